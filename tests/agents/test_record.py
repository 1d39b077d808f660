"""`watch` and `record`: what they show and write, keys, interruptions and errors."""

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
from uwoc_gym.agents import flight as evaluate
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.commands import watch
from uwoc_gym.agents.viewing import episode, video

pygame = pytest.importorskip("pygame")
pytest.importorskip("imageio_ffmpeg")

from uwoc_gym.agents.viewing import stage as staging  # noqa: E402

SMALL = ["--size", "640x360"]


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    path = tmp_path / "short.json"
    path.write_text(Scenario.named("Random").merged({"episode": {"duration_s": 2.0}}).to_json())
    return path


@pytest.fixture
def record(scenario_file: Path, tmp_path: Path) -> Callable[..., int]:
    def run(*options: str) -> int:
        return main(["record", "--scenario", str(scenario_file), *SMALL, *options])

    return run


def an_episode(scenario: str | Path, *policies: str, seed: int = 0) -> episode.Episode:
    name, found = evaluate.load_scenario(str(scenario))
    return episode.Episode([evaluate.load(policy) for policy in policies], name, found, seed)


@pytest.fixture
def press(monkeypatch: pytest.MonkeyPatch) -> Callable[[watch.Player, str], bool]:
    def one(player: watch.Player, key: str) -> bool:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=getattr(pygame, f"K_{key}")))
        return player.frame()

    return one


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
    far = Scenario().merged({"start": {"x_m": 0.0, "y_m": -20.0}, "episode": {"lost_distance_m": 1.0}})
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


def test_an_encoder_that_fails_is_quoted(tmp_path: Path) -> None:
    def write() -> None:
        with video.Video(tmp_path / "a.mp4", (641, 361), 20.0) as writer:
            for _ in range(50):
                writer.add(bytes(641 * 361 * 3))

    with pytest.raises(video.CommandError, match=r"--out .*a\.mp4: ffmpeg failed: "):
        write()
    assert list(tmp_path.iterdir()) == []


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
        (["record", "--from", "-1"], ["--from", "at least 0"]),
        (["record", "--size", "10x10"], ["--size", "'10x10'", "1280x720"]),
        (["record", "--size", "big"], ["--size", "'big'"]),
        (["record", "--speed", "0"], ["--speed", "above 0"]),
        (["record", "--fps", "nan"], ["--fps", "above 0"]),
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


@pytest.mark.parametrize(
    ("count", "size", "grid"),
    [(1, (1280, 720), (1, 1)), (2, (1280, 720), (2, 1)), (3, (1280, 720), (3, 1)), (4, (1280, 720), (2, 2)),
     (2, (720, 1280), (1, 2))],
)  # fmt: skip
def test_pictures_share_the_frame(count: int, size: tuple[int, int], grid: tuple[int, int]) -> None:
    cells = staging._cells(count, size)
    assert (len({cell.left for cell in cells}), len({cell.top for cell in cells})) == grid
    whole = pygame.Rect((0, 0), size)
    for i, cell in enumerate(cells):
        assert whole.contains(cell)
        assert cell.collidelist(cells[:i]) == -1


def test_a_stage_flies_the_episode_of_the_benchmark() -> None:
    wanted = an_episode("Random", "nlpd", "pd", seed=4)
    stage = staging.Stage(wanted, (640, 360))
    stage.fly_until(3.0)
    flight = evaluate.fly(wanted.policies[0], wanted.scenario, [4])
    np.testing.assert_array_equal(stage.pilots[0]._env.state()["pose"], flight.series.pose[60])
    assert stage.time_s == pytest.approx(3.0)


def test_keys(press: Callable[[watch.Player, str], bool], scenario_file: Path) -> None:
    player = watch.Player(an_episode(scenario_file, "pd", "nlpd"), (640, 360), 1.0)
    for _ in range(3):
        assert player.frame()
    time_s = player.stage.time_s
    assert time_s == pytest.approx(0.1)
    assert press(player, "SPACE")
    time_s = player.stage.time_s
    assert player.frame()
    assert player.stage.time_s == time_s
    assert press(player, "SPACE")
    assert press(player, "UP")
    assert player.speed == 2.0
    assert press(player, "DOWN")
    assert press(player, "DOWN")
    assert player.speed == 0.5
    before = [pilot._env.state()["velocity"] for pilot in player.stage.pilots]
    player.paused = True
    assert press(player, "RIGHT")
    after = [pilot._env.state()["velocity"] for pilot in player.stage.pilots]
    for i in range(2):
        assert after[i][1] - before[i][1] == pytest.approx(watch.SHOVE / 250.0, rel=0.3)
    assert press(player, "LEFT")
    for i, pilot in enumerate(player.stage.pilots):
        np.testing.assert_allclose(pilot._env.state()["velocity"], before[i], atol=1e-12)
    player.paused = False
    assert press(player, "n")
    assert player.stage.seed == 1
    assert player.stage.time_s == 0.0
    assert press(player, "r")
    assert player.stage.seed == 1
    player.speed = 32.0
    for _ in range(5):
        assert player.frame()
    assert player.stage.ended
    assert press(player, "RIGHT")
    assert not press(player, "q")
    player.close()


def test_watch_ends_well_when_the_window_is_closed(
    scenario_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frames: list[int] = []
    real = watch.Player.frame

    def frame(self: watch.Player) -> bool:
        frames.append(1)
        if len(frames) == 3:
            pygame.event.post(pygame.event.Event(pygame.QUIT))
        return real(self)

    monkeypatch.setattr(watch.Player, "frame", frame)
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


def test_the_shell_needs_no_pygame_until_something_is_drawn() -> None:
    import subprocess

    code = (
        "import sys; from uwoc_gym.agents import cli; cli.main(['list'])\n"
        "sys.exit(', '.join({'pygame', 'plotly', 'torch', 'matplotlib'} & set(sys.modules)) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300, stdout=subprocess.DEVNULL)


def test_pictures_too_small_for_all_policies_are_refused(tmp_path, capsys):
    words = ["record", "--policy", "pd", "nlpd", "pd-tuned", "nlpd-tuned", "--size", "320x180"]
    assert main([*words, "--out", str(tmp_path / "a.gif")]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "--size 320x180 is not allowed with 4 policies; each needs at least 320x180" in error
    assert not (tmp_path / "a.gif").exists()
