"""Tianshou."""

from __future__ import annotations

import gymnasium as gym
from checks import check, run
from tianshou.algorithm.modelfree.sac import SAC, SACPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv, SubprocVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic

import uwoc_gym  # noqa: F401 - registers the IDs

ID = "uwoc/Random-v0"


def make() -> gym.Env:
    """A short single environment."""
    return gym.make(ID, max_episode_steps=20)


def learner() -> SAC:
    """SAC with small networks."""
    env = make()
    actor = ContinuousActorProbabilistic(
        preprocess_net=Net(state_shape=(20,), hidden_sizes=(32,)),
        action_shape=(3,),
        unbounded=True,
        conditioned_sigma=True,
    )
    critic = ContinuousCritic(preprocess_net=Net(state_shape=(20,), action_shape=(3,), hidden_sizes=(32,), concat=True))
    policy = SACPolicy(actor=actor, action_space=env.action_space)
    return SAC(policy=policy, policy_optim=AdamOptimizerFactory(), critic=critic, critic_optim=AdamOptimizerFactory())


@check
def vectors() -> None:
    """Collector on DummyVectorEnv and SubprocVectorEnv of 2, over the ends of episodes."""
    for kind in (DummyVectorEnv, SubprocVectorEnv):
        envs = kind([make, make])
        collector = Collector(learner(), envs, VectorReplayBuffer(1000, 2))
        collector.reset()
        found = collector.collect(n_step=100, random=True)
        assert found.n_collected_steps == 100
        assert found.n_collected_episodes >= 4
        assert {"range_m", "is_success"} <= set(collector.buffer.info.get_keys())
        envs.close()


@check
def trainer() -> None:
    """SAC learns one epoch of 200 steps."""
    algorithm = learner()
    flown = Collector(algorithm, DummyVectorEnv([make, make]), VectorReplayBuffer(1000, 2))
    tested = Collector(algorithm, DummyVectorEnv([make]))
    found = algorithm.run_training(
        OffPolicyTrainerParams(
            training_collector=flown,
            test_collector=tested,
            max_epochs=1,
            epoch_num_steps=200,
            collection_step_num_env_steps=20,
            test_step_num_episodes=1,
            batch_size=32,
            update_step_num_gradient_steps_per_sample=0.1,
            show_progress=False,
        )
    )
    assert found.train_step >= 200


if __name__ == "__main__":
    run()
