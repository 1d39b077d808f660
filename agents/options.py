"""Options that several commands have, and checks of what they are given before any work begins."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import TypeVar

from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.policies.registry import MAY_BE, load
from uwoc_gym.agents.scenarios import said
from uwoc_gym.agents.viewing.episode import Episode
from uwoc_gym.agents.work import cores
from uwoc_gym.agents.wrapping import MAY_BE as WRAPPER_MAY_BE
from uwoc_gym.agents.wrapping import Wrapping, wrapping
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.given import LIMITS, Limit, shown
from uwoc_gym.scenario import Scenario
from uwoc_gym.spaces import LARGEST_FRAME, SMALLEST_FRAME, check_render_size

T = TypeVar("T", int, float)


def whole(limit: str, low: int | None = None, high: int | None = None) -> Callable[[str], int]:
    """An argparse type: a whole number within the bounds of that name in `LIMITS`, of which some may be others."""
    return _reader(int, _bounds(limit, low, high))


def number(limit: str, low: float | None = None, high: float | None = None) -> Callable[[str], float]:
    """An argparse type: a number within the bounds of that name in `LIMITS`, of which some may be others."""
    return _reader(float, _bounds(limit, low, high))


def _bounds(name: str, low: float | None, high: float | None) -> Limit:
    usual = LIMITS[name]
    return usual._replace(low=usual.low if low is None else low, high=usual.high if high is None else high)


def _reader(kind: Callable[[str], T], bounds: Limit) -> Callable[[str], T]:
    def parse(text: str) -> T:
        try:
            value = kind(text)
            if bounds.low <= value <= bounds.high:
                return value
        except ValueError:
            pass
        raise argparse.ArgumentTypeError(f"{shown(text)} is not allowed; it must be {bounds.allowed}.")

    return parse


def frame_size(text: str) -> tuple[int, int]:
    """An argparse type: the width and height of a picture [px], as in 1280x720."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
        return check_render_size((width, height))
    except ValueError:
        least, most = ("x".join(map(str, size)) for size in (SMALLEST_FRAME, LARGEST_FRAME))
        raise argparse.ArgumentTypeError(
            f"{shown(text)} is not allowed; it must be a width and a height [px] from {least} to {most}, as 1280x720."
        ) from None


def add_work_arguments(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the options that say who does the work.

    Args:
        parser: Gets them.
        what: What is done side by side, as in "flights at a time".
    """
    parser.add_argument(
        "--jobs",
        type=whole("jobs"),
        metavar="N",
        help=f"{what}, for the same results (default: as many as there are cores, {cores()} on this machine)",
    )
    parser.add_argument(
        "--on",
        type=_place,
        metavar="PLACE",
        help="where it is done, for the same results: ray, for Ray on this machine, or ray://HOST:PORT, for a cluster "
        "that knows all folders and policies that are named (default: processes of this machine)",
    )


def _place(text: str) -> str:
    """An argparse type: where work is done."""
    if re.fullmatch(r"ray(://[^/\s:]+:\d+)?", text):
        return text
    raise argparse.ArgumentTypeError(
        f"{shown(text)} is not allowed; it must be ray, or ray://HOST:PORT with the port of a cluster's Ray client "
        "server, 10001 if nothing else was said."
    )


def add_search_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that every search has."""
    parser.add_argument(
        "--seed", type=whole("seed"), default=0, metavar="S", help="the search's seed (default: %(default)s)"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with the search that --out holds; Optuna keeps the state of CMA-ES as a pickled object, which runs "
        "the code in it: only give folders that you trust",
    )
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="folder for results.json, trials.csv, study.db and what was found"
    )


