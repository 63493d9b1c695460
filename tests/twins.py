"""Slow twins in float64 of what mibvh computes fast: every node against every triangle or point.

They share no code with the package beyond the tree's own arrays.
"""

from __future__ import annotations

import numpy as np


def clipped_areas(corners, lower, upper):
    """(P,) areas of triangles (P, 3, 3) in closed boxes (P, 3): Sutherland and Hodgman, in step."""
    polygon = np.zeros((len(corners), 10, 3))
    polygon[:, :3] = corners
    size = np.full(len(corners), 3)
    slot = np.arange(10)
    for axis in range(3):
        for sign, limit in ((1.0, lower[:, axis]), (-1.0, upper[:, axis])):
            beyond = sign * (polygon[:, :, axis] - limit[:, None]) < 0
            cut = np.flatnonzero((beyond & (slot < size[:, None])).any(axis=1))
            polygon[cut], size[cut] = _one_side(polygon[cut], size[cut], axis, sign, limit[cut])
    spokes = np.where((slot < size[:, None])[:, :, None], polygon - polygon[:, :1], 0.0)
    total = np.cross(spokes[:, 1:-1], spokes[:, 2:]).sum(axis=1)
    return np.where(size >= 3, 0.5 * np.linalg.norm(total, axis=1), 0.0)


def _one_side(polygon, size, axis, sign, limit):
    """Cut polygons by a plane each."""
    rows, slot = np.arange(len(polygon))[:, None], np.arange(10)
    used = slot < size[:, None]
    follower = polygon[rows, np.where(slot + 1 < size[:, None], slot + 1, 0)]
    p, q = (sign * (x[:, :, axis] - limit[:, None]) for x in (polygon, follower))
    crosses = used & ((p >= 0) != (q >= 0))
    share = p / np.where(crosses, p - q, 1.0)
    between = polygon + share[:, :, None] * (follower - polygon)
    # Each edge gives its beginning, if that is inside, and where it crosses the plane.
    points = np.stack([polygon, between], 2).reshape(len(polygon), 20, 3)
    kept = np.stack([used & (p >= 0), crosses], 2).reshape(len(polygon), 20)
    assert kept.sum(axis=1).max(initial=0) <= 10
    order = np.argsort(~kept, axis=1, kind="stable")[:, :10]
    return points[rows, order], kept.sum(axis=1)


def owned(tree, triangles):
    """(M, N) bool: whether a triangle has any reference below a node."""
    own = np.zeros((len(tree), triangles), bool)
    for node in range(len(tree)):
        own[node, tree.references[tree.first[node] :][: tree.count[node]]] = True
    return own


def foreign_fractions(tree, triangles, weights=None):
    """(M,) share of the surfaces that is foreign to each node and in its box."""
    corners = triangles.corners.astype(np.float64)
    weights = np.ones(len(corners)) if weights is None else np.asarray(weights)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = weights @ np.linalg.norm(cross, axis=1) / 2
    near = ~owned(tree, len(corners))
    for k in range(3):
        near &= corners[:, :, k].min(axis=1) <= tree.upper[:, k, None]
        near &= corners[:, :, k].max(axis=1) >= tree.lower[:, k, None]
    node, t = np.nonzero(near)
    areas = clipped_areas(corners[t], *(b[node].astype(float) for b in (tree.lower, tree.upper)))
    return np.bincount(node, weights[t] * areas, len(tree)) / total


def leaf_of_reference(tree):
    """(R,) the leaf that each reference is in."""
    leaf = np.zeros(len(tree.references), int)
    for node in np.flatnonzero(tree.left < 0):
        leaf[tree.first[node] :][: tree.count[node]] = node
    return leaf


def fragment_fractions(tree, triangles):
    """(M,) the same where a reference owns only what its triangle has in its leaf's box.

    The part in the leaf and in another node's box is the part in the box that both share.
    """
    corners = triangles.corners[tree.references].astype(np.float64)
    leaf = leaf_of_reference(tree)
    low = np.maximum(tree.lower[:, None], tree.lower[leaf][None]).astype(float)
    high = np.minimum(tree.upper[:, None], tree.upper[leaf][None]).astype(float)
    own = (tree.first[:, None] <= np.arange(len(leaf))) & (
        np.arange(len(leaf)) < (tree.first + tree.count)[:, None]
    )
    near = ~own & (low <= high).all(axis=2)
    near &= (corners.min(axis=1)[None] <= high).all(axis=2)
    near &= (corners.max(axis=1)[None] >= low).all(axis=2)
    node, r = np.nonzero(near)
    areas = clipped_areas(corners[r], low[node, r], high[node, r])
    return np.bincount(node, areas, len(tree)) / triangles.areas.sum()


def node_costs(tree):
    """(M,) 1.2 or what the tree was built with, and a leaf's references."""
    return np.where(tree.left < 0, tree.meta["c_tri"] * tree.count, tree.meta["c_inner"])


def point_costs(tree, triangles, points, ids):
    """(P, 2) cost of the foreign and of the own nodes that hold each point."""
    own, costs = owned(tree, len(triangles)), node_costs(tree)
    out = np.zeros((len(points), 2))
    for i, point in enumerate(points):
        holds = ((point >= tree.lower) & (point <= tree.upper)).all(axis=1)
        out[i] = costs @ (holds & ~own[:, ids[i]]), costs @ (holds & own[:, ids[i]])
    return out


def line_costs(tree, o, d, start, stop):
    """(L,) cost of the closed boxes that ``o + t d``, ``start <= t <= stop``, touches."""
    costs = node_costs(tree)
    out = np.zeros(len(o))
    for i in range(len(o)):
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (tree.lower - o[i]) / d[i], (tree.upper - o[i]) / d[i]
        flat = d[i] == 0
        held = (tree.lower <= o[i]) & (o[i] <= tree.upper)
        near = np.where(flat, np.where(held, -np.inf, np.inf), np.minimum(a, b)).max(axis=1)
        far = np.where(flat, np.where(held, np.inf, -np.inf), np.maximum(a, b)).min(axis=1)
        out[i] = costs @ (np.maximum(near, start) <= np.minimum(far, stop[i]))
    return out
