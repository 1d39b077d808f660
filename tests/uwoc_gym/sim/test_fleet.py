from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

from uwoc_gym import (
    SCENARIOS,
    EpisodeSettings,
    OpticalLink,
    PaperPath,
    Pulse,
    Range,
    RewardSettings,
    Scenario,
    Sea,
    StraightPath,
    Vehicle,
)
from uwoc_gym.sim.fleet import Autoreset, Fleet
from uwoc_gym.sim.layout import FLAGS, MEASURE_NAMES
from uwoc_gym.task.action import KINDS

RANDOM = Scenario.named("Random")
LANES = 1024
STEPS = 100
# Steps per episode: every lane ends at least twice in a run.
LENGTH = 40
ACTIONS = np.random.default_rng(7).uniform(-1.2, 1.2, (STEPS, LANES, 3)).astype(np.float32)


def record(fly, autoreset, lanes, threads=1):
    """What a run writes at every step, for lanes whose seeds and actions are fixed by their numbers."""
    lanes = np.asarray(lanes)
    flight = fly(
        RANDOM,
        lanes.size,
        seeds=[1000 + lane for lane in lanes.tolist()],
        autoreset=autoreset,
        max_episode_steps=LENGTH,
        threads=threads,
    )
    written = {"first": [flight.observations.copy()], "observations": [], "out": [], "flags": [], "finals": []}
    for actions in ACTIONS:
        flight.finals[:] = 0.0
        flight.step(actions[lanes])
        for name in ("observations", "out", "flags", "finals"):
            written[name].append(getattr(flight, name).copy())
    flight.fleet.close()
    arrays = {name: np.array(values) for name, values in written.items()}
    # Put the simulations first.
    return {
        name: np.moveaxis(value, 2 if name in ("out", "flags") else 1, 0) for name, value in arrays.items()
    } | flight.fleet.drawn()


RESETS = [Autoreset.NEXT_STEP, Autoreset.SAME_STEP]


@pytest.fixture(scope="module", params=RESETS, ids=["next step", "same step"])
def reference(request, fly):
    return request.param, record(fly, request.param, np.arange(LANES))


@pytest.mark.parametrize("size", [1, 5, 33, 100])
@pytest.mark.parametrize("threads", [1, 2])
def test_batch_size_changes_no_bit(fly, reference, size, threads):
    autoreset, expected = reference
    for name, value in record(fly, autoreset, np.arange(size), threads).items():
        np.testing.assert_array_equal(value, expected[name][:size], err_msg=name)


def test_threads_change_no_bit(fly, reference):
    autoreset, expected = reference
    for threads in (2, 3):
        for name, value in record(fly, autoreset, np.arange(LANES), threads).items():
            np.testing.assert_array_equal(value, expected[name], err_msg=name)


def test_order_changes_no_bit(fly, reference):
    autoreset, expected = reference
    order = np.random.default_rng(3).permutation(LANES)[:300]
    for name, value in record(fly, autoreset, order).items():
        np.testing.assert_array_equal(value, expected[name][order], err_msg=name)


def test_run_crosses_episodes(reference):
    # Guards the tests above: there must be ends, and what is compared must differ between lanes.
    autoreset, run = reference
    truncated = run["out"][:, :, MEASURE_NAMES.index("truncated")]
    assert (truncated.sum(axis=1) >= 2).mean() > 0.9
    assert len(np.unique(run["first"][:, 0, 0])) > 0.99 * LANES
    assert run["finals"].any() == (autoreset is Autoreset.SAME_STEP)
    assert np.isfinite(run["observations"]).all()
    assert np.isfinite(run["out"]).all()


def test_second_episode_draws_anew(fly):
    flight = fly(RANDOM, 5)
    before = flight.fleet.drawn()["vehicle.mass_scale"]
    flight.fleet.reset(flight.observations)
    assert (flight.fleet.drawn()["vehicle.mass_scale"] != before).all()
    flight.fleet.seed(np.arange(5), list(range(5)))
    flight.fleet.reset(flight.observations)
    np.testing.assert_array_equal(flight.fleet.drawn()["vehicle.mass_scale"], before)


def test_reset_of_some_lanes_leaves_the_others(fly):
    flight = fly(RANDOM, 40)
    flight.step(0.5, 7)
    before, seen = flight.fleet.state(), flight.observations.copy()
    lanes = np.array([3, 35])
    flight.fleet.reset(flight.observations, lanes)
    after = flight.fleet.state()
    others = np.delete(np.arange(40), lanes)
    for name, value in after.items():
        np.testing.assert_array_equal(value[others], before[name][others], err_msg=name)
    np.testing.assert_array_equal(flight.observations[others], seen[others])
    assert (after["time_s"][lanes] == 0.0).all()
    assert (flight.observations[lanes] != seen[lanes]).any(axis=1).all()


