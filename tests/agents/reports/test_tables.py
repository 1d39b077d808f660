"""Tables of what was flown."""

from __future__ import annotations

import math

import pytest

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


NAMES = {
    "a|b": r"a\|b",
    "a\nb\r\n c": "a b c",
    "a`b`": r"a\`b\`",
    "<b>&amp;": r"\<b\>\&amp;",
    "[a](b)": r"\[a\](b)",
    "*a*~~b~~": r"\*a\*\~\~b\~\~",
    r"a\|b": r"a&#92;\|b",
    "a\\": "a&#92;",
    r"runs\my_ppo": r"runs\my_ppo",
    "a\x1b[31m\u2028b": "a\N{REPLACEMENT CHARACTER}\\[31m b",
    "runs/my_ppo-2.zip": "runs/my_ppo-2.zip",
}


@pytest.mark.parametrize("name", NAMES)
def test_a_name_breaks_no_table(name: str) -> None:
    assert tables.escaped(name) == NAMES[name]
    rows = [{measure.key: 1.0 for measure in tables.MEASURES}]
    results = [tables.Result(name, policy, rows, False) for policy in (name, "nlpd-tuned")]
    lines = tables.table(tables.results_data(results, 0)).splitlines()
    assert lines[0] == f"### {NAMES[name]}"
    table = [line for line in lines if line.startswith("|")]
    assert f"| {NAMES[name]} " in table[0]
    bare = [line.replace(r"\|", "") for line in table]
    assert {line.count("|") for line in bare} == {4}
    assert len(table) == len(tables.MEASURES) + 6


def test_cells_and_code_stay_in_their_place() -> None:
    table = tables.grid(["a|b", "c"], [["x\ny", tables.code("run `z` | tee")]])
    assert table.splitlines() == [
        r"| a\|b | c                    |",
        "| ---- | -------------------- |",
        r"| x y  | `` run `z` \| tee `` |",
    ]
    assert tables.code("uwoc-gym list") == "`uwoc-gym list`"
