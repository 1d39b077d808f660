"""An agent: a trained model with the wrappers that it was trained in, rebuilt for observations alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.policies.residual import checked_scale, corrected
from uwoc_gym.baselines.beliefs import Beliefs
from uwoc_gym.baselines.policy import Predictor


class Agent:
    """A model with all that stood between it and the environment in training.

    Args:
        model: A model of Stable-Baselines3 or sb3-contrib, or its network alone.
        normalise: Its observation statistics, frozen, if it was trained with some.
        frames: How many observations in a row it sees.
        controller: What its actions correct, if anything: a controller or any other policy.
        scale: What an action of 1 adds to the controller's.
        beliefs: What filters add to its observations, if anything.
    """

    def __init__(
        self,
        model: Any,
        normalise: Callable[[Any], Any] | None = None,
        frames: int = 1,
        controller: Predictor | None = None,
        scale: float = 1.0,
        beliefs: Beliefs | None = None,
    ) -> None:
        self.model = model
        self.controller = controller
        self._normalise = normalise
        self._frames = frames
        self._scale = checked_scale(scale)
        self._beliefs = beliefs

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions for observations, called as in Stable-Baselines3.

        Args:
            observation: Shape (size,) or (N, size), size 20 unless it was trained on other observation groups.
            state: The memory that the last call returned; None in the first.
            episode_start: Where an episode begins, bool of shape () or (N,); by default nowhere after the first call.
            deterministic: Whether to take the most likely action instead of drawing one.

        Returns:
            Actions of shape (3,) or (N, 3), or what the kind trained for has, and the memory for the next call.

        Raises:
            ValueError: The observation has another shape.
        """
        seen = np.asarray(observation, dtype=np.float32)
        size = self.model.observation_space.shape[0] // self._frames
        if self._beliefs is not None:
            size -= len(self._beliefs.names)
        if seen.ndim not in (1, 2) or seen.shape[-1] != size:
            raise ValueError(f"observation has shape {seen.shape}; it must be ({size},) or (N, {size}).")
        batch = np.atleast_2d(seen)
        start = np.zeros(len(batch), dtype=bool) if episode_start is None else np.atleast_1d(episode_start).astype(bool)
        stacked, memory, below, believed = state if state is not None else (None, None, None, None)
        given = batch
        if self._beliefs is not None:
            given, believed = self._beliefs(given, believed, start)
        if self._normalise is not None:
            given = self._normalise(given)
        if self._frames > 1:
            given = stacked = stack(stacked, given, start, self._frames)
        actions, memory = self.model.predict(given, memory, start, deterministic)
        if self.controller is not None:
            controls, below = self.controller.predict(batch, state=below, episode_start=start, deterministic=True)
            actions = corrected(controls, actions, self._scale)
        return (actions if seen.ndim == 2 else actions[0]), (stacked, memory, below, believed)


def stack(
    stacked: npt.NDArray[np.float32] | None,
    observations: npt.NDArray[np.float32],
    episode_start: npt.NDArray[np.bool_],
    frames: int,
) -> npt.NDArray[np.float32]:
    """The observations behind those before them, oldest first, zero before the episode began: as VecFrameStack does.

    Args:
        stacked: What the last call returned, (N, frames * size); None in the first.
        observations: Shape (N, size).
        episode_start: Where an episode begins, (N,).
        frames: Number of observations in a row.
    """
    size = observations.shape[1]
    result = np.zeros((len(observations), frames * size), dtype=np.float32)
    if stacked is not None:
        result[:, :-size] = np.where(episode_start[:, None], 0.0, stacked[:, size:])
    result[:, -size:] = observations
    return result
