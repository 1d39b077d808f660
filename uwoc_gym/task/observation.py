"""The observation vector: groups of entries that a scenario chooses from, their units, scales and bounds, and how to
read it.

Entries are measured values divided by a scale, in the AUV's body frame, clipped to ±5 scales. The standard groups hold
all that the scripted controllers need, so that scripted and learned policies see the same thing, noise included.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.elementary import fma, sincos
from uwoc_gym.compute.records import rows
from uwoc_gym.parameters import NumberSpec, Parameters, names, number

Array = npt.NDArray[np.float64]

LIMIT = 5.0
"""Bound of the scaled entries."""


FIX_AGE_S = 4.0
"""Scale of the age of a fix [s]."""


class Entry(NamedTuple):
    """One entry of the observation vector."""

    name: str
    unit: str
    low: float
    high: float
    scale: str | float = 1.0
    """The value in its unit that stands as 1: a number, or the name of one in `ObservationSettings`."""


_POSITION, _VELOCITY, _YAW_RATE = "position_scale_m", "velocity_scale_mps", "yaw_rate_scale_rad_s"
_ACCELERATION, _YAW_ACCELERATION = "acceleration_scale_mps2", "yaw_acceleration_scale_rad_s2"

GROUPS: dict[str, tuple[Entry, ...]] = {
    "ship": (
        Entry("ship position ahead", "m", -LIMIT, LIMIT, _POSITION),
        Entry("ship position to starboard", "m", -LIMIT, LIMIT, _POSITION),
        Entry("cosine of ship heading relative to AUV", "1", -1.0, 1.0),
        Entry("sine of ship heading relative to AUV", "1", -1.0, 1.0),
        Entry("ship velocity relative to AUV, ahead", "m/s", -LIMIT, LIMIT, _VELOCITY),
        Entry("ship velocity relative to AUV, to starboard", "m/s", -LIMIT, LIMIT, _VELOCITY),
        Entry("ship yaw rate relative to AUV", "rad/s", -LIMIT, LIMIT, _YAW_RATE),
    ),
    "velocity": (
        Entry("surge velocity", "m/s", -LIMIT, LIMIT, _VELOCITY),
        Entry("sway velocity", "m/s", -LIMIT, LIMIT, _VELOCITY),
        Entry("yaw rate", "rad/s", -LIMIT, LIMIT, _YAW_RATE),
    ),
    "ship-acceleration": (
        Entry("ship acceleration ahead", "m/s^2", -LIMIT, LIMIT, _ACCELERATION),
        Entry("ship acceleration to starboard", "m/s^2", -LIMIT, LIMIT, _ACCELERATION),
        Entry("ship yaw acceleration", "rad/s^2", -LIMIT, LIMIT, _YAW_ACCELERATION),
    ),
    "heading": (
        Entry("cosine of own heading", "1", -1.0, 1.0),
        Entry("sine of own heading", "1", -1.0, 1.0),
    ),
    "last-action": (
        Entry("last action, surge", "1", -1.0, 1.0),
        Entry("last action, sway", "1", -1.0, 1.0),
        Entry("last action, yaw", "1", -1.0, 1.0),
    ),
    "link": (
        Entry("bit rate, log scale from threshold to on-axis", "1", 0.0, 1.0),
        Entry("inside the cone", "1", 0.0, 1.0),
    ),
    "time": (Entry("share of the episode gone", "1", 0.0, 1.0),),
    "fix": (
        Entry("last fix: ship position ahead at its ping", "m", -LIMIT, LIMIT, _POSITION),
        Entry("last fix: ship position to starboard at its ping", "m", -LIMIT, LIMIT, _POSITION),
        Entry("last fix: cosine of ship heading relative to AUV at its ping", "1", -1.0, 1.0),
        Entry("last fix: sine of ship heading relative to AUV at its ping", "1", -1.0, 1.0),
        Entry("time since the ping of the last fix", "s", 0.0, LIMIT, FIX_AGE_S),
        Entry("last fix arrived with this observation", "1", 0.0, 1.0),
    ),
}
"""What can be observed: the entries of each group."""

STANDARD = ("ship", "velocity", "ship-acceleration", "heading", "last-action", "link")
"""The groups of the registered environments."""


def row_name(group: str) -> str:
    """The name of a group's rows in a block's record."""
    return group.replace("-", "_")


OBSERVED = rows(**{row_name(name): (len(entries),) for name, entries in GROUPS.items()})


@dataclass(frozen=True, kw_only=True)
class ObservationSettings(Parameters):
    """What is observed, and the scales: an entry is the physical value divided by its scale."""

    groups: tuple[str, ...] = names(
        STANDARD, tuple(GROUPS), "groups of entries that are observed, in their order", since="0.2.0"
    )
    position_scale_m: float = number(4.0, "m", "scale of relative position", low=0.001, high=1e6, randomisable=False)
    velocity_scale_mps: float = number(1.0, "m/s", "scale of velocities", low=0.001, high=1000.0, randomisable=False)
    yaw_rate_scale_rad_s: float = number(1.0, "rad/s", "scale of yaw rates", low=0.001, high=1000.0, randomisable=False)
    acceleration_scale_mps2: float = number(
        0.5, "m/s^2", "scale of the ship's acceleration", low=0.001, high=1000.0, randomisable=False
    )
    yaw_acceleration_scale_rad_s2: float = number(
        0.5, "rad/s^2", "scale of the ship's yaw acceleration", low=0.001, high=1000.0, randomisable=False
    )

    @cached_property
    def entries(self) -> tuple[Entry, ...]:
        """The entries of the observation vector, in their order."""
        return tuple(entry for name in self.groups for entry in GROUPS[name])

    @property
    def size(self) -> int:
        """Length of the observation vector."""
        return len(self.entries)

    @property
    def scales(self) -> dict[str, float]:
        """The scales by name."""
        return {name: self.value(name) for name, spec in self.specs().items() if isinstance(spec, NumberSpec)}

    @cached_property
    def entry_scales(self) -> Array:
        """The scale of each entry in SI units, shape (size,); not to be written to."""
        own = self.scales
        found = np.array([own[entry.scale] if isinstance(entry.scale, str) else entry.scale for entry in self.entries])
        found.flags.writeable = False
        return found

    def place(self, entry: str) -> int | None:
        """Where the entry of that name stands in the observation vector; None if it isn't observed."""
        own = [each.name for each in self.entries]
        return own.index(entry) if entry in own else None

    @property
    def fixes(self) -> bool:
        """Whether the ship is known by fixes."""
        return "fix" in self.groups

    def derived(self) -> dict[str, float]:
        """What entries are multiplied with, and whether the time and fixes are observed."""
        return {
            "time": "time" in self.groups,
            "fix": self.fixes,
            "per_position": 1.0 / self.position_scale_m,
            "per_velocity": 1.0 / self.velocity_scale_mps,
            "per_yaw_rate": 1.0 / self.yaw_rate_scale_rad_s,
            "per_acceleration": 1.0 / self.acceleration_scale_mps2,
            "per_yaw_acceleration": 1.0 / self.yaw_acceleration_scale_rad_s2,
        }


