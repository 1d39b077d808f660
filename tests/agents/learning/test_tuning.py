"""Tuning: what is scored, on which seeds, and that the shipped gains are what they say."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import tuning
from uwoc_gym.agents.learning.seeds import VALIDATION, training_seed
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.baselines import gains

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 4.0}})


def test_score_is_the_mean_return_on_training_seeds():
    points = [tuning.point_of(gains(name), tuning.NLPD_BOX) for name in ("pd", "nlpd-tuned")]
    scored = tuning.controller_score(SHORT, 0, 6)(points)
    first = training_seed(0)
    for name, (score, outcome) in zip(("pd", "nlpd-tuned"), scored, strict=True):
        flown = fly(POLICIES[name], SHORT, range(first, first + 6)).metrics
        assert score == pytest.approx(flown.return_.mean(), rel=1e-3)
        assert outcome["availability"] == pytest.approx(flown.availability.mean(), rel=0.02)


def test_gains_of_a_point_and_back():
    law = gains("nlpd-tuned")
    point = tuning.point_of(law, tuning.NLPD_BOX)
    again = tuning.gains_of(point)
    for name in ("a_p", "a_v", "b_p", "b_v", "mu_p", "mu_v"):
        np.testing.assert_allclose(getattr(again, name), getattr(law, name))


@pytest.mark.parametrize(("tuned", "printed"), [("pd-tuned", "pd"), ("nlpd-tuned", "nlpd")])
def test_tuned_gains_beat_the_printed_ones_on_validation_seeds(tuned, printed):
    scenario = Scenario.named("Random")
    scores = {name: fly(POLICIES[name], scenario, VALIDATION[:32]).metrics.return_ for name in (tuned, printed)}
    assert (scores[tuned] - scores[printed]).mean() > 20.0
