"""Saying a scenario: by name, ID or file, with changes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from uwoc_gym import Pulse, Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning.plans import Wish, planned
from uwoc_gym.agents.scenarios import said

RANDOM = Scenario.named("Random")
SHORT = {"episode": {"duration_s": 5.0}}


def _file(folder: Path, data: Any, name: str = "mine.json") -> str:
    path = folder / name
    path.write_text(json.dumps(data))
    return str(path)


def test_by_name_id_and_whole_file(tmp_path: Path) -> None:
    assert said("Random") == said("uwoc/Random-v0") == ("Random", "Random", (), RANDOM)
    assert said(_file(tmp_path, RANDOM.to_dict())) == ("mine", None, (), RANDOM)


def test_a_file_says_what_it_changes(tmp_path: Path) -> None:
    for base in ("Random", "uwoc/Random-v0"):
        found = said(_file(tmp_path, {"base": base, **SHORT}))
        assert found == ("mine", "Random", (SHORT,), RANDOM.merged(SHORT))


def test_overrides_go_over_all_of_them(tmp_path: Path) -> None:
    deep = {"depth_m": 3.7}
    wanted = RANDOM.merged(SHORT).merged(deep)
    for override in (json.dumps(deep), _file(tmp_path, deep, "deep.json")):
        assert said("Random", override).scenario == RANDOM.merged(deep)
        assert said(_file(tmp_path, {"base": "Random", **SHORT}), override).scenario == wanted
        assert said(_file(tmp_path, RANDOM.merged(SHORT).to_dict()), override).scenario == wanted


def test_whole_files_of_earlier_versions_are_read(tmp_path: Path) -> None:
    earlier = RANDOM.to_dict()
    del earlier["action"], earlier["observation"]["groups"]
    assert said(_file(tmp_path, earlier)).scenario == RANDOM


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (SHORT, ["leaves out link, vehicle", '"base"', "--override"]),
        ({}, ["leaves out link", '"base"']),
        ({key: value for key, value in RANDOM.to_dict().items() if key != "sea"}, ["leaves out sea;"]),
        (
            {**RANDOM.to_dict(), "vehicle": {"mass_scale": 1.3}},
            ["leaves out vehicle.mass_surge_kg, ", " more settings; "],
        ),
        (
            {**RANDOM.to_dict(), "ship": {"kind": "straight", "x_m": 1.0, "y_m": 2.0}},
            ["leaves out ship.course_rad, ship.speed_mps;"],
        ),
        (
            {**RANDOM.to_dict(), "sea": {"pulses": [{**Pulse().to_dict()}, {"start_s": 3.0}], "current": {}}},
            ["leaves out sea.pulses[1].duration_s, "],
        ),
        ({"base": "Randm"}, ["base = 'Randm'", "did you mean 'Random'?"]),
        ({"base": "Random", "episod": {}}, ["did you mean 'episode'?"]),
        ({"episod": {}}, ["did you mean 'episode'?"]),
        ([1], ["must be a JSON object"]),
    ],
)
def test_a_file_that_says_too_little_is_refused(data: Any, words: list[str], tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="--scenario: ") as caught:
        said(_file(tmp_path, data))
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("missing.json", "can't be read"),
        ("{", "isn't valid JSON"),
        ('{"episod": {}}', "did you mean 'episode'?"),
        ('{"episode": {"duration_s": -1}}', "duration_s = -1"),
    ],
)
def test_an_override_that_is_not_allowed_is_named(override: str, words: str) -> None:
    with pytest.raises(CommandError, match="--override: ") as caught:
        said("Random", override)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "words",
    [
        ["benchmark"],
        ["evaluate", "pd"],
        ["protocol", "--runs", "runs"],
        ["tune", "pd", "--out", "out"],
        ["tune", "ppo", "--out", "out"],
        ["train", "--out", "out"],
        ["record"],
        ["watch"],
        ["replay"],
    ],
    ids=" ".join,
)
def test_every_command_takes_a_scenario_alike(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    out = ["--out", "out"] if words[0] == "protocol" else []
    assert main([*words, *out, "--scenario", _file(tmp_path, SHORT)]) == 1
    assert "leaves out link" in capsys.readouterr().err
    assert main([*words, *out, "--scenario", "Random", "--override", '{"episod": {}}']) == 1
    assert "--override: " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_training_is_planned_in_what_is_said(tmp_path: Path) -> None:
    plan = planned(Wish(scenario="StrongPulse"))
    assert (plan.env_id, plan.name) == ("uwoc/StrongPulse-v0", "uwoc/StrongPulse-v0")
    assert plan.task == plan.practice == Scenario.named("StrongPulse")
    plan = planned(Wish(scenario=_file(tmp_path, RANDOM.merged(SHORT).to_dict())))
    assert plan.name == "mine"
    # The settings of Random's own training aren't for a scenario that doesn't say that it is one.
    assert plan.task == plan.practice == RANDOM.merged(SHORT)


def test_changes_go_before_those_of_the_settings(tmp_path: Path) -> None:
    told = [
        Wish(override=(json.dumps(SHORT),)),
        Wish(scenario="Random", override=(json.dumps(SHORT),)),
        Wish(scenario=_file(tmp_path, {"base": "Random", **SHORT})),
    ]
    for plan in map(planned, told):
        assert plan.env_id == "uwoc/Random-v0"
        assert plan.task == RANDOM.merged(SHORT)
        assert plan.practice == RANDOM.merged(plan.values["env_kwargs"]["scenario"]).merged(SHORT) != plan.task
