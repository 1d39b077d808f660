"""The order of events in the paper's worlds, compiled: what happens in a reset, a step and a rollout.

The functions here are lists of calls of the effects' kernel functions, each in a loop over the lanes of a block. The
loops are short and many because such loops vectorise; lanes never look at each other except to skip work.
"""

from __future__ import annotations

import numpy as np

from uwoc_gym.compute.compiled import compiled, inlined, pasted, subroutine
from uwoc_gym.compute.elementary import whole
from uwoc_gym.compute.records import LANES, STRIDE, record_at
from uwoc_gym.compute.rng import STREAM, draw
from uwoc_gym.sim.layout import (
    BLOCK,
    BLOCK_DOUBLES,
    DRAW,
    DRAW_DOUBLES,
    DRAWN_SHIP,
    FIRST_OUT,
    FLAG_ROWS,
    OUT_ROWS,
    ROW,
    WORLD,
)
from uwoc_gym.task import action, ending, observation, reward
from uwoc_gym.world.auv import fixes, horizontal, sensors, start
from uwoc_gym.world.optics import link
from uwoc_gym.world.sea import current, pulses
from uwoc_gym.world.ship import paths

_LARGEST = np.finfo(np.float32).max
NOT_FINITE = -1
HAS_ENDED = -2
WRONG_SIZE = -3
_CHOICE, _AFTER_SHIP = DRAWN_SHIP
_ENDED = ROW["ending.ended"]


@subroutine
def _draw_numbers(memory, world, s, b, j, alternative) -> None:
    """Draw lane ``j``'s numbers for its episode; ``alternative`` is that of the ship's path, or −1 to draw it too."""
    for row in range(_CHOICE, _AFTER_SHIP):
        s[row * STRIDE + j] = 0.0
    for place in range(int(world.layout.draws), int(world.layout.observed), DRAW_DOUBLES):
        own = record_at(memory, place, DRAW)
        row = int(own.row)
        if own.only >= 0.0 and own.only != b.drawn.ship.choice[j]:
            continue
        value = own.low
        if row == _CHOICE and alternative >= 0.0:
            value = alternative
        elif own.low < own.high:
            u, _, _, _ = draw(b, j, STREAM, own.step, own.index)
            value = _pick_place(int(own.mask), u) if own.mask > 0.0 else own.low + (own.high - own.low) * u
        s[row * STRIDE + j] = value


@inlined
def _pick_place(mask, u):
    """The place of one of the bits that are set, all alike."""
    count = 0
    bits = mask
    while bits > 0:
        count += bits & 1
        bits >>= 1
    wanted = int(u * count)
    place = -1
    while wanted >= 0:
        place += 1
        wanted -= (mask >> place) & 1
    return float(place)


@subroutine
def _begin_episode(memory, world, b, j, at_step) -> None:
    """Put the lane at the beginning, or a later step, of the episode whose numbers it has drawn."""
    ending.begin(b, j, at_step, world)
    action.begin(b, j)
    sensors.begin(b, j, world)
    if world.observation.fix > 0.0:
        fixes.begin(b, j)
    horizontal.begin(b, j, world)
    link.begin(b, j, world)
    paths.begin(b, j, world)
    current.begin(b, j, world)
    _move_ship(memory, world, b, j, j + 1)
    start.begin(b, j, world)


@pasted
def _move_ship(memory, world, b, first, last) -> None:
    """Write the motion of the lanes' ships at their time."""
    for j in range(first, last):
        paths.sail(b, j)
    if world.ship.random > 0.0:
        for j in range(first, last):
            paths.wander(b, j)
    if world.ship.lawn_mower > 0.0:
        for j in range(first, last):
            paths.follow_legs(b, j)
    if world.ship.recorded > 0.0:
        for j in range(first, last):
            if b.drawn.ship.kind[j] == paths.RECORDED:
                paths.follow_record(b, j, memory, int(world.layout.segments))
    for j in range(first, last):
        paths.turn_to_heading(b, j)


