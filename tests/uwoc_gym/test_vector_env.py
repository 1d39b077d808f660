"""The vector environment: equal to single ones, in every autoreset mode."""

import pickle
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList, NormalizeObservation, RecordEpisodeStatistics

import uwoc_gym
from uwoc_gym import TrackingVectorEnv
from uwoc_gym.sim.layout import info_names

INFO_NAMES = info_names(uwoc_gym.Scenario())

STEPS = 17
"""Short episodes, so that tests cross their ends."""


def make(n, mode=AutoresetMode.NEXT_STEP, **kwargs):
    kwargs = {"max_episode_steps": STEPS} | kwargs
    return gym.make_vec(
        "uwoc/Random-v0", num_envs=n, vectorization_mode="vector_entry_point", autoreset_mode=mode, **kwargs
    )


def actions(n, steps, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, n, 3)).astype(np.float32)


def test_is_what_make_vec_takes_by_default():
    assert isinstance(gym.make_vec("uwoc/Nominal-v0", num_envs=3).unwrapped, TrackingVectorEnv)


def test_chosen_parameters_replace_drawn_ones_for_one_episode():
    ranges = {"vehicle": {"mass_scale": (0.5, 2.0)}, "sea": {"pulses": [{"start_s": 0.1, "force_x_n": (0.0, 900.0)}]}}
    chosen = {"vehicle.mass_scale": [1.0, 1.5, 0.7], "sea.pulses[0].force_x_n": 700.0}
    env = TrackingVectorEnv(3, ranges)
    env.reset(seed=4, options={"parameters": chosen})
    push = np.full((3, 3), 0.5, dtype=np.float32)
    for _ in range(STEPS):
        env.step(push)
    for lane, mass_scale in enumerate(chosen["vehicle.mass_scale"]):
        fixed = {"vehicle": {"mass_scale": mass_scale}, "sea": {"pulses": [{"start_s": 0.1, "force_x_n": 700.0}]}}
        alone = TrackingVectorEnv(1, fixed)
        alone.reset(seed=4 + lane)
        for _ in range(STEPS):
            alone.step(push[:1])
        np.testing.assert_array_equal(alone.state()["pose"][0], env.state()["pose"][lane])
    env.reset(seed=4)
    plain = TrackingVectorEnv(3, ranges)
    plain.reset(seed=4)
    np.testing.assert_array_equal(env.parameters()["vehicle.mass_scale"], plain.parameters()["vehicle.mass_scale"])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_equals_gymnasiums_vector_of_single_environments(mode):
    n, seed = 5, 11
    ours = make(n, mode)
    theirs = gym.make_vec(
        "uwoc/Random-v0", num_envs=n, vectorization_mode="sync", max_episode_steps=STEPS,
        vector_kwargs={"autoreset_mode": mode},
    )  # fmt: skip
    obs, infos = ours.reset(seed=seed)
    expected, expected_infos = theirs.reset(seed=seed)
    np.testing.assert_array_equal(obs, expected)
    compare_infos(infos, expected_infos)
    for action in actions(n, 60):
        got, want = ours.step(action), theirs.step(action)
        for a, b in zip(got[:4], want[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        compare_infos(got[4], want[4])
        if "final_info" in want[4]:
            compare_infos(got[4]["final_info"], want[4]["final_info"])
            for a, b in zip(got[4]["final_obs"], want[4]["final_obs"], strict=True):
                np.testing.assert_array_equal(a, b)


def compare_infos(got, want):
    for name in INFO_NAMES:
        mask = want[f"_{name}"]
        np.testing.assert_array_equal(got[f"_{name}"], mask)
        np.testing.assert_array_equal(got[name][mask], want[name][mask])


def test_each_environment_equals_the_single_one_with_its_seed():
    n, seed = 4, 100
    env = make(n, AutoresetMode.SAME_STEP)
    batch = [env.reset(seed=seed)[0]] + [env.step(action)[0] for action in actions(n, 40)]
    for i in range(n):
        single = gym.make("uwoc/Random-v0", max_episode_steps=STEPS)
        seen = [single.reset(seed=seed + i)[0]]
        for action in actions(n, 40):
            obs, _, terminated, truncated, _ = single.step(action[i])
            seen.append(single.reset()[0] if terminated or truncated else obs)
        np.testing.assert_array_equal(np.array(batch)[:, i], seen)


def test_next_step_autoreset_ignores_the_action_and_gives_no_reward():
    env = make(2)
    env.reset(seed=0)
    steps = actions(2, STEPS)
    for action in steps:
        *_, truncated, _ = env.step(action)
    assert truncated.all()
    obs, reward, terminated, truncated, _ = env.step(np.full((2, 3), 0.9, dtype=np.float32))
    assert not reward.any()
    assert not terminated.any()
    assert not truncated.any()
    assert (obs[:, 15:18] == 0.0).all()


def test_disabled_autoreset_resets_by_mask_only():
    env = make(3, AutoresetMode.DISABLED)
    env.reset(seed=0)
    for action in actions(3, STEPS):
        last = env.step(action)[0]
    before = last.copy()
    last[:] = np.nan
    with pytest.raises(RuntimeError, match=r"simulations \[0, 1, 2\] have ended"):
        env.step(np.zeros((3, 3), dtype=np.float32))
    after, infos = env.reset(options={"reset_mask": np.array([True, False, True])})
    np.testing.assert_array_equal(after[1], before[1])
    assert not np.array_equal(after[0], before[0])
    np.testing.assert_array_equal(infos["_range_m"], [True, False, True])
    with pytest.raises(RuntimeError, match=r"\[1\]"):
        env.step(np.zeros((3, 3), dtype=np.float32))
    env.reset(options={"reset_mask": np.array([False, True, False])})
    env.step(np.zeros((3, 3), dtype=np.float32))


def test_returned_arrays_are_the_callers_own():
    env = make(3)
    obs, _ = env.reset(seed=0)
    obs[:] = np.nan
    first = env.step(np.zeros((3, 3), dtype=np.float32))
    kept = [np.copy(part) for part in first[:4]] + [np.copy(first[4]["range_m"])]
    for part in first[:4]:
        part[:] = 1
    first[4]["range_m"][:] = -1
    second = env.step(np.zeros((3, 3), dtype=np.float32))
    assert np.isfinite(second[0]).all()
    assert np.isfinite(kept[0]).all()
    assert (second[4]["range_m"] > 0).all()


def test_options_of_all_environments():
    env = make(2)
    pose = np.array([[0.0, 1.0, 0.2], [2.0, 3.0, 0.4]])
    env.reset(seed=0, options={"pose": pose, "velocity": (0.1, 0.0, 0.0), "scenario": {"depth_m": 2.0}})
    state = env.unwrapped.state()
    np.testing.assert_array_equal(state["pose"], pose)
    np.testing.assert_array_equal(state["velocity"], [[0.1, 0, 0]] * 2)
    np.testing.assert_array_equal(state["depth_m"], [2, 2])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reset_mask": np.array([True])}, "options['reset_mask'] = array([ True]) is not allowed"),
        ({"reset_mask": np.array([1, 0])}, "it must be a bool array of shape (2,)"),
        ({"reset_mask": np.array([False, False])}, "at least one True"),
        ({"reset_mask": np.array([True, False])}, "at the first reset"),
        ({"pose": np.zeros((3, 3))}, "of shape (3,) or (2, 3)"),
        ({"parameters": {"vehicle.mass_scale": [1.0, 1.0, 1.0]}}, "a number or of shape (2,)"),
        ({"start": 1}, "options['start'] is not known"),
    ],
)
def test_refuses_bad_options(options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make(2).reset(seed=0, options=options)


def test_refuses_a_scenario_for_some_environments():
    env = make(2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="beside options"):
        env.reset(options={"reset_mask": np.array([True, False]), "scenario": {"depth_m": 2.0}})


def test_refuses_bad_arguments_and_actions():
    with pytest.raises(ValueError, match="num_envs = 0 is not allowed; it must be a whole number from 1"):
        TrackingVectorEnv(0)
    with pytest.raises(ValueError, match="max_episode_steps = -1"):
        TrackingVectorEnv(2, max_episode_steps=-1)
    env = TrackingVectorEnv(2)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros((2, 3), dtype=np.float32))
    with pytest.raises(ValueError, match=r"seed = \[1\] has 1 entries"):
        env.reset(seed=[1])
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions = array.* must be finite and of shape \(2, 3\)"):
        env.step(np.zeros(3, dtype=np.float32))
    with pytest.raises(ValueError, match="of simulation 1 is not allowed; it must be finite"):
        env.step(np.array([[0, 0, 0], [0, np.nan, 0]], dtype=np.float32))
    assert not env.state()["time_s"].any()


