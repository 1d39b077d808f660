"""The table of planted faults is of the present sources; ``python -m tests.trust.mutants`` runs it."""

from __future__ import annotations

import ast
import importlib.util
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


def _load() -> Any:
    """The module beside this file, wherever pytest was started."""
    spec = importlib.util.spec_from_file_location("trust_mutants", Path(__file__).with_name("mutants.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


mutants = _load()
NAMES = [fault.name for fault in mutants.FAULTS]
TINY = mutants.Fault("tiny", "nothing", "uwoc_gym/task/action.py", "-1.0), 1.0", "-1.0), 2.0", "tests/test_tiny.py")


def test_there_are_enough_faults_of_all_kinds() -> None:
    assert len(NAMES) == len(set(NAMES)) >= 24
    for kind in (mutants.PHYSICS, mutants.TASK, mutants.SIM, mutants.SHELLS, mutants.AGENTS):
        assert len(kind) >= 4


@pytest.mark.parametrize("fault", mutants.FAULTS, ids=NAMES)
def test_a_fault_can_be_planted(fault: Any) -> None:
    source = (ROOT / fault.file).read_text(encoding="utf-8")
    changed = mutants.planted(source, fault)
    assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(source))
    assert fault.compiled or fault.file.startswith("agents/") or len(changed.encode()) <= len(source.encode())
    files = [word for word in shlex.split(fault.tests) if word.startswith("tests/")]
    assert files
    assert all((ROOT / file).is_file() for file in files)


@pytest.mark.parametrize("text", ["no such text", "import"])
def test_a_text_that_does_not_stand_there_once_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"tiny: .* stands \d+ times in uwoc_gym/task/action.py; it must be once"):
        mutants.planted((ROOT / TINY.file).read_text(encoding="utf-8"), TINY._replace(text=text))


def test_a_copy_is_imported_whole(tmp_path: Path) -> None:
    folder = tmp_path / "tree"
    mutants.copy_tree(folder)
    code = (
        "import uwoc_gym.world, uwoc_gym.baselines, uwoc_gym.agents.errors as e; print(uwoc_gym.__file__, e.__file__)"
    )
    found = subprocess.check_output(
        [sys.executable, "-c", code], cwd=folder, text=True, env=mutants.surroundings(folder)
    )
    assert [Path(name).is_relative_to(folder) for name in found.split()] == [True, True]


@pytest.mark.parametrize(
    ("status", "output", "noticed_by"),
    [
        (
            1,
            "F\nFAILED tests/test_tiny.py::test_one[a b] - assert 1 == 2\nFAILED tests/test_tiny.py::test_two",
            "test_one[a b]",
        ),
        (0, "3 passed", ""),
        (2, "ERROR tests/test_tiny.py - ModuleNotFoundError: ...", ""),
        (None, "timed out after 600 seconds", ""),
    ],
    ids=["failed", "passed", "not run", "too long"],
)
def test_only_a_failed_test_has_noticed(
    status: int | None, output: str, noticed_by: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run_tests(folder: Path, tests: list[str], limit_s: float) -> tuple[int | None, str]:
        assert "-1.0), 2.0" in (folder / TINY.file).read_text(encoding="utf-8")
        assert tests == ["tests/test_tiny.py", "-x", "--deselect", "test_three"]
        return status, output

    monkeypatch.setattr(mutants, "run_tests", run_tests)
    verdict = mutants.try_fault(TINY, tmp_path / "tree", ["test_three"])
    assert verdict.noticed_by == (noticed_by and f"tests/test_tiny.py::{noticed_by}")
    share = "1 of 1 planted faults are noticed, 100 %." if noticed_by else "0 of 1 planted faults are noticed, 0 %."
    assert mutants.table([verdict]).endswith(share)
