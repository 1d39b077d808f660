"""Figures of what was flown and learned."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.flight import Series, possible
from uwoc_gym.agents.policies.looks import DASHES, OTHERS, Look, looks
from uwoc_gym.agents.reports import statistics, tables
from uwoc_gym.agents.reports.files import whole
from uwoc_gym.env import TrackingEnv
from uwoc_gym.scenario import Scenario
from uwoc_gym.world.sea.pulses import DrawnPulse, drawn_pulses

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

GREY = "#777777"
CONE = "#F0E442"
PULSE = "#A33B20"
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


def style(look: Look) -> dict[str, Any]:
    """What Matplotlib calls a look; a solid line stands behind the others, so that it hides none."""
    dash = (0.0, DASHES[look.dash]) if DASHES[look.dash] else "solid"
    return {"color": look.colour, "linestyle": dash, "linewidth": 1.6, "zorder": 2.5 if DASHES[look.dash] else 2.2}


LEGEND: dict[str, Any] = {"handlelength": 4.0}
"""Of every legend of policies: its lines long enough for their dashes to be told apart."""


def heading(parts: Sequence[str], width: int) -> str:
    """What stands above a figure, in lines of at most so many characters; those that are empty are left out."""
    text = textwrap.fill(", ".join(part for part in parts if part), width)
    # Matplotlib takes what stands between dollars for mathematics.
    return text.replace("$", r"\$")


CLOSE_UP_S = 3.0
"""How long a figure's close-up is [s]."""

D_C = "d_C: the cone's slant height; no link beyond it"
D_B = "d_B: the AUV's depth; the least range"
"""The paper's two bounds of the range, in words."""


def drawn_by(scenario: Scenario, seed: int) -> list[DrawnPulse]:
    """The pulses of a seed's episode."""
    env = TrackingEnv(scenario=scenario)
    env.reset(seed=seed)
    return drawn_pulses(env.parameters())


def close_up(flown: Sequence[Series], begins: Sequence[float]) -> tuple[float, float]:
    """The seconds in which policies differ most [s, s].

    Args:
        flown: Their episodes.
        begins: When a pulse begins [s]; those seconds begin a little before one of them, without any with the episode.
    """
    size = min(series.time_s.size for series in flown)
    time_s = flown[0].time_s[:size]
    ranges = np.array([series.range_m[:size] for series in flown])
    # Of one policy alone the range itself tells where something happens.
    telling = np.ptp(ranges, axis=0) if len(flown) > 1 else ranges[0]
    found = [max(begin - 0.1 * CLOSE_UP_S, 0.0) for begin in begins if begin < time_s[-1]] or [0.0]
    most = max(found, key=lambda at: telling[(time_s >= at) & (time_s <= at + CLOSE_UP_S)].sum())
    return most, most + CLOSE_UP_S


