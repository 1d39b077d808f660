"""The observation vector: names, units, scales and bounds of its entries, and how to read it.

Entries are measured values divided by a scale, in the AUV's body frame, clipped to ±5 scales. They hold all that the
scripted controllers need, so that scripted and learned policies see the same thing, noise included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

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
