"""Tables of what was flown: the measures of an episode, their summaries, and Markdown."""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Container, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.reports import statistics
from uwoc_gym.metrics import AFTERMATH_S, PARTS
from uwoc_gym.task.reward import RewardSettings


class Measure(NamedTuple):
    """One measure of an episode and how a table shows it."""

    key: str
    heading: str
    digits: int
    nan_is_never: bool = False
    """Whether nan says never rather than that the measure doesn't apply; infinity always does."""

    def text(self, value: float) -> str:
        """One episode's value as a table shows it."""
        if math.isfinite(value):
            return f"{value:.{self.digits}f}"
        return "never" if statistics.says_never(value, self.nan_is_never) else "–"


MEASURES = (
    Measure("return", "return", 1),
    Measure("arrival_time_s", "t_a [s]", 2, nan_is_never=True),
    Measure("establishment_time_s", "t_b [s]", 2, nan_is_never=True),
    Measure("restoring_time_s", "Δt [s]", 2),
    Measure("rmse_x_m", "RMSE x [m]", 4),
    Measure("rmse_y_m", "RMSE y [m]", 4),
    Measure("rmse_yaw_rad", "RMSE yaw [rad]", 4),
    Measure("availability", "availability", 4),
    Measure("mean_log10_bit_rate", "mean log10 bit rate [bit/s]", 3),
    Measure("delivered_gbit", "delivered [Gbit]", 1),
    Measure("effort", "effort", 4),
    Measure("lost", "episodes lost [share]", 3),
)
"""The rows of the table, by the keys of an episode's row."""


class Loss(NamedTuple):
    """A part of what episodes lack of the possible return, and what a table calls it."""

    key: str
    heading: str


LOSSES = (
    Loss("loss", "loss"),
    *(Loss(f"loss_{part}", f"loss: {part}") for part in PARTS),
    *(Loss(f"loss_{term}", f"loss: {term.replace('_', ' ')}") for term in RewardSettings().highest),
)
"""All of it, its parts by when it is lost, and its parts by term of the reward, by the keys of an episode's row."""


def losses(scores: Mapping[str, npt.ArrayLike]) -> dict[str, float] | None:
    """The mean of each of `LOSSES` over episodes, by its key; None where episodes don't say."""
    if not all(loss.key in scores for loss in LOSSES):
        return None
    return {loss.key: float(np.mean(np.asarray(scores[loss.key], dtype=float))) for loss in LOSSES}


