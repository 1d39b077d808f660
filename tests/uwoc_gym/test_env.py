"""The single environment as users meet it: IDs, spaces, documentation, episodes, errors."""

import copy
import pickle
import re
import subprocess
import sys
import warnings
from contextlib import ExitStack
from functools import partial
from unittest.mock import patch

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import (
    FrameStackObservation,
    NormalizeObservation,
    RecordEpisodeStatistics,
    TimeAwareObservation,
)

import uwoc_gym
from uwoc_gym import ENV_IDS, SettingError, TrackingEnv
from uwoc_gym.scenario import DESCRIPTIONS
from uwoc_gym.sim.layout import info_names
from uwoc_gym.spaces import action_space, observation_space
from uwoc_gym.task.action import KINDS
from uwoc_gym.task.observation import GROUPS, STANDARD

INFO_NAMES = info_names(uwoc_gym.Scenario())

ZERO = np.zeros(3, dtype=np.float32)


def table(heading: str) -> list[list[str]]:
    """Rows of the table under a heading of the class docstring."""
    section = TrackingEnv.__doc__.split(f"## {heading}")[1].split("##")[0]
    rows = [line.strip().strip("|").split("|") for line in section.splitlines() if line.strip().startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_passes_gymnasiums_checker(env_id):
    check_env(gym.make(env_id).unwrapped)


def test_is_made_from_another_project_without_an_import():
    code = (
        "import gymnasium as gym, sys; env = gym.make('uwoc_gym:uwoc/Nominal-v0'); env.reset(seed=0)\n"
        "sys.exit(', '.join({'torch', 'stable_baselines3', 'matplotlib', 'pygame'} & set(sys.modules)) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)


def test_registering_again_changes_nothing():
    before = dict(gym.registry)
    uwoc_gym.register_envs()
    assert dict(gym.registry) == before


def test_a_scenario_of_ones_own_becomes_an_id():
    mine = uwoc_gym.Scenario(vehicle=uwoc_gym.Vehicle(mass_scale=1.3))
    with ExitStack() as stack:
        for register in (uwoc_gym.SCENARIOS, DESCRIPTIONS, ENV_IDS, gym.registry):
            stack.enter_context(patch.dict(register))
        uwoc_gym.name_scenario("Mine", "with a heavier vehicle", mine)
        uwoc_gym.register_envs()
        assert ENV_IDS["uwoc/Mine-v0"] == "Mine"
        assert gym.make("uwoc/Mine-v0").unwrapped.scenario == mine
        assert gym.make_vec("uwoc/Mine-v0", num_envs=2).unwrapped.scenario == mine
        with pytest.raises(SettingError, match=r"name = 'my own' is not allowed; it must be of letters, digits"):
            uwoc_gym.name_scenario("my own", "no ID can be made of it", mine)
    assert "uwoc/Mine-v0" not in gym.registry


def test_a_spec_that_is_varied_says_how_to_do_so_in_silence():
    spec = gym.make("uwoc/Nominal-v0").spec
    heavy = {"vehicle": {"mass_scale": 1.3}}
    with pytest.warns(UserWarning, match=r"Where that is meant, scenario_digest=None among the arguments"):
        gym.make(spec, scenario=heavy)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(spec, scenario=heavy, scenario_digest=None)
    assert env.unwrapped.scenario.vehicle.mass_scale == 1.3


def test_observation_table_matches_the_space():
    space = observation_space(uwoc_gym.Scenario())
    settings = uwoc_gym.ObservationSettings()
    rows = [row for row in table("Observation Space") if len(row) == 6]
    assert len(rows) == len(settings.entries) == space.shape[0]
    for i, (number, name, low, high, unit, scale) in enumerate(rows):
        assert (int(number), name, unit) == (i, settings.entries[i].name, settings.entries[i].unit)
        assert (float(low), float(high), float(scale)) == (space.low[i], space.high[i], settings.entry_scales[i])


def test_group_table_matches_the_groups():
    rows = [row for row in table("Observation Space") if len(row) == 2 and row[0] in GROUPS]
    assert [name for name, _ in rows] == list(GROUPS)
    first = 0
    for name, text in rows:
        if name in STANDARD:
            last = first + len(GROUPS[name]) - 1
            assert text == f"{first} to {last}"
            first = last + 1
        elif len(GROUPS[name]) > 1:
            assert text == "see below"
        else:
            (entry,) = GROUPS[name]
            assert text == f"{entry.name}, from {entry.low:g} to {entry.high:g}"


def test_table_of_fixes_matches_the_group():
    rows = [row for row in table("Observation Space") if len(row) == 5][2:]
    settings = uwoc_gym.ObservationSettings(groups=("fix",))
    assert len(rows) == settings.size
    for (name, low, high, unit, scale), entry, value in zip(rows, settings.entries, settings.entry_scales, strict=True):
        assert (name, float(low), float(high), unit) == (entry.name, entry.low, entry.high, entry.unit)
        assert float(scale) == value


def test_action_table_matches_the_space_and_the_limits():
    space = action_space(uwoc_gym.Scenario())
    limits = uwoc_gym.Vehicle().force_limits
    for i, (number, name, low, high, unit) in enumerate(table("Action Space")):
        assert (int(number), name, float(low), float(high)) == (i, KINDS["wrench"][i], space.low[i], space.high[i])
        assert float(unit.split()[0]) == limits[i]


def test_reward_table_matches_the_weights():
    weights = uwoc_gym.RewardSettings()
    rows = table("Rewards")
    assert [row[0] for row in rows] == list(uwoc_gym.task.reward.TERM)
    assert all(float(row[1]) == getattr(weights, row[0]) for row in rows)


def test_starts_as_the_paper_does():
    env = gym.make("uwoc/Nominal-v0")
    _, info = env.reset(seed=0)
    state = env.unwrapped.state()
    np.testing.assert_allclose(state["pose"], [5, 5, 0])
    np.testing.assert_allclose(state["ship_pose"], [0, 10, 0], atol=1e-12)
    assert info["range_m"] == pytest.approx(8.03, abs=0.01)
    assert info["bit_rate_bps"] == 0.0
    assert info["cost"] == 1.0


def test_info_has_every_term_and_they_sum_to_the_reward():
    env = gym.make("uwoc/Random-v0")
    env.reset(seed=1)
    for _ in range(20):
        _, reward, _, _, info = env.step(env.action_space.sample())
        assert set(info) == set(INFO_NAMES)
        assert reward == pytest.approx(sum(info[f"reward_{term}"] for term in uwoc_gym.task.reward.TERM), abs=1e-15)
        assert isinstance(reward, float)
        assert isinstance(info["in_cone"], bool)


def test_the_same_seed_gives_the_same_episodes():
    def fly(seed):
        env = gym.make("uwoc/Random-v0", max_episode_steps=20)
        rng = np.random.default_rng(0)
        seen = [env.reset(seed=seed)[0]]
        for _ in range(50):
            obs, _, terminated, truncated, _ = env.step(rng.uniform(-1, 1, 3).astype(np.float32))
            seen.append(obs)
            if terminated or truncated:
                seen.append(env.reset()[0])
        return np.array(seen)

    np.testing.assert_array_equal(fly(3), fly(3))
    assert not np.array_equal(fly(3), fly(4))


def test_episodes_of_one_seed_differ_but_do_not_depend_on_how_long_the_last_ran():
    env = gym.make("uwoc/Random-v0")
    env.reset(seed=5)
    first = env.unwrapped.parameters()
    second = env.reset()[0]
    assert env.unwrapped.parameters() != first
    env.reset(seed=5)
    for _ in range(7):
        env.step(ZERO)
    np.testing.assert_array_equal(env.reset()[0], second)


def test_without_a_seed_episodes_are_random():
    starts = [gym.make("uwoc/Random-v0").reset()[0] for _ in range(2)]
    assert not np.array_equal(*starts)


@pytest.mark.parametrize(("env_id", "steps"), [("uwoc/Nominal-v0", 3000), ("uwoc/Random-v0", 1200)])
def test_is_truncated_after_its_duration(env_id, steps):
    env = gym.make(env_id, scenario={"episode": {"lost_distance_m": 1e6}})
    env.reset(seed=0)
    for step in range(1, steps + 1):
        *_, terminated, truncated, info = env.step(ZERO)
        assert not terminated
        assert truncated == (step == steps)
    assert info["is_success"] is False


def test_periods_are_arguments():
    env = gym.make("uwoc/Nominal-v0", control_period_s=0.1, integration_step_s=0.02)
    env.reset(seed=0)
    env.step(ZERO)
    assert env.unwrapped.state()["time_s"] == pytest.approx(0.1)
    assert env.unwrapped.metadata["render_fps"] == 10


def test_a_time_limit_from_gym_make_still_reports_success():
    env = gym.make("uwoc/Nominal-v0", max_episode_steps=3)
    ship = uwoc_gym.PaperPath().at(0.0).pose[0]
    env.reset(seed=0, options={"pose": ship})
    *_, truncated, info = [env.step(ZERO) for _ in range(3)][-1]
    assert truncated
    assert info["is_success"] is True


def test_termination_when_the_link_is_lost():
    env = gym.make("uwoc/Nominal-v0")
    env.reset(seed=0, options={"pose": (0.0, -9.5, -1.57), "velocity": (3.0, 0.0, 0.0)})
    terminated = False
    while not terminated:
        *_, terminated, truncated, info = env.step(np.array([1, 0, 0], dtype=np.float32))
        assert not truncated
    assert info["is_success"] is False
    assert np.hypot(*(env.unwrapped.state()["pose"] - env.unwrapped.state()["ship_pose"])[:2]) > 20.0


def test_reset_options_hold_for_one_episode():
    env = gym.make("uwoc/Nominal-v0")
    options = {"pose": (1, 2, 0.5), "velocity": (0.1, 0.2, 0.3), "scenario": {"vehicle": {"mass_scale": 1.3}}}
    env.reset(seed=0, options=options)
    state = env.unwrapped.state()
    np.testing.assert_array_equal(state["pose"], options["pose"])
    np.testing.assert_array_equal(state["velocity"], options["velocity"])
    assert env.unwrapped.parameters()["vehicle.mass_scale"] == 1.3
    env.reset()
    assert env.unwrapped.parameters()["vehicle.mass_scale"] == 1.0


def test_large_actions_are_clipped():
    states = []
    for action in ([1, -1, 1], [9, -50, 1e30]):
        env = gym.make("uwoc/Nominal-v0")
        env.reset(seed=0)
        env.step(np.array(action, dtype=np.float32))
        states.append(env.unwrapped.state())
    np.testing.assert_array_equal(states[0]["pose"], states[1]["pose"])
    np.testing.assert_array_equal(states[1]["force"], [2000, -2000, 500])


@pytest.mark.parametrize("bad", [[np.nan, 0, 0], [0, np.inf, 0], [0, 0], np.zeros((1, 3)), "up", None])
def test_refuses_bad_actions_and_moves_nothing(bad):
    env = TrackingEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action"):
        env.step(bad if bad is None or isinstance(bad, str) else np.array(bad, dtype=np.float32))
    assert env.state()["time_s"] == 0.0


def test_refuses_to_step_before_reset_and_after_the_end():
    env = TrackingEnv(scenario={"episode": {"duration_s": 0.05}})
    with pytest.raises(gym.error.ResetNeeded, match="reset"):
        env.step(ZERO)
    env.reset(seed=0)
    env.step(ZERO)
    with pytest.raises(gym.error.ResetNeeded, match="ended"):
        env.step(ZERO)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"position": (0, 0, 0)}, "options['position'] is not known; allowed are pose, velocity, parameters, scenario"),
        ({"pose": (0, 0)}, "options['pose'] = (0, 0) is not allowed; it must be finite and of shape (3,)"),
        ({"velocity": (0, 0, np.nan)}, "options['velocity']"),
        ({"parameters": {"vehicle.mass": 1.0}}, "options['parameters']['vehicle.mass'] is not known; did you mean"),
        ({"parameters": {"vehicle.mass_scale": 1.1}}, "a number, in the range [1, 1] that the scenario draws it from"),
        ({"parameters": {"vehicle.mass_scale": "much"}}, "= 'much' is not allowed"),
        ({"parameters": {"vehicle.mass_scale": np.nan}}, "= nan is not allowed"),
        ({"scenario": {"vehicle": {"mas_scale": 1}}}, "did you mean 'mass_scale'?"),
        ({"scenario": {"observation": {"position_scale_m": 9}}}, "must not change 'observation'"),
    ],
)
def test_refuses_bad_options(options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        TrackingEnv().reset(seed=0, options=options)


def test_refuses_bad_arguments():
    with pytest.raises(SettingError, match="whole multiple of integration_step_s"):
        gym.make("uwoc/Nominal-v0", control_period_s=0.012)
    with pytest.raises(SettingError, match="did you mean 'Nominal'"):
        gym.make("uwoc/Nominal-v0", scenario="Nomina")
    with pytest.raises(ValueError, match="render_mode = 'hologram'"):
        TrackingEnv(render_mode="hologram")


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_identically(duplicate):
    env = TrackingEnv(scenario="Random")
    env.reset(seed=2)
    env.step(ZERO)
    twin = duplicate(env)
    for _ in range(5):
        np.testing.assert_array_equal(env.step(ZERO)[0], twin.step(ZERO)[0])
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])


