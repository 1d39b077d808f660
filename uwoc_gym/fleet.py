"""N simulations as arrays: reset, step, observe, reward. The only place where time passes.

All environments are thin shells over `Fleet`. Its simulations lie in blocks of 32 lanes (see `block`); one compiled
function advances any number of blocks, with everything inside: checking and scaling of actions, integration, ship,
sea, sensors, link, reward, observation, end of episode and autoreset. A lane's episode is a pure function of its
seed and episode number, so it is the same bit for bit on any batch size.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym import link as optics
from uwoc_gym.block import (
    ACTION_SURGE,
    ACTION_SWAY,
    ACTION_YAW,
    BER,
    BIT_RATE,
    COS,
    COS_FOV,
    COST,
    CURRENT_X,
    CURRENT_Y,
    DEPTH,
    ENDED,
    EPISODE,
    ERROR_SURGE,
    ERROR_SWAY,
    ERROR_X,
    ERROR_Y,
    ERROR_YAW,
    ERROR_YAW_RATE,
    FIRST_MEASURE,
    FIRST_PARAMETER,
    IN_CONE,
    INVERSE_SURGE,
    INVERSE_SWAY,
    INVERSE_YAW,
    KEY_0,
    KEY_1,
    LANES,
    LAST_OUTSIDE,
    LEVEL,
    LEVEL_SCALE,
    LN_DEPTH,
    LN_RATE,
    MEASURES,
    POINTING_ERROR,
    PUSH_SURGE,
    PUSH_SWAY,
    PUSH_YAW,
    RANGE,
    REWARD,
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
    SIN,
    SLANT,
    SLOPE_COS,
    SLOPE_LINEAR,
    SLOPE_LOG,
    SNR,
    STEP,
    STRIDE,
    SUCCESS,
    SURGE,
    SWAY,
    TERM_BIT_RATE,
    TERM_EFFORT,
    TERM_HEADING,
    TERM_IN_CONE,
    TERM_POSITION,
    TERMINATED,
    TIME,
    TRUNCATED,
    WAS_ENDED,
    YAW,
    YAW_RATE,
    X,
    Y,
)
from uwoc_gym.compiled import compiled, inlined, subroutine
from uwoc_gym.elementary import atan_below_one, exp, fma, log, sincos, wrap
from uwoc_gym.observation import LIMIT, SIZE
from uwoc_gym.parameters import Number, closest
from uwoc_gym.reward import reward_terms
from uwoc_gym.rng import STREAM_PARAMETERS, draw, key_from_seed
from uwoc_gym.scenario import Scenario
from uwoc_gym.sea import PULSE_PARAMETERS, advance_current, apply_pulses, begin_current, mark_pulses
from uwoc_gym.sensors import measure_errors
from uwoc_gym.ship import (
    PATH_PARAMETERS,
    SPLINE_COLUMNS,
    begin_path,
    kinds_of,
    move_ship,
    path_numbers_with_table,
)
from uwoc_gym.vehicle import integrate_in_calm, integrate_with_pulses, set_dynamics

Array = npt.NDArray[np.float64]


class Autoreset(enum.IntEnum):
    """What happens to a simulation after its episode has ended."""

    DISABLED = 0
    NEXT_STEP = 1
    SAME_STEP = 2


def _fixed_parameters(scenario: Scenario) -> list[tuple[str, Number]]:
    """Path and value of each number that an episode may draw, other than those of the ship and the pulses."""
    groups = {
        "link": scenario.link,
        "vehicle": scenario.vehicle,
        "current": scenario.sea.current,
        "sensors": scenario.sensors,
        "start": scenario.start,
    }
    numbers = [(f"{group}.{name}", value) for group, owner in groups.items() for name, value in owner.numbers()]
    # Not a number stands for "at the cone's height", which the kernel works out.
    numbers.append(("depth_m", math.nan if scenario.depth_m is None else scenario.depth_m))
    return numbers


_PATHS = [path for path, _ in _fixed_parameters(Scenario())]


def _row(path: str) -> int:
    return FIRST_PARAMETER + _PATHS.index(path)


# First rows of the groups of drawn numbers; within a group they follow the order of the class's fields.
_LINK = _row("link.power_w")
_VEHICLE = _row("vehicle.mass_surge_kg")
_CURRENT = _row("current.speed_mps")
_SENSORS = _row("sensors.position_std_m")
_START = _row("start.x_m")
_DEPTH = _row("depth_m")
_SHIP = FIRST_PARAMETER + len(_PATHS)
_PULSES = _SHIP + PATH_PARAMETERS
_FIXED = len(_PATHS)

# Places in the table of constants that a scenario hands to the kernel.
(
    C_PERIOD, C_STEP, C_SUBSTEPS, C_MAX_STEPS, C_LOST, C_AUTORESET,
    C_FORCE_SURGE, C_FORCE_SWAY, C_FORCE_YAW, C_CORIOLIS, C_SURFACE, C_Q, C_LN_THRESHOLD, C_LN_CEILING,
    C_RELATIVE_START, C_CURRENT, C_NOISE, C_PULSES, C_RANDOM, C_LAWN_MOWER, C_RECORDED, C_PATHS,
    C_W_RATE, C_W_CONE, C_W_POSITION, C_W_HEADING, C_W_EFFORT, C_POSITION_SCALE, C_HEADING_SCALE,
    C_OBS_POSITION, C_OBS_VELOCITY, C_OBS_YAW_RATE, C_OBS_ACCELERATION, C_OBS_YAW_ACCELERATION, C_ROWS,
) = range(35)  # fmt: skip
_CONSTANTS = 35
_PATH_WIDTH = 1 + 2 * PATH_PARAMETERS

_LARGEST = np.finfo(np.float32).max
_NOT_FINITE = -1
_HAS_ENDED = -2


@inlined
def _draw_parameter(s, j, low, high, step, index):
    if low == high or low != low:
        return low
    u, _, _, _ = draw(
        s[j + KEY_0 * STRIDE], s[j + KEY_1 * STRIDE], s[j + EPISODE * STRIDE], STREAM_PARAMETERS, step, index
    )
    return low + (high - low) * u


@subroutine
def _draw_numbers(s, table) -> None:
    """Draw the numbers of the link, the vehicle, the sea, the sensors and the start for a lane's next episode."""
    j = 0
    pulses = int(table[C_PULSES])
    drawn = _FIXED + pulses * PULSE_PARAMETERS
    for i in range(drawn):
        row = FIRST_PARAMETER + i if i < _FIXED else _PULSES + i - _FIXED
        low = table[_CONSTANTS + 2 * i]
        s[j + row * STRIDE] = _draw_parameter(s, j, low, table[_CONSTANTS + 2 * i + 1], 0.0, i)


