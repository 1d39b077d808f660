"""Policies compared over trainings and held-out seeds: the numbers of BENCHMARK.md, and its text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.reports import statistics, tables
from uwoc_gym.agents.reports.tables import REFERENCE
from uwoc_gym.metrics import AFTERMATH_S

Array = npt.NDArray[np.float64]


def compared(own: Mapping[str, Mapping[str, Array]], scenario: str = "", possible: float = math.nan) -> dict[str, Any]:
    """Each policy's measures, and how it stands against the reference.

    Args:
        own: Each measure by policy, shape (trainings, seeds).
        scenario: What was flown, by name.
        possible: The highest return that an episode can have.
    """
    reference = own[REFERENCE]["return"]
    found: dict[str, Any] = {}
    ways = tables.way(scenario, own)
    for name, measures in own.items():
        # The same resamples for every policy.
        rng = np.random.default_rng(0)
        returns = measures["return"]
        difference = returns - reference
        found[name] = {
            "trainings": returns.shape[0],
            "episodes": returns.shape[1],
            "steps": float(np.max(measures["steps"])),
            "return_iqm": statistics.estimate(returns, statistics.interquartile_mean, rng)._asdict(),
            "return_worst": statistics.estimate(returns, statistics.worst_share, rng)._asdict(),
            "difference": statistics.estimate(difference, statistics.mean, rng)._asdict(),
            "improvement": statistics.estimate(difference, statistics.improvement, rng)._asdict(),
            "return_median": statistics.estimate(returns, statistics.median, rng)._asdict(),
            "possible": possible,
            "below_half": None,
            "losses": tables.losses(measures),
            "way": None,
            "measures": tables.summaries(measures, 0),
        }
        if "loss" in measures:
            half = tables.below_half(measures["loss"], possible)
            found[name]["below_half"] = statistics.estimate(half, statistics.mean, rng)._asdict()
        if ways is not None:
            start, end = (own[each]["return"][0] for each in ways)
            share = statistics.share_of_the_way(returns, start, end, rng)
            found[name]["way"] = {"from": ways.start, "to": ways.end, "share": share._asdict()}
    return found


def markdown(command: str, results: Mapping[str, Any]) -> str:
    """The benchmark as Markdown."""
    parts = [
        "# Benchmark",
        f"Written by {tables.code(command)}. Every policy flies the same {results['held_out_seeds']} held-out seeds, "
        "which no training, tuning or choice of a model has seen, on the same observations and actuators. IQM: "
        "interquartile mean. In brackets: 95 % bootstrap intervals over training seeds and scenario seeds. Difference "
        f"and probability of improvement: in return against `{REFERENCE}`, episode by episode. Worst: mean of the "
        "worst 5 % of episodes; below half: share of those that reach less than half of the possible return. Loss: "
        "what is missing of that, by part of the episode (arrival: until first inside the cone; disturbances: while a "
        f"pulse acts, {AFTERMATH_S:g} s from then on, and until the outage that is left behind is over; rest: at all "
        "other times) and by term of the reward. Way: share of the way in return from the tuned NLPD to the "
        "clairvoyant yardstick. (m of n never): in m of n episodes, over all trainings, it doesn't come to that, as "
        "when a link isn't restored; the mean is over the others. (k of n): the measure applies to k of n episodes; "
        "–: to none. A scenario in which nothing is drawn is flown once by each policy.",
    ]
    for scenario, own in results["results"].items():
        header = ["", *map(tables.escaped, own)]
        first = ("trainings", "episodes")
        lines = [[key, *(str(entry[key]) for entry in own.values())] for key in first]
        for label, key, digits in (
            ("return, IQM", "return_iqm", 1), ("return, median", "return_median", 1),
            ("return, worst", "return_worst", 1), ("below half", "below_half", 3),
            ("difference", "difference", 2), ("P(improvement)", "improvement", 3),
        ):  # fmt: skip
            if all(entry[key] for entry in own.values()):
                lines.append([label, *(statistics.text(entry[key], digits) for entry in own.values())])
        if all(entry["way"] for entry in own.values()):
            lines.append(["way", *(statistics.text(entry["way"]["share"], 2) for entry in own.values())])
        lines += tables.loss_lines(list(own.values()))
        lines += tables.measure_lines(list(own.values()))
        parts += [f"## {tables.escaped(scenario)}", tables.grid(header, lines)]
    speeds = results["microseconds_a_decision"]
    parts += [
        "## A decision",
        "Mean time of one `predict` on one observation, on the machine that wrote this.",
        tables.grid(["", *map(tables.escaped, speeds)], [["µs", *(f"{value:.0f}" for value in speeds.values())]]),
        "## Trainings",
    ]
    lines = []
    for group, entry in results["groups"].items():
        runs = entry["trainings"]
        minutes = np.array([each["wall_time_s"] for each in runs]) / 60.0
        speed = np.array([each["steps_per_s"] for each in runs])
        words = " ".join(["uwoc-gym train", *entry["arguments"]])
        lines.append(
            [tables.escaped(group), tables.code(words), str(len(runs)),
             f"{runs[0]['settings']['n_timesteps']:,}", f"{minutes.mean():.1f}",
             f"{speed.mean():,.0f}"]
        )  # fmt: skip
    parts.append(tables.grid(["group", "command", "trainings", "steps", "minutes each", "steps/s"], lines))
    return "\n\n".join(parts) + "\n"
