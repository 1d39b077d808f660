"""`uwoc-gym protocol`: train groups of agents from several seeds, fly all held-out seeds, and say who is better."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uwoc_gym.agents import places
from uwoc_gym.agents.cluster import workers
from uwoc_gym.agents.errors import CommandError, naming, require
from uwoc_gym.agents.flight import check_flights, decision_time, possible
from uwoc_gym.agents.learning import protocol
from uwoc_gym.agents.learning.protocol import GROUPS, USUAL
from uwoc_gym.agents.learning.seeds import BATCH, HELD_OUT, RUNS
from uwoc_gym.agents.options import (
    add_scenario_arguments,
    add_work_arguments,
    add_wrapper_argument,
    scenarios_of,
    whole,
    wrapping_of,
)
from uwoc_gym.agents.reports import comparison, figures, files, tables
from uwoc_gym.baselines.controllers import CONTROLLERS
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import SCENARIOS

HELP = "train every group of agents from several seeds and compare them with the controllers on held-out seeds"
EXAMPLES = """\
examples:
  uwoc-gym protocol --runs runs/protocol --out benchmark
  uwoc-gym protocol --runs runs/protocol --groups ppo --training-seeds 3 --scenario Random --out benchmark
  uwoc-gym protocol --runs runs/protocol --out benchmark --ship trained
  uwoc-gym protocol --runs runs/tide --groups ppo-tide --rivals nlpd@Tide los@Tide --out benchmark-tide
"""

RIVALS = ("pd", "nlpd", "pd-tuned", "nlpd-tuned")
"""The controllers that fly beside the groups by default."""


def usual_scenarios(groups: Sequence[str]) -> list[str]:
    """What is flown if nothing is said: the world in which groups are trained, for Random all that looks like it.

    Raises:
        CommandError: They are trained in several.
    """
    (env_id, *others) = dict.fromkeys(GROUPS[name].wish.env for name in groups)
    if others:
        raise CommandError(
            f"--groups {' '.join(groups)} is not allowed without --scenario: they are trained in several worlds; give "
            "those of one."
        )
    return _like_random() if env_id is None else [env_id]


def _like_random() -> list[str]:
    """The IDs that show and take what `Random` does, in which the agents are trained."""

    def interface(name: str) -> tuple[object, ...]:
        return SCENARIOS[name].observation.entries, SCENARIOS[name].actions

    return [env_id for env_id, name in ENV_IDS.items() if interface(name) == interface("Random")]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--groups", nargs="+", default=list(USUAL), choices=list(GROUPS), metavar="GROUP",
        help=f"what to train, of {' '.join(GROUPS)} (default: {' '.join(USUAL)})",
    )  # fmt: skip
    parser.add_argument(
        "--training-seeds", type=whole("seeds", low=0, high=RUNS), metavar="N",
        help="trainings of each group (default: the group's own, 10, 5 or 3); 0 for controllers alone",
    )  # fmt: skip
    add_scenario_arguments(
        parser, None, "what is flown, by default that of the groups, or all that looks like Random: ", many=True
    )
    add_wrapper_argument(parser)
    parser.add_argument(
        "--rivals",
        nargs="+",
        default=list(RIVALS),
        choices=list(CONTROLLERS),
        metavar="POLICY",
        help=f"the controllers that fly beside the groups; {tables.REFERENCE}, with which all are compared, does "
        "in any case, and the share of the way to clairvoyant is told where that does (default: "
        f"{' '.join(RIVALS)})",
    )
    parser.add_argument(
        "--seeds",
        type=whole("seeds", high=len(HELD_OUT)),
        default=len(HELD_OUT),
        metavar="N",
        help="held-out seeds (default: %(default)s)",
    )
    parser.add_argument("--steps", type=whole("steps"), metavar="N", help="training steps instead of the settings' own")
    add_work_arguments(parser, "trainings and flights at a time")
    parser.add_argument("--runs", required=True, metavar="DIR", help="folder of the trainings; what is there is kept")
    parser.add_argument("--ship", metavar="DIR", help="put each group's best agent on the validation seeds here")
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="folder for BENCHMARK.md, results.json, scores.npz and figures"
    )


def run(args: argparse.Namespace) -> int:
    """Train what is missing, fly everything and report; returns the exit status."""
    require("tqdm", "matplotlib", "stable_baselines3", "sb3_contrib", "yaml")
    from tqdm import tqdm

    args.scenario = args.scenario or usual_scenarios(args.groups)
    scenarios = scenarios_of(args)
    around = wrapping_of(args)
    rivals = list(dict.fromkeys([*args.rivals, tables.REFERENCE]))
    check_flights([CONTROLLERS[name] for name in rivals], scenarios, min(args.seeds, BATCH), around)
    folder = files.output_folder(args.out)
    if places.elsewhere(args.runs):
        with naming("--runs"):
            places.check(args.runs)
    else:
        files.output_folder(args.runs, "--runs")
    if args.ship:
        files.output_folder(args.ship, "--ship")
    begun = time.perf_counter()
    counts = {name: GROUPS[name].seeds if args.training_seeds is None else args.training_seeds for name in args.groups}
    wanted = {name: count for name, count in counts.items() if count}
    members = protocol.jobs_of(wanted, args.runs, args.steps, args.wrapper)
    protocol.check(members, scenarios)
    # By seed, so that a protocol that is stopped has as much of every group.
    jobs = sorted((job for own in members.values() for job in own), key=lambda job: job.wish.seed or 0)
    folders = {group: [job.folder for job in own] for group, own in members.items()}
    policies = {name: [name] for name in rivals} | folders
    flights = len(scenarios) * sum(map(len, policies.values()))
    with (
        workers(args.jobs, args.on) as crew,
        tqdm(total=len(jobs) + flights, unit="job", file=sys.stderr) as bar,
    ):
        protocol.train_all(jobs, crew, bar)
        if args.ship:
            for group, own in folders.items():
                protocol.ship([places.local(path) for path in own], Path(args.ship) / group, GROUPS[group].description)
        scores = protocol.fly_all(scenarios, policies, HELD_OUT[: args.seeds], crew, bar, args.wrapper)
    first = next(iter(scenarios.values()))
    results: dict[str, Any] = {
        "held_out_seeds": args.seeds,
        "wrappers": around.plain(),
        "groups": {
            group: {
                "arguments": GROUPS[group].wish.words(),
                "trainings": [protocol.read_results(places.local(path) / files.RESULTS) for path in own],
            }
            for group, own in folders.items()
        },
        "results": {name: comparison.compared(own, name, possible(scenarios[name])) for name, own in scores.items()},
        "microseconds_a_decision": {
            name: round(decision_time(own[0], False, args.wrapper, first, HELD_OUT[:1]), 1)
            for name, own in policies.items()
        },
    }
    arrays: dict[str, Any] = {
        f"{scenario}/{policy}/{key}": values
        for scenario, by_policy in scores.items()
        for policy, measures in by_policy.items()
        for key, values in measures.items()
    }
    with files.whole(folder / "scores.npz") as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)
    results["wall_time_s"] = round(time.perf_counter() - begun, 1)
    files.write_results(folder, args.command_line, scenarios, results)
    for name, by_policy in scores.items():
        returns = {policy: measures["return"] for policy, measures in by_policy.items()}
        if returns[tables.REFERENCE].shape[1] > 1:
            figures.profiles(folder / f"profile-{name}.png", name, returns, scenarios[name], around.plain())
    text = comparison.markdown(args.command_line, results)
    files.write_text(folder / "BENCHMARK.md", text)
    print(text, end="")
    return 0
