"""Files that are whole or not there, and the one that every command leaves: results.json."""

from __future__ import annotations

import csv
import errno
import importlib.metadata
import io
import json
import math
import os
import platform
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.given import SettingError, from_json, read_text
from uwoc_gym.scenario import Scenario


def output_file(given: str, suffixes: tuple[str, ...], force: bool) -> Path:
    """A file that may be written to.

    Raises:
        CommandError: It has another suffix, exists without ``force``, or can't be written to.
    """
    path = Path(given)
    if places.elsewhere(given):
        raise CommandError(f"--out {given} is not allowed; it must be a file of this machine.")
    if path.suffix.lower() not in suffixes:
        raise CommandError(f"--out {given}: the file's name must end in {' or '.join(suffixes)}.")
    if path.is_dir():
        raise CommandError(f"--out {given} is a folder; it must be a file.")
    if path.exists() and not force:
        raise CommandError(f"--out {given} already exists; give --force to overwrite it.")
    try:
        _try_out(path.parent)
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(None, "it is read-only")
    except OSError as error:
        raise CommandError(
            f"--out {given}: {error.strerror or error}; it must be a file that can be written."
        ) from None
    return path


def _try_out(folder: Path) -> None:
    """Write to a folder that may not be there yet, and leave nothing of it.

    Raises:
        OSError: It can't be written to.
    """
    with _made(folder), tempfile.TemporaryFile(dir=folder):
        pass


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make a folder, and take it away again if nothing has come into it."""
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for each in missing:
            with suppress(OSError):
                each.rmdir()


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path to write to, which becomes ``path`` where the block ends without an error; else nothing is left of it.

    The folder is made if it isn't there.

    Raises:
        OSError: It can't be written; the error names ``path``.
    """
    part = path.with_name(f".{path.name}.part")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with named(path, part):
            yield part
            flush(part)
            os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A folder to fill, which becomes ``folder`` where the block ends without an error; else nothing is left of it.

    ``folder`` may be there before if nothing is in it.

    Raises:
        OSError: It can't be written.
    """
    part = folder.absolute().with_name(f".{folder.name}.part")
    with _made(part.parent):
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir()
        try:
            yield part
            if folder.exists():
                folder.rmdir()
            part.rename(folder)
        finally:
            shutil.rmtree(part, ignore_errors=True)


@contextmanager
def named(path: Path, part: Path | None = None) -> Iterator[None]:
    """Name a file in an error about writing to it: that of a full disk doesn't.

    Args:
        path: The file.
        part: What it is called until it is whole.
    """
    try:
        yield
    except OSError as error:
        if error.filename not in (None, str(part)):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


_LOCK = ".lock"
"""What a process that is at work in a folder holds there."""

_LOOK_S = 0.2
"""Time between two looks at whether it has come to its end [s]."""


@contextmanager
def locked(folder: Path, patience_s: float = 0.0) -> Iterator[None]:
    """Be the only process at work in a folder; one that has died isn't.

    Args:
        folder: The folder.
        patience_s: How long to wait for another process that is at work in it [s].

    Raises:
        CommandError: Another process is at work in it.
    """
    with _made(folder):
        lock = folder / _LOCK
        handle = os.open(lock, os.O_RDWR | os.O_CREAT)
        try:
            until = time.monotonic() + patience_s
            while True:
                try:
                    _lock(handle)
                    break
                except (BlockingIOError, PermissionError):
                    if time.monotonic() < until:
                        time.sleep(_LOOK_S)
                        continue
                    raise CommandError(
                        f"--out {folder}: another process is at work in this folder; wait for its end, or give another "
                        "one."
                    ) from None
            try:
                yield
            finally:
                if [each.name for each in folder.iterdir()] == [lock.name]:
                    lock.unlink()
        finally:
            os.close(handle)


def _lock(handle: int) -> None:
    """Lock an open file until it is closed.

    Raises:
        BlockingIOError: Another process has.
        PermissionError: Another process has, on Windows.
    """
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        return
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # A file system that knows no locks refuses nobody.
        if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS):
            raise


def flush(path: Path) -> None:
    """Wait until a file, or a folder's list of names, is on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def output_folder(path: str | Path, option: str = "--out") -> Path:
    """A folder to which files can be written; it is only made with the first file, so that a refusal leaves nothing.

    Raises:
        CommandError: They can't.
    """
    folder = Path(path)
    try:
        _try_out(folder)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CommandError(f"{option} {folder}: {reason}; it must be a folder that can be written to.") from None
    return folder


def new_folder(path: str | Path) -> Path:
    """An output folder that holds nothing yet.

    Raises:
        CommandError: It does, or files can't be written to it.
    """
    folder = output_folder(path)
    # Who was killed leaves its lock.
    if folder.exists() and any(each.name != _LOCK for each in folder.iterdir()):
        raise CommandError(f"--out {path} is not empty; give another folder.")
    return folder


