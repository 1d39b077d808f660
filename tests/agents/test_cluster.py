"""Work done by Ray: the same results, and one clear line for what can't be."""

from __future__ import annotations

import builtins
import pickle
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from uwoc_gym.agents import cluster
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.work import Task


def doubled(factor: int, seeds: Sequence[int]) -> list[int]:
    return [factor * seed for seed in seeds]


def full(seeds: Sequence[int]) -> None:
    raise OSError(28, "No space left on device", "runs/ppo-0")


def stopped(seeds: Sequence[int]) -> None:
    signal.raise_signal(signal.SIGTERM)


def test_a_node_does_what_it_is_sent() -> None:
    good, found = cluster.perform(pickle.dumps(Task(doubled, (2,), [3, 4])), cluster.same())
    assert good
    assert pickle.loads(found) == [6, 8]


def test_a_node_without_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *more: Any) -> Any:
        if name.startswith("uwoc_gym"):
            raise ModuleNotFoundError(f"No module named {name.partition('.')[0]!r}")
        return real(name, *more)

    monkeypatch.setattr(builtins, "__import__", without)
    good, found = cluster.outpost()(b"", {"uwoc-gym": "0.1.0"})
    assert not good
    assert "uwoc-gym 0.1.0 isn't installed (No module named 'uwoc_gym'); install there what is here." in found


def test_a_node_with_another_version_is_refused() -> None:
    task = pickle.dumps(Task(doubled, (2,), [3]))
    good, found = cluster.perform(task, cluster.same() | {"uwoc-gym": "9.9", "code of uwoc-gym": "0"})
    assert not good
    assert isinstance(found, CommandError)
    assert "here 9.9, code of uwoc-gym is" in str(found)


def test_a_node_whose_disk_is_full_is_named() -> None:
    good, found = cluster.perform(pickle.dumps(Task(full)), cluster.same())
    assert not good
    assert isinstance(found, CommandError)
    assert "No space left on device: 'runs/ppo-0' (on node " in str(found)


def test_a_task_that_is_asked_to_stop_ends_its_process() -> None:
    with pytest.raises(SystemExit) as ended:
        cluster.perform(pickle.dumps(Task(stopped)), cluster.same())
    assert ended.value.code == 128 + signal.SIGTERM


@pytest.mark.parametrize("place", ["rays", "ray://host", "ray://:10001", "ray://a b:1", "http://host:1"])
def test_a_place_that_there_is_not_is_refused(place: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "--on", place]) == 2
    assert "it must be ray, or ray://HOST:PORT" in capsys.readouterr().err


@pytest.mark.filterwarnings("default")
def test_ray_gives_the_same_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    short = ["--override", "episode.duration_s=3"]
    flights = ["benchmark", "--policy", "pd", "los", "--scenario", "Random", "Tide", "--seeds", "4", "--batch", "2"]
    search = ["tune", "los", "--scenario", "Tide", "--trials", "8", "--batch", "4", "--episodes", "2"]
    for name, where in (("here", ["--jobs", "1"]), ("ray", ["--jobs", "2", "--on", "ray"])):
        assert main([*flights, *short, *where, "--out", str(tmp_path / name)]) == 0
        assert main([*search, *short, "--eval-episodes", "2", *where, "--out", str(tmp_path / f"tuned-{name}")]) == 0
    for one, other in (("here/episodes.csv", "ray/episodes.csv"), ("tuned-here/trials.csv", "tuned-ray/trials.csv")):
        assert (tmp_path / one).read_bytes() == (tmp_path / other).read_bytes()
