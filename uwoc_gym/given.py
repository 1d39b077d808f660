"""What is given from outside, read within bounds: numbers, counts, arrays, JSON and files, and how errors show them.

Everything here ends, in bounded time and memory, with a value or a `SettingError`, whatever it is given.
"""

from __future__ import annotations

import difflib
import json
import math
import numbers
import os
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class SettingError(ValueError):
    """A setting that is unknown, has the wrong type or lies outside what is allowed."""


class Limit(NamedTuple):
    """The least and the most of something that may be asked for."""

    low: float
    high: float
    whole: bool = True

    @property
    def allowed(self) -> str:
        """What is accepted, in words."""
        return f"a {'whole ' if self.whole else ''}number from {self.low:_} to {self.high:_}"


LIMITS: dict[str, Limit] = {
    # Of environments and simulations. A million take 2 GB.
    "environments": Limit(1, 1_000_000),
    "threads": Limit(1, 1024),
    # Doubles count as far as that.
    "max_episode_steps": Limit(1, 2**53),
    "seed": Limit(0, 2**64 - 1),
    "width": Limit(32, 7680),
    "height": Limit(32, 4320),
    # Of a recorded path, and of pulses, ships and whatever else a scenario has several of.
    "samples": Limit(4, 500_000),
    "items": Limit(0, 1000),
    # Of commands.
    "seeds": Limit(1, 1_000_000),
    "episodes at a time": Limit(1, 4096),
    "trials": Limit(1, 1_000_000),
    "steps": Limit(1, 10**12),
    "frames in a row": Limit(1, 100),
    "jobs": Limit(1, 256),
    "rounds": Limit(1, 1000),
    "seconds": Limit(1e-3, 1e6, whole=False),
    "frames per second": Limit(0.1, 240.0, whole=False),
    "times real time": Limit(0.01, 1000.0, whole=False),
    "frames": Limit(1, 1_000_000),
    # Control periods of all episodes that are flown together, each of which is kept: 200 bytes.
    "flown together": Limit(1, 30_000_000),
    # What an action of 1 adds to a controller's, as a share of the actuators' limits.
    "residual scale": Limit(1e-6, 2.0, whole=False),
    # Standard deviation of what is added to actions, likewise.
    "noise": Limit(0.0, 2.0, whole=False),
    # Of a network.
    "width of a layer": Limit(1, 8192),
    "layers": Limit(0, 32),
    # Transitions that a learner keeps at a time: a rollout's, or a replay buffer's.
    "transitions": Limit(1, 10_000_000),
}
"""What can't be less, and what would take more time or memory than anyone means, by what it counts."""

DEEPEST = 32
"""How deep plain data may be nested."""
MOST_VALUES = 2_000_000
"""How many values plain data may hold."""
MOST_BYTES = 32 * 2**20
"""How long a file may be that is read into memory."""


class _Short(reprlib.Repr):
    """A representation that is short whatever it is of."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 5
        self.maxdict = self.maxlist = self.maxtuple = self.maxset = self.maxfrozenset = self.maxdeque = 12
        self.maxstring = self.maxother = 160
        self.maxlong = 60

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write down thousands of digits.
        return super().repr_int(x, level) if x.bit_length() < 2000 else f"a number of {x.bit_length()} bits"

    def repr_ndarray(self, x: npt.NDArray[Any], level: int) -> str:
        return repr(x) if x.size <= 12 else f"an array of shape {x.shape} and type {x.dtype}"


_SHORT = _Short()


def shown(value: Any) -> str:
    """The value as an error shows it: on one line, and short however long or deep it is."""
    try:
        return " ".join(_SHORT.repr(value).split())
    except Exception:
        return f"a {type(value).__name__} that can't be shown"


def closest(name: Any, known: Iterable[str]) -> str:
    """The hint that ends an error about an unknown name: the nearest valid one and all of them."""
    valid = list(known)
    matches = difflib.get_close_matches(name[:100], valid, n=1, cutoff=0.4) if isinstance(name, str) else []
    hint = f"did you mean {matches[0]!r}? " if matches else ""
    return f"{hint}Valid names: {', '.join(valid)}."


def scalar(value: Any) -> Any:
    """NumPy's scalars and arrays without a dimension as the plain value that they hold, anything else as it is."""
    if isinstance(value, (np.generic, np.ndarray)) and value.ndim == 0:
        return value.item()
    return value


def as_number(value: Any) -> float | None:
    """The number that a value is, as a float; None for what isn't one, truth values among them."""
    plain = scalar(value)
    if isinstance(plain, bool) or not isinstance(plain, (numbers.Real, np.floating)):
        return None
    try:
        return float(plain)
    except (OverflowError, TypeError, ValueError):
        return None


def as_whole(value: Any) -> int | None:
    """The whole number that a value is, 3.0 too; None for what isn't one, truth values among them."""
    plain = scalar(value)
    if isinstance(plain, int) and not isinstance(plain, bool):
        return int(plain)
    number = as_number(plain)
    return int(number) if number is not None and math.isfinite(number) and number == math.floor(number) else None


