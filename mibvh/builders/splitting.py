"""Splitting references: one box of a triangle into two tight ones, and splitting up front.

The primitive cuts the part of a triangle inside its box at an axis plane and boxes both
sides: Stich, Friedrich, Dietrich: *Spatial Splits in Bounding Volume Hierarchies* (HPG 2009).
Pre-splitting gives each triangle a number of cuts before any tree is built: section 5 of
Karras and Aila: *Fast Parallel Construction of High-Quality Bounding Volume Hierarchies*
(HPG 2013).

Compiled code here keeps boxes as the rows of :mod:`mibvh.builders.simd`: lower corner, a spare
lane, minus the upper corner, a spare lane. Corners are in scene units and are scaled to
builder units in float64, where the scale, a power of two, loses nothing. All clipping is done
in float64 too, and its results are rounded outward to float32.
"""

from __future__ import annotations

import math

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.simd import prefetch
from mibvh.errors import MibvhError
from mibvh.parallel import run_blocks
from mibvh.triangles import F32, Triangles

#: Most corners a triangle can have after clipping to a box and cutting at a plane, and one.
MAX_CORNERS = 12
#: How many references before its turn a triangle is asked for from memory.
AHEAD = 12
#: Spatial median planes are told apart down to this level: the cells of 63-bit Morton codes.
_LEVELS = 21
#: Triangles of a block that one thread splits.
_BLOCK = 4096

# ------------------------------------------------------------------ the primitive


@njit(allocates=False)
def round_down(value):
    """Largest float32 not above a float64."""
    rounded = np.float32(value)
    if np.float64(rounded) > value:
        rounded = np.nextafter(rounded, np.float32(-np.inf))
    return rounded


@njit(allocates=False)
def round_up(value):
    """Smallest float32 not below a float64."""
    rounded = np.float32(value)
    if np.float64(rounded) < value:
        rounded = np.nextafter(rounded, np.float32(np.inf))
    return rounded


@njit(allocates=False, forceinline=True)
def _cut(polygon, size, axis, plane, side, out):
    """Write the part of a convex polygon with ``side * x[axis] >= side * plane`` to ``out``.

    One step of Sutherland and Hodgman. Returns the new number of corners.
    """
    kept = 0
    a = side * (polygon[0, axis] - plane)
    for i in range(size):
        j = i + 1 if i + 1 < size else 0
        b = side * (polygon[j, axis] - plane)
        if a >= 0.0:
            for k in range(3):
                out[kept, k] = polygon[i, k]
            kept += 1
        if (a < 0.0 < b) or (b < 0.0 < a):
            t = a / (a - b)
            for k in range(3):
                out[kept, k] = polygon[i, k] + t * (polygon[j, k] - polygon[i, k])
            out[kept, axis] = plane  # exactly, or the two sides of a cut would not meet
            kept += 1
        a = b
    return kept


@njit(allocates=False)
def expect(corners, triangle):
    """Fetch a triangle of a mesh, (N, 3, 3) float32, that will be needed soon."""
    # Nine numbers are on two cache lines at most.
    prefetch(corners, 9 * triangle)
    prefetch(corners, 9 * triangle + 8)


@njit(allocates=False, forceinline=True)
def clip_to_box(corners, triangle, scale, boxes, row, polygon, spare):
    """Write the part of a triangle inside a box; return its number of corners (0: none).

    Parameters
    ----------
    corners : (N, 3, 3) float32
        The mesh, in scene units.
    triangle : int
    scale : float64
        From scene to builder units.
    boxes : (R, 8) float32
    row : int
        The box.
    polygon, spare : (MAX_CORNERS, 3) float64
        Result, and scratch.
    """
    crossed = 0
    for k in range(3):
        low, high = np.float64(boxes[row, k]), -np.float64(boxes[row, k + 4])
        for i in range(3):
            x = np.float64(corners[triangle, i, k]) * scale
            polygon[i, k] = x
            crossed |= (x < low) << (2 * k) | (x > high) << (2 * k + 1)
    # Most planes of most boxes cut nothing off.
    size, swapped, source, target = 3, False, polygon, spare
    for plane in range(6):
        if (crossed >> plane) & 1:
            k, upper = plane >> 1, plane & 1
            side = 1.0 - 2.0 * upper
            limit = side * np.float64(boxes[row, k + 4 * upper])
            size = _cut(source, size, k, limit, side, target)
            source, target, swapped = target, source, not swapped
    for i in range(size if swapped else 0):
        for k in range(3):
            polygon[i, k] = spare[i, k]
    return size


