"""The invariants of a tree, checked one by one."""

from __future__ import annotations

import numpy as np

from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import F64, Triangles

#: Points per split triangle at which coverage by its leaves is checked: a regular grid of
#: barycentric coordinates, corners and edges included.
_GRID = 12


def faults(tree: Tree, triangles: Triangles | None = None) -> list[str]:
    """Check a tree; see :meth:`mibvh.tree.Tree.validate`."""
    found = _array_faults(tree) or _topology_faults(tree)
    if found:
        return found  # what follows relies on a sound structure
    found = _box_faults(tree)
    if triangles is not None:
        found += _coverage_faults(tree, triangles)
    return found


def _array_faults(tree: Tree) -> list[str]:
    found = []
    nodes = len(tree.left)
    for name, shape, kind in [
        ("lower", (nodes, 3), np.float32),
        ("upper", (nodes, 3), np.float32),
        ("left", (nodes,), np.int32),
        ("first", (nodes,), np.int32),
        ("count", (nodes,), np.int32),
        ("references", (len(tree.references),), np.int32),
    ]:
        array = getattr(tree, name)
        if array.shape != shape or array.dtype != kind:
            found.append(f"{name} is {array.dtype} {array.shape}, not {kind.__name__} {shape}")
    if nodes == 0 or len(tree.references) == 0:
        found.append("the tree is empty")
    return found


def _topology_faults(tree: Tree) -> list[str]:
    found = []
    nodes = len(tree)
    inner = np.flatnonzero(tree.left >= 0)
    left = tree.left[inner].astype(np.int64)
    if (left <= inner).any() or (left + 1 >= nodes).any():
        return ["a node's children do not stand behind it within the arrays"]
    children = np.concatenate([left, left + 1])
    if len(np.unique(children)) != nodes - 1 or len(children) != nodes - 1:
        return ["some node is not the child of exactly one node"]
    first, count = tree.first.astype(np.int64), tree.count.astype(np.int64)
    if first[0] != 0 or count[0] != len(tree.references):
        found.append("the root's range is not all references")
    if (count < 1).any():
        found.append(f"{int((count < 1).sum())} nodes have no references")
    joined = (
        (first[left] == first[inner])
        & (first[left + 1] == first[inner] + count[left])
        & (count[left] + count[left + 1] == count[inner])
    )
    if not joined.all():
        found.append(f"{int((~joined).sum())} inner nodes' ranges are not their children's, joined")
    if tree.depth > MAX_DEPTH:
        found.append(f"depth {tree.depth} is beyond the traversal stack of {MAX_DEPTH}")
    if tree.references.min() < 0:
        found.append("a reference is negative")
    if not found:
        order = np.argsort(tree.first[tree.is_leaf], kind="stable")
        leaf_of = np.repeat(np.flatnonzero(tree.is_leaf)[order], count[tree.is_leaf][order])
        pairs = np.stack([leaf_of, tree.references], axis=1)
        if len(np.unique(pairs, axis=0)) != len(pairs):
            found.append("a leaf holds a triangle twice")
    return found


def _box_faults(tree: Tree) -> list[str]:
    found = []
    if not (tree.lower <= tree.upper).all():  # false for NaN too
        found.append("a box is inverted or NaN")
    child = np.arange(1, len(tree))
    parent = tree.parents[child]
    inside = (tree.lower[child] >= tree.lower[parent]) & (tree.upper[child] <= tree.upper[parent])
    if not inside.all():
        found.append(f"{int((~inside).any(axis=1).sum())} boxes stick out of their parents'")
    return found


def _coverage_faults(tree: Tree, triangles: Triangles) -> list[str]:
    found = []
    if int(tree.references.max()) >= len(triangles):
        return ["a reference is beyond the triangles"]
    times = np.bincount(tree.references, minlength=len(triangles))
    if (times == 0).any():
        found.append(f"{int((times == 0).sum())} triangles are in no leaf")
    leaves = np.flatnonzero(tree.is_leaf)
    leaves = leaves[np.argsort(tree.first[leaves], kind="stable")]
    leaf_of = np.repeat(leaves, tree.count[leaves])
    whole = times[tree.references] == 1
    ids, nodes = tree.references[whole], leaf_of[whole]
    inside = (triangles.lower[ids] >= tree.lower[nodes]) & (
        triangles.upper[ids] <= tree.upper[nodes]
    )
    if not inside.all():
        found.append(f"{int((~inside).any(axis=1).sum())} references stick out of their leaves")
    split = np.flatnonzero(~whole)
    split = split[np.argsort(tree.references[split], kind="stable")]
    if len(split):
        missed = _uncovered(tree, triangles, tree.references[split], leaf_of[split])
        if missed:
            found.append(f"{missed} split triangles are not covered by their leaves")
    return found


def _barycentric_grid() -> F64:
    """(P, 3) float64: barycentric coordinates of a regular grid of points."""
    u, v = np.meshgrid(np.arange(_GRID + 1), np.arange(_GRID + 1), indexing="ij")
    keep = u + v <= _GRID
    a, b = u[keep] / _GRID, v[keep] / _GRID
    return np.stack([1 - a - b, a, b], axis=1)


def _uncovered(tree: Tree, triangles: Triangles, ids: np.ndarray, nodes: np.ndarray) -> int:
    """Count split triangles with a grid point in none of their leaves' boxes."""
    weights = _barycentric_grid()
    # Points are computed in float64; a face of a clipped box is a float32, so a point on it
    # may stand outside by a rounding of the triangle's coordinates.
    missed = 0
    starts = np.flatnonzero(np.r_[True, ids[1:] != ids[:-1]])
    ends = np.r_[starts[1:], len(ids)]
    for block in range(0, len(starts), 4096):
        chunk = slice(block, block + 4096)
        triangle = ids[starts[chunk]]
        points = np.einsum("pk,tkx->tpx", weights, triangles.corners[triangle].astype(np.float64))
        slack = 2e-6 * np.abs(triangles.corners[triangle]).max(axis=(1, 2))
        covered = np.zeros(points.shape[:2], bool)
        sizes = ends[chunk] - starts[chunk]
        for k in range(int(sizes.max())):
            has = np.flatnonzero(sizes > k)
            node = nodes[starts[chunk][has] + k]
            low = tree.lower[node].astype(np.float64)[:, None] - slack[has, None, None]
            high = tree.upper[node].astype(np.float64)[:, None] + slack[has, None, None]
            covered[has] |= ((points[has] >= low) & (points[has] <= high)).all(axis=2)
        missed += int((~covered.all(axis=1)).sum())
    return missed
