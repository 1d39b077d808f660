"""How simulations lie in memory: blocks of 32 lanes, each quantity a row of its block, read by name.

A block is one record of nested groups of rows; lane j of a row is its element j. The rows of a block are a constant
distance apart, so that the compiler can prove that loops over lanes have no overlapping reads and writes, and
vectorises them. Eight unused doubles at the end of each row keep rows from falling into the same few cache sets when
only one lane is in use.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

LANES = 32
"""Simulations in a block: few enough for its rows to fit into the first-level cache."""

STRIDE = LANES + 8
"""Doubles from one row to the next."""

ROW_BYTES = 8 * STRIDE

Spec = Mapping[str, Any]
"""Names of rows, each with the shape of what stands in a lane: () for a number, or the Spec of a group."""


def rows(*names: str, **shapes: tuple[int, ...]) -> dict[str, tuple[int, ...]]:
    """Rows of one number a lane each, and others of the given shapes, such as ``matrix=(3, 3)``."""
    return dict.fromkeys(names, ()) | shapes


CLOCK = rows("time_s", "step")
"""Time in the episode [s] and in control periods, which every effect finds in ``b.clock``."""


def block_type(spec: Spec) -> np.dtype[Any]:
    """The record of a block.

    A group whose rows are all numbers can also be read as a whole, as ``all[k, j]``.
    """
    return _record(spec, (STRIDE,))


def lane_type(spec: Spec) -> np.dtype[Any]:
    """The record of one lane: the same names in the same order, without the gaps."""
    return _record(spec, ())


def _record(spec: Spec, tail: tuple[int, ...]) -> np.dtype[Any]:
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    size = 0
    for name, inside in spec.items():
        kind = _record(inside, tail) if isinstance(inside, Mapping) else np.dtype((np.float64, (*inside, *tail)))
        names.append(name)
        formats.append(kind)
        offsets.append(size)
        size += kind.itemsize
    if tail and spec and all(inside == () for inside in spec.values()):
        names.append("all")
        formats.append((np.float64, (len(spec), *tail)))
        offsets.append(0)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def row_numbers(spec: Spec, first: int = 0) -> Iterator[tuple[str, int]]:
    """The dotted name and the number in the block of each row, of the first one where there are several."""
    for name, inside in spec.items():
        if isinstance(inside, Mapping):
            for below, number in row_numbers(inside, first):
                yield f"{name}.{below}", number
        else:
            yield name, first
        first += count(inside)


def count(inside: Any) -> int:
    """How many rows a group or an entry of a Spec takes."""
    if isinstance(inside, Mapping):
        return sum(count(below) for below in inside.values())
    return math.prod(inside)


def table_type(fields: Mapping[str, Any]) -> np.dtype[Any]:
    """The record of settings: the nested names of ``fields``, each one float64."""
    return np.dtype(
        [(name, table_type(value) if isinstance(value, Mapping) else np.float64) for name, value in fields.items()]
    )


def flat(fields: Mapping[str, Any]) -> list[float]:
    """The values of nested settings, in the order of `table_type`."""
    values: list[float] = []
    for value in fields.values():
        values += flat(value) if isinstance(value, Mapping) else [float(value)]
    return values
