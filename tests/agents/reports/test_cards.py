"""The cards beside the shipped agents say what stands in the results, and what flights still come to."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from uwoc_gym import ENV_IDS, Scenario
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
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
