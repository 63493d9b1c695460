"""Wide trees made by collapsing binary ones.

Which nodes of the binary tree become nodes of the wide one, the others' children going to their
parents, is chosen by dynamic programming (Ylitie, Karras and Laine, *Efficient Incoherent Ray
Traversal on GPUs Through Compressed Wide BVHs*, HPG 2017), or from the root on by opening the child
of the largest area until the node is full (Wald, Benthin and Boulos, *Getting Rid of Packets*, RT
2008), as most programs do.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.measures.area import Measure
from mibvh.measures.nodes import node_measures
from mibvh.nodes import C_INNER, C_TRI
from mibvh.tree import Tree
from mibvh.triangles import F64, I32, as_triangles
from mibvh.wide_tree import C_BOX, WIDTHS, WideTree

Method = Literal["optimal", "greedy"]


def collapse(
    tree: Tree,
    width: int = 8,
    *,
    method: Method = "optimal",
    weights: npt.ArrayLike | None = None,
    measure: Measure | None = None,
    c_inner: float | None = None,
    c_box: float = C_BOX,
    c_tri: float | None = None,
    max_leaf: int | None = None,
) -> WideTree:
    """Collapse a binary tree to nodes of up to ``width`` children.

    Parameters
    ----------
    tree : Tree
        Of any leaves; with one reference each, as :func:`unfold` makes them, every triangle
        becomes a child with a box of its own.
    width : int
        2, 4 or 8. With 2 the tree stays as it is.
    method : "optimal" or "greedy"
        The cheapest of all wide trees that consist of this tree's nodes, by dynamic programming;
        or from the root on, opening the child of the greatest weight until a node is full.
    weights : (M,) array, optional
        What each node's visit is worth: the probability that a ray comes to it, up to a factor.
        By default its area: the cost minimised is then SAH.
    measure : Measure, optional
        What each node's box costs to have, in the place of weights: one of
        :mod:`mibvh.measures`, such as that which the tree was built by.
    c_inner : float, optional
        Cost of visiting an inner node of two children; what the tree was built with by default.
    c_box : float
        Cost of each child box beyond the second.
    c_tri : float, optional
        Cost of a triangle; what the tree was built with by default.
    max_leaf : int, optional
        Let the dynamic programme make one leaf of what is below a node, where that is cheaper
        and has no more references than this. By default leaves stay as they are. What splitting
        left of a triangle in such a leaf becomes one reference again.

    Returns
    -------
    WideTree
        With its costs in ``meta``, and the options.

    Raises
    ------
    MibvhError
        If an option is out of range.
    """
    if width not in WIDTHS:
        raise MibvhError(f"a wide tree's width is one of 2, 4, 8, not {width!r}")
    if method not in ("optimal", "greedy"):
        raise MibvhError(f"a tree is collapsed by optimal or greedy, not {method!r}")
    if max_leaf is not None and (method == "greedy" or max_leaf < 1):
        raise MibvhError(f"max_leaf must be at least 1, and the method optimal, not {max_leaf}")
    costs = {
        "c_inner": tree.meta.get("c_inner", C_INNER) if c_inner is None else c_inner,
        "c_box": c_box,
        "c_tri": tree.meta.get("c_tri", C_TRI) if c_tri is None else c_tri,
    }
    if not min(costs.values()) >= 0:
        raise MibvhError(f"costs are not negative: {costs}")
    if weights is not None and measure is not None:
        raise MibvhError("a tree is collapsed by weights or by a measure, not by both")
    weight = _weights(tree, node_measures(tree, measure) if measure else weights)
    if method == "greedy":
        kind = _greedy(tree.left, weight, width)
    else:
        split = _programme(
            tree.left,
            tree.count,
            weight,
            width,
            costs["c_inner"],
            costs["c_box"],
            costs["c_tri"],
            max_leaf or 0,
        )
        kind = _chosen(tree.left, split, width)
    nodes, child, children = _number(tree.left, kind)
    by = measure.name if measure else "area" if weights is None else "given"
    options = {"width": width, "method": method, "max_leaf": max_leaf, "weights": by}
    first, count, references = tree.first[nodes], tree.count[nodes], tree.references
    if max_leaf is not None and tree.splits_triangles:
        first, count, references = _without_repeats(child, first, count, references)
    return WideTree(
        tree.lower[nodes],
        tree.upper[nodes],
        child,
        children,
        first,
        count,
        references,
        width,
        False,
        {**tree.meta, **costs, "collapse": options},
    )


def _without_repeats(child: I32, first: I32, count: I32, references: I32) -> tuple[I32, I32, I32]:
    """Ranges and references without those that name a triangle again in the same leaf."""
    kept = np.ones(len(references), np.bool_)
    _mark_repeats(child, first, count, references, kept)
    place = np.concatenate([[0], np.cumsum(kept)]).astype(np.int32)
    return place[first], place[first + count] - place[first], references[kept]


@njit
def _mark_repeats(child, first, count, references, kept):
    for n in range(len(child)):
        if child[n] < 0:
            for i in range(first[n] + 1, first[n] + count[n]):
                if references[i] in references[first[n] : i]:
                    kept[i] = False


def _weights(tree: Tree, weights: npt.ArrayLike | None) -> F64:
    if weights is None:
        return tree.half_areas
    given = np.ascontiguousarray(weights, np.float64)
    if given.shape != (len(tree),) or not (np.isfinite(given) & (given >= 0)).all():
        raise MibvhError(f"weights need {len(tree)} numbers that are not negative, one per node")
    return given


#: Kinds of a binary tree's nodes in the wide one: gone, an inner node, a leaf.
_GONE, _INNER, _LEAF = 0, 1, 2


@njit
def _programme(left, count, weight, width, c_inner, c_box, c_tri, max_leaf):
    """How each node's subtree is best cut into at most j = 2..width roots.

    ``split[n, j]`` is how many of j roots the left child gets, negative where a single root is no
    dearer; ``split[n, 0]`` how many children the node has as a wide one, or 0 where it is better
    a leaf.
    """
    nodes = len(left)
    # float32 halves the greatest need of memory; a rounding is far less than trees differ by.
    cost = np.zeros((nodes, width + 1), np.float32)
    split = np.zeros((nodes, width + 1), np.int8)
    for n in range(nodes - 1, -1, -1):
        leaf = weight[n] * c_tri * count[n]
        if left[n] < 0:
            cost[n, :] = leaf
            continue
        a, b = left[n], left[n] + 1
        alone = np.inf
        for j in range(2, width + 1):
            best = np.inf
            for k in range(1, j):
                both = np.float64(cost[a, k]) + np.float64(cost[b, j - k])
                if both < best:
                    best = both
                    split[n, j] = k
            cost[n, j] = best
            node = best + weight[n] * (c_inner + c_box * (j - 2))
            if node < alone:
                alone = node
                split[n, 0] = j
        if count[n] <= max_leaf and leaf <= alone:
            alone = leaf
            split[n, 0] = 0
        cost[n, 1] = alone
        for j in range(2, width + 1):
            if cost[n, 1] <= cost[n, j]:
                cost[n, j] = cost[n, 1]
                split[n, j] = -split[n, j]
    return split


@njit
def _chosen(left, split, width):
    """Kind of each node, from what the programme found."""
    kind = np.zeros(len(left), np.int8)
    stack = np.empty((len(left) + 1, 2), np.int32)  # node, roots that its subtree is cut into
    stack[0, 0], stack[0, 1], top = 0, 1, 1
    while top > 0:
        top -= 1
        n, j = stack[top, 0], stack[top, 1]
        if left[n] < 0:
            kind[n] = _LEAF
            continue
        if j == 1 or split[n, j] < 0:
            j = np.int32(split[n, 0])
            kind[n] = _LEAF if j == 0 else _INNER
            if j == 0:
                continue
        k = np.int32(abs(split[n, j]))
        stack[top, 0], stack[top, 1] = left[n], k
        stack[top + 1, 0], stack[top + 1, 1] = left[n] + 1, j - k
        top += 2
    return kind


@njit
def _greedy(left, weight, width):
    """Kind of each node, where wide nodes are filled by opening the child of most weight."""
    kind = np.zeros(len(left), np.int8)
    kind[0] = _INNER if left[0] >= 0 else _LEAF
    group = np.empty(width, np.int64)
    for n in range(len(left)):  # parents before children
        if kind[n] != _INNER:
            continue
        group[0], group[1], size = left[n], left[n] + 1, 2
        while size < width:
            widest = -1
            for i in range(size):
                if left[group[i]] >= 0 and (widest < 0 or weight[group[i]] > weight[group[widest]]):
                    widest = i
            if widest < 0:
                break
            opened = left[group[widest]]
            group[widest], group[size] = opened, opened + 1
            size += 1
        for i in range(size):
            kind[group[i]] = _INNER if left[group[i]] >= 0 else _LEAF
    return kind


@njit
def _number(left, kind):
    """The wide tree's nodes: which binary nodes they are, first child, and number of children.

    Groups of siblings stand in the order of their first members in the binary tree, so that a
    tree in which every node stays keeps its numbers.
    """
    kept = np.flatnonzero(kind > 0)
    inner = np.flatnonzero(kind == _INNER)
    size = np.zeros(len(inner) + 1, np.int64)  # where each group begins in members
    members = np.empty(len(kept), np.int64)
    key = np.empty(len(inner), np.int64)
    stack = np.empty(64, np.int64)
    end = 0
    for i in range(len(inner)):
        stack[0], stack[1], top = left[inner[i]] + 1, left[inner[i]], 2
        key[i] = len(left)
        while top > 0:
            top -= 1
            n = stack[top]
            if kind[n] == _GONE:
                stack[top], stack[top + 1] = left[n] + 1, left[n]
                top += 2
            else:
                members[end] = n
                key[i] = min(key[i], n)
                end += 1
        size[i + 1] = end
    nodes = np.zeros(len(kept), np.int64)
    place = np.zeros(len(left), np.int64)
    child, children = np.full(len(kept), -1, np.int32), np.zeros(len(kept), np.int32)
    end = 1
    for i in np.argsort(key):
        parent = place[inner[i]]
        child[parent], children[parent] = end, size[i + 1] - size[i]
        for m in range(size[i], size[i + 1]):
            nodes[end], place[members[m]] = members[m], end
            end += 1
    return nodes, child, children


def binary_nodes(wide: WideTree, tree: Tree) -> I32:
    """Which node of a binary tree each node of a wide one is, that was collapsed from it.

    What is known of the binary tree's nodes, such as their overlap, need not be computed again.

    Parameters
    ----------
    wide : WideTree
        From :func:`collapse`.
    tree : Tree

    Returns
    -------
    (M,) int32

    Raises
    ------
    MibvhError
        If some node is none of the binary tree's, or has another box.
    """
    # Ranges of references name nodes: a child's is shorter than its parent's.
    size = len(tree.references) + 1
    keys, wanted = (t.first.astype(np.int64) * size + t.count for t in (tree, wide))
    order = np.argsort(keys)
    place = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(tree) - 1)
    nodes = order[place].astype(np.int32)
    if (keys[nodes] != wanted).any() or not (
        np.array_equal(tree.lower[nodes], wide.lower)
        and np.array_equal(tree.upper[nodes], wide.upper)
    ):
        raise MibvhError("the wide tree was not collapsed from this tree, or its boxes are wider")
    return nodes


def nodes_in_finer(tree: Tree, finer: Tree) -> I32 | None:
    """Which node of a finer tree each node of a tree is, if both were collapsed from one draft.

    What is known of the finer tree's nodes, such as their overlap, need not be computed again.

    Parameters
    ----------
    tree : Tree
    finer : Tree
        The same but for its leaves, some of which are smaller.

    Returns
    -------
    (M,) int32 or None
        None if the trees differ otherwise: some node of the tree is none of the finer one's, or
        has another box.
    """
    nodes = _same_places(tree.left, finer.left)
    if len(nodes) < len(tree) or not (
        np.array_equal(tree.lower, finer.lower[nodes])
        and np.array_equal(tree.upper, finer.upper[nodes])
    ):
        return None
    return nodes


@njit
def _same_places(left, finer):
    """Walk two trees side by side, the first to its leaves; nothing if the second ends before."""
    place = np.zeros(len(left), np.int32)
    for n in range(len(left)):  # parents before children
        if left[n] >= 0:
            child = finer[place[n]]
            if child < 0:
                return place[:0]
            place[left[n]], place[left[n] + 1] = child, child + 1
    return place


def unfold(tree: Tree, triangles: Any) -> Tree:
    """Halve a tree's leaves until each holds one reference, boxed by its part of the leaf's box.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles or (N, 3, 3) array

    Returns
    -------
    Tree
        With new nodes behind the others.

    Raises
    ------
    MibvhError
        If the tree is invalid, or was built for another geometry.
    """
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    lower, upper, left, first, count = _unfold(
        tree.lower,
        tree.upper,
        tree.left,
        tree.first,
        tree.count,
        tree.references,
        triangles.corners,
    )
    return Tree(lower, upper, left, first, count, tree.references, {**tree.meta, "unfolded": True})


@njit
def _unfold(lower, upper, left, first, count, references, corners):
    nodes, leaves = len(left), (len(left) + 1) // 2
    size = nodes + 2 * (len(references) - leaves)
    lo, hi = np.empty((size, 3), np.float32), np.empty((size, 3), np.float32)
    child = np.full(size, -1, np.int32)
    begin, number = np.empty(size, np.int32), np.empty(size, np.int32)
    lo[:nodes], hi[:nodes], child[:nodes] = lower, upper, left
    begin[:nodes], number[:nodes] = first, count
    size = nodes
    for leaf in range(nodes):
        if left[leaf] >= 0:
            continue
        # -- halve, parents before children
        new = size
        n = leaf
        while n < size:
            if number[n] > 1:
                child[n] = size
                begin[size], number[size] = begin[n], number[n] // 2
                begin[size + 1] = begin[n] + number[size]
                number[size + 1] = number[n] - number[size]
                size += 2
            n = max(n + 1, new)
        # -- boxes, children before parents
        for i in range(size - 1, new - 2, -1):
            n = i if i >= new else leaf
            if child[n] >= 0:
                for k in range(3):
                    lo[n, k] = min(lo[child[n], k], lo[child[n] + 1, k])
                    hi[n, k] = max(hi[child[n], k], hi[child[n] + 1, k])
                continue
            t = references[begin[n]]
            for k in range(3):
                a = min(corners[t, 0, k], corners[t, 1, k], corners[t, 2, k])
                b = max(corners[t, 0, k], corners[t, 1, k], corners[t, 2, k])
                lo[n, k] = min(max(a, lower[leaf, k]), upper[leaf, k])
                hi[n, k] = max(min(b, upper[leaf, k]), lower[leaf, k])
    return lo, hi, child, begin, number
