"""`uwoc-gym calibrate`: search for what the paper doesn't give, so that its tables come out."""

from __future__ import annotations

import argparse
import sys

from uwoc_gym.agents import interrupts
from uwoc_gym.agents.errors import require
from uwoc_gym.agents.learning.calibration import case_problem, nlpd_problem
from uwoc_gym.agents.learning.search import search
from uwoc_gym.agents.options import add_search_arguments, whole
from uwoc_gym.agents.reports import files

HELP = "search for what the paper doesn't give: the NLPD's exponents, and the noise and pulse of its two cases"
EXAMPLES = """\
examples:
  uwoc-gym calibrate nlpd --out calibration/nlpd
  uwoc-gym calibrate case-1 --out calibration/case-1
  uwoc-gym calibrate nlpd --out calibration/nlpd --trials 6000 --resume
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("target", choices=("nlpd", "case-1", "case-2"), help="what to search for")
    parser.add_argument(
        "--variant",
        choices=("found", "printed"),
        default="found",
        help="the cases' PD: without feedforward on a plant without Coriolis terms, as its nominal row was found to "
        "be, or as printed (default: %(default)s)",
    )
    parser.add_argument(
        "--trials", type=whole("trials"), metavar="N", help="points to try in all (default: 4000; cases 1500)"
    )
    parser.add_argument(
        "--batch",
        type=whole("episodes at a time", low=2),
        default=64,
        metavar="N",
        help="points to try at a time (default: %(default)s)",
    )
    add_search_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Search and report; returns the exit status."""
    require("optuna", "cmaes", "tqdm")
    problem = nlpd_problem() if args.target == "nlpd" else case_problem(args.target, args.variant)
    folder = files.output_folder(args.out)
    said = {"target": args.target, "variant": args.variant, "seed": args.seed}
    with files.locked(folder):
        found = search(
            folder,
            said,
            problem.box,
            problem.evaluate,
            trials=args.trials or problem.trials,
            batch=args.batch,
            seed=args.seed,
            direction="minimize",
            sampler="cma-es",
            resume=args.resume,
        )
    files.write_text(folder / problem.file, problem.text(found.best))
    document = {
        "finished": found.finished,
        **said,
        "trials": found.trials,
        "score": found.best.score,
        "found": found.best.values,
        **problem.write(found.best),
    }
    files.write_results(folder, args.command_line, problem.scenarios, document)
    print(f"score {found.best.score:.6g} after {found.trials} trials; found:")
    for name, value in {**found.best.values, **found.best.outcome}.items():
        print(f"  {name:<32} {value:.6g}")
    if not found.finished:
        print("uwoc-gym calibrate: interrupted; --resume goes on", file=sys.stderr)
        return interrupts.status()
    return 0
