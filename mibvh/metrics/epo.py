"""End-point overlap (Aila, Karras and Laine 2013).

``EPO = sum_n C_n area((S - Q(n)) in box(n)) / area(S)``: the surfaces ``S`` without those
that belong to triangles referenced below the node, as far as they lie in the node's closed
box. A triangle with any reference below a node counts as the node's own (triangle-level
exclusion), so that a spatial partition has an EPO of zero.

The walk goes triangle by triangle, down from the root. The part of the triangle inside a
foreign node is clipped from the part inside that node's parent, so that most clips cut a
small polygon by one or two planes, and a polygon inside a box is not clipped at all. Areas
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


@njit
def _cut(source, n, target, axis, limit, keep_above):
    """Clip a convex polygon by an axis plane (closed half-space). Returns the corner count."""
    m = 0
    px, py, pz = source[n - 1, 0], source[n - 1, 1], source[n - 1, 2]
    p = source[n - 1, axis] - limit
    if not keep_above:
        p = -p
    for i in range(n):
        qx, qy, qz = source[i, 0], source[i, 1], source[i, 2]
        q = source[i, axis] - limit
        if not keep_above:
            q = -q
        if (p >= 0.0) != (q >= 0.0):
            s = p / (p - q)
            target[m, 0] = px + s * (qx - px)
            target[m, 1] = py + s * (qy - py)
            target[m, 2] = pz + s * (qz - pz)
            target[m, axis] = limit
            m += 1
        if q >= 0.0:
            target[m, 0], target[m, 1], target[m, 2] = qx, qy, qz
            m += 1
        px, py, pz, p = qx, qy, qz, q
    return m


@njit
def _area(polygon, n):
    """Area of a convex polygon."""
    x = y = z = 0.0
    ax, ay, az = polygon[0, 0], polygon[0, 1], polygon[0, 2]
    ux, uy, uz = polygon[1, 0] - ax, polygon[1, 1] - ay, polygon[1, 2] - az
    for i in range(2, n):
        vx, vy, vz = polygon[i, 0] - ax, polygon[i, 1] - ay, polygon[i, 2] - az
        x += uy * vz - uz * vy
        y += uz * vx - ux * vz
        z += ux * vy - uy * vx
        ux, uy, uz = vx, vy, vz
    return 0.5 * np.sqrt(x * x + y * y + z * z)


@njit
def _own(positions, start, end, first, count):
    """Whether one of a triangle's positions in leaf order lies in a node's range."""
    for i in range(start, end):  # noqa: SIM110 - Numba has no any()
        if 0 <= positions[i] - first < count:
            return True
    return False


@njit
def _walk(
    begin, end, order, corners, weights, starts, positions, leaf_of, box, left, first, count, depth,
    unit, sums,
):  # fmt: skip
    """Add the foreign areas of items ``order[begin:end]`` to ``sums`` (M,) int64.

    An item is a triangle, or, where ``leaf_of`` is not empty, a reference's part of it: what lies
    in the box of the leaf that the reference is in.
    """
    # Level k of the walk keeps the polygon inside the node at depth k, its corner count, box
    # and area. Where that is all of the parent's polygon, the level names the level that
    # holds it instead. Siblings share a level: a node is clipped when popped, after its
    # sibling's subtree is done with, and its parent's level is still what it was.
    polygons = np.empty((depth + 2, _CORNERS, 3))
    spare = np.empty((2, _CORNERS, 3))
    corner_count = np.empty(depth + 2, np.int64)
    limits = np.empty((depth + 2, 6))
    areas = np.empty(depth + 2)
    holder = np.empty(depth + 2, np.int64)
    stack = np.empty(2 * depth + 4, np.int32)
    stack_level = np.empty(2 * depth + 4, np.int32)
    pairs = visits = clips = 0
    for index in range(begin, end):
        t = order[index]
        item = index if len(leaf_of) > 0 else t
        for i in range(3):
            for k in range(3):
                polygons[0, i, k] = corners[t, i, k]
        n = 3
        if len(leaf_of) > 0:
            for plane in range(6):
                limit = np.float64(box[leaf_of[index], plane])
                n = _cut(polygons[0], n, spare[0], plane % 3, limit, plane < 3)
                polygons[0, :n] = spare[0, :n]
                if n < 3:
                    break
        areas[0] = _area(polygons[0], n) if n >= 3 else 0.0
        if areas[0] == 0.0 or weights[t] == 0.0:
            continue
        weight = weights[t] * unit
        corner_count[0] = n
        for k in range(3):
            limits[0, k] = polygons[0, :n, k].min()
            limits[0, k + 3] = polygons[0, :n, k].max()
        start, stop = starts[item], starts[item + 1]
        stack[0], stack_level[0], top = 0, 0, 1
        while top > 0:
            top -= 1
            node, level = stack[top], stack_level[top]
            h = np.int64(0) if level == 0 else holder[level - 1]
            if not _own(positions, start, stop, first[node], count[node]):
                # -- clip by the planes that cut the polygon's box
                n, cuts = corner_count[h], 0
                for plane in range(6):
                    k = plane % 3
                    if plane < 3:
                        if limits[h, k] >= box[node, k]:
                            continue
                    elif limits[h, k + 3] <= box[node, k + 3]:
                        continue
                    source = polygons[h] if cuts == 0 else spare[(cuts - 1) & 1]
                    n = _cut(source, n, spare[cuts & 1], k, np.float64(box[node, plane]), plane < 3)
                    cuts += 1
                    if n < 3:
                        break
                if cuts > 0:
                    clips += 1
                    if n < 3:
                        continue
                    area = _area(spare[(cuts - 1) & 1], n)
                    if area == 0.0:
                        continue
                else:
                    area = areas[h]
                # -- count
                sums[node] += np.int64(area * weight + 0.5)
                pairs += 1
                if left[node] < 0:
                    continue
                if cuts > 0:
                    h = np.int64(level)
                    areas[h] = area
                    corner_count[h] = n
                    for k in range(3):
                        limits[h, k] = np.inf
                        limits[h, k + 3] = -np.inf
                    for i in range(n):
                        for k in range(3):
                            value = spare[(cuts - 1) & 1, i, k]
                            polygons[h, i, k] = value
                            limits[h, k] = min(limits[h, k], value)
                            limits[h, k + 3] = max(limits[h, k + 3], value)
            elif left[node] < 0:
                continue
            holder[level] = h
            # -- go on to the children that the polygon's box touches
            for child in range(left[node], left[node] + 2):
                visits += 1
                if (
                    limits[h, 0] <= box[child, 3]
                    and limits[h, 3] >= box[child, 0]
                    and limits[h, 1] <= box[child, 4]
                    and limits[h, 4] >= box[child, 1]
                    and limits[h, 2] <= box[child, 5]
                    and limits[h, 5] >= box[child, 2]
                ):
                    stack[top], stack_level[top] = child, level + 1
                    top += 1
    return pairs, visits, clips


def _items(tree: Tree, triangles: int, fragments: bool) -> tuple[Any, ...]:
    """What is walked, in leaf order so that neighbours come together.

    The triangle of each item, where its references stand (starts, positions), and the leaf it is
    cut to, if any.
    """
    if fragments:
        leaves = np.flatnonzero(tree.is_leaf)
        leaves = leaves[np.argsort(tree.first[leaves], kind="stable")]
        leaf_of = np.repeat(leaves, tree.count[leaves]).astype(np.int32)
        every = np.arange(len(tree.references) + 1)
        return tree.references, every, every[:-1].astype(np.int32), leaf_of
    starts, positions = triangle_positions(tree, triangles)
    present = np.flatnonzero(starts[1:] > starts[:-1])
    order = present[np.argsort(positions[starts[present]], kind="stable")].astype(np.int32)
    return order, starts, positions, np.empty(0, np.int32)


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
    """
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    density = np.ones(len(triangles)) if weights is None else np.asarray(weights, np.float64)
    if density.shape != (len(triangles),) or not (density >= 0).all():
        raise MibvhError(f"weights need {len(triangles)} numbers that are not negative")
    total = float((density * triangles.areas).sum())
    if not total > 0:
        return OverlapResult(np.zeros(len(tree)), 0, 0, 0)
    order, starts, positions, leaf_of = _items(tree, len(triangles), fragments)
    box = np.concatenate([tree.lower, tree.upper], axis=1)
    workers = threads or thread_count()
    sums = np.zeros((workers, len(tree)), np.int64)
    counts = np.zeros((workers, 3), np.int64)
    unit = 1.0 / (total * _UNIT)

    def work(worker: int, begin: int, end: int) -> None:
        counts[worker] += _walk(
            begin, end, order, triangles.corners, density, starts, positions, leaf_of, box,
            tree.left, tree.first, tree.count, tree.depth, unit, sums[worker],
        )  # fmt: skip

    run_blocks(work, len(order), _BLOCK, workers, progress)
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
