"""The invariants of a tree, checked by compiled code before any kernel sees its arrays.

Kernels check no bounds: a wrong index is a crash, an endless loop or a wrong number. Each check
here is one pass over the nodes or the references, a few nanoseconds for each.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.coverage import uncovered
from mibvh.nodes import DEEPEST, MAX_DEPTH, Nodes
from mibvh.triangles import MAX_COORDINATE, Triangles

#: Leaves up to this size are searched for repeated triangles pair by pair, in compiled code; larger
#: ones are rare, and sorted by NumPy: Numba takes seconds to compile its own sort.
_SMALL_LEAF = 32
#: Cost constants up to this are taken, by builders too.
_DEAREST = 1e6

#: The first violation that :func:`_structure` meets, by the number that it returns.
_STRUCTURE = {
    1: "node {node} has left = {left}: neither -1 nor a child that stands behind it",
    2: "node {node} has left = {left}: its children are not among the {nodes} nodes",
    3: "node {node} is the child of no node",
    4: "a child of node {node} is the child of another node too",
    5: "node {node} is deeper than {deepest}",
    6: "node {node} has no references (count = {count}): inner nodes need the range of all below "
    "them, which Tree.from_arrays makes",
    7: "the root's range is not all {references} references, but {first} and {count} from there",
    8: "the range of node {node} ({first}, {count}) is not those of its children, joined",
    9: "a leaf, node {node}, holds a triangle twice",
}


@njit
def _structure(left, first, count, references, small):
    """Return the number of the first violation in :data:`_STRUCTURE`, and its node; 0 if none.

    Leaves of more than ``small`` references are not searched for repeated ones.

    Parents stand before their children: one pass sees each node after its parent, and there can
    be no cycle.
    """
    nodes = len(left)
    depth = np.zeros(nodes, np.uint16)  # from 1; 0 as long as no parent is known
    depth[0] = 1
    if first[0] != 0 or count[0] != len(references):
        return 7, 0
    for n in range(nodes):
        if depth[n] == 0:
            return 3, n
        if count[n] < 1:
            return 6, n
        child = np.int64(left[n])
        if child == -1:
            if count[n] <= small and _repeats(references, first[n], count[n]):
                return 9, n
            continue
        if child <= n:
            return 1, n
        if child + 1 >= nodes:
            return 2, n
        if depth[child] != 0 or depth[child + 1] != 0:
            return 4, n
        if depth[n] > DEEPEST:
            return 5, child
        depth[child] = depth[child + 1] = depth[n] + 1
        a, b = np.int64(count[child]), np.int64(count[child + 1])
        joined = first[child] == first[n] and first[child + 1] == first[n] + a
        if a < 1 or b < 1:
            return 6, child if a < 1 else child + 1
        if not joined or a + b != count[n]:
            return 8, n
    return 0, 0


@njit(allocates=False)
def _repeats(ids, first, count):
    """Whether a value stands twice among ``count`` of the array's from ``first``."""
    for i in range(first + 1, first + count):
        for k in range(first, i):
            if ids[i] == ids[k]:
                return True
    return False


@njit
def _references(references, triangles):
    """Return the first position that names none of the triangles, and how many are missing."""
    times = np.zeros(triangles, np.bool_)
    missing = triangles
    for i in range(len(references)):
        t = references[i]
        if t < 0 or t >= triangles:
            return i, 0
        if not times[t]:
            times[t] = True
            missing -= 1
    return -1, missing


@njit(allocates=False)
def _boxes(lower, upper, left, largest):
    """Count boxes that are inverted, NaN or overlarge, and those that stick out of their parents'.

    Each with the first such node.
    """
    wrong = out = 0
    first_wrong = first_out = -1
    for n in range(len(left)):
        sound = True
        for k in range(3):
            if not (-largest <= lower[n, k] <= upper[n, k] <= largest):  # true for NaN too
                sound = False
        if not sound:
            first_wrong = n if wrong == 0 else first_wrong
            wrong += 1
        if left[n] < 0:
            continue
        for child in range(left[n], left[n] + 2):
            inside = True
            for k in range(3):
                if lower[child, k] < lower[n, k] or upper[child, k] > upper[n, k]:
                    inside = False
            if not inside:
                first_out = child if out == 0 else first_out
                out += 1
    return wrong, first_wrong, out, first_out


@njit(allocates=False)
def _leaf_boxes(lower, upper, left, first, count, references, corners, times):
    """Count the unsplit triangles that stick out of their leaf's box; with the first such leaf."""
    out, first_out = 0, -1
    for n in range(len(left)):
        if left[n] >= 0:
            continue
        for i in range(first[n], first[n] + count[n]):
            t = references[i]
            if times[t] != 1:
                continue
            inside = True
            for k in range(3):
                a, b, c = corners[t, 0, k], corners[t, 1, k], corners[t, 2, k]
                if min(a, b, c) < lower[n, k] or max(a, b, c) > upper[n, k]:
                    inside = False
            if not inside:
                first_out = n if out == 0 else first_out
                out += 1
    return out, first_out


