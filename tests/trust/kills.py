"""Commands killed by SIGKILL at random moments: what stands there is whole, goes on, and what was finished is kept."""

from __future__ import annotations

import csv
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tests.trust.figures import Wrong, none_of, share
from tests.trust.processes import BRIEF, OFF_TRAIN, TRAIN, end, lines, start, until
from uwoc_gym import agents
from uwoc_gym.agents.learning import checkpoints, training
from uwoc_gym.agents.learning.progress import read_progress
from uwoc_gym.agents.policies import archive

KILLS, LONG_KILLS = 3, 20
"""Of each command."""
SCENARIO = "Random"


@dataclass
class Tally:
    """What came of the kills of one command."""

    kills: int = 0
    good: int = 0
    lost: list[int] = field(default_factory=list)
    """Finished pieces of work of which nothing is known any more, by kill."""
    wrong: list[str] = field(default_factory=list)

    def note(self, faults: list[str], lost: int) -> None:
        """Add a kill."""
        self.kills += 1
        self.good += not faults
        self.lost.append(lost)
        self.wrong += faults


def killed(words: list[str], out: Path, moment: Callable[[subprocess.Popen[str]], None]) -> bool:
    """Start a command and kill it, with its children, when ``moment`` has passed; False if it had ended by itself."""
    process = start(*(word.replace("OUT", str(out)) for word in words))
    try:
        moment(process)
        running = process.poll() is None
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    status, _, errors = end(process)
    assert running or status == 0, errors
    return running


def _after(found: Callable[[], bool], wait_s: float) -> Callable[[subprocess.Popen[str]], None]:
    """The moment so long after something is there."""

    def moment(process: subprocess.Popen[str]) -> None:
        until(found, process)
        time.sleep(wait_s)

    return moment


def _at(wait_s: float) -> Callable[[subprocess.Popen[str]], None]:
    """The moment so long after the start, or the end."""

    def moment(process: subprocess.Popen[str]) -> None:
        latest = time.monotonic() + wait_s
        while time.monotonic() < latest and process.poll() is None:
            time.sleep(0.01)

    return moment


def run_faults(out: Path) -> list[str]:
    """What is wrong with the folder of a training that was killed."""
    last = checkpoints.newest(out)
    if last is None:
        return []
    try:
        progress = read_progress(last / "progress.json")
        agents_there = [path for path in (out / "model.zip", last / "last.zip", last / "best.zip", out / "last.zip")
                        if path.is_file()]  # fmt: skip
        for path in agents_there:
            # Weights, their digest and statistics.
            agents.load(str(path), SCENARIO)
        counted = archive.read(last / "last.zip").normalisation
    except Exception as error:
        return [f"{type(error).__name__}: {error}"]
    if len(agents_there) < 3:
        return [f"only {[path.name for path in agents_there]} of {last.name} are there"]
    if counted is not None and counted.observations is not None and counted.observations.count < progress.steps:
        return [f"statistics of {counted.observations.count} steps for weights of {progress.steps}"]
    return []


def _evaluations(out: Path, skip: int) -> list[int]:
    """Steps of the evaluations that a log tells of, after so many of its lines."""
    log = out / "train.log"
    text = log.read_text(encoding="utf-8").splitlines()[skip:] if log.is_file() else []
    return [int(found[1]) for line in text if (found := re.search(r" step (\d+):", line))]


