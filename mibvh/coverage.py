"""Whether the leaves that a split triangle is in hold all of it between them.

A spatial split enters a triangle in several leaves, each of which holds a part. The boxes of its
leaves are cut out of the triangle, one after the other; what is left then is in none. Exact but for
rounding, where points of a grid would miss a gap between them.
"""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.nodes import Nodes
from mibvh.triangles import Triangles

#: A triangle cut along the axes has at most nine corners; the rest is for rounding.
_CORNERS = 16
#: Boxes are widened by this share of the triangle's largest coordinate: faces of clipped boxes are
#: rounded to float32.
_SLACK = 5e-7
#: What is left counts if it has more than this share of the triangle's area.
_LEFT_OVER = 1e-9


def uncovered(tree: Nodes, triangles: Triangles, times: np.ndarray) -> tuple[int, int]:
    """Count the split triangles that are not covered by their leaves.

    Parameters
    ----------
    tree : Tree
        Of sound structure.
    triangles : Triangles
    times : (N,) int32
        References of each triangle.

    Returns
    -------
    missed, first : int
        How many, and the first of them, or -1.
    """
    if len(tree.references) == len(triangles):
        return 0, -1
    starts, leaves = _split_leaves(tree.left, tree.first, tree.count, tree.references, times)
    return _uncovered(triangles.corners, starts, leaves, tree.lower, tree.upper)


@njit
def _split_leaves(left, first, count, references, times):
    """Leaves of triangle ``t``: ``leaves[starts[t] : starts[t + 1]]``; none for unsplit ones."""
    starts = np.zeros(len(times) + 1, np.int64)
    for t in range(len(times)):
        starts[t + 1] = starts[t] + (times[t] if times[t] > 1 else 0)
    place = starts[:-1].copy()
    leaves = np.empty(starts[-1], np.int32)
    for n in range(len(left)):
        if left[n] >= 0:
            continue
        for i in range(first[n], first[n] + count[n]):
            t = references[i]
            if times[t] > 1:
                leaves[place[t]] = n
                place[t] += 1
    return starts, leaves


@njit
def _uncovered(corners, starts, leaves, lower, upper):
    missed, first = 0, -1
    pieces = np.empty((64, _CORNERS, 3))
    sizes = np.empty(64, np.int64)
    work = np.empty((2, _CORNERS, 3))
    low, high = np.empty(3), np.empty(3)
    for t in range(len(corners)):
        if starts[t] == starts[t + 1]:
            continue
        largest = 0.0
        for i in range(3):
            for k in range(3):
                pieces[0, i, k] = corners[t, i, k]
                largest = max(largest, abs(pieces[0, i, k]))
        sizes[0], held = 3, 1
        allowed = _LEFT_OVER * _area(pieces[0], 3)
        slack = _SLACK * largest
        for j in range(starts[t], starts[t + 1]):
            for k in range(3):
                low[k] = lower[leaves[j], k] - slack
                high[k] = upper[leaves[j], k] + slack
            # A piece gives way to at most six; the first `held` ones are gone through, new ones
            # come behind them, and the gaps are closed.
            old, keep = held, 0
            for p in range(old):
                if held + 6 > len(pieces):
                    pieces, sizes = _grown(pieces), _grown(sizes)
                if not _touches(pieces[p], sizes[p], low, high):
                    _copy(pieces, sizes, p, keep)
                    keep += 1
                    continue
                held = _subtract(pieces, sizes, p, held, low, high, work, allowed)
            for p in range(old, held):
                _copy(pieces, sizes, p, keep)
                keep += 1
            held = keep
            if held == 0:
                break
        for p in range(held):
            if _area(pieces[p], sizes[p]) > allowed:
                first = t if missed == 0 else first
                missed += 1
                break
    return missed, first


@njit
def _grown(array):
    return np.concatenate((array, np.empty_like(array)))


@njit(allocates=False)
def _copy(pieces, sizes, source, target):
    if source != target:
        for i in range(sizes[source]):
            for k in range(3):
                pieces[target, i, k] = pieces[source, i, k]
        sizes[target] = sizes[source]


@njit(allocates=False)
def _touches(piece, n, low, high):
    """Whether the piece's box and the box have a point in common."""
    for k in range(3):
        a = b = piece[0, k]
        for i in range(1, n):
            a, b = min(a, piece[i, k]), max(b, piece[i, k])
        if a > high[k] or b < low[k]:
            return False
    return True


@njit(allocates=False)
def _subtract(pieces, sizes, p, held, low, high, work, allowed):
    """Append what a box leaves of a piece, plane by plane; return how many pieces there are."""
    source, n = 0, sizes[p]
    for i in range(n):
        for k in range(3):
            work[0, i, k] = pieces[p, i, k]
    for plane in range(6):
        k = plane % 3
        limit, sign = (low[k], 1.0) if plane < 3 else (high[k], -1.0)
        # -- outside of the plane: a piece of its own
        m = _cut(work[source], n, pieces[held], k, limit, -sign)
        if m >= 3 and _area(pieces[held], m) > allowed:
            sizes[held] = m
            held += 1
        # -- inside: what is still to be cut
        n = _cut(work[source], n, work[1 - source], k, limit, sign)
        source = 1 - source
        if n < 3:
            break
    return held


@njit(allocates=False)
def _cut(polygon, n, out, axis, limit, sign):
    """Clip a convex polygon, keeping ``sign * (x - limit) >= 0``; return the corner count."""
    m, last = 0, n - 1
    p = sign * (polygon[last, axis] - limit)
    for i in range(n):
        q = sign * (polygon[i, axis] - limit)
        if (p >= 0.0) != (q >= 0.0) and m < _CORNERS:
            s = p / (p - q)
            for k in range(3):
                out[m, k] = polygon[last, k] + s * (polygon[i, k] - polygon[last, k])
            out[m, axis] = limit
            m += 1
        if q >= 0.0 and m < _CORNERS:
            for k in range(3):
                out[m, k] = polygon[i, k]
            m += 1
        p, last = q, i
    return m


@njit(allocates=False)
def _area(polygon, n):
    x = y = z = 0.0
    for i in range(1, n - 1):
        ax, bx = polygon[i, 0] - polygon[0, 0], polygon[i + 1, 0] - polygon[0, 0]
        ay, by = polygon[i, 1] - polygon[0, 1], polygon[i + 1, 1] - polygon[0, 1]
        az, bz = polygon[i, 2] - polygon[0, 2], polygon[i + 1, 2] - polygon[0, 2]
        x += ay * bz - az * by
        y += az * bx - ax * bz
        z += ax * by - ay * bx
    return 0.5 * np.sqrt(x * x + y * y + z * z)
