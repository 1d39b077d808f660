"""The AUV's motion against SciPy's integrator and the paper's equations, written out here a second time."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from uwoc_gym import Current, EpisodeSettings, Pulse, Scenario, Sea, SettingError, StraightPath, Vehicle

POSE = (1.0, -2.0, 0.4)
VELOCITY = (0.8, -0.3, 0.5)
ACTION = (0.0625, 0.03125, 0.09375)
FORCE = np.array(ACTION) * (2000.0, 2000.0, 500.0)
MASSES = (100.0, 250.0, 80.0)
UNDAMPED = {f"{order}_damping_{axis}": 0.0 for order in ("linear", "quadratic") for axis in ("surge", "sway", "yaw")}


def scenario(period: float = 0.05, step: float = 0.005, vehicle: Vehicle | None = None, **sea) -> Scenario:
    """A vast sea, so that no episode ends."""
    return Scenario(
        ship=StraightPath(speed_mps=0.0),
        vehicle=vehicle or Vehicle(),
        sea=Sea(**sea),
        episode=EpisodeSettings(
            duration_s=period * 10_000, control_period_s=period, integration_step_s=step, lost_distance_m=1e6
        ),
    )


def derivative(t, state, body, earth, current, masses, damping_scale, coriolis):
    """The paper's equations for the velocity relative to the water."""
    _, _, yaw, u, v, r = state
    m11, m22, m33 = masses
    c, s = math.cos(yaw), math.sin(yaw)
    force_u = body[0] + c * earth[0] + s * earth[1]
    force_v = body[1] - s * earth[0] + c * earth[1]
    on = 1.0 if coriolis else 0.0
    return [
        c * u - s * v + current[0],
        s * u + c * v + current[1],
        r,
        (force_u + on * m22 * v * r - damping_scale * (70 + 100 * abs(u)) * u) / m11,
        (force_v - on * m11 * u * r - damping_scale * (100 + 200 * abs(v)) * v) / m22,
        (body[2] - on * (m22 - m11) * u * v - damping_scale * (50 + 100 * abs(r)) * r) / m33,
    ]


