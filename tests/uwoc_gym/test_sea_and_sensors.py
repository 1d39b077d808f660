from __future__ import annotations

import math

import numpy as np
import pytest

from uwoc_gym import Current, EpisodeSettings, Pulse, Scenario, Sea, Sensors, StraightPath, unpack

LANES = 4096
EPISODE = EpisodeSettings(duration_s=500.0, control_period_s=0.5, integration_step_s=0.05, lost_distance_m=1e6)
POSE = (1.0, -2.0, 0.6)
VELOCITY = (0.4, -0.2, 0.1)


def scenario(**settings) -> Scenario:
    return Scenario(ship=StraightPath(speed_mps=0.0), **({"episode": EPISODE} | settings))


def current_history(fly, steps, **settings):
    flight = fly(scenario(sea=Sea(current=Current(**settings))), LANES)
    history = [flight.fleet.state()["current"]]
    history += [flight.step()["current"] for _ in range(steps)]
    return np.array(history)


def test_random_current_is_stationary(fly):
    history = current_history(fly, 6, std_mps=0.2, correlation_time_s=2.0)
    # Standard errors over the lanes: of the mean σ/√N, of the deviation σ/√(2N).
    assert np.abs(history.mean(axis=1)).max() < 4.5 * 0.2 / LANES**0.5
    assert np.abs(history.std(axis=1) - 0.2).max() < 4.5 * 0.2 / (2 * LANES) ** 0.5


@pytest.mark.parametrize("lag", [1, 4])
def test_random_current_is_correlated_as_stated(fly, lag):
    history = current_history(fly, 4, std_mps=0.2, correlation_time_s=2.0)
    expected = math.exp(-0.5 * lag / 2.0)
    for axis in range(2):
        correlation = np.corrcoef(history[0, :, axis], history[lag, :, axis])[0, 1]
        assert correlation == pytest.approx(expected, abs=4.5 * (1 - expected**2) / LANES**0.5)


def test_random_current_axes_are_independent(fly):
    history = current_history(fly, 1, std_mps=0.2, correlation_time_s=2.0)
    for x, y in ((history[0, :, 0], history[0, :, 1]), (history[0, :, 0], history[1, :, 1])):
        assert abs(np.corrcoef(x, y)[0, 1]) < 4.5 / LANES**0.5


def test_random_current_varies_about_the_constant_part(fly):
    history = current_history(fly, 3, std_mps=0.1, correlation_time_s=2.0, speed_mps=0.5, direction_rad=2.0)
    mean = (0.5 * math.cos(2.0), 0.5 * math.sin(2.0))
    np.testing.assert_allclose(history.mean(axis=1), [mean] * 4, rtol=0, atol=4.5 * 0.1 / LANES**0.5)


def test_constant_current_is_constant(fly):
    flight = fly(scenario(sea=Sea(current=Current(speed_mps=0.3, direction_rad=-0.4))))
    for _ in range(3):
        expected = [0.3 * math.cos(-0.4), 0.3 * math.sin(-0.4)]
        np.testing.assert_allclose(flight.step()["current"][0], expected, rtol=1e-14)


def test_unforced_auv_drifts_with_the_current(fly):
    flight = fly(
        scenario(sea=Sea(current=Current(speed_mps=0.3, direction_rad=2.2))), pose=POSE, velocity=(0.5, 0.4, 0.3)
    )
    flow = np.array([0.3 * math.cos(2.2), 0.3 * math.sin(2.2)])
    before = flight.step(0.0, 120)
    after = flight.step(0.0, 20)
    np.testing.assert_allclose((after["pose"] - before["pose"])[0], [*(10.0 * flow), 0.0], rtol=0, atol=1e-6)
    c, s = math.cos(after["pose"][0, 2]), math.sin(after["pose"][0, 2])
    drift = [c * flow[0] + s * flow[1], c * flow[1] - s * flow[0], 0.0]
    np.testing.assert_allclose(after["velocity"][0], drift, rtol=0, atol=1e-6)


def test_auv_at_rest_stays_without_current(fly):
    state = fly(scenario(), pose=POSE, velocity=(0, 0, 0)).step(0.0, 20)
    np.testing.assert_array_equal(state["pose"][0], POSE)


def test_random_current_moves_the_auv(fly):
    sea = Sea(current=Current(std_mps=0.2, correlation_time_s=60.0))
    flight = fly(scenario(sea=sea), 64, pose=(0, 0, 0), velocity=(0, 0, 0))
    flow = flight.fleet.state()["current"]
    moved = flight.step(0.0, 6)["pose"][:, :2]
    # Pushed the way the water goes: more than half the speed after a second or two.
    assert ((moved * flow).sum(axis=1) > 0.0).mean() > 0.95


