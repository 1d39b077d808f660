"""Gymnasium's own wrappers, single and vector: each that there is, flown over the end of an episode."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from typing import Any

import array_api_compat.numpy as numpy_api
import array_api_compat.torch as torch_api
import gymnasium as gym
import numpy as np
import torch
from checks import CHECKS, NotApplicable, check, run
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import vector

import uwoc_gym  # noqa: F401 - registers the IDs

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
ID, STEPS, SIZE = "uwoc/Random-v0", 12, (320, 180)

BOX = gym.spaces.Box(-10.0, 10.0, (20,), np.float32)
BOUNDS = gym.spaces.Box(-2.0, 2.0, (3,), np.float32)

IMAGES = "is for observations that are pictures; ours are vectors"
JAX = "is for environments of JAX's arrays; ours are NumPy's"

ARGUMENTS: dict[str, dict[str, Any]] = {
    "TimeLimit": {"max_episode_steps": STEPS},
    "ClipReward": {"min_reward": 0.0, "max_reward": 0.5},
    "DelayObservation": {"delay": 2},
    "FrameStackObservation": {"stack_size": 3},
    "MaxAndSkipObservation": {"skip": 2},
    "RescaleAction": {"min_action": np.float32(-2.0), "max_action": np.float32(2.0)},
    "RescaleObservation": {"min_obs": np.float32(0.0), "max_obs": np.float32(1.0)},
    "StickyAction": {"repeat_action_probability": 0.5},
    "RepeatAction": {"num_repeats": 2},
    "DiscretizeAction": {"bins": 3},
    "DiscretizeObservation": {"bins": 3},
    "DtypeObservation": {"dtype": np.float64},
    "TransformAction": {"func": lambda action: 0.5 * action, "action_space": BOUNDS},
    "TransformObservation": {"func": lambda seen: 2.0 * seen, "observation_space": BOX},
    "TransformReward": {"func": lambda reward: 2.0 * reward},
    "ReshapeObservation": {"shape": (4, 5)},
    "ArrayConversion": {"env_xp": numpy_api, "target_xp": torch_api},
    "AddRenderObservation": {"render_only": False},
    "AddWhiteNoise": {"probability_of_noise_per_pixel": 0.5},
    "ObstructView": {"obstructed_pixels_ratio": 0.5, "obstruction_width": 20},
    "RecordVideo": {"video_folder": tempfile.mkdtemp(), "episode_trigger": lambda episode: True},
    "VectorizeTransformObservation": {"wrapper": wrappers.ReshapeObservation, "shape": (4, 5)},
    "VectorizeTransformAction": {"wrapper": wrappers.RescaleAction, "min_action": -2.0, "max_action": 2.0},
    "VectorizeTransformReward": {"wrapper": wrappers.TransformReward, "func": lambda reward: 2.0 * reward},
}
"""What a wrapper is made with besides the environment."""

OTHERS: dict[str, str] = {
    "AtariPreprocessing": "is for Atari's games",
    "FilterObservation": "is for observations in a dict; ours are vectors",
    "GrayscaleObservation": IMAGES,
    "JaxToNumpy": JAX,
    "JaxToTorch": JAX,
    "ResizeObservation": IMAGES,
}
"""What doesn't apply, and why."""

ARGUMENTS_OF_VECTORS: dict[str, dict[str, Any]] = {
    "TransformAction": {"func": lambda actions: 0.5 * actions},
    "TransformObservation": {"func": lambda seen: 2.0 * seen},
}

CONVERT = ("ArrayConversion", "NumpyToTorch")
"""What takes and gives PyTorch's tensors."""

DRAWN = ("HumanRendering", "RecordVideo", "RenderCollection", "AddRenderObservation", "AddWhiteNoise", "ObstructView")
"""What needs pictures."""


def fly_single(name: str, wrapper: Callable[..., Any]) -> None:
    """A wrapped environment through a whole episode and into the next."""
    options: dict[str, Any] = {"render_mode": "rgb_array", "render_size": SIZE} if name in DRAWN else {}
    env = gym.make(ID, scenario={"episode": {"duration_s": STEPS * 0.05}}, **options)
    wrapped = wrapper(env, **ARGUMENTS.get(name, {}))
    seen, _ = wrapped.reset(seed=0)
    for _ in range(2):
        for _ in range(STEPS):
            if name not in CONVERT:
                assert wrapped.observation_space.contains(seen), "the observation isn't in the space"
            seen, reward, terminated, truncated, _ = wrapped.step(converted(name, wrapped.action_space.sample()))
            if name in DRAWN and name != "AddRenderObservation":
                wrapped.render()
            if terminated or truncated:
                break
        assert truncated, "the episode didn't end"
        assert np.isfinite(float(reward))
        seen, _ = wrapped.reset()
    wrapped.close()


def converted(name: str, action: Any) -> Any:
    """An action as an array of the framework that a wrapper converts from."""
    return torch.as_tensor(action) if name in CONVERT else action


def fly_vector(name: str, wrapper: Callable[..., Any], mode: Any, theirs: bool = False) -> None:
    """A wrapped vector environment, ours or Gymnasium's own, through whole episodes and into the next."""
    options: dict[str, Any] = {"render_mode": "rgb_array", "render_size": SIZE} if name in DRAWN else {}
    if theirs:
        options |= {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    else:
        options |= {"autoreset_mode": mode}
    env = gym.make_vec(ID, num_envs=3, max_episode_steps=STEPS, **options)
    wrapped = wrapper(env, **ARGUMENTS_OF_VECTORS.get(name, ARGUMENTS.get(name, {})))
    wrapped.reset(seed=0)
    ends = 0
    for _ in range(2 * STEPS + 2):
        _, _, _, truncated, _ = wrapped.step(converted(name, wrapped.action_space.sample()))
        ends += int(np.asarray(truncated).all())
        if name in DRAWN:
            wrapped.render()
    assert ends == 2, f"{ends} ends of episodes"
    wrapped.close()


def add(kind: str, module: Any, name: str) -> None:
    """Put a check of one wrapper among the checks."""

    def function() -> str | None:
        if name in OTHERS:
            raise NotApplicable(OTHERS[name])
        wrapper = getattr(module, name)
        if kind == "single":
            fly_single(name, wrapper)
            return None
        fly_vector(name, wrapper, gym.vector.AutoresetMode.NEXT_STEP)
        try:
            fly_vector(name, wrapper, gym.vector.AutoresetMode.SAME_STEP)
        except Exception as error:
            # What fails on Gymnasium's own vectors as well isn't ours.
            try:
                fly_vector(name, wrapper, gym.vector.AutoresetMode.SAME_STEP, theirs=True)
            except type(error):
                return "not with autoreset SameStep, nor do Gymnasium's own vectors"
            raise
        return None

    function.__name__ = f"{kind}_{name}"
    function.__doc__ = f"{'wrappers' if kind == 'single' else 'wrappers.vector'}.{name}"
    check(function)


@check
def checker() -> None:
    """utils.env_checker.check_env."""
    check_env(gym.make(ID).unwrapped)


@check
def vectors() -> None:
    """make_vec: sync, async and vector_entry_point, over the ends of episodes."""
    for mode in ("sync", "async", "vector_entry_point"):
        env = gym.make_vec(ID, num_envs=2, vectorization_mode=mode, max_episode_steps=5)
        env.reset(seed=0)
        for _ in range(12):
            env.step(env.action_space.sample())
        env.close()


for kind, module in (("single", wrappers), ("vector", vector)):
    for name in module.__all__:
        if name != "vector":
            add(kind, module, name)

if __name__ == "__main__":
    assert len(CHECKS) > 40
    run()
