"""Files that are whole or not there."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import uwoc_gym.agents
from uwoc_gym import Scenario
from uwoc_gym.agents.reports import files


def test_only_one_function_writes_results() -> None:
    # It asks for the scenarios, so that none is spoken of without its digest.
    sources = Path(uwoc_gym.agents.__file__).parent.rglob("*.py")
    writers = [path.name for path in sources if re.search(r"write_\w+\([^)]*RESULTS", path.read_text("utf-8"))]
    assert writers == ["files.py"]


def test_a_file_is_whole_or_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    files.write_text(path, "old")

    def fail() -> None:
        with files.whole(path) as part:
            part.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "old"
    with files.whole(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_results_name_their_scenarios_by_digest(tmp_path: Path) -> None:
    short = Scenario.named("Random").merged({"episode": {"duration_s": 5.0}})
    files.write_results(tmp_path, "uwoc-gym x", {"Random": short, "CartPole-v1": None}, {"score": float("nan")})
    found = json.loads((tmp_path / "results.json").read_text())
    assert found["scenarios"] == {"Random": short.digest()} != {"Random": Scenario.named("Random").digest()}
    assert found["command"] == "uwoc-gym x"
    assert found["versions"]["numba"]
    assert found["score"] is None


def test_a_folder_is_whole_or_not_there(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "data"

    def fill(name: str, full: bool = False) -> None:
        with files.whole_folder(target) as part:
            (part / name).write_text(name)
            if full:
                raise OSError("full")

    with pytest.raises(OSError, match="full"):
        fill("half", full=True)
    assert list(tmp_path.iterdir()) == []
    fill("all")
    assert [path.name for path in target.parent.rglob("*")] == ["data", "all"]
    with pytest.raises(OSError, match="not empty"):
        fill("other")
    assert [path.name for path in target.parent.rglob("*")] == ["data", "all"]
