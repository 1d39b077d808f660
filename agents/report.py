"""What a benchmark writes: tables, figures and intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from uwoc_gym.agents.errors import UserError

from uwoc_gym import Scenario

if TYPE_CHECKING:
    from uwoc_gym.agents.evaluate import Flight

COLUMNS: dict[str, tuple[str, int]] = {
    "return": ("return", 1),
    "arrival_s": ("t_a [s]", 3),
    "established_s": ("t_b [s]", 3),
    "restoring_s": ("Δt [s]", 2),
    "rmse_x_m": ("RMSE x [m]", 4),
    "rmse_y_m": ("RMSE y [m]", 4),
    "rmse_yaw_rad": ("RMSE yaw [rad]", 4),
    "availability": ("availability", 4),
    "log10_bit_rate": ("log10 B", 3),
    "delivered_gbit": ("Gbit", 1),
    "effort": ("effort", 4),
    "lost": ("lost", 3),
}
"""Heading and decimals of each measure."""

# Okabe and Ito's colours, which colour-blind readers can tell apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_SHIP, _LIMIT = "#666666", "#000000"


class Estimate(NamedTuple):
    """A mean over episodes with its 95 % bootstrap interval; not-a-number where no episode has a value."""

    mean: float
    low: float
    high: float
    episodes: int


def estimate(values: npt.NDArray[np.float64], rng: np.random.Generator) -> Estimate:
    """The mean of the finite values with a percentile bootstrap interval."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    mean = float(finite.mean())
    if finite.size < 2 or np.ptp(finite) == 0.0:
        return Estimate(mean, mean, mean, finite.size)
    from scipy.stats import bootstrap

    interval = bootstrap(
        (finite,), np.mean, n_resamples=2000, method="percentile", rng=rng, vectorized=True
    ).confidence_interval
    return Estimate(mean, float(interval.low), float(interval.high), finite.size)


def cell(value: Estimate, decimals: int) -> str:
    """An estimate as a table shows it."""
    if value.episodes == 0:
        return "–"
    text = f"{value.mean:.{decimals}f}"
    return text if value.low == value.high else f"{text} [{value.low:.{decimals}f}, {value.high:.{decimals}f}]"


def table(results: Mapping[str, Mapping[str, Mapping[str, Estimate]]], episodes: Mapping[str, int]) -> str:
    """A Markdown table for each scenario: a row for each policy, a column for each measure."""
    parts = []
    for scenario, policies in results.items():
        number = episodes[scenario]
        note = "1 episode; the scenario draws nothing" if number == 1 else f"{number} episodes, mean [95 % interval]"
        rows = [["policy", *(heading for heading, _ in COLUMNS.values())]]
        for policy, measures in policies.items():
            rows.append([policy, *(cell(measures[name], decimals) for name, (_, decimals) in COLUMNS.items())])
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines = [
            "| " + " | ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) + " |" for row in rows
        ]
        lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
        parts.append(f"### {scenario} ({note})\n\n" + "\n".join(lines))
    return "\n\n".join(parts) + "\n"


def pyplot() -> Any:
    """Matplotlib without a display.

    Raises:
        UserError: Matplotlib isn't installed.
    """
    try:
        import matplotlib as mpl
    except ImportError:
        raise UserError('figures need Matplotlib: pip install "uwoc-gym[benchmark]"') from None
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def draw_flights(title: str, scenario: Scenario, flights: Mapping[str, Flight], path: Path) -> None:
    """One picture of the first episode of each policy: range, log bit rate, pointing error, and paths."""
    plt = pyplot()
    link = scenario.midpoint().link
    cone = link.cone()
    figure, axes = plt.subplot_mosaic([["range", "path"], ["rate", "path"], ["angle", "path"]], figsize=(13, 8))
    for (name, flight), colour in zip(flights.items(), COLOURS * 9, strict=False):
        end = len(flight.pose)
        time = flight.record.time_s[:end]
        rate = flight.record.bit_rate_bps[:end, 0]
        axes["range"].plot(time, flight.record.range_m[:end, 0], color=colour, lw=1.4, label=name)
        axes["rate"].plot(time, np.log10(np.where(rate > 0.0, rate, np.nan)), color=colour, lw=1.4)
        axes["angle"].plot(time, np.degrees(flight.pointing_error_rad), color=colour, lw=1.4)
        axes["path"].plot(flight.pose[:, 1], flight.pose[:, 0], color=colour, lw=1.4, label=name)
        axes["path"].plot(flight.pose[0, 1], flight.pose[0, 0], "o", color=colour, ms=5)
    limits = {
        "range": (cone.slant_height_m, "slant height of the cone", "range [m]"),
        "rate": (math.log10(link.threshold_bit_rate_bps), "threshold", "log10 bit rate [bit/s]"),
        "angle": (math.degrees(cone.half_angle_rad), "field of view", "pointing error [deg]"),
    }
    for key, (value, label, quantity) in limits.items():
        axes[key].axhline(value, color=_LIMIT, ls="--", lw=1, label=label)
        axes[key].set(ylabel=quantity, xlabel="time [s]" if key == "angle" else "")
        axes[key].grid(alpha=0.3)
    axes["range"].legend(fontsize=8, ncols=2)
    axes["rate"].legend(fontsize=8)
    axes["angle"].legend(fontsize=8)
    ship = max((flight.ship_pose for flight in flights.values()), key=len)
    axes["path"].plot(ship[:, 1], ship[:, 0], color=_SHIP, lw=1, ls=":", label="ship")
    depth = scenario.midpoint().depth_m
    radius = cone.footprint_radius_m(cone.height_m if depth is None else float(depth))  # type: ignore[arg-type]
    for index in np.linspace(0, len(ship) - 1, 7).astype(int):
        circle = plt.Circle((ship[index, 1], ship[index, 0]), radius, fill=False, color=_SHIP, lw=0.8, alpha=0.7)
        axes["path"].add_patch(circle)
    axes["path"].set(xlabel="y, east [m]", ylabel="x, north [m]", aspect="equal")
    axes["path"].legend(fontsize=8, title="path; circles: the cone's footprint", title_fontsize=8)
    axes["path"].grid(alpha=0.3)
    figure.suptitle(title)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)
