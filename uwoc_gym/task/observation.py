"""The observation vector: names, units, scales and bounds of its entries, and how to read it.

Entries are measured values divided by a scale, in the AUV's body frame, clipped to ±5 scales. They hold all that the
scripted controllers need, so that scripted and learned policies see the same thing, noise included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.elementary import fma
from uwoc_gym.compute.records import rows
from uwoc_gym.parameters import Parameters, number

Array = npt.NDArray[np.float64]

LIMIT = 5.0
"""Bound of the scaled entries."""


@dataclass(frozen=True, kw_only=True)
class ObservationSettings(Parameters):
    """Scales of the observation's entries: an entry is the physical value divided by its scale."""

    position_scale_m: float = number(4.0, "m", "scale of relative position", positive=True, randomisable=False)
    velocity_scale_mps: float = number(1.0, "m/s", "scale of velocities", positive=True, randomisable=False)
    yaw_rate_scale_rad_s: float = number(1.0, "rad/s", "scale of yaw rates", positive=True, randomisable=False)
    acceleration_scale_mps2: float = number(
        0.5, "m/s^2", "scale of the ship's acceleration", positive=True, randomisable=False
    )
    yaw_acceleration_scale_rad_s2: float = number(
        0.5, "rad/s^2", "scale of the ship's yaw acceleration", positive=True, randomisable=False
    )

    def derived(self) -> dict[str, float]:
        """What entries are multiplied with."""
        return {
            "per_position": 1.0 / self.position_scale_m,
            "per_velocity": 1.0 / self.velocity_scale_mps,
            "per_yaw_rate": 1.0 / self.yaw_rate_scale_rad_s,
            "per_acceleration": 1.0 / self.acceleration_scale_mps2,
            "per_yaw_acceleration": 1.0 / self.yaw_acceleration_scale_rad_s2,
        }


class Entry(NamedTuple):
    """One entry of the observation vector."""

    name: str
    unit: str
    low: float
    high: float
    scale: str
    """Name of the scale in `ObservationSettings`, or empty for entries without one."""


_POSITION, _VELOCITY, _YAW_RATE = "position_scale_m", "velocity_scale_mps", "yaw_rate_scale_rad_s"
_ACCELERATION, _YAW_ACCELERATION = "acceleration_scale_mps2", "yaw_acceleration_scale_rad_s2"

ENTRIES: tuple[Entry, ...] = (
    Entry("ship position ahead", "m", -LIMIT, LIMIT, _POSITION),
    Entry("ship position to starboard", "m", -LIMIT, LIMIT, _POSITION),
    Entry("cosine of ship heading relative to AUV", "1", -1.0, 1.0, ""),
    Entry("sine of ship heading relative to AUV", "1", -1.0, 1.0, ""),
    Entry("ship velocity relative to AUV, ahead", "m/s", -LIMIT, LIMIT, _VELOCITY),
    Entry("ship velocity relative to AUV, to starboard", "m/s", -LIMIT, LIMIT, _VELOCITY),
    Entry("ship yaw rate relative to AUV", "rad/s", -LIMIT, LIMIT, _YAW_RATE),
    Entry("surge velocity", "m/s", -LIMIT, LIMIT, _VELOCITY),
    Entry("sway velocity", "m/s", -LIMIT, LIMIT, _VELOCITY),
    Entry("yaw rate", "rad/s", -LIMIT, LIMIT, _YAW_RATE),
    Entry("ship acceleration ahead", "m/s^2", -LIMIT, LIMIT, _ACCELERATION),
    Entry("ship acceleration to starboard", "m/s^2", -LIMIT, LIMIT, _ACCELERATION),
    Entry("ship yaw acceleration", "rad/s^2", -LIMIT, LIMIT, _YAW_ACCELERATION),
    Entry("cosine of own heading", "1", -1.0, 1.0, ""),
    Entry("sine of own heading", "1", -1.0, 1.0, ""),
    Entry("last action, surge", "1", -1.0, 1.0, ""),
    Entry("last action, sway", "1", -1.0, 1.0, ""),
    Entry("last action, yaw", "1", -1.0, 1.0, ""),
    Entry("bit rate, log scale from threshold to on-axis", "1", 0.0, 1.0, ""),
    Entry("inside the cone", "1", 0.0, 1.0, ""),
)
SIZE = len(ENTRIES)
"""Length of the observation vector."""

OBSERVED = rows(tracking=(SIZE,))

(
    SHIP_AHEAD, SHIP_STARBOARD, SHIP_HEADING_COS, SHIP_HEADING_SIN,
    RELATIVE_AHEAD, RELATIVE_STARBOARD, RELATIVE_YAW_RATE,
    OWN_SURGE, OWN_SWAY, OWN_YAW_RATE,
    SHIP_ACCELERATION_AHEAD, SHIP_ACCELERATION_STARBOARD, SHIP_ACCELERATION_YAW,
    OWN_HEADING_COS, OWN_HEADING_SIN,
    LAST_SURGE, LAST_SWAY, LAST_YAW, LINK_LEVEL, LINK_IN_CONE,
) = range(SIZE)  # fmt: skip


def scales(settings: ObservationSettings) -> Array:
    """The scale of each entry in SI units, shape (20,); 1 for entries without one."""
    return np.array([getattr(settings, entry.scale) if entry.scale else 1.0 for entry in ENTRIES])