@subroutine
def _begin_episode(s, table, splines) -> None:
    """Draw the ship's path for the lane at which the view ``s`` begins and put it at time 0."""
    j = 0
    drawn = _FIXED + int(table[C_PULSES]) * PULSE_PARAMETERS
    which = int(_draw_parameter(s, j, 0.0, table[C_PATHS], 1.0, 0))
    path = _CONSTANTS + 2 * drawn + which * _PATH_WIDTH
    for i in range(PATH_PARAMETERS):
        low = table[path + 1 + 2 * i]
        s[j + (_SHIP + i) * STRIDE] = _draw_parameter(s, j, low, table[path + 2 + 2 * i], 2.0, i)

    for row in (TIME, STEP, ENDED, LAST_OUTSIDE, ACTION_SURGE, ACTION_SWAY, ACTION_YAW):
        s[j + row * STRIDE] = 0.0
    for row in (ERROR_X, ERROR_Y, ERROR_YAW, ERROR_SURGE, ERROR_SWAY, ERROR_YAW_RATE):
        s[j + row * STRIDE] = 0.0

    v = j + _VEHICLE * STRIDE
    set_dynamics(
        s, j,
        s[v], s[v + STRIDE], s[v + 2 * STRIDE],
        s[v + 3 * STRIDE], s[v + 4 * STRIDE], s[v + 5 * STRIDE],
        s[v + 6 * STRIDE], s[v + 7 * STRIDE], s[v + 8 * STRIDE],
        s[v + 9 * STRIDE], s[v + 10 * STRIDE], table[C_CORIOLIS],
    )  # fmt: skip
    _begin_link(s, j, table)
    begin_path(s, j, int(table[path]), _SHIP, s[j + KEY_0 * STRIDE], s[j + KEY_1 * STRIDE], s[j + EPISODE * STRIDE])
    begin_current(s, j, _CURRENT)

    _move_ship(s, 1, table, splines)
    start = j + _START * STRIDE
    relative = table[C_RELATIVE_START]
    s[j + X * STRIDE] = s[start] + relative * s[j + SHIP_X * STRIDE]
    s[j + Y * STRIDE] = s[start + STRIDE] + relative * s[j + SHIP_Y * STRIDE]
    s[j + YAW * STRIDE] = s[start + 2 * STRIDE] + relative * s[j + SHIP_YAW * STRIDE]
    s[j + SURGE * STRIDE] = s[start + 3 * STRIDE]
    s[j + SWAY * STRIDE] = s[start + 4 * STRIDE]
    s[j + YAW_RATE * STRIDE] = s[start + 5 * STRIDE]


@inlined
def _begin_link(s, j, table) -> None:
    """Reduce the link that lane ``j`` has drawn to ln B = a + b ln d + c (d − 1) + e ln cos ψ, its cone and depth."""
    p = j + _LINK * STRIDE
    fov = s[p + 3 * STRIDE]
    responsivity = s[p + 5 * STRIDE]
    attenuation = s[p + 6 * STRIDE]
    order = optics.lambertian_order(s[p + STRIDE])
    area = optics.effective_area(s[p + 2 * STRIDE], s[p + 4 * STRIDE], fov, 0.0)
    loss = optics.channel_loss(attenuation, 1.0)
    current = responsivity * (optics.radiant_intensity(s[p], order, 1.0, 0.0) * area * loss)
    surface = table[C_SURFACE] > 0.0
    irradiance = s[p + 8 * STRIDE] * (1.0 if surface else loss * loss)
    lit = s[p + 2 * STRIDE] if surface else area
    background = optics.solar_power(irradiance, s[p + 9 * STRIDE], s[p + 7 * STRIDE], lit)
    noise = optics.shot_noise_per_hertz(responsivity, background)
    ln_rate = math.log(current * current / noise / (table[C_Q] * table[C_Q]))
    slope_log, slope_linear, slope_cos = optics.log_rate_slopes(order, attenuation, surface)

    excess = ln_rate + slope_cos * math.log(math.cos(fov)) - table[C_LN_THRESHOLD]
    slant = math.exp(optics.solve_log_range(excess, slope_log, slope_linear))
    depth = s[j + _DEPTH * STRIDE]
    if depth != depth:
        depth = slant * math.cos(fov)
        s[j + _DEPTH * STRIDE] = depth
    on_axis = min(ln_rate + slope_log * math.log(depth) + slope_linear * (depth - 1.0), table[C_LN_CEILING])
    decades = on_axis - table[C_LN_THRESHOLD]

    s[j + LN_RATE * STRIDE] = ln_rate
    s[j + SLOPE_LOG * STRIDE] = slope_log
    s[j + SLOPE_LINEAR * STRIDE] = slope_linear
    s[j + SLOPE_COS * STRIDE] = slope_cos
    s[j + DEPTH * STRIDE] = depth
    s[j + LN_DEPTH * STRIDE] = math.log(depth)
    # A hair's breadth of tolerance: at the cone's own depth the rim is where both conditions meet.
    s[j + COS_FOV * STRIDE] = math.cos(fov) * (1.0 - 1e-12)
    s[j + SLANT * STRIDE] = slant * (1.0 + 1e-12)
    s[j + LEVEL_SCALE * STRIDE] = 1.0 / decades if decades > 0.0 else 0.0


