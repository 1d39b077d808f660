"""The one place that runs jobs: a list of tasks that know nothing of each other, done by so many processes.

What runs them elsewhere, such as on other machines, goes behind `run_all`: a task can be pickled, carries all its
seeds, and gives the same whoever runs it.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection, wait
from typing import Any

from uwoc_gym.agents import interrupts
from uwoc_gym.agents.errors import CommandError


@dataclass(frozen=True)
class Task:
    """A job that any process can do: a function at the top of a module, and what it is called with.

    Attributes:
        function: Called with the seeds after the arguments.
        arguments: What can be pickled.
        seeds: All that its randomness hangs on.
        name: What errors call it.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    seeds: Sequence[int] = ()
    name: str = "a task"

    def run(self) -> Any:
        """Do it."""
        return self.function(*self.arguments, self.seeds)


def cores() -> int:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_all(tasks: Iterable[Task], jobs: int) -> Generator[tuple[Task, Any], None, None]:
    """Do tasks, so many at a time, each in a process of its own; one at a time they are done in this process.

    Processes have one thread each. Close the iterator where it isn't used up, as `contextlib.closing` does.

    Args:
        tasks: Taken from as there are processes for them.
        jobs: How many at a time.

    Yields:
        Each task with its result, in the order of the tasks.

    Raises:
        CommandError: A process can't be started, or ended before its task was done.
        KeyboardInterrupt: It was asked to stop. Tasks that were done by then have been given; of those before them some
            may be missing.
        Exception: A task failed with it; those before it have been given, and no more are begun.
    """
    if jobs == 1:
        for task in tasks:
            interrupts.check()
            yield task, task.run()
        return
    yield from _Crew(jobs).done(iter(tasks))


_AHEAD = 8
"""How many tasks for each process may be done or under way while a result before theirs is waited for."""


class _Crew:
    """Processes that do tasks."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._workers: dict[Connection, multiprocessing.process.BaseProcess] = {}
        self._under_way: dict[Connection, int] = {}

    def done(self, tasks: Iterator[Task]) -> Generator[tuple[Task, Any], None, None]:
        """See `run_all`."""
        numbered = enumerate(tasks)
        waiting: dict[int, Task] = {}
        answers: dict[int, tuple[bool, Any]] = {}
        try:
            while True:
                interrupts.check()
                idle = min(self._jobs - len(self._under_way), _AHEAD * self._jobs - len(waiting))
                for number, task in islice(numbered, idle):
                    waiting[number] = task
                    self._begin(number, task)
                if not waiting:
                    return
                first = next(iter(waiting))
                if first not in answers:
                    for connection in wait(list(self._under_way)):
                        number = self._under_way[connection]  # type: ignore[index]
                        answers[number] = self._answer(connection, waiting[number])  # type: ignore[arg-type]
                    continue
                good, found = answers.pop(first)
                if not good:
                    raise found
                yield waiting.pop(first), found
        except KeyboardInterrupt:
            self._stop()
            for number, (good, found) in sorted(answers.items()):
                if good:
                    yield waiting[number], found
            raise
        finally:
            self._stop()

    def _begin(self, number: int, task: Task) -> None:
        connection = self._idle()
        self._under_way[connection] = number
        # That a process has ended is noticed where its answer is read.
        with suppress(BrokenPipeError):
            connection.send(task)

    def _idle(self) -> Connection:
        """A process that has nothing to do."""
        for connection in self._workers:
            if connection not in self._under_way:
                return connection
        # PyTorch and Numba don't like to be forked.
        context = multiprocessing.get_context("spawn")
        try:
            own, other = context.Pipe()
            process = context.Process(target=serve, args=(other,), daemon=True)
            with interrupts.kept_from_children(), _one_thread_each():
                process.start()
        except OSError as error:
            raise CommandError(f"worker processes can't be started: {error.strerror or error}") from None
        other.close()
        self._workers[own] = process
        return own

    def _answer(self, connection: Connection, task: Task) -> tuple[bool, Any]:
        """Whether the process has done its task, and the result or what went wrong."""
        del self._under_way[connection]
        try:
            good, found = connection.recv()
        except (EOFError, ConnectionResetError):
            process = self._workers.pop(connection)
            process.join()
            connection.close()
            return False, CommandError(f"{task.name}: its process ended with status {process.exitcode}")
        return good, found

    def _stop(self) -> None:
        for connection, process in self._workers.items():
            process.terminate()
            connection.close()
        for process in self._workers.values():
            process.join()
        self._workers.clear()
        self._under_way.clear()


def serve(connection: Connection) -> None:
    """Do the tasks that come, one after another, until nobody is there any more to send one."""
    while True:
        answer: tuple[bool, Any]
        try:
            task = connection.recv()
        except EOFError:
            return
        except Exception as error:
            answer = False, _portable(error)
        else:
            try:
                answer = True, task.run()
            except Exception as error:
                answer = False, _portable(error)
        try:
            connection.send(answer)
        except BrokenPipeError:
            return
        except Exception as error:
            # What a task gives, its process must be able to send.
            connection.send((False, _portable(error)))


def _portable(error: Exception) -> Exception:
    """An error that another process can raise, with a note of where it was raised here."""
    if isinstance(error, CommandError):
        return error
    told = error
    if type(error).__module__.partition(".")[0] not in ("builtins", __name__.partition(".")[0]):
        # Others may not be made again from what they say.
        told = RuntimeError(f"{type(error).__name__}: {error}")
    told.add_note(traceback.format_exc())
    return told


_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS")
"""What says how many threads NumPy, PyTorch and Numba take, which read it when they are imported."""


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes begun in the block have one thread for their numbers: as many of them as cores share these."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def take_one_thread() -> None:
    """Let PyTorch, if it is there, take one thread: small networks gain nothing from more, and give the same bits."""
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(1)
