"""Checkpoints of a training run: folders that are either whole or not there.

A checkpoint is written under a temporary name and renamed when all of it is on the disk; only then is its predecessor
removed. Whatever stops the process, the newest folder with a proper name is whole.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import IO

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.reports.files import flush, whole

_PREFIX = "checkpoint-"
_PART = ".part"


def newest(folder: Path) -> Path | None:
    """The newest whole checkpoint in a run's folder; None if there is none."""
    return max(_whole(folder), key=_number, default=None)


def _whole(folder: Path) -> list[Path]:
    return [path for path in folder.glob(f"{_PREFIX}*") if path.is_dir() and path.name[len(_PREFIX) :].isdigit()]


def _number(path: Path) -> int:
    return int(path.name[len(_PREFIX) :])


def write(folder: Path, fill: Callable[[Path], None]) -> Path:
    """Write a checkpoint whole or not at all, and remove the one before it.

    Args:
        folder: The run's folder.
        fill: Writes the files into the folder that it is given.

    Raises:
        CommandError: It can't be written; the one before it stays.
    """
    last = newest(folder)
    name = f"{_PREFIX}{_number(last) + 1 if last else 1:06d}"
    part, target = folder / (name + _PART), folder / name
    try:
        for left in folder.glob(f"{_PREFIX}*{_PART}"):
            shutil.rmtree(left)
        part.mkdir()
        fill(part)
        for path in part.iterdir():
            flush(path)
        flush(part)
        part.rename(target)
        flush(folder)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        reason = error.strerror or error
        kept = f"{last} is whole" if last else "there is none before it"
        raise CommandError(f"checkpoint {target} can't be written: {reason}; {kept}.") from error
    for path in _whole(folder):
        if path != target:
            shutil.rmtree(path, ignore_errors=True)
    return target


def save_agent(path: Path, write: Callable[[IO[bytes]], None]) -> None:
    """Save an agent whole or not at all.

    Args:
        path: Its file.
        write: Writes it to a file that is open for reading and writing.

    Raises:
        OSError: It can't be written.
    """
    # Stable-Baselines3 would add a suffix to a path; a file it takes as it is.
    try:
        with whole(path) as part, part.open("w+b") as file:
            write(file)
    except (OSError, RuntimeError) as error:
        # PyTorch reports a full disk as a RuntimeError, and an error in writing doesn't name the file.
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error).splitlines()[0]
        raise OSError(getattr(error, "errno", None), reason, str(path)) from error
