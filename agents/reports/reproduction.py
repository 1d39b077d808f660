"""Every figure and table of the paper, its numbers beside ours."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.flight import Flight, fly
from uwoc_gym.agents.reports import paper_figures
from uwoc_gym.agents.reports.documents import Block, Heading, Paragraph, Picture, Table
from uwoc_gym.agents.reports.figures import D_B, D_C
from uwoc_gym.agents.reports.paper_figures import Track
from uwoc_gym.baselines import Gains, gains, paper
from uwoc_gym.baselines.controllers import one_for_each
from uwoc_gym.baselines.paper import CALIBRATED, IMPROVEMENT, PUBLISHED, SAMPLING_TIME_S, SCENARIOS, Row
from uwoc_gym.metrics import rmse, since_arrival, tracking_error
from uwoc_gym.scenario import Scenario
from uwoc_gym.world.optics.link import OpticalLink

Array = npt.NDArray[np.float64]

CASES = tuple(SCENARIOS)
TITLES = {"nominal": "Nominal", "case-1": "Case I", "case-2": "Case II"}

PULSE_SIZES_N = np.arange(0.0, 2001.0, 100.0)
"""Pulse sizes that are swept, alike on all three axes [N, N, N m]."""

SHOWN_PULSE_N = 1500.0
"""The pulse that illustrates the measures: the printed PD loses the link in it for about a second."""

NOISE_SEEDS = tuple(range(8))
"""Seeds of the noise with which the calibrated cases are flown."""

COLUMNS = ("RMSE x [m]", "RMSE y [m]", "RMSE yaw [rad]", "t_a [s]", "Δt [s]")
DIGITS = (4, 4, 4, 3, 2)

EPSILON = 1.0
"""The weight of the disturbance at which the matrix inequality's sign is reported."""


@dataclass(frozen=True)
class Variant:
    """A law on a plant, as one row of the tables."""

    label: str
    law: str
    """PD or NLPD, whose published row it stands beside."""
    gains: Gains
    coriolis: bool


def variants() -> tuple[Variant, ...]:
    """The rows of the tables besides the published ones."""
    pd, nlpd, plain = gains("pd"), gains("nlpd"), gains("pd-plain")
    return (
        Variant("PD, as printed", "PD", pd, True),
        Variant("PD, as found", "PD", plain, False),
        Variant("PD, no feedforward", "PD", plain, True),
        Variant("NLPD, as printed", "NLPD", nlpd, True),
        Variant("NLPD, no feedforward", "NLPD", replace(nlpd, feedforward=False), True),
    )


COMPARISONS = (
    ("as printed: both with full feedforward", "PD, as printed", "NLPD, as printed"),
    ("as found: PD without feedforward, on a plant without Coriolis terms", "PD, as found", "NLPD, as printed"),
    ("neither with feedforward", "PD, no feedforward", "NLPD, no feedforward"),
)
"""Pairs of variants whose improvement is worked out."""


def fly_and_draw(folder: Path) -> tuple[dict[str, Any], dict[str, Scenario], list[str]]:
    """Fly the paper's simulations and draw their figures, which go to the folder.

    Returns:
        The numbers as plain data, the scenarios that were flown by name, and the figures' names.
    """
    from tqdm import tqdm

    results: dict[str, Any] = {}
    scenarios: dict[str, Scenario] = {}
    figures: dict[str, Callable[[], Any]] = {}
    stages: list[tuple[str, Callable[[], None]]] = [
        ("link", lambda: _link(results, figures)),
        ("printed cases", lambda: _cases(results, figures, scenarios)),
        ("pulse sweep", lambda: _sweep(results, figures, scenarios)),
        *(
            (f"calibrated {TITLES[case]}", partial(_calibrated, case, results, figures, scenarios))
            for case in CALIBRATED
        ),
    ]
    with tqdm(total=len(stages), file=sys.stderr, unit="part") as bar:
        for name, stage in stages:
            bar.set_description(name)
            stage()
            bar.update()
        bar.total += len(figures)
        for name, draw in figures.items():
            bar.set_description(name)
            paper_figures.save(draw(), folder, name)
            bar.update()
    return results, scenarios, list(figures)