def numbers_by_path(scenario):
    """Each number of the scenario, with the alternative of the ship's path to which it belongs."""
    children = {"link": scenario.link, "vehicle": scenario.vehicle, "sea.current": scenario.sea.current}
    children |= {"sensors": scenario.sensors, "fixes": scenario.fixes, "start": scenario.start}
    children |= {f"sea.pulses[{i}]": pulse for i, pulse in enumerate(scenario.sea.pulses)}
    for prefix, child in children.items():
        yield from ((f"{prefix}.{name}", value, None) for name, value in child.numbers())
    for i, path in enumerate(scenario.ship_paths):
        yield from ((f"ship[{i}].{name}", value, i) for name, value in path.numbers())


def test_draws_lie_in_their_ranges(fly):
    drawn = fly(RANDOM, 6000).fleet.drawn()
    numbers = list(numbers_by_path(RANDOM))
    choices = {"link.background", "sea.pulses[0].frame", "sea.pulses[1].frame", *(f"ship[{i}].turn" for i in (2, 3, 5))}
    assert set(drawn) == {name for name, _, _ in numbers} | {"depth_m", "ship"} | choices
    assert set(np.unique(drawn["ship"])) == set(range(6))
    ranges = 0
    for name, value, alternative in numbers:
        mine = np.ones(6000, bool) if alternative is None else drawn["ship"] == alternative
        assert np.isnan(drawn[name][~mine]).all()
        own = drawn[name][mine]
        if isinstance(value, Range):
            ranges += 1
            width = value.high - value.low
            assert value.low <= own.min() < value.low + 0.02 * width
            assert value.high >= own.max() > value.high - 0.02 * width
            assert own.mean() == pytest.approx(value.middle, abs=4.5 * width / (12 * own.size) ** 0.5)
        else:
            assert (own == value).all()
    assert ranges > 35
    assert set(drawn["ship[2].turn"]) == {"starboard", ""}
    assert (drawn["sea.pulses[1].frame"] == "earth").all()


def test_draws_are_independent(fly):
    drawn = fly(RANDOM, 2000).fleet.drawn()
    names = [name for name, value, only in numbers_by_path(RANDOM) if isinstance(value, Range) and only is None]
    correlation = np.corrcoef([drawn[name] for name in names]) - np.eye(len(names))
    assert np.abs(correlation).max() < 4.5 / 2000**0.5


def test_all_alternatives_of_the_ship_are_drawn(fly):
    scenario = Scenario(ship=[StraightPath(x_m=float(x)) for x in range(5)])
    x = fly(scenario, 2000).fleet.state()["ship_pose"][:, 0]
    counts = np.bincount(x.astype(int), minlength=5)
    # Standard deviation of a count: √(2000 · 0.2 · 0.8) ≈ 18.
    assert np.abs(counts - 400).max() < 80


def test_drawn_depth(fly):
    depth = fly(Scenario(depth_m=(2.0, 3.0)), 500).fleet.state()["depth_m"]
    assert 2.0 <= depth.min() < 2.02
    assert 2.98 < depth.max() <= 3.0
    cone = OpticalLink().cone()
    state = fly(Scenario()).fleet.state()
    assert state["depth_m"][0] == pytest.approx(cone.height_m, rel=1e-12)
    assert state["slant_height_m"][0] == pytest.approx(cone.slant_height_m, rel=1e-11)


@pytest.mark.parametrize("threads", [1, 2])
def test_pickle_continues_identically(fly, threads):
    flight = fly(RANDOM, 70, autoreset=Autoreset.SAME_STEP, max_episode_steps=LENGTH, threads=threads)
    for actions in ACTIONS[:17]:
        flight.step(actions[:70])
    copy = pickle.loads(pickle.dumps(flight))
    before = {name: value.copy() for name, value in flight.fleet.state().items()}
    for actions in ACTIONS[17:80]:
        copy.step(actions[:70])
    for name, value in flight.fleet.state().items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)
    for actions in ACTIONS[17:80]:
        flight.step(actions[:70])
    np.testing.assert_array_equal(copy.observations, flight.observations)
    np.testing.assert_array_equal(copy.out, flight.out)
    np.testing.assert_array_equal(copy.fleet.measures(), flight.fleet.measures())
    flight.fleet.close()
    copy.fleet.close()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("lane", [0, 77])
def test_non_finite_action_moves_nothing(fly, threads, bad, lane):
    flight = fly(RANDOM, 100, threads=threads)
    flight.step(0.5, 3)
    before, seen = flight.fleet.state(), flight.observations.copy()
    actions = np.zeros((100, 3))
    actions[lane, 1] = bad
    with pytest.raises(ValueError, match=rf"action \[0.0, {bad}, 0.0\] of simulation {lane} .* must be finite"):
        flight.step(actions)
    for name, value in flight.fleet.state().items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)
    np.testing.assert_array_equal(flight.observations, seen)
    flight.step(0.0)
    flight.fleet.close()


