"""The ship's paths: position, velocity and acceleration as functions of time, consistent with each other.

Straight lines, circles, the paper's circle and smooth random paths are one family, a straight line plus turning
vectors ("harmonics"), so that a block of simulations on different paths still vectorises; lawn-mower and recorded
paths are computed beside it. Yaw grows from x (north) to y (east): a positive yaw rate turns to starboard.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from uwoc_gym.block import (
    FIRST_PARAMETER,
    HARMONIC,
    HARMONIC_ROWS,
    HARMONICS,
    HEADING,
    HEADING_RATE,
    LEGS_COURSE,
    LEGS_LENGTH,
    LEGS_SIDE,
    LEGS_SPACING,
    LEGS_SPEED,
    PATH_KIND,
    PATH_VX,
    PATH_VY,
    PATH_X,
    PATH_Y,
    SHIP_AX,
    SHIP_AY,
    SHIP_COS,
    SHIP_SIN,
    SHIP_VX,
    SHIP_VY,
    SHIP_X,
    SHIP_Y,
    SHIP_YAW,
    SHIP_YAW_ACCELERATION,
    SHIP_YAW_RATE,
    STRIDE,
    SWING,
    SWING_PHASE,
    SWING_RATE,
    TIME,
)
from uwoc_gym.compiled import compiled, inlined
from uwoc_gym.elementary import atan2, fma, sincos
from uwoc_gym.parameters import Number, Parameters, SettingError, choice, number, samples
from uwoc_gym.rng import STREAM_SHIP, draw, key_from_seed

Array = npt.NDArray[np.float64]

PAPER_CODE, STRAIGHT_CODE, CIRCLE_CODE, RANDOM_CODE, LAWN_MOWER_CODE, RECORDED_CODE = range(6)
PATH_PARAMETERS = 7
"""Numbers that any path hands to compiled code."""
SPLINE_COLUMNS = 13
"""A row of a recorded path's table: start of the segment, then four coefficients for each of x, y, yaw."""

COURSE = (0.0, 2.0 * math.pi)


class ShipMotion(NamedTuple):
    """The ship's motion in the earth frame at T times, each of shape (T, 3) for x, y, yaw [m, m, rad and per s, s²]."""

    pose: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True, kw_only=True)
class ShipPath(Parameters):
    """Base of all paths."""

    code: ClassVar[int]

    def path_numbers(self) -> list[Number]:
        """The numbers, fixed or ranges, that the path hands to compiled code, in its order."""
        return [value for _, value in self.numbers()]

    def table(self) -> Array:
        """The spline table of a recorded path, shape (segments, 13); empty for the others."""
        return np.empty((0, SPLINE_COLUMNS))

    @property
    def end_time_s(self) -> float:
        """Time [s] at which the path ends; infinite unless recorded."""
        return math.inf

    def at(self, time_s: npt.ArrayLike, seed: int = 0) -> ShipMotion:
        """Pose, velocity and acceleration at times [s] of shape (T,).

        Args:
            time_s: Times from 0 to the path's end.
            seed: Fixes what a random path draws.

        Raises:
            SettingError: A number of the path is a range.
            ValueError: A time lies outside the path.
        """
        times = np.atleast_1d(np.asarray(time_s, dtype=float))
        if not (np.isfinite(times) & (times >= 0.0) & (times <= self.end_time_s)).all():
            raise ValueError(f"time_s must lie in [0, {self.end_time_s:g}] [s].")
        for name, _ in self.numbers():
            self.value(name)
        values = np.zeros(PATH_PARAMETERS)
        numbers = self.path_numbers()
        values[: len(numbers)] = numbers
        out = np.empty((times.size, 9))
        key_0, key_1 = key_from_seed(seed)
        _trace(self.code, values, self.table(), key_0, key_1, times, out)
        return ShipMotion(out[:, 0:3], out[:, 3:6], out[:, 6:9])


@dataclass(frozen=True, kw_only=True)
class PaperPath(ShipPath):
    """The paper's ship: a circle about the origin from (0, radius), its heading swinging about x (paper, sec. 4).

    x = radius · sin(rate · t), y = radius · cos(rate · t), yaw = swing · sin(rate · t).
    """

    kind: ClassVar[str] = "paper"
    code: ClassVar[int] = PAPER_CODE

    radius_m: Number = number(10.0, "m", "radius of the circle", low=0.0, source="paper, sec. 4")
    rate_rad_s: Number = number(0.1, "rad/s", "rate of turning and of the swing", source="paper, sec. 4")
    swing_rad: Number = number(math.pi / 2, "rad", "amplitude of the heading's swing", source="paper, sec. 4")