def _percent(ours: float, theirs: float) -> float:
    """Relative difference [%]; nan where the published value is 0 or either is none."""
    return 100.0 * (ours - theirs) / theirs if theirs else math.nan


def _link(results: dict[str, Any], figures: dict[str, Callable[[], Any]]) -> None:
    links = {name: OpticalLink(background=name) for name in ("surface", "printed")}
    published = {"slant_height_m": paper.SLANT_HEIGHT_M, "height_m": paper.CONE_HEIGHT_M}
    cone: dict[str, Any] = {"published": published, "threshold_mbit_s": links["surface"].threshold_bit_rate_bps / 1e6}
    for name, link in links.items():
        own = link.cone()
        got = {"slant_height_m": own.slant_height_m, "height_m": own.height_m}
        cone[name] = {**got, "difference_percent": {key: _percent(got[key], published[key]) for key in got}}
    on_axis = float(links["surface"].bit_rate(links["surface"].cone().height_m, 0.0))
    cone["on_axis_gbit_s"] = on_axis / 1e9
    cone["footprint_radius_m"] = links["surface"].cone().height_m * math.tan(links["surface"].cone().half_angle_rad)
    results["cone"] = cone
    figures["contour_side"] = partial(paper_figures.contour_side, links["surface"])
    figures["contour_top"] = partial(paper_figures.contour_top, links["surface"])
    figures["slant_height"] = partial(paper_figures.slant_height, links)


def _fly(
    scenario: Scenario, laws: Sequence[Gains], seeds: Sequence[int], parameters: Mapping[str, npt.ArrayLike] | None
) -> Flight:
    """Fly one gain set per simulation at the paper's sampling time."""
    return fly(one_for_each(laws), scenario, seeds, parameters, extra=("velocity", "ship_velocity", "depth_m"))


def _pulse(size: npt.ArrayLike) -> dict[str, npt.ArrayLike]:
    names = ("force_x_n", "force_y_n", "moment_nm")
    return {f"sea.pulses[0].{name}": size for name in names}


_SWEPT = {"sea": {"pulses": [dict.fromkeys(("force_x_n", "force_y_n", "moment_nm"), (0.0, 2000.0))]}}


