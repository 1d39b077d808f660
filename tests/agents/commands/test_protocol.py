"""The protocol from end to end with short trainings, and what is shipped from it."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO, TD3

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.cluster import workers
from uwoc_gym.agents.commands.protocol import usual_scenarios
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import protocol, training
from uwoc_gym.agents.learning.plans import Wish
from uwoc_gym.agents.policies.registry import load, shipped
from uwoc_gym.agents.reports import files, tables
from uwoc_gym.metrics import PARTS


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Two groups of two short trainings each, flown through a short scenario."""
    root = tmp_path_factory.mktemp("protocol")
    scenario = root / "short.json"
    scenario.write_text(Scenario.named("Random").merged({"episode": {"duration_s": 3.0}}).to_json())
    groups = {
        "ppo": Wish(algorithm="ppo", frame_stack=1, envs=4, set=("n_steps=16", "batch_size=32"), eval_episodes=2),
        "td3": Wish(algorithm="td3", frame_stack=1, envs=2, eval_episodes=2),
    }
    words = ["protocol", "--groups", "ppo", "td3", "--training-seeds", "2", "--steps", "128", "--seeds", "6"]
    words += ["--scenario", str(scenario), "--runs", str(root / "runs"), "--ship", str(root / "trained")]
    with pytest.MonkeyPatch.context() as patch:
        for name, wish in groups.items():
            patch.setitem(protocol.GROUPS, name, protocol.Group(wish, 10, f"{name} in a test"))
        assert main([*words, "--out", str(root / "out")]) == 0
        stamps = {path: path.stat().st_mtime_ns for path in (root / "runs").glob("*/model.zip")}
        assert main([*words, "--out", str(root / "again")]) == 0
        assert stamps == {path: path.stat().st_mtime_ns for path in (root / "runs").glob("*/model.zip")}
    return root


def test_every_policy_is_compared_with_the_reference(flown):
    results = json.loads((flown / "out/results.json").read_text())
    own = results["results"]["short"]
    assert set(own) == {"pd", "nlpd", "pd-tuned", "nlpd-tuned", "ppo", "td3"}
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


def test_same_runs_give_the_same_numbers(flown):
    one, two = (json.loads((flown / name / "results.json").read_text())["results"] for name in ("out", "again"))
    assert one == two


def test_text_and_figure(flown):
    text = (flown / "out/BENCHMARK.md").read_text()
    assert "## short" in text
    for measure in tables.MEASURES:
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