def add_scenario_arguments(
    parser: argparse.ArgumentParser,
    default: str | list[str] | None,
    prefix: str = "",
    many: bool = False,
    option: str = "--scenario",
) -> None:
    """Add the options that say a scenario, or several.

    Args:
        parser: Gets them.
        default: What is flown if nothing is said.
        prefix: Goes before the help on ``--scenario``.
        many: Whether there may be several, which all get the same changes.
        option: What says it: "--scenario", or "SCENARIO" for a word without an option, which may be left out.
    """
    usual = "all environment IDs" if many else default
    parser.add_argument(
        option.lower(),
        nargs="+" if many else None if option.startswith("-") else "?",
        default=default,
        metavar="SCENARIO",
        help=f"{prefix}a name, an environment ID or a .json file with a whole scenario, or with changes to the one "
        f'that its "base" names{"" if default is None else f" (default: {usual})"}',
    )
    parser.add_argument(
        "--override",
        nargs="+",
        action="extend",
        metavar="CHANGE",
        help="changes to the scenario, each a path and a value, such as episode.duration_s=30 or, to scale, "
        "'sea.pulses[*].force_x_n*=0.1' (quoted, for the shell), or a .json file, or JSON itself, such as "
        '\'{"episode": {"duration_s": 30}}\'',
    )


def add_wrapper_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that puts wrappers around the environments."""
    parser.add_argument(
        "--wrapper",
        nargs="+",
        action="extend",
        default=[],
        metavar="WRAPPER",
        help=f"what goes around the environments, the first innermost: {WRAPPER_MAY_BE}",
    )


def wrapping_of(args: argparse.Namespace) -> Wrapping:
    """The wrappers that ``--wrapper`` names.

    Raises:
        CommandError: One can't be imported, or they stand in an order that isn't allowed.
    """
    return wrapping(args.wrapper)


def scenario_of(args: argparse.Namespace) -> tuple[str, Scenario]:
    """Short name and scenario that the options say.

    Raises:
        CommandError: They aren't allowed.
    """
    found = said(args.scenario, args.override)
    return found.name, found.scenario


def scenarios_of(args: argparse.Namespace) -> dict[str, Scenario]:
    """The scenarios that the options say, by short name.

    Raises:
        CommandError: They aren't allowed, or two of one name differ.
    """
    scenarios: dict[str, Scenario] = {}
    for given in args.scenario:
        name, _, _, scenario = said(given, args.override, among=len(args.scenario) > 1)
        if scenarios.get(name, scenario) != scenario:
            raise CommandError(f"--scenario: two different scenarios are called {name!r}; rename one of the files.")
        scenarios[name] = scenario
    return scenarios


def add_trust_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that lets policies, and runs that go on, run what their files say."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help="load files that hold pickled objects or name code too, which runs it: those that Stable-Baselines3 alone "
        "has saved, agents of version 0.1, those that correct a module:callable, and runs that name one; without it "
        "nothing in a file is run",
    )


def policies_of(args: argparse.Namespace) -> list[Policy]:
    """The policies that ``--policy`` names, each once.

    Raises:
        CommandError: There is no such policy, it can't be loaded, or it would have to be trusted.
    """
    with naming("--policy"):
        return [load(name, args.trust) for name in dict.fromkeys(args.policy)]


def add_episode_arguments(parser: argparse.ArgumentParser, policies: list[str]) -> None:
    """Add the options that say who flies what; ``policies`` fly by default."""
    parser.add_argument(
        "--policy",
        nargs="+",
        default=policies,
        metavar="POLICY",
        help=f"each {MAY_BE} (default: {' '.join(policies)})",
    )
    add_trust_argument(parser)
    add_scenario_arguments(parser, "StrongPulse")
    add_wrapper_argument(parser)
    parser.add_argument("--seed", type=whole("seed"), default=0, metavar="S", help="the episode's seed (default: 0)")


def add_file_arguments(parser: argparse.ArgumentParser, default: str, many: bool, what: str) -> None:
    """Add the options about the file to write."""
    parser.add_argument(
        "--out",
        nargs="+" if many else None,
        default=[default] if many else default,
        metavar="FILE",
        help=f"{what} (default: {default})",
    )
    parser.add_argument("--force", action="store_true", help="overwrite existing files")


def episode_of(args: argparse.Namespace) -> Episode:
    """The episode that the options name.

    Raises:
        CommandError: There is no such policy or scenario.
    """
    name, scenario = scenario_of(args)
    return Episode(policies_of(args), name, scenario, args.seed, wrapping_of(args))
