"""Pulses against SciPy's integrator and by their impulse."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uwoc_gym import Current, Pulse, Sea, Vehicle

START = {"pose": (1.0, -2.0, 0.4), "velocity": (0.8, -0.3, 0.5)}
ACTION = (0.0625, 0.03125, 0.09375)
FORCE = np.array(ACTION) * (2000.0, 2000.0, 500.0)
UNDAMPED = {f"{order}_damping_{axis}": 0.0 for order in ("linear", "quadratic") for axis in ("surge", "sway", "yaw")}


def assert_agrees(state, expected, atol=1e-8):
    np.testing.assert_allclose(state["pose"][0], expected[0], rtol=0, atol=atol)
    np.testing.assert_allclose(state["velocity"][0], expected[1], rtol=0, atol=atol)


PULSES = [(0.3, 0.9, 350.0, -200.0, 100.0), (0.7, 1.4, -120.0, 90.0, -60.0)]


def as_pulses(frames):
    return tuple(
        Pulse(start_s=a, duration_s=b - a, force_x_n=x, force_y_n=y, moment_nm=n, frame=frame)
        for (a, b, x, y, n), frame in zip(PULSES, frames, strict=True)
    )


@pytest.mark.parametrize("frames", [("body", "body"), ("earth", "earth"), ("body", "earth")])
@pytest.mark.parametrize("current", [None, (0.3, 2.0)])
def test_pulses(fly, frames, current, vast_sea, exact):
    pulses = [(*numbers, frame == "earth") for numbers, frame in zip(PULSES, frames, strict=True)]
    sea = {"pulses": as_pulses(frames)}
    flow = (0.0, 0.0)
    if current:
        sea["current"] = Current(speed_mps=current[0], direction_rad=current[1])
        flow = (current[0] * math.cos(current[1]), current[0] * math.sin(current[1]))
    flight = fly(vast_sea(**sea), **START)
    for steps in (10, 10, 20):
        state = flight.step(ACTION, steps)
        assert_agrees(state, exact(state["time_s"][0], FORCE, pulses, flow), 1e-7)


def test_pulse_with_edges_off_the_grid(fly, vast_sea, exact):
    # Between the steps its edges fall in, the mean force over a step is the force itself.
    pulse = Pulse(start_s=0.3021, duration_s=0.5043, force_x_n=100.0, force_y_n=-80.0, moment_nm=40.0)
    state = fly(vast_sea(pulses=(pulse,)), **START).step(ACTION, 40)
    assert_agrees(state, exact(2.0, FORCE, [(0.3021, 0.8064, 100.0, -80.0, 40.0, False)]), 1e-5)


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
def test_impulse_is_exact(fly, start, duration, frame, vast_sea):
    pulse = Pulse(start_s=start, duration_s=duration, force_x_n=350.0, force_y_n=-210.0, moment_nm=0.0, frame=frame)
    vehicle = Vehicle(coriolis=False, **UNDAMPED)
    yaw = 0.7
    scenario = vast_sea(periods=20, vehicle=vehicle, pulses=(pulse,))
    state = fly(scenario, pose=(0, 0, yaw), velocity=(0, 0, 0)).step(0.0, 10)
    x, y = 350.0 * duration, -210.0 * duration
    if frame == "earth":
        x, y = math.cos(yaw) * x + math.sin(yaw) * y, math.cos(yaw) * y - math.sin(yaw) * x
    np.testing.assert_allclose(state["velocity"][0], [x / 100.0, y / 250.0, 0.0], rtol=1e-11, atol=1e-15)


def test_angular_impulse_is_exact(fly, vast_sea):
    pulse = Pulse(start_s=0.0123, duration_s=0.0517, force_x_n=0.0, force_y_n=0.0, moment_nm=80.0)
    flight = fly(vast_sea(periods=20, vehicle=Vehicle(**UNDAMPED), pulses=(pulse,)), pose=(0, 0, 0), velocity=(0, 0, 0))
    np.testing.assert_allclose(flight.step(0.0, 2)["velocity"][0], [0.0, 0.0, 0.0517], rtol=1e-11)


def test_pulse_touches_only_its_own_lane(fly, vast_sea):
    pulse = Pulse(start_s=(0.0, 0.4), duration_s=0.1)
    flight = fly(vast_sea(pulses=(pulse,)), 40, pose=(0, 0, 0), velocity=(0, 0, 0))
    start = flight.fleet.drawn()["sea.pulses[0].start_s"]
    state = flight.step(0.0, 4)
    moved = np.abs(state["velocity"]).max(axis=1) > 0.0
    assert 0 < moved.sum() < 40
    np.testing.assert_array_equal(moved, start < 0.2)


def test_pulse_in_earth_frame_pushes_along_x(fly, below_a_still_ship):
    pulse = Pulse(start_s=0.0, duration_s=0.5, force_x_n=300.0, force_y_n=0.0, moment_nm=0.0, frame="earth")
    state = fly(below_a_still_ship(sea=Sea(pulses=(pulse,))), pose=(0, 0, 1.0), velocity=(0, 0, 0)).step()
    surge, sway, _ = state["velocity"][0]
    # The push along x is seen from a body turned by 1 rad.
    assert surge > 0.0
    assert sway < 0.0
