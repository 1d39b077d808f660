"""The command line from end to end, in short scenarios."""

from __future__ import annotations

import csv
import json
import math
import re
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym import ENV_IDS, Scenario
from uwoc_gym.agents import flight as evaluate
from uwoc_gym.agents.cli import COMMANDS, main
from uwoc_gym.agents.commands import benchmark
from uwoc_gym.agents.options import CommandError
from uwoc_gym.agents.reports import tables as report

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 5.0}})


class Still:
    """A policy that does nothing and remembers how often it was asked."""

    def __init__(self) -> None:
        self.calls = 0

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        self.calls += 1
        return np.zeros((len(observation), 3), dtype=np.float32), state


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    path = tmp_path / "short.json"
    path.write_text(SHORT.to_json())
    return path


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    made = types.ModuleType("uwoc_policies_of_a_test")
    made.still = lambda scenario: Still()  # type: ignore[attr-defined]
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

    def fly(*args: Any) -> Any:
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*args)

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
    def fly(*args: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(benchmark, "fly", fly)
    assert _fly(scenario_file, tmp_path / "out", "--policy", "pd") == 130
    assert json.loads((tmp_path / "out/results.json").read_text())["results"] == []


def test_policy_from_a_callable(module: types.ModuleType, scenario_file: Path, tmp_path: Path) -> None:
    assert _fly(scenario_file, tmp_path / "out", "--policy", f"{module.__name__}:still") == 0
    assert {float(row["effort"]) for row in _rows(tmp_path / "out")} == {0.0}


def test_a_lost_episode_ends_alone() -> None:
    far = Scenario().merged({"start": {"x_m": -9.0, "y_m": (-4.0, 9.0)}, "episode": {"duration_s": 30.0}})
    policy = evaluate.Policy("still", "", lambda scenario: Still())
    flight = evaluate.fly(policy, far, range(8))
    lost, steps = flight.metrics.lost, flight.metrics.steps
    assert 0 < lost.sum() < 8
    assert ((steps < 600) == (lost > 0)).all()
    for i in range(8):
        alone = evaluate.fly(policy, far, [i]).metrics.rows()[0]
        assert list(alone.values()) == pytest.approx(list(flight.metrics.rows()[i].values()), nan_ok=True, abs=0.0)


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
        policy = evaluate.load(str(path))
        assert kind in policy.description
        observations = np.random.default_rng(0).normal(size=(3, 20)).astype(np.float32)
        plain = policy.make(SHORT).predict(observations, deterministic=True)[0]
        assert plain == pytest.approx(model.predict(observations, deterministic=True)[0], abs=1e-6)
        env.obs_rms.mean += 0.5
        env.save(str(tmp_path / "vecnormalize.pkl"))
        normalised = evaluate.load(str(path)).make(SHORT).predict(observations, deterministic=True)[0]
        wanted = model.predict(env.normalize_obs(observations), deterministic=True)[0]
        assert normalised == pytest.approx(wanted, abs=1e-6)
        assert evaluate.fly(policy, SHORT, [0, 1]).metrics.steps.tolist() == [100.0, 100.0]
        (tmp_path / "vecnormalize.pkl").unlink()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["benchmark", "--policy", "nlpdd"], ["--policy", "did you mean 'nlpd'?"]),
        (["benchmark", "--policy", "no_such_module:thing"], ["--policy", "can't be imported"]),
        (["benchmark", "--policy", "missing.zip"], ["--policy", "no such file"]),
        (["benchmark", "--policy", __file__], ["--policy", "not a zip file saved by Stable-Baselines3"]),
        (["benchmark", "--scenario", "Nominl"], ["--scenario", "did you mean 'Nominal'?"]),
        (["benchmark", "--scenario", "missing.json"], ["--scenario", "missing.json"]),
        (["benchmark", "--scenario", __file__], ["--scenario", "JSON"]),
        (["benchmark", "--seeds", "0"], ["--seeds", "'0'", "at least 1"]),
        (["benchmark", "--seeds", "many"], ["--seeds", "'many'"]),
        (["benchmark", "--seed", "-1"], ["--seed"]),
        (["benchmark", "--control-period", "0"], ["--control-period", "above 0"]),
        (["benchmark", "--control-period", "0.007"], ["--control-period", "multiple"]),
        (["benchmark", "--out", f"{__file__}/out"], ["--out", "folder"]),
        (["speed", "--rounds", "0"], ["--rounds", "at least 1"]),
        (["speed", "--out", __file__], ["--out", "folder"]),
        (["nonsense"], ["nonsense"]),
        ([], ["COMMAND"]),
    ],
)
def test_errors_are_one_line(options: list[str], words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(options) not in (0, 130)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    for word in words:
        assert word in captured.err


def test_a_policy_without_predict_is_refused(
    module: types.ModuleType, scenario_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fly(scenario_file, tmp_path / "out", "--policy", f"{module.__name__}:nothing") == 1
    assert "without predict()" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(("missing", "extra"), [("matplotlib", "benchmark"), ("tqdm", "benchmark")])
def test_a_missing_extra_is_named(
    missing: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import importlib.util

    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else real(name))
    assert main(["benchmark", "--out", str(tmp_path)]) == 1
    assert f'pip install "uwoc-gym[{extra}]"' in capsys.readouterr().err


def test_actions_of_another_shape_are_refused() -> None:
    class Wrong(Still):
        def predict(self, observation: Any, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
            return np.zeros(3, dtype=np.float32), None

    with pytest.raises(CommandError, match=r"shape \(3,\)"):
        evaluate.fly(evaluate.Policy("wrong", "", lambda scenario: Wrong()), SHORT, [0, 1])


def test_list_names_everything(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    for name in (*ENV_IDS, *ENV_IDS.values(), *evaluate.POLICIES):
        assert name in text


@pytest.mark.parametrize("options", [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)])
def test_help_and_version(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(options) == 0
    assert "uwoc-gym" in capsys.readouterr().out


def test_speed_reports_ratios(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--rounds", "1", "--time", "0.01", "--sizes", "1", "4", "--fleet", "64", "--out", str(tmp_path)]
    assert main(["speed", *options]) == 0
    assert "uwoc/Random-v0" in capsys.readouterr().out
    results = json.loads((tmp_path / "results.json").read_text())
    assert len(results["rates"]) == 4
    for row in results["rates"]:
        assert row["ratio"] == pytest.approx(row["steps_per_s"] / row["reference_steps_per_s"])
    assert results["memory"]["state_bytes"] > 0
    assert results["scenarios"] == {name: Scenario.named(name).digest() for name in ("Nominal", "Random")}


def test_speed_counts_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pygame")
    assert main(["speed", "--render", "--rounds", "1", "--time", "0.1", "--out", str(tmp_path)]) == 0
    assert "pictures of 1280x720 per second" in capsys.readouterr().out
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["pictures_per_s"] > 0
    assert results["scenarios"] == {"StrongPulse": Scenario.named("StrongPulse").digest()}


def test_the_benchmark_counts_what_says_never() -> None:
    measures = {measure.key: 1.0 for measure in report.MEASURES}
    rows = [
        measures | {"arrival_time_s": math.nan, "restoring_time_s": math.nan},
        measures | {"arrival_time_s": 2.0, "restoring_time_s": math.inf},
        measures | {"arrival_time_s": 2.0, "restoring_time_s": 0.25},
    ]
    (found,) = report.results_data([report.Result("Random", "pd", rows, False)], 0)
    counts = {key: (entry["values"], entry["never"], entry["episodes"]) for key, entry in found["measures"].items()}
    assert counts["arrival_time_s"] == (2, 1, 3)
    assert counts["restoring_time_s"] == (1, 1, 3)
    assert counts["return"] == (3, 0, 3)
    lines = {
        line.split("|")[1].strip(): line.split("|")[2].strip()
        for line in report.table([found]).split("\n")
        if "|" in line
    }
    assert lines["t_a [s]"] == "2.00 (1 of 3 never)"
    assert lines["Δt [s]"] == "0.25 (2 of 3, 1 of them never)"


def test_evaluate_writes_what_it_prints(
    scenario_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--scenario", str(scenario_file), "--seed", "7", "--seeds", "2", "--out", str(tmp_path / "out")]
    assert main(["evaluate", "nlpd", *options]) == 0
    results = json.loads((tmp_path / "out/results.json").read_text())
    assert [row["seed"] for row in results["episodes"]] == [7, 8]
    assert results["scenarios"] == {"short": SHORT.digest()}
    mean = results["results"][0]["measures"]["return"]["mean"]
    assert mean == pytest.approx(np.mean([row["return"] for row in results["episodes"]]))
    assert f"{mean:.1f} [" in capsys.readouterr().out
    assert main(["evaluate", "nlpdd"]) == 1
    assert "did you mean 'nlpd'?" in capsys.readouterr().err


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


def test_only_one_function_writes_results() -> None:
    # It asks for the scenarios, so that none is spoken of without its digest.
    sources = Path(report.__file__).parents[1].rglob("*.py")
    writers = [path.name for path in sources if re.search(r"write_\w+\([^)]*results\.json", path.read_text("utf-8"))]
    assert writers == ["tables.py"]


def test_readmes_tables_are_whole() -> None:
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    assert "@@" not in text
    blocks = [[line for line in block.splitlines() if line.startswith("|")] for block in text.split("\n\n")]
    tables = [block for block in blocks if len(block) > 1]
    assert len(tables) >= 6
    for table in tables:
        assert len({line.count("|") for line in table}) == 1, table[0]
