"""`uwoc-gym evaluate`: one policy through one scenario on given seeds."""

from __future__ import annotations

import argparse
import sys
import time

from uwoc_gym.agents import interrupts
from uwoc_gym.agents.errors import naming
from uwoc_gym.agents.flight import batches, check_flights, flown_seeds, fly
from uwoc_gym.agents.options import (
    add_scenario_arguments,
    add_trust_argument,
    add_wrapper_argument,
    scenario_of,
    whole,
    wrapping_of,
)
from uwoc_gym.agents.policies.registry import MAY_BE, load
from uwoc_gym.agents.reports import files, tables

HELP = "fly one policy through one scenario and print its measures"
EXAMPLES = """\
examples:
  uwoc-gym evaluate nlpd
  uwoc-gym evaluate runs/ppo --scenario Random --seed 1000 --seeds 50 --out results
  uwoc-gym evaluate tuning/nlpd/gains.json --override 'sea.pulses[*].force_x_n*=0.5' episode.duration_s=30
  uwoc-gym evaluate ppo --wrapper gymnasium.wrappers:DelayObservation,delay=2
"""

BATCH = 100
"""Episodes flown at a time."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("policy", metavar="POLICY", help=MAY_BE)
    add_trust_argument(parser)
    add_scenario_arguments(parser, "Random")
    add_wrapper_argument(parser)
    parser.add_argument(
        "--seeds", type=whole("seeds"), default=20, metavar="N", help="number of seeds (default: %(default)s)"
    )
    parser.add_argument("--seed", type=whole("seed"), default=0, metavar="S", help="first seed (default: %(default)s)")
    parser.add_argument("--out", metavar="DIR", help="folder for results.json")


def run(args: argparse.Namespace) -> int:
    """Fly and report; returns the exit status."""
    name, scenario = scenario_of(args)
    with naming("POLICY"):
        policy = load(args.policy, args.trust)
    around = wrapping_of(args)
    check_flights([policy], {name: scenario}, min(args.seeds, BATCH), around)
    folder = files.output_folder(args.out) if args.out else None
    begun = time.perf_counter()
    asked = range(args.seed, args.seed + args.seeds)
    seeds = flown_seeds(policy, scenario, asked, around)
    rows: list[dict[str, float]] = []
    interrupted = False
    try:
        for batch in batches(seeds, BATCH):
            rows += fly(policy, scenario, batch, wrapping=around).metrics.rows()
    except KeyboardInterrupt:
        if not rows:
            raise
        interrupted = True
    data = tables.results_data([tables.Result(name, policy.name, rows, len(seeds) < len(asked))], args.seed)
    print(tables.table(data, around.plain()), end="")
    if folder is not None:
        document = {
            "finished": not interrupted,
            "settings": {
                "policy": policy.name,
                "seeds": list(seeds[: len(rows)]),
                "scenario": scenario.to_dict(),
                "wrappers": around.plain(),
            },
            "wall_time_s": round(time.perf_counter() - begun, 3),
            "results": data,
            "episodes": [{"seed": seed, **row} for seed, row in zip(seeds, rows, strict=False)],
        }
        files.write_results(folder, args.command_line, {name: scenario}, document)
    if interrupted:
        print(f"uwoc-gym evaluate: interrupted after {len(rows)} finished episodes", file=sys.stderr)
        return interrupts.status()
    return 0
