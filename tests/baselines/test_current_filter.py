"""The filter for the current: what it finds, and how sure it is of it."""

from __future__ import annotations

import numpy as np

from uwoc_gym import Scenario, TrackingVectorEnv, unpack
from uwoc_gym.baselines.current_filter import CurrentFilter, CurrentFilterSettings
from uwoc_gym.baselines.kalman import Belief

LANES = 64
# The model is right and nothing pushes, so that the filter's assumptions hold but for what it calls unknown.
KNOWN = Scenario.named("Tide").merged(
    {
        "vehicle": {"mass_scale": 1.0, "damping_scale": 1.0},
        "sea": {"pulses": [], "current": {"std_mps": 0.0}},
        "sensors": {"velocity_std_mps": 0.02, "yaw_rate_std_rad_s": 0.01, "yaw_std_rad": 0.0},
        "episode": {"lost_distance_m": 1e4},
    }
)


def flights(scenario: Scenario, steps: int):  # type: ignore[no-untyped-def]
    """Observations and the current in the earth frame, (LANES, 2), under actions that are held for a while."""
    env = TrackingVectorEnv(LANES, scenario)
    observation, _ = env.reset(seed=11)
    generator = np.random.default_rng(2)
    for step in range(steps):
        water = env.snapshot()["current"]
        yield unpack(observation, scenario.observation), np.stack([water["x"], water["y"]], axis=1)
        if step % 30 == 0:
            action = generator.uniform(-1.0, 1.0, (LANES, 3)).astype(np.float32)
        observation, *_ = env.step(action)


def test_it_finds_the_current_and_knows_how_well() -> None:
    settings = CurrentFilterSettings(drift_mps=0.0, force=0.001)
    own = CurrentFilter(KNOWN.known(), settings)
    belief, squares = None, []
    for seen, current in flights(KNOWN, 300):
        water = current
        if belief is None:
            belief = own.begin(seen)
            continue
        belief, square = own.learn(belief, seen)
        squares.append(square)
    error = belief.mean[:, 3:] - water
    assert np.sqrt((error**2).mean()) < 0.01
    # NEES and NIS within their 95 % bounds, wider by 5 % and 3 % for a plant that is stepped more finely.
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(belief.cov[:, 3:, 3:]), error)
    assert abs(nees.mean() - 2.0) < 1.96 * np.sqrt(4.0 / LANES) + 0.1
    nis = np.array(squares)
    assert abs(nis.mean() - 3.0) < 1.96 * np.sqrt(6.0 / nis.size) + 0.1


def test_it_is_near_where_the_plant_is_another() -> None:
    scenario = Scenario.named("Tide")
    observe, memory = CurrentFilter(scenario.known()), None
    for seen, current in flights(scenario, 100):
        water = current
        found, memory = observe(seen, memory, None)
    heading = seen.heading
    turned = np.stack(
        [
            heading[:, 0] * water[:, 0] + heading[:, 1] * water[:, 1],
            heading[:, 0] * water[:, 1] - heading[:, 1] * water[:, 0],
        ],
        axis=1,
    )
    assert np.median(np.linalg.norm(found.water_velocity - turned, axis=1)) < 0.12
    assert np.median(np.linalg.norm(water, axis=1)) > 0.3


def test_a_new_episode_begins_anew() -> None:
    observe, memory = CurrentFilter(KNOWN.known()), None
    for seen, _ in flights(KNOWN, 40):
        _, memory = observe(seen, memory, None)
    begun = np.arange(LANES) == 3
    _, after = observe(seen, tuple(each.copy() for each in memory), begun)
    _, fresh = observe(seen, None, None)
    for whole, own in zip(after, fresh, strict=True):
        np.testing.assert_array_equal(whole[3], own[3])
        assert not np.array_equal(whole[2], own[2])
    assert isinstance(Belief(*after), Belief)