def test_spec_makes_the_same_environment():
    env = gym.make("uwoc/Nominal-v0", scenario={"vehicle": {"mass_scale": 1.2}})
    again = gym.make(env.spec)
    assert again.unwrapped.scenario == env.unwrapped.scenario


def test_infos_are_arrays_where_they_are_asked_for():
    plain, arrays = gym.make("uwoc/Random-v0"), gym.make("uwoc/Random-v0", info_arrays=True)
    for env in (plain, arrays):
        env.reset(seed=0)
    for _ in range(3):
        want, got = plain.step(ZERO)[4], pickle.loads(pickle.dumps(arrays)).step(ZERO)[4]
        arrays.step(ZERO)
        assert got == want
        assert {name: (type(value), value.dtype, value.shape) for name, value in got.items()} == {
            name: (np.ndarray, np.asarray(value).dtype, ()) for name, value in want.items()
        }
    with pytest.raises(ValueError, match="info_arrays = 'yes' is not allowed; it must be True or False"):
        gym.make("uwoc/Random-v0", info_arrays="yes")


SAILS = [
    uwoc_gym.PaperPath(radius_m=(8.0, 9.0)),
    uwoc_gym.StraightPath(),
    uwoc_gym.CirclePath(turn="port"),
    uwoc_gym.RandomPath(),
    uwoc_gym.LawnMowerPath(leg_length_m=5.0),
    uwoc_gym.RecordedPath(time_s=(0, 50, 100, 200), x_m=(0, 1, 2, 3), y_m=(10, 9, 8, 7)),
    uwoc_gym.CarriedOnPath(speed_mps=0.5),
]