def exact(
    end, force=(0.0, 0.0, 0.0), pulses=(), current=(0.0, 0.0), masses=MASSES, damping_scale=1.0, coriolis=True,
    pose=POSE, velocity=VELOCITY,
):  # fmt: skip
    """Pose and velocity at ``end``; pulses are (start, end, force_x, force_y, moment, earth?)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    cx, cy = current
    state = np.array([*pose, velocity[0] - c * cx - s * cy, velocity[1] + s * cx - c * cy, velocity[2]])
    edges = sorted({0.0, end} | {edge for pulse in pulses for edge in pulse[:2] if 0.0 < edge < end})
    for begin, finish in pairwise(edges):
        body, earth = np.array(force, dtype=float), np.zeros(2)
        for start, stop, x, y, moment, fixed in pulses:
            if start < 0.5 * (begin + finish) < stop:
                body[2] += moment
                (earth if fixed else body)[:2] += (x, y)
        arguments = (body, earth, current, masses, damping_scale, coriolis)
        result = solve_ivp(derivative, (begin, finish), state, method="DOP853", rtol=1e-11, atol=1e-13, args=arguments)
        state = result.y[:, -1]
    c, s = math.cos(state[2]), math.sin(state[2])
    return state[:3], np.add(state[3:], (c * cx + s * cy, c * cy - s * cx, 0.0))


def assert_agrees(state, expected, atol=1e-8):
    np.testing.assert_allclose(state["pose"][0], expected[0], rtol=0, atol=atol)
    np.testing.assert_allclose(state["velocity"][0], expected[1], rtol=0, atol=atol)


@pytest.mark.parametrize("coriolis", [True, False])
def test_constant_force(fly, coriolis):
    flight = fly(scenario(vehicle=Vehicle(coriolis=coriolis)), pose=POSE, velocity=VELOCITY)
    for steps in (1, 19, 180):
        state = flight.step(ACTION, steps)
        assert_agrees(state, exact(state["time_s"][0], FORCE, coriolis=coriolis), 1e-7)
    np.testing.assert_allclose(state["force"][0], FORCE)


def test_start_is_kept(fly):
    state = fly(scenario(), pose=POSE, velocity=VELOCITY).fleet.state()
    np.testing.assert_array_equal(state["pose"][0], POSE)
    np.testing.assert_array_equal(state["velocity"][0], VELOCITY)


def test_true_masses_and_damping(fly):
    vehicle = Vehicle(mass_scale=1.2, damping_scale=0.7)
    state = fly(scenario(vehicle=vehicle), pose=POSE, velocity=VELOCITY).step(ACTION, 100)
    assert_agrees(state, exact(5.0, FORCE, masses=np.array(MASSES) * 1.2, damping_scale=0.7), 1e-7)


PULSES = [(0.3, 0.9, 350.0, -200.0, 100.0), (0.7, 1.4, -120.0, 90.0, -60.0)]


def as_pulses(frames):
    return tuple(
        Pulse(start_s=a, duration_s=b - a, force_x_n=x, force_y_n=y, moment_nm=n, frame=frame)
        for (a, b, x, y, n), frame in zip(PULSES, frames, strict=True)
    )


@pytest.mark.parametrize("frames", [("body", "body"), ("earth", "earth"), ("body", "earth")])
@pytest.mark.parametrize("current", [None, (0.3, 2.0)])
def test_pulses(fly, frames, current):
    pulses = [(*numbers, frame == "earth") for numbers, frame in zip(PULSES, frames, strict=True)]
    sea = {"pulses": as_pulses(frames)}
    flow = (0.0, 0.0)
    if current:
        sea["current"] = Current(speed_mps=current[0], direction_rad=current[1])
        flow = (current[0] * math.cos(current[1]), current[0] * math.sin(current[1]))
    flight = fly(scenario(**sea), pose=POSE, velocity=VELOCITY)
    for steps in (10, 10, 20):
        state = flight.step(ACTION, steps)
        assert_agrees(state, exact(state["time_s"][0], FORCE, pulses, flow), 1e-7)


def test_pulse_with_edges_off_the_grid(fly):
    # Between the steps its edges fall in, the mean force over a step is the force itself.
    pulse = Pulse(start_s=0.3021, duration_s=0.5043, force_x_n=100.0, force_y_n=-80.0, moment_nm=40.0)
    state = fly(scenario(pulses=(pulse,)), pose=POSE, velocity=VELOCITY).step(ACTION, 40)
    assert_agrees(state, exact(2.0, FORCE, [(0.3021, 0.8064, 100.0, -80.0, 40.0, False)]), 1e-5)


def test_constant_current(fly):
    flight = fly(scenario(current=Current(speed_mps=0.4, direction_rad=-1.1)), pose=POSE, velocity=VELOCITY)
    flow = (0.4 * math.cos(-1.1), 0.4 * math.sin(-1.1))
    np.testing.assert_allclose(flight.fleet.state()["current"][0], flow, rtol=1e-14)
    for steps in (20, 180):
        state = flight.step(ACTION, steps)
        assert_agrees(state, exact(state["time_s"][0], FORCE, current=flow), 1e-7)


@pytest.mark.parametrize(("frame", "damping_scale"), [("body", 1.0), ("body", 0.0), ("earth", 0.0)])
def test_order_of_convergence(fly, frame, damping_scale):
    # At a high yaw rate. Where there is damping, no velocity changes sign: |·| isn't smooth there.
    velocity = (1.0, 0.5, 2.0)
    numbers = (0.0, 2.0, 200.0, 400.0, 450.0 * damping_scale, frame == "earth")
    pulse = Pulse(
        start_s=0.0, duration_s=2.0, force_x_n=200.0, force_y_n=400.0, moment_nm=450.0 * damping_scale, frame=frame
    )
    vehicle = Vehicle(damping_scale=damping_scale)
    expected = np.concatenate(exact(1.0, pulses=[numbers], velocity=velocity, damping_scale=damping_scale))
    errors = []
    for step in (0.1, 0.05, 0.025, 0.0125):
        flight = fly(scenario(0.1, step, vehicle, pulses=(pulse,)), pose=POSE, velocity=velocity)
        state = flight.step(0.0, 10)
        errors.append(np.linalg.norm(np.concatenate([state["pose"][0], state["velocity"][0]]) - expected))
    orders = -np.diff(np.log2(errors))
    assert (orders > 3.75).all()
    assert (orders < 4.35).all()


def kinetic_energy(state) -> np.ndarray:
    return 0.5 * (state["velocity"] ** 2 @ np.array(MASSES))


def random_start(count):
    rng = np.random.default_rng(5)
    return rng.uniform(-3.0, 3.0, (count, 3)), rng.uniform(-1.5, 1.5, (count, 3))


def test_energy_never_grows(fly):
    pose, velocity = random_start(64)
    flight = fly(scenario(), 64, pose=pose, velocity=velocity)
    before = kinetic_energy(flight.fleet.state())
    for _ in range(100):
        after = kinetic_energy(flight.step())
        assert (after < before).all()
        before = after


def test_energy_is_kept_without_damping(fly):
    pose, velocity = random_start(64)
    flight = fly(scenario(vehicle=Vehicle(**UNDAMPED)), 64, pose=pose, velocity=velocity)
    before = kinetic_energy(flight.fleet.state())
    start = flight.fleet.state()["velocity"]
    state = flight.step(0.0, 100)
    np.testing.assert_allclose(kinetic_energy(state), before, rtol=1e-9)
    assert np.abs(state["velocity"] - start).max() > 0.5


def test_rotated_start_rotates_the_trajectory(fly):
    turn = 1.234
    c, s = math.cos(turn), math.sin(turn)
    x, y, yaw = POSE
    flight = fly(
        scenario(pulses=as_pulses(("body", "body"))),
        2,
        pose=[POSE, (c * x - s * y, s * x + c * y, yaw + turn)],
        velocity=VELOCITY,
    )
    state = flight.step(ACTION, 100)
    np.testing.assert_allclose(state["velocity"][1], state["velocity"][0], rtol=0, atol=1e-13)
    x, y, yaw = state["pose"][0]
    expected = (c * x - s * y, s * x + c * y, yaw + turn)
    np.testing.assert_allclose(state["pose"][1], expected, rtol=0, atol=1e-12)


def test_mirrored_start_mirrors_the_trajectory(fly):
    mirror = np.array([1.0, -1.0, -1.0])
    flight = fly(scenario(), 2, pose=[POSE, mirror * POSE], velocity=[VELOCITY, mirror * VELOCITY])
    state = flight.step([ACTION, mirror * ACTION], 100)
    assert np.abs(state["pose"][0]).min() > 0.1
    np.testing.assert_allclose(state["pose"][1], mirror * state["pose"][0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(state["velocity"][1], mirror * state["velocity"][0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("coriolis", [True, False])
def test_acceleration_is_that_of_the_motion(fly, coriolis):
    vehicle = Vehicle(mass_scale=1.3, damping_scale=0.8, coriolis=coriolis)
    h = 1e-4
    flight = fly(scenario(h, h, vehicle), 16, pose=np.zeros(3), velocity=random_start(16)[1])
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


def test_coriolis_off(fly):
    vehicle = Vehicle(coriolis=False, **UNDAMPED)
    state = fly(scenario(vehicle=vehicle), pose=POSE, velocity=VELOCITY).step(0.0, 50)
    np.testing.assert_array_equal(state["velocity"][0], VELOCITY)
    assert not vehicle.coriolis_force(VELOCITY, VELOCITY).any()


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.2])
def test_mass_scale(fly, scale):
    vehicle = Vehicle(mass_scale=scale, coriolis=False, **UNDAMPED)
    np.testing.assert_allclose(vehicle.inertia, np.array(MASSES) * scale)
    state = fly(scenario(vehicle=vehicle), pose=(0, 0, 0), velocity=(0, 0, 0)).step(ACTION, 20)
    np.testing.assert_allclose(state["velocity"][0], FORCE / (np.array(MASSES) * scale), rtol=1e-12)


@pytest.mark.parametrize(
    ("start", "duration"),
    [
        (0.0, 0.005),
        (0.0123, 0.0517),
        (0.0511, 0.0007),
        (0.0487, 0.0031),
        (0.1, 0.05),
        (0.0999999, 0.2000002),
        (0.0, 0.0),
        (0.15, 1e-9),
    ],
)
@pytest.mark.parametrize("frame", ["body", "earth"])
def test_impulse_is_exact(fly, start, duration, frame):
    pulse = Pulse(start_s=start, duration_s=duration, force_x_n=350.0, force_y_n=-210.0, moment_nm=0.0, frame=frame)
    vehicle = Vehicle(coriolis=False, **UNDAMPED)
    yaw = 0.7
    state = fly(scenario(vehicle=vehicle, pulses=(pulse,)), pose=(0, 0, yaw), velocity=(0, 0, 0)).step(0.0, 10)
    x, y = 350.0 * duration, -210.0 * duration
    if frame == "earth":
        x, y = math.cos(yaw) * x + math.sin(yaw) * y, math.cos(yaw) * y - math.sin(yaw) * x
    np.testing.assert_allclose(state["velocity"][0], [x / 100.0, y / 250.0, 0.0], rtol=1e-11, atol=1e-15)


def test_angular_impulse_is_exact(fly):
    pulse = Pulse(start_s=0.0123, duration_s=0.0517, force_x_n=0.0, force_y_n=0.0, moment_nm=80.0)
    flight = fly(scenario(vehicle=Vehicle(**UNDAMPED), pulses=(pulse,)), pose=(0, 0, 0), velocity=(0, 0, 0))
    np.testing.assert_allclose(flight.step(0.0, 2)["velocity"][0], [0.0, 0.0, 0.0517], rtol=1e-11)


def test_pulse_touches_only_its_own_lane(fly):
    pulse = Pulse(start_s=(0.0, 0.4), duration_s=0.1)
    flight = fly(scenario(pulses=(pulse,)), 40, pose=(0, 0, 0), velocity=(0, 0, 0))
    start = flight.fleet.drawn()["sea.pulses[0].start_s"]
    state = flight.step(0.0, 4)
    moved = np.abs(state["velocity"]).max(axis=1) > 0.0
    assert 0 < moved.sum() < 40
    np.testing.assert_array_equal(moved, start < 0.2)


def test_actions_are_clipped_and_scaled(fly):
    vehicle = Vehicle(max_surge_force_n=300.0, max_sway_force_n=200.0, max_yaw_moment_nm=100.0)
    state = fly(scenario(vehicle=vehicle), 2).step([(2.0, -7.0, 0.5), (1.0, -1.0, 0.5)])
    np.testing.assert_array_equal(state["force"], [[300.0, -200.0, 50.0]] * 2)
    np.testing.assert_array_equal(state["velocity"][0], state["velocity"][1])
    np.testing.assert_array_equal(vehicle.force_limits, [300.0, 200.0, 100.0])


def test_nominal():
    vehicle = Vehicle(mass_scale=(0.8, 1.4), damping_scale=0.5, mass_surge_kg=(90.0, 100.0), coriolis=False)
    assert vehicle.nominal() == Vehicle(mass_surge_kg=95.0, coriolis=False)


def test_range_has_no_inertia():
    with pytest.raises(SettingError, match=r"Vehicle.mass_scale is the range \(0.8, 1.2\)"):
        _ = Vehicle(mass_scale=(0.8, 1.2)).inertia
