"""Video files."""

from __future__ import annotations

from pathlib import Path

import pytest

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.viewing import video

pytest.importorskip("imageio_ffmpeg")


def test_an_encoder_that_fails_is_quoted(tmp_path: Path) -> None:
    def write() -> None:
        with video.writing(tmp_path / "a.mp4", (641, 361), 20.0) as writer:
            for _ in range(50):
                writer.add(bytes(641 * 361 * 3))

    with pytest.raises(CommandError, match=r"--out .*a\.mp4: ffmpeg failed: "):
        write()
    assert list(tmp_path.iterdir()) == []
