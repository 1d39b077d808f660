"""What filters believe, as further entries of an observation: what a policy that learns may see besides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.current_filter import CurrentFilter
from uwoc_gym.baselines.law import observer
from uwoc_gym.baselines.learned_tracker import LearnedTracker
from uwoc_gym.baselines.observers import Memory
from uwoc_gym.given import SettingError
from uwoc_gym.scenario import Scenario
from uwoc_gym.task.observation import GROUPS, LIMIT, unpack

LEARNED = "learned"
"""What entries are called by that a network has learned to tell."""


class Beliefs:
    """Observations with what the filters of the ``ekf-`` laws believe behind them, batched.

    The ship's motion now, where it is known by fixes alone, in the entries and scales of the groups ``ship`` and
    ``ship-acceleration``; and the water's velocity, ahead and to starboard in the AUV's body frame, over the scale of
    velocities.

    Args:
        scenario: What is known of the scenario.
        learned: Whether the ship's motion is what the `LearnedTracker` of the ``gru-`` laws believes.

    Raises:
        SettingError: Its observations leave nothing to filter, or leave out what filters need.
    """

    def __init__(self, scenario: Scenario, learned: bool = False) -> None:
        self._settings = own = scenario.observation
        self._late = own.fixes and "ship" not in own.groups
        self._water = all(group in own.groups for group in CurrentFilter.needed)
        if not (self._late or self._water):
            raise SettingError(
                f"the observation groups {', '.join(own.groups)} leave nothing to filter; filters need those of "
                f"{', '.join(CurrentFilter.needed)}, for the current, or fix, velocity and heading, for the ship."
            )
        self._observe = observer(scenario, LearnedTracker if learned else True, {})
        entries = [entry for group in ("ship", "ship-acceleration") if self._late for entry in GROUPS[group]]
        scales = own.scales
        self._scales = np.array(
            [scales[entry.scale] if isinstance(entry.scale, str) else entry.scale for entry in entries]
            + [own.velocity_scale_mps] * 2 * self._water
        )
        self.names = (
            *(f"{LEARNED if learned else 'believed'} {entry.name}" for entry in entries),
            *(("believed water velocity ahead", "believed water velocity to starboard") if self._water else ()),
        )
        """What the further entries are."""

    @classmethod
    def named(cls, names: Sequence[str], scenario: Scenario) -> Beliefs:
        """Those that add entries of such names.

        Raises:
            SettingError: As above, or what would add them adds others here.
        """
        found = cls(scenario, any(name.startswith(LEARNED) for name in names))
        if list(found.names) != list(names):
            raise SettingError(f"filters that added {', '.join(names)} add {', '.join(found.names)} here.")
        return found

    def __call__(
        self, observation: npt.NDArray[Any], memory: Memory = None, begun: npt.NDArray[np.bool_] | None = None
    ) -> tuple[npt.NDArray[np.float32], Memory]:
        """The observations, (N, size), with their further entries, and the memory for the next ones.

        Args:
            observation: Shape (N, size).
            memory: What the last call gave back, which this one may change in place; None at the beginning.
            begun: Which of them begin an episode, (N,).
        """
        seen: Any
        seen, memory = self._observe(unpack(observation, self._settings), memory, begun)
        parts = []
        if self._late:
            yaw = seen.yaw_error[:, None]
            parts = [seen.relative_position, np.cos(yaw), np.sin(yaw), seen.relative_velocity, seen.ship_acceleration]
        if self._water:
            parts.append(seen.water_velocity)
        told = np.clip(np.concatenate(parts, axis=1) / self._scales, -LIMIT, LIMIT)
        return np.concatenate([observation, told], axis=1).astype(np.float32), memory
