"""Compilation and its cache."""

import gc
import os
import pickle
import subprocess
import sys

import gymnasium as gym
import numba
import numpy as np
import pytest
from numba.core import event

import uwoc_gym
from tests.trust import caches
from uwoc_gym.sim import paper


@pytest.fixture
def toy(tmp_path):
    """A package with this package's `compiled`, an equation in a room of its own, and two functions of it."""
    caches.make_toy(tmp_path)

    def result(before=""):
        """What both functions give, how often the first came from the cache, and the warnings."""
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
        code = (
            f"{before}\nfrom toy.main import run, run_over\n"
            "print(run(1.0), run_over(1.0), sum(run.stats.cache_hits.values()))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True, timeout=120
        )
        return (*done.stdout.split(), done.stderr.count("RuntimeWarning"))

    return result


@pytest.mark.parametrize("edited", ["rooms/equation.py", "main.py"])
def test_an_edit_anywhere_in_the_package_is_compiled(toy, tmp_path, edited):
    assert toy() == ("12.0", "12.0", "0", 0)
    assert toy() == ("12.0", "12.0", "1", 0)
    path = tmp_path / "toy" / edited
    path.write_text(path.read_text().replace("2.0 *", "3.0 *").replace("10.0 +", "100.0 +"))
    assert toy()[:2] in (("13.0", "13.0"), ("102.0", "102.0"))


def test_compiles_in_memory_with_one_warning_where_no_folder_is_found(toy):
    nowhere = "from numba.core import caching; caching.CacheImpl._locator_classes = []"
    assert toy(nowhere) == ("12.0", "12.0", "0", 1)


def test_this_package_is_imported_where_no_folder_is_found():
    code = "from numba.core import caching; caching.CacheImpl._locator_classes = []; import uwoc_gym"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stderr.count("RuntimeWarning") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", [caches.truncated, caches.flipped, lambda data: b"", lambda data: b"nonsense"])
def test_a_damaged_cache_is_replaced_with_one_warning(toy, tmp_path, suffix, damage):
    toy()
    for path in (tmp_path / "cache").rglob(f"*{suffix}"):
        path.write_bytes(damage(path.read_bytes()))
    assert toy() == ("12.0", "12.0", "0", 1)
    assert toy() == ("12.0", "12.0", "1", 0)


def test_a_full_disk_costs_a_warning(toy):
    resource = pytest.importorskip("resource")
    full = f"import resource; resource.setrlimit({resource.RLIMIT_FSIZE}, (64, 64))"
    assert toy(full) == ("12.0", "12.0", "0", 1)
    assert toy() == ("12.0", "12.0", "0", 0)


def test_importing_compiles_nothing():
    code = (
        "import uwoc_gym; from uwoc_gym.sim import paper; "
        "made = [name for name, each in vars(paper).items() if getattr(each, 'signatures', 0)]; assert not made"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


@pytest.mark.parametrize("terminal", [True, False])
def test_a_person_at_a_terminal_is_told_once_that_it_compiles(tmp_path, terminal):
    (tmp_path / "sitecustomize.py").write_text(f"import sys\nsys.stderr.isatty = lambda: {terminal}\n")
    code = (
        "import numpy as np; from uwoc_gym import PaperPath, Vehicle; PaperPath().at(np.zeros(2)); PaperPath().at(0.0)"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    for first in (True, False):
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert done.stderr.count("uwoc_gym: compiling the simulation, once") == (terminal and first)


def test_a_copy_in_another_process_compiles_for_the_usual_array(tmp_path):
    env = gym.make("uwoc/Nominal-v0").unwrapped
    env.reset(seed=0)
    (tmp_path / "env.pkl").write_bytes(pickle.dumps(env))
    code = (
        f"import pickle; env = pickle.load(open({str(tmp_path / 'env.pkl')!r}, 'rb')); env.step([0, 0, 0]); "
        "from uwoc_gym.sim.paper import step_one; assert len(step_one.signatures) == 1"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_no_array_makes_a_step_compile_again():
    env, vector = gym.make("uwoc/Nominal-v0").unwrapped, uwoc_gym.TrackingVectorEnv(4)
    for each in (env, vector):
        each.reset(seed=0)
        each.step(np.zeros(each.action_space.shape, np.float32))

    def compiled():
        return [len(each.signatures) for each in (paper.step_one, paper.step, paper.reset)]

    before = compiled()
    env.reset(seed=0)
    fixed = np.zeros(3, np.float32)
    fixed.flags.writeable = False
    for action in (np.zeros(3, np.float32), fixed, np.zeros(3), [0, 0, 0], np.zeros((6,), np.float32)[::2]):
        env.step(action)
    env.reset(options={"pose": (1.0, 2.0, 3.0), "velocity": (0, 0, 0)})
    vector.reset(seed=0)
    several = np.zeros((4, 3), np.float32)
    several.flags.writeable = False
    for actions in (np.zeros((4, 3), np.float32), several, np.zeros((4, 3)), np.zeros((8, 3), np.float32)[::2]):
        vector.step(actions)
    vector.reset(options={"pose": (0, 0, 0), "parameters": {"vehicle.mass_scale": 1.0}})
    assert compiled() == before


@pytest.mark.parametrize("wanted", [True, False])
def test_the_garbage_collector_rests_while_it_compiles_and_then_is_as_before(wanted):
    during = []

    class Watch(event.Listener):
        def on_start(self, happening):
            during.append(gc.isenabled())

        def on_end(self, happening):
            pass

    def double(x):
        return 2 * x

    double.__module__ = "uwoc_gym.toy"
    before = gc.isenabled()
    try:
        (gc.enable if wanted else gc.disable)()
        with event.install_listener("numba:run_pass", Watch()):
            assert numba.njit(double)(3) == 6
        assert gc.isenabled() == wanted
    finally:
        (gc.enable if before else gc.disable)()
    assert during
    assert not any(during)
