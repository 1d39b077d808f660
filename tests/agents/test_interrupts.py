"""Being asked to stop, killed, and left without room: by real signals to real processes."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from tests.trust import kills, writes
from tests.trust.processes import BRIEF, TRAIN, end, lines, start, until
from uwoc_gym import agents
from uwoc_gym.agents import interrupts
from uwoc_gym.agents.cli import COMMANDS, main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import checkpoints, training
from uwoc_gym.agents.reports import files

LONG = ["--scenario", "Nominal", "--override", '{"episode": {"duration_s": 100000}}']


def _hears(process: subprocess.Popen[str], number: int) -> bool:
    """Whether a process has a handler of its own for a signal."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) >> (number - 1) & 1)


WORK: dict[str, tuple[list[str], Callable[[Path], bool]]] = {
    "train": (["--steps", "10000000", "--eval-every", "64", *TRAIN, *BRIEF, "--out", "OUT"],
              lambda out: (out / "last.zip").is_file()),
    "benchmark": (["--policy", "pd", "--scenario", "Random", "--seeds", "1000000", "--batch", "2", *BRIEF,
                   "--out", "OUT"],
                  lambda out: lines(out / "episodes.csv") > 3),
    "evaluate": (["pd", "--seeds", "1000000", *BRIEF, "--out", "OUT"], lambda out: True),
    "tune": (["pd", "--trials", "1000000", "--episodes", "2", *BRIEF, "--out", "OUT"],
             lambda out: lines(out / "trials.csv") > 20),
    "tracker": (["--override", "episode.duration_s=4", "--episodes", "64", "--steps", "10000000", "--units", "4",
                 "--out", "OUT"],
                lambda out: (out / ".lock").is_file()),
    "calibrate": (["nlpd", "--trials", "1000000", "--batch", "8", "--out", "OUT"],
                  lambda out: lines(out / "trials.csv") > 8),
    "dataset": (["--policy", "pd", "--episodes", "1000000", *BRIEF, "--out", "OUT-v0"],
                lambda out: (out.with_name(".OUT-v0.part") / "data/main_data.hdf5").is_file()),
    "protocol": (["--groups", "ppo", "--training-seeds", "2", "--steps", "10000000", "--runs", "OUT/runs",
                  "--out", "OUT"],
                 lambda out: len(list(out.glob("runs/*/train.log"))) == 2),
    "reproduce": (["--out", "OUT"], lambda out: True),
    "record": (["--policy", "pd", *LONG, "--to", "40000", "--size", "320x180", "--out", "OUT.mp4"],
               lambda out: out.with_name(".OUT.mp4.part").is_file()),
    "replay": ([*LONG, "--out", "OUT.html"], lambda out: True),
    "watch": (["--policy", "pd", *LONG, "--size", "320x180"], lambda out: True),
    "speed": (["--time", "100", "--out", "OUT"], lambda out: True),
}  # fmt: skip
"""Work that takes long, and how one sees that it has begun."""

OFTEN = ("train", "benchmark", "evaluate")
"""What is stopped in every run of the tests; the others are in ``-m long``."""


def _interrupted(command: str, number: int, folder: Path, group: bool, wait_s: float) -> tuple[int, str, str]:
    words, begun = WORK[command]
    out = folder / "OUT"
    process = start(command, *(word.replace("OUT", str(out)) for word in words))
    until(lambda: begun(out) and _hears(process, signal.SIGTERM), process)
    time.sleep(wait_s)
    (os.killpg if group else os.kill)(process.pid, number)
    ended = end(process)
    if command == "benchmark":
        # Those that flew for it have ended too; who watches over their shared memory ends once they have.
        latest = time.monotonic() + 20.0
        while _alive(process.pid) and time.monotonic() < latest:
            time.sleep(0.1)
        assert _alive(process.pid) == []
    return ended


