"""`uwoc-gym benchmark`: every policy through every scenario on the same seeds."""

from __future__ import annotations

import argparse
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uwoc_gym.agents import interrupts, places
from uwoc_gym.agents.cluster import workers
from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.flight import Series, batches, check_flights, decision_time, flown, flown_seeds, fly, possible
from uwoc_gym.agents.options import (
    add_scenario_arguments,
    add_trust_argument,
    add_work_arguments,
    add_wrapper_argument,
    number,
    policies_of,
    scenarios_of,
    whole,
    wrapping_of,
)
from uwoc_gym.agents.policies.registry import MAY_BE, POLICIES
from uwoc_gym.agents.reports import figures, files, statistics, tables
from uwoc_gym.agents.work import Task, cores, run_all
from uwoc_gym.agents.wrapping import Wrapping
from uwoc_gym.baselines.controllers import CONTROLLERS
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.given import shown
from uwoc_gym.parameters import SettingError
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import Scenario
from uwoc_gym.sim.layout import varying

HELP = "fly policies through scenarios on the same seeds and compare them"
EXAMPLES = """\
examples:
  uwoc-gym benchmark
  uwoc-gym benchmark --policy pd nlpd --scenario Nominal uwoc/Random-v0 --seeds 100 --out results
  uwoc-gym benchmark --policy los@Tide ppo-tide --against los@Tide --scenario Tide --seeds 200
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
        help=f"each {MAY_BE} (default: those of {' '.join(by_default())} that can fly the scenario, and law@SCENARIO, "
        "which was tuned in it; the slow ones, as uwoc-gym list tells them, fly where they are named)",
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
    parser.add_argument(
        "--against",
        metavar="POLICY",
        help="whom the others are compared with, episode by episode, of those that fly (default: "
        f"{tables.REFERENCE}, if it does)",
    )
    add_work_arguments(parser, "processes that fly at a time")
    parser.add_argument("--out", metavar="DIR", help="folder for results.json, episodes.csv, table.md and figures")


def run(args: argparse.Namespace) -> int:
    """Fly and report; returns the exit status."""
    require("tqdm", *(["matplotlib"] if args.out else []))
    scenarios = _scenarios(args)
    around = wrapping_of(args)
    pairs = _pairs(args, scenarios, around)
    if args.against not in (None, *(pair.policy.name for pair in pairs)):
        raise CommandError(f"--against {shown(args.against)} is not allowed; it must be a policy that flies.")
    folder = files.output_folder(args.out) if args.out else None
    found = Found({}, {}, {})
    begun = time.perf_counter()
    interrupted = False
    try:
        if folder is None:
            _fly_all(args, scenarios, pairs, around, found, None)
        else:
            drawn = dict.fromkeys(path for scenario in scenarios.values() for path in varying(scenario))
            with files.EpisodesFile(folder / files.EPISODES, [*drawn]) as episodes:
                _fly_all(args, scenarios, pairs, around, found, episodes)
    except KeyboardInterrupt:
        interrupted = True
    results = [
        tables.Result(name, policy.name, rows, len(seeds) < args.seeds, possible(scenarios[name]))
        for name, policy, _, seeds in pairs
        if (rows := found.rows.get((name, policy.name)))
    ]
    data = tables.results_data(results, args.seed, args.against or tables.REFERENCE)
    text = tables.table(data, around.plain(), found.microseconds) if data else ""
    print(text, end="")
    if folder is not None:
        document = _document(args, scenarios, around, data, not interrupted, begun) | {
            "microseconds_a_decision": found.microseconds
        }
        files.write_results(folder, args.command_line, scenarios, document)
        files.write_text(folder / "table.md", text)
        for name, series in found.series.items():
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


class Found(NamedTuple):
    """What has been flown so far."""

    rows: dict[tuple[str, str], list[dict[str, float]]]
    """The episodes by scenario and policy."""
    series: dict[str, dict[str, tuple[int, Series]]]
    """Seed and series of the first episode, by scenario and policy."""
    microseconds: dict[str, dict[str, float]]
    """How long a decision takes, by scenario and policy."""


def _scenarios(args: argparse.Namespace) -> dict[str, Scenario]:
    scenarios = scenarios_of(args)
    if args.control_period is None:
        return scenarios
    try:
        changes = {"episode": {"control_period_s": args.control_period}}
        return {name: scenario.merged(changes) for name, scenario in scenarios.items()}
    except SettingError as error:
        raise CommandError(f"--control-period {args.control_period:g}: {error}") from None


def _pairs(args: argparse.Namespace, scenarios: Mapping[str, Scenario], around: Wrapping) -> list[Pair]:
    """Who flies which scenario: all that are named, or else all that can and aren't left out."""
    episodes = min(args.batch, args.seeds)
    seeds = range(args.seed, args.seed + args.seeds)
    words: Mapping[str, str] = {}
    if args.policy is not None:
        policies = policies_of(args)
        words = dict(zip((policy.name for policy in policies), dict.fromkeys(args.policy), strict=True))
        check_flights(policies, scenarios, episodes, around)
        who: Mapping[str, Sequence[Policy]] = dict.fromkeys(scenarios, policies)
    else:
        check_flights([], scenarios, episodes, around)
        usual = {name: [POLICIES[each] for each in by_default(name)] for name in scenarios}
        who = {
            name: [policy for policy in usual[name] if _can(policy, name, scenario, around)]
            for name, scenario in scenarios.items()
        }
        # Where nobody can fly, the first says why.
        for name, able in who.items():
            if not able:
                check_flights(usual[name], {name: scenarios[name]}, 1, around)
    return [
        Pair(name, policy, words.get(policy.name, policy.name), flown_seeds(policy, scenario, seeds, around))
        for name, scenario in scenarios.items()
        for policy in who[name]
    ]


