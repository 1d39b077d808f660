"""The lists, and the table of a scenario's settings."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from uwoc_gym import ENV_IDS, SCENARIOS, Pulse, Scenario, Sea
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.commands.list import Group, Setting, groups, table, text_of
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.parameters import Number, Parameters, child, choice, flag, number, samples
from uwoc_gym.scenario import DESCRIPTIONS


def test_list_names_everything(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    for name in (*ENV_IDS, *ENV_IDS.values(), *POLICIES):
        assert name in text


RECORDED = Scenario.named("Nominal").merged(
    {
        "ship": {"kind": "recorded", "time_s": [0.0, 50.0, 100.0, 200.0], "x_m": [0, 1, 2, 3], "y_m": [0, 0, 1, 2.5]},
        "sea": Sea(pulses=tuple(Pulse(start_s=10.0 * i) for i in range(12))),
    }
)


def _leaves(data: dict[str, Any], place: str = "") -> Iterator[tuple[str, Any]]:
    """The paths of nested plain data down to what holds no more names."""
    for name, value in data.items():
        path = f"{place}{name}"
        if isinstance(value, dict):
            yield from _leaves(value, f"{path}.")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for i, item in enumerate(value):
                yield from _leaves(item, f"{path}[{i}].")
        else:
            yield path, value


def _says(text: str, value: Any) -> bool:
    """Whether a cell says a plain value: numbers to 8 digits, of a sequence how many, the first and the last."""
    if value is None or value == []:
        return text == "none"
    if isinstance(value, bool):
        return text == ("true" if value else "false")
    if isinstance(value, str):
        return text == value
    if isinstance(value, list) and isinstance(value[0], str):
        return text in (", ".join(value), " or ".join(value))
    if isinstance(value, list) and len(value) > 2:
        return text.startswith(f"{len(value)} samples") and _says(text.split(" ")[-1], value[-1])
    wanted = value if isinstance(value, list) else [value]
    return [float(part) for part in text.split(" … ")] == pytest.approx(wanted, rel=1e-7)


def _table(text: str) -> list[list[str]]:
    """The cells of the table's lines but its header; lines that don't begin with a space are titles."""
    lines = [line.strip() for line in re.sub(r"\n {20,}", "  ", text).splitlines() if line.startswith("  ")]
    return [re.split(r"  +", line) for line in lines[1:]]


@pytest.mark.parametrize("name", [*SCENARIOS, "recorded"])
def test_every_setting_stands_in_the_table_once(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario, given = SCENARIOS.get(name, RECORDED), name
    if name not in SCENARIOS:
        given = str(tmp_path / "mine.json")
        Path(given).write_text(scenario.to_json())
    assert main(["list", given]) == 0
    text = capsys.readouterr().out
    cells = _table(text)
    wanted = dict(_leaves(scenario.to_dict()))
    assert sorted(line[0] for line in cells) == sorted(wanted)
    for path, value, *_ in cells:
        assert _says(value, wanted[path]), (path, value, wanted[path])
    assert f"digest: {scenario.digest()}\n" in text
    heading = f"{name}: {DESCRIPTIONS[name]}" if name in SCENARIOS else "mine: a scenario of its own"
    assert text.splitlines()[0] == heading


def test_units_options_and_sources(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "uwoc/StrongPulse-v0"]) == 0
    own = {line[0]: line[1:] for line in _table(capsys.readouterr().out)}
    assert own["link.power_w"] == ["0.1", "W", "mean optical power of the transmitter [paper, table 1]"]
    # The paper's 350 N is the source of the default, not of what the scenario has instead.
    assert own["sea.pulses[0].force_x_n"][1:] == ["N", "force along surge, or along x [default 350: paper, Case I]"]
    assert own["sea.pulses[0].start_s"][2].endswith("[paper, Case I]")
    assert own["sea.pulses[0].frame"][1].endswith("(one of body, earth)")
    assert own["ship.kind"][1].startswith("its kind (one of paper, straight, circle, ")
    assert own["vehicle.coriolis"][0] == "true"


def test_columns_line_up() -> None:
    long = "ship, velocity, heading, last-action, link"
    parts = [
        Group("", [Setting("depth_m", "0.1 … 2", "m", "how deep")]),
        Group(
            "link: a link", [Setting("link.groups", long, "", "what"), Setting("link.power_w", "1", "m^2", "how much")]
        ),
    ]
    header, *lines = table(parts)
    value, unit, words = (header.index(heading) for heading in ("value", "unit", "what it is"))
    assert lines == [
        "",
        f"{'  depth_m':<{value}}{'0.1 … 2':<{unit - value}}{'m':<{words - unit}}how deep",
        "",
        "link: a link",
        f"{'  link.groups':<{value}}{long}",
        f"{'':<{words}}what",
        f"{'  link.power_w':<{value}}{'1':<{unit - value}}{'m^2':<{words - unit}}how much",
    ]


@dataclass(frozen=True, kw_only=True)
class Inner(Parameters):
    depth_m: Number | None = number(None, "m", "how deep", low=0.0, high=9.0, optional=True)


@dataclass(frozen=True, kw_only=True)
class Outer(Parameters):
    rate: Number = number((1, 2), "1/s", "how fast", low=0.0, high=9.0, source="a book")
    on: bool = flag(False, "whether")
    way: str = choice("up", ("up", "down"), "whither")
    times_s: tuple[float, ...] = samples("s", "when")
    inner: Inner = child(Inner(), (Inner,), "the inside")
    more: tuple[Inner, ...] = child((), (Inner,), "further ones", many=True)


def test_a_new_setting_appears_by_itself() -> None:
    def lines(own: Parameters) -> list[list[str]]:
        return [list(setting) for group in groups(own) for setting in group.settings]

    assert lines(Outer(times_s=(0.0, 1.5))) == [
        ["rate", "1 … 2", "1/s", "how fast [a book]"],
        ["on", "false", "", "whether"],
        ["way", "up", "", "whither (one of up, down)"],
        ["times_s", "2 samples, 0 to 1.5", "s", "when"],
        ["more", "none", "", "further ones"],
        ["inner.depth_m", "none", "m", "how deep"],
    ]
    changed = Outer(rate=3, on=True, way="down", times_s=(2.0, 0.0, 1.0), more=(Inner(depth_m=(0, 2e-9)), Inner()))
    assert lines(changed) == [
        ["rate", "3", "1/s", "how fast [default 1 … 2: a book]"],
        ["on", "true", "", "whether [default false]"],
        ["way", "down", "", "whither (one of up, down) [default up]"],
        ["times_s", "3 samples, 2 to 1", "s", "when"],
        ["inner.depth_m", "none", "m", "how deep"],
        ["more[0].depth_m", "0 … 2e-09", "m", "how deep [default none]"],
        ["more[1].depth_m", "none", "m", "how deep"],
    ]


def test_several_names_say_whether_one_is_drawn() -> None:
    assert text_of(("ship", "link")) == "ship, link"
    assert text_of(("starboard", "port"), " or ") == "starboard or port"


def test_what_is_overridden_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, then = {"vehicle": {"mass_scale": [0.8, 1.1]}}, {"depth_m": 3.5}
    file = tmp_path / "heavy.json"
    file.write_text(json.dumps({"base": "Nominal", **first}))
    assert main(["list", str(file), "--override", json.dumps(then)]) == 0
    text = capsys.readouterr().out
    own = {line[0]: line[1:] for line in _table(text)}
    assert own["vehicle.mass_scale"][0] == "0.8 … 1.1"
    assert own["vehicle.mass_scale"][2].endswith("[default 1: paper, Case II]")
    assert own["depth_m"][0] == "3.5"
    assert text.startswith(f"Nominal: {DESCRIPTIONS['Nominal']}\n")
    assert f"changed by: {json.dumps(first)}\nchanged by: {json.dumps(then)}\n" in text
    assert f"digest: {Scenario.named('Nominal').merged(first).merged(then).digest()}\n" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["Randm"], "error: SCENARIO: there is no scenario 'Randm'; did you mean 'Random'?"),
        (["Random", "--override", '{"vehicel": {}}'], "error: --override: Scenario has no setting 'vehicel'; did you"),
        (["--override", "{}"], "error: --override {}: there is nothing to change; name a scenario."),
    ],
)
def test_what_is_not_allowed_is_said_in_a_line(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["list", *words]) == 1
    printed = capsys.readouterr()
    assert message in printed.err
    assert printed.out == ""


def test_what_is_slow_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    policies = capsys.readouterr().out.partition("policies:")[2].split("\n")
    said = {line.split()[0] for line in policies if line.endswith("(slow: flies where it is named)")}
    assert said == {name for name, policy in POLICIES.items() if policy.slow}
    assert said >= {"mppi", "clairvoyant"}
    assert not said & {"pd", "nlpd-tuned", "los", "lqr", "ekf-lqr", "ppo"}
