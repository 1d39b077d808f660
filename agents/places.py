"""Folders by their address: a path, or what fsspec knows, such as ``s3://bucket/runs``.

Who works in a folder that is elsewhere does so in a copy of it on this machine, and what has changed goes back at each
checkpoint and at the end, whatever ends it.
"""

from __future__ import annotations

import functools
import json
import re
import shutil
import tempfile
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from uwoc_gym.agents.errors import CommandError, require

OFTEN_S = 10.0
"""Time from one time that what has been found is put back to the next [s]."""

_LIST = ".files.json"
"""The names of all files of a folder, written after them: what isn't named there hasn't come to its end."""


def elsewhere(given: str | Path) -> bool:
    """Whether an address names a file system, as ``s3://`` does; a path doesn't."""
    return re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", str(given)) is not None


@contextmanager
def held(given: str | Path) -> Iterator[Path]:
    """A folder of this machine to work in, for a folder by its address; a path is what it is.

    Args:
        given: The address, or a path.

    Raises:
        CommandError: It can't be reached, or what it holds can't be read, or it can't be written to.
    """
    if not elsewhere(given):
        yield Path(given)
        return
    copy = _Copy(str(given))
    copy.fetch()
    copy.try_out()
    _held.append(copy)
    try:
        yield copy.folder
    except CommandError as error:
        raise CommandError(str(error).replace(str(copy.folder), copy.address)) from None
    finally:
        _held.remove(copy)
        copy.put_back()
        copy.forget()


def check(given: str) -> None:
    """Write to a folder that is elsewhere, and leave nothing.

    Raises:
        CommandError: It can't be reached, or it can't be written to.
    """
    _seen(given.rstrip("/")).try_out()


def keep(folder: Path, every_s: float = 0.0) -> None:
    """Put back now what has changed in a folder that is held, or in the one that it lies in.

    Args:
        folder: The folder; nothing is done for one that isn't elsewhere.
        every_s: Not more often than this [s].

    Raises:
        CommandError: It can't be reached.
    """
    for copy in _held:
        if folder.is_relative_to(copy.folder) and time.monotonic() - copy.kept >= every_s:
            copy.put_back()


def address(path: Path) -> str:
    """By what others know a folder or a file: its address if it lies in a folder that is held, or else its path."""
    for copy in _held:
        if path.is_relative_to(copy.folder):
            return "/".join((copy.address, *path.relative_to(copy.folder).parts))
    return str(path)


def inside(given: str | Path, name: str) -> str:
    """The address of what lies in a folder."""
    return f"{str(given).rstrip('/')}/{name}" if elsewhere(given) else str(Path(given) / name)


def names(given: str | Path, start: str) -> list[str]:
    """The files and folders in a folder whose names begin so.

    Raises:
        CommandError: It can't be reached.
    """
    if not elsewhere(given):
        return sorted(path.name for path in Path(given).glob(f"{start}*"))
    return _seen(str(given).rstrip("/")).names(start)


def local(given: str | Path) -> Path:
    """A path to read from: of a folder that is elsewhere a copy, as it is now, of the files that stand at its top.

    Args:
        given: The address of a folder, or of a .zip or .json file; or a path.

    Raises:
        CommandError: It can't be reached.
    """
    if not elsewhere(given):
        return Path(given)
    folder, _, name = str(given).rpartition("/")
    if Path(name).suffix not in (".zip", ".json"):
        folder, name = str(given), ""
    copy = _seen(folder.rstrip("/"))
    copy.fetch(top=True)
    return copy.folder / name