@njit(allocates=False)
def split_reference(corners, triangle, scale, boxes, row, axis, plane, left, right, polygon, spare):
    """Cut a reference at an axis plane and box both parts.

    The part of the triangle inside the box is cut, so the new boxes are tight however often
    the reference was split before. They are rounded outward, lie inside the old box, and meet
    at the plane.

    Parameters
    ----------
    corners, triangle, scale, boxes, row, polygon, spare
        As for :func:`clip_to_box`.
    axis : int
    plane : float32
        Strictly inside the box on that axis.
    left, right : (8,) float32
        Where the new boxes go.

    Returns
    -------
    int
        3: both parts hold something; 1 (2): nothing of the triangle is right (left) of the
        plane, and only ``left`` (``right``) was written.
    """
    cut = np.float64(plane)
    size = clip_to_box(corners, triangle, scale, boxes, row, polygon, spare)
    if size == 0:
        # A box that the triangle only grazes, and misses by rounding: cut the box alone.
        for k in range(8):
            left[k] = boxes[row, k]
            right[k] = boxes[row, k]
        left[axis + 4] = -plane
        right[axis] = plane
        return 3
    found = 0
    for i in range(size):
        if polygon[i, axis] < cut:
            found |= 1
        elif polygon[i, axis] > cut:
            found |= 2
    if found == 0:  # all of it lies in the plane
        found = 1
    for half in range(2):
        if found & (half + 1):
            _box_of_half(polygon, size, axis, cut, half, boxes, row, left if half == 0 else right)
    return found


@njit(allocates=False)
def _box_of_half(polygon, size, axis, cut, half, boxes, row, out):
    """Box the corners on one side of the plane and the points where edges cross it."""
    side = 1.0 - 2.0 * half
    for k in range(3):
        low, high = np.inf, -np.inf
        for i in range(size):
            j = i + 1 if i + 1 < size else 0
            a = side * (cut - polygon[i, axis])
            b = side * (cut - polygon[j, axis])
            if a >= 0.0:
                low, high = min(low, polygon[i, k]), max(high, polygon[i, k])
            if (a < 0.0 < b) or (b < 0.0 < a):
                value = cut
                if k != axis:
                    value = polygon[i, k] + a / (a - b) * (polygon[j, k] - polygon[i, k])
                low, high = min(low, value), max(high, value)
        # Into the old box, which may be tighter by a rounding than the clipped polygon.
        least, most = boxes[row, k], -boxes[row, k + 4]
        out[k] = min(max(round_down(low), least), most)
        out[k + 4] = -max(min(round_up(high), most), least)


def pack_boxes(references: References) -> F32:
    """(R, 8) float32: the rows that the compiled code of this file works on."""
    boxes = np.zeros((len(references), 8), np.float32)
    boxes[:, 0:3] = references.lower
    boxes[:, 4:7] = -references.upper
    return boxes


# ------------------------------------------------------------------ splitting up front


@njit(allocates=False)
def _dominant_plane(boxes, row, origin, extent):
    """Find the coarsest spatial median plane of the scene box that a box straddles.

    The planes of level ``-i`` cut the scene box into cells of ``2**i`` of its extent. On one
    axis, number the planes of the finest level; of those strictly inside the box, the
    coarsest has the most trailing zeros, and the first and last number show which it is: the
    highest bit in which they differ is its level. Among planes of one level, the axis on
    which the box is longest is taken.

    Returns
    -------
    (level, axis, plane)
        Level from -1 (the middle of the scene) down to -21; ``plane`` as float32. Level 0:
        the box straddles no plane.
    """
    best, best_axis, best_plane, best_length = 0, 0, np.float32(0), np.float32(0)
    cells = float(1 << _LEVELS)
    for k in range(3):
        length = -boxes[row, k + 4] - boxes[row, k]
        if not (extent[k] > 0.0 and length > 0.0):
            continue
        a = math.floor((np.float64(boxes[row, k]) - origin[k]) / extent[k] * cells)
        b = math.ceil((-np.float64(boxes[row, k + 4]) - origin[k]) / extent[k] * cells) - 1
        a, b = max(a, 0), min(b, (1 << _LEVELS) - 1)
        level, plane = 0, np.float32(0)
        while a < b:
            bit = 0
            while (a ^ b) >> (bit + 1):
                bit += 1
            number = (b >> bit) << bit
            plane = np.float32(origin[k] + extent[k] * (float(number) / cells))
            # A face of the box on a plane can be numbered on its wrong side by a rounding.
            if plane <= boxes[row, k]:
                a = number
            elif plane >= -boxes[row, k + 4]:
                b = number - 1
            else:
                level = bit - _LEVELS
                break
        if level == 0:
            continue
        if best == 0 or level > best or (level == best and length > best_length):
            best, best_axis, best_plane, best_length = level, k, plane, length
    return best, best_axis, best_plane


