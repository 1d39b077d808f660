"""Policies compared over trainings and seeds."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym.agents.reports import comparison, tables


def test_what_says_never_is_counted():
    returns, reference = np.ones((2, 3)), np.ones((1, 3))
    measures = {measure.key: returns for measure in tables.MEASURES} | {"steps": returns}
    restoring = np.array([[np.inf, np.nan, 1.0], [2.0, 3.0, np.inf]])
    own = {"ppo": measures | {"restoring_time_s": restoring}}
    own["nlpd-tuned"] = dict.fromkeys(measures, reference) | {"arrival_time_s": np.array([[np.nan, 1.0, 1.0]])}
    found = comparison.compared(own)
    ppo = found["ppo"]["measures"]["restoring_time_s"]
    assert (ppo["mean"], ppo["values"], ppo["never"], ppo["episodes"]) == (2.0, 3, 2, 6)
    results = {"held_out_seeds": 3, "results": {"here": found}, "groups": {}, "microseconds_a_decision": {}}
    text = comparison.markdown("uwoc-gym protocol", results)
    assert "(5 of 6, 2 of them never)" in text
    assert "1.00 (1 of 3 never)" in text


def test_policies_alike_have_intervals_alike():
    returns = np.random.default_rng(0).normal(size=(3, 8))
    measures = {measure.key: returns for measure in tables.MEASURES} | {"steps": np.ones((3, 8))}
    reference = dict.fromkeys(measures, returns[:1])
    found = comparison.compared({"ppo": measures, "nlpd-tuned": reference, "td3": measures})
    assert found["ppo"] == found["td3"]
    assert found["ppo"]["return_iqm"]["low"] < found["ppo"]["return_iqm"]["high"]


def _measures(returns, possible):
    """Measures of episodes of those returns that lose everything at rest, by nearness."""
    own = {measure.key: returns for measure in tables.MEASURES} | {"steps": np.ones(returns.shape)}
    lost = {loss.key: np.zeros(returns.shape) for loss in tables.LOSSES}
    return own | lost | dict.fromkeys(("loss", "loss_rest", "loss_position"), possible - returns)


def test_half_lost_episodes_and_the_way_to_the_yardstick():
    reference, best = np.array([[2.0, 4.0, 6.0, 8.0]]), np.array([[6.0, 8.0, 9.0, 9.0]])
    agents = np.array([[3.0, 5.0, 8.0, 8.0], [1.0, 1.0, 9.0, 9.0]])
    policies = {"nlpd-tuned": reference, "clairvoyant": best, "ppo": agents}
    found = comparison.compared({name: _measures(own, 10.0) for name, own in policies.items()}, "Random", 10.0)
    ppo = found["ppo"]
    assert ppo["below_half"]["value"] == 3 / 8
    assert ppo["return_median"]["value"] == np.median(agents)
    assert ppo["losses"]["loss"] == ppo["losses"]["loss_rest"] == pytest.approx(10.0 - agents.mean())
    assert ppo["way"]["share"]["value"] == pytest.approx((agents.mean() - 5.0) / (best.mean() - 5.0))
    assert found["nlpd-tuned"]["way"]["share"]["value"] == 0.0
    results = {"held_out_seeds": 4, "results": {"Random": found}, "groups": {}, "microseconds_a_decision": {}}
    lines = [[cell.strip() for cell in line.split("|")] for line in comparison.markdown("x", results).splitlines()]
    rows = {line[1]: line[2:-1] for line in lines if len(line) > 3}
    assert [cell.split(" ")[0] for cell in rows["below half"]] == ["0.500", "0.000", "0.375"]
    assert [cell.split(" ")[0] for cell in rows["return, median"]] == ["5.0", "8.5", "6.5"]
    assert rows["loss"] == rows["loss: rest"] == rows["loss: position"] == ["5.0", "2.0", f"{10 - agents.mean():.1f}"]
    assert [cell.split(" ")[0] for cell in rows["way"]] == ["0.00", "1.00", f"{ppo['way']['share']['value']:.2f}"]
    del policies["clairvoyant"]
    found = comparison.compared({name: _measures(own, 10.0) for name, own in policies.items()}, "Random", 10.0)
    assert found["ppo"]["way"] is None
    assert "| way " not in comparison.markdown("x", results | {"results": {"Random": found}})
