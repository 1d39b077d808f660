"""Pictures of the environment: what they show, how they are recorded, and what closing the window does."""

import copy
import importlib
import itertools
import pickle
import re
import subprocess
import sys
import time

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from gymnasium.wrappers.vector import RecordVideo as RecordVectorVideo

from uwoc_gym import ENV_IDS, Scenario, TrackingEnv, TrackingVectorEnv
from uwoc_gym.baselines import NLPDController
from uwoc_gym.sim.fleet import Fleet
from uwoc_gym.world.sea.pulses import drawn_pulses

pygame = pytest.importorskip("pygame")
rendering = importlib.import_module("uwoc_gym.rendering")

ZERO = np.zeros(3, dtype=np.float32)
SMALL = (640, 360)


def fly(env, steps, seed=0):
    pilot = NLPDController(scenario=env.unwrapped.scenario)
    observation, _ = env.reset(seed=seed)
    for _ in range(steps):
        observation, *_ = env.step(pilot.predict(observation)[0])


def count(frame, colour, tolerance=3):
    """How many pixels have a colour."""
    return int((np.abs(frame.astype(int) - colour).max(axis=-1) <= tolerance).sum())


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_the_checkers_of_gymnasium_and_sb3_pass_in_each_mode(env_id):
    for mode in TrackingEnv.metadata["render_modes"]:
        env = gym.make(env_id, render_mode=mode)
        check_env(env.unwrapped, skip_render_check=mode == "human")
        env.close()
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(env_id, render_mode="rgb_array").unwrapped)


