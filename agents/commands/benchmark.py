"""`uwoc-gym benchmark`: every policy through every scenario on the same seeds."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

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
    parser.add_argument(
        "--policy",
        nargs="+",
        metavar="POLICY",
        help=f"each {MAY_BE} (default: those of {' '.join(_usual())} that can fly the scenario)",
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
    around = wrapping_of(args)
    pairs = _pairs(args, scenarios, around)
    folder = files.output_folder(args.out) if args.out else None
    results: list[tables.Result] = []
    flown: dict[str, dict[str, tuple[int, Series]]] = {}
    begun = time.perf_counter()
    interrupted = False
    try:
        if folder is None:
            _fly_all(args, scenarios, pairs, around, results, flown, None)
        else:
            with files.EpisodesFile(folder / "episodes.csv") as episodes:
                _fly_all(args, scenarios, pairs, around, results, flown, episodes)
    except KeyboardInterrupt:
        interrupted = True
    results = [result for result in results if result.rows]
    data = tables.results_data(results, args.seed)
    text = tables.table(data, around.plain()) if data else ""
    print(text, end="")
    if folder is not None:
        document = _document(args, scenarios, around, data, not interrupted, begun)
        files.write_results(folder, args.command_line, scenarios, document)
        files.write_text(folder / "table.md", text)
        for name, series in flown.items():
            figures.figure(folder / f"{name}.png", name, scenarios[name], series, around.plain())
            returns = {
                each.policy: np.array([row["return"] for row in each.rows]) for each in results if each.scenario == name
            }
            if min(map(len, returns.values())) > 1:
                figures.profiles(folder / f"{name}-profile.png", name, returns, scenarios[name], around.plain())
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


def _pairs(
    args: argparse.Namespace, scenarios: Mapping[str, Scenario], around: Wrapping
) -> Mapping[str, Sequence[Policy]]:
    """Who flies which scenario: all that are named, or else all that can."""
    episodes = min(args.batch, args.seeds)
    if args.policy is not None:
        policies = policies_of(args)
        check_flights(policies, scenarios, episodes, around)
        return dict.fromkeys(scenarios, policies)
    check_flights([], scenarios, episodes, around)
    usual = [POLICIES[name] for name in _usual()]
    pairs = {
        name: [policy for policy in usual if _can(policy, name, scenario, around)]
        for name, scenario in scenarios.items()
    }
    # Where nobody can fly, the first says why.
    check_flights(usual, {name: scenarios[name] for name, able in pairs.items() if not able}, 1, around)
    return pairs


def _usual() -> list[str]:
    """The policies that fly by default."""
    return [name for name, policy in POLICIES.items() if policy.installed() and name != "pd-plain"]


def _can(policy: Policy, name: str, scenario: Scenario, around: Wrapping) -> bool:
    """Whether an agent was trained for what a scenario shows and takes, and a law sees what it needs."""
    try:
        check_flights([policy], {name: scenario}, 1, around)
    except CommandError:
        return False
    return True


def _fly_all(
    args: argparse.Namespace,
    scenarios: dict[str, Scenario],
    pairs: Mapping[str, Sequence[Policy]],
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
        for policy in pairs[name]
    ]
    left = TimeLeft(
        [(policy.name, scenarios[name], batch) for name, policy, own in plan for batch in batches(own, args.batch)]
    )
    count, total = 0, sum(len(own) for *_, own in plan)
    shown = "{percentage:3.0f} % |{bar}| {elapsed} gone, {desc}"
    with tqdm(total=left.work, bar_format=shown, file=sys.stderr, desc="compiling") as bar:
        warm_up(scenarios, pairs, around, min(args.batch, args.seeds))
        left.begin()
        for name, policy, own in plan:
            result = tables.Result(name, policy.name, [], len(own) < len(seeds))
            results.append(result)
            for batch in batches(own, args.batch):
                bar.set_description_str(f"{left.words()}: {count} of {total} episodes, {name}, {policy.name}")
                flight = fly(policy, scenarios[name], batch, wrapping=around)
                rows = flight.metrics.rows()
                if episodes is not None:
                    episodes.append(name, policy.name, batch, rows)
                result.rows.extend(rows)
                flown.setdefault(name, {}).setdefault(policy.name, (batch[0], flight.series))
                count += len(batch)
                bar.update(left.done())
        bar.set_description_str(f"done: {count} episodes")


def warm_up(
    scenarios: Mapping[str, Scenario], pairs: Mapping[str, Sequence[Policy]], around: Wrapping, episodes: int
) -> None:
    """Compile and load all that flights need, so that how fast they go tells how long the others will take."""
    if (torch := sys.modules.get("torch")) is not None:
        # Networks of this size gain nothing from more, and wait for each other where others work on the machine.
        torch.set_num_threads(1)
    for name, scenario in scenarios.items():
        short = scenario.merged({"episode": {"duration_s": scenario.episode.control_period_s}})
        for policy in pairs[name]:
            fly(policy, short, range(episodes if scenario.draws or around else 1), wrapping=around)


class TimeLeft:
    """How long the flights to come will take, from those that are done.

    A control period of a batch costs something however few episodes it has, and policies differ; so time is counted by
    work, and each policy's own speed is taken once it has flown.

    Args:
        flights: Policy, scenario and seeds of each flight, in their order.
        clock: Gives the time [s].
    """

    def __init__(
        self,
        flights: Sequence[tuple[str, Scenario, Sequence[int]]],
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._flights = [
            (policy, scenario.episode.steps * (_ALONE + len(seeds))) for policy, scenario, seeds in flights
        ]
        self._clock = clock
        self._seconds: list[float] = []
        self.begin()

    def begin(self) -> None:
        """The first flight begins now."""
        self._at = self._clock()

    @property
    def work(self) -> int:
        """All there is to do."""
        return sum(amount for _, amount in self._flights)

    def done(self) -> int:
        """A flight has ended, and the next one begins; returns how much work it was."""
        now = self._clock()
        self._seconds.append(now - self._at)
        self._at = now
        return self._flights[len(self._seconds) - 1][1]

    def seconds(self) -> float | None:
        """What is left [s]; None before anything is known."""
        if not self._seconds:
            return None
        done = list(zip(self._flights, self._seconds, strict=False))
        work: dict[str, float] = {}
        taken: dict[str, float] = {}
        for (policy, amount), seconds in done:
            work[policy] = work.get(policy, 0.0) + amount
            taken[policy] = taken.get(policy, 0.0) + seconds
        usual = sum(taken.values()) / sum(work.values())
        return sum(
            amount * (taken[policy] / work[policy] if policy in work else usual)
            for policy, amount in self._flights[len(done) :]
        )

    def words(self) -> str:
        """What is left in a few words."""
        seconds = self.seconds()
        if seconds is None:
            return "flying"
        return f"about {seconds / 60.0:.0f} min left" if seconds >= 90.0 else f"about {seconds:.0f} s left"


_ALONE = 500
"""How many more episodes cost as much as a control period of a batch does by itself."""


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
            "policies": [str(Path(name)) if name.endswith(".zip") else name for name in args.policy or _usual()],
            "scenarios": {name: each.to_dict() for name, each in scenarios.items()},
            "wrappers": around.plain(),
            "interval": statistics.INTERVAL,
        },
        "wall_time_s": round(time.perf_counter() - begun, 3),
        "results": data,
    }
