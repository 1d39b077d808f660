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
from uwoc_gym.agents.scenarios import changes_of, differences, said

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


def test_paths_and_values_are_changes_too(tmp_path: Path) -> None:
    words = ["sea.pulses[*].force_x_n*=0.1", "ship[*].speed_mps=1.0", "episode.duration_s = 58"]
    changes = {"sea.pulses[*].force_x_n *=": 0.1, "ship[*].speed_mps": 1.0, "episode.duration_s": 58}
    assert changes_of(words) == (changes,)
    assert said("Random", words).scenario == RANDOM.merged(changes)
    # A file and JSON go before and after; those that follow each other hold together.
    file = _file(tmp_path, {"depth_m": 2.0})
    mixed = ["depth_m=3", file, "depth_m *=2", '{"depth_m *=": 0.5}']
    assert changes_of(mixed) == ({"depth_m": 3}, {"depth_m": 2.0}, {"depth_m *=": 2}, {"depth_m *=": 0.5})
    assert said("Random", mixed).scenario.depth_m == 2.0
    kinds = ['ship={"kind": "circle"}', "action=surge-yaw", "vehicle.mass_scale=[0.9, 1.1]", "ship.turn=port"]
    found = said("Random", kinds).scenario
    assert (found.action, found.vehicle.mass_scale, found.ship.turn) == ("surge-yaw", (0.9, 1.1), "port")  # type: ignore[union-attr]
    assert said("Random", ["start.x_m=50", "episode.lost_distance_m=100"]).scenario.start.x_m == 50.0


def test_what_settings_train_on_is_scaled_too() -> None:
    plan = planned(Wish(override=("sea.pulses[*].force_x_n*=0.1", "vehicle.mass_scale*=2")))
    assert plan.task is not None
    assert plan.practice is not None
    for scenario in (plan.task, plan.practice):
        assert [each.force_x_n for each in scenario.sea.pulses] == [(-100.0, 100.0)] * 2
        assert scenario.vehicle.mass_scale == (1.6, 2.4)
    assert differences(plan.practice, plan.task)[0] == "sea.pulses[0].start_s: [2.0, 11.0] -> [5.0, 30.0]"
    assert "episode.duration_s: 12.0 -> 60.0" in differences(plan.practice, plan.task)
    less = differences(plan.practice, plan.task.merged({"sea": {"pulses": []}, "ship": {"kind": "straight"}}))
    assert 'sea.pulses[0].frame: "body" -> none' in less
    assert 'ship.kind: none -> "straight"' in less


@pytest.mark.parametrize("given", ["random", "RANDOM", "uwoc/random-v0", "UWOC/Random-V0"])
def test_case_does_not_matter(given: str) -> None:
    assert said(given) == said("Random")


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (["depth_m=1", "depth_m=2"], "'depth_m' is given twice"),
        (["depth_m=deep"], "Scenario.depth_m = 'deep'"),
        (["sea.pulses[4].force_x_n=1"], "Sea.pulses[4] is not there"),
        (["=3"], "Scenario has no setting ''"),
        (["nlpd"], "'nlpd' is not allowed; it must be path=value, path*=factor, JSON or a .json file"),
        ("missing.json", "can't be read"),
        ("{", "isn't valid JSON"),
        ('{"episod": {}}', "did you mean 'episode'?"),
        ('{"episode": {"duration_s": -1}}', "duration_s = -1"),
    ],
)
def test_an_override_that_is_not_allowed_is_named(override: str | list[str], words: str) -> None:
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