@inlined
def _turn_to_heading(s, lanes) -> None:
    for j in range(lanes):
        sine, cosine = sincos(s[j + YAW * STRIDE])
        s[j + SIN * STRIDE] = sine
        s[j + COS * STRIDE] = cosine


@inlined
def _move_ship(s, lanes, table, splines) -> None:
    move_ship(s, lanes, table[C_RANDOM] > 0.0, table[C_LAWN_MOWER] > 0.0, table[C_RECORDED] > 0.0, splines)


@subroutine
def _advance(s, lanes, table, actions, first_lane, splines) -> None:
    """Move the block's AUVs through one control period."""
    period = table[C_PERIOD]
    h = table[C_STEP]
    substeps = int(table[C_SUBSTEPS])
    pulses = int(table[C_PULSES])
    numbers = actions.reshape(actions.size)[3 * first_lane :]
    for j in range(lanes):
        s[j + ACTION_SURGE * STRIDE] = min(max(float(numbers[3 * j + 0]), -1.0), 1.0)
        s[j + ACTION_SWAY * STRIDE] = min(max(float(numbers[3 * j + 1]), -1.0), 1.0)
        s[j + ACTION_YAW * STRIDE] = min(max(float(numbers[3 * j + 2]), -1.0), 1.0)
    surge, sway, yaw = table[C_FORCE_SURGE], table[C_FORCE_SWAY], table[C_FORCE_YAW]
    for j in range(lanes):
        s[j + PUSH_SURGE * STRIDE] = s[j + ACTION_SURGE * STRIDE] * surge * s[j + INVERSE_SURGE * STRIDE]
        s[j + PUSH_SWAY * STRIDE] = s[j + ACTION_SWAY * STRIDE] * sway * s[j + INVERSE_SWAY * STRIDE]
        s[j + PUSH_YAW * STRIDE] = s[j + ACTION_YAW * STRIDE] * yaw * s[j + INVERSE_YAW * STRIDE]

    # The water carries the AUV, and its equation of motion holds for the velocity relative to it.
    if table[C_CURRENT] > 0.0:
        _change_to_water(s, lanes, -1.0)
    if pulses > 0 and mark_pulses(s, lanes, _PULSES, pulses, period):
        for substep in range(substeps):
            apply_pulses(s, lanes, _PULSES, pulses, substep * h, period, h)
            integrate_with_pulses(s, lanes, h, 1)
    else:
        integrate_in_calm(s, lanes, h, substeps)
    _turn_to_heading(s, lanes)
    if table[C_CURRENT] > 0.0:
        _change_to_water(s, lanes, 1.0)
        for j in range(lanes):
            s[j + X * STRIDE] = fma(period, s[j + CURRENT_X * STRIDE], s[j + X * STRIDE])
            s[j + Y * STRIDE] = fma(period, s[j + CURRENT_Y * STRIDE], s[j + Y * STRIDE])

    for j in range(lanes):
        s[j + STEP * STRIDE] += 1.0
        s[j + TIME * STRIDE] = s[j + STEP * STRIDE] * period
    if table[C_CURRENT] > 0.0:
        advance_current(s, lanes, _CURRENT, period)
    _move_ship(s, lanes, table, splines)


@inlined
def _change_to_water(s, lanes, sense) -> None:
    """Add ``sense`` times the current, seen from the body, to surge and sway."""
    for j in range(lanes):
        cx = sense * s[j + CURRENT_X * STRIDE]
        cy = sense * s[j + CURRENT_Y * STRIDE]
        cosine = s[j + COS * STRIDE]
        sine = s[j + SIN * STRIDE]
        s[j + SURGE * STRIDE] += fma(cosine, cx, sine * cy)
        s[j + SWAY * STRIDE] += fma(cosine, cy, -(sine * cx))


@subroutine
def _measure(s, lanes, table) -> None:
    """Evaluate link, errors, reward and end of episode for the present state."""
    q2 = table[C_Q] * table[C_Q]
    ln_threshold = table[C_LN_THRESHOLD]
    ln_ceiling = table[C_LN_CEILING]
    w_rate, w_cone, w_position = table[C_W_RATE], table[C_W_CONE], table[C_W_POSITION]
    w_heading, w_effort = table[C_W_HEADING], table[C_W_EFFORT]
    position_scale, heading_scale = table[C_POSITION_SCALE], table[C_HEADING_SCALE]
    lost_distance, max_steps = table[C_LOST], table[C_MAX_STEPS]
    threshold = math.exp(ln_threshold)
    ceiling = math.exp(ln_ceiling)
    for j in range(lanes):
        dx = s[j + SHIP_X * STRIDE] - s[j + X * STRIDE]
        dy = s[j + SHIP_Y * STRIDE] - s[j + Y * STRIDE]
        depth = s[j + DEPTH * STRIDE]
        distance2 = fma(dx, dx, dy * dy)
        range2 = fma(depth, depth, distance2)
        distance = math.sqrt(distance2)
        range_m = math.sqrt(range2)
        ln_range = 0.5 * log(range2)
        ln_rate = fma(s[j + SLOPE_LOG * STRIDE], ln_range, s[j + LN_RATE * STRIDE])
        ln_rate = fma(s[j + SLOPE_LINEAR * STRIDE], range_m - 1.0, ln_rate)
        ln_rate = fma(s[j + SLOPE_COS * STRIDE], s[j + LN_DEPTH * STRIDE] - ln_range, ln_rate)
        visible = depth >= s[j + COS_FOV * STRIDE] * range_m
        inside = visible and (range_m <= s[j + SLANT * STRIDE])
        above = (min(ln_rate, ln_ceiling) - ln_threshold) * s[j + LEVEL_SCALE * STRIDE]
        level = min(max(above, 0.0), 1.0)
        multiple = exp(ln_rate - ln_threshold) if visible else 0.0
        yaw_error = wrap(s[j + SHIP_YAW * STRIDE] - s[j + YAW * STRIDE])
        in_cone = 1.0 if inside else 0.0
        level = level if visible else 0.0
        s[j + BIT_RATE * STRIDE] = min(multiple * threshold, ceiling)
        s[j + SNR * STRIDE] = multiple * q2
        s[j + RANGE * STRIDE] = range_m
        s[j + POINTING_ERROR * STRIDE] = 2.0 * atan_below_one(distance / (range_m + depth))
        s[j + IN_CONE * STRIDE] = in_cone
        s[j + COST * STRIDE] = 1.0 - in_cone
        s[j + LEVEL * STRIDE] = level
        rate, cone, position, heading, effort = reward_terms(
            level, in_cone, distance, yaw_error,
            s[j + ACTION_SURGE * STRIDE], s[j + ACTION_SWAY * STRIDE], s[j + ACTION_YAW * STRIDE],
            w_rate, w_cone, w_position, w_heading, w_effort, position_scale, heading_scale,
        )  # fmt: skip
        s[j + TERM_BIT_RATE * STRIDE] = rate
        s[j + TERM_IN_CONE * STRIDE] = cone
        s[j + TERM_POSITION * STRIDE] = position
        s[j + TERM_HEADING * STRIDE] = heading
        s[j + TERM_EFFORT * STRIDE] = effort
        s[j + REWARD * STRIDE] = rate + cone + position + heading + effort

        step = s[j + STEP * STRIDE]
        last_outside = s[j + LAST_OUTSIDE * STRIDE] if inside else step
        # Written so that a state that is not a number counts as lost.
        lost = not (distance <= lost_distance)
        late = step >= max_steps
        s[j + LAST_OUTSIDE * STRIDE] = last_outside
        s[j + TERMINATED * STRIDE] = 1.0 if lost else 0.0
        s[j + TRUNCATED * STRIDE] = 1.0 if late else 0.0
        s[j + ENDED * STRIDE] = 1.0 if lost or late else 0.0
        s[j + SUCCESS * STRIDE] = 1.0 if (3.0 * last_outside <= 2.0 * step) and not lost else 0.0
    for j in range(lanes):
        snr = s[j + SNR * STRIDE]
        # Most lanes are either dark or so bright that Q is below the smallest double.
        unsure = 0.0 < snr < 1500.0
        certain = 0.0 if snr > 0.0 else 0.5
        s[j + BER * STRIDE] = 0.5 * math.erfc(math.sqrt(0.5 * snr)) if unsure else certain


