"""`uwoc-gym benchmark`: every policy through every scenario on the same seeds."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from uwoc_gym.agents import interrupts
from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.flight import Series, batches, check_flights, flown_seeds, fly
from uwoc_gym.agents.options import (
    add_scenario_arguments,
    add_trust_argument,
    add_wrapper_argument,
    number,
    policies_of,
    scenarios_of,
    whole,
    wrapping_of,
)
from uwoc_gym.agents.policies.registry import MAY_BE, POLICIES
from uwoc_gym.agents.reports import figures, files, statistics, tables
from uwoc_gym.agents.wrapping import Wrapping
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.parameters import SettingError
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import Scenario

HELP = "fly policies through scenarios on the same seeds and compare them"
EXAMPLES = """\
examples:
  uwoc-gym benchmark
  uwoc-gym benchmark --policy pd nlpd --scenario Nominal uwoc/Random-v0 --seeds 100 --out results
  uwoc-gym benchmark --policy runs/ppo/model.zip my_module:make_policy --scenario my_scenario.json
  uwoc-gym benchmark --scenario Random --override episode.duration_s=30 'ship[*].speed_mps=1.0'
  uwoc-gym benchmark --scenario Random --policy pd ppo --wrapper gymnasium.wrappers:DelayObservation,delay=2
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    policies = [name for name, policy in POLICIES.items() if policy.installed() and name != "pd-plain"]
    parser.add_argument(
        "--policy",
        nargs="+",
        default=policies,
        metavar="POLICY",
        help=f"each {MAY_BE} (default: {' '.join(policies)})",
    )
    add_trust_argument(parser)
    add_scenario_arguments(parser, list(ENV_IDS), many=True)
    add_wrapper_argument(parser)
    parser.add_argument(
        "--seeds", type=whole("seeds"), default=20, metavar="N", help="number of seeds (default: %(default)s)"
    )
    parser.add_argument("--seed", type=whole("seed"), default=0, metavar="S", help="first seed (default: %(default)s)")
    parser.add_argument(
        "--batch",
        type=whole("episodes at a time"),
        default=50,
        metavar="N",
        help="episodes at a time (default: %(default)s)",
    )
    parser.add_argument(
        "--control-period",
        type=number("seconds"),
        metavar="S",
        help="time between actions [s] (default: the scenario's)",
    )
    parser.add_argument("--out", metavar="DIR", help="folder for results.json, episodes.csv, table.md and figures")


def run(args: argparse.Namespace) -> int:
    """Fly and report; returns the exit status."""
    require("tqdm", *(["matplotlib"] if args.out else []))
    scenarios = _scenarios(args)
    policies = policies_of(args)
    around = wrapping_of(args)
    check_flights(policies, scenarios, min(args.batch, args.seeds), around)
    folder = files.output_folder(args.out) if args.out else None
    results: list[tables.Result] = []
    flown: dict[str, dict[str, tuple[int, Series]]] = {}
    begun = time.perf_counter()
    interrupted = False
    try:
        if folder is None:
            _fly_all(args, scenarios, policies, around, results, flown, None)
        else:
            with files.EpisodesFile(folder / "episodes.csv") as episodes:
                _fly_all(args, scenarios, policies, around, results, flown, episodes)
    except KeyboardInterrupt:
        interrupted = True
    results = [result for result in results if result.rows]
    data = tables.results_data(results, args.seed)
    text = tables.table(data) if data else ""
    print(text, end="")
    if folder is not None:
        document = _document(args, scenarios, around, data, not interrupted, begun)
        files.write_results(folder, args.command_line, scenarios, document)
        files.write_text(folder / "table.md", text)
        for name, series in flown.items():
            figures.figure(folder / f"{name}.png", name, scenarios[name], series)
    if interrupted:
        count = sum(len(result.rows) for result in results)
        print(f"uwoc-gym benchmark: interrupted after {count} finished episodes", file=sys.stderr)
        return interrupts.status()
    return 0


def _scenarios(args: argparse.Namespace) -> dict[str, Scenario]:
    scenarios = scenarios_of(args)
    if args.control_period is None:
        return scenarios
    try:
        changes = {"episode": {"control_period_s": args.control_period}}
        return {name: scenario.merged(changes) for name, scenario in scenarios.items()}
    except SettingError as error:
        raise CommandError(f"--control-period {args.control_period:g}: {error}") from None


def _fly_all(
    args: argparse.Namespace,
    scenarios: dict[str, Scenario],
    policies: list[Policy],
    around: Wrapping,
    results: list[tables.Result],
    flown: dict[str, dict[str, tuple[int, Series]]],
    episodes: files.EpisodesFile | None,
) -> None:
    """Fly everything; what is finished stands in ``results``, ``flown`` and ``episodes`` at any time."""
    from tqdm import tqdm

    seeds = range(args.seed, args.seed + args.seeds)
    plan = [
        (name, policy, flown_seeds(policy, scenario, seeds, around))
        for name, scenario in scenarios.items()
        for policy in policies
    ]
    with tqdm(total=sum(len(own) for *_, own in plan), unit="episode", file=sys.stderr) as bar:
        for name, policy, own in plan:
            bar.set_description(f"{name}, {policy.name}")
            result = tables.Result(name, policy.name, [], len(own) < len(seeds))
            results.append(result)
            for batch in batches(own, args.batch):
                flight = fly(policy, scenarios[name], batch, wrapping=around)
                rows = flight.metrics.rows()
                if episodes is not None:
                    episodes.append(name, policy.name, batch, rows)
                result.rows.extend(rows)
                flown.setdefault(name, {}).setdefault(policy.name, (batch[0], flight.series))
                bar.update(len(batch))


def _document(
    args: argparse.Namespace,
    scenarios: dict[str, Scenario],
    around: Wrapping,
    data: list[dict[str, Any]],
    finished: bool,
    begun: float,
) -> dict[str, Any]:
    return {
        "finished": finished,
        "settings": {
            "seeds": list(range(args.seed, args.seed + args.seeds)),
            "batch": args.batch,
            "control_period_s": {name: each.episode.control_period_s for name, each in scenarios.items()},
            "policies": [str(Path(name)) if name.endswith(".zip") else name for name in args.policy],
            "scenarios": {name: each.to_dict() for name, each in scenarios.items()},
            "wrappers": around.plain(),
            "interval": statistics.INTERVAL,
        },
        "wall_time_s": round(time.perf_counter() - begun, 3),
        "results": data,
    }
