"""Time in an episode, and when it is over: lost beyond recovery, or at the end of its time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.records import rows
from uwoc_gym.parameters import Parameters, SettingError, number

STATE = rows("last_outside", "ended", "was_ended", "diverged")
"""Step at which the AUV was last outside the cone; whether the episode is over, and was before the present step;
whether the last step has diverged, which a new episode that begins in it doesn't forget."""

OUTCOME = rows("is_success", "reward", "terminated", "truncated")


@dataclass(frozen=True, kw_only=True)
class EpisodeSettings(Parameters):
    """Time grid and end of an episode."""

    duration_s: float = number(150.0, "s", "length", low=0.001, high=1e6, randomisable=False, source="paper, sec. 4")
    control_period_s: float = number(
        0.05,
        "s",
        "time between actions",
        low=1e-4,
        high=60.0,
        randomisable=False,
        source="20 Hz; the paper's runs use 0.005 s",
    )
    integration_step_s: float = number(
        0.005, "s", "step of the RK4 integrator", low=1e-7, high=1.0, randomisable=False, source="paper, sec. 4"
    )
    lost_distance_m: float = number(
        20.0,
        "m",
        "horizontal distance at which the link counts as lost beyond recovery",
        low=0.01,
        high=1e6,
        randomisable=False,
        source="project default: twice the radius of the paper's path",
    )

    def _check(self) -> None:
        _whole(self.control_period_s, self.integration_step_s, "control_period_s", "integration_step_s")
        _whole(self.duration_s, self.control_period_s, "duration_s", "control_period_s")

    def derived(self) -> dict[str, float]:
        """The time grid as whole numbers, and the exact integration step."""
        step = self.control_period_s / self.substeps
        return {"substeps": self.substeps, "step_s": step, "max_steps": self.steps}

    @property
    def substeps(self) -> int:
        """Integration steps in a control period."""
        return round(self.control_period_s / self.integration_step_s)

    @property
    def steps(self) -> int:
        """Control periods in an episode."""
        return round(self.duration_s / self.control_period_s)

    def step_within(self, longest_s: float) -> float:
        """The longest integration step [s] that divides the control period and isn't above another."""
        return self.control_period_s / max(1, math.ceil(self.control_period_s / longest_s))


def _whole(long: float, short: float, long_name: str, short_name: str) -> None:
    ratio = long / short
    # Beyond that doubles don't count any more.
    if not ratio < 2.0**53 or round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise SettingError(
            f"EpisodeSettings.{long_name} = {long!r} is not allowed; it must be a whole multiple of "
            f"{short_name} = {short!r} [s]."
        )


@inlined
def begin(b, j, step, world) -> None:
    """A new episode, at time 0 unless it is believed to be later."""
    b.clock.step[j] = step
    b.clock.time_s[j] = step * world.episode.control_period_s
    b.ending.ended[j] = 0.0
    b.ending.last_outside[j] = 0.0


@inlined
def tick(b, j, world) -> None:
    """The end of a control period."""
    b.clock.step[j] += 1.0
    b.clock.time_s[j] = b.clock.step[j] * world.episode.control_period_s


@inlined
def judge(b, j, world) -> None:
    """Whether the episode is over, and a success so far."""
    o = b.ending
    step = b.clock.step[j]
    last_outside = o.last_outside[j] if b.measure.in_cone[j] > 0.0 else step
    lost = (b.link.distance_m[j] > world.episode.lost_distance_m) or o.diverged[j] > 0.0
    late = step >= world.episode.max_steps
    o.last_outside[j] = last_outside
    o.ended[j] = 1.0 if lost or late else 0.0
    b.outcome.terminated[j] = 1.0 if lost else 0.0
    b.outcome.truncated[j] = 1.0 if late else 0.0
    b.outcome.is_success[j] = 1.0 if (3.0 * last_outside <= 2.0 * step) and not lost else 0.0


@inlined
def show_start(b, j) -> None:
    """Nothing has been earned or ended at time 0."""
    b.ending.ended[j] = 0.0
    b.outcome.reward[j] = 0.0
    b.outcome.terminated[j] = 0.0
    b.outcome.truncated[j] = 0.0
    b.outcome.is_success[j] = 0.0