def violations(tree: Nodes, triangles: Triangles | None = None) -> list[str]:
    """Check a tree; see :meth:`mibvh.tree.Tree.validate`."""
    found = meta_violations(tree.meta) or structure_violations(tree)
    if found:
        return found
    if tree.depth > MAX_DEPTH:  # all but traversal can do with it
        found.append(f"depth {tree.depth} is beyond the traversal stack of {MAX_DEPTH}")
    if triangles is not None:
        found += geometry_violations(tree, triangles)
    return found


def structure_violations(tree: Nodes) -> list[str]:
    """Check what can be checked without the triangles."""
    found = _array_violations(tree)
    if found:
        return found
    violation, n = _structure(tree.left, tree.first, tree.count, tree.references, _SMALL_LEAF)
    if not violation:
        violation, n = _repeats_in_large_leaves(tree)
    if violation:
        return [
            _STRUCTURE[violation].format(
                node=n,
                left=tree.left[n],
                first=tree.first[n],
                count=tree.count[n],
                nodes=len(tree),
                references=len(tree.references),
                deepest=DEEPEST,
            )
        ]
    known = tree.meta.get("triangles")
    if known is None and tree.references.min() < 0:
        return ["a reference is negative"]
    return (_reference_violations(tree, known) if known is not None else []) + _box_violations(tree)


def _repeats_in_large_leaves(tree: Nodes) -> tuple[int, int]:
    """Return what :func:`_structure` does for leaves of a sound structure that it leaves out."""
    for n in np.flatnonzero((tree.left < 0) & (tree.count > _SMALL_LEAF)):
        run = np.sort(tree.references[tree.first[n] : tree.first[n] + tree.count[n]])
        if (run[1:] == run[:-1]).any():
            return 9, int(n)
    return 0, 0


def geometry_violations(tree: Nodes, triangles: Triangles) -> list[str]:
    """Check a tree of valid structure against its triangles."""
    found = _reference_violations(tree, len(triangles))
    if found:
        return found
    times = np.bincount(tree.references, minlength=len(triangles)).astype(np.int32)
    out, n = _leaf_boxes(
        tree.lower,
        tree.upper,
        tree.left,
        tree.first,
        tree.count,
        tree.references,
        triangles.corners,
        times,
    )
    if out:
        found.append(f"{out} references stick out of their leaves (first: in node {n})")
    missed, t = uncovered(tree, triangles, times)
    if missed:
        found.append(
            f"{missed} split triangles are not covered by their leaves (first: triangle {t})"
        )
    return found


def meta_violations(meta: Any) -> list[str]:
    """Check those entries of the metadata that metrics are made with."""
    if not isinstance(meta, Mapping):
        return ["its metadata is no table of names and values"]
    count, digest = meta.get("triangles"), meta.get("digest")
    if count is not None and (type(count) is not int or count < 1):
        return [f"its metadata says that it has {str(count)[:40]!r} triangles"]
    if digest is not None and not isinstance(digest, str):
        return ["its metadata has a digest that is no text"]
    for name in ("c_inner", "c_tri", "c_box"):
        cost = meta.get(name, 1.0)
        number = isinstance(cost, int | float) and not isinstance(cost, bool)
        if not (number and 0 <= cost <= _DEAREST):
            return [f"its metadata has the cost constant {name} = {str(cost)[:40]!r}"]
    return []


def _array_violations(tree: Nodes) -> list[str]:
    nodes = tree.left.shape[0] if tree.left.ndim else 0
    references = tree.references.shape[0] if tree.references.ndim else 0
    if nodes == 0 or references == 0:
        return ["the tree is empty"]
    found = []
    for name, shape, kind in [
        ("lower", (nodes, 3), np.float32),
        ("upper", (nodes, 3), np.float32),
        ("left", (nodes,), np.int32),
        ("first", (nodes,), np.int32),
        ("count", (nodes,), np.int32),
        ("references", (references,), np.int32),
    ]:
        array = getattr(tree, name)
        if array.shape != shape or array.dtype != kind:
            found.append(f"{name} is {array.dtype} {array.shape}, not {kind.__name__} {shape}")
    return found


def _reference_violations(tree: Nodes, triangles: int) -> list[str]:
    if triangles > len(tree.references):  # before memory is taken for that many
        return [
            f"of {triangles} triangles at least {triangles - len(tree.references)} are in no leaf"
        ]
    at, missing = _references(tree.references, triangles)
    if at >= 0:
        return [
            f"reference {at} is {tree.references[at]}, beyond the triangles (0 to {triangles - 1})"
        ]
    return [f"{missing} of {triangles} triangles are in no leaf"] if missing else []


def _box_violations(tree: Nodes) -> list[str]:
    wrong, n, out, child = _boxes(tree.lower, tree.upper, tree.left, MAX_COORDINATE)
    found = []
    if wrong:
        found.append(f"{wrong} boxes are inverted or NaN, or beyond 1e15 (first: node {n})")
    if out:
        found.append(f"{out} boxes stick out of their parents' (first: node {child})")
    return found
