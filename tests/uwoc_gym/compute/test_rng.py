from __future__ import annotations

import inspect
import re
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy import stats

import uwoc_gym
from uwoc_gym import SCENARIOS, Vehicle
from uwoc_gym.compute import rng
from uwoc_gym.compute.records import block_type
from uwoc_gym.parameters import Parameters, number
from uwoc_gym.sim.layout import MODULES, drawn_numbers, numbers_of

KEY = (123456789.0, 4000000000.0)
COUNT = 40_000


@numba.njit
def words(key0, key1, c0, c1, c2, c3):
    return rng.philox(np.uint64(key0), np.uint64(key1), np.uint64(c0), np.uint64(c1), np.uint64(c2), np.uint64(c3))


BLOCK = block_type({"random": rng.STATE})


@numba.njit
def draw_many(state, stream, count, index):
    b = state.view(BLOCK)[0]
    out = np.empty((4, count))
    for step in range(count):
        out[0, step], out[1, step], out[2, step], out[3, step] = rng.draw(b, 5, stream, float(step), index)
    return out


def draws(key0, key1, episode, stream, count, index):
    state = np.zeros(BLOCK.itemsize // 8)
    random = state.view(BLOCK)[0]["random"]
    random["key_0"][5], random["key_1"][5], random["episode"][5] = key0, key1, episode
    return draw_many(state, float(stream), count, float(index))


@numba.njit
def normals(uniform):
    out = np.empty((4, uniform.shape[1]))
    for i in range(uniform.shape[1]):
        out[0, i], out[1, i] = rng.normal_pair(uniform[0, i], uniform[1, i])
        out[2, i], out[3, i] = rng.normal_pair(uniform[2, i], uniform[3, i])
    return out


ALL = 0xFFFFFFFF


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((ALL, ALL, ALL, ALL), (ALL, ALL), (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_known_answers_of_random123(counter, key, expected):
    assert tuple(int(word) for word in words(*key, *counter)) == expected


def test_uniforms_are_scaled_words():
    # Counter: step, episode, stream, block.
    expected = [(int(word) + 0.5) / 2.0**32 for word in words(5, 7, 0, 3, 4, 2)]
    np.testing.assert_array_equal(draws(5.0, 7.0, 3.0, 4, 1, 2)[:, 0], expected)


def test_uniforms_lie_inside_the_interval():
    uniform = draws(*KEY, 0.0, 1, COUNT, 0)
    assert uniform.min() > 0.0
    assert uniform.max() < 1.0


@pytest.mark.parametrize("column", range(4))
def test_uniforms_are_uniform(column):
    assert stats.kstest(draws(*KEY, 0.0, 1, COUNT, 0)[column], "uniform").pvalue > 0.01


@pytest.mark.parametrize("column", range(4))
def test_normals_are_normal(column):
    assert stats.kstest(normals(draws(*KEY, 0.0, 2, COUNT, 0))[column], "norm").pvalue > 0.01


def test_normal_moments():
    z = normals(draws(*KEY, 1.0, 3, COUNT, 0)).ravel()
    error = z.size**-0.5
    assert abs(z.mean()) < 4 * error
    assert abs(z.var() - 1.0) < 4 * error * 2**0.5
    assert abs(stats.skew(z)) < 4 * error * 6**0.5
    assert abs(stats.kurtosis(z)) < 4 * error * 24**0.5


def test_normal_pair_is_box_and_muller():
    radius, angle = (-2.0 * np.log(0.3)) ** 0.5, 2.0 * np.pi * 0.8
    got = normals(np.array([[0.3], [0.8], [0.3], [0.8]]))[:2, 0]
    np.testing.assert_allclose(got, [radius * np.cos(angle), radius * np.sin(angle)], rtol=1e-14)


BASE = (*KEY, 2.0, 3, 1)


@pytest.mark.parametrize(
    "changed",
    [
        (KEY[0] + 1.0, KEY[1], 2.0, 3, 1),
        (KEY[0], KEY[1] + 1.0, 2.0, 3, 1),
        (*KEY, 3.0, 3, 1),
        (*KEY, 2.0, 4, 1),
        (*KEY, 2.0, 3, 2),
    ],
    ids=["key 0", "key 1", "episode", "stream", "block"],
)
def test_streams_are_independent(changed):
    def stream(key0, key1, episode, number, block):
        return draws(key0, key1, episode, number, COUNT, block)

    together = np.concatenate([stream(*BASE), stream(*changed)])
    correlation = np.corrcoef(together) - np.eye(8)
    assert np.abs(correlation).max() < 4.5 * COUNT**-0.5
    # Neighbouring steps of one stream as well.
    one = together[4:]
    assert np.abs(np.corrcoef(one[:, 1:], one[:, :-1])[:4, 4:]).max() < 4.5 * COUNT**-0.5


STREAMS = {name: module.STREAM for name, module in {"random": rng, **MODULES}.items() if hasattr(module, "STREAM")}


def test_streams_have_their_own_numbers():
    assert len(set(STREAMS.values())) == len(STREAMS)
    # Those of v0 stay as they are.
    assert {"random": 1.0, "ship": 2.0, "current": 3.0, "sensors": 4.0}.items() <= STREAMS.items()


def test_every_file_with_a_stream_is_among_them():
    package = Path(inspect.getfile(uwoc_gym)).parent
    found = [path for path in package.rglob("*.py") if re.search(r"^STREAM\b", path.read_text(), re.MULTILINE)]
    assert len(found) == len(STREAMS)


@pytest.mark.parametrize("name", [name for name in STREAMS if name != "random"])
def test_settings_of_an_effect_with_a_stream_say_when_it_is_random(name):
    module = MODULES[name]
    own = [each for each in vars(module).values() if inspect.isclass(each) and each.__module__ == module.__name__]
    assert any(issubclass(each, Parameters) and "random" in vars(each) for each in own)


def test_key_from_seed():
    keys = [rng.key_from_seed(seed) for seed in (0, 1, 2, 2**32, 2**64, 2**70)]
    assert len(set(keys)) == len(keys)
    assert rng.key_from_seed(2**70) == keys[-1]
    for word in np.ravel(keys):
        assert word == int(word)
        assert 0 <= word < 2**32


def test_no_two_numbers_share_a_draw():
    for scenario in SCENARIOS.values():
        numbers = [each for each in drawn_numbers(scenario) if each.path]
        own = [each.counter for each in numbers if each.only < 0]
        assert len(set(own)) == len(own)
        for alternative in range(len(scenario.ship_paths)):
            with_path = own + [each.counter for each in numbers if each.only == alternative]
            assert len(set(with_path)) == len(with_path)


class Wider(Vehicle):
    """A vehicle with one more number, before all others."""

    @classmethod
    def specs(cls):
        return {"added": number(1.0, "1", "new", low=0.0, high=9.0).metadata["spec"], **super().specs()}

    added = 1.0


def test_a_new_number_moves_no_draw():
    def counters(vehicle):
        rows = dict.fromkeys(vehicle.drawn(), 0)
        return {each.path: each.counter for each in numbers_of(vehicle, "vehicle.", "vehicle.", rows)}

    before, after = counters(Vehicle()), counters(Wider())
    assert list(after) == ["vehicle.added", *before]
    assert {path: after[path] for path in before} == before
    assert after["vehicle.added"] not in before.values()


@pytest.mark.parametrize(
    ("path", "place"),
    [
        ("link.power_w", (0.0, 0.0)),
        ("depth_m", (0.0, 35.0)),
        ("sea.pulses[0].start_s", (0.0, 36.0)),
        ("sea.pulses[1].start_s", (0.0, 42.0)),
        ("sea.pulses[3].moment_nm", (0.0, 58.0)),
        ("ship", (1.0, 0.0)),
        ("ship.lawn-mower.spacing_m", (2.0, 4.0)),
    ],
)
def test_numbers_of_v0_keep_their_places(path, place):
    assert rng.counter(path) == place