def test_a_training_that_is_not_allowed_is_refused_before_any_begins(tmp_path, capsys, monkeypatch):
    broken = protocol.Group(Wish(algorithm="ppo", set=("n_stps=4",)), 1, "PPO")
    monkeypatch.setitem(protocol.GROUPS, "ppo", broken)
    words = ["protocol", "--groups", "ppo", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    assert main(words) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "--groups ppo" in error
    assert "did you mean 'n_steps'" in error
    assert list(tmp_path.iterdir()) == []


def test_refuses_more_seeds_than_are_held_out(tmp_path, capsys):
    assert main(["protocol", "--seeds", "201", "--runs", str(tmp_path), "--out", str(tmp_path)]) == 2
    assert "a whole number from 1 to 200" in capsys.readouterr().err


def _kill(*_):
    os.kill(os.getpid(), signal.SIGKILL)


class _Bar:
    """What shows nothing."""

    def update(self, count=1):
        pass

    set_description = update


def test_a_training_that_is_killed_is_named_and_goes_on(tmp_path, monkeypatch):
    wish = Wish(algorithm="ppo", envs=4, steps=128, set=("n_steps=16", "batch_size=32"), eval_episodes=2, seed=0)
    job = protocol.Job(wish, str(tmp_path / "ppo-0"))
    with monkeypatch.context() as patch, workers(2) as crew:
        patch.setattr(training, "train_one", _kill)
        said = "a training failed; the others stand in their folders: training ppo-0: its process ended with status -9"
        with pytest.raises(CommandError, match=f"^{said}$"):
            protocol.train_all([job], crew, _Bar())
    with workers(1) as crew:
        protocol.train_all([job], crew, _Bar())
    assert json.loads((tmp_path / "ppo-0" / "results.json").read_text())["finished"]
    with pytest.raises(CommandError, match="was begun with other settings"):
        protocol.check({"ppo": [protocol.Job(replace(wish, set=()), job.folder)]}, {})


def test_groups_say_the_commands_of_the_benchmark():
    folder = Path(protocol.__file__).parents[1]
    text = "".join(path.read_text(encoding="utf-8") for path in folder.glob("BENCHMARK*.md"))
    for name in (*protocol.USUAL, "ppo-tide"):
        group = protocol.GROUPS[name]
        assert f"| {name} " in text
        assert f"`{' '.join(['uwoc-gym train', *group.wish.words()])}`" in text


def test_groups_fly_the_world_that_they_are_trained_in():
    assert usual_scenarios(["ppo-tide"]) == ["uwoc/Tide-v0"]
    assert "uwoc/Random-v0" in usual_scenarios(list(protocol.USUAL))
    assert "uwoc/Underactuated-v0" not in usual_scenarios(list(protocol.USUAL))
    with pytest.raises(CommandError, match=r"--groups ppo-tide ppo is not allowed without --scenario: .* worlds"):
        usual_scenarios(["ppo-tide", "ppo"])


@pytest.mark.parametrize("damage", [{"best": None}, {"best": {"return": 5}}, {"wall_time_s": True}, {"settings": []}])
def test_results_of_a_training_that_lack_what_the_report_needs_are_refused(tmp_path, damage):
    whole = {
        "finished": True, "best": {"return": {"mean": 1.0}}, "wall_time_s": 2.0, "steps_per_s": 3,
        "settings": {"n_timesteps": 4},
    }  # fmt: skip
    path = tmp_path / "results.json"
    files.write_json(path, whole)
    assert protocol.read_results(path) == whole
    files.write_json(path, {**whole, **damage})
    (name,) = damage
    with pytest.raises(CommandError, match=rf"results.json: {name}.* is not allowed; it must be a finite number"):
        protocol.read_results(path)
    files.write_text(path, "[]")
    with pytest.raises(CommandError, match=r"best\.return\.mean"):
        protocol.ship([tmp_path], tmp_path / "shipped", "")
    assert not (tmp_path / "shipped").exists()


def test_tables_say_where_it_is_lost_and_how_far_it_is_to_the_yardstick(tmp_path, short_file):
    scenario = short_file(2.0)
    words = ["protocol", "--training-seeds", "0", "--seeds", "3", "--scenario", str(scenario), "--rivals", "pd", "pd",
             "clairvoyant", "--runs", str(tmp_path / "runs")]  # fmt: skip
    for jobs in "12":
        assert main([*words, "--jobs", jobs, "--out", str(tmp_path / jobs)]) == 0
    one, two = (json.loads((tmp_path / jobs / "results.json").read_text()) for jobs in "12")
    assert one["results"] == two["results"]
    own = one["results"]["short"]
    # The reference flies in any case.
    assert list(own) == ["pd", "clairvoyant", "nlpd-tuned"] == list(one["microseconds_a_decision"])
    scores = np.load(tmp_path / "1/scores.npz")
    returns = {name: scores[f"short/{name}/return"] for name in own}
    start, end = returns["nlpd-tuned"].mean(), returns["clairvoyant"].mean()
    assert end > start
    for name, entry in own.items():
        losses = {key: scores[f"short/{name}/{key}"].mean() for key in entry["losses"]}
        assert entry["losses"] == pytest.approx(losses)
        assert entry["losses"]["loss"] == pytest.approx(40.0 - returns[name].mean())
        assert sum(losses[f"loss_{part}"] for part in PARTS) == pytest.approx(losses["loss"])
        assert entry["below_half"]["value"] == (returns[name] < 20.0).mean()
        assert entry["return_median"]["value"] == np.median(returns[name])
        assert entry["way"]["share"]["value"] == pytest.approx((returns[name].mean() - start) / (end - start))
    text = (tmp_path / "1/BENCHMARK.md").read_text()
    for heading in ("below half", "return, median", "loss: arrival", "loss: bit rate", "way"):
        assert f"| {heading} " in text


def test_a_rival_that_there_is_not_is_refused(tmp_path, capsys):
    words = ["--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]
    assert main(["protocol", "--rivals", "pd", "nldp", *words]) == 2
    assert "argument --rivals: invalid choice: 'nldp'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
