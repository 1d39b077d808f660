"""The planners: what they plan on, that nothing but the step decides their draws, and that planning pays."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym import Scenario, SettingError, TrackingVectorEnv
from uwoc_gym.agents.flight import fly
from uwoc_gym.baselines.controllers import CONTROLLERS, Tuned
from uwoc_gym.baselines.planner import Clairvoyant, Planner, PlannerSettings

TIDE = Scenario.named("Tide")
QUICK = PlannerSettings(candidates=24.0, rounds=2.0, horizon_s=2.0)
SHORT = {"episode.duration_s": 3.0}


@pytest.mark.parametrize("world", ["Tide", "Underactuated", "LateFix"])
@pytest.mark.parametrize("law", ["mppi", "clairvoyant"])
def test_a_lane_is_flown_alike_in_every_batch(world: str, law: str) -> None:
    scenario = Scenario.named(world).merged(SHORT)
    policy = Tuned(law, QUICK).policy(law)
    together = fly(policy, scenario, range(5)).record
    alone = fly(policy, scenario, [3]).record
    np.testing.assert_array_equal(together.pose[:, 3], alone.pose[:, 0])


def test_a_lane_that_begins_anew_forgets() -> None:
    """Two episodes one after the other are those that each would be by itself."""
    policy = Planner(QUICK, TIDE.known())
    env = TrackingVectorEnv(2, TIDE)
    observation, _ = env.reset(seed=[4, 5])
    first, memory = policy.predict(observation)
    moved, *_ = env.step(first)
    _, memory = policy.predict(moved, memory, np.zeros(2, dtype=bool))
    mixed = np.stack([observation[0], moved[1]])
    again, memory = policy.predict(mixed, memory, np.array([True, False]))
    np.testing.assert_array_equal(again[0], first[0])
    alone, _ = policy.predict(observation[0])
    assert alone.shape == (3,)
    np.testing.assert_array_equal(alone, first[0])


def test_a_plan_never_gets_worse_where_the_model_is_true() -> None:
    """Without anything that the model doesn't know, more rounds only help."""
    scenario = TIDE.known().merged({"start": {"x_m": 3.0, "y_m": -2.0, "relative_to_ship": True}, **SHORT})
    found = [
        fly(Tuned("clairvoyant", QUICK.merged({"rounds": rounds})).policy("c"), scenario, [0]).metrics.return_[0]
        for rounds in (1.0, 2.0, 8.0)
    ]
    assert found[0] < found[2]
    assert found[1] < found[2] + 0.5


def test_the_planner_believes_what_is_seen() -> None:
    """Its model, flown from the belief, goes where the AUV goes under the same actions."""
    scenario = TIDE.merged(
        {
            "vehicle": {"mass_scale": 1.0, "damping_scale": 1.0},
            "sea": {"pulses": [], "current": {"std_mps": 0.0}},
            "sensors": {"position_std_m": 0.0, "yaw_std_rad": 0.0, "velocity_std_mps": 0.0, "yaw_rate_std_rad_s": 0.0},
            "ship": {"kind": "circle", "radius_m": 8.0, "speed_mps": 0.6},
        }
    )
    planner = Planner(QUICK, scenario.known())
    env = TrackingVectorEnv(3, scenario)
    observation, _ = env.reset(seed=[0, 1, 2])
    state = env.state()
    # The true current, as a filter will know it after a while.
    seen, _ = planner.look(observation, None, np.ones(3, dtype=bool))
    yaw = state["pose"][:, 2]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    x, y = state["current"].T
    seen = seen._replace(water_velocity=np.column_stack([cosine * x + sine * y, cosine * y - sine * x]))
    fleet, rows = planner.roots(seen, np.arange(3))
    actions = np.tile(np.float32([0.6, -0.2, 0.3]), (3, 30, 1))
    believed = fleet.rollout(rows, actions)
    total = np.zeros(3)
    for step in range(30):
        _, reward, *_ = env.step(actions[:, step])
        total += reward
    np.testing.assert_allclose(believed.returns, total, rtol=2e-4)


def test_planning_pays() -> None:
    seeds = range(100_000, 100_006)
    planned, guided = (
        fly(CONTROLLERS[name], TIDE.merged({"episode.duration_s": 20.0}), seeds).metrics.return_.mean()
        for name in ("mppi", "los@Tide")
    )
    assert planned > guided


def test_a_clairvoyant_needs_to_be_shown_the_environment() -> None:
    policy = Clairvoyant(QUICK, TIDE.known())
    with pytest.raises(RuntimeError, match=r"give it the environment by watch\(env\)"):
        policy.predict(np.zeros((1, TIDE.observation.size), np.float32))


def test_a_clairvoyant_sees_what_is_to_come() -> None:
    """It leans against a pulse before that begins, which nobody else can know of."""
    calm = {"episode.duration_s": 6.0, "sea.current.std_mps": 0.0}
    pulse = {"start_s": 3.0, "duration_s": 1.0, "force_x_n": 1500.0, "force_y_n": 0.0, "moment_nm": 0.0}
    scenario = TIDE.merged({**calm, "sea.pulses": [{**pulse, "frame": "earth"}]})
    still = TIDE.merged({**calm, "sea.pulses": [{**pulse, "force_x_n": 0.0, "frame": "earth"}]})
    for law, differs in (("clairvoyant", True), ("mppi", False)):
        policy = Tuned(law, QUICK).policy(law)
        one, other = (fly(policy, each, [7]).record.force[:58] for each in (scenario, still))
        assert (np.abs(one - other).max() > 1.0) == differs


def test_what_a_planner_needs_is_named() -> None:
    blind = TIDE.merged({"observation.groups": ["velocity", "heading"]})
    with pytest.raises(SettingError, match="needs the observation group 'ship'"):
        Planner(scenario=blind)
    with pytest.raises(SettingError, match="horizon_s"):
        PlannerSettings(horizon_s=0.0)
