"""The agents that come with the package: what they score, and that anyone can load them."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

from uwoc_gym import Scenario, agents
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning.seeds import VALIDATION
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.registry import POLICIES, TRAINED

NAMES = ("ppo", "ppo-residual", "td3")


def test_there_are_a_ppo_an_off_policy_and_a_residual_agent():
    assert {path.name for path in TRAINED.iterdir()} == set(NAMES)
    assert set(NAMES) < set(POLICIES)
    residual = json.loads((TRAINED / "ppo-residual/agent.json").read_text(encoding="utf-8"))["residual"]
    assert residual["scale"] == 0.6


@pytest.mark.parametrize("name", NAMES)
def test_folder_says_how_it_was_trained_and_is_small(name):
    results = json.loads((TRAINED / name / "results.json").read_text(encoding="utf-8"))
    assert results["finished"]
    assert results["command"].startswith("uwoc-gym train --algorithm")
    assert results["versions"]["stable-baselines3"]
    assert (TRAINED / name / "settings.yaml").is_file()
    assert (TRAINED / name / "model.zip").stat().st_size < 500_000


@pytest.mark.parametrize("name", NAMES)
def test_plain_sb3_loads_the_model(name):
    algorithm = json.loads((TRAINED / name / "agent.json").read_text(encoding="utf-8"))["algorithm"]
    model = ALGORITHMS[algorithm].load().load(TRAINED / name / "model.zip", device="cpu")
    assert model.observation_space.shape == (80,)


def test_ppo_scores_what_is_stored():
    stored = json.loads((TRAINED / "ppo/results.json").read_text(encoding="utf-8"))["best"]["return"]
    returns = fly(POLICIES["ppo"], Scenario.named("Random"), VALIDATION).metrics.return_
    assert stored["low"] <= returns.mean() <= stored["high"]
    assert returns.mean() == pytest.approx(stored["mean"], rel=1e-3)


@pytest.mark.parametrize("name", ["ppo", "ppo-residual"])
def test_beats_the_tuned_nlpd_with_less_effort(name):
    # On validation seeds: the benchmark's own are for the benchmark.
    scenario = Scenario.named("Random")
    agent, nlpd = (fly(POLICIES[each], scenario, VALIDATION).metrics for each in (name, "nlpd-tuned"))
    assert (agent.return_ - nlpd.return_).mean() > 0.3
    assert agent.effort.mean() < nlpd.effort.mean()


def test_loads_by_name_and_flies_a_single_environment():
    policy = agents.load("ppo", "Nominal")
    env = gym.make("uwoc_gym:uwoc/Nominal-v0")
    observation, info = env.reset(seed=0)
    memory, start = None, np.ones(1, dtype=bool)
    for _ in range(100):
        action, memory = policy.predict(observation, memory, start, deterministic=True)
        start[:] = False
        observation, _, _, _, info = env.step(action)
    assert info["in_cone"]
