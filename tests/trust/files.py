"""Every kind of file that is read, damaged at random: it gives one clear line, or is read and does no harm."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import random
import re
import signal
import sys
import tempfile
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

from tests.trust.figures import none_of, share
from tests.trust.processes import BRIEF, OFF_TRAIN, TRAIN
from uwoc_gym import Scenario
from uwoc_gym.agents.cli import LONGEST, main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import checkpoints, protocol, training
from uwoc_gym.agents.learning.plans import Wish, planned, recorded_plan
from uwoc_gym.agents.learning.progress import read_progress
from uwoc_gym.agents.policies import archive
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.agents.scenarios import said
from uwoc_gym.given import SettingError
from uwoc_gym.world.ship.paths import RecordedPath

EXAMPLES, LONG_EXAMPLES = 20, 1000
SLOWEST_S = 10.0

TELLING = (
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.fork",
    "subprocess.Popen",
    "pickle.find_class",
    "socket.connect",
)
"""What Python's audit tells of that no file may bring about."""


class Kind(NamedTuple):
    """A kind of file."""

    path: Path
    """One that is whole."""
    read: Callable[[Path], object]
    """Reads it as the commands do, and gives what it says in a form that can be compared."""
    member: str = ""
    """What is damaged in it, where it is a zip file that has to stay one; nothing for all of it."""


class _Hangs(BaseException):
    """It takes too long; not an error that anything would catch."""


class _Watch:
    """Notes what runs while it is told to; Python can't take an audit hook away again."""

    def __init__(self) -> None:
        self.on = False
        self.seen: list[str] = []
        sys.addaudithook(self._note)

    def _note(self, event: str, args: tuple[Any, ...]) -> None:
        if self.on and event in TELLING:
            self.seen.append(f"{event}{args[:2]!r}"[:200])


