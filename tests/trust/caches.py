"""Numba's cache cold, warm, missing, full and damaged: the same results, a warning at most, and what it costs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import uwoc_gym
from tests.trust.figures import Wrong, none_of
from uwoc_gym.compute import compiled

FIRST_STEP = """
import hashlib
import numpy as np
import uwoc_gym
env = uwoc_gym.TrackingEnv(scenario="Random")
seen = [env.reset(seed=3)[0], *(np.asarray(each) for each in env.step(np.array([0.3, -0.2, 0.1], np.float32))[:3])]
print(hashlib.sha256(b"".join(each.tobytes() for each in seen)).hexdigest())
"""
"""The first reset and step in a process."""

TOY_STEP = "from toy.main import run, run_over\nprint(run(1.0), run_over(1.0))"
NOWHERE = "from numba.core import caching; caching.CacheImpl._locator_classes = []"
FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))"


def make_toy(folder: Path) -> None:
    """A package with this package's `compiled`, an equation in a room of its own, and two functions of it."""
    own = Path(compiled.__file__).relative_to(Path(uwoc_gym.__file__).parent)
    inside = f"toy.{own.with_suffix('').as_posix().replace('/', '.')}"
    files = {
        own.as_posix(): Path(compiled.__file__).read_text(),
        "rooms/equation.py": f"from {inside} import inlined\n@inlined\ndef times(x):\n    return 2.0 * x\n",
        "main.py": f"from {inside} import compiled, over_arrays\nfrom toy.rooms.equation import times\n"
        "@compiled\ndef run(x):\n    return 10.0 + times(x)\n"
        "@over_arrays\ndef run_over(x):\n    return 10.0 + times(x)\n",
    }
    for name, text in files.items():
        path = folder / "toy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def truncated(data: bytes) -> bytes:
    """The first half."""
    return data[: len(data) // 2]


def flipped(data: bytes) -> bytes:
    """64 bytes in the middle inverted."""
    middle = len(data) // 2
    return data[:middle] + bytes(each ^ 0xFF for each in data[middle : middle + 64]) + data[middle + 64 :]


class Started(NamedTuple):
    """What a process came to."""

    status: int
    said: str
    warnings: int
    seconds: float


def started(code: str, cache: Path, paths: Path, before: str = "") -> Started:
    """Run code in a process with a cache."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(paths)}
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", f"{before}\n{code}"], env=environment, capture_output=True, text=True, timeout=300
    )
    taken = time.perf_counter() - begun
    return Started(done.returncode, done.stdout or done.stderr[-300:], done.stderr.count("RuntimeWarning"), taken)


def tried(code: str, folder: Path) -> tuple[list[tuple[str, Started, int]], list[str]]:
    """A process with each state of the cache, the warnings that it should give, and what was wrong."""
    cache, empty, taken = folder / "cache", folder / "empty", folder / "file"
    taken.write_text("a file where a folder should be")
    found: list[tuple[str, Started, int]] = []

    def note(name: str, warnings: int, where: Path = cache, before: str = "") -> None:
        print(f"  {name}", file=sys.stderr, flush=True)
        found.append((name, started(code, where, folder, before), warnings))

    note("cold", 0)
    note("warm", 0)
    note("where its folder can't be made", 1, taken / "cache", "")
    note("without any folder", 1, cache, NOWHERE)
    note("on a full disk", 1, empty, FULL)
    shutil.rmtree(empty, ignore_errors=True)
    for words, damage in (("cut in half", truncated), ("flipped in 64 bytes", flipped)):
        for suffix, what in ((".nbi", "index"), (".nbc", "code")):
            for path in cache.rglob(f"*{suffix}"):
                path.write_bytes(damage(path.read_bytes()))
            note(f"with its {what} {words}", 1)
            note("the next time", 0)
    good = found[0][1].said
    wrong = []
    for name, each, most in found:
        if each.status or each.said != good:
            wrong.append(f"{name}: status {each.status}, {each.said}")
        if each.warnings > most:
            wrong.append(f"{name}: {each.warnings} warnings")
    return found, wrong


def measure(long: bool) -> list[tuple[str, str]]:
    """A toy package with the same compilation, or the first step of this one."""
    with tempfile.TemporaryDirectory() as folder:
        make_toy(Path(folder))
        found, wrong = tried(FIRST_STEP if long else TOY_STEP, Path(folder))
    what = "first step" if long else "first call of a toy package"
    right = found[0][1]
    rows = []
    for name, each, _ in found:
        same = "the same" if (each.status, each.said) == (0, right.said) else "another result"
        text = f"{each.seconds:.1f} s, {same}, {each.warnings} warning{'s' * (each.warnings != 1)}"
        rows.append((f"{what}, cache {name}", text if same == "the same" else Wrong(text)))
    return [*rows, ("caches: what was wrong", none_of(wrong))]
