"""`uwoc-gym watch`: policies on the same episode, live, side by side."""

from __future__ import annotations

import argparse

from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.flight import check_flights
from uwoc_gym.agents.options import add_episode_arguments, episode_of, frame_size, number
from uwoc_gym.spaces import FRAME

HELP = "watch policies on the same episode, live, side by side"
EXAMPLES = """\
keys:
  space          pause and go on
  up, down       twice and half the speed
  left, right    give every AUV a shove to port or to starboard
  N, R           the next seed; the same seed again
  Q, escape      quit, as closing the window does

examples:
  uwoc-gym watch
  uwoc-gym watch --policy pd nlpd runs/ppo/model.zip --scenario Random --seed 7 --speed 2
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_episode_arguments(parser, ["pd", "nlpd"])
    parser.add_argument(
        "--speed",
        type=number("times real time"),
        default=1.0,
        metavar="X",
        help="times real time (default: %(default)g)",
    )
    parser.add_argument(
        "--size", type=frame_size, default=FRAME, metavar="WxH", help="size of the window [px] (default: 1280x720)"
    )


def run(args: argparse.Namespace) -> int:
    """Show until the user has seen enough; returns the exit status."""
    require("pygame")
    from uwoc_gym.agents.viewing.player import Player
    from uwoc_gym.rendering import NoDisplayError

    wanted = episode_of(args)
    check_flights(wanted.policies, {wanted.scenario_name: wanted.scenario}, 1, wanted.wrapping)
    try:
        player = Player(wanted, args.size, args.speed)
    except NoDisplayError as error:
        raise CommandError(f"{error} At the command line, `uwoc-gym record` writes a video instead.") from None
    try:
        while player.frame():
            pass
    finally:
        player.close()
    return 0
