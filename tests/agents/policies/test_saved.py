"""Saved models as policies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO

from uwoc_gym import Scenario
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import environments, seeds, settings
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.baselines import NLPDController
from uwoc_gym.sb3 import TrackingVecEnv

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 5.0}})


def test_policy_from_a_saved_model(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.vec_env import VecNormalize

    from uwoc_gym.sb3 import TrackingVecEnv

    env = VecNormalize(TrackingVecEnv("uwoc/Random-v0", 2, seed=0))
    for kind, model in (
        ("PPO", PPO("MlpPolicy", env, n_steps=8, batch_size=16, policy_kwargs={"net_arch": [4]}, device="cpu", seed=0)),
        ("SAC", SAC("MlpPolicy", env, buffer_size=10, policy_kwargs={"net_arch": [4]}, device="cpu", seed=0)),
    ):
        path = tmp_path / f"{kind}.zip"
        model.save(path)
        policy = load(str(path))
        assert kind in policy.description
        observations = np.random.default_rng(0).normal(size=(3, 20)).astype(np.float32)
        plain = policy.make(SHORT).predict(observations, deterministic=True)[0]
        assert plain == pytest.approx(model.predict(observations, deterministic=True)[0], abs=1e-6)
        env.obs_rms.mean += 0.5
        env.save(str(tmp_path / "vecnormalize.pkl"))
        normalised = load(str(path)).make(SHORT).predict(observations, deterministic=True)[0]
        wanted = model.predict(env.normalize_obs(observations), deterministic=True)[0]
        assert normalised == pytest.approx(wanted, abs=1e-6)
        assert fly(policy, SHORT, [0, 1]).metrics.steps.tolist() == [100.0, 100.0]
        (tmp_path / "vecnormalize.pkl").unlink()


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
