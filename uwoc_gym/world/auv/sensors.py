"""Measurement noise on the AUV's pose and velocity: the true state drives the physics, policies see the noisy one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.elementary import fma, sincos
from uwoc_gym.compute.records import rows
from uwoc_gym.compute.rng import draw, normal_pair
from uwoc_gym.parameters import Number, Parameters, number

STREAM = 4.0
STATE = rows("cos", "sin", "error_x", "error_y", "error_yaw", "error_surge", "error_sway", "error_yaw_rate")
"""Cosine and sine of the measured heading; errors of the measured pose [m, m, rad] and velocity [m/s, m/s, rad/s]."""

UNKNOWN = "the paper gives no noise level"


@dataclass(frozen=True, kw_only=True)
class Sensors(Parameters):
    """Standard deviations of white Gaussian noise, drawn anew at every observation."""

    position_std_m: Number = number(0.0, "m", "x and y", low=0.0, high=100.0, source=UNKNOWN)
    yaw_std_rad: Number = number(0.0, "rad", "yaw", low=0.0, high=3.2, source=UNKNOWN)
    velocity_std_mps: Number = number(0.0, "m/s", "surge and sway velocity", low=0.0, high=10.0, source=UNKNOWN)
    yaw_rate_std_rad_s: Number = number(0.0, "rad/s", "yaw rate", low=0.0, high=10.0, source=UNKNOWN)

    @property
    def random(self) -> bool:
        """Whether any episode can have noise."""
        return any(np.max(value) > 0.0 for _, value in self.numbers())

    def derived(self) -> dict[str, float]:
        """Noise, without which nothing acts."""
        return {"acts": self.random}


@inlined
def begin(b, j, world) -> None:
    """Without noise nothing below is called, so that errors stay as they begin."""
    o = b.sensors
    o.error_x[j] = o.error_y[j] = o.error_yaw[j] = 0.0
    o.error_surge[j] = o.error_sway[j] = o.error_yaw_rate[j] = 0.0


@inlined
def see_exactly(b, j) -> None:
    """The heading as it is."""
    b.sensors.cos[j] = b.auv.cos[j]
    b.sensors.sin[j] = b.auv.sin[j]


@inlined
def see(b, j) -> None:
    """Draw the errors of the present step, and turn the heading by that of yaw."""
    step = b.clock.step[j]
    u0, u1, u2, u3 = draw(b, j, STREAM, step, 0.0)
    u4, u5, _, _ = draw(b, j, STREAM, step, 1.0)
    n0, n1 = normal_pair(u0, u1)
    n2, n3 = normal_pair(u2, u3)
    n4, n5 = normal_pair(u4, u5)
    p = b.drawn.sensors
    o = b.sensors
    yaw = p.yaw_std_rad[j] * n2
    o.error_x[j] = p.position_std_m[j] * n0
    o.error_y[j] = p.position_std_m[j] * n1
    o.error_yaw[j] = yaw
    o.error_surge[j] = p.velocity_std_mps[j] * n3
    o.error_sway[j] = p.velocity_std_mps[j] * n4
    o.error_yaw_rate[j] = p.yaw_rate_std_rad_s[j] * n5
    es, ec = sincos(yaw)
    cosine = b.auv.cos[j]
    sine = b.auv.sin[j]
    o.cos[j] = fma(cosine, ec, -(sine * es))
    o.sin[j] = fma(sine, ec, cosine * es)
