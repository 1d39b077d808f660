"""Recording: what it writes, interruptions and errors."""

from __future__ import annotations

import importlib.util
import signal
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main

pygame = pytest.importorskip("pygame")

from uwoc_gym.agents.viewing import stage as staging  # noqa: E402

SMALL = ["--size", "640x360"]


@pytest.fixture
def record(short_file: Callable[[float], Path]) -> Callable[..., int]:
    def run(*options: str) -> int:
        return main(["record", "--scenario", str(short_file(2.0)), *SMALL, *options])

    return run


def test_both_kinds_of_file(
    record: Callable[..., int], tmp_path: Path, video_facts: Callable[[Path], Any], capsys: pytest.CaptureFixture[str]
) -> None:
    movie, gif = tmp_path / "new/a.mp4", tmp_path / "new/a.gif"
    assert record("--policy", "pd", "nlpd", "--fps", "10", "--out", str(movie), str(gif)) == 0
    assert video_facts(movie) == ("h264", "yuv420p", (640, 360), 10.0, 21)
    facts = video_facts(gif)
    assert (facts.codec, facts.size, facts.frames_per_s) == ("gif", (640, 360), 10.0)
    assert facts.frames == 21
    assert sorted(path.name for path in movie.parent.iterdir()) == ["a.gif", "a.mp4"]
    captured = capsys.readouterr()
    assert "recording" in captured.err
    assert f"{movie}: 21 frames, 2.1 s" in captured.out
    assert "pygame" not in captured.out


def test_part_of_an_episode_at_another_speed(
    record: Callable[..., int], tmp_path: Path, video_facts: Callable[[Path], Any]
) -> None:
    out = tmp_path / "a.mp4"
    assert record("--from", "0.5", "--to", "1.5", "--speed", "0.5", "--fps", "15", "--out", str(out)) == 0
    assert (video_facts(out).frames, video_facts(out).frames_per_s) == (31, 15.0)


def test_an_early_end_ends_the_recording(tmp_path: Path, video_facts: Callable[[Path], Any]) -> None:
    far = Scenario().merged({"start": {"x_m": 0.0, "y_m": 9.02, "sway_mps": -5.0}, "episode": {"lost_distance_m": 1.0}})
    path = tmp_path / "far.json"
    path.write_text(far.to_json())
    out = tmp_path / "a.mp4"
    assert main(["record", "--scenario", str(path), "--policy", "pd", "--out", str(out), *SMALL]) == 0
    assert video_facts(out).frames == 2


def test_an_interrupt_leaves_a_playable_file(
    record: Callable[..., int],
    tmp_path: Path,
    video_facts: Callable[[Path], Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    real, shown = staging.Stage.frame, []

    def frame(self: staging.Stage) -> bytes:
        shown.append(1)
        if len(shown) == 7:
            signal.raise_signal(signal.SIGINT)
        return real(self)

    monkeypatch.setattr(staging.Stage, "frame", frame)
    out = [tmp_path / "a.mp4", tmp_path / "a.gif"]
    handler = signal.getsignal(signal.SIGINT)
    assert record("--out", *map(str, out)) == 130
    assert signal.getsignal(signal.SIGINT) is handler
    assert [video_facts(path).frames for path in out] == [7, 7]
    assert "interrupted at 0.3 s" in capsys.readouterr().err.splitlines()[-1]


def test_an_error_leaves_nothing(
    record: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Wild:
        calls = 0

        def predict(self, observation: Any, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
            self.calls += 1
            return np.full((1, 3), np.nan if self.calls > 5 else 0.0), None

    module = types.ModuleType("uwoc_wild_policies")
    module.wild = lambda scenario: Wild()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    out = tmp_path / "out"
    assert record("--policy", "uwoc_wild_policies:wild", "--out", str(out / "a.mp4"), str(out / "a.gif")) == 1
    assert "not all finite" in capsys.readouterr().err.splitlines()[-1]
    assert list(out.iterdir()) == []


def test_existing_files_are_kept_without_force(
    record: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.mp4"
    out.write_text("mine")
    assert record("--out", str(out)) == 1
    assert capsys.readouterr().err.splitlines()[-1].endswith("already exists; give --force to overwrite it.")
    assert out.read_text() == "mine"
    assert record("--out", str(out), "--force", "--to", "0.2") == 0
    assert out.read_bytes()[4:8] == b"ftyp"


def test_a_missing_encoder_is_named(
    record: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import imageio_ffmpeg

    def missing() -> str:
        raise RuntimeError("No ffmpeg exe could be found")

    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", missing)
    assert record("--out", str(tmp_path / "a.mp4")) == 1
    assert "there is no ffmpeg" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("missing", ["pygame", "imageio_ffmpeg", "plotly"])
def test_missing_extras_are_named(
    missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else real(name))
    command = "replay" if missing == "plotly" else "record"
    assert main([command]) == 1
    assert f'{missing} is not installed; run: pip install "uwoc-gym[render]"' in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["record", "--policy", "nlpdd"], ["--policy", "did you mean 'nlpd'?", "Valid names: pd, pd-plain, nlpd"]),
        (["record", "--scenario", "uwoc/Nominl-v0"], ["--scenario", "did you mean 'uwoc/Nominal-v0'?", "StrongPulse"]),
        (["record", "--out", "a.avi"], ["--out a.avi", ".mp4 or .gif"]),
        (["record", "--out", f"{__file__}/a.mp4"], ["--out", "can be written"]),
        (["record", "--from", "200"], ["--from 200", "150 s"]),
        (["record", "--from", "5", "--to", "4"], ["--from 5", "--to"]),
        (["record", "--from", "-1"], ["--from", "from 0.0 to"]),
        (["record", "--size", "10x10"], ["--size", "'10x10'", "1280x720"]),
        (["record", "--size", "big"], ["--size", "'big'"]),
        (["record", "--speed", "0"], ["--speed", "from 0.01 to"]),
        (["record", "--fps", "nan"], ["--fps", "from 0.1 to"]),
        (["record", "--fps", "60", "--out", "no_such_file.gif"], ["--fps 60", "50"]),
        (["watch", "--policy", "nlpdd"], ["--policy", "Valid names"]),
        (["watch", "--speed", "fast"], ["--speed", "'fast'"]),
    ],
)
def test_errors_are_one_line(options: list[str], words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(options) in (1, 2)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    for word in words:
        assert word in captured.err


def test_pictures_too_small_for_all_policies_are_refused(tmp_path, capsys):
    words = ["record", "--policy", "pd", "nlpd", "pd-tuned", "nlpd-tuned", "--size", "320x180"]
    assert main([*words, "--out", str(tmp_path / "a.gif")]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "--size 320x180 is not allowed with 4 policies; each needs at least 320x180" in error
    assert not (tmp_path / "a.gif").exists()