@pytest.mark.parametrize("size", [(1280, 720), (640, 720), (641, 361), (800, 1000), (320, 180)])
def test_a_frame_has_its_size_and_shows_the_link(size):
    env = TrackingEnv(scenario="StrongPulse", render_mode="rgb_array", render_size=size)
    env.reset(seed=0)
    outside = env.render()
    fly(env, 200)
    inside = env.render()
    for frame in (outside, inside):
        assert frame.dtype == np.uint8
        assert frame.shape == (size[1] // 2 * 2, size[0] // 2 * 2, 3)
        assert frame.flags.writeable
        assert frame.std(axis=(0, 1)).min() > 10.0
    # The header's lamp.
    header = size[1] // 14
    for frame, shown, absent in ((outside, rendering.RED, rendering.GREEN), (inside, rendering.GREEN, rendering.RED)):
        assert count(frame[: 2 * header], shown) > 10
        assert count(frame[: 2 * header], absent) == 0


def centre(frame, colour):
    """Mean column and row of the pixels of a colour."""
    return np.argwhere(np.abs(frame.astype(int) - colour).max(axis=-1) <= 3).mean(axis=0)[::-1]


@pytest.mark.parametrize("size", [(84, 84), (32, 32), (64, 48), (300, 400)])
def test_a_small_frame_shows_cone_ship_and_auv(size):
    env = TrackingEnv(scenario="Nominal", render_mode="rgb_array", render_size=size)
    env.reset(seed=0, options={"pose": (4.0, 10.0, 0.0), "velocity": (0.0, 0.0, 0.0)})
    ship = env.state()["ship_pose"]
    outside = env.render()
    assert outside.shape == (size[1], size[0], 3)
    # The ship lies 4 m south of the AUV: half the way from the picture's middle to its upper edge.
    np.testing.assert_allclose(ship[:2], (0.0, 10.0), atol=1e-9)
    side = min(size)
    for colour in (rendering.ACCENT, rendering.CONE_DARK):
        assert count(outside, colour) >= 4
    assert count(outside, rendering.CONE_LIT) == 0
    at = centre(outside, rendering.ACCENT)
    np.testing.assert_allclose(at, (size[0] / 2, size[1] / 2 - side * 4.0 / 17.6), atol=0.05 * side)
    env.reset(seed=0, options={"pose": (0.5, 10.0, 0.0), "velocity": (0.0, 0.0, 0.0)})
    inside = env.render()
    assert count(inside, rendering.CONE_DARK) == 0
    assert count(inside, rendering.CONE_LIT) >= 4
    assert count(inside, rendering.ACCENT) >= 4
    # The footprint, 2.2 m around the ship, is what it is in the picture's scale, less what stands on it.
    lit = count(inside, rendering.CONE_LIT) + count(inside, rendering.ACCENT) + count(inside, (255, 255, 255))
    assert lit == pytest.approx(np.pi * (2.2025 * side / 17.62) ** 2, rel=0.35 if side < 50 else 0.2)


def test_a_small_frame_shows_headings_and_what_is_far_off():
    env = TrackingEnv(scenario="Nominal", render_mode="rgb_array", render_size=(84, 84))
    frames = []
    for yaw in (0.0, 1.0, 2.0):
        env.reset(seed=0, options={"pose": (0.5, 10.0, yaw), "velocity": (0.0, 0.0, 0.0)})
        frames.append(env.render())
    assert not any(np.array_equal(a, b) for a, b in itertools.combinations(frames, 2))
    env.reset(seed=0, options={"pose": (0.0, 90.0, 0.0), "velocity": (0.0, 0.0, 0.0)})
    at = centre(env.render(), rendering.ACCENT)
    np.testing.assert_allclose(at, (84 * 0.94, 42), atol=3)


def test_a_banner_stays_off_the_ships_name():
    banner = (120, 40, 20)
    env = TrackingEnv(scenario="StrongPulse", render_mode="rgb_array", render_size=(640, 720))
    env.reset(seed=0)
    env.render()
    fly(env, 610)
    frame = env.render()
    rows, columns = np.nonzero(np.abs(frame.astype(int) - banner).max(axis=-1) <= 3)
    assert rows.size > 2000
    # The ship and its name are in the middle.
    assert columns.max() < 300
    # Words that would reach the name go to the other side.
    env = TrackingEnv(scenario="Nominal", render_mode="rgb_array", render_size=(640, 720))
    env.reset(seed=0)
    env.render()
    fly(env, 100)
    env.renderer.note("words enough to reach the name of the ship")
    rows, columns = np.nonzero(np.abs(env.render().astype(int) - banner).max(axis=-1) <= 3)
    assert columns.min() > 200
    assert columns.max() > 600


def test_frames_are_the_same_for_the_same_seed_and_follow_the_state():
    frames = []
    for _ in range(2):
        env = TrackingEnv(scenario="Random", render_mode="rgb_array", render_size=SMALL)
        env.reset(seed=3)
        env.render()
        fly(env, 30, seed=3)
        frames.append(env.render())
        env.step(ZERO)
        assert not np.array_equal(env.render(), frames[-1])
    np.testing.assert_array_equal(*frames)


def test_drawing_changes_no_episode():
    plain, drawn = TrackingEnv(scenario="Random"), TrackingEnv(scenario="Random", render_mode="rgb_array")
    for env in (plain, drawn):
        env.reset(seed=1)
    drawn.render()
    for _ in range(20):
        np.testing.assert_array_equal(plain.step(ZERO)[0], drawn.step(ZERO)[0])
        drawn.render()


def test_delivered_data_is_that_of_the_metrics():
    from uwoc_gym.agents.flight import fly as fly_record
    from uwoc_gym.agents.policies.registry import POLICIES

    scenario = Scenario.named("StrongPulse").merged({"episode": {"duration_s": 35.0}})
    env = TrackingEnv(scenario=scenario, render_mode="rgb_array", render_size=SMALL)
    env.reset(seed=0)
    env.render()
    fly(env, scenario.episode.steps)
    metrics = fly_record(POLICIES["nlpd"], scenario, [0]).metrics
    assert env.renderer.delivered_bit * 1e-9 == pytest.approx(metrics.delivered_gbit[0], rel=1e-9)
    assert env.renderer.delivered().endswith("Gbit delivered")


def test_what_was_not_seen_is_said():
    env = TrackingEnv(render_mode="rgb_array", render_size=SMALL)
    env.reset(seed=0)
    env.step(ZERO)
    env.render()
    assert env.renderer.delivered() == "0.0 Gbit delivered since 0.1 s"


@pytest.mark.parametrize(
    "scenario",
    [
        {"depth_m": 4.3},
        {"depth_m": 0.3},
        {"link": {"max_bit_rate_bps": 1e7}},
        {"link": {"field_of_view_rad": (0.2, 0.4)}},
        {"vehicle": {"max_sway_force_n": 1e-3}},
        {"episode": {"control_period_s": 0.005, "duration_s": 1.0}},
    ],
)
def test_unusual_scenarios_are_drawn(scenario):
    env = TrackingEnv(scenario=scenario, render_mode="rgb_array", render_size=SMALL)
    env.reset(seed=0)
    env.render()
    for _ in range(5):
        env.step(ZERO)
    assert env.render().std() > 10.0


def test_an_auv_far_off_is_drawn():
    env = TrackingEnv(render_mode="rgb_array", render_size=SMALL, scenario={"episode": {"lost_distance_m": 1e4}})
    env.reset(seed=0, options={"pose": (900.0, -700.0, 2.0)})
    assert env.render().std() > 10.0


def test_long_charts_reach_back_half_a_minute():
    env = TrackingEnv(scenario={"episode": {"control_period_s": 0.01}}, render_mode="rgb_array", render_size=SMALL)
    env.reset(seed=0)
    env.render()
    fly(env, 3200)
    renderer = env.renderer
    assert renderer.samples == 3201
    assert renderer.recent()[0, 0] == pytest.approx(2.0)
    env.render()


def test_render_fps_is_the_control_rate():
    for period, rate in ((None, 20), (0.1, 10), (0.005, 200)):
        for made in (TrackingEnv, TrackingVectorEnv):
            assert made(control_period_s=period).metadata["render_fps"] == rate


def test_record_video(tmp_path, video_facts):
    pytest.importorskip("moviepy")
    env = gym.make("uwoc/Random-v0", render_mode="rgb_array", render_size=SMALL, max_episode_steps=12)
    env = RecordVideo(env, str(tmp_path / "videos"), episode_trigger=lambda episode: True)
    fly(env, 12)
    env.close()
    (path,) = tmp_path.glob("videos/*.mp4")
    facts = video_facts(path)
    assert (facts.size, facts.frames_per_s, facts.frames) == (SMALL, 20, 13)


def test_record_video_of_a_vector_environment(tmp_path, video_facts):
    pytest.importorskip("moviepy")
    envs = gym.make_vec("uwoc/Random-v0", num_envs=3, render_mode="rgb_array", render_size=SMALL)
    envs = RecordVectorVideo(
        envs, str(tmp_path / "videos"), video_aspect_ratio=(16, 9), step_trigger=lambda step: step == 0, video_length=8
    )
    envs.reset(seed=0)
    for _ in range(12):
        envs.step(np.zeros((3, 3), dtype=np.float32))
    envs.close()
    (path,) = tmp_path.glob("videos/*.mp4")
    facts = video_facts(path)
    assert (facts.size, facts.frames_per_s, facts.frames) == ((3 * SMALL[0], SMALL[1]), 20, 9)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_pictures_of_a_vector_environment_are_those_of_single_ones(mode):
    scenario = Scenario.named("Random").merged({"episode": {"duration_s": 0.3}})
    envs = TrackingVectorEnv(2, scenario, render_mode="rgb_array", render_size=SMALL, autoreset_mode=mode)
    envs.reset(seed=5)
    envs.render()
    for _ in range(9):
        envs.step(np.zeros((2, 3), dtype=np.float32))
    frames = envs.render()
    assert len(frames) == 2
    for i, frame in enumerate(frames):
        env = TrackingEnv(scenario=scenario, render_mode="rgb_array", render_size=SMALL)
        env.reset(seed=5 + i)
        env.render()
        env.renderer.title = f"TrackingVectorEnv · {i}"
        for _ in range(6):
            env.step(ZERO)
        env.reset()
        for _ in range(2 if mode == "NextStep" else 3):
            env.step(ZERO)
        np.testing.assert_array_equal(env.render(), frame)


def test_pictures_of_an_sb3_environment():
    pytest.importorskip("stable_baselines3")
    from uwoc_gym.sb3 import TrackingVecEnv

    env = TrackingVecEnv("uwoc/Random-v0", 2, seed=0, render_mode="rgb_array", render_size=SMALL)
    assert env.get_attr("render_mode") == ["rgb_array"] * 2
    env.reset()
    assert env.render().shape == (2 * SMALL[1], SMALL[0], 3)


def test_human_mode_shows_each_step_and_returns_none():
    env = TrackingEnv(render_mode="human", render_size=SMALL, control_period_s=0.01)
    env.reset(seed=0)
    begun = time.perf_counter()
    for _ in range(20):
        assert not env.step(ZERO)[3]
    # At the rate of the control period, less what a busy machine's clock is off by.
    assert time.perf_counter() - begun > 0.1
    assert env.render() is None
    env.close()
    env.close()


def test_closing_the_window_ends_the_loop():
    env = gym.make("uwoc/Nominal-v0", render_mode="human", render_size=SMALL, control_period_s=0.005)
    steps = 0
    for _ in range(3):
        env.reset(seed=0)
        terminated = truncated = False
        while not (terminated or truncated):
            *_, terminated, truncated, _ = env.step(ZERO)
            steps += 1
            if steps == 5:
                pygame.event.post(pygame.event.Event(pygame.QUIT))
    # The step that finds the window closed ends the episode; later ones end at once.
    assert steps in (6, 7, 8)
    assert not terminated
    with pytest.raises(gym.error.ResetNeeded):
        env.unwrapped.step(ZERO)
    env.close()
    env.reset(seed=0)
    assert not env.step(ZERO)[3]
    env.close()


def test_no_display_is_said(monkeypatch):
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if sys.platform != "linux":
        pytest.skip("only on Linux can a display be taken away")
    pygame.display.quit()
    env = TrackingEnv(render_mode="human")
    with pytest.raises(rendering.NoDisplayError, match=r"no display.*rgb_array"):
        env.reset(seed=0)


def test_without_pygame_the_extra_is_named():
    code = (
        "import sys; sys.modules['pygame'] = None\n"
        "import gymnasium as gym\n"
        "env = gym.make('uwoc_gym:uwoc/Nominal-v0', render_mode='rgb_array')\n"
        "env.reset(); env.step(env.action_space.sample())\n"
        "for attempt in (env.render, lambda: gym.make('uwoc/Nominal-v0', render_mode='human')):\n"
        "    try: attempt()\n"
        "    except gym.error.DependencyNotInstalled as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout.splitlines() == ['pygame is not installed; run: pip install "uwoc-gym[render]"'] * 2


@pytest.mark.parametrize(
    ("made", "options", "message"),
    [
        (
            TrackingEnv,
            {"render_mode": "ansi"},
            "render_mode = 'ansi' is not allowed; it must be None or one of 'human', 'rgb_array'.",
        ),
        (TrackingVectorEnv, {"render_mode": "human"}, "HumanRendering"),
        (TrackingEnv, {"render_size": (84, 31)}, "render_size = (84, 31) is not allowed; it must be"),
        (TrackingEnv, {"render_size": (640.5, 360)}, "render_size"),
        (TrackingEnv, {"render_size": "big"}, "render_size = 'big'"),
        (TrackingVectorEnv, {"render_size": None}, "render_size = None"),
    ],
)
def test_bad_arguments_are_named(made, options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        made(**options)


def test_render_before_reset_and_without_a_mode():
    for made in (TrackingEnv, TrackingVectorEnv):
        with pytest.raises(gym.error.ResetNeeded, match="reset"):
            made(render_mode="rgb_array").render()
        with pytest.warns(UserWarning, match="rgb_array"):
            assert made().render() is None


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_draw_too(duplicate):
    for made in (TrackingEnv, lambda **options: TrackingVectorEnv(2, **options)):
        env = made(render_mode="rgb_array", render_size=SMALL)
        env.reset(seed=0)
        env.render()
        assert np.shape(duplicate(env).render()) == np.shape(env.render())


def test_a_push_changes_the_velocity_by_impulse_over_mass():
    env = TrackingEnv(scenario={"vehicle": {"mass_scale": 1.25}})
    env.reset(seed=0, options={"velocity": (0.1, 0.2, 0.3)})
    env.push((50.0, -40.0, 8.0))
    wanted = np.array([0.1, 0.2, 0.3]) + np.array([50.0, -40.0, 8.0]) / env.scenario.vehicle.inertia
    np.testing.assert_allclose(env.state()["velocity"], wanted, rtol=1e-14)
    env.step(ZERO)
    assert env.state()["pose"][0] > 5.0


def test_a_push_equals_a_short_pulse():
    pulse = {"start_s": 0.0, "duration_s": 1e-3, "force_x_n": 3e4, "force_y_n": -2e4, "moment_nm": 1e4}
    scenario = {"sea": {"pulses": [pulse]}, "episode": {"integration_step_s": 0.001}}
    with_pulse, pushed = TrackingEnv(scenario=scenario), TrackingEnv()
    for env in (with_pulse, pushed):
        env.reset(seed=0)
    pushed.push((30.0, -20.0, 10.0))
    for env in (with_pulse, pushed):
        for _ in range(20):
            env.step(ZERO)
    np.testing.assert_allclose(with_pulse.state()["pose"], pushed.state()["pose"], atol=2e-3)


@pytest.mark.parametrize("bad", [(1.0, 2.0), (0.0, np.nan, 0.0), "hard", None])
def test_bad_pushes_move_nothing(bad):
    env = TrackingEnv()
    with pytest.raises(gym.error.ResetNeeded, match="push"):
        env.push((0.0, 0.0, 0.0))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="impulse = "):
        env.push(bad)
    np.testing.assert_array_equal(env.state()["velocity"], 0.0)


def test_a_push_touches_its_lanes_only():
    fleet = Fleet(Scenario(), 40)
    fleet.seed(np.arange(40), list(range(40)))
    fleet.reset(np.zeros((40, 20), dtype=np.float32))
    fleet.push(np.array([0, 35]), (10.0, 0.0, 0.0))
    moved = np.flatnonzero(fleet.state()["velocity"][:, 0])
    np.testing.assert_array_equal(moved, [0, 35])


def test_pulses_are_put_into_words():
    env = TrackingEnv(scenario="StrongPulse")
    env.reset(seed=0)
    assert drawn_pulses(env.parameters()) == [(30.0, 31.0, "pulse: 1500 N, 1500 N, 1500 N m")]
    assert drawn_pulses({}) == []


def test_pictures_outlive_pygames_end():
    """In a process of its own, which a dead font would end."""
    code = (
        "import gymnasium as gym, numpy as np, pygame, uwoc_gym\n"
        "env = gym.make('uwoc/Random-v0', render_mode='rgb_array', render_size=(320, 180))\n"
        "env.reset(seed=0)\n"
        "before = env.render()\n"
        "for _ in range(2):\n"
        "    pygame.quit()\n"
        "    np.testing.assert_array_equal(env.render(), before)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
