"""Boxes in one vector register, for Numba kernels.

A box is eight float32 lanes: lower x, y, z, a spare lane, then *minus* upper x, y, z and
another spare lane. With the upper corner negated, the union of two boxes is one vector
minimum. Numba's scalars get there only when LLVM happens to see it, so the few operations
that builders need are spelt out here in LLVM's own terms; LLVM maps eight lanes to
whatever the machine has.

Rows of ``(N, 8)`` float32 arrays are taken without any check of the index.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

_FLOAT = ir.FloatType()
_INT = ir.IntType(32)
_VECTOR = ir.VectorType(_FLOAT, 8)


class _BoxType(types.Type):
    """Numba type of a box held in a register."""

    def __init__(self) -> None:
        super().__init__(name="Box8")


_box = _BoxType()


@register_model(_BoxType)
class _BoxModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


def _constant(value: int) -> ir.Constant:
    return ir.Constant(_INT, value)


def _row(context: Any, build: Any, array_type: Any, array: Any, row: Any, width: int) -> Any:
    """Pointer to the first element of a row of a contiguous array of ``width`` columns."""
    data = context.make_array(array_type)(context, build, array).data
    offset = build.mul(row, ir.Constant(row.type, width))
    return build.gep(data, [offset])


def _pick(build: Any, vector: Any, lane: int) -> Any:
    return build.extract_element(vector, _constant(lane))


def _corners(build: Any, box: Any) -> list[Any]:
    """Lower and minus upper corner, as four lanes each (the last repeats z)."""
    lanes = ir.VectorType(_INT, 4)
    return [
        build.shuffle_vector(box, box, ir.Constant(lanes, [base, base + 1, base + 2, base + 2]))
        for base in (0, 4)
    ]


@intrinsic
def load(typing: Any, array: Any, row: Any) -> Any:
    """Row of an (N, 8) float32 array."""

    def generate(context, build, signature, values):
        pointer = _row(context, build, signature.args[0], values[0], values[1], 8)
        result = build.load(build.bitcast(pointer, _VECTOR.as_pointer()))
        result.align = 4
        return result

    return _box(array, types.intp), generate


@intrinsic
def store(typing: Any, array: Any, row: Any, box: Any) -> Any:
    """Write a row of an (N, 8) float32 array."""

    def generate(context, build, signature, values):
        pointer = _row(context, build, signature.args[0], values[0], values[1], 8)
        build.store(values[2], build.bitcast(pointer, _VECTOR.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, box), generate


@intrinsic
def load_corners(typing: Any, lower: Any, upper: Any, row: Any) -> Any:
    """Box from rows of (N, 3) float32 arrays; the spare lanes are 0."""

    def generate(context, build, signature, values):
        result = ir.Constant(_VECTOR, [0.0] * 8)
        for side in (0, 1):
            pointer = _row(context, build, signature.args[side], values[side], values[2], 3)
            for k in range(3):
                value = build.load(build.gep(pointer, [_constant(k)]))
                value = build.fneg(value) if side else value
                result = build.insert_element(result, value, _constant(4 * side + k))
        return result

    return _box(lower, upper, types.intp), generate


@intrinsic
def store_corners(typing: Any, lower: Any, upper: Any, row: Any, box: Any, factor: Any) -> Any:
    """Write a box, times ``factor``, to rows of (N, 3) float32 arrays."""

    def generate(context, build, signature, values):
        signs = ir.Constant(_VECTOR, [1.0] * 4 + [-1.0] * 4)
        factors = ir.Constant(_VECTOR, ir.Undefined)
        for lane in range(8):
            factors = build.insert_element(factors, values[4], _constant(lane))
        scaled = build.fmul(build.fmul(factors, signs), values[3])
        for side in (0, 1):
            pointer = _row(context, build, signature.args[side], values[side], values[2], 3)
            for k in range(3):
                build.store(_pick(build, scaled, 4 * side + k), build.gep(pointer, [_constant(k)]))
        return context.get_dummy_value()

    return types.void(lower, upper, types.intp, box, types.float32), generate


@intrinsic
def load_point(typing: Any, points: Any, row: Any, factor: Any) -> Any:
    """Return a row of 3 floats of either width, times a float64 ``factor``, as a point.

    The factor is a power of two that float32 holds, so that the product is rounded once.
    """

    def generate(context, build, signature, values):
        pointer = _row(context, build, signature.args[0], values[0], values[1], 3)
        result = ir.Constant(_VECTOR, [0.0] * 8)
        for k in range(3):
            value = build.load(build.gep(pointer, [_constant(k)]))
            if value.type == _FLOAT:
                value = build.fmul(value, build.fptrunc(values[2], _FLOAT))
            else:
                value = build.fptrunc(build.fmul(value, values[2]), _FLOAT)
            result = build.insert_element(result, value, _constant(k))
            result = build.insert_element(result, build.fneg(value), _constant(4 + k))
        return result

    return _box(points, types.intp, types.float64), generate


def _load_vertex(context: Any, build: Any, signature: Any, values: Any, before: int) -> Any:
    """Four floats from ``before`` in front of a vertex, of which three are it."""
    data = context.make_array(signature.args[0])(context, build, values[0]).data
    start = build.mul(values[1], ir.Constant(values[1].type, 3))
    start = build.sub(start, ir.Constant(start.type, before))
    pointer = build.bitcast(build.gep(data, [start]), ir.VectorType(_FLOAT, 4).as_pointer())
    found = build.load(pointer)
    found.align = 4
    order = [before, before + 1, before + 2, 3 - 3 * before] * 2
    found = build.shuffle_vector(found, found, ir.Constant(ir.VectorType(_INT, 8), order))
    factor = build.fptrunc(values[2], _FLOAT)
    factors = ir.Constant(_VECTOR, ir.Undefined)
    for lane in range(8):
        factors = build.insert_element(factors, factor, _constant(lane))
    signs = ir.Constant(_VECTOR, [1.0] * 4 + [-1.0] * 4)
    return build.fmul(found, build.fmul(factors, signs))


@intrinsic
def load_vertex(typing: Any, corners: Any, vertex: Any, factor: Any) -> Any:
    """Return a triangle's first or second vertex, times a float64 ``factor``, as a point.

    ``corners`` is an (N, 3, 3) float32 mesh, ``vertex`` counts all vertices, and the factor is a
    power of two that float32 holds. The spare lanes have a coordinate of the next vertex.
    """

    def generate(context, build, signature, values):
        return _load_vertex(context, build, signature, values, 0)

    return _box(corners, types.intp, types.float64), generate


@intrinsic
def load_last_vertex(typing: Any, corners: Any, vertex: Any, factor: Any) -> Any:
    """Return a triangle's third vertex likewise; the spare lanes are of the one before."""

    def generate(context, build, signature, values):
        return _load_vertex(context, build, signature, values, 1)

    return _box(corners, types.intp, types.float64), generate


