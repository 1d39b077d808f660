"""Kalman filters of N lanes at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Belief(NamedTuple):
    """A mean, (N, n), and its covariance, (N, n, n)."""

    mean: Array
    cov: Array


def belief(mean: Sequence[npt.ArrayLike], deviations: Sequence[float], lanes: int) -> Belief:
    """Independent numbers, each one or (N,), with their deviations."""
    columns = np.stack([np.broadcast_to(np.asarray(each, dtype=float), lanes) for each in mean], axis=1)
    return Belief(columns, np.tile(np.diag(np.square(deviations)), (lanes, 1, 1)))


def predict(before: Belief, step: Array, noise: Array, mean: Array | None = None) -> Belief:
    """Go on by a step.

    Args:
        before: What is believed.
        step: The transition, (N, n, n), or its slope where it isn't linear.
        noise: The covariance of what comes on top, (n, n) or (N, n, n).
        mean: Where a transition that isn't linear leads, (N, n).
    """
    led = (step @ before.mean[..., None])[..., 0] if mean is None else mean
    return Belief(led, step @ before.cov @ step.swapaxes(1, 2) + noise)


def correct(before: Belief, innovation: Array, seen: Array, noise: Array) -> tuple[Belief, Array, Array]:
    """Take in a measurement, in Joseph's form.

    Args:
        before: What is believed.
        innovation: What was measured minus what was expected, (N, m).
        seen: The measurement's matrix, (m, n) or (N, m, n).
        noise: Its covariance, (m, m).

    Returns:
        What is believed now; the log likelihood of the innovation but for a constant; and its square in its own
        covariance (NIS), both (N,).
    """
    back = np.swapaxes(seen, -1, -2)
    spread = seen @ before.cov @ back + noise
    inverse = np.linalg.inv(spread)
    gain = before.cov @ back @ inverse
    square = np.einsum("ni,nij,nj->n", innovation, inverse, innovation)
    kept = np.eye(before.mean.shape[1]) - gain @ seen
    cov = kept @ before.cov @ kept.swapaxes(1, 2) + gain @ noise @ gain.swapaxes(1, 2)
    likelihood = -0.5 * (square + np.linalg.slogdet(spread)[1])
    return Belief(before.mean + (gain @ innovation[..., None])[..., 0], cov), likelihood, square


def matrix(rows: Sequence[Sequence[Any]], lanes: int) -> Array:
    """A matrix for each lane from entries that are numbers or (N,)."""
    found = np.empty((lanes, len(rows), len(rows[0])))
    for i, row in enumerate(rows):
        for k, each in enumerate(row):
            found[:, i, k] = each
    return found


def chosen(where: npt.NDArray[np.bool_], new: Sequence[Array], old: Sequence[Array] | None) -> tuple[Array, ...]:
    """The new entries of some lanes, the old ones of the others."""
    if old is None:
        return tuple(new)
    return tuple(
        np.where(where.reshape((-1,) + (1,) * (fresh.ndim - 1)), fresh, kept)
        for fresh, kept in zip(new, old, strict=True)
    )
