"""The Stable-Baselines3 environment."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

import uwoc_gym
from uwoc_gym import ENV_IDS
from uwoc_gym.sb3 import TrackingVecEnv
from uwoc_gym.sim.layout import info_names

INFO_NAMES = info_names(uwoc_gym.Scenario())

STEPS = 17


def assert_alike(got, want):
    """Observations, rewards, ends and infos of two steps are the same."""
    for k in range(3):
        np.testing.assert_array_equal(got[k], want[k])
    for info, expected in zip(got[3], want[3], strict=True):
        assert {name: info[name] for name in INFO_NAMES} == {name: expected[name] for name in INFO_NAMES}
        assert info.get("TimeLimit.truncated", False) == expected["TimeLimit.truncated"]
        assert ("terminal_observation" in info) == ("terminal_observation" in expected)
        if "terminal_observation" in info:
            np.testing.assert_array_equal(info["terminal_observation"], expected["terminal_observation"])


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_passes_stable_baselines3s_checker(env_id):
    check_env(gym.make(env_id))
    check_env(gym.make(env_id).unwrapped)


def test_equals_stable_baselines3s_own_vector_environment():
    n, seed = 3, 7
    ours = TrackingVecEnv("uwoc/Random-v0", n, seed, info_keys=INFO_NAMES, max_episode_steps=STEPS)
    theirs = make_vec_env("uwoc/Random-v0", n, seed=seed, env_kwargs={"max_episode_steps": STEPS, "render_mode": None})
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    rng = np.random.default_rng(0)
    for _ in range(50):
        action = rng.uniform(-1, 1, (n, 3)).astype(np.float32)
        got, want = ours.step(action), theirs.step(action)
        assert_alike(got, want)
        assert ours.reset_infos[0].keys() == theirs.reset_infos[0].keys() - {"episode"}


def test_an_episode_lost_in_its_last_step_is_not_cut_short_by_time():
    for start_x_m, cut_short in ((100.0, False), (0.0, True)):
        env = TrackingVecEnv("uwoc/Nominal-v0", 1, seed=0, max_episode_steps=1)
        env.set_options({"pose": (start_x_m, 10.0, 0.0)})
        env.reset()
        _, _, dones, infos = env.step(np.zeros((1, 3), np.float32))
        assert dones[0]
        assert infos[0]["TimeLimit.truncated"] is cut_short
        env.close()


def test_methods_that_stable_baselines3_calls():
    env = TrackingVecEnv("uwoc/Nominal-v0", 2, seed=0)
    env.reset()
    states = env.env_method("state", indices=[1])
    assert states[0]["pose"].shape == (3,)
    assert env.get_attr("render_mode") == [None, None]
    assert env.env_is_wrapped(gym.Wrapper) == [False, False]
    env.set_attr("note", [1])
    assert env.get_attr("note") == [[1], [1]]
    with pytest.raises(ValueError, match=r"set_attr\('scenario'\) is not allowed"):
        env.set_attr("scenario", "Random")
    with pytest.raises(ValueError, match="leave out indices"):
        env.set_attr("note", 2, indices=0)
    env.close()


def test_options_are_for_the_next_reset_alone():
    env = TrackingVecEnv("uwoc/Random-v0", 2, seed=3)
    twin = uwoc_gym.TrackingVectorEnv(2, scenario="Random")
    together = {"pose": (1.0, 2.0, 0.5), "scenario": {"depth_m": 2.0}, "parameters": {"vehicle.mass_scale": 1.1}}
    env.set_options(together)
    np.testing.assert_array_equal(env.reset(), twin.reset(seed=[3, 4], options=together)[0])
    assert env.env_method("state")[1]["depth_m"] == 2.0
    np.testing.assert_array_equal(env.reset(), twin.reset()[0])
    each = [
        {"pose": (0.0, i, 0.0), "velocity": None, "parameters": {"vehicle.mass_scale": 1.0 + i / 9}} for i in (0, 1)
    ]
    env.set_options(each)
    with pytest.raises(ValueError, match=r"options\['pose'\] = 'x' is not allowed"):
        env.set_options({"pose": "x"})
    options = {"pose": [[0, 0, 0], [0, 1, 0]], "parameters": {"vehicle.mass_scale": [1.0, 1.0 + 1 / 9]}}
    np.testing.assert_array_equal(env.reset(), twin.reset(options=options)[0])


def test_refuses_other_environments_and_unknown_info():
    with pytest.raises(ValueError, match="env_id = 'CartPole-v1' is not allowed"):
        TrackingVecEnv("CartPole-v1", 1)
    with pytest.raises(ValueError, match="info_keys has 'speed'"):
        TrackingVecEnv("uwoc/Nominal-v0", 1, info_keys=("speed",))


def test_wrappers_and_a_short_training():
    env = VecNormalize(VecFrameStack(TrackingVecEnv("uwoc/Random-v0", 4, seed=0, max_episode_steps=STEPS), 2))
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=64, n_epochs=1, seed=0, device="cpu")
    model.learn(256)
    mean, _ = evaluate_policy(model, env, n_eval_episodes=4, warn=False)
    assert np.isfinite(mean)


def test_some_are_shoved():
    env = TrackingVecEnv("uwoc/Nominal-v0", 3, seed=0)
    with pytest.raises(gym.error.ResetNeeded):
        env.env_method("push", (0.0, 600.0, 0.0))
    env.reset()
    assert env.env_method("push", (0.0, 600.0, 0.0), indices=[1]) == [None]
    assert env.env_method("push", (0.0, 600.0, 0.0), indices=[]) == []
    sway = [each["velocity"][1] for each in env.env_method("state")]
    assert sway[0] == sway[2] == 0.0
    assert sway[1] > 0.0
    assert env.env_method("push", (0.0, 600.0, 0.0)) == [None] * 3
    single = gym.make("uwoc/Nominal-v0")
    single.reset(seed=0)
    single.unwrapped.push((0.0, 600.0, 0.0))
    assert env.env_method("state", indices=0)[0]["velocity"][1] == single.unwrapped.state()["velocity"][1]
    assert len(env.env_method("snapshot", indices=[1, 2])) == 2
    env.env_method("restore", env.vector_env.snapshot([1]), indices=[0])
    assert [each["velocity"][1] / sway[1] for each in env.env_method("state")] == [2.0, 2.0, 1.0]


class DelayAll(gym.vector.VectorWrapper):
    """Observations of the step before, zero at an episode's start."""

    def reset(self, *, seed=None, options=None):
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool))
        observations, infos = self.env.reset(seed=seed, options=options)
        if mask.all():
            self._last = np.zeros_like(observations)
        shown = np.where(mask[:, None], 0.0, self._last).astype(np.float32)
        self._last[mask] = observations[mask]
        return shown, infos

    def step(self, actions):
        observations, *rest = self.env.step(actions)
        shown, self._last = self._last, observations
        return shown, *rest


