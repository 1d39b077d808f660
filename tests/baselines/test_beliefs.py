"""What filters believe as entries of an observation, against what the laws behind the same filters see."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from uwoc_gym import Scenario, SettingError, TrackingVectorEnv, unpack
from uwoc_gym.baselines.beliefs import Beliefs
from uwoc_gym.baselines.law import observer
from uwoc_gym.baselines.learned_tracker import LearnedTracker

LATE, TIDE = Scenario.named("LateFix"), Scenario.named("Tide")


def flown(scenario: Scenario, lanes: int, steps: int) -> list[tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]]:
    """Observations of a few flights, which begin anew after their ends, and where they do."""
    env = TrackingVectorEnv(lanes, scenario)
    observation, _ = env.reset(seed=3)
    rng = np.random.default_rng(0)
    found, begun, over = [(observation, np.ones(lanes, dtype=bool))], np.zeros(lanes, dtype=bool), None
    for _ in range(steps):
        action = rng.uniform(-1.0, 1.0, (lanes, len(scenario.actions))).astype(np.float32)
        observation, _, terminated, truncated, _ = env.step(action)
        begun = np.zeros(lanes, dtype=bool) if over is None else over
        found.append((observation, begun))
        over = terminated | truncated
    return found


@pytest.mark.parametrize(("learned", "tracker"), [(False, True), (True, LearnedTracker)])
def test_the_ship_that_is_believed_stands_as_one_that_is_seen(learned: bool, tracker: Any) -> None:
    """The further entries are those that `unpack` reads where the ship is observed, of what the law's filter says."""
    beliefs, law = Beliefs(LATE.known(), learned), observer(LATE.known(), tracker, {})
    full = LATE.merged({"observation.groups": ["ship", "ship-acceleration"]}).observation
    memory = own = None
    for observation, begun in flown(LATE, 3, 90):
        found, memory = beliefs(observation, memory, begun)
        seen, own = law(unpack(observation, LATE.observation), own, begun)
        size = LATE.observation.size
        np.testing.assert_array_equal(found[:, :size], observation)
        told = unpack(found[:, size : size + full.size], full)
        for name in ("relative_position", "yaw_error", "relative_velocity", "ship_acceleration"):
            wanted = getattr(seen, name)
            if name == "relative_position":
                wanted = np.clip(wanted, -5.0 * full.position_scale_m, 5.0 * full.position_scale_m)
            np.testing.assert_allclose(getattr(told, name), wanted, atol=2e-5, err_msg=name)
        np.testing.assert_allclose(found[:, size + full.size :], seen.water_velocity, atol=1e-6)  # type: ignore[arg-type]
    assert len(beliefs.names) == full.size + 2
    assert beliefs.names[0] == f"{'learned' if learned else 'believed'} ship position ahead"
    assert Beliefs.named(beliefs.names, LATE.known()).names == beliefs.names


def test_where_the_ship_is_seen_only_the_water_is_added() -> None:
    beliefs = Beliefs(TIDE.known())
    assert beliefs.names == ("believed water velocity ahead", "believed water velocity to starboard")
    memory = None
    env = TrackingVectorEnv(16, TIDE)
    observation, _ = env.reset(seed=0)
    for _ in range(300):
        found, memory = beliefs(observation, memory, None)
        observation, *_ = env.step(np.full((16, 3), 0.1, dtype=np.float32))
    state = env.state()
    x, y = state["current"].T
    yaw = state["pose"][:, 2]
    truth = np.column_stack([np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x])
    # After a quarter of a minute it knows most of the current.
    assert np.hypot(*(found[:, -2:] - truth).T).mean() < 0.3 * np.hypot(x, y).mean()


@pytest.mark.parametrize(
    ("scenario", "learned"), [(LATE, False), (LATE, True), (TIDE, False)], ids=["LateFix", "learned", "Tide"]
)
def test_an_episode_forgets_those_before_it_and_beside_it(scenario: Scenario, learned: bool) -> None:
    short = scenario.merged({"episode.duration_s": 1.0})
    beliefs = Beliefs(short.known(), learned)
    together, alone = flown(short, 3, 45), None
    memory = None
    for i, (observation, begun) in enumerate(together):
        found, memory = beliefs(observation, memory, begun)
        if i > 0 and begun[1]:
            alone = None
        one, alone = beliefs(observation[1:2], alone, np.zeros(1, dtype=bool) if alone is not None else None)
        np.testing.assert_allclose(found[1], one[0], rtol=1e-6, atol=1e-7)


def test_nothing_to_filter_is_refused() -> None:
    blind = TIDE.merged({"observation.groups": ["ship", "link"]})
    with pytest.raises(SettingError, match="the observation groups ship, link leave nothing to filter; filters need"):
        Beliefs(blind.known())
    unmoved = LATE.merged({"observation.groups": ["fix", "link"]})
    with pytest.raises(SettingError, match="needs the observation group 'velocity'"):
        Beliefs(unmoved.known())
    with pytest.raises(SettingError, match="nothing to track where the ship is observed at all times"):
        Beliefs(TIDE.known(), learned=True)
