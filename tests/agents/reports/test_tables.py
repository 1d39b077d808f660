"""Tables of what was flown."""

from __future__ import annotations

import math

from uwoc_gym.agents.reports import tables


def test_the_benchmark_counts_what_says_never() -> None:
    measures = {measure.key: 1.0 for measure in tables.MEASURES}
    rows = [
        measures | {"arrival_time_s": math.nan, "restoring_time_s": math.nan},
        measures | {"arrival_time_s": 2.0, "restoring_time_s": math.inf},
        measures | {"arrival_time_s": 2.0, "restoring_time_s": 0.25},
    ]
    (found,) = tables.results_data([tables.Result("Random", "pd", rows, False)], 0)
    counts = {key: (entry["values"], entry["never"], entry["episodes"]) for key, entry in found["measures"].items()}
    assert counts["arrival_time_s"] == (2, 1, 3)
    assert counts["restoring_time_s"] == (1, 1, 3)
    assert counts["return"] == (3, 0, 3)
    lines = {
        line.split("|")[1].strip(): line.split("|")[2].strip()
        for line in tables.table([found]).split("\n")
        if "|" in line
    }
    assert lines["t_a [s]"] == "2.00 (1 of 3 never)"
    assert lines["Δt [s]"] == "0.25 (2 of 3, 1 of them never)"


def test_one_episode_says_never_or_that_a_measure_does_not_apply() -> None:
    by_key = {measure.key: measure for measure in tables.MEASURES}
    assert by_key["arrival_time_s"].text(math.nan) == "never"
    assert by_key["establishment_time_s"].text(math.nan) == "never"
    assert by_key["restoring_time_s"].text(math.inf) == "never"
    assert by_key["restoring_time_s"].text(math.nan) == by_key["rmse_x_m"].text(math.nan) == "–"
    assert by_key["restoring_time_s"].text(0.456) == "0.46"
