"""`uwoc-gym tracker`: teach a network how ships sail, for laws where the ship is known by late fixes."""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial

import numpy as np

from uwoc_gym.agents import interrupts
from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.flight import batches, check_flights, fly
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION, BATCH, training_seed
from uwoc_gym.agents.options import add_scenario_arguments, whole
from uwoc_gym.agents.reports import files
from uwoc_gym.agents.scenarios import said
from uwoc_gym.baselines import Controller
from uwoc_gym.baselines.learned_tracker import LearnedTracker
from uwoc_gym.baselines.policy import Policy

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
        "--eval-episodes", type=whole("seeds"), default=192, metavar="N",
        help="validation episodes at the end (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--seed", type=whole("seed"), default=0, metavar="S", help="of the run (default: %(default)s)")
    parser.add_argument("--out", required=True, metavar="DIR", help="new folder, or an empty one")


def run(args: argparse.Namespace) -> int:
    """Fly, learn, and say what came of it; returns the exit status."""
    require("torch", "tqdm")
    import torch
    from tqdm import tqdm

    from uwoc_gym.agents.learning import tracking

    name, _, _, scenario = said(USUAL_SCENARIO if args.scenario is None else args.scenario, args.override)
    tracking.check(scenario)
    first = training_seed(args.seed)
    check_flights([tracking.PILOT], {name: scenario}, args.episodes)
    folder = files.output_folder(args.out)
    if (folder / FILE).exists():
        raise CommandError(f"--out {folder} holds a {FILE} already; give another folder.")
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    begun = time.perf_counter()
    network = tracking.Network(args.units)
    steps, losses = 0, []
    with files.locked(folder), interrupts.noted() as asked:
        parts = []
        with tqdm(total=args.episodes, unit="flight", file=sys.stderr) as bar:
            for seeds in batches(range(first, first + args.episodes), _AT_A_TIME):
                parts.append(tracking.sailed(scenario, seeds))
                bar.update(len(seeds))
                if asked:
                    raise KeyboardInterrupt
        with tqdm(total=args.steps, unit="step", file=sys.stderr) as bar:
            for own in tracking.learn(network, tracking.Ways.joined(parts), args.steps, args.seed):
                steps += 1
                losses.append(own)
                bar.update()
                bar.set_postfix_str(f"loss {np.mean(losses[-100:]):.4f}", refresh=False)
                if asked:
                    break
        with files.whole(folder / FILE) as part, part.open("wb") as file:
            kept = {key: each.astype(np.float32) for key, each in network.weights()._asdict().items()}
            np.savez(file, **kept)
        learned = partial(LearnedTracker, weights=folder / FILE)
        seeds = ALL_VALIDATION[: args.eval_episodes]
        rival, its = tracking.RIVAL
        found = tracking.errors(scenario, {rival: its, "learned": learned}, seeds)
        for called, tracker in ((rival, its), ("learned", learned)):
            law = Policy(called, "", partial(Controller, "nlpd-tuned", filtered=tracker))
            flown = [fly(law, scenario, batch).metrics for batch in batches(seeds, BATCH)]
            found[called]["return"] = float(np.concatenate([each.return_ for each in flown]).mean())
        document = {
            "finished": steps == args.steps,
            "steps": steps,
            "episodes": args.episodes,
            "units": args.units,
            "seed": args.seed,
            "loss": float(np.mean(losses[-100:])),
            "wall_time_s": round(time.perf_counter() - begun, 1),
            "validation_seeds": [seeds[0], seeds[-1]],
            "results": found,
        }
        files.write_results(folder, args.command_line, {name: scenario}, document)
    for called, each in found.items():
        print(
            f"{called}: {each['place_rms_m']:.3f} m off (RMS; median {each['place_median_m']:.3f}), "
            f"{each['heading_rms_rad']:.3f} rad; nlpd-tuned behind it: return {each['return']:.1f}"
        )
    print(f"{folder / FILE}: {steps:,} steps")
    if asked:
        print(f"uwoc-gym tracker: interrupted after {steps:,} steps of {args.steps:,}", file=sys.stderr)
        return interrupts.status()
    return 0
