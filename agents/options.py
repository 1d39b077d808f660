"""What the commands share: their errors, and checks of options before any work begins."""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from uwoc_gym.spaces import SMALLEST_FRAME, check_render_size

EXTRAS = {
    "cmaes": "tune",
    "imageio_ffmpeg": "render",
    "matplotlib": "benchmark",
    "optuna": "tune",
    "plotly": "render",
    "pygame": "render",
    "sb3_contrib": "agents",
    "stable_baselines3": "agents",
    "tensorboard": "agents",
    "tqdm": "benchmark",
    "yaml": "agents",
}
"""Which extra of this package brings a module."""


class CommandError(Exception):
    """An error that a command reports in one line."""


@contextmanager
def naming(option: str) -> Iterator[None]:
    """Put the option's name before an error about what it was given."""
    try:
        yield
    except CommandError as error:
        raise CommandError(f"{option}: {error}") from None


def require(*modules: str) -> None:
    """Refuse to go on without optional modules.

    Raises:
        CommandError: One of them isn't installed; the extra that brings it is named.
    """
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise CommandError(f'{module} is not installed; run: pip install "uwoc-gym[{EXTRAS[module]}]"')


def output_folder(path: str | Path) -> Path:
    """Create a folder for results and make sure that files can be written to it.

    Raises:
        CommandError: They can't.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or error
        raise CommandError(f"--out {folder}: {reason}; it must be a folder that can be written to.") from None
    return folder


def whole(low: int) -> Callable[[str], int]:
    """An argparse type: a whole number of at least ``low``."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if value < low:
            raise argparse.ArgumentTypeError(f"{text!r} is not allowed; it must be a whole number of at least {low}.")
        return value

    return parse


def _number(text: str, allowed: str, low: float, strictly: bool) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (low < value if strictly else low <= value) or not value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not allowed; it must be {allowed}.")
    return value


def seconds(text: str) -> float:
    """An argparse type: a time above 0 [s]."""
    return _number(text, "a number of seconds above 0", 0.0, True)


def moment(text: str) -> float:
    """An argparse type: a time of at least 0 [s]."""
    return _number(text, "a number of seconds of at least 0", 0.0, False)


def above_zero(text: str) -> float:
    """An argparse type: a number above 0."""
    return _number(text, "a number above 0", 0.0, True)


def frame_size(text: str) -> tuple[int, int]:
    """An argparse type: the width and height of a picture [px], as in 1280x720."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
        return check_render_size((width, height))
    except ValueError:
        least = "x".join(str(side) for side in SMALLEST_FRAME)
        raise argparse.ArgumentTypeError(
            f"{text!r} is not allowed; it must be a width and a height [px] of at least {least}, as in 1280x720."
        ) from None


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
