"""What stands between the observations and a law: the ship's state now, made of what was observed until now."""

from __future__ import annotations

from typing import Any, Protocol

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
            memory: What the last call gave back; None at the beginning.
            begun: Which of them begin an episode, (N,).
        """
        ...


def as_seen(seen: Measured, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
    """What is observed is enough."""
    return seen, memory


class CarriedFixes:
    """The ship stands still where the last fix says; what the AUV has done since its ping is worked out.

    The AUV's way is the sum of its velocities in the frame of its own heading (dead reckoning), and is kept for as long
    as the age of a fix can be told. The memory is changed in place.

    Args:
        scenario: What is known of the scenario: its control period counts.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._period_s = scenario.episode.control_period_s
        self._kept = round(LIMIT * FIX_AGE_S / self._period_s) + 1

    def __call__(self, seen: Measured, memory: Memory, begun: npt.NDArray[np.bool_] | None) -> tuple[Measured, Memory]:
        """See `Observer`; of the ship's velocity and acceleration it knows nothing."""
        known: Any = seen
        lanes = np.arange(len(known.velocity))
        if memory is None:
            shapes: list[tuple[int, ...]] = [(), (3,), (2,), (self._kept, 3), (3,)]
            memory = tuple(np.zeros((lanes.size, *shape)) for shape in shapes)
            begun = np.ones(lanes.size, dtype=bool)
        step, place, moving, trail, ship = memory
        begins = np.zeros(lanes.size, dtype=bool) if begun is None else np.asarray(begun, dtype=bool)
        yaw = np.arctan2(known.heading[:, 1], known.heading[:, 0])
        ground = turned(known.velocity[:, :2], yaw)
        step[:] = np.where(begins, 0.0, step + 1.0)
        place[:, :2] += np.where(begins[:, None], 0.0, 0.5 * self._period_s * (moving + ground))
        place[:, 2] = yaw
        moving[:] = ground
        trail[lanes, step.astype(int) % self._kept] = place
        told = begins | (known.fix_is_new > 0.5)
        since = np.clip(np.round(known.fix_age_s / self._period_s), 0.0, np.minimum(step, self._kept - 1))
        ping = trail[lanes, (step - since).astype(int) % self._kept]
        heard = np.concatenate(
            [ping[:, :2] + turned(known.fix_position, ping[:, 2]), (ping[:, 2] + known.fix_yaw_error)[:, None]], axis=1
        )
        ship[:] = np.where(told[:, None], heard, ship)
        return (
            seen._replace(
                relative_position=turned(ship[:, :2] - place[:, :2], -yaw),
                yaw_error=np.angle(np.exp(1j * (ship[:, 2] - yaw))),
                relative_velocity=-known.velocity,
                ship_acceleration=np.zeros_like(known.velocity),
            ),
            memory,
        )


def turned(vector: Array, angle: Array) -> Array:
    """Vectors, (N, 2), turned by angles, (N,) [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vector[:, 0], vector[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
