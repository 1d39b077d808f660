"""The agents that come with the package: what they score, and that anyone can load them."""

from __future__ import annotations

import hashlib
import json

import gymnasium as gym
import numpy as np
import pytest

from uwoc_gym import ENV_IDS, Scenario, agents
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION, VALIDATION
from uwoc_gym.agents.policies import archive
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.registry import POLICIES, TRAINED
from uwoc_gym.baselines.beliefs import Beliefs

NAMES = ("ppo", "ppo-residual", "td3", "ppo-underactuated", "ppo-tide", "ppo-latefix")

SHA256 = {
    "ppo": "f49e7b0f3681022b86cf7b27c696723c8a7ecebc7dc7dc402223abb12002efb0",
    "ppo-residual": "5027b23d6be32d8e187201294ed3563032aa0f5d851e6b06b7c2eb5cd190ee21",
    "td3": "2d3103e637a4e23d7ac74bcf21eb776bf8f649ff2255c448418eab13df10962d",
    "ppo-underactuated": "cb08db65c788356df5bf89f26e47bcba23f52e8666de4dd095c64d54a92f969c",
    "ppo-tide": "807f32f3bbcc93409a2ce780aad4770d2740032487f0ce68318960b8c90e7a65",
    "ppo-latefix": "7f8e1dc0931179b9cc62cbee9fc34e1622cd8f526d0fbbf6a669cf0d24019f6e",
}
"""Of each agent's file; whoever ships another one says so here."""


def test_there_are_a_ppo_an_off_policy_and_a_residual_agent():
    assert {path.name for path in TRAINED.iterdir() if path.is_dir()} == set(NAMES)
    assert set(NAMES) < set(POLICIES)
    residual = archive.read(TRAINED / "ppo-residual/model.zip").residual
    assert residual["scale"] == 0.6


@pytest.mark.parametrize("name", NAMES)
def test_folder_says_how_it_was_trained_and_is_small(name):
    results = json.loads((TRAINED / name / "results.json").read_text(encoding="utf-8"))
    assert results["finished"]
    assert results["command"].startswith("uwoc-gym train ")
    assert results["versions"]["stable-baselines3"]
    assert (TRAINED / name / "settings.yaml").is_file()
    assert (TRAINED / name / "model.zip").stat().st_size < 500_000


@pytest.mark.parametrize("name", NAMES)
def test_the_file_is_the_one_that_was_shipped(name):
    assert hashlib.sha256((TRAINED / name / "model.zip").read_bytes()).hexdigest() == SHA256[name]
    assert {path.name for path in (TRAINED / name).iterdir()} == {
        "CARD.md", "model.zip", "results.json", "settings.yaml",
    }  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_it_acts_as_plain_sb3_does_bit_for_bit(name):
    said = archive.read(TRAINED / name / "model.zip")
    world = Scenario.named(ENV_IDS[said.env])
    agent = agents.load(name, ENV_IDS[said.env])
    model = ALGORITHMS[said.algorithm].load().load(TRAINED / name / "model.zip", device="cpu")
    scale = said.residual["scale"] if said.residual is not None else 1.0
    beliefs = Beliefs.named(said.beliefs, world.known()) if said.beliefs else None
    plain = Agent(model, None, said.frame_stack, agent.controller, scale, beliefs)
    rng = np.random.default_rng(0)
    memory, own = None, None
    for step in range(20):
        observations = rng.normal(size=(5, world.observation.size)).astype(np.float32)
        begun = np.full(5, step == 0)
        found, memory = agent.predict(observations, memory, begun, deterministic=True)
        wanted, own = plain.predict(observations, own, begun, deterministic=True)
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("name", NAMES)
def test_plain_sb3_loads_the_model(name):
    said = archive.read(TRAINED / name / "model.zip")
    model = ALGORITHMS[said.algorithm].load().load(TRAINED / name / "model.zip", device="cpu")
    assert model.observation_space.shape == (said.frame_stack * said.seen,)


@pytest.mark.parametrize("name", ["ppo", "ppo-underactuated", "ppo-tide", "ppo-latefix"])
def test_an_agent_scores_what_is_stored(name):
    stored = json.loads((TRAINED / name / "results.json").read_text(encoding="utf-8"))["best"]["return"]
    world = Scenario.named(ENV_IDS[archive.read(TRAINED / name / "model.zip").env])
    returns = fly(POLICIES[name], world, ALL_VALIDATION[: stored["episodes"]]).metrics.return_
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
