"""Tuning: what is scored, on which seeds, and that the shipped gains are what they say."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cluster import workers
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import tuning
from uwoc_gym.agents.learning.search import Dimension
from uwoc_gym.agents.learning.seeds import VALIDATION, training_seed
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.baselines import gains
from uwoc_gym.baselines.controllers import Tuned, begun
from uwoc_gym.baselines.planner import PlannerSettings

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 4.0}})


def test_score_is_the_mean_return_on_training_seeds():
    box = tuning.box_of("nlpd", SHORT)
    points = [tuning.point_of(gains(name), box) for name in ("pd", "nlpd-tuned")]
    with workers(1) as crew:
        scored = tuning.controller_score("nlpd", SHORT, 0, 6, crew)(points)
    first = training_seed(0)
    for name, (score, outcome) in zip(("pd", "nlpd-tuned"), scored, strict=True):
        flown = fly(POLICIES[name], SHORT, range(first, first + 6)).metrics
        assert score == pytest.approx(flown.return_.mean(), rel=1e-3)
        assert outcome["availability"] == pytest.approx(flown.availability.mean(), rel=0.02)


def test_a_law_that_flies_alone_is_scored_alike():
    scenario = SHORT.merged({"episode": {"duration_s": 1.0}})
    rest = PlannerSettings(candidates=8.0, rounds=1.0)
    points = [{"horizon_s": 1.0}, {"horizon_s": 0.5}]
    with workers(1) as crew:
        scored = tuning.controller_score("mppi", scenario, 0, 2, crew, rest=rest)(points)
    first = training_seed(0)
    for point, (score, _) in zip(points, scored, strict=True):
        policy = Tuned("mppi", rest.merged(point)).policy("one")
        assert score == pytest.approx(fly(policy, scenario, range(first, first + 2)).metrics.return_.mean())


def test_gains_of_a_point_and_back():
    law = gains("nlpd-tuned")
    point = tuning.point_of(law, tuning.box_of("nlpd", SHORT))
    again = tuning.gains_of("nlpd", point).gains
    for name in ("a_p", "a_v", "b_p", "b_v", "mu_p", "mu_v"):
        np.testing.assert_allclose(getattr(again, name), getattr(law, name))


@pytest.mark.parametrize("law", tuning.SEARCHED)
def test_every_law_has_a_box_that_holds_what_its_search_begins_at(law):
    box = tuning.box_of(law, SHORT)
    start = begun(law).gains
    point = tuning.point_of(start, box)
    again = tuning.gains_of(law, point, rest=start)
    assert again.law == law
    assert tuning.point_of(again.gains, box) == pytest.approx(point)


def test_pd_gains_are_searched_for_in_proportion_to_the_limits():
    strong, weak = (tuning.box_of("ekf-pd", Scenario.named(name)) for name in ("Random", "Tide"))
    assert "b_p_xy" not in strong
    (surge, _, yaw), (weak_surge, _, weak_yaw) = (
        Scenario.named(name).vehicle.force_limits for name in ("Random", "Tide")
    )
    assert strong["a_p_xy"].high / weak["a_p_xy"].high == pytest.approx(surge / weak_surge) == 8.0
    assert strong["a_v_yaw"].low / weak["a_v_yaw"].low == pytest.approx(yaw / weak_yaw)
    # Without a sway force the surge force still says what a gain is worth.
    bare = tuning.box_of("pd", Scenario.named("Underactuated"))
    assert bare["a_p_xy"] == strong["a_p_xy"]


def test_bounds_can_be_said():
    box = tuning.box_of("nlpd", SHORT)
    found = tuning.changed(box, ["a_p_xy=5:50", "mu_p_yaw=0.5:0.75"])
    assert found["a_p_xy"] == Dimension(5.0, 50.0, log=True)
    assert found["mu_p_yaw"] == Dimension(0.5, 0.75)
    assert {name: found[name] for name in box.keys() - {"a_p_xy", "mu_p_yaw"}} == {
        name: box[name] for name in box.keys() - {"a_p_xy", "mu_p_yaw"}
    }


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("a_p_xy", "--box a_p_xy: it must be name=low:high with low < high"),
        ("a_p_xy=5:3", "it must be name=low:high with low < high"),
        ("a_p_xy=few:3", "it must be name=low:high with low < high"),
        ("a_p_yx=1:3", "there is no number 'a_p_yx'; did you mean 'a_p_xy'"),
        ("a_p_xy=0:3", "the search is on a log scale, so that low must be above 0"),
    ],
)
def test_bounds_that_are_not_allowed(word, said):
    with pytest.raises(CommandError) as caught:
        tuning.changed(tuning.box_of("pd", SHORT), [word])
    assert said in str(caught.value)


@pytest.mark.parametrize(("tuned", "printed"), [("pd-tuned", "pd"), ("nlpd-tuned", "nlpd")])
def test_tuned_gains_beat_the_printed_ones_on_validation_seeds(tuned, printed):
    scenario = Scenario.named("Random")
    scores = {name: fly(POLICIES[name], scenario, VALIDATION[:32]).metrics.return_ for name in (tuned, printed)}
    assert (scores[tuned] - scores[printed]).mean() > 20.0
