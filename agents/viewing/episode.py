"""What `watch`, `record` and `replay` share: the options that name policies and one episode, and the output file."""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from typing import NamedTuple

from uwoc_gym.agents.flight import Policy, load, load_scenario
from uwoc_gym.agents.options import CommandError, naming, whole
from uwoc_gym.scenario import Scenario

# Before anything imports pygame, which greets on the standard output otherwise.
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")


class Episode(NamedTuple):
    """One episode and who flies it."""

    policies: list[Policy]
    scenario_name: str
    scenario: Scenario
    seed: int


def add_arguments(parser: argparse.ArgumentParser, policies: list[str]) -> None:
    """Add the options that say who flies what; ``policies`` fly by default."""
    parser.add_argument(
        "--policy",
        nargs="+",
        default=policies,
        metavar="POLICY",
        help="names, saved .zip files or module:callable (default: " + " ".join(policies) + ")",
    )
    parser.add_argument(
        "--scenario",
        default="StrongPulse",
        metavar="SCENARIO",
        help="a name, an environment ID or a .json file (default: %(default)s)",
    )
    parser.add_argument("--seed", type=whole(0), default=0, metavar="S", help="the episode's seed (default: 0)")


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


def chosen(args: argparse.Namespace) -> Episode:
    """The episode that the options name.

    Raises:
        CommandError: There is no such policy or scenario.
    """
    with naming("--scenario"):
        name, scenario = load_scenario(args.scenario)
    with naming("--policy"):
        policies = [load(given) for given in dict.fromkeys(args.policy)]
    return Episode(policies, name, scenario, args.seed)


def output_file(given: str, suffixes: tuple[str, ...], force: bool) -> Path:
    """A file that may be written to, whose folder then exists.

    Raises:
        CommandError: It has another suffix, exists without ``force``, or can't be written to.
    """
    path = Path(given)
    if path.suffix.lower() not in suffixes:
        raise CommandError(f"--out {given}: the file's name must end in {' or '.join(suffixes)}.")
    if path.is_dir():
        raise CommandError(f"--out {given} is a folder; it must be a file.")
    if path.exists() and not force:
        raise CommandError(f"--out {given} already exists; give --force to overwrite it.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(None, "it is read-only")
    except OSError as error:
        raise CommandError(
            f"--out {given}: {error.strerror or error}; it must be a file that can be written."
        ) from None
    return path
