"""The house: which way imports run, and that no module reaches for what another keeps to itself."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {"uwoc_gym": "uwoc_gym", "baselines": "uwoc_gym.baselines", "agents": "uwoc_gym.agents"}
"""Folder and name of each package."""

FLOORS = (
    ("uwoc_gym.given",),
    ("uwoc_gym.parameters", "uwoc_gym.compute"),
    ("uwoc_gym.world", "uwoc_gym.task"),
    ("uwoc_gym.scenario",),
    ("uwoc_gym.scenarios",),
    ("uwoc_gym.sim", "uwoc_gym.metrics"),
    ("uwoc_gym.spaces", "uwoc_gym.registry"),
    ("uwoc_gym.env", "uwoc_gym.vector_env", "uwoc_gym.rendering"),
    ("uwoc_gym.wrapping",),
    ("uwoc_gym.sb3", "uwoc_gym"),
    ("uwoc_gym.baselines",),
    ("uwoc_gym.agents.errors", "uwoc_gym.agents.interrupts", "uwoc_gym.agents.modules"),
    ("uwoc_gym.agents.places",),
    ("uwoc_gym.agents.scenarios", "uwoc_gym.agents.work", "uwoc_gym.agents.wrapping"),
    ("uwoc_gym.agents.policies",),
    ("uwoc_gym.agents.flight",),
    ("uwoc_gym.agents.reports",),
    ("uwoc_gym.agents.learning", "uwoc_gym.agents.viewing", "uwoc_gym.agents.cluster"),
    ("uwoc_gym.agents.options",),
    ("uwoc_gym.agents.commands",),
    ("uwoc_gym.agents.cli", "uwoc_gym.agents"),
)
"""From the ground up; rooms of one floor don't know each other. `uwoc_gym.agents` itself is load() alone."""

TUPLES = {"_asdict", "_replace", "_fields", "_make"}
"""What named tuples give everybody, in spite of its name."""


def _name(path: Path) -> str:
    folder, *rest = path.relative_to(ROOT).with_suffix("").parts
    return ".".join([PACKAGES[folder], *(part for part in rest if part != "__init__")])


MODULES = {_name(path): path for folder in PACKAGES for path in sorted((ROOT / folder).rglob("*.py"))}


def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _imports(tree: ast.AST) -> Iterator[str]:
    """The modules of this project that a file imports, at its top or later."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            if not all(name in MODULES for name in names) and node.module in MODULES:
                yield node.module
            yield from (name for name in names if name in MODULES)


def _room(module: str) -> tuple[int, str]:
    """Floor and name of the room that a module stands in."""
    # What stands nowhere in agents doesn't fall through to the ground floor.
    packages = ("uwoc_gym", "uwoc_gym.agents")
    fitting = [
        (len(room), floor, room)
        for floor, rooms in enumerate(FLOORS)
        for room in rooms
        if module == room or (module.startswith(f"{room}.") and room not in packages)
    ]
    assert fitting, f"{module} stands in no room"
    _, floor, room = max(fitting)
    return floor, room


@pytest.mark.parametrize("module", MODULES)
def test_imports_run_downwards(module: str) -> None:
    floor, room = _room(module)
    for imported in _imports(_tree(MODULES[module])):
        below, other = _room(imported)
        assert below < floor or other == room, f"{module} imports {imported}"


def test_nothing_imports_in_a_circle() -> None:
    graph = {module: set(_imports(_tree(path))) - {module} for module, path in MODULES.items()}
    while True:
        leaves = {module for module, needed in graph.items() if not needed & graph.keys()}
        if not leaves:
            break
        graph = {module: needed for module, needed in graph.items() if module not in leaves}
    assert not graph, f"imports in a circle among {', '.join(sorted(graph))}"


def _private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__") and name not in TUPLES


def _reaches(tree: ast.Module) -> Iterator[str]:
    """Private names that a file takes from elsewhere: those that it doesn't define itself."""
    own = {
        name
        for node in ast.walk(tree)
        for name in (
            [node.name]
            if isinstance(node, (ast.FunctionDef, ast.ClassDef))
            else [node.id]
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
            else [node.attr]
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self"
            else []
        )
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names if _private(alias.name))
        elif isinstance(node, ast.Attribute) and _private(node.attr) and node.attr not in own:
            yield ast.unparse(node)


READERS = [path for folder in (*PACKAGES, "tests") for path in sorted((ROOT / folder).rglob("*.py"))]


@pytest.mark.parametrize("path", READERS, ids=lambda path: str(path.relative_to(ROOT)))
def test_nobody_reaches_for_what_another_keeps_to_itself(path: Path) -> None:
    # Numba has no public way to date cached code by other files than the function's own.
    allowed = ("self._cache_file", "ufunc._dispatcher") if path.name == "compiled.py" else ()
    assert [each for each in _reaches(_tree(path)) if not each.startswith(allowed)] == []


def test_the_rules_see_what_they_forbid() -> None:
    told = "from a import _b\nimport c\nc._d\nx = c.e()\nx._f\nx._asdict()\nself._g = 1\nx._g\nc.__doc__\n"
    assert list(_reaches(ast.parse(told))) == ["a._b", "c._d", "x._f"]
    lazy = "def f():\n    from uwoc_gym.agents.learning import training\n    import uwoc_gym.agents.cli\n"
    assert set(_imports(ast.parse(lazy))) == {"uwoc_gym.agents.learning.training", "uwoc_gym.agents.cli"}
    assert _room("uwoc_gym.agents.learning.training")[0] > _room("uwoc_gym.agents.flight")[0] > _room("uwoc_gym.env")[0]
    with pytest.raises(AssertionError, match="no room"):
        _room("uwoc_gym.agents.attic")


def test_every_command_has_a_file_of_its_name() -> None:
    from uwoc_gym.agents.cli import COMMANDS

    files = {path.stem for path in (ROOT / "agents/commands").glob("*.py")} - {"__init__"}
    assert files == set(COMMANDS)
