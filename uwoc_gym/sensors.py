"""Measurement noise on the AUV's pose and velocity: the true state drives the physics, policies see the noisy one."""

from __future__ import annotations

from dataclasses import dataclass

from uwoc_gym.block import (
    EPISODE,
    ERROR_SURGE,
    ERROR_SWAY,
    ERROR_X,
    ERROR_Y,
    ERROR_YAW,
    ERROR_YAW_RATE,
    KEY_0,
    KEY_1,
    STEP,
    STRIDE,
)
from uwoc_gym.compiled import inlined
from uwoc_gym.parameters import Number, Parameters, number
from uwoc_gym.rng import STREAM_SENSORS, draw, normal_pair

UNKNOWN = "the paper gives no noise level"


@dataclass(frozen=True, kw_only=True)
class Sensors(Parameters):
    """Standard deviations of white Gaussian noise, drawn anew at every observation."""

    position_std_m: Number = number(0.0, "m", "x and y", low=0.0, source=UNKNOWN)
    yaw_std_rad: Number = number(0.0, "rad", "yaw", low=0.0, source=UNKNOWN)
    velocity_std_mps: Number = number(0.0, "m/s", "surge and sway velocity", low=0.0, source=UNKNOWN)
    yaw_rate_std_rad_s: Number = number(0.0, "rad/s", "yaw rate", low=0.0, source=UNKNOWN)


@inlined
def measure_errors(s, lanes, first) -> None:
    """Draw the measurement errors of each lane's present step."""
    for j in range(lanes):
        key_0 = s[j + KEY_0 * STRIDE]
        key_1 = s[j + KEY_1 * STRIDE]
        episode = s[j + EPISODE * STRIDE]
        step = s[j + STEP * STRIDE]
        u0, u1, u2, u3 = draw(key_0, key_1, episode, STREAM_SENSORS, step, 0)
        u4, u5, _, _ = draw(key_0, key_1, episode, STREAM_SENSORS, step, 1)
        n0, n1 = normal_pair(u0, u1)
        n2, n3 = normal_pair(u2, u3)
        n4, n5 = normal_pair(u4, u5)
        p = j + first * STRIDE
        position = s[p]
        velocity = s[p + 2 * STRIDE]
        s[j + ERROR_X * STRIDE] = position * n0
        s[j + ERROR_Y * STRIDE] = position * n1
        s[j + ERROR_YAW * STRIDE] = s[p + STRIDE] * n2
        s[j + ERROR_SURGE * STRIDE] = velocity * n3
        s[j + ERROR_SWAY * STRIDE] = velocity * n4
        s[j + ERROR_YAW_RATE * STRIDE] = s[p + 3 * STRIDE] * n5