@pytest.mark.parametrize("ship", [*SAILS, (SAILS[1], SAILS[2])], ids=lambda each: getattr(each, "kind", "several"))
@pytest.mark.parametrize("whole", [True, False])
def test_a_spec_with_objects_goes_through_json(ship, whole):
    scenario = uwoc_gym.Scenario(ship=ship)
    env = gym.make("uwoc/Nominal-v0", scenario=scenario if whole else {"ship": ship})
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario == env.unwrapped.scenario == scenario


@pytest.mark.parametrize("vector", [False, True])
def test_a_spec_says_how_long_episodes_are(vector):
    made = partial(gym.make_vec, num_envs=2) if vector else gym.make
    assert made("uwoc/Random-v0").spec.max_episode_steps == 1200
    assert made("uwoc/Random-v0", control_period_s=0.1).spec.max_episode_steps == 600
    assert made("uwoc/Random-v0", scenario={"episode": {"duration_s": 90}}).spec.max_episode_steps == 1800
    assert made("uwoc/Random-v0", max_episode_steps=7).spec.max_episode_steps == 7
    assert made(made("uwoc/Random-v0", max_episode_steps=7).spec).spec.max_episode_steps == 7


def test_what_a_spec_says_of_their_length_ends_no_episode():
    env = gym.make("uwoc/Nominal-v0", scenario={"episode": {"duration_s": 0.5}})
    assert env.spec.max_episode_steps == 10

    def steps(env, duration_s=0.5):
        env.reset(seed=0, options={"scenario": {"episode": {"duration_s": duration_s}}})
        for step in range(1, 100):
            if env.step(ZERO)[3]:
                return step

    assert steps(env) == 10
    assert steps(env, 2.0) == 40
    assert steps(gym.make(env.spec)) == 10


