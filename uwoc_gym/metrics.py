"""What an episode is judged by: arrival, establishment and restoring time, RMSE, availability, data and effort.

All functions take series whose first axis is time, one sample per control period and T + 1 samples with the start;
further axes are simulations, so that one call serves a single run or a batch. Samples that lie after an episode's
early end are marked by ``valid``, bool of shape (T + 1, ...), by default True everywhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class EpisodeRecord:
    """The series of N episodes of T control periods; entries where ``valid`` is False have no meaning."""

    time_s: Array
    """Time of the samples, (T + 1,) [s]."""
    in_cone: Mask
    """Whether the AUV is inside the cone, (T + 1, N)."""
    pose: Array
    """The AUV's x, y and yaw in the earth frame, (T + 1, N, 3) [m, m, rad]."""
    ship_pose: Array
    """The ship's x, y and yaw in the earth frame, (T + 1, N, 3) [m, m, rad]."""
    bit_rate_bps: Array
    """Bit rate at the target bit error rate, (T + 1, N) [bit/s]."""
    force: Array
    """Surge force, sway force and yaw moment applied in each period, (T, N, 3) [N, N, N m]."""
    reward: Array
    """Reward of each period, (T, N)."""
    valid: Mask
    """Whether the sample belongs to the episode, (T + 1, N)."""
    lost: Mask
    """Whether the episode ended because the link was lost beyond recovery, (N,)."""
    disturbance_s: Array
    """Time at which the first disturbance begins, (N,) [s]; nan where there is none."""
    force_limits: Array
    """The actuators' limits, (3,) [N, N, N m]."""


@dataclass(frozen=True, kw_only=True)
class EpisodeMetrics:
    """The measures of N episodes, each of shape (N,)."""

    return_: Array
    """Sum of the rewards."""
    steps: Array
    """Control periods flown."""
    arrival_time_s: Array
    """See `arrival_time_s` [s]."""
    establishment_time_s: Array
    """See `establishment_time_s` [s]."""
    restoring_time_s: Array
    """See `restoring_time_s` [s]."""
    rmse_x_m: Array
    """Root mean square of the error in x from arrival on [m]."""
    rmse_y_m: Array
    """Root mean square of the error in y from arrival on [m]."""
    rmse_yaw_rad: Array
    """Root mean square of the error in yaw from arrival on [rad]."""
    availability: Array
    """See `availability`."""
    mean_log10_bit_rate: Array
    """See `mean_log10_bit_rate`."""
    delivered_gbit: Array
    """See `delivered_gbit` [Gbit]."""
    effort: Array
    """See `effort`."""
    lost: Array
    """1 where the link was lost beyond recovery, else 0."""

    def rows(self) -> list[dict[str, float]]:
        """One dict per episode, in the order of the fields."""
        names = [field.name for field in dataclasses.fields(self)]
        columns = [getattr(self, name).tolist() for name in names]
        return [
            {name.rstrip("_"): value for name, value in zip(names, row, strict=True)}
            for row in zip(*columns, strict=True)
        ]


def _inside(in_cone: npt.ArrayLike, valid: npt.ArrayLike | None) -> tuple[Mask, Mask]:
    inside = np.asarray(in_cone, dtype=bool)
    belongs = np.ones_like(inside) if valid is None else np.broadcast_to(np.asarray(valid, dtype=bool), inside.shape)
    return inside & belongs, belongs


def _sum(values: npt.ArrayLike) -> Array:
    """Sum over time, each simulation by itself, so that its rounding doesn't depend on how many there are."""
    series = np.asarray(values, dtype=float)
    rows = np.ascontiguousarray(np.moveaxis(series, 0, -1)).reshape(-1, series.shape[0])
    return np.array([row.sum() for row in rows], dtype=float).reshape(series.shape[1:])


def _first(time_s: Array, mask: Mask) -> Array:
    """Time of the first True of each simulation, nan if there is none."""
    return np.where(mask.any(axis=0), time_s[mask.argmax(axis=0)], np.nan)


