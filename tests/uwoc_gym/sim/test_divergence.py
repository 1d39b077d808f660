"""What the integrator can't follow: refused where it is seen beforehand, ended with finite values where it isn't."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest

import uwoc_gym
from uwoc_gym import Scenario
from uwoc_gym.sb3 import TrackingVecEnv
from uwoc_gym.world.auv.limits import Motion

FULL = np.ones(3, np.float32)


@pytest.fixture
def unchecked(monkeypatch):
    """Scenarios that can't be integrated are accepted."""
    monkeypatch.setattr("uwoc_gym.world.auv.limits.Motion.longest_step", lambda motion, rate: math.inf)
    monkeypatch.setattr("uwoc_gym.scenario.FASTEST", math.inf)
    return Scenario().merged({"vehicle": {"damping_scale": 100.0}, "episode": {"integration_step_s": 0.05}})


def assert_finite(values):
    for each in values.values() if isinstance(values, dict) else values:
        if isinstance(each, dict):
            assert_finite(each)
        elif np.asarray(each).dtype.kind == "f":
            assert np.isfinite(each).all()


def test_a_diverged_episode_ends_with_finite_values(unchecked):
    env = uwoc_gym.TrackingEnv(unchecked)
    env.reset(seed=0)
    for _ in range(1000):
        observation, reward, terminated, truncated, info = env.step(FULL)
        assert env.observation_space.contains(observation)
        assert_finite([reward])
        assert_finite(info)
        if terminated:
            break
        assert "diverged" not in info
    assert terminated
    assert not truncated
    assert info["diverged"] is True
    assert reward < 0.2
    assert not info["is_success"]
    assert_finite(env.state())
    env.reset(seed=0, options={"scenario": {"episode": {"integration_step_s": 0.0005}}})
    assert "diverged" not in env.step(FULL)[4]


@pytest.mark.parametrize("mode", list(gym.vector.AutoresetMode))
def test_lanes_that_diverge_say_so_and_leave_the_others_alone(unchecked, mode):
    calm = Scenario().merged({"vehicle": {"damping_scale": (1.0, 100.0)}, "episode": {"integration_step_s": 0.05}})
    env = uwoc_gym.TrackingVectorEnv(3, calm, autoreset_mode=mode)
    alone = uwoc_gym.TrackingEnv(calm)
    scales = np.array([1.0, 100.0, 1.0])
    env.reset(seed=0, options={"parameters": {"vehicle.damping_scale": scales}})
    expected, _ = alone.reset(seed=2, options={"parameters": {"vehicle.damping_scale": 1.0}})
    for _ in range(1000):
        observations, rewards, terminated, _, infos = env.step(np.tile(FULL, (3, 1)))
        expected = alone.step(FULL)[0]
        np.testing.assert_array_equal(observations[2], expected)
        assert_finite([observations, rewards])
        assert_finite(infos)
        if terminated.any():
            break
    own = infos["final_info"] if mode is gym.vector.AutoresetMode.SAME_STEP else infos
    np.testing.assert_array_equal(terminated, [False, True, False])
    np.testing.assert_array_equal(own["diverged"], [False, True, False])
    np.testing.assert_array_equal(own["_diverged"], [False, True, False])


def test_sb3_sees_it_too(unchecked):
    env = TrackingVecEnv("uwoc/Nominal-v0", 2, scenario=unchecked)
    env.reset()
    for _ in range(1000):
        observations, rewards, dones, infos = env.step(np.tile(FULL, (2, 1)))
        assert_finite([observations, rewards])
        if dones.any():
            break
    assert infos[0]["diverged"]
    assert not infos[0]["TimeLimit.truncated"]
    assert np.isfinite(infos[0]["terminal_observation"]).all()


def test_a_later_end_is_no_divergence(unchecked):
    env = uwoc_gym.TrackingEnv(unchecked)
    env.reset(seed=0)
    while not env.step(FULL)[2]:
        pass
    short = {"scenario": {"vehicle": {"damping_scale": 1.0}, "episode": {"duration_s": 0.1}}}
    env.reset(seed=0, options=short)
    env.step(FULL)
    assert "diverged" not in env.step(FULL)[4]


