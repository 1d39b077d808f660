"""`uwoc-gym evaluate`: one policy through one scenario on given seeds."""

from __future__ import annotations

import argparse
import time

from uwoc_gym.agents.flight import batches, draws, fly, load, load_scenario
from uwoc_gym.agents.options import naming, output_folder, whole
from uwoc_gym.agents.reports import tables as report

HELP = "fly one policy through one scenario and print its measures"
EXAMPLES = """\
examples:
  uwoc-gym evaluate nlpd
  uwoc-gym evaluate runs/ppo --scenario Random --seed 1000 --seeds 50 --out results
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "policy", metavar="POLICY", help="a name, a training run's folder, a .zip file, module:callable"
    )
    parser.add_argument(
        "--scenario", default="Random", metavar="SCENARIO", help="name, ID or .json file (default: %(default)s)"
    )
    parser.add_argument(
        "--seeds", type=whole(1), default=20, metavar="N", help="number of seeds (default: %(default)s)"
    )
    parser.add_argument("--seed", type=whole(0), default=0, metavar="S", help="first seed (default: %(default)s)")
    parser.add_argument("--out", metavar="DIR", help="folder for results.json")


def run(args: argparse.Namespace) -> int:
    """Fly and report; returns the exit status."""
    with naming("--scenario"):
        name, scenario = load_scenario(args.scenario)
    with naming("POLICY"):
        policy = load(args.policy)
    folder = output_folder(args.out) if args.out else None
    begun = time.perf_counter()
    seeds = range(args.seed, args.seed + args.seeds)
    collapsed = policy.deterministic and not draws(scenario) and len(seeds) > 1
    if collapsed:
        seeds = seeds[:1]
    rows = [row for batch in batches(seeds, 100) for row in fly(policy, scenario, batch).metrics.rows()]
    data = report.results_data([report.Result(name, policy.name, rows, collapsed)], args.seed)
    print(report.table(data), end="")
    if folder is not None:
        document = {
            "settings": {"policy": policy.name, "seeds": list(seeds), "scenario": scenario.to_dict()},
            "wall_time_s": round(time.perf_counter() - begun, 3),
            "results": data,
            "episodes": [{"seed": seed, **row} for seed, row in zip(seeds, rows, strict=True)],
        }
        report.write_results(folder, args.command_line, {name: scenario}, document)
    return 0
