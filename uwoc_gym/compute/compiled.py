"""The one way this package compiles a function: Numba, float64, IEEE arithmetic, cached on disk."""

from __future__ import annotations

import gc
import hashlib
import pickle
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import caching as numba_caching
from numba.core import event as numba_event
from numba.core import serialize as numba_serialize
from numba.extending import register_jitable as numba_register_jitable

# Without types that mypy could follow.
event: Any = numba_event
caching: Any = numba_caching
serialize: Any = numba_serialize
register_jitable: Any = numba_register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])

# "numpy" division never raises, which is what lets LLVM vectorise; fast-math stays off so that results don't
# depend on how many simulations share a block.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "nogil": True}


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


@cache
def _warn_once(problem: str) -> None:
    """Say what is wrong with the cache, which costs time only."""
    advice = "set NUMBA_CACHE_DIR to a folder that can be written to, or every process compiles anew"
    warnings.warn(f"{problem}; {advice}.", RuntimeWarning, stacklevel=2)


class _Sealed(caching.CompileResultCacheImpl):  # type: ignore[misc]
    """Machine code with its digest, without which a damaged file would be run."""

    def reduce(self, result: Any) -> tuple[str, bytes]:
        code = serialize.dumps(super().reduce(result))
        return hashlib.sha256(code).hexdigest(), code

    def rebuild(self, target_context: Any, payload: tuple[str, bytes]) -> Any:
        digest, code = payload
        if hashlib.sha256(code).hexdigest() != digest:
            raise ValueError("its digest is another")
        return super().rebuild(target_context, pickle.loads(code))


class _Cache(caching.FunctionCache):  # type: ignore[misc]
    """Numba's cache, which is never a reason to stop: what it can't read or write is compiled instead."""

    _impl_class = _Sealed

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        # Numba dates cached code by the file of the function alone, though it holds inlined code of other files.
        self._cache_file._source_stamp = (self._cache_file._source_stamp, _sources_stamp())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            # Reading damaged bytes can raise anything.
            _warn_once(f"the cache of compiled code in {self.cache_path} is damaged and is written anew")
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _warn_once(f"the cache of compiled code in {self.cache_path} can't be written: {error.strerror}")


def _cached(dispatcher: Any, attribute: str) -> None:
    """Keep what ``dispatcher`` compiles on disk, or say once that there is no folder for it."""
    try:
        setattr(dispatcher, attribute, _Cache(dispatcher.py_func))
    except RuntimeError:
        _warn_once("Numba finds no folder to cache compiled code in")


def compiled(function: Function) -> Function:
    """Compile ``function`` on first use and keep the machine code in Numba's cache.

    Where it can't be read or written, the function is compiled in memory instead and one warning says so.
    """
    dispatcher: Any = numba.njit(**_OPTIONS)(function)
    _cached(dispatcher, "_cache")
    return cast(Function, dispatcher)


# What only other compiled code calls needs no way in from Python, which takes time to compile.
_INSIDE: dict[str, Any] = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "no_rewrites": True}


def inlined(function: Function) -> Function:
    """Compile a small function into its callers, so that their loops still vectorise."""
    return cast(Function, numba.njit(forceinline=True, **_INSIDE)(function))


def equation(function: Function) -> Function:
    """An equation of scalars that compiled code can call, and that stays an ordinary Python function."""
    return cast(Function, register_jitable(forceinline=True, **_INSIDE)(function))


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
    """The scalar equation ``function``, an `equation` or `inlined`, as a NumPy ufunc that is compiled on first use."""
    vectorize: Any = cast(Any, numba).vectorize()
    ufunc: Any = vectorize(getattr(function, "py_func", function))
    _cached(ufunc._dispatcher, "cache")
    return cast(Callable[..., Any], ufunc)