def _rows(flight: Flight) -> list[Row]:
    """The tables' numbers of each simulation, RMSE from arrival to the end."""
    m = flight.metrics
    columns = (m.rmse_x_m, m.rmse_y_m, m.rmse_yaw_rad, m.arrival_time_s, m.restoring_time_s)
    return [Row(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def _compared(row: Row, published: Row) -> dict[str, Any]:
    difference = {key: _percent(ours, theirs) for key, ours, theirs in zip(Row._fields, row, published, strict=True)}
    return {**row._asdict(), "difference_percent": difference}


def _track(flight: Flight, lane: int, label: str, stride: int = 10) -> Track:
    record = flight.record
    own = np.flatnonzero(record.valid[:, lane])[::stride]
    away = record.ship_pose[own, lane, :2] - record.pose[own, lane, :2]
    across, depth = np.hypot(away[:, 0], away[:, 1]), flight.extra["depth_m"][own, lane]
    return Track(
        label=label,
        time_s=record.time_s[own],
        pose=record.pose[own, lane],
        ship_pose=record.ship_pose[own, lane],
        range_m=np.hypot(across, depth),
        pointing_error_rad=np.arctan2(across, depth),
        bit_rate_bps=record.bit_rate_bps[own, lane],
    )


def _case_figures(
    figures: dict[str, Callable[[], Any]], prefix: str, tracks: Sequence[Track], link: OpticalLink
) -> None:
    cone = link.cone()
    radius = cone.height_m * math.tan(cone.half_angle_rad)
    logs = [np.log10(np.where(t.bit_rate_bps > 0.0, t.bit_rate_bps, np.nan)) for t in tracks]
    ranges = {D_C: cone.slant_height_m, D_B: cone.height_m}
    angles = [np.rad2deg(t.pointing_error_rad) for t in tracks]
    against = paper_figures.against_time
    figures[f"{prefix}_states"] = partial(paper_figures.states, tracks)
    figures[f"{prefix}_view"] = partial(paper_figures.view, tracks, cone.height_m, radius)
    figures[f"{prefix}_range"] = partial(against, tracks, [t.range_m for t in tracks], "range d [m]", ranges)
    figures[f"{prefix}_bit_rate"] = partial(
        against, tracks, logs, "log10 of bit rate", {"threshold": math.log10(link.threshold_bit_rate_bps)}
    )
    figures[f"{prefix}_pointing_error"] = partial(
        against, tracks, angles, "pointing error [°]", {"Ψ_C": math.degrees(cone.half_angle_rad)}
    )


def _cases(results: dict[str, Any], figures: dict[str, Callable[[], Any]], scenarios: dict[str, Scenario]) -> None:
    """All variants through the three cases as printed: one flight per plant."""
    pulse = np.array([0.0, 350.0, 350.0])
    masses = np.array([1.0, 1.0, 1.2])
    rows: dict[str, dict[str, Row]] = {case: {} for case in CASES}
    tracks: dict[str, dict[str, Track]] = {case: {} for case in CASES}
    for coriolis in (True, False):
        own = [variant for variant in variants() if variant.coriolis == coriolis]
        scenario = paper.sampled_as_published(
            Scenario().merged({**_SWEPT, "vehicle": {"mass_scale": (1.0, 1.2), "coriolis": coriolis}})
        )
        scenarios[f"cases as printed, {'full plant' if coriolis else 'no Coriolis terms'}"] = scenario
        laws = [variant.gains for variant in own for _ in CASES]
        chosen = {**_pulse(np.tile(pulse, len(own))), "vehicle.mass_scale": np.tile(masses, len(own))}
        flight = _fly(scenario, laws, [0] * len(laws), chosen)
        for lane, row in enumerate(_rows(flight)):
            variant, case = own[lane // len(CASES)], CASES[lane % len(CASES)]
            rows[case][variant.label] = row
            tracks[case][variant.label] = _track(flight, lane, variant.label)
        if coriolis:
            _lyapunov(results, figures, flight, own)
        else:
            found = next(i for i, variant in enumerate(own) if variant.label == "PD, as found") * len(CASES)
            results["late_window"] = _late_window(flight, found)
    results["settings"] = {
        "sampling_time_s": SAMPLING_TIME_S,
        "duration_s": scenario.episode.duration_s,
        "pulse_n": 350.0,
        "pulse_start_s": 30.0,
        "pulse_duration_s": 1.0,
        "mass_error_percent": 20.0,
        "position_gain": 300.0,
        "velocity_gain": 250.0,
        "nlpd": {name: getattr(gains("nlpd"), name) for name in ("mu_p", "mu_v", "b_p")},
    }
    results["published"] = {f"{case}, {law}": row._asdict() for (case, law), row in PUBLISHED.items()}
    results["tables"] = {
        case: {v.label: _compared(rows[case][v.label], PUBLISHED[case, v.law]) for v in variants()} for case in CASES
    }
    results["improvement"] = {
        case: {
            "published": _shares(IMPROVEMENT[case]),
            **{name: _shares(paper.improvement(rows[case][pd], rows[case][nlpd])) for name, pd, nlpd in COMPARISONS},
        }
        for case in CASES
    }
    for case in CASES:
        shown = [tracks[case][name] for name in ("PD, as printed", "NLPD, as printed", "PD, as found")]
        _case_figures(figures, case, shown, scenario.link)


def _shares(row: Row) -> dict[str, float]:
    percents = {f"{key}_percent": 100.0 * value for key, value in zip(Row._fields[:3], row[:3], strict=True)}
    return {**percents, "arrival_earlier_s": row.arrival_time_s}


def _late_window(flight: Flight, lane: int, start_s: float = 2.2) -> dict[str, float]:
    """RMSE of one simulation from a given time on, to show what the window does."""
    record = flight.record
    error = tracking_error(record.pose[:, lane], record.ship_pose[:, lane])
    values = rmse(error, since_arrival(record.in_cone[:, lane]) & (record.time_s >= start_s))
    return {"start_s": start_s, **dict(zip(Row._fields[:3], values.tolist(), strict=True))}


def _lyapunov(
    results: dict[str, Any], figures: dict[str, Callable[[], Any]], flight: Flight, own: Sequence[Variant]
) -> None:
    """V along the undisturbed flights, its balance with what is dissipated, and the matrix inequality's sign."""
    record = flight.record
    vehicle = Scenario().vehicle
    report_ = {}
    curves = {}
    for name in ("PD, as printed", "NLPD, as printed"):
        variant = next(i for i, each in enumerate(own) if each.label == name)
        lane = variant * len(CASES)
        yaw, velocity = record.pose[:, lane, 2], flight.extra["velocity"][:, lane]
        error = tracking_error(record.pose[:, lane], record.ship_pose[:, lane])
        cosine, sine = np.cos(yaw), np.sin(yaw)
        over_ground = np.stack(
            [
                cosine * velocity[:, 0] - sine * velocity[:, 1],
                sine * velocity[:, 0] + cosine * velocity[:, 1],
                velocity[:, 2],
            ],
            axis=-1,
        )
        drift = flight.extra["ship_velocity"][:, lane] - over_ground
        law = own[variant].gains
        value = paper.lyapunov(error, drift, yaw, law, vehicle)
        resisting = paper.damping_and_gain(velocity, drift, yaw, law, vehicle)
        power = np.einsum("ti,tij,tj->t", drift, resisting, drift)
        lost = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1])) * SAMPLING_TIME_S])
        weakest = float(np.linalg.eigvalsh(resisting)[:, 0].min())
        matrix = paper.inequality_matrix(resisting[::10], EPSILON)
        curves[name] = value[::10]
        report_[name] = {
            "initial_j": float(value[0]),
            "final_j": float(value[-1]),
            "largest_rise_in_a_sample_j": float(np.diff(value).max()),
            "largest_imbalance_percent": float(100.0 * np.abs(value + lost - value[0]).max() / value[0]),
            "smallest_eigenvalue_of_damping_and_gain": weakest,
            "largest_eigenvalue_of_inequality": float(np.linalg.eigvalsh(matrix)[:, -1].max()),
            "smallest_epsilon": 1.0 / math.sqrt(weakest - 1.0) if weakest > 1.0 else math.nan,
        }
    results["lyapunov"] = {"epsilon": EPSILON, **report_}
    figures["lyapunov"] = partial(paper_figures.lyapunov, record.time_s[::10], curves)


