"""Saved models as policies."""

from __future__ import annotations

import numpy as np
import pytest
from stable_baselines3 import PPO

from uwoc_gym import Scenario
from uwoc_gym.agents.learning import environments, seeds, settings
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.baselines import NLPDController
from uwoc_gym.sb3 import TrackingVecEnv

SCENARIO = Scenario.named("Random").merged({"episode": {"duration_s": 2.0}})


def test_inference_stacks_normalises_and_corrects_as_training_does() -> None:
    scenario = SCENARIO.merged({"episode": {"duration_s": 0.5}})
    controller = NLPDController(scenario=scenario)
    values = settings.OWN | {"normalize": True, "frame_stack": 3, "residual_scale": 0.3}
    base = environments.make_base("uwoc/Random-v0", 3, scenario, {})
    base.seed(seeds.training_seed(0))
    env, _, statistics = environments.wrapped(base, values, controller, scenario)
    assert statistics is not None
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=24, n_epochs=1, seed=0, device="cpu")
    model.learn(240)
    statistics.training = False
    env.seed(seeds.training_seed(1))
    plain = TrackingVecEnv("uwoc/Random-v0", 3, seeds.training_seed(1), scenario=scenario)
    agent = Agent(model, statistics.normalize_obs, 3, controller, 0.3)
    stacked, raw = env.reset(), plain.reset()
    memory, begun = None, np.ones(3, dtype=bool)
    for _ in range(35):
        actions, memory = agent.predict(raw, memory, begun, deterministic=True)
        np.testing.assert_array_equal(memory[0], stacked)
        stacked, *_ = env.step(model.predict(stacked, deterministic=True)[0])
        raw, unscaled, begun, _ = plain.step(actions)
        np.testing.assert_allclose(statistics.get_original_obs(), raw, atol=1e-6)
        np.testing.assert_allclose(statistics.get_original_reward(), unscaled, atol=1e-6)
    single, _ = agent.predict(raw[1], deterministic=True)
    batch, _ = agent.predict(raw, deterministic=True)
    assert single == pytest.approx(batch[1], abs=1e-6)
