"""Actions of actuators that have a force, have none, or draw it."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym import Scenario, TrackingEnv, TrackingVectorEnv, unpack

AXES = {"max_surge_force_n": 0, "max_sway_force_n": 1, "max_yaw_moment_nm": 2}


@pytest.mark.parametrize(("limit", "axis"), AXES.items())
def test_an_actuator_without_force_neither_acts_nor_costs(limit: str, axis: int) -> None:
    scenario = Scenario().merged({f"vehicle.{limit}": 0.0})
    found = []
    action = np.array([0.3, -0.4, 0.5], np.float32)
    silent = action.copy()
    silent[axis] = 0.0
    for each in (action, silent):
        env = TrackingEnv(scenario)
        env.reset(seed=0)
        observation, reward, _, _, info = env.step(each)
        found.append((observation, reward))
        # The mean square of those that have a force.
        assert info["reward_effort"] == pytest.approx(-0.05 * float((silent**2).sum()) / 2.0)
        assert env.state()["force"][axis] == 0.0
        last = unpack(observation).last_action
        assert last is not None
        np.testing.assert_array_equal(last, silent)
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1]


def test_without_any_force_nothing_costs() -> None:
    env = TrackingEnv(Scenario().merged({f"vehicle.{limit}": 0.0 for limit in AXES}))
    env.reset(seed=0)
    _, _, _, _, info = env.step(np.ones(3, np.float32))
    assert info["reward_effort"] == 0.0


def test_limits_are_drawn() -> None:
    env = TrackingVectorEnv(64, Scenario().merged({f"vehicle.{limit}": (50.0, 400.0) for limit in AXES}))
    env.reset(seed=0)
    env.step(np.full((64, 3), 0.5, np.float32))
    drawn, force = env.parameters(), env.state()["force"]
    for limit, axis in AXES.items():
        np.testing.assert_allclose(force[:, axis], 0.5 * drawn[f"vehicle.{limit}"], rtol=1e-12)
        assert np.ptp(drawn[f"vehicle.{limit}"]) > 200.0
