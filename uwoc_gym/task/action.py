"""What an agent does: the names of its actions, and how they reach the AUV."""

from __future__ import annotations

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.records import rows

NAMES = ("surge force", "sway force", "yaw moment")
SIZE = len(NAMES)
"""Length of the action vector."""

STATE = rows("surge", "sway", "yaw")
"""The clipped action of the last control period."""


@inlined
def begin(b, j) -> None:
    """Nothing has been done yet."""
    b.action.surge[j] = 0.0
    b.action.sway[j] = 0.0
    b.action.yaw[j] = 0.0


@inlined
def take(b, j, numbers, first) -> None:
    """Take the lane's action from ``numbers[first:]``, clipped."""
    b.action.surge[j] = min(max(float(numbers[first]), -1.0), 1.0)
    b.action.sway[j] = min(max(float(numbers[first + 1]), -1.0), 1.0)
    b.action.yaw[j] = min(max(float(numbers[first + 2]), -1.0), 1.0)
