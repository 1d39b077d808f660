"""Recording policies on one episode, side by side, to video files."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from uwoc_gym.agents import interrupts
from uwoc_gym.agents.viewing.episode import Episode
from uwoc_gym.agents.viewing.stage import Stage
from uwoc_gym.agents.viewing.video import writing


class Recorded(NamedTuple):
    """What a recording came to."""

    frames: int
    interrupted_s: float | None
    """Time of the episode at which the user interrupted it [s]; None if nobody did."""


def record(
    wanted: Episode,
    paths: Sequence[Path],
    size: tuple[int, int],
    begin_s: float,
    end_s: float,
    speed: float,
    frames_per_s: float,
) -> Recorded:
    """Fly and write the files; an interrupt ends them where they are, so that they can be played.

    Args:
        wanted: Who flies what.
        paths: Files to write, .mp4 or .gif.
        size: Width and height of the picture [px].
        begin_s: First moment shown [s].
        end_s: Last moment shown [s].
        speed: Times real time.
        frames_per_s: Frames shown per second.

    Raises:
        CommandError: There is no encoder, it fails, or the picture is too small for all policies.
    """
    from tqdm import tqdm

    stage = Stage(wanted, size)
    count = math.floor((end_s - begin_s) * frames_per_s / speed + 1e-9) + 1
    shown = 0
    with ExitStack() as files, interrupts.noted() as interrupted:
        writers = [files.enter_context(writing(path, size, frames_per_s)) for path in paths]
        for k in tqdm(range(count), unit="frame", file=sys.stderr, desc="recording"):
            stage.fly_until(begin_s + k * speed / frames_per_s)
            frame = stage.frame()
            for writer in writers:
                writer.add(frame)
            shown += 1
            if interrupted or stage.ended:
                break
    return Recorded(shown, stage.time_s if interrupted else None)
