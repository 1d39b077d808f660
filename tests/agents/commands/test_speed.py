"""The measurement of speed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main


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


def test_speed_of_the_first_use(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["speed", "--cold", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    results = json.loads((tmp_path / "results.json").read_text())
    times = results["cpu_s"]
    assert times["single, cold"] > 3.0 * times["single, cached"] > 0.0
    assert 0.0 < times["vector, cold"] < times["single, cold"]
    compiled = results["parts_s"]
    assert {"uwoc_gym.sim.paper", "uwoc_gym.world.ship.paths", "uwoc_gym.task.reward"} <= set(compiled)
    assert sum(compiled.values()) == pytest.approx(times["single, cold"] + times["vector, cold"], rel=0.25)
    assert all(f"{value:.2f}" in said for value in compiled.values())
