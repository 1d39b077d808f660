"""The learned tracker as an observer; that it computes what PyTorch does stands in tests/agents/learning."""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from uwoc_gym import Scenario, TrackingVectorEnv
from uwoc_gym.agents.flight import fly
from uwoc_gym.baselines import Controller
from uwoc_gym.baselines.controllers import CONTROLLERS
from uwoc_gym.baselines.learned_tracker import (
    FEATURES,
    LONGEST_S,
    OUTPUTS,
    SHIPPED,
    LearnedTracker,
    Weights,
    motion,
    read_weights,
    told,
)
from uwoc_gym.given import SettingError
from uwoc_gym.task.observation import unpack

LATE = Scenario.named("LateFix")
SHIPPED_SHA256 = "67704e37902d555121571cef2cf030f576dbe7cb706f6994e6ebb6aa95539283"
UNITS = 5
SHAPES = ((3 * UNITS, FEATURES), (3 * UNITS,), (3 * UNITS, UNITS), (3 * UNITS,), (UNITS, UNITS), (UNITS,))


def weights(seed: int = 0) -> Weights:
    generator = np.random.default_rng(seed)
    return Weights(*(generator.normal(0.0, 0.5, shape) for shape in (*SHAPES, (OUTPUTS, UNITS), (OUTPUTS,))))


def test_weights_that_ship_stay_what_they_are() -> None:
    # Agents have learned behind them.
    assert hashlib.sha256(SHIPPED.read_bytes()).hexdigest() == SHIPPED_SHA256


def test_slopes_are_those_of_places_and_headings() -> None:
    generator = np.random.default_rng(1)
    coefficients, age_s, step_s = generator.normal(size=(40, OUTPUTS)), generator.uniform(0.0, 3.0, 40), 1e-4
    before, now, after = (motion(coefficients, age_s + shift) for shift in (-step_s, 0.0, step_s))
    for axis in range(2):
        np.testing.assert_allclose(now[1][axis], (after[0][axis] - before[0][axis]) / (2.0 * step_s), atol=1e-5)
        np.testing.assert_allclose(now[2][axis], (after[1][axis] - before[1][axis]) / (2.0 * step_s), atol=1e-5)
    np.testing.assert_allclose(now[4], (after[3] - before[3]) / (2.0 * step_s), atol=1e-5)


def test_past_the_longest_age_a_ship_goes_straight_on() -> None:
    coefficients = np.random.default_rng(3).normal(size=(5, OUTPUTS))
    last, later = (motion(coefficients, np.full(5, LONGEST_S + over_s)) for over_s in (0.0, 2.0))
    for axis in range(2):
        np.testing.assert_allclose(later[0][axis], last[0][axis] + 2.0 * last[1][axis])
        np.testing.assert_array_equal(later[1][axis], last[1][axis])
        assert last[2][axis].all()
        assert not later[2][axis].any()
    np.testing.assert_array_equal(later[3], last[3])
    assert not later[4].any()


def test_what_is_told_doesnt_hang_on_where_and_which_way() -> None:
    generator = np.random.default_rng(2)
    ship, before = generator.normal(0.0, 3.0, (2, 6, 3))
    since_s, first = np.full(6, 2.0), np.arange(6) == 4
    turn = 1.3
    cosine, sine = np.cos(turn), np.sin(turn)

    def moved(poses: np.ndarray) -> np.ndarray:
        x, y, yaw = poses.T
        return np.column_stack([cosine * x - sine * y + 7.0, sine * x + cosine * y - 2.0, yaw + turn])

    own = told(ship, before, since_s, first)
    np.testing.assert_allclose(told(moved(ship), moved(before), since_s, first), own, atol=1e-12)
    assert own[4].tolist() == [0.0, 0.0, 0.0, 0.0, 1.0, 1.0]


