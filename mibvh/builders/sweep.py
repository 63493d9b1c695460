"""`bbvh`: top-down full-sweep SAH.

MacDonald and Booth: *Heuristics for ray tracing using space subdivision* (The Visual
Computer 1990). Every node tries all splits between neighbours in the order of box centres,
on all three axes, and takes the one of least ``A_left N_left + A_right N_right`` (ties: the
most even one, then the lower axis). References are sorted once per axis; each split
partitions the three lists stably, so that they stay sorted.
"""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References, centers_twice
from mibvh.builders.radix import argsort_keys, float_keys
from mibvh.builders.registry import Context, Options, builder
from mibvh.triangles import Triangles


@njit
def _sweep_axis(order, begin, end, box, right_area, best_cost, best_even, axis, best_axis, best_at):
    """Try every split of one axis. Returns the best (cost, evenness, axis, position) so far."""
    n = end - begin
    inf = np.float32(np.inf)
    x0, y0, z0, x1, y1, z1 = inf, inf, inf, -inf, -inf, -inf
    for i in range(n - 1, 0, -1):
        r = order[begin + i]
        x0, y0, z0 = min(x0, box[r, 0]), min(y0, box[r, 1]), min(z0, box[r, 2])
        x1, y1, z1 = max(x1, box[r, 4]), max(y1, box[r, 5]), max(z1, box[r, 6])
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        right_area[i] = dx * dy + (dx + dy) * dz
    x0, y0, z0, x1, y1, z1 = inf, inf, inf, -inf, -inf, -inf
    for i in range(n - 1):
        r = order[begin + i]
        x0, y0, z0 = min(x0, box[r, 0]), min(y0, box[r, 1]), min(z0, box[r, 2])
        x1, y1, z1 = max(x1, box[r, 4]), max(y1, box[r, 5]), max(z1, box[r, 6])
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        area = dx * dy + (dx + dy) * dz
        cost = area * np.float32(i + 1) + right_area[i + 1] * np.float32(n - i - 1)
        if cost <= best_cost:
            even = abs(2 * (i + 1) - n)
            if cost < best_cost or even < best_even:
                best_cost, best_even, best_axis, best_at = cost, even, axis, i + 1
    return best_cost, best_even, best_axis, best_at


@njit
def _partition(order, begin, end, is_left, buffer):
    """Stable partition: the marked references first."""
    a, b = begin, 0
    for i in range(begin, end):
        r = order[i]
        if is_left[r]:
            order[a] = r
            a += 1
        else:
            buffer[b] = r
            b += 1
    for i in range(b):
        order[a + i] = buffer[i]


@njit
def _build(box, order0, order1, order2):
    """The whole tree. A range of n references owns 2n - 1 consecutive nodes."""
    n = len(order0)
    left = np.full(2 * n - 1, -1, np.int32)
    right = np.full(2 * n - 1, -1, np.int32)
    reference = np.full(2 * n - 1, -1, np.int32)
    is_left = np.zeros(n, np.bool_)
    buffer = np.empty(n, np.int32)
    right_area = np.empty(n + 1, np.float32)
    stack = np.empty((n + 1, 3), np.int32)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, n, 0
    top = 1
    while top > 0:
        top -= 1
        begin, end, node = stack[top, 0], stack[top, 1], stack[top, 2]
        if end - begin == 1:
            reference[node] = order0[begin]
            continue
        cost, even, axis, at = np.float32(np.inf), end - begin + 1, 0, 1
        cost, even, axis, at = _sweep_axis(
            order0, begin, end, box, right_area, cost, even, 0, axis, at
        )
        cost, even, axis, at = _sweep_axis(
            order1, begin, end, box, right_area, cost, even, 1, axis, at
        )
        cost, even, axis, at = _sweep_axis(
            order2, begin, end, box, right_area, cost, even, 2, axis, at
        )
        chosen = order0 if axis == 0 else (order1 if axis == 1 else order2)
        for i in range(begin, end):
            is_left[chosen[i]] = i < begin + at
        if axis != 0:
            _partition(order0, begin, end, is_left, buffer)
        if axis != 1:
            _partition(order1, begin, end, is_left, buffer)
        if axis != 2:
            _partition(order2, begin, end, is_left, buffer)
        left[node] = node + 1
        right[node] = node + 2 * at
        stack[top, 0], stack[top, 1], stack[top, 2] = begin + at, end, node + 2 * at
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = begin, begin + at, node + 1
        top += 2
    return left, right, reference


@builder(
    "bbvh",
    summary="top-down full sweep: the split of least A_l N_l + A_r N_r, all axes, all positions",
    source="MacDonald and Booth 1990",
)
def bbvh(triangles: Triangles, options: Options, context: Context) -> Draft:
    """Build the full-sweep SAH tree; O(n log n)."""
    refs = References.of(triangles)
    centers = centers_twice(refs)
    orders = [argsort_keys(float_keys(centers[:, k]), 32) for k in range(3)]
    box = np.zeros((len(refs), 8), np.float32)
    box[:, 0:3] = refs.lower
    box[:, 4:7] = refs.upper
    return Draft(refs, *_build(box, *orders))