@inlined
def _limited(value: float) -> float:
    return min(max(value, -LIMIT), LIMIT)


@subroutine
def _observe(s, lanes, table, observations, first_lane) -> None:
    """Write what the sensors say, scaled, into rows of ``observations``."""
    if table[C_NOISE] > 0.0:
        measure_errors(s, lanes, _SENSORS)
    p = 1.0 / table[C_OBS_POSITION]
    v = 1.0 / table[C_OBS_VELOCITY]
    w = 1.0 / table[C_OBS_YAW_RATE]
    a = 1.0 / table[C_OBS_ACCELERATION]
    b = 1.0 / table[C_OBS_YAW_ACCELERATION]
    noisy = table[C_NOISE] > 0.0
    entries = observations.reshape(observations.size)[SIZE * first_lane :]
    for j in range(lanes):
        cosine = s[j + COS * STRIDE]
        sine = s[j + SIN * STRIDE]
        if noisy:
            es, ec = sincos(s[j + ERROR_YAW * STRIDE])
            cosine, sine = fma(cosine, ec, -(sine * es)), fma(sine, ec, cosine * es)
        dx = s[j + SHIP_X * STRIDE] - s[j + X * STRIDE] - s[j + ERROR_X * STRIDE]
        dy = s[j + SHIP_Y * STRIDE] - s[j + Y * STRIDE] - s[j + ERROR_Y * STRIDE]
        surge = s[j + SURGE * STRIDE] + s[j + ERROR_SURGE * STRIDE]
        sway = s[j + SWAY * STRIDE] + s[j + ERROR_SWAY * STRIDE]
        rate = s[j + YAW_RATE * STRIDE] + s[j + ERROR_YAW_RATE * STRIDE]
        vx = s[j + SHIP_VX * STRIDE]
        vy = s[j + SHIP_VY * STRIDE]
        ax = s[j + SHIP_AX * STRIDE]
        ay = s[j + SHIP_AY * STRIDE]
        ship_cos = s[j + SHIP_COS * STRIDE]
        ship_sin = s[j + SHIP_SIN * STRIDE]
        entries[SIZE * j + 0] = _limited(p * fma(cosine, dx, sine * dy))
        entries[SIZE * j + 1] = _limited(p * fma(cosine, dy, -(sine * dx)))
        entries[SIZE * j + 2] = _within_one(fma(ship_cos, cosine, ship_sin * sine))
        entries[SIZE * j + 3] = _within_one(fma(ship_sin, cosine, -(ship_cos * sine)))
        entries[SIZE * j + 4] = _limited(v * (fma(cosine, vx, sine * vy) - surge))
        entries[SIZE * j + 5] = _limited(v * (fma(cosine, vy, -(sine * vx)) - sway))
        entries[SIZE * j + 6] = _limited(w * (s[j + SHIP_YAW_RATE * STRIDE] - rate))
        entries[SIZE * j + 7] = _limited(v * surge)
        entries[SIZE * j + 8] = _limited(v * sway)
        entries[SIZE * j + 9] = _limited(w * rate)
        entries[SIZE * j + 10] = _limited(a * fma(cosine, ax, sine * ay))
        entries[SIZE * j + 11] = _limited(a * fma(cosine, ay, -(sine * ax)))
        entries[SIZE * j + 12] = _limited(b * s[j + SHIP_YAW_ACCELERATION * STRIDE])
        entries[SIZE * j + 13] = _within_one(cosine)
        entries[SIZE * j + 14] = _within_one(sine)
        entries[SIZE * j + 15] = s[j + ACTION_SURGE * STRIDE]
        entries[SIZE * j + 16] = s[j + ACTION_SWAY * STRIDE]
        entries[SIZE * j + 17] = s[j + ACTION_YAW * STRIDE]
        entries[SIZE * j + 18] = s[j + LEVEL * STRIDE]
        entries[SIZE * j + 19] = s[j + IN_CONE * STRIDE]


