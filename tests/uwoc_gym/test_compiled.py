"""Compilation and its cache."""

import subprocess
import sys
import warnings

import numba
import pytest

from uwoc_gym import compiled


def test_cached_code_is_dated_by_every_source_file():
    function = compiled.compiled(_double)
    assert function._cache._cache_file._source_stamp[1] == compiled._sources_stamp()
    assert {"fleet.py", "vehicle.py"} <= {name for name, *_ in compiled._sources_stamp()}


def _double(x):
    return 2 * x


def test_compiles_in_memory_with_one_warning_where_nothing_can_be_cached(monkeypatch):
    real = numba.njit

    def without_cache(*arguments, cache=False, **options):
        if cache:
            return lambda function: (_ for _ in ()).throw(RuntimeError("cannot cache"))
        return real(*arguments, **options)

    monkeypatch.setattr(compiled.numba, "njit", without_cache)
    monkeypatch.setattr(compiled._CacheState, "available", True)
    with pytest.warns(RuntimeWarning, match="NUMBA_CACHE_DIR"):
        function = compiled.compiled(_double)
    assert function(3) == 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compiled.compiled(_double)(4) == 8


def test_importing_compiles_nothing():
    code = (
        "import uwoc_gym.fleet as fleet; "
        "assert not fleet._step.signatures and not fleet._reset.signatures, fleet._step.signatures"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
