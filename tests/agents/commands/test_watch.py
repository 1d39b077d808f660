"""Watching, and how it ends."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from uwoc_gym.agents.cli import main

pygame = pytest.importorskip("pygame")

from uwoc_gym.agents.viewing.player import Player  # noqa: E402

SMALL = ["--size", "640x360"]


def test_watch_ends_well_when_the_window_is_closed(
    short_file: Callable[[float], Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frames: list[int] = []
    real = Player.frame

    def frame(self: Player) -> bool:
        frames.append(1)
        if len(frames) == 3:
            pygame.event.post(pygame.event.Event(pygame.QUIT))
        return real(self)

    monkeypatch.setattr(Player, "frame", frame)
    assert main(["watch", "--scenario", str(short_file(2.0)), *SMALL]) == 0
    assert len(frames) == 3
    assert capsys.readouterr() == ("", "")


@pytest.mark.skipif(sys.platform != "linux", reason="only on Linux can a display be taken away")
def test_watch_without_a_display(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    pygame.display.quit()
    assert main(["watch"]) == 1
    error = capsys.readouterr().err
    assert "no display" in error
    assert "rgb_array" in error
    assert "uwoc-gym record" in error
