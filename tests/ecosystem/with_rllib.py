"""RLlib."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import ray
from checks import check, run
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.algorithms.sac import SACConfig
from ray.tune.registry import register_env

ID = "uwoc_gym:uwoc/Random-v0"


def make(config: dict[str, Any]) -> gym.Env:
    """A short single environment, in whatever process."""
    return gym.make(ID, max_episode_steps=20, **config)


def train(config: Any) -> float:
    """One iteration in this process; returns the mean return."""
    algorithm = (
        config.environment("tracking", env_config={"control_period_s": 0.1})
        .env_runners(num_env_runners=0, num_envs_per_env_runner=2, rollout_fragment_length=50)
        .learners(num_learners=0)
        .build_algo()
    )
    found = algorithm.train()
    algorithm.stop()
    return float(found["env_runners"]["episode_return_mean"])


@check
def on_policy() -> None:
    """PPO, one iteration with 2 environments in a vector."""
    assert train(PPOConfig().training(train_batch_size_per_learner=200, minibatch_size=50, num_epochs=1)) != 0.0


@check
def off_policy() -> None:
    """SAC, one iteration."""
    config = SACConfig().training(
        train_batch_size_per_learner=32, num_steps_sampled_before_learning_starts=50, initial_alpha=0.1
    )
    assert train(config) != 0.0


if __name__ == "__main__":
    ray.init(num_cpus=2, include_dashboard=False, configure_logging=False)
    register_env("tracking", make)
    run()
