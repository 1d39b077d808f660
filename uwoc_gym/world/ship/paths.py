"""The ship's paths: position, velocity and acceleration as functions of time, consistent with each other.

Straight lines, circles, the paper's circle and smooth random paths are one family, a straight line plus turning
vectors ("harmonics"), so that a block of simulations on different paths still vectorises; lawn-mower and recorded
paths are computed beside it. Yaw grows from x (north) to y (east): a positive yaw rate turns to starboard.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from uwoc_gym.compute import rng
from uwoc_gym.compute.compiled import compiled, inlined
from uwoc_gym.compute.elementary import atan2, floor, fma, sincos
from uwoc_gym.compute.records import CLOCK, block_type, record_at, rows
from uwoc_gym.compute.rng import draw, key_from_seed
from uwoc_gym.given import LIMITS, as_numbers, closest, read_text, shown
from uwoc_gym.parameters import (
    ANY_ANGLE,
    FARTHEST_M,
    ChoiceSpec,
    Number,
    Parameters,
    SettingError,
    choice,
    number,
    samples,
)

Array = npt.NDArray[np.float64]

STREAM = 2.0

STATE = rows("x", "y", "yaw", "cos", "sin", "vx", "vy", "yaw_rate", "ax", "ay", "yaw_acceleration")
"""The ship's motion at the lane's time, in the earth frame [m, rad, per s, per s²]."""

HARMONICS = 3
PATH = rows(
    # A straight part, the heading, and turning vectors of given rate, phase and radii along x and y.
    "x", "y", "vx", "vy", "heading", "heading_rate", "swing", "swing_rate",
    rate=(HARMONICS,), phase=(HARMONICS,), radius_x=(HARMONICS,), radius_y=(HARMONICS,),
)  # fmt: skip
"""The path that the episode has drawn."""

SEGMENT = np.dtype([("start_s", "f8"), ("x", "f8", 4), ("y", "f8", 4), ("yaw", "f8", 4)])
"""A segment of a recorded path: coefficients of falling powers of the time since its start."""

SEGMENT_DOUBLES = SEGMENT.itemsize // 8

COURSE = (0.0, 2.0 * math.pi)

FASTEST_MPS = 100.0
"""Speed [m/s] beyond which a path isn't a ship's; fast ferries reach 30."""


def _corners(x: Number, y: Number) -> Array:
    """The corners of what two numbers may be drawn from, (n, 2)."""
    return np.stack(np.meshgrid(np.ravel(x), np.ravel(y), indexing="ij"), axis=-1).reshape(-1, 2)


class ShipMotion(NamedTuple):
    """The ship's motion in the earth frame at T times, each of shape (T, 3) for x, y, yaw [m, m, rad and per s, s²]."""

    pose: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True, kw_only=True)
