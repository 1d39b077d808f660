"""What CONTRIBUTING.md and the hooks of pre-commit speak of is there, and CI runs what the hooks run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml")

ROOT = Path(__file__).parents[1]


def test_every_path_of_contributing_exists() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    paths = [each for each in re.findall(r"`([\w./-]+)`", prose) if "/" in each]
    assert len(paths) > 25
    assert [path for path in paths if not (ROOT / path).exists()] == []
    tests = re.findall(r"\btest_\w+\.py", text)
    assert [name for name in tests if not list((ROOT / "tests").rglob(name))] == []


def _hooks() -> dict[str, dict[str, Any]]:
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    return {hook["id"]: hook for repo in config["repos"] for hook in repo["hooks"]}


def test_hooks_run_what_ci_runs() -> None:
    run = (ROOT / ".ci/run").read_text(encoding="utf-8")
    hooks = _hooks()
    for name in ("ruff-check", "ruff-format"):
        _, _, command = hooks[name]["entry"].partition(" ")
        assert f'"$python" {command}\n' in run
    types = (ROOT / hooks["mypy"]["entry"]).read_text(encoding="utf-8")
    assert re.search(r"-m mypy --config-file .* -p uwoc_gym\n", run)
    assert re.search(r"-m mypy --config-file .* -p uwoc_gym\n", types)
    tests = [word for word in hooks["rules"]["entry"].split() if word.startswith("tests/")]
    assert {"tests/test_kernels.py", "tests/test_architecture.py"} <= set(tests)
    assert all((ROOT / test).is_file() for test in tests)


def test_hooks_need_no_network() -> None:
    for hook in _hooks().values():
        assert hook["language"] == "system"
        assert hook["entry"].startswith(".ci/")
