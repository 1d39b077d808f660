"""Tables, files and figures of what was flown."""

from __future__ import annotations

import csv
import importlib.metadata
import json
import math
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, TextIO

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.flight import Series
from uwoc_gym.agents.options import write_text
from uwoc_gym.agents.reports import statistics
from uwoc_gym.scenario import Scenario

Array = npt.NDArray[np.float64]


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


def results_data(results: Sequence[Result], seed: int, reference: str = "nlpd-tuned") -> list[dict[str, Any]]:
    """The results as plain data for JSON and `table`.

    Args:
        results: What was flown.
        seed: Seed of the resampling.
        reference: The policy that others are compared with, episode by episode, where it flew the same ones.
    """
    partners = {result.scenario: result for result in results if result.policy == reference}
    return [
        {
            "scenario": result.scenario,
            "policy": result.policy,
            "episodes": len(result.rows),
            "one_episode_stands_for_all_seeds": result.collapsed,
            "measures": summaries(columns(result.rows), seed),
            "return_worst": float(statistics.worst_share([row["return"] for row in result.rows])),
            "against": _against(result, partners.get(result.scenario), seed),
        }
        for result in results
    ]


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


def table(data: Sequence[Mapping[str, Any]]) -> str:
    """The results as Markdown: for each scenario a table with a row per measure and a column per policy."""
    parts = []
    for scenario in dict.fromkeys(entry["scenario"] for entry in data):
        own = [entry for entry in data if entry["scenario"] == scenario]
        header = ["", *(entry["policy"] for entry in own)]
        lines = [["episodes", *(str(entry["episodes"]) for entry in own)]]
        lines += [
            [
                measure.heading,
                *(statistics.text(entry["measures"][measure.key], measure.digits) for entry in own),
            ]
            for measure in MEASURES
        ]
        lines.insert(2, ["return, worst 5 %", *(f"{entry['return_worst']:.1f}" for entry in own)])
        partner = next((entry["against"]["policy"] for entry in own if entry["against"]), None)
        if partner is not None:
            for label, key, digits in ((f"return − {partner}", "difference", 2), (f"P(> {partner})", "improvement", 3)):
                cells = [statistics.text(entry["against"][key], digits) if entry["against"] else "" for entry in own]
                lines.append([label, *cells])
        text = f"### {scenario}\n\n{grid(header, lines)}\n"
        if any(entry["one_episode_stands_for_all_seeds"] for entry in own):
            text += (
                "\nNothing in this scenario is drawn at random: where it says 1 episode, every seed gives the same.\n"
            )
        parts.append(text)
    parts.append(
        "Means over episodes with 95 % bootstrap intervals in brackets. t_a: arrival in the cone; t_b: inside for "
        "good, or until the first disturbance; Δt: from leaving the cone after the first disturbance to being back "
        "for good, 0 without an outage; RMSE: from arrival on; availability: share of time inside; effort: RMS of "
        "force over limit. (m of n never): in m of n episodes it doesn't come to that; the mean is over the others. "
        "(k of n): the measure applies to k of n episodes; –: to none. return − X: mean of the difference in return, "
        "episode by episode; P(> X): probability that an episode's return is the higher one.\n"
    )
    return "\n".join(parts)


