"""The paper's figures, drawn from what was flown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.policies.looks import LOOKS, OTHERS, looks
from uwoc_gym.agents.reports import figures
from uwoc_gym.agents.reports.figures import CONE, D_B, D_C, LIMIT, style
from uwoc_gym.baselines.paper import PUBLISHED
from uwoc_gym.world.optics.link import OpticalLink

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

SIZE_INCHES = (8.0, 4.6)
DOTS_PER_INCH = 150


@dataclass(frozen=True, kw_only=True)
class Track:
    """One controller's flight, thinned for drawing."""

    label: str
    time_s: Array
    pose: Array
    """(T, 3) [m, m, rad]."""
    ship_pose: Array
    """(T, 3) [m, m, rad]."""
    range_m: Array
    pointing_error_rad: Array
    bit_rate_bps: Array


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write NAME.png and NAME.svg, each whole or not at all."""
    for kind in ("png", "svg"):
        figures.save(figure, folder / f"{name}.{kind}", DOTS_PER_INCH)


def _new() -> Figure:
    return figures.new_figure(*SIZE_INCHES)


def _tidy(axis: Any, x: str, y: str) -> None:
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.grid(color="#dddddd", linewidth=0.6)


def _legend_above(figure: Figure, axis: Any, columns: int = 4) -> None:
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, fontsize=8, frameon=False)


def _lines(tracks: Sequence[Track]) -> list[dict[str, Any]]:
    """What each controller's line looks like."""
    found = looks(track.label for track in tracks)
    return [style(found[track.label]) for track in tracks]


def contour_side(link: OpticalLink) -> Figure:
    """log10 of the bit rate over distance and depth, the cone drawn in."""
    cone = link.cone()
    figure = _new()
    axis = figure.add_subplot()
    x, z = np.meshgrid(np.linspace(-4.0, 4.0, 321), np.linspace(0.1, 8.0, 317))
    mesh = _contours(axis, link, x, z, np.hypot(x, z), np.arctan2(np.abs(x), z), (4.0, 13.0))
    edge = cone.height_m * np.tan(cone.half_angle_rad)
    axis.plot(
        [-edge, 0.0, edge, -edge], [cone.height_m, 0.0, cone.height_m, cone.height_m], color="black", label="cone"
    )
    axis.set_ylim(8.0, 0.0)
    _tidy(axis, "horizontal distance [m]", "depth below the ship [m]")
    axis.legend(loc="lower right", fontsize=8)
    figure.colorbar(mesh, ax=axis, label="log10 of bit rate in bit/s")
    return figure


def contour_top(link: OpticalLink) -> Figure:
    """log10 of the bit rate at the cone's height, seen from above."""
    cone = link.cone()
    figure = _new()
    axis = figure.add_subplot()
    x, y = np.meshgrid(np.linspace(-3.0, 3.0, 301), np.linspace(-3.0, 3.0, 301))
    r = np.hypot(x, y)
    mesh = _contours(axis, link, x, y, np.hypot(r, cone.height_m), np.arctan2(r, cone.height_m), (7.0, 10.0))
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    edge = cone.height_m * np.tan(cone.half_angle_rad)
    axis.plot(edge * np.cos(angle), edge * np.sin(angle), color="black", label="cone")
    axis.set_aspect("equal")
    _tidy(axis, "x from the ship [m]", "y from the ship [m]")
    axis.legend(loc="lower right", fontsize=8)
    figure.colorbar(mesh, ax=axis, label="log10 of bit rate in bit/s", ticks=[7, 8, 9, 10])
    return figure


def _contours(
    axis: Any, link: OpticalLink, x: Array, y: Array, range_m: Array, angle: Array, span: tuple[float, float]
) -> Any:
    rate = np.asarray(link.bit_rate(range_m, np.minimum(angle, np.pi / 2 - 1e-6)))
    logs = np.log10(np.where(rate > 0.0, rate, np.nan))
    mesh = axis.contourf(x, y, logs, levels=np.linspace(*span, 19), cmap="cividis", extend="both")
    lines = axis.contour(
        x, y, logs, levels=np.arange(math.ceil(span[0]) + 1.0, span[1]), colors="white", linewidths=0.7
    )
    axis.clabel(lines, fmt="%d", fontsize=8)
    return mesh


def slant_height(links: Mapping[str, OpticalLink]) -> Figure:
    """Bit rate along the cone's edge for each background, and where it falls to the threshold."""
    figure = _new()
    axis = figure.add_subplot()
    ranges = np.linspace(1.0, 8.0, 281)
    for look, (name, link) in zip(OTHERS, links.items(), strict=False):
        cone = link.cone()
        rate = np.asarray(link.bit_rate(ranges, cone.half_angle_rad))
        line = style(look)
        axis.plot(ranges, np.log10(rate), **line, label=f"background {name}")
        axis.plot([cone.slant_height_m] * 2, [5.0, 7.0], color=line["color"], linewidth=0.8)
        axis.plot(cone.slant_height_m, 7.0, "o", color=line["color"])
        axis.annotate(f"{cone.slant_height_m:.3f} m", (cone.slant_height_m, 5.15), fontsize=8,
                      xytext=(4, 0), textcoords="offset points")  # fmt: skip
    axis.axhline(7.0, **LIMIT, label="threshold")
    axis.set_ylim(5.0, 10.0)
    _tidy(axis, "range at the edge of the field of view [m]", "log10 of bit rate in bit/s")
    axis.legend(fontsize=8)
    return figure


