"""How fast the AUV becomes and how fast its motion changes, which an integration step has to follow.

Taken over all numbers that an episode may draw. An axis is as fast as the force along it drives it against its own
damping, or as it can become in the time that there is; what the Coriolis terms carry over from the other axes is left
out, for which `uwoc_gym.task.ending.RATE_TIMES_STEP` leaves room. The rate is a bound of the norm of the equation of
motion's Jacobian at these velocities, in coordinates scaled by the square roots of the masses, where the Coriolis terms
are nearly skew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.parameters import Number
from uwoc_gym.world.auv.horizontal import Vehicle

Array = npt.NDArray[np.float64]

_AXES = ("surge", "sway", "yaw")


class _Ends(NamedTuple):
    """Lowest and highest values that an episode may draw, for the three axes."""

    low: Array
    high: Array


def _ends(*values: Number) -> _Ends:
    return _Ends(*(np.array([pick(value) for value in values], dtype=float) for pick in (np.min, np.max)))


class Motion:
    """Bounds of an AUV's motion through the water.

    Args:
        vehicle: The AUV.
        force: The most that acts on each axis, shape (3,) [N, N, N m].
        start: The fastest that it begins, shape (3,) [m/s, m/s, rad/s].
        duration_s: How long it flies [s].
    """

    def __init__(self, vehicle: Vehicle, force: Array, start: Array, duration_s: float) -> None:
        self._coriolis = vehicle.coriolis
        # All axes have the same scale, so that ratios of masses don't depend on it.
        self._mass = _ends(vehicle.mass_surge_kg, vehicle.mass_sway_kg, vehicle.inertia_yaw_kg_m2)
        self._lightest = self._mass.low * _ends(vehicle.mass_scale).low
        scale = _ends(vehicle.damping_scale)
        linear, quadratic = (
            _ends(*(getattr(vehicle, f"{kind}_damping_{axis}") for axis in _AXES)) for kind in ("linear", "quadratic")
        )
        self._linear, self._quadratic = linear.high * scale.high, quadratic.high * scale.high
        with np.errstate(divide="ignore", invalid="ignore"):
            reached, damped = (
                np.maximum(start, np.fmin(_terminal(force, *own), start + duration_s * force / self._lightest))
                for own in ((linear.low * scale.low, quadratic.low * scale.low), (self._linear, self._quadratic))
            )
        self.velocity: Array = reached
        """The fastest that each axis becomes, shape (3,) [m/s, m/s, rad/s]."""
        self.rate = self._rate(reached, damped)
        """How fast the motion changes at most [1/s]."""

    def rate_at(self, velocity: npt.ArrayLike) -> float:
        """How fast the motion changes at a velocity through the water, shape (3,) [m/s, m/s, rad/s] [1/s]."""
        own = np.abs(np.asarray(velocity, dtype=float))
        return self._rate(own, own)

    def _rate(self, velocity: Array, damped: Array) -> float:
        """The rate at velocities of the least and the most damping; strong damping is fastest where the AUV is slow."""
        damping = ((self._linear + 2.0 * self._quadratic * damped) / self._lightest).max()
        u, v, r = velocity
        turning = 0.0
        if self._coriolis:
            (m1, m2, m3), (n1, n2, _) = self._mass
            apart = max(abs(n1 - m2), abs(n2 - m1))
            turning = max(
                np.sqrt(n2 / m1) * r + n2 / np.sqrt(m1 * m3) * v,
                np.sqrt(n1 / m2) * r + n1 / np.sqrt(m2 * m3) * u,
                apart / np.sqrt(m1 * m3) * v + apart / np.sqrt(m2 * m3) * u,
            )
        # The heading turns with the yaw rate even where nothing couples to it.
        return float(max(damping + turning, r))


def _terminal(force: Array, linear: Array, quadratic: Array) -> Array:
    """Speed at which damping balances a force, shape (3,); infinite or not a number without damping."""
    return 2.0 * force / (linear + np.sqrt(linear * linear + 4.0 * quadratic * force))
