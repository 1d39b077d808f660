"""Compilation and its cache."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import numba
import pytest

import uwoc_gym
from uwoc_gym.compute import compiled


@pytest.mark.parametrize("edited", ["rooms/equation.py", "main.py"])
def test_an_edit_anywhere_in_the_package_is_compiled(tmp_path, edited):
    """A package with this package's `compiled` and an equation in a room of its own, which then changes."""
    own = Path(compiled.__file__).relative_to(Path(uwoc_gym.__file__).parent)
    inside = f"toy.{own.with_suffix('').as_posix().replace('/', '.')}"
    files = {
        own.as_posix(): Path(compiled.__file__).read_text(),
        "rooms/equation.py": f"from {inside} import inlined\n@inlined\ndef times(x):\n    return 2.0 * x\n",
        "main.py": f"from {inside} import compiled\nfrom toy.rooms.equation import times\n"
        "@compiled\ndef run(x):\n    return 10.0 + times(x)\n",
    }
    for name, text in files.items():
        path = tmp_path / "toy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def result():
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
        code = "from toy.main import run; print(run(1.0), sum(run.stats.cache_hits.values()))"
        return subprocess.check_output([sys.executable, "-c", code], env=environment, text=True).split()

    assert result() == ["12.0", "0"]
    assert result() == ["12.0", "1"]
    path = tmp_path / "toy" / edited
    path.write_text(path.read_text().replace("2.0 *", "3.0 *").replace("10.0 +", "100.0 +"))
    assert result()[0] in ("13.0", "102.0")


def _double(x):
    return 2 * x


def test_compiles_in_memory_with_one_warning_where_nothing_can_be_cached(monkeypatch):
    real = numba.njit

    def without_cache(*arguments, cache=False, **options):
        if cache:
            return lambda function: (_ for _ in ()).throw(RuntimeError("cannot cache"))
        return real(*arguments, **options)

    monkeypatch.setattr(compiled.numba, "njit", without_cache)
    monkeypatch.setattr(compiled.CacheState, "available", True)
    with pytest.warns(RuntimeWarning, match="NUMBA_CACHE_DIR"):
        function = compiled.compiled(_double)
    assert function(3) == 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compiled.compiled(_double)(4) == 8


def test_importing_compiles_nothing():
    code = (
        "import uwoc_gym; from uwoc_gym.sim import paper; "
        "made = [name for name, each in vars(paper).items() if getattr(each, 'signatures', 0)]; assert not made"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
