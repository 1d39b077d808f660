"""The protocol from end to end with short trainings, and what is shipped from it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from stable_baselines3 import PPO, TD3

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.flight import load, shipped
from uwoc_gym.agents.learning import protocol
from uwoc_gym.agents.reports import tables as report


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Two groups of two short trainings each, flown through a short scenario."""
    root = tmp_path_factory.mktemp("protocol")
    scenario = root / "short.json"
    scenario.write_text(Scenario.named("Random").merged({"episode": {"duration_s": 3.0}}).to_json())
    small = {
        "ppo": ("--frame-stack", "1", "--envs", "4", "--set", "n_steps=16", "--set", "batch_size=32"),
        "td3": ("--frame-stack", "1", "--envs", "2"),
    }
    groups = {
        name: protocol.Group(("--algorithm", name, *options, "--eval-episodes", "2"), 10, f"{name} in a test")
        for name, options in small.items()
    }
    words = ["protocol", "--groups", "ppo", "td3", "--training-seeds", "2", "--steps", "128", "--seeds", "6"]
    words += ["--scenario", str(scenario), "--runs", str(root / "runs"), "--ship", str(root / "trained")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(protocol, "GROUPS", groups)
        assert main([*words, "--out", str(root / "out")]) == 0
        stamps = {path: path.stat().st_mtime_ns for path in (root / "runs").glob("*/model.zip")}
        assert main([*words, "--out", str(root / "again")]) == 0
        assert stamps == {path: path.stat().st_mtime_ns for path in (root / "runs").glob("*/model.zip")}
    return root


def test_every_policy_is_compared_with_the_reference(flown):
    results = json.loads((flown / "out/results.json").read_text())
    own = results["results"]["short"]
    assert set(own) == {*protocol.CONTROLLERS, "ppo", "td3"}
    assert own["ppo"]["trainings"] == 2
    assert own["ppo"]["episodes"] == 6
    assert own["ppo"]["measures"]["arrival_time_s"]["episodes"] == 12
    scenario = Scenario.from_json((flown / "short.json").read_text())
    assert results["scenarios"] == {"short": scenario.digest()}
    assert own["nlpd-tuned"]["difference"]["value"] == 0.0
    assert own["ppo"]["difference"]["high"] < 0.0
    scores = np.load(flown / "out/scores.npz")
    expected = scores["short/ppo/return"] - scores["short/nlpd-tuned/return"]
    assert own["ppo"]["difference"]["value"] == pytest.approx(expected.mean())
    assert scores["short/ppo/return"].shape == (2, 6)


def test_what_says_never_is_counted():
    returns, reference = np.ones((2, 3)), np.ones((1, 3))
    measures = {measure.key: returns for measure in report.MEASURES} | {"steps": returns}
    restoring = np.array([[np.inf, np.nan, 1.0], [2.0, 3.0, np.inf]])
    own = {"ppo": measures | {"restoring_time_s": restoring}}
    own["nlpd-tuned"] = dict.fromkeys(measures, reference) | {"arrival_time_s": np.array([[np.nan, 1.0, 1.0]])}
    found = protocol.compared(own)
    ppo = found["ppo"]["measures"]["restoring_time_s"]
    assert (ppo["mean"], ppo["values"], ppo["never"], ppo["episodes"]) == (2.0, 3, 2, 6)
    results = {"held_out_seeds": 3, "results": {"here": found}, "groups": {}, "microseconds_a_decision": {}}
    text = protocol.benchmark_text("uwoc-gym protocol", results)
    assert "(5 of 6, 2 of them never)" in text
    assert "1.00 (1 of 3 never)" in text


def test_same_runs_give_the_same_numbers(flown):
    one, two = (json.loads((flown / name / "results.json").read_text())["results"] for name in ("out", "again"))
    assert one == two


def test_text_and_figure(flown):
    text = (flown / "out/BENCHMARK.md").read_text()
    assert "## short" in text
    for measure in report.MEASURES:
        assert f"| {measure.heading}" in text
    assert "`uwoc-gym train --algorithm td3" in text
    assert (flown / "out/profile-short.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_shipped_agents_decide_as_the_best_runs_and_load_with_plain_sb3(flown):
    observations = np.random.default_rng(0).uniform(-1, 1, (5, 20)).astype(np.float32)
    found = shipped(flown / "trained")
    for name, kind in (("ppo", PPO), ("td3", TD3)):
        scores = {}
        for seed in range(2):
            run = flown / f"runs/{name}-{seed}"
            scores[run] = json.loads((run / "results.json").read_text())["best"]["return"]["mean"]
        best = max(scores, key=scores.get)
        expected, _ = load(str(best)).make(Scenario()).predict(observations, deterministic=True)
        actions, _ = found[name].make(Scenario()).predict(observations, deterministic=True)
        np.testing.assert_array_equal(actions, expected)
        plain = kind.load(flown / f"trained/{name}/model.zip", device="cpu")
        np.testing.assert_array_equal(plain.predict(observations, deterministic=True)[0], expected)
        assert (flown / f"trained/{name}/model.zip").stat().st_size <= (best / "model.zip").stat().st_size


def test_a_failed_training_is_named(tmp_path, capsys, monkeypatch):
    broken = protocol.Group(("--algorithm", "ppo", "--set", "n_stps=4"), 1, "PPO")
    monkeypatch.setattr(protocol, "GROUPS", {"ppo": broken})
    words = ["protocol", "--groups", "ppo", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    assert main(words) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "a training failed" in error
    assert "ppo-0" in error
    assert "did you mean 'n_steps'" in error


def test_refuses_more_seeds_than_are_held_out(tmp_path, capsys):
    assert main(["protocol", "--seeds", "201", "--runs", str(tmp_path), "--out", str(tmp_path)]) == 1
    assert "there are 200 held-out seeds" in capsys.readouterr().err
