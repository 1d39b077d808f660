"""The fleet as something to plan on: snapshots, beliefs, rollouts, and what a policy's maker knows."""

from __future__ import annotations

import pickle

import gymnasium as gym
import numpy as np
import pytest

import uwoc_gym
from uwoc_gym import CarriedOnPath, Fleet, PaperPath, Pulse, Scenario, Sea, SettingError, StraightPath
from uwoc_gym.sim.fleet import Autoreset
from uwoc_gym.sim.layout import FLAGS, MEASURE_NAMES

RANDOM = Scenario.named("Random")
ACTIONS = np.random.default_rng(5).uniform(-1.2, 1.2, (80, 40, 3)).astype(np.float32)


def go_on(flight, lanes, actions):
    """What a flight writes in further steps, and where it ends."""
    seen = []
    for action in actions:
        flight.step(action)
        seen.append([flight.observations[lanes].copy(), flight.out[:, lanes].copy(), flight.flags[:, lanes].copy()])
    state = {name: values[lanes] for name, values in flight.fleet.state().items()}
    return [np.array(each) for each in zip(*seen, strict=True)], state


@pytest.mark.parametrize("autoreset", [Autoreset.NEXT_STEP, Autoreset.SAME_STEP])
def test_a_restored_simulation_goes_on_bit_for_bit(fly, autoreset):
    # Through several ends: what a lane is going to draw is part of its state.
    flight = fly(RANDOM, 40, autoreset=autoreset, max_episode_steps=25)
    go_on(flight, [0], ACTIONS[:12])
    rows = pickle.loads(pickle.dumps(flight.fleet.snapshot([3, 35, 7])))
    actions = ACTIONS[12:]
    expected = go_on(flight, [3, 35, 7], actions)

    lanes = [39, 0, 11]
    other = fly(RANDOM, 40, seed=900, autoreset=autoreset, max_episode_steps=25)
    go_on(other, [0], ACTIONS[:5])
    bystander = other.fleet.snapshot(5)
    other.fleet.restore(rows, lanes)
    assert other.fleet.snapshot(5) == bystander
    moved = actions.copy()
    moved[:, lanes] = actions[:, [3, 35, 7]]
    np.testing.assert_equal(go_on(other, lanes, moved), expected)


def test_one_snapshot_for_many_and_for_a_fleet_without_seeds(fly):
    flight = fly(RANDOM, 5)
    flight.step(0.3, 10)
    fleet = Fleet(RANDOM, 33)
    fleet.restore(flight.fleet.snapshot(2))
    for name, values in fleet.state().items():
        expected = flight.fleet.state()[name][2]
        np.testing.assert_array_equal(values, np.broadcast_to(expected, values.shape), err_msg=name)
    np.testing.assert_array_equal(fleet.observe(), np.broadcast_to(flight.observations[2], (33, 20)))
    np.testing.assert_equal(
        {k: v[8] for k, v in fleet.drawn().items()}, {k: v[2] for k, v in flight.fleet.drawn().items()}
    )


def test_a_snapshot_is_read_by_name(fly):
    flight = fly(RANDOM, 3)
    flight.step(0.5, 3)
    rows = flight.fleet.snapshot()
    np.testing.assert_array_equal(rows["auv"]["x"], flight.fleet.state()["pose"][:, 0])
    np.testing.assert_array_equal(rows["observed"]["ship"].astype(np.float32), flight.observations[:, :7])
    np.testing.assert_array_equal(rows["pulses"]["pulse_1"]["start_s"], flight.fleet.drawn()["sea.pulses[1].start_s"])


def test_other_layouts_and_lanes_are_refused(fly):
    fleet = fly(RANDOM, 4).fleet
    before = fleet.snapshot()
    pulsed = fly(Scenario(sea=Sea(pulses=[Pulse()])), 4).fleet.snapshot()
    for rows, lanes, message in (
        (pulsed, None, "rows are not of this fleet's layout; .* 2 pulses"),
        (np.zeros((4, 9)), None, "rows are not of this fleet's layout"),
        (before[:3], None, r"rows have shape \(3,\); it must be \(1,\) or \(4,\)"),
        (before[:2], [1, 9], r"lanes = \[1, 9\] is not allowed; it must be whole numbers from 0 to 3"),
        (before[:2], [0.5, 1.0], "lanes = .* is not allowed"),
    ):
        with pytest.raises(ValueError, match=message):
            fleet.restore(rows, lanes)
        assert (fleet.snapshot() == before).all()


