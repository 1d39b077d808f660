"""RLlib."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import ray
from checks import block, check, run
from ray.rllib.algorithms.sac import SACConfig
from ray.tune.registry import register_env

ID = "uwoc_gym:uwoc/Random-v0"


@check
def page() -> None:
    """PPO on TrackingVectorEnv, as docs/cluster.md has it, cut to 24 iterations of 4,096 steps"""
    found = block("cluster.md", "PPOConfig", {"ITERATIONS = 48": "ITERATIONS = 24"})
    assert type(found["algorithm"].env_runner.env.unwrapped).__name__ == "TrackingVectorEnv"
    assert found["returns"][-1] > found["returns"][0] + 80.0
    ray.shutdown()


@check
def off_policy() -> None:
    """SAC, one iteration with 2 environments in a vector"""

    def make(config: dict[str, Any]) -> gym.Env:
        return gym.make(ID, max_episode_steps=20, **config)

    ray.init(address="local", num_cpus=2, include_dashboard=False, configure_logging=False)
    register_env("tracking", make)
    algorithm = (
        SACConfig()
        .environment("tracking", env_config={"control_period_s": 0.1})
        .env_runners(num_env_runners=0, num_envs_per_env_runner=2, rollout_fragment_length=50)
        .learners(num_learners=0)
        .training(train_batch_size_per_learner=32, num_steps_sampled_before_learning_starts=50, initial_alpha=0.1)
        .build_algo()
    )
    found = algorithm.train()
    algorithm.stop()
    assert float(found["env_runners"]["episode_return_mean"]) != 0.0


if __name__ == "__main__":
    run()
