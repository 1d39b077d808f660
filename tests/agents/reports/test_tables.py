"""Tables of what was flown."""

from __future__ import annotations

import math

import numpy as np
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
    assert header == ["", "A", "B"]
    assert lines == [["pd", "1.0", "1.0"], ["ppo", "**2.0**", "**2.0**"], ["lost", "–", "–"]]


def test_what_is_tuned_for_worlds_shares_a_row_and_the_yardstick_is_not_bold() -> None:
    flown = {("A", "los@A"): 2.0, ("A", "clairvoyant"): 3.0, ("B", "los@B"): 2.0, ("B", "los@A"): 1.0}
    results = [
        tables.Result(scenario, policy, [dict.fromkeys((measure.key for measure in tables.MEASURES), value)], True)
        for (scenario, policy), value in flown.items()
    ]
    header, lines = tables.headline(tables.results_data(results, 0))
    assert header == ["", "A", "B"]
    assert lines == [["los@here", "**2.0**", "**2.0**"], ["los@A", "", "1.0"], ["clairvoyant", "3.0", ""]]
    more = [*results, tables.Result("B", "los", results[0].rows, True), tables.Result("B", "pd", results[0].rows, True)]
    _, lines = tables.headline(tables.results_data(more, 0))
    assert [row for row, *_ in lines] == ["los", "los@here", "los@A", "pd", "clairvoyant"]


def test_cells_and_code_stay_in_their_place() -> None:
    table = tables.grid(["a|b", "c"], [["x\ny", tables.code("run `z` | tee")]])
    assert table.splitlines() == [
        r"| a\|b | c                    |",
        "| ---- | -------------------- |",
        r"| x y  | `` run `z` \| tee `` |",
    ]
    assert tables.code("uwoc-gym list") == "`uwoc-gym list`"


def _lossy(returns: list[float], possible: float) -> list[dict[str, float]]:
    """Episodes of those returns, which lose a half on the way and the rest by effort."""
    rows = []
    for value in returns:
        row = {measure.key: value for measure in tables.MEASURES} | {loss.key: 0.0 for loss in tables.LOSSES}
        lacking = possible - value
        row |= {"loss": lacking, "loss_arrival": 0.5 * lacking, "loss_rest": 0.5 * lacking, "loss_effort": lacking}
        rows.append(row)
    return rows


def test_a_mean_says_less_than_the_numbers_beside_it() -> None:
    """Of forty episodes thirty are good and ten lost: the mean is of no episode."""
    returns = [900.0 + k for k in range(30)] + [100.0 + 10.0 * k for k in range(10)]
    (found,) = tables.results_data([tables.Result("Tide", "pd", _lossy(returns, 1000.0), False, 1000.0)], 0)
    assert found["return_median"] == np.median(returns) == 909.5
    assert found["return_worst"] == 105.0
    assert found["below_half"] == 0.25
    assert found["possible"] == 1000.0
    assert found["losses"]["loss"] == pytest.approx(1000.0 - np.mean(returns))
    lines = cells(tables.table([found]))["pd"]
    assert (lines["median"], lines["worst 5 %"], lines["below half"]) == ("909.5", "105.0", "0.250")
    lacking = f"{1000.0 - np.mean(returns):.1f}"
    assert (lines["loss"], lines["loss: effort"], lines["loss: in cone"]) == (lacking, lacking, "0.0")
    assert lines["loss: arrival"] == lines["loss: rest"] == f"{500.0 - 0.5 * np.mean(returns):.1f}"


def test_what_says_nothing_of_losses_has_no_columns_of_them() -> None:
    rows = [{measure.key: 1.0 for measure in tables.MEASURES}]
    (found,) = tables.results_data([tables.Result("Random", "pd", rows, False)], 0)
    assert (found["below_half"], found["losses"], found["way"]) == (None, None, None)
    assert not [heading for heading in cells(tables.table([found]))["pd"] if "loss" in heading or "half" in heading]


def test_the_way_to_the_yardstick_begins_at_the_nlpd_that_was_tuned_there() -> None:
    returns = {"nlpd-tuned": [0.0, 2.0], "nlpd@Tide": [4.0, 4.0], "los": [5.0, 7.0], "clairvoyant": [8.0, 8.0]}
    results = [
        tables.Result(scenario, policy, _lossy(own, 10.0), False, 10.0)
        for scenario in ("Tide", "Random")
        for policy, own in returns.items()
    ]
    results.append(tables.Result("Random", "few", _lossy([1.0], 10.0), False, 10.0))
    results.append(tables.Result("LateFix", "los", _lossy([1.0, 2.0], 10.0), False, 10.0))
    found = {(each["scenario"], each["policy"]): each for each in tables.results_data(results, 0)}
    tide = {policy: found["Tide", policy]["way"] for policy in returns}
    assert {(each["from"], each["to"]) for each in tide.values()} == {("nlpd@Tide", "clairvoyant")}
    assert [each["share"]["value"] for each in tide.values()] == [-0.75, 0.0, 0.5, 1.0]
    # Elsewhere what was tuned in the tide is one of many.
    assert found["Random", "los"]["way"]["from"] == "nlpd-tuned"
    assert found["Random", "los"]["way"]["share"]["value"] == pytest.approx(5.0 / 7.0)
    assert found["Random", "few"]["way"] is None
    assert found["LateFix", "los"]["way"] is None
    lines = cells(tables.table([found["Tide", policy] for policy in returns]))
    assert lines["clairvoyant"]["way to clairvoyant"] == "1.00"
    assert lines["los"]["way to clairvoyant"].startswith("0.50")
    assert "way to" not in tables.table([found["LateFix", "los"]]).partition("Means over")[0]


def test_a_world_s_own_yardstick_is_the_end_of_its_way() -> None:
    assert tables.way("Tide", ["clairvoyant", "clairvoyant@Tide", "nlpd-tuned"]) == ("nlpd-tuned", "clairvoyant@Tide")
    assert tables.way("Tide", ["clairvoyant@LateFix", "nlpd@Tide"]) is None
    assert tables.way("Tide", ["clairvoyant", "nlpd@LateFix"]) is None


def test_how_long_a_decision_takes_stands_by_itself() -> None:
    rows = [{measure.key: 1.0 for measure in tables.MEASURES}]
    data = tables.results_data([tables.Result("Random", "pd", rows, False)], 0)
    text = tables.table(data, (), {"Random": {"pd": 51.4, "a|b": 9.6}, "Tide": {"pd": 60.0}})
    told = cells(text.partition("### Microseconds a decision")[2])
    assert told["pd"] == {"Random": "51", "Tide": "60"}
    assert told[r"a\|b"] == {"Random": "10", "Tide": ""}
    assert "Microseconds" not in tables.table(data)