def _sweep(results: dict[str, Any], figures: dict[str, Callable[[], Any]], scenarios: dict[str, Scenario]) -> None:
    """Both printed laws through pulses of growing size."""
    laws = {"PD, as printed": gains("pd"), "NLPD, as printed": gains("nlpd")}
    n = PULSE_SIZES_N.size
    duration = 45.0
    scenario = paper.sampled_as_published(Scenario().merged({**_SWEPT, "episode": {"duration_s": duration}}))
    scenarios["pulse sweep"] = scenario
    each = [law for law in laws.values() for _ in range(n)]
    flight = _fly(scenario, each, [0] * len(each), _pulse(np.tile(PULSE_SIZES_N, len(laws))))
    after = flight.record.time_s >= 30.0
    curves, found = {}, {}
    for i, name in enumerate(laws):
        lanes = slice(i * n, (i + 1) * n)
        away = (flight.record.ship_pose - flight.record.pose)[after, lanes, :2]
        peak = np.hypot(np.hypot(away[..., 0], away[..., 1]), flight.extra["depth_m"][after, lanes]).max(axis=0)
        restoring = flight.metrics.restoring_time_s[lanes]
        curves[name] = (peak, restoring)
        losing = PULSE_SIZES_N[restoring > 0.0]
        found[name] = {
            "peak_range_m": peak.tolist(),
            "restoring_time_s": restoring.tolist(),
            "at_printed_pulse_m": float(np.interp(350.0, PULSE_SIZES_N, peak)),
            "first_outage_n": float(losing[0]) if losing.size else math.nan,
            "at_shown_pulse_s": float(restoring[int(np.flatnonzero(PULSE_SIZES_N == SHOWN_PULSE_N)[0])]),
        }
    results["sweep"] = {"sizes_n": PULSE_SIZES_N.tolist(), "shown_pulse_n": SHOWN_PULSE_N, **found}
    cone = scenario.link.cone()
    figures["pulse_sweep"] = partial(paper_figures.sweep, PULSE_SIZES_N, curves, cone.slant_height_m)
    lane = int(np.flatnonzero(PULSE_SIZES_N == SHOWN_PULSE_N)[0])
    inside, times = flight.record.in_cone[:, lane], flight.record.time_s
    left = times[after & ~inside][0]
    restoring_s = float(flight.metrics.restoring_time_s[lane])
    marks = {
        "t_a": float(flight.metrics.arrival_time_s[lane]),
        "t_b": float(flight.metrics.establishment_time_s[lane]),
        "left": float(left),
        "back": float(left) + restoring_s,
    }
    track = _track(flight, lane, f"PD, as printed, pulse of {SHOWN_PULSE_N:.0f} N", stride=2)
    figures["measures"] = partial(paper_figures.measures, track, cone.slant_height_m, cone.height_m, marks, restoring_s)


