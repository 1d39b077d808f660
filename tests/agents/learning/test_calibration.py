"""Searches for what the paper doesn't give: what they score."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import calibration
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.baselines import gains
from uwoc_gym.baselines.paper import PUBLISHED
from uwoc_gym.metrics import rmse, since_arrival, tracking_error


def point_of(law):
    axes = ("x", "y", "yaw")
    mu = {f"mu_{kind}_{axis}": getattr(law, f"mu_{kind}")[i] for kind in "pv" for i, axis in enumerate(axes)}
    return {**mu, "b": law.b_p[0]}


def test_nlpd_score_counts_published_tolerances():
    problem = calibration.nlpd_problem()
    (score, outcome), (pd_score, _) = problem.evaluate([point_of(gains("nlpd")), point_of(gains("pd"))])
    published = PUBLISHED["nominal", "NLPD"]
    away = [
        (outcome[key] - getattr(published, key)) / (0.01 if key == "arrival_time_s" else 0.02 * getattr(published, key))
        for key in ("rmse_x_m", "rmse_y_m", "rmse_yaw_rad", "arrival_time_s")
    ]
    assert score == pytest.approx(np.mean(np.square(away)))
    # Within tolerance in every number, which the PD isn't.
    assert score < 1.0 < pd_score


def test_case_score_is_that_of_the_best_window():
    wanted = np.array([PUBLISHED["case-1", name] for name in ("PD", "NLPD")])
    rows = np.zeros((len(calibration.WINDOWS), 2, 2, 5)) + wanted[:, None, :] * 2.0
    rows[7] = wanted[:, None, :]
    score, outcome = calibration.case_score(rows, wanted)
    assert score == 0.0
    assert outcome["window_end_s"] == calibration.WINDOWS[7][1]
    assert outcome["nlpd_rmse_x_m"] == pytest.approx(0.687)
    rows[7, 1, 0, 4] = np.inf
    assert calibration.case_score(rows, wanted)[0] > 0.01


def test_windows_rmse_is_that_of_the_metrics():
    scenario = Scenario().merged({"episode": {"duration_s": 60.0}})
    flight = fly(POLICIES["pd"], scenario, [0])
    rows = calibration.window_rows(flight)
    record = flight.record
    error = tracking_error(record.pose, record.ship_pose)
    for w in (0, 40, 100, len(calibration.WINDOWS) - 1):
        start, end = calibration.WINDOWS[w]
        time = record.time_s[:, None]
        counted = since_arrival(record.in_cone) & (time <= end + 1e-9)
        if not np.isnan(start):
            counted &= time >= start - 1e-9
        np.testing.assert_allclose(rows[w, :, :3], rmse(error, counted), rtol=1e-9)
    assert rows[0, 0, 3] == flight.metrics.arrival_time_s[0]
