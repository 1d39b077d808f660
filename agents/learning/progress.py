"""How far a training run has come, as it stands in every checkpoint."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.reports.files import read_json
from uwoc_gym.given import as_number, shown


@dataclass
class Progress:
    """How far a run has come; part of every checkpoint."""

    steps: int = 0
    seconds: float = 0.0
    """Wall time so far [s]."""
    learning_seconds: float = 0.0
    """The same without evaluations and checkpoints, but with what it took to copy a teacher [s]."""
    seeds_used: int = 0
    """Training seeds in use, those of lessons and of the times it went on with new episodes among them."""
    evaluations: list[dict[str, Any]] = field(default_factory=list)
    best_steps: int | None = None
    lessons: int = 0
    """Rounds in which a teacher was copied; their steps aren't among the others."""
    finished: bool = False
    counters: dict[str, int] = field(default_factory=dict)
    """What the model counts besides, by Stable-Baselines3's names."""

    @property
    def best(self) -> dict[str, Any] | None:
        """The evaluation of the best model."""
        return next((each for each in self.evaluations if each["steps"] == self.best_steps), None)


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**53


def _are_counts(value: Any) -> bool:
    return isinstance(value, dict) and all(_is_count(each) for each in value.values())


def _is_time(value: Any) -> bool:
    seconds = as_number(value)
    return seconds is not None and 0.0 <= seconds < math.inf


def _is_score(value: Any) -> bool:
    mean = value.get("mean") if isinstance(value, dict) else None
    return isinstance(value, dict) and (mean is None or as_number(mean) is not None)


def _are_evaluations(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(each, dict)
        and _is_count(each.get("steps"))
        and as_number((each.get("return") or {}).get("mean") if _is_score(each.get("return")) else None) is not None
        and all(key == "steps" or _is_score(score) for key, score in each.items())
        for each in value
    )


_KEPT: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "steps": ("a whole number of at least 0", _is_count),
    "seconds": ("a number of seconds", _is_time),
    "learning_seconds": ("a number of seconds", _is_time),
    "seeds_used": ("a whole number of at least 0", _is_count),
    "lessons": ("a whole number of at least 0", _is_count),
    "evaluations": ("a list of evaluations, each with steps and a mean return", _are_evaluations),
    "best_steps": ("null or a whole number of at least 0", lambda value: value is None or _is_count(value)),
    "counters": ("a mapping of names to whole numbers of at least 0", _are_counts),
    "finished": ("true or false", lambda value: isinstance(value, bool)),
}
"""What each field may be, in words and as a check."""


def read_progress(path: Path) -> Progress:
    """The progress that a checkpoint's ``progress.json`` says.

    Raises:
        CommandError: The file can't be read or says something else.
    """
    found = read_json(path)
    if not isinstance(found, dict):
        raise CommandError(f"{path} = {shown(found)} is not allowed; it must be a mapping with {', '.join(_KEPT)}.")
    # In an order that doesn't hang on the process, so that the same file gives the same error.
    for key in dict.fromkeys([*_KEPT, *found]):
        if key not in _KEPT:
            raise CommandError(f"{path} has {shown(key)}, which is not known; it must have {', '.join(_KEPT)} alone.")
        allowed, fits = _KEPT[key]
        if not fits(found.get(key)) or key not in found:
            raise CommandError(f"{path}: {key} = {shown(found.get(key))} is not allowed; it must be {allowed}.")
    progress = Progress(**found)
    if progress.best_steps is not None and progress.best is None:
        raise CommandError(f"{path}: best_steps = {progress.best_steps} is not allowed; it must be one of evaluations.")
    return progress