@dataclass(frozen=True, kw_only=True)
class StraightPath(ShipPath):
    """A straight line at constant speed, heading along it."""

    kind: ClassVar[str] = "straight"
    code: ClassVar[int] = STRAIGHT_CODE

    x_m: Number = number(0.0, "m", "x at time 0")
    y_m: Number = number(0.0, "m", "y at time 0")
    course_rad: Number = number(0.0, "rad", "course")
    speed_mps: Number = number(1.0, "m/s", "speed", low=0.0, source="paper's ship: 1 m/s")


@dataclass(frozen=True, kw_only=True)
class CirclePath(ShipPath):
    """A circle at constant speed, heading along it."""

    kind: ClassVar[str] = "circle"
    code: ClassVar[int] = CIRCLE_CODE

    x_m: Number = number(0.0, "m", "x of the centre")
    y_m: Number = number(0.0, "m", "y of the centre")
    radius_m: Number = number(10.0, "m", "radius", positive=True, source="paper's ship: 10 m")
    speed_mps: Number = number(1.0, "m/s", "speed", low=0.0, source="paper's ship: 1 m/s")
    start_angle_rad: Number = number(0.0, "rad", "direction from the centre to the ship at time 0")
    turn: str = choice("starboard", ("starboard", "port"), "side to which the ship turns")

    def path_numbers(self) -> list[Number]:
        return [*super().path_numbers(), 1.0 if self.turn == "starboard" else -1.0]


@dataclass(frozen=True, kw_only=True)
class RandomPath(ShipPath):
    """A smooth random path: steady way along a course plus three turning vectors with random periods and phases.

    The turning vectors' speeds add up to ``wander`` times the mean speed, so that the ship never stops; its heading
    is that of its velocity. Periods, phases and senses are drawn anew each episode.
    """

    kind: ClassVar[str] = "random"
    code: ClassVar[int] = RANDOM_CODE

    x_m: Number = number(0.0, "m", "x at time 0")
    y_m: Number = number(0.0, "m", "y at time 0")
    course_rad: Number = number(COURSE, "rad", "mean course")
    speed_mps: Number = number(0.8, "m/s", "mean speed", positive=True)
    wander: Number = number(0.6, "1", "speed of the turning vectors over the mean speed", low=0.0, high=0.9)
    shortest_period_s: Number = number(20.0, "s", "shortest period of a turning vector", positive=True)
    longest_period_s: Number = number(60.0, "s", "longest period of a turning vector", positive=True)


@dataclass(frozen=True, kw_only=True)
class LawnMowerPath(ShipPath):
    """Parallel legs joined by half circles, first to one side, then to the other, heading along the path."""

    kind: ClassVar[str] = "lawn-mower"
    code: ClassVar[int] = LAWN_MOWER_CODE

    x_m: Number = number(0.0, "m", "x at time 0")
    y_m: Number = number(0.0, "m", "y at time 0")
    course_rad: Number = number(0.0, "rad", "course of the first leg")
    leg_length_m: Number = number(20.0, "m", "length of a leg", positive=True)
    spacing_m: Number = number(8.0, "m", "distance between legs", positive=True)
    speed_mps: Number = number(1.0, "m/s", "speed", low=0.0, source="paper's ship: 1 m/s")
    turn: str = choice("starboard", ("starboard", "port"), "side of the first turn")

    def path_numbers(self) -> list[Number]:
        return [*super().path_numbers(), 1.0 if self.turn == "starboard" else -1.0]


