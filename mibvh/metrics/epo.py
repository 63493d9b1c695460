"""End-point overlap (Aila, Karras and Laine 2013).

``EPO = sum_n C_n area((S - Q(n)) in box(n)) / area(S)``: the surfaces ``S`` without those
that belong to triangles referenced below the node, as far as they lie in the node's closed
box. A triangle with any reference below a node counts as the node's own (triangle-level
exclusion), so that a spatial partition has an EPO of zero.

The walk goes triangle by triangle through the subtrees beside the triangle's own path. The part
of the triangle inside a foreign node is clipped from the part inside that node's parent, so that
most clips cut a small polygon by one or two planes, and one inside a box is not clipped. Areas
are summed as 64-bit integers in units of 2**-60 of the total, so that the result is the same
to the last bit for any number of threads.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.metrics.points import Estimate, RayEnds, epo_at_ends, estimate_epo, triangle_positions
from mibvh.metrics.sah import node_costs
from mibvh.parallel import run_blocks, thread_count
from mibvh.tree import Tree
from mibvh.triangles import F64, as_triangles

#: Areas are accumulated as integers in these units of the total area.
_UNIT = 2.0**-60
_BLOCK = 2048
#: A triangle cut by six planes has at most nine corners.
_CORNERS = 10


@dataclasses.dataclass(frozen=True, eq=False)
class OverlapResult:
    """Where the surfaces overlap foreign nodes.

    Attributes
    ----------
    fraction : (M,) float64
        Share of all surface (or of all ray ends, if weighted) that is foreign to each node
        and lies in its box.
    pairs : int
        Overlapping (triangle, foreign node) pairs of positive area: what the time goes with.
    visits : int
        Boxes tested.
    clips : int
        Polygons cut.
    """

    fraction: F64
    pairs: int
    visits: int
    clips: int


@njit(inline="always")
def _cut(polygons, source, n, target, axis, limit, sign):
    """Clip a convex polygon by an axis plane, keeping ``sign * (x - limit) >= 0``.

    From one row of ``polygons`` to another; returns the corner count.
    """
    m = 0
    px, py, pz = polygons[source, n - 1, 0], polygons[source, n - 1, 1], polygons[source, n - 1, 2]
    p = sign * (polygons[source, n - 1, axis] - limit)
    for i in range(n):
        qx, qy, qz = polygons[source, i, 0], polygons[source, i, 1], polygons[source, i, 2]
        q = sign * (polygons[source, i, axis] - limit)
        if (p >= 0.0) != (q >= 0.0):
            s = p / (p - q)
            polygons[target, m, 0] = px + s * (qx - px)
            polygons[target, m, 1] = py + s * (qy - py)
            polygons[target, m, 2] = pz + s * (qz - pz)
            polygons[target, m, axis] = limit
            m += 1
        if q >= 0.0:
            polygons[target, m, 0] = qx
            polygons[target, m, 1] = qy
            polygons[target, m, 2] = qz
            m += 1
        px, py, pz, p = qx, qy, qz, q
    return m


@njit(inline="always")
def _measure(polygons, row, n, limits):
    """Return the area of the polygon in a row, and write its box to that row of ``limits``."""
    x = y = z = 0.0
    ax, ay, az = polygons[row, 0, 0], polygons[row, 0, 1], polygons[row, 0, 2]
    x0, y0, z0, x1, y1, z1 = ax, ay, az, ax, ay, az
    ux = uy = uz = 0.0
    for i in range(1, n):
        bx, by, bz = polygons[row, i, 0], polygons[row, i, 1], polygons[row, i, 2]
        x0, y0, z0 = min(x0, bx), min(y0, by), min(z0, bz)
        x1, y1, z1 = max(x1, bx), max(y1, by), max(z1, bz)
        vx, vy, vz = bx - ax, by - ay, bz - az
        x += uy * vz - uz * vy
        y += uz * vx - ux * vz
        z += ux * vy - uy * vx
        ux, uy, uz = vx, vy, vz
    limits[row, 0], limits[row, 1], limits[row, 2] = x0, y0, z0
    limits[row, 3], limits[row, 4], limits[row, 5] = x1, y1, z1
    return 0.5 * np.sqrt(x * x + y * y + z * z)


@njit(inline="always")
def _clip(polygons, row, n, limits, box, node, spare):
    """Clip the polygon in a row by the planes of a node's box that cut the polygon's own box.

    The rows ``spare`` and ``spare + 1`` are written in turn. Returns the row that holds the
    result and its corner count, below three for nothing left.
    """
    for plane in range(6):
        k = plane % 3
        if plane < 3:
            if limits[row, k] >= box[node, k]:
                continue
        elif limits[row, k + 3] <= box[node, k + 3]:
            continue
        target = spare + 1 if row == spare else spare
        sign = 1.0 if plane < 3 else -1.0
        n = _cut(polygons, row, n, target, k, np.float64(box[node, plane]), sign)
        if n < 3:
            return target, n
        # The box of what is left may no longer cross the next planes; the old one is kept, as
        # cutting in vain costs less than measuring.
        for i in range(6):
            limits[target, i] = limits[row, i]
        row = target
    return row, n


@njit(inline="always")
def _own(positions, start, end, first, count):
    """Whether one of a triangle's positions in leaf order lies in a node's range."""
    for i in range(start, end):  # noqa: SIM110 - Numba has no any()
        if 0 <= positions[i] - first < count:
            return True
    return False


@njit(inline="always")
def _touches(limits, row, box, node):
    """Whether the closed box in a row of ``limits`` and that of a node have a point in common."""
    return (
        limits[row, 0] <= box[node, 3]
        and limits[row, 3] >= box[node, 0]
        and limits[row, 1] <= box[node, 4]
        and limits[row, 4] >= box[node, 1]
        and limits[row, 2] <= box[node, 5]
        and limits[row, 5] >= box[node, 2]
    )


@njit
def _walk(
    begin, end, walked, cut_to_leaf, corners, weights, starts, positions, references, box, left,
    first, count, depth, unit, sums,
):  # fmt: skip
    """Add the foreign areas of the references ``begin`` to ``end`` to ``sums`` (M,) int64.

    ``walked`` says which references stand for their triangle; with ``cut_to_leaf`` every one
    stands for the part of it in its leaf's box.

    Foreign to a reference are the siblings of the nodes on its path and what is below them. The
    siblings that touch a node's box are passed down from node to node, so that the path is gone
    once for all references below a node, and few of its siblings reach the leaf.
    """
    polygons = np.empty((2 * depth + 6, _CORNERS, 3))
    limits = np.empty((2 * depth + 6, 6))
    corner_count = np.empty(2 * depth + 6, np.int64)
    areas = np.empty(2 * depth + 6)
    holder = np.empty(depth + 2, np.int64)
    stack = np.empty(2 * depth + 4, np.int32)
    stack_level = np.empty(2 * depth + 4, np.int32)
    path = np.empty(2 * depth + 4, np.int32)
    path_begin = np.empty(2 * depth + 4, np.int32)
    path_end = np.empty(2 * depth + 4, np.int32)
    siblings = np.empty((depth + 2) * (depth + 2), np.int32)
    pairs = visits = clips = 0
    path[0], path_begin[0], path_end[0], top = 0, 0, 0, 1
    while top > 0:
        top -= 1
        node, low, high = path[top], path_begin[top], path_end[top]
        if first[node] >= end or first[node] + count[node] <= begin:
            continue
        if left[node] >= 0:
            # -- pass on the siblings that touch each child, and the other child; the lists of both
            # are written now, one behind the other, and stay until the children are done with
            for c in range(2):
                child, other = left[node] + c, left[node] + 1 - c
                place = high if c == 0 else path_end[top - 1]
                path[top], path_begin[top] = child, place
                for k in range(3):
                    limits[0, k], limits[0, k + 3] = box[child, k], box[child, k + 3]
                for i in range(low, high + 1):
                    sibling = siblings[i] if i < high else other
                    visits += 1
                    if _touches(limits, 0, box, sibling):
                        siblings[place] = sibling
                        place += 1
                path_end[top] = place
                top += 1
            continue
        for position in range(max(begin, first[node]), min(end, first[node] + count[node])):
            t = references[position]
            if not walked[position] or weights[t] == 0.0:
                continue
            for i in range(3):
                for k in range(3):
                    polygons[0, i, k] = corners[t, i, k]
            row, n = np.int64(0), np.int64(3)
            areas[0] = _measure(polygons, 0, 3, limits)
            if cut_to_leaf:
                row, n = _clip(polygons, row, n, limits, box, node, 0)
                areas[row] = _measure(polygons, row, n, limits) if n >= 3 else 0.0
            if areas[row] == 0.0:
                continue
            corner_count[row] = n
            item = position if cut_to_leaf else t
            found = _foreign(
                row, siblings, low, high, starts[item], starts[item + 1], positions,
                weights[t] * unit, polygons, limits, corner_count, areas, holder, stack,
                stack_level, box, left, first, count, sums,
            )  # fmt: skip
            pairs, visits, clips = pairs + found[0], visits + found[1], clips + found[2]
    return pairs, visits, clips


@njit(inline="always")
def _foreign(
    item_row, siblings, low, high, start, stop, positions, weight, polygons, limits, corner_count,
    areas, holder, stack, stack_level, box, left, first, count, sums,
):  # fmt: skip
    """Add one polygon's areas in the subtrees ``siblings[low:high]``, from the top down."""
    # Each level, the depth below a sibling, has two rows for the polygon inside the node there,
    # and names the one that holds it; where it is all of the parent's, that is the parent's row.
    # Siblings share a level: a node is clipped when popped, after its sibling's subtree is done
    # with, and its parent's level is still what it was.
    pairs = visits = clips = 0
    several = stop - start > 1
    for s in range(low, high):
        visits += 1
        if not _touches(limits, item_row, box, siblings[s]):
            continue
        stack[0], stack_level[0], top = siblings[s], 0, 1
        while top > 0:
            top -= 1
            node, level = stack[top], np.int64(stack_level[top])
            h = item_row if level == 0 else holder[level - 1]
            if not (several and _own(positions, start, stop, first[node], count[node])):
                row, n = _clip(polygons, h, corner_count[h], limits, box, node, 2 * level + 2)
                if row != h:
                    clips += 1
                    if n < 3:
                        continue
                    areas[row] = _measure(polygons, row, n, limits)
                    if areas[row] == 0.0:
                        continue
                    corner_count[row] = n
                    h = row
                sums[node] += np.int64(areas[h] * weight + 0.5)
                pairs += 1
            if left[node] < 0:
                continue
            holder[level] = h
            for child in range(left[node], left[node] + 2):
                visits += 1
                if _touches(limits, h, box, child):
                    stack[top], stack_level[top] = child, level + 1
                    top += 1
    return pairs, visits, clips


