"""Figures of what was flown and learned."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.flight import Series
from uwoc_gym.agents.reports import statistics
from uwoc_gym.agents.reports.files import whole
from uwoc_gym.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

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
GREY = "#777777"
CONE = "#F0E442"
LIMIT: dict[str, Any] = {"color": "black", "linestyle": (0, (4, 3)), "linewidth": 1.0}
"""Line of a bound that a quantity is held against."""


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of that size [inches]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    chart = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(chart)
    return chart


def save(chart: Figure, path: Path, dots_per_inch: int = 150) -> None:
    """Write a figure as PNG or SVG, by the path's suffix, whole or not at all; the same figure gives the same file."""
    from matplotlib import rc_context

    kind = path.suffix[1:]
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    with whole(path) as part, rc_context({"svg.hashsalt": path.stem}):
        chart.savefig(part, format=kind, dpi=dots_per_inch, metadata=metadata)


def style(index: int) -> dict[str, Any]:
    """Colour and dashes of the line of that number."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": DASHES[index % len(DASHES)], "linewidth": 1.5}


def figure(path: Path, name: str, scenario: Scenario, flown: Mapping[str, tuple[int, Series]]) -> None:
    """Draw one episode of each policy: range, bit rate, pointing error and the path seen from above.

    Args:
        path: PNG file to write.
        name: The scenario's name, for the title.
        scenario: The scenario.
        flown: Seed and series by policy.
    """
    chart = new_figure(13.0, 7.6)
    grid = chart.add_gridspec(3, 2, width_ratios=(1.25, 1.0))
    top = chart.add_subplot(grid[0, 0])
    axes = (top, chart.add_subplot(grid[1, 0], sharex=top), chart.add_subplot(grid[2, 0], sharex=top))
    above = chart.add_subplot(grid[:, 1])
    seed, any_series = next(iter(flown.values()))
    longest = max((series for _, series in flown.values()), key=lambda series: series.time_s.size)
    angle = np.rad2deg(scenario.link.midpoint().value("field_of_view_rad"))
    for i, (policy, (_, series)) in enumerate(flown.items()):
        line = style(i) | {"label": policy}
        rate = np.where(series.bit_rate_bps > 0.0, series.bit_rate_bps, np.nan)
        axes[0].plot(series.time_s, series.range_m, **line)
        axes[1].plot(series.time_s, np.log10(rate), **line)
        axes[2].plot(series.time_s, np.rad2deg(series.pointing_error_rad), **line)
        above.plot(series.pose[:, 1], series.pose[:, 0], **line)
        above.plot(*series.pose[0, 1::-1], marker="o", color=line["color"], markersize=5)
        if series.time_s[-1] < longest.time_s[-1] or series.pose.shape[0] <= round(
            scenario.episode.duration_s / scenario.episode.control_period_s
        ):
            above.plot(*series.pose[-1, 1::-1], marker="x", color=line["color"], markersize=9, markeredgewidth=2)
    axes[0].axhline(any_series.slant_height_m, **LIMIT, label="cone's slant height")
    axes[1].axhline(np.log10(scenario.link.threshold_bit_rate_bps), **LIMIT, label="threshold")
    axes[2].axhline(angle, **LIMIT, label="field of view")
    axes[0].set_ylabel("range [m]")
    axes[1].set_ylabel("log10 of bit rate\nin bit/s")
    axes[2].set_ylabel("pointing error [°]")
    axes[2].set_xlabel("time [s]")
    for axis in axes:
        axis.margins(x=0.0)
        axis.grid(color="#dddddd", linewidth=0.6)
        if np.isfinite(any_series.disturbance_s):
            axis.axvline(any_series.disturbance_s, color=GREY, linewidth=1.0, label="first pulse begins")
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
    save(chart, path)


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
    shown = [key for key in ("return", "availability") if evaluations and key in evaluations[-1]] or ["return"]
    chart = new_figure(6.5 * len(shown), 4.5)
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
            axis.axhline(scores[key]["mean"], label=name, **style(i))
        axis.set_xlabel("steps")
        axis.set_ylabel(f"{key}, mean and 95 % interval")
        axis.grid(color="#dddddd", linewidth=0.6)
        axis.legend(loc="lower right", fontsize=8)
    chart.suptitle(title)
    save(chart, path, 120)


def profiles(path: Path, name: str, returns: Mapping[str, Array], scenario: Scenario) -> None:
    """Draw each policy's performance profile: the share of episodes above each share of the possible return.

    Args:
        path: PNG file to write.
        name: The scenario's name, for the title.
        returns: Return by policy, any shape.
        scenario: The scenario, for the highest possible return.
    """
    most = scenario.episode.steps * scenario.reward.bounds[1]
    shares = {policy: np.asarray(values).ravel() / most for policy, values in returns.items()}
    every = np.concatenate(list(shares.values()))
    levels = np.linspace(float(np.quantile(every, 0.005)), float(every.max()), 400)
    chart = new_figure(8.0, 4.6)
    axis = chart.add_subplot()
    for i, (policy, values) in enumerate(shares.items()):
        axis.plot(levels, statistics.profile(values, levels), **style(i), label=policy)
    axis.set_xlabel("share of the possible return")
    axis.set_ylabel("share of episodes above it")
    axis.grid(color="#dddddd", linewidth=0.6)
    axis.legend(fontsize=8)
    axis.set_title(name)
    save(chart, path)


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
        above.add_patch(Circle(centre, radius, facecolor=CONE, edgecolor=GREY, alpha=0.35, zorder=0, label=label))
        above.annotate(f"{times[index]:.0f}", centre, textcoords="offset points", xytext=(4, 4), fontsize=8, zorder=5)
        above.plot(*centre, marker="^", color="black", markersize=5, zorder=4)
