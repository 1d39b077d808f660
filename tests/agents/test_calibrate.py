"""Searches for what the paper doesn't give: what they score, and that they can be stopped and resumed."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.flight import POLICIES, fly
from uwoc_gym.agents.learning import calibration as calibrate
from uwoc_gym.agents.learning import search
from uwoc_gym.agents.learning.search import Dimension
from uwoc_gym.agents.options import CommandError
from uwoc_gym.baselines import gains
from uwoc_gym.baselines.paper import PUBLISHED
from uwoc_gym.metrics import rmse, since_arrival, tracking_error

BOX = {"a": Dimension(-2.0, 2.0), "b": Dimension(0.01, 10.0, log=True)}


def bowl(points):
    return [((p["a"] - 0.5) ** 2 + np.log(p["b"]) ** 2, {"sum": p["a"] + p["b"]}) for p in points]


def run(folder, trials=48, evaluate=bowl, **changes):
    options = {"batch": 8, "seed": 3, "direction": "minimize", "sampler": "cma-es"} | changes
    return search.search(folder, {"target": "bowl"}, BOX, evaluate, trials=trials, **options)


def tried(folder):
    return list(csv.DictReader((folder / "trials.csv").read_text(encoding="utf-8").splitlines()))


@pytest.mark.parametrize("sampler", ["cma-es", "tpe"])
def test_search_finds_the_bottom_and_writes_what_it_tried(tmp_path, sampler):
    found = run(tmp_path, 96, sampler=sampler)
    assert found.finished
    assert found.best.score < 0.05
    rows = tried(tmp_path)
    assert len(rows) == found.trials == 96
    assert min(float(row["score"]) for row in rows) == found.best.score
    assert found.best.outcome["sum"] == found.best.values["a"] + found.best.values["b"]


def test_same_seed_tries_the_same(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        run(tmp_path / name, 24)
    assert (tmp_path / "one/trials.csv").read_text() == (tmp_path / "two/trials.csv").read_text()


def test_points_to_begin_with_are_tried_first(tmp_path):
    run(tmp_path, 8, begin=[{"a": 0.5, "b": 1.0}])
    first = tried(tmp_path)[0]
    assert (float(first["a"]), float(first["b"]), float(first["score"])) == (0.5, 1.0, 0.0)


def test_interrupted_search_keeps_its_batches_and_goes_on(tmp_path):
    batches = []

    def stop(points):
        batches.append(points)
        if len(batches) == 3:
            raise KeyboardInterrupt
        return bowl(points)

    found = run(tmp_path, evaluate=stop)
    assert not found.finished
    assert found.trials == 16
    before = (tmp_path / "trials.csv").read_text().splitlines()
    assert len(before) == 17
    again = run(tmp_path, resume=True)
    assert again.finished
    assert again.trials == 48
    assert (tmp_path / "trials.csv").read_text().splitlines()[:17] == before
    assert again.best.score <= found.best.score


def test_refuses_folders_that_do_not_fit(tmp_path):
    with pytest.raises(CommandError, match=r"--resume: there is no .*study\.db"):
        run(tmp_path, resume=True)
    run(tmp_path, 8)
    with pytest.raises(CommandError, match="holds a search already"):
        run(tmp_path)
    with pytest.raises(CommandError, match="holds a search with another target"):
        search.search(
            tmp_path, {"target": "dome"}, BOX, bowl,
            trials=16, batch=8, seed=3, direction="minimize", sampler="cma-es", resume=True,
        )  # fmt: skip
    (tmp_path / "study.db").write_bytes(b"not a database")
    with pytest.raises(CommandError, match="can't be used"):
        run(tmp_path, resume=True)


def test_interrupted_before_the_first_batch(tmp_path):
    def stop(points):
        raise KeyboardInterrupt

    with pytest.raises(CommandError, match="nothing was found"):
        run(tmp_path, evaluate=stop)


def point_of(law):
    axes = ("x", "y", "yaw")
    mu = {f"mu_{kind}_{axis}": getattr(law, f"mu_{kind}")[i] for kind in "pv" for i, axis in enumerate(axes)}
    return {**mu, "b": law.b_p[0]}


def test_nlpd_score_counts_published_tolerances():
    problem = calibrate.nlpd_problem()
    (score, outcome), (pd_score, _) = problem.evaluate([point_of(gains("paper")), point_of(gains("paper-pd"))])
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
    rows = np.zeros((len(calibrate.WINDOWS), 2, 2, 5)) + wanted[:, None, :] * 2.0
    rows[7] = wanted[:, None, :]
    score, outcome = calibrate.case_score(rows, wanted)
    assert score == 0.0
    assert outcome["window_end_s"] == calibrate.WINDOWS[7][1]
    assert outcome["nlpd_rmse_x_m"] == pytest.approx(0.687)
    rows[7, 1, 0, 4] = np.inf
    assert calibrate.case_score(rows, wanted)[0] > 0.01


def test_windows_rmse_is_that_of_the_metrics():
    scenario = Scenario().merged({"episode": {"duration_s": 60.0}})
    flight = fly(POLICIES["pd"], scenario, [0])
    rows = calibrate.window_rows(flight)
    record = flight.record
    error = tracking_error(record.pose, record.ship_pose)
    for w in (0, 40, 100, len(calibrate.WINDOWS) - 1):
        start, end = calibrate.WINDOWS[w]
        time = record.time_s[:, None]
        counted = since_arrival(record.in_cone) & (time <= end + 1e-9)
        if not np.isnan(start):
            counted &= time >= start - 1e-9
        np.testing.assert_allclose(rows[w, :, :3], rmse(error, counted), rtol=1e-9)
    assert rows[0, 0, 3] == flight.metrics.arrival_time_s[0]


def test_case_search_writes_a_scenario_that_flies(tmp_path, monkeypatch):
    monkeypatch.setattr(calibrate, "CASE_DURATION_S", 33.0)
    monkeypatch.setattr(calibrate, "WINDOWS", ((float("nan"), 32.0), (30.0, 32.5)))
    out = tmp_path / "case"
    assert main(["calibrate", "case-2", "--trials", "4", "--batch", "2", "--out", str(out)]) == 0
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert results["trials"] == 4
    assert results["scenarios"] == {
        name: scenario.digest() for name, scenario in calibrate.case_problem("case-2", "found").scenarios.items()
    }
    assert main(["benchmark", "--policy", "pd", "--scenario", str(out / "scenario.json"), "--seeds", "1"]) == 0
