"""The AUV's state at time 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.parameters import ANY_ANGLE, FARTHEST_M, Number, Parameters, flag, number


@dataclass(frozen=True, kw_only=True)
class Start(Parameters):
    """The AUV's state at time 0: in the earth frame, or as offsets from the ship's position and heading."""

    x_m: Number = number(5.0, "m", "x", low=-FARTHEST_M, high=FARTHEST_M, source="paper, sec. 4")
    y_m: Number = number(5.0, "m", "y", low=-FARTHEST_M, high=FARTHEST_M, source="paper, sec. 4")
    yaw_rad: Number = number(0.0, "rad", "yaw", low=-ANY_ANGLE, high=ANY_ANGLE, source="paper, sec. 4")
    surge_mps: Number = number(0.0, "m/s", "surge velocity", low=-20.0, high=20.0, source="paper, sec. 4: at rest")
    sway_mps: Number = number(0.0, "m/s", "sway velocity", low=-20.0, high=20.0, source="paper, sec. 4: at rest")
    yaw_rate_rad_s: Number = number(0.0, "rad/s", "yaw rate", low=-10.0, high=10.0, source="paper, sec. 4: at rest")
    relative_to_ship: bool = flag(False, "x, y (along the earth's axes) and yaw are offsets from the ship's")

    @property
    def fastest(self) -> npt.NDArray[np.float64]:
        """The largest surge, sway and yaw rate, shape (3,) [m/s, m/s, rad/s]."""
        return np.array([np.abs(value).max() for value in (self.surge_mps, self.sway_mps, self.yaw_rate_rad_s)])


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
