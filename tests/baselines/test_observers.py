"""What stands before the laws: fixes that are carried along."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from uwoc_gym import Scenario, TrackingVectorEnv, unpack
from uwoc_gym.baselines import NLPDController
from uwoc_gym.baselines.observers import CarriedFixes

STILL = Scenario.named("LateFix").merged(
    {
        "ship": {"kind": "straight", "speed_mps": 0.0, "course_rad": (-3.0, 3.0)},
        "fixes": {"position_std_m": 0.0, "yaw_std_rad": 0.0, "delay_s": 1.3},
        "sensors": dict.fromkeys(Scenario().sensors.specs(), 0.0),
        "episode": {"duration_s": 20.0, "lost_distance_m": 1e4},
    }
)


def test_a_ship_that_stands_still_is_known_at_all_times() -> None:
    lanes = 6
    env = TrackingVectorEnv(lanes, STILL, autoreset_mode=AutoresetMode.SAME_STEP)
    observation, _ = env.reset(seed=3)
    observer, memory = CarriedFixes(STILL), None
    generator = np.random.default_rng(0)
    ended = np.ones(lanes, dtype=bool)
    # Beyond the end of an episode, with which the memory has to begin anew.
    for step in range(600):
        if step % 20 == 0:
            action = generator.uniform(-0.2, 0.2, (lanes, 3)).astype(np.float32)
        known, memory = observer(unpack(observation, STILL.observation), memory, ended)
        state = env.state()
        apart = state["ship_pose"] - state["pose"]
        c, s = np.cos(state["pose"][:, 2]), np.sin(state["pose"][:, 2])
        expected = np.stack([c * apart[:, 0] + s * apart[:, 1], c * apart[:, 1] - s * apart[:, 0]], axis=1)
        np.testing.assert_allclose(known.relative_position, expected, atol=0.02)
        np.testing.assert_allclose(np.exp(1j * known.yaw_error), np.exp(1j * apart[:, 2]), atol=1e-5)
        np.testing.assert_allclose(known.relative_velocity, -state["velocity"], atol=1e-6)
        observation, _, terminated, truncated, _ = env.step(action)
        ended = terminated | truncated


def test_a_law_flies_alone_as_among_others() -> None:
    scenario = Scenario.named("LateFix")
    env = TrackingVectorEnv(5, scenario)
    observation, _ = env.reset(seed=1)
    law, memory, own = NLPDController("nlpd-tuned", scenario), None, None
    for _ in range(120):
        actions, memory = law.predict(observation, memory)
        alone, own = law.predict(observation[3], own)
        np.testing.assert_allclose(alone, actions[3], atol=1e-6)
        assert alone.shape == (3,)
        observation, *_ = env.step(actions)


def test_a_law_that_sees_the_ship_has_no_memory() -> None:
    action, memory = NLPDController().predict(np.zeros(20, np.float32))
    assert memory is None
    assert action.shape == (3,)
    with pytest.raises(ValueError, match=r"observation has shape \(1, 1, 20\)"):
        NLPDController().predict(np.zeros((1, 1, 20), np.float32))
