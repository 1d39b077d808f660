"""Flying a policy through seeded episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.baselines.policy import Policy

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 5.0}})


def test_a_lost_episode_ends_alone(still: Any) -> None:
    far = Scenario().merged({"start": {"x_m": -9.0, "y_m": (-4.0, 9.0)}, "episode": {"duration_s": 30.0}})
    policy = Policy("still", "", lambda scenario: still)
    flight = fly(policy, far, range(8))
    lost, steps = flight.metrics.lost, flight.metrics.steps
    assert 0 < lost.sum() < 8
    assert ((steps < 600) == (lost > 0)).all()
    for i in range(8):
        alone = fly(policy, far, [i]).metrics.rows()[0]
        assert list(alone.values()) == pytest.approx(list(flight.metrics.rows()[i].values()), nan_ok=True, abs=0.0)


def test_actions_of_another_shape_are_refused() -> None:
    class Wrong:
        def predict(self, observation: Any, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
            return np.zeros(3, dtype=np.float32), None

    with pytest.raises(CommandError, match=r"shape \(3,\)"):
        fly(Policy("wrong", "", lambda scenario: Wrong()), SHORT, [0, 1])


def test_a_policy_is_made_from_what_is_known_and_not_from_the_truth(still: Any) -> None:
    told = []

    def make(scenario: Scenario) -> Any:
        told.append(scenario)
        return still

    truth = SHORT.merged({"vehicle": {"mass_scale": 1.2}})
    fly(Policy("curious", "", make), truth, [0, 1])
    assert told == [truth.known()]
    assert told[0].vehicle.mass_scale == 1.0
    assert not told[0].sea.pulses
