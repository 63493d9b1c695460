"""A tree as rows that hold both children of a node, to take subtrees out and put them in.

What optimisers by insertion have in common (Bittner, Hapala, Havran: *Fast Insertion-Based
Optimization of Bounding Volume Hierarchies*, Computer Graphics Forum 32(1), 2013): a row is 64
bytes, so that a step of the search for the best place reads one cache line.

Rows are (n, 16) float32. Row r > 0 is an inner node; half of it (8 words) describes a child:
lower corner, upper corner, its measure unless that is the area, and as an integer the child's row,
or ~reference if it is a leaf. Entry 2 * r + side names such a half. Row 0 stands above the root,
which is entry 0, so that the root needs no special care. ``up[r]`` is the entry of row r.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.measures.boxes import of_corners
from mibvh.triangles import F32


@njit
def rows_of(left, right, reference, boxes, measure):
    """Make rows of a draft, numbered parents first, left subtrees first."""
    n = len(left) // 2 + 1
    rows = np.zeros((n, 16), np.float32)
    links = rows.view(np.int32)
    up = np.full(n, -1, np.int32)
    stack = np.empty((n + 1, 2), np.int32)
    stack[0, 0], stack[0, 1] = 0, 0
    top, made = 1, 1
    while top > 0:
        top -= 1
        node, entry = stack[top, 0], stack[top, 1]
        row, at = entry >> 1, (entry & 1) << 3
        for i in range(6):
            rows[row, at + i] = boxes[node, i]
        _remeasure(measure, rows, row, at)
        if left[node] < 0:
            links[row, at + 7] = ~reference[node]
            continue
        links[row, at + 7] = made
        up[made] = entry
        stack[top, 0], stack[top, 1] = right[node], 2 * made + 1
        stack[top + 1, 0], stack[top + 1, 1] = left[node], 2 * made
        top += 2
        made += 1
    return rows, up


def draft_of(rows: F32, references: References, report: dict[str, Any]) -> Draft:
    """Make a draft of rows."""
    n = len(rows)
    children = rows.view(np.int32)[:, [7, 15]]
    # Inner nodes get the names 0 to n - 2 (the root 0), leaves the rest.
    name = np.arange(-1, n - 1, dtype=np.int32)
    root = children[0, 0]
    if root > 0:
        name[1], name[root] = name[root], 0
    children = np.where(children < 0, n - 1 + ~children, name[children]).astype(np.int32)
    left, right, reference = np.full((3, 2 * n - 1), -1, np.int32)
    left[name[1:]], right[name[1:]] = children[1:].T
    reference[n - 1 :] = np.arange(n)
    return Draft(references, left, right, reference, report)


@njit(allocates=False)
def measure_of(measure, rows, row, at):
    """Measure of an entry, float64: half its area, or what is kept beside the box."""
    if measure is None:
        x = np.float64(rows[row, at + 3]) - np.float64(rows[row, at])
        y = np.float64(rows[row, at + 4]) - np.float64(rows[row, at + 1])
        z = np.float64(rows[row, at + 5]) - np.float64(rows[row, at + 2])
        return x * y + (x + y) * z
    return np.float64(rows[row, at + 6])


@njit(allocates=False)
def _remeasure(measure, rows, row, at):
    """Keep the measure of an entry beside its new box."""
    if measure is not None:
        rows[row, at + 6] = of_corners(
            measure,
            rows[row, at],
            rows[row, at + 1],
            rows[row, at + 2],
            rows[row, at + 3],
            rows[row, at + 4],
            rows[row, at + 5],
        )


@njit(allocates=False)
def _joint_measure(measure, rows, row, at, x0, y0, z0, x1, y1, z1):
    """Measure of the box that joins an entry to the box given, float64."""
    if measure is None:
        x = np.float64(max(rows[row, at + 3], x1)) - np.float64(min(rows[row, at], x0))
        y = np.float64(max(rows[row, at + 4], y1)) - np.float64(min(rows[row, at + 1], y0))
        z = np.float64(max(rows[row, at + 5], z1)) - np.float64(min(rows[row, at + 2], z0))
        return x * y + (x + y) * z
    a, b, c = rows[row, at], rows[row, at + 1], rows[row, at + 2]
    d, e, f = rows[row, at + 3], rows[row, at + 4], rows[row, at + 5]
    if a <= x0 and b <= y0 and c <= z0 and d >= x1 and e >= y1 and f >= z1:
        return np.float64(rows[row, at + 6])
    return of_corners(
        measure, min(a, x0), min(b, y0), min(c, z0), max(d, x1), max(e, y1), max(f, z1)
    )


@njit(allocates=False)
def refit(measure, rows, up, row):
    """Recompute the box of a row and of those above it, as far as they change.

    Returns the area that the tree loses by it (negative where boxes grow).
    """
    saved = 0.0
    while row != 0:
        entry = up[row]
        above, at = entry >> 1, (entry & 1) << 3
        before = measure_of(measure, rows, above, at)
        changed = False
        for i in range(3):
            low = min(rows[row, i], rows[row, i + 8])
            high = max(rows[row, i + 3], rows[row, i + 11])
            changed |= low != rows[above, at + i] or high != rows[above, at + i + 3]
            rows[above, at + i], rows[above, at + i + 3] = low, high
        if not changed:
            break
        _remeasure(measure, rows, above, at)
        saved += before - measure_of(measure, rows, above, at)
        row = above
    return saved


@njit(allocates=False)
def remove(measure, rows, links, up, entry):
    """Take an entry out of the tree, and the row it is in: its sibling takes their place.

    Returns the area saved above and in that row, and the entry where the sibling is now.
    """
    row, at = entry >> 1, (entry & 1) << 3
    place = up[row]
    above, at_above = place >> 1, (place & 1) << 3
    saved = measure_of(measure, rows, above, at_above)
    for i in range(8):
        links[above, at_above + i] = links[row, 8 - at + i]
    if links[above, at_above + 7] > 0:
        up[links[above, at_above + 7]] = place
    return saved + refit(measure, rows, up, above), place


@njit(allocates=False)
def insert(measure, rows, links, up, place, row, box, link):
    """Put a subtree, by box and link, beside the one at an entry; ``row`` joins the two."""
    above, at = place >> 1, (place & 1) << 3
    for i in range(8):
        links[row, i] = links[above, at + i]
    for i in range(7):
        rows[row, 8 + i] = box[i]
    links[row, 15] = link
    if links[row, 7] > 0:
        up[links[row, 7]] = 2 * row
    if link > 0:
        up[link] = 2 * row + 1
    links[above, at + 7] = row
    up[row] = place
    refit(measure, rows, up, row)


@njit(allocates=False)
def _cost_at(measure, rows, up, place, x0, y0, z0, x1, y1, z1):
    """Return what inserting a box at an entry costs."""
    row, at = place >> 1, (place & 1) << 3
    cost = _joint_measure(measure, rows, row, at, x0, y0, z0, x1, y1, z1)
    while row != 0:
        entry = up[row]
        row, at = entry >> 1, (entry & 1) << 3
        grown = _joint_measure(measure, rows, row, at, x0, y0, z0, x1, y1, z1)
        cost += grown - measure_of(measure, rows, row, at)
    return cost


@njit(allocates=False)
def search(measure, rows, links, up, box, near, limit, keys, queue):
    """Find where inserting a box costs least.

    Parameters
    ----------
    box : (7,) float32
        Lower corner, upper corner, and the measure unless that is the area.
    near : int
        An entry likely to be good: where the search starts to bound from.
    limit : float
        What the cost must be below.
    keys, queue : (n,) float64 and int32
        Space for a binary heap of rows by induced cost.

    Returns
    -------
    entry, cost : int, float
        -1 where there is no place below the limit.
    """
    x0, y0, z0, x1, y1, z1 = box[0], box[1], box[2], box[3], box[4], box[5]
    area = np.float64(box[6])
    if measure is None:
        x, y, z = np.float64(x1) - x0, np.float64(y1) - y0, np.float64(z1) - z0
        area = x * y + (x + y) * z
    place, best = -1, limit
    bound = _cost_at(measure, rows, up, near, x0, y0, z0, x1, y1, z1)
    if bound < best:
        # A little above, so that the search itself finds this place or a better one, and
        # which of equal ones it finds does not depend on ``near``.
        place, best = near, bound * (1 + 1e-12)
    cost = _joint_measure(measure, rows, 0, 0, x0, y0, z0, x1, y1, z1)
    if cost < best:
        place, best = 0, cost
    keys[0], queue[0] = cost - measure_of(measure, rows, 0, 0), links[0, 7]
    size = 1 if links[0, 7] > 0 else 0
    while size > 0 and keys[0] + area < best:
        induced, row = keys[0], queue[0]
        size -= 1
        key, value, i = keys[size], queue[size], 0
        while True:
            child = 2 * i + 1
            if child + 1 < size and keys[child + 1] < keys[child]:
                child += 1
            if child >= size or keys[child] >= key:
                break
            keys[i], queue[i] = keys[child], queue[child]
            i = child
        keys[i], queue[i] = key, value
        for side in range(2):
            at = side << 3
            joint = _joint_measure(measure, rows, row, at, x0, y0, z0, x1, y1, z1)
            cost = induced + joint
            if cost < best:
                place, best = 2 * row + side, cost
            key, value = induced + (joint - measure_of(measure, rows, row, at)), links[row, at + 7]
            if value > 0 and key + area < best:
                i = size
                size += 1
                while i > 0 and keys[(i - 1) >> 1] > key:
                    keys[i], queue[i] = keys[(i - 1) >> 1], queue[(i - 1) >> 1]
                    i = (i - 1) >> 1
                keys[i], queue[i] = key, value
    return place, best
