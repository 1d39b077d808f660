"""How fast the AUV becomes and how fast its motion changes, which an integration step has to follow.

Taken over all numbers that an episode may draw. An axis is as fast as what acts along it drives it against its own
damping, or as it can become in the time that there is. To the forces belong the Coriolis terms at the velocities that
the forces alone lead to; these terms are carried no further, for which `RATE_TIMES_STEP` leaves room. The rate is a
bound of the Jacobian of the equation of motion at these velocities, its largest sum of a row, in coordinates scaled by
the square roots of the masses, where the Coriolis terms are nearly skew.

A step may be as long as both limits below allow; docs/trust.md says how far flights are from those with shorter steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.parameters import Number
from uwoc_gym.world.auv.horizontal import Vehicle

Array = npt.NDArray[np.float64]

RATE_TIMES_STEP = 1.45
"""Largest rate of change times integration step: RK4 is unstable from about 2.6 on, and wrong long before."""

SUM_OF_ERRORS = 2.6
"""Largest sum of the errors of steps that haven't been damped away.

Each is (rate times step)⁵ / 120, the first term that RK4 lacks (Hairer, Nørsett and Wanner, "Solving Ordinary
Differential Equations I", sec. II.1). The true sum is far smaller, since the rate is seldom reached: the paper's
vehicle has 2.6 at a step of 0.05 s, and is 0.1 % off."""

_AXES = ("surge", "sway", "yaw")


class _Ends(NamedTuple):
    """Lowest and highest values that an episode may draw, for the three axes."""

    low: Array
    high: Array


def _ends(*values: Number) -> _Ends:
    return _Ends(*(np.array([pick(value) for value in values], dtype=float) for pick in (np.min, np.max)))


class Motion:
    """Estimates of how fast an AUV moves through the water, and how fast that changes, at most.

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
        self._scale = _ends(vehicle.mass_scale)
        self._lightest = self._mass.low * self._scale.low
        (m1, m2, _), (n1, n2, _) = self._mass
        self._apart = max(abs(n1 - m2), abs(n2 - m1)) * self._scale.high[0]
        scale = _ends(vehicle.damping_scale)
        linear, quadratic = (
            _ends(*(getattr(vehicle, f"{kind}_damping_{axis}") for axis in _AXES)) for kind in ("linear", "quadratic")
        )
        self._linear, self._quadratic = linear.high * scale.high, quadratic.high * scale.high
        dampings = (linear.low * scale.low, quadratic.low * scale.low), (self._linear, self._quadratic)
        with np.errstate(divide="ignore"):
            self._memory_s = min(duration_s, (self._mass.high * self._scale.high / dampings[0][0]).max())
        reached, damped = (self._reached(force, start, duration_s, *own) for own in dampings)
        self.velocity: Array = reached
        """The fastest that each axis becomes, shape (3,) [m/s, m/s, rad/s]."""
        self.rate = self._rate(reached, damped)
        """How fast the motion changes at most [1/s]."""

    def rate_at(self, velocity: npt.ArrayLike) -> float:
        """How fast the motion changes at a velocity through the water, shape (3,) [m/s, m/s, rad/s] [1/s]."""
        own = np.abs(np.asarray(velocity, dtype=float))
        return self._rate(own, own)

    def longest_step(self, rate: float) -> float:
        """The longest integration step [s] that follows a motion of that rate [1/s]."""
        if not rate > 0.0:
            return np.inf
        kept = 120.0 * SUM_OF_ERRORS / (rate * self._memory_s)
        return float(min(RATE_TIMES_STEP, kept**0.25) / rate)

    def _reached(self, force: Array, start: Array, duration_s: float, linear: Array, quadratic: Array) -> Array:
        """The fastest that each axis becomes with these dampings."""

        def driven(force: Array) -> Array:
            with np.errstate(divide="ignore", invalid="ignore"):
                terminal = 2.0 * force / (linear + np.sqrt(linear * linear + 4.0 * quadratic * force))
            # Without damping there is no terminal speed.
            return np.maximum(start, np.fmin(terminal, start + duration_s * force / self._lightest))

        alone = driven(force)
        if not self._coriolis:
            return alone
        u, v, r = alone
        heavy = self._mass.high * self._scale.high
        carried = driven(force + np.array([heavy[1] * v * r, heavy[0] * u * r, self._apart * u * v]))
        # They add no energy.
        most: Array = np.sqrt((self._mass.high * alone**2).sum() / self._mass.low)
        return np.fmin(carried, most)

    def _rate(self, velocity: Array, damped: Array) -> float:
        """The rate at velocities of the least and the most damping; strong damping is fastest where the AUV is slow."""
        damping = (self._linear + 2.0 * self._quadratic * damped) / self._lightest
        u, v, r = velocity
        (m1, m2, m3), (n1, n2, _) = self._mass
        apart = self._apart / self._scale.high[0]
        turning = np.array(
            [
                np.sqrt(n2 / m1) * r + n2 / np.sqrt(m1 * m3) * v,
                np.sqrt(n1 / m2) * r + n1 / np.sqrt(m2 * m3) * u,
                apart / np.sqrt(m1 * m3) * v + apart / np.sqrt(m2 * m3) * u,
            ]
        )
        # The heading turns with the yaw rate, and its errors add up over all turns.
        return float(max((damping + self._coriolis * turning).max(), 3.0 * r))
