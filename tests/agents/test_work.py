"""Jobs in processes: the same results in the same order, however many do them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym.agents.cluster import workers
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.work import Task, cores, run_all


@contextmanager
def done_by(tasks: Iterable[Task], jobs: int) -> Iterator[Iterator[tuple[Task, Any]]]:
    """Tasks and their results, by so many processes."""
    with workers(jobs) as crew, closing(run_all(tasks, crew)) as done:
        yield done


def drawn(scale: float, seeds: Sequence[int]) -> list[float]:
    return [scale * np.random.default_rng(seed).normal() for seed in seeds]


def who(wait_s: float, seeds: Sequence[int]) -> int:
    time.sleep(wait_s)
    return os.getpid()


def threads(seeds: Sequence[int]) -> dict[str, Any]:
    import numba
    import torch

    return {
        "numba": numba.get_num_threads(),
        "torch": torch.get_num_threads(),
        "omp": os.environ["OMP_NUM_THREADS"],
        "deaf": signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []),
    }


def failing(seeds: Sequence[int]) -> None:
    raise CommandError(f"seed {seeds[0]} won't")


class Odd(Exception):
    """An error that no other process can make again."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} and {second}")


def odd(seeds: Sequence[int]) -> None:
    raise Odd("this", "that")


def unsendable(seeds: Sequence[int]) -> Any:
    return lambda: None


def killed(seeds: Sequence[int]) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_results_stand_in_the_order_of_the_tasks(jobs: int) -> None:
    # The first takes longest.
    tasks = [Task(who, (0.5,)), *(Task(drawn, (float(k),), range(k, k + 3)) for k in range(9))]
    with done_by(tasks, jobs) as done:
        found = list(done)
    assert [task for task, _ in found] == tasks
    assert [result for _, result in found[1:]] == [drawn(k, range(k, k + 3)) for k in range(9)]


def test_so_many_processes_do_them_and_one_does_them_here() -> None:
    with done_by([Task(who, (0.3,))] * 6, 2) as done:
        others = {result for _, result in done}
    assert len(others) == 2
    assert os.getpid() not in others
    with done_by([Task(who, (0.0,))] * 2, 1) as done:
        assert [result for _, result in done] == [os.getpid()] * 2


def test_processes_have_one_thread_and_do_not_hear_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with done_by([Task(threads)] * 2, 2) as done:
        for _, found in done:
            assert found == {"numba": 1, "torch": 1, "omp": "1", "deaf": True}
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "NUMBA_NUM_THREADS" not in os.environ


def test_tasks_are_taken_as_there_is_somebody_for_them() -> None:
    """Of tasks without end, as of a million of them, few are begun before they are wanted."""
    begun = []

    def endless() -> Any:
        for number in count():
            begun.append(number)
            yield Task(drawn, (1.0,), [number])

    with done_by(endless(), 2) as done:
        assert [next(done)[1] for _ in range(3)] == [drawn(1.0, [number]) for number in range(3)]
    assert len(begun) < 30


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_task_raises_comes_in_its_place(jobs: int) -> None:
    tasks = [Task(drawn, (1.0,), [0]), Task(failing, (), [7]), Task(drawn, (1.0,), [1])]
    with done_by(tasks, jobs) as done:
        assert next(done)[1] == drawn(1.0, [0])
        with pytest.raises(CommandError, match=r"^seed 7 won't$"):
            next(done)


@pytest.mark.parametrize(
    ("function", "kind", "message"),
    [
        (odd, RuntimeError, "Odd: this and that"),
        (unsendable, Exception, "lambda"),
        (killed, CommandError, "^flying it: its process ended with status -9$"),
    ],
)
def test_what_goes_wrong_in_another_process_is_said(function: Any, kind: type[Exception], message: str) -> None:
    with (
        pytest.raises(kind, match=message),
        done_by([Task(function, (), (), "flying it"), Task(who, (0.0,))], 2) as done,
    ):
        list(done)


def test_an_interruption_gives_what_was_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first task takes a minute, and what was done after it isn't lost."""
    tasks = [Task(who, (60.0,)), Task(drawn, (1.0,), [4]), Task(drawn, (1.0,), [5])]
    given = []
    old = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    # In the background of a shell nobody minds it.
    kept = signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.alarm(12)
    begun = time.monotonic()
    try:
        with done_by(tasks, 2) as done, pytest.raises(KeyboardInterrupt):
            given.extend(done)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, old)
        signal.signal(signal.SIGINT, kept)
    assert given == [(task, drawn(1.0, task.seeds)) for task in tasks[1:]]
    assert time.monotonic() - begun < 40.0


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")
def test_processes_end_with_the_one_that_began_them() -> None:
    code = (
        "import sys\nfrom uwoc_gym.agents.work import Task\nfrom tests.agents.test_work import done_by, who\n"
        "if __name__ == '__main__':\n    with done_by((Task(who, (0.2,)) for _ in range(10**6)), 2) as done:\n"
        "        for _, pid in done:\n            print(pid, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        others = {int(process.stdout.readline()) for _ in range(6)}
        process.kill()
    assert len(others) == 2
    until = time.monotonic() + 30.0
    while any(Path(f"/proc/{pid}").exists() for pid in others) and time.monotonic() < until:
        time.sleep(0.1)
    assert not [pid for pid in others if Path(f"/proc/{pid}").exists()]


def test_there_is_at_least_one_core() -> None:
    assert 1 <= cores() <= (os.cpu_count() or 1)