@inlined
def _within_one(value: float) -> float:
    return min(max(value, -1.0), 1.0)


@inlined
def _show_start(s, table, observations, lane) -> None:
    _turn_to_heading(s, 1)
    _measure(s, 1, table)
    for row in (ENDED, REWARD, TERMINATED, TRUNCATED, SUCCESS):
        s[row * STRIDE] = 0.0
    _observe(s, 1, table, observations, lane)


@subroutine
def _restart(s, table, splines, observations, lane) -> None:
    """Begin the next episode of the lane at which the view ``s`` begins."""
    s[EPISODE * STRIDE] += 1.0
    _draw_numbers(s, table)
    _begin_episode(s, table, splines)
    _show_start(s, table, observations, lane)


@compiled
def _reset(s, table, splines, lanes, poses, velocities, chosen_rows, chosen, observations):
    """Begin the episode that each of ``lanes`` is marked with; numbers in the other arrays replace drawn ones."""
    rows = int(table[C_ROWS])
    for lane in lanes:
        own = s[lane // LANES * rows * STRIDE + lane % LANES :]
        _draw_numbers(own, table)
        for i, row in enumerate(chosen_rows):
            own[row * STRIDE] = chosen[i, lane]
        _begin_episode(own, table, splines)
        for axis in range(3):
            if poses[lane, axis] == poses[lane, axis]:
                own[(X + axis) * STRIDE] = poses[lane, axis]
            if velocities[lane, axis] == velocities[lane, axis]:
                own[(SURGE + axis) * STRIDE] = velocities[lane, axis]
        _show_start(own, table, observations, lane)


@compiled
def _look(s, table, observations):
    """Observe every lane anew; since errors are a function of the step, this repeats the last observation."""
    rows = int(table[C_ROWS])
    for start in range(0, observations.shape[0], LANES):
        lanes = min(LANES, observations.shape[0] - start)
        _observe(s[start // LANES * rows * STRIDE :], lanes, table, observations, start)


@inlined
def _move(s, lanes, table, splines, actions, observations, first) -> None:
    """One control period of a block: the order in which everything happens."""
    _advance(s, lanes, table, actions, first, splines)
    _measure(s, lanes, table)
    _observe(s, lanes, table, observations, first)


@compiled
def _step_one(s, table, splines, action, observation, out):
    """`_step` for a fleet of one without autoreset, with as few arguments as possible since each costs time."""
    for axis in range(3):
        if not abs(action[axis]) <= _LARGEST:
            return _NOT_FINITE
    if s[ENDED * STRIDE] > 0.0:
        return _HAS_ENDED
    _move(s, 1, table, splines, action, observation, 0)
    for measure in range(MEASURES):
        out[measure] = s[(FIRST_MEASURE + measure) * STRIDE]
    return 0


@compiled
def _step(s, table, splines, actions, observations, out, flags, finals, first, last):
    """Advance lanes ``first`` to ``last``; returns how many episodes ended, or a negative number for what is wrong.

    ``first`` is a multiple of the block's lanes. ``out`` and ``flags`` receive the measures and flags before any
    autoreset in this step, ``finals`` the last observations of episodes that end where autoreset is in the same step.
    """
    rows = int(table[C_ROWS])
    autoreset = int(table[C_AUTORESET])
    numbers = actions.reshape(actions.size)
    bad = 0
    for i in range(3 * first, 3 * last):
        bad += 0 if abs(numbers[i]) <= _LARGEST else 1
    if bad:
        return _NOT_FINITE
    if autoreset == 0:
        for start in range(first, last, LANES):
            row = (start // LANES * rows + ENDED) * STRIDE
            for j in range(min(LANES, last - start)):
                bad += 1 if s[row + j] > 0.0 else 0
        if bad:
            return _HAS_ENDED
    ends = 0
    for start in range(first, last, LANES):
        lanes = min(LANES, last - start)
        block = s[start // LANES * rows * STRIDE :]
        # A lane that ended in the step before begins anew in this one, whose action and reward don't count.
        fresh = 0
        if autoreset == 1:
            for j in range(lanes):
                block[WAS_ENDED * STRIDE + j] = block[ENDED * STRIDE + j]
                fresh += 1 if block[ENDED * STRIDE + j] > 0.0 else 0
        _move(block, lanes, table, splines, actions, observations, start)
        if fresh:
            for j in range(lanes):
                if block[WAS_ENDED * STRIDE + j] > 0.0:
                    _restart(block[j:], table, splines, observations, start + j)
        for measure in range(MEASURES):
            row = (FIRST_MEASURE + measure) * STRIDE
            source = block[row : row + lanes]
            target = out[measure, start : start + lanes]
            for j in range(lanes):
                target[j] = source[j]
        for j in range(lanes):
            flags[0, start + j] = block[TERMINATED * STRIDE + j] > 0.0
            flags[1, start + j] = block[TRUNCATED * STRIDE + j] > 0.0
            flags[2, start + j] = block[IN_CONE * STRIDE + j] > 0.0
            flags[3, start + j] = block[SUCCESS * STRIDE + j] > 0.0
            ends += 1 if block[ENDED * STRIDE + j] > 0.0 else 0
        if autoreset == 2:
            for j in range(lanes):
                if block[ENDED * STRIDE + j] > 0.0:
                    for k in range(SIZE):
                        finals[start + j, k] = observations[start + j, k]
                    _restart(block[j:], table, splines, observations, start + j)
    return ends


def _bounds(value: Number) -> tuple[float, float]:
    low, high = value if isinstance(value, tuple) else (value, value)
    return float(low), float(high)


def _compile_scenario(scenario: Scenario, max_steps: int, autoreset: Autoreset) -> tuple[Array, Array]:
    """The scenario as the kernel reads it: one table of constants and bounds, and the recorded paths' splines."""
    episode, vehicle, reward, seen = scenario.episode, scenario.vehicle, scenario.reward, scenario.observation
    link = scenario.link
    sea, sensors = scenario.sea, scenario.sensors
    paths = scenario.ship_paths
    random, lawn_mower, recorded = kinds_of(paths)
    constants = np.zeros(_CONSTANTS)
    for place, value in {
        C_PERIOD: episode.control_period_s,
        C_STEP: episode.control_period_s / episode.substeps,
        C_SUBSTEPS: episode.substeps,
        C_MAX_STEPS: max_steps,
        C_LOST: episode.lost_distance_m,
        C_AUTORESET: autoreset,
        C_FORCE_SURGE: vehicle.max_surge_force_n,
        C_FORCE_SWAY: vehicle.max_sway_force_n,
        C_FORCE_YAW: vehicle.max_yaw_moment_nm,
        C_CORIOLIS: vehicle.coriolis,
        C_SURFACE: link.background == "surface",
        C_Q: optics.inverse_q_function(link.target_ber),
        C_LN_THRESHOLD: math.log(link.threshold_bit_rate_bps),
        C_LN_CEILING: math.inf if link.max_bit_rate_bps is None else math.log(link.max_bit_rate_bps),
        C_RELATIVE_START: scenario.start.relative_to_ship,
        C_CURRENT: any(_bounds(value)[1] > 0.0 for value in (sea.current.speed_mps, sea.current.std_mps)),
        C_NOISE: any(_bounds(value)[1] > 0.0 for _, value in sensors.numbers()),
        C_PULSES: len(sea.pulses),
        C_RANDOM: random,
        C_LAWN_MOWER: lawn_mower,
        C_RECORDED: recorded,
        C_PATHS: len(paths),
        C_W_RATE: reward.bit_rate,
        C_W_CONE: reward.in_cone,
        C_W_POSITION: reward.position,
        C_W_HEADING: reward.heading,
        C_W_EFFORT: reward.effort,
        C_POSITION_SCALE: reward.position_scale_m,
        C_HEADING_SCALE: reward.heading_scale_rad,
        C_OBS_POSITION: seen.position_scale_m,
        C_OBS_VELOCITY: seen.velocity_scale_mps,
        C_OBS_YAW_RATE: seen.yaw_rate_scale_rad_s,
        C_OBS_ACCELERATION: seen.acceleration_scale_mps2,
        C_OBS_YAW_ACCELERATION: seen.yaw_acceleration_scale_rad_s2,
        C_ROWS: _rows(scenario),
    }.items():
        constants[place] = value

    numbers = [value for _, value in _fixed_parameters(scenario)]
    for pulse in sea.pulses:
        numbers += pulse.pulse_numbers()
    tables = [constants, np.array([_bounds(value) for value in numbers]).ravel()]
    splines = np.empty((0, SPLINE_COLUMNS))
    for path in paths:
        own = path_numbers_with_table(path, splines.shape[0])
        splines = np.concatenate([splines, path.table()])
        padded = own + [0.0] * (PATH_PARAMETERS - len(own))
        tables += [np.array([path.code]), np.array([_bounds(value) for value in padded]).ravel()]
    return np.concatenate(tables), np.ascontiguousarray(splines)


def _drawn_rows(scenario: Scenario) -> dict[str, tuple[int, int]]:
    """Row in a block, and place of its range in the table, of each number that an episode draws, by its path."""
    rows = {path: (FIRST_PARAMETER + i, _CONSTANTS + 2 * i) for i, path in enumerate(_PATHS)}
    for i, pulse in enumerate(scenario.sea.pulses):
        for k, (name, _) in enumerate(pulse.numbers()):
            place = i * PULSE_PARAMETERS + k
            rows[f"sea.pulses[{i}].{name}"] = (_PULSES + place, _CONSTANTS + 2 * (_FIXED + place))
    return rows


def _rows(scenario: Scenario) -> int:
    return _PULSES + len(scenario.sea.pulses) * PULSE_PARAMETERS


class Fleet:
    """N simulations of one scenario, advanced together.

    Args:
        scenario: What to simulate.
        size: Number of simulations N.
        autoreset: What happens after an episode's end.
        max_episode_steps: Steps after which an episode is truncated; by default the scenario's duration.
        threads: Threads that share the blocks of 32 simulations; worth it from several thousand simulations on.

    Raises:
        ValueError: ``size``, ``threads`` or ``max_episode_steps`` is below 1.
    """

    def __init__(
        self,
        scenario: Scenario,
        size: int,
        autoreset: Autoreset = Autoreset.DISABLED,
        max_episode_steps: int | None = None,
        threads: int = 1,
    ) -> None:
        for name, value in (("size", size), ("threads", threads), ("max_episode_steps", max_episode_steps)):
            if value is not None and (value != int(value) or value < 1):
                raise ValueError(f"{name} = {value!r} is not allowed; it must be a whole number of at least 1.")
        self.size = int(size)
        self.autoreset = Autoreset(autoreset)
        self.threads = int(threads)
        self._blocks = -(-self.size // LANES)
        self._pool: ThreadPoolExecutor | None = None
        self._seeded = np.zeros(self.size, dtype=bool)
        self._state = np.zeros(0)
        self._unused = np.zeros((0, SIZE), dtype=np.float32)
        self.configure(scenario, max_episode_steps)

    def configure(self, scenario: Scenario, max_episode_steps: int | None = None) -> None:
        """Change the scenario; takes effect for each simulation when it is next reset, so reset all of them."""
        self.scenario = scenario
        self.max_episode_steps = max_episode_steps or scenario.episode.steps
        self._table, self._splines = _compile_scenario(scenario, self.max_episode_steps, self.autoreset)
        self._drawn_rows = _drawn_rows(scenario)
        rows = _rows(scenario)
        old = self._state
        self._state = np.zeros(self._blocks * rows * STRIDE)
        self._by_row = self._state.reshape(self._blocks, rows, STRIDE)[:, :, :LANES]
        if old.size:
            # Pulses come last, so that all other rows keep their places when their number changes.
            before = old.reshape(self._blocks, -1, STRIDE)
            kept = min(rows, before.shape[1])
            self._state.reshape(self._blocks, rows, STRIDE)[:, :kept] = before[:, :kept]

    def row(self, index: int) -> Array:
        """A copy of one row of the blocks over all simulations, shape (N,)."""
        return self._by_row[:, index].reshape(-1)[: self.size].copy()

    def _set_row(self, index: int, lanes: npt.NDArray[np.int64], values: npt.ArrayLike) -> None:
        self._by_row[lanes // LANES, index, lanes % LANES] = values

    @property
    def single(self) -> Array:
        """A live view of the measures of simulation 0, shape (16,), in the order of `MEASURE_NAMES`."""
        return self._by_row[0, FIRST_MEASURE : FIRST_MEASURE + MEASURES, 0]

    def seed(self, lanes: npt.NDArray[np.int64], seeds: list[int]) -> None:
        """Give simulations their seeds; their next reset begins episode 0."""
        keys = np.array([key_from_seed(seed) for seed in seeds], dtype=float).reshape(-1, 2)
        self._set_row(KEY_0, lanes, keys[:, 0])
        self._set_row(KEY_1, lanes, keys[:, 1])
        self._set_row(EPISODE, lanes, -1.0)
        self._seeded[lanes] = True

    def reset(
        self,
        observations: npt.NDArray[np.float32],
        lanes: npt.NDArray[np.int64] | None = None,
        pose: npt.ArrayLike | None = None,
        velocity: npt.ArrayLike | None = None,
        parameters: Mapping[str, npt.ArrayLike] | None = None,
    ) -> None:
        """Begin the next episode of each of ``lanes`` (all by default) and write its observation.

        Args:
            observations: Written to, shape (N, 20); other lanes' rows stay.
            lanes: Indices of the simulations to reset.
            pose: Start pose, shape (3,) or (N, 3) [m, m, rad] in the earth frame, instead of the scenario's.
            velocity: Start velocity, shape (3,) or (N, 3) [m/s, m/s, rad/s], instead of the scenario's.
            parameters: Numbers to take instead of drawing them, by their names in `drawn`: one, or one per
                simulation. Each must lie in the range that the scenario draws from.

        Raises:
            ValueError: ``pose`` or ``velocity`` has another shape or isn't finite, or one of ``parameters`` is unknown,
                of another shape or out of range; nothing has changed.
        """
        which = np.arange(self.size) if lanes is None else lanes
        if not self._seeded[which].all():
            raise ValueError("every simulation needs a seed before its first reset.")
        poses = self._start_values("pose", pose)
        velocities = self._start_values("velocity", velocity)
        rows, chosen = self._chosen(parameters or {})
        self._set_row(EPISODE, which, self._by_row[which // LANES, EPISODE, which % LANES] + 1.0)
        _reset(self._state, self._table, self._splines, which, poses, velocities, rows, chosen, observations)

    def _chosen(self, parameters: Mapping[str, npt.ArrayLike]) -> tuple[npt.NDArray[np.int64], Array]:
        """Rows and values, one per simulation, of the numbers that aren't to be drawn."""
        if not isinstance(parameters, Mapping) or not all(isinstance(name, str) for name in parameters):
            raise ValueError(f"options['parameters'] = {parameters!r} is not allowed; it must be a mapping of names.")
        rows = np.zeros(len(parameters), dtype=np.int64)
        chosen = np.zeros((len(parameters), self.size))
        for i, (name, value) in enumerate(parameters.items()):
            field = f"options['parameters'][{name!r}]"
            if name not in self._drawn_rows:
                raise ValueError(f"{field} is not known; {closest(name, list(self._drawn_rows))}")
            rows[i], place = self._drawn_rows[name]
            low, high = self._table[place : place + 2]
            try:
                array = np.asarray(value, dtype=float)
            except (TypeError, ValueError):
                array = np.empty(0)
            if array.shape not in ((), (self.size,)) or not ((low <= array) & (array <= high)).all():
                shapes = "a number" if self.size == 1 else f"a number or of shape ({self.size},)"
                raise ValueError(
                    f"{field} = {value!r} is not allowed; it must be {shapes}, in the range [{low:g}, {high:g}] that "
                    "the scenario draws it from."
                )
            chosen[i] = array
        return rows, chosen

    @property
    def begun(self) -> bool:
        """Whether any simulation has been reset."""
        return bool((self.row(EPISODE)[self._seeded] >= 0.0).any())

    def push(self, lanes: npt.NDArray[np.int64], impulse: npt.ArrayLike) -> None:
        """Change the AUVs' velocities at once, by an impulse over their true masses.

        Args:
            lanes: Indices of the simulations to push.
            impulse: Along surge, along sway and about yaw, shape (3,) [N s, N s, N m s].

        Raises:
            ValueError: The impulse has another shape or isn't finite; nothing has moved.
        """
        try:
            given = np.asarray(impulse, dtype=float)
        except (TypeError, ValueError):
            given = np.empty(0)
        if given.shape != (3,) or not np.isfinite(given).all():
            raise ValueError(f"impulse = {impulse!r} is not allowed; it must be finite and of shape (3,).")
        rows = ((SURGE, INVERSE_SURGE), (SWAY, INVERSE_SWAY), (YAW_RATE, INVERSE_YAW))
        for own, (velocity, inverse) in zip(given, rows, strict=True):
            before = self._by_row[lanes // LANES, velocity, lanes % LANES]
            self._set_row(velocity, lanes, before + own * self._by_row[lanes // LANES, inverse, lanes % LANES])

    def _start_values(self, name: str, value: npt.ArrayLike | None) -> Array:
        if value is None:
            return np.full((self.size, 3), np.nan)
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape not in ((3,), (self.size, 3)) or not np.isfinite(array).all():
            shapes = "(3,)" if self.size == 1 else f"(3,) or ({self.size}, 3)"
            raise ValueError(f"options[{name!r}] = {value!r} is not allowed; it must be finite and of shape {shapes}.")
        return np.ascontiguousarray(np.broadcast_to(array, (self.size, 3)))

    def observe(self) -> npt.NDArray[np.float32]:
        """The present observation of every simulation, noise included, shape (N, 20)."""
        observations = np.empty((self.size, SIZE), dtype=np.float32)
        _look(self._state, self._table, observations)
        return observations

    def step(
        self,
        actions: npt.NDArray[np.float32],
        observations: npt.NDArray[np.float32],
        out: Array,
        flags: npt.NDArray[np.bool_],
        finals: npt.NDArray[np.float32] | None = None,
    ) -> int:
        """Advance every simulation by one control period.

        The arrays' shapes and types are the caller's promise: at this rate of calls they aren't checked.

        Args:
            actions: Shape (N, 3), float32; clipped to [-1, 1] and scaled by the actuators' limits.
            observations: Written to, shape (N, 20), float32.
            out: Written to, shape (16, N): the measures before any autoreset, in the order of `MEASURE_NAMES`.
            flags: Written to, shape (4, N): terminated, truncated, in the cone, success, before any autoreset.
            finals: Written to where a simulation ended and began anew in this step, shape (N, 20), float32.

        Returns:
            How many episodes ended in this step.

        Raises:
            ValueError: An action isn't finite; nothing has moved.
            RuntimeError: An episode has ended and autoreset is disabled; nothing has moved.
        """
        last_observations = self._unused if finals is None else finals
        arguments = (self._state, self._table, self._splines, actions, observations, out, flags, last_observations)
        if self.threads == 1 or self._blocks == 1:
            ends: int = _step(*arguments, 0, self.size)
        else:
            ends = self._step_in_threads(arguments)
        if ends < 0:
            self._refuse(ends, actions)
        return ends

    def stepper(self) -> Callable[[npt.NDArray[np.float32], npt.NDArray[np.float32]], list[float]]:
        """A quick `step` for a fleet of one without autoreset, valid until the next `configure`.

        The function takes an action of shape (3,) and the observation to write, of shape (20,), both contiguous
        float32, and returns the measures in the order of `MEASURE_NAMES`.
        """
        out = np.empty(MEASURES)
        state, table, splines = self._state, self._table, self._splines

        def step(action: npt.NDArray[np.float32], observation: npt.NDArray[np.float32]) -> list[float]:
            if _step_one(state, table, splines, action, observation, out):
                self._refuse(_HAS_ENDED if np.isfinite(action).all() else _NOT_FINITE, action.reshape(1, 3))
            return out.tolist()

        return step

    def _step_in_threads(self, arguments: tuple[Any, ...]) -> int:
        if not np.isfinite(arguments[3]).all():
            return _NOT_FINITE
        if self.autoreset is Autoreset.DISABLED and self.row(ENDED).any():
            return _HAS_ENDED
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads)
        share = -(-self._blocks // self.threads) * LANES
        starts = range(0, self.size, share)
        step: Callable[..., int] = _step
        jobs = [self._pool.submit(step, *arguments, start, min(start + share, self.size)) for start in starts]
        return sum(job.result() for job in jobs)

    def _refuse(self, status: int, actions: npt.NDArray[np.float32]) -> None:
        if status == _NOT_FINITE:
            index = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            raise ValueError(
                f"action {actions[index].tolist()} of simulation {index} is not allowed; it must be finite "
                "(numbers beyond [-1, 1] are clipped)."
            )
        ended = np.flatnonzero(self.row(ENDED)).tolist()
        raise RuntimeError(f"the episodes of simulations {ended[:10]} have ended; reset them before stepping on.")

    def close(self) -> None:
        """End the threads, if there are any."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None, "_by_row": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        rows = _rows(self.scenario)
        self._by_row = self._state.reshape(self._blocks, rows, STRIDE)[:, :, :LANES]

    def measures(self) -> Array:
        """The present measures of all simulations, shape (16, N), in the order of `MEASURE_NAMES`."""
        rows = self._by_row[:, FIRST_MEASURE : FIRST_MEASURE + MEASURES]
        return rows.transpose(1, 0, 2).reshape(MEASURES, -1)[:, : self.size].copy()

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The true state by name, each with a first axis of length N; see `TrackingEnv.state` for the entries."""
        get = self.row
        limits = self.scenario.vehicle.force_limits
        return {
            "time_s": get(TIME),
            "pose": np.stack([get(X), get(Y), get(YAW)], axis=-1),
            "velocity": np.stack([get(SURGE), get(SWAY), get(YAW_RATE)], axis=-1),
            "depth_m": get(DEPTH),
            "ship_pose": np.stack([get(SHIP_X), get(SHIP_Y), get(SHIP_YAW)], axis=-1),
            "ship_velocity": np.stack([get(SHIP_VX), get(SHIP_VY), get(SHIP_YAW_RATE)], axis=-1),
            "ship_acceleration": np.stack([get(SHIP_AX), get(SHIP_AY), get(SHIP_YAW_ACCELERATION)], axis=-1),
            "current": np.stack([get(CURRENT_X), get(CURRENT_Y)], axis=-1),
            "force": np.stack([get(ACTION_SURGE), get(ACTION_SWAY), get(ACTION_YAW)], axis=-1) * limits,
            "bit_rate_bps": get(BIT_RATE),
            "snr": get(SNR),
            "ber": get(BER),
            "range_m": get(RANGE),
            "pointing_error_rad": get(POINTING_ERROR),
            "in_cone": get(IN_CONE) > 0.0,
            "slant_height_m": get(SLANT),
        }

    def drawn(self) -> dict[str, Array]:
        """What the present episodes have drawn for each number of the scenario, by its path, each of shape (N,)."""
        return {path: self.row(row) for path, (row, _) in self._drawn_rows.items()}


MEASURE_NAMES = (
    "bit_rate_bps", "snr", "ber", "range_m", "pointing_error_rad", "in_cone", "cost",
    "reward_bit_rate", "reward_in_cone", "reward_position", "reward_heading", "reward_effort",
    "is_success", "reward", "terminated", "truncated",
)  # fmt: skip
"""Names of the measures that a step writes out, in their order."""