def loss_lines(entries: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """A line per loss, with a cell for each entry's ``losses``; none where no entry has any."""
    if not any(entry["losses"] for entry in entries):
        return []
    return [
        [loss.heading, *(f"{entry['losses'][loss.key]:.1f}" if entry["losses"] else "" for entry in entries)]
        for loss in LOSSES
    ]


YARDSTICK = "clairvoyant"
"""What shows how much is possible."""


class Way(NamedTuple):
    """From where to where a policy's share of the way is reckoned."""

    start: str
    end: str


def way(scenario: str, flown: Container[str]) -> Way | None:
    """The way from the tuned NLPD to the yardstick, each as it was tuned in that scenario if that flew; else None.

    Args:
        scenario: The scenario's name.
        flown: The policies that flew it.
    """
    starts = [name for name in (f"nlpd@{scenario}", "nlpd-tuned") if name in flown]
    ends = [name for name in (f"{YARDSTICK}@{scenario}", YARDSTICK) if name in flown]
    return Way(starts[0], ends[0]) if starts and ends else None


def below_half(loss: npt.ArrayLike, possible: float) -> npt.NDArray[np.bool_]:
    """Which episodes reach less than half of the possible return, by what they lack of it."""
    return np.asarray(loss, dtype=float) > 0.5 * possible


def summaries(scores: Mapping[str, npt.ArrayLike], seed: int) -> dict[str, dict[str, Any]]:
    """Each of `MEASURES` over episodes, by its key, as plain data.

    Args:
        scores: By measure, shape (R, S), training seeds by scenario seeds, or (S,); those without are left out.
        seed: The same seed resamples alike.
    """
    rng = np.random.default_rng(seed)
    return {
        measure.key: statistics.summarise(scores[measure.key], rng, measure.nan_is_never)._asdict()
        for measure in MEASURES
        if measure.key in scores
    }


def columns(rows: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """The measures of episodes by key."""
    return {key: [row[key] for row in rows] for key in (rows[0] if rows else ())}


class Result(NamedTuple):
    """All episodes of one policy in one scenario."""

    scenario: str
    policy: str
    rows: list[dict[str, float]]
    collapsed: bool
    """Whether one episode stands for all seeds, because they don't differ."""
    possible: float = math.nan
    """The highest return that an episode can have."""


REFERENCE = "nlpd-tuned"
"""Whom policies are compared with, episode by episode, unless another is said."""


def results_data(results: Sequence[Result], seed: int, reference: str = REFERENCE) -> list[dict[str, Any]]:
    """The results as plain data for JSON and `table`.

    Args:
        results: What was flown.
        seed: Seed of the resampling.
        reference: The policy that others are compared with, episode by episode, where it flew the same ones.
    """
    partners = {result.scenario: result for result in results if result.policy == reference}
    flown = {(result.scenario, result.policy): result for result in results}
    return [
        {
            "scenario": result.scenario,
            "policy": result.policy,
            "episodes": len(result.rows),
            "one_episode_stands_for_all_seeds": result.collapsed,
            "measures": summaries(columns(result.rows), seed),
            "return_median": float(statistics.median([row["return"] for row in result.rows])),
            "return_worst": float(statistics.worst_share([row["return"] for row in result.rows])),
            "possible": result.possible,
            "below_half": _below_half(result),
            "losses": losses(columns(result.rows)),
            "way": _way(result, flown, seed),
            "against": _against(result, partners.get(result.scenario), seed),
        }
        for result in results
    ]


def _below_half(result: Result) -> float | None:
    """The share of episodes below half of the possible return; None where they don't say what they lack."""
    if math.isnan(result.possible) or not all("loss" in row for row in result.rows):
        return None
    return float(below_half([row["loss"] for row in result.rows], result.possible).mean())


def _way(result: Result, flown: Mapping[tuple[str, str], Result], seed: int) -> dict[str, Any] | None:
    """A policy's share of the way to the yardstick; None where the ends of the way didn't fly the same episodes."""
    found = way(result.scenario, [policy for scenario, policy in flown if scenario == result.scenario])
    if found is None:
        return None
    returns, start, end = (
        [row["return"] for row in each.rows]
        for each in (result, flown[result.scenario, found.start], flown[result.scenario, found.end])
    )
    if not len(returns) == len(start) == len(end):
        return None
    share = statistics.share_of_the_way(returns, start, end, np.random.default_rng(seed))
    return {"from": found.start, "to": found.end, "share": share._asdict()}


def _against(result: Result, partner: Result | None, seed: int) -> dict[str, Any] | None:
    """Paired difference and probability of improvement in return; None without a partner for every episode."""
    if partner is None or partner.policy == result.policy or len(partner.rows) != len(result.rows):
        return None
    differences = [a["return"] - b["return"] for a, b in zip(result.rows, partner.rows, strict=True)]
    rng = np.random.default_rng(seed)
    return {
        "policy": partner.policy,
        "difference": statistics.estimate(differences, statistics.mean, rng)._asdict(),
        "improvement": statistics.estimate(differences, statistics.improvement, rng)._asdict(),
    }


def measure_lines(entries: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """A line per measure, with a cell for each entry's ``measures``."""
    return [
        [measure.heading, *(statistics.text(entry["measures"][measure.key], measure.digits) for entry in entries)]
        for measure in MEASURES
    ]


WIDTH = 100
"""How wide a table may be that is printed, in characters: a terminal shows it without folding its lines."""


def wrapped(wrappers: Sequence[Mapping[str, Any]]) -> str:
    """In which wrappers something flew, in a few words: "wrapped in DelayObservation(delay=2)"; "" without any.

    Args:
        wrappers: Name and options of each, the first innermost, as results tell them.
    """
    each = (
        f"{wrapper['name'].rpartition(':')[2]}"
        f"({', '.join(f'{key}={json.dumps(value, ensure_ascii=False)}' for key, value in wrapper['options'].items())})"
        for wrapper in wrappers
    )
    return f"wrapped in {', in '.join(each)}" if wrappers else ""


def table(
    data: Sequence[Mapping[str, Any]],
    wrappers: Sequence[Mapping[str, Any]] = (),
    microseconds: Mapping[str, Mapping[str, float]] | None = None,
) -> str:
    """The results as Markdown, no wider than a terminal.

    First, of several scenarios, every return at a glance; then for each scenario a row per policy, the measures in as
    many tables below each other as it takes.

    Args:
        data: What `results_data` gives.
        wrappers: Name and options of what stood around the environments, the first innermost.
        microseconds: How long a decision took, by scenario and policy.
    """
    scenarios = list(dict.fromkeys(entry["scenario"] for entry in data))
    parts = []
    if len(scenarios) > 1:
        parts.append(f"### Return\n\n{narrow(*headline(data))}\n")
    for scenario in scenarios:
        own = [entry for entry in data if entry["scenario"] == scenario]
        text = f"### {escaped(scenario)}\n\n{narrow(*_scenario(own))}\n"
        if any(entry["one_episode_stands_for_all_seeds"] for entry in own):
            text += (
                "\nNothing in this scenario is drawn at random: where it says 1 episode, every seed gives the same.\n"
            )
        parts.append(text)
    if microseconds:
        parts.append(f"### Microseconds a decision\n\n{narrow(*_decisions(microseconds))}\n")
    if wrappers:
        there = "returns are what is paid there, all else is of the true states behind."
        parts.append(f"{textwrap.fill(f'Flown {escaped(wrapped(wrappers))}: {there}', WIDTH)}\n")
    parts.append(f"{textwrap.fill(_NOTES, WIDTH)}\n")
    return "\n".join(parts)


_NOTES = (
    "Means over episodes with 95 % bootstrap intervals in brackets. t_a: arrival in the cone; t_b: inside for "
    "good, or until the first disturbance; Δt: from leaving the cone after the first disturbance to being back "
    "for good, 0 without an outage; RMSE: from arrival on; availability: share of time inside; effort: RMS of "
    "force over limit. (m of n never): in m of n episodes it doesn't come to that; the mean is over the others. "
    "(k of n): the measure applies to k of n episodes; –: to none. worst 5 %: mean of the lowest twentieth of the "
    "returns; below half: share of episodes that reach less than half of the possible return. loss: what is missing "
    f"of that; arrival: until first inside the cone; disturbances: while a pulse acts, {AFTERMATH_S:g} s from then on, "
    "and until the outage that is left behind is over; rest: at all other times; and by term of the reward. way to X: "
    "share of the way in return from the tuned NLPD, of this world if it flew, to X. A decision: the mean time of one "
    "on one observation, while other flights were under way. return − X: mean of the difference in return, "
    "episode by episode; P(> X): probability that an episode's return is the higher one. At a glance, the highest "
    "return of a scenario is **bold**."
)


def headline(data: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a table with a row per policy and a column per scenario: its return, the highest bold.

    What is tuned in the scenario that it flies, as law@scenario, shares a row with its like, below the law itself. The
    yardstick comes last and isn't bold.
    """
    scenarios = list(dict.fromkeys(entry["scenario"] for entry in data))
    cells: dict[str, dict[str, str]] = {}
    highest: dict[str, tuple[float, str]] = {}
    for entry in data:
        scenario, policy, found = entry["scenario"], entry["policy"], entry["measures"]["return"]
        law, _, world = policy.partition("@")
        row = f"{law}@{_HERE}" if world == scenario else policy
        cells.setdefault(row, {})[scenario] = statistics.text(found, 1)
        if law != YARDSTICK and found["mean"] is not None:
            highest[scenario] = max(highest.get(scenario, (-math.inf, "")), (found["mean"], row))
    for scenario, (_, row) in highest.items():
        cells[row][scenario] = f"**{cells[row][scenario]}**"
    first = list(cells)

    def place(row: str) -> tuple[bool, int, bool]:
        law = row.partition("@")[0]
        return law == YARDSTICK, first.index(law if law in cells else row), row != law

    lines = [
        [escaped(_short(row)), *(cells[row].get(scenario, "") for scenario in scenarios)]
        for row in sorted(first, key=place)
    ]
    return ["", *map(escaped, scenarios)], lines


_HERE = "here"
"""What stands after @ in a row of what is tuned in the scenario of each column."""


def _scenario(own: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a table with a row for each policy of a scenario."""
    columns = {"episodes": [str(entry["episodes"]) for entry in own]}
    measures = measure_lines(own)
    columns["return"] = measures[0][1:]
    columns["median"] = [f"{entry['return_median']:.1f}" for entry in own]
    columns["worst 5 %"] = [f"{entry['return_worst']:.1f}" for entry in own]
    if any(entry["below_half"] is not None for entry in own):
        columns["below half"] = ["" if entry["below_half"] is None else f"{entry['below_half']:.3f}" for entry in own]
    yardstick = next((entry["way"]["to"] for entry in own if entry["way"]), None)
    if yardstick is not None:
        columns[f"way to {escaped(yardstick)}"] = [
            statistics.text(entry["way"]["share"], 2) if entry["way"] else "" for entry in own
        ]
    partner = next((entry["against"]["policy"] for entry in own if entry["against"]), None)
    if partner is not None:
        name = escaped(partner)
        for label, key, digits in ((f"return − {name}", "difference", 2), (f"P(> {name})", "improvement", 3)):
            columns[label] = [
                statistics.text(entry["against"][key], digits) if entry["against"] else "" for entry in own
            ]
    columns |= {heading: cells for heading, *cells in loss_lines(own)}
    columns |= {heading: cells for heading, *cells in measures[1:]}
    rows = zip(*columns.values(), strict=True)
    return ["", *columns], [[escaped(_short(entry["policy"])), *cells] for entry, cells in zip(own, rows, strict=True)]


def _decisions(microseconds: Mapping[str, Mapping[str, float]]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a table with a row for each policy and a column for each scenario."""
    policies = dict.fromkeys(policy for own in microseconds.values() for policy in own)
    lines = [
        [escaped(_short(policy)), *(f"{own[policy]:.0f}" if policy in own else "" for own in microseconds.values())]
        for policy in policies
    ]
    return ["", *map(escaped, microseconds)], lines


def _short(name: str, most: int = 40) -> str:
    """A name of which so many characters, the last ones of a path, are to be shown."""
    return name if len(name) <= most else f"…{name[1 - most :]}"


def narrow(header: Sequence[str], lines: Sequence[Sequence[str]], width: int = WIDTH) -> str:
    """A Markdown table as `grid` makes it, in as many below each other as keep within a width where cells allow.

    Each has the first column, and of the others as many as there is room for.
    """
    parts, first, count = [], 1, len(header)
    while first < count:
        for last in range(count, first, -1):
            part = grid([header[0], *header[first:last]], [[line[0], *line[first:last]] for line in lines])
            if last == first + 1 or len(part.partition("\n")[0]) <= width:
                break
        parts.append(part)
        first = last
    return "\n\n".join(parts)


def escaped(name: str) -> str:
    """A name that anybody may have chosen, such as a file's, as Markdown that shows it in one line as it is."""
    line = "".join(each if each.isprintable() else "\N{REPLACEMENT CHARACTER}" for each in " ".join(name.split()))
    # A backslash that nothing follows for it to escape, as in a path, may stay.
    return re.sub(
        r"\\(?=[!-/:-@\[-`{-~]|$)|[`*<>\[\]|~&]",
        lambda found: "&#92;" if found[0] == "\\" else f"\\{found[0]}",
        line,
    )


def code(text: str) -> str:
    """A text, such as a command, as Markdown's code in one line."""
    line = " ".join(text.split())
    fence = "`" * (1 + max((len(run) for run in re.findall("`+", line)), default=0))
    pad = " " if "`" in line else ""
    return f"{fence}{pad}{line}{pad}{fence}"


def grid(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table with its columns lined up, one line a row whatever the cells hold."""
    header, *lines = ([re.sub(r"(?<!\\)\|", r"\|", " ".join(cell.split())) for cell in row] for row in (header, *lines))
    widths = [max(len(line[i]) for line in [header, *lines]) for i in range(len(header))]
    pad = [[f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)] for line in [header, *lines]]
    rule = ["-" * width for width in widths]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [pad[0], rule, *pad[1:]])
