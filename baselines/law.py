"""What the scripted laws share: the interface of learned policies, an observer before the law, the actuators behind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.current_filter import CurrentFilter
from uwoc_gym.baselines.observers import CarriedFixes, DeadReckoning, Memory, Observer, as_seen, in_turn
from uwoc_gym.baselines.tracker import ShipTracker
from uwoc_gym.given import SettingError
from uwoc_gym.scenario import Scenario, as_scenario
from uwoc_gym.task.action import AXES
from uwoc_gym.task.observation import Measured, ObservationSettings, unpack

Array = npt.NDArray[np.float64]


Tracker = Callable[[Scenario], Observer]
"""Makes what believes in the motion of a ship that is known by fixes alone, from what is known of the scenario."""


class Law:
    """A force for what is seen of the ship, batched over observations; a law adds `force_for`.

    Axes without a force or an action are left alone.

    Args:
        scenario: The scenario, or the name of one, that gives the vehicle's nominal model, the actuators' limits and
            the observation's scales. What the plant departs from the nominal model by stays unknown to the law.
        filtered: Whether the law flies behind filters: a `CurrentFilter`, where what that needs is observed, and a
            `ShipTracker`, where the ship is known by fixes alone, or else what is given here instead of that one.
            Without, `CarriedFixes` stands in for the latter.
        needed: Groups that the law needs where the ship is observed at all times, each with what would do without it,
            or nothing.

    Raises:
        SettingError: There is no scenario of that name, its observations leave out what the law needs, or a tracker is
            given that has nothing to track.
    """

    def __init__(self, scenario: str | Scenario, filtered: bool | Tracker, needed: Mapping[str, str]) -> None:
        chosen = as_scenario(scenario)
        self.vehicle = chosen.vehicle.nominal()
        self.force_limits = self.vehicle.force_limits
        self.observation_settings = chosen.observation
        self._inertia = self.vehicle.inertia
        self._axes = list(AXES[chosen.action])
        self._observe = observer(chosen, filtered, needed)

    def force_for(self, seen: Measured) -> Array:
        """The force that the law asks for, before the actuators' limits.

        Args:
            seen: What is known of the ship and the AUV now, of shape (...).

        Returns:
            Surge force [N], sway force [N] and yaw moment [N m] in the AUV's body frame, float64 of shape (..., 3).
        """
        raise NotImplementedError

    def feedforward(self, seen: Any) -> Array:
        """The model's force along the ship's path: M a − M r S w + C(ν) w + D(ν) w, all in the body frame.

        That is Rᵀ [M(η) η̈_ref + C(ν,η) η̇_ref + D(ν,η) η̇_ref], with the ship's acceleration a and velocity w as seen
        from the body and S w = (−w₂, w₁, 0). The term in S comes from Rᵀ Ṙ = r S.
        """
        velocity = seen.velocity
        ship = velocity + seen.relative_velocity
        rate = velocity[..., 2]
        turning = np.stack([-rate * ship[..., 1], rate * ship[..., 0], np.zeros_like(rate)], axis=-1)
        if seen.water_velocity is not None:
            # Only what moves through the water is held back by it.
            water = np.concatenate([seen.water_velocity, np.zeros_like(rate)[..., None]], axis=-1)
            velocity, ship = velocity - water, ship - water
        model = self.vehicle
        resistance = model.coriolis_force(velocity, ship) + model.damping(velocity) * ship
        result: Array = self._inertia * (seen.ship_acceleration - turning) + resistance
        return result

    def action(self, seen: Measured) -> npt.NDArray[np.float32]:
        """The force for what N observations say over the limits, float32 in [-1, 1] of shape (N, actions)."""
        force, limits = self.force_for(seen)[:, self._axes], self.force_limits[self._axes]
        share = np.divide(force, limits, out=np.zeros_like(force), where=limits > 0.0)
        return np.clip(share, -1.0, 1.0).astype(np.float32, order="C")

    def force(self, observation: npt.ArrayLike) -> Array:
        """The force that the law asks for where the ship is observed at all times; see `force_for`.

        Args:
            observation: Shape (..., size), size 20 unless the scenario chooses other groups.

        Raises:
            ValueError: The observation's last axis has another size, or there are N gain sets and not N observations.
        """
        return self.force_for(unpack(observation, self.observation_settings))

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Memory = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[npt.NDArray[np.float32], Memory]:
        """The action for an observation, called as in Stable-Baselines3.

        Args:
            observation: Shape (size,) or (N, size), size 20 unless the scenario chooses other groups.
            state: What the last call gave back, None at first. Without filters and late fixes it isn't needed.
            episode_start: Which of N episodes begin with the observation, (N,).
            deterministic: Not used: the law has no randomness.

        Returns:
            The action, float32 in [-1, 1] of shape (actions,) or (N, actions), the force over the actuators' limits;
            and the state for the next call.

        Raises:
            ValueError: The observation has another shape.
        """
        batch = batch_of(observation, self.observation_settings)
        seen, state = self._observe(unpack(batch, self.observation_settings), state, episode_start)
        action = self.action(seen)
        return (action[0] if np.ndim(observation) == 1 else action), state


def observer(scenario: Scenario, filtered: bool | Tracker, needed: Mapping[str, str]) -> Observer:
    """What stands between the observations of a scenario and a policy that flies on `Measured`; see `Law`.

    Raises:
        SettingError: The scenario's observations leave out what is needed, or leave nothing to a tracker that is given.
    """
    groups = scenario.observation.groups
    is_late = scenario.observation.fixes and "ship" not in groups
    for group, instead in {**needed, **(dict.fromkeys(DeadReckoning.needed, "") if is_late else {})}.items():
        if group not in groups and not (is_late and group in ("ship", "ship-acceleration")):
            raise SettingError(
                f"The law needs the observation group {group!r}, which the scenario leaves out; choose groups with "
                f"it{instead}."
            )
    found: Observer = as_seen
    if is_late:
        maker: Tracker = CarriedFixes if not filtered else ShipTracker if filtered is True else filtered
        found = maker(scenario)
    elif callable(filtered):
        raise SettingError(
            "A tracker has nothing to track where the ship is observed at all times; fly the law without one, or "
            "choose the observation group 'fix' instead of 'ship'."
        )
    if filtered and all(group in groups for group in CurrentFilter.needed):
        found = in_turn(found, CurrentFilter(scenario))
    return found


def batch_of(observation: npt.ArrayLike, settings: ObservationSettings) -> npt.NDArray[Any]:
    """One observation or N as N of them.

    Raises:
        ValueError: The observation has another shape.
    """
    given = np.asarray(observation)
    if given.ndim not in (1, 2):
        raise ValueError(f"observation has shape {given.shape}; it must be ({settings.size},) or (N, {settings.size}).")
    return np.atleast_2d(given)


def several(given: Any) -> Sequence[Any]:
    """One gain set or a sequence of them, as a sequence."""
    return given if isinstance(given, Sequence) and not isinstance(given, str) else [given]