class Measured(NamedTuple):
    """What an observation says, in SI units; the leading axes are those of the observation.

    Of groups that the scenario leaves out, entries are None.
    """

    relative_position: Array | None = None
    """Ship's position relative to the AUV in the AUV's body frame, (..., 2) [m]."""
    yaw_error: Array | None = None
    """Ship's heading minus the AUV's, in (-π, π], (...) [rad]."""
    relative_velocity: Array | None = None
    """Ship's velocity minus the AUV's in the AUV's body frame, and of yaw, (..., 3) [m/s, m/s, rad/s]."""
    velocity: Array | None = None
    """The AUV's surge, sway and yaw rate, (..., 3) [m/s, m/s, rad/s]."""
    ship_acceleration: Array | None = None
    """The ship's acceleration in the AUV's body frame, and of yaw, (..., 3) [m/s², m/s², rad/s²]."""
    heading: Array | None = None
    """Cosine and sine of the AUV's yaw, (..., 2)."""
    last_action: Array | None = None
    """The action applied in the last step, along surge, along sway and about yaw, (..., 3)."""
    link_level: Array | None = None
    """Bit rate on a log scale, 0 at the cone's threshold or below, 1 on the axis, (...)."""
    in_cone: Array | None = None
    """1 inside the cone, else 0, (...)."""
    elapsed: Array | None = None
    """Share of the episode gone, (...)."""
    fix_position: Array | None = None
    """Ship's position in the AUV's body frame at the ping of the last fix, (..., 2) [m]."""
    fix_yaw_error: Array | None = None
    """Ship's heading minus the AUV's at that ping, in (-π, π], (...) [rad]."""
    fix_age_s: Array | None = None
    """Time since that ping, (...) [s]."""
    fix_is_new: Array | None = None
    """1 where the fix arrived with this observation, else 0, (...)."""
    water_velocity: Array | None = None
    """Velocity of the water in the AUV's body frame, (..., 2) [m/s]: never observed, but a filter may believe in it."""
    others: Mapping[str, Array] = MappingProxyType({})
    """The entries of further groups in SI units, by the group's name, (..., entries)."""


