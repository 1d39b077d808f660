"""Policies on the same episode as one page that opens offline."""

from __future__ import annotations

import importlib.resources
import json
import math
from typing import Any

import numpy as np

from uwoc_gym.agents.flight import Flight
from uwoc_gym.agents.policies.looks import DASHES, Look, looks
from uwoc_gym.agents.reports.tables import MEASURES
from uwoc_gym.agents.viewing.episode import Episode
from uwoc_gym.env import TrackingEnv
from uwoc_gym.world.optics.link import Cone
from uwoc_gym.world.sea.pulses import drawn_pulses

_PERIOD_S = 0.1
"""Time between the samples that the page holds, or the control period where that is longer [s]."""


def page_data(wanted: Episode, flights: dict[str, Flight], start_s: float = 0.0) -> dict[str, Any]:
    """What the page shows, as plain data: the flights sampled and rounded.

    Args:
        wanted: Who flies what.
        flights: The flight of each policy, of one episode.
        start_s: Moment that the page opens at [s].
    """
    scenario = wanted.scenario
    period = scenario.episode.control_period_s
    stride = max(1, round(_PERIOD_S / period))
    longest = max((flight.series for flight in flights.values()), key=lambda series: series.time_s.size)
    env = TrackingEnv(scenario=scenario)
    env.reset(seed=wanted.seed)
    parameters = env.parameters()
    half_angle = parameters["link.field_of_view_rad"]
    cone = Cone(half_angle, longest.slant_height_m)
    rows = [flight.metrics.rows()[0] for flight in flights.values()]
    threshold = scenario.link.threshold_bit_rate_bps
    return {
        "title": f"{wanted.scenario_name}, seed {wanted.seed}",
        "subtitle": f"{' and '.join(flights)} keep an optical link to a ship, AUVs {longest.depth_m:.2f} m deep",
        "period_s": stride * period,
        "start_s": start_s,
        "depth_m": _rounded(longest.depth_m, 3),
        "slant_height_m": _rounded(longest.slant_height_m, 3),
        "radius_m": _rounded(cone.footprint_radius_m(longest.depth_m), 3),
        "field_of_view_deg": _rounded(math.degrees(half_angle), 2),
        "threshold": _rounded(math.log10(threshold), 3),
        "pulses": [pulse._asdict() for pulse in drawn_pulses(parameters)],
        "ship": _path(longest.ship_pose[::stride]),
        "policies": [
            _policy(name, flight, stride, look)
            for (name, flight), look in zip(flights.items(), looks(flights).values(), strict=True)
        ],
        "outcome": [
            [measure.heading, *(measure.text(row[measure.key]) for row in rows)]
            for measure in MEASURES
            if measure.key != "lost"
        ]
        + [["end", *("link lost" if row["lost"] else "in time" for row in rows)]],
    }


def page(data: dict[str, Any], plotly_js: str) -> str:
    """The page as one HTML text that needs nothing else."""
    template = importlib.resources.files("uwoc_gym.agents.viewing").joinpath("replay.html").read_text(encoding="utf-8")
    # Inside a script nothing may look like its end, and names of policies come from outside.
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    head, rest = template.split("@@PLOTLY@@")
    middle, tail = rest.split("@@DATA@@")
    return head + plotly_js.replace("</script", "<\\/script") + middle + text + tail


def _path(pose: Any) -> dict[str, list[float]]:
    yaw = np.unwrap(pose[:, 2])
    return {"x": _rounded(pose[:, 0], 3), "y": _rounded(pose[:, 1], 3), "yaw": _rounded(yaw, 3)}


def _policy(name: str, flight: Flight, stride: int, look: Look) -> dict[str, Any]:
    series = flight.series
    inside = flight.record.in_cone[: series.time_s.size, 0]
    rate = series.bit_rate_bps
    sent = np.concatenate([[0.0], np.cumsum(np.where(inside, rate, 0.0)[1:] * np.diff(series.time_s))]) * 1e-9
    # Without light there is no logarithm; the chart has a gap there.
    log_rate = [round(math.log10(value), 3) if value > 0.0 else None for value in rate[::stride].tolist()]
    return {
        "name": name,
        "colour": look.colour,
        "dash": look.dash,
        "stroke": " ".join(f"{length:g}" for length in DASHES[look.dash]),
        **_path(series.pose[::stride]),
        "in_cone": inside[::stride].astype(int).tolist(),
        "log_rate": log_rate,
        "range_m": _rounded(series.range_m[::stride], 3),
        "pointing_deg": _rounded(np.degrees(series.pointing_error_rad[::stride]), 2),
        "delivered_gbit": _rounded(sent[::stride], 2),
    }


def _rounded(values: Any, digits: int) -> Any:
    return np.round(values, digits).tolist()
