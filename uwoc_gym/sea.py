"""What pushes the AUV: force pulses and currents.

A pulse is a force of given start and length; in each integration step it acts with its mean over that step, so that
its impulse is exact wherever its edges fall. A current moves the water: damping and Coriolis terms see the velocity
relative to it (Fossen, "Handbook of Marine Craft Hydrodynamics and Motion Control", sec. 8.1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from uwoc_gym.block import (
    CURRENT_X,
    CURRENT_Y,
    EARTH_X,
    EARTH_Y,
    EPISODE,
    EXTRA_SURGE,
    EXTRA_SWAY,
    EXTRA_YAW,
    INVERSE_SURGE,
    INVERSE_SWAY,
    INVERSE_YAW,
    KEY_0,
    KEY_1,
    STEP,
    STRIDE,
    TIME,
)
from uwoc_gym.compiled import inlined
from uwoc_gym.elementary import exp, sincos
from uwoc_gym.parameters import Number, Parameters, child, choice, number
from uwoc_gym.rng import STREAM_CURRENT, draw, normal_pair

PULSE_PARAMETERS = 6
"""Numbers that a pulse hands to compiled code: start, duration, two forces, moment, 1 if fixed to the earth."""


@dataclass(frozen=True, kw_only=True)
class Pulse(Parameters):
    """A force and moment that act for a while: the paper's "current ocean forces" (Case I)."""

    start_s: Number = number(30.0, "s", "time at which the pulse begins", low=0.0, source="paper, Case I")
    duration_s: Number = number(1.0, "s", "length of the pulse", low=0.0, source="paper, Case I")
    force_x_n: Number = number(350.0, "N", "force along surge, or along x", source="paper, Case I")
    force_y_n: Number = number(350.0, "N", "force along sway, or along y", source="paper, Case I")
    moment_nm: Number = number(350.0, "N m", "yaw moment", source="paper, Case I")
    frame: str = choice(
        "body", ("body", "earth"), "frame in which the force is fixed; the paper adds it in the body frame"
    )

    def pulse_numbers(self) -> list[Number]:
        """The numbers, fixed or ranges, that the pulse hands to compiled code, in its order."""
        return [*(value for _, value in self.numbers()), 1.0 if self.frame == "earth" else 0.0]


@dataclass(frozen=True, kw_only=True)
class Current(Parameters):
    """A horizontal current: a constant velocity plus a slowly varying random one.

    The random part is a Gauss-Markov process in x and y, started from its stationary distribution and advanced by
    its exact discrete step once every control period.
    """

    speed_mps: Number = number(0.0, "m/s", "speed of the constant part", low=0.0)
    direction_rad: Number = number(0.0, "rad", "direction towards which the constant part flows")
    std_mps: Number = number(0.0, "m/s", "standard deviation of the random part on each axis", low=0.0)
    correlation_time_s: Number = number(60.0, "s", "correlation time of the random part", positive=True)


@dataclass(frozen=True, kw_only=True)
class Sea(Parameters):
    """All that pushes the AUV besides its own actuators."""

    pulses: tuple[Pulse, ...] = child((), (Pulse,), "force pulses, any number", many=True)
    current: Current = child(Current(), (Current,), "the current")


class DrawnPulse(NamedTuple):
    """When something pushes the AUV, and in words how hard."""

    begin_s: float
    end_s: float
    words: str


def drawn_pulses(parameters: Mapping[str, float]) -> list[DrawnPulse]:
    """The pulses of an episode, from what `TrackingEnv.parameters` says it has drawn."""
    found: list[DrawnPulse] = []
    while f"sea.pulses[{len(found)}].start_s" in parameters:
        own = f"sea.pulses[{len(found)}]."
        begin, duration = parameters[own + "start_s"], parameters[own + "duration_s"]
        x, y, moment = (parameters[own + name] for name in ("force_x_n", "force_y_n", "moment_nm"))
        found.append(DrawnPulse(begin, begin + duration, f"pulse: {x:.0f} N, {y:.0f} N, {moment:.0f} N m"))
    return found


