"""The cards beside the shipped agents say what stands in the results, and what flights still come to."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from uwoc_gym import ENV_IDS, Scenario
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning.seeds import HELD_OUT
from uwoc_gym.agents.policies import archive
from uwoc_gym.agents.policies.registry import POLICIES, TRAINED
from uwoc_gym.agents.reports import cards, files
from uwoc_gym.baselines.controllers import CONTROLLERS

NAMES = ("ppo", "ppo-residual", "td3")
SCORES = files.read_json(cards.SCORES)


def entries(scores: dict[str, Any], policy: str) -> dict[str, dict[str, Any]]:
    return {entry["scenario"]: entry for entry in scores["results"] if entry["policy"] == policy}


def test_the_cards_are_what_the_scores_make_them(tmp_path: Path) -> None:
    for name in NAMES:
        shutil.copytree(TRAINED / name, tmp_path / name)
        (tmp_path / name / cards.CARD).unlink()
    cards.write(SCORES, tmp_path)
    assert files.read_json(tmp_path / cards.SCORES.name) == SCORES
    for name in NAMES:
        assert (tmp_path / name / cards.CARD).read_bytes() == (TRAINED / name / cards.CARD).read_bytes()


def test_the_scores_are_of_todays_scenarios_and_of_all_ids() -> None:
    names = [env_id.removeprefix("uwoc/").removesuffix("-v0") for env_id in ENV_IDS]
    assert SCORES["scenarios"] == {name: Scenario.named(name).digest() for name in names}
    for policy in CONTROLLERS.keys() - {"pd-plain"}:
        assert list(entries(SCORES, policy)) == names
    # Agents can't fly where there is no sway force to command, or no sight of the ship.
    for policy in NAMES:
        assert list(entries(SCORES, policy)) == [name for name in names if name not in ("Underactuated", "LateFix")]


@pytest.mark.parametrize("name", NAMES)
def test_flown_again_an_agent_scores_what_its_card_says(name: str) -> None:
    said = entries(SCORES, name)
    card = (TRAINED / name / cards.CARD).read_text(encoding="utf-8")
    (one,) = fly(POLICIES[name], Scenario.named("StrongPulse"), [0]).metrics.rows()
    found = said["StrongPulse"]["measures"]["return"]["mean"]
    assert one["return"] == pytest.approx(found, abs=0.5)
    assert f"{found:.1f}" in card
    few = fly(POLICIES[name], Scenario.named("Random"), range(40)).metrics.return_
    summary = said["Random"]["measures"]["return"]
    # The error of a mean over 40 of 200 seeds is 2.2 times that over all of them.
    assert abs(few.mean() - summary["mean"]) < 2.5 * (summary["high"] - summary["low"]) / 2.0
    assert f"{summary['mean']:.1f} [{summary['low']:.1f}, {summary['high']:.1f}]" in card


@pytest.mark.parametrize("name", NAMES)
def test_a_cards_code_runs(name: str) -> None:
    card = (TRAINED / name / cards.CARD).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    assert len(blocks) == (1 if name == "ppo-residual" else 2)
    for block in blocks:
        printed = subprocess.check_output([sys.executable, "-c", block], text=True, timeout=600)
        # Of at most 1200, the mean of eight or one episode.
        assert 1000.0 < float(printed) < 1200.0


def an_entry(scenario: str, policy: str, value: float, low: float | None, high: float | None) -> dict[str, Any]:
    difference = {"value": value, "low": low, "high": high}
    return {"scenario": scenario, "policy": policy, "against": {"difference": difference}}


def test_ahead_is_only_what_an_interval_says() -> None:
    each = [("A", 1.0, 0.5, 1.5), ("B", 1.0, -0.5, 2.5), ("C", -1.0, -1.5, -0.5), ("D", 1.0, None, None)]
    scores = {"results": [an_entry(name, "ppo", *numbers) for name, *numbers in each]}  # type: ignore[arg-type]
    assert cards.standings(scores, "ppo") == {"ahead": ["A", "D"], "even": ["B"], "behind": ["C"]}


def test_results_that_lack_an_agent_are_refused(tmp_path: Path) -> None:
    for name in NAMES:
        shutil.copytree(TRAINED / name, tmp_path / name)
    less = SCORES | {"results": [entry for entry in SCORES["results"] if entry["policy"] != "td3"]}
    before = (tmp_path / "ppo" / cards.CARD).read_bytes()
    with pytest.raises(CommandError, match="td3"):
        cards.write(less, tmp_path)
    assert not (tmp_path / cards.SCORES.name).exists()
    assert (tmp_path / "ppo" / cards.CARD).read_bytes() == before


BENCHMARK = SCORES | {"finished": True, "settings": {"seeds": list(range(200)), "policies": [], "wrappers": []}}


def without(key: str) -> dict[str, Any]:
    return {name: value for name, value in BENCHMARK.items() if name != key}


def with_settings(**changes: Any) -> dict[str, Any]:
    return BENCHMARK | {"settings": BENCHMARK["settings"] | changes}


@pytest.mark.parametrize(
    ("results", "words"),
    [
        ({}, "must be the results.json of uwoc-gym benchmark"),
        ([1], "must be the results.json of uwoc-gym benchmark"),
        (without("settings"), "must be the results.json of uwoc-gym benchmark"),
        (BENCHMARK | {"results": {"Random": {}}}, "must be the results.json of uwoc-gym benchmark"),
        (BENCHMARK | {"results": [{"scenario": "Random"}]}, "must be the results.json of uwoc-gym benchmark"),
        (BENCHMARK | {"settings": {"policy": "pd", "seeds": [0]}}, "must be the results.json of uwoc-gym benchmark"),
        (BENCHMARK | {"finished": False}, "is of a benchmark that was interrupted; cards are of all held-out seeds"),
        (with_settings(wrappers=[{"name": "a:b", "options": {}}]), "is of flights in wrappers; "),
        (with_settings(seeds=list(range(20))), "is of other seeds than 0 to 199; "),
        (BENCHMARK | {"scenarios": {"Random": "0" * 16}}, "is of other scenarios than the IDs' own, all of them; "),
        (BENCHMARK | {"results": []}, "the results lack nlpd-tuned, ppo, ppo-residual, td3; "),
    ],
)
def test_what_cards_cannot_be_written_from_is_refused_in_one_line(
    results: Any, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "results.json"
    path.write_text(json.dumps(results))
    before = {name: (TRAINED / name / cards.CARD).stat().st_mtime_ns for name in NAMES}
    assert cards.main([str(path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("cards: ")
    assert words in line
    assert {name: (TRAINED / name / cards.CARD).stat().st_mtime_ns for name in NAMES} == before


def test_a_benchmark_of_everything_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "results.json"
    path.write_text(json.dumps(BENCHMARK))
    assert cards.kept(cards.read(path)) == SCORES
    assert cards.SEEDS == HELD_OUT
    assert cards.main([]) == cards.main(["a", "b"]) == 2
    assert capsys.readouterr().err.count("usage: ") == 2
    assert cards.main([str(tmp_path / "none.json")]) == 1


@pytest.mark.parametrize(
    ("residual", "words"),
    [
        ({"gains": {}, "scale": 0.5}, "corrects a controller whose gains are in its file."),
        ({"agent": "agent.zip", "scale": 0.5}, "corrects another agent, which is in its file."),
        ({"policy": "ppo", "scale": 0.5}, "corrects `ppo`."),
    ],
)
def test_a_card_says_what_is_corrected(residual: dict[str, Any], words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    said = replace(archive.read(TRAINED / "ppo/model.zip"), residual=residual)
    monkeypatch.setattr(archive, "read", lambda model: said)
    trained = files.read_json(TRAINED / "ppo/results.json")
    text = cards.card("ppo", "An agent", trained, SCORES, TRAINED / "ppo/model.zip")
    assert words in text
    assert "gains are in its file" not in text or "gains" in residual


def test_a_card_of_one_observation_stacks_none(monkeypatch: pytest.MonkeyPatch) -> None:
    said = replace(archive.read(TRAINED / "ppo/model.zip"), frame_stack=1, algorithm="tqc")
    monkeypatch.setattr(archive, "read", lambda model: said)
    trained = files.read_json(TRAINED / "ppo/results.json")
    text = cards.card("ppo", "An agent", trained, SCORES, TRAINED / "ppo/model.zip")
    assert "It sees one observation." in text
    assert "`TQC.load` of Stable-Baselines3 gives the network:" in text
    assert "from sb3_contrib import TQC" in text
    assert "VecFrameStack" not in text
    assert "fails" not in text
