"""TorchRL."""

from __future__ import annotations

import gymnasium as gym
import torch
from checks import check, run
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import Unbounded
from torchrl.envs import (
    GymEnv,
    GymWrapper,
    ParallelEnv,
    SerialEnv,
    StepCounter,
    TransformedEnv,
    default_info_dict_reader,
)
from torchrl.envs.utils import check_env_specs

import uwoc_gym  # noqa: F401 - registers the IDs

ID = "uwoc/Random-v0"


@check
def single() -> None:
    """GymEnv, check_env_specs and a rollout of 50 steps."""
    env = GymEnv(ID)
    check_env_specs(env)
    assert env.rollout(50)["next", "reward"].shape == (50, 1)


@check
def infos() -> None:
    """auto_register_info_dict: all of info in the rollout, single, made with info_arrays=True."""
    env = GymEnv(ID, info_arrays=True).auto_register_info_dict()
    flown = env.rollout(20)
    assert flown["next", "range_m"].dtype == torch.float64
    assert flown["next", "in_cone"].dtype == torch.bool


@check
def serial_and_parallel() -> None:
    """SerialEnv and ParallelEnv of 2."""
    for kind in (SerialEnv, ParallelEnv):
        env = kind(2, lambda: GymEnv(ID))
        assert env.rollout(5)["next", "reward"].shape == (2, 5, 1)
        env.close()


@check
def native_vector() -> None:
    """GymWrapper of TrackingVectorEnv, autoreset disabled and in the same step, past ends, with info."""
    for mode in ("Disabled", "SameStep"):
        made = gym.make_vec(ID, num_envs=4, max_episode_steps=7, autoreset_mode=mode)
        env = GymWrapper(made)
        # In the same step TorchRL has put a reader there that takes the last observation out of info.
        env.set_info_dict_reader(default_info_dict_reader(["range_m"], [Unbounded((4,), dtype=torch.float64)]))
        flown = env.rollout(30, break_when_any_done=False)
        assert flown.batch_size == (4, 30)
        assert flown["next", "truncated"].sum() >= 4 * 3
        assert flown["next", "range_m"].shape == (4, 30)


@check
def collector() -> None:
    """Collector on the native vector environment with a network, 3 batches over the ends of episodes."""
    made = gym.make_vec(ID, num_envs=4, max_episode_steps=11, autoreset_mode="Disabled")
    env = TransformedEnv(GymWrapper(made), StepCounter())
    policy = TensorDictModule(nn.Sequential(nn.Linear(20, 3), nn.Tanh()), ["observation"], ["action"])
    batches = Collector(env, policy, frames_per_batch=200, total_frames=600)
    steps = [batch["step_count"].max().item() for batch in batches]
    batches.shutdown()
    assert len(steps) == 3
    assert max(steps) == 10


if __name__ == "__main__":
    run()
