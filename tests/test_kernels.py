"""The rules of a kernel function, which keep it readable, vectorised, and fit for a GPU.

One lane at a time; no NumPy on scalars, no local arrays, no slices; a lane never looks at another.
"""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import pytest

import uwoc_gym

PACKAGE = Path(inspect.getfile(uwoc_gym)).parent
ORDER_OF_EVENTS = {"paper.py"}
"""Here the loops over lanes stand."""
WORDS = {"uint64"}
"""The one thing of NumPy that has no other name in compiled code: the words of Philox."""


def kernel_functions(tree: ast.Module) -> list[ast.FunctionDef]:
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any(isinstance(each, ast.Name) and each.id == "inlined" for each in node.decorator_list)
    ]


def broken_rules(function: ast.FunctionDef) -> list[str]:
    """What a kernel function does that it must not, in words."""
    found = []
    arguments = [each.arg for each in function.args.args]
    if "b" in arguments and arguments[:2] != ["b", "j"]:
        found.append(f"takes {arguments[:2]} first instead of the block b and the lane j")
    if "lanes" in arguments:
        found.append("takes lanes: the loop over them is the caller's")
    # Names for parts of the block, as in `p = b.drawn.link`.
    parts = {"b"}
    for node in ast.walk(function):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                targets = target.elts if isinstance(target, ast.Tuple) else [target]
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                for name, part in zip(targets, values, strict=False):
                    if isinstance(name, ast.Name) and isinstance(part, ast.Attribute) and root(part) in parts:
                        parts.add(name.id)
    for node in ast.walk(function):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("np", "numpy"):
            if node.attr not in WORDS:
                found.append(f"line {node.lineno}: np.{node.attr}")
        elif isinstance(node, ast.Slice):
            found.append(f"line {node.lineno}: a slice")
        elif isinstance(node, (ast.List, ast.ListComp, ast.Dict, ast.Set)):
            found.append(f"line {node.lineno}: a container")
        elif isinstance(node, ast.Subscript) and root(node.value) in parts:
            lane = node.slice.elts[-1] if isinstance(node.slice, ast.Tuple) else node.slice
            if not (isinstance(lane, ast.Name) and lane.id == "j") and not is_shape(node):
                found.append(f"line {node.lineno}: another lane than j")
        elif isinstance(node, ast.For) and isinstance(node.target, ast.Name) and node.target.id == "j":
            found.append(f"line {node.lineno}: a loop over lanes")
    return found


def is_shape(node: ast.Subscript) -> bool:
    return isinstance(node.value, ast.Attribute) and node.value.attr == "shape"


def root(node: ast.expr) -> str | None:
    while isinstance(node, ast.Attribute):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


FILES = sorted(path for path in PACKAGE.rglob("*.py") if path.name not in ORDER_OF_EVENTS)


def test_there_are_kernel_functions():
    assert sum(len(kernel_functions(ast.parse(path.read_text()))) for path in FILES) > 40


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_kernel_functions_keep_the_rules(path):
    for function in kernel_functions(ast.parse(path.read_text())):
        assert not broken_rules(function), function.name


@pytest.mark.parametrize(
    "body",
    [
        "def f(b, j):\n    b.auv.x[j] = np.sin(b.auv.y[j])",
        "def f(b, j):\n    b.auv.x[j] = b.auv.x[0]",
        "def f(b, j):\n    p = b.drawn.link\n    b.auv.x[j] = p.power_w[j + 1]",
        "def f(b, j):\n    b.auv.all[j, 2] = 0.0",
        "def f(b, j):\n    v = [0.0, 1.0]",
        "def f(b, j):\n    v = b.auv.x[:4]",
        "def f(b, lanes):\n    b.auv.x[0] = 0.0",
        "def f(s, b, j):\n    b.auv.x[j] = 0.0",
        "def f(b, world):\n    for j in range(32):\n        b.auv.x[j] = 0.0",
    ],
)
def test_what_breaks_them_is_found(body):
    (function,) = kernel_functions(ast.parse("@inlined\n" + body))
    assert broken_rules(function)
