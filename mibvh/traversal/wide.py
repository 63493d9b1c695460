"""The wide kernel: nodes of up to eight children, and lanes that fetch their next ray.

A lane's work is a group, the children of one node, and which of them are still to be visited: a
list of four bits per child, first to visit first. A step takes the first of the list, an inner node
or a triangle; of an inner node the rest of the list is pushed, and its children that are hit,
sorted, become the group. The next triangle of a leaf is a group of its own. Every lane goes through
rays of its own, a packet's side by side; after every few steps the lanes that are done fetch their
next one.

Closest-hit rays visit the nearest child first. Any-hit rays do too, or go by the tree's order,
where it has one.

Distances to the planes of 8-bit boxes are one multiply-add. Their rounding is below ``2**-13`` of a
grid step plus ``5 * 2**-24`` of the distance; the former is within :data:`_SLACK`, the latter
within :data:`_OUTWARD`. Float32 boxes are tested as the binary kernel tests them.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from mibvh.traversal.geometry import inverse, larger, slabs_of, smaller, triangle_hit
from mibvh.traversal.pages import ROW
from mibvh.traversal.records import Records
from mibvh.traversal.wide_rows import BASE_BITS, ENTRY, LARGEST, NETWORKS, SPAN
from mibvh.tree import MAX_DEPTH
from mibvh.variant import mitsuba

#: Words per ray: origin, direction, tmax, one spare.
RAY_ROW = 8
_OUTWARD = 1.0 + 2.0**-20
#: Boxes begin no nearer than this; a normal number even with four bits of it replaced.
_NEAREST = 2.0**-100
#: 8-bit boxes are widened by this share of the grid's length, 1/256 of a step.
_SLACK = 2.0**-16


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
    counts_out : tuple of four UInt32
        Inner nodes visited, child boxes tested, leaves visited and triangles tested, written if
        counted.
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
    # Inner nodes visited, child boxes tested, leaves visited, triangles tested.
    inner, boxes = dr.full(mi.UInt32, 0, n), dr.full(mi.UInt32, 0, n)
    leaves, tests = dr.full(mi.UInt32, 0, n), dr.full(mi.UInt32, 0, n)

    while busy:
        if todo == 0:
            # -- put away the ray that is done, fetch the next
            if begun:
                dr.scatter(t_out, dr.select(triangle == 0xFFFFFFFF, dr.inf, t), ray)
                dr.scatter(triangle_out, triangle, ray)
                if dr.hint(count, mode="scalar"):
                    dr.scatter(counts_out[0], inner, ray)
                    dr.scatter(counts_out[1], boxes, ray)
                    dr.scatter(counts_out[2], leaves, ray)
                    dr.scatter(counts_out[3], tests, ray)
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
                todo = dr.select(t >= 0, mi.UInt32(ENTRY), mi.UInt32(0))
                inner, boxes = mi.UInt32(0), mi.UInt32(0)
                leaves, tests = mi.UInt32(0), mi.UInt32(0)
        steps = mi.UInt32(0)
        while (todo != 0) & (steps < burst):
            steps += 1
            group, todo, top, t, triangle, counts = step(
                records,
                (o, d, inv),
                t,
                triangle,
                group,
                todo,
                (stack_group, stack_todo),
                top,
                (inner, boxes, leaves, tests),
                any_hit=any_hit,
                count=count,
            )
            inner, boxes, leaves, tests = counts


@dr.syntax
def step(
    records: Records,
    ray: tuple[Any, Any, Any],
    t: Any,
    triangle: Any,
    group: Any,
    todo: Any,
    stacks: tuple[Any, Any],
    top: Any,
    counts: tuple[Any, ...],
    *,
    any_hit: bool,
    count: bool,
) -> Any:
    """Visit the first of the children that are still to be visited: a node, or one triangle.

    Parameters
    ----------
    records : Records
    ray : (Point3f, Vector3f, Vector3f)
        Origin, direction and its inverse.
    t, triangle : Float, UInt32
        The current hit.
    group, todo : UInt32
        The children at hand, and which of them are still to be visited.
    stacks : two local arrays of UInt32
        Groups left for later, and which of their children are still to be visited.
    top : UInt32
        Entries of the stacks.
    counts : tuple of four UInt32
        Inner nodes visited, child boxes tested, leaves visited, triangles tested; as they are
        unless counted.
    any_hit, count : bool

    Returns
    -------
    group, todo, top, t, triangle, counts
    """
    mi = mitsuba()
    o, d, inv = ray
    stack_group, stack_todo = stacks
    inner, boxes, leaves, tests = counts
    span = 1 if records.wide.quantised else SPAN[records.wide.width]
    child = todo & (ENTRY - 1)
    rest = todo >> 4
    inners = group >> BASE_BITS
    at = (group & ((1 << BASE_BITS) - 1)) + child
    if dr.hint(span > 1, mode="scalar"):
        at += (span - 1) * smaller(child, inners)
    row = dr.gather(mi.ArrayXf, records.rows, at, shape=(ROW, dr.width(at)))
    if child < inners:
        if rest != 0:
            stack_group[top] = group
            stack_todo[top] = rest
            top += 1
        group, todo, tested = _visit(records, at, row, o, inv, t, any_hit, count)
        if dr.hint(count, mode="scalar"):
            inner += 1
            boxes += tested
    else:
        hit, distance = triangle_hit(row, o, d, t)
        t = dr.select(hit, distance, t)
        triangle = dr.select(hit, dr.reinterpret_array(mi.UInt32, row[12]), triangle)
        todo = mi.UInt32(rest)
        if dr.hint(count, mode="scalar"):
            tests += 1
            following = dr.reinterpret_array(mi.UInt32, row[13])
            leaves += dr.select((following == 0) | (hit & any_hit), 1, 0)
        if dr.hint(not records.single, mode="scalar"):
            more = dr.reinterpret_array(mi.UInt32, row[13])
            if more != 0:
                if rest != 0:
                    stack_group[top] = group
                    stack_todo[top] = rest
                    top += 1
                group = mi.UInt32(more)
                todo = mi.UInt32(ENTRY)
        if dr.hint(any_hit, mode="scalar"):
            top = dr.select(hit, 0, top)
            todo = dr.select(hit, 0, todo)
    if (todo == 0) & (top > 0):
        top -= 1
        group = stack_group[top]
        todo = stack_todo[top]
    return group, todo, top, t, triangle, (inner, boxes, leaves, tests)


@dr.syntax
def walk_wide_lanes(
    records: Records, o: Any, d: Any, tmax: Any, active: Any, *, any_hit: bool
) -> Any:
    """Trace one ray per lane through a wide tree; may be called inside symbolic loops.

    Parameters
    ----------
    records : Records
        In the wide layout.
    o : Point3f
        Origins in the records' units.
    d : Vector3f
    tmax : Float
        In the records' units.
    active : Bool
        Lanes that carry a ray.
    any_hit : bool
        End at the first hit found.

    Returns
    -------
    t : Float
        Distance of the hit; infinite for a miss.
    triangle : UInt32
        2**32 - 1 for a miss.
    """
    mi = mitsuba()
    n = dr.width(o)
    inv = inverse(d)
    stack_group = dr.alloc_local(mi.UInt32, MAX_DEPTH)
    stack_todo = dr.alloc_local(mi.UInt32, MAX_DEPTH)
    top = dr.full(mi.UInt32, 0, n)
    t = mi.Float(tmax)
    triangle = dr.full(mi.UInt32, 0xFFFFFFFF, n)
    group = dr.full(mi.UInt32, records.root << BASE_BITS, n)
    # A ray that can hit nothing has a negative tmax, and takes no steps.
    todo = dr.select(active & (tmax >= 0), mi.UInt32(ENTRY), mi.UInt32(0))
    uncounted = (mi.UInt32(0),) * 4
    while todo != 0:
        group, todo, top, t, triangle, _ = step(
            records,
            (o, d, inv),
            t,
            triangle,
            group,
            todo,
            (stack_group, stack_todo),
            top,
            uncounted,
            any_hit=any_hit,
            count=False,
        )
    return dr.select(triangle == 0xFFFFFFFF, dr.inf, t), triangle


def _visit(
    records: Records, at: Any, row: Any, o: Any, inv: Any, t: Any, any_hit: bool, count: bool
) -> tuple[Any, Any, Any]:
    """Test the boxes of a node's children.

    Returns
    -------
    group : UInt32
        The node's word.
    todo : UInt32
        List of the children that are hit, in the order to visit them.
    tested : UInt32
        How many boxes there are; 0 unless counted.
    """
    mi = mitsuba()
    stored = any_hit and records.order is not None
    if records.wide.quantised:
        words = [dr.reinterpret_array(mi.UInt32, row[i]) for i in range(ROW)]
        hits = _small_boxes(row, words, o, inv, t, records.wide.width)
        if stored:
            todo = _in_order(hits, dr.gather(mi.UInt32, records.order, at))
        else:
            todo = _nearest_first(hits)
        return words[3], todo, _present(words, records.wide.width) if count else mi.UInt32(0)
    width = records.wide.width
    values = list(row)
    for i in range(1, SPAN[width]):
        values += list(dr.gather(mi.ArrayXf, records.rows, at + i, shape=(ROW, dr.width(at))))
    word, order = (dr.reinterpret_array(mi.UInt32, values[6 * width + i]) for i in range(2))
    entries = [(order >> (4 * i)) & 0xF for i in range(width)]
    near = _plain_boxes(values, o, inv, t, width)
    todo = mi.UInt32(0)
    if not stored:
        for a, b in NETWORKS[width]:
            swap = near[b] < near[a]
            near[a], near[b] = smaller(near[a], near[b]), larger(near[a], near[b])
            entries[a], entries[b] = (
                dr.select(swap, entries[b], entries[a]),
                dr.select(swap, entries[a], entries[b]),
            )
    tested = mi.UInt32(0)
    for distance, entry in zip(reversed(near), reversed(entries), strict=True):
        todo = dr.select(distance < dr.inf, (todo << 4) | entry, todo)
        if count:
            tested += entry >> 3
    return word, todo, tested


def _plain_boxes(values: Any, o: Any, inv: Any, t: Any, width: int) -> list[Any]:
    """Where a ray enters each float32 box before ``t``; infinity for those it misses."""
    found = []
    for i in range(width):
        corners = [values[width * k + i] for k in range(6)]
        near, far = slabs_of(corners[:3], corners[3:], o, inv)
        found.append(dr.select(near <= smaller(far, t), near, dr.inf))
    return found


def _small_boxes(row: Any, words: Any, o: Any, inv: Any, t: Any, width: int) -> list[Any]:
    """Where a ray enters each 8-bit box before ``t``, infinity for those it misses.

    The child's list entry replaces the lowest bits; those of infinity are no entry.
    """
    mi = mitsuba()
    axes = []
    for k in range(3):
        # -- the axis's grid along the ray, and the words of the planes met first and last
        length = dr.reinterpret_array(mi.Float, ((127 + LARGEST) << 23) - ((words[k] & 63) << 23))
        origin = dr.reinterpret_array(mi.Float, words[k] & 0xFFFFFFC0)
        scale = length * inv[k]
        begin = (origin - o[k] - length) * inv[k]
        slack = dr.abs(scale) * _SLACK
        backwards = inv[k] < 0
        lower, upper = words[4 + 2 * k : 6 + 2 * k], words[10 + 2 * k : 12 + 2 * k]
        near = [dr.select(backwards, upper[i], lower[i]) for i in range(2)]
        far = [dr.select(backwards, lower[i], upper[i]) for i in range(2)]
        axes.append((scale, begin - slack, begin + slack, near, far))
    keys = []
    for child in range(width):
        near_x, near_y, near_z = (
            dr.fma(_unpack(near[child // 4], child % 4), scale, begin)
            for scale, begin, _, near, _ in axes
        )
        far_x, far_y, far_z = (
            dr.fma(_unpack(far[child // 4], child % 4), scale, begin)
            for scale, _, begin, _, far in axes
        )
        enters = larger(larger(near_x, near_y), larger(near_z, _NEAREST))
        leaves = smaller(smaller(far_x, far_y), far_z) * _OUTWARD
        key = (dr.reinterpret_array(mi.UInt32, enters) & 0xFFFFFFF0) | (ENTRY | child)
        keys.append(
            dr.select(enters <= smaller(leaves, t), dr.reinterpret_array(mi.Float, key), dr.inf)
        )
    return keys


def _nearest_first(keys: list[Any]) -> Any:
    """List of the children that are hit, by distance."""
    mi = mitsuba()
    for a, b in NETWORKS[len(keys)]:
        keys[a], keys[b] = smaller(keys[a], keys[b]), larger(keys[a], keys[b])
    todo = mi.UInt32(0)
    for key in reversed(keys):  # infinity ends in four zeros: no entry
        todo = (todo << 4) | (dr.reinterpret_array(mi.UInt32, key) & 0xF)
    return todo


def _in_order(keys: list[Any], order: Any) -> Any:
    """List of the children that are hit, in the tree's order."""
    mi = mitsuba()
    hit = mi.UInt32(0)
    for i, key in enumerate(keys):
        hit |= dr.select(key < dr.inf, mi.UInt32(1 << i), mi.UInt32(0))
    todo = mi.UInt32(0)
    for i in reversed(range(len(keys))):
        entry = (order >> (4 * i)) & 0xF
        listed = (entry >> 3) & (hit >> (entry & (ENTRY - 1))) & 1
        todo = dr.select(listed != 0, (todo << 4) | entry, todo)
    return todo


def _present(words: Any, width: int) -> Any:
    """How many of a node's 8-bit boxes are none of those that stand for no child."""
    mi = mitsuba()
    there = mi.UInt32(0)
    for i in range(width):
        lower, upper = ((words[at + i // 4] >> (8 * (i % 4))) & 0xFF for at in (4, 10))
        there += dr.select(lower <= upper, mi.UInt32(1), mi.UInt32(0))
    return there


def _unpack(word: Any, byte: int) -> Any:
    """``1 + b / 256`` of a byte of a word: its bits as the first of a mantissa."""
    shift = 15 - 8 * byte
    moved = word << shift if shift > 0 else word >> -shift
    return dr.reinterpret_array(mitsuba().Float, (moved & 0x7F8000) | 0x3F800000)