def count(name: str, value: Any, limit: str | None = None) -> int:
    """The count that a value is.

    Args:
        name: What the count is called, for the error.
        value: What was given.
        limit: Its bounds' name in `LIMITS`, by default ``name``.

    Raises:
        SettingError: It isn't a whole number within its bounds.
    """
    bounds = LIMITS[limit or name]
    whole = as_whole(value)
    if whole is None or not bounds.low <= whole <= bounds.high:
        raise SettingError(f"{name} = {shown(value)} is not allowed; it must be {bounds.allowed}.")
    return whole


def as_numbers(value: Any, *shapes: tuple[int, ...]) -> Array | None:
    """The finite numbers that a value holds, float64 and of one of the shapes, of any shape without; else None.

    Texts, truth values and complex numbers aren't numbers; an array of NumPy's or anything that gives one is.
    """
    most = max(map(len, shapes), default=3)
    try:
        found = _numbers(value, most)
        array = None if found is None else np.asarray(found, dtype=float)
    # What gives an array may raise anything, such as a tensor of PyTorch that needs a gradient.
    except Exception:
        return None
    if array is None or (shapes and array.shape not in shapes) or not np.isfinite(array).all():
        return None
    return array


def _numbers(value: Any, depth: int) -> Any:
    """Nested lists of arrays and numbers, at most so deep; None if there is anything else."""
    if isinstance(value, (list, tuple)):
        items = [_numbers(item, depth - 1) for item in value] if depth else [None]
        return None if any(item is None for item in items) else items
    # An array with a dimension is no single number, and asking costs more than a step of an environment.
    single = None if type(value) is np.ndarray and value.ndim else as_number(value)
    if single is not None or isinstance(value, (str, bytes, Mapping, bool)) or not hasattr(value, "__array__"):
        return single
    array = np.asarray(value)
    return array if array.dtype.kind in "iuf" and array.ndim <= depth else None


def check_plain(value: Any) -> None:
    """Refuse plain data that is nested too deeply, holds itself, or grows beyond bounds where it names its parts again.

    Raises:
        SettingError: It is one of these.
    """
    waiting = [(value, 0)]
    seen = 0
    while waiting:
        each, depth = waiting.pop()
        seen += 1
        if depth > DEEPEST:
            raise SettingError(f"it is nested more than {DEEPEST} levels deep.")
        if seen > MOST_VALUES:
            raise SettingError(f"it holds more than {MOST_VALUES:_} values.")
        if isinstance(each, Mapping):
            waiting.extend((item, depth + 1) for item in each.values())
        elif isinstance(each, (list, tuple)):
            waiting.extend((item, depth + 1) for item in each)


def from_json(text: str, name: str | None = None) -> Any:
    """What a JSON text says.

    Args:
        text: The text.
        name: What an error calls it, by default the text itself.

    Raises:
        SettingError: It isn't valid, or nested or long beyond bounds.
    """
    try:
        found = json.loads(text)
        check_plain(found)
    except RecursionError:
        reason = f"it is nested more than {DEEPEST} levels deep."
    except SettingError as error:
        reason = str(error)
    except ValueError as error:
        reason = f"{error}."
    else:
        return found
    raise SettingError(f"{name or shown(text)} isn't valid JSON: {reason}")


def said_by(word: str) -> Any:
    """The value that a word of a command line says: what it is as JSON, else the text itself."""
    try:
        return from_json(word)
    except SettingError:
        return word.strip()


def read_text(path: str | Path, most_bytes: int = MOST_BYTES) -> str:
    """The text of a file, UTF-8 with or without a byte-order mark.

    Raises:
        SettingError: The file, which the error names, can't be read, isn't text or is too long.
    """
    name = shown(os.fspath(path))
    try:
        with open(path, "rb") as file:
            data = file.read(most_bytes + 1)
        text = data.decode("utf-8-sig") if len(data) <= most_bytes else None
    except OSError as error:
        raise SettingError(f"{name} can't be read: {error.strerror or error}.") from None
    except UnicodeDecodeError as error:
        raise SettingError(f"{name} can't be read: it must be text in UTF-8 ({error.reason}).") from None
    except ValueError as error:
        # A name that no file can have.
        raise SettingError(f"{name} can't be read: {error}.") from None
    if text is None:
        raise SettingError(f"{name} is not allowed; it must be a file of at most {most_bytes:_} bytes.")
    return text


def is_sequence(value: Any) -> bool:
    """Whether a value is a sequence of values rather than a text: a list, a tuple, a range or an array."""
    return isinstance(value, (list, tuple, range)) or (isinstance(value, np.ndarray) and value.ndim > 0)


def values_of(value: Any) -> Sequence[Any]:
    """The values of a sequence, NumPy's as plain ones; nothing for what is no sequence."""
    return [scalar(item) for item in value] if is_sequence(value) else ()
