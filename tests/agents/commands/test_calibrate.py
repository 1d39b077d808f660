"""Calibrating from end to end."""

from __future__ import annotations

import json

from uwoc_gym.agents.cli import main
from uwoc_gym.agents.learning import calibration


def test_case_search_writes_a_scenario_that_flies(tmp_path, monkeypatch):
    monkeypatch.setattr(calibration, "CASE_DURATION_S", 33.0)
    monkeypatch.setattr(calibration, "WINDOWS", ((float("nan"), 32.0), (30.0, 32.5)))
    out = tmp_path / "case"
    assert main(["calibrate", "case-2", "--trials", "4", "--batch", "2", "--out", str(out)]) == 0
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert results["trials"] == 4
    assert results["scenarios"] == {
        name: scenario.digest() for name, scenario in calibration.case_problem("case-2", "found").scenarios.items()
    }
    assert main(["benchmark", "--policy", "pd", "--scenario", str(out / "scenario.json"), "--seeds", "1"]) == 0
