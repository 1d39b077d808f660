"""Numbers that a law or a filter is set by."""

from __future__ import annotations

from typing import Any

from uwoc_gym.parameters import number


def fixed(default: float, unit: str, description: str, low: float, high: float) -> Any:
    """A setting that no episode draws and that the project has chosen."""
    return number(default, unit, description, low=low, high=high, randomisable=False, source="project default")