def _inside_for_good(inside: Mask, belongs: Mask) -> Mask:
    """Whether the AUV is inside at a sample and at all later ones of its episode."""
    stays = inside | ~belongs
    return np.logical_and.accumulate(stays[::-1], axis=0)[::-1] & belongs


def arrival_time_s(time_s: npt.ArrayLike, in_cone: npt.ArrayLike, valid: npt.ArrayLike | None = None) -> Array:
    """t_a: the first time inside the cone [s]; nan if never (paper, sec. 2.3)."""
    inside, _ = _inside(in_cone, valid)
    return _first(np.asarray(time_s, dtype=float), inside)


def establishment_time_s(time_s: npt.ArrayLike, in_cone: npt.ArrayLike, valid: npt.ArrayLike | None = None) -> Array:
    """t_b: the time from which the AUV stays inside the cone [s]; nan if it isn't inside at the end.

    To ignore a disturbance, as the paper does, leave what comes after it out of ``valid``.
    """
    return _first(np.asarray(time_s, dtype=float), _inside_for_good(*_inside(in_cone, valid)))


def restoring_time_s(
    time_s: npt.ArrayLike,
    in_cone: npt.ArrayLike,
    disturbance_s: npt.ArrayLike,
    valid: npt.ArrayLike | None = None,
) -> Array:
    """Δt: from first leaving the cone after a disturbance to being back inside for good [s].

    Args:
        time_s: Time of the samples, (T + 1,) [s].
        in_cone: Whether the AUV is inside the cone, (T + 1, ...).
        disturbance_s: When the disturbance begins, a number or of shape (...) [s]; nan for none.
        valid: Which samples belong to the episode.

    Returns:
        Shape (...). 0 where there was no outage; inf where the link was not back for good at the episode's end; nan
        where the measure doesn't apply: no disturbance, none before the episode's end, or no link to lose when it
        began.
    """
    time = np.asarray(time_s, dtype=float)
    inside, belongs = _inside(in_cone, valid)
    start = np.broadcast_to(np.asarray(disturbance_s, dtype=float), inside.shape[1:])
    column = time.reshape((-1,) + (1,) * start.ndim)
    # Half a nanosecond: sample times are multiples of the control period with rounding errors.
    after = belongs & (column >= start - 5e-10)
    outside = after & ~inside
    left = _first(time, outside)
    back = _first(time, _inside_for_good(inside, belongs) & after & (column >= left))
    result = np.where(outside.any(axis=0), np.where(np.isnan(back), np.inf, back - left), 0.0)
    linked = np.take_along_axis(inside, after.argmax(axis=0)[None], axis=0)[0]
    restored: Array = np.where(after.any(axis=0) & linked, result, np.nan)
    return restored


