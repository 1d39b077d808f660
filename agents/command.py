"""What the commands share: their errors, and checks of options before any work begins."""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

EXTRAS = {
    "matplotlib": "benchmark",
    "tqdm": "benchmark",
    "stable_baselines3": "agents",
    "sb3_contrib": "agents",
    "tensorboard": "agents",
    "yaml": "agents",
    "optuna": "tune",
    "cmaes": "tune",
}
"""Which extra of this package brings a module."""


class CommandError(Exception):
    """An error that a command reports in one line."""


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


def seconds(text: str) -> float:
    """An argparse type: a time above 0 [s]."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not allowed; it must be a number of seconds above 0.")
    return value


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