_READ: dict[str, Callable[[Array], dict[str, Array]]] = {
    "ship": lambda x: {
        "relative_position": x[..., 0:2],
        "yaw_error": np.arctan2(x[..., 3], x[..., 2]),
        "relative_velocity": x[..., 4:7],
    },
    "velocity": lambda x: {"velocity": x},
    "ship-acceleration": lambda x: {"ship_acceleration": x},
    "heading": lambda x: {"heading": x},
    "last-action": lambda x: {"last_action": x},
    "link": lambda x: {"link_level": x[..., 0], "in_cone": x[..., 1]},
    "time": lambda x: {"elapsed": x[..., 0]},
    "fix": lambda x: {
        "fix_position": x[..., 0:2],
        "fix_yaw_error": np.arctan2(x[..., 3], x[..., 2]),
        "fix_age_s": x[..., 4],
        "fix_is_new": x[..., 5],
    },
}
"""How a group's entries, in SI units, are read; those of groups that aren't here stand in `Measured.others`."""


def unpack(observation: npt.ArrayLike, settings: ObservationSettings | None = None) -> Measured:
    """Read an observation.

    Args:
        observation: One observation or an array of them, shape (..., size).
        settings: The groups and scales that made it, by default those of the registered environments, of size 20.

    Raises:
        ValueError: The last axis has another size.
    """
    own = settings or ObservationSettings()
    obs = np.asarray(observation, dtype=np.float64)
    if obs.ndim == 0 or obs.shape[-1] != own.size:
        raise ValueError(f"observation has shape {obs.shape}; its last axis must be {own.size} long.")
    si = obs * own.entry_scales
    found: dict[str, Any] = {}
    others: dict[str, Array] = {}
    first = 0
    for name in own.groups:
        last = first + len(GROUPS[name])
        entries = si[..., first:last]
        if name in _READ:
            found |= _READ[name](entries)
        else:
            others[name] = entries
        first = last
    return Measured(**found, others=others)


@inlined
def _limited(value: float) -> float:
    return min(max(value, -LIMIT), LIMIT)


@inlined
def _within_one(value: float) -> float:
    return min(max(value, -1.0), 1.0)


@inlined
def observe(b, j, world) -> None:
    """What the sensors say, scaled and clipped: the entries of all standard groups, in their order."""
    scale = world.observation
    noise, ship, o = b.sensors, b.ship, b.observed
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
    o.ship[0, j] = _limited(p * fma(cosine, dx, sine * dy))
    o.ship[1, j] = _limited(p * fma(cosine, dy, -(sine * dx)))
    o.ship[2, j] = _within_one(fma(ship_cos, cosine, ship_sin * sine))
    o.ship[3, j] = _within_one(fma(ship_sin, cosine, -(ship_cos * sine)))
    o.ship[4, j] = _limited(v * (fma(cosine, vx, sine * vy) - surge))
    o.ship[5, j] = _limited(v * (fma(cosine, vy, -(sine * vx)) - sway))
    o.ship[6, j] = _limited(w * (ship.yaw_rate[j] - rate))
    o.velocity[0, j] = _limited(v * surge)
    o.velocity[1, j] = _limited(v * sway)
    o.velocity[2, j] = _limited(w * rate)
    o.ship_acceleration[0, j] = _limited(a * fma(cosine, ax, sine * ay))
    o.ship_acceleration[1, j] = _limited(a * fma(cosine, ay, -(sine * ax)))
    o.ship_acceleration[2, j] = _limited(c * ship.yaw_acceleration[j])
    o.heading[0, j] = _within_one(cosine)
    o.heading[1, j] = _within_one(sine)
    o.last_action[0, j] = b.action.surge[j]
    o.last_action[1, j] = b.action.sway[j]
    o.last_action[2, j] = b.action.yaw[j]
    o.link[0, j] = b.link.level[j]
    o.link[1, j] = b.measure.in_cone[j]


@inlined
def observe_time(b, j, world) -> None:
    """How much of the episode is gone."""
    b.observed.time[0, j] = b.clock.step[j] / world.episode.max_steps


@inlined
def observe_fix(b, j, world) -> None:
    """The last fix as it was at its ping, and its age."""
    p = world.observation.per_position
    fix, o = b.fix, b.observed
    o.fix[0, j] = _limited(p * fix.ahead[j])
    o.fix[1, j] = _limited(p * fix.starboard[j])
    sine, cosine = sincos(fix.yaw[j])
    o.fix[2, j] = _within_one(cosine)
    o.fix[3, j] = _within_one(sine)
    o.fix[4, j] = _limited((b.clock.time_s[j] - fix.ping_s[j]) / FIX_AGE_S)
    o.fix[5, j] = 1.0 if fix.arrived[j] == b.clock.step[j] else 0.0