@njit(allocates=False)
def _priorities(begin, end, out, corners, scale, boxes, origin, extent):
    """Fill a part of (N,) float64: ``(2**i * (A_box - A_ideal)) ** (1/3)``.

    It stays 0 for what cannot be split.

    ``A_box`` is the box's surface area; ``A_ideal``, the area that infinitely many splits
    would come to, is the sum of the components of the cross product of two edges. The factor
    ``2**i`` prefers triangles that cross the planes near the root.
    """
    for t in range(begin, end):
        level, _, _ = _dominant_plane(boxes, t, origin, extent)
        if level == 0:
            continue
        x = -np.float64(boxes[t, 4]) - boxes[t, 0]
        y = -np.float64(boxes[t, 5]) - boxes[t, 1]
        z = -np.float64(boxes[t, 6]) - boxes[t, 2]
        a0 = (np.float64(corners[t, 1, 0]) - corners[t, 0, 0]) * scale
        a1 = (np.float64(corners[t, 1, 1]) - corners[t, 0, 1]) * scale
        a2 = (np.float64(corners[t, 1, 2]) - corners[t, 0, 2]) * scale
        b0 = (np.float64(corners[t, 2, 0]) - corners[t, 0, 0]) * scale
        b1 = (np.float64(corners[t, 2, 1]) - corners[t, 0, 1]) * scale
        b2 = (np.float64(corners[t, 2, 2]) - corners[t, 0, 2]) * scale
        ideal = abs(a1 * b2 - a2 * b1) + abs(a2 * b0 - a0 * b2) + abs(a0 * b1 - a1 * b0)
        excess = 2.0 * (x * y + y * z + z * x) - ideal
        if excess > 0.0:
            out[t] = (2.0**level * excess) ** (1.0 / 3.0)


@njit(allocates=False)
def _splits_at(priorities, factor):
    """Total splits when triangle t gets ``floor(factor * p_t)`` of them."""
    total = 0.0
    for t in range(len(priorities)):
        total += math.floor(factor * priorities[t])
    return total


@njit
def _factor_for(priorities, budget):
    """Find the largest D whose splits fit the budget, by bisection (to 2**-40)."""
    mass = priorities.sum()
    if mass <= 0.0 or budget < 1.0:
        return 0.0
    low = budget / mass  # fits, since each floor takes something away
    high = 2.0 * low
    while _splits_at(priorities, high) <= budget:
        low, high = high, 2.0 * high
    for _ in range(40):
        middle = 0.5 * (low + high)
        total = _splits_at(priorities, middle)
        if total <= budget:
            low = middle
            if total == budget:
                break
        else:
            high = middle
    return low


