"""Late fixes against a list of pings that is kept in plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from hypothesis import given, settings
from hypothesis import strategies as st

from uwoc_gym import Scenario, SettingError, TrackingEnv, TrackingVectorEnv, unpack

LATE = Scenario.named("LateFix")
EXACT = {"position_std_m": 0.0, "yaw_std_rad": 0.0, "dropout": 0.0}


def late(**fixes: object) -> Scenario:
    return LATE.merged({"fixes": fixes, "episode": {"duration_s": 15.0, "lost_distance_m": 1e4}})


def truth(env: TrackingVectorEnv) -> np.ndarray:
    """Where the ship is seen from the AUV, and its relative heading, (lanes, 3)."""
    state = env.state()
    apart = state["ship_pose"] - state["pose"]
    c, s = np.cos(state["pose"][:, 2]), np.sin(state["pose"][:, 2])
    x, y = apart[:, 0], apart[:, 1]
    return np.stack([c * x + s * y, c * y - s * x, np.angle(np.exp(1j * apart[:, 2]))], axis=1)


def apart(fix: np.ndarray, true: np.ndarray) -> np.ndarray:
    errors = fix - true
    errors[:, 2] = np.angle(np.exp(1j * errors[:, 2]))
    return errors


def told(scenario: Scenario, observation: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    seen = unpack(observation, scenario.observation)
    return np.concatenate([seen.fix_position, seen.fix_yaw_error[..., None]], -1), seen.fix_age_s, seen.fix_is_new


@settings(derandomize=True, deadline=None, max_examples=15)
@given(period=st.integers(1, 60), delay=st.integers(0, 100), odd=st.sampled_from([0.0, 0.013]))
def test_a_fix_is_what_was_true_at_its_ping(period: int, delay: int, odd: float) -> None:
    period_s = 0.05 * period + odd
    delay_s = min(0.05 * delay, 2.0 * period_s)
    scenario = late(period_s=period_s, delay_s=delay_s, **EXACT)
    env = TrackingVectorEnv(3, scenario)
    observation, _ = env.reset(seed=5)
    actions = np.random.default_rng(period).uniform(-0.3, 0.3, (200, 3, 3)).astype(np.float32)
    pings: list[tuple[float, np.ndarray]] = []
    held, before = None, None
    for step in range(200):
        time = 0.05 * step
        if time + 1e-9 >= len(pings) * period_s:
            pings.append((time, truth(env)))
        arrived = [k for k in range(len(pings)) if k == 0 or time + 1e-9 >= k * period_s + delay_s]
        before, held = held, arrived[-1]
        fix, age, new = told(scenario, observation)
        np.testing.assert_allclose(apart(fix, pings[held][1]), 0.0, atol=2e-5)
        np.testing.assert_allclose(age, time - pings[held][0], atol=1e-5)
        assert (new == float(held != before)).all()
        observation, *_ = env.step(actions[step])


def test_errors_have_their_deviations_from_the_first_fix_on() -> None:
    lanes = 4096
    scenario = late(period_s=1.0, delay_s=0.0, position_std_m=0.3, yaw_std_rad=0.05, dropout=0.0)
    env = TrackingVectorEnv(lanes, scenario)
    observation, _ = env.reset(seed=1)
    errors = []
    for step in range(41):
        if step % 20 == 0:
            errors.append(apart(told(scenario, observation)[0], truth(env)))
        observation, *_ = env.step(np.zeros((lanes, 3), np.float32))
    for each in errors:
        assert (np.abs(each.std(axis=0) / [0.3, 0.3, 0.05] - 1.0) < 4.5 / (2 * lanes) ** 0.5).all()
        assert (np.abs(each.mean(axis=0)) / [0.3, 0.3, 0.05] < 4.5 / lanes**0.5).all()
    correlation = np.corrcoef(np.concatenate(errors, axis=1).T) - np.eye(9)
    assert np.abs(correlation).max() < 4.5 / lanes**0.5


def test_lost_fixes_leave_the_one_before() -> None:
    lanes = 2048
    scenario = late(period_s=0.5, delay_s=0.25, dropout=0.4, position_std_m=0.0, yaw_std_rad=0.0)
    env = TrackingVectorEnv(lanes, scenario)
    observation, _ = env.reset(seed=2)
    came, oldest = [], 0.0
    for step in range(205):
        _, age, new = told(scenario, observation)
        # Ping 0 is known at once, so that it doesn't come a second time.
        if step % 10 == 5 and step > 5:
            came.append(new)
        elif step > 0:
            assert not new.any()
        oldest = max(oldest, age.max())
        observation, *_ = env.step(np.zeros((lanes, 3), np.float32))
    share = np.mean(came)
    assert abs(share - 0.6) < 4.5 * math.sqrt(0.24 / np.size(came))
    assert oldest > 2.0
    assert abs(np.corrcoef(came[3], came[4])[0, 1]) < 4.5 / lanes**0.5


def test_fixes_hang_on_seed_and_step_alone() -> None:
    scenario = late(dropout=0.3)
    many = TrackingVectorEnv(5, scenario, autoreset_mode=AutoresetMode.SAME_STEP)
    seen, _ = many.reset(seed=[7, 8, 9, 10, 11])
    one = TrackingEnv(scenario)
    alone, _ = one.reset(seed=9)
    for _ in range(300):
        np.testing.assert_array_equal(alone, seen[2])
        kept = one.snapshot()
        one.restore(kept)
        alone, *_ = one.step(np.zeros(3, np.float32))
        seen, _, _, ended, infos = many.step(np.zeros((5, 3), np.float32))
    assert ended.all()
    np.testing.assert_array_equal(alone, infos["final_obs"][2])
    fix, age, new = told(scenario, seen)
    assert np.isfinite(fix).all()
    assert (age == 0.0).all()
    assert new.all()


def test_numbers_of_fixes_are_drawn() -> None:
    scenario = late(period_s=(1.0, 4.0), delay_s=(0.0, 1.0), dropout=(0.0, 0.5))
    env = TrackingVectorEnv(64, scenario)
    env.reset(seed=0)
    drawn = env.parameters()
    assert np.ptp(drawn["fixes.period_s"]) > 2.0
    assert np.ptp(drawn["fixes.delay_s"]) > 0.7
    assert np.ptp(drawn["fixes.dropout"]) > 0.3


@pytest.mark.parametrize(
    ("fixes", "message"),
    [
        ({"delay_s": 9.0}, r"Fixes\.delay_s = 9\.0 is not allowed; it must be at most 2 times period_s = 2\.0 \[s\]"),
        ({"delay_s": (0.0, 3.0), "period_s": (0.7, 5.0)}, r"at most 2 times period_s"),
        ({"period_s": 0.04, "delay_s": 0.0}, r"Fixes\.period_s = 0\.04 .* at least .*control_period_s = 0\.05 \[s\]"),
        ({"dropout": 1.0}, r"Fixes\.dropout = 1\.0 .* \[0, 0\.99\]"),
    ],
)
def test_what_is_refused(fixes: dict[str, object], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        LATE.merged({"fixes": fixes})


def test_fixes_that_nobody_observes_change_nothing() -> None:
    plain, busy = Scenario(), Scenario().merged({"fixes": {"period_s": 0.04, "delay_s": 0.0}})
    assert not plain.draws
    assert not busy.draws
    assert plain.merged({"observation": {"groups": ["fix", "velocity", "heading"]}}).draws
    assert LATE.known().fixes == LATE.fixes.exact()