def test_the_share_of_time_gone_is_seen():
    env = TimeAwareObservation(gym.make("uwoc/Random-v0", control_period_s=0.1), normalize_time=True)
    env.reset(seed=0)
    for _ in range(6):
        seen = env.step(ZERO)[0]
    assert seen[-1] == pytest.approx(6 / 600)


def test_standard_wrappers():
    env = NormalizeObservation(
        FrameStackObservation(RecordEpisodeStatistics(gym.make("uwoc/Random-v0", max_episode_steps=5)), 4)
    )
    obs, _ = env.reset(seed=0)
    assert obs.shape == (4, 20)
    for _ in range(5):
        *_, truncated, info = env.step(ZERO)
    assert truncated
    assert info["episode"]["l"] == 5


@pytest.mark.parametrize("vector", [False, True])
def test_an_assigned_generator_gives_its_own_episodes(vector):
    def start(generator, before=None):
        env = uwoc_gym.TrackingVectorEnv(3, "Random") if vector else gym.make("uwoc/Random-v0").unwrapped
        if before is not None:
            env.reset(seed=before)
        env.np_random = generator
        episodes = [env.reset()[0], env.reset()[0]]
        assert not np.array_equal(*episodes)
        return np.array(episodes)

    first = start(np.random.default_rng(1))
    np.testing.assert_array_equal(start(np.random.default_rng(1)), first)
    np.testing.assert_array_equal(start(np.random.default_rng(1), before=5), first)
    assert not np.array_equal(start(np.random.default_rng(2)), first)
    assert not np.array_equal(start(np.random.default_rng()), start(np.random.default_rng()))


