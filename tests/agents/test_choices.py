"""What a scenario observes and does holds from training to recording, and what doesn't fit is said in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from uwoc_gym import agents
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.policies import archive

OTHER = {
    "observation": {"groups": ["ship", "velocity", "heading", "link", "time"]},
    "action": "surge-yaw",
    "episode": {"duration_s": 2.0},
}
SMALL = ["--set", "n_steps=16", "--set", "batch_size=32", "--set", "n_epochs=1", "--set", "policy_kwargs.net_arch=[8]"]


def _said(capsys: pytest.CaptureFixture[str]) -> str:
    lines = capsys.readouterr().err.strip().splitlines()
    return lines[-1] if lines else ""


def test_an_agent_of_other_observations_and_actions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pygame")
    override = ["--override", json.dumps(OTHER)]
    out = tmp_path / "run"
    train = ["train", "--algorithm", "ppo", "--steps", "64", "--envs", "4", "--eval-episodes", "2", "--out", str(out)]
    assert main([*train, *SMALL, *override]) == 0
    described = archive.read(out / "model.zip").observation
    assert described is not None
    assert described["actions"] == ["surge force", "yaw moment"]
    assert len(described["entries"]) == 15
    assert main(["evaluate", str(out), "--seeds", "2", *override]) == 0
    record = ["record", "--policy", str(out), "--scenario", "Random", "--to", "0.5", "--size", "320x180"]
    assert main([*record, "--out", str(tmp_path / "a.gif"), *override]) == 0
    capsys.readouterr()
    assert main(["evaluate", str(out), "--seeds", "2"]) == 1
    assert "trained for another observation layout: 15 entries where the scenario has 20, without" in _said(capsys)
    wrench = {key: value for key, value in OTHER.items() if key != "action"}
    assert main(["evaluate", str(out), "--seeds", "2", "--override", json.dumps(wrench)]) == 1
    assert "trained for other actions: surge force, yaw moment; the scenario's are surge force, sway" in _said(capsys)


def test_a_bare_model_of_other_actions(tmp_path: Path) -> None:
    from stable_baselines3 import PPO

    from uwoc_gym import Scenario
    from uwoc_gym.sb3 import TrackingVecEnv

    scenario = Scenario.named("Random").merged(OTHER)
    model = PPO("MlpPolicy", TrackingVecEnv("uwoc/Random-v0", 2, scenario=OTHER), n_steps=8, batch_size=16)
    model.save(tmp_path / "own.zip")
    agent = agents.load(str(tmp_path / "own.zip"), scenario, trust=True)
    observation = TrackingVecEnv("uwoc/Random-v0", 2, scenario=OTHER).reset()
    assert agent.predict(observation, deterministic=True)[0].shape == (2, 2)
    with pytest.raises(CommandError, match=r"shapes \(15,\) and \(2,\); they must be \(20,\) and \(3,\)"):
        agents.load(str(tmp_path / "own.zip"), trust=True)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ({"observation": {"groups": ["velocity", "heading", "link"]}}, "needs the observation group 'ship'"),
        (
            {"observation": {"groups": ["ship", "velocity", "heading"]}},
            "needs the observation group 'ship-acceleration'",
        ),
    ],
)
def test_a_controller_that_cannot_fly_says_so(override: object, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "nlpd", "--seeds", "1", "--override", json.dumps(override)]) == 1
    assert said in _said(capsys)


def test_a_controller_that_can_does(capsys: pytest.CaptureFixture[str]) -> None:
    groups = {"observation": {"groups": ["ship", "velocity", "heading"]}, "episode": {"duration_s": 2.0}}
    assert main(["evaluate", "pd-plain", "--seeds", "2", "--override", json.dumps(groups)]) == 0