class Measured(NamedTuple):
    """What an observation says, in SI units; the leading axes are those of the observation."""

    relative_position: Array
    """Ship's position relative to the AUV in the AUV's body frame, (..., 2) [m]."""
    yaw_error: Array
    """Ship's heading minus the AUV's, in (-π, π], (...) [rad]."""
    relative_velocity: Array
    """Ship's velocity minus the AUV's in the AUV's body frame, and of yaw, (..., 3) [m/s, m/s, rad/s]."""
    velocity: Array
    """The AUV's surge, sway and yaw rate, (..., 3) [m/s, m/s, rad/s]."""
    ship_acceleration: Array
    """The ship's acceleration in the AUV's body frame, and of yaw, (..., 3) [m/s², m/s², rad/s²]."""
    heading: Array
    """Cosine and sine of the AUV's yaw, (..., 2)."""
    last_action: Array
    """The action applied in the last step, (..., 3)."""
    link_level: Array
    """Bit rate on a log scale, 0 at the cone's threshold or below, 1 on the axis, (...)."""
    in_cone: Array
    """1 inside the cone, else 0, (...)."""


def unpack(observation: npt.ArrayLike, settings: ObservationSettings | None = None) -> Measured:
    """Read an observation of shape (..., 20).

    Args:
        observation: One observation or an array of them.
        settings: The scales that made it, by default those of the registered environments.

    Raises:
        ValueError: The last axis isn't 20 long.
    """
    obs = np.asarray(observation, dtype=np.float64)
    if obs.ndim == 0 or obs.shape[-1] != SIZE:
        raise ValueError(f"observation has shape {obs.shape}; its last axis must be {SIZE} long.")
    si = obs * scales(settings or ObservationSettings())
    return Measured(
        relative_position=si[..., SHIP_AHEAD : SHIP_STARBOARD + 1],
        yaw_error=np.arctan2(si[..., SHIP_HEADING_SIN], si[..., SHIP_HEADING_COS]),
        relative_velocity=si[..., RELATIVE_AHEAD : RELATIVE_YAW_RATE + 1],
        velocity=si[..., OWN_SURGE : OWN_YAW_RATE + 1],
        ship_acceleration=si[..., SHIP_ACCELERATION_AHEAD : SHIP_ACCELERATION_YAW + 1],
        heading=si[..., OWN_HEADING_COS : OWN_HEADING_SIN + 1],
        last_action=si[..., LAST_SURGE : LAST_YAW + 1],
        link_level=si[..., LINK_LEVEL],
        in_cone=si[..., LINK_IN_CONE],
    )


@inlined
def _limited(value: float) -> float:
    return min(max(value, -LIMIT), LIMIT)


@inlined
def _within_one(value: float) -> float:
    return min(max(value, -1.0), 1.0)


@inlined
def observe(b, j, world) -> None:
    """What the sensors say, scaled and clipped."""
    scale = world.observation
    noise, ship, o = b.sensors, b.ship, b.observed.tracking
    p, v, w = scale.per_position, scale.per_velocity, scale.per_yaw_rate
    a, c = scale.per_acceleration, scale.per_yaw_acceleration
    cosine = noise.cos[j]
    sine = noise.sin[j]
    dx = ship.x[j] - b.auv.x[j] - noise.error_x[j]
    dy = ship.y[j] - b.auv.y[j] - noise.error_y[j]
    surge = b.auv.surge[j] + noise.error_surge[j]
    sway = b.auv.sway[j] + noise.error_sway[j]
    rate = b.auv.yaw_rate[j] + noise.error_yaw_rate[j]
    vx, vy = ship.vx[j], ship.vy[j]
    ax, ay = ship.ax[j], ship.ay[j]
    ship_cos, ship_sin = ship.cos[j], ship.sin[j]
    o[SHIP_AHEAD, j] = _limited(p * fma(cosine, dx, sine * dy))
    o[SHIP_STARBOARD, j] = _limited(p * fma(cosine, dy, -(sine * dx)))
    o[SHIP_HEADING_COS, j] = _within_one(fma(ship_cos, cosine, ship_sin * sine))
    o[SHIP_HEADING_SIN, j] = _within_one(fma(ship_sin, cosine, -(ship_cos * sine)))
    o[RELATIVE_AHEAD, j] = _limited(v * (fma(cosine, vx, sine * vy) - surge))
    o[RELATIVE_STARBOARD, j] = _limited(v * (fma(cosine, vy, -(sine * vx)) - sway))
    o[RELATIVE_YAW_RATE, j] = _limited(w * (ship.yaw_rate[j] - rate))
    o[OWN_SURGE, j] = _limited(v * surge)
    o[OWN_SWAY, j] = _limited(v * sway)
    o[OWN_YAW_RATE, j] = _limited(w * rate)
    o[SHIP_ACCELERATION_AHEAD, j] = _limited(a * fma(cosine, ax, sine * ay))
    o[SHIP_ACCELERATION_STARBOARD, j] = _limited(a * fma(cosine, ay, -(sine * ax)))
    o[SHIP_ACCELERATION_YAW, j] = _limited(c * ship.yaw_acceleration[j])
    o[OWN_HEADING_COS, j] = _within_one(cosine)
    o[OWN_HEADING_SIN, j] = _within_one(sine)
    o[LAST_SURGE, j] = b.action.surge[j]
    o[LAST_SWAY, j] = b.action.sway[j]
    o[LAST_YAW, j] = b.action.yaw[j]
    o[LINK_LEVEL, j] = b.link.level[j]
    o[LINK_IN_CONE, j] = b.measure.in_cone[j]
