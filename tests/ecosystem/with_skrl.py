"""skrl."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import torch
from checks import check, run
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.trainers.torch import SequentialTrainer
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

import uwoc_gym  # noqa: F401 - registers the IDs

ID = "uwoc/Random-v0"
NETWORK = [{"name": "net", "input": "OBSERVATIONS", "layers": [32], "activations": "elu"}]


def weights(model: torch.nn.Module) -> torch.Tensor:
    """All of a network's weights."""
    return torch.nn.utils.parameters_to_vector(model.parameters()).detach().clone()


def train(made: Any) -> None:
    """PPO for 64 steps."""
    env = wrap_env(made)
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": "cpu"}
    models = {
        "policy": gaussian_model(**spaces, network=NETWORK, output="ACTIONS"),
        "value": deterministic_model(**spaces, network=NETWORK, output="ONE"),
    }
    for model in models.values():
        model.init_state_dict(role="")
    before = weights(models["policy"])
    memory = RandomMemory(memory_size=16, num_envs=env.num_envs, device="cpu")
    quiet = {"write_interval": 0, "checkpoint_interval": 0}
    agent = PPO(models=models, memory=memory, cfg={"rollouts": 16, "experiment": quiet}, **spaces)
    SequentialTrainer(cfg={"timesteps": 64, "headless": True}, env=env, agents=agent).train()
    assert not torch.equal(before, weights(models["policy"]))


@check
def single() -> None:
    """PPO learns 64 steps on the single environment."""
    train(gym.make(ID, max_episode_steps=20))


@check
def native_vector() -> None:
    """PPO learns 64 steps on TrackingVectorEnv of 4."""
    train(gym.make_vec(ID, num_envs=4, max_episode_steps=20))


if __name__ == "__main__":
    run()
