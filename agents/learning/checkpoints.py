"""Checkpoints of a training run: folders that are either whole or not there.

A checkpoint is written under a temporary name and renamed when all of it is on the disk; only then is its predecessor
removed. Whatever stops the process, the newest folder with a proper name is whole.
"""

from __future__ import annotations

import json
import shutil
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

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


def _arrays(buffer: Any) -> dict[str, Any]:
    return {
        name: value
        for name, value in vars(buffer).items()
        if isinstance(value, np.ndarray) and value.shape[:1] == (buffer.buffer_size,)
    }


def save_buffer(buffer: Any, path: Path) -> None:
    """Save the filled part of a replay buffer."""
    filled = buffer.buffer_size if buffer.full else buffer.pos
    # One more than filled: a buffer that saves memory keeps the next observation there.
    parts = {name: value[: filled + 1] for name, value in _arrays(buffer).items()}
    np.savez(path, pos=buffer.pos, full=buffer.full, **parts)


def save_plain(path: Path, value: Any) -> None:
    """Save numbers, texts, arrays, and tuples and mappings of them, such as a policy's memory, and no objects.

    Raises:
        TypeError: Something else is among them.
    """
    arrays: list[npt.NDArray[Any]] = []

    def told(each: Any) -> Any:
        if each is None or isinstance(each, (bool, int, float, str)):
            return each
        if isinstance(each, Mapping):
            return {"named": {str(key): told(own) for key, own in each.items()}}
        if isinstance(each, (tuple, list, deque)):
            return {"in order": [told(own) for own in each]}
        array = np.asarray(each)
        if array.dtype.hasobject:
            raise TypeError(f"{type(each).__name__} can't be kept")
        arrays.append(array)
        return {"array": len(arrays) - 1}

    text = json.dumps(told(value))
    np.savez(path, np.array(text), *arrays)


def read_plain(path: Path) -> Any:
    """What `save_plain` saved; what stood in order comes back as a tuple.

    Raises:
        CommandError: The file can't be read.
    """

    def found(each: Any) -> Any:
        if not isinstance(each, dict):
            return each
        ((kind, own),) = each.items()
        if kind == "named":
            return {key: found(value) for key, value in own.items()}
        return tuple(map(found, own)) if kind == "in order" else saved[f"arr_{own + 1}"]

    try:
        with path.open("rb") as file, np.load(file) as saved:
            return found(json.loads(str(saved["arr_0"])))
    # NumPy raises anything on what is damaged, from a BadZipFile to a SyntaxError.
    except Exception as error:
        raise damaged(path, error) from None


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """Arrays that were saved together.

    Raises:
        CommandError: The file can't be read, lacks one of them, or one holds what isn't finite.
    """
    try:
        with path.open("rb") as file, np.load(file) as saved:
            held = {name: saved[name] for name in names}
        if not all(np.isfinite(array).all() for array in held.values()):
            raise ValueError("it holds what isn't finite")
    # NumPy raises anything on what is damaged, from a BadZipFile to a SyntaxError.
    except Exception as error:
        raise damaged(path, error) from None
    return held


def read_buffer(path: Path, names: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """Arrays of a saved replay buffer, each (transitions, environments, ...), oldest first; and whether it was "full".

    Raises:
        CommandError: The file can't be read, or lacks one of them.
    """
    held = read_arrays(path, (*names, "pos", "full"))
    try:
        pos, full = int(held.pop("pos")), np.asarray(bool(held.pop("full")))
        if len({array.shape[:2] for array in held.values()}) != 1 or not 0 <= pos <= len(held[names[0]]):
            raise ValueError("its arrays don't fit together")
    except (TypeError, ValueError) as error:
        raise damaged(path, error) from None
    return {name: np.roll(array, -pos, axis=0) if full else array[:pos] for name, array in held.items()} | {
        "full": full
    }


def damaged(path: Path, error: Exception) -> CommandError:
    """What to say of a file that can't be read."""
    text = " ".join(str(error).split())
    return CommandError(f"{path} can't be read: it is damaged, or of another run: {text[:200]}.")


def load_buffer(buffer: Any, path: Path) -> None:
    """Fill a replay buffer with what was saved.

    Raises:
        CommandError: The file can't be read, or is of another buffer.
    """
    try:
        with path.open("rb") as file, np.load(file) as saved:
            held = {name: saved[name] for name in ("pos", "full", *_arrays(buffer))}
        pos, full = int(held["pos"]), bool(held["full"])
        filled = buffer.buffer_size if full else pos
        if not 0 <= pos < buffer.buffer_size:
            raise ValueError(f"pos = {pos} is not in the buffer")
        for name, value in _arrays(buffer).items():
            if held[name].dtype != value.dtype or len(held[name]) < filled:
                raise ValueError(f"{name} is not what it should be")
            value[: len(held[name])] = held[name]
    # NumPy raises anything on what is damaged, from a BadZipFile to a SyntaxError.
    except Exception as error:
        raise damaged(path, error) from None
    buffer.pos, buffer.full = pos, full
