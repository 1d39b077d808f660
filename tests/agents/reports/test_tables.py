"""Tables of what was flown."""

from __future__ import annotations

import math

import pytest

from uwoc_gym.agents.reports import tables


def cells(text: str) -> dict[str, dict[str, str]]:
    """The cells of a printed table by policy and heading, whatever tables they stand in."""
    found: dict[str, dict[str, str]] = {}
    for block in text.split("\n\n"):
        rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in block.split("\n") if "|" in line]
        for name, *values in rows[2:]:
            found.setdefault(name, {}).update(zip(rows[0][1:], values, strict=True))
    return found


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
    lines = cells(tables.table([found]))["pd"]
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
    text = tables.table(tables.results_data(results, 0))
    assert text.splitlines()[0] == f"### {NAMES[name]}"
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    shown = set()
    for block in blocks:
        assert len(block) == 4
        assert len({line.replace(r"\|", "").count("|") for line in block}) == 1
        assert block[2].startswith(f"| {NAMES[name]} ")
        shown |= {heading.strip() for heading in block[0].split("|")[2:-1]}
    assert shown >= {measure.heading for measure in tables.MEASURES} | {"episodes", "return − nlpd-tuned"}


def test_a_printed_table_fits_a_terminal() -> None:
    rows = [{measure.key: 12345.678 + k for measure in tables.MEASURES} for k in range(9)]
    names = ["pd", "nlpd-tuned", "a folder/of many/with a name that is longer than any terminal is wide/model.zip"]
    results = [tables.Result(scenario, name, rows, False) for scenario in ("Nominal", "Random") for name in names]
    text = tables.table(tables.results_data(results, 0))
    assert max(map(len, text.splitlines())) <= tables.WIDTH
    assert "…" in text
    assert names[2][-30:] in text


def test_what_flew_in_wrappers_says_so_below() -> None:
    rows = [{measure.key: 1.0 for measure in tables.MEASURES}]
    data = tables.results_data([tables.Result("Random", "pd", rows, False)], 0)
    late = {"name": "gymnasium.wrappers:DelayObservation", "options": {"delay": 2}}
    named = {"name": "mine:a.b", "options": {"how": "s|x", "by": [1, 2]}}
    assert tables.wrapped([late]) == "wrapped in DelayObservation(delay=2)"
    assert tables.wrapped([late, named]) == 'wrapped in DelayObservation(delay=2), in a.b(how="s|x", by=[1, 2])'
    assert tables.wrapped([]) == ""
    plain, told = tables.table(data), tables.table(data, [late, named])
    assert "wrapped" not in plain
    more = set(told.splitlines()) - set(plain.splitlines())
    assert " ".join(line for line in told.splitlines() if line in more) == (
        r'Flown wrapped in DelayObservation(delay=2), in a.b(how="s\|x", by=\[1, 2\]): returns are what is paid '
        "there, all else is of the true states behind."
    )
    assert max(map(len, told.splitlines())) <= tables.WIDTH


def test_the_returns_at_a_glance_say_who_leads() -> None:
    rows = {name: [{measure.key: value for measure in tables.MEASURES}] for name, value in (("pd", 1.0), ("ppo", 2.0))}
    rows["lost"] = [{measure.key: math.nan for measure in tables.MEASURES}]
    results = [tables.Result(scenario, name, each, True) for scenario in ("A", "B") for name, each in rows.items()]
    header, lines = tables.headline(tables.results_data(results, 0))
    assert header == ["", "pd", "ppo", "lost"]
    assert lines == [["A", "1.0", "**2.0**", "–"], ["B", "1.0", "**2.0**", "–"]]


def test_cells_and_code_stay_in_their_place() -> None:
    table = tables.grid(["a|b", "c"], [["x\ny", tables.code("run `z` | tee")]])
    assert table.splitlines() == [
        r"| a\|b | c                    |",
        "| ---- | -------------------- |",
        r"| x y  | `` run `z` \| tee `` |",
    ]
    assert tables.code("uwoc-gym list") == "`uwoc-gym list`"