@intrinsic
def prefetch(typing: Any, array: Any, element: Any) -> Any:
    """Ask for the cache line of an element of a contiguous array, by its place in memory."""

    def generate(context, build, signature, values):
        byte = ir.IntType(8).as_pointer()
        data = context.make_array(signature.args[0])(context, build, values[0]).data
        pointer = build.bitcast(build.gep(data, [values[1]]), byte)
        kind = ir.FunctionType(ir.VoidType(), [byte, _INT, _INT, _INT])
        ask = build.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        # To read, to be kept in all caches, as data.
        build.call(ask, [pointer, _constant(0), _constant(3), _constant(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


@intrinsic
def nothing(typing: Any) -> Any:
    """Return the box that adds nothing to a union."""

    def generate(context, build, signature, values):
        return ir.Constant(_VECTOR, [float("inf")] * 8)

    return _box(), generate


@intrinsic
def union(typing: Any, a: Any, b: Any) -> Any:
    """Return the smallest box around two."""

    def generate(context, build, signature, values):
        return build.select(build.fcmp_ordered("<", *values), *values)

    return _box(a, b), generate


@intrinsic
def widen(typing: Any, array: Any, row: Any, box: Any) -> Any:
    """Widen the box in a row to hold another.

    As a store of a selection this would become a masked store, for which the next load of
    the row has to wait; the minimum that knows no NaN stays one instruction.
    """

    def generate(context, build, signature, values):
        pointer = build.bitcast(
            _row(context, build, signature.args[0], values[0], values[1], 8), _VECTOR.as_pointer()
        )
        old = build.load(pointer)
        old.align = 4
        kind = ir.FunctionType(_VECTOR, [_VECTOR, _VECTOR])
        minimum = cgutils.get_or_insert_function(build.module, kind, "llvm.minnum.v8f32")
        new = build.call(minimum, [old, values[2]], fastmath=("nnan",))
        build.store(new, pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, box), generate


@intrinsic
def half_area(typing: Any, box: Any) -> Any:
    """Half the surface area: float32 ``dx * dy + (dx + dy) * dz``."""

    def generate(context, build, signature, values):
        low, high = _corners(build, values[0])
        # Minus the extents; the signs cancel in the products.
        extent = build.fadd(low, high)
        x, y, z = (_pick(build, extent, k) for k in range(3))
        return build.fadd(build.fmul(x, y), build.fmul(build.fadd(x, y), z))

    return types.float32(box), generate


@intrinsic
def half_area_exact(typing: Any, box: Any) -> Any:
    """Half the surface area in float64."""

    def generate(context, build, signature, values):
        double = ir.DoubleType()
        low, high = (
            build.fpext(corner, ir.VectorType(double, 4)) for corner in _corners(build, values[0])
        )
        extent = build.fadd(low, high)
        x, y, z = (_pick(build, extent, k) for k in range(3))
        return build.fadd(build.fadd(build.fmul(x, y), build.fmul(y, z)), build.fmul(z, x))

    return types.float64(box), generate


@intrinsic
def grid(typing: Any, box: Any, origin: Any, factor: Any, least: Any, greatest: Any) -> Any:
    """Return ``(box - origin) * factor`` rounded up, between ``least`` and ``greatest``.

    By lane, all five being boxes. With negative factors and the upper corner negated, the
    lower lanes come out as minus the cell that the box begins in, the upper ones as the
    cell behind its end.
    """

    def generate(context, build, signature, values):
        scaled = build.fmul(build.fsub(values[0], values[1]), values[2])
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        ceil = cgutils.get_or_insert_function(build.module, kind, "llvm.ceil.v8f32")
        cells = build.call(ceil, [scaled])
        cells = build.select(build.fcmp_ordered(">", cells, values[3]), cells, values[3])
        return build.select(build.fcmp_ordered("<", cells, values[4]), cells, values[4])

    return _box(box, origin, factor, least, greatest), generate


@intrinsic
def last_cells(typing: Any, cells: Any) -> Any:
    """Return minus the last cell that a box is in, in the lower lanes, from its :func:`grid`.

    A box that ends where a cell begins is not in it, but in the cell before.
    """

    def generate(context, build, signature, values):
        lanes = ir.Constant(ir.VectorType(_INT, 8), [4, 5, 6, 7, 0, 1, 2, 3])
        ends = build.shuffle_vector(values[0], values[0], lanes)
        last = build.fsub(ir.Constant(_VECTOR, [1.0] * 8), ends)
        return build.select(build.fcmp_ordered("<", last, values[0]), last, values[0])

    return _box(cells), generate


@intrinsic
def coordinate(typing: Any, box: Any, index: Any) -> Any:
    """Return one lane as it is, float32; upper corners are negated."""

    def generate(context, build, signature, values):
        return build.extract_element(values[0], values[1])

    return types.float32(box, types.intp), generate


@intrinsic
def lane(typing: Any, box: Any, index: Any) -> Any:
    """Return one lane, a whole number, as an integer."""

    def generate(context, build, signature, values):
        value = build.extract_element(values[0], values[1])
        return build.fptosi(value, context.get_value_type(types.intp))

    return types.intp(box, types.intp), generate
