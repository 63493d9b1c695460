"""The fastest kernel: nodes of eight children, and lanes that fetch their next ray.

A lane's work is a group, the children of one node, and which of them are still to be visited: a
list of four bits per child, nearest first. A step takes the first of the list, an inner node or
a triangle; of an inner node the rest of the list is pushed, and its children that are hit,
sorted, become the group. Every lane goes through rays of its own, a packet's side by side; after
every few steps the lanes that are done fetch their next one.

Distances to the grid's planes are one multiply-add. Their rounding is below ``2**-13`` of a grid
step plus ``5 * 2**-24`` of the distance; the former is within what the collapse widens boxes by,
the latter within :data:`_OUTWARD`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from mibvh.traversal.collapse import BASE_BITS, LARGEST, WIDTH
from mibvh.traversal.geometry import inverse, larger, smaller, triangle_hit
from mibvh.traversal.records import ROW, Records
from mibvh.tree import MAX_DEPTH
from mibvh.variant import mitsuba

#: Words per ray: origin, direction, tmax, one spare.
RAY_ROW = 8
_OUTWARD = 1.0 + 2.0**-20
#: Boxes begin no nearer than this; a normal number even with four bits of it replaced.
_NEAREST = 2.0**-100
#: Batcher's sorting network for eight.
_NETWORK = (
    (0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (1, 2), (5, 6),
    (0, 4), (1, 5), (2, 6), (3, 7), (2, 4), (3, 5), (1, 2), (3, 4), (5, 6),
)  # fmt: skip


@dr.syntax
def walk_wide(
    records: Records,
    rays: Any,
    first: Any,
    end: Any,
    stride: int,
    burst: Any,
    t_out: Any,
    triangle_out: Any,
    counts_out: Any,
    *,
    count: bool,
    any_hit: bool,
) -> None:
    """Trace rays through a wide tree.

    Parameters
    ----------
    records : Records
        In the wide layout.
    rays : Float
        Rows of :data:`RAY_ROW`: origin and tmax in the records' units.
    first, end : UInt32
        Each lane takes the rays ``first, first + stride, ...`` before ``end``.
    stride : int
    burst : UInt32
        Steps between fetches, opaque.
    t_out, triangle_out : Float, UInt32
        Written at each ray's place: distance of the closest hit, infinite for a miss, and the
        triangle's id, 2**32 - 1 for a miss.
    counts_out : tuple of two UInt32
        Inner nodes visited and triangles tested, written if counted.
    count, any_hit : bool
    """
    mi = mitsuba()
    n = dr.width(first)
    # Groups left for later, and which of their children are still to be visited.
    stack_group = dr.alloc_local(mi.UInt32, MAX_DEPTH)
    stack_todo = dr.alloc_local(mi.UInt32, MAX_DEPTH)
    top = dr.full(mi.UInt32, 0, n)  # entries of the stacks
    ray = mi.UInt32(first)  # the ray that the lane traces
    begun = dr.full(mi.Bool, False, n)  # it has one
    busy = first < end  # it has one, or is to fetch its first
    o, d = dr.zeros(mi.Point3f, n), dr.zeros(mi.Vector3f, n)
    inv = dr.zeros(mi.Vector3f, n)  # 1 / d
    t = dr.full(mi.Float, 0, n)  # distance of the current hit
    triangle = dr.full(mi.UInt32, 0, n)  # the current hit
    # The children at hand, and which of them are still to be visited.
    group, todo = dr.full(mi.UInt32, 0, n), dr.full(mi.UInt32, 0, n)
    # Inner nodes visited, triangles tested.
    inner, tests = dr.full(mi.UInt32, 0, n), dr.full(mi.UInt32, 0, n)

    while busy:
        if todo == 0:
            # -- put away the ray that is done, fetch the next
            if begun:
                dr.scatter(t_out, dr.select(triangle == 0xFFFFFFFF, dr.inf, t), ray)
                dr.scatter(triangle_out, triangle, ray)
                if dr.hint(count, mode="scalar"):
                    dr.scatter(counts_out[0], inner, ray)
                    dr.scatter(counts_out[1], tests, ray)
                ray += stride
            begun = mi.Bool(True)
            busy = ray < end
            if busy:
                fetched = dr.gather(mi.ArrayXf, rays, ray, shape=(RAY_ROW, n))
                o = mi.Point3f(fetched[0], fetched[1], fetched[2])
                d = mi.Vector3f(fetched[3], fetched[4], fetched[5])
                inv = inverse(d)
                t = mi.Float(fetched[6])
                triangle = mi.UInt32(0xFFFFFFFF)
                group = mi.UInt32(records.root << BASE_BITS)
                # A ray that can hit nothing has a negative tmax, and takes no steps.
                todo = dr.select(t >= 0, mi.UInt32(WIDTH), mi.UInt32(0))
                inner, tests = mi.UInt32(0), mi.UInt32(0)
        steps = mi.UInt32(0)
        while (todo != 0) & (steps < burst):
            steps += 1
            child = todo & (WIDTH - 1)
            rest = todo >> 4
            at = (group & ((1 << BASE_BITS) - 1)) + child
            row = dr.gather(mi.ArrayXf, records.rows, at, shape=(ROW, n))
            if child < (group >> BASE_BITS):
                if rest != 0:
                    stack_group[top] = group
                    stack_todo[top] = rest
                    top += 1
                group = dr.reinterpret_array(mi.UInt32, row[3])
                todo = _children_hit(row, o, inv, t)
                if dr.hint(count, mode="scalar"):
                    inner += 1
            else:
                hit, distance = triangle_hit(row, o, d, t)
                t = dr.select(hit, distance, t)
                triangle = dr.select(hit, dr.reinterpret_array(mi.UInt32, row[12]), triangle)
                todo = mi.UInt32(rest)
                if dr.hint(count, mode="scalar"):
                    tests += 1
                if dr.hint(any_hit, mode="scalar"):
                    top = dr.select(hit, 0, top)
                    todo = dr.select(hit, 0, todo)
            if (todo == 0) & (top > 0):
                top -= 1
                group = stack_group[top]
                todo = stack_todo[top]


def _children_hit(row: Any, o: Any, inv: Any, t: Any) -> Any:
    """List of the children that a ray hits before ``t``, nearest first, four bits each."""
    mi = mitsuba()
    words = [dr.reinterpret_array(mi.UInt32, row[i]) for i in range(ROW)]
    axes = []
    for k in range(3):
        # -- the axis's grid along the ray, and the words of the planes met first and last
        length = dr.reinterpret_array(mi.Float, ((127 + LARGEST) << 23) - ((words[k] & 63) << 23))
        begin = (row[k] - o[k] - length) * inv[k]
        backwards = inv[k] < 0
        lower, upper = words[4 + 2 * k : 6 + 2 * k], words[10 + 2 * k : 12 + 2 * k]
        near = [dr.select(backwards, upper[i], lower[i]) for i in range(2)]
        far = [dr.select(backwards, lower[i], upper[i]) for i in range(2)]
        axes.append((length * inv[k], begin, near, far))
    keys = []
    for child in range(WIDTH):
        near_x, near_y, near_z = (
            dr.fma(_unpack(near[child // 4], child % 4), scale, begin)
            for scale, begin, near, _ in axes
        )
        far_x, far_y, far_z = (
            dr.fma(_unpack(far[child // 4], child % 4), scale, begin)
            for scale, begin, _, far in axes
        )
        enters = larger(larger(near_x, near_y), larger(near_z, _NEAREST))
        leaves = smaller(smaller(far_x, far_y), far_z) * _OUTWARD
        # Sorted by distance, the child's list entry in the lowest bits.
        key = (dr.reinterpret_array(mi.UInt32, enters) & 0xFFFFFFF0) | (WIDTH | child)
        keys.append(
            dr.select(enters <= smaller(leaves, t), dr.reinterpret_array(mi.Float, key), dr.inf)
        )
    for a, b in _NETWORK:
        keys[a], keys[b] = smaller(keys[a], keys[b]), larger(keys[a], keys[b])
    todo = mi.UInt32(0)
    for key in reversed(keys):  # infinity ends in four zeros: no entry
        todo = (todo << 4) | (dr.reinterpret_array(mi.UInt32, key) & 0xF)
    return todo


def _unpack(word: Any, byte: int) -> Any:
    """``1 + b / 256`` of a byte of a word: its bits as the first of a mantissa."""
    shift = 15 - 8 * byte
    moved = word << shift if shift > 0 else word >> -shift
    return dr.reinterpret_array(mitsuba().Float, (moved & 0x7F8000) | 0x3F800000)
