"""Force pulses of given start and length, any number of them in an episode.

In each integration step a pulse acts with its mean over that step, so that its impulse is exact wherever its edges
fall.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.records import block_type, record_at, rows
from uwoc_gym.parameters import Number, Parameters, choice, number


@dataclass(frozen=True, kw_only=True)
class Pulse(Parameters):
    """A force and moment that act for a while: the paper's "current ocean forces" (Case I)."""

    start_s: Number = number(30.0, "s", "time at which the pulse begins", low=0.0, high=1e6, source="paper, Case I")
    duration_s: Number = number(1.0, "s", "length of the pulse", low=0.0, high=1e6, source="paper, Case I")
    force_x_n: Number = number(350.0, "N", "force along surge, or along x", low=-1e5, high=1e5, source="paper, Case I")
    force_y_n: Number = number(350.0, "N", "force along sway, or along y", low=-1e5, high=1e5, source="paper, Case I")
    moment_nm: Number = number(350.0, "N m", "yaw moment", low=-1e5, high=1e5, source="paper, Case I")
    frame: str = choice(
        "body", ("body", "earth"), "frame in which the force is fixed; the paper adds it in the body frame"
    )

    @property
    def strongest(self) -> npt.NDArray[np.float64]:
        """The most that it adds along surge, sway and about yaw, shape (3,) [N, N, N m]; one fixed in the earth frame
        can point along either axis."""
        x, y, moment = (np.abs(value).max() for value in (self.force_x_n, self.force_y_n, self.moment_nm))
        if "earth" in self.frame:
            x = y = np.hypot(x, y)
        return np.array([x, y, moment])


ROWS = rows(*Pulse.drawn())
PULSE = block_type(ROWS)
"""The record of what a block's lanes have drawn for one pulse."""
DOUBLES = PULSE.itemsize // 8


class DrawnPulse(NamedTuple):
    """When something pushes the AUV, and in words how hard."""

    begin_s: float
    end_s: float
    words: str


def drawn_pulses(parameters: Mapping[str, float]) -> list[DrawnPulse]:
    """The pulses of an episode, from what `TrackingEnv.parameters` says it has drawn."""
    found: list[DrawnPulse] = []
    for i, (begin, end) in enumerate(pulse_times(parameters)):
        x, y, moment = (parameters[f"sea.pulses[{i}].{name}"] for name in ("force_x_n", "force_y_n", "moment_nm"))
        found.append(DrawnPulse(begin, end, f"pulse: {x:.0f} N, {y:.0f} N, {moment:.0f} N m"))
    return found


def pulse_times(parameters: Mapping[str, Any]) -> list[tuple[Any, Any]]:
    """Beginning and end of each pulse [s], of one episode or, as arrays, of several; see `drawn_pulses`."""
    found: list[tuple[Any, Any]] = []
    while f"sea.pulses[{len(found)}].start_s" in parameters:
        begin, duration = (parameters[f"sea.pulses[{len(found)}].{name}"] for name in ("start_s", "duration_s"))
        found.append((begin, begin + duration))
    return found


@inlined
def touches(b, j, pulse, world):
    """Whether the pulse acts at any time of the coming control period."""
    start = pulse.start_s[j]
    t = b.clock.time_s[j]
    return (start < t + world.episode.control_period_s) & (start + pulse.duration_s[j] > t)


@inlined
def push(b, j, numbers, first, last, offset_s, h, world) -> None:
    """Add the mean of all pulses over the step of ``h`` seconds that begins ``offset_s`` into the control period.

    The pulses stand in ``numbers`` from the place ``first`` to ``last``.
    """
    begin = b.clock.time_s[j]
    t = begin + offset_s
    surge = sway = yaw = earth_x = earth_y = 0.0
    for place in range(first, last, DOUBLES):
        pulse = record_at(numbers, place, PULSE)
        start = pulse.start_s[j]
        end = start + pulse.duration_s[j]
        if start < begin + world.episode.control_period_s and end > begin:
            share = max(0.0, min(t + h, end) - max(t, start)) / h
            x = share * pulse.force_x_n[j]
            y = share * pulse.force_y_n[j]
            yaw += share * pulse.moment_nm[j]
            if pulse.frame[j] > 0.0:
                earth_x += x
                earth_y += y
            else:
                surge += x
                sway += y
    b.wrench.surge[j] += surge
    b.wrench.sway[j] += sway
    b.wrench.yaw[j] += yaw
    b.wrench.x[j] += earth_x
    b.wrench.y[j] += earth_y
