"""A vast sea to fly in, and where an AUV ends up in it by SciPy's integrator and the paper's equations."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from uwoc_gym import EpisodeSettings, Scenario, Sea, StraightPath, Vehicle

MASSES = (100.0, 250.0, 80.0)
POSE = (1.0, -2.0, 0.4)
VELOCITY = (0.8, -0.3, 0.5)


def _vast_sea(
    period: float = 0.05, step: float = 0.005, vehicle: Vehicle | None = None, periods: int = 400, **sea
) -> Scenario:
    """A vast sea, so that no episode ends."""
    return Scenario(
        ship=StraightPath(speed_mps=0.0),
        vehicle=vehicle or Vehicle(),
        sea=Sea(**sea),
        episode=EpisodeSettings(
            duration_s=period * periods, control_period_s=period, integration_step_s=step, lost_distance_m=1e6
        ),
    )


def _derivative(t, state, body, earth, current, masses, damping_scale, coriolis):
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


def _exact(
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
        result = solve_ivp(_derivative, (begin, finish), state, method="DOP853", rtol=1e-11, atol=1e-13, args=arguments)
        state = result.y[:, -1]
    c, s = math.cos(state[2]), math.sin(state[2])
    return state[:3], np.add(state[3:], (c * cx + s * cy, c * cy - s * cx, 0.0))


@pytest.fixture(scope="session")
def vast_sea():
    """Make a scenario in which no episode ends: period, step, vehicle, and what is in the sea."""
    return _vast_sea


@pytest.fixture(scope="session")
def exact():
    """Pose and velocity of the AUV at a time; see `_exact`."""
    return _exact
