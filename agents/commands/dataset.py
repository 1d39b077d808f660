"""`uwoc-gym dataset`: episodes of policies, or of a training, as data for offline learning."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from uwoc_gym.agents import interrupts, places
from uwoc_gym.agents.errors import CommandError, naming, require
from uwoc_gym.agents.flight import batches, check_flights, flown_seeds
from uwoc_gym.agents.learning.demonstrations import flown, replayed
from uwoc_gym.agents.learning.seeds import HELD_OUT
from uwoc_gym.agents.options import (
    add_scenario_arguments,
    add_trust_argument,
    number,
    policies_of,
    whole,
)
from uwoc_gym.agents.policies.registry import MAY_BE
from uwoc_gym.agents.reports import datasets, files
from uwoc_gym.agents.reports.datasets import Dataset
from uwoc_gym.agents.scenarios import said
from uwoc_gym.scenario import Scenario

HELP = "write episodes of policies, or of a training, as a dataset of Minari"
EXAMPLES = """\
examples:
  uwoc-gym dataset --policy nlpd-tuned --out datasets/random-expert-v0
  uwoc-gym dataset --policy pd --noise 0.3 --out datasets/random-medium-v0
  uwoc-gym dataset --policy nlpd-tuned pd runs/ppo --scenario StrongPulse --episodes 50 --out datasets/pulse-mixed-v0
  uwoc-gym dataset --replay runs/td3 --out datasets/random-replay-v0

Each episode has its seed: reset(seed=...) of the environment that Minari recovers begins it, and its actions then fly
it bit for bit. In Python, with MINARI_DATASETS_PATH=datasets: minari.load_dataset("random-expert-v0").
"""

BATCH = 100
"""Episodes flown at a time."""

USUAL = 100
"""Episodes a policy."""

USUAL_SEED = 1000
"""Of the first one."""

USUAL_SCENARIO = "Random"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--policy",
        nargs="+",
        metavar="POLICY",
        help=f"what flies, each {MAY_BE}",
    )
    what.add_argument(
        "--replay",
        metavar="RUN",
        help="instead, the replay buffer of a training run's folder (sac, td3 and tqc have one), in its own scenario",
    )
    add_trust_argument(parser)
    add_scenario_arguments(parser, None, f"by default {USUAL_SCENARIO}: ")
    parser.add_argument(
        "--episodes",
        type=whole("seeds"),
        metavar="N",
        help=f"episodes a policy (default: {USUAL}; of a replay its last ones, by default all)",
    )
    parser.add_argument(
        "--seed",
        type=whole("seed"),
        metavar="S",
        help=f"seed of the first episode, the others' follow (default: {USUAL_SEED}; the benchmark is flown on "
        f"{HELD_OUT[0]} to {HELD_OUT[-1]}, which nothing should be learned from)",
    )
    parser.add_argument(
        "--noise",
        type=number("noise"),
        metavar="σ",
        help="standard deviation of noise on every action, as a share of the actuators' limits (default: 0)",
    )
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="new folder, named like the dataset, such as random-expert-v0"
    )


def run(args: argparse.Namespace) -> int:
    """Fly and write; returns the exit status."""
    require("minari", "h5py", "tqdm")
    name, scenario, fill, settings = _replay(args) if args.replay is not None else _flights(args)
    folder = datasets.dataset_folder(args.out)
    begun = time.perf_counter()
    interrupted = False
    with datasets.written(folder, name, scenario) as dataset:
        try:
            fill(dataset)
        except KeyboardInterrupt:
            if not len(dataset):
                raise
            interrupted = True
        summary = datasets.summary(dataset.returns())
        dataset.describe(
            {
                "algorithm_name": ", ".join(summary),
                "description": _sentence(name, settings),
                "flown": settings,
                "returns": summary,
            }
        )
        document = {
            "finished": not interrupted,
            "settings": {**settings, "scenario": scenario.to_dict()},
            "wall_time_s": round(time.perf_counter() - begun, 3),
            "results": summary,
        }
        files.write_results(dataset.folder, args.command_line, {name: scenario}, document)
    for policy, own in summary.items():
        print(f"{policy}: {own['episodes']} episodes, return {own['return_mean']:.1f} ± {own['return_std']:.1f}")
    print(f"{places.address(folder)}: {len(dataset)} episodes")
    if interrupted:
        print(f"uwoc-gym dataset: interrupted after {len(dataset)} finished episodes", file=sys.stderr)
        return interrupts.status()
    return 0


def _flights(args: argparse.Namespace) -> tuple[str, Scenario, Callable[[Dataset], None], dict[str, object]]:
    """Name and scenario of what is flown, what flies it, and what there is to say about it."""
    name, _, _, scenario = said(USUAL_SCENARIO if args.scenario is None else args.scenario, args.override)
    policies = policies_of(args)
    count, noise = args.episodes or USUAL, args.noise or 0.0
    first = USUAL_SEED if args.seed is None else args.seed
    check_flights(policies, {name: scenario}, min(count, BATCH))
    wanted = range(first, first + count)
    plan = [(policy, wanted if noise else flown_seeds(policy, scenario, wanted)) for policy in policies]

    def fill(dataset: Dataset) -> None:
        from tqdm import tqdm

        with tqdm(total=sum(len(seeds) for _, seeds in plan), unit="episode", file=sys.stderr) as bar:
            for policy, seeds in plan:
                for batch in batches(seeds, BATCH):
                    episodes = flown(policy, scenario, batch, noise)
                    # An HDF5 file that is left in the middle of a write may not be read any more.
                    with interrupts.noted() as asked:
                        dataset.append(episodes)
                    bar.update(len(batch))
                    if asked:
                        raise KeyboardInterrupt

    seeds = {policy.name: [own[0], own[-1]] for policy, own in plan}
    return name, scenario, fill, {"policies": list(seeds), "seeds": seeds, "noise": noise}


def _replay(args: argparse.Namespace) -> tuple[str, Scenario, Callable[[Dataset], None], dict[str, object]]:
    for name in ("scenario", "override", "seed", "noise"):
        if getattr(args, name) is not None:
            raise CommandError(f"--{name} is not allowed beside --replay, whose run says what was flown.")
    with naming("--replay"):
        replay = replayed(Path(args.replay), args.trust)
    kept = replay.episodes[-args.episodes if args.episodes else None :]
    return replay.name, replay.scenario, lambda dataset: dataset.append(kept), {"run": args.replay, "policies": []}


def _sentence(name: str, settings: dict[str, object]) -> str:
    if "run" in settings:
        return f"uwoc-gym: the {name}."
    noise = f" with noise of {settings['noise']:g} on actions" if settings["noise"] else ""
    return f"uwoc-gym: {', '.join(map(str, settings['policies']))}{noise} in {name}."  # type: ignore[call-overload]