@inlined
def mark_pulses(s, lanes, first, pulses, period) -> bool:
    """Whether a pulse touches the coming control period in any lane; clears the rows that pulses write."""
    touched = False
    for pulse in range(pulses):
        row = (first + pulse * PULSE_PARAMETERS) * STRIDE
        for j in range(lanes):
            start = s[j + row]
            t = s[j + TIME * STRIDE]
            touched |= (start < t + period) & (start + s[j + row + STRIDE] > t)
    if touched:
        for row in (EXTRA_SURGE, EXTRA_SWAY, EXTRA_YAW, EARTH_X, EARTH_Y):
            for j in range(lanes):
                s[j + row * STRIDE] = 0.0
    return touched


@inlined
def apply_pulses(s, lanes, first, pulses, offset, period, h) -> None:
    """Write the pulses' mean over the integration step that starts ``offset`` after the control period began."""
    for j in range(lanes):
        begin = s[j + TIME * STRIDE]
        t = begin + offset
        surge = sway = yaw = earth_x = earth_y = 0.0
        near = False
        for pulse in range(pulses):
            row = j + (first + pulse * PULSE_PARAMETERS) * STRIDE
            start = s[row]
            end = start + s[row + STRIDE]
            if start < begin + period and end > begin:
                near = True
                share = max(0.0, min(t + h, end) - max(t, start)) / h
                x = share * s[row + 2 * STRIDE]
                y = share * s[row + 3 * STRIDE]
                yaw += share * s[row + 4 * STRIDE]
                if s[row + 5 * STRIDE] > 0.0:
                    earth_x += x
                    earth_y += y
                else:
                    surge += x
                    sway += y
        if near:
            s[j + EXTRA_SURGE * STRIDE] = surge * s[j + INVERSE_SURGE * STRIDE]
            s[j + EXTRA_SWAY * STRIDE] = sway * s[j + INVERSE_SWAY * STRIDE]
            s[j + EXTRA_YAW * STRIDE] = yaw * s[j + INVERSE_YAW * STRIDE]
            s[j + EARTH_X * STRIDE] = earth_x
            s[j + EARTH_Y * STRIDE] = earth_y


@inlined
def begin_current(s, j, first) -> None:
    """Draw the current of lane ``j`` from its stationary distribution."""
    p = j + first * STRIDE
    sine, cosine = sincos(s[p + STRIDE])
    u0, u1, _, _ = draw(s[j + KEY_0 * STRIDE], s[j + KEY_1 * STRIDE], s[j + EPISODE * STRIDE], STREAM_CURRENT, 0.0, 0)
    n0, n1 = normal_pair(u0, u1)
    s[j + CURRENT_X * STRIDE] = s[p] * cosine + s[p + 2 * STRIDE] * n0
    s[j + CURRENT_Y * STRIDE] = s[p] * sine + s[p + 2 * STRIDE] * n1


@inlined
def advance_current(s, lanes, first, period) -> None:
    """Advance the random part of the current by one control period, from each lane's step count."""
    for j in range(lanes):
        p = j + first * STRIDE
        sine, cosine = sincos(s[p + STRIDE])
        mean_x = s[p] * cosine
        mean_y = s[p] * sine
        keep = exp(-period / s[p + 3 * STRIDE])
        fresh = s[p + 2 * STRIDE] * math.sqrt(1.0 - keep * keep)
        u0, u1, _, _ = draw(
            s[j + KEY_0 * STRIDE],
            s[j + KEY_1 * STRIDE],
            s[j + EPISODE * STRIDE],
            STREAM_CURRENT,
            s[j + STEP * STRIDE],
            0,
        )
        n0, n1 = normal_pair(u0, u1)
        s[j + CURRENT_X * STRIDE] = mean_x + keep * (s[j + CURRENT_X * STRIDE] - mean_x) + fresh * n0
        s[j + CURRENT_Y * STRIDE] = mean_y + keep * (s[j + CURRENT_Y * STRIDE] - mean_y) + fresh * n1