def test_states_of_another_scenario_are_refused(fly):
    fleet = fly(Scenario(), 2).fleet
    before = fleet.snapshot()
    for overrides in (
        {"vehicle": {"max_surge_force_n": 100.0}},
        {"reward": {"effort": 0.1}},
        {"ship": {"kind": "random"}},
        {"sensors": {"position_std_m": 1.0}},
    ):
        rows = fly(Scenario().merged(overrides), 2).fleet.snapshot()
        for use in (fleet.restore, lambda rows: fleet.rollout(rows, np.zeros((2, 3, 3)))):
            with pytest.raises(ValueError, match=r"rows are of another scenario; .* all of this one's settings"):
                use(rows)
        assert (fleet.snapshot() == before).all()


def test_the_state_of_an_episode_with_options_is_refused_later():
    env = uwoc_gym.TrackingEnv()
    env.reset(seed=0, options={"scenario": {"vehicle": {"max_surge_force_n": 100.0}}})
    rows = env.snapshot()
    np.testing.assert_array_equal(env.restore(rows), env.unwrapped.restore(rows))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="rows are of another scenario"):
        env.restore(rows)


def test_a_believed_current_goes_with_the_state(fly):
    here, there = (fly(Scenario().known(), 1).fleet for _ in range(2))
    still = {"pose": np.zeros(3), "velocity": np.zeros(3), "ship_pose": np.zeros(3), "ship_velocity": np.zeros(3)}
    here.believe(**still, current=(0.5, 0.0))
    rows = here.snapshot()
    actions = np.zeros((1, 40, 3))
    drifted = here.rollout(rows, actions).last_distance_m
    assert drifted > 0.5
    assert there.rollout(rows, actions).last_distance_m == drifted
    third = fly(Scenario().known(), 1).fleet
    third.restore(rows)
    assert third.rollout(third.snapshot(), actions).last_distance_m == drifted
    # A rollout lets what its rows believe flow; so does what is restored, without one.
    fourth = fly(Scenario().known(), 1)
    fourth.fleet.restore(rows)
    state = fourth.step(0.0, 40)
    assert np.hypot(*(state["ship_pose"] - state["pose"])[0, :2]) == pytest.approx(drifted[0], rel=1e-12)


@pytest.mark.parametrize("used_before", [False, True])
def test_episodes_after_a_restored_one_are_those_of_the_snapshot(used_before):
    env, other = (gym.make("uwoc/Random-v0").unwrapped for _ in range(2))
    env.reset(seed=4)
    rows = env.snapshot()
    expected = [env.reset()[0] for _ in range(2)]
    if used_before:
        other.reset(seed=9)
    other.restore(rows)
    np.testing.assert_array_equal([other.reset()[0] for _ in range(2)], expected)
    vector, again = (uwoc_gym.TrackingVectorEnv(3, "Random") for _ in range(2))
    vector.reset(seed=4)
    rows = vector.snapshot()
    if used_before:
        again.reset(seed=9)
    again.restore(rows)
    np.testing.assert_array_equal(again.reset()[0], vector.reset()[0])


def test_restoring_one_environment_leaves_the_others_to_be_seeded():
    vector = uwoc_gym.TrackingVectorEnv(3, "Random")
    env = gym.make("uwoc/Random-v0").unwrapped
    env.reset(seed=4)
    vector.restore(env.snapshot(), [1])
    assert np.isfinite(vector.reset()[0]).all()


def test_environments_have_snapshots_too():
    env = gym.make("uwoc/Random-v0").unwrapped
    observation, _ = env.reset(seed=4)
    for action in ACTIONS[:20, 0]:
        observation, *_ = env.step(action)
    rows = env.snapshot()
    expected = [env.step(action) for action in ACTIONS[20:50, 0]]
    np.testing.assert_array_equal(env.restore(rows), observation)
    np.testing.assert_equal([env.step(action) for action in ACTIONS[20:50, 0]], expected)
    other = gym.make("uwoc/Random-v0").unwrapped
    np.testing.assert_array_equal(other.restore(rows), observation)
    np.testing.assert_equal(other.step(ACTIONS[20, 0]), expected[0])
    vector = uwoc_gym.TrackingVectorEnv(3, "Random")
    np.testing.assert_array_equal(vector.restore(rows), np.broadcast_to(observation, (3, 20)))
    np.testing.assert_array_equal(vector.step(ACTIONS[[20] * 3, 0])[0], np.broadcast_to(expected[0][0], (3, 20)))
    assert (vector.snapshot([2, 0]) == vector.snapshot(1)).all()


def test_an_ended_episode_stays_ended_when_restored():
    env = gym.make("uwoc/Nominal-v0", scenario={"episode": {"duration_s": 0.1}}).unwrapped
    env.reset(seed=0)
    before = env.snapshot()
    env.step(ACTIONS[0, 0])
    env.step(ACTIONS[0, 0])
    ended = env.snapshot()
    env.restore(before)
    env.step(ACTIONS[0, 0])
    env.restore(ended)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(ACTIONS[0, 0])


