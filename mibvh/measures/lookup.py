"""Reading the summed tables: the measure of a box, for Numba kernels.

A box has six coordinates, each between two planes, and so 64 numbers to be weighted: eight corners
of the box, and for each of them eight crossings of planes around it. They are read in pairs along
z, four corners of crossings at a time in a vector register. Numba's scalars take four times as
long, so the sum is spelt out in LLVM's own terms; LLVM maps vectors to whatever the machine has,
and adds in the order that is written here, so that every machine finds the same.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from mibvh._jit import njit
from mibvh.triangles import F32, I32

#: Cells per axis of the lookup from a coordinate to the plane below it.
CELLS = 4096


class FluxTables(NamedTuple):
    """What the compiled measure reads.

    Attributes
    ----------
    table : (P * P * P * 16,) float32
        ``T_c`` at each crossing of three planes, and at the next plane on z; whole numbers.
    planes : (3 * P,) float32
        In builder units, rising along each axis.
    above : (3 * P,) float32
        The next plane; for the last two NaN, which no coordinate is above, not even infinity.
    inverse : (3 * P,) float32
        One over the distance to the next plane.
    cells : (3 * CELLS,) int32
        For each cell of equal size a plane at or below its beginning, if any is, and near it: its
        place in ``planes``.
    lookup : (6,) float32
        Origin of the cells of each axis, and cells per unit.
    per_axis : int
        P.
    area_weight, share_weight : float
        The measure is the first times half the area plus the second times the number of
        segments that touch the box.
    """

    table: F32
    planes: F32
    above: F32
    inverse: F32
    cells: I32
    lookup: F32
    per_axis: int
    area_weight: float
    share_weight: float


_DOUBLE = ir.DoubleType()
_PAIR = ir.VectorType(ir.FloatType(), 2)
_FOUR = ir.VectorType(_DOUBLE, 4)
_INT = ir.IntType(32)
_LANES = ir.Constant(ir.VectorType(_INT, 4), [0, 1, 2, 3])


def _four(build: Any, values: list[Any]) -> Any:
    """Four numbers in a vector."""
    result = ir.Constant(_FOUR, ir.Undefined)
    for lane, value in enumerate(values):
        result = build.insert_element(result, value, ir.Constant(_INT, lane))
    return result


@intrinsic
def _blend(typing: Any, table: Any, places: Any, step_x: Any, step_y: Any, shares: Any) -> Any:
    """Sum the numbers of the eight corners, interpolated between planes.

    ``places`` are those of the planes below: low x, high x, low y, ... times their steps in the
    table; ``shares`` of the way to the next plane likewise.
    """

    def generate(context, build, signature, values):
        data = context.make_array(signature.args[0])(context, build, values[0]).data
        places = [build.extract_value(values[1], i) for i in range(6)]
        shares = [build.extract_value(values[4], i) for i in range(6)]
        # Weight of the plane below, and of the one above, for each coordinate.
        weights = [(build.fsub(ir.Constant(_DOUBLE, 1.0), share), share) for share in shares]
        total = ir.Constant(_FOUR, [0.0] * 4)
        for y in range(2):
            for z in range(2):
                inner = ir.Constant(_FOUR, [0.0] * 4)
                for x in range(2):
                    corner = 4 * x + 2 * y + z
                    row = build.add(places[x], build.add(places[2 + y], places[4 + z]))
                    row = build.add(row, ir.Constant(row.type, 2 * corner))
                    for above in range(2):
                        if above:
                            row = build.add(row, values[2])
                        pairs = []
                        for place in (row, build.add(row, values[3])):
                            pointer = build.bitcast(build.gep(data, [place]), _PAIR.as_pointer())
                            pair = build.load(pointer)
                            pair.align = 4
                            pairs.append(pair)
                        four = build.fpext(build.shuffle_vector(*pairs, _LANES), _FOUR)
                        weight = _four(build, [weights[x][above]] * 4)
                        inner = build.fadd(inner, build.fmul(four, weight))
                on_y, on_z = weights[2 + y], weights[4 + z]
                products = [build.fmul(a, b) for a in on_y for b in on_z]
                total = build.fadd(total, build.fmul(inner, _four(build, products)))
        parts = [build.extract_element(total, ir.Constant(_INT, lane)) for lane in range(4)]
        return build.fadd(build.fadd(parts[0], parts[1]), build.fadd(parts[2], parts[3]))

    places_type, shares_type = types.UniTuple(types.intp, 6), types.UniTuple(types.float64, 6)
    return types.float64(table, places_type, types.intp, types.intp, shares_type), generate


@njit(allocates=False)
def _plane_below(tables, axis, value):
    """Place of the last plane at or below a coordinate, but the last; the share to the next."""
    at = (value - tables.lookup[axis]) * tables.lookup[axis + 3]
    cell = np.int64(min(max(at, np.float32(0)), np.float32(CELLS - 1)))
    plane = np.uint64(tables.cells[np.uint64(axis * CELLS + cell)])
    # Most cells have no plane in them and few have two: without a branch, but for those.
    plane += np.uint64(tables.above[plane] <= value)
    while tables.above[plane] <= value:
        plane += np.uint64(1)
    beyond = np.float64(value) - np.float64(tables.planes[plane])
    share = beyond * tables.inverse[plane]
    return np.int64(plane) - axis * tables.per_axis, min(max(share, 0.0), 1.0)


@njit(allocates=False)
def touched(tables, x0, y0, z0, x1, y1, z1):
    """Count the segments that touch a box; float64, interpolated between planes."""
    i0, u0 = _plane_below(tables, 0, x0)
    i1, u1 = _plane_below(tables, 0, x1)
    j0, v0 = _plane_below(tables, 1, y0)
    j1, v1 = _plane_below(tables, 1, y1)
    k0, w0 = _plane_below(tables, 2, z0)
    k1, w1 = _plane_below(tables, 2, z1)
    step_y = 16 * tables.per_axis
    step_x = step_y * tables.per_axis
    places = (i0 * step_x, i1 * step_x, j0 * step_y, j1 * step_y, 16 * k0, 16 * k1)
    total = _blend(tables.table, places, step_x, step_y, (u0, u1, v0, v1, w0, w1))
    return max(total, 0.0)


@njit(allocates=False)
def touched_share(tables, x0, y0, z0, x1, y1, z1):
    """Measure of a box: weighted half area plus weighted count of segments that touch it."""
    x = np.float64(x1) - np.float64(x0)
    y = np.float64(y1) - np.float64(y0)
    z = np.float64(z1) - np.float64(z0)
    area = x * y + (x + y) * z
    return tables.area_weight * area + tables.share_weight * touched(tables, x0, y0, z0, x1, y1, z1)
