from __future__ import annotations

import math

import numpy as np
import pytest

from uwoc_gym import Current, Pulse, Sea, Sensors, unpack

LANES = 4096
POSE = (1.0, -2.0, 0.6)
VELOCITY = (0.4, -0.2, 0.1)


NOISE = Sensors(position_std_m=0.05, velocity_std_mps=0.03, yaw_rate_std_rad_s=0.02)


def errors_of(flight):
    """What observation says minus what is true: x, y, yaw in the earth frame (yaw exact), then velocities."""
    state, seen = flight.fleet.state(), unpack(flight.observations)
    heading = state["pose"][:, 2]
    c, s = np.cos(heading), np.sin(heading)
    ahead, aside = seen.relative_position.T
    relative = np.stack([c * ahead - s * aside, s * ahead + c * aside], axis=1)
    position = state["ship_pose"][:, :2] - relative - state["pose"][:, :2]
    return np.concatenate([position, seen.velocity - state["velocity"]], axis=1)


def test_noise_has_the_configured_deviations(fly, below_a_still_ship):
    flight = fly(below_a_still_ship(sensors=NOISE), LANES, pose=POSE, velocity=VELOCITY)
    expected = np.array([0.05, 0.05, 0.03, 0.03, 0.02])
    for _ in range(3):
        errors = errors_of(flight)
        assert (np.abs(errors.std(axis=0) / expected - 1.0) < 4.5 / (2 * LANES) ** 0.5).all()
        assert (np.abs(errors.mean(axis=0) / expected) < 4.5 / LANES**0.5).all()
        correlation = np.corrcoef(errors.T) - np.eye(5)
        assert np.abs(correlation).max() < 4.5 / LANES**0.5
        flight.step()


def test_noise_is_white(fly, below_a_still_ship):
    flight = fly(below_a_still_ship(sensors=NOISE), LANES, pose=POSE, velocity=VELOCITY)
    first = errors_of(flight)
    flight.step()
    correlation = np.corrcoef(first.T, errors_of(flight).T)[:5, 5:]
    assert np.abs(correlation).max() < 4.5 / LANES**0.5


def test_noise_of_yaw(fly, below_a_still_ship):
    flight = fly(below_a_still_ship(sensors=Sensors(yaw_std_rad=0.02)), LANES, pose=POSE, velocity=(0, 0, 0))
    seen = unpack(flight.observations)
    errors = np.arctan2(seen.heading[:, 1], seen.heading[:, 0]) - POSE[2]
    assert errors.std() == pytest.approx(0.02, rel=4.5 / (2 * LANES) ** 0.5)
    assert abs(errors.mean()) < 4.5 * 0.02 / LANES**0.5
    # One measured heading: everything that is seen from the body turns with it.
    np.testing.assert_allclose(seen.yaw_error, -(POSE[2] + errors), rtol=0, atol=1e-6)
    bearing = np.arctan2(seen.relative_position[:, 1], seen.relative_position[:, 0])
    np.testing.assert_allclose(bearing, math.atan2(2.0, -1.0) - POSE[2] - errors, rtol=0, atol=1e-6)


def test_relative_velocity_holds_the_same_noise(fly, below_a_still_ship):
    flight = fly(below_a_still_ship(sensors=NOISE), 64, pose=POSE, velocity=VELOCITY)
    seen = unpack(flight.observations)
    np.testing.assert_allclose(seen.relative_velocity, -seen.velocity, rtol=0, atol=1e-6)


def test_noise_leaves_the_truth_alone(fly, below_a_still_ship):
    everything = Sensors(position_std_m=0.5, yaw_std_rad=0.3, velocity_std_mps=0.3, yaw_rate_std_rad_s=0.3)
    sea = Sea(current=Current(std_mps=0.1), pulses=(Pulse(start_s=(0.0, 2.0)),))
    noisy, quiet = (fly(below_a_still_ship(sensors=sensors, sea=sea), 40) for sensors in (everything, Sensors()))
    for action in (0.3, -0.1, 0.0):
        states = [flight.step(action, 3) for flight in (noisy, quiet)]
        for name, value in states[0].items():
            np.testing.assert_array_equal(value, states[1][name], err_msg=name)
        np.testing.assert_array_equal(noisy.out, quiet.out)
        assert not np.array_equal(noisy.observations, quiet.observations)


def test_noise_does_not_touch_what_is_known(fly, below_a_still_ship):
    flight = fly(below_a_still_ship(sensors=NOISE), 40, pose=POSE, velocity=VELOCITY)
    flight.step((0.25, -0.5, 0.125))
    seen = unpack(flight.observations)
    np.testing.assert_array_equal(seen.last_action, [[0.25, -0.5, 0.125]] * 40)
    heading = flight.fleet.state()["pose"][:, 2]
    np.testing.assert_allclose(seen.heading, np.stack([np.cos(heading), np.sin(heading)], axis=1), atol=1e-7)
