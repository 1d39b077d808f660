"""Kernel functions compile for a GPU as well, which needs numba-cuda with its toolkit (numba-cuda[cu13]) but no GPU."""

from __future__ import annotations

import inspect
from types import SimpleNamespace

import numba
import pytest

from uwoc_gym.compute.records import View
from uwoc_gym.sim import layout
from uwoc_gym.sim.layout import BLOCK, WORLD
from uwoc_gym.task import observation, reward
from uwoc_gym.world.auv import start
from uwoc_gym.world.sea import pulses

pytest.importorskip("numba_cuda", reason='needs pip install "numba-cuda[cu13]"')
cuda = pytest.importorskip("numba.cuda")

COMPUTE_CAPABILITY = (9, 0)
MODULES = {*layout.MODULES.values(), observation, pulses, reward, start}
"""Every effect, and what has kernel functions besides."""
TYPES = {
    "b": View(BLOCK),
    "j": numba.int64,
    "world": View(WORLD),
    "pulse": View(pulses.PULSE),
    "numbers": numba.float64[::1],
    "splines": numba.float64[::1],
    **dict.fromkeys(("first", "last", "place"), numba.int64),
}
FUNCTIONS = {
    f"{module.__name__.rpartition('.')[2]}.{name}": each.py_func
    for module in sorted(MODULES, key=lambda module: module.__name__)
    for name, each in vars(module).items()
    if hasattr(each, "py_func") and each.py_func.__module__ == module.__name__
    if list(inspect.signature(each.py_func).parameters)[:2] == ["b", "j"] and not name.startswith("_")
}


def test_every_effect_has_functions_to_compile():
    assert {name.partition(".")[0] for name in FUNCTIONS} == {each.__name__.rpartition(".")[2] for each in MODULES}
    assert len(FUNCTIONS) > 30


@pytest.mark.parametrize("name", FUNCTIONS)
def test_compiles_to_ptx(name, monkeypatch):
    # Functions that are called are compiled for the present device, for which this stands in.
    device = SimpleNamespace(compute_capability=COMPUTE_CAPABILITY)
    monkeypatch.setattr("numba.cuda.dispatcher.get_current_device", lambda: device)
    function = FUNCTIONS[name]
    arguments = tuple(TYPES.get(each, numba.float64) for each in inspect.signature(function).parameters)
    ptx, _ = cuda.compile_ptx(function, arguments, device=True, cc=COMPUTE_CAPABILITY)
    assert ".target sm_90" in ptx
    # A call into the CPU's libraries would be left over as an external function.
    assert ".extern .func" not in ptx