def figure(
    path: Path,
    name: str,
    scenario: Scenario,
    flown: Mapping[str, tuple[int, Series]],
    wrappers: Sequence[Mapping[str, Any]] = (),
) -> None:
    """Draw one episode of each policy: range, bit rate and pointing error, the path seen from above, and a close-up.

    Args:
        path: PNG file to write.
        name: The scenario's name, for the title.
        scenario: The scenario.
        flown: Seed and series by policy.
        wrappers: Name and options of what stood around the environments, for the title.
    """
    chart = new_figure(15.0, 8.4)
    grid = chart.add_gridspec(3, 3, width_ratios=(1.15, 1.0, 1.0))
    whole = [chart.add_subplot(grid[row, 0]) for row in range(3)]
    near = [chart.add_subplot(grid[row, 1]) for row in range(3)]
    right = grid[:, 2].subgridspec(2, 1, height_ratios=(1.25, 1.0))
    above, beside = chart.add_subplot(right[0]), chart.add_subplot(right[1])
    seed = next(iter(flown.values()))[0]
    longest = max((series for _, series in flown.values()), key=lambda series: series.time_s.size)
    pulses = [pulse for pulse in drawn_by(scenario, seed) if pulse.begin_s < longest.time_s[-1]]
    span = close_up([series for _, series in flown.values()], [pulse.begin_s for pulse in pulses])
    threshold = math.log10(scenario.link.threshold_bit_rate_bps)
    rates = {policy: _log_rate(series) for policy, (_, series) in flown.items()}
    dark = min([threshold, *(float(np.nanmin(rate)) for rate in rates.values() if np.isfinite(rate).any())]) - 0.5
    for policy, look in looks(flown).items():
        series = flown[policy][1]
        line = style(look) | {"label": policy}
        # Where no light arrives the line runs along the foot, so that it doesn't leave the picture.
        curves = (series.range_m, np.nan_to_num(rates[policy], nan=dark), np.rad2deg(series.pointing_error_rad))
        shown = (series.time_s >= span[0] - 0.1) & (series.time_s <= span[1] + 0.1)
        for row, values in enumerate(curves):
            whole[row].plot(series.time_s, values, **line)
            near[row].plot(series.time_s[shown], values[shown], **line)
        above.plot(series.pose[:, 1], series.pose[:, 0], **line)
        above.plot(*series.pose[0, 1::-1], marker="o", color=look.colour, markersize=5)
        if series.time_s[-1] < longest.time_s[-1] or series.pose.shape[0] <= round(
            scenario.episode.duration_s / scenario.episode.control_period_s
        ):
            above.plot(*series.pose[-1, 1::-1], marker="x", color=look.colour, markersize=9, markeredgewidth=2)
        apart = series.pose[shown] - series.ship_pose[shown]
        beside.plot(apart[:, 1], apart[:, 0], **line)
        if shown.any():
            beside.plot(*apart[0, 1::-1], marker="o", color=look.colour, markersize=5)
    names = ("range [m]", "log10 of bit rate\nin bit/s", "pointing error [°]")
    angle = math.degrees(scenario.link.midpoint().value("field_of_view_rad"))
    bounds = (longest.slant_height_m, threshold, angle)
    words = (D_C, "the threshold of a link", "the field of view")
    for row, (all_of_it, part) in enumerate(zip(whole, near, strict=True)):
        all_of_it.set_ylabel(names[row])
        for axis in (all_of_it, part):
            axis.axhline(bounds[row], **LIMIT, label=words[row])
            if row == 0:
                axis.axhline(longest.depth_m, color="black", linestyle=":", linewidth=1.0, label=D_B)
            for pulse in pulses:
                axis.axvspan(pulse.begin_s, pulse.end_s, color=PULSE, alpha=0.25, linewidth=0.0)
            axis.grid(color="#dddddd", linewidth=0.6)
            axis.tick_params(labelbottom=row == 2)
        own = [line for line in all_of_it.get_lines() if line.get_label() not in flown]
        all_of_it.legend(handles=own, loc="best", fontsize=8, framealpha=0.9)
        all_of_it.set_xlim(0.0, max(float(longest.time_s[-1]), 0.1))
        all_of_it.axvspan(*span, color=GREY, alpha=0.15, linewidth=0.0, zorder=0)
        part.set_xlim(*span)
        # A scale of its own: what differs is small where nobody leaves the cone.
        values = np.concatenate([line.get_ydata() for line in part.get_lines() if line.get_label() in flown])
        margin = 0.06 * max(float(np.ptp(values)), 1e-3)
        part.set_ylim(values.min() - margin, values.max() + margin)
    for axis in (whole[1], near[1]):
        low, high = axis.get_ylim()
        if low < dark:
            ticks = range(math.ceil(dark + 0.3), math.floor(high) + 1)
            axis.set_yticks([dark, *ticks], ["no light", *map(str, ticks)])
            axis.set_ylim(low, high)
    whole[2].set_ylim(bottom=0.0)
    for axis, what in ((whole[2], "time [s]"), (near[2], f"the {span[1] - span[0]:g} s that differ most, time [s]")):
        axis.set_xlabel(what)
    _draw_ship(above, scenario, longest)
    _draw_cone(beside, longest)
    for axis, title in ((above, "path from above"), (beside, "AUV from the ship, in those seconds")):
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("y, east [m]")
        axis.set_ylabel("x, north [m]")
        axis.set_aspect("equal", adjustable="datalim")
        axis.grid(color="#dddddd", linewidth=0.6)
    handles, labels = above.get_legend_handles_labels()
    if pulses:
        handles.append(_patch(PULSE, 0.25))
        labels.append("pulse" if len(pulses) == 1 else "pulses")
    columns = min(len(labels), 8)
    chart.legend(handles, labels, loc="outside lower center", fontsize=9, ncols=columns, frameon=False, **LEGEND)
    chart.suptitle(heading([name, f"seed {seed}", tables.wrapped(wrappers)], 150))
    save(chart, path)