def trainings(options: list[str], kills: int, folder: Path, draw: random.Random) -> Tally:
    """Kill a training after each new checkpoint, every third time at any moment, and go on with it."""
    begin = ["train", "--steps", "10000000", "--eval-every", "64", *options, *BRIEF, "--out", "OUT"]
    tally, out = Tally(), folder / "0"
    for kill in range(kills):
        early = kill % 3 == 2
        if early:
            out = folder / str(kill)
        # What an early kill left is gone on with by the next one.
        words = ["train", "--resume", "--out", "OUT"] if training.begun(out) else begin
        before, skip = checkpoints.newest(out), lines(out / "train.log")
        steps = read_progress(before / "progress.json").steps if before else 0
        new = _after(lambda own=out, last=before: checkpoints.newest(own) not in (None, last), draw.uniform(0.0, 0.6))  # type: ignore[misc]
        killed(words, out, _at(draw.uniform(1.0, 9.0)) if early else new)
        faults, lost = run_faults(out), 0
        last = checkpoints.newest(out)
        if last is not None and not faults:
            progress = read_progress(last / "progress.json")
            kept = {each["steps"] for each in progress.evaluations}
            lost = sum(each not in kept for each in _evaluations(out, skip))
            if progress.steps < steps:
                faults.append(f"{progress.steps} steps where there were {steps}")
        tally.note(faults, lost)
    # The last one goes on too.
    words = ["train", "--resume", "--out", "OUT"] if training.begun(out) else begin
    before = checkpoints.newest(out)
    killed(words, out, _after(lambda: checkpoints.newest(out) not in (None, before), 0.0))
    return tally


def _tried(out: Path) -> int:
    """Trials in the database of a search."""
    import optuna

    if not (out / "study.db").is_file():
        return 0
    study = optuna.load_study(study_name="search", storage=f"sqlite:///{out / 'study.db'}")
    return sum(trial.state.is_finished() for trial in study.trials)


def tunings(kills: int, folder: Path, draw: random.Random) -> Tally:
    """Kill a search between and in its batches, every third time at any moment from its start on."""
    begin = ["tune", "pd", "--trials", "1000000", "--batch", "4", "--episodes", "2", *BRIEF, "--out", "OUT"]
    tally, out = Tally(), folder / "0"
    for kill in range(kills):
        early = kill % 3 == 2
        if early:
            out = folder / str(kill)
        table = out / "trials.csv"
        before = lines(table)
        words = [*begin, "--resume"] if (out / "study.db").is_file() else begin
        seen = [before]

        def moment(process: subprocess.Popen[str], wait_s: float, own: Path = table, seen: list[int] = seen) -> None:
            until(lambda: lines(own) > seen[0], process)
            latest = time.monotonic() + wait_s
            while time.monotonic() < latest:
                seen.append(lines(own))

        wait_s = draw.uniform(0.0, 0.6)
        killed(words, out, _at(draw.uniform(1.0, 8.0)) if early else lambda process, wait=wait_s: moment(process, wait))  # type: ignore[misc]
        faults, lost = [], 0
        try:
            kept = _tried(out)
        except KeyError:
            # Killed before the search had a name; nothing had been tried.
            kept = 0
        lost = max(max(seen) - 1 - kept, 0)
        if lines(table):
            rows = list(csv.reader(table.read_text(encoding="utf-8").splitlines()))
            if len({len(row) for row in rows}) != 1 or len(rows) < max(seen):
                faults.append(f"trials.csv has {len(rows)} rows after {max(seen)}")
        tally.note(faults, lost)
    words = [*begin, "--resume"] if (out / "study.db").is_file() else begin
    before = lines(out / "trials.csv")
    killed(words, out, _after(lambda: lines(out / "trials.csv") > before, 0.0))
    return tally


def benchmarks(kills: int, folder: Path, draw: random.Random) -> Tally:
    """Kill a benchmark; its table of episodes has whole rows, all that were seen in it."""
    words = ["benchmark", "--policy", "pd", "--scenario", SCENARIO, "--seeds", "1000000", "--batch", "2", *BRIEF,
             "--out", "OUT"]  # fmt: skip
    tally, table = Tally(), folder / "OUT/episodes.csv"
    for _ in range(kills):
        table.unlink(missing_ok=True)
        seen = [0]

        def moment(process: subprocess.Popen[str], wait_s: float, seen: list[int] = seen) -> None:
            until(lambda: lines(table) > 3, process)
            latest = time.monotonic() + wait_s
            while time.monotonic() < latest:
                # The last line may be on its way.
                seen.append(lines(table) - 1)

        wait_s = draw.uniform(0.0, 1.0)
        killed(words, folder / "OUT", lambda process, wait=wait_s: moment(process, wait))  # type: ignore[misc]
        text = table.read_text(encoding="utf-8")
        rows = list(csv.reader(text.splitlines()))
        faults = [] if text.endswith("\n") else [f"a row is torn: {text[-60:]!r}"]
        if len({len(row) for row in rows}) != 1:
            faults.append("rows of several lengths")
        tally.note(faults, max(max(seen) - len(rows), 0))
    return tally