@pytest.mark.parametrize("threads", [1, 2])
def test_ended_episode_refuses_to_step(fly, threads):
    flight = fly(RANDOM, 40, max_episode_steps=3, threads=threads)
    flight.step(0.0, 3)
    assert (flight.measures()["truncated"] == 1.0).all()
    before = flight.fleet.state()
    with pytest.raises(RuntimeError, match=r"episodes of simulations \[0, 1, 2, .*\] have ended; reset them"):
        flight.step()
    for name, value in flight.fleet.state().items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)
    flight.fleet.reset(flight.observations, np.arange(1, 40))
    with pytest.raises(RuntimeError, match=r"simulations \[0\] have ended"):
        flight.step()
    flight.fleet.reset(flight.observations, np.array([0]))
    flight.step()
    flight.fleet.close()


def far_away(fly, **options):
    scenario = Scenario(ship=StraightPath(speed_mps=0.0), episode=EpisodeSettings(lost_distance_m=8.0))
    # Lane 1 leaves the allowed distance in its first step.
    return fly(scenario, 2, pose=[(0.0, 0.0, 0.0), (7.99, 0.0, 0.0)], velocity=[(0, 0, 0), (2.0, 0, 0)], **options)


def test_lost_link_terminates(fly):
    flight = far_away(fly)
    state = flight.step()
    assert np.hypot(*state["pose"][1, :2]) > 8.0
    np.testing.assert_array_equal(flight.measures()["terminated"], [0.0, 1.0])
    np.testing.assert_array_equal(flight.measures()["truncated"], [0.0, 0.0])
    np.testing.assert_array_equal(flight.flags[:2], [[False, True], [False, False]])


def test_flags_repeat_the_measures(fly):
    flight = fly(RANDOM, 200, max_episode_steps=20)
    for actions in ACTIONS[:20]:
        flight.step(actions[:200])
        rows = dict(zip(MEASURE_NAMES, flight.out, strict=True))
        for flag, name in zip(flight.flags, ("terminated", "truncated", "in_cone", "is_success"), strict=True):
            np.testing.assert_array_equal(flag, rows[name] > 0.0, err_msg=name)
    assert flight.flags[1].all()
    assert 0 < flight.flags[2].sum() < 200


def test_same_step_autoreset(fly):
    flight = far_away(fly, autoreset=Autoreset.SAME_STEP)
    state = flight.step()
    np.testing.assert_array_equal(state["time_s"], [0.05, 0.0])
    # The measures are those of the end, the observation is that of the new start.
    assert flight.out[MEASURE_NAMES.index("terminated"), 1] == 1.0
    assert flight.finals[1, 0] == pytest.approx(-8.09 / 4, abs=0.01)
    np.testing.assert_allclose(flight.observations[1, :2], [-1.25, -1.25], rtol=1e-6)
    np.testing.assert_array_equal(flight.finals[0], 0.0)
    assert flight.step()["time_s"].tolist() == [0.1, 0.05]


def test_next_step_autoreset(fly):
    flight = far_away(fly, autoreset=Autoreset.NEXT_STEP)
    state = flight.step()
    np.testing.assert_array_equal(state["time_s"], [0.05, 0.05])
    assert flight.observations[1, 0] == pytest.approx(-8.09 / 4, abs=0.01)
    state = flight.step(1.0)
    np.testing.assert_array_equal(state["time_s"], [0.1, 0.0])
    rows = dict(zip(MEASURE_NAMES, flight.out, strict=True))
    for name in ("reward", "terminated", "truncated"):
        assert rows[name][1] == 0.0
    np.testing.assert_array_equal(state["pose"][1], [5.0, 5.0, 0.0])
    np.testing.assert_array_equal(flight.observations[1, 15:18], 0.0)
    assert flight.step()["time_s"][1] == 0.05


@pytest.mark.parametrize("name", ["pose", "velocity"])
@pytest.mark.parametrize(
    "value", [(0.0, 0.0), np.zeros((2, 3)), np.zeros((3, 1)), 1.0, (0.0, 0.0, np.nan), "abc", np.zeros((1, 3))]
)
def test_bad_start(fly, name, value):
    flight = fly(Scenario(), 5)
    before = flight.step()
    with pytest.raises(ValueError, match=rf"(?s)options\['{name}'\] = .* finite and of shape \(3,\) or \(5, 3\)"):
        flight.fleet.reset(flight.observations, **{name: value})
    for key, each in flight.fleet.state().items():
        np.testing.assert_array_equal(each, before[key], err_msg=key)