@dataclass(frozen=True, kw_only=True)
class RecordedPath(ShipPath):
    """A recorded path: a cubic spline with continuous acceleration through samples of position and heading.

    Velocity and acceleration are the spline's derivatives, hence consistent with the position. Without ``yaw_rad``
    the heading follows the course over ground.
    """

    kind: ClassVar[str] = "recorded"
    code: ClassVar[int] = RECORDED_CODE

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
        if count < 4 or self.time_s[0] != 0.0 or not (np.diff(self.time_s) > 0.0).all():
            raise SettingError("RecordedPath.time_s must be four or more increasing times that start at 0 [s].")

    @classmethod
    def from_csv(cls, path: str | Path) -> Self:
        """Read a CSV file with the columns time_s, x_m, y_m and, optionally, yaw_rad.

        Raises:
            FileNotFoundError: There is no such file.
            SettingError: A column is missing or unknown, or a cell isn't a number.
        """
        with open(path, newline="") as file:
            rows = list(csv.DictReader(file))
        columns: dict[str, list[float]] = {}
        for name in rows[0] if rows else ():
            try:
                columns[name] = [float(row[name]) for row in rows]
            except (TypeError, ValueError):
                raise SettingError(f"{path}: column {name!r} must hold a number in every row.") from None
        return cls.from_dict(columns)

    def path_numbers(self) -> list[Number]:
        return []

    @property
    def end_time_s(self) -> float:
        return self.time_s[-1]

    def table(self) -> Array:
        return _spline_table(self.time_s, self.x_m, self.y_m, self.yaw_rad)


