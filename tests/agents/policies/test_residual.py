"""Residual actions in all three kinds of environment."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3

from uwoc_gym.agents.learning.environments import ResidualVecEnv
from uwoc_gym.agents.policies.residual import ResidualAction, ResidualVectorAction, corrected
from uwoc_gym.baselines import NLPDController
from uwoc_gym.parameters import SettingError
from uwoc_gym.sb3 import TrackingVecEnv

ID, STEPS, SCALE = "uwoc/Random-v0", 9, 0.4


def _single(**options: Any) -> gym.Env[Any, Any]:
    return ResidualAction(gym.make(ID, max_episode_steps=STEPS, **options), NLPDController(scenario="Random"), SCALE)


def test_the_correction_is_added_and_clipped() -> None:
    applied = corrected([[0.5, -0.9, 0.0]], [[1.0, -1.0, -0.5]], 0.4)
    assert applied == pytest.approx(np.array([[0.9, -1.0, -0.2]]))
    assert applied.dtype == np.float32


def test_no_correction_is_the_controller() -> None:
    env, plain, controller = _single(), gym.make(ID, max_episode_steps=STEPS), NLPDController(scenario="Random")
    observation, _ = env.reset(seed=3)
    assert (plain.reset(seed=3)[0] == observation).all()
    for _ in range(STEPS):
        wanted = plain.step(controller.predict(observation)[0])
        observation, reward, *_ = env.step(np.zeros(3, dtype=np.float32))
        assert (observation == wanted[0]).all()
        assert reward == wanted[1]


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
def test_passes_both_checkers() -> None:
    check_env(_single(), skip_render_check=True)
    check_env_of_sb3(_single())


def test_all_kinds_agree_step_for_step() -> None:
    n, seed = 3, 5
    controller = NLPDController(scenario="Random")
    singles = [_single() for _ in range(n)]
    vector = ResidualVectorAction(
        gym.make_vec(ID, num_envs=n, max_episode_steps=STEPS, autoreset_mode=AutoresetMode.SAME_STEP), controller, SCALE
    )
    sb3 = ResidualVecEnv(TrackingVecEnv(ID, n, seed, max_episode_steps=STEPS), controller, SCALE)
    first = np.stack([env.reset(seed=seed + i)[0] for i, env in enumerate(singles)])
    np.testing.assert_array_equal(vector.reset(seed=seed)[0], first)
    np.testing.assert_array_equal(sb3.reset(), first)
    rng = np.random.default_rng(0)
    for _ in range(3 * STEPS):
        actions = rng.uniform(-1, 1, (n, 3)).astype(np.float32)
        found = vector.step(actions)
        observations, rewards, dones, infos = sb3.step(actions)
        np.testing.assert_array_equal(found[0], observations)
        for i, env in enumerate(singles):
            seen, reward, terminated, truncated, _ = env.step(actions[i])
            assert found[1][i] == reward
            assert rewards[i] == np.float32(reward)
            assert bool(dones[i]) == (terminated or truncated)
            if terminated or truncated:
                np.testing.assert_array_equal(infos[i]["terminal_observation"], seen)
                seen, _ = env.reset()
            np.testing.assert_array_equal(observations[i], seen)


def test_next_step_autoreset_ignores_the_action() -> None:
    env = ResidualVectorAction(
        gym.make_vec(ID, num_envs=2, max_episode_steps=STEPS), NLPDController(scenario="Random"), SCALE
    )
    env.reset(seed=0)
    still = np.zeros((2, 3), dtype=np.float32)
    for step in range(1, 2 * STEPS + 3):
        _, rewards, _, truncated, _ = env.step(still)
        assert truncated.all() == (step in (STEPS, 2 * STEPS + 1))
        assert (rewards == 0.0).all() == (step in (STEPS + 1, 2 * STEPS + 2))


@pytest.mark.parametrize("scale", [0.0, -1.0, 2.1, float("nan"), "much", True])
def test_a_scale_that_is_not_allowed_is_refused(scale: Any) -> None:
    with pytest.raises(SettingError, match=r"scale = .* is not allowed; it must be a number in \(0, 2\]"):
        ResidualAction(gym.make(ID), NLPDController(), scale)


def test_other_environments_are_refused() -> None:
    with pytest.raises(SettingError, match=r"actions have shape \(\)"):
        ResidualAction(gym.make("CartPole-v1"), NLPDController())


def test_step_before_reset_is_refused() -> None:
    with pytest.raises(gym.error.ResetNeeded):
        ResidualAction(gym.make(ID), NLPDController()).step(np.zeros(3, dtype=np.float32))
