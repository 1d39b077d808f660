"""How simulations lie in memory: blocks of 32 lanes, each quantity a row of its block, read by name.

A block is one record of nested groups of rows; lane j of a row is its element j. The rows of a block are a constant
distance apart, so that the compiler can prove that loops over lanes have no overlapping reads and writes, and
vectorises them. Eight unused doubles at the end of each row keep rows from falling into the same few cache sets when
only one lane is in use.
"""

from __future__ import annotations

import hashlib
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_builtin,
    lower_getattr,
    lower_getattr_generic,
    models,
    register_model,
)
from numba.np.numpy_support import as_dtype

# Numba's own decorator has no types that mypy could follow.
_intrinsic: Callable[[Callable[..., Any]], Callable[..., Any]] = intrinsic

LANES = 32
"""Simulations in a block: few enough for its rows to fit into the first-level cache."""

STRIDE = LANES + 8
"""Doubles from one row to the next."""

ROW_BYTES = 8 * STRIDE

_DOUBLE = ir.DoubleType()

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


class View(types.Type):
    """A record as compiled code sees it: a place in an array of float64 whose parts are read by name.

    Of a block's record the parts are groups and rows; Numba's own records give an array for each row that is touched,
    which takes several times as long to compile. A number is a setting, which nothing writes while compiled code runs;
    LLVM is told so, and reads it once before a loop over lanes, which otherwise wouldn't vectorise.
    """

    def __init__(self, record: np.dtype[Any]) -> None:
        self.record = record
        # The full type would be in the name of each function and take longer to write than the function to compile.
        super().__init__(name=f"View_{hashlib.sha256(repr(record).encode()).hexdigest()[:8]}")


class Rows(types.Type):
    """The numbers of a row over the lanes, or of several rows, written and read as ``row[j]`` or ``rows[k, j]``.

    As in the rest of compiled code no index is checked, and none counts from the end.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape
        super().__init__(name="_".join(["Rows", *map(str, shape)]))


register_model(View)(models.OpaqueModel)
register_model(Rows)(models.OpaqueModel)


@_intrinsic
def record_at(typing_context: Any, numbers: Any, place: Any, kind: Any) -> Any:
    """The record of type ``kind`` that begins at a place of an array of float64; nothing is checked."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        start = cgutils.gep(builder, array.data, arguments[1])
        return builder.bitcast(start, cgutils.voidptr_t)

    if not isinstance(kind, types.DType):
        return None
    return View(as_dtype(kind.dtype))(numbers, types.intp, kind), generate


def _kind_of(record: np.dtype[Any], name: str) -> tuple[types.Type, int]:
    """What stands at that name of a record, and where [bytes]."""
    assert record.fields is not None
    inside, place = record.fields[name][:2]
    if inside.subdtype is not None:
        return Rows(inside.shape), place
    return View(inside) if inside.names else types.float64, place


@infer_getattr
class _ViewAttributes(AttributeTemplate):
    key = View

    def generic_resolve(self, view: View, name: str) -> Any:  # type: ignore[override]
        return _kind_of(view.record, name)[0] if name in (view.record.names or ()) else None


@lower_getattr_generic(View)
def _read_part(context: Any, builder: Any, view: View, value: Any, name: str) -> Any:
    kind, place = _kind_of(view.record, name)
    start = cgutils.pointer_add(builder, value, place)
    if kind is not types.float64:
        return start
    number = builder.load(builder.bitcast(start, _DOUBLE.as_pointer()))
    number.set_metadata("invariant.load", builder.module.add_metadata([]))
    return number


@infer_getattr
class _RowsAttributes(AttributeTemplate):
    key = Rows

    def resolve_shape(self, rows: Rows) -> Any:
        return types.UniTuple(types.intp, len(rows.shape))


@lower_getattr(Rows, "shape")
def _read_shape(context: Any, builder: Any, rows: Rows, value: Any) -> Any:
    return context.get_constant_generic(builder, types.UniTuple(types.intp, len(rows.shape)), rows.shape)


def _index_type(rows: Any, index: Any) -> Any:
    """The type of an index that has as many numbers as there are dimensions, else None."""
    if isinstance(rows, Rows):
        if isinstance(index, types.Integer) and len(rows.shape) == 1:
            return types.intp
        if isinstance(index, types.BaseTuple) and len(index) == len(rows.shape):
            return types.UniTuple(types.intp, len(index))
    return None


@infer_global(operator.getitem)
class _ReadNumber(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        index = _index_type(*arguments)
        return None if index is None else signature(types.float64, arguments[0], index)


@infer_global(operator.setitem)
class _WriteNumber(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        index = _index_type(*arguments[:2])
        return None if index is None else signature(types.none, arguments[0], index, types.float64)


def _place(builder: Any, rows: Rows, kind: Any, value: Any, index: Any) -> Any:
    """Pointer to the number with that index."""
    indices = cgutils.unpack_tuple(builder, index) if isinstance(kind, types.BaseTuple) else [index]
    place = indices[0]
    for size, further in zip(rows.shape[1:], indices[1:], strict=True):
        place = builder.add(builder.mul(place, place.type(size)), further)
    return builder.gep(builder.bitcast(value, _DOUBLE.as_pointer()), [place], inbounds=True)


@lower_builtin(operator.getitem, Rows, types.Any)
def _read_number(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    rows, kind = signature.args
    return builder.load(_place(builder, rows, kind, *arguments))


@lower_builtin(operator.setitem, Rows, types.Any, types.float64)
def _write_number(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    rows, kind, _ = signature.args
    value, index, number = arguments
    builder.store(number, _place(builder, rows, kind, value, index))
    return context.get_dummy_value()