@contextlib.contextmanager
def _within(seconds: float) -> Iterator[None]:
    def ring(number: int, frame: FrameType | None) -> None:
        raise _Hangs(f"takes more than {seconds:.0f} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _flown(path: Path) -> object:
    """What an agent does on one observation."""
    scenario = Scenario.named("Random")
    pilot = load(str(path)).pilot(scenario)
    seen = np.linspace(-1.0, 1.0, scenario.observation.size, dtype=np.float32)[None]
    action = pilot.predict(seen, episode_start=np.ones(1, dtype=bool), deterministic=True)[0]
    return np.asarray(action).tobytes()


def _plan(wish: Wish, recorded: Any = None) -> object:
    return json.dumps(planned(wish, recorded).to_dict())


def kinds(folder: Path) -> dict[str, Kind]:
    """A whole file of each kind, written to a folder, and how it is read."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        assert main(["train", "--steps", "64", *TRAIN, *BRIEF, "--out", str(folder / "ppo")]) == 0
        assert main(["train", "--steps", "128", *OFF_TRAIN, *BRIEF, "--out", str(folder / "sac")]) == 0
    run, other = folder / "ppo", folder / "sac"
    last, buffered = checkpoints.newest(run), checkpoints.newest(other)
    assert last is not None
    assert buffered is not None
    learners = {
        name: training.Run(planned(Wish(), recorded_plan(path / "run.json")), path, "")
        for name, path in (("ppo", run), ("sac", other))
    }

    def goes_on(path: Path) -> object:
        archive.read_training(path, learners["ppo"].model)
        return repr(archive.read(path).normalisation)

    def buffer(path: Path) -> object:
        kept = learners["sac"].model.replay_buffer
        checkpoints.load_buffer(kept, path)
        return kept.observations.tobytes()

    (folder / "gains.json").write_text(
        json.dumps({"a_p": [300, 310, 300], "a_v": 250, "mu_p": 0.7, "feedforward": True})
    )
    (folder / "scenario.json").write_text(Scenario.named("Random").to_json())
    (folder / "changes.json").write_text('{"base": "Random", "vehicle": {"mass_scale": [0.8, 1.2]}, "depth_m": 3.2}')
    text = "".join(f"{0.5 * i},{2.0 * np.cos(0.1 * i):.6f},{2.0 * np.sin(0.1 * i):.6f}\n" for i in range(40))
    (folder / "ship.csv").write_text(f"time_s,x_m,y_m\n{text}")
    brief = Wish(steps=64, envs=1)
    return {
        "agent": Kind(run / "model.zip", _flown),
        "agent.json in it": Kind(run / "model.zip", _flown, "agent.json"),
        "policy.pth in it": Kind(run / "model.zip", _flown, "policy.pth"),
        "agent to go on with": Kind(last / "last.zip", goes_on),
        "optimiser in it": Kind(last / "last.zip", goes_on, "policy.optimizer.pth"),
        "replay buffer": Kind(buffered / "replay.npz", buffer),
        "gains": Kind(folder / "gains.json", lambda path: _plan(replace(brief, residual=str(path)))),
        "scenario": Kind(folder / "scenario.json", lambda path: said(str(path)).scenario.digest()),
        "changes to a scenario": Kind(folder / "changes.json", lambda path: said(str(path)).scenario.digest()),
        "settings": Kind(run / "settings.yaml", lambda path: _plan(replace(brief, settings=str(path)))),
        "run.json": Kind(run / "run.json", lambda path: _plan(Wish(), recorded_plan(path))),
        "progress.json": Kind(last / "progress.json", lambda path: repr(read_progress(path))),
        "results.json": Kind(run / "results.json", lambda path: json.dumps(protocol.read_results(path))),
        "ship's path": Kind(folder / "ship.csv", lambda path: repr(RecordedPath.from_csv(path))),
    }


VALUE = re.compile(rb'-?\d[\d.]*(?:[eE][+-]?\d+)?|true|false|null|"[^"]*"|nn\.\w+')
OTHERS = (
    b"null",
    b"true",
    b"-1",
    b"0",
    b"1e300",
    b"1e12",
    b"NaN",
    b'"x"',
    b"[]",
    b"{}",
    b"[[1, 2]]",
    b'{"a": 1}',
    b"7",
)


def damaged(data: bytes, draw: random.Random) -> bytes:
    """Some bytes flipped, all from somewhere on cut off, some put in, or a value of a text replaced by another."""
    values = [] if b"\0" in data else list(VALUE.finditer(data))
    match draw.randrange(5 if values else 3):
        case 0:
            changed = bytearray(data)
            for _ in range(draw.choice((1, 1, 1, 4, 32))):
                changed[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
            return bytes(changed)
        case 1:
            return data[: draw.randrange(len(data))]
        case 2:
            at = draw.randrange(len(data) + 1)
            again = data[at : at + draw.randrange(1, 64)]
            more = again if draw.random() < 0.5 else draw.randbytes(draw.randrange(1, 17))
            return data[:at] + more + data[at:]
        case _:
            found = draw.choice(values)
            return data[: found.start()] + draw.choice(OTHERS) + data[found.end() :]


def _spoilt(kind: Kind, draw: random.Random) -> bytes:
    """The bytes of a damaged file."""
    data = kind.path.read_bytes()
    if not kind.member:
        return damaged(data, draw)
    with zipfile.ZipFile(io.BytesIO(data)) as whole:
        held = {name: whole.read(name) for name in whole.namelist()}
    before = held[kind.member]
    held[kind.member] = damaged(before, draw)
    if kind.member == "policy.pth":
        # What whoever makes it would put right too.
        said_of_it = json.loads(held["agent.json"])
        held["agent.json"] = json.dumps(
            {**said_of_it, "policy_sha256": hashlib.sha256(held[kind.member]).hexdigest()}
        ).encode()
    found = io.BytesIO()
    with zipfile.ZipFile(found, "w") as copy:
        for name, each in held.items():
            copy.writestr(name, each)
    return found.getvalue()


def fuzzed(name: str, kind: Kind, examples: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """How many damaged files gave a clear line, were read as before or otherwise; and what is wrong."""
    draw = random.Random(name)
    watch = _watch()
    good = kind.read(kind.path)
    tally: Counter[str] = Counter()
    wrong = []
    path = folder / kind.path.name
    for i in range(examples):
        path.write_bytes(_spoilt(kind, draw))
        watch.seen.clear()
        watch.on = True
        fault = ""
        try:
            with warnings.catch_warnings(), _within(SLOWEST_S):
                warnings.simplefilter("error")
                found = kind.read(path)
            tally["read as before" if found == good else "read, saying something else"] += 1
        except (CommandError, SettingError) as error:
            text = " ".join(str(error).split())
            if not text or len(text) > LONGEST or path.name not in text:
                fault = f"not a clear line: {text}"
            tally["a clear line"] += not fault
        except (Exception, _Hangs) as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            fault = f"{type(error).__name__} in {Path(where.filename).name}: {' '.join(str(error).split())[:150]}"
        finally:
            watch.on = False
        if watch.seen:
            fault = f"it ran {watch.seen[0]}"
        if fault:
            wrong.append(f"{name} {i}: {fault}")
    os.unlink(path)
    return tally, wrong


_WATCHES: list[_Watch] = []


def _watch() -> _Watch:
    if not _WATCHES:
        _WATCHES.append(_Watch())
    return _WATCHES[0]


def tried(examples: int) -> dict[str, tuple[Counter[str], list[str]]]:
    """All kinds, each damaged so many times."""
    with tempfile.TemporaryDirectory() as own:
        found = {}
        (Path(own) / "damaged").mkdir()
        for name, kind in kinds(Path(own)).items():
            print(f"  {name}", file=sys.stderr, flush=True)
            found[name] = fuzzed(name, kind, examples, Path(own) / "damaged")
        return found


def measure(long: bool) -> list[tuple[str, str]]:
    """Twenty or a thousand damaged files of each kind."""
    examples = LONG_EXAMPLES if long else EXAMPLES
    rows = []
    wrong = []
    for name, (tally, faults) in tried(examples).items():
        wrong += faults
        text = ", ".join(f"{count:,} {words}" for words, count in sorted(tally.items()) if count)
        rows.append((f"{examples:,} damaged: {name}", text))
    every = examples * len(rows)
    return [
        ("damaged files that gave one clear line or were read without harm", share(every - len(wrong), every)),
        ("tracebacks, hangs, code that ran, lines that don't help", none_of(wrong)),
        *rows,
    ]
