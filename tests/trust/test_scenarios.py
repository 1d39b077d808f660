"""The short form of `scenarios`."""

from __future__ import annotations

import numpy as np

from tests.trust.scenarios import relative_error, tally


def test_random_scenarios_stay_finite_and_accurate() -> None:
    found = tally(12)
    assert found.worlds == 12 * 32
    assert found.tried >= found.accepted == 12
    assert (found.not_finite, found.diverged) == (0, 0)
    assert found.above == 0
    assert 0.0 < found.largest_error < 0.01


def test_a_step_that_is_too_long_would_be_seen(monkeypatch) -> None:
    monkeypatch.setattr("uwoc_gym.world.auv.limits.Motion.longest_step", lambda motion, rate: 8.0 / rate)
    found = tally(12)
    assert found.above + found.diverged > 0.1 * found.worlds


def test_errors_are_relative_to_the_way_that_was_gone() -> None:
    fine = np.zeros((3, 1, 3))
    fine[:, 0, 0] = (0.0, 2.0, 4.0)
    coarse = fine + np.array([0.0, 0.1, 0.0])
    np.testing.assert_allclose(relative_error(coarse, fine), [0.025])
