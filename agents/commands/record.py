"""`uwoc-gym record`: policies on the same episode, side by side, to MP4 and GIF."""

from __future__ import annotations

import argparse
import math
import sys

from uwoc_gym.agents import interrupts
from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.flight import check_flights
from uwoc_gym.agents.options import (
    add_episode_arguments,
    add_file_arguments,
    episode_of,
    frame_size,
    number,
)
from uwoc_gym.agents.reports.files import output_file
from uwoc_gym.given import LIMITS
from uwoc_gym.spaces import FRAME

HELP = "record policies on the same episode, side by side, to MP4 or GIF"
EXAMPLES = """\
examples:
  uwoc-gym record
  uwoc-gym record --policy pd nlpd --scenario StrongPulse --from 28 --to 38 --out pulse.mp4 pulse.gif
  uwoc-gym record --policy runs/ppo/model.zip --scenario Random --seed 7 --size 1920x1080 --speed 2

Interrupted, it ends the files where it is, so that they can be played.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_episode_arguments(parser, ["pd", "nlpd"])
    add_file_arguments(parser, "link.mp4", True, "one or several files, .mp4 or .gif")
    parser.add_argument(
        "--from",
        type=number("seconds", low=0.0),
        default=0.0,
        metavar="S",
        dest="begin",
        help="first moment shown [s] (default: 0)",
    )
    parser.add_argument(
        "--to",
        type=number("seconds"),
        default=math.inf,
        metavar="S",
        dest="end",
        help="last moment shown [s] (default: the end)",
    )
    parser.add_argument(
        "--speed",
        type=number("times real time"),
        default=1.0,
        metavar="X",
        help="times real time (default: %(default)g)",
    )
    parser.add_argument(
        "--fps",
        type=number("frames per second"),
        default=20.0,
        metavar="N",
        help="frames per second (default: %(default)g)",
    )
    parser.add_argument(
        "--size", type=frame_size, default=FRAME, metavar="WxH", help="size of the picture [px] (default: 1280x720)"
    )


def run(args: argparse.Namespace) -> int:
    """Record; returns the exit status."""
    require("pygame", "imageio_ffmpeg", "tqdm")
    from uwoc_gym.agents.viewing.recording import record
    from uwoc_gym.agents.viewing.video import SUFFIXES

    wanted = episode_of(args)
    duration = wanted.scenario.episode.duration_s
    if not args.begin < min(args.end, duration):
        raise CommandError(
            f"--from {args.begin:g} is not allowed; it must lie before --to and before the episode's end at "
            f"{duration:g} s."
        )
    end = min(args.end, duration)
    frames = (end - args.begin) * args.fps / args.speed
    if frames > LIMITS["frames"].high:
        raise CommandError(
            f"--fps {args.fps:g} at --speed {args.speed:g} is not allowed for {end - args.begin:g} s; the "
            f"{frames:.0f} frames must be at most {LIMITS['frames'].high:_}."
        )
    check_flights(wanted.policies, {wanted.scenario_name: wanted.scenario}, 1, wanted.wrapping)
    if any(name.lower().endswith(".gif") for name in args.out) and args.fps > 50.0:
        raise CommandError(f"--fps {args.fps:g} is not allowed; a GIF shows at most 50 frames per second.")
    paths = [output_file(given, SUFFIXES, args.force) for given in dict.fromkeys(args.out)]
    shown, interrupted_s = record(wanted, paths, args.size, args.begin, end, args.speed, args.fps)
    for path in paths:
        print(f"{path}: {shown} frames, {shown / args.fps:.1f} s, {path.stat().st_size / 1e6:.2f} MB")
    if interrupted_s is not None:
        print(f"uwoc-gym record: interrupted at {interrupted_s:.1f} s of the episode", file=sys.stderr)
        return interrupts.status()
    return 0
