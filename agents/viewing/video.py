"""Video files, written by the ffmpeg that imageio-ffmpeg brings: each stands whole under its name or not at all."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.reports.files import whole

SUFFIXES = (".mp4", ".gif")


def encoder() -> str:
    """The path of ffmpeg.

    Raises:
        CommandError: imageio-ffmpeg doesn't find one.
    """
    import imageio_ffmpeg

    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError:
        raise CommandError(
            "there is no ffmpeg to encode the video; reinstall imageio-ffmpeg or set IMAGEIO_FFMPEG_EXE to the path of "
            "one."
        ) from None


@contextmanager
def writing(path: Path, size: tuple[int, int], frames_per_s: float) -> Iterator[Video]:
    """A video to which frames are added; where the block ends without an error the file is there, otherwise not.

    Args:
        path: The file, whose suffix says how it is encoded: MP4 (H.264, yuv420p) or GIF (one palette for all frames).
        size: Width and height of the frames [px], even.
        frames_per_s: Frames shown per second.

    Raises:
        CommandError: There is no encoder, or it fails.
    """
    with whole(path) as part:
        video = Video(path, part, size, frames_per_s)
        try:
            yield video
            video.finish()
        finally:
            video.close()


class Video:
    """What ffmpeg is given, frame by frame; see `writing`."""

    def __init__(self, path: Path, part: Path, size: tuple[int, int], frames_per_s: float) -> None:
        self._path = path
        self._part = part
        self._draft = path.with_name(f".{path.name}.draft")
        self._palette = path.with_name(f".{path.name}.png")
        self._encoder = encoder()
        self._gif = path.suffix.lower() == ".gif"
        raw = _words(f"-f rawvideo -pix_fmt rgb24 -s {size[0]}x{size[1]} -r {frames_per_s} -i -")
        if self._gif:
            # The palette has to know all frames, so they are kept without loss until then.
            how = [*_words("-c:v libx264rgb -preset ultrafast -qp 0 -f matroska"), str(self._draft)]
        else:
            how = [*_words("-c:v libx264 -crf 20 -pix_fmt yuv420p -movflags +faststart -f mp4"), str(self._part)]
        self._process = subprocess.Popen(
            [self._encoder, "-y", "-loglevel", "error", *raw, *how],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # An interrupt at the keyboard is ours to answer.
            start_new_session=True,
        )

    def add(self, frame: bytes) -> None:
        """Add a frame, rows of red, green and blue.

        Raises:
            CommandError: The encoder has given up.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(frame)
        except OSError:
            raise self._failure() from None

    def _failure(self) -> CommandError:
        self._process.kill()
        _, said = self._process.communicate()
        return _failed(self._path, said)

    def finish(self) -> None:
        """Complete the file.

        Raises:
            CommandError: The encoder fails.
        """
        _, said = self._process.communicate()
        if self._process.returncode != 0:
            raise _failed(self._path, said)
        if self._gif:
            self._run(["-i", str(self._draft), "-vf", "palettegen=max_colors=192:stats_mode=full", "-f", "image2"])
            dither = "paletteuse=dither=none:diff_mode=rectangle"
            self._run(["-i", str(self._draft), "-i", str(self._palette), "-lavfi", dither, "-f", "gif"])

    def _run(self, how: list[str]) -> None:
        target = self._palette if "image2" in how else self._part
        done = subprocess.run(
            [self._encoder, "-y", "-loglevel", "error", *how, str(target)],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
            check=False,
        )
        if done.returncode != 0:
            raise _failed(self._path, done.stderr)

    def close(self) -> None:
        """Stop the encoder where it still runs, and remove what only it needed."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()
        for pipe in (self._process.stdin, self._process.stderr):
            if pipe is not None and not pipe.closed:
                pipe.close()
        for path in (self._draft, self._palette):
            path.unlink(missing_ok=True)


def _words(options: str) -> list[str]:
    return options.split()


def _failed(path: Path, said: bytes) -> CommandError:
    lines = said.decode(errors="replace").strip().splitlines()
    return CommandError(f"--out {path}: ffmpeg failed: {lines[-1] if lines else 'it gave no reason'}")