def test_lanes_begin_anew_and_dont_know_of_each_other() -> None:
    scenario = LATE.merged({"episode": {"duration_s": 6.0}})
    env = TrackingVectorEnv(3, scenario)
    together, alone = LearnedTracker(scenario, weights()), LearnedTracker(scenario, weights())
    observation, _ = env.reset(seed=5)
    memory, own, begun = None, None, np.ones(3, dtype=bool)
    for step in range(scenario.episode.steps + 30):
        seen = unpack(observation, scenario.observation)
        found, memory = together(seen, memory, begun)
        single = unpack(observation[1:2], scenario.observation)
        # From the second episode on one that knows nothing of the first.
        if begun[1]:
            alone, own = LearnedTracker(scenario, weights()), None
        lonely, own = alone(single, own, begun[1:2])
        for name in ("relative_position", "yaw_error", "relative_velocity", "ship_acceleration"):
            # Products of matrices of other sizes are rounded in another order.
            np.testing.assert_allclose(getattr(found, name)[1:2], getattr(lonely, name), atol=1e-12, err_msg=f"{step}")
        observation, _, terminated, truncated, _ = env.step(np.zeros((3, 3), dtype=np.float32))
        begun = terminated | truncated


def test_a_ship_that_isnt_heard_of_any_more_goes_straight_on() -> None:
    scenario = LATE.merged({"fixes": {"period_s": 9.0}})
    env = TrackingVectorEnv(4, scenario)
    tracker, memory = LearnedTracker(scenario, weights()), None
    observation, _ = env.reset(seed=0)
    late = []
    for _ in range(160):
        seen = unpack(observation, scenario.observation)
        found, memory = tracker(seen, memory, None)
        if (seen.fix_age_s > LONGEST_S).all():
            late.append(found)
        observation, *_ = env.step(np.zeros((4, 3), dtype=np.float32))
    assert len(late) > 60
    assert not np.any([found.ship_acceleration for found in late])
    assert np.isfinite([found.relative_position for found in late]).all()
    speeds = np.array([np.hypot(*(found.relative_velocity + found.velocity)[:, :2].T) for found in late])
    np.testing.assert_allclose(speeds, np.broadcast_to(speeds[0], speeds.shape), rtol=1e-9)


def test_laws_behind_it_are_ahead_of_those_behind_three_models() -> None:
    seeds = range(100_000, 100_024)
    learned, models = (fly(CONTROLLERS[name], LATE, seeds).metrics.return_ for name in ("gru-nlpd", "ekf-nlpd"))
    assert (learned > models).mean() > 0.7
    assert (learned - models).mean() > 40.0


def test_where_the_ship_is_seen_it_is_refused() -> None:
    with pytest.raises(SettingError, match="nothing to track where the ship is observed at all times"):
        Controller("nlpd-tuned", "Random", filtered=LearnedTracker)


@pytest.mark.parametrize("fault", ["missing", "text", "lacking", "shape", "nan"])
def test_files_that_arent_weights_are_refused(fault: str, tmp_path: Path) -> None:
    path, parts = tmp_path / f"{fault}.npz", weights()._asdict()
    if fault == "text":
        path.write_text("weights")
    elif fault != "missing":
        if fault == "lacking":
            del parts["out"]
        elif fault == "shape":
            parts["hidden"] = parts["hidden"][:, 1:]
        else:
            parts["out"][0, 0] = np.nan
        np.savez(path, **parts)
    with pytest.raises(
        SettingError, match=f"weights = '.*{fault}.npz' is not allowed.*tracker.npz of uwoc-gym tracker"
    ):
        Controller("nlpd-tuned", "LateFix", filtered=partial(LearnedTracker, weights=path))


def test_files_give_the_weights_back(tmp_path: Path) -> None:
    for seed in (0, 1):
        # What was read before isn't given again.
        np.savez(tmp_path / "own.npz", **weights(seed)._asdict())
        for own, other in zip(read_weights(tmp_path / "own.npz"), weights(seed), strict=True):
            np.testing.assert_array_equal(own, other)