@pasted
def _advance(memory, world, s, b, lanes, numbers, first_lane) -> None:
    """Move the block's AUVs, ships and water through one control period."""
    period = world.episode.control_period_s
    h = world.episode.step_s
    substeps = int(world.episode.substeps)
    if world.scenario.action == action.WRENCH:
        for j in range(lanes):
            action.take_wrench(b, j, numbers, first_lane + j, world)
    elif world.scenario.action == action.SURGE_YAW:
        for j in range(lanes):
            action.take_surge_yaw(b, j, numbers, first_lane + j, world)
    for j in range(lanes):
        horizontal.actuate(b, j, world)

    flows = world.current.acts > 0.0
    if flows:
        for j in range(lanes):
            horizontal.calm(b, j)
            current.flow(b, j, world)
            horizontal.change_to_water(b, j, -1.0)
    end = int(world.layout.block_doubles)
    pushed = False
    for place in range(BLOCK_DOUBLES, end, pulses.DOUBLES):
        for j in range(lanes):
            pushed |= pulses.touches(b, j, record_at(s, place, pulses.PULSE), world)
    if pushed:
        for substep in range(substeps):
            for j in range(lanes):
                horizontal.release(b, j)
                pulses.push(b, j, s, BLOCK_DOUBLES, end, substep * h, h, world)
            for j in range(lanes):
                horizontal.integrate_pushed(b, j, h)
    else:
        for _ in range(substeps):
            for j in range(lanes):
                horizontal.integrate_in_calm(b, j, h)
    diverged = False
    for j in range(lanes):
        followed = horizontal.follows(b, j)
        b.ending.diverged[j] = 0.0 if followed else 1.0
        diverged |= not followed
    if diverged:
        for j in range(lanes):
            if b.ending.diverged[j] > 0.0:
                horizontal.give_up(b, j, 2.0 * world.episode.lost_distance_m)
    for j in range(lanes):
        horizontal.turn_to_heading(b, j)
    if flows:
        for j in range(lanes):
            horizontal.change_to_water(b, j, 1.0)
            horizontal.carry(b, j, period)

    for j in range(lanes):
        ending.tick(b, j, world)
    if flows:
        for j in range(lanes):
            current.advance(b, j, world)
    _move_ship(memory, world, b, whole(0), lanes)


@pasted
def _judge(world, b, first, last) -> None:
    """Evaluate all that reward, ending and observation depend on."""
    for j in range(first, last):
        link.measure(b, j, world)
    for j in range(first, last):
        reward.pay(b, j, world)
        ending.judge(b, j, world)


@pasted
def _show(memory, world, s, b, first, last, entries, first_lane) -> None:
    """Work out what only `info` shows, and what the sensors say; write the latter to ``entries``."""
    for j in range(first, last):
        link.report(b, j, world)
    for j in range(first, last):
        link.report_errors(b, j, world)
    _observe(memory, world, s, b, first, last, entries, first_lane)


@pasted
def _observe(memory, world, s, b, first, last, entries, first_lane) -> None:
    if world.sensors.acts > 0.0:
        for j in range(first, last):
            sensors.see(b, j)
    else:
        for j in range(first, last):
            sensors.see_exactly(b, j)
    for j in range(first, last):
        observation.observe(b, j, world)
    if world.observation.time > 0.0:
        for j in range(first, last):
            observation.observe_time(b, j, world)
    if world.observation.fix > 0.0:
        for j in range(first, last):
            fixes.listen(b, j)
        for j in range(first, last):
            observation.observe_fix(b, j, world)
    active = memory[int(world.layout.observed) : int(world.layout.segments)]
    for k in range(active.size):
        row = int(active[k]) * STRIDE
        place = active.size * (first_lane - first) + k
        for j in range(first, last):
            entries[place + active.size * j] = s[row + j]


@subroutine
def _show_start(memory, world, s, b, j, entries, lane) -> None:
    horizontal.turn_to_heading(b, j)
    _judge(world, b, j, j + 1)
    ending.show_start(b, j)
    _show(memory, world, s, b, j, j + 1, entries, lane)


