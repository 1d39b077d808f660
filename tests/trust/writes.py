"""Commands that find no room for what they write: the error names the file, and no part of one is left."""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

from tests.trust.figures import none_of, share
from tests.trust.processes import BRIEF, OFF_TRAIN, TRAIN, room
from uwoc_gym.agents.cli import main

WRITERS: dict[str, list[str]] = {
    "train": ["train", "--steps", "64", *TRAIN, *BRIEF, "--out", "OUT"],
    "train sac": ["train", "--steps", "128", *OFF_TRAIN, *BRIEF, "--out", "OUT"],
    "benchmark": ["benchmark", "--policy", "pd", "--scenario", "Random", "--seeds", "40", *BRIEF, "--out", "OUT"],
    "evaluate": ["evaluate", "pd", "--seeds", "40", *BRIEF, "--out", "OUT"],
    "tune": ["tune", "pd", "--trials", "16", "--episodes", "2", *BRIEF, "--out", "OUT"],
    "record": ["record", "--policy", "pd", "--to", "1", "--size", "320x180", "--out", "OUT/a.mp4", "OUT/a.gif"],
    "replay": ["replay", "--policy", "pd", *BRIEF, "--out", "OUT/a.html"],
    "speed": ["speed", "--render", "--time", "0.1", "--rounds", "1", "--out", "OUT"],
}  # fmt: skip
"""What each command writes in a moment."""

SLOW_WRITERS: dict[str, list[str]] = {
    "calibrate": ["calibrate", "nlpd", "--trials", "16", "--batch", "8", "--out", "OUT"],
    "protocol": ["protocol", "--training-seeds", "0", "--scenario", "Random", *BRIEF, "--seeds", "4", "--jobs", "1",
                 "--runs", "OUT/runs", "--out", "OUT"],
}  # fmt: skip
"""What takes longer, for the long form."""

SIZES = (0, 700, 15_000)
LONG_SIZES = (0, 1, 100, 700, 3_000, 15_000, 60_000, 250_000)
"""Bytes beyond which no file can grow."""


def faults(words: list[str], size: int, out: Path) -> tuple[bool, list[str]]:
    """Whether a command failed for want of room, and what is wrong with how it did."""
    words = [word.replace("OUT", str(out)) for word in words]
    errors = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors), room(size):
        status = main(words)
    said = errors.getvalue()
    if status == 0:
        return False, [] if size else [f"{words[0]} found room in 0 bytes"]
    last = said.splitlines()[-1]
    wrong = [f"status {status}"] if status != 1 else []
    # A limit on files is one on the shared memory of processes too, which isn't a file of ours.
    named = str(out) in last or "worker processes can't be started" in last
    if not last.startswith(f"uwoc-gym {words[0]}: error: ") or not named:
        wrong.append(f"names no file: {last}")
    if "Traceback" in said:
        wrong.append(f"a traceback: {said[-300:]}")
    hidden = [path for path in out.rglob(".*") if path.name.endswith((".part", ".draft", ".png"))]
    wrong += [f"left {path.relative_to(out)}" for path in [*hidden, *out.rglob("*.part")]]
    return True, [f"{words[0]} at {size} bytes: {each}" for each in wrong]


@contextlib.contextmanager
def _without_tracebacks_of_threads() -> Iterator[None]:
    """TensorBoard writes in a thread of its own, whose end is no news."""
    before, threading.excepthook = threading.excepthook, lambda *_: None
    try:
        yield
    finally:
        threading.excepthook = before


def measure(long: bool) -> list[tuple[str, str]]:
    """Every command at several sizes."""
    tried, failed, wrong, at_fault = 0, 0, list[str](), 0
    for name, words in ({**WRITERS, **SLOW_WRITERS} if long else WRITERS).items():
        print(f"  {name}", file=sys.stderr, flush=True)
        for size in LONG_SIZES if long else SIZES:
            with tempfile.TemporaryDirectory() as folder, _without_tracebacks_of_threads():
                short_of_room, found = faults(words, size, Path(folder) / "out")
            tried, failed = tried + 1, failed + short_of_room
            at_fault += bool(found)
            wrong += found
    return [
        ("commands run with too little room for some file", f"{failed:,} of {tried:,} tried"),
        ("of these, an error in a line that names the file, and no part of one left", share(failed - at_fault, failed)),
        ("what was wrong", none_of(wrong)),
    ]
