"""The AUV's state at time 0."""

from __future__ import annotations

from dataclasses import dataclass

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.parameters import Number, Parameters, flag, number


@dataclass(frozen=True, kw_only=True)
class Start(Parameters):
    """The AUV's state at time 0: in the earth frame, or as offsets from the ship's position and heading."""

    x_m: Number = number(5.0, "m", "x", source="paper, sec. 4")
    y_m: Number = number(5.0, "m", "y", source="paper, sec. 4")
    yaw_rad: Number = number(0.0, "rad", "yaw", source="paper, sec. 4")
    surge_mps: Number = number(0.0, "m/s", "surge velocity", source="paper, sec. 4: at rest")
    sway_mps: Number = number(0.0, "m/s", "sway velocity", source="paper, sec. 4: at rest")
    yaw_rate_rad_s: Number = number(0.0, "rad/s", "yaw rate", source="paper, sec. 4: at rest")
    relative_to_ship: bool = flag(False, "x, y (along the earth's axes) and yaw are offsets from the ship's")


@inlined
def begin(b, j, world) -> None:
    """Put the AUV where the lane has drawn; the ship is at its own start already."""
    p = b.drawn.start
    relative = world.start.relative_to_ship
    b.auv.x[j] = p.x_m[j] + relative * b.ship.x[j]
    b.auv.y[j] = p.y_m[j] + relative * b.ship.y[j]
    b.auv.yaw[j] = p.yaw_rad[j] + relative * b.ship.yaw[j]
    b.auv.surge[j] = p.surge_mps[j]
    b.auv.sway[j] = p.sway_mps[j]
    b.auv.yaw_rate[j] = p.yaw_rate_rad_s[j]