def grid(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table with its columns lined up."""
    widths = [max(len(line[i]) for line in [header, *lines]) for i in range(len(header))]
    pad = [[f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)] for line in [header, *lines]]
    rule = ["-" * width for width in widths]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [pad[0], rule, *pad[1:]])


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results may depend on."""
    found = {"python": platform.python_version()}
    for package in ("uwoc-gym", "gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "sb3-contrib", "torch"):
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def command_line(argv: Sequence[str] | None) -> str:
    """The command as it would be typed again."""
    return shlex.join(["uwoc-gym", *(sys.argv[1:] if argv is None else argv)])


def plain(value: Any) -> Any:
    """JSON knows no numbers that aren't finite: they become null."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def json_text(data: Mapping[str, Any]) -> str:
    """The data as JSON, in which numbers that aren't finite are null."""
    return json.dumps(plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    write_text(path, json_text(data))


def write_results(
    folder: Path, command: str, scenarios: Mapping[str, Scenario | None], document: Mapping[str, Any]
) -> None:
    """Write a command's ``results.json``, whole or not at all.

    Args:
        folder: Where it goes.
        command: The command line that it comes from.
        scenarios: The full scenarios that it speaks of, by name; it gets their digests, so that two of one name can't
            be taken for each other. None for one that isn't this package's.
        document: What else it says.
    """
    digests = {name: scenario.digest() for name, scenario in scenarios.items() if scenario is not None}
    head = {"command": command, "versions": versions(), "scenarios": digests}
    taken = head.keys() & document.keys()
    assert not taken, taken
    write_json(folder / "results.json", {**head, **document})


class EpisodesFile:
    """A CSV file with one row per episode, which keeps what has been appended whatever happens next."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: TextIO | None = None
        self._writer: Any = None

    def __enter__(self) -> Self:
        self._file = self._path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()

    def append(self, scenario: str, policy: str, seeds: Sequence[int], rows: Sequence[Mapping[str, float]]) -> None:
        """Add finished episodes."""
        assert self._file is not None
        if self._file.tell() == 0 and rows:
            self._writer.writerow(["scenario", "policy", "seed", *rows[0]])
        for seed, row in zip(seeds, rows, strict=True):
            self._writer.writerow([scenario, policy, seed, *(repr(value) for value in row.values())])
        self._file.flush()


# Okabe and Ito's colours, which people with any kind of colour vision tell apart, with unlike dashes as a second cue.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#777777")
DASHES = (
    "-",
    (0, (5, 2)),
    (0, (1.5, 1.5)),
    (0, (6, 2, 1.5, 2)),
    (0, (9, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
    "-",
    (0, (1, 3)),
)
_GREY = "#777777"


def figure(path: Path, name: str, scenario: Scenario, flown: Mapping[str, tuple[int, Series]]) -> None:
    """Draw one episode of each policy: range, bit rate, pointing error and the path seen from above.

    Args:
        path: PNG file to write.
        name: The scenario's name, for the title.
        scenario: The scenario.
        flown: Seed and series by policy.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    chart = Figure(figsize=(13.0, 7.6), layout="constrained")
    FigureCanvasAgg(chart)
    grid = chart.add_gridspec(3, 2, width_ratios=(1.25, 1.0))
    top = chart.add_subplot(grid[0, 0])
    axes = (top, chart.add_subplot(grid[1, 0], sharex=top), chart.add_subplot(grid[2, 0], sharex=top))
    above = chart.add_subplot(grid[:, 1])
    seed, any_series = next(iter(flown.values()))
    longest = max((series for _, series in flown.values()), key=lambda series: series.time_s.size)
    angle = np.rad2deg(scenario.link.midpoint().value("field_of_view_rad"))
    for i, (policy, (_, series)) in enumerate(flown.items()):
        style: dict[str, Any] = {
            "color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)], "linewidth": 1.5,
            "label": policy,
        }  # fmt: skip
        rate = np.where(series.bit_rate_bps > 0.0, series.bit_rate_bps, np.nan)
        axes[0].plot(series.time_s, series.range_m, **style)
        axes[1].plot(series.time_s, np.log10(rate), **style)
        axes[2].plot(series.time_s, np.rad2deg(series.pointing_error_rad), **style)
        above.plot(series.pose[:, 1], series.pose[:, 0], **style)
        above.plot(*series.pose[0, 1::-1], marker="o", color=style["color"], markersize=5)
        if series.time_s[-1] < longest.time_s[-1] or series.pose.shape[0] <= round(
            scenario.episode.duration_s / scenario.episode.control_period_s
        ):
            above.plot(*series.pose[-1, 1::-1], marker="x", color=style["color"], markersize=9, markeredgewidth=2)
    limit: dict[str, Any] = {"color": "black", "linestyle": (0, (4, 3)), "linewidth": 1.0}
    axes[0].axhline(any_series.slant_height_m, **limit, label="cone's slant height")
    axes[1].axhline(np.log10(scenario.link.threshold_bit_rate_bps), **limit, label="threshold")
    axes[2].axhline(angle, **limit, label="field of view")
    axes[0].set_ylabel("range [m]")
    axes[1].set_ylabel("log10 of bit rate\nin bit/s")
    axes[2].set_ylabel("pointing error [°]")
    axes[2].set_xlabel("time [s]")
    for axis in axes:
        axis.margins(x=0.0)
        axis.grid(color="#dddddd", linewidth=0.6)
        if np.isfinite(any_series.disturbance_s):
            axis.axvline(any_series.disturbance_s, color=_GREY, linewidth=1.0, label="first pulse begins")
        # The policies' colours stand below the path; here only what is this panel's own.
        own = [line for line in axis.get_lines() if line.get_label() not in flown]
        axis.legend(handles=own, loc="lower right" if axis is axes[1] else "upper right", fontsize=8, framealpha=0.9)
    for axis in axes[:2]:
        axis.tick_params(labelbottom=False)
    axes[1].margins(y=0.12)
    axes[2].set_ylim(bottom=0.0)
    _draw_ship(above, scenario, longest)
    above.set_xlabel("y [m]")
    above.set_ylabel("x [m]")
    above.set_aspect("equal", adjustable="datalim")
    above.grid(color="#dddddd", linewidth=0.6)
    above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.07), fontsize=8, ncols=4, frameon=False)
    chart.suptitle(f"{name}, seed {seed}")
    part = path.with_name(path.name + ".part")
    chart.savefig(part, dpi=150, format="png")
    part.replace(path)


def learning_curve(
    path: Path, title: str, evaluations: Sequence[Mapping[str, Any]], baselines: Mapping[str, Mapping[str, Any]]
) -> None:
    """Draw mean return and availability over training steps, with the controllers' scores as horizontal lines.

    Args:
        path: PNG file to write.
        title: What stands above.
        evaluations: ``steps`` and, by measure, summaries as plain data.
        baselines: By controller, summaries on the same episodes.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = [key for key in ("return", "availability") if evaluations and key in evaluations[-1]] or ["return"]
    chart = Figure(figsize=(6.5 * len(shown), 4.5), layout="constrained")
    FigureCanvasAgg(chart)
    steps = [each["steps"] for each in evaluations]
    for column, key in enumerate(shown):
        axis = chart.add_subplot(1, len(shown), column + 1)
        mean, low, high = (
            np.array([math.nan if each[key][end] is None else each[key][end] for each in evaluations], dtype=float)
            for end in ("mean", "low", "high")
        )
        axis.fill_between(steps, low, high, color=COLOURS[0], alpha=0.2, linewidth=0.0)
        axis.plot(steps, mean, color=COLOURS[0], marker="o", markersize=3, label="agent")
        for i, (name, scores) in enumerate(baselines.items(), start=1):
            style: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)]}
            axis.axhline(scores[key]["mean"], label=name, **style)
        axis.set_xlabel("steps")
        axis.set_ylabel(f"{key}, mean and 95 % interval")
        axis.grid(color="#dddddd", linewidth=0.6)
        axis.legend(loc="lower right", fontsize=8)
    chart.suptitle(title)
    part = path.with_name(path.name + ".part")
    chart.savefig(part, dpi=120, format="png")
    part.replace(path)


def profiles(path: Path, name: str, returns: Mapping[str, Array], scenario: Scenario) -> None:
    """Draw each policy's performance profile: the share of episodes above each share of the possible return.

    Args:
        path: PNG file to write.
        name: The scenario's name, for the title.
        returns: Return by policy, any shape.
        scenario: The scenario, for the highest possible return.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    most = scenario.episode.steps * scenario.reward.bounds[1]
    shares = {policy: np.asarray(values).ravel() / most for policy, values in returns.items()}
    every = np.concatenate(list(shares.values()))
    levels = np.linspace(float(np.quantile(every, 0.005)), float(every.max()), 400)
    chart = Figure(figsize=(8.0, 4.6), layout="constrained")
    FigureCanvasAgg(chart)
    axis = chart.add_subplot()
    for i, (policy, values) in enumerate(shares.items()):
        style: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)]}
        axis.plot(levels, statistics.profile(values, levels), **style, label=policy)
    axis.set_xlabel("share of the possible return")
    axis.set_ylabel("share of episodes above it")
    axis.grid(color="#dddddd", linewidth=0.6)
    axis.legend(fontsize=8)
    axis.set_title(name)
    part = path.with_name(path.name + ".part")
    chart.savefig(part, dpi=150, format="png")
    part.replace(path)


def _draw_ship(above: Any, scenario: Scenario, series: Series) -> None:
    from matplotlib.patches import Circle

    # A ring's radius follows from the cone that the episode drew.
    radius = math.sqrt(max(series.slant_height_m**2 - series.depth_m**2, 0.0))
    ship = series.ship_pose
    above.plot(ship[:, 1], ship[:, 0], color="black", linewidth=1.0, label="ship", zorder=1)
    times = series.time_s
    for k, index in enumerate(np.linspace(0, times.size - 1, 6).round().astype(int)):
        label = "cone's footprint, time in s" if k == 0 else None
        centre = (ship[index, 1], ship[index, 0])
        above.add_patch(Circle(centre, radius, facecolor="#F0E442", edgecolor=_GREY, alpha=0.35, zorder=0, label=label))
        above.annotate(f"{times[index]:.0f}", centre, textcoords="offset points", xytext=(4, 4), fontsize=8, zorder=5)
        above.plot(*centre, marker="^", color="black", markersize=5, zorder=4)
