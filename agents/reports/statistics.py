"""Statistics of scores over training and scenario seeds: interquartile means, paired differences and their intervals.

The measures are those of R. Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice"
(NeurIPS 2021). Scores stand in a matrix with a row per training seed and a column per scenario seed; a scripted
controller has one row. Bootstrap samples draw rows and columns independently, so that an interval speaks of other
trainings in other scenarios.

What says "never", such as a link that isn't restored, has no place in a mean and is counted beside it; what doesn't
apply to an episode, such as a restoring time without a disturbance, is neither.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

RESAMPLES = 2000
INTERVAL = f"95 % percentile bootstrap, {RESAMPLES} resamples"
"""What stands in brackets, in words."""


class Estimate(NamedTuple):
    """A number and its 95 % bootstrap interval."""

    value: float
    low: float
    """Lower end; nan where there is only one score."""
    high: float


class Summary(NamedTuple):
    """A measure over episodes: the mean of its values, and how many episodes have none."""

    mean: float
    """nan where there is no value."""
    low: float
    """Lower end of the mean's 95 % bootstrap interval; nan where there are fewer than two values."""
    high: float
    values: int
    """Episodes in which the measure has a value."""
    never: int
    """Episodes that say never."""
    episodes: int
    """All; to those left over the measure doesn't apply."""


def interquartile_mean(scores: npt.ArrayLike) -> Array:
    """Mean of the middle half of the scores along the last axis, those on its edges weighted by their share."""
    ordered = np.sort(np.asarray(scores, dtype=float), axis=-1)
    size = ordered.shape[-1]
    # Score i covers [i, i + 1] of the order; what lies in the middle half counts.
    low, high = 0.25 * size, 0.75 * size
    index = np.arange(size)
    weights = np.clip(np.minimum(index + 1, high) - np.maximum(index, low), 0.0, 1.0)
    result: Array = ordered @ weights / weights.sum()
    return result


def mean(scores: npt.ArrayLike) -> Array:
    """Mean of the scores along the last axis."""
    return np.asarray(np.mean(np.asarray(scores, dtype=float), axis=-1))


def worst_share(scores: npt.ArrayLike, share: float = 0.05) -> Array:
    """Mean of the lowest ``share`` of the scores along the last axis, at least one of them."""
    ordered = np.sort(np.asarray(scores, dtype=float), axis=-1)
    return np.asarray(ordered[..., : max(1, round(share * ordered.shape[-1]))].mean(axis=-1))


def median(scores: npt.ArrayLike) -> Array:
    """Median of the scores along the last axis."""
    return np.asarray(np.median(np.asarray(scores, dtype=float), axis=-1))


def share_of_the_way(
    scores: npt.ArrayLike, start: npt.ArrayLike, end: npt.ArrayLike, rng: np.random.Generator
) -> Estimate:
    """How far from one policy's mean to another's a policy's mean lies: 0 at the first, 1 at the second.

    Args:
        scores: Shape (R, S), training seeds by scenario seeds, or (S,).
        start: Of the policy at which the way begins, in the same S scenario seeds, shape (S,).
        end: Of the policy at which it ends, shape (S,).
        rng: Draws the resamples, of trainings and of episodes, in which all three flew.

    Returns:
        nan where the second policy isn't ahead of the first, so that there is no way.
    """
    matrix = np.atleast_2d(np.asarray(scores, dtype=float))
    flat, first, last = matrix.ravel(), np.ravel(start), np.ravel(end)
    size = matrix.shape[1]
    gained, whole = float(mean(flat) - mean(first)), float(mean(last) - mean(first))
    if not whole > 0.0:
        return Estimate(math.nan, math.nan, math.nan)

    def of_places(chosen: Array) -> Array:
        places = chosen.astype(np.int64)
        begin = mean(first[places % size])
        length = mean(last[places % size]) - begin
        # A resample may have no way at all.
        there = length != 0.0
        return np.where(there, (mean(flat[places]) - begin) / np.where(there, length, 1.0), gained / whole)

    return estimate(np.arange(matrix.size).reshape(matrix.shape), of_places, rng)


def improvement(differences: npt.ArrayLike) -> Array:
    """Probability that a score is higher than its partner's, from paired differences; equal ones count half."""
    array = np.asarray(differences, dtype=float)
    return np.asarray(np.mean((array > 0.0) + 0.5 * (array == 0.0), axis=-1))


