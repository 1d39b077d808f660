"""Statistics of scores over training and scenario seeds: interquartile means, paired differences and their intervals.

The measures are those of R. Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice"
(NeurIPS 2021). Scores stand in a matrix with a row per training seed and a column per scenario seed; a scripted
controller has one row. Bootstrap samples draw rows and columns independently, so that an interval speaks of other
trainings in other scenarios.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

RESAMPLES = 2000


class Estimate(NamedTuple):
    """A number and its 95 % bootstrap interval."""

    value: float
    low: float
    """Lower end; nan where there is only one score."""
    high: float


def interquartile_mean(scores: npt.ArrayLike) -> float:
    """Mean of the middle half of all scores, those on its edges weighted by their share."""
    ordered = np.sort(np.asarray(scores, dtype=float), axis=None)
    size = ordered.size
    # Score i covers [i, i + 1] of the order; what lies in the middle half counts.
    low, high = 0.25 * size, 0.75 * size
    index = np.arange(size)
    weights = np.clip(np.minimum(index + 1, high) - np.maximum(index, low), 0.0, 1.0)
    return float(weights @ ordered / weights.sum())


def mean(scores: npt.ArrayLike) -> float:
    """Mean of all scores."""
    return float(np.asarray(scores, dtype=float).mean())


def worst_share(scores: npt.ArrayLike, share: float = 0.05) -> float:
    """Mean of the lowest ``share`` of all scores, at least one of them."""
    ordered = np.sort(np.asarray(scores, dtype=float), axis=None)
    return float(ordered[: max(1, round(share * ordered.size))].mean())


def improvement(differences: npt.ArrayLike) -> float:
    """Probability that a score is higher than its partner's, from paired differences; equal ones count half."""
    array = np.asarray(differences, dtype=float)
    return float(np.mean((array > 0.0) + 0.5 * (array == 0.0)))


def estimate(
    scores: npt.ArrayLike, statistic: Callable[[Array], float], rng: np.random.Generator, resamples: int = RESAMPLES
) -> Estimate:
    """A statistic of a matrix of scores with its percentile interval over resampled rows and columns.

    Args:
        scores: Shape (R, S): training seeds by scenario seeds.
        statistic: What is estimated, of a matrix of any shape.
        rng: Draws the resamples.
        resamples: Their number.
    """
    matrix = np.atleast_2d(np.asarray(scores, dtype=float))
    value = statistic(matrix)
    axes = [np.arange(size) for size in matrix.shape if size > 1]
    if not axes:
        return Estimate(value, math.nan, math.nan)
    known = matrix[np.isfinite(matrix)]
    if known.size and np.ptp(known) == 0.0:
        return Estimate(value, value, value)
    from scipy.stats import bootstrap

    def of(*chosen: npt.NDArray[np.int64]) -> float:
        # An axis with one entry isn't resampled, and takes all of it.
        drawn = iter(chosen)
        rows, columns = (next(drawn) if size > 1 else np.arange(1) for size in matrix.shape)
        return statistic(matrix[np.ix_(rows, columns)])

    found = bootstrap(tuple(axes), of, n_resamples=resamples, vectorized=False, method="percentile", rng=rng)
    return Estimate(value, float(found.confidence_interval.low), float(found.confidence_interval.high))


def text(found: Mapping[str, float], digits: int) -> str:
    """An estimate, given by its entries, as a table shows it."""
    value, low, high = (found[key] if found[key] is not None else math.nan for key in Estimate._fields)
    if not math.isfinite(value):
        return "–"
    if not math.isfinite(low) or low == high:
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def profile(scores: npt.ArrayLike, thresholds: npt.ArrayLike) -> Array:
    """Performance profile: the share of scores above each threshold, shape like ``thresholds``."""
    flat = np.asarray(scores, dtype=float).ravel()
    result: Array = (flat[:, None] > np.asarray(thresholds, dtype=float).ravel()).mean(axis=0)
    return result