def states(tracks: Sequence[Track]) -> Figure:
    """x, y and yaw of the ship and of each controller's AUV against time."""
    figure = _new()
    axes = figure.subplots(3, 1, sharex=True)
    for k, (axis, name) in enumerate(zip(axes, ("x [m]", "y [m]", "yaw [rad]"), strict=True)):
        axis.plot(tracks[0].time_s, tracks[0].ship_pose[:, k], color="black", linewidth=1.0, label="ship")
        for track, line in zip(tracks, _lines(tracks), strict=True):
            axis.plot(track.time_s, track.pose[:, k], **line, label=track.label)
        axis.margins(x=0.0)
        _tidy(axis, "time [s]" if k == 2 else "", name)
    _legend_above(figure, axes[0])
    return figure


def view(tracks: Sequence[Track], depth_m: float, radius_m: float) -> Figure:
    """The paths in space, with the cone at a few moments."""
    figure = _new()
    axis: Any = figure.add_subplot(projection="3d")
    ship = tracks[0].ship_pose
    axis.plot(ship[:, 0], ship[:, 1], np.zeros(len(ship)), color="black", linewidth=1.0, label="ship")
    for track, line in zip(tracks, _lines(tracks), strict=True):
        axis.plot(track.pose[:, 0], track.pose[:, 1], np.full(len(track.pose), depth_m), **line, label=track.label)
    angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.array([0.0, 1.0]))
    for index in np.linspace(0, len(ship) * 0.4, 4).astype(int):
        axis.plot_surface(
            ship[index, 0] + radius_m * height * np.cos(angle),
            ship[index, 1] + radius_m * height * np.sin(angle),
            depth_m * height,
            color=CONE, alpha=0.25, linewidth=0.0,
        )  # fmt: skip
    axis.set_box_aspect((1.0, 1.0, 0.45), zoom=1.25)
    axis.set_zlim(depth_m * 1.2, 0.0)
    axis.set_xlabel("x [m]")
    axis.set_ylabel("y [m]")
    axis.set_zlabel("depth [m]")
    axis.legend(fontsize=8, loc="upper left")
    return figure


def against_time(tracks: Sequence[Track], values: Sequence[Array], label: str, limits: Mapping[str, float]) -> Figure:
    """One quantity of each controller against time, whole and around the first seconds and the disturbance."""
    figure = _new()
    grid = figure.add_gridspec(2, 2)
    panels = [figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])]
    spans = ((0.0, float(tracks[0].time_s[-1])), (0.0, 6.0), (28.0, 40.0))
    for axis, (low, high) in zip(panels, spans, strict=True):
        for track, series, line in zip(tracks, values, _lines(tracks), strict=True):
            shown = (track.time_s >= low) & (track.time_s <= high)
            axis.plot(track.time_s[shown], series[shown], **line, label=track.label)
        for k, (name, limit) in enumerate(limits.items()):
            axis.axhline(limit, **{**LIMIT, "linestyle": ((0, (4, 3)), ":")[k]}, label=name)
        axis.margins(x=0.0, y=0.08)
        _tidy(axis, "time [s]" if axis is not panels[0] else "", "" if axis is panels[2] else label)
    _legend_above(figure, panels[0], 3)
    return figure


def measures(
    track: Track, slant_height_m: float, depth_m: float, times: Mapping[str, float], outage_s: float
) -> Figure:
    """What the arrival, establishment and restoring time are, on one controller's range."""
    figure = _new()
    axis = figure.add_subplot()
    shown = track.time_s <= 45.0
    axis.plot(track.time_s[shown], track.range_m[shown], **style(LOOKS["pd"]), label=track.label)
    axis.axhline(slant_height_m, **LIMIT, label=D_C)
    axis.axhline(depth_m, color="black", linestyle=":", linewidth=1.0, label=D_B)
    left, back = times["left"], times["back"]
    for name in ("t_a", "t_b"):
        up = 6.6 if name == "t_a" else 5.9
        axis.annotate(name, (times[name], slant_height_m), xytext=(times[name] + 3.0, up), fontsize=10,
                      arrowprops={"arrowstyle": "->"})  # fmt: skip
    if np.isfinite(left):
        axis.axvspan(left, back, color=CONE, alpha=0.6)
        axis.annotate(f"Δt = {outage_s:.2f} s", ((left + back) / 2, slant_height_m + 0.4), xytext=(33.5, 6.2),
                      fontsize=10, arrowprops={"arrowstyle": "->"})  # fmt: skip
    axis.margins(x=0.0)
    _tidy(axis, "time [s]", "range d [m]")
    axis.legend(fontsize=8, loc="upper right")
    return figure


def sweep(sizes: Array, curves: Mapping[str, tuple[Array, Array]], slant_height_m: float) -> Figure:
    """Greatest range after the pulse, and restoring time, against the pulse's size."""
    figure = _new()
    left, right = figure.subplots(1, 2)
    for name, look in looks(curves).items():
        peak, restoring = curves[name]
        left.plot(sizes, peak, marker=".", **style(look), label=name)
        right.plot(sizes, restoring, marker=".", **style(look), label=name)
    left.axhline(slant_height_m, **LIMIT, label=D_C)
    right.axhline(PUBLISHED["case-1", "PD"].restoring_time_s, **LIMIT, label="published for PD")
    _tidy(left, "pulse [N, N, N m]", "greatest range after the pulse [m]")
    _tidy(right, "pulse [N, N, N m]", "restoring time Δt [s]")
    left.legend(fontsize=8)
    right.legend(fontsize=8)
    return figure


def lyapunov(time_s: Array, curves: Mapping[str, Array]) -> Figure:
    """V along the nominal flights, on a log scale."""
    figure = _new()
    axis = figure.add_subplot()
    for name, look in looks(curves).items():
        axis.plot(time_s, np.maximum(curves[name], 1e-16), **style(look), label=name)
    axis.set_yscale("log")
    axis.margins(x=0.0)
    _tidy(axis, "time [s]", "V [J]")
    axis.legend(fontsize=8)
    return figure
