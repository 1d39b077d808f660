"""Policies compared over trainings and seeds."""

from __future__ import annotations

import numpy as np

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
