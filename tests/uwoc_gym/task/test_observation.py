"""What is observed and done belongs to the scenario: groups of entries and kinds of action, in every environment."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.env_checker import check_env as sb3_check

import uwoc_gym
from uwoc_gym import ObservationSettings, Scenario, SettingError, unpack
from uwoc_gym.baselines import NLPDController, PDController
from uwoc_gym.sb3 import TrackingVecEnv
from uwoc_gym.task.action import KINDS
from uwoc_gym.task.observation import GROUPS, STANDARD

RANDOM = Scenario.named("Random")
BLIND = [name for name in STANDARD if name != "ship-acceleration"]
CHOICES = {
    "time": {"observation": {"groups": [*STANDARD, "time"]}},
    "no acceleration": {"observation": {"groups": BLIND}},
    "surge-yaw": {"action": "surge-yaw"},
    "all of them": {"observation": {"groups": ["time", *reversed(BLIND)]}, "action": "surge-yaw"},
}
choices = pytest.mark.parametrize("override", CHOICES.values(), ids=CHOICES)


def actions_for(scenario, count, size, seed=3):
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (count, size, len(scenario.actions))).astype(np.float32)


@choices
def test_spaces_follow(override):
    scenario = RANDOM.merged(override)
    env = gym.make("uwoc/Random-v0", scenario=override)
    assert env.action_space.shape == (len(KINDS[scenario.action]),)
    assert env.observation_space.shape == (sum(len(GROUPS[name]) for name in scenario.observation.groups),)
    vector = gym.make_vec("uwoc/Random-v0", num_envs=3, scenario=override, vectorization_mode="vector_entry_point")
    assert vector.single_action_space == env.action_space
    assert vector.single_observation_space == env.observation_space
    trained = TrackingVecEnv("uwoc/Random-v0", 3, scenario=override)
    assert trained.action_space == env.action_space
    assert trained.observation_space == env.observation_space


@choices
def test_checkers_find_nothing(override):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium_check(gym.make("uwoc/Random-v0", scenario=override).unwrapped, skip_render_check=True)
        sb3_check(gym.make("uwoc/Random-v0", scenario=override), warn=True)


@choices
def test_single_vector_and_sb3_environments_agree(override):
    scenario = RANDOM.merged(override)
    singles = [gym.make("uwoc/Random-v0", scenario=override) for _ in range(3)]
    vector = uwoc_gym.TrackingVectorEnv(3, scenario)
    trained = TrackingVecEnv("uwoc/Random-v0", 3, seed=5, scenario=override)
    observations = np.array([env.reset(seed=5 + i)[0] for i, env in enumerate(singles)])
    np.testing.assert_array_equal(vector.reset(seed=5)[0], observations)
    np.testing.assert_array_equal(trained.reset(), observations)
    for actions in actions_for(scenario, 60, 3):
        steps = [env.step(action) for env, action in zip(singles, actions, strict=True)]
        seen, rewards, *_ = vector.step(actions)
        np.testing.assert_array_equal(seen, [step[0] for step in steps])
        np.testing.assert_array_equal(rewards, [step[1] for step in steps])
        np.testing.assert_array_equal(trained.step(actions)[0], seen)


@choices
def test_groups_hold_what_the_standard_observation_holds(fly, override):
    """The same flight, seen through other groups: each entry is the one of its name."""
    scenario = RANDOM.merged(override)
    standard = RANDOM.merged({"action": scenario.action})
    own, other = fly(scenario, 5, max_episode_steps=40), fly(standard, 5, max_episode_steps=40)
    names = [entry.name for entry in scenario.observation.entries]
    for step, actions in enumerate(actions_for(scenario, 40, 5), start=1):
        own.step(actions)
        other.step(actions)
        np.testing.assert_array_equal(own.out, other.out)
        for place, name in enumerate(names):
            if name == "share of the episode gone":
                np.testing.assert_allclose(own.observations[:, place], step / 40, rtol=1e-6)
            else:
                reference = other.observations[:, standard.observation.place(name)]
                np.testing.assert_array_equal(own.observations[:, place], reference, err_msg=name)


def test_surge_yaw_is_the_wrench_without_its_sway(fly):
    both = fly(RANDOM, 5), fly(RANDOM.merged({"action": "surge-yaw"}), 5)
    for actions in actions_for(RANDOM, 50, 5):
        actions[:, 1] = 0.0
        states = both[0].step(actions), both[1].step(actions[:, [0, 2]])
        np.testing.assert_equal(states[1], states[0])
        own, others = both[1].measures(), both[0].measures()
        # The mean square of two actions and of three.
        np.testing.assert_allclose(own.pop("reward_effort"), 1.5 * others.pop("reward_effort"), rtol=1e-14)
        rewards = own.pop("reward"), others.pop("reward")
        assert (rewards[0] < rewards[1]).all()
        np.testing.assert_equal(own, others)
        np.testing.assert_array_equal(both[1].observations, both[0].observations)


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.permutations(list(GROUPS)), st.integers(1, len(GROUPS)), st.floats(0.1, 10.0))
def test_unpack_reads_any_choice_of_groups(order, count, scale):
    settings = ObservationSettings(groups=order[:count], position_scale_m=scale, velocity_scale_mps=2.0)
    values = np.random.default_rng(0).uniform(-1.0, 1.0, (4, settings.size))
    seen = unpack(values, settings)
    if "ship" in settings.groups:
        place = settings.place("ship position ahead")
        np.testing.assert_allclose(seen.relative_position, values[:, place : place + 2] * scale)
        np.testing.assert_allclose(seen.yaw_error, np.arctan2(values[:, place + 3], values[:, place + 2]))
    else:
        assert seen.relative_position is seen.yaw_error is seen.relative_velocity is None
    if "velocity" in settings.groups:
        place = settings.place("surge velocity")
        np.testing.assert_allclose(seen.velocity, values[:, place : place + 3] * [2.0, 2.0, 1.0])
    if "time" in settings.groups:
        np.testing.assert_array_equal(seen.elapsed, values[:, settings.place("share of the episode gone")])
    else:
        assert seen.elapsed is None
    with pytest.raises(ValueError, match=f"must be {settings.size} long"):
        unpack(np.zeros(settings.size + 1), settings)


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        (["ship", "velocty"], "did you mean 'velocity'"),
        (["ship", "ship"], "each of them once"),
        ([], "must be a list of names"),
        ("ship", "must be a list of names"),
    ],
)
def test_groups_that_are_not_allowed(groups, message):
    with pytest.raises(SettingError, match=rf"ObservationSettings.groups = .* is not allowed; .*{message}"):
        Scenario().merged({"observation": {"groups": groups}})


def test_the_kind_of_action_is_one_of_a_few():
    with pytest.raises(SettingError, match=r"Scenario\.action = 'surge' is not allowed; did you mean 'surge-yaw'\?"):
        Scenario(action="surge")
    with pytest.raises(SettingError, match=r"Scenario\.action = \('wrench', 'surge-yaw'\) is not allowed"):
        Scenario(action=("wrench", "surge-yaw"))


@pytest.mark.parametrize("override", [{"observation": {"groups": ["ship"]}}, {"action": "surge-yaw"}])
def test_an_episode_cannot_change_what_is_seen_or_done(override):
    env = gym.make("uwoc/Random-v0")
    with pytest.raises(ValueError, match=f"options\\['scenario'\\] must not change '{next(iter(override))}'"):
        env.reset(options={"scenario": override})


def test_controllers_fly_with_what_they_need():
    with_time = RANDOM.merged(CHOICES["time"])
    plain, timed = NLPDController(scenario=RANDOM), NLPDController(scenario=with_time)
    seen = np.random.default_rng(1).uniform(-1, 1, (6, 20)).astype(np.float32)
    np.testing.assert_array_equal(timed.predict(np.hstack([seen, seen[:, :1]]))[0], plain.predict(seen)[0])
    reordered = RANDOM.merged({"observation": {"groups": ["link", *STANDARD[:-1]]}})
    other = NLPDController(scenario=reordered).predict(np.hstack([seen[:, 18:], seen[:, :18]]))[0]
    np.testing.assert_array_equal(other, plain.predict(seen)[0])
    blind = RANDOM.merged(CHOICES["no acceleration"])
    with_all = PDController("pd-plain", scenario=RANDOM)
    action, _ = PDController("pd-plain", scenario=blind).predict(np.delete(seen, (10, 11, 12), axis=1))
    np.testing.assert_array_equal(action, with_all.predict(seen)[0])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            CHOICES["no acceleration"],
            "needs the observation group 'ship-acceleration', .* gain set without feedforward",
        ),
        ({"observation": {"groups": ["ship", "velocity"]}}, "needs the observation group 'heading'"),
    ],
)
def test_controllers_say_what_they_lack(override, message):
    with pytest.raises(SettingError, match=message):
        NLPDController(scenario=RANDOM.merged(override))
