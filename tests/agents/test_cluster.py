"""Work done by Ray: the same results, and one clear line for what can't be."""

from __future__ import annotations

import builtins
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.trust.processes import start, until
from uwoc_gym.agents import cluster
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.work import Task, run_all


def doubled(factor: int, seeds: Sequence[int]) -> list[int]:
    return [factor * seed for seed in seeds]


def full(seeds: Sequence[int]) -> None:
    raise OSError(28, "No space left on device", "runs/ppo-0")


def stopped(seeds: Sequence[int]) -> None:
    signal.raise_signal(signal.SIGTERM)


def test_a_node_does_what_it_is_sent() -> None:
    good, found = cluster.perform(pickle.dumps(Task(doubled, (2,), [3, 4])), cluster.same(), "")
    assert good
    assert pickle.loads(found) == [6, 8]


def where(seeds: Sequence[int]) -> str:
    return str(Path.cwd())


def test_paths_begin_on_a_node_where_they_do_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir("/")
    good, found = cluster.perform(pickle.dumps(Task(where)), cluster.same(), str(tmp_path))
    assert good
    assert pickle.loads(found) == str(tmp_path)


def test_a_node_without_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *more: Any) -> Any:
        if name.startswith("uwoc_gym"):
            raise ModuleNotFoundError(f"No module named {name.partition('.')[0]!r}")
        return real(name, *more)

    monkeypatch.setattr(builtins, "__import__", without)
    good, found = cluster.outpost()(b"", {"uwoc-gym": "0.1.0"}, "")
    assert not good
    assert "uwoc-gym 0.1.0 isn't installed (No module named 'uwoc_gym'); install there what is here." in found


def test_a_node_with_another_version_is_refused() -> None:
    task = pickle.dumps(Task(doubled, (2,), [3]))
    good, found = cluster.perform(task, cluster.same() | {"uwoc-gym": "9.9", "code of uwoc-gym": "0"}, "")
    assert not good
    assert isinstance(found, CommandError)
    assert "here 9.9, code of uwoc-gym is" in str(found)


def test_a_node_whose_disk_is_full_is_named() -> None:
    good, found = cluster.perform(pickle.dumps(Task(full)), cluster.same(), "")
    assert not good
    assert isinstance(found, CommandError)
    assert "No space left on device: 'runs/ppo-0' (on node " in str(found)


def test_a_task_that_is_asked_to_stop_ends_its_process() -> None:
    with pytest.raises(SystemExit) as ended:
        cluster.perform(pickle.dumps(Task(stopped)), cluster.same(), "")
    assert ended.value.code == 128 + signal.SIGTERM


@pytest.mark.parametrize("place", ["rays", "ray://host", "ray://:10001", "ray://a b:1", "http://host:1"])
def test_a_place_that_there_is_not_is_refused(place: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "--on", place]) == 2
    assert "it must be ray, or ray://HOST:PORT" in capsys.readouterr().err


def called(seeds: Sequence[int]) -> str:
    import ray

    name: str = ray.get_runtime_context().get_task_name()
    return name


@pytest.mark.filterwarnings("default")
def test_ray_gives_the_same_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    short = ["--override", "episode.duration_s=3"]
    flights = ["benchmark", "--policy", "pd", "los", "--scenario", "Random", "Tide", "--seeds", "4", "--batch", "2"]
    search = ["tune", "los", "--scenario", "Tide", "--trials", "8", "--batch", "4", "--episodes", "2"]
    for name, where in (("here", ["--jobs", "1"]), ("ray", ["--jobs", "2", "--on", "ray"])):
        assert main([*flights, *short, *where, "--out", str(tmp_path / name)]) == 0
        assert main([*search, *short, "--eval-episodes", "2", *where, "--out", str(tmp_path / f"tuned-{name}")]) == 0
    with cluster.workers(1, "ray") as crew:
        # What Ray's dashboard shows.
        assert [name for _, name in run_all([Task(called, name="training ppo-0")], crew)] == ["training ppo-0"]
    for one, other in (("here/episodes.csv", "ray/episodes.csv"), ("tuned-here/trials.csv", "tuned-ray/trials.csv")):
        assert (tmp_path / one).read_bytes() == (tmp_path / other).read_bytes()


@pytest.fixture
def three_nodes(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """The address of a cluster of a head and two nodes of one core, and the processes of these two."""
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    # Of its own: Ray keeps there which cluster is this machine's, also once that one is gone.
    folder = tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True)
    monkeypatch.setenv("RAY_TMPDIR", folder.name)
    with ExitStack() as sockets:
        ports = [sockets.enter_context(closing(socket.create_server(("127.0.0.1", 0)))).getsockname()[1] for _ in "ab"]
    nodes: list[subprocess.Popen[bytes]] = []

    def begin(*words: str) -> None:
        command = [str(Path(sys.executable).with_name("ray")), "start", "--block", "--object-store-memory=100000000"]
        nodes.append(subprocess.Popen([*command, *words], stdout=subprocess.DEVNULL, start_new_session=True))
        time.sleep(10.0)

    try:
        client = f"--ray-client-server-port={ports[1]}"
        begin("--head", f"--port={ports[0]}", client, "--num-cpus=0", "--include-dashboard=false")
        for _ in range(2):
            begin(f"--address=127.0.0.1:{ports[0]}", "--num-cpus=1")
        yield f"ray://127.0.0.1:{ports[1]}", nodes[1:]
    finally:
        # Asked to stop, `ray start` ends all that it has begun.
        for node in reversed(nodes):
            node.terminate()
            with suppress(subprocess.TimeoutExpired):
                node.wait(timeout=30.0)
            with suppress(ProcessLookupError):
                os.killpg(node.pid, signal.SIGKILL)
            node.wait()
        folder.cleanup()


@pytest.mark.long
@pytest.mark.parametrize("dies", ["node", "driver"])
def test_what_dies_on_a_cluster_changes_no_number(
    dies: str, three_nodes: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    address, nodes = three_nodes
    words = ["protocol", "--groups", "ppo", "--training-seeds", "2", "--steps", "700000", "--scenario", "Random"]
    words += ["--seeds", "4", "--rivals", "nlpd"]
    there = [*words, "--on", address, "--runs", str(tmp_path / "there"), "--out", str(tmp_path / "out-there")]
    process = start(*there)
    checkpoints = [tmp_path / f"there/ppo-{seed}/checkpoint-000002" for seed in range(2)]
    until(lambda: all(path.is_dir() for path in checkpoints), process)
    os.killpg(nodes[0].pid if dies == "node" else process.pid, signal.SIGKILL)
    if dies == "driver":
        process.communicate()
        process = start(*there)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    assert main([*words, "--jobs", "1", "--runs", str(tmp_path / "here"), "--out", str(tmp_path / "out-here")]) == 0
    with np.load(tmp_path / "out-there/scores.npz") as mine, np.load(tmp_path / "out-here/scores.npz") as other:
        assert mine.files == other.files
        for name in mine.files:
            np.testing.assert_array_equal(mine[name], other[name])
    for seed in range(2):
        told = [json.loads((tmp_path / f"{place}/ppo-{seed}/results.json").read_text()) for place in ("there", "here")]
        assert told[0]["evaluations"] == told[1]["evaluations"]
        # Nothing that a checkpoint stood for was done again.
        assert len((tmp_path / f"there/ppo-{seed}/train.log").read_text().splitlines()) == len(told[0]["evaluations"])