def estimate(scores: npt.ArrayLike, statistic: Callable[[Array], Array], rng: np.random.Generator) -> Estimate:
    """A statistic of a matrix of scores with its percentile interval over resampled rows and columns.

    Args:
        scores: Shape (R, S), training seeds by scenario seeds, or (S,).
        statistic: What is estimated, along the last axis of scores of shape (..., R * S).
        rng: Draws the resamples.
    """
    matrix = np.atleast_2d(np.asarray(scores, dtype=float))
    value = float(statistic(matrix.ravel()))
    axes = [np.arange(size) for size in matrix.shape if size > 1]
    if not axes:
        return Estimate(value, math.nan, math.nan)
    known = matrix[np.isfinite(matrix)]
    # Equal scores, to rounding, have no spread to resample.
    if known.size and np.ptp(known) <= 1e-12 * np.abs(known).max():
        return Estimate(value, value, value)
    from scipy.stats import bootstrap

    def of(*chosen: npt.NDArray[np.int64], axis: int) -> Array:
        # An axis with one entry isn't resampled, and takes all of it.
        drawn = iter(chosen)
        rows, columns = (next(drawn) if size > 1 else np.zeros(1, dtype=np.int64) for size in matrix.shape)
        taken = matrix[rows[..., :, None], columns[..., None, :]]
        return statistic(taken.reshape(*taken.shape[:-2], -1))

    found = bootstrap(tuple(axes), of, n_resamples=RESAMPLES, vectorized=True, method="percentile", rng=rng)
    return Estimate(value, float(found.confidence_interval.low), float(found.confidence_interval.high))


def says_never(scores: npt.ArrayLike, nan_is_never: bool) -> npt.NDArray[np.bool_]:
    """Where a measure says never, shape like ``scores``: where it is infinite, and of some measures where it is nan."""
    array = np.asarray(scores, dtype=float)
    never: npt.NDArray[np.bool_] = np.isinf(array) | (np.isnan(array) & nan_is_never)
    return never


def summarise(scores: npt.ArrayLike, rng: np.random.Generator, nan_is_never: bool = False) -> Summary:
    """The mean of a measure's values with its interval, and the number of episodes that say never.

    Args:
        scores: Shape (R, S), training seeds by scenario seeds, or (S,).
        rng: Draws the resamples.
        nan_is_never: Whether nan says never, as an arrival does; otherwise the measure doesn't apply there.
    """
    matrix = np.asarray(scores, dtype=float)
    has_value = np.isfinite(matrix)
    count, never = int(has_value.sum()), int(says_never(matrix, nan_is_never).sum())
    if not count:
        return Summary(math.nan, math.nan, math.nan, count, never, matrix.size)
    whole = float(matrix[has_value].mean())

    def of_values(chosen: Array) -> Array:
        known = np.isfinite(chosen)
        number = known.sum(axis=-1)
        total = np.where(known, chosen, 0.0).sum(axis=-1)
        # A resample may hold no value at all.
        return np.where(number > 0, total / np.maximum(number, 1), whole)

    found = estimate(matrix, of_values, rng)
    return Summary(whole, *(found[1:] if count > 1 else (math.nan, math.nan)), count, never, matrix.size)


def text(found: Mapping[str, float | None], digits: int) -> str:
    """An estimate or a summary, given by its entries, as a table shows it.

    "1.20 [1.10, 1.30] (12 of 200 never)" is a mean over 188 values; "(50 of 200)" says to how many of all episodes the
    measure applies, "–" that it applies to none.
    """
    value, low, high = (
        math.nan if number is None else number
        for number in (found.get("value", found.get("mean")), found["low"], found["high"])
    )
    episodes, never = int(found.get("episodes") or 0), int(found.get("never") or 0)
    applies = int(found.get("values") or 0) + never
    shown = f"{value:.{digits}f}" if math.isfinite(value) else "never" if never else "–"
    if math.isfinite(low) and low != high:
        shown += f" [{low:.{digits}f}, {high:.{digits}f}]"
    if 0 < applies < episodes:
        some = f", {never} of them never" if 0 < never < applies else ""
        shown += f" ({applies} of {episodes}{some})"
    elif 0 < never < episodes:
        shown += f" ({never} of {episodes} never)"
    return shown


def profile(scores: npt.ArrayLike, thresholds: npt.ArrayLike) -> Array:
    """Performance profile: the share of scores above each threshold, shape like ``thresholds``."""
    flat = np.asarray(scores, dtype=float).ravel()
    result: Array = (flat[:, None] > np.asarray(thresholds, dtype=float).ravel()).mean(axis=0)
    return result