class ShipPath(Parameters):
    """Base of all paths."""

    # A field, so that it is in what `dataclasses.asdict` gives, and so in the JSON of an EnvSpec.
    kind: str = field(default="", init=False, repr=False, compare=False)  # type: ignore[misc]

    def __init_subclass__(cls, kind: str) -> None:
        cls.kind = kind

    def segments(self) -> Array:
        """The splines of a recorded path, as `SEGMENT`s; none for the others."""
        return np.empty(0)

    @property
    def end_time_s(self) -> float:
        """Time [s] at which the path ends; infinite unless recorded."""
        return math.inf

    def starts(self) -> Array:
        """Places at time 0 of which one is the farthest possible from wherever one is, (n, 2) [m]; none if unknown."""
        own: Any = self
        return _corners(own.x_m, own.y_m)

    def at(self, time_s: npt.ArrayLike, seed: int = 0) -> ShipMotion:
        """Pose, velocity and acceleration at times [s] of shape (T,).

        Args:
            time_s: Times from 0 to the path's end.
            seed: Fixes what a random path draws.

        Raises:
            SettingError: A number of the path is a range, or a choice one of several.
            ValueError: A time isn't a number or lies outside the path.
        """
        given = as_numbers(time_s)
        if given is None or given.ndim > 1 or not ((given >= 0.0) & (given <= self.end_time_s)).all():
            raise ValueError(
                f"time_s = {shown(time_s)} is not allowed; it must be a number or of shape (T,), in "
                f"[0, {self.end_time_s:g}] [s]."
            )
        times = np.atleast_1d(given)
        specs = self.specs()
        for name in self.drawn():
            _ = self.option(name) if isinstance(specs[name], ChoiceSpec) else self.value(name)
        state = np.zeros(_ALONE.itemsize // 8)
        block = state.view(_ALONE)[0]
        for name, value in {**self.drawn_values(), **further_numbers(self, 0)}.items():
            block["drawn"]["ship"][name][0] = value
        block["random"]["key_0"][0], block["random"]["key_1"][0] = key_from_seed(seed)
        out = np.empty((times.size, 9))
        _trace(state, self.segments(), times, out)
        return ShipMotion(out[:, 0:3], out[:, 3:6], out[:, 6:9])


@dataclass(frozen=True, kw_only=True)
class PaperPath(ShipPath, kind="paper"):
    """The paper's ship: a circle about the origin from (0, radius), its heading swinging about x (paper, sec. 4).

    x = radius · sin(rate · t), y = radius · cos(rate · t), yaw = swing · sin(rate · t).
    """

    radius_m: Number = number(10.0, "m", "radius of the circle", low=0.0, high=1e6, source="paper, sec. 4")
    rate_rad_s: Number = number(
        0.1, "rad/s", "rate of turning and of the swing", low=-10.0, high=10.0, source="paper, sec. 4"
    )
    swing_rad: Number = number(
        math.pi / 2, "rad", "amplitude of the heading's swing", low=-6.3, high=6.3, source="paper, sec. 4"
    )

    def _check(self) -> None:
        fastest = float(np.max(self.radius_m) * np.abs(self.rate_rad_s).max())
        if fastest > FASTEST_MPS:
            raise SettingError(
                f"PaperPath.radius_m = {self.radius_m!r} is not allowed with rate_rad_s = {self.rate_rad_s!r}: the "
                f"ship would sail at {fastest:.4g} m/s; it must be at most {FASTEST_MPS:g} m/s."
            )

    def starts(self) -> Array:
        return _corners(0.0, self.radius_m)


@dataclass(frozen=True, kw_only=True)
class StraightPath(ShipPath, kind="straight"):
    """A straight line at constant speed, heading along it."""

    x_m: Number = number(0.0, "m", "x at time 0", low=-FARTHEST_M, high=FARTHEST_M)
    y_m: Number = number(0.0, "m", "y at time 0", low=-FARTHEST_M, high=FARTHEST_M)
    course_rad: Number = number(0.0, "rad", "course", low=-ANY_ANGLE, high=ANY_ANGLE)
    speed_mps: Number = number(1.0, "m/s", "speed", low=0.0, high=30.0, source="paper's ship: 1 m/s")


@dataclass(frozen=True, kw_only=True)
class CirclePath(ShipPath, kind="circle"):
    """A circle at constant speed, heading along it."""

    x_m: Number = number(0.0, "m", "x of the centre", low=-FARTHEST_M, high=FARTHEST_M)
    y_m: Number = number(0.0, "m", "y of the centre", low=-FARTHEST_M, high=FARTHEST_M)
    radius_m: Number = number(10.0, "m", "radius", low=0.1, high=1e6, source="paper's ship: 10 m")
    speed_mps: Number = number(1.0, "m/s", "speed", low=0.0, high=30.0, source="paper's ship: 1 m/s")
    start_angle_rad: Number = number(
        0.0, "rad", "direction from the centre to the ship at time 0", low=-ANY_ANGLE, high=ANY_ANGLE
    )
    turn: str = choice("starboard", ("starboard", "port"), "side to which the ship turns")

    def starts(self) -> Array:
        low, high = _corners(self.start_angle_rad, 0.0)[[0, -1], 0]
        angles = np.linspace(low, high, 361)
        ring = np.multiply.outer(np.ravel(self.radius_m), np.column_stack([np.cos(angles), np.sin(angles)]))
        found: Array = _corners(self.x_m, self.y_m)[:, None] + ring.reshape(1, -1, 2)
        return found.reshape(-1, 2)


@dataclass(frozen=True, kw_only=True)
class RandomPath(ShipPath, kind="random"):
    """A smooth random path: steady way along a course plus three turning vectors with random periods and phases.

    The turning vectors' speeds add up to ``wander`` times the mean speed, so that the ship never stops; its heading
    is that of its velocity. Periods, phases and senses are drawn anew each episode.
    """

    x_m: Number = number(0.0, "m", "x at time 0", low=-FARTHEST_M, high=FARTHEST_M)
    y_m: Number = number(0.0, "m", "y at time 0", low=-FARTHEST_M, high=FARTHEST_M)
    course_rad: Number = number(COURSE, "rad", "mean course", low=-ANY_ANGLE, high=ANY_ANGLE)
    speed_mps: Number = number(0.8, "m/s", "mean speed", low=0.001, high=30.0)
    wander: Number = number(0.6, "1", "speed of the turning vectors over the mean speed", low=0.0, high=0.9)
    shortest_period_s: Number = number(20.0, "s", "shortest period of a turning vector", low=0.1, high=1e6)
    longest_period_s: Number = number(60.0, "s", "longest period of a turning vector", low=0.1, high=1e6)

    @property
    def random(self) -> bool:
        """Always: periods, phases and senses are drawn."""
        return True


@dataclass(frozen=True, kw_only=True)
class LawnMowerPath(ShipPath, kind="lawn-mower"):
    """Parallel legs joined by half circles, first to one side, then to the other, heading along the path."""

    x_m: Number = number(0.0, "m", "x at time 0", low=-FARTHEST_M, high=FARTHEST_M)
    y_m: Number = number(0.0, "m", "y at time 0", low=-FARTHEST_M, high=FARTHEST_M)
    course_rad: Number = number(0.0, "rad", "course of the first leg", low=-ANY_ANGLE, high=ANY_ANGLE)
    leg_length_m: Number = number(20.0, "m", "length of a leg", low=0.1, high=1e6)
    spacing_m: Number = number(8.0, "m", "distance between legs", low=0.1, high=1e6)
    speed_mps: Number = number(1.0, "m/s", "speed", low=0.0, high=30.0, source="paper's ship: 1 m/s")
    turn: str = choice("starboard", ("starboard", "port"), "side of the first turn")


@dataclass(frozen=True, kw_only=True)
class RecordedPath(ShipPath, kind="recorded"):
    """A recorded path: a cubic spline with continuous acceleration through samples of position and heading.

    Velocity and acceleration are the spline's derivatives, hence consistent with the position. Without ``yaw_rad``
    the heading follows the course over ground. A ship that goes faster than 100 m/s from one sample to the next is
    refused.
    """

    time_s: tuple[float, ...] = samples("s", "increasing times from 0, four or more")
    x_m: tuple[float, ...] = samples("m", "x at these times")
    y_m: tuple[float, ...] = samples("m", "y at these times")
    yaw_rad: tuple[float, ...] | None = samples("rad", "heading at these times", optional=True)

    def _check(self) -> None:
        count = len(self.time_s)
        for name in ("x_m", "y_m", "yaw_rad"):
            values = getattr(self, name)
            if values is not None and len(values) != count:
                raise SettingError(
                    f"RecordedPath.{name} has {len(values)} samples; it must have as many as time_s, {count}."
                )
        if count < 4 or self.time_s[0] != 0.0:
            raise SettingError(
                f"RecordedPath.time_s = {shown(self.time_s)} is not allowed; it must be four or more increasing times "
                "that start at 0 [s]."
            )
        with np.errstate(over="ignore", invalid="ignore"):
            elapsed = np.diff(self.time_s)
            gone = np.hypot(np.diff(self.x_m), np.diff(self.y_m))
            late, near = elapsed > 0.0, gone <= FASTEST_MPS * elapsed
        for i in np.flatnonzero(~late)[:1]:
            raise SettingError(
                f"RecordedPath.time_s[{i + 1}] = {self.time_s[i + 1]!r} is not allowed; in row {i + 2} it must be "
                f"above that of the row before, {self.time_s[i]!r} [s]."
            )
        for i in np.flatnonzero(~near)[:1]:
            raise SettingError(
                f"RecordedPath.x_m[{i + 1}], y_m[{i + 1}] = {self.x_m[i + 1]!r}, {self.y_m[i + 1]!r} is not allowed; "
                f"in row {i + 2} it is {gone[i]:.6g} m from the row before, {elapsed[i]:.6g} s later, and its speed "
                f"must be at most {FASTEST_MPS:g} m/s."
            )

    @classmethod
    def from_csv(cls, path: str | Path) -> Self:
        """Read a CSV file with the columns time_s, x_m, y_m and, optionally, yaw_rad.

        Its rows are counted from 1 below the header, without empty lines.

        Raises:
            FileNotFoundError: There is no such file.
            SettingError: It can't be read, a column is missing, doubled or unknown, a row has more or fewer cells than
                the header, a cell isn't a finite number, or the path isn't allowed.
        """
        if not Path(path).exists():
            raise FileNotFoundError(f"there is no file {str(path)!r}")
        text = read_text(path)
        try:
            return cls.from_dict(_columns(text, list(cls.specs())))
        except (SettingError, csv.Error) as error:
            raise SettingError(f"{path}: {error}") from None

    @property
    def end_time_s(self) -> float:
        return self.time_s[-1]

    def starts(self) -> Array:
        return _corners(self.x_m[0], self.y_m[0])

    def segments(self) -> Array:
        return _splines(self.time_s, self.x_m, self.y_m, self.yaw_rad)


def _columns(text: str, known: list[str]) -> dict[str, list[float]]:
    """The numbers of a CSV text by column.

    Raises:
        SettingError: A column is unknown or doubled, or a row or cell isn't as it should be.
        csv.Error: It isn't CSV.
    """
    lines = (row for row in csv.reader(io.StringIO(text, newline="")) if row)
    names = [name.strip() for name in next(lines, [])]
    for name in names:
        if name not in known:
            raise SettingError(f"there is no column {shown(name)}; {closest(name, known)}")
        if names.count(name) > 1:
            raise SettingError(f"column {name!r} stands there {names.count(name)} times; it must be there once.")
    columns: dict[str, list[float]] = {name: [] for name in names}
    for i, row in enumerate(lines):
        if i == LIMITS["samples"].high:
            raise SettingError(f"row {i + 1} is not allowed; there must be at most {i:_} rows.")
        if len(row) != len(names):
            raise SettingError(
                f"row {i + 1} = {shown(row)} is not allowed; it must have a cell for each of the {len(names)} columns "
                f"{', '.join(names)}."
            )
        for name, cell in zip(names, row, strict=True):
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise SettingError(
                    f"column {name!r} = {shown(cell)} in row {i + 1} is not allowed; it must be a finite number."
                )
            columns[name].append(value)
    return columns if any(columns.values()) else {}


@lru_cache(maxsize=8)
def _splines(
    time_s: tuple[float, ...], x_m: tuple[float, ...], y_m: tuple[float, ...], yaw_rad: tuple[float, ...] | None
) -> Array:
    from scipy.interpolate import CubicSpline

    x = CubicSpline(time_s, x_m)
    y = CubicSpline(time_s, y_m)
    if yaw_rad is None:
        course = np.arctan2(y(time_s, 1), x(time_s, 1))
    else:
        course = np.asarray(yaw_rad)
    yaw = CubicSpline(time_s, np.unwrap(course))
    return np.column_stack([time_s[:-1], x.c.T, y.c.T, yaw.c.T]).ravel()


@dataclass(frozen=True, kw_only=True)
class CarriedOnPath(ShipPath, kind="carried-on"):
    """A motion carried on as it is at one moment: the course turns at a constant rate, and so does the heading.

    That is what can be said of a ship whose plans aren't known, from a fix, its velocity and its rate of turn.
    """

    x_m: Number = number(0.0, "m", "x at that moment", low=-FARTHEST_M, high=FARTHEST_M)
    y_m: Number = number(0.0, "m", "y at that moment", low=-FARTHEST_M, high=FARTHEST_M)
    course_rad: Number = number(0.0, "rad", "course at that moment", low=-ANY_ANGLE, high=ANY_ANGLE)
    speed_mps: Number = number(0.0, "m/s", "speed", low=0.0, high=30.0)
    turn_rad_s: Number = number(0.0, "rad/s", "rate at which the course turns", low=-10.0, high=10.0)
    yaw_rad: Number = number(0.0, "rad", "heading at that moment", low=-ANY_ANGLE, high=ANY_ANGLE)
    yaw_rate_rad_s: Number = number(0.0, "rad/s", "rate at which the heading turns", low=-10.0, high=10.0)
    moment_s: Number = number(0.0, "s", "the moment", low=0.0, high=1e6)

    def starts(self) -> Array:
        return np.empty((0, 2))


SHIP_PATHS: tuple[type[ShipPath], ...] = (
    PaperPath,
    StraightPath,
    CirclePath,
    RandomPath,
    LawnMowerPath,
    RecordedPath,
    CarriedOnPath,
)


PAPER, STRAIGHT, CIRCLE, RANDOM, LAWN_MOWER, RECORDED, CARRIED_ON = (float(code) for code in range(len(SHIP_PATHS)))
"""What `kind` holds for each kind of path."""

DRAWN = rows("kind", *{name: () for path in SHIP_PATHS for name in path.drawn()}, "first_segment", "segments")
"""The numbers of all kinds of path."""


def further_numbers(path: ShipPath, first_segment: int) -> dict[str, int]:
    """What stands in the rows of `DRAWN` besides the path's own numbers."""
    segments = path.segments().size * 8 // SEGMENT.itemsize
    return {"kind": SHIP_PATHS.index(type(path)), "first_segment": first_segment, "segments": segments}


def kinds(paths: tuple[ShipPath, ...]) -> dict[str, float]:
    """Which kinds that need more than the first turning vector are among these."""
    return {
        "random": any(isinstance(path, RandomPath) for path in paths),
        "lawn_mower": any(isinstance(path, LawnMowerPath) for path in paths),
        "recorded": any(isinstance(path, RecordedPath) for path in paths),
    }


@inlined
def _side(turn):
    """1 for starboard, −1 for port."""
    return 1.0 - 2.0 * turn


@inlined
def begin(b, j, world) -> None:
    """Turn the path that the lane has drawn into the family's coefficients."""
    p, o = b.drawn.ship, b.path
    kind = p.kind[j]
    o.x[j] = o.y[j] = o.vx[j] = o.vy[j] = 0.0
    o.heading[j] = o.heading_rate[j] = o.swing[j] = o.swing_rate[j] = 0.0
    for k in range(HARMONICS):
        o.rate[k, j] = o.phase[k, j] = o.radius_x[k, j] = o.radius_y[k, j] = 0.0
    if kind == PAPER:
        o.rate[0, j] = -p.rate_rad_s[j]
        o.phase[0, j] = 0.5 * math.pi
        o.radius_x[0, j] = p.radius_m[j]
        o.radius_y[0, j] = p.radius_m[j]
        o.swing[j] = p.swing_rad[j]
        o.swing_rate[j] = p.rate_rad_s[j]
    elif kind == STRAIGHT:
        sine, cosine = sincos(p.course_rad[j])
        o.x[j] = p.x_m[j]
        o.y[j] = p.y_m[j]
        o.vx[j] = p.speed_mps[j] * cosine
        o.vy[j] = p.speed_mps[j] * sine
        o.heading[j] = p.course_rad[j]
    elif kind == CIRCLE:
        side = _side(p.turn[j])
        rate = side * p.speed_mps[j] / p.radius_m[j]
        o.x[j] = p.x_m[j]
        o.y[j] = p.y_m[j]
        o.rate[0, j] = rate
        o.phase[0, j] = p.start_angle_rad[j]
        o.radius_x[0, j] = p.radius_m[j]
        o.radius_y[0, j] = p.radius_m[j]
        o.heading[j] = p.start_angle_rad[j] + 0.5 * math.pi * side
        o.heading_rate[j] = rate
    elif kind == LAWN_MOWER:
        o.x[j] = p.x_m[j]
        o.y[j] = p.y_m[j]
    elif kind == RANDOM:
        _begin_random(b, j)
    elif kind == CARRIED_ON:
        _begin_carried_on(b, j)


@inlined
def _begin_carried_on(b, j) -> None:
    """A straight line or an arc through the place at the moment, with the velocity there."""
    p, o = b.drawn.ship, b.path
    moment = p.moment_s[j]
    speed = p.speed_mps[j]
    turn = p.turn_rad_s[j]
    sine, cosine = sincos(p.course_rad[j])
    o.heading[j] = p.yaw_rad[j] - p.yaw_rate_rad_s[j] * moment
    o.heading_rate[j] = p.yaw_rate_rad_s[j]
    # Below that, the arc's radius would cost more digits than the turn is worth.
    if abs(turn) < 1e-8:
        o.vx[j] = speed * cosine
        o.vy[j] = speed * sine
        o.x[j] = p.x_m[j] - o.vx[j] * moment
        o.y[j] = p.y_m[j] - o.vy[j] * moment
    else:
        radius = speed / turn
        o.rate[0, j] = turn
        o.phase[0, j] = p.course_rad[j] - 0.5 * math.pi - turn * moment
        o.radius_x[0, j] = radius
        o.radius_y[0, j] = radius
        o.x[j] = p.x_m[j] - radius * sine
        o.y[j] = p.y_m[j] + radius * cosine


@inlined
def _begin_random(b, j) -> None:
    """Draw the turning vectors of a random path, which begins where it should."""
    p, o = b.drawn.ship, b.path
    speed = p.speed_mps[j]
    shortest = p.shortest_period_s[j]
    sine, cosine = sincos(p.course_rad[j])
    o.vx[j] = speed * cosine
    o.vy[j] = speed * sine
    x = p.x_m[j]
    y = p.y_m[j]
    for k in range(HARMONICS):
        u_period, u_phase, u_sense, _ = draw(b, j, STREAM, 0.0, float(k))
        rate = 2.0 * math.pi / (shortest + (p.longest_period_s[j] - shortest) * u_period)
        radius = p.wander[j] * speed / (HARMONICS * rate)
        phase = 2.0 * math.pi * u_phase
        o.rate[k, j] = -rate if u_sense < 0.5 else rate
        o.phase[k, j] = phase
        o.radius_x[k, j] = radius
        o.radius_y[k, j] = radius
        sine, cosine = sincos(phase)
        x -= radius * cosine
        y -= radius * sine
    o.x[j] = x
    o.y[j] = y


@inlined
def _turn(rate, phase, t):
    """Sine and cosine of a turning vector's angle at time t."""
    return sincos(fma(rate, t, phase))


@inlined
def sail(b, j) -> None:
    """Straight part, swinging heading and first turning vector: all that most paths have."""
    o, s = b.path, b.ship
    t = b.clock.time_s[j]
    rate = o.swing_rate[j]
    sine, cosine = _turn(rate, 0.0, t)
    swing = o.swing[j]
    s.yaw[j] = fma(swing, sine, fma(o.heading_rate[j], t, o.heading[j]))
    s.yaw_rate[j] = fma(swing * rate, cosine, o.heading_rate[j])
    s.yaw_acceleration[j] = -(swing * rate * rate * sine)
    vx = o.vx[j]
    vy = o.vy[j]
    x = fma(vx, t, o.x[j])
    y = fma(vy, t, o.y[j])
    rate = o.rate[0, j]
    sine, cosine = _turn(rate, o.phase[0, j], t)
    rx = o.radius_x[0, j]
    ry = o.radius_y[0, j]
    rate2 = rate * rate
    s.x[j] = fma(rx, cosine, x)
    s.y[j] = fma(ry, sine, y)
    s.vx[j] = fma(-(rx * rate), sine, vx)
    s.vy[j] = fma(ry * rate, cosine, vy)
    s.ax[j] = fma(-(rx * rate2), cosine, 0.0)
    s.ay[j] = fma(-(ry * rate2), sine, 0.0)


@inlined
def wander(b, j) -> None:
    """The other turning vectors and the heading of lanes on random paths; the others' vectors have no length."""
    o, s = b.path, b.ship
    t = b.clock.time_s[j]
    x, y, vx, vy, ax, ay = s.x[j], s.y[j], s.vx[j], s.vy[j], s.ax[j], s.ay[j]
    rate0, rate1, rate2 = o.rate[0, j], o.rate[1, j], o.rate[2, j]
    rx1, ry1, rx2, ry2 = o.radius_x[1, j], o.radius_y[1, j], o.radius_x[2, j], o.radius_y[2, j]
    sine0, cosine0 = _turn(rate0, o.phase[0, j], t)
    sine1, cosine1 = _turn(rate1, o.phase[1, j], t)
    sine2, cosine2 = _turn(rate2, o.phase[2, j], t)
    square1 = rate1 * rate1
    square2 = rate2 * rate2
    x = fma(rx2, cosine2, fma(rx1, cosine1, x))
    y = fma(ry2, sine2, fma(ry1, sine1, y))
    vx = fma(-(rx2 * rate2), sine2, fma(-(rx1 * rate1), sine1, vx))
    vy = fma(ry2 * rate2, cosine2, fma(ry1 * rate1, cosine1, vy))
    ax = fma(-(rx2 * square2), cosine2, fma(-(rx1 * square1), cosine1, ax))
    ay = fma(-(ry2 * square2), sine2, fma(-(ry1 * square1), sine1, ay))
    cube0 = rate0 * rate0 * rate0
    cube1 = rate1 * rate1 * rate1
    cube2 = rate2 * rate2 * rate2
    jx = o.radius_x[0, j] * cube0 * sine0 + rx1 * cube1 * sine1 + rx2 * cube2 * sine2
    jy = -(o.radius_y[0, j] * cube0 * cosine0) + -(ry1 * cube1 * cosine1) + -(ry2 * cube2 * cosine2)

    speed2 = fma(vx, vx, vy * vy)
    inverse = 1.0 / speed2 if speed2 > 0.0 else 0.0
    rate = inverse * fma(vx, ay, -(vy * ax))
    bend = fma(vx, jy, -(vy * jx))
    acceleration = inverse * fma(-2.0 * rate, fma(vx, ax, vy * ay), bend)
    mine = b.drawn.ship.kind[j] == RANDOM
    s.x[j], s.y[j], s.vx[j], s.vy[j], s.ax[j], s.ay[j] = x, y, vx, vy, ax, ay
    s.yaw[j] = _pick(mine, atan2(vy, vx), s.yaw[j])
    s.yaw_rate[j] = _pick(mine, rate, s.yaw_rate[j])
    s.yaw_acceleration[j] = _pick(mine, acceleration, s.yaw_acceleration[j])


@inlined
def _pick(mine: bool, own: float, other: float) -> float:
    """``own`` or ``other``, both of which are computed, so that loops vectorise."""
    return own if mine else other


@inlined
def follow_legs(b, j) -> None:
    """The motion of lanes on lawn-mower paths."""
    p, s = b.drawn.ship, b.ship
    mine = p.kind[j] == LAWN_MOWER
    course = p.course_rad[j]
    leg = p.leg_length_m[j]
    spacing = p.spacing_m[j]
    speed = p.speed_mps[j]
    side = _side(p.turn[j])
    x0 = s.x[j]
    y0 = s.y[j]
    radius = 0.5 * spacing
    whole = leg + math.pi * radius
    travelled = speed * b.clock.time_s[j]
    count = floor(travelled / whole)
    rest = travelled - count * whole
    # Odd legs come back, and their turns go to the other side.
    back = count - 2.0 * floor(0.5 * count)
    sense = side * (1.0 - 2.0 * back)
    turning = rest > leg
    angle = max(rest - leg, 0.0) / radius
    turn_sin, turn_cos = sincos(angle)
    along = min(rest, leg) + radius * turn_sin
    along = back * leg + (1.0 - 2.0 * back) * along
    across = side * (spacing * count + radius * (1.0 - turn_cos))
    sine, cosine = sincos(course)
    yaw = course + sense * angle + math.pi * side * back
    rate = sense * speed / radius if turning else 0.0
    yaw_sin, yaw_cos = sincos(yaw)
    vx = speed * yaw_cos
    vy = speed * yaw_sin
    s.x[j] = _pick(mine, x0 + along * cosine - across * sine, x0)
    s.y[j] = _pick(mine, y0 + along * sine + across * cosine, y0)
    s.yaw[j] = _pick(mine, yaw, s.yaw[j])
    s.vx[j] = _pick(mine, vx, s.vx[j])
    s.vy[j] = _pick(mine, vy, s.vy[j])
    s.yaw_rate[j] = _pick(mine, rate, s.yaw_rate[j])
    s.ax[j] = _pick(mine, -(rate * vy), s.ax[j])
    s.ay[j] = _pick(mine, rate * vx, s.ay[j])


@inlined
def _cubic(c, dt):
    """Value and two derivatives of a cubic."""
    value = fma(fma(fma(c[0], dt, c[1]), dt, c[2]), dt, c[3])
    rate = fma(fma(3.0 * c[0], dt, 2.0 * c[1]), dt, c[2])
    return value, rate, fma(6.0 * c[0], dt, 2.0 * c[1])


@inlined
def follow_record(b, j, splines, first) -> None:
    """The motion of a lane on a recorded path, whose segments stand in ``splines`` from the place ``first`` on."""
    s = b.ship
    t = b.clock.time_s[j]
    low = int(b.drawn.ship.first_segment[j])
    high = low + int(b.drawn.ship.segments[j])
    while high - low > 1:
        middle = (low + high) // 2
        if record_at(splines, first + middle * SEGMENT_DOUBLES, SEGMENT).start_s <= t:
            low = middle
        else:
            high = middle
    own = record_at(splines, first + low * SEGMENT_DOUBLES, SEGMENT)
    dt = t - own.start_s
    s.x[j], s.vx[j], s.ax[j] = _cubic(own.x, dt)
    s.y[j], s.vy[j], s.ay[j] = _cubic(own.y, dt)
    s.yaw[j], s.yaw_rate[j], s.yaw_acceleration[j] = _cubic(own.yaw, dt)


@inlined
def turn_to_heading(b, j) -> None:
    """Write cosine and sine of the ship's yaw."""
    b.ship.sin[j], b.ship.cos[j] = sincos(b.ship.yaw[j])


_ALONE = block_type({"clock": CLOCK, "random": rng.STATE, "drawn": {"ship": DRAWN}, "path": PATH, "ship": STATE})
"""A block in which there is nothing but the ship."""


@compiled
def _trace(state, splines, times, out):
    b = record_at(state, 0, _ALONE)
    kind = b.drawn.ship.kind[0]
    begin(b, 0, None)
    for i in range(times.size):
        b.clock.time_s[0] = times[i]
        sail(b, 0)
        if kind == RANDOM:
            wander(b, 0)
        elif kind == LAWN_MOWER:
            follow_legs(b, 0)
        elif kind == RECORDED:
            follow_record(b, 0, splines, 0)
        s = b.ship
        out[i, 0], out[i, 1], out[i, 2] = s.x[0], s.y[0], s.yaw[0]
        out[i, 3], out[i, 4], out[i, 5] = s.vx[0], s.vy[0], s.yaw_rate[0]
        out[i, 6], out[i, 7], out[i, 8] = s.ax[0], s.ay[0], s.yaw_acceleration[0]