def overlap(
    tree: Tree,
    triangles: Any,
    *,
    weights: npt.ArrayLike | None = None,
    fragments: bool = False,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> OverlapResult:
    """Measure, for every node, the share of the surfaces that is foreign and in its box.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles or (N, 3, 3) array
    weights : (N,) array, optional
        Density of ray ends on each triangle, up to a factor; by default the same on all, as
        in the paper.
    fragments : bool
        For trees with split triangles, the other reading of "not in the subtree": a reference
        owns only the part of its triangle that lies in its leaf's box, and what other parts of
        the same triangle have in a node counts as foreign to it.
    threads : int, optional
        The result is the same to the last bit for any number.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    OverlapResult

    Raises
    ------
    MibvhError
        If the tree was built for another geometry, or a weight is missing or negative.
    """
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    density = np.ones(len(triangles)) if weights is None else np.asarray(weights, np.float64)
    if density.shape != (len(triangles),) or not (density >= 0).all():
        raise MibvhError(f"weights need {len(triangles)} numbers that are not negative")
    total = float((density * triangles.areas).sum())
    if not total > 0:
        return OverlapResult(np.zeros(len(tree)), 0, 0, 0)
    if fragments:
        starts = np.arange(len(tree.references) + 1)
        positions = starts[:-1].astype(np.int32)
        walked = np.ones(len(tree.references), np.bool_)
    else:
        starts, positions = triangle_positions(tree, len(triangles))
        walked = np.zeros(len(tree.references), np.bool_)
        walked[positions[starts[:-1][starts[:-1] < starts[1:]]]] = True
    box = np.concatenate([tree.lower, tree.upper], axis=1)
    workers = threads or thread_count()
    sums = np.zeros((workers, len(tree)), np.int64)
    counts = np.zeros((workers, 3), np.int64)
    unit = 1.0 / (total * _UNIT)

    def work(worker: int, begin: int, end: int) -> None:
        counts[worker] += _walk(
            begin, end, walked, fragments, triangles.corners, density, starts, positions,
            tree.references, box, tree.left, tree.first, tree.count, tree.depth, unit, sums[worker],
        )  # fmt: skip

    run_blocks(work, len(tree.references), _BLOCK, workers, progress)
    pairs, visits, clips = (int(c) for c in counts.sum(axis=0))
    return OverlapResult(sums.sum(axis=0) * _UNIT, pairs, visits, clips)


def epo_per_node(tree: Tree, triangles: Any, **options: Any) -> F64:
    """Each node's share of the EPO; options as for :func:`overlap`.

    Returns
    -------
    (M,) float64
    """
    return node_costs(tree) * overlap(tree, triangles, **options).fraction


def epo_per_depth(tree: Tree, triangles: Any, **options: Any) -> F64:
    """EPO of the nodes of each depth; options as for :func:`overlap`.

    Returns
    -------
    (depth + 1,) float64
    """
    shares = epo_per_node(tree, triangles, **options)
    return np.bincount(tree.depths, shares, tree.depth + 1).astype(np.float64)


@typing.overload
def epo(tree: Tree, triangles: Any, *, samples: int, seed: int = 0) -> Estimate: ...
@typing.overload
def epo(tree: Tree, triangles: Any, *, ray_ends: RayEnds) -> Estimate: ...
@typing.overload
def epo(
    tree: Tree,
    triangles: Any,
    *,
    weights: npt.ArrayLike | None = None,
    fragments: bool = False,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> float: ...
def epo(
    tree: Tree,
    triangles: Any,
    *,
    samples: int | None = None,
    seed: int = 0,
    ray_ends: RayEnds | None = None,
    **options: Any,
) -> float | Estimate:
    """Expected extra cost of a point query at a ray's end, due to overlap.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles or (N, 3, 3) array
        What the tree was built for.
    samples : int, optional
        Estimate it from so many points on the surfaces instead, stratified by area: for scenes
        where the exact value takes too long, such as dense hair.
    seed : int
        Of the points.
    ray_ends : RayEnds, optional
        Where rays begin or end (:func:`mibvh.ray_ends`): average over these points instead of
        evenly over all surfaces.
    **options
        For the exact value, as for :func:`overlap`.

    Returns
    -------
    float or Estimate
        In units of the cost constants that the tree was built with; 0 where no surface lies
        in a foreign node. With ``samples`` or ``ray_ends``, an estimate with its standard error.

    Raises
    ------
    MibvhError
        If the tree was built for another geometry, or there are too few points.
    """
    if samples is not None:
        return estimate_epo(tree, triangles, samples, seed)
    if ray_ends is not None:
        return epo_at_ends(tree, triangles, ray_ends)
    return float(epo_per_node(tree, triangles, **options).sum())
