"""Residual actions: the agent corrects what a controller would do.

applied = clip(controller(observation) + scale · action, −1, 1)
"""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines import Controller
from uwoc_gym.given import SettingError, as_number, shown
from uwoc_gym.scenario import Scenario
from uwoc_gym.spaces import action_space

Actions = npt.NDArray[np.float32]

CONTROLS = action_space(Scenario())
"""What a controller commands."""


def corrected(controls: npt.ArrayLike, action: npt.ArrayLike, scale: float) -> Actions:
    """The controller's action with the agent's correction, clipped to [-1, 1].

    Args:
        controls: The controller's action, shape (..., 3).
        action: The agent's action, shape (..., 3).
        scale: What an action of 1 adds, as a share of the actuators' limits.
    """
    correction = np.float32(scale) * np.asarray(action, dtype=np.float32)
    return np.clip(np.asarray(controls, dtype=np.float32) + correction, -1.0, 1.0).astype(np.float32)


def checked_scale(scale: Any) -> float:
    """The scale of a correction.

    Raises:
        SettingError: It isn't a number in (0, 2].
    """
    number = as_number(scale)
    if number is None or not 0.0 < number <= 2.0:
        raise SettingError(f"scale = {shown(scale)} is not allowed; it must be a number in (0, 2].")
    return number


def check_actions(shape: tuple[int, ...] | None) -> None:
    """Refuse environments whose actions aren't a controller's.

    Raises:
        SettingError: The shape isn't (3,).
    """
    if shape != CONTROLS.shape:
        raise SettingError(f"the environment's actions have shape {shape}; a controller's have {CONTROLS.shape}.")


class ResidualAction(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """An environment in which the agent's action corrects a controller's.

    Args:
        env: An environment with this package's observations and actions.
        controller: What is corrected; it sees the same observations as the agent.
        scale: What an action of 1 adds, as a share of the actuators' limits, in (0, 2].

    Raises:
        SettingError: The scale isn't allowed, or the environment has other actions.
    """

    def __init__(self, env: gym.Env[Any, Any], controller: Controller, scale: float = 0.5) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, controller=controller, scale=scale)
        super().__init__(env)
        check_actions(env.action_space.shape)
        self.action_space = CONTROLS
        self.controller = controller
        self.scale = checked_scale(scale)
        self._controls: Actions | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._controls, _ = self.controller.predict(observation)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Apply the corrected action for one control period.

        Raises:
            ResetNeeded: Nothing has been reset yet.
        """
        if self._controls is None:
            raise gym.error.ResetNeeded("no episode has begun; call reset() before step().")
        observation, reward, terminated, truncated, info = self.env.step(corrected(self._controls, action, self.scale))
        self._controls, _ = self.controller.predict(observation)
        return observation, reward, terminated, truncated, info


class ResidualVectorAction(gym.vector.VectorWrapper):
    """`ResidualAction` for a vector environment, in any autoreset mode.

    Args:
        env: A vector environment with this package's observations and actions.
        controller: What is corrected.
        scale: What an action of 1 adds, as a share of the actuators' limits, in (0, 2].

    Raises:
        SettingError: The scale isn't allowed, or the environment has other actions.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], controller: Controller, scale: float = 0.5) -> None:
        super().__init__(env)
        check_actions(env.single_action_space.shape)
        self.controller = controller
        self.scale = checked_scale(scale)
        self._controls: Actions | None = None

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes."""
        observations, infos = self.env.reset(seed=cast(Any, seed), options=options)
        self._controls, _ = self.controller.predict(observations)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Apply the corrected actions for one control period.

        Raises:
            ResetNeeded: Nothing has been reset yet.
        """
        if self._controls is None:
            raise gym.error.ResetNeeded("no episode has begun; call reset() before step().")
        observations, rewards, terminated, truncated, infos = self.env.step(
            corrected(self._controls, actions, self.scale)
        )
        # After an episode's end these are of the next episode, or the last ones of this if the reset is yet to come,
        # at whose step the action doesn't count.
        self._controls, _ = self.controller.predict(observations)
        return observations, rewards, terminated, truncated, infos
