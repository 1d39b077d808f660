"""What stands between the observations and a law: the ship's state now, made of what was observed until now."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from uwoc_gym.scenario import Scenario
from uwoc_gym.task.observation import FIX_AGE_S, LIMIT, Measured

Array = npt.NDArray[np.float64]
Memory = tuple[npt.NDArray[Any], ...] | None


class Observer(Protocol):
    """Completes what is measured."""

    def __call__(self, seen: Measured, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
        """What a law can fly on, and the memory for the next observation.

        Args:
            seen: What N observations say.
            memory: What the last call gave back, which this one may change in place; None at the beginning.
            begun: Which of them begin an episode, (N,).
        """
        ...


def as_seen(seen: Measured, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
    """What is observed is enough."""
    return seen, memory


def in_turn(first: Observer, second: Observer) -> Observer:
    """Two observers, the second of which sees what the first has completed."""

    def both(seen: Measured, memory: Any, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
        # How many arrays the first one remembers stands before them, so that a memory stays a tuple of arrays (N, ...).
        count = 0 if memory is None else int(memory[0][0])
        before = (None, None) if memory is None else (memory[1 : 1 + count] or None, memory[1 + count :])
        known: Any
        known, own = first(seen, before[0], begun)
        known, others = second(known, before[1], begun)
        kept = own or ()
        return known, (np.full(len(known.velocity), len(kept)), *kept, *(others or ()))

    return both


class Heard(NamedTuple):
    """A fix among the AUV's own places, in a frame with the earth's axes that begins where the AUV did."""

    place: Array
    """Where the AUV is, (N, 3) [m, m, rad]."""
    ship: Array
    """Where the ship was at the ping of the last fix, (N, 3) [m, m, rad]."""
    ping_s: Array
    """When that was, since the beginning, (N,) [s]."""
    age_s: Array
    """How long that is ago, (N,) [s]."""
    told: npt.NDArray[np.bool_]
    """Whether this observation brought it, (N,)."""
    begun: npt.NDArray[np.bool_]
    """Whether an episode begins with it, (N,)."""


class DeadReckoning:
    """The AUV's own way, as the sum of its velocities, and where fixes lie on it.

    The way is kept for as long as the age of a fix can be told.

    Args:
        scenario: What is known of the scenario: its control period counts.
    """

    needed = ("velocity", "heading")
    """The groups of observations that it sums up."""

    def __init__(self, scenario: Scenario) -> None:
        self._period_s = scenario.episode.control_period_s
        self._kept = round(LIMIT * FIX_AGE_S / self._period_s) + 1

    def __call__(self, seen: Any, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Heard, Memory]:
        """Go on by one observation; see `Observer`."""
        lanes = np.arange(len(seen.velocity))
        if memory is None:
            shapes: list[tuple[int, ...]] = [(), (3,), (2,), (self._kept, 3), (3,)]
            memory = tuple(np.zeros((lanes.size, *shape)) for shape in shapes)
            begun = np.ones(lanes.size, dtype=bool)
        step, place, moving, trail, ship = memory
        begins = np.zeros(lanes.size, dtype=bool) if begun is None else np.asarray(begun, dtype=bool)
        yaw = np.arctan2(seen.heading[:, 1], seen.heading[:, 0])
        ground = turned(seen.velocity[:, :2], yaw)
        step[:] = np.where(begins, 0.0, step + 1.0)
        place[:, :2] += np.where(begins[:, None], 0.0, 0.5 * self._period_s * (moving + ground))
        place[:, 2] = yaw
        moving[:] = ground
        trail[lanes, step.astype(int) % self._kept] = place
        told = begins | (seen.fix_is_new > 0.5)
        since = np.clip(np.round(seen.fix_age_s / self._period_s), 0.0, np.minimum(step, self._kept - 1))
        ping = trail[lanes, (step - since).astype(int) % self._kept]
        heard = np.concatenate(
            [ping[:, :2] + turned(seen.fix_position, ping[:, 2]), (ping[:, 2] + seen.fix_yaw_error)[:, None]], axis=1
        )
        ship[:] = np.where(told[:, None], heard, ship)
        return Heard(place, ship, step * self._period_s - seen.fix_age_s, seen.fix_age_s, told, begins), memory


class CarriedFixes:
    """The ship stands still where the last fix says; what the AUV has done since its ping is worked out.

    Args:
        scenario: What is known of the scenario.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._reckon = DeadReckoning(scenario)

    def __call__(self, seen: Measured, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
        """See `Observer`."""
        heard, memory = self._reckon(seen, memory, begun)
        still = np.zeros_like(heard.ship)
        return completed(seen, heard.place, heard.ship, still, still), memory


def completed(seen: Any, place: Array, ship: Array, velocity: Array, acceleration: Array) -> Measured:
    """What a law can fly on where the ship's pose, velocity and acceleration in the frame of `Heard` are believed."""
    yaw = place[:, 2]
    moving, gaining = (
        np.concatenate([turned(each[:, :2], -yaw), each[:, 2:]], axis=1) for each in (velocity, acceleration)
    )
    found: Measured = seen._replace(
        relative_position=turned(ship[:, :2] - place[:, :2], -yaw),
        yaw_error=wrapped(ship[:, 2] - yaw),
        relative_velocity=moving - seen.velocity,
        ship_acceleration=gaining,
    )
    return found


def turned(vector: Array, angle: Array) -> Array:
    """Vectors, (N, 2), turned by angles, (N,) [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vector[:, 0], vector[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)


def wrapped(angle: Array) -> Array:
    """Angles [rad] in (-π, π]."""
    return np.arctan2(np.sin(angle), np.cos(angle))
