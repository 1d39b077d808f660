"""`uwoc-gym replay`: policies on the same episode as one page that opens offline."""

from __future__ import annotations

import argparse
import sys

from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.flight import check_flights, fly
from uwoc_gym.agents.options import add_episode_arguments, add_file_arguments, episode_of, number
from uwoc_gym.agents.reports.files import output_file, write_text
from uwoc_gym.agents.viewing.replay import page, page_data

HELP = "fly policies through one episode and write it as a page to turn, zoom and play"
EXAMPLES = """\
examples:
  uwoc-gym replay
  uwoc-gym replay --policy pd nlpd runs/ppo/model.zip --scenario Random --seed 7 --out random.html

The page holds all it needs in one file; open it in any browser with WebGL.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_episode_arguments(parser, ["pd", "nlpd"])
    add_file_arguments(parser, "replay.html", False, "the page")
    parser.add_argument(
        "--at",
        type=number("seconds", low=0.0),
        default=0.0,
        metavar="S",
        help="moment that the page opens at [s] (default: 0)",
    )


def run(args: argparse.Namespace) -> int:
    """Fly and write; returns the exit status."""
    require("plotly", "tqdm")
    from plotly.offline import get_plotlyjs
    from tqdm import tqdm

    wanted = episode_of(args)
    check_flights(wanted.policies, {wanted.scenario_name: wanted.scenario}, 1, wanted.wrapping)
    duration = wanted.scenario.episode.duration_s
    if args.at > duration:
        raise CommandError(f"--at {args.at:g} is not allowed; it must be at most the episode's {duration:g} s.")
    path = output_file(args.out, (".html",), args.force)
    flights = {}
    for policy in tqdm(wanted.policies, unit="policy", file=sys.stderr, desc="flying"):
        flights[policy.name] = fly(policy, wanted.scenario, [wanted.seed], wrapping=wanted.wrapping)
    text = page(page_data(wanted, flights, args.at), get_plotlyjs())
    write_text(path, text)
    print(f"{path}: {len(text.encode()) / 1e6:.2f} MB")
    return 0
