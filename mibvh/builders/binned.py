"""`binned`: top-down SAH over a few bins of box centres.

Wald: *On fast Construction of SAH-based Bounding Volume Hierarchies* (IEEE Interactive Ray
Tracing 2007). Every node puts its references into equal bins along each axis, by where their
centres are within the box of all *centres*, and takes the plane between bins of least
``A_left N_left + A_right N_right``. The default of most renderers: close to the full sweep where
there are many references, and worse where few are left.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.measured import cost_of
from mibvh.builders.options import Options, option
from mibvh.builders.registry import Context, builder
from mibvh.builders.simd import load, nothing, store, union, widen
from mibvh.builders.splitting import pack_boxes
from mibvh.triangles import Triangles


@njit
def _center_bounds(boxes, order, begin, end, low, high):
    """Least and greatest of twice the centres, on each axis."""
    for k in range(3):
        low[k], high[k] = np.inf, -np.inf
        for i in range(begin, end):
            center = boxes[order[i], k] - boxes[order[i], k + 4]
            low[k], high[k] = min(low[k], center), max(high[k], center)


@njit
def _bin(boxes, row, axis, low, factor, bins):
    """Bin of a reference on an axis."""
    return min(bins - 1, np.int64((boxes[row, axis] - boxes[row, axis + 4] - low) * factor))


@njit
def _best_plane(measure, boxes, order, begin, end, axis, low, factor, bins, bin_box, number, areas):
    """Fill the bins of one axis, and sweep them; return the least cost and the bin behind it."""
    for b in range(bins):
        store(bin_box, b, nothing())
        number[b] = 0
    for i in range(begin, end):
        b = _bin(boxes, order[i], axis, low, factor, bins)
        widen(bin_box, b, load(boxes, np.int64(order[i])))
        number[b] += 1
    side = nothing()
    for b in range(bins - 1, 0, -1):
        side = union(side, load(bin_box, b))
        areas[b] = cost_of(measure, side)
    side, best, at, left = nothing(), np.inf, 0, 0
    for b in range(1, bins):
        side = union(side, load(bin_box, b - 1))
        left += number[b - 1]
        if left == 0 or left == end - begin:
            continue
        cost = cost_of(measure, side) * left + areas[b] * (end - begin - left)
        if cost < best:
            best, at = cost, b
    return best, at


@njit
def _build(measure, boxes, bins, left, right, reference):
    """Build all; a range of n references owns 2 n - 1 nodes."""
    order = np.arange(len(boxes)).astype(np.int32)
    spare = np.empty(len(boxes), np.int32)
    low, high = np.empty(3, np.float32), np.empty(3, np.float32)
    bin_box = np.empty((bins, 8), np.float32)
    number, areas = np.empty(bins, np.int64), np.empty(bins, np.float32)
    stack = np.empty((len(boxes) + 1, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2], top = 0, len(boxes), 0, 1
    while top > 0:
        top -= 1
        begin, end, node = stack[top, 0], stack[top, 1], stack[top, 2]
        if end - begin == 1:
            left[node], right[node], reference[node] = -1, -1, order[begin]
            continue
        _center_bounds(boxes, order, begin, end, low, high)
        best, axis, at, factor = np.inf, -1, 0, np.float32(0)
        for k in range(3):
            # As a reciprocal it may overflow: then all of the axis is in one bin.
            scale = np.float32(bins) / (high[k] - low[k]) if high[k] > low[k] else np.float32(0)
            if not 0 < scale < np.float32(1e30):
                continue
            cost, plane = _best_plane(
                measure, boxes, order, begin, end, k, low[k], scale, bins, bin_box, number, areas
            )
            if cost < best:
                best, axis, at, factor = cost, k, plane, scale
        middle = begin + (end - begin) // 2
        if axis >= 0:
            middle, others = begin, 0
            for i in range(begin, end):
                if _bin(boxes, order[i], axis, low[axis], factor, bins) < at:
                    order[middle] = order[i]
                    middle += 1
                else:
                    spare[others] = order[i]
                    others += 1
            for i in range(others):
                order[middle + i] = spare[i]
        left[node], right[node], reference[node] = node + 1, node + 2 * (middle - begin), -1
        stack[top, 0], stack[top, 1], stack[top, 2] = middle, end, right[node]
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = begin, middle, left[node]
        top += 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class BinnedOptions(Options):
    """Options of `binned`."""

    bins: int = option(16, "bins per axis; more is slower and nearer to the full sweep", 2, 256)


@builder(
    "binned",
    summary="top-down SAH over 16 bins of box centres per axis",
    source="Wald 2007",
    options=BinnedOptions,
    memory=130,
)
def binned(triangles: Triangles, options: BinnedOptions, context: Context) -> Draft:
    """Build the binned SAH tree; O(n log n), on one thread."""
    refs = References.of(triangles)
    left, right, reference = np.empty((3, 2 * len(refs) - 1), np.int32)
    measure = context.compiled_measure(refs.scale)
    _build(measure, pack_boxes(refs), options.bins, left, right, reference)
    return Draft(refs, left, right, reference)
