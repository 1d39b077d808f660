"""AgileRL."""

from __future__ import annotations

import gymnasium as gym
import torch
from agilerl.algorithms import PPO, TD3
from agilerl.components.replay_buffer import ReplayBuffer
from agilerl.training.train_off_policy import train_off_policy
from agilerl.training.train_on_policy import train_on_policy
from checks import check, run

import uwoc_gym  # noqa: F401 - registers the IDs

ID = "uwoc/Random-v0"


@check
def on_policy() -> None:
    """train_on_policy of a population of 2 PPO agents, 200 steps on TrackingVectorEnv of 4."""
    env = gym.make_vec(ID, num_envs=4, max_episode_steps=20)
    spaces = (env.single_observation_space, env.single_action_space)
    agents = [PPO(*spaces, index=i, num_envs=4, batch_size=32, learn_step=32) for i in range(2)]
    agents, _ = train_on_policy(
        env, "tracking", "PPO", agents, max_steps=200, evo_steps=100, eval_steps=20, eval_loop=1, verbose=False
    )
    assert len(agents) == 2


@check
def off_policy() -> None:
    """train_off_policy of a TD3 agent, 200 steps on TrackingVectorEnv of 4."""
    torch.manual_seed(0)
    env = gym.make_vec(ID, num_envs=4, max_episode_steps=20)
    spaces = (env.single_observation_space, env.single_action_space)
    agents = [TD3(*spaces, batch_size=32, learn_step=8, vect_noise_dim=4)]
    memory = ReplayBuffer(max_size=1000)
    train_off_policy(
        env, "tracking", "TD3", agents, memory, max_steps=200, evo_steps=100, eval_steps=20, eval_loop=1, verbose=False
    )


if __name__ == "__main__":
    run()
