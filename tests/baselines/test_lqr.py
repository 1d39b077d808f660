"""The regulator: the Riccati equation that it solves, what it steers by, and where it holds."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym import Scenario, SettingError
from uwoc_gym.agents.flight import fly
from uwoc_gym.baselines.controllers import CONTROLLERS, Tuned
from uwoc_gym.baselines.lqr import Regulator, RegulatorScales, optimal, schedule


def test_the_double_integrator_has_its_textbook_gain() -> None:
    """ẍ = −u with cost ∫ x² + u²: K = (1, √2)."""
    found = optimal(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.diag([1.0, 0.0]))
    np.testing.assert_allclose(found, [[1.0, np.sqrt(2.0)]], atol=1e-12)


def test_the_gain_solves_the_riccati_equation_and_is_stable() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        change, push = rng.normal(size=(6, 6)), rng.normal(size=(6, 2))
        weights = np.diag(rng.uniform(0.1, 5.0, 6))
        gain = optimal(change, push, weights)
        closed = change - push @ gain
        assert np.linalg.eigvals(closed).real.max() < 0.0
        # The cost from x is xᵀ P x with closedᵀ P + P closed = −(Q + Kᵀ K), and K = Bᵀ P.
        both = np.kron(closed.T, np.eye(6)) + np.kron(np.eye(6), closed.T)
        riccati = np.linalg.solve(both, -(weights + gain.T @ gain).ravel()).reshape(6, 6)
        np.testing.assert_allclose(push.T @ riccati, gain, rtol=1e-6, atol=1e-8)


def test_the_slope_is_that_of_the_equation_of_motion() -> None:
    vehicle = Scenario().vehicle.nominal()
    m11, m22, m33 = vehicle.inertia
    u = 0.7
    found = vehicle.velocity_slope([u, 0.0, 0.0])
    linear = vehicle.damping(np.zeros(3))
    quadratic = (vehicle.damping(np.ones(3)) - linear)[0]
    expected = [
        [-(linear[0] + 2.0 * quadratic * u) / m11, 0.0, 0.0],
        [0.0, -linear[1] / m22, -m11 * u / m22],
        # Munk's moment.
        [0.0, (m11 - m22) * u / m33, -linear[2] / m33],
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=2e-4)
    several = vehicle.velocity_slope([[u, 0.0, 0.0], [0.1, 0.2, -0.3]])
    np.testing.assert_array_equal(several[0], found)


@pytest.mark.parametrize("world", ["Tide", "Underactuated"])
def test_every_speed_of_the_schedule_is_stable(world: str) -> None:
    scenario = Scenario.named(world).known()
    vehicle, axes = scenario.vehicle, [0, 2] if world == "Underactuated" else [0, 1, 2]
    gains = schedule(vehicle, axes, RegulatorScales())
    for speed, gain in zip(np.linspace(-3.0, 3.0, 25), gains, strict=True):
        u = speed if 1 in axes else np.copysign(max(abs(speed), 0.25), speed)
        change = np.zeros((6, 6))
        change[:3, 3:] = np.eye(3)
        change[1, 2] = u
        change[3:, 3:] = vehicle.velocity_slope([u, 0.0, 0.0])
        push = np.vstack([np.zeros((3, 3)), np.diag(1.0 / vehicle.inertia)])
        assert np.linalg.eigvals(change - push @ gain).real.max() < 0.0
    if world == "Underactuated":
        assert not gains[:, 1].any()
        # Forward it turns to starboard for a ship there, and backward to port.
        assert gains[-1, 2, 1] > 0.0 > gains[0, 2, 1]


def test_in_company_with_the_ship_it_only_makes_good_the_drag() -> None:
    law = Regulator(RegulatorScales())
    observation = np.zeros(20, np.float32)
    observation[[2, 13]] = 1.0
    observation[[e.name for e in Scenario().observation.entries].index("surge velocity")] = 0.8
    np.testing.assert_allclose(law.force(observation), [(70.0 + 100.0 * 0.8) * 0.8, 0.0, 0.0], atol=1e-4)


def test_what_is_far_counts_as_nearer() -> None:
    law = Regulator(RegulatorScales(reach_m=2.0))
    ahead = np.zeros((3, 20), np.float32)
    ahead[:, [2, 13]] = 1.0
    ahead[:, 0] = Scenario().observation.entry_scales[0] ** -1 * np.array([1.0, 4.0, 8.0])
    near, far, farther = law.force(ahead)[:, 0]
    assert far == pytest.approx(2.0 * near, rel=1e-4)
    assert farther == pytest.approx(far, rel=1e-4)


def test_several_scales_fly_as_each_would() -> None:
    scenario = Scenario.named("Tide").merged({"episode.duration_s": 5.0})
    sets = [RegulatorScales(place_m=0.5), RegulatorScales(reach_m=1.0), RegulatorScales(place_m=0.5)]
    together = fly(
        CONTROLLERS["lqr"].__class__("three", "", lambda known: Regulator(sets, known)), scenario, [5, 5, 5]
    ).metrics.return_
    alone = [fly(Tuned("lqr", each).policy("one"), scenario, [5]).metrics.return_[0] for each in sets]
    np.testing.assert_allclose(together, alone, rtol=1e-12)
    assert together[0] == together[2] != together[1]


def test_it_sails_where_the_paper_s_law_is_lost() -> None:
    scenario = Scenario.named("Underactuated")
    lqr, nlpd = (fly(CONTROLLERS[name], scenario, range(100_000, 100_016)).metrics for name in ("lqr", "nlpd-tuned"))
    assert lqr.return_.mean() > nlpd.return_.mean() + 300.0


def test_other_gains_are_refused() -> None:
    with pytest.raises(SettingError, match="it must be RegulatorScales"):
        Regulator({"place_m": 1.0})  # type: ignore[arg-type]
    with pytest.raises(SettingError, match=r"RegulatorScales.place_m = 0.0 is not allowed"):
        RegulatorScales(place_m=0.0)