def test_what_is_known_is_nothing_of_the_truth():
    known = RANDOM.known()
    assert known.vehicle == RANDOM.vehicle.nominal()
    assert not known.sea.pulses
    assert all(value == 0.0 for _, value in known.sensors.numbers())
    assert known.ship == CarriedOnPath()
    assert (known.observation, known.reward, known.episode) == (RANDOM.observation, RANDOM.reward, RANDOM.episode)
    assert known == RANDOM.merged({"vehicle": {"mass_scale": 1.1}, "sea": {"pulses": []}}).known()
    assert known == known.known()
    assert RANDOM.known(integration_step_s=0.05).episode.substeps == 1
    with pytest.raises(SettingError, match=r"control_period_s = 0\.05"):
        RANDOM.known(integration_step_s=0.03)


@pytest.mark.parametrize("path", [PaperPath(), StraightPath(x_m=3.0, course_rad=0.4), PaperPath(rate_rad_s=-0.07)])
@pytest.mark.parametrize("moment", [0.0, 7.35])
def test_a_motion_that_does_not_change_its_turn_is_carried_on(path, moment):
    at = path.at(moment)
    (x, y, yaw), (vx, vy, yaw_rate), (ax, ay, _) = at.pose[0], at.velocity[0], at.acceleration[0]
    carried = CarriedOnPath(
        x_m=x, y_m=y, course_rad=np.arctan2(vy, vx), speed_mps=np.hypot(vx, vy),
        turn_rad_s=(vx * ay - vy * ax) / (vx**2 + vy**2), yaw_rad=yaw, yaw_rate_rad_s=yaw_rate, moment_s=moment,
    )  # fmt: skip
    times = np.linspace(0.0, 60.0, 50)
    expected, found = path.at(times), carried.at(times)
    for attribute in ("pose", "velocity", "acceleration"):
        # The paper's heading swings, which carrying on can't know.
        np.testing.assert_allclose(getattr(found, attribute)[:, :2], getattr(expected, attribute)[:, :2], atol=1e-9)
    np.testing.assert_allclose(found.pose[:, 2], yaw + yaw_rate * (times - moment), atol=1e-12)


