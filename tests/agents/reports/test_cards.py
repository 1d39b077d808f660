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
from uwoc_gym.agents.reports import cards, files, tables
from uwoc_gym.baselines.controllers import CONTROLLERS
from uwoc_gym.given import SettingError

NAMES = ("ppo", "ppo-residual", "td3", "ppo-underactuated", "ppo-tide", "ppo-latefix")
SCORES = files.read_json(cards.SCORES)
SLOW = ["Underactuated", "Tide", "LateFix"]
"""Where slow policies are shown."""


def interface(scenario: Scenario) -> tuple[object, str]:
    return scenario.observation, scenario.action


def able(policy: str, scenario: str) -> bool:
    """Whether a controller can fly a scenario."""
    try:
        CONTROLLERS[policy].pilot(Scenario.named(scenario))
    except SettingError:
        return False
    return True


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
        world = policy.partition("@")[2]
        flown = (
            [world] if world else SLOW if CONTROLLERS[policy].slow else [name for name in names if able(policy, name)]
        )
        assert list(entries(SCORES, policy)) == flown, policy
    # Agents fly where there are the observations and actions that they were trained for.
    for policy in NAMES:
        home = Scenario.named(ENV_IDS[archive.read(TRAINED / policy / "model.zip").env])
        alike = [name for name in names if interface(Scenario.named(name)) == interface(home)]
        assert list(entries(SCORES, policy)) == alike


@pytest.mark.parametrize("name", NAMES)
def test_flown_again_an_agent_scores_what_its_card_says(name: str) -> None:
    said = entries(SCORES, name)
    home = ENV_IDS[archive.read(TRAINED / name / "model.zip").env]
    card = (TRAINED / name / cards.CARD).read_text(encoding="utf-8")
    if "StrongPulse" in said:
        (one,) = fly(POLICIES[name], Scenario.named("StrongPulse"), [0]).metrics.rows()
        found = said["StrongPulse"]["measures"]["return"]["mean"]
        assert one["return"] == pytest.approx(found, abs=0.5)
        assert f"{found:.1f}" in card
    few = fly(POLICIES[name], Scenario.named(home), range(40)).metrics.return_
    summary = said[home]["measures"]["return"]
    # The error of a mean over 40 of 200 seeds is 2.2 times that over all of them.
    assert abs(few.mean() - summary["mean"]) < 2.5 * (summary["high"] - summary["low"]) / 2.0
    assert f"{summary['mean']:.1f} [{summary['low']:.1f}, {summary['high']:.1f}]" in card


@pytest.mark.parametrize("name", NAMES)
def test_a_cards_code_runs(name: str) -> None:
    card = (TRAINED / name / cards.CARD).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    assert len(blocks) == (2 if name in ("ppo", "td3") else 1)
    for block in blocks:
        printed = subprocess.check_output([sys.executable, "-c", block], text=True, timeout=600)
        # Of at most 1200, the mean of eight or one episode; in the tide some ships can't be kept up with.
        assert 600.0 < float(printed) < 1200.0


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


def a_benchmark(folder: Path, flights: dict[tuple[str, str], list[float]], **changes: Any) -> Path:
    """A folder as a benchmark leaves it, with episodes of such returns."""
    folder.mkdir()
    names = list(dict.fromkeys(scenario for scenario, _ in flights))
    entries = [
        {"scenario": scenario, "policy": policy, "episodes": len(own), "one_episode_stands_for_all_seeds": False}
        for (scenario, policy), own in flights.items()
    ]
    head = {
        "command": f"uwoc-gym benchmark --out {folder.name}",
        "versions": SCORES["versions"],
        "scenarios": {name: Scenario.named(name).digest() for name in names},
        "results": entries,
        "settings": {"seeds": list(range(200)), "policies": [], "wrappers": []},
        "finished": True,
    }
    (folder / files.RESULTS).write_text(json.dumps(head | changes))
    with files.EpisodesFile(folder / files.EPISODES, ["sea.current.speed_mps"]) as file:
        for (scenario, policy), own in flights.items():
            rows = [dict.fromkeys((measure.key for measure in tables.MEASURES), 0.0) | {"return": each} for each in own]
            drawn = [{"sea.current.speed_mps": 0.5}] * len(own)
            file.append(scenario, policy, range(len(own)), rows, drawn)
    return folder


ALL = {(name, "nlpd-tuned"): [1.0, 2.0, 3.0] for name in ENV_IDS.values()}


