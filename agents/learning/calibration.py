"""Searches for what the paper doesn't give, so that its tables come out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.flight import Flight, fly
from uwoc_gym.agents.learning.search import Dimension, Evaluate, Tried
from uwoc_gym.agents.reports.files import json_text
from uwoc_gym.baselines import Gains, gains
from uwoc_gym.baselines.controllers import one_for_each
from uwoc_gym.baselines.paper import PUBLISHED, SCENARIOS, Row, sampled_as_published, without_coriolis
from uwoc_gym.metrics import since_arrival, tracking_error
from uwoc_gym.scenario import Scenario

Array = npt.NDArray[np.float64]

CASE_DURATION_S = 60.0
"""The cases are searched over their first minute: what comes later repeats what the windows have seen."""

WINDOW_STARTS_S = (math.nan, 26.0, 28.0, 29.0, 30.0)
"""Where an RMSE's window may begin [s]; not a number stands for the arrival."""

WINDOW_ENDS_S = tuple(np.arange(31.0, CASE_DURATION_S + 0.25, 0.5).tolist())
"""Where it may end [s]."""

NOISE_SEEDS = (0, 1)
"""Seeds of the noise that every setting is tried with."""

_NLPD_BOX = {
    **{f"mu_{kind}_{axis}": Dimension(0.0, 1.0) for kind in "pv" for axis in ("x", "y", "yaw")},
    "b": Dimension(0.001, 2.0, log=True),
}
_CASE_BOX = {
    "sea.pulses[0].force_x_n": Dimension(0.0, 3000.0),
    "sea.pulses[0].force_y_n": Dimension(0.0, 3000.0),
    "sea.pulses[0].moment_nm": Dimension(0.0, 1500.0),
    "sensors.position_std_m": Dimension(0.0, 1.0),
    "sensors.yaw_std_rad": Dimension(0.0, 1.0),
    "sensors.velocity_std_mps": Dimension(0.0, 1.0),
    "sensors.yaw_rate_std_rad_s": Dimension(0.0, 1.0),
}


class Problem(NamedTuple):
    """What is searched for, and what is made of it."""

    box: Mapping[str, Dimension]
    evaluate: Evaluate
    trials: int
    write: Callable[[Tried], Mapping[str, Any]]
    """What the best point means, for results.json."""
    file: str
    text: Callable[[Tried], str]
    """A file to use the best point with, and what it holds."""
    scenarios: Mapping[str, Scenario]
    """What is flown."""


def nlpd_gains(values: Mapping[str, float]) -> Gains:
    """The NLPD with the paper's a = 300 and 250 and exponents from a point of the search."""

    def axes(kind: str) -> tuple[float, float, float]:
        x, y, yaw = (values[f"mu_{kind}_{axis}"] for axis in ("x", "y", "yaw"))
        return x, y, yaw

    b = (values["b"],) * 3
    return replace(gains("pd"), mu_p=axes("p"), mu_v=axes("v"), b_p=b, b_v=b, source="uwoc-gym calibrate nlpd")


def nlpd_problem() -> Problem:
    """Exponents and b with which the printed NLPD flies the paper's nominal row.

    The score is the mean square of each number's distance from the published one, in units of 2 % for the RMSE and
    0.01 s for the arrival.
    """
    scenario = sampled_as_published(Scenario.named(SCENARIOS["nominal"]))
    wanted = np.array(PUBLISHED["nominal", "NLPD"][:4])
    unit = np.array([*(0.02 * wanted[:3]), 0.01])

    def evaluate(points: list[dict[str, float]]) -> list[tuple[float, dict[str, float]]]:
        laws = [nlpd_gains(point) for point in points]
        flown = fly(one_for_each(laws), scenario, [0] * len(points)).metrics
        got = np.stack([flown.rmse_x_m, flown.rmse_y_m, flown.rmse_yaw_rad, flown.arrival_time_s], axis=-1)
        # Never to arrive is worse than anything else.
        scores = np.nan_to_num(np.mean(np.square((got - wanted) / unit), axis=-1), nan=1e9)
        names = ("rmse_x_m", "rmse_y_m", "rmse_yaw_rad", "arrival_time_s")
        return [
            (score, dict(zip(names, np.nan_to_num(row, nan=-1.0).tolist(), strict=True)))
            for score, row in zip(scores.tolist(), got, strict=True)
        ]

    return Problem(
        _NLPD_BOX,
        evaluate,
        4000,
        lambda best: {"published": PUBLISHED["nominal", "NLPD"]._asdict(), "flown": best.outcome},
        "gains.json",
        lambda best: json_text(asdict(nlpd_gains(best.values))),
        {SCENARIOS["nominal"]: scenario},
    )


