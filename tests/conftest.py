"""No test opens a window that anyone would see; and what a video file holds."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("SDL_AUDIODRIVER", "dummy")


class VideoFacts(NamedTuple):
    """What ffmpeg finds when it decodes a whole file."""

    codec: str
    pixel_format: str
    size: tuple[int, int]
    frames_per_s: float
    frames: int


@pytest.fixture(scope="session")
def video_facts() -> Callable[[Path], VideoFacts]:
    """Decode a video to its end; fails where it can't be played."""
    encoder = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()

    def look(path: Path) -> VideoFacts:
        command = [encoder, "-v", "info", "-xerror", "-i", str(path), "-f", "null", "-"]
        said = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=True).stderr
        stream = re.search(r"Video: (\w+).*?, (\w+)[(,].*?(\d+)x(\d+).*?([\d.]+) fps", said)
        assert stream, said
        frames = int(re.findall(r"frame=\s*(\d+)", said)[-1])
        codec, pixels, width, height, rate = stream.groups()
        return VideoFacts(codec, pixels, (int(width), int(height)), float(rate), frames)

    return look
