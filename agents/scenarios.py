"""Saying a scenario: by name, environment ID or file, with changes to it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.given import SettingError, closest, from_json, read_text, said_by, shown
from uwoc_gym.parameters import ChildSpec, Parameters
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import SCENARIOS, Scenario

BASE = "base"
"""The key by which a file names the scenario that it changes."""

NAMED = 5
"""How many of the settings that a file leaves out an error names."""


class Said(NamedTuple):
    """A scenario as it was asked for."""

    name: str
    """The named scenario's, or the file's without its suffix."""
    base: str | None
    """The named scenario that is changed; None for a file that says everything."""
    changes: tuple[dict[str, Any], ...]
    """What was changed, one after the other."""
    scenario: Scenario
    """With the changes."""


def said(
    scenario: str, override: str | Sequence[str] | None = None, option: str = "--scenario", among: bool = False
) -> Said:
    """The scenario that options name.

    Args:
        scenario: A name, an environment ID or the path of a .json file: with every setting, or with "base", the name
            of the scenario that the rest of it changes.
        override: Further changes, as `changes_of` takes them.
        option: What said the scenario, which errors about it begin with.
        among: Whether there are several, so that errors about changes say in which.

    Raises:
        CommandError: There is no such scenario, a file leaves out settings without a base, or a change isn't allowed.
    """
    with naming(option):
        found = _read(scenario)
    if override is None:
        return found
    changes = changes_of(override)
    with naming(f"--override: in {found.name}" if among else "--override"):
        changed = merged(found.scenario, changes)
    return found._replace(changes=(*found.changes, *changes), scenario=changed)


def merged(scenario: Scenario, changes: Iterable[Mapping[str, Any]]) -> Scenario:
    """The scenario with changes merged in, one mapping after the other.

    Raises:
        SettingError: A change isn't allowed.
    """
    for each in changes:
        scenario = scenario.merged(each)
    return scenario


def changes_of(override: str | Sequence[str] | None) -> tuple[dict[str, Any], ...]:
    """What ``--override`` says, in the order in which it holds.

    Args:
        override: Words, each of which is a JSON object, the path of a .json file with one, or a path and a value, as
            ``sea.pulses[1].force_x_n=500`` or, to scale it, ``sea.pulses[*].force_x_n*=0.1``. A value that isn't JSON
            is a text. Paths and values that follow each other hold together.

    Raises:
        CommandError: A word is none of them, a file can't be read, or a path is given twice in a row.
    """
    words = [override] if isinstance(override, str) else override or ()
    found: list[dict[str, Any]] = []
    together: dict[str, Any] | None = None
    with naming("--override"):
        for word in words:
            if _is_assignment(word):
                key, value = _assignment(word)
                if together is None:
                    together = {}
                    found.append(together)
                if key in together:
                    raise CommandError(f"{shown(key)} is given twice; leave one out.")
                together[key] = value
            elif not _is_json(word) and not word.endswith(".json") and not os.path.isfile(word):
                raise CommandError(
                    f"{shown(word)} is not allowed; it must be path=value, path*=factor, JSON or a .json file."
                )
            else:
                found.append(json_object(word))
                together = None
    return tuple(each for each in found if each)


def _is_json(word: str) -> bool:
    return word.lstrip()[:1] in ("{", "[")


def _is_assignment(word: str) -> bool:
    return "=" in word and not _is_json(word) and not os.path.isfile(word)


def _assignment(word: str) -> tuple[str, Any]:
    path, scales, text = re.fullmatch(r"(.*?)\s*(\*?)=(.*)", word, re.DOTALL).groups()  # type: ignore[union-attr]
    return f"{path.strip()} *=" if scales else path.strip(), said_by(text)


def differences(own: Scenario, other: Scenario) -> list[str]:
    """Where two scenarios differ: a line for each path, with the value of the first and that of the second."""
    left, right = (dict(_leaves(each.to_dict())) for each in (own, other))
    paths = [path for path in dict.fromkeys([*left, *right]) if left.get(path, _NONE) != right.get(path, _NONE)]
    return [f"{path}: {left.get(path, _NONE)} -> {right.get(path, _NONE)}" for path in paths]


_NONE = "none"


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Each setting in plain data by its path, and its value in JSON."""
    if isinstance(value, Mapping):
        for name, each in value.items():
            yield from _leaves(each, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        for i, each in enumerate(value):
            yield from _leaves(each, f"{path}[{i}]")
    else:
        yield path, shown(value) if isinstance(value, list) and len(value) > 2 else json.dumps(value)


def named(name: str) -> Said | None:
    """The scenario of that name or environment ID, in whatever case; None if there is none."""
    known = {each.lower(): short for each, short in [*((each, each) for each in SCENARIOS), *ENV_IDS.items()]}
    short = ENV_IDS.get(name, name)
    short = short if short in SCENARIOS else known.get(name.lower(), short)
    return Said(short, short, (), SCENARIOS[short]) if short in SCENARIOS else None


def _read(given: str) -> Said:
    found = named(given)
    if found is not None:
        return found
    path = Path(given)
    if path.suffix != ".json" and not os.path.isfile(given):
        hint = closest(given, [*SCENARIOS, *ENV_IDS])
        raise CommandError(
            f"there is no scenario {shown(given)}; {hint} A scenario may also be the path of a .json file."
        )
    data = json_object(given, file=True)
    try:
        if BASE not in data:
            whole = Scenario.from_dict(data)
            missing = list(_left_out(whole, data))
            if missing:
                more = f" and {len(missing) - NAMED} more settings" if len(missing) > NAMED else ""
                raise CommandError(
                    f'{shown(given)} leaves out {", ".join(missing[:NAMED])}{more}; say by "{BASE}" which named '
                    "scenario it changes, or give it as --override."
                )
            return Said(path.stem, None, (), whole)
        name = data.pop(BASE)
        base = named(name) if isinstance(name, str) else None
        if base is None:
            raise CommandError(
                f"{shown(given)} has {BASE} = {shown(name)}, which is no scenario; {closest(name, SCENARIOS)}"
            )
        return Said(path.stem, base.base, (data,), base.scenario.merged(data))
    except SettingError as error:
        raise CommandError(f"scenario {shown(given)} is not allowed: {error}") from None


def _left_out(own: Parameters, data: Mapping[str, Any], place: str = "") -> Iterator[str]:
    """Paths of the settings that the data of ``own`` don't say, but for those that earlier versions can't have said."""
    for name, spec in own.specs().items():
        path = f"{place}{name}"
        if name not in data:
            if not spec.since:
                yield path
        elif isinstance(spec, ChildSpec):
            value = getattr(own, name)
            if isinstance(value, tuple):
                for i, (each, said_of_it) in enumerate(zip(value, data[name], strict=True)):
                    yield from _left_out(each, said_of_it, f"{path}[{i}].")
            else:
                yield from _left_out(value, data[name], f"{path}.")


def json_object(given: str, file: bool = False) -> dict[str, Any]:
    """A JSON object from a text or a file.

    Args:
        given: The text itself if it begins with a brace or a bracket, else the file's path.
        file: Whether it is a path in any case.

    Raises:
        CommandError: The file can't be read, or it isn't a JSON object.
    """
    try:
        text = given if not file and _is_json(given) else read_text(given)
        found = from_json(text, shown(given))
    except SettingError as error:
        raise CommandError(str(error)) from None
    if not isinstance(found, dict):
        raise CommandError(f"{shown(given)} is not allowed; it must be a JSON object.")
    return found
