"""Residual actions: the agent corrects what a controller, or any other policy, would do.

applied = clip(controller(observation) + scale · action, −1, 1)
"""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.baselines.policy import Predictor
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


class Named:
    """A policy that is corrected, whose failures say which it is.

    Args:
        policy: The policy.
        name: What it is called.
    """

    def __init__(self, policy: Predictor, name: str) -> None:
        self._policy, self._name = policy, name

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """What the policy does.

        Raises:
            CommandError: It fails.
        """
        try:
            return self._policy.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
        except CommandError:
            raise
        except Exception as error:
            raise CommandError(
                f"policy {self._name!r}, which is corrected, failed: {type(error).__name__}: {error}"
            ) from error


class Corrected:
    """A policy that is corrected, with what it remembers from step to step.

    It decides when the agent does, once for each observation, so that none is remembered twice.

    Args:
        policy: What is corrected; it sees the same observations as the agent.
        scale: What an action of 1 adds, as a share of the actuators' limits, in (0, 2].

    Raises:
        SettingError: The scale isn't allowed.
    """

    def __init__(self, policy: Predictor, scale: float) -> None:
        self.policy = policy
        self.scale = checked_scale(scale)
        self._memory: Any = None
        self._seen: Any = None
        self._begun: npt.NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def begin(self, observations: Any) -> None:
        """Take the first observations (N, size) of N episodes."""
        self._memory, self._seen = None, observations
        self._begun = np.ones(len(observations), dtype=bool)

    def see(self, observations: Any, begun: npt.NDArray[np.bool_]) -> None:
        """Take the next observations (N, size), which are an episode's first where it has begun."""
        self._seen, self._begun = observations, begun

    def see_again(self, observations: Any, begun: npt.NDArray[np.bool_]) -> None:
        """Take other observations in place of the last, since some episodes have begun anew."""
        self._seen, self._begun = observations, self._begun | begun

    def kept(self) -> tuple[Any, ...]:
        """What it needs to go on: memory, last observations, and where an episode has begun with them."""
        return self._memory, self._seen, self._begun

    def put_back(self, memory: Any, seen: Any, begun: npt.NDArray[np.bool_]) -> None:
        """Go on from what `kept` has told."""
        self._memory, self._seen, self._begun = memory, seen, begun

    def act(self, action: Any) -> Actions:
        """What is applied, (N, 3), where the agent does ``action``.

        Raises:
            ResetNeeded: No episode has begun.
        """
        if self._seen is None:
            raise gym.error.ResetNeeded("no episode has begun; call reset() before step().")
        controls, self._memory = self.policy.predict(
            self._seen, state=self._memory, episode_start=self._begun, deterministic=True
        )
        return corrected(controls, action, self.scale)


class ResidualAction(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """An environment in which the agent's action corrects a controller's.

    Args:
        env: An environment with this package's observations and actions.
        controller: What is corrected, a controller or any other policy; it sees the same observations as the agent.
        scale: What an action of 1 adds, as a share of the actuators' limits, in (0, 2].

    Raises:
        SettingError: The scale isn't allowed, or the environment has other actions.
    """

    def __init__(self, env: gym.Env[Any, Any], controller: Predictor, scale: float = 0.5) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, controller=controller, scale=scale)
        super().__init__(env)
        check_actions(env.action_space.shape)
        self.action_space = CONTROLS
        self.controller, self.scale = controller, scale
        self._corrected = Corrected(controller, scale)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._corrected.begin(observation[None])
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Apply the corrected action for one control period.

        Raises:
            ResetNeeded: Nothing has been reset yet.
        """
        applied = self._corrected.act(np.asarray(action)[None])[0]
        observation, reward, terminated, truncated, info = self.env.step(applied)
        self._corrected.see(observation[None], np.zeros(1, dtype=bool))
        return observation, reward, terminated, truncated, info


class ResidualVectorAction(gym.vector.VectorWrapper):
    """`ResidualAction` for a vector environment, in any autoreset mode.

    Args:
        env: A vector environment with this package's observations and actions.
        controller: What is corrected, a controller or any other policy.
        scale: What an action of 1 adds, as a share of the actuators' limits, in (0, 2].

    Raises:
        SettingError: The scale isn't allowed, or the environment has other actions.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], controller: Predictor, scale: float = 0.5) -> None:
        super().__init__(env)
        check_actions(env.single_action_space.shape)
        self.controller, self.scale = controller, scale
        self._corrected = Corrected(controller, scale)
        self._mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self._over = np.zeros(env.num_envs, dtype=bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, or some where ``options`` has a ``reset_mask``."""
        mask = (options or {}).get("reset_mask")
        observations, infos = self.env.reset(seed=cast(Any, seed), options=options)
        if mask is None or np.all(mask):
            self._corrected.begin(observations)
            self._over = np.zeros(self.num_envs, dtype=bool)
        else:
            chosen = np.asarray(mask, dtype=bool)
            self._corrected.see_again(observations, chosen)
            self._over = self._over & ~chosen
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Apply the corrected actions for one control period.

        Raises:
            ResetNeeded: Nothing has been reset yet.
        """
        observations, rewards, terminated, truncated, infos = self.env.step(self._corrected.act(actions))
        ended = np.asarray(terminated | truncated, dtype=bool)
        # After an episode's end these are of the next episode, or the last ones of this if the reset is yet to come,
        # at whose step the action doesn't count.
        begun = {AutoresetMode.SAME_STEP: ended, AutoresetMode.NEXT_STEP: self._over}.get(self._mode)
        self._corrected.see(observations, np.zeros_like(ended) if begun is None else begun)
        self._over = ended
        return observations, rewards, terminated, truncated, infos