@pytest.mark.parametrize("wrapper", [lambda env: gym.wrappers.DelayObservation(env, 1), DelayAll], ids=["each", "all"])
def test_wrappers_of_both_kinds_equal_stable_baselines3s_own_loop(wrapper):
    n, seed = 3, 7
    ours = TrackingVecEnv("uwoc/Random-v0", n, seed, info_keys=INFO_NAMES, wrapper=wrapper, max_episode_steps=STEPS)
    theirs = make_vec_env(
        lambda **options: gym.wrappers.DelayObservation(gym.make("uwoc/Random-v0", **options), 1), n, seed=seed,
        env_kwargs={"max_episode_steps": STEPS},
    )  # fmt: skip
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    rng = np.random.default_rng(0)
    for _ in range(50):
        action = rng.uniform(-1, 1, (n, 3)).astype(np.float32)
        got, want = ours.step(action), theirs.step(action)
        assert_alike(got, want)
    each = wrapper is not DelayAll
    assert ours.env_is_wrapped(gym.wrappers.DelayObservation) == [each] * n
    assert ours.get_attr("scenario") == [ours.scenario] * n
    ours.env_method("push", (0.0, 1e3, 0.0), indices=[2])
    ours.set_attr("note", 1)
    assert ours.get_attr("note", indices=[0]) == [1]
    ours.set_options({"pose": (0.0, 2.0, 0.0)})
    ours.reset()
    assert ours.env_method("state")[2]["pose"].tolist() == [0.0, 2.0, 0.0]
    ours.close()


def test_wrappers_may_change_spaces_and_are_refused_out_of_order():
    flat = TrackingVecEnv("uwoc/Random-v0", 2, 0, wrapper=[
        lambda env: gym.wrappers.FrameStackObservation(env, 2), gym.wrappers.vector.FlattenObservation,
    ])  # fmt: skip
    assert flat.observation_space.shape == flat.reset()[0].shape == (40,)
    with pytest.raises(ValueError, match="TimeLimit goes around single environments, and must stand before"):
        TrackingVecEnv("uwoc/Random-v0", 2, wrapper=[gym.wrappers.vector.FlattenObservation, gym.wrappers.TimeLimit])
    with pytest.raises(TypeError, match="must return the Env that it is given, wrapped"):
        TrackingVecEnv("uwoc/Random-v0", 2, wrapper=lambda env: None)
    for bad in (3, [gym.wrappers.ClipAction, 3], "ClipAction", None):
        with pytest.raises(ValueError, match=r"wrapper = .* is not allowed; it must take an environment"):
            TrackingVecEnv("uwoc/Random-v0", 2, wrapper=bad)
    with pytest.raises(TypeError, match="infos of type list; they must be a dict"):
        TrackingVecEnv("uwoc/Random-v0", 2, wrapper=gym.wrappers.vector.DictInfoToList).reset()
    with pytest.raises(ValueError, match=r"max_episode_steps = 2000 .* at most the scenario's 1200"):
        TrackingVecEnv("uwoc/Random-v0", 2, wrapper=gym.wrappers.ClipAction, max_episode_steps=2000)
    timed = partial(gym.wrappers.TimeAwareObservation, normalize_time=True)
    aware = TrackingVecEnv("uwoc/Random-v0", 2, wrapper=timed, max_episode_steps=100)
    aware.reset()
    assert aware.step(np.zeros((2, 3), np.float32))[0][:, -1] == pytest.approx(1 / 100)
    single = TrackingVecEnv("uwoc/Random-v0", 2, wrapper=gym.wrappers.ClipAction)
    with pytest.raises(ValueError, match="must be one dict"):
        single.set_options([{"pose": (0.0, 1.0, 0.0)}, {"pose": (0.0, 2.0, 0.0)}])
    with pytest.raises(ValueError, match=r"options\['pose'\] = 'x' is not allowed"):
        single.set_options({"pose": "x"})


def test_training_in_wrappers():
    env = TrackingVecEnv(
        "uwoc/Random-v0", 4, seed=0, wrapper=lambda env: gym.wrappers.DelayObservation(env, 2), max_episode_steps=STEPS
    )
    PPO("MlpPolicy", env, n_steps=32, batch_size=64, n_epochs=1, seed=0, device="cpu").learn(256)
