"""Teaching a tracker from end to end."""

from __future__ import annotations

import json
import os
import signal
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from uwoc_gym.agents.cli import main
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import tracking
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION
from uwoc_gym.baselines import Controller
from uwoc_gym.baselines.learned_tracker import LearnedTracker
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.scenario import Scenario

SHORT = '{"episode": {"duration_s": 8.0}}'
SMALL = ["--override", SHORT, "--episodes", "6", "--steps", "8", "--units", "4", "--eval-episodes", "3"]


def test_what_is_learned_flies_as_it_is_said_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "tracker"
    assert main(["tracker", *SMALL, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    results = json.loads((out / "results.json").read_text())
    assert results["finished"] is True
    assert results["steps"] == 8
    assert set(results["results"]) == {"three models", "learned"}
    scenario = Scenario.named("LateFix").merged(json.loads(SHORT))
    law = Policy(
        "own", "", partial(Controller, "nlpd-tuned", filtered=partial(LearnedTracker, weights=out / "tracker.npz"))
    )
    flown = fly(law, scenario, ALL_VALIDATION[:3]).metrics.return_.mean()
    assert results["results"]["learned"]["return"] == pytest.approx(float(flown), abs=1e-9)
    assert f"return {results['results']['learned']['return']:.1f}" in said
    assert main(["tracker", *SMALL, "--out", str(out)]) == 1
    assert "is not empty; give another folder" in capsys.readouterr().err


def test_a_ship_that_is_seen_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tracker", "--scenario", "Random", "--out", str(tmp_path / "none")]) == 1
    assert "the ship must be known by 'fix' alone" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "results.json").write_text("of a training")
    assert main(["tracker", *SMALL, "--out", str(tmp_path)]) == 1
    assert "is not empty; give another folder" in capsys.readouterr().err
    assert [each.name for each in tmp_path.iterdir()] == ["results.json"]


def test_episodes_that_are_too_short_to_score_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = ["--override", "episode.duration_s=3", "--episodes", "2", "--steps", "1"]
    assert main(["tracker", *short, "--out", str(tmp_path / "none")]) == 1
    assert "episode.duration_s = 3 is not allowed; it must be above 3 s" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_more_validation_than_there_is_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tracker", "--eval-episodes", "100001", "--out", str(tmp_path / "none")]) == 2
    assert "from 1 to 100_000" in capsys.readouterr().err


def test_what_is_learned_stands_where_the_judging_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(tracking, "errors", stopped)
    out = tmp_path / "tracker"
    assert main(["tracker", *SMALL, "--out", str(out)]) == 130
    results = json.loads((out / "results.json").read_text())
    assert (results["finished"], results["results"]) == (True, {})
    assert (out / "tracker.npz").is_file()


def test_what_is_stopped_keeps_what_it_has_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = tracking.learn

    def stopped(*arguments: Any) -> Any:
        for step, found in enumerate(real(*arguments)):
            if step == 3:
                os.kill(os.getpid(), signal.SIGINT)
            yield found

    monkeypatch.setattr(tracking, "learn", stopped)
    out = tmp_path / "tracker"
    assert main(["tracker", *SMALL, "--out", str(out)]) == 130
    results = json.loads((out / "results.json").read_text())
    assert (results["finished"], results["steps"]) == (False, 4)
    assert "interrupted after 4 steps of 8" in capsys.readouterr().err
    assert (out / "tracker.npz").is_file()