@subroutine
def _restart(memory, world, s, b, j, entries, lane) -> None:
    """Begin the lane's next episode."""
    b.random.episode[j] += 1.0
    _draw_numbers(memory, world, s, b, j, -1.0)
    _begin_episode(memory, world, b, j, 0.0)
    _show_start(memory, world, s, b, j, entries, lane)


@compiled
def reset(memory, lanes, at_step, poses, velocities, alternatives, rows, only, chosen, observations):
    """Begin the episode that each of ``lanes`` is marked with, at the step ``at_step``.

    Numbers in the other arrays, one a lane, replace drawn ones: the ship's path where ``alternatives`` isn't negative,
    poses and velocities that are numbers, and ``chosen`` for each of ``rows`` that belongs to the path.
    """
    world = record_at(memory, 0, WORLD)
    size = int(world.layout.block_doubles)
    blocks = memory[int(world.layout.blocks) :]
    entries = observations.reshape(observations.size)
    for lane in lanes:
        s = blocks[lane // LANES * size :]
        b = record_at(s, 0, BLOCK)
        j = lane % LANES
        _draw_numbers(memory, world, s, b, j, alternatives[lane])
        for i in range(rows.size):
            if only[i] < 0 or only[i] == b.drawn.ship.choice[j]:
                s[rows[i] * STRIDE + j] = chosen[i, lane]
        _begin_episode(memory, world, b, j, at_step)
        a = b.auv
        if poses[lane, 0] == poses[lane, 0]:
            a.x[j], a.y[j], a.yaw[j] = poses[lane, 0], poses[lane, 1], poses[lane, 2]
        if velocities[lane, 0] == velocities[lane, 0]:
            a.surge[j], a.sway[j], a.yaw_rate[j] = velocities[lane, 0], velocities[lane, 1], velocities[lane, 2]
        _show_start(memory, world, s, b, j, entries, lane)


@compiled
def look(memory, observations):
    """Observe every lane anew; since errors are a function of the step, this repeats the last observation."""
    world = record_at(memory, 0, WORLD)
    size = int(world.layout.block_doubles)
    blocks = memory[int(world.layout.blocks) :]
    entries = observations.reshape(observations.size)
    for start_lane in range(0, observations.shape[0], LANES):
        s = blocks[start_lane // LANES * size :]
        b = record_at(s, 0, BLOCK)
        _observe(memory, world, s, b, whole(0), min(LANES, observations.shape[0] - start_lane), entries, start_lane)


@subroutine
def _fly(memory, world, s, b, lanes, numbers, first_lane) -> None:
    """One control period of a block, and what it comes to."""
    _advance(memory, world, s, b, lanes, numbers, first_lane)
    _judge(world, b, whole(0), lanes)


@subroutine
def _present(memory, world, s, b, lanes, entries, first_lane) -> None:
    _show(memory, world, s, b, whole(0), lanes, entries, first_lane)


@compiled
def step_one(memory, act, seen):
    """`step` for a fleet of one without autoreset, with as few arguments as possible since each costs time."""
    world = record_at(memory, 0, WORLD)
    if act.size != action.WIDTHS[int(world.scenario.action)]:
        return WRONG_SIZE
    for i in range(act.size):
        if not abs(act[i]) <= _LARGEST:
            return NOT_FINITE
    s = memory[int(world.layout.blocks) :]
    b = record_at(s, 0, BLOCK)
    if b.ending.ended[0] > 0.0:
        return HAS_ENDED
    _advance(memory, world, s, b, whole(1), act, whole(0))
    _judge(world, b, whole(0), whole(1))
    _show(memory, world, s, b, whole(0), whole(1), seen, whole(0))
    return 0


@compiled
def step(memory, actions, observations, out, flags, finals, first, last):
    """Advance lanes ``first`` to ``last``; returns how many episodes ended, or a negative number for what is wrong.

    ``first`` is a multiple of the block's lanes. ``out`` and ``flags`` receive the measures and flags before any
    autoreset in this step, ``finals`` the last observations of episodes that end where autoreset is in the same step.
    """
    world = record_at(memory, 0, WORLD)
    size = int(world.layout.block_doubles)
    autoreset = int(world.layout.autoreset)
    blocks = memory[int(world.layout.blocks) :]
    numbers = actions.reshape(actions.size)
    entries = observations.reshape(observations.size)
    width = actions.shape[1]
    bad = 0
    for i in range(width * first, width * last):
        bad += 0 if abs(numbers[i]) <= _LARGEST else 1
    if bad:
        return NOT_FINITE
    if autoreset == 0:
        for begin in range(first, last, LANES):
            row = begin // LANES * size + _ENDED * STRIDE
            for j in range(min(LANES, last - begin)):
                bad += 1 if blocks[row + j] > 0.0 else 0
        if bad:
            return HAS_ENDED
    ends = 0
    for begin in range(first, last, LANES):
        lanes = min(LANES, last - begin)
        s = blocks[begin // LANES * size :]
        b = record_at(s, 0, BLOCK)
        # A lane that ended in the step before begins anew in this one, whose action and reward don't count.
        fresh = 0
        if autoreset == 1:
            for j in range(lanes):
                b.ending.was_ended[j] = b.ending.ended[j]
                fresh += 1 if b.ending.ended[j] > 0.0 else 0
        _fly(memory, world, s, b, lanes, numbers, begin)
        _present(memory, world, s, b, lanes, entries, begin)
        if fresh:
            for j in range(lanes):
                if b.ending.was_ended[j] > 0.0:
                    _restart(memory, world, s, b, j, entries, begin + j)
        for i in range(OUT_ROWS):
            row = (FIRST_OUT + i) * STRIDE
            source = s[row : row + lanes]
            target = out[i, begin : begin + lanes]
            for j in range(lanes):
                target[j] = source[j]
        for i in range(len(FLAG_ROWS)):
            row = FLAG_ROWS[i] * STRIDE
            source = s[row : row + lanes]
            told = flags[i, begin : begin + lanes]
            for j in range(lanes):
                told[j] = source[j] > 0.0
        for j in range(lanes):
            ends += 1 if b.ending.ended[j] > 0.0 else 0
        if autoreset == 2:
            for j in range(lanes):
                if b.ending.ended[j] > 0.0:
                    for k in range(observations.shape[1]):
                        finals[begin + j, k] = observations[begin + j, k]
                    _restart(memory, world, s, b, j, entries, begin + j)
    return ends


@compiled
def rollout(memory, scratch, roots, actions, returns, rewards, distances, linked):
    """Fly copies of ``roots`` through ``actions`` in a block of scratch memory; see `Fleet.rollout`."""
    world = record_at(memory, 0, WORLD)
    s = scratch
    b = record_at(s, 0, BLOCK)
    horizon, flights, _ = actions.shape
    for begin in range(0, flights, LANES):
        lanes = min(LANES, flights - begin)
        for row in range(roots.shape[1]):
            for j in range(lanes):
                s[row * STRIDE + j] = roots[min(begin + j, roots.shape[0] - 1), row]
        for j in range(lanes):
            returns[begin + j] = 0.0
            linked[begin + j] = 0
            rewards[begin + j] = b.outcome.reward[j]
            distances[begin + j] = b.link.distance_m[j]
        for t in range(horizon):
            moment = actions[t]
            numbers = moment.reshape(moment.size)
            for j in range(lanes):
                b.ending.was_ended[j] = b.ending.ended[j]
            _fly(memory, world, s, b, lanes, numbers, begin)
            for j in range(lanes):
                if b.ending.was_ended[j] > 0.0:
                    b.ending.ended[j] = 1.0
                else:
                    returns[begin + j] += b.outcome.reward[j]
                    rewards[begin + j] = b.outcome.reward[j]
                    distances[begin + j] = b.link.distance_m[j]
                    linked[begin + j] += 1 if b.measure.in_cone[j] > 0.0 else 0
