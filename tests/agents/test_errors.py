"""What isn't installed is said in one line, whatever it is."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from uwoc_gym.agents.errors import EXTRAS, CommandError, require
from uwoc_gym.agents.policies.algorithms import ALGORITHMS

AGENTS = Path(__file__).parents[2] / "agents"


def _required() -> set[str]:
    """The modules that commands ask for by name."""
    calls = [
        node
        for path in AGENTS.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "require"
    ]
    return {
        each.value
        for call in calls
        for argument in call.args
        for each in ast.walk(argument)
        if isinstance(each, ast.Constant) and isinstance(each.value, str)
    }


def test_every_module_that_is_asked_for_has_an_extra() -> None:
    required = _required() | {each.module for each in ALGORITHMS.values()}
    assert {"torch", "tqdm"} < required
    assert required <= set(EXTRAS)


def test_what_isnt_installed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(CommandError, match=r'torch is not installed; run: pip install "uwoc-gym\[agents\]"'):
        require("torch")