@pytest.mark.parametrize("velocity", [(500.0, 0.0, 0.0), (0.0, 0.0, -300.0), (0.0, 5e6, 0.0)])
def test_velocities_that_cannot_be_followed_are_refused(velocity):
    for make in (uwoc_gym.TrackingEnv, lambda: uwoc_gym.TrackingVectorEnv(3)):
        env = make()
        env.reset(seed=0)
        before = env.snapshot()
        with pytest.raises(
            ValueError, match=r"options\['velocity'\] = .* doesn't follow in steps of 0.005 s; .* at most"
        ):
            env.reset(options={"velocity": velocity})
        assert (env.snapshot() == before).all()
        env.reset(options={"velocity": (2.0, -1.0, 0.5)})


def test_pushes_that_cannot_be_followed_are_refused():
    env = uwoc_gym.TrackingEnv()
    env.reset(seed=0)
    before = env.snapshot()
    with pytest.raises(ValueError, match=r"impulse = \(1000000000.0, 0, 0\) is not allowed: at \[10000000.0"):
        env.push((1e9, 0, 0))
    assert (env.snapshot() == before).all()
    env.push((100.0, 0, 0))
    assert env.state()["velocity"][0] == 1.0


@pytest.mark.parametrize("option", ["pose", "velocity"])
def test_places_beyond_the_world_are_refused(option):
    env = uwoc_gym.TrackingEnv()
    with pytest.raises(ValueError, match=rf"options\['{option}'\] = .* within \[-1e\+07, 1e\+07\]"):
        env.reset(seed=0, options={option: (1e8, 0.0, 0.0)})


def test_motion_is_as_fast_as_forces_damping_and_time_allow():
    vehicle = Scenario().vehicle.merged({"coriolis": False})
    force = vehicle.force_limits
    motion = Motion(vehicle, force, np.zeros(3), 150.0)
    np.testing.assert_allclose(vehicle.damping(motion.velocity) * motion.velocity, force, rtol=1e-12)
    free = vehicle.merged({"damping_scale": 0.0})
    np.testing.assert_allclose(Motion(free, force, np.ones(3), 2.0).velocity, 1.0 + 2.0 * force / vehicle.inertia)


def test_coriolis_terms_carry_motion_over_but_add_no_energy():
    plain, coupled = (
        Motion(Scenario().vehicle.merged({"coriolis": on}), np.array([2e3, 2e3, 5e2]), np.zeros(3), 150.0)
        for on in (False, True)
    )
    assert (coupled.velocity > plain.velocity).all()
    free = Scenario().vehicle.merged({"damping_scale": 0.0})
    begun = np.array([3.0, 2.0, 1.0])
    energy = (free.inertia * begun**2).sum()
    assert (free.inertia * Motion(free, np.zeros(3), begun, 150.0).velocity ** 2 <= energy * (1.0 + 1e-12)).all()


def test_the_rate_bounds_the_jacobian_of_the_equation_of_motion():
    vehicle = Scenario().vehicle.merged({"damping_scale": 0.7, "mass_scale": 1.3})
    roots = np.sqrt(vehicle.inertia)
    generator = np.random.default_rng(0)
    motion = Motion(vehicle, vehicle.force_limits, np.zeros(3), 150.0)
    for velocity in generator.uniform(-5.0, 5.0, (100, 3)):
        columns = [
            (vehicle.acceleration(velocity + own, 0.0) - vehicle.acceleration(velocity - own, 0.0)) / 2e-6
            for own in 1e-6 * np.eye(3)
        ]
        jacobian = roots[:, None] * np.array(columns).T / roots
        assert np.abs(np.linalg.eigvals(jacobian)).max() <= motion.rate_at(velocity) * (1.0 + 1e-6)