def test_start_given(fly):
    pose = np.arange(9.0).reshape(3, 3)
    state = fly(RANDOM, 3, pose=pose, velocity=(0.1, 0.2, 0.3)).fleet.state()
    np.testing.assert_array_equal(state["pose"], pose)
    np.testing.assert_array_equal(state["velocity"], [[0.1, 0.2, 0.3]] * 3)


def test_start_relative_to_the_ship(fly):
    flight = fly(Scenario(ship=StraightPath(x_m=7.0, y_m=-3.0, course_rad=0.5), start=RANDOM.start), 20)
    drawn = flight.fleet.drawn()
    offset = np.stack([drawn[f"start.{name}"] for name in ("x_m", "y_m", "yaw_rad")], axis=1)
    np.testing.assert_allclose(flight.fleet.state()["pose"], np.add(offset, (7.0, -3.0, 0.5)), rtol=1e-14, atol=1e-14)


def test_seeds_are_needed():
    fleet = Fleet(Scenario(), 3)
    fleet.seed(np.array([0, 2]), [1, 2])
    observations = np.zeros((3, 20), np.float32)
    with pytest.raises(ValueError, match="every simulation needs a seed before its first reset"):
        fleet.reset(observations)
    fleet.reset(observations, np.array([0, 2]))
    assert observations[[0, 2]].any(axis=1).all()
    assert not observations[1].any()


@pytest.mark.parametrize("name", ["size", "threads", "max_episode_steps"])
@pytest.mark.parametrize("value", [0, -3, 1.5])
def test_counts_are_checked(name, value):
    with pytest.raises(ValueError, match=rf"{name} = {value} is not allowed; it must be a whole number from 1 to"):
        Fleet(**({"scenario": Scenario(), "size": 2} | {name: value}))


LINKS = {
    "paper": OpticalLink(),
    "printed": OpticalLink(background="printed"),
    "capped": OpticalLink(max_bit_rate_bps=2e8),
    "strict": OpticalLink(target_ber=1e-9, threshold_bit_rate_bps=1e5, attenuation_per_m=0.4),
}


def scattered(fly, link, depth=(1.0, 3.6), size=400, **settings):
    """Lanes all around a ship, some in its cone, stepped once with random actions."""
    start = {"x_m": (-4.0, 4.0), "y_m": (-4.0, 4.0), "yaw_rad": (-3.0, 3.0), "relative_to_ship": True}
    speed = {"surge_mps": (-2.0, 2.0), "sway_mps": (-2.0, 2.0), "yaw_rate_rad_s": (-1.0, 1.0)}
    scenario = Scenario(link=link, ship=PaperPath(), depth_m=depth).merged({"start": start | speed, **settings})
    flight = fly(scenario, size)
    flight.step(ACTIONS[0, :size])
    return flight


@pytest.mark.parametrize("name", LINKS)
def test_measures_are_the_links(fly, name):
    link = LINKS[name]
    flight = scattered(fly, link)
    state, measures = flight.fleet.state(), flight.measures()
    offset = (state["ship_pose"] - state["pose"])[:, :2]
    distance = np.hypot(*offset.T)
    d = np.hypot(distance, state["depth_m"])
    angle = np.arctan2(distance, state["depth_m"])
    assert np.abs(angle - link.field_of_view_rad).min() > 1e-9
    expected = {
        "range_m": d,
        "pointing_error_rad": angle,
        "bit_rate_bps": link.bit_rate(d, angle),
        "snr": link.snr(d, angle, link.threshold_bit_rate_bps),
        "ber": link.ber(d, angle, link.threshold_bit_rate_bps),
    }
    for key, value in expected.items():
        np.testing.assert_allclose(measures[key], value, rtol=1e-10, atol=1e-290, err_msg=key)
        np.testing.assert_array_equal(measures[key], state[key], err_msg=key)
    inside = (angle <= link.field_of_view_rad) & (d <= link.cone().slant_height_m)
    assert 10 < inside.sum() < 390
    np.testing.assert_array_equal(measures["in_cone"], inside)
    np.testing.assert_array_equal(measures["cost"], ~inside)
    np.testing.assert_array_equal(state["in_cone"], inside)


