"""SAH and EPO by paths that share no code with :mod:`mibvh.metrics`.

EPO is estimated from points on the surfaces: a point costs ``C_n`` in every node that holds it,
save those with a reference to its own triangle. No triangle is clipped, and a triangle's own nodes
are marked by climbing from each of its leaves, so that what is wrong in the exact routine is not
wrong here in the same way.
"""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.audit.record import Check
from mibvh.parallel import run_blocks
from mibvh.tree import Tree
from mibvh.triangles import F32, F64, I32, Triangles
from mibvh.wide_tree import C_BOX, WideTree

#: Independent estimates, of which the spread is the error.
_GROUPS = 16
#: Points of each.
_POINTS = 6000
#: Standard errors by which an estimate may be off: less than one in 20,000, of Student's t.
_ERRORS = 5.5
#: Rounding of boxes and points, relative to the figure.
_ROUNDING = 2e-4
#: Triangles whose areas are computed at a time.
_BLOCK = 1 << 18


def check_sah(tree: Tree | WideTree, value: float) -> Check:
    """Recompute the surface area heuristic from the boxes, in float64."""
    extent = tree.upper.astype(np.float64) - tree.lower.astype(np.float64)
    area = 2 * (extent * np.roll(extent, 1, axis=1)).sum(axis=1)
    cost = _node_costs(tree)
    expected = float(cost[0] if area[0] == 0 else (cost * area).sum() / area[0])
    return Check.of("sah", value, expected, 1e-6 * expected, "recomputed from the boxes")


def check_epo(tree: Tree | WideTree, triangles: Triangles, value: float, seed: int = 0) -> Check:
    """Hold an exact end-point overlap against an estimate from points.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles
    value : float
        The exact figure.
    seed : int
        Of the points.

    Returns
    -------
    Check
        Passed if the estimate is within its error.
    """
    groups = estimates(tree, triangles, seed=seed)
    expected = float(groups.mean())
    error = float(groups.std(ddof=1) / np.sqrt(len(groups)))
    return Check.of(
        "epo",
        value,
        expected,
        _ERRORS * error + _ROUNDING * max(expected, abs(value)) + 1e-9,
        f"estimated from {_GROUPS * _POINTS:,} points on the surfaces",
    )


def estimates(
    tree: Tree | WideTree, triangles: Triangles, points: int = _POINTS, seed: int = 0
) -> F64:
    """Estimate the end-point overlap several times over.

    Returns
    -------
    (groups,) float64
        Independent estimates; their mean is the best one.
    """
    in_order = np.flatnonzero(tree.left < 0)
    in_order = in_order[np.argsort(tree.first[in_order])]
    leaf_of = np.repeat(in_order, tree.count[in_order])
    order = np.argsort(tree.references, kind="stable")
    begin = np.searchsorted(tree.references[order], np.arange(len(triangles) + 1))
    doubled = _doubled_areas(triangles.corners)
    # In the order of the leaves, a regular walk through the surface visits every region in
    # proportion to its area; the beginning is random.
    by_leaf = order[begin[:-1][begin[:-1] < begin[1:]]]
    walk = tree.references[np.sort(by_leaf)]
    along = np.cumsum(doubled[walk])
    if not along[-1] > 0:
        return np.zeros(_GROUPS)
    children = _children(tree)
    costs, parents, leaves = _node_costs(tree), _parents(tree.left, children), leaf_of[order]
    found = np.empty(_GROUPS)

    def estimate(_worker: int, group: int, _end: int) -> None:
        rng = np.random.default_rng([seed, 20, group])
        place = (np.arange(points) + rng.random()) / points * along[-1]
        chosen = walk[np.minimum(np.searchsorted(along, place, side="right"), len(walk) - 1)]
        chosen = np.sort(chosen)
        found[group] = (
            _points_cost(
                tree.lower,
                tree.upper,
                tree.left,
                children,
                costs,
                parents,
                leaves,
                begin,
                chosen,
                _on_triangles(triangles.corners[chosen], rng),
            )
            / points
        )

    run_blocks(estimate, _GROUPS, 1)
    return found


def _doubled_areas(corners: F32) -> F64:
    """(N,) float64; in blocks, since what they are computed from is many times as large."""
    found = np.empty(len(corners))
    for begin in range(0, len(corners), _BLOCK):
        a, b, c = corners[begin : begin + _BLOCK].astype(np.float64).transpose(1, 0, 2)
        found[begin : begin + _BLOCK] = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return found


def _on_triangles(corners: F32, rng: np.random.Generator) -> F64:
    """(N, 3) float64: a random point on each triangle.

    Clipped to the triangle's box: one on an axis-aligned triangle lies in its flat box. Rounding
    to float32 instead would put points of a wall that leans by a last bit into boxes beside it.
    """
    a, b = np.sqrt(rng.random(len(corners))), rng.random(len(corners))
    weights = np.stack([1 - a, a * (1 - b), a * b], axis=1)
    points = np.einsum("nk,nkx->nx", weights, corners.astype(np.float64))
    return np.clip(points, corners.min(axis=1), corners.max(axis=1))


def _children(tree: Tree | WideTree) -> I32:
    """(M,) int32: how many children each node has, side by side from its first one on."""
    if isinstance(tree, WideTree):
        return tree.children
    return np.where(tree.left < 0, 0, 2).astype(np.int32)


def _node_costs(tree: Tree | WideTree) -> F64:
    """(M,) float64: a wide node's boxes beyond the second have their own cost."""
    c_inner, c_tri = tree.meta.get("c_inner", 1.2), tree.meta.get("c_tri", 1.0)
    further = tree.meta.get("c_box", C_BOX) * (_children(tree) - 2.0)
    return np.where(tree.left < 0, c_tri * tree.count, c_inner + further).astype(np.float64)


def _parents(first: I32, children: I32) -> I32:
    parents = np.full(len(first), -1, np.int32)
    for place in range(int(children.max(initial=0))):
        inner = np.flatnonzero(children > place)
        parents[first[inner] + place] = inner
    return parents


@njit
def _points_cost(lower, upper, left, children, cost, parents, leaves, begin, chosen, points):
    """Sum over points of the cost of the foreign nodes that hold them."""
    owner = np.full(len(left), -1, np.int32)
    stack = np.empty(len(left), np.int32)
    marked, total = -1, 0.0
    for i in range(len(chosen)):
        triangle = chosen[i]
        if triangle != marked:
            for reference in range(begin[triangle], begin[triangle + 1]):
                node = leaves[reference]
                while node >= 0 and owner[node] != triangle:
                    owner[node] = triangle
                    node = parents[node]
            marked = triangle
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            inside = True
            for k in range(3):
                if points[i, k] < lower[node, k] or points[i, k] > upper[node, k]:
                    inside = False
            if not inside:
                continue
            if owner[node] != triangle:
                total += cost[node]
            for c in range(left[node], left[node] + children[node]):
                stack[top] = c
                top += 1
    return total
