"""The invariants of a wide tree, checked by compiled code in one pass over its nodes."""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.nodes import MAX_DEPTH, WIDTHS, WideNodes
from mibvh.triangles import MAX_COORDINATE
from mibvh.validation import meta_violations

#: The violation that :func:`_first_violation` meets, by the number that it returns.
_VIOLATIONS = {
    1: "has {children} children, not 2 to {width}",
    2: "has children that do not stand behind it within the arrays",
    3: "is the child of more than one node",
    4: "is the child of no node",
    5: "has no references",
    6: "has a range of references that its children's do not make up",
    7: "has a box that is inverted, NaN or beyond 1e15",
    8: "has a box that sticks out of its parent's",
    9: "is deeper than the traversal stack of {depth}",
    10: "is a leaf that has children",
    11: "is a leaf that holds a triangle twice",
}


def violations(tree: WideNodes) -> list[str]:
    """Return the first violation, without the triangles; see ``WideTree.validate``."""
    found = meta_violations(tree.meta) or _array_violations(tree)
    if found:
        return found[:1]
    violation, node = _first_violation(
        tree.lower,
        tree.upper,
        tree.child,
        tree.children,
        tree.first,
        tree.count,
        tree.references,
        tree.width,
        # Grids of 8 bits widen boxes, by less than the scene's size.
        MAX_COORDINATE * (2 if tree.quantised else 1),
    )
    if violation:
        sentence = _VIOLATIONS[violation].format(
            children=tree.children[node], width=tree.width, depth=MAX_DEPTH
        )
        return [f"node {node} {sentence}"]
    if tree.references.min() < 0:
        return [f"reference {int(tree.references.argmin())} is negative"]
    return []


def _array_violations(tree: WideNodes) -> list[str]:
    found = []
    if tree.width not in WIDTHS:
        found.append(f"the width is {tree.width!r}, not one of 2, 4, 8")
    nodes = len(tree.child)
    for name in ("lower", "upper", "child", "children", "first", "count", "references"):
        array = getattr(tree, name)
        boxes = name in ("lower", "upper")
        kind = np.float32 if boxes else np.int32
        shape = (nodes, 3) if boxes else (len(tree.references) if name == "references" else nodes,)
        if array.shape != shape or array.dtype != kind:
            found.append(f"{name} is {array.dtype} {array.shape}, not {kind.__name__} {shape}")
    if nodes == 0 or len(tree.references) == 0:
        found.append("the tree is empty")
    return found


@njit
def _first_violation(lower, upper, child, children, first, count, references, width, largest):
    """Number of the first violation and its node; 0 for a valid tree.

    Parents stand before their children: what a node is refused for is not looked at below it.
    """
    nodes = len(child)
    depth = np.full(nodes, -1, np.int32)
    depth[0] = 0
    seen = np.full(max(references.max(), 0) + 1, -1, np.int32)
    if first[0] != 0 or count[0] != len(references):
        return 6, 0
    for n in range(nodes):
        if depth[n] < 0:
            return 4, n
        for k in range(3):
            # True for NaN.
            if not -largest <= lower[n, k] <= upper[n, k] <= largest:
                return 7, n
        if child[n] < 0:
            if children[n] != 0:
                return 10, n
            for i in range(first[n], first[n] + count[n]):
                if references[i] >= 0:
                    if seen[references[i]] == n:
                        return 11, n
                    seen[references[i]] = n
            continue
        if children[n] < 2 or children[n] > width:
            return 1, n
        begin, end = np.int64(child[n]), np.int64(child[n]) + children[n]
        if begin <= n or end > nodes:
            return 2, n
        if depth[n] >= MAX_DEPTH:
            return 9, begin
        for c in range(begin, end):
            if depth[c] >= 0:
                return 3, c
            depth[c] = depth[n] + 1
            if count[c] < 1:
                return 5, c
            for k in range(3):
                if lower[c, k] < lower[n, k] or upper[c, k] > upper[n, k]:
                    return 8, c
        at = np.int64(first[n])
        for c in begin + np.argsort(first[begin:end]):
            if first[c] != at:
                return 6, n
            at += count[c]
        if at != np.int64(first[n]) + count[n]:
            return 6, n
    return 0, 0