def _calibrated(
    case: str, results: dict[str, Any], figures: dict[str, Callable[[], Any]], scenarios: dict[str, Scenario]
) -> None:
    """PD and NLPD, as their nominal rows came out, through a case's calibrated scenario, over seeds of the noise."""
    known = CALIBRATED[case]
    scenario = paper.sampled_as_published(Scenario.named(known.scenario))
    sides = {
        "PD": ("PD, as found", gains("pd-plain"), paper.without_coriolis(scenario)),
        "NLPD": ("NLPD, as printed", gains("nlpd"), scenario),
    }
    found: dict[str, Any] = {}
    residuals = []
    shown = []
    for law, (label, gain_set, plant) in sides.items():
        scenarios[f"{known.scenario}, {law}'s plant"] = plant
        flight = _fly(plant, [gain_set] * len(NOISE_SEEDS), NOISE_SEEDS, None)
        shown.append(_track(flight, 0, label))
        record = flight.record
        time_s = record.time_s[:, None]
        window = since_arrival(record.in_cone, record.valid) & (time_s <= known.window_end_s)
        if known.window_start_s is not None:
            window &= time_s >= known.window_start_s
        errors = rmse(tracking_error(record.pose, record.ship_pose), window)
        columns = [*errors.T, flight.metrics.arrival_time_s, flight.metrics.restoring_time_s]
        mean = Row(*(float(np.mean(column)) for column in columns))
        spread = Row(*(float(np.std(column, ddof=1)) for column in columns))
        published = PUBLISHED[case, law]
        found[law] = {**_compared(mean, published), "standard_deviation": spread._asdict()}
        scale = [*published[:4], PUBLISHED[case, "PD"].restoring_time_s]
        residuals += [(ours - theirs) / by for ours, theirs, by in zip(mean, published, scale, strict=True)]
    pulse, sensors = scenario.sea.pulses[0], scenario.sensors
    results.setdefault("calibrated", {})[case] = {
        "scenario": known.scenario,
        "pulse": {"force_x_n": pulse.force_x_n, "force_y_n": pulse.force_y_n, "moment_nm": pulse.moment_nm},
        "noise": dict(sensors.numbers()),
        "window": {"start_s": known.window_start_s, "end_s": known.window_end_s},
        "noise_seeds": len(NOISE_SEEDS),
        "rows": found,
        "rms_residual_percent": 100.0 * math.sqrt(float(np.mean(np.square(residuals)))),
    }
    _case_figures(figures, f"{case}_calibrated", shown, scenario.link)


def _number(value: float | None, digits: int, nobody: str = "–") -> str:
    return nobody if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def _signed(value: float, digits: int = 1) -> str:
    return "" if not math.isfinite(value) else f" ({value:+.{digits}f} %)"


