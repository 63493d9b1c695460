"""`treelet` and `streelet`: exhaustive rearrangement of treelets.

Karras and Aila: *Fast Parallel Construction of High-Quality Bounding Volume Hierarchies*
(HPG 2013), known as TRBVH. A treelet is a node with a few of its descendants: it grows from
its root by opening, again and again, the treelet leaf of largest area, until it has n = 7
leaves. Of all binary trees over these n subtrees the best is found by dynamic programming
over their 2^n subsets s::

    c[s] = min( C_inner A[s] + min over p of (c[p] + c[s without p]),  C_tri A[s] T[s] )

where A[s] is the area of the box around the subset, T[s] the number of triangles in it, and
the second term, the subset as one leaf, is there as long as T[s] <= max_leaf. For a single
subtree c is the least cost of that subtree, which is kept for every node of the tree. The
treelet is rebuilt where that lowers its cost, so SAH after the leaf collapse never rises.

A round goes through all nodes with at least gamma references below, bottom-up; gamma is n
in the first round and doubles with each further one, as the small subtrees are the first to
have settled. Disjoint subtrees are rearranged in parallel: what happens below a node depends
on nothing else, so the tree is the same on any number of threads.

`streelet` is the same over the references that the triangle splitting of that paper makes
(:mod:`mibvh.builders.splitting`).

The method is covered by US patents 10331632 (treelets) and 9547932 (splitting).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numba
import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft
from mibvh.builders.finish import draft_sah
from mibvh.builders.registry import Context, Options, builder, option
from mibvh.builders.rotations import box_area, depth_first
from mibvh.triangles import F32, I32, Triangles

#: References in the subtrees of one parallel step: well under a second of work, so that
#: progress is shown and Ctrl-C heard.
_STEP = 1 << 17


@njit
def subtree_costs(left, right, box, count, c_inner, c_tri, max_leaf):
    """(2R - 1,) float64: the least cost of each subtree times its area, after collapse.

    Nodes must stand behind their parents, as :func:`depth_first` lays them out.
    """
    cost = np.empty(len(left), np.float64)
    for node in range(len(left) - 1, -1, -1):
        area = box_area(box, node)
        cost[node] = c_tri * area * count[node]
        if left[node] >= 0:
            inner = c_inner * area + (cost[left[node]] + cost[right[node]])
            if count[node] > max_leaf or inner < cost[node]:
                cost[node] = inner
    return cost


@njit
def _grow(root, size, left, right, box, leaves, inner):
    """Grow a treelet: open the leaf of largest area until there are ``size`` leaves.

    Fills ``leaves`` and ``inner`` (the root first) and returns the number of leaves, which
    is smaller where nothing is left to open.
    """
    area = np.empty(8, np.float64)
    inner[0] = root
    leaves[0], leaves[1] = left[root], right[root]
    for i in range(2):
        area[i] = box_area(box, leaves[i]) if left[leaves[i]] >= 0 else -1.0
    n = 2
    while n < size:
        widest = 0
        for i in range(1, n):
            if area[i] > area[widest]:
                widest = i
        if area[widest] < 0.0:
            break
        node = leaves[widest]
        inner[n - 1] = node
        for i, child in ((widest, left[node]), (n, right[node])):
            leaves[i] = child
            area[i] = box_area(box, child) if left[child] >= 0 else -1.0
        n += 1
    return n


@njit
def _optimise_subsets(n, leaves, box, count, cost, c_inner, c_tri, max_leaf, s_box, s_count, s_cost):
    """The dynamic programme: box, triangles and least cost of every subset of the leaves.

    A subset is a bit mask. Its proper subsets are smaller numbers, so ascending order has
    them ready. Of a partition in two, one side holds the lowest bit; the other side runs
    through the non-empty subsets of the rest.
    """
    for i in range(n):
        s = 1 << i
        for k in range(6):
            s_box[s, k] = box[leaves[i], k]
        s_count[s] = count[leaves[i]]
        s_cost[s] = cost[leaves[i]]
    for s in range(3, 1 << n):
        rest = s & (s - 1)
        if rest == 0:
            continue
        low = s ^ rest
        for k in range(3):
            s_box[s, k] = min(s_box[low, k], s_box[rest, k])
            s_box[s, k + 3] = max(s_box[low, k + 3], s_box[rest, k + 3])
        s_count[s] = s_count[low] + s_count[rest]
        # Two minima, so that one comparison need not wait for the other. After the first
        # partition the number of those left is even.
        even = s_cost[rest] + s_cost[low]
        odd = even
        p = (rest - 1) & rest
        while p:
            c = s_cost[p] + s_cost[s ^ p]
            even = c if c < even else even
            p = (p - 1) & rest
            c = s_cost[p] + s_cost[s ^ p]
            odd = c if c < odd else odd
            p = (p - 1) & rest
        area = box_area(s_box, s)
        best = c_inner * area + (even if even < odd else odd)
        if s_count[s] <= max_leaf:
            best = min(best, c_tri * area * s_count[s])
        s_cost[s] = best


@njit
def _rebuild(
    n, leaves, inner, left, right, box, count, cost, s_box, s_count, s_cost, slot, subset
):
    """Write the best tree of the treelet into its own inner nodes, root in root."""
    slot[0], subset[0], top = 0, (1 << n) - 1, 1
    used = 1
    while top > 0:
        top -= 1
        node, s = inner[slot[top]], subset[top]
        for k in range(6):
            box[node, k] = s_box[s, k]
        count[node] = s_count[s]
        cost[node] = s_cost[s]
        rest = s & (s - 1)
        best, side = np.inf, rest
        p = rest
        while p:
            c = s_cost[p] + s_cost[s ^ p]
            if c < best:
                best, side = c, p
            p = (p - 1) & rest
        for part in (s ^ side, side):
            if part & (part - 1):
                child = inner[used]
                slot[top], subset[top] = used, part
                used += 1
                top += 1
            else:
                i = 0
                while part >> i != 1:
                    i += 1
                child = leaves[i]
            if part == side:
                right[node] = child
            else:
                left[node] = child


@njit
def _improve(
    nodes, size, left, right, box, count, cost, c_inner, c_tri, max_leaf
):
    """Rearrange the treelets rooted in ``nodes``, children before parents.

    Returns how many were rebuilt.
    """
    leaves = np.empty(8, np.int32)
    inner = np.empty(8, np.int32)
    slot = np.empty(8, np.int32)
    subset = np.empty(8, np.int32)
    s_box = np.empty((1 << size, 6), np.float32)
    s_count = np.empty(1 << size, np.int64)
    s_cost = np.empty(1 << size, np.float64)
    rebuilt = 0
    for i in range(len(nodes) - 1, -1, -1):
        root = nodes[i]
        area = box_area(box, root)
        now = c_inner * area + (cost[left[root]] + cost[right[root]])
        if count[root] <= max_leaf:
            now = min(now, c_tri * area * count[root])
        cost[root] = now
        n = _grow(root, size, left, right, box, leaves, inner)
        if n < 3:
            continue
        _optimise_subsets(
            n, leaves, box, count, cost, c_inner, c_tri, max_leaf, s_box, s_count, s_cost
        )
        if s_cost[(1 << n) - 1] < now:
            _rebuild(
                n, leaves, inner, left, right, box, count, cost,
                s_box, s_count, s_cost, slot, subset,
            )
            rebuilt += 1
    return rebuilt


@njit
def _above(root, least, left, right, count):
    """Nodes below and including ``root`` with at least so many references, parents first.

    Returns them, and the highest nodes below them that have fewer.
    """
    found = np.empty(2 * count[root] // max(least, 1) + 1, np.int32)
    return found
