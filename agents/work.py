"""The one place that runs jobs: a list of tasks that know nothing of each other, done by so many processes.

A task can be pickled, carries all its seeds, and gives the same whoever runs it: a process of this machine, or one of
a cluster (`cluster.py`).
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple, Protocol

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


def run_all(tasks: Iterable[Task], hands: Hands) -> Generator[tuple[Task, Any], None, None]:
    """Do tasks.

    Close the iterator where it isn't used up, as `contextlib.closing` does: then those at work stop.

    Args:
        tasks: Taken from as there is somebody for them.
        hands: Who does them.

    Yields:
        Each task with its result, in the order of the tasks.

    Raises:
        CommandError: A process can't be started, or ended before its task was done.
        KeyboardInterrupt: It was asked to stop. Tasks that were done by then have been given; of those before them some
            may be missing.
        Exception: A task failed with it; those before it have been given, and no more are begun.
    """
    numbered = enumerate(tasks)
    waiting: dict[int, Task] = {}
    answers: dict[int, Answer] = {}
    try:
        while True:
            interrupts.check()
            jobs = hands.jobs
            idle = min(jobs - (len(waiting) - len(answers)), _AHEAD * jobs - len(waiting))
            for number, task in islice(numbered, max(idle, 0)):
                waiting[number] = task
                hands.begin(number, task)
            if not waiting:
                return
            first = next(iter(waiting))
            if first not in answers:
                answers |= {answer.number: answer for answer in hands.answers()}
                continue
            answer = answers.pop(first)
            if not answer.good:
                raise answer.found
            yield waiting.pop(first), answer.found
    except KeyboardInterrupt:
        hands.stop()
        for number, answer in sorted(answers.items()):
            if answer.good:
                yield waiting[number], answer.found
        raise
    finally:
        if waiting:
            hands.stop()


_AHEAD = 8
"""How many tasks for each process may be done or under way while a result before theirs is waited for."""


class Answer(NamedTuple):
    """What came of a task."""

    number: int
    """The task's own, as `Hands.begin` was told it."""
    good: bool
    found: Any
    """Its result, or the error that it ended with."""


class Hands(Protocol):
    """Those who do tasks."""

    @property
    def jobs(self) -> int:
        """How many at a time."""

    def begin(self, number: int, task: Task) -> None:
        """Let somebody who has nothing to do begin a task.

        Raises:
            CommandError: Nobody can.
        """

    def answers(self) -> Sequence[Answer]:
        """Wait for tasks to end; none may have when it returns, so that requests to stop are heard."""

    def stop(self) -> None:
        """Let nobody go on with what was begun; who was at work has put away what it keeps when this returns."""

    def close(self) -> None:
        """Let all go."""


class Here:
    """This process, which does tasks itself, one at a time."""

    jobs = 1

    def __init__(self) -> None:
        self._done: list[Answer] = []

    def begin(self, number: int, task: Task) -> None:
        """See `Hands`."""
        try:
            self._done.append(Answer(number, True, task.run()))
        except Exception as error:
            self._done.append(Answer(number, False, error))

    def answers(self) -> Sequence[Answer]:
        """See `Hands`."""
        done, self._done = self._done, []
        return done

    def stop(self) -> None:
        """See `Hands`."""
        self._done.clear()

    def close(self) -> None:
        """See `Hands`."""


class Crew:
    """Processes of this machine that do tasks.

    Args:
        jobs: How many; each has one thread.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._workers: dict[Connection, multiprocessing.process.BaseProcess] = {}
        self._under_way: dict[Connection, tuple[int, Task]] = {}

    def begin(self, number: int, task: Task) -> None:
        """See `Hands`."""
        connection = self._idle()
        self._under_way[connection] = number, task
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

    def answers(self) -> Sequence[Answer]:
        """See `Hands`."""
        return [self._answer(connection) for connection in wait(list(self._under_way))]  # type: ignore[arg-type]

    def _answer(self, connection: Connection) -> Answer:
        """What the process says of its task."""
        number, task = self._under_way.pop(connection)
        try:
            good, found = connection.recv()
        except (EOFError, ConnectionResetError):
            process = self._workers.pop(connection)
            process.join()
            connection.close()
            return Answer(number, False, CommandError(f"{task.name}: its process ended with status {process.exitcode}"))
        return Answer(number, good, found)

    def stop(self) -> None:
        """See `Hands`."""
        for process in self._workers.values():
            process.terminate()
        self.close()

    def close(self) -> None:
        """See `Hands`."""
        # Who is let go ends by itself, and puts away what Python keeps track of.
        for connection in self._workers:
            connection.close()
        for process in self._workers.values():
            process.join()
        self._workers.clear()
        self._under_way.clear()


def serve(connection: Connection) -> None:
    """Do the tasks that come, one after another, until nobody is there any more to send one."""
    threading.Thread(target=_follow, daemon=True).start()
    while True:
        answer: tuple[bool, Any]
        try:
            task = connection.recv()
        except EOFError:
            return
        except Exception as error:
            answer = False, portable(error)
        else:
            answer = attempt(task)
        try:
            connection.send(answer)
        except BrokenPipeError:
            return
        except Exception as error:
            # What a task gives, its process must be able to send.
            connection.send((False, portable(error)))


def _follow() -> None:
    """Ask this process to stop when the one that it works for has been killed: its task may take hours yet."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)


def attempt(task: Task) -> tuple[bool, Any]:
    """Do a task in a process that is there for that.

    Returns:
        Whether it was done, and its result, or an error that any process can raise.

    Raises:
        SystemExit: It was asked to stop.
    """
    try:
        return True, task.run()
    except KeyboardInterrupt:
        raise SystemExit(interrupts.status()) from None
    except Exception as error:
        return False, portable(error)


def portable(error: Exception) -> Exception:
    """An error that another process can raise, with a note of where it was raised here."""
    if isinstance(error, CommandError):
        return error
    told = error
    if type(error).__module__.partition(".")[0] not in ("builtins", __name__.partition(".")[0]):
        # Others may not be made again from what they say.
        told = RuntimeError(f"{type(error).__name__}: {error}")
    told.add_note(traceback.format_exc())
    return told


THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS")
"""What says how many threads NumPy, PyTorch and Numba take, which read it when they are imported."""


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes begun in the block have one thread for their numbers: as many of them as cores share these."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
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
