"""Stable-Baselines3 and sb3-contrib: each algorithm for continuous actions, and their environments' tools."""

from __future__ import annotations

from typing import Any

import sb3_contrib
import stable_baselines3
from checks import NotApplicable, check, run
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import SubprocVecEnv, VecFrameStack, VecMonitor, VecNormalize

from uwoc_gym import TrackingEnv
from uwoc_gym.sb3 import TrackingVecEnv

ID = "uwoc/Random-v0"
STEPS = 15

SETTINGS: dict[str, dict[str, Any]] = {
    "PPO": {"n_steps": 16, "batch_size": 32},
    "A2C": {"n_steps": 16},
    "TRPO": {"n_steps": 16, "batch_size": 32},
    "RecurrentPPO": {"policy": "MlpLstmPolicy", "n_steps": 16, "batch_size": 32},
    "ARS": {"n_delta": 2},
    "SAC": {"learning_starts": 20},
    "TD3": {"learning_starts": 20},
    "DDPG": {"learning_starts": 20},
    "TQC": {"learning_starts": 20},
    "CrossQ": {"learning_starts": 20},
}
OTHERS = {
    "DQN": "is for actions that are counted; ours are continuous",
    "QRDQN": "is for actions that are counted; ours are continuous",
    "MaskablePPO": "is for actions that are counted; ours are continuous",
    "HER": "needs goals among the observations",
    "HerReplayBuffer": "needs goals among the observations",
}


def names(module: Any) -> list[str]:
    """The algorithms of a library."""
    return [name for name in module.__all__ if name[0].isupper() and name not in ("HER",)]


def add(module: Any, name: str) -> None:
    """Put an algorithm among the checks."""

    def function() -> None:
        if name in OTHERS:
            raise NotApplicable(OTHERS[name])
        env = TrackingVecEnv(ID, n_envs=2, seed=0, max_episode_steps=STEPS)
        arguments = {"policy": "MlpPolicy", **SETTINGS[name]}
        policy = arguments.pop("policy")
        model = getattr(module, name)(policy, env, device="cpu", **arguments)
        model.learn(64)
        assert model.num_timesteps >= 64
        action, _ = model.predict(env.reset(), deterministic=True)
        assert action.shape == (2, 3)

    function.__name__ = name
    function.__doc__ = f"{module.__name__}.{name} learns 64 steps on TrackingVecEnv"
    check(function)


for module in (stable_baselines3, sb3_contrib):
    for name in names(module):
        add(module, name)


@check
def checker() -> None:
    """common.env_checker.check_env."""
    check_env(TrackingEnv(scenario="Random"))


@check
def wrapped() -> None:
    """VecNormalize, VecFrameStack and VecMonitor around TrackingVecEnv; evaluate_policy."""
    env = VecMonitor(VecFrameStack(VecNormalize(TrackingVecEnv(ID, 2, seed=0, max_episode_steps=STEPS)), 3))
    model = stable_baselines3.PPO("MlpPolicy", env, n_steps=16, batch_size=32, device="cpu").learn(64)
    returns, lengths = evaluate_policy(model, env, n_eval_episodes=3, return_episode_rewards=True, warn=False)
    assert len(returns) == 3
    assert set(lengths) == {STEPS}


@check
def their_vectors() -> None:
    """make_vec_env of the single environment, in this process and in others."""
    for kind in (None, SubprocVecEnv):
        env = make_vec_env(ID, 2, seed=0, vec_env_cls=kind, env_kwargs={"max_episode_steps": STEPS})
        stable_baselines3.PPO("MlpPolicy", env, n_steps=16, batch_size=32, device="cpu").learn(64)
        env.close()


if __name__ == "__main__":
    run()
