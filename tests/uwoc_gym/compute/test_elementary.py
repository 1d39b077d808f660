from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwoc_gym.compute import elementary

LONG = np.longdouble


@numba.njit
def each_sincos(x):
    out = np.empty((2, x.size))
    for i in range(x.size):
        out[0, i], out[1, i] = elementary.sincos(x[i])
    return out


@numba.njit
def each_small_sincos(x):
    out = np.empty((2, x.size))
    for i in range(x.size):
        out[0, i], out[1, i] = elementary.small_sincos(x[i])
    return out


def each(function):
    @numba.njit
    def apply(x):
        out = np.empty(x.size)
        for i in range(x.size):
            out[i] = function(x[i])
        return out

    return apply


each_log = each(elementary.log)
each_exp = each(elementary.exp)
each_atan = each(elementary.atan_below_one)
each_wrap = each(elementary.wrap)


@numba.njit
def each_atan2(y, x):
    out = np.empty(x.size)
    for i in range(x.size):
        out[i] = elementary.atan2(y[i], x[i])
    return out


@numba.njit
def one_fma(a, b, c):
    return elementary.fma(a, b, c)


def both_signs(low: float, high: float, count: int = 20_000) -> np.ndarray:
    x = np.geomspace(low, high, count)
    return np.concatenate([-x, [0.0], x])


def test_fma_rounds_once():
    a = 1.0 + 2.0**-30
    # a² − (1 + 2⁻²⁹) is 2⁻⁶⁰, which rounding the product first would lose.
    assert one_fma(a, a, -(1.0 + 2.0**-29)) == 2.0**-60


@pytest.mark.parametrize("x", [both_signs(1e-12, 1e6), np.linspace(-20.0, 20.0, 40_001), np.arange(-500, 500) * 0.25])
def test_sincos(x):
    sine, cosine = each_sincos(x)
    assert np.abs(sine - np.sin(x.astype(LONG))).max() < 3e-16
    assert np.abs(cosine - np.cos(x.astype(LONG))).max() < 3e-16


def test_sincos_at_quadrants():
    # At k·π/2 the reduction decides between two quadrants.
    k = np.arange(-4000, 4001)
    x = np.concatenate([np.nextafter(k * (math.pi / 2), side) for side in (-np.inf, np.inf)] + [k * (math.pi / 4)])
    sine, cosine = each_sincos(x)
    np.testing.assert_allclose(sine, np.sin(x), rtol=0, atol=4e-16)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=0, atol=4e-16)


@pytest.mark.parametrize("limit", [0.001, 0.03, 0.5])
def test_small_sincos(limit):
    x = np.linspace(-limit, limit, 10_001)
    sine, cosine = each_small_sincos(x)
    bound = np.abs(x) ** 7 / 5040 + 1.2e-16
    assert (np.abs(sine - np.sin(x.astype(LONG))) <= bound).all()
    assert (np.abs(cosine - np.cos(x.astype(LONG))) <= bound).all()


@pytest.mark.parametrize("x", [np.geomspace(1e-300, 1e300, 60_001), np.linspace(0.5, 2.0, 60_001)])
def test_log(x):
    expected = np.log(x.astype(LONG))
    error = np.abs(each_log(x) - expected)
    assert (error <= 4e-16 * np.abs(expected)).all()


def test_log_near_one():
    x = 1.0 + np.concatenate([-np.geomspace(1e-16, 0.1, 2001), np.geomspace(2.3e-16, 0.1, 2001)])
    np.testing.assert_allclose(each_log(x), np.log(x), rtol=6e-16, atol=0)
    assert each_log(np.array([1.0]))[0] == 0.0


def test_exp():
    x = np.concatenate([np.linspace(-700.0, 700.0, 60_001), both_signs(1e-12, 700.0)])
    expected = np.exp(x.astype(LONG))
    assert (np.abs(each_exp(x) - expected) <= 4e-16 * expected).all()


def test_exp_saturates():
    got = each_exp(np.array([-np.inf, -701.0, 701.0, np.inf]))
    np.testing.assert_allclose(got, [math.exp(-700.0)] * 2 + [math.exp(700.0)] * 2, rtol=4e-16)


def test_atan_below_one():
    t = np.concatenate([np.linspace(0.0, 1.0, 40_001), np.geomspace(1e-300, 1.0, 10_001)])
    assert np.abs(each_atan(t) - np.arctan(t.astype(LONG))).max() < 3.3e-16


def test_atan2_all_around():
    angle = np.linspace(-math.pi, math.pi, 40_001)
    radius = np.geomspace(1e-150, 1e150, angle.size)
    np.random.default_rng(0).shuffle(radius)
    y, x = radius * np.sin(angle), radius * np.cos(angle)
    assert np.abs(each_atan2(y, x) - np.arctan2(y, x)).max() < 5e-16


def test_atan2_on_axes():
    y = np.array([0.0, 0.0, 1.0, 0.0, -1.0, 1.0, -1.0])
    x = np.array([0.0, 1.0, 0.0, -1.0, 0.0, -1.0, -1.0])
    expected = np.array([0.0, 0.0, 0.5, 1.0, -0.5, 0.75, -0.75]) * math.pi
    np.testing.assert_allclose(each_atan2(y, x), expected, rtol=0, atol=5e-16)


def test_wrap():
    angle = np.concatenate([both_signs(1e-9, 1e4), np.arange(-60, 61) * math.pi])
    wrapped = each_wrap(angle)
    # Half an ulp of slack, where the rounding of angle/2π crosses a whole number.
    assert (wrapped >= -math.pi - 1e-12).all()
    assert (wrapped < math.pi + 1e-12).all()
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), rtol=0, atol=3e-12)


def test_wrap_ends():
    np.testing.assert_array_equal(each_wrap(np.array([math.pi, -math.pi, 0.0, 1.5])), [-math.pi, -math.pi, 0.0, 1.5])


@settings(derandomize=True, deadline=None)
@given(st.floats(-1e6, 1e6))
def test_sine_and_cosine_lie_on_the_circle(x):
    sine, cosine = each_sincos(np.array([x]))[:, 0]
    assert sine**2 + cosine**2 == pytest.approx(1.0, abs=1e-15)


@settings(derandomize=True, deadline=None)
@given(st.floats(-690.0, 690.0))
def test_log_undoes_exp(x):
    assert each_log(each_exp(np.array([x])))[0] == pytest.approx(x, rel=1e-15, abs=1e-15)
