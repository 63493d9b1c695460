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
def nodes_above(root, least, left, right, count):
    """Nodes from ``root`` down with at least so many references, parents before children."""
    found = np.empty(max(count[root] - 1, 1), np.int32)
    found[0] = root
    end = 1 if count[root] >= max(least, 2) else 0
    node = 0
    while node < end:
        for child in (left[found[node]], right[found[node]]):
            if count[child] >= max(least, 2):
                found[end] = child
                end += 1
        node += 1
    return found[:end]


@njit(parallel=True)
def _improve_subtrees(
    roots, least, size, left, right, box, count, cost, c_inner, c_tri, max_leaf
):
    """Rearrange disjoint subtrees in parallel. Returns treelets looked at and rebuilt."""
    done = np.zeros((len(roots), 2), np.int64)
    for i in numba.prange(len(roots)):
        nodes = nodes_above(roots[i], least, left, right, count)
        done[i, 0] = len(nodes)
        done[i, 1] = _improve(
            nodes, size, left, right, box, count, cost, c_inner, c_tri, max_leaf
        )
    return done.sum(axis=0)


def rearrange(
    draft: Draft, size: int, rounds: int, options: Options, context: Context
) -> Draft:
    """Rearrange the treelets of a draft, round by round.

    Parameters
    ----------
    draft : Draft
        The start tree.
    size : int
        Leaves of a treelet, 4 to 8.
    rounds : int
        Passes over the tree; each one leaves out subtrees twice as large as the one before.
    options : Options
        The costs.
    context : Context
        Told of the progress.

    Returns
    -------
    Draft
        With ``start_sah``, ``end_sah``, ``iterations`` (rounds), and the treelets looked at
        and rebuilt in its report.
    """
    costs = {
        "c_inner": options.c_inner, "c_tri": options.c_tri, "max_leaf": options.max_leaf,
    }
    left, right, reference, count, box = depth_first(draft)
    cost = subtree_costs(left, right, box, count, *costs.values())
    arrays = (size, left, right, box, count, cost, *costs.values())
    # Subtrees of at most `limit` references are the units of parallel work; the few nodes
    # above them follow one after the other. The limit depends on the scene alone.
    limit = max(256, len(draft.references) // 256)
    looked, rebuilt = 0, 0
    for turn in range(rounds):
        least = size << turn
        top = nodes_above(0, limit + 1, left, right, count)
        below = np.concatenate([left[top], right[top]]) if len(top) else np.zeros(1, np.int32)
        below = np.sort(below[(count[below] <= limit) & (count[below] >= least)])
        ends = np.cumsum(count[below], dtype=np.int64)
        cuts = np.searchsorted(ends, np.arange(0, len(reference) + _STEP, _STEP))
        for begin, end in zip(cuts[:-1], cuts[1:], strict=True):
            if begin < end:
                done = _improve_subtrees(below[begin:end], least, *arrays)
                looked, rebuilt = looked + int(done[0]), rebuilt + int(done[1])
                context.progress("treelets", (turn + end / len(below)) / rounds)
        top = top[count[top] >= least]
        for end in range(len(top), 0, -_STEP):
            rebuilt += _improve(top[max(end - _STEP, 0) : end], *arrays)
        looked += len(top)
    result = Draft(draft.references, left, right, reference)
    start_sah, end_sah = draft_sah(draft, **costs), draft_sah(result, **costs)
    if end_sah > start_sah:  # possible where a leaf holds a split triangle twice
        result, end_sah = draft, start_sah
    report = {
        "start_sah": start_sah,
        "end_sah": end_sah,
        "iterations": rounds,
        "treelets": looked,
        "rebuilt": rebuilt,
    }
    return dataclasses.replace(result, report=report)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TreeletOptions(Options):
    """What `treelet` takes."""

    start: str = option("lbvh", "builder of the tree to start from")
    size: int = option(7, "leaves of a treelet; one more triples the time", 4, 8)
    rounds: int = option(3, "passes over the tree; later ones leave small subtrees out", 0, 24)


@builder(
    "treelet",
    summary="TRBVH: the best rearrangement of every treelet of 7 subtrees, bottom-up, repeated",
    source="Karras and Aila 2013",
    options=TreeletOptions,
)
def treelet(triangles: Triangles, options: TreeletOptions, context: Context) -> Draft:
    """Rearrange the treelets of a start tree."""
    draft = context.start(triangles, options.start, options)
    draft = rearrange(draft, options.size, options.rounds, options, context)
    draft.report["start"] = options.start
    return draft