def test_a_list_of_seeds_is_followed_by_its_own_episodes():
    env = uwoc_gym.TrackingVectorEnv(3, "Random")
    env.reset(seed=[4, 9, 2])
    expected = env.reset()[0]
    env.np_random = np.random.default_rng(1)
    env.reset(seed=[4, 9, 2])
    np.testing.assert_array_equal(env.reset()[0], expected)
    one = gym.make("uwoc/Random-v0")
    one.reset(seed=9)
    np.testing.assert_array_equal(one.reset()[0], expected[1])


@pytest.mark.parametrize("vector", [False, True])
def test_a_spec_tells_scenarios_of_one_name_apart(vector):
    def made(given, **options):
        if vector:
            return gym.make_vec(given, vectorization_mode="vector_entry_point", **options)
        return gym.make(given, **options)

    env = made("uwoc/Nominal-v0", scenario={"vehicle": {"mass_scale": 1.1}})
    digest = env.spec.kwargs["scenario_digest"]
    assert digest == env.unwrapped.scenario.digest() != made("uwoc/Nominal-v0").spec.kwargs["scenario_digest"]
    if not vector:
        assert (
            gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json())).unwrapped.scenario.digest() == digest
        )
    with pytest.warns(UserWarning, match=f"scenario_digest = '{digest}' was recorded of another scenario"):
        made("uwoc/Nominal-v0", scenario_digest=digest)
