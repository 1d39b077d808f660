"""The command in a process of its own, with work that takes long, and a disk without room."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

BRIEF = ["--override", '{"episode": {"duration_s": 2.0}}']
TRAIN = [
    "--envs", "4", "--eval-episodes", "2", "--set", "n_steps=16", "--set", "batch_size=32", "--set", "n_epochs=1",
    "--set", "policy_kwargs.net_arch=[8]", "--set", "normalize=true",
]  # fmt: skip
OFF = ["--set", "buffer_size=4000", "--set", "batch_size=16", "--set", "learning_starts=50", "--set", "train_freq=8"]
OFF_TRAIN = ["--algorithm", "sac", "--envs", "4", "--eval-episodes", "2", "--set", "policy_kwargs.net_arch=[8]", *OFF]


def start(*words: object) -> subprocess.Popen[str]:
    """The command in a process, and a group, of its own."""
    command = [sys.executable, "-m", "uwoc_gym_command", *map(str, words)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "SDL_VIDEODRIVER": "dummy"}
    # From the checkout's top, where the command's first lines stand.
    return subprocess.Popen(
        command,
        cwd=Path(__file__).parents[2],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def end(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit status and what was said."""
    try:
        said, errors = process.communicate(timeout=120)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    return process.returncode, said, errors


def until(found: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait for something that a process does before it ends."""
    latest = time.monotonic() + 180
    while not found():
        assert process.poll() is None, end(process)
        assert time.monotonic() < latest
        time.sleep(0.02)


def lines(path: Path) -> int:
    """How many lines a file has; none if it isn't there."""
    return len(path.read_text(encoding="utf-8").splitlines()) if path.is_file() else 0


@contextmanager
def room(size: int) -> Iterator[None]:
    """No file may grow beyond so many bytes, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