def test_measures_with_a_drawn_link(fly):
    link = OpticalLink(
        power_w=(0.05, 0.5),
        half_power_angle_rad=(0.4, 0.6),
        detector_area_m2=(1e-5, 1e-3),
        field_of_view_rad=(0.5, 0.8),
        refractive_index=(1.3, 1.7),
        responsivity_a_per_w=(0.3, 0.9),
        attenuation_per_m=(0.0, 0.5),
        filter_bandwidth_nm=(10.0, 50.0),
        solar_irradiance_w_per_m2_nm=(0.1, 1.0),
        water_transmittance=(0.5, 1.0),
    )
    flight = scattered(fly, link, depth=None, size=60)
    state, drawn = flight.fleet.state(), flight.fleet.drawn()
    for lane in range(60):
        own = OpticalLink(**{name: float(drawn[f"link.{name}"][lane]) for name, _ in link.numbers()})
        place = (state["range_m"][lane], state["pointing_error_rad"][lane])
        assert state["depth_m"][lane] == pytest.approx(own.cone().height_m, rel=1e-10)
        assert state["slant_height_m"][lane] == pytest.approx(own.cone().slant_height_m, rel=1e-10)
        assert state["bit_rate_bps"][lane] == pytest.approx(own.bit_rate(*place), rel=1e-10)


WEIGHTS = RewardSettings(
    bit_rate=0.7, in_cone=0.2, position=1.1, heading=0.6, effort=0.3, position_scale_m=2.0, heading_scale_rad=0.8
)


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize("weights", [RewardSettings(), WEIGHTS])
def test_reward(fly, name, weights):
    link = LINKS[name]
    flight = scattered(fly, link, reward=weights)
    state, measures = flight.fleet.state(), flight.measures()
    distance = np.hypot(*(state["ship_pose"] - state["pose"])[:, :2].T)
    yaw_error = np.abs(np.angle(np.exp(1j * (state["ship_pose"] - state["pose"])[:, 2])))
    threshold = link.threshold_bit_rate_bps
    on_axis = np.asarray(link.bit_rate(state["depth_m"], 0.0))
    level = np.log(np.maximum(measures["bit_rate_bps"], threshold) / threshold)
    decades = np.log(on_axis / threshold)
    action = np.clip(ACTIONS[0, :400].astype(float), -1.0, 1.0)
    expected = {
        # Below the depth at which the threshold is reached on the axis there is nothing to gain.
        "bit_rate": weights.bit_rate * np.where(decades > 0.0, level / decades, 0.0),
        "in_cone": weights.in_cone * state["in_cone"],
        "position": weights.position / (1.0 + distance / weights.position_scale_m),
        "heading": weights.heading / (1.0 + yaw_error / weights.heading_scale_rad),
        "effort": -weights.effort * (action**2).mean(axis=1),
    }
    for term, value in expected.items():
        np.testing.assert_allclose(measures[f"reward_{term}"], value, rtol=1e-9, atol=1e-12, err_msg=term)
    np.testing.assert_allclose(measures["reward"], sum(expected.values()), rtol=1e-9)
    low, high = weights.bounds
    assert low <= measures["reward"].min()
    assert measures["reward"].max() <= high
    assert measures["reward_bit_rate"].max() > 0.3 * weights.bit_rate


def test_whole_turns_of_yaw_cost_nothing(fly):
    still = Scenario(ship=StraightPath(speed_mps=0.0))
    flight = fly(still, 3, pose=[(0.5, 0.0, 0.3 + turns * 2.0 * np.pi) for turns in (0, 1, -2)], velocity=(0, 0, 0))
    flight.step()
    rewards = flight.measures()["reward"]
    assert rewards == pytest.approx(np.full(3, rewards[0]), abs=1e-12)


def test_best_step_gives_one(fly):
    flight = fly(Scenario(ship=StraightPath(speed_mps=0.0)), pose=(0, 0, 0), velocity=(0, 0, 0))
    flight.step()
    assert flight.measures()["reward"][0] == pytest.approx(1.0, rel=1e-12)


def test_observation(fly):
    scales = {
        "position_scale_m": 0.8,
        "velocity_scale_mps": 0.8,
        "yaw_rate_scale_rad_s": 0.3,
        "acceleration_scale_mps2": 0.05,
        "yaw_acceleration_scale_rad_s2": 0.04,
    }
    flight = scattered(fly, OpticalLink(), observation=scales)
    state, measures = flight.fleet.state(), flight.measures()
    yaw = state["pose"][:, 2]
    c, s = np.cos(yaw), np.sin(yaw)

    def in_body(vector):
        return [c * vector[:, 0] + s * vector[:, 1], c * vector[:, 1] - s * vector[:, 0]]

    surge, sway, rate = state["velocity"].T
    position = in_body(state["ship_pose"] - state["pose"])
    velocity = in_body(state["ship_velocity"])
    acceleration = in_body(state["ship_acceleration"])
    heading = state["ship_pose"][:, 2] - yaw
    expected = [
        *(np.array(position) / 0.8),
        np.cos(heading),
        np.sin(heading),
        (velocity[0] - surge) / 0.8,
        (velocity[1] - sway) / 0.8,
        (state["ship_velocity"][:, 2] - rate) / 0.3,
        surge / 0.8,
        sway / 0.8,
        rate / 0.3,
        *(np.array(acceleration) / 0.05),
        state["ship_acceleration"][:, 2] / 0.04,
        c,
        s,
        *np.clip(ACTIONS[0, :400], -1.0, 1.0).T,
        measures["reward_bit_rate"] / 0.4,
        measures["in_cone"],
    ]
    clipped = np.clip(np.transpose(expected), -5.0, 5.0)
    np.testing.assert_allclose(flight.observations, clipped, rtol=1e-6, atol=1e-6)
    # Clipping must have been put to the test.
    assert np.abs(np.transpose(expected)).max() > 5.0