def evaluations(kills: int, folder: Path, draw: random.Random) -> Tally:
    """Kill an evaluation; it writes once, at its end: all or nothing is there."""
    words = ["evaluate", "pd", "--seeds", "4000", *BRIEF, "--out", "OUT"]
    tally = Tally()
    begun = time.monotonic()
    killed(words, folder / "whole", _at(600.0))
    taken = time.monotonic() - begun
    for kill in range(kills):
        out = folder / str(kill)
        running = killed(words, out, _at(draw.uniform(0.3, 1.05) * taken))
        faults, path = [], out / "results.json"
        if path.is_file():
            if json.loads(path.read_text(encoding="utf-8"))["finished"] is not True:
                faults.append("results.json isn't finished")
        elif not running:
            faults.append("it ended without results.json")
        tally.note(faults, 0)
    return tally


def protocols(kills: int, folder: Path, draw: random.Random) -> Tally:
    """Kill a protocol and begin it anew, until it has come to its end; then another one."""
    words = ["protocol", "--groups", "ppo", "--training-seeds", "2", "--steps", "1000", "--scenario", SCENARIO,
             "--seeds", "4", "--jobs", "1", "--runs", "OUT/runs", "--out", "OUT"]  # fmt: skip
    tally, out, number = Tally(), folder / "0", 0
    while tally.kills < kills:
        before = {path for path in out.glob("runs/*") if training.finished(path)}
        if not killed(words, out, _at(draw.uniform(4.0, 25.0))):
            number += 1
            out = folder / str(number)
            continue
        after = {path for path in out.glob("runs/*") if training.finished(path)}
        faults = [fault for path in out.glob("runs/*") for fault in run_faults(path)]
        tally.note(faults, len(before - after))
    if killed(words, out, _at(600.0)) or not (out / "BENCHMARK.md").is_file():
        tally.wrong.append("it doesn't come to its end")
    return tally


COMMANDS: dict[str, tuple[str, int, Callable[[int, Path, random.Random], Tally]]] = {
    "train, PPO with normalisation": (
        "evaluations", 1, lambda kills, folder, draw: trainings(TRAIN, kills, folder, draw)
    ),
    "train, SAC": ("evaluations", 1, lambda kills, folder, draw: trainings(OFF_TRAIN, kills, folder, draw)),
    "tune": ("trials that stood in trials.csv", 0, tunings),
    "benchmark": ("episodes that stood in episodes.csv", 0, benchmarks),
    "protocol": ("finished trainings", 0, protocols),
    "evaluate": ("results that it had written, at its end,", 0, evaluations),
}  # fmt: skip
"""What is counted as finished, how much of it one kill may cost, and what kills it."""


def measure(long: bool) -> list[tuple[str, str]]:
    """Three or twenty kills of each command."""
    rows, wrong = [], []
    for name, (finished, most, kill) in COMMANDS.items():
        print(f"  {name}", file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            try:
                tally = kill(LONG_KILLS if long else KILLS, Path(folder), random.Random(name))
            except AssertionError as error:
                # A command that should have gone on has ended.
                tally = Tally(1, 0, [], [f"it doesn't go on: {error}"])
        wrong += [f"{name}: {fault}" for fault in tally.wrong]
        rows.append((f"{name}: kills after which the folder loads, belongs together and goes on",
                     share(tally.good, tally.kills)))  # fmt: skip
        text = f"{sum(tally.lost)} in {tally.kills} kills, at most {max(tally.lost, default=0)} a kill"
        rows.append((f"{name}: {finished} lost", text if max(tally.lost, default=0) <= most else Wrong(text)))
    return [*rows, ("kills: what was wrong", none_of(wrong))]
