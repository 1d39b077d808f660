"""Folders by their address: a path, or what fsspec knows, such as ``s3://bucket/runs``.

Who works in a folder that is elsewhere does so in a copy of it on this machine, and what has changed goes back at each
checkpoint and at the end, whatever ends it.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import time
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from uwoc_gym.agents import interrupts
from uwoc_gym.agents.errors import CommandError, require

OFTEN_S = 10.0
"""Time from one time that what has been found is put back to the next [s]."""

_PAUSES_S = (1.0, 5.0)
"""How long to wait before what failed is tried again [s]."""

_LIST = ".files.json"
"""The names of all files of a folder, written after them: what isn't named there hasn't come to its end."""


def elsewhere(given: str | Path) -> bool:
    """Whether an address names a file system, as ``s3://`` does; a path doesn't."""
    return re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", str(given)) is not None


@contextmanager
def held(given: str | Path) -> Iterator[Path]:
    """A folder of this machine to work in, for a folder by its address; a path is what it is.

    Who asks to stop while the last files are put back is heard when they are.

    Args:
        given: The address, or a path.

    Raises:
        CommandError: It can't be reached, or what it holds can't be read, or it can't be written to. What couldn't be
            put back stays on this machine, and the error says where.
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
        raise CommandError(by_address(str(error))) from None
    finally:
        _held.remove(copy)
        with interrupts.noted() as asked:
            copy.end()
        if asked:
            raise KeyboardInterrupt


def by_address(text: str) -> str:
    """A text in which folders that are elsewhere are named by their addresses, not by those of their copies here."""
    for copy in (*_held, *_seen.values()):
        text = text.replace(str(copy.folder), copy.address)
    return text


def check(given: str) -> None:
    """Write to a folder that is elsewhere, and leave nothing.

    Raises:
        CommandError: It can't be reached, or it can't be written to.
    """
    _look(given).try_out()


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
    return sorted(name for name in _look(str(given)).top(folders=True) if name.startswith(start))


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
    if Path(name).suffix in (".zip", ".json"):
        copy = _look(folder)
        copy.take([name])
        return copy.folder / name
    copy = _look(str(given))
    copy.take(copy.top())
    return copy.folder


class _Copy:
    """A copy on this machine of a folder that is elsewhere.

    Args:
        given: Its address.

    Raises:
        CommandError: There is no such file system, or the address names no folder in it.
    """

    def __init__(self, given: str) -> None:
        require("fsspec")
        import fsspec

        self.address = given.rstrip("/")
        name = self.address.rpartition("/")[2]
        if not elsewhere(self.address) or name in (".", ".."):
            raise CommandError(f"{given} is not allowed; it must name a folder, such as s3://bucket/runs.")
        with self._reaching():
            self._system, self._root = fsspec.core.url_to_fs(self.address)
        parent = tempfile.mkdtemp(prefix="uwoc-gym-")
        self._forget = weakref.finalize(self, shutil.rmtree, parent, ignore_errors=True)
        self.folder = Path(parent) / name
        self.folder.mkdir()
        self.kept = time.monotonic()
        self._there: dict[str, tuple[int, int]] = {}
        self._keys: dict[str, str] = {}

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

    def fetch(self) -> None:
        """Take over all that is there, or what its list of files names."""
        self.take(self._listed())
        self._there = self._here()

    def take(self, names: Iterable[str]) -> None:
        """Take over files, unless they are here as they are there; what isn't there any more goes."""
        with self._reaching():
            # Other processes may have written since it was last looked at.
            self._system.invalidate_cache()
            for name in names:
                target = self.folder / name
                try:
                    key = self._system.ukey(self._at(name))
                    if key == self._keys.get(name) and target.is_file():
                        continue
                    target.parent.mkdir(parents=True, exist_ok=True)
                    self._system.get_file(self._at(name), str(target))
                    self._keys[name] = key
                except FileNotFoundError:
                    target.unlink(missing_ok=True)

    def _listed(self) -> list[str]:
        """The names of its files, but for those of folders in it that have lists of their own."""
        with self._reaching():
            self._system.invalidate_cache()
            with suppress(FileNotFoundError):
                found = json.loads(self._system.cat_file(self._at(_LIST)))
                for name in found:
                    if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
                        raise ValueError(f"its list of files names {name!r}")
                return list(found)
            names = [self._name(path) for path in self._system.find(self._root)]
        others = {name.removesuffix(_LIST) for name in names if name.endswith(f"/{_LIST}")}
        # A file is found in itself, by no name.
        return [name for name in names if name and not _passing(Path(name)) and not name.startswith(tuple(others))]

    def _name(self, path: str) -> str:
        return path[len(self._root) :].strip("/")

    def top(self, folders: bool = False) -> list[str]:
        """The names of the files at its top, and of the folders too if they are asked for; those that are gone go."""
        with self._reaching():
            self._system.invalidate_cache()
            try:
                found = self._system.ls(self._root, detail=True)
            except FileNotFoundError:
                found = []
        names = {self._name(each["name"]) for each in found if folders or each["type"] == "file"}
        names = {name for name in names if name and not _passing(Path(name))}
        return sorted(names if folders else names | {path.name for path in self.folder.iterdir()})

    def try_out(self) -> None:
        """Write to it, and leave nothing.

        Raises:
            CommandError: It can't be written to.
        """
        name = self._at(".try")
        with self._reaching():
            missing = []
            folder = self._root.rstrip("/")
            while folder and not self._system.exists(folder):
                missing.append(folder)
                folder = folder.rpartition("/")[0]
            self._system.makedirs(self._root, exist_ok=True)
            self._system.pipe_file(name, b"")
            self._system.rm_file(name)
            for folder in missing:
                # Where a store has no folders of its own there is nothing to remove.
                with suppress(Exception):
                    self._system.rmdir(folder)

    def put_back(self) -> None:
        """Put back what has changed; what isn't here any more goes once the list of files says so.

        What fails is tried again, after a while.

        Raises:
            CommandError: It can't be reached.
        """
        for pause in _PAUSES_S:
            try:
                self._put_back()
                return
            except CommandError:
                time.sleep(pause)
        self._put_back()

    def _put_back(self) -> None:
        here = self._here()
        changed = [name for name in here if here[name] != self._there.get(name)]
        gone = self._there.keys() - here.keys()
        if not changed and not gone:
            return
        with self._reaching():
            for name in changed:
                self._system.makedirs(self._at(name).rpartition("/")[0], exist_ok=True)
                self._system.put_file(str(self.folder / name), self._at(name))
            self._system.pipe_file(self._at(_LIST), json.dumps(sorted(here)).encode())
            for name in gone:
                with suppress(FileNotFoundError):
                    self._system.rm_file(self._at(name))
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

    def end(self) -> None:
        """Put back what has changed, and remove it from this machine.

        Raises:
            CommandError: It can't be reached; what it should have got stays here.
        """
        try:
            self.put_back()
        except BaseException as error:
            self._forget.detach()
            raise CommandError(f"{error}; what it should have got stands in {self.folder}") from error
        self._forget()


def _passing(name: Path) -> bool:
    """Whether a file is there only while somebody is at work: locks, and what isn't whole."""
    return any(part.startswith(".") or part.endswith(".part") for part in name.parts)


_held: list[_Copy] = []

_seen: dict[str, _Copy] = {}
"""What is only read, by its address: it stays for the next look."""


def _look(given: str) -> _Copy:
    copy = _seen.get(given.rstrip("/")) or _Copy(given)
    return _seen.setdefault(copy.address, copy)
