"""The tracker against ships that sail as its models say, stepped finely and independently of its matrices."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.flight import fly
from uwoc_gym.baselines import Controller
from uwoc_gym.baselines.observers import Heard
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.baselines.tracker import ShipTracker, TrackerSettings

SHIPS, FIXES, PERIOD_S, FINE_S = 600, 12, 2.0, 0.01
SETTINGS = TrackerSettings(free_mps2=0.3, free_s=4.0, turning_rad_s2=0.03, steady_mps=0.05)


def free_ships(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Truth (fixes, ships, 6) of x, y, their rates and accelerations; and headings, which say nothing."""
    speed = np.hypot(SETTINGS.speed_mps, SETTINGS.speed_std_mps)
    x = np.zeros((SHIPS, 2))
    v = generator.normal(0.0, speed, (SHIPS, 2))
    a = generator.normal(0.0, SETTINGS.free_mps2, (SHIPS, 2))
    keep = np.exp(-FINE_S / SETTINGS.free_s)
    truth = []
    for step in range(round(FIXES * PERIOD_S / FINE_S)):
        if step % round(PERIOD_S / FINE_S) == 0:
            truth.append(np.concatenate([x, v, a], axis=1))
        x = x + FINE_S * v + 0.5 * FINE_S**2 * a
        v = v + FINE_S * a
        a = keep * a + SETTINGS.free_mps2 * np.sqrt(1.0 - keep**2) * generator.normal(size=(SHIPS, 2))
    return np.array(truth), generator.uniform(-3.0, 3.0, (len(truth), SHIPS))


def led_ships(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Truth (fixes, ships, 3) of x, y and the speed, and headings of ships that go where they head."""
    x = np.zeros((SHIPS, 2))
    speed = generator.normal(SETTINGS.speed_mps, SETTINGS.speed_std_mps, SHIPS)
    yaw, rate = generator.uniform(-3.0, 3.0, SHIPS), generator.normal(0.0, 0.1, SHIPS)
    truth, yaws = [], []
    for step in range(round(FIXES * PERIOD_S / FINE_S)):
        if step % round(PERIOD_S / FINE_S) == 0:
            truth.append(np.concatenate([x, speed[:, None]], axis=1))
            yaws.append(yaw)
        x = x + FINE_S * speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        speed = speed + SETTINGS.steady_mps * np.sqrt(FINE_S) * generator.normal(size=SHIPS)
        yaw = yaw + FINE_S * rate
        rate = rate + SETTINGS.turning_rad_s2 * np.sqrt(FINE_S) * generator.normal(size=SHIPS)
    return np.array(truth), np.array(yaws)


@pytest.mark.parametrize(("ships", "model", "tolerance"), [(free_ships, 2, 0.0), (led_ships, 0, 0.15)])
def test_errors_are_as_large_as_the_tracker_says(ships, model: int, tolerance: float) -> None:
    generator = np.random.default_rng(4)
    truth, yaws = ships(generator)
    tracker = ShipTracker(Scenario.named("LateFix"), SETTINGS)

    def fix(k: int) -> np.ndarray:
        place = truth[k, :, :2] + generator.normal(0.0, SETTINGS.position_std_m, (SHIPS, 2))
        return np.column_stack([place, yaws[k] + generator.normal(0.0, SETTINGS.yaw_std_rad, SHIPS)])

    nobody, everybody = np.zeros(SHIPS), np.ones(SHIPS, dtype=bool)
    track = tracker.begin(Heard(np.zeros((SHIPS, 3)), fix(0), nobody, nobody, everybody, everybody))
    innovations = []
    for k in range(1, FIXES):
        track, squares = tracker.learn(track, fix(k), np.full(SHIPS, k * PERIOD_S))
        innovations.append(squares[:, model])
    belief = track.models[model]
    error = truth[-1] - belief.mean
    estimation = np.einsum("ni,nij,nj->n", error, np.linalg.inv(belief.cov), error)
    # The courses of ships that are led are arcs to the tracker only, for which the tolerance is.
    for squares, freedoms in ((np.array(innovations), 2), (estimation, error.shape[1])):
        bound = 1.96 * np.sqrt(2.0 * freedoms / squares.size) + tolerance * freedoms
        assert abs(squares.mean() - freedoms) < bound


def test_weights_find_out_how_a_ship_sails() -> None:
    generator = np.random.default_rng(5)
    tracker = ShipTracker(Scenario.named("LateFix"), SETTINGS)
    nobody, everybody = np.zeros(SHIPS), np.ones(SHIPS, dtype=bool)
    for ships, models in ((free_ships, [2]), (led_ships, [0, 1])):
        truth, yaws = ships(generator)
        fixes = np.concatenate([truth[..., :2], yaws[..., None]], axis=-1)
        fixes += generator.normal(size=fixes.shape) * [0.3, 0.3, SETTINGS.yaw_std_rad]
        track = tracker.begin(Heard(fixes[0], fixes[0], nobody, nobody, everybody, everybody))
        for k in range(1, FIXES):
            track, _ = tracker.learn(track, fixes[k], np.full(SHIPS, k * PERIOD_S))
        assert np.median(track.weights[:, models].sum(axis=1)) > 0.9
        np.testing.assert_allclose(track.weights.sum(axis=1), 1.0)


def test_behind_it_a_law_is_far_ahead_of_the_same_law_on_carried_fixes() -> None:
    scenario = Scenario.named("LateFix")
    behind = Policy("behind", "", lambda known: Controller("nlpd-tuned", known, filtered=True))
    plain = Policy("plain", "", lambda known: Controller("nlpd-tuned", known))
    returns = [fly(policy, scenario, range(16)).metrics.return_.mean() for policy in (behind, plain)]
    assert returns[0] > 900.0
    assert returns[1] < 600.0
