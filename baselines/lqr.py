"""A linear-quadratic regulator over the known model, scheduled over the speed through the water.

The errors are the ship's place ahead and to starboard, the heading's, and those of the three velocities. Linear about a
hull that makes way with surge velocity u, with the slope A(u) of the nominal model's acceleration,

    ṗ_x = ẽ_u,   ṗ_y = ẽ_v + u ψ̃,   ψ̃˙ = ẽ_r,   ẽ˙ = A(u) ẽ − M⁻¹ τ,

so that the regulator knows the moment that a hull pushed askew makes. The weights follow Bryson's rule: an error of its
scale weighs as much as an actuator at its limit. See Anderson and Moore, "Optimal Control: Linear Quadratic Methods",
sec. 3.2, and Bryson and Ho, "Applied Optimal Control", sec. 5.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.law import Law, Tracker, several
from uwoc_gym.baselines.numbers import fixed
from uwoc_gym.baselines.observers import wrapped
from uwoc_gym.given import SettingError, shown
from uwoc_gym.parameters import Parameters
from uwoc_gym.scenario import Scenario
from uwoc_gym.world.auv.horizontal import Vehicle

Array = npt.NDArray[np.float64]

_SPEEDS = np.linspace(-3.0, 3.0, 25)
"""Surge velocities of the schedule [m/s]."""

_SLOWEST_MPS = 0.25
"""Surge velocity below which a hull without sway force can't be steered to the side."""


@dataclass(frozen=True, kw_only=True)
class RegulatorScales(Parameters):
    """Errors that weigh as much as an actuator at its limit, and how far errors count."""

    place_m: float = fixed(0.3, "m", "error of the place", 1e-3, 1e3)
    heading_rad: float = fixed(0.1, "rad", "error of the heading", 1e-3, 1e3)
    speed_mps: float = fixed(4.5, "m/s", "error of surge and sway velocity", 1e-3, 1e3)
    yaw_rate_rad_s: float = fixed(8.0, "rad/s", "error of the yaw rate", 1e-3, 1e3)
    reach_m: float = fixed(
        8.0, "m", "distance beyond which the ship counts as nearer, so that actuators keep up", 0.01, 1e3
    )
    course: float = fixed(
        0.0, "1", "share of the way from the ship's heading to the course through the water", 0.0, 1.0
    )


class Regulator(Law):
    """The regulator, batched over observations.

    Args:
        scales: The scales, or a sequence of N of them, one for each of N observations.
        scenario: As in `Law`.
        filtered: As in `Law`.

    Raises:
        SettingError: As in `Law`, or ``scales`` is something else.
    """

    def __init__(
        self,
        scales: RegulatorScales | Sequence[RegulatorScales] = RegulatorScales(),
        scenario: str | Scenario = "Nominal",
        filtered: bool | Tracker = False,
    ) -> None:
        given = several(scales)
        if not given or not all(isinstance(each, RegulatorScales) for each in given):
            raise SettingError(
                f"scales = {shown(scales)} is not allowed; it must be RegulatorScales, or several of them."
            )
        super().__init__(scenario, filtered, dict.fromkeys(("ship", "velocity", "ship-acceleration"), ""))
        kinds = list(dict.fromkeys(given))
        self._gains = np.stack([schedule(self.vehicle, self._axes, each) for each in kinds])
        axis: Any = 0 if given is not scales else slice(None)
        self._kind = np.array([kinds.index(each) for each in given])[axis]
        self._reach, self._course = (
            np.array([getattr(each, name) for each in given])[axis] for name in ("reach_m", "course")
        )

    def force_for(self, seen: Any) -> Array:
        """See `Law.force_for`."""
        place, own = seen.relative_position, seen.velocity
        water = np.zeros_like(own)
        if seen.water_velocity is not None:
            water[..., :2] = seen.water_velocity
        through, ship = own - water, own + seen.relative_velocity - water
        nearer = np.minimum(1.0, self._reach / np.maximum(np.hypot(place[..., 0], place[..., 1]), 1e-9))
        aside = np.arctan2(ship[..., 1], ship[..., 0])
        heading = seen.yaw_error + self._course * wrapped(aside - seen.yaw_error)
        error = np.concatenate([place * nearer[..., None], heading[..., None], seen.relative_velocity], axis=-1)
        at = np.clip((through[..., 0] - _SPEEDS[0]) / (_SPEEDS[1] - _SPEEDS[0]), 0.0, _SPEEDS.size - 1.0)
        low = np.minimum(at.astype(int), _SPEEDS.size - 2)
        part = (at - low)[..., None, None]
        gain = (1.0 - part) * self._gains[self._kind, low] + part * self._gains[self._kind, low + 1]
        found: Array = self.feedforward(seen) + (gain @ error[..., None])[..., 0]
        return found


def schedule(vehicle: Vehicle, axes: Sequence[int], scales: RegulatorScales) -> Array:
    """The regulator's gains at each speed of the schedule, (speeds, 3, 6): the force for the six errors.

    Args:
        vehicle: The nominal model.
        axes: The axes that actions act on.
        scales: The weights.
    """
    limits = vehicle.force_limits
    moved = [axis for axis in axes if limits[axis] > 0.0]
    s = scales
    weights = np.diag(
        1.0 / np.square([s.place_m, s.place_m, s.heading_rad, s.speed_mps, s.speed_mps, s.yaw_rate_rad_s])
    )
    push = np.zeros((6, len(moved)))
    push[3:] = (np.diag(limits / vehicle.inertia))[:, moved]
    found = np.zeros((_SPEEDS.size, 3, 6))
    for i, speed in enumerate(_SPEEDS):
        u = speed if 1 in moved else np.copysign(max(abs(speed), _SLOWEST_MPS), speed)
        change = np.zeros((6, 6))
        change[:3, 3:] = np.eye(3)
        change[1, 2] = u
        change[3:, 3:] = vehicle.velocity_slope([u, 0.0, 0.0])
        found[i, moved] = limits[moved, None] * optimal(change, push, weights)
    return found


def optimal(change: Array, push: Array, weights: Array) -> Array:
    """The gain K that makes u = K x cost least, with ẋ = A x − B u and the cost ∫ xᵀ Q x + uᵀ u."""
    from scipy.linalg import solve_continuous_are

    found: Array = push.T @ solve_continuous_are(change, push, weights, np.eye(push.shape[1]))
    return found