def test_observation_of_the_paper_at_its_start(fly):
    # Ship at (0, 10), AUV at (5, 5), both heading along x; the ship sails along x at 1 m/s and turns.
    seen = fly(Scenario()).observations[0]
    expected = [-5 / 4, 5 / 4, 1, 0, 1, 0, np.pi / 20, 0, 0, 0, 0, -0.2, 0, 1, 0, 0, 0, 0, 0, 0]
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-6)


def test_success_is_the_last_third_in_the_cone(fly):
    # Started at rest in the cone, outside it, and pushed out of it halfway.
    pulse = Pulse(start_s=0.75, duration_s=0.25, force_x_n=6e4, force_y_n=0.0, moment_nm=0.0)
    still = Scenario(ship=StraightPath(speed_mps=0.0), episode=EpisodeSettings(duration_s=1.5, lost_distance_m=1e3))
    pushed = still.merged({"sea": Sea(pulses=(pulse,))})
    for scenario, pose, success in ((still, (0, 0, 0), 1.0), (still, (4, 0, 0), 0.0), (pushed, (0, 0, 0), 0.0)):
        flight = fly(scenario, pose=pose, velocity=(0, 0, 0))
        flight.step(0.0, 30)
        assert flight.measures()["is_success"][0] == success


def test_a_last_third_in_the_cone_to_the_very_step_is_success(fly):
    # They drift into the cone, each a little later than the one before.
    still = Scenario(ship=StraightPath(speed_mps=0.0), episode=EpisodeSettings(duration_s=5.0, lost_distance_m=1e3))
    starts = [(2.3 + 0.05 * i, 0.0, 0.0) for i in range(8)]
    flight = fly(still, 8, pose=starts, velocity=(-2.0, 0.0, 0.0))
    last_outside = np.zeros(8)
    just = 0
    for step in range(1, 101):
        flight.step()
        measures = flight.measures()
        last_outside[measures["in_cone"] == 0.0] = step
        np.testing.assert_array_equal(measures["is_success"], 3.0 * last_outside <= 2.0 * step)
        just += np.count_nonzero((3.0 * last_outside == 2.0 * step) & (last_outside > 0.0))
    assert just > 0


def test_configure_takes_effect_at_reset(fly):
    flight = fly(Scenario(), 40)
    flight.fleet.configure(Scenario(vehicle=Vehicle(mass_scale=2.0), sea=Sea(pulses=(Pulse(), Pulse()))))
    flight.fleet.reset(flight.observations)
    assert (flight.fleet.drawn()["vehicle.mass_scale"] == 2.0).all()
    assert (flight.fleet.drawn()["sea.pulses[1].force_x_n"] == 350.0).all()
    expected = fly(Scenario(vehicle=Vehicle(mass_scale=2.0)), 40).step(0.5, 5)
    for name, value in flight.step(0.5, 5).items():
        np.testing.assert_array_equal(value, expected[name], err_msg=name)


def test_nothing_but_seeds_and_episodes_outlives_a_scenario(fly):
    flight = fly(RANDOM, 40)
    flight.step(0.3)
    before = flight.fleet.snapshot()
    flight.fleet.configure(RANDOM)
    after = flight.fleet.snapshot()
    assert before["random"]["key_0"].any()
    np.testing.assert_array_equal(after["random"], before["random"])
    # Beside them stands only whose rows these are.
    for name in ("random", "origin"):
        after[name] = np.zeros((), after[name].dtype)
    assert not after.view(np.float64).any()


def test_measures_of_a_step_are_the_present_ones(fly):
    flight = fly(RANDOM, 40)
    flight.step(0.3)
    np.testing.assert_array_equal(flight.out, flight.fleet.measures())
    np.testing.assert_array_equal(flight.fleet.single, flight.out[:, 0])


def test_flags_are_the_measures_of_their_names(fly):
    flight = fly(RANDOM.merged({"start": {"x_m": (-1.0, 14.0)}}), 70, autoreset=Autoreset.SAME_STEP)
    seen = set()
    for _ in range(100):
        flight.flags[:] = np.random.default_rng(0).integers(2, size=flight.flags.shape)
        flight.step((1.0, 0.0, 0.0))
        rows = dict(zip(MEASURE_NAMES, flight.out, strict=True))
        for name, flags in zip(FLAGS, flight.flags, strict=True):
            np.testing.assert_array_equal(flags, rows[name] > 0.0, err_msg=name)
            seen |= {(name, flag) for flag in flags.tolist()}
    assert {(name, flag) for name in ("terminated", "in_cone", "is_success") for flag in (True, False)} <= seen