def test_pulse_in_earth_frame_pushes_along_x(fly):
    pulse = Pulse(start_s=0.0, duration_s=0.5, force_x_n=300.0, force_y_n=0.0, moment_nm=0.0, frame="earth")
    state = fly(scenario(sea=Sea(pulses=(pulse,))), pose=(0, 0, 1.0), velocity=(0, 0, 0)).step()
    surge, sway, _ = state["velocity"][0]
    # The push along x is seen from a body turned by 1 rad.
    assert surge > 0.0
    assert sway < 0.0


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


def test_noise_has_the_configured_deviations(fly):
    flight = fly(scenario(sensors=NOISE), LANES, pose=POSE, velocity=VELOCITY)
    expected = np.array([0.05, 0.05, 0.03, 0.03, 0.02])
    for _ in range(3):
        errors = errors_of(flight)
        assert (np.abs(errors.std(axis=0) / expected - 1.0) < 4.5 / (2 * LANES) ** 0.5).all()
        assert (np.abs(errors.mean(axis=0) / expected) < 4.5 / LANES**0.5).all()
        correlation = np.corrcoef(errors.T) - np.eye(5)
        assert np.abs(correlation).max() < 4.5 / LANES**0.5
        flight.step()


def test_noise_is_white(fly):
    flight = fly(scenario(sensors=NOISE), LANES, pose=POSE, velocity=VELOCITY)
    first = errors_of(flight)
    flight.step()
    correlation = np.corrcoef(first.T, errors_of(flight).T)[:5, 5:]
    assert np.abs(correlation).max() < 4.5 / LANES**0.5


def test_noise_of_yaw(fly):
    flight = fly(scenario(sensors=Sensors(yaw_std_rad=0.02)), LANES, pose=POSE, velocity=(0, 0, 0))
    seen = unpack(flight.observations)
    errors = np.arctan2(seen.heading[:, 1], seen.heading[:, 0]) - POSE[2]
    assert errors.std() == pytest.approx(0.02, rel=4.5 / (2 * LANES) ** 0.5)
    assert abs(errors.mean()) < 4.5 * 0.02 / LANES**0.5
    # One measured heading: everything that is seen from the body turns with it.
    np.testing.assert_allclose(seen.yaw_error, -(POSE[2] + errors), rtol=0, atol=1e-6)
    bearing = np.arctan2(seen.relative_position[:, 1], seen.relative_position[:, 0])
    np.testing.assert_allclose(bearing, math.atan2(2.0, -1.0) - POSE[2] - errors, rtol=0, atol=1e-6)


def test_relative_velocity_holds_the_same_noise(fly):
    flight = fly(scenario(sensors=NOISE), 64, pose=POSE, velocity=VELOCITY)
    seen = unpack(flight.observations)
    np.testing.assert_allclose(seen.relative_velocity, -seen.velocity, rtol=0, atol=1e-6)


def test_noise_leaves_the_truth_alone(fly):
    everything = Sensors(position_std_m=0.5, yaw_std_rad=0.3, velocity_std_mps=0.3, yaw_rate_std_rad_s=0.3)
    sea = Sea(current=Current(std_mps=0.1), pulses=(Pulse(start_s=(0.0, 2.0)),))
    noisy, quiet = (fly(scenario(sensors=sensors, sea=sea), 40) for sensors in (everything, Sensors()))
    for action in (0.3, -0.1, 0.0):
        states = [flight.step(action, 3) for flight in (noisy, quiet)]
        for name, value in states[0].items():
            np.testing.assert_array_equal(value, states[1][name], err_msg=name)
        np.testing.assert_array_equal(noisy.out, quiet.out)
        assert not np.array_equal(noisy.observations, quiet.observations)


def test_noise_does_not_touch_what_is_known(fly):
    flight = fly(scenario(sensors=NOISE), 40, pose=POSE, velocity=VELOCITY)
    flight.step((0.25, -0.5, 0.125))
    seen = unpack(flight.observations)
    np.testing.assert_array_equal(seen.last_action, [[0.25, -0.5, 0.125]] * 40)
    heading = flight.fleet.state()["pose"][:, 2]
    np.testing.assert_allclose(seen.heading, np.stack([np.cos(heading), np.sin(heading)], axis=1), atol=1e-7)