def test_a_true_belief_flies_as_the_truth_does(fly):
    """The nominal plant in a steady current, below a ship that sails straight on."""
    truth = Scenario(ship=StraightPath(course_rad=0.3, speed_mps=0.8)).merged(
        {"sea": {"current": {"speed_mps": 0.4, "direction_rad": 2.0}}, "episode": {"lost_distance_m": 1e3}}
    )
    flight = fly(truth, 3, pose=(1.0, 0.5, 0.2), velocity=(0.3, 0.1, 0.0))
    for action in ACTIONS[:30]:
        flight.step(action[:3])
    state = flight.fleet.state()
    believed = Fleet(truth.known(), 3)
    believed.believe(
        pose=state["pose"], velocity=state["velocity"], ship_pose=state["ship_pose"],
        ship_velocity=state["ship_velocity"], current=state["current"], time_s=state["time_s"][0],
    )  # fmt: skip
    arrays = [np.zeros((3, 20), np.float32), np.zeros((len(MEASURE_NAMES), 3)), np.zeros((len(FLAGS), 3), bool)]
    for action in ACTIONS[30:]:
        flight.step(action[:3])
        believed.step(np.ascontiguousarray(action[:3]), *arrays)
    for name, values in flight.fleet.state().items():
        np.testing.assert_allclose(believed.state()[name], values, rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(arrays[0], flight.observations, atol=1e-6)


def test_beliefs_differ_by_simulation_and_leave_others_alone(fly):
    fleet = Fleet(RANDOM.known(), 3)
    common = {"velocity": (0, 0, 0), "ship_pose": (0, 0, 0), "ship_velocity": (1.0, 0, 0)}
    fleet.believe(pose=[(1, 2, 3), (4, 5, 6), (7, 8, 9)], ship_turn_rad_s=[0.0, 0.1, -0.1], **common)
    np.testing.assert_array_equal(fleet.state()["pose"], [(1, 2, 3), (4, 5, 6), (7, 8, 9)])
    np.testing.assert_allclose(fleet.state()["ship_acceleration"][:, 1], [0.0, 0.1, -0.1], atol=1e-15)
    fleet.believe([1], pose=(0, 0, 0), **common)
    np.testing.assert_array_equal(fleet.state()["pose"], [(1, 2, 3), (0, 0, 0), (7, 8, 9)])
    before = fleet.snapshot()
    for wrong, message in (
        ({"pose": (1, 2)}, r"pose = \(1, 2\) is not allowed; .* \(3,\) or \(3, 3\)"),
        ({"pose": (1, 2, np.nan)}, "pose = .* finite"),
        ({"pose": (0, 0, 0), "current": (1, 2, 3)}, r"current = .* \(2,\)"),
        ({"pose": (0, 0, 0), "time_s": -1.0}, "time_s = -1.0 is not allowed"),
    ):
        with pytest.raises(ValueError, match=message):
            fleet.believe(**common, **wrong)
        assert (fleet.snapshot() == before).all()


@pytest.mark.parametrize("count", [1, 40, 64])
def test_a_rollout_is_the_fleet_step_by_step(fly, count):
    scenario = RANDOM.merged({"episode": {"lost_distance_m": 9.0}})
    flight = fly(scenario, count, seed=3)
    flight.step(0.1, 10)
    rows = flight.fleet.snapshot()
    actions = np.random.default_rng(1).uniform(-1.3, 1.3, (count, 60, 3)).astype(np.float32)
    # Some are driven off until they are lost.
    actions[::3, :, 0] = 1.0
    found = flight.fleet.rollout(rows, actions)
    assert (flight.fleet.snapshot() == rows).all()

    returns, last, distance, linked = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count, int)
    alive = np.ones(count, bool)
    for action in actions.transpose(1, 0, 2):
        # Ended lanes are put back in the air, where nobody looks at them.
        flight.fleet.restore(rows[~alive], np.flatnonzero(~alive))
        state = flight.step(action)
        measures = flight.measures()
        returns += np.where(alive, measures["reward"], 0.0)
        last = np.where(alive, measures["reward"], last)
        gap = np.hypot(*(state["pose"] - state["ship_pose"])[:, :2].T)
        distance = np.where(alive, gap, distance)
        linked += alive & (measures["in_cone"] > 0.0)
        alive &= measures["terminated"] == 0.0
    assert count == 1 or 0 < alive.sum() < count
    np.testing.assert_array_equal(found.returns, returns)
    np.testing.assert_array_equal(found.last_reward, last)
    np.testing.assert_allclose(found.last_distance_m, distance, rtol=1e-14)
    np.testing.assert_array_equal(found.steps_in_link, linked)


def test_a_rollout_from_one_state_is_that_from_each(fly):
    fleet = fly(RANDOM, 1, seed=8).fleet
    actions = np.random.default_rng(2).uniform(-1, 1, (35, 20, 3))
    one = fleet.rollout(fleet.snapshot(), actions)
    many = fleet.rollout(np.repeat(fleet.snapshot(), 35), actions)
    np.testing.assert_array_equal(one, many)
    assert len(np.unique(one.returns)) == 35


def test_rollouts_refuse_what_they_cannot_fly(fly):
    fleet = fly(RANDOM, 2).fleet
    rows = fleet.snapshot()
    for actions, message in (
        (np.zeros((2, 3)), r"actions = array.* are not allowed; .*\(K, H, 3\)"),
        (np.zeros((2, 5, 2)), r"an array of shape \(2, 5, 2\)"),
        (np.full((2, 5, 3), np.nan), "finite"),
        ("up", "finite"),
    ):
        with pytest.raises(ValueError, match=message):
            fleet.rollout(rows, actions)
    with pytest.raises(ValueError, match=r"rows have shape \(2,\); it must be \(1,\) or \(5,\)"):
        fleet.rollout(rows, np.zeros((5, 4, 3)))


@pytest.mark.parametrize(("field", "value"), [("segments", 4.0), ("first_segment", -1.0), ("segments", np.nan)])
def test_rows_that_lead_out_of_the_memory_are_refused(field, value):
    """A recorded path of four points has three segments, and compiled code reads where a row says."""
    times = [0.0, 50.0, 100.0, 150.0]
    path = {"kind": "recorded", "time_s": times, "x_m": times, "y_m": [0.0] * 4}
    fleet = Fleet(Scenario.named("Nominal").merged({"ship": path}), 2)
    fleet.seed(np.arange(2), [0, 1])
    fleet.reset(np.empty((2, fleet.scenario.observation.size), dtype=np.float32))
    rows = fleet.snapshot()
    fleet.restore(rows)
    damaged = rows.copy()
    damaged["drawn"]["ship"][field][1] = value
    with pytest.raises(ValueError, match=r"^rows are damaged: they have a ship on a path that this fleet doesn't know"):
        fleet.restore(damaged)
    np.testing.assert_array_equal(fleet.snapshot(), rows)