def read_json(path: Path) -> Any:
    """What a JSON file says.

    Raises:
        CommandError: It can't be read, isn't JSON, or is long or nested beyond bounds.
    """
    try:
        return from_json(read_text(path), str(path))
    except SettingError as error:
        raise CommandError(str(error)) from None


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results may depend on."""
    found = {"python": platform.python_version()}
    for package in ("uwoc-gym", "gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "sb3-contrib", "torch"):
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def command_line(argv: Sequence[str] | None) -> str:
    """The command as it would be typed again."""
    return shlex.join(["uwoc-gym", *(sys.argv[1:] if argv is None else argv)])


def plain(value: Any) -> Any:
    """JSON knows no numbers that aren't finite: they become null."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def copy(source: Path, target: Path) -> None:
    """Copy a file whole or not at all."""
    with whole(target) as part:
        shutil.copyfile(source, part)


def json_text(data: Mapping[str, Any]) -> str:
    """The data as JSON, in which numbers that aren't finite are null."""
    return json.dumps(plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    write_text(path, json_text(data))


def write_results(
    folder: Path, command: str, scenarios: Mapping[str, Scenario | None], document: Mapping[str, Any]
) -> None:
    """Write a command's ``results.json``, whole or not at all.

    Args:
        folder: Where it goes.
        command: The command line that it comes from.
        scenarios: The full scenarios that it speaks of, by name; it gets their digests, so that two of one name can't
            be taken for each other. None for one that isn't this package's.
        document: What else it says.
    """
    digests = {name: scenario.digest() for name, scenario in scenarios.items() if scenario is not None}
    head = {"command": command, "versions": versions(), "scenarios": digests}
    taken = head.keys() & document.keys()
    assert not taken, taken
    write_json(folder / RESULTS, {**head, **document})


RESULTS = "results.json"
"""What `write_results` writes."""

EPISODES = "episodes.csv"
"""What an `EpisodesFile` is called."""


def read_episodes(path: Path) -> dict[tuple[str, str], list[dict[str, float]]]:
    """The measures of all episodes in an `EpisodesFile`, by scenario and policy, in its order; without what was drawn.

    Raises:
        CommandError: It can't be read, or is of something else.
    """
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CommandError(f"{str(path)!r} can't be read: {error}") from None
    with io.StringIO(text, newline="") as file:
        reader = csv.DictReader(file)
        own = [key for key in reader.fieldnames or () if key not in _NAMES and not key.startswith(_DRAWN)]
        if not {*_NAMES} <= set(reader.fieldnames or ()):
            raise CommandError(f"{str(path)!r} is not allowed; it must be the {EPISODES} of uwoc-gym benchmark.")
        for row in reader:
            try:
                measures = {key: float(row[key]) for key in own}
            except (TypeError, ValueError):
                raise CommandError(f"{str(path)!r} is not allowed; line {reader.line_num} isn't an episode.") from None
            found.setdefault((row["scenario"], row["policy"]), []).append(measures)
    return found


_NAMES, _DRAWN = ("scenario", "policy", "seed"), "drawn."


class EpisodesFile:
    """A CSV file with one row per episode, which keeps what has been appended whatever happens next.

    It is there from the first episode on.

    Args:
        path: Where it goes.
        drawn: Paths of what episodes may have drawn, each a column ``drawn.<path>``.
    """

    def __init__(self, path: Path, drawn: Sequence[str] = ()) -> None:
        self.path = path
        self._drawn = drawn
        self._file: TextIO | None = None
        self._writer: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            with named(self.path):
                self._file.close()

    def append(
        self,
        scenario: str,
        policy: str,
        seeds: Sequence[int],
        rows: Sequence[Mapping[str, float]],
        drawn: Sequence[Mapping[str, float | str]],
    ) -> None:
        """Add finished episodes: their measures, and what each has drawn, which leaves a cell empty where it hasn't."""
        if not rows:
            return
        with named(self.path):
            if self._file is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._file = self.path.open("w", newline="", encoding="utf-8")
                self._writer = csv.writer(self._file)
                columns = (f"{_DRAWN}{path}" for path in self._drawn)
                self._writer.writerow([*_NAMES, *rows[0], *columns])
            for seed, row, own in zip(seeds, rows, drawn, strict=True):
                cells = (own.get(path, "") for path in self._drawn)
                self._writer.writerow(
                    [scenario, policy, seed, *map(repr, row.values())]
                    + [cell if isinstance(cell, str) else repr(cell) for cell in cells]
                )
            self._file.flush()
