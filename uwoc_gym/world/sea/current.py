"""A horizontal current that carries the AUV: a constant velocity plus a Gauss-Markov process in x and y."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.elementary import exp, sincos
from uwoc_gym.compute.records import rows
from uwoc_gym.compute.rng import draw, normal_pair
from uwoc_gym.parameters import ANY_ANGLE, Number, Parameters, number

STREAM = 3.0
STATE = rows("x", "y")
"""Velocity of the water in the earth frame [m/s]."""


@dataclass(frozen=True, kw_only=True)
class Current(Parameters):
    """A horizontal current: a constant velocity plus a slowly varying random one.

    The random part is a Gauss-Markov process in x and y, started from its stationary distribution and advanced by
    its exact discrete step once every control period.
    """

    speed_mps: Number = number(0.0, "m/s", "speed of the constant part", low=0.0, high=5.0)
    direction_rad: Number = number(
        0.0, "rad", "direction towards which the constant part flows", low=-ANY_ANGLE, high=ANY_ANGLE
    )
    std_mps: Number = number(0.0, "m/s", "standard deviation of the random part on each axis", low=0.0, high=2.0)
    correlation_time_s: Number = number(60.0, "s", "correlation time of the random part", low=0.01, high=1e6)

    @property
    def fastest_mps(self) -> float:
        """A speed [m/s] that it exceeds in one of 3000 moments at most: the constant part and four deviations."""
        return float(np.max(self.speed_mps) + 4.0 * np.max(self.std_mps))

    @property
    def random(self) -> bool:
        """Whether any episode can have the random part."""
        return bool(np.max(self.std_mps) > 0.0)

    def derived(self) -> dict[str, float]:
        """Whether any episode can have a current."""
        return {"acts": np.max(self.speed_mps) > 0.0 or self.random}


@inlined
def begin(b, j, world) -> None:
    """Draw the current from its stationary distribution."""
    p = b.drawn.current
    sine, cosine = sincos(p.direction_rad[j])
    u0, u1, _, _ = draw(b, j, STREAM, 0.0, 0.0)
    n0, n1 = normal_pair(u0, u1)
    b.current.x[j] = p.speed_mps[j] * cosine + p.std_mps[j] * n0
    b.current.y[j] = p.speed_mps[j] * sine + p.std_mps[j] * n1


@inlined
def flow(b, j, world) -> None:
    """The current is the same wherever the AUV is."""
    b.water.x[j] += b.current.x[j]
    b.water.y[j] += b.current.y[j]


@inlined
def advance(b, j, world) -> None:
    """Advance the random part by one control period, exactly."""
    p = b.drawn.current
    sine, cosine = sincos(p.direction_rad[j])
    mean_x = p.speed_mps[j] * cosine
    mean_y = p.speed_mps[j] * sine
    keep = exp(-world.episode.control_period_s / p.correlation_time_s[j])
    fresh = p.std_mps[j] * math.sqrt(1.0 - keep * keep)
    u0, u1, _, _ = draw(b, j, STREAM, b.clock.step[j], 0.0)
    n0, n1 = normal_pair(u0, u1)
    b.current.x[j] = mean_x + keep * (b.current.x[j] - mean_x) + fresh * n0
    b.current.y[j] = mean_y + keep * (b.current.y[j] - mean_y) + fresh * n1