def _alive(group: int) -> list[str]:
    """The processes of a group that haven't ended, by name and state."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            name, _, rest = path.read_text().rpartition(")")
            state, _, own = rest.split()[:3]
            if int(own) == group and state != "Z":
                found.append(f"{name}) {state}")
    return found


def test_a_request_that_is_swallowed_while_something_compiles_is_heard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def compiling(run: training.Run) -> list[str]:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        return []

    monkeypatch.setattr(training.Run, "preview", compiling)
    assert main(["train", *TRAIN, "--steps", "64", "--out", str(tmp_path / "run")]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "uwoc-gym train: error: interrupted"
    assert not training.begun(tmp_path / "run")


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")
def test_who_works_for_a_command_that_is_killed_ends_and_keeps_what_it_has(tmp_path: Path) -> None:
    words, begun = WORK["protocol"]
    process = start("protocol", "--jobs", "2", *(word.replace("OUT", str(tmp_path)) for word in words))
    until(lambda: begun(tmp_path), process)
    process.kill()
    latest = time.monotonic() + 60.0
    while _alive(process.pid) and time.monotonic() < latest:
        time.sleep(0.1)
    assert _alive(process.pid) == []
    process.communicate()
    for seed in range(2):
        assert checkpoints.newest(tmp_path / f"runs/ppo-{seed}") is not None


def test_all_commands_that_take_long_are_interrupted() -> None:
    assert set(WORK) == set(COMMANDS) - {"list"}


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize(
    "command", [pytest.param(each, marks=() if each in OFTEN else pytest.mark.long) for each in WORK]
)
def test_sigterm_ends_a_command_as_an_interrupt_does(command: str, tmp_path: Path) -> None:
    # Nothing tells from outside that `evaluate` has flown its first episodes.
    wait_s = 8.0 if command == "evaluate" else 1.5
    status, _, errors = _interrupted(command, signal.SIGTERM, tmp_path, False, wait_s)
    assert status == 128 + signal.SIGTERM, errors
    assert "Traceback" not in errors
    last = errors.splitlines()[-1]
    assert last.startswith(f"uwoc-gym {command}")
    assert "interrupted" in last
    assert not [path for path in tmp_path.rglob(".*") if path.name.endswith((".part", ".draft"))]
    out = tmp_path / "OUT"
    match command:
        case "train":
            assert agents.load(str(out), "Random") is not None
            assert json.loads((out / "results.json").read_text())["finished"] is False
        case "benchmark":
            results = json.loads((out / "results.json").read_text())
            assert results["finished"] is False
            assert results["results"][0]["episodes"] == lines(out / "episodes.csv") - 1 > 0
            assert "# Random" in (out / "table.md").read_text()
        case "evaluate":
            results = json.loads((out / "results.json").read_text())
            assert results["finished"] is False
            assert results["results"][0]["episodes"] == len(results["episodes"]) > 0
            assert len(results["settings"]["seeds"]) == len(results["episodes"])
        case "dataset":
            results = json.loads((tmp_path / "OUT-v0/results.json").read_text())
            assert results["finished"] is False
            assert results["results"]["pd"]["episodes"] >= 100
        case "tune" | "calibrate":
            results = json.loads((out / "results.json").read_text())
            assert results["finished"] is False
            assert results["trials"] == lines(out / "trials.csv") - 1
        case "protocol":
            # Each training was told, and wrote where it stood.
            for path in (out / "runs").iterdir():
                assert checkpoints.newest(path) is not None
        case "record":
            assert (tmp_path / "OUT.mp4").stat().st_size > 1000


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")
def test_ctrl_c_reaches_the_whole_group_and_is_answered_once(tmp_path: Path) -> None:
    status, _, errors = _interrupted("protocol", signal.SIGINT, tmp_path, True, 1.0)
    assert status == 130, errors
    assert "Traceback" not in errors
    assert errors.splitlines()[-1] == "uwoc-gym protocol: error: interrupted"
    for path in (tmp_path / "OUT/runs").iterdir():
        assert checkpoints.newest(path) is not None


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")
def test_ctrl_c_during_the_import_is_one_line() -> None:
    draw = random.Random(0)
    for number in (signal.SIGINT, signal.SIGINT, signal.SIGINT, signal.SIGTERM):
        process = start("benchmark", "--seeds", "1000000")
        until(lambda one=process: _hears(one, signal.SIGTERM), process)  # type: ignore[misc]
        time.sleep(draw.uniform(0.0, 0.5))
        process.send_signal(number)
        status, said, errors = end(process)
        assert (status, said) == (128 + number, "")
        assert len(errors.splitlines()) == 1, errors
        assert "interrupted" in errors


@pytest.mark.parametrize(
    ("command", "times"),
    [
        ("train, PPO with normalisation", 1),
        *(pytest.param(each, 1, marks=pytest.mark.long) for each in ("train, SAC", "tune", "benchmark")),
    ],
)
def test_whatever_kills_a_command_its_folder_loads_and_goes_on(command: str, times: int, tmp_path: Path) -> None:
    _, most, kill = kills.COMMANDS[command]
    tally = kill(times, tmp_path, random.Random(1))
    assert tally.wrong == []
    assert tally.good == tally.kills == times
    assert max(tally.lost) <= most


def test_two_processes_in_one_folder_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(["train", "--steps", "64", *TRAIN, *BRIEF, "--out", str(out)]) == 0
    code = (
        "import sys, time, pathlib\nfrom uwoc_gym.agents.reports import files\n"
        "with files.locked(pathlib.Path(sys.argv[1])):\n    print('locked', flush=True)\n    time.sleep(600)\n"
    )
    holders = [
        subprocess.Popen([sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE, text=True)
        for folder in (out, tmp_path)
    ]
    try:
        for holder in holders:
            assert holder.stdout is not None
            assert holder.stdout.readline() == "locked\n"
        before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
        capsys.readouterr()
        for words in (
            ["train", "--resume", "--out", str(out)],
            ["tune", "pd", "--trials", "16", "--episodes", "2", *BRIEF, "--out", str(tmp_path)],
            ["calibrate", "nlpd", "--trials", "64", "--out", str(tmp_path)],
        ):
            assert main(words) == 1
            error = capsys.readouterr().err
            assert len(error.splitlines()) == 1
            assert "another process is at work in this folder" in error
        assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()} == before
        # A task waits: what was killed on another node may not know yet.
        ending = threading.Timer(0.5, holders[0].kill)
        ending.start()
        with files.locked(out, patience_s=30.0):
            assert holders[0].wait() != 0
    finally:
        for holder in holders:
            holder.kill()
            holder.communicate()
    # What is dead holds nothing.
    assert main(["train", "--resume", "--out", str(out)]) == 0


def test_a_lock_ends_with_its_block(tmp_path: Path) -> None:
    for _ in range(2):
        with files.locked(tmp_path), pytest.raises(CommandError, match="another process"), files.locked(tmp_path):
            pass


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
# There is no room for compiled code either, where it isn't there yet.
@pytest.mark.filterwarnings("ignore:the cache of compiled code:RuntimeWarning")
@pytest.mark.parametrize("command", writes.WRITERS)
@pytest.mark.parametrize(
    "size", [pytest.param(each, marks=() if each == 700 else pytest.mark.long) for each in writes.SIZES]
)
def test_a_full_disk_names_the_file_and_leaves_no_part(command: str, size: int, tmp_path: Path) -> None:
    assert writes.faults(writes.WRITERS[command], size, tmp_path / "out")[1] == []


def test_the_second_request_stops_at_once_unless_it_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with interrupts.heard(), interrupts.noted() as asked:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        assert asked == [signal.SIGTERM]
        monkeypatch.setattr(time, "monotonic", lambda: 1e9)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert interrupts.status() == 128 + signal.SIGTERM
    with interrupts.heard(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    with interrupts.heard():
        assert interrupts.status() == 128 + signal.SIGINT
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_what_is_begun_apart_does_not_hear_ctrl_c() -> None:
    code = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))"

    def deaf() -> str:
        return subprocess.check_output([sys.executable, "-c", code], text=True).strip()

    with interrupts.kept_from_children():
        assert deaf() == "True"
    assert deaf() == "False"