def _log_rate(series: Series) -> Array:
    """log10 of the bit rate in bit/s, nan where no light arrives."""
    logs: Array = np.log10(np.where(series.bit_rate_bps > 0.0, series.bit_rate_bps, np.nan))
    return logs


def _patch(colour: str, alpha: float) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=colour, alpha=alpha, linewidth=0.0)


def _draw_cone(beside: Any, series: Series) -> None:
    """The cone's footprint around the ship."""
    from matplotlib.patches import Circle

    beside.add_patch(Circle((0.0, 0.0), _footprint(series), facecolor=CONE, edgecolor=GREY, alpha=0.35, zorder=0))
    beside.plot(0.0, 0.0, marker="^", color="black", markersize=6, zorder=4)


def _footprint(series: Series) -> float:
    """Radius of the cone at the AUV's depth [m]; it follows from the cone that the episode drew."""
    return math.sqrt(max(series.slant_height_m**2 - series.depth_m**2, 0.0))


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
        axis.fill_between(steps, low, high, color=OTHERS[0].colour, alpha=0.2, linewidth=0.0)
        axis.plot(steps, mean, color=OTHERS[0].colour, marker="o", markersize=3, label="agent")
        for name, look in looks(baselines).items():
            axis.axhline(baselines[name][key]["mean"], label=name, **style(look))
        axis.set_xlabel("steps")
        axis.set_ylabel(f"{key}, mean and 95 % interval")
        axis.grid(color="#dddddd", linewidth=0.6)
        axis.legend(loc="lower right", fontsize=8, **LEGEND)
    chart.suptitle(title)
    save(chart, path, 120)


def profiles(
    path: Path,
    name: str,
    returns: Mapping[str, Array],
    scenario: Scenario,
    wrappers: Sequence[Mapping[str, Any]] = (),
) -> None:
    """Draw each policy's performance profile: the share of episodes above each share of the possible return.

    Args:
        path: PNG file to write.
        name: The scenario's name, for the title.
        returns: Return by policy, any shape.
        scenario: The scenario, for the highest possible return.
        wrappers: Name and options of what stood around the environments, for the title.
    """
    most = possible(scenario)
    shares = {policy: np.asarray(values).ravel() / most for policy, values in returns.items()}
    every = np.concatenate(list(shares.values()))
    levels = np.linspace(float(every.min()), float(every.max()), 400)
    chart = new_figure(8.0, 4.6)
    axis = chart.add_subplot()
    for policy, look in looks(shares).items():
        axis.plot(levels, statistics.profile(shares[policy], levels), **style(look), label=policy)
    axis.set_xlabel("share of the possible return")
    axis.set_ylabel("share of episodes above it")
    axis.grid(color="#dddddd", linewidth=0.6)
    # Beside the axes: lines may pass anywhere in them.
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5), **LEGEND)
    axis.set_title(heading([name, tables.wrapped(wrappers)], 75))
    save(chart, path)


def _draw_ship(above: Any, scenario: Scenario, series: Series) -> None:
    from matplotlib.patches import Circle

    radius = _footprint(series)
    ship = series.ship_pose
    above.plot(ship[:, 1], ship[:, 0], color="black", linewidth=1.0, label="ship", zorder=1)
    times = series.time_s
    for k, index in enumerate(np.linspace(0, times.size - 1, 6).round().astype(int)):
        label = "cone's footprint, time in s" if k == 0 else None
        centre = (ship[index, 1], ship[index, 0])
        above.add_patch(Circle(centre, radius, facecolor=CONE, edgecolor=GREY, alpha=0.35, zorder=0, label=label))
        above.annotate(f"{times[index]:.0f}", centre, textcoords="offset points", xytext=(4, 4), fontsize=8, zorder=5)
        above.plot(*centre, marker="^", color="black", markersize=5, zorder=4)
