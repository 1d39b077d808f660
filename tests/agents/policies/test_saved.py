"""Saved models as policies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import environments, seeds, settings
from uwoc_gym.agents.policies import archive
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.baselines import NLPDController
from uwoc_gym.baselines.beliefs import Beliefs
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


@pytest.mark.parametrize("world", ["LateFix", "Tide"])
def test_filters_believe_in_flight_what_they_believed_in_training(world: str) -> None:
    scenario = Scenario.named(world).merged({"episode": {"duration_s": 1.0}})
    values = settings.OWN | {"normalize": True, "frame_stack": 2}
    base = environments.make_base(f"uwoc/{world}-v0", 3, scenario, {})
    env, _, statistics = environments.wrapped(base, values, None, scenario, beliefs=Beliefs(scenario.known()))
    assert statistics is not None
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=24, n_epochs=1, seed=0, device="cpu")
    model.learn(240)
    statistics.training = False
    env.seed(seeds.training_seed(1))
    plain = TrackingVecEnv(f"uwoc/{world}-v0", 3, seeds.training_seed(1), scenario=scenario)
    agent = Agent(model, statistics.normalize_obs, 2, beliefs=Beliefs(scenario.known()))
    stacked, raw = env.reset(), plain.reset()
    memory, begun = None, np.ones(3, dtype=bool)
    ends = 0
    for _ in range(65):
        before = memory
        actions, memory = agent.predict(raw, memory, begun, deterministic=True)
        np.testing.assert_array_equal(memory[0], stacked)
        # What the last observation of an episode makes believe is what the agent would have made of it.
        stacked, _, dones, infos = env.step(model.predict(stacked, deterministic=True)[0])
        kept = None if before is None else [np.copy(each) for each in memory[3]]
        raw, _, begun, plain_infos = plain.step(actions)
        for i in np.flatnonzero(dones):
            ends += 1
            last = np.asarray(plain_infos[i]["terminal_observation"])
            assert kept is not None
            believed, _ = Beliefs(scenario.known())(
                last[None], tuple(each[i : i + 1] for each in kept), np.zeros(1, dtype=bool)
            )
            size = len(believed[0])
            told = infos[i]["terminal_observation"][-size:]
            np.testing.assert_allclose(told, statistics.normalize_obs(believed[0]), atol=1e-5)
    assert ends >= 9
    with pytest.raises(ValueError, match="observation has shape"):
        agent.predict(raw[:, :-1])


def test_a_filtered_agent_is_saved_and_flies_as_it_was_scored(tmp_path: Path) -> None:
    words = ["train", "--env", "uwoc/LateFix-v0", "--steps", "64", "--envs", "2", "--eval-episodes", "2"]
    small = [
        "filtered=true",
        "teacher=null",
        "critic_steps=0",
        "n_steps=16",
        "batch_size=16",
        "policy_kwargs.net_arch=[8]",
        "env_kwargs.scenario={}",
    ]
    assert main([*words, *(word for each in small for word in ("--set", each)), "--out", str(tmp_path / "run")]) == 0
    said = archive.read(tmp_path / "run/model.zip")
    scenario = Scenario.named("LateFix")
    assert said.beliefs == list(Beliefs(scenario.known()).names)
    policy = load(str(tmp_path / "run"))
    assert np.isfinite(fly(policy, scenario.merged({"episode.duration_s": 2.0}), [1, 2]).metrics.return_).all()
    with pytest.raises(CommandError, match="was trained for another observation layout"):
        policy.pilot(Scenario.named("Random"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set", "filtered=1"], "filtered = 1 is not allowed; it must be true, false or learned"),
        (["--env", "CartPole-v1", "--set", "filtered=true"], "filtered is not allowed for 'CartPole-v1'"),
        (
            ["--override", '{"observation": {"groups": ["ship", "link"]}}', "--set", "filtered=true"],
            "filtered = True is not allowed: the observation groups ship, link leave nothing to filter",
        ),
    ],
)
def test_filters_that_have_nothing_to_do_are_refused(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", *words, "--out", str(tmp_path / "run")]) == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