def row_cells(row: Mapping[str, Any], outage: bool = True) -> list[str]:
    """A table row's five numbers, with the relative difference where there is one."""
    differences = row.get("difference_percent", {})
    cells = []
    for key, digits in zip(Row._fields, DIGITS, strict=True):
        value = row[key]
        if key == "restoring_time_s" and (not outage or value == 0.0):
            cells.append("none" if outage else "–")
            continue
        never = key.endswith("_time_s") and not math.isfinite(value)
        cells.append("never" if never else _number(value, digits) + _signed(differences.get(key, math.nan)))
    return cells


def report_blocks(results: Mapping[str, Any]) -> list[Block]:
    """The report, which shows nothing but what stands in the results."""
    settings = results["settings"]
    blocks: list[Block] = [
        Heading("The paper's figures and tables, flown again", 1),
        Paragraph(
            "I. N'Doye, D. Zhang, M.-S. Alouini and T.-M. Laleg-Kirati, “Establishing and Maintaining a Reliable "
            "Optical Wireless Communication in Underwater Environment”: what its equations give, beside what it "
            f"prints. Written by “uwoc-gym reproduce”; flights are sampled at {settings['sampling_time_s']} s and last "
            f"{settings['duration_s']:.0f} s. Percentages in brackets are relative differences from what is published."
        ),
    ]
    return [
        *blocks,
        *_link_blocks(results["cone"]),
        *_case_blocks(results),
        *_calibrated_blocks(results),
        *_lyapunov_blocks(results["lyapunov"]),
    ]


def _link_blocks(cone: Mapping[str, Any]) -> list[Block]:
    rows = [["published", *(_number(cone["published"][key], 4) for key in ("slant_height_m", "height_m"))]]
    for name in ("surface", "printed"):
        own = cone[name]
        rows.append(
            [f"background {name}"]
            + [
                _number(own[key], 4) + _signed(own["difference_percent"][key], 2)
                for key in ("slant_height_m", "height_m")
            ]
        )
    return [
        Heading("The link and its cone"),
        Table(
            ["", "slant height d_C [m]", "height h_C [m]"],
            rows,
            "The cone in which the threshold rate is reached. The paper rounds d_C; its h_C gives the value shown.",
        ),
        Paragraph(
            "The background equation as printed attenuates sunlight twice and collects it through the concentrator; "
            "the cone it gives is too short. With the receiver at the surface, where the ship carries it, and diffuse "
            "light on the bare detector, both published lengths come out, so that this is the default; the printed "
            f"form can be selected. At the cone's height the rate on the axis is {cone['on_axis_gbit_s']:.1f} Gbit/s "
            f"against {cone['threshold_mbit_s']:.0f} Mbit/s at the edge of a disc of radius "
            f"{cone['footprint_radius_m']:.2f} m."
        ),
        Picture("contour_side", "Side view of the bit rate, with the cone."),
        Picture("contour_top", "Top view of the bit rate at the cone's height."),
        Picture("slant_height", "The slant height, read off the bit rate along the edge of the field of view."),
    ]


