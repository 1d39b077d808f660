from __future__ import annotations

import math

import numpy as np
import pytest

from uwoc_gym import Current, Sea

LANES = 4096
POSE = (1.0, -2.0, 0.6)


def current_history(fly, below_a_still_ship, steps, **settings):
    flight = fly(below_a_still_ship(sea=Sea(current=Current(**settings))), LANES)
    history = [flight.fleet.state()["current"]]
    history += [flight.step()["current"] for _ in range(steps)]
    return np.array(history)


def test_random_current_is_stationary(fly, below_a_still_ship):
    history = current_history(fly, below_a_still_ship, 6, std_mps=0.2, correlation_time_s=2.0)
    # Standard errors over the lanes: of the mean σ/√N, of the deviation σ/√(2N).
    assert np.abs(history.mean(axis=1)).max() < 4.5 * 0.2 / LANES**0.5
    assert np.abs(history.std(axis=1) - 0.2).max() < 4.5 * 0.2 / (2 * LANES) ** 0.5


@pytest.mark.parametrize("lag", [1, 4])
def test_random_current_is_correlated_as_stated(fly, below_a_still_ship, lag):
    history = current_history(fly, below_a_still_ship, 4, std_mps=0.2, correlation_time_s=2.0)
    expected = math.exp(-0.5 * lag / 2.0)
    for axis in range(2):
        correlation = np.corrcoef(history[0, :, axis], history[lag, :, axis])[0, 1]
        assert correlation == pytest.approx(expected, abs=4.5 * (1 - expected**2) / LANES**0.5)


def test_random_current_axes_are_independent(fly, below_a_still_ship):
    history = current_history(fly, below_a_still_ship, 1, std_mps=0.2, correlation_time_s=2.0)
    for x, y in ((history[0, :, 0], history[0, :, 1]), (history[0, :, 0], history[1, :, 1])):
        assert abs(np.corrcoef(x, y)[0, 1]) < 4.5 / LANES**0.5


def test_random_current_varies_about_the_constant_part(fly, below_a_still_ship):
    history = current_history(
        fly, below_a_still_ship, 3, std_mps=0.1, correlation_time_s=2.0, speed_mps=0.5, direction_rad=2.0
    )
    mean = (0.5 * math.cos(2.0), 0.5 * math.sin(2.0))
    np.testing.assert_allclose(history.mean(axis=1), [mean] * 4, rtol=0, atol=4.5 * 0.1 / LANES**0.5)


def test_constant_current_is_constant(fly, below_a_still_ship):
    flight = fly(below_a_still_ship(sea=Sea(current=Current(speed_mps=0.3, direction_rad=-0.4))))
    for _ in range(3):
        expected = [0.3 * math.cos(-0.4), 0.3 * math.sin(-0.4)]
        np.testing.assert_allclose(flight.step()["current"][0], expected, rtol=1e-14)


def test_unforced_auv_drifts_with_the_current(fly, below_a_still_ship):
    flight = fly(
        below_a_still_ship(sea=Sea(current=Current(speed_mps=0.3, direction_rad=2.2))),
        pose=POSE,
        velocity=(0.5, 0.4, 0.3),
    )
    flow = np.array([0.3 * math.cos(2.2), 0.3 * math.sin(2.2)])
    before = flight.step(0.0, 120)
    after = flight.step(0.0, 20)
    np.testing.assert_allclose((after["pose"] - before["pose"])[0], [*(10.0 * flow), 0.0], rtol=0, atol=1e-6)
    c, s = math.cos(after["pose"][0, 2]), math.sin(after["pose"][0, 2])
    drift = [c * flow[0] + s * flow[1], c * flow[1] - s * flow[0], 0.0]
    np.testing.assert_allclose(after["velocity"][0], drift, rtol=0, atol=1e-6)


def test_auv_at_rest_stays_without_current(fly, below_a_still_ship):
    state = fly(below_a_still_ship(), pose=POSE, velocity=(0, 0, 0)).step(0.0, 20)
    np.testing.assert_array_equal(state["pose"][0], POSE)


def test_random_current_moves_the_auv(fly, below_a_still_ship):
    sea = Sea(current=Current(std_mps=0.2, correlation_time_s=60.0))
    flight = fly(below_a_still_ship(sea=sea), 64, pose=(0, 0, 0), velocity=(0, 0, 0))
    flow = flight.fleet.state()["current"]
    moved = flight.step(0.0, 6)["pose"][:, :2]
    # Pushed the way the water goes: more than half the speed after a second or two.
    assert ((moved * flow).sum(axis=1) > 0.0).mean() > 0.95
