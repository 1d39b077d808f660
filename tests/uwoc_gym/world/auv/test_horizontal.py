"""The AUV's motion against SciPy's integrator and the paper's equations, written out here a second time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwoc_gym import Current, Pulse, SettingError, Vehicle

POSE = (1.0, -2.0, 0.4)
VELOCITY = (0.8, -0.3, 0.5)
ACTION = (0.0625, 0.03125, 0.09375)
FORCE = np.array(ACTION) * (2000.0, 2000.0, 500.0)
MASSES = (100.0, 250.0, 80.0)
UNDAMPED = {f"{order}_damping_{axis}": 0.0 for order in ("linear", "quadratic") for axis in ("surge", "sway", "yaw")}
WEAK = {"max_surge_force_n": 0.1, "max_sway_force_n": 0.1, "max_yaw_moment_nm": 0.1}
"""With what these could do to an undamped hull, no integration step would be short enough."""


def assert_agrees(state, expected, atol=1e-8):
    np.testing.assert_allclose(state["pose"][0], expected[0], rtol=0, atol=atol)
    np.testing.assert_allclose(state["velocity"][0], expected[1], rtol=0, atol=atol)


@pytest.mark.parametrize("coriolis", [True, False])
def test_constant_force(fly, coriolis, vast_sea, exact):
    flight = fly(vast_sea(vehicle=Vehicle(coriolis=coriolis)), pose=POSE, velocity=VELOCITY)
    for steps in (1, 19, 180):
        state = flight.step(ACTION, steps)
        assert_agrees(state, exact(state["time_s"][0], FORCE, coriolis=coriolis), 1e-7)
    np.testing.assert_allclose(state["force"][0], FORCE)


def test_start_is_kept(fly, vast_sea):
    state = fly(vast_sea(), pose=POSE, velocity=VELOCITY).fleet.state()
    np.testing.assert_array_equal(state["pose"][0], POSE)
    np.testing.assert_array_equal(state["velocity"][0], VELOCITY)


def test_true_masses_and_damping(fly, vast_sea, exact):
    vehicle = Vehicle(mass_scale=1.2, damping_scale=0.7)
    state = fly(vast_sea(vehicle=vehicle), pose=POSE, velocity=VELOCITY).step(ACTION, 100)
    assert_agrees(state, exact(5.0, FORCE, masses=np.array(MASSES) * 1.2, damping_scale=0.7), 1e-7)


def test_constant_current(fly, vast_sea, exact):
    flight = fly(vast_sea(current=Current(speed_mps=0.4, direction_rad=-1.1)), pose=POSE, velocity=VELOCITY)
    flow = (0.4 * math.cos(-1.1), 0.4 * math.sin(-1.1))
    np.testing.assert_allclose(flight.fleet.state()["current"][0], flow, rtol=1e-14)
    for steps in (20, 180):
        state = flight.step(ACTION, steps)
        assert_agrees(state, exact(state["time_s"][0], FORCE, current=flow), 1e-7)


@pytest.mark.parametrize(("frame", "damping_scale"), [("body", 1.0), ("body", 0.0), ("earth", 0.0)])
def test_order_of_convergence(fly, frame, damping_scale, vast_sea, exact):
    # At a high yaw rate. Where there is damping, no velocity changes sign: |·| isn't smooth there.
    velocity = (1.0, 0.5, 2.0)
    numbers = (0.0, 2.0, 200.0, 400.0, 450.0 * damping_scale, frame == "earth")
    pulse = Pulse(
        start_s=0.0, duration_s=2.0, force_x_n=200.0, force_y_n=400.0, moment_nm=450.0 * damping_scale, frame=frame
    )
    vehicle = Vehicle(damping_scale=damping_scale, **WEAK)
    expected = np.concatenate(exact(1.0, pulses=[numbers], velocity=velocity, damping_scale=damping_scale))
    errors = []
    for step in (0.04, 0.02, 0.01, 0.005):
        flight = fly(vast_sea(0.2, step, vehicle, periods=10, pulses=(pulse,)), pose=POSE, velocity=velocity)
        state = flight.step(0.0, 5)
        errors.append(np.linalg.norm(np.concatenate([state["pose"][0], state["velocity"][0]]) - expected))
    orders = -np.diff(np.log2(errors))
    assert (orders > 3.75).all()
    assert (orders < 4.35).all()


def kinetic_energy(state) -> np.ndarray:
    return 0.5 * (state["velocity"] ** 2 @ np.array(MASSES))


def random_start(count):
    rng = np.random.default_rng(5)
    return rng.uniform(-3.0, 3.0, (count, 3)), rng.uniform(-1.5, 1.5, (count, 3))


def test_energy_never_grows(fly, vast_sea):
    pose, velocity = random_start(64)
    flight = fly(vast_sea(), 64, pose=pose, velocity=velocity)
    before = kinetic_energy(flight.fleet.state())
    for _ in range(100):
        after = kinetic_energy(flight.step())
        assert (after < before).all()
        before = after


def test_energy_is_kept_without_damping(fly, vast_sea):
    pose, velocity = random_start(64)
    flight = fly(vast_sea(vehicle=Vehicle(**UNDAMPED, **WEAK)), 64, pose=pose, velocity=velocity)
    before = kinetic_energy(flight.fleet.state())
    start = flight.fleet.state()["velocity"]
    state = flight.step(0.0, 100)
    np.testing.assert_allclose(kinetic_energy(state), before, rtol=1e-9)
    assert np.abs(state["velocity"] - start).max() > 0.5


def test_rotated_start_rotates_the_trajectory(fly, vast_sea):
    turn = 1.234
    c, s = math.cos(turn), math.sin(turn)
    x, y, yaw = POSE
    pulse = Pulse(start_s=0.3, duration_s=0.6, force_x_n=350.0, force_y_n=-200.0, moment_nm=100.0)
    flight = fly(
        vast_sea(pulses=(pulse,)),
        2,
        pose=[POSE, (c * x - s * y, s * x + c * y, yaw + turn)],
        velocity=VELOCITY,
    )
    state = flight.step(ACTION, 100)
    np.testing.assert_allclose(state["velocity"][1], state["velocity"][0], rtol=0, atol=1e-13)
    x, y, yaw = state["pose"][0]
    expected = (c * x - s * y, s * x + c * y, yaw + turn)
    np.testing.assert_allclose(state["pose"][1], expected, rtol=0, atol=1e-12)


def test_mirrored_start_mirrors_the_trajectory(fly, vast_sea):
    mirror = np.array([1.0, -1.0, -1.0])
    flight = fly(vast_sea(), 2, pose=[POSE, mirror * POSE], velocity=[VELOCITY, mirror * VELOCITY])
    state = flight.step([ACTION, mirror * ACTION], 100)
    assert np.abs(state["pose"][0]).min() > 0.1
    np.testing.assert_allclose(state["pose"][1], mirror * state["pose"][0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(state["velocity"][1], mirror * state["velocity"][0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("coriolis", [True, False])
def test_acceleration_is_that_of_the_motion(fly, coriolis, vast_sea):
    vehicle = Vehicle(mass_scale=1.3, damping_scale=0.8, coriolis=coriolis)
    h = 1e-4
    flight = fly(vast_sea(h, h, vehicle), 16, pose=np.zeros(3), velocity=random_start(16)[1])
    zero = flight.fleet.state()["velocity"]
    one = flight.step(ACTION)["velocity"]
    two = flight.step(ACTION)["velocity"]
    slope = (4.0 * one - 3.0 * zero - two) / (2.0 * h)
    np.testing.assert_allclose(vehicle.acceleration(zero, FORCE), slope, rtol=1e-6, atol=1e-6)


def test_acceleration_by_hand():
    # u = 1, v = 2, r = 3 under no force.
    expected = [(250 * 2 * 3 - 170) / 100, (-100 * 3 - 2 * 500) / 250, (-150 * 2 - 3 * 350) / 80]
    np.testing.assert_allclose(Vehicle().acceleration([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]), expected, rtol=1e-14)
    np.testing.assert_allclose(Vehicle().damping([-1.0, 2.0, -3.0]), [170.0, 500.0, 350.0])
    np.testing.assert_allclose(Vehicle().coriolis_force([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]), [-1500.0, 300.0, 300.0])


def test_coriolis_force_does_no_work():
    velocity = random_start(20)[1]
    force = Vehicle().coriolis_force(velocity, velocity)
    np.testing.assert_allclose((force * velocity).sum(axis=1), 0.0, atol=1e-12)
    assert np.abs(force).max() > 100.0


def test_coriolis_off(fly, vast_sea):
    vehicle = Vehicle(coriolis=False, **UNDAMPED)
    state = fly(vast_sea(periods=50, vehicle=vehicle), pose=POSE, velocity=VELOCITY).step(0.0, 49)
    np.testing.assert_array_equal(state["velocity"][0], VELOCITY)
    assert not vehicle.coriolis_force(VELOCITY, VELOCITY).any()


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.2])
def test_mass_scale(fly, scale, vast_sea):
    vehicle = Vehicle(mass_scale=scale, coriolis=False, **UNDAMPED)
    np.testing.assert_allclose(vehicle.inertia, np.array(MASSES) * scale)
    state = fly(vast_sea(periods=50, vehicle=vehicle), pose=(0, 0, 0), velocity=(0, 0, 0)).step(ACTION, 20)
    np.testing.assert_allclose(state["velocity"][0], FORCE / (np.array(MASSES) * scale), rtol=1e-12)


def test_actions_are_clipped_and_scaled(fly, vast_sea):
    vehicle = Vehicle(max_surge_force_n=300.0, max_sway_force_n=200.0, max_yaw_moment_nm=100.0)
    state = fly(vast_sea(vehicle=vehicle), 2).step([(2.0, -7.0, 0.5), (1.0, -1.0, 0.5)])
    np.testing.assert_array_equal(state["force"], [[300.0, -200.0, 50.0]] * 2)
    np.testing.assert_array_equal(state["velocity"][0], state["velocity"][1])
    np.testing.assert_array_equal(vehicle.force_limits, [300.0, 200.0, 100.0])


def test_nominal():
    vehicle = Vehicle(mass_scale=(0.8, 1.4), damping_scale=0.5, mass_surge_kg=(90.0, 100.0), coriolis=False)
    assert vehicle.nominal() == Vehicle(mass_surge_kg=95.0, coriolis=False)


def test_range_has_no_inertia():
    with pytest.raises(SettingError, match=r"Vehicle.mass_scale is the range \(0.8, 1.2\)"):
        _ = Vehicle(mass_scale=(0.8, 1.2)).inertia