def _case_blocks(results: Mapping[str, Any]) -> list[Block]:
    settings, sweep, late = results["settings"], results["sweep"], results["late_window"]
    nlpd = settings["nlpd"]
    notes = {
        "nominal": (
            "The published PD row is that of a PD without feedforward on a plant without Coriolis terms; the "
            "published NLPD row is that of the law with its full feedforward on the full plant. The published "
            "comparison thus pits a controller without a model against one with a model. The RMSE is taken from "
            f"arrival to the end; from {late['start_s']} s on, the PD as found gives {late['rmse_x_m']:.4f}, "
            f"{late['rmse_y_m']:.4f} and {late['rmse_yaw_rad']:.4f}. The paper doesn't give the NLPD's exponents; the "
            "flights use those that “uwoc-gym calibrate nlpd” found, which aren't the only ones that match: "
            f"μ_p = {_triple(nlpd['mu_p'])}, μ_v = {_triple(nlpd['mu_v'])}, b = {nlpd['b_p'][0]:.4f}."
        ),
        "case-1": (
            f"A pulse of {settings['pulse_n']:.0f} N, {settings['pulse_n']:.0f} N and {settings['pulse_n']:.0f} N m at "
            f"{settings['pulse_start_s']:.0f} s for {settings['pulse_duration_s']:.0f} s. With the printed gains "
            f"(K_p = {settings['position_gain']:.0f}, K_v = {settings['velocity_gain']:.0f}) it drives the PD's range "
            f"to about {sweep['PD, as printed']['at_printed_pulse_m']:.2f} m only, well inside the cone: the published "
            "outage can't follow from the printed settings. The noise's level isn't given either, so that these "
            "flights are without. The published tables print Case I's improvement of yaw with the wrong sign, and Case "
            "II's of the arrival with a value that its rows don't give."
        ),
        "case-2": (
            f"Case I with masses {settings['mass_error_percent']:.0f} % above what the controllers know. As in Case I, "
            "no controller leaves the cone with the printed pulse."
        ),
    }
    blocks: list[Block] = []
    for case in CASES:
        blocks += [Heading(TITLES[case]), _case_table(results, case), _improvement_table(results, case)]
        blocks += [Paragraph(notes[case]), *_pictures(case, TITLES[case])]
    outage, published = sweep["PD, as printed"], results["published"]["case-1, PD"]["restoring_time_s"]
    blocks += [
        Heading("How large a pulse breaks the link"),
        Picture("pulse_sweep", "Greatest range and restoring time against the pulse's size, alike on all axes."),
        Paragraph(
            f"The printed PD first loses the link at {outage['first_outage_n']:.0f} N, and at "
            f"{sweep['shown_pulse_n']:.0f} N for {outage['at_shown_pulse_s']:.2f} s (published Δt: {published:.2f} s); "
            f"the NLPD's outage there is {sweep['NLPD, as printed']['at_shown_pulse_s']:.2f} s."
        ),
        Picture("measures", "Arrival, establishment and restoring time, on a flight through the larger pulse."),
    ]
    return blocks


def _triple(values: Iterable[float]) -> str:
    return f"({', '.join(f'{value:.4f}' for value in values)})"


def _case_table(results: Mapping[str, Any], case: str) -> Table:
    outage = case != "nominal"
    rows = []
    for law in ("PD", "NLPD"):
        rows.append([f"{law}, published", *row_cells(results["published"][f"{case}, {law}"], outage)])
        rows += [
            [variant.label, *row_cells(results["tables"][case][variant.label], outage)]
            for variant in variants()
            if variant.law == law
        ]
    return Table(
        ["", *COLUMNS],
        rows,
        f"{TITLES[case]}, printed settings. As printed: full feedforward, full plant. As found: no feedforward, plant "
        "without Coriolis terms.",
    )


def _improvement_table(results: Mapping[str, Any], case: str) -> Table:
    keys = (*(f"{key}_percent" for key in Row._fields[:3]), "arrival_earlier_s")
    rows = [
        [
            name,
            *(f"{_number(row[key], 2 if 'percent' in key else 3)}{' %' if 'percent' in key else ''}" for key in keys),
        ]
        for name, row in results["improvement"][case].items()
    ]
    return Table(
        ["NLPD against PD", "RMSE x", "RMSE y", "RMSE yaw", "earlier by [s]"],
        rows,
        "By how much the NLPD's error is below the PD's, and its arrival earlier: as published, and for pairs of the "
        "rows above. The first and the last computed pair are the fair ones: both laws have the same model.",
    )


def _pictures(prefix: str, title: str) -> list[Block]:
    captions = {
        "states": "states of the ship and the AUV",
        "view": "paths in space",
        "range": "range with d_C and d_B",
        "bit_rate": "logarithm of the bit rate",
        "pointing_error": "receiver's pointing error with the field of view",
    }
    return [Picture(f"{prefix}_{name}", f"{title}: {caption}.") for name, caption in captions.items()]


