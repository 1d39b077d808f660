"""How simulations lie in memory: blocks of 32 lanes, each quantity a row of its block, read by name.

A block is one record of nested groups of rows; lane j of a row is its element j. The rows of a block are a constant
distance apart, so that the compiler can prove that loops over lanes have no overlapping reads and writes, and
vectorises them. Eight unused doubles at the end of each row keep rows from falling into the same few cache sets when
only one lane is in use.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model

# Numba's own decorator has no types that mypy could follow.
_intrinsic: Callable[[Callable[..., Any]], Callable[..., Any]] = intrinsic

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


@_intrinsic
def record_at(typing_context: Any, numbers: Any, place: Any, kind: Any) -> Any:
    """The record of type ``kind`` that begins at a place of an array of float64, as a view; nothing is checked.

    For compiled code, where NumPy's own views take long to compile.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _pointer(context, builder, signature, arguments)

    if not isinstance(kind, types.DType):
        return None
    return kind.dtype(numbers, types.intp, kind), generate


class Settings(types.Type):
    """A record of settings as compiled code reads it: nothing writes to it while compiled code runs.

    LLVM is told so, and reads it once before a loop over lanes, which otherwise wouldn't vectorise.
    """

    def __init__(self, record: Any) -> None:
        self.record = record
        super().__init__(name=f"Settings({record.name})")


@register_model(Settings)
class _SettingsModel(models.OpaqueModel):
    """A pointer to the record."""


@_intrinsic
def settings_at(typing_context: Any, numbers: Any, place: Any, kind: Any) -> Any:
    """The settings of type ``kind`` that begin at a place of an array of float64."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _pointer(context, builder, signature, arguments)

    if not isinstance(kind, types.DType):
        return None
    return Settings(kind.dtype)(numbers, types.intp, kind), generate


def _pointer(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    start = cgutils.gep(builder, array.data, arguments[1])
    return builder.bitcast(start, context.get_value_type(signature.return_type))


@infer_getattr
class _SettingsAttributes(AttributeTemplate):
    key = Settings

    def generic_resolve(self, settings: Settings, name: str) -> Any:  # type: ignore[override]
        if name not in settings.record.fields:
            return None
        inside = settings.record.typeof(name)
        return Settings(inside) if isinstance(inside, types.Record) else inside


@lower_getattr_generic(Settings)
def _read_setting(context: Any, builder: Any, kind: Settings, value: Any, name: str) -> Any:
    inside = kind.record.typeof(name)
    place = cgutils.pointer_add(builder, value, kind.record.offset(name))
    if isinstance(inside, types.Record):
        return place
    number = builder.load(builder.bitcast(place, context.get_value_type(inside).as_pointer()))
    number.set_metadata("invariant.load", builder.module.add_metadata([]))
    return number
