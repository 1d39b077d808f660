"""What an agent does: the kinds of action that a scenario chooses from, and how they reach the AUV."""

from __future__ import annotations

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.records import rows

KINDS: dict[str, tuple[str, ...]] = {
    "wrench": ("surge force", "sway force", "yaw moment"),
    "surge-yaw": ("surge force", "yaw moment"),
}
"""The names of each kind's actions, which are shares of the actuators' limits in [-1, 1]."""

WRENCH, SURGE_YAW = (float(place) for place in range(len(KINDS)))

AXES = {"wrench": (0, 1, 2), "surge-yaw": (0, 2)}
"""The axes, of surge, sway and yaw, that each kind's actions act on."""

WIDTHS = tuple(len(names) for names in KINDS.values())

STATE = rows("surge", "sway", "yaw")
"""The clipped action of the last control period; 0 where the kind or the AUV has none."""


@inlined
def begin(b, j) -> None:
    """Nothing has been done yet."""
    b.action.surge[j] = 0.0
    b.action.sway[j] = 0.0
    b.action.yaw[j] = 0.0


@inlined
def _clipped(number):
    return min(max(float(number), -1.0), 1.0)


@inlined
def take_wrench(b, j, numbers, place, world) -> None:
    """Take three numbers from the ``place``-th three on; those of actuators without force say nothing."""
    can = world.vehicle
    b.action.surge[j] = can.surges * _clipped(numbers[3 * place])
    b.action.sway[j] = can.sways * _clipped(numbers[3 * place + 1])
    b.action.yaw[j] = can.yaws * _clipped(numbers[3 * place + 2])


@inlined
def take_surge_yaw(b, j, numbers, place, world) -> None:
    """Take two numbers; there is no force to the side."""
    can = world.vehicle
    b.action.surge[j] = can.surges * _clipped(numbers[2 * place])
    b.action.sway[j] = 0.0
    b.action.yaw[j] = can.yaws * _clipped(numbers[2 * place + 1])
