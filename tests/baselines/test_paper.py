"""The functions of the paper's stability proof."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from uwoc_gym import Scenario
from uwoc_gym.baselines import gains
from uwoc_gym.baselines.controller import gain
from uwoc_gym.baselines.paper import damping_and_gain, inequality_matrix, lyapunov, sampled_as_published

VEHICLE = Scenario().vehicle
ZERO = np.zeros(3)


@given(st.floats(-4.0, 4.0), st.sampled_from(["pd", "nlpd"]), st.integers(0, 2))
def test_potential_is_the_integral_of_the_pull(size, name, axis):
    law = gains(name)
    error = np.zeros(3)
    error[axis] = size
    a, b, mu = law.a_p[axis], law.b_p[axis], law.mu_p[axis]
    expected, _ = quad(lambda z: z * gain(z, a, b, mu), 0.0, size, points=[np.clip(b, 0, abs(size)) * np.sign(size)])
    assert lyapunov(error, ZERO, 0.0, law, VEHICLE) == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(st.floats(-3.0, 3.0))
def test_kinetic_part_is_the_same_seen_from_any_heading(yaw):
    body = np.array([0.7, -0.4, 0.3])
    earth = np.array(
        [np.cos(yaw) * body[0] - np.sin(yaw) * body[1], np.sin(yaw) * body[0] + np.cos(yaw) * body[1], body[2]]
    )
    expected = 0.5 * (VEHICLE.inertia * body**2).sum()
    assert lyapunov(ZERO, earth, yaw, gains("pd"), VEHICLE) == pytest.approx(expected, rel=1e-12)


def test_inequality_is_definite_just_where_damping_outweighs_the_disturbance():
    resisting = damping_and_gain(ZERO, ZERO, 0.3, gains("pd"), VEHICLE)
    weakest = np.linalg.eigvalsh(resisting)[0]
    limit = 1.0 / np.sqrt(weakest - 1.0)
    assert np.linalg.eigvalsh(inequality_matrix(resisting, 1.001 * limit))[-1] < 0.0
    assert np.linalg.eigvalsh(inequality_matrix(resisting, 0.999 * limit))[-1] > 0.0


def test_damping_turns_with_the_vehicle():
    resisting = damping_and_gain(ZERO, ZERO, np.pi / 2, gains("pd"), VEHICLE)
    np.testing.assert_allclose(resisting, np.diag([350.0, 320.0, 300.0]), atol=1e-9)


def test_sampling_is_the_papers():
    assert sampled_as_published(Scenario()).episode.control_period_s == 0.005