def by_default(scenario: str | None = None) -> list[str]:
    """The policies that fly a scenario by default: those that aren't slow, and what was tuned in it alone.

    Without a scenario, those that fly every one.
    """
    return [
        name
        for name, policy in POLICIES.items()
        if policy.installed() and not policy.slow and name != "pd-plain" and name.partition("@")[2] in ("", scenario)
    ]


def _can(policy: Policy, name: str, scenario: Scenario, around: Wrapping) -> bool:
    """Whether an agent was trained for what a scenario shows and takes, and a law sees what it needs."""
    try:
        check_flights([policy], {name: scenario}, 1, around)
    except CommandError:
        return False
    return True


class Pair(NamedTuple):
    """A policy in a scenario."""

    scenario: str
    policy: Policy
    word: str
    """What `load` knows the policy by."""
    seeds: Sequence[int]
    """Those of its episodes that differ."""


def _tasks(
    args: argparse.Namespace, scenarios: Mapping[str, Scenario], pairs: Sequence[Pair]
) -> Iterator[tuple[Pair, Task]]:
    """Of each pair how long a decision takes, then its flights."""
    for pair in pairs:
        arguments = (pair.word, args.trust, tuple(args.wrapper), scenarios[pair.scenario])
        name = f"policy {pair.policy.name!r} in {pair.scenario}"
        yield pair, Task(decision_time, arguments, pair.seeds[:1], name)
        for batch in batches(pair.seeds, args.batch):
            yield pair, Task(flown, arguments, batch, name)


def _fly_all(
    args: argparse.Namespace,
    scenarios: dict[str, Scenario],
    pairs: Sequence[Pair],
    around: Wrapping,
    found: Found,
    episodes: files.EpisodesFile | None,
) -> None:
    """Fly everything; what is finished stands in ``found`` and ``episodes`` at any time."""
    from tqdm import tqdm

    count, total = 0, sum(len(pair.seeds) for pair in pairs)
    shown = "{percentage:3.0f} % |{bar}| {elapsed} gone, {desc}"
    # Tasks come back in their order; of those that an interruption has ended, some may be missing.
    of_task: deque[tuple[Pair, Task]] = deque()

    def tasks() -> Iterator[Task]:
        for each in _tasks(args, scenarios, pairs):
            of_task.append(each)
            yield each[1]

    flights = [
        (pair.policy.name, scenarios[pair.scenario], batch)
        for pair in pairs
        for batch in batches(pair.seeds, args.batch)
    ]
    left = TimeLeft(flights)
    # A lone flight isn't worth another process.
    jobs = args.jobs if args.on else min(args.jobs or cores(), len(flights))
    with (
        workers(jobs, args.on) as crew,
        tqdm(total=left.work, bar_format=shown, file=sys.stderr, desc="compiling") as bar,
    ):
        warm_up(scenarios, pairs, around, min(args.batch, args.seeds), everybody=jobs == 1)
        bar.set_description_str(f"flying: 0 of {total} episodes")
        with closing(run_all(tasks(), crew)) as done:
            for task, result in done:
                while of_task[0][1] is not task:
                    of_task.popleft()
                pair, _ = of_task.popleft()
                name, policy = pair.scenario, pair.policy.name
                if task.function is decision_time:
                    found.microseconds.setdefault(name, {})[policy] = round(result, 1)
                    continue
                rows = found.rows.setdefault((name, policy), [])
                if task.seeds[0] != pair.seeds[len(rows)]:
                    # An interruption has left out the episodes before these, and pairs go by their places.
                    continue
                # Between the two an interruption would leave episodes in the one that the other lacks.
                with interrupts.noted() as asked:
                    if episodes is not None:
                        episodes.append(name, policy, task.seeds, result.rows, result.drawn)
                        places.keep(episodes.path.parent, places.OFTEN_S)
                    rows.extend(result.rows)
                if asked:
                    raise KeyboardInterrupt
                found.series.setdefault(name, {}).setdefault(policy, (task.seeds[0], result.series))
                count += len(task.seeds)
                bar.update(left.done((policy, scenarios[name], task.seeds), result.seconds))
                bar.set_description_str(f"{left.words(crew.jobs)}: {count} of {total} episodes, {name}, {policy}")
        bar.set_description_str(f"done: {count} episodes")


