"""The one way this package compiles a function: Numba, float64, IEEE arithmetic, cached on disk."""

from __future__ import annotations

import gc
import sys
import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event as numba_event

# Without types that mypy could follow.
event: Any = numba_event

Function = TypeVar("Function", bound=Callable[..., Any])

# "numpy" division never raises, which is what lets LLVM vectorise; fast-math stays off so that results don't
# depend on how many simulations share a block.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "nogil": True}


class CacheState:
    """Whether Numba has found a folder that it can keep machine code in."""

    available = True


class Compiling(event.Listener):  # type: ignore[misc]
    """What surrounds the compilation of this package's functions.

    A person at a terminal is told, once, why nothing happens; and the garbage collector rests, since its search among
    the many objects of the compiler takes a fifth of the time and finds little.
    """

    def __init__(self) -> None:
        self._depth = 0
        self._collects = False
        self._silent = sys.stderr is None or not sys.stderr.isatty()

    def on_start(self, happening: Any) -> None:
        """Numba begins to compile something."""
        if not self._ours(happening):
            return
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        if not self._silent:
            self._silent = True
            print("uwoc_gym: compiling the simulation, once; later runs load it from a cache ...", file=sys.stderr)

    def on_end(self, happening: Any) -> None:
        """Numba has compiled it, or failed to."""
        if not self._ours(happening):
            return
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()

    def _ours(self, happening: Any) -> bool:
        return bool(happening.data["dispatcher"].py_func.__module__.startswith(__name__.partition(".")[0]))


event.register("numba:compile", Compiling())


@lru_cache(maxsize=1)
def _sources_stamp() -> tuple[tuple[str, int, int], ...]:
    """Name, time of change and size of each source file of this package."""
    folder = Path(__file__).parents[1]
    files = sorted(folder.rglob("*.py"))
    return tuple((str(file.relative_to(folder)), file.stat().st_mtime_ns, file.stat().st_size) for file in files)


def compiled(function: Function) -> Function:
    """Compile ``function`` on first use and keep the machine code in Numba's cache.

    Where no cache folder can be written, the function is compiled in memory instead and one warning says so.
    """
    if CacheState.available:
        try:
            dispatcher = numba.njit(cache=True, **_OPTIONS)(function)
        except RuntimeError as error:
            CacheState.available = False
            warnings.warn(
                f"Numba finds no folder to cache compiled code in ({error}); every process will compile anew. "
                "Set NUMBA_CACHE_DIR to a writable folder to avoid that.",
                RuntimeWarning,
                stacklevel=2,
            )
        else:
            # Numba dates cached code by the file of the function alone, though it holds inlined code of other files.
            index = dispatcher._cache._cache_file
            index._source_stamp = (index._source_stamp, _sources_stamp())
            return cast(Function, dispatcher)
    return cast(Function, numba.njit(**_OPTIONS)(function))


# What only other compiled code calls needs no way in from Python, which takes time to compile.
_INSIDE: dict[str, Any] = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "no_rewrites": True}


def inlined(function: Function) -> Function:
    """Compile a small function into its callers, so that their loops still vectorise."""
    return cast(Function, numba.njit(forceinline=True, **_INSIDE)(function))


def pasted(function: Function) -> Function:
    """Paste a list of calls into its callers before they are typed.

    For what is called once or twice and loops over lanes: LLVM meets such a loop where its bounds are known, and only
    there. What is called more often is typed each time, and better `inlined`.
    """
    return cast(Function, numba.njit(inline="always", **_INSIDE)(function))


def subroutine(function: Function) -> Function:
    """Compile a large function that other compiled code calls; the compiler decides whether to inline it."""
    return cast(Function, numba.njit(**_INSIDE)(function))


def over_arrays(function: Callable[..., Any]) -> Callable[..., Any]:
    """The scalar equation ``function``, plain or `inlined`, as a NumPy ufunc that is compiled on first use."""
    vectorize: Any = cast(Any, numba).vectorize(cache=CacheState.available)
    ufunc: Callable[..., Any] = vectorize(getattr(function, "py_func", function))
    return ufunc
