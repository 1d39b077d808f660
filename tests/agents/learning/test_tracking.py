"""Teaching a network how ships sail."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from uwoc_gym import Scenario
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import tracking
from uwoc_gym.baselines.observers import CarriedFixes
from uwoc_gym.baselines.tracker import ShipTracker

SHORT = Scenario.named("LateFix").merged({"episode": {"duration_s": 12.0}})
SEEDS = range(1_000_000, 1_000_008)


@pytest.fixture(scope="module")
def ways() -> tracking.Ways:
    return tracking.sailed(SHORT, SEEDS)


def test_truths_are_of_one_ship(ways: tracking.Ways) -> None:
    period_s = SHORT.episode.control_period_s
    same = ways.fix[2:] == ways.fix[:-2]
    slope = (ways.truth[2:, :, :2] - ways.truth[:-2, :, :2]) / (2.0 * period_s)
    # Up to the errors of the AUV's own velocity, which move the frame.
    off = (slope - ways.truth[1:-1, :, 2:4])[same]
    assert float(off.abs().median()) < 0.05
    turning = (ways.truth[2:, :, 6] - ways.truth[:-2, :, 6]) / (2.0 * period_s)
    assert float((turning - ways.truth[1:-1, :, 7])[same].abs().median()) < 1e-3


def test_fixes_are_where_they_should_be(ways: tracking.Ways) -> None:
    # At the ping the ship was where the fix says, but for the fix's errors; shortly after it is still near.
    fresh = (ways.age_s > 0.4) & (ways.age_s < 0.6)
    back = ways.truth[fresh][:, :2] - ways.truth[fresh][:, 2:4] * ways.age_s[fresh][:, None]
    assert 0.2 < float(back.square().mean().sqrt()) < 0.6
    assert ways.fix[0].tolist() == [0] * len(SEEDS)
    assert int(ways.fix.max()) == len(ways.features) - 1
    assert ways.features[0, :, 4].tolist() == [1.0] * len(SEEDS)
    assert not ways.features[1:, :, 4].any()


def test_what_learns_computes_what_flies(ways: tracking.Ways) -> None:
    torch.manual_seed(3)
    network = tracking.Network(7)
    weights = network.weights()
    with torch.no_grad():
        wanted = network(ways.features).numpy()
    state = np.zeros((len(SEEDS), 7))
    for fix, features in enumerate(ways.features.double().numpy()):
        state = weights.step(features, state)
        np.testing.assert_allclose(weights.way(state), wanted[fix], atol=1e-5)


def test_learning_makes_the_loss_smaller(ways: tracking.Ways) -> None:
    torch.manual_seed(0)
    network = tracking.Network(16)
    losses = list(tracking.learn(network, ways, 120, 0))
    assert np.mean(losses[-20:]) < 0.6 * np.mean(losses[:20])


def test_the_same_seed_learns_the_same(ways: tracking.Ways) -> None:
    found = []
    for _ in range(2):
        torch.manual_seed(4)
        network = tracking.Network(4)
        losses = list(tracking.learn(network, ways, 3, 9))
        found.append((losses, [each.tolist() for each in network.weights()]))
    assert found[0] == found[1]


def test_episodes_with_fewer_fixes_join_those_with_more(ways: tracking.Ways) -> None:
    drawn = SHORT.merged({"fixes": {"period_s": [1.0, 1.5]}})
    more = tracking.sailed(drawn, range(3))
    joined = tracking.Ways.joined([ways, more])
    assert len(joined.features) == len(more.features) > len(ways.features)
    torch.manual_seed(1)
    network = tracking.Network(4)
    moments = torch.arange(joined.fix.shape[0])
    both, *each = (tracking.loss(network, part, moments).item() for part in (joined, ways, more))
    share = len(SEEDS) / (len(SEEDS) + 3)
    assert both == pytest.approx(share * each[0] + (1.0 - share) * each[1], rel=1e-4)


def test_errors_of_a_better_tracker_are_smaller() -> None:
    found = tracking.errors(SHORT, {"still": CarriedFixes, "models": ShipTracker}, range(16))
    for name in ("place_rms_m", "place_median_m", "velocity_rms_mps"):
        assert 0.0 < found["models"][name] < found["still"][name]


def test_errors_of_batches_are_those_of_all_together(monkeypatch: pytest.MonkeyPatch) -> None:
    own = tracking.errors(SHORT, {"models": ShipTracker}, range(6))
    monkeypatch.setattr(tracking, "BATCH", 4)
    assert tracking.errors(SHORT, {"models": ShipTracker}, range(6))["models"] == pytest.approx(own["models"])


def test_a_loss_that_isnt_finite_ends_it(ways: tracking.Ways) -> None:
    network = tracking.Network(4)
    with torch.no_grad():
        network.out.bias[0] = float("nan")
    with pytest.raises(CommandError, match="the loss isn't finite at step 1"):
        next(tracking.learn(network, ways, 5, 0))


def test_ships_sail_on_where_the_link_is_lost() -> None:
    below = SHORT.merged({"start": {"x_m": [-0.1, 0.1], "y_m": [-0.1, 0.1]}})
    near = below.merged({"episode.lost_distance_m": 0.3})
    seeds = range(4)
    assert (fly(tracking.PILOT, near, seeds).metrics.lost > 0.0).any()
    for own, other in zip(tracking.sailed(near, seeds), tracking.sailed(below, seeds), strict=True):
        assert torch.equal(own, other)


def test_a_ship_that_is_seen_is_refused() -> None:
    with pytest.raises(CommandError, match=r"--scenario: the observation groups ship, .* known by 'fix' alone"):
        tracking.check(Scenario.named("Random"))