def _calibrated_blocks(results: Mapping[str, Any]) -> list[Block]:
    blocks: list[Block] = [
        Heading("Cases I and II, calibrated"),
        Paragraph(
            "What follows isn't the paper's setting: pulse, noise and RMSE window were searched (“uwoc-gym calibrate "
            "case-1” and “case-2”) so that PD and NLPD come as near as they can to the published rows, with one "
            "setting per case. The PD is the one of the published nominal row, without feedforward and on a plant "
            "without Coriolis terms: its error behind the moving ship is what lets the pulse push it out where the "
            "NLPD stays in. The differences that remain say how far the tables are from what this model gives."
        ),
    ]
    for case, found in results["calibrated"].items():
        rows = []
        for law in ("PD", "NLPD"):
            rows.append([f"{law}, published", *row_cells(results["published"][f"{case}, {law}"])])
            rows.append([f"{law}, calibrated", *row_cells(found["rows"][law])])
            deviations = found["rows"][law]["standard_deviation"]
            rows.append(
                ["standard deviation"] + [_number(deviations[k], d) for k, d in zip(Row._fields, DIGITS, strict=True)]
            )
        start = found["window"]["start_s"]
        pulse, noise = found["pulse"], found["noise"]
        blocks += [
            Heading(f"{TITLES[case]}: scenario {found['scenario']}", 3),
            Table(
                ["", *COLUMNS],
                rows,
                f"{TITLES[case]}, calibrated: mean over {found['noise_seeds']} seeds of the noise.",
            ),
            Paragraph(
                f"Pulse {pulse['force_x_n']:.0f} N, {pulse['force_y_n']:.0f} N, {pulse['moment_nm']:.0f} N m; noise of "
                f"{noise['position_std_m']:.3f} m, {noise['yaw_std_rad']:.3f} rad, {noise['velocity_std_mps']:.3f} m/s "
                f"and {noise['yaw_rate_std_rad_s']:.3f} rad/s (standard deviations); RMSE from "
                f"{'arrival' if start is None else f'{start:.1f} s'} to {found['window']['end_s']:.1f} s. Root mean "
                f"square of the relative differences of all ten numbers: {found['rms_residual_percent']:.1f} %."
            ),
            *_pictures(f"{case}_calibrated", f"{TITLES[case]}, calibrated"),
        ]
    return blocks


def _lyapunov_blocks(found: Mapping[str, Any]) -> list[Block]:
    names = [name for name in found if name != "epsilon"]
    lines: list[tuple[str, str, Callable[[float], str]]] = [
        ("V at the start [J]", "initial_j", lambda v: f"{v:.1f}"),
        ("V at the end [J]", "final_j", lambda v: f"{v:.3g}"),
        ("largest rise of V within a sample [J]", "largest_rise_in_a_sample_j", lambda v: f"{v:.3g}"),
        ("largest imbalance of V and what D + K_v dissipates [% of V at the start]", "largest_imbalance_percent",
         lambda v: f"{v:.3f}"),
        ("smallest eigenvalue of D + K_v", "smallest_eigenvalue_of_damping_and_gain", lambda v: f"{v:.1f}"),
        ("largest eigenvalue of the inequality's matrix", "largest_eigenvalue_of_inequality", lambda v: f"{v:.3f}"),
        ("smallest ε for which it is negative definite", "smallest_epsilon", lambda v: f"{v:.4f}"),
    ]  # fmt: skip
    return [
        Heading("The stability claim, checked"),
        Table(
            ["", *names],
            [[label, *(form(found[name][key]) for name in names)] for label, key, form in lines],
            f"Along the nominal flights, without disturbance; the matrix for ε = {found['epsilon']:.0f}.",
        ),
        Paragraph(
            "Without disturbance V falls along both flights, and what it loses is what D + K_v dissipates, as the "
            "proof says. Where hardly anything is left of it, it can rise by the amount shown: the law acts on samples "
            "and holds its force between them, which the proof doesn't. The proof's matrix is negative definite at "
            "every velocity flown if its largest eigenvalue is below 0."
        ),
        Picture("lyapunov", "V along the nominal flights."),
    ]
