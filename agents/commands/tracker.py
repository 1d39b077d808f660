"""`uwoc-gym tracker`: teach a network how ships sail, for laws where the ship is known by late fixes."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uwoc_gym.agents import interrupts, places
from uwoc_gym.agents.errors import require
from uwoc_gym.agents.flight import batches, check_flights, fly
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION, BATCH, training_seed
from uwoc_gym.agents.options import add_scenario_arguments, whole
from uwoc_gym.agents.reports import files
from uwoc_gym.agents.scenarios import said
from uwoc_gym.baselines import Controller
from uwoc_gym.baselines.law import Tracker
from uwoc_gym.baselines.learned_tracker import LearnedTracker
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.scenario import Scenario

if TYPE_CHECKING:
    from uwoc_gym.agents.learning.tracking import Network

HELP = "teach a network how ships sail, for laws that know the ship by late fixes"
EXAMPLES = """\
examples:
  uwoc-gym tracker --out runs/tracker
  uwoc-gym tracker --override 'fixes.period_s=[1, 3]' --out runs/tracker-any-period

In Python: Controller("nlpd-tuned", "LateFix", filtered=partial(LearnedTracker, weights="runs/tracker/tracker.npz")).
"""

USUAL_SCENARIO = "LateFix"

FILE = "tracker.npz"

_AT_A_TIME = 512
"""Flights at a time."""

_SHOWN = 100
"""Steps over which the loss is averaged that is shown."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_scenario_arguments(parser, None, f"by default {USUAL_SCENARIO}: ")
    parser.add_argument(
        "--episodes",
        type=whole("seeds"),
        default=8192,
        metavar="N",
        help="flights to learn from (default: %(default)s)",
    )
    parser.add_argument(
        "--steps", type=whole("steps"), default=8000, metavar="N", help="steps of learning (default: %(default)s)"
    )
    parser.add_argument(
        "--units", type=whole("width of a layer"), default=192, metavar="N",
        help="units of the network's state (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--eval-episodes", type=whole("seeds", high=len(ALL_VALIDATION)), default=192, metavar="N",
        help="validation episodes at the end (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--seed", type=whole("seed"), default=0, metavar="S", help="of the run (default: %(default)s)")
    parser.add_argument("--out", required=True, metavar="DIR", help="new folder, or an empty one")


def run(args: argparse.Namespace) -> int:
    """Fly, learn, and say what came of it; returns the exit status."""
    require("torch", "tqdm")
    import torch

    from uwoc_gym.agents.learning import tracking

    name, _, _, scenario = said(USUAL_SCENARIO if args.scenario is None else args.scenario, args.override)
    tracking.check(scenario)
    training_seed(args.seed)
    check_flights([tracking.PILOT], {name: scenario}, args.episodes)
    folder = files.new_folder(args.out)
    torch.set_num_threads(1)
    begun = time.perf_counter()
    with files.locked(folder):
        network, losses = _taught(args, scenario)
        with files.whole(folder / FILE) as part, part.open("wb") as file:
            kept = {key: each.astype(np.float32) for key, each in network.weights()._asdict().items()}
            np.savez(file, **kept)
        finished = len(losses) == args.steps
        seeds = ALL_VALIDATION[: args.eval_episodes]
        document = {
            "finished": finished,
            "steps": len(losses),
            "episodes": args.episodes,
            "units": args.units,
            "seed": args.seed,
            "loss": float(np.mean(losses[-_SHOWN:])),
            "validation_seeds": [seeds[0], seeds[-1]],
            "results": {},
        }
        # What is learned stands, whatever becomes of the judging.
        files.write_results(folder, args.command_line, {name: scenario}, document)
        found = document["results"] = _judged(scenario, folder / FILE, seeds)
        document["wall_time_s"] = round(time.perf_counter() - begun, 1)
        files.write_results(folder, args.command_line, {name: scenario}, document)
    for called, each in found.items():
        print(
            f"{called}: {each['place_rms_m']:.3f} m off (RMS; median {each['place_median_m']:.3f}), "
            f"{each['heading_rms_rad']:.3f} rad; nlpd-tuned behind it: return {each['return']:.1f}"
        )
    print(f"{places.address(folder / FILE)}: {len(losses):,} steps")
    if not finished:
        print(f"uwoc-gym tracker: interrupted after {len(losses):,} steps of {args.steps:,}", file=sys.stderr)
        return interrupts.status()
    return 0


def _taught(args: argparse.Namespace, scenario: Scenario) -> tuple[Network, list[float]]:
    """A network that has learned to the end, or until it was asked to stop, and the loss at each step.

    Raises:
        KeyboardInterrupt: The process was asked to stop before anything was learned.
    """
    import torch
    from tqdm import tqdm

    from uwoc_gym.agents.learning import tracking

    torch.manual_seed(args.seed)
    network, first = tracking.Network(args.units), training_seed(args.seed)
    parts: list[tracking.Ways] = []
    losses: list[float] = []
    with interrupts.noted() as asked:
        with tqdm(total=args.episodes, unit="flight", file=sys.stderr) as bar:
            for seeds in batches(range(first, first + args.episodes), _AT_A_TIME):
                parts.append(tracking.sailed(scenario, seeds))
                bar.update(len(seeds))
                if asked:
                    raise KeyboardInterrupt
        with tqdm(total=args.steps, unit="step", file=sys.stderr) as bar:
            for loss in tracking.learn(network, tracking.Ways.joined(parts), args.steps, args.seed):
                losses.append(loss)
                bar.update()
                bar.set_postfix_str(f"loss {np.mean(losses[-_SHOWN:]):.4f}", refresh=False)
                if asked:
                    break
    return network, losses


def _judged(scenario: Scenario, weights: Path, seeds: Sequence[int]) -> dict[str, dict[str, float]]:
    """The errors of both trackers on seeds, and what the same law reaches behind them."""
    from uwoc_gym.agents.learning import tracking

    rival, its = tracking.RIVAL
    trackers: dict[str, Tracker] = {rival: its, "learned": partial(LearnedTracker, weights=weights)}
    found = tracking.errors(scenario, trackers, seeds)
    for called, tracker in trackers.items():
        law = Policy(called, "", partial(Controller, "nlpd-tuned", filtered=tracker))
        flown = [fly(law, scenario, batch).metrics for batch in batches(seeds, BATCH)]
        found[called]["return"] = float(np.concatenate([each.return_ for each in flown]).mean())
    return found