def tracking_error(pose: npt.ArrayLike, ship_pose: npt.ArrayLike) -> Array:
    """Ship's pose minus the AUV's in the earth frame, (..., 3) [m, m, rad], yaw wrapped to [-π, π)."""
    error: Array = np.asarray(ship_pose, dtype=float) - np.asarray(pose, dtype=float)
    error[..., 2] = (error[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
    return error


def rmse(error: npt.ArrayLike, counted: npt.ArrayLike) -> Array:
    """Root mean square of ``error`` (T + 1, ..., 3) over the samples ``counted`` (T + 1, ...); nan if there are none.

    Returns:
        Shape (..., 3), in the error's units.
    """
    mask = np.asarray(counted, dtype=bool)[..., None]
    number = mask.sum(axis=0)
    total = _sum(np.where(mask, np.square(np.asarray(error, dtype=float)), 0.0))
    result: Array = np.sqrt(np.where(number > 0, total / np.maximum(number, 1), np.nan))
    return result


def since_arrival(in_cone: npt.ArrayLike, valid: npt.ArrayLike | None = None) -> Mask:
    """Which samples lie at or after the arrival, (T + 1, ...): where the paper takes its RMSE."""
    inside, belongs = _inside(in_cone, valid)
    return np.logical_or.accumulate(inside, axis=0) & belongs


def availability(in_cone: npt.ArrayLike, valid: npt.ArrayLike | None = None) -> Array:
    """Share of the episode's full length spent inside the cone, in [0, 1].

    Each control period counts by the sample at its end. What a lost episode didn't fly counts as outside, so that
    losing the link early can't look better than losing it late.
    """
    inside, _ = _inside(in_cone, valid)
    result: Array = inside[1:].mean(axis=0)
    return result


def mean_log10_bit_rate(bit_rate_bps: npt.ArrayLike, valid: npt.ArrayLike | None = None) -> Array:
    """Mean of log10(bit rate / (bit/s)) over the samples with any reception; nan if there are none."""
    rate = np.asarray(bit_rate_bps, dtype=float)
    received, _ = _inside(rate > 0.0, valid)
    number = received.sum(axis=0)
    total = _sum(np.log10(np.where(received, rate, 1.0)))
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def delivered_gbit(
    time_s: npt.ArrayLike, bit_rate_bps: npt.ArrayLike, in_cone: npt.ArrayLike, valid: npt.ArrayLike | None = None
) -> Array:
    """Data delivered [Gbit]: each control period counts with the bit rate at its end, if that is inside the cone.

    Outside the cone the link is below its threshold and counts as broken. The rule takes no mean of the two ends
    because the rate jumps at the field of view's edge.
    """
    inside, _ = _inside(in_cone, valid)
    periods = np.diff(np.asarray(time_s, dtype=float))
    rate = np.where(inside, np.asarray(bit_rate_bps, dtype=float), 0.0)[1:]
    return _sum(periods.reshape((-1,) + (1,) * (rate.ndim - 1)) * rate) * 1e-9


def effort(force: npt.ArrayLike, force_limits: npt.ArrayLike, valid: npt.ArrayLike | None = None) -> Array:
    """Root mean square of force over limit, over the periods and the axes that have a force, in [0, 1].

    Args:
        force: Applied force, (T, ..., 3) [N, N, N m].
        force_limits: The actuators' limits, (3,) [N, N, N m].
        valid: Which samples belong to the episode, (T + 1, ...).
    """
    limits = np.asarray(force_limits, dtype=float)
    has = limits > 0.0
    share = np.square(np.asarray(force, dtype=float)[..., has] / limits[has]).sum(axis=-1) / max(1, has.sum())
    belongs = np.ones_like(share, dtype=bool) if valid is None else np.asarray(valid, dtype=bool)[1:]
    result: Array = np.sqrt(_sum(np.where(belongs, share, 0.0)) / np.maximum(belongs.sum(axis=0), 1))
    return result


PARTS = ("arrival", "disturbances", "rest")
"""The parts of an episode, as `phases` tells them."""

AFTERMATH_S = 3.0
"""How long after its end a pulse is still what the return is lost to [s]: a tuned law is back in less."""


def phases(
    time_s: npt.ArrayLike,
    in_cone: npt.ArrayLike,
    pulses_s: Sequence[tuple[npt.ArrayLike, npt.ArrayLike]] = (),
    valid: npt.ArrayLike | None = None,
) -> dict[str, Mask]:
    """Which control periods belong to which part of an episode, by what a loss in them is due to.

    * ``arrival``: those that end before the AUV has been inside the cone; all of them if it never is.
    * ``disturbances``: of the others, those in which a pulse acts, those that begin less than `AFTERMATH_S` after its
      end, and then those up to the one that ends inside the cone: an outage that a pulse leaves behind counts until it
      is over.
    * ``rest``: all others.

    What a lost episode didn't fly belongs to the part in which it was lost.

    Args:
        time_s: Time of the samples, (T + 1,) [s].
        in_cone: Whether the AUV is inside the cone, (T + 1, ...).
        pulses_s: Beginning and end of each pulse, numbers or of shape (...) [s].
        valid: Which samples belong to the episode.

    Returns:
        By name, shape (T, ...); exactly one of them is True in each period.
    """
    time = np.asarray(time_s, dtype=float)
    inside, belongs = _inside(in_cone, valid)
    column = time.reshape((-1,) + (1,) * (inside.ndim - 1))
    begins, ends = column[:-1], column[1:]
    acts = np.zeros(inside[1:].shape, dtype=bool)
    for first, last in pulses_s:
        # Half a nanosecond: sample times are multiples of the control period with rounding errors.
        acts |= (ends > np.asarray(first) + 5e-10) & (begins < np.asarray(last) + AFTERMATH_S - 5e-10)
    arrived = np.logical_or.accumulate(inside, axis=0)[1:]
    disturbed = acts & arrived
    for i in range(1, len(disturbed)):
        disturbed[i] |= disturbed[i - 1] & ~inside[i] & belongs[i]
    found = dict(zip(PARTS, (~arrived, disturbed, arrived & ~disturbed), strict=True))
    flown = belongs[1:]
    last = np.maximum(flown.sum(axis=0) - 1, 0)[None]
    return {name: np.where(flown, mask, np.take_along_axis(mask, last, axis=0)) for name, mask in found.items()}


def losses(
    terms: Mapping[str, npt.ArrayLike],
    highest: Mapping[str, float],
    parts: Mapping[str, npt.ArrayLike],
    valid: npt.ArrayLike,
) -> dict[str, Array]:
    """What episodes lack of the highest return, in all, by part of the episode and by term of the reward.

    What a lost episode didn't fly is lost altogether.

    Args:
        terms: The reward's terms of each period, (T, N).
        highest: The most that a period can bring of each.
        parts: Which periods belong to which part, (T, N), as `phases` gives them.
        valid: Which samples belong to the episode, (T + 1, N).

    Returns:
        ``loss``, and ``loss_<name>`` for each part and each term, (N,). The parts add up to the loss, and so do the
        terms.
    """
    flown = np.asarray(valid, dtype=bool)[1:]
    lacking = {name: highest[name] - np.where(flown, own, 0.0) for name, own in terms.items()}
    periods = np.sum(list(lacking.values()), axis=0)
    return {
        "loss": _sum(periods),
        **{f"loss_{name}": _sum(np.where(mask, periods, 0.0)) for name, mask in parts.items()},
        **{f"loss_{name}": _sum(own) for name, own in lacking.items()},
    }


def episode_metrics(record: EpisodeRecord) -> EpisodeMetrics:
    """All measures of the episodes in a record."""
    time, inside, valid = record.time_s, record.in_cone, record.valid
    errors = rmse(tracking_error(record.pose, record.ship_pose), since_arrival(inside, valid))
    # The paper's t_b ignores the effect of disturbances, which the restoring time measures.
    calm_until = np.where(np.isnan(record.disturbance_s), np.inf, record.disturbance_s)
    undisturbed = valid & (time[:, None] < calm_until)
    return EpisodeMetrics(
        return_=_sum(np.where(valid[1:], record.reward, 0.0)),
        steps=valid[1:].sum(axis=0).astype(float),
        arrival_time_s=arrival_time_s(time, inside, valid),
        establishment_time_s=establishment_time_s(time, inside, undisturbed),
        restoring_time_s=restoring_time_s(time, inside, record.disturbance_s, valid),
        rmse_x_m=errors[..., 0],
        rmse_y_m=errors[..., 1],
        rmse_yaw_rad=errors[..., 2],
        availability=availability(inside, valid),
        mean_log10_bit_rate=mean_log10_bit_rate(record.bit_rate_bps, valid),
        delivered_gbit=delivered_gbit(time, record.bit_rate_bps, inside, valid),
        effort=effort(record.force, record.force_limits, valid),
        lost=record.lost.astype(float),
    )