def test_seeds_of_single_environments_can_be_listed():
    env = TrackingVectorEnv(2, scenario="Random")
    listed, _ = env.reset(seed=[8, None])
    np.testing.assert_array_equal(listed[0], TrackingVectorEnv(1, scenario="Random").reset(seed=8)[0][0])


def test_pickled_copy_goes_on_identically():
    env = make(3).unwrapped
    env.reset(seed=0)
    twin = pickle.loads(pickle.dumps(env))
    for action in actions(3, 25):
        np.testing.assert_array_equal(env.step(action)[0], twin.step(action)[0])


def test_vector_wrappers():
    env = DictInfoToList(NormalizeObservation(RecordEpisodeStatistics(make(2))))
    env.reset(seed=0)
    for action in actions(2, STEPS):
        *_, infos = env.step(action)
    assert [info["episode"]["l"] for info in infos] == [STEPS, STEPS]


def alike(n, seed=3):
    """Ours and Gymnasium's vector of the same environments, some steps into their episodes."""
    both = make(n, render_mode="rgb_array", render_size=(320, 180)), gym.make_vec(
        "uwoc/Random-v0", num_envs=n, vectorization_mode="sync", max_episode_steps=STEPS, render_mode="rgb_array",
        render_size=(320, 180),
    )  # fmt: skip
    for env in both:
        env.reset(seed=seed)
        for action in actions(n, 5):
            env.step(action)
    return [both[0].unwrapped, both[1]]


