"""Measures of an episode, from its recorded time series.

Series are arrays of shape (T + 1, N): N episodes sampled at the start and after each of T steps. An episode that ended
early is given by `length`, the number of its steps; later samples are ignored. Definitions follow section 4 of the
paper; a time that doesn't exist is not-a-number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class Record(NamedTuple):
    """Time series of N episodes."""

    time_s: Array
    """Times of the samples, (T + 1,) [s]."""
    length: npt.NDArray[np.int64]
    """Steps of each episode, (N,)."""
    in_cone: Flags
    """Inside the cone, (T + 1, N)."""
    error: Array
    """Ship's pose minus the AUV's in the earth frame, yaw wrapped, (T + 1, N, 3) [m, m, rad]."""
    range_m: Array
    """Distance between transmitter and receiver, (T + 1, N) [m]."""
    bit_rate_bps: Array
    """Bit rate, (T + 1, N) [bit/s]."""
    effort: Array
    """Mean square of the clipped action in each step, (T, N)."""
    reward: Array
    """Reward of each step, (T, N)."""
    lost: Flags
    """Whether the episode was terminated, (N,)."""

    def valid(self) -> Flags:
        """Samples that belong to their episode, (T + 1, N)."""
        return np.arange(self.time_s.size)[:, None] <= self.length


def arrival_time(record: Record) -> Array:
    """t_a, the time of the first sample inside the cone [s], (N,)."""
    inside = record.in_cone & record.valid()
    return np.where(inside.any(axis=0), record.time_s[inside.argmax(axis=0)], np.nan)


def establishment_time(record: Record, until_s: float = np.inf) -> Array:
    """t_b, the time from which the AUV stays inside the cone until ``until_s`` (a disturbance) or the end [s], (N,)."""
    considered = record.valid() & (record.time_s < until_s)[:, None]
    last = considered.shape[0] - 1 - considered[::-1].argmax(axis=0)
    outside = considered & ~record.in_cone
    last_outside = np.where(outside.any(axis=0), considered.shape[0] - 1 - outside[::-1].argmax(axis=0), -1)
    return np.where(last_outside < last, record.time_s[np.minimum(last_outside + 1, last)], np.nan)


def restoring_time(record: Record, disturbance_s: float | None) -> Array:
    """Δt, from leaving the cone after a disturbance until back inside for good [s], (N,).

    0 where the AUV never left, not-a-number without a disturbance, before arrival, or where it was not back at the end.
    """
    count = record.length.size
    if disturbance_s is None:
        return np.full(count, np.nan)
    after = record.valid() & (record.time_s >= disturbance_s)[:, None]
    outside = after & ~record.in_cone
    first = outside.argmax(axis=0)
    back = outside.shape[0] - outside[::-1].argmax(axis=0)
    returned = back <= record.length
    step = record.time_s[np.minimum(back, record.time_s.size - 1)] - record.time_s[first]
    result = np.where(outside.any(axis=0), np.where(returned, step, np.nan), 0.0)
    arrived = arrival_time(record) < disturbance_s
    return np.where(arrived, result, np.nan)


def rmse(record: Record, from_s: Array | float | None = None) -> Array:
    """Root mean square errors of x, y and yaw from arrival (or ``from_s``) to the end [m, m, rad], (N, 3)."""
    start = arrival_time(record) if from_s is None else np.broadcast_to(from_s, record.length.shape)
    counted = record.valid() & (record.time_s[:, None] >= start)
    squares = np.where(counted[..., None], record.error**2, 0.0).sum(axis=0)
    number = counted.sum(axis=0)[:, None]
    return np.sqrt(np.divide(squares, number, out=np.full(squares.shape, np.nan), where=number > 0))


def availability(record: Record) -> Array:
    """Share of the planned episode's samples inside the cone, (N,); time after an early end counts as outside."""
    result: Array = (record.in_cone & record.valid()).mean(axis=0)
    return result


def mean_log_bit_rate(record: Record) -> Array:
    """Mean of log10 of the bit rate [bit/s] over the samples at which anything is received, (N,)."""
    heard = (record.bit_rate_bps > 0.0) & record.valid()
    total = np.where(heard, np.log10(np.where(heard, record.bit_rate_bps, 1.0)), 0.0).sum(axis=0)
    number = heard.sum(axis=0)
    return np.divide(total, number, out=np.full(total.shape, np.nan), where=number > 0)


def delivered_gbit(record: Record) -> Array:
    """Bits delivered inside the cone [Gbit], (N,), each step at the rate of its end."""
    used = np.where(record.in_cone & record.valid(), record.bit_rate_bps, 0.0)[1:]
    result: Array = (used * np.diff(record.time_s)[:, None]).sum(axis=0) / 1e9
    return result


def effort(record: Record) -> Array:
    """Root mean square of the clipped action over the episode, (N,): 1 if every actuator is always at its limit."""
    counted = record.valid()[1:]
    result: Array = np.sqrt(np.where(counted, record.effort, 0.0).sum(axis=0) / counted.sum(axis=0))
    return result


def episode_return(record: Record) -> Array:
    """Sum of the rewards, (N,)."""
    result: Array = np.where(record.valid()[1:], record.reward, 0.0).sum(axis=0)
    return result


def episode_metrics(record: Record, disturbance_s: float | None = None) -> dict[str, Array]:
    """All measures by name, each of shape (N,).

    Args:
        record: The episodes.
        disturbance_s: When the first pulse begins [s], for the restoring time.
    """
    errors = rmse(record)
    return {
        "return": episode_return(record),
        "arrival_s": arrival_time(record),
        "established_s": establishment_time(record, np.inf if disturbance_s is None else disturbance_s),
        "restoring_s": restoring_time(record, disturbance_s),
        "rmse_x_m": errors[:, 0],
        "rmse_y_m": errors[:, 1],
        "rmse_yaw_rad": errors[:, 2],
        "availability": availability(record),
        "log10_bit_rate": mean_log_bit_rate(record),
        "delivered_gbit": delivered_gbit(record),
        "effort": effort(record),
        "lost": record.lost.astype(float),
    }