def test_benchmarks_are_taken_together(tmp_path: Path) -> None:
    usual = a_benchmark(tmp_path / "usual", ALL)
    slow = a_benchmark(tmp_path / "slow", {("Tide", "clairvoyant"): [3.0, 4.0, 5.0], ("Tide", "mppi"): [2.0, 3.0, 4.0]})
    found = cards.read([usual, slow / files.RESULTS])
    assert found["commands"] == ["uwoc-gym benchmark --out usual", "uwoc-gym benchmark --out slow"]
    tide = {entry["policy"]: entry for entry in found["results"] if entry["scenario"] == "Tide"}
    assert list(tide) == ["nlpd-tuned", "mppi", "clairvoyant"]
    assert tide["mppi"]["against"]["difference"]["value"] == 1.0
    assert tide["mppi"]["way"]["share"]["value"] == pytest.approx(0.5)
    assert tide["clairvoyant"]["measures"]["return"]["mean"] == pytest.approx(4.0)
    assert [entry["scenario"] for entry in found["results"] if entry["policy"] == "nlpd-tuned"] == [*ENV_IDS.values()]


def test_a_benchmark_that_was_flown_twice_or_in_part_is_refused(tmp_path: Path) -> None:
    usual = a_benchmark(tmp_path / "usual", ALL)
    again = a_benchmark(tmp_path / "again", {("Tide", "nlpd-tuned"): [1.0]})
    with pytest.raises(CommandError, match="has nlpd-tuned in Tide, which others of the results have too"):
        cards.read([usual, again])
    with pytest.raises(CommandError, match=r"fewer scenarios than the IDs': .*Nominal.* are missing"):
        cards.read([again])
    path = usual / files.EPISODES
    whole = path.read_text()
    path.write_text(whole.rpartition("LateFix")[0])
    with pytest.raises(CommandError, match="lacks episodes of nlpd-tuned in LateFix"):
        cards.read([usual])
    path.write_text(whole.replace("2.0", "two", 1))
    with pytest.raises(CommandError, match=r"episodes.csv' is not allowed; line 3 isn't an episode"):
        cards.read([usual])
    path.write_text("a,b\n1,2\n")
    with pytest.raises(CommandError, match=r"it must be the episodes.csv of uwoc-gym benchmark"):
        cards.read([usual])
    path.unlink()
    with pytest.raises(CommandError, match=r"episodes.csv' can't be read"):
        cards.read([usual])


GOOD: dict[str, Any] = {
    "command": "uwoc-gym benchmark",
    "versions": {},
    "scenarios": {},
    "results": [],
    "settings": {"seeds": list(range(200)), "policies": [], "wrappers": []},
    "finished": True,
}


def without(key: str) -> dict[str, Any]:
    return {name: value for name, value in GOOD.items() if name != key}


def with_settings(**changes: Any) -> dict[str, Any]:
    return GOOD | {"settings": GOOD["settings"] | changes}


@pytest.mark.parametrize(
    ("results", "words"),
    [
        ({}, "must be the results of uwoc-gym benchmark"),
        ([1], "must be the results of uwoc-gym benchmark"),
        (without("settings"), "must be the results of uwoc-gym benchmark"),
        (GOOD | {"results": {"Random": {}}}, "must be the results of uwoc-gym benchmark"),
        (GOOD | {"results": [{"scenario": "Random"}]}, "must be the results of uwoc-gym benchmark"),
        (GOOD | {"settings": {"policy": "pd", "seeds": [0]}}, "must be the results of uwoc-gym benchmark"),
        (GOOD | {"finished": False}, "is of a benchmark that was interrupted; cards are of all held-out seeds"),
        (with_settings(wrappers=[{"name": "a:b", "options": {}}]), "is of flights in wrappers; "),
        (with_settings(seeds=list(range(20))), "is of other seeds than 0 to 199; "),
        (GOOD | {"scenarios": {"Random": "0" * 16}}, "is of other scenarios than the IDs' own; "),
        (GOOD, "is of fewer scenarios than the IDs': "),
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


def test_cards_are_of_what_is_held_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cards.SEEDS == HELD_OUT
    assert cards.main([]) == 2
    assert capsys.readouterr().err.count("usage: ") == 1
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


def test_a_card_says_what_filters_add_and_where_it_was_trained(monkeypatch: pytest.MonkeyPatch) -> None:
    said = replace(archive.read(TRAINED / "ppo/model.zip"), beliefs=["water"], env="uwoc/LateFix-v0")
    monkeypatch.setattr(archive, "read", lambda model: said)
    trained = files.read_json(TRAINED / "ppo/results.json")
    text = cards.card("ppo", "An agent", trained, SCORES, TRAINED / "ppo/model.zip")
    assert "zeros before the first with what filters believe behind each of them." in text
    assert "is nothing without the filters that it stands behind" in text
    assert 'gym.make("uwoc_gym:uwoc/LateFix-v0")' in text
    assert "the 16 observations and 3 actions" in text
    assert "--policy ppo nlpd-tuned --scenario LateFix`" in text


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
