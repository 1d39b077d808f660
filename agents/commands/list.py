"""`uwoc-gym list`: environment IDs, scenarios and policies, or every setting of one scenario."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.options import add_scenario_arguments
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.agents.scenarios import Said, said
from uwoc_gym.parameters import ChildSpec, ChoiceSpec, Parameters, Range
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import DESCRIPTIONS

HELP = "list environment IDs, scenarios and policies, or every setting of a scenario"
EXAMPLES = """\
examples:
  uwoc-gym list
  uwoc-gym list Random
  uwoc-gym list uwoc/Nominal-v0 --override '{"vehicle": {"mass_scale": [0.8, 1.2]}}'
"""


class Setting(NamedTuple):
    """A setting as a line of the table."""

    path: str
    """As in `Scenario.to_dict()`: "sea.pulses[0].force_x_n"."""
    value: str
    unit: str
    words: str
    """What it is and may be, and in brackets where its default comes from."""


class Group(NamedTuple):
    """The settings that stand in one component itself."""

    title: str
    settings: list[Setting]


HEADER = Setting("setting", "value", "unit", "what it is [source, which is the default's where the value differs]")
WIDEST = 24
"""Longest value that the columns make room for."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_scenario_arguments(parser, None, "show every setting of this one: ", option="SCENARIO")


def run(args: argparse.Namespace) -> int:
    """Print the lists, or the scenario's settings; returns the exit status."""
    if args.scenario is not None:
        show(said(args.scenario, args.override, option="SCENARIO"))
        return 0
    if args.override is not None:
        raise CommandError(f"--override {' '.join(args.override)}: there is nothing to change; name a scenario.")
    print("environment IDs and the scenarios that they fly:")
    for env_id, name in ENV_IDS.items():
        print(f"  {env_id:<24} {name:<14} {DESCRIPTIONS[name]}".rstrip())
    print("\npolicies:")
    for policy in POLICIES.values():
        print(f"  {policy.name:<24} {policy.description}{' (slow: flies where it is named)' if policy.slow else ''}")
    return 0


def show(found: Said) -> None:
    """Print what a scenario is, its digest, and every setting of it."""
    if found.base is None:
        print(f"{found.name}: a scenario of its own")
    else:
        print(f"{found.base}: {DESCRIPTIONS[found.base]}")
    for changes in found.changes:
        print(f"changed by: {json.dumps(changes)}")
    print(f"digest: {found.scenario.digest()}")
    print()
    for line in table(groups(found.scenario)):
        print(line)


def table(parts: Iterable[Group]) -> list[str]:
    """The settings as lines of text, in columns; what follows a value longer than `WIDEST` stands on the next line."""
    parts = list(parts)
    every = [HEADER, *(setting for group in parts for setting in group.settings)]
    path, unit = (max(len(setting[i]) for setting in every) for i in (0, 2))
    value = max(len(setting.value) for setting in every if len(setting.value) <= WIDEST)

    def text(setting: Setting) -> list[str]:
        first, rest = f"  {setting.path:<{path}}  ", f"{setting.unit:<{unit}}  {setting.words}".rstrip()
        if len(setting.value) <= WIDEST:
            return [f"{first}{setting.value:<{value}}  {rest}"]
        return [f"{first}{setting.value}", f"{' ' * (len(first) + value)}  {rest}"]

    lines = text(HEADER)
    for group in parts:
        lines += ["", *([group.title] if group.title else [])]
        lines += [line for setting in group.settings for line in text(setting)]
    return lines


def groups(own: Parameters, place: str = "", title: str = "", kinds: tuple[str, ...] = ()) -> Iterator[Group]:
    """The settings of a component, then those of all below it, by what their specs say of them.

    Args:
        own: The component.
        place: Its path.
        title: What it is called.
        kinds: What it might be instead, itself included, where there is a choice.
    """
    here = [Setting(f"{place}.kind", own.kind, "", _with_options("its kind", kinds))] if kinds else []
    below: list[Group] = []
    for name, spec in own.specs().items():
        path = f"{place}.{name}" if place else name
        value = getattr(own, name)
        if not isinstance(spec, ChildSpec):
            here.append(_setting(own, name, path))
        elif value == ():
            here.append(Setting(path, text_of(value), "", spec.description))
        else:
            several = tuple(each.kind for each in spec.types) if len(spec.types) > 1 else ()
            items = {path: value} if isinstance(value, Parameters) else {f"{path}[{i}]": v for i, v in enumerate(value)}
            for i, (where, item) in enumerate(items.items()):
                below += groups(item, where, f"{where}{'' if i else f': {spec.description}'}", several)
    if here:
        yield Group(title, here)
    yield from below


def _setting(own: Parameters, name: str, path: str) -> Setting:
    spec = own.specs()[name]
    value = getattr(own, name)
    single = isinstance(spec, ChoiceSpec)
    words = _with_options(spec.description, getattr(spec, "options", ()), "one of" if single else "of")
    # A dataclass keeps a field's default as the attribute of its class; what must be given has none.
    default = spec.parse(getattr(type(own), name, value), path)
    source = getattr(spec, "source", "")
    between = " or " if single else ", "
    if value != default:
        source = f"default {text_of(default, between)}{': ' if source else ''}{source}"
    unit = getattr(spec, "unit", "")
    return Setting(path, text_of(value, between), unit, f"{words} [{source}]" if source else words)


def _with_options(description: str, options: Sequence[str], of: str = "one of") -> str:
    return f"{description} ({of} {', '.join(options)})" if options else description


def text_of(value: Any, between: str = ", ") -> str:
    """A setting's value in words; ``between`` stands between names where there are several."""
    if value is None or value == ():
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:.8g}"
    if isinstance(value, Range):
        return f"{text_of(value.low)} … {text_of(value.high)}"
    if isinstance(value, tuple):
        if isinstance(value[0], str):
            return between.join(value)
        return f"{len(value)} samples, {text_of(value[0])} to {text_of(value[-1])}"
    return str(value)
