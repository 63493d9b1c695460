"""A plain walk through a wide tree, ray by ray: the wide kernel's slow twin.

It goes by the tree's own arrays, not by the kernel's rows, and computes in float32 what the kernel
does, so that hits and visits are the kernel's. Where asked, it tells every step of every ray: what
warps that trace them together have to go through.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.collapsing import collapse
from mibvh.rays.rayset import RaySet
from mibvh.traversal.kernel_rays import kernel_rays
from mibvh.traversal.records import unit_scale
from mibvh.traversal.trace import U32
from mibvh.traversal.wide_nodes import enter_children, new_children, wide_nodes
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import F32, F64, I32, as_triangles
from mibvh.wide_tree import WideTree

_TINY = np.float32(2.0**-80)
_ZERO, _INF = np.float32(0), np.float32(np.inf)


@dataclasses.dataclass(frozen=True, eq=False)
class Walk:
    """What rays visit in a wide tree.

    Attributes
    ----------
    t : (R,) float32
        Distances in units of the direction's length; infinite for a miss.
    triangle : (R,) int32
        -1 for a miss.
    inner, boxes, leaves, tests : (R,) uint32
        As :class:`mibvh.Hits` has them.
    starts : (R + 1,) int64
        Where each ray's steps begin in ``steps``; all 0 unless asked for.
    steps : (S,) int32
        Ray by ray and in order: an inner node by its number, a triangle by the complement of its
        place in the tree's references.
    """

    t: F32
    triangle: I32
    inner: U32
    boxes: U32
    leaves: U32
    tests: U32
    starts: Any
    steps: I32


def walk_wide_tree(
    tree: WideTree, triangles: Any, rays: RaySet, *, any_hit: bool = False, steps: bool = False
) -> Walk:
    """Trace rays through a wide tree, one after the other.

    Parameters
    ----------
    tree : WideTree
    triangles : Triangles or (N, 3, 3) array
    rays : RaySet
    any_hit : bool
        End each ray at the first hit found; children are visited in the tree's order, if it has
        one (:meth:`mibvh.WideTree.ordered`).
    steps : bool
        Tell every step, too.

    Returns
    -------
    Walk
    """
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    scale = unit_scale(triangles)
    o, d, tmax, unit = kernel_rays(rays, float(scale))
    counts = np.zeros((len(rays), 4), np.uint32)
    t, hit = np.empty(len(rays), np.float32), np.empty(len(rays), np.int32)
    nodes, found = wide_nodes(tree, scale, any_hit), new_children()
    shapes = (tree.references, triangles.corners * scale)
    starts = np.zeros(len(rays) + 1, np.int64)
    told = np.empty(0, np.int32)
    hits = (t, hit, starts)
    _walk(nodes, shapes, (o, d, tmax), any_hit, found, hits, counts, told)
    if steps:
        np.cumsum(counts[:, 0] + counts[:, 3], dtype=np.int64, out=starts[1:])
        told = np.empty(starts[-1], np.int32)
        _walk(nodes, shapes, (o, d, tmax), any_hit, found, hits, counts, told)
    with np.errstate(over="ignore"):
        t = (t / unit).astype(np.float32)
    inner, boxes, leaves, tests = (np.ascontiguousarray(column) for column in counts.T)
    return Walk(t, hit, inner, boxes, leaves, tests, starts, told)


def node_visits(tree: Tree | WideTree, triangles: Any, rays: RaySet) -> F64:
    """Visits of each node by rays that are traced through a tree, per ray.

    What :func:`mibvh.collapse` takes for weights, so that the tree it makes is cheap for such rays.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
        What it was built for.
    rays : RaySet
        Closest hits are found, nearest child first.

    Returns
    -------
    (M,) float64
        From 0 to 1.
    """
    wide = tree if isinstance(tree, WideTree) else collapse(tree, 2)  # which keeps its nodes
    walk = walk_wide_tree(wide, triangles, rays, steps=True)
    leaf_at = np.full(len(wide.references), -1, np.int32)  # a leaf, where its first triangle is
    leaves = np.flatnonzero(wide.is_leaf)
    leaf_at[wide.first[leaves]] = leaves
    visited = np.where(walk.steps >= 0, walk.steps, leaf_at[np.maximum(~walk.steps, 0)])
    return np.bincount(visited[visited >= 0], minlength=len(wide)) / len(rays)


@njit
def _walk(nodes, tree, rays, any_hit, found, hits, counts, told):
    """Trace all rays."""
    references, corners = tree
    o, d, tmax = rays
    t_out, hit_out, starts = hits
    stack = np.empty(8 * MAX_DEPTH + 8, np.int32)
    for r in range(len(tmax)):
        origin = (o[r, 0], o[r, 1], o[r, 2])
        inv = (_inverse(d[r, 0]), _inverse(d[r, 1]), _inverse(d[r, 2]))
        t, hit = tmax[r], np.int32(-1)
        inner = boxes = leaves = tests = 0
        at = starts[r]
        stack[0], top = 0, 1 if t >= _ZERO else 0
        while top > 0:
            top -= 1
            node = stack[top]
            begin, size = nodes.child[node], nodes.children[node]
            if begin < 0:
                leaves += 1
                ended = False
                for i in range(nodes.first[node], nodes.first[node] + nodes.count[node]):
                    if len(told) > 0:
                        told[at] = ~i
                        at += 1
                    tests += 1
                    distance = _triangle(corners[references[i]], o[r], d[r], t)
                    if distance < t:
                        t, hit = distance, references[i]
                        if any_hit:
                            ended = True
                            break
                if ended:
                    break
                continue
            if len(told) > 0:
                told[at] = node
                at += 1
            inner += 1
            boxes += size
            enter_children(nodes, node, origin, inv, t, found)
            for i in range(7, -1, -1):
                if found.near[found.order[i]] < _INF:
                    stack[top] = begin + found.order[i]
                    top += 1
        t_out[r] = t if hit >= 0 else _INF
        hit_out[r] = hit
        counts[r, 0], counts[r, 1], counts[r, 2], counts[r, 3] = inner, boxes, leaves, tests


@njit
def _inverse(x):
    return np.float32(1) / (np.float32(np.copysign(_TINY, x)) if abs(x) < _TINY else x)


@njit
def _triple(d, ax, ay, az, bx, by, bz):
    sx, sy, sz = ax + bx, ay + by, az + bz
    ex, ey, ez = bx - ax, by - ay, bz - az
    return d[0] * (sy * ez - sz * ey) + (d[1] * (sz * ex - sx * ez) + d[2] * (sx * ey - sy * ex))


@njit
def _triangle(corners, o, d, t):
    """Distance at which a ray hits a triangle before t, or infinity."""
    ax, ay, az = corners[0, 0] - o[0], corners[0, 1] - o[1], corners[0, 2] - o[2]
    bx, by, bz = corners[1, 0] - o[0], corners[1, 1] - o[1], corners[1, 2] - o[2]
    cx, cy, cz = corners[2, 0] - o[0], corners[2, 1] - o[1], corners[2, 2] - o[2]
    u = _triple(d, cx, cy, cz, bx, by, bz)
    v = _triple(d, ax, ay, az, cx, cy, cz)
    w = _triple(d, bx, by, bz, ax, ay, az)
    if not (
        (u >= _ZERO and v >= _ZERO and w >= _ZERO) or (u <= _ZERO and v <= _ZERO and w <= _ZERO)
    ):
        return _INF
    nx, ny, nz = _normal(corners)
    at = (nx * ax + ny * ay + nz * az) / (nx * d[0] + ny * d[1] + nz * d[2])
    return at if at >= _ZERO and at < t else _INF


@njit
def _normal(corners):
    """Normal of any length, its largest component 1."""
    e = corners[1:].astype(np.float64) - corners[0].astype(np.float64)
    x = e[0, 1] * e[1, 2] - e[0, 2] * e[1, 1]
    y = e[0, 2] * e[1, 0] - e[0, 0] * e[1, 2]
    z = e[0, 0] * e[1, 1] - e[0, 1] * e[1, 0]
    largest = max(abs(x), abs(y), abs(z))
    if largest > 0.0:
        x, y, z = x / largest, y / largest, z / largest
    return np.float32(x), np.float32(y), np.float32(z)