@pytest.mark.parametrize("name", [name for name, each in SCENARIOS.items() if len(each.sea.pulses) < 2])
def test_a_large_fleet_of_the_papers_worlds_takes_150_mebibytes(name):
    size = 65_536
    assert size * 8 * 50 < Fleet(SCENARIOS[name], size).memory.nbytes < 150 * 2**20


def test_stepping_a_large_fleet_takes_no_memory(fly):
    flight = fly(RANDOM, 65_536)
    actions = np.zeros((65_536, 3), np.float32)
    tracemalloc.start()
    try:
        flight.fleet.step(actions, flight.observations, flight.out, flight.flags)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # Not even a byte for each.
    assert peak < 65_536


@pytest.mark.parametrize("autoreset", RESETS, ids=["next step", "same step"])
@pytest.mark.parametrize("start_m", [0.5, 6.0])
def test_an_episode_is_that_of_a_fresh_fleet_reset_as_often(fly, autoreset, start_m):
    """Nothing of an episode reaches into the next: state, info and success are those of a fleet that skipped it."""
    size, length = 9, 30
    scenario = RANDOM.merged({"start": {"x_m": (-start_m, start_m), "y_m": (-start_m, start_m)}})
    flight = fly(scenario, size, seed=50, autoreset=autoreset, max_episode_steps=length)
    succeeded = []
    turn = length + (autoreset is Autoreset.NEXT_STEP)
    for episode in range(3):
        fresh = fly(scenario, size, seed=50, autoreset=autoreset, max_episode_steps=length)
        for _ in range(episode):
            fresh.fleet.reset(fresh.observations)
        np.testing.assert_array_equal(flight.observations, fresh.observations)
        np.testing.assert_equal(flight.fleet.state(), fresh.fleet.state())
        np.testing.assert_equal(flight.fleet.drawn(), fresh.fleet.drawn())
        for _ in range(length):
            # Out of the cone in one episode, at rest in the next.
            action = 0.0 if episode % 2 else np.sign(ACTIONS[0, :size])
            flight.step(action)
            fresh.step(action)
            np.testing.assert_array_equal(flight.out, fresh.out)
            np.testing.assert_array_equal(flight.flags, fresh.flags)
        succeeded.append(flight.flags[3].mean())
        if turn > length:
            flight.step()
    if start_m < 1.0:
        assert succeeded[0] < 0.5 < succeeded[1]


def test_success_of_an_episode_knows_nothing_of_the_one_before(fly):
    # Episode 1 ends outside the cone, episode 2 stays on its axis throughout.
    still = Scenario(ship=StraightPath(speed_mps=0.0), episode=EpisodeSettings(duration_s=2.0, lost_distance_m=1e3))
    flight = fly(still, pose=(6.0, 0.0, 0.0))
    flight.step(0.0, 40)
    assert flight.measures()["is_success"][0] == 0.0
    flight.fleet.reset(flight.observations, pose=(0.0, 0.0, 0.0))
    for _ in range(40):
        flight.step()
        assert flight.measures()["is_success"][0] == 1.0


AXES = {"surge force": 0, "sway force": 1, "yaw moment": 2}


@pytest.mark.parametrize("kind", KINDS)
def test_each_action_of_each_kind_does_what_it_is_called(fly, kind):
    names = KINDS[kind]
    # Lane i does nothing but the i-th action.
    flight = fly(Scenario(action=kind), len(names))
    force = flight.step(0.5 * np.eye(len(names)))["force"]
    expected = np.zeros((len(names), 3))
    for lane, name in enumerate(names):
        expected[lane, AXES[name]] = 0.5 * Vehicle().force_limits[AXES[name]]
    np.testing.assert_array_equal(force, expected)


