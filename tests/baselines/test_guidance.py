"""Line-of-sight guidance: what it asks for where that is plain, its symmetry, and a world that a PD law can't sail."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwoc_gym import Scenario, SettingError, unpack
from uwoc_gym.agents.flight import fly
from uwoc_gym.baselines.controllers import CONTROLLERS
from uwoc_gym.baselines.guidance import Guidance, GuidanceGains

SEEDS = settings(derandomize=True, deadline=None, max_examples=50)
# Entries of the standard observation that change sign where port and starboard are exchanged.
MIRRORED = [1, 3, 5, 6, 8, 9, 11, 12, 14, 16, 17]


def observation(**entries: float) -> np.ndarray:
    names = [each.name for each in Scenario().observation.entries]
    found = np.zeros(20, np.float32)
    found[[2, 13]] = 1.0
    for place, value in entries.items():
        found[names.index(place.replace("_", " "))] = value
    return found


def test_in_company_with_the_ship_it_only_makes_good_the_drag() -> None:
    law = Guidance(GuidanceGains())
    force = law.force(observation(surge_velocity=0.8))
    np.testing.assert_allclose(force, [(70.0 + 100.0 * 0.8) * 0.8, 0.0, 0.0], atol=1e-4)


def test_it_turns_to_a_ship_that_is_abeam() -> None:
    law = Guidance(GuidanceGains())
    assert law.force(observation(ship_position_to_starboard=0.5))[2] > 100.0
    assert law.force(observation(ship_position_to_starboard=-0.5))[2] < -100.0


def test_the_pull_is_capped() -> None:
    law = Guidance(GuidanceGains(pull_per_s=1.0, fastest_pull_mps=2.0, munk=0.0, surge_yields=0.0, surge_per_s=1.0))
    near, far, farther = (law.force(observation(ship_position_ahead=x / 4.0))[0] for x in (1.0, 4.0, 8.0))
    assert near == pytest.approx(0.5 * far, rel=1e-3)
    assert far == pytest.approx(farther, rel=1e-6)


def test_sway_gives_way_to_a_turn() -> None:
    abeam = observation(ship_position_to_starboard=0.5)
    pushes = [Guidance(GuidanceGains(sway_yields=each)).force(abeam)[1] for each in (0.0, 2.0, 50.0)]
    assert pushes[0] > 1000.0
    assert pushes[0] > 2.0 * pushes[1] > 0.0
    assert abs(pushes[2]) < 1.0


@SEEDS
@given(seed=st.integers(0, 2**32 - 1))
def test_port_and_starboard_are_alike(seed: int) -> None:
    seen = np.random.default_rng(seed).uniform(-1.0, 1.0, 20)
    mirrored = seen.copy()
    mirrored[MIRRORED] *= -1.0
    law = Guidance(GuidanceGains())
    np.testing.assert_allclose(law.force(mirrored), law.force(seen) * [1.0, -1.0, -1.0], rtol=1e-6, atol=1e-6)


def test_several_gain_sets_fly_side_by_side() -> None:
    laws = [GuidanceGains(), GuidanceGains(crab=0.0, facing=0.5), GuidanceGains(surge_per_s=1.0, munk=1.0)]
    seen = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 20)).astype(np.float32)
    together, _ = Guidance(laws).predict(seen)
    for k, each in enumerate(laws):
        np.testing.assert_array_equal(together[k], Guidance(each).predict(seen)[0][k])


def test_without_a_sway_force_it_is_far_ahead_of_the_tuned_nlpd() -> None:
    scenario = Scenario.named("Underactuated")
    returns = {name: fly(CONTROLLERS[name], scenario, range(12)).metrics.return_ for name in ("los", "nlpd-tuned")}
    assert returns["los"].mean() > 1050.0
    assert returns["nlpd-tuned"].mean() < 700.0
    assert CONTROLLERS["los"].pilot(scenario).predict(np.zeros((4, 20), np.float32))[0].shape == (4, 2)


def test_what_it_refuses() -> None:
    with pytest.raises(SettingError, match=r"GuidanceGains\.crab = -1\.0 is not allowed"):
        GuidanceGains(crab=-1.0)
    with pytest.raises(SettingError, match=r"gains = 'los' is not allowed; it must be GuidanceGains"):
        Guidance("los")  # type: ignore[arg-type]
    blind = Scenario().merged({"observation": {"groups": ["velocity", "heading"]}})
    with pytest.raises(SettingError, match="needs the observation group 'ship'"):
        Guidance(GuidanceGains(), blind)
    lost = Scenario.named("LateFix").merged({"observation": {"groups": ["fix", "velocity", "link"]}})
    with pytest.raises(SettingError, match="needs the observation group 'heading'"):
        Guidance(GuidanceGains(), lost)
    assert unpack(observation()).yaw_error == 0.0
