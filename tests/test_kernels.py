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
ORDER_OF_EVENTS = {PACKAGE / "sim/paper.py"}
"""Here the loops over lanes stand."""
WORDS = {"uint64"}
"""The one thing of NumPy that has no other name in compiled code: the words of Philox."""
COMPILERS = {"inlined", "subroutine", "pasted"}
"""What makes a function part of compiled code."""
NUMBERS = {"numbers", "splines"}
"""Arguments that are plain arrays, of which a lane may read any place."""
ALL_LANES = {"lanes", "LANES", "32"}
"""How often a loop over lanes runs."""


def kernel_functions(tree: ast.Module) -> list[ast.FunctionDef]:
    """Functions that are compiled, by a decorator or by a call, as in ``f = inlined(g)``."""
    called = {
        each.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and root(node.func) in COMPILERS
        for each in node.args
        if isinstance(each, ast.Name)
    }
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and (node.name in called or any(root(each) in COMPILERS for each in node.decorator_list))
    ]


def broken_rules(function: ast.FunctionDef) -> list[str]:
    """What a kernel function does that it must not, in words."""
    found = []
    arguments = [each.arg for each in function.args.args]
    if "b" in arguments and arguments[:2] != ["b", "j"]:
        found.append(f"takes {arguments[:2]} first instead of the block b and the lane j")
    if "lanes" in arguments:
        found.append("takes lanes: the loop over them is the caller's")
    # Without annotations.
    nodes = [node for statement in function.body for node in ast.walk(statement)]
    written = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    if "j" in written:
        found.append("writes j: the lane is the caller's")
    free = NUMBERS & set(arguments) - written
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("np", "numpy"):
            if node.attr not in WORDS:
                found.append(f"line {node.lineno}: np.{node.attr}")
        elif isinstance(node, ast.Slice):
            found.append(f"line {node.lineno}: a slice")
        elif isinstance(node, (ast.List, ast.ListComp, ast.Dict, ast.Set)):
            found.append(f"line {node.lineno}: a container")
        elif isinstance(node, ast.Subscript) and not in_the_lane(node, arguments, free):
            found.append(f"line {node.lineno}: {ast.unparse(node)} is of another lane than j")
        elif isinstance(node, ast.For) and ALL_LANES & {ast.unparse(each) for each in ast.walk(node.iter)}:
            found.append(f"line {node.lineno}: a loop over lanes")
    return found


def in_the_lane(node: ast.Subscript, arguments: list[str], free: set[str]) -> bool:
    """Whether a subscript ends in j; without a block, whether it picks one of a few numbers that it was given."""
    if is_shape(node) or (isinstance(node.value, ast.Name) and node.value.id in free):
        return True
    if "b" not in arguments:
        return isinstance(node.slice, ast.Constant)
    lane = node.slice.elts[-1] if isinstance(node.slice, ast.Tuple) else node.slice
    return isinstance(lane, ast.Name) and lane.id == "j"


def is_shape(node: ast.Subscript) -> bool:
    return isinstance(node.value, ast.Attribute) and node.value.attr == "shape"


def root(node: ast.expr) -> str | None:
    while isinstance(node, (ast.Attribute, ast.Call)):
        node = node.value if isinstance(node, ast.Attribute) else node.func
    return node.id if isinstance(node, ast.Name) else None


FILES = sorted(path for path in PACKAGE.rglob("*.py") if path not in ORDER_OF_EVENTS)


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
        "def f(b, j):\n    q = b.auv\n    r = q\n    r.x[j] = r.x[0]",
        "def f(b, j):\n    b.auv.all[j, 2] = 0.0",
        "def f(b, j, pulse):\n    b.auv.x[j] = pulse.start_s[0]",
        "def f(b, j, s):\n    pulse = record_at(s, 0, PULSE)\n    b.auv.x[j] = pulse.start_s[j + 1]",
        "def f(b, j):\n    for i in range(32):\n        b.auv.x[i] = 0.0",
        "def f(x):\n    for i in range(LANES):\n        g(x, i)",
        "def f(x, i):\n    x[i] = 0.0",
        "def f(b, j):\n    numbers = b.auv.x\n    numbers[0] = 0.0",
        "def f(b, j):\n    j = j + 1\n    b.auv.x[j] = 0.0",
        "def f(b, j):\n    v = [0.0, 1.0]",
        "def f(b, j):\n    v = b.auv.x[:4]",
        "def f(b, lanes):\n    b.auv.x[0] = 0.0",
        "def f(s, b, j):\n    b.auv.x[j] = 0.0",
        "def f(b, world):\n    for j in range(32):\n        b.auv.x[j] = 0.0",
    ],
)
@pytest.mark.parametrize("compiler", ["@inlined\n{}", "@subroutine\n{}", "@pasted\n{}", "{}\ng = inlined(f)"])
def test_what_breaks_them_is_found(body, compiler):
    (function,) = kernel_functions(ast.parse(compiler.format(body)))
    assert broken_rules(function)


def test_what_keeps_them_is_left_alone():
    kept = (
        "@inlined\ndef f(b, j, numbers, place):\n    q = b.auv\n    for k in range(q.all.shape[0]):\n"
        "        q.all[k, j] = q.x[j] * numbers[3 * place]\n\n@inlined\ndef cubic(c):\n    return c[0] + c[1]"
    )
    assert [broken_rules(function) for function in kernel_functions(ast.parse(kept))] == [[], []]
