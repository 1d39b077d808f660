"""The benchmark from end to end, in short scenarios."""

from __future__ import annotations

import csv
import json
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.commands import benchmark
from uwoc_gym.baselines import NLPDController

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


def _fly(scenario: Path, out: Path, *more: str) -> int:
    return main(["benchmark", "--scenario", str(scenario), "--seeds", "3", "--batch", "2", "--out", str(out), *more])


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
    real, calls = benchmark.fly, []

    def fly(*args: Any, **options: Any) -> Any:
        calls.append(args)
        # The first flight only warms up.
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*args, **options)

    monkeypatch.setattr(benchmark, "fly", fly)
    out = tmp_path / "out"
    assert _fly(scenario_file, out, "--policy", "pd") == 130
    assert [row["seed"] for row in _rows(out)] == ["0", "1"]
    results = json.loads((out / "results.json").read_text())
    assert results["finished"] is False
    assert results["results"][0]["episodes"] == 2
    assert "interrupted after 2 finished episodes" in capsys.readouterr().err.splitlines()[-1]


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
    """A minute of compiling before them says nothing, and the slow policy alone is slow."""
    clock = iter([0.0, 60.0, 62.0, 82.0]).__next__
    scenario = SHORT
    flights = [(policy, scenario, range(50)) for _ in range(3) for policy in ("fast", "slow")]
    left = benchmark.TimeLeft(flights, clock)
    left.begin()
    assert left.seconds() is None
    assert left.words() == "flying"
    left.done()
    assert left.seconds() == pytest.approx(5 * 2.0)
    left.done()
    assert left.seconds() == pytest.approx(2 * 2.0 + 2 * 20.0)
    assert left.words() == "about 44 s left"


def test_a_longer_episode_takes_longer_and_a_lone_one_little_less_than_a_batch() -> None:
    clock = iter([0.0, 0.0, 11.0]).__next__
    longer = SHORT.merged({"episode": {"duration_s": 50.0}})
    left = benchmark.TimeLeft([("pd", SHORT, range(50)), ("pd", longer, range(50)), ("pd", longer, range(1))], clock)
    left.begin()
    share = left.done() / left.work
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
    assert "ppo" not in found
    assert main(["benchmark", "--policy", "ppo", "--scenario", "Underactuated", "--seeds", "2"]) == 1
    assert "policy 'ppo' can't fly Underactuated" in capsys.readouterr().err