def test_what_is_called_by_name_is_what_gymnasiums_vectors_give():
    ours, theirs = alike(3)
    for env in (ours, theirs):
        assert env.call("push", (30.0, -50.0, 20.0)) == (None,) * 3
        env.step(actions(3, 1)[0])
    for name in ("state", "parameters"):
        for got, want in zip(ours.call(name), theirs.call(name), strict=True):
            assert {key: type(value) for key, value in got.items()} == {k: type(v) for k, v in want.items()}
            for key, value in want.items():
                np.testing.assert_array_equal(got[key], value, err_msg=key)
    for got, want in zip(ours.call("snapshot"), theirs.call("snapshot"), strict=True):
        assert got.shape == want.shape
        assert got["auv"].tobytes() == want["auv"].tobytes()
    for name in ("scenario", "action_space", "observation_space", "render_mode"):
        assert ours.get_attr(name) == theirs.get_attr(name)


def test_pictures_are_called_by_name():
    pytest.importorskip("pygame")
    ours, theirs = alike(2)
    shapes = [[frame.shape for frame in env.call("render")] for env in (ours, theirs)]
    assert shapes == [[(180, 320, 3)] * 2] * 2
    silent = TrackingVectorEnv(2)
    silent.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode|render mode"):
        assert silent.call("render") == (None, None)


def test_attributes_of_ones_own_are_kept():
    for env in alike(2):
        env.set_attr("level", [1, 2])
        assert env.get_attr("level") == (1, 2)
        env.set_attr("level", 5)
        assert env.get_attr("level") == (5, 5)
        with pytest.raises(ValueError, match="2"):
            env.set_attr("level", [1])
        with pytest.raises(AttributeError):
            env.get_attr("nothing_like_it")


def test_refuses_what_isnt_one_environments_own():
    env = TrackingVectorEnv(2)
    with pytest.raises(ValueError, match=r"set_attr\('scenario'\) is not allowed; the environments share"):
        env.set_attr("scenario", None)
    with pytest.raises(ValueError, match=r"call\('reset'\) is not allowed; reset acts on all"):
        env.call("reset")
    with pytest.raises(gym.error.ResetNeeded):
        env.call("push", (1.0, 0.0, 0.0))
    env = make(2, AutoresetMode.DISABLED).unwrapped
    env.reset(seed=0)
    for action in actions(2, STEPS):
        env.step(action)
    with pytest.raises(gym.error.ResetNeeded):
        env.push((1.0, 0.0, 0.0))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_autoreset_mode_is_where_others_look_for_it(mode):
    env = make(1, mode.value)
    assert env.metadata["autoreset_mode"] is env.unwrapped.autoreset_mode is mode


def test_metadata_belongs_to_the_instance():
    same, following = make(1, AutoresetMode.SAME_STEP), make(1)
    assert same.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert following.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert "autoreset_mode" not in uwoc_gym.TrackingVectorEnv.metadata


@pytest.mark.parametrize("seed", [[-1, 2], [1.9, 2], ["a", 2]])
def test_refuses_seeds_that_are_no_whole_numbers(seed):
    with pytest.raises(ValueError, match=r"seed\[0\] = .* is not allowed; it must be a whole number"):
        make(2).reset(seed=seed)


def test_refuses_what_is_no_mapping_or_no_action():
    env = TrackingVectorEnv(2)
    with pytest.raises(ValueError, match=r"options\['parameters'\] = 5 is not allowed"):
        env.reset(seed=0, options={"parameters": 5})
    with pytest.raises(ValueError, match="options = 5 is not allowed"):
        env.reset(seed=0, options=5)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions = 'x' are not allowed"):
        env.step("x")