def warm_up(
    scenarios: Mapping[str, Scenario], pairs: Sequence[Pair], around: Wrapping, episodes: int, everybody: bool
) -> None:
    """Compile all that flights need, once, and not in each of the processes that fly.

    Args:
        scenarios: What is flown.
        pairs: Who flies it.
        around: What stands around the environments.
        episodes: How many fly together.
        everybody: Whether this process is to fly everybody, and has to load all; else agents, which bring nothing that
            is compiled, are left to those that do.
    """
    seen: set[str] = set()
    for pair in pairs:
        if not everybody and (pair.policy.name in seen or pair.policy.name not in CONTROLLERS):
            continue
        seen.add(pair.policy.name)
        scenario = scenarios[pair.scenario]
        short = scenario.merged({"episode": {"duration_s": scenario.episode.control_period_s}})
        fly(pair.policy, short, range(min(episodes, len(pair.seeds))), wrapping=around)


class TimeLeft:
    """How long the flights to come will take, from those that are done.

    A control period of a batch costs something however few episodes it has, and policies differ; so time is counted by
    work, and each policy's own speed is taken once it has flown.

    Args:
        flights: Policy, scenario and seeds of each flight.
    """

    def __init__(self, flights: Iterable[tuple[str, Scenario, Sequence[int]]]) -> None:
        self._to_do: dict[str, float] = {}
        self._done: dict[str, float] = {}
        self._seconds: dict[str, float] = {}
        for flight in flights:
            self._to_do[flight[0]] = self._to_do.get(flight[0], 0) + _work(flight)
        self.work = sum(self._to_do.values())
        """All there is to do."""

    def done(self, flight: tuple[str, Scenario, Sequence[int]], seconds: float) -> int:
        """A flight has ended that took so long by itself [s]; returns how much work it was."""
        policy, work = flight[0], _work(flight)
        self._to_do[policy] -= work
        self._done[policy] = self._done.get(policy, 0.0) + work
        self._seconds[policy] = self._seconds.get(policy, 0.0) + seconds
        return work

    def seconds(self, jobs: int = 1) -> float | None:
        """What is left [s] where so many fly at a time; None before anything is known."""
        if not self._done:
            return None
        usual = sum(self._seconds.values()) / sum(self._done.values())
        alone = sum(
            work * (self._seconds[policy] / self._done[policy] if policy in self._done else usual)
            for policy, work in self._to_do.items()
        )
        return alone / jobs

    def words(self, jobs: int) -> str:
        """What is left in a few words."""
        seconds = self.seconds(jobs)
        if seconds is None:
            return "flying"
        return f"about {seconds / 60.0:.0f} min left" if seconds >= 90.0 else f"about {seconds:.0f} s left"


def _work(flight: tuple[str, Scenario, Sequence[int]]) -> int:
    _, scenario, seeds = flight
    return scenario.episode.steps * (_ALONE + len(seeds))


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
    words = args.policy or dict.fromkeys(each for name in scenarios for each in by_default(name))
    policies = [str(Path(name)) if name.endswith(".zip") and not places.elsewhere(name) else name for name in words]
    return {
        "finished": finished,
        "settings": {
            "seeds": list(range(args.seed, args.seed + args.seeds)),
            "batch": args.batch,
            "control_period_s": {name: each.episode.control_period_s for name, each in scenarios.items()},
            "policies": policies,
            "scenarios": {name: each.to_dict() for name, each in scenarios.items()},
            "wrappers": around.plain(),
            "interval": statistics.INTERVAL,
        },
        "wall_time_s": round(time.perf_counter() - begun, 3),
        "results": data,
    }
