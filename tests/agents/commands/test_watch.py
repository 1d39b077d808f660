"""Watching, and how it ends."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main

pygame = pytest.importorskip("pygame")


pytest.importorskip("imageio_ffmpeg")

from uwoc_gym.agents.viewing.player import Player  # noqa: E402

SMALL = ["--size", "640x360"]


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    path = tmp_path / "short.json"
    path.write_text(Scenario.named("Random").merged({"episode": {"duration_s": 2.0}}).to_json())
    return path


def test_watch_ends_well_when_the_window_is_closed(
    scenario_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frames: list[int] = []
    real = Player.frame

    def frame(self: Player) -> bool:
        frames.append(1)
        if len(frames) == 3:
            pygame.event.post(pygame.event.Event(pygame.QUIT))
        return real(self)

    monkeypatch.setattr(Player, "frame", frame)
    assert main(["watch", "--scenario", str(scenario_file), *SMALL]) == 0
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
