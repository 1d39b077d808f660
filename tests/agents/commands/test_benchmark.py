"""The benchmark from end to end, in short scenarios."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import signal
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym import Scenario, TrackingEnv
from uwoc_gym.agents import flight
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.commands import benchmark
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.agents.reports import files
from uwoc_gym.baselines import NLPDController
from uwoc_gym.baselines.policy import Policy

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 5.0}})


@pytest.fixture
def scenario_file(short_file: Callable[[float], Path]) -> Path:
    return short_file(5.0)


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch, still: Any) -> types.ModuleType:
    made = types.ModuleType("uwoc_policies_of_a_test")
    made.still = lambda scenario: still  # type: ignore[attr-defined]
    made.nothing = lambda scenario: object()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, made.__name__, made)
    return made


def _fly(scenario: Path, out: Path, *more: str, jobs: int = 1) -> int:
    words = ["--scenario", str(scenario), "--seeds", "3", "--batch", "2", "--jobs", str(jobs), "--out", str(out)]
    return main(["benchmark", *words, *more])


def _rows(out: Path) -> list[dict[str, str]]:
    with (out / "episodes.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_benchmark_writes_what_it_prints(
    scenario_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert _fly(scenario_file, out, "--policy", "pd", "nlpd") == 0
    rows = _rows(out)
    assert [(row["policy"], row["seed"]) for row in rows] == [(p, s) for p in ("pd", "nlpd") for s in "012"]
    results = json.loads((out / "results.json").read_text())
    assert results["finished"] is True
    assert results["command"].startswith("uwoc-gym benchmark --scenario")
    assert results["settings"]["seeds"] == [0, 1, 2]
    table = (out / "table.md").read_text()
    assert table == capsys.readouterr().out
    for entry in results["results"]:
        own = [float(row["return"]) for row in rows if row["policy"] == entry["policy"]]
        summary = entry["measures"]["return"]
        assert summary["mean"] == pytest.approx(np.mean(own))
        assert f"{summary['mean']:.1f} [{summary['low']:.1f}, {summary['high']:.1f}]" in table
    assert results["scenarios"] == {"short": SHORT.digest()}
    picture = (out / "short.png").read_bytes()
    assert picture[:8] == b"\x89PNG\r\n\x1a\n"
    assert int.from_bytes(picture[16:20], "big") > 1000
    assert int.from_bytes(picture[20:24], "big") > 500


def test_benchmark_compares_with_the_tuned_nlpd_episode_by_episode(scenario_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert _fly(scenario_file, out, "--policy", "pd", "nlpd-tuned") == 0
    returns = {name: [float(r["return"]) for r in _rows(out) if r["policy"] == name] for name in ("pd", "nlpd-tuned")}
    pd, reference = json.loads((out / "results.json").read_text())["results"]
    expected = np.mean(np.subtract(returns["pd"], returns["nlpd-tuned"]))
    assert pd["against"]["difference"]["value"] == pytest.approx(expected)
    assert pd["against"]["improvement"]["value"] == 0.0
    assert pd["return_worst"] == min(returns["pd"])
    assert pd["return_median"] == np.median(returns["pd"])
    assert pd["below_half"] == np.mean(np.less(returns["pd"], 50.0))
    assert pd["losses"]["loss"] == pytest.approx(100.0 - np.mean(returns["pd"]))
    assert reference["against"] is None
    assert "return − nlpd-tuned" in (out / "table.md").read_text()


def test_same_seeds_give_the_same_rows_in_any_batch(scenario_file: Path, tmp_path: Path) -> None:
    assert _fly(scenario_file, tmp_path / "a", "--policy", "pd") == 0
    assert _fly(scenario_file, tmp_path / "b", "--policy", "pd", "--batch", "3") == 0
    assert (tmp_path / "a/episodes.csv").read_bytes() == (tmp_path / "b/episodes.csv").read_bytes()


def test_a_scenario_that_draws_nothing_is_flown_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "calm.json"
    path.write_text(Scenario().merged({"episode": {"duration_s": 5.0}}).to_json())
    assert _fly(path, tmp_path / "out", "--policy", "pd") == 0
    assert len(_rows(tmp_path / "out")) == 1
    assert "every seed gives the same" in capsys.readouterr().out


def test_control_period_changes_the_number_of_steps(scenario_file: Path, tmp_path: Path) -> None:
    assert _fly(scenario_file, tmp_path / "out", "--policy", "pd", "--control-period", "0.1") == 0
    assert {float(row["steps"]) for row in _rows(tmp_path / "out")} == {50.0}


def test_interrupt_keeps_finished_episodes(
    scenario_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real, calls = flight.fly, []

    def fly(*args: Any, **options: Any) -> Any:
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*args, **options)

    monkeypatch.setattr(flight, "fly", fly)
    out = tmp_path / "out"
    assert _fly(scenario_file, out, "--policy", "pd") == 130
    assert [row["seed"] for row in _rows(out)] == ["0", "1"]
    results = json.loads((out / "results.json").read_text())
    assert results["finished"] is False
    assert results["results"][0]["episodes"] == 2
    assert "interrupted after 2 finished episodes" in capsys.readouterr().err.splitlines()[-1]


def test_whom_the_others_are_compared_with_can_be_said(
    scenario_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert _fly(scenario_file, out, "--policy", "pd", "lqr", "--against", "pd") == 0
    assert "return − pd" in capsys.readouterr().out
    one, other = json.loads((out / "results.json").read_text())["results"]
    assert one["against"] is None
    assert other["against"]["policy"] == "pd"
    rows = _rows(out)
    returns = {
        name: np.array([float(row["return"]) for row in rows if row["policy"] == name]) for name in ("pd", "lqr")
    }
    assert other["against"]["difference"]["value"] == pytest.approx((returns["lqr"] - returns["pd"]).mean())
    assert _fly(scenario_file, tmp_path / "none", "--policy", "pd", "--against", "lqr") == 1
    assert "--against 'lqr' is not allowed; it must be a policy that flies" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_an_interrupt_while_episodes_are_kept_leaves_them_everywhere(
    scenario_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = files.EpisodesFile.append

    def append(self: files.EpisodesFile, scenario: str, policy: str, seeds: Any, rows: Any, drawn: Any) -> None:
        real(self, scenario, policy, seeds[:1], rows[:1], drawn[:1])
        os.kill(os.getpid(), signal.SIGTERM)
        real(self, scenario, policy, seeds[1:], rows[1:], drawn[1:])

    monkeypatch.setattr(files.EpisodesFile, "append", append)
    out = tmp_path / "out"
    assert _fly(scenario_file, out, "--policy", "pd") == 128 + signal.SIGTERM
    results = json.loads((out / "results.json").read_text())
    assert results["results"][0]["episodes"] == len(_rows(out)) == 2


def test_an_interrupt_before_anything_is_finished(
    scenario_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fly(*args: Any, **options: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(benchmark, "fly", fly)
    assert _fly(scenario_file, tmp_path / "out", "--policy", "pd") == 130
    assert json.loads((tmp_path / "out/results.json").read_text())["results"] == []


def test_policy_from_a_callable(module: types.ModuleType, scenario_file: Path, tmp_path: Path) -> None:
    assert _fly(scenario_file, tmp_path / "out", "--policy", f"{module.__name__}:still") == 0
    assert {float(row["effort"]) for row in _rows(tmp_path / "out")} == {0.0}


def test_a_policy_without_predict_is_refused(
    module: types.ModuleType, scenario_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fly(scenario_file, tmp_path / "out", "--policy", f"{module.__name__}:nothing") == 1
    assert "without predict()" in capsys.readouterr().err.splitlines()[-1]


class Raising:
    """A policy that fails in flight."""

    def predict(self, observation: Any, **others: Any) -> Any:
        raise RuntimeError("no idea")


class Bare:
    """A policy that gives its actions without a memory."""

    def predict(self, observation: Any, **others: Any) -> Any:
        return np.zeros((len(observation), 3), dtype=np.float32)


def _fail(scenario: Any) -> Any:
    raise ValueError("no such file")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda scenario: Raising(), "failed: RuntimeError: no idea"),
        (lambda scenario: Bare(), "gave a ndarray; it must give (actions, memory)"),
        (_fail, "failed to be made: ValueError: no such file"),
    ],
)
def test_a_policy_that_fails_is_named_in_one_line(
    make: Any, message: str, scenario_file: Path, tmp_path: Path, module: types.ModuleType,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    module.broken = make  # type: ignore[attr-defined]
    assert _fly(scenario_file, tmp_path / "out", "--policy", f"{module.__name__}:broken") == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert "uwoc-gym benchmark: error: policy 'uwoc_policies_of_a_test:broken'" in last
    assert message in last


def test_the_time_left_is_what_flights_of_the_same_policy_took() -> None:
    """The slow policy alone is slow, and what is flown at the same time takes no time of its own."""
    flights = [(policy, SHORT, range(50)) for _ in range(3) for policy in ("fast", "slow")]
    for jobs in (1, 4):
        left = benchmark.TimeLeft(flights)
        assert left.seconds(jobs) is None
        assert left.words(jobs) == "flying"
        left.done(flights[0], 2.0)
        assert left.seconds(jobs) == pytest.approx(5 * 2.0 / jobs)
        left.done(flights[1], 20.0)
        assert left.seconds(jobs) == pytest.approx((2 * 2.0 + 2 * 20.0) / jobs)
        assert left.words(jobs) == f"about {44 // jobs} s left"


def test_a_longer_episode_takes_longer_and_a_lone_one_little_less_than_a_batch() -> None:
    longer = SHORT.merged({"episode": {"duration_s": 50.0}})
    flights = [("pd", SHORT, range(50)), ("pd", longer, range(50)), ("pd", longer, range(1))]
    left = benchmark.TimeLeft(flights)
    share = left.done(flights[0], 11.0) / left.work
    assert left.seconds() == pytest.approx(11.0 * (1.0 / share - 1.0))
    assert left.seconds() == pytest.approx(110.0 + 110.0, rel=0.1)


def test_nothing_is_promised_before_something_has_flown(
    scenario_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fly(scenario_file, tmp_path / "out", "--policy", "pd", "nlpd") == 0
    bars = capsys.readouterr().err.split("\r")
    assert "compiling" in bars[1] or "compiling" in bars[0]
    assert not any("left" in bar for bar in bars if " 0 of 6 episodes" in bar)
    assert bars[-1].strip().endswith("done: 6 episodes")


def test_returns_over_seeds_are_drawn_as_profiles(scenario_file: Path, tmp_path: Path) -> None:
    assert _fly(scenario_file, tmp_path / "out", "--policy", "pd") == 0
    assert (tmp_path / "out/short-profile.png").read_bytes()[:4] == b"\x89PNG"


class TwoAxes:
    """A policy of surge and yaw on the newest of stacked observations."""

    def __init__(self, scenario: Scenario) -> None:
        self.inner = NLPDController("nlpd-tuned", scenario)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):  # type: ignore[no-untyped-def]
        assert observation.shape[1:] == (3, 20)
        return self.inner.predict(observation[:, -1])[0], state


def test_wrappers_that_change_shapes_are_flown(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--policy", f"{__name__}:TwoAxes", "--scenario", "Random", "--seeds", "2"]
    wrapper = ["--wrapper", "gymnasium.wrappers:FrameStackObservation,stack_size=3"]
    assert main(["benchmark", *words, *wrapper, "--override", "episode.duration_s=1"]) == 0
    assert "TwoAxes" in capsys.readouterr().out


def test_by_default_those_fly_who_can(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "--scenario", "Underactuated", "--seeds", "2", "--override", "episode.duration_s=1"]) == 0
    found = capsys.readouterr().out
    assert "| los " in found
    assert "| ppo-underactuated " in found
    assert "| ppo " not in found
    assert main(["benchmark", "--policy", "ppo", "--scenario", "Underactuated", "--seeds", "2"]) == 1
    assert "policy 'ppo' can't fly Underactuated" in capsys.readouterr().err


def test_any_number_of_processes_finds_the_same(scenario_file: Path, tmp_path: Path) -> None:
    policies = ("--policy", "pd", "ekf-nlpd", "los", "mppi", "ppo", "ppo-residual")
    for jobs in (1, 2, 3):
        short = ("--override", "episode.duration_s=2")
        assert _fly(scenario_file, tmp_path / str(jobs), *policies, *short, jobs=jobs) == 0
    first = json.loads((tmp_path / "1/results.json").read_text())
    for jobs in (2, 3):
        own = json.loads((tmp_path / f"{jobs}/results.json").read_text())
        assert own["results"] == first["results"]
        assert list(own["microseconds_a_decision"]["short"]) == list(policies[1:])
        for name in ("episodes.csv", "short.png", "short-profile.png"):
            assert (tmp_path / f"{jobs}/{name}").read_bytes() == (tmp_path / f"1/{name}").read_bytes(), name


def test_episodes_say_what_they_have_drawn(scenario_file: Path, tmp_path: Path) -> None:
    """By the single environment of the same seed; what a scenario doesn't draw, or a path doesn't have, stays empty."""
    calm = tmp_path / "deep.json"
    calm.write_text(Scenario().merged({"depth_m": (3.0, 4.0), "episode": {"duration_s": 1.0}}).to_json())
    words = ["--scenario", str(scenario_file), str(calm), "--policy", "pd", "--seeds", "6", "--jobs", "1"]
    assert main(["benchmark", *words, "--out", str(tmp_path / "out")]) == 0
    rows = _rows(tmp_path / "out")
    assert len(rows) == 12
    for row in rows:
        env = TrackingEnv(SHORT if row["scenario"] == "short" else Scenario.from_json(calm.read_text()))
        env.reset(seed=int(row["seed"]))
        drawn = env.parameters()
        own = {key.removeprefix("drawn."): cell for key, cell in row.items() if key.startswith("drawn.")}
        told = {path: cell for path, cell in own.items() if cell}
        if row["scenario"] == "deep":
            assert list(told) == ["depth_m"]
        else:
            assert own["depth_m"] == ""
            assert float(told["sea.pulses[0].force_x_n"]) == drawn["sea.pulses[0].force_x_n"]
            followed = f"ship[{float(told['ship']):.0f}]."
            assert all(path.startswith(followed) for path in told if path.startswith("ship["))
        for path, cell in told.items():
            assert cell == drawn[path] if isinstance(drawn[path], str) else float(cell) == drawn[path]
    assert len({row["drawn.vehicle.mass_scale"] for row in rows[:6]}) == 6


def test_by_default_what_is_slow_or_tuned_elsewhere_stays_at_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = benchmark.by_default("Tide")
    assert not {"mppi", "clairvoyant", "pd-plain"} & set(usual)
    assert {"pd", "nlpd-tuned", "los", "ppo"} <= set(usual)
    fast = Policy("nlpd@Tide", "", POLICIES["nlpd"].make)
    slow = Policy("mppi@Tide", "", POLICIES["nlpd"].make, slow=True)
    for policy in (fast, slow):
        monkeypatch.setitem(POLICIES, policy.name, policy)
    words = ["--seeds", "1", "--jobs", "1", "--override", "episode.duration_s=0.5", "--out", str(tmp_path)]
    assert main(["benchmark", "--scenario", "Tide", "Random", *words]) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    flown = {name: {e["policy"] for e in results["results"] if e["scenario"] == name} for name in ("Tide", "Random")}
    assert flown["Tide"] - flown["Random"] >= {"nlpd@Tide"}
    assert {name.partition("@")[2] for name in flown["Random"]} <= {"", "Random"}
    assert "mppi@Tide" not in flown["Tide"]
    # Whoever is named flies anywhere.
    assert main(["benchmark", "--scenario", "Random", "--policy", "nlpd@Tide", "mppi@Tide", *words]) == 0


def test_the_way_is_told_where_the_yardstick_flies(scenario_file: Path, tmp_path: Path) -> None:
    words = ("--policy", "pd", "nlpd-tuned", "clairvoyant", "--override", "episode.duration_s=3")
    assert _fly(scenario_file, tmp_path, *words) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    means = {name: np.mean([float(row["return"]) for row in _rows(tmp_path) if row["policy"] == name])
             for name in words[1:4]}  # fmt: skip
    pd = results["results"][0]
    assert means["clairvoyant"] > means["nlpd-tuned"]
    share = (means["pd"] - means["nlpd-tuned"]) / (means["clairvoyant"] - means["nlpd-tuned"])
    assert pd["way"]["share"]["value"] == pytest.approx(share)
    assert "| way to clairvoyant" in (tmp_path / "table.md").read_text()
    taken = results["microseconds_a_decision"]["short"]
    assert taken["clairvoyant"] > 3.0 * taken["pd"] > 0.0


def test_a_policy_that_fails_in_another_process_is_named(
    scenario_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fly(scenario_file, tmp_path / "out", "--policy", "pd", f"{__name__}:raising", jobs=2) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f"uwoc-gym benchmark: error: policy '{__name__}:raising' failed: RuntimeError: no idea"


def raising(scenario: Any) -> Any:
    return Raising() if multiprocessing.parent_process() else NLPDController(scenario=scenario)


@pytest.mark.parametrize("jobs", ["0", "257", "two", "1.5"])
def test_jobs_are_a_whole_number(jobs: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "--jobs", jobs]) == 2
    error = capsys.readouterr().err
    assert f"argument --jobs: '{jobs}' is not allowed; it must be a whole number from 1 to 256." in error