class _Copy:
    """A copy on this machine of a folder that is elsewhere.

    Args:
        given: Its address.

    Raises:
        CommandError: There is no such file system.
    """

    def __init__(self, given: str) -> None:
        require("fsspec")
        import fsspec

        self.address = given.rstrip("/")
        with self._reaching():
            self._system, self._root = fsspec.core.url_to_fs(self.address)
        parent = tempfile.mkdtemp(prefix="uwoc-gym-")
        self.forget = weakref.finalize(self, shutil.rmtree, parent, ignore_errors=True)
        """Removes it from this machine."""
        self.folder = Path(parent) / (self.address.rpartition("/")[2] or "root")
        self.folder.mkdir()
        self.kept = time.monotonic()
        self._there: dict[str, tuple[int, int]] = {}

    @contextmanager
    def _reaching(self) -> Iterator[None]:
        """Say in one line what keeps the folder from being reached: each file system has errors of its own."""
        try:
            yield
        except Exception as error:
            lines = str(error).strip().splitlines()
            raise CommandError(
                f"{self.address} can't be used: {type(error).__name__}{f': {lines[0][:300]}' if lines else ''}"
            ) from error

    def _at(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}"

    def fetch(self, top: bool = False) -> None:
        """Take over what is there.

        Args:
            top: Only the files that don't lie in folders of it.
        """
        with self._reaching():
            # Other processes may have written since it was last looked at.
            self._system.invalidate_cache()
            for name in self._names(top):
                target = self.folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                self._system.get_file(self._at(name), str(target))
        self._there = self._here()

    def _names(self, top: bool) -> list[str]:
        if not top:
            with suppress(FileNotFoundError):
                return list(json.loads(self._system.cat_file(self._at(_LIST))))
        found = self._system.find(self._root, maxdepth=1 if top else None)
        # A file is found in itself.
        names = [path[len(self._root) :].strip("/") for path in found]
        return [name for name in names if name and not _passing(Path(name))]

    def names(self, start: str) -> list[str]:
        """Names of what lies in it that begin so."""
        with self._reaching():
            self._system.invalidate_cache()
            try:
                found = self._system.ls(self._root, detail=False)
            except FileNotFoundError:
                return []
        own = {path.rstrip("/").rpartition("/")[2] for path in found}
        return sorted(name for name in own if name.startswith(start))

    def try_out(self) -> None:
        """Write to it, and leave nothing.

        Raises:
            CommandError: It can't be written to.
        """
        name = self._at(".try")
        with self._reaching():
            self._system.makedirs(self._root, exist_ok=True)
            self._system.pipe_file(name, b"")
            self._system.rm_file(name)

    def put_back(self) -> None:
        """Put back what has changed; what isn't here any more goes once the list of files says so.

        Raises:
            CommandError: It can't be reached; what is missing there stays here.
        """
        here = self._here()
        changed = [name for name in here if here[name] != self._there.get(name)]
        gone = self._there.keys() - here.keys()
        if not changed and not gone:
            return
        try:
            with self._reaching():
                for name in changed:
                    self._system.makedirs(self._at(name).rpartition("/")[0], exist_ok=True)
                    self._system.put_file(str(self.folder / name), self._at(name))
                self._system.pipe_file(self._at(_LIST), json.dumps(sorted(here)).encode())
                for name in gone:
                    with suppress(FileNotFoundError):
                        self._system.rm_file(self._at(name))
        except CommandError as error:
            safe = Path(tempfile.mkdtemp(prefix="uwoc-gym-kept-")) / self.folder.name
            shutil.copytree(self.folder, safe)
            raise CommandError(f"{error}; what it should have got stands in {safe}") from error
        self._there, self.kept = here, time.monotonic()

    def _here(self) -> dict[str, tuple[int, int]]:
        """When each file was last written, and its size."""
        found = {}
        for path in sorted(self.folder.rglob("*")):
            name = path.relative_to(self.folder)
            if path.is_file() and not _passing(name):
                status = path.stat()
                found[name.as_posix()] = status.st_mtime_ns, status.st_size
        return found


def _passing(name: Path) -> bool:
    """Whether a file is there only while somebody is at work: locks, and what isn't whole."""
    return any(part.startswith(".") or part.endswith(".part") for part in name.parts)


_held: list[_Copy] = []

_seen = functools.cache(_Copy)
