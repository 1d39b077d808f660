"""The water's velocity from how the AUV moves: an extended Kalman filter over the nominal model.

The state is the AUV's velocity through the water and the water's in the earth frame; what is measured is their sum. A
force that is known drives the AUV through the water against its damping, so that what it makes over ground beyond that
is the water's. The true plant isn't the nominal one; the noise of the process stands for the difference, for pulses,
and for a current that changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.kalman import Belief, belief, chosen, correct, matrix, predict
from uwoc_gym.baselines.numbers import fixed
from uwoc_gym.baselines.observers import Memory
from uwoc_gym.parameters import Parameters
from uwoc_gym.scenario import Scenario
from uwoc_gym.task.observation import Measured

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CurrentFilterSettings(Parameters):
    """What the filter takes for granted."""

    current_std_mps: float = fixed(0.4, "m/s", "current along each axis before anything is known", 0.0, 10.0)
    drift_mps: float = fixed(0.03, "m/s/√s", "drift of the current", 0.0, 10.0)
    force: float = fixed(0.1, "√s", "force that is not known, as a share of the actuators' limits", 0.0, 100.0)
    velocity_std_mps: float = fixed(0.02, "m/s", "error of the measured velocity", 1e-4, 10.0)
    yaw_rate_std_rad_s: float = fixed(0.01, "rad/s", "error of the measured yaw rate", 1e-4, 10.0)


class CurrentFilter:
    """An observer (see `uwoc_gym.baselines.observers`) that believes in a current.

    Args:
        scenario: What is known of the scenario: nominal model, limits and control period.
        settings: What the filter takes for granted.
    """

    needed = ("velocity", "heading", "last-action")
    """The groups of observations that it learns from."""

    def __init__(self, scenario: Scenario, settings: CurrentFilterSettings | None = None) -> None:
        self.settings = settings or CurrentFilterSettings()
        self._vehicle = scenario.vehicle.nominal()
        self._limits = self._vehicle.force_limits
        self._period_s = scenario.episode.control_period_s
        own = self.settings
        self._noise = np.zeros((5, 5))
        self._noise[:3, :3] = np.diag(np.square(own.force * self._limits / self._vehicle.inertia)) * self._period_s
        self._noise[3:, 3:] = np.eye(2) * own.drift_mps**2 * self._period_s
        self._errors = np.diag([own.velocity_std_mps**2] * 2 + [own.yaw_rate_std_rad_s**2])

    def __call__(self, seen: Measured, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
        """See `uwoc_gym.baselines.observers.Observer`."""
        known: Any = seen
        if memory is None:
            believed = self.begin(known)
        else:
            believed, _ = self.learn(Belief(*memory), known)
            if begun is not None and np.any(begun):
                believed = Belief(*chosen(begun, self.begin(known), believed))
        cosine, sine = known.heading[:, 0], known.heading[:, 1]
        x, y = believed.mean[:, 3], believed.mean[:, 4]
        water = np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=1)
        return seen._replace(water_velocity=water), tuple(believed)

    def begin(self, seen: Any) -> Belief:
        """What is believed at the beginning of an episode."""
        s = self.settings
        through = float(np.hypot(s.current_std_mps, s.velocity_std_mps))
        start = belief(
            [*seen.velocity.T, 0.0, 0.0],
            [through, through, s.yaw_rate_std_rad_s, s.current_std_mps, s.current_std_mps],
            len(seen.velocity),
        )
        # What the current is more, the AUV makes less through the water.
        turn = self._turn(seen)
        start.cov[:, :2, 3:] = -turn * s.current_std_mps**2
        start.cov[:, 3:, :2] = start.cov[:, :2, 3:].swapaxes(1, 2)
        return start

    def learn(self, before: Belief, seen: Any) -> tuple[Belief, Array]:
        """Go on by a control period and take in a measured velocity.

        Args:
            before: What was believed one period ago.
            seen: What N observations say.

        Returns:
            What is believed now, and the innovation squared in its own covariance (NIS), (N,).
        """
        h = self._period_s
        lanes = len(before.mean)
        through = before.mean[:, :3]
        force = seen.last_action * self._limits
        middle = through + 0.5 * h * self._vehicle.acceleration(through, force)
        moved = through + h * self._vehicle.acceleration(middle, force)
        step = np.tile(np.eye(5), (lanes, 1, 1))
        step[:, :3, :3] += h * self._vehicle.velocity_slope(middle)
        ahead = predict(before, step, self._noise, np.concatenate([moved, before.mean[:, 3:]], axis=1))
        measured = np.zeros((lanes, 3, 5))
        measured[:, :3, :3] = np.eye(3)
        measured[:, :2, 3:] = self._turn(seen)
        innovation = seen.velocity - (measured @ ahead.mean[..., None])[..., 0]
        after, _, square = correct(ahead, innovation, measured, self._errors)
        return after, square

    @staticmethod
    def _turn(seen: Any) -> Array:
        """From the earth frame to the body's, (N, 2, 2)."""
        cosine, sine = seen.heading[:, 0], seen.heading[:, 1]
        return matrix([[cosine, sine], [-sine, cosine]], len(cosine))