@lru_cache(maxsize=8)
def _spline_table(
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
    table = np.column_stack([time_s[:-1], x.c.T, y.c.T, yaw.c.T])
    return np.ascontiguousarray(table)


SHIP_PATHS: tuple[type[ShipPath], ...] = (
    PaperPath,
    StraightPath,
    CirclePath,
    RandomPath,
    LawnMowerPath,
    RecordedPath,
)


@inlined
def set_path(s, j, code, p0, p1, p2, p3, p4, p5, p6) -> None:
    """Turn the path numbers that lane ``j`` has drawn into the family's coefficients."""
    s[j + PATH_KIND * STRIDE] = code
    for row in range(PATH_X, HARMONIC + HARMONICS * HARMONIC_ROWS):
        s[j + row * STRIDE] = 0.0
    first = j + HARMONIC * STRIDE
    if code == PAPER_CODE:
        s[first] = -p1
        s[first + STRIDE] = 0.5 * math.pi
        s[first + 2 * STRIDE] = p0
        s[first + 3 * STRIDE] = p0
        s[j + SWING * STRIDE] = p2
        s[j + SWING_RATE * STRIDE] = p1
    elif code == STRAIGHT_CODE:
        sine, cosine = sincos(p2)
        s[j + PATH_X * STRIDE] = p0
        s[j + PATH_Y * STRIDE] = p1
        s[j + PATH_VX * STRIDE] = p3 * cosine
        s[j + PATH_VY * STRIDE] = p3 * sine
        s[j + HEADING * STRIDE] = p2
    elif code == CIRCLE_CODE:
        rate = p5 * p3 / p2
        s[j + PATH_X * STRIDE] = p0
        s[j + PATH_Y * STRIDE] = p1
        s[first] = rate
        s[first + STRIDE] = p4
        s[first + 2 * STRIDE] = p2
        s[first + 3 * STRIDE] = p2
        s[j + HEADING * STRIDE] = p4 + 0.5 * math.pi * p5
        s[j + HEADING_RATE * STRIDE] = rate
    elif code == LAWN_MOWER_CODE:
        s[j + PATH_X * STRIDE] = p0
        s[j + PATH_Y * STRIDE] = p1
        s[j + LEGS_COURSE * STRIDE] = p2
        s[j + LEGS_LENGTH * STRIDE] = p3
        s[j + LEGS_SPACING * STRIDE] = p4
        s[j + LEGS_SPEED * STRIDE] = p5
        s[j + LEGS_SIDE * STRIDE] = p6
    elif code == RECORDED_CODE:
        s[j + PATH_X * STRIDE] = p0
        s[j + PATH_Y * STRIDE] = p1


@inlined
def set_random_path(s, j, x, y, course, speed, wander, shortest, longest, key_0, key_1, episode) -> None:
    """Draw the turning vectors of a random path for lane ``j``."""
    sine, cosine = sincos(course)
    s[j + PATH_VX * STRIDE] = speed * cosine
    s[j + PATH_VY * STRIDE] = speed * sine
    for harmonic in range(HARMONICS):
        u_period, u_phase, u_sense, _ = draw(key_0, key_1, episode, STREAM_SHIP, 0.0, harmonic)
        rate = 2.0 * math.pi / (shortest + (longest - shortest) * u_period)
        radius = wander * speed / (HARMONICS * rate)
        phase = 2.0 * math.pi * u_phase
        row = j + (HARMONIC + harmonic * HARMONIC_ROWS) * STRIDE
        s[row] = -rate if u_sense < 0.5 else rate
        s[row + STRIDE] = phase
        s[row + 2 * STRIDE] = radius
        s[row + 3 * STRIDE] = radius
        sine, cosine = sincos(phase)
        x -= radius * cosine
        y -= radius * sine
    s[j + PATH_X * STRIDE] = x
    s[j + PATH_Y * STRIDE] = y


def _make_turning(row: int) -> tuple[Any, Any]:
    """How the turning vector at ``row`` moves the ship; the row is compiled in, so that loops vectorise."""

    @inlined
    def add(s, j, x, y, vx, vy, ax, ay):
        """Write the given motion plus the turning vector as the ship's."""
        rate = s[j + row * STRIDE]
        sine, cosine = sincos(fma(rate, s[j + TIME * STRIDE], s[j + (row + 1) * STRIDE]))
        rx = s[j + (row + 2) * STRIDE]
        ry = s[j + (row + 3) * STRIDE]
        rate2 = rate * rate
        s[j + SHIP_X * STRIDE] = fma(rx, cosine, x)
        s[j + SHIP_Y * STRIDE] = fma(ry, sine, y)
        s[j + SHIP_VX * STRIDE] = fma(-(rx * rate), sine, vx)
        s[j + SHIP_VY * STRIDE] = fma(ry * rate, cosine, vy)
        s[j + SHIP_AX * STRIDE] = fma(-(rx * rate2), cosine, ax)
        s[j + SHIP_AY * STRIDE] = fma(-(ry * rate2), sine, ay)

    @inlined
    def jerk(s, j):
        """The turning vector's third derivative."""
        rate = s[j + row * STRIDE]
        sine, cosine = sincos(fma(rate, s[j + TIME * STRIDE], s[j + (row + 1) * STRIDE]))
        rate3 = rate * rate * rate
        return s[j + (row + 2) * STRIDE] * rate3 * sine, -(s[j + (row + 3) * STRIDE] * rate3 * cosine)

    return add, jerk


_add_first, _jerk_of_first = _make_turning(HARMONIC)
_add_second, _jerk_of_second = _make_turning(HARMONIC + HARMONIC_ROWS)
_add_third, _jerk_of_third = _make_turning(HARMONIC + 2 * HARMONIC_ROWS)


@inlined
def _add_others(s, lanes):
    """Add the second and third turning vectors, which only random paths have."""
    for j in range(lanes):
        x, y = s[j + SHIP_X * STRIDE], s[j + SHIP_Y * STRIDE]
        vx, vy = s[j + SHIP_VX * STRIDE], s[j + SHIP_VY * STRIDE]
        ax, ay = s[j + SHIP_AX * STRIDE], s[j + SHIP_AY * STRIDE]
        _add_second(s, j, x, y, vx, vy, ax, ay)
    for j in range(lanes):
        x, y = s[j + SHIP_X * STRIDE], s[j + SHIP_Y * STRIDE]
        vx, vy = s[j + SHIP_VX * STRIDE], s[j + SHIP_VY * STRIDE]
        ax, ay = s[j + SHIP_AX * STRIDE], s[j + SHIP_AY * STRIDE]
        _add_third(s, j, x, y, vx, vy, ax, ay)


@inlined
def _head_along_course(s, lanes) -> None:
    """Give the lanes on random paths the heading of their velocity."""
    for j in range(lanes):
        along = s[j + PATH_KIND * STRIDE] == RANDOM_CODE
        jx0, jy0 = _jerk_of_first(s, j)
        jx1, jy1 = _jerk_of_second(s, j)
        jx2, jy2 = _jerk_of_third(s, j)
        vx = s[j + SHIP_VX * STRIDE]
        vy = s[j + SHIP_VY * STRIDE]
        ax = s[j + SHIP_AX * STRIDE]
        ay = s[j + SHIP_AY * STRIDE]
        speed2 = fma(vx, vx, vy * vy)
        inverse = 1.0 / speed2 if speed2 > 0.0 else 0.0
        rate = inverse * fma(vx, ay, -(vy * ax))
        bend = fma(vx, jy0 + jy1 + jy2, -(vy * (jx0 + jx1 + jx2)))
        acceleration = inverse * fma(-2.0 * rate, fma(vx, ax, vy * ay), bend)
        yaw = atan2(vy, vx)
        s[j + SHIP_YAW * STRIDE] = _pick(along, yaw, s[j + SHIP_YAW * STRIDE])
        s[j + SHIP_YAW_RATE * STRIDE] = _pick(along, rate, s[j + SHIP_YAW_RATE * STRIDE])
        old = s[j + SHIP_YAW_ACCELERATION * STRIDE]
        s[j + SHIP_YAW_ACCELERATION * STRIDE] = _pick(along, acceleration, old)


@inlined
def move_ship(s, lanes, random, lawn_mower, recorded, table) -> None:
    """Write the ship's motion at each lane's time into the block.

    ``random``, ``lawn_mower`` and ``recorded`` say which kinds of path the scenario has, so that the rest is skipped.
    """
    for j in range(lanes):
        t = s[j + TIME * STRIDE]
        rate = s[j + SWING_RATE * STRIDE]
        sine, cosine = sincos(fma(rate, t, s[j + SWING_PHASE * STRIDE]))
        swing = s[j + SWING * STRIDE]
        yaw = fma(swing, sine, fma(s[j + HEADING_RATE * STRIDE], t, s[j + HEADING * STRIDE]))
        s[j + SHIP_YAW * STRIDE] = yaw
        s[j + SHIP_YAW_RATE * STRIDE] = fma(swing * rate, cosine, s[j + HEADING_RATE * STRIDE])
        s[j + SHIP_YAW_ACCELERATION * STRIDE] = -(swing * rate * rate * sine)
        vx = s[j + PATH_VX * STRIDE]
        vy = s[j + PATH_VY * STRIDE]
        x = fma(vx, t, s[j + PATH_X * STRIDE])
        y = fma(vy, t, s[j + PATH_Y * STRIDE])
        _add_first(s, j, x, y, vx, vy, 0.0, 0.0)
    if random:
        _add_others(s, lanes)
        _head_along_course(s, lanes)
    if lawn_mower:
        _move_along_legs(s, lanes)
    if recorded:
        for j in range(lanes):
            if s[j + PATH_KIND * STRIDE] == RECORDED_CODE:
                _move_along_record(s, j, s[j + PATH_X * STRIDE], s[j + PATH_Y * STRIDE], table)
    for j in range(lanes):
        sine, cosine = sincos(s[j + SHIP_YAW * STRIDE])
        s[j + SHIP_SIN * STRIDE] = sine
        s[j + SHIP_COS * STRIDE] = cosine


@inlined
def _move_along_legs(s, lanes) -> None:
    """Move the lanes on lawn-mower paths."""
    for j in range(lanes):
        mine = s[j + PATH_KIND * STRIDE] == LAWN_MOWER_CODE
        course = s[j + LEGS_COURSE * STRIDE]
        leg = s[j + LEGS_LENGTH * STRIDE]
        spacing = s[j + LEGS_SPACING * STRIDE]
        speed = s[j + LEGS_SPEED * STRIDE]
        side = s[j + LEGS_SIDE * STRIDE]
        x0 = s[j + SHIP_X * STRIDE]
        y0 = s[j + SHIP_Y * STRIDE]
        radius = 0.5 * spacing
        whole = leg + math.pi * radius
        travelled = speed * s[j + TIME * STRIDE]
        count = np.floor(travelled / whole)
        rest = travelled - count * whole
        # Odd legs come back, and their turns go to the other side.
        back = count - 2.0 * np.floor(0.5 * count)
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
        x = x0 + along * cosine - across * sine
        y = y0 + along * sine + across * cosine
        s[j + SHIP_X * STRIDE] = _pick(mine, x, x0)
        s[j + SHIP_Y * STRIDE] = _pick(mine, y, y0)
        s[j + SHIP_YAW * STRIDE] = _pick(mine, yaw, s[j + SHIP_YAW * STRIDE])
        s[j + SHIP_VX * STRIDE] = _pick(mine, vx, s[j + SHIP_VX * STRIDE])
        s[j + SHIP_VY * STRIDE] = _pick(mine, vy, s[j + SHIP_VY * STRIDE])
        s[j + SHIP_YAW_RATE * STRIDE] = _pick(mine, rate, s[j + SHIP_YAW_RATE * STRIDE])
        s[j + SHIP_AX * STRIDE] = _pick(mine, -(rate * vy), s[j + SHIP_AX * STRIDE])
        s[j + SHIP_AY * STRIDE] = _pick(mine, rate * vx, s[j + SHIP_AY * STRIDE])


@inlined
def _pick(first: bool, a: float, b: float) -> float:
    """``a`` or ``b``, both of which are computed, so that loops vectorise."""
    return a if first else b


@inlined
def _move_along_record(s, j, first, segments, table) -> None:
    t = s[j + TIME * STRIDE]
    low = int(first)
    high = int(first + segments)
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= t:
            low = middle
        else:
            high = middle
    dt = t - table[low, 0]
    for channel in range(3):
        c3 = table[low, 1 + 4 * channel]
        c2 = table[low, 2 + 4 * channel]
        c1 = table[low, 3 + 4 * channel]
        c0 = table[low, 4 + 4 * channel]
        value = fma(fma(fma(c3, dt, c2), dt, c1), dt, c0)
        rate = fma(fma(3.0 * c3, dt, 2.0 * c2), dt, c1)
        acceleration = fma(6.0 * c3, dt, 2.0 * c2)
        if channel == 0:
            s[j + SHIP_X * STRIDE] = value
            s[j + SHIP_VX * STRIDE] = rate
            s[j + SHIP_AX * STRIDE] = acceleration
        elif channel == 1:
            s[j + SHIP_Y * STRIDE] = value
            s[j + SHIP_VY * STRIDE] = rate
            s[j + SHIP_AY * STRIDE] = acceleration
        else:
            s[j + SHIP_YAW * STRIDE] = value
            s[j + SHIP_YAW_RATE * STRIDE] = rate
            s[j + SHIP_YAW_ACCELERATION * STRIDE] = acceleration


@inlined
def begin_path(s, j, code, first_parameter, key_0, key_1, episode) -> None:
    """Start the path of lane ``j`` from the numbers in its parameter rows."""
    p = j + first_parameter * STRIDE
    p0, p1, p2, p3 = s[p], s[p + STRIDE], s[p + 2 * STRIDE], s[p + 3 * STRIDE]
    p4, p5, p6 = s[p + 4 * STRIDE], s[p + 5 * STRIDE], s[p + 6 * STRIDE]
    set_path(s, j, code, p0, p1, p2, p3, p4, p5, p6)
    if code == RANDOM_CODE:
        set_random_path(s, j, p0, p1, p2, p3, p4, p5, p6, key_0, key_1, episode)


@compiled
def _trace(code, values, table, key_0, key_1, times, out):
    state = np.zeros((FIRST_PARAMETER + PATH_PARAMETERS) * STRIDE)
    for i in range(PATH_PARAMETERS):
        state[(FIRST_PARAMETER + i) * STRIDE] = values[i]
    if code == RECORDED_CODE:
        state[FIRST_PARAMETER * STRIDE] = 0.0
        state[(FIRST_PARAMETER + 1) * STRIDE] = table.shape[0]
    begin_path(state, 0, code, FIRST_PARAMETER, key_0, key_1, 0.0)
    for i in range(times.size):
        state[TIME * STRIDE] = times[i]
        move_ship(state, 1, True, True, code == RECORDED_CODE, table)
        out[i, 0] = state[SHIP_X * STRIDE]
        out[i, 1] = state[SHIP_Y * STRIDE]
        out[i, 2] = state[SHIP_YAW * STRIDE]
        out[i, 3] = state[SHIP_VX * STRIDE]
        out[i, 4] = state[SHIP_VY * STRIDE]
        out[i, 5] = state[SHIP_YAW_RATE * STRIDE]
        out[i, 6] = state[SHIP_AX * STRIDE]
        out[i, 7] = state[SHIP_AY * STRIDE]
        out[i, 8] = state[SHIP_YAW_ACCELERATION * STRIDE]


def kinds_of(paths: tuple[ShipPath, ...]) -> tuple[bool, bool, bool]:
    """Whether there are random, lawn-mower and recorded paths among these, which `move_ship` wants to know."""
    codes = {path.code for path in paths}
    return RANDOM_CODE in codes, LAWN_MOWER_CODE in codes, RECORDED_CODE in codes


def path_numbers_with_table(path: ShipPath, first_segment: int) -> list[Any]:
    """The path's numbers for compiled code; a recorded path gets its place in the shared spline table."""
    if isinstance(path, RecordedPath):
        return [float(first_segment), float(path.table().shape[0])]
    return path.path_numbers()