@pytest.mark.parametrize("kind", KINDS)
def test_the_rewards_bounds_are_reached(fly, kind):
    # Beyond the cone, with all that an action can be, only the nearness and the heading are above 0.
    weights = RewardSettings(position=0.0, heading=0.0, effort=0.3)
    scenario = Scenario(ship=StraightPath(speed_mps=0.0), action=kind, reward=weights)
    worst = fly(scenario, pose=(15.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0))
    worst.step(-1.0)
    assert worst.measures()["reward"][0] == pytest.approx(weights.bounds[0], rel=1e-12)
    weights = RewardSettings(bit_rate=0.7, in_cone=0.2, position=1.1, heading=0.6, effort=0.3)
    best = fly(
        Scenario(ship=StraightPath(speed_mps=0.0), action=kind, reward=weights), pose=(0, 0, 0), velocity=(0, 0, 0)
    )
    best.step()
    assert best.measures()["reward"][0] == pytest.approx(weights.bounds[1], rel=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_each_actuator_has_its_own_limit(fly, axis):
    limits = {"max_surge_force_n": 700.0, "max_sway_force_n": 1100.0, "max_yaw_moment_nm": 90.0}
    free = {f"{order}_damping_{name}": 0.0 for order in ("linear", "quadratic") for name in ("surge", "sway", "yaw")}
    short = {"vehicle": limits | free, "episode": {"duration_s": 1.0}}
    flight = fly(Scenario().merged(short), velocity=(0.0, 0.0, 0.0))
    action = np.zeros(3)
    action[axis] = 0.5
    state = flight.step(action)
    force = 0.5 * np.array(list(limits.values()))[axis]
    # Without damping the velocity after a period is force over mass times the period, along that axis alone.
    expected = np.zeros(3)
    expected[axis] = force / (100.0, 250.0, 80.0)[axis] * 0.05
    np.testing.assert_allclose(state["velocity"][0], expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(state["force"][0, axis], force, rtol=1e-12)


def test_numbers_of_the_ship_can_be_chosen(fly):
    fleet = fly(RANDOM, 4).fleet
    seen = np.zeros((4, 20), np.float32)
    chosen = {"ship": [1, 1, 2, 5], "ship[1].radius_m": [7.0, 8.0, 9.0, 9.0], "ship[2].speed_mps": 0.5}
    fleet.reset(seen, parameters=chosen)
    drawn, state = fleet.drawn(), fleet.state()
    np.testing.assert_array_equal(drawn["ship"], chosen["ship"])
    np.testing.assert_array_equal(drawn["ship[1].radius_m"], [7.0, 8.0, np.nan, np.nan])
    np.testing.assert_allclose(np.hypot(*state["ship_pose"][:2, :2].T), [7.0, 8.0], rtol=1e-12)
    assert np.hypot(*state["ship_velocity"][2, :2]) == pytest.approx(0.5, rel=1e-12)
    other = fly(Scenario(ship=PaperPath(radius_m=(6.0, 12.0))), 1).fleet
    other.reset(seen[:1], parameters={"ship.radius_m": 6.5})
    assert np.hypot(*other.state()["ship_pose"][0, :2]) == pytest.approx(6.5, rel=1e-12)
    for name, value, message in (
        ("ship", 6, "a whole one from 0 to 5"),
        ("ship", 0.5, "a whole one from 0 to 5"),
        ("ship[1].radius_m", 20.0, r"\[6, 12\]"),
        ("ship[2].turn", "port", r"'starboard'"),
        ("current.speed_mps", 0.1, "did you mean 'sea.current.speed_mps'"),
    ):
        with pytest.raises(ValueError, match=message):
            fleet.reset(seen, parameters={name: value})


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_threads_work_in_a_forked_child():
    code = """
import os, sys
import numpy as np
from uwoc_gym import TrackingVectorEnv
env = TrackingVectorEnv(100, threads=2)
env.reset(seed=0)
actions = np.ones((100, 3), np.float32)
env.step(actions)
rows = env.snapshot()
child = os.fork()
seen = env.step(actions)[0]
if not child:
    env.close()
    os._exit(int(seen.sum() == 0.0))
status = os.waitpid(child, 0)[1]
env.close()
sys.exit(os.waitstatus_to_exitcode(status))
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True, timeout=120)


def test_terms_are_those_that_add_up_to_the_reward(fly):
    flight = fly(Scenario.named("Random"), 40)
    for action in np.linspace(-1.0, 1.0, 5):
        flight.step(action)
        terms, measures = flight.fleet.terms(), flight.measures()
        assert list(terms) == list(RewardSettings().highest)
        for name, values in terms.items():
            np.testing.assert_array_equal(values, measures[f"reward_{name}"])
        np.testing.assert_allclose(sum(terms.values()), measures["reward"], rtol=1e-14)
    terms["effort"][:] = 7.0
    assert (flight.fleet.terms()["effort"] <= 0.0).all()


def test_the_most_of_each_term_is_reached_and_not_passed(fly):
    weights = RewardSettings(bit_rate=0.7, in_cone=0.2, position=1.1, heading=0.6, effort=0.3)
    best = fly(Scenario(ship=StraightPath(speed_mps=0.0), reward=weights), pose=(0, 0, 0), velocity=(0, 0, 0))
    best.step()
    for name, values in best.fleet.terms().items():
        assert values[0] == pytest.approx(weights.highest[name], rel=1e-12, abs=1e-12)
    assert sum(weights.highest.values()) == pytest.approx(weights.bounds[1])