def case_problem(case: str, variant: str) -> Problem:
    """Pulse, noise levels and RMSE window with which PD and NLPD come nearest to a case's two rows.

    One setting serves both controllers, of which the NLPD is the printed one on the full plant. The score is the mean
    over both rows of the squared relative differences of RMSE and arrival, and of the restoring time's difference over
    PD's.
    """
    ranges = {
        "sea": {
            "pulses": [
                {name.split(".")[-1]: (each.low, each.high) for name, each in _CASE_BOX.items() if "pulses" in name}
            ]
        },
        "sensors": {
            name.split(".")[-1]: (each.low, each.high) for name, each in _CASE_BOX.items() if "sensors" in name
        },
        "episode": {"duration_s": CASE_DURATION_S},
    }
    full = sampled_as_published(Scenario.named(SCENARIOS[case]).merged(ranges))
    pd_side = (gains("pd"), full) if variant == "printed" else (gains("pd-plain"), without_coriolis(full))
    sides = (pd_side, (gains("nlpd"), full))
    wanted = np.array([PUBLISHED[case, name] for name in ("PD", "NLPD")])

    def evaluate(points: list[dict[str, float]]) -> list[tuple[float, dict[str, float]]]:
        n, k = len(points), len(NOISE_SEEDS)
        settings = {name: np.repeat([point[name] for point in points], k) for name in _CASE_BOX}
        rows = [
            window_rows(fly(one_for_each([law] * n * k), scenario, list(NOISE_SEEDS) * n, settings)).reshape(
                -1, n, k, 5
            )
            for law, scenario in sides
        ]
        return [case_score(row, wanted) for row in np.moveaxis(np.stack(rows, axis=1), 2, 0)]

    def scenario_text(best: Tried) -> str:
        found = {
            "sea": {"pulses": [{key.split(".")[-1]: each for key, each in best.values.items() if "pulses" in key}]},
            "sensors": {key.split(".")[-1]: each for key, each in best.values.items() if "sensors" in key},
        }
        return full.merged(found).to_json() + "\n"

    return Problem(
        _CASE_BOX,
        evaluate,
        1500,
        lambda best: {
            "published": {name: PUBLISHED[case, name]._asdict() for name in ("PD", "NLPD")},
            "flown": best.outcome,
        },
        "scenario.json",
        scenario_text,
        {SCENARIOS[case]: full, f"{SCENARIOS[case]}, PD's plant": pd_side[1]},
    )


WINDOWS = tuple((start, end) for start in WINDOW_STARTS_S for end in WINDOW_ENDS_S)
"""All windows [s] that an RMSE may be taken over."""


def window_rows(flight: Flight) -> Array:
    """The table's five numbers of each simulation for each of `WINDOWS`, shape (W, N, 5), in the order of `Row`."""
    record = flight.record
    time = record.time_s
    error = tracking_error(record.pose, record.ship_pose)
    arrived = since_arrival(record.in_cone, record.valid)
    rows = np.empty((len(WINDOWS), error.shape[1], 5))
    rows[..., 3] = flight.metrics.arrival_time_s
    rows[..., 4] = flight.metrics.restoring_time_s
    # Running sums: a window is a difference of two of them, where `metrics.rmse` would sum each of hundreds anew.
    counted = arrived & record.valid
    squares = np.cumsum(np.where(counted[..., None], np.square(error), 0.0), axis=0)
    number = np.cumsum(counted, axis=0)
    for w, (start, end) in enumerate(WINDOWS):
        last = int(np.searchsorted(time, end + 1e-9)) - 1
        first = -1 if math.isnan(start) else int(np.searchsorted(time, start - 1e-9)) - 1
        total = squares[last] - (squares[first] if first >= 0 else 0.0)
        samples = number[last] - (number[first] if first >= 0 else 0)
        rows[w, :, :3] = np.sqrt(np.where(samples > 0, total.T / np.maximum(samples, 1), np.nan)).T
    return rows


def case_score(rows: Array, wanted: Array) -> tuple[float, dict[str, float]]:
    """Score and outcome of one setting in its best window.

    Args:
        rows: Numbers by window, controller and noise seed, shape (W, 2, K, 5).
        wanted: The published rows, shape (2, 5).
    """
    # A link that isn't restored within the flight counts as a minute's outage; one that never was, as lost.
    filled = np.where(np.isinf(rows), CASE_DURATION_S, np.nan_to_num(rows, nan=1e3, posinf=np.inf))
    mean = filled.mean(axis=2)
    scale = wanted.copy()
    scale[:, 4] = wanted[0, 4]
    scores = np.square((mean - wanted) / scale).mean(axis=(1, 2))
    best = int(scores.argmin())
    start, end = WINDOWS[best]
    outcome = {"window_start_s": -1.0 if math.isnan(start) else start, "window_end_s": end}
    for name, row in zip(("pd", "nlpd"), mean[best], strict=True):
        outcome |= {f"{name}_{key}": value for key, value in zip(Row._fields, row.tolist(), strict=True)}
    return float(scores[best]), outcome