@njit
def _places(n, priorities, factor):
    """Where each block of triangles writes its parts: behind the first ``n`` rows."""
    starts = np.empty(-(-n // _BLOCK) + 1, np.int64)
    starts[0] = n
    for block in range(len(starts) - 1):
        room = 0
        for t in range(block * _BLOCK, min((block + 1) * _BLOCK, n)):
            room += math.floor(factor * priorities[t])
        starts[block + 1] = starts[block] + room
    return starts


@njit
def _close_up(n, starts, ends, boxes, triangle):
    """Close up what the blocks left empty; return the number of references."""
    used = n
    for block in range(len(ends)):
        for row in range(starts[block], ends[block]):
            if row != used:
                boxes[used] = boxes[row]
                triangle[used] = triangle[row]
            used += 1
    return used


@njit
def _split_block(
    corners, scale, boxes, triangle, priorities, factor, origin, extent, first, last, used
):
    """Split the triangles from ``first`` to ``last``, writing from row ``used``; return its end.

    A box with s splits to spend is cut at the coarsest plane it straddles, and the other
    s - 1 go to its halves in proportion to their longest extents. One half stays in its row,
    the other is appended.
    """
    polygon = np.empty((MAX_CORNERS, 3), np.float64)
    spare = np.empty((MAX_CORNERS, 3), np.float64)
    halves = np.empty((2, 8), np.float32)
    # The smaller half is done first, so that each pending entry has at least twice the
    # splits of the next and the stack stays below 64.
    stack_row = np.empty(128, np.int64)
    stack_splits = np.empty(128, np.int64)
    for t in range(first, last):
        splits = math.floor(factor * priorities[t])
        if splits == 0:
            continue
        stack_row[0], stack_splits[0], top = t, splits, 1
        while top > 0:
            top -= 1
            row, splits = stack_row[top], stack_splits[top]
            level, axis, plane = _dominant_plane(boxes, row, origin, extent)
            if splits == 0 or level == 0:
                continue
            found = split_reference(
                corners, t, scale, boxes, row, axis, plane, halves[0], halves[1], polygon, spare
            )
            if found != 3:  # the box was loose: tighten it and go on
                for k in range(8):
                    boxes[row, k] = halves[found - 1, k]
                stack_row[top], stack_splits[top] = row, splits - 1
                top += 1
                continue
            for k in range(8):
                boxes[row, k] = halves[0, k]
                boxes[used, k] = halves[1, k]
            triangle[used] = t
            first, second = _longest(halves[0]), _longest(halves[1])
            share = math.floor((splits - 1) * (first / (first + second)) + 0.5)
            rest = splits - 1 - share
            a, b = (row, used) if share > rest else (used, row)
            stack_row[top], stack_splits[top] = a, max(share, rest)
            stack_row[top + 1], stack_splits[top + 1] = b, min(share, rest)
            top += 2
            used += 1
    return used


@njit(allocates=False)
def _longest(box):
    """Longest extent of a box, as float64."""
    return -np.float64(min(box[4] + box[0], min(box[5] + box[1], box[6] + box[2])))


def presplit(triangles: Triangles, beta: float = 0.3) -> References:
    """Split triangles before the tree is built (Karras and Aila 2013, section 5).

    Triangle t gets ``floor(D * p_t)`` splits, where the priority ``p_t`` grows with the area
    its box wastes and with the size of the spatial cells it straddles, and D is the largest
    factor that fits the budget. Each split is at a median plane of the scene box, so that
    boxes of neighbouring triangles are cut in the same places.

    Parameters
    ----------
    triangles : Triangles
    beta : float
        Budget: at most ``beta * N`` references are added. More lowers overlap, for a larger
        tree.

    Returns
    -------
    refs : References
        The first N belong to triangles 0 to N - 1 in order; the others follow.
    """
    if not (math.isfinite(beta) and beta >= 0.0):
        raise MibvhError(f"beta must be 0 or more, not {beta}")
    whole = References.of(triangles)
    n = len(whole)
    origin = whole.lower.min(axis=0).astype(np.float64)
    extent = whole.upper.max(axis=0).astype(np.float64) - origin
    scene = (triangles.corners, whole.scale)
    boxes = pack_boxes(whole)
    priorities = np.zeros(n)
    seen = (priorities, *scene, boxes, origin, extent)
    run_blocks(lambda _, begin, end: _priorities(begin, end, *seen), n, _BLOCK)
    factor = _factor_for(priorities, math.floor(beta * n))
    room = int(_splits_at(priorities, factor))
    boxes = np.concatenate([boxes, np.zeros((room, 8), np.float32)])
    triangle = np.concatenate([whole.triangle, np.zeros(room, np.int32)])
    # Blocks of triangles write to places of their own, as many as the splits they may have.
    starts = _places(n, priorities, factor)
    ends = starts[:-1].copy()
    arrays = (*scene, boxes, triangle, priorities, factor, origin, extent)

    def split(_: int, begin: int, end: int) -> None:
        block = begin // _BLOCK
        ends[block] = _split_block(*arrays, begin, end, starts[block])

    run_blocks(split, n, _BLOCK)
    used = _close_up(n, starts, ends, boxes, triangle)
    return References(
        boxes[:used, 0:3].copy(), -boxes[:used, 4:7], triangle[:used].copy(), whole.scale
    )


def as_boxes(references: References) -> Triangles:
    """Triangles that fill references' boxes corner to corner, in scene units.

    Builders that split no triangles look at nothing but boxes, so they build over references
    when they are given these.
    """
    lower, upper = (
        corner / np.float32(references.scale) for corner in (references.lower, references.upper)
    )
    return Triangles(np.stack([lower, upper, lower], axis=1), "parts of triangles")


def over_parts(draft: Draft, references: References, builder: str) -> Draft:
    """Put references into the draft that a builder made of :func:`as_boxes`.

    Raises
    ------
    MibvhError
        If the builder has split what it was given.
    """
    part = draft.references.triangle
    if len(part) != len(references):
        raise MibvhError(
            f"triangles are split up front for builders that split none; {builder} does"
        )
    reference = np.where(draft.left < 0, part[draft.reference], np.int32(-1))
    return Draft(references, draft.left, draft.right, reference, draft.report, draft.measure)
