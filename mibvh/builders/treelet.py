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
import itertools

import numba
import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft
from mibvh.builders.morton import radix_draft
from mibvh.builders.registry import Context, Options, builder, option
from mibvh.builders.rotations import box_area, depth_first, judged
from mibvh.builders.splitting import presplit
from mibvh.triangles import Triangles

#: References in the subtrees of one parallel step: well under a second of work, so that
#: progress is shown and Ctrl-C heard.
_STEP = 1 << 17
#: Treelets solved side by side.
_LANES = 8


@njit
def _node_cost(node, left, right, box, count, cost, c_inner, c_tri, max_leaf):
    """Least cost of a subtree, times its area, from those of its children."""
    area = box_area(box, node)
    leaf = c_tri * area * count[node]
    if left[node] < 0:
        return leaf
    inner = c_inner * area + (cost[left[node]] + cost[right[node]])
    return leaf if count[node] <= max_leaf and leaf <= inner else inner


@njit
def subtree_costs(left, right, box, count, c_inner, c_tri, max_leaf):
    """(2R - 1,) float64: the least cost of each subtree, times its area, after the collapse.

    Nodes must stand behind their parents, as :func:`depth_first` lays them out.
    """
    cost = np.empty(len(left), np.float64)
    for node in range(len(left) - 1, -1, -1):
        cost[node] = _node_cost(node, left, right, box, count, cost, c_inner, c_tri, max_leaf)
    return cost


@njit
def _grow(root, size, lane, left, right, box, leaves, inner):
    """Grow a treelet: open the leaf of largest area until there are ``size`` leaves.

    There must be that many references below the root. Fills column ``lane`` of ``leaves``
    and of ``inner``, the root first.
    """
    area = np.empty(8, np.float64)
    node, place = root, 0
    for n in range(1, size):
        inner[n - 1, lane] = node
        for i, child in ((place, left[node]), (n, right[node])):
            leaves[i, lane] = child
            area[i] = box_area(box, child) if left[child] >= 0 else -1.0
        place = 0
        for i in range(1, n + 1):
            if area[i] > area[place]:
                place = i
        node = leaves[place, lane]


@njit
def _solve(size, c_inner, c_tri, max_leaf, s_box, s_count, s_cost):
    """Run the dynamic programme, for eight treelets side by side.

    Parameters
    ----------
    size : int
        Leaves of a treelet, n.
    c_inner, c_tri, max_leaf : float, float, int
        The costs.
    s_box : (2**n, 6, 8) float32
        Box of every subset of the leaves; a subset is a bit mask.
    s_count, s_cost : (2**n, 8) float64
        Its triangles, and its least cost. All three hold the single leaves already, and
        this fills in the rest.
    """
    # Unsigned indices, as Numba spends time on negative ones; and a last axis of fixed
    # length, over which the inner loops become vector instructions.
    one, lanes = np.uint64(1), np.uint64(_LANES)
    for s in range(np.uint64(3), one << np.uint64(size)):
        rest = s & (s - one)
        if rest == 0:
            continue
        # Proper subsets are smaller numbers, so they are ready.
        low = s ^ rest
        for k in range(np.uint64(3)):
            for i in range(lanes):
                a, b = s_box[low, k, i], s_box[rest, k, i]
                s_box[s, k, i] = a if a < b else b
        for k in range(np.uint64(3), np.uint64(6)):
            for i in range(lanes):
                a, b = s_box[low, k, i], s_box[rest, k, i]
                s_box[s, k, i] = a if a > b else b
        for i in range(lanes):
            s_count[s, i] = s_count[low, i] + s_count[rest, i]
            s_cost[s, i] = s_cost[low, i] + s_cost[rest, i]
        # Of a partition in two, one side holds the lowest bit; the other side runs through
        # the non-empty subsets of the rest.
        p = (rest - one) & rest
        while p:
            q = s ^ p
            for i in range(lanes):
                both = s_cost[p, i] + s_cost[q, i]
                least = s_cost[s, i]
                s_cost[s, i] = both if both < least else least
            p = (p - one) & rest
        for i in range(lanes):
            x = np.float64(s_box[s, 3, i]) - np.float64(s_box[s, 0, i])
            y = np.float64(s_box[s, 4, i]) - np.float64(s_box[s, 1, i])
            z = np.float64(s_box[s, 5, i]) - np.float64(s_box[s, 2, i])
            area = x * y + (x + y) * z
            inner = c_inner * area + s_cost[s, i]
            leaf = c_tri * area * s_count[s, i]
            s_cost[s, i] = leaf if s_count[s, i] <= max_leaf and leaf <= inner else inner


@njit
def _rebuild(size, lane, leaves, inner, left, right, box, count, cost, s_box, s_count, s_cost):
    """Write the best tree of a treelet into its own inner nodes; the root stays the root."""
    slot = np.empty(8, np.int32)
    subset = np.empty(8, np.int32)
    slot[0], subset[0], top = 0, (1 << size) - 1, 1
    used = 1
    while top > 0:
        top -= 1
        node, s = inner[slot[top], lane], subset[top]
        for k in range(6):
            box[node, k] = s_box[s, k, lane]
        count[node] = np.int32(s_count[s, lane])
        cost[node] = s_cost[s, lane]
        # Which partition was the best is not kept for all the subsets: it is needed for the
        # few that become nodes only.
        rest = s & (s - 1)
        side, p = rest, rest
        least = np.inf
        while p:
            both = s_cost[p, lane] + s_cost[s ^ p, lane]
            if both < least:
                least, side = both, p
            p = (p - 1) & rest
        for part in (s ^ side, side):
            if part & (part - 1):
                child = inner[used, lane]
                slot[top], subset[top] = used, part
                used += 1
                top += 1
            else:
                bit = 0
                while part >> bit != 1:
                    bit += 1
                child = leaves[bit, lane]
            if part == side:
                right[node] = child
            else:
                left[node] = child


@njit
def _improve(nodes, size, left, right, box, count, cost, c_inner, c_tri, max_leaf):
    """Rearrange the treelets rooted in ``nodes``; none may stand below another one.

    Their descendants' costs must be up to date. Returns how many were rebuilt.
    """
    leaves = np.zeros((8, _LANES), np.int32)
    inner = np.zeros((8, _LANES), np.int32)
    s_box = np.zeros((1 << size, 6, _LANES), np.float32)
    s_count = np.zeros((1 << size, _LANES), np.float64)
    s_cost = np.zeros((1 << size, _LANES), np.float64)
    rebuilt = 0
    for first in range(0, len(nodes), _LANES):
        used = min(_LANES, len(nodes) - first)
        for lane in range(used):
            _grow(nodes[first + lane], size, lane, left, right, box, leaves, inner)
            for i in range(size):
                leaf = leaves[i, lane]
                for k in range(6):
                    s_box[1 << i, k, lane] = box[leaf, k]
                s_count[1 << i, lane] = count[leaf]
                s_cost[1 << i, lane] = cost[leaf]
        _solve(size, c_inner, c_tri, max_leaf, s_box, s_count, s_cost)
        for lane in range(used):
            root = nodes[first + lane]
            now = _node_cost(root, left, right, box, count, cost, c_inner, c_tri, max_leaf)
            cost[root] = now
            if s_cost[(1 << size) - 1, lane] < now:
                _rebuild(
                    size,
                    lane,
                    leaves,
                    inner,
                    left,
                    right,
                    box,
                    count,
                    cost,
                    s_box,
                    s_count,
                    s_cost,
                )
                rebuilt += 1
    return rebuilt


@njit
def nodes_above(root, least, left, right, count):
    """Nodes from ``root`` down with at least so many references below, by their height.

    Returns them, lowest first, and for each height where its nodes end. Nodes of equal
    height do not stand below one another.
    """
    found = np.empty(max(count[root] - 1, 1), np.int32)
    parent = np.empty(len(found), np.int32)
    found[0], parent[0] = root, 0
    end = 1 if count[root] >= least else 0
    node = 0
    while node < end:
        for child in (left[found[node]], right[found[node]]):
            if count[child] >= least:
                found[end], parent[end] = child, node
                end += 1
        node += 1
    height = np.zeros(end, np.int32)
    for i in range(end - 1, 0, -1):
        height[parent[i]] = max(height[parent[i]], height[i] + 1)
    ends = np.zeros(height[0] + 2 if end else 1, np.int64)
    for i in range(end):
        ends[height[i] + 1] += 1
    ends = np.cumsum(ends)
    nodes = np.empty(end, np.int32)
    for i in range(end):
        nodes[ends[height[i]]] = found[i]
        ends[height[i]] += 1
    return nodes, ends[:-1]


@njit
def _improve_all(nodes, ends, size, left, right, box, count, cost, c_inner, c_tri, max_leaf):
    """Rearrange the treelets rooted in nodes ordered by height. Returns how many were rebuilt."""
    rebuilt, begin = 0, 0
    for end in ends:
        rebuilt += _improve(
            nodes[begin:end], size, left, right, box, count, cost, c_inner, c_tri, max_leaf
        )
        begin = end
    return rebuilt


@njit(parallel=True)
def _improve_subtrees(roots, least, size, left, right, box, count, cost, c_inner, c_tri, max_leaf):
    """Rearrange disjoint subtrees in parallel. Returns treelets looked at and rebuilt."""
    done = np.zeros((len(roots), 2), np.int64)
    for i in numba.prange(len(roots)):
        nodes, ends = nodes_above(roots[i], least, left, right, count)
        done[i, 0] = len(nodes)
        done[i, 1] = _improve_all(
            nodes, ends, size, left, right, box, count, cost, c_inner, c_tri, max_leaf
        )
    return done.sum(axis=0)


def rearrange(draft: Draft, options: RearrangeOptions, context: Context) -> Draft:
    """Rearrange the treelets of a draft, round by round.

    Parameters
    ----------
    draft : Draft
        The start tree.
    options : RearrangeOptions
        The treelets' size, the rounds, the costs.
    context : Context
        Told of the progress.

    Returns
    -------
    Draft
        With ``start_sah``, ``end_sah``, ``iterations`` (rounds), and the treelets looked at
        and rebuilt in its report.
    """
    costs = (options.c_inner, options.c_tri, options.max_leaf)
    left, right, reference, count, box = depth_first(draft)
    cost = subtree_costs(left, right, box, count, *costs)
    # A scene of fewer triangles is a smaller treelet.
    size = min(options.size, len(draft.references))
    rounds = options.rounds if size > 2 else 0
    arrays = (size, left, right, box, count, cost, *costs)
    # Subtrees of at most `limit` references are the units of parallel work; the few nodes
    # above them follow. The limit depends on the scene alone, as the outcome must.
    limit = max(256, len(draft.references) // 256)
    looked, rebuilt = 0, 0
    for turn in range(rounds):
        least = size << turn
        top, heights = nodes_above(0, max(limit + 1, least), left, right, count)
        roots = np.concatenate([left[top], right[top]]) if len(top) else np.zeros(1, np.int32)
        roots = np.sort(roots[(count[roots] <= limit) & (count[roots] >= least)])
        ends = np.cumsum(count[roots], dtype=np.int64)
        cuts = np.searchsorted(ends, np.arange(0, len(left) + _STEP, _STEP))
        for begin, end in itertools.pairwise(cuts):
            if begin < end:
                done = _improve_subtrees(roots[begin:end], least, *arrays)
                looked, rebuilt = looked + int(done[0]), rebuilt + int(done[1])
                context.progress("treelets", (turn + end / len(roots)) / rounds)
        begin = 0
        for ends in np.split(heights, range(_STEP, len(heights), _STEP)):
            rebuilt += _improve_all(top[begin:], ends - begin, *arrays)
            begin = ends[-1] if len(ends) else begin
        looked += len(top)
    result = Draft(draft.references, left, right, reference)
    # Where a leaf holds a split triangle twice, the programme's cost is an upper bound only.
    report = {"iterations": rounds, "treelets": looked, "rebuilt": rebuilt}
    return judged(draft, result, options, report)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RearrangeOptions(Options):
    """What `treelet` and `streelet` have in common."""

    size: int = option(7, "leaves of a treelet; one more triples the time", 4, 8)
    rounds: int = option(3, "passes over the tree; later ones leave small subtrees out", 0, 24)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TreeletOptions(RearrangeOptions):
    """What `treelet` takes."""

    start: str = option("lbvh", "builder of the tree to start from")


@dataclasses.dataclass(frozen=True, kw_only=True)
class SplitTreeletOptions(RearrangeOptions):
    """What `streelet` takes."""

    beta: float = option(
        0.3, "references that splitting may add, per triangle; more overlap less", 0.0, 8.0
    )


@builder(
    "treelet",
    summary="TRBVH: the best rearrangement of every treelet of 7 subtrees, bottom-up, repeated",
    source="Karras and Aila 2013",
    options=TreeletOptions,
)
def treelet(triangles: Triangles, options: TreeletOptions, context: Context) -> Draft:
    """Rearrange the treelets of a start tree."""
    draft = context.start(triangles, options.start, options)
    draft = rearrange(draft, options, context)
    draft.report["start"] = options.start
    return draft


@builder(
    "streelet",
    summary="triangle splitting, a Morton tree over the parts, then `treelet`",
    source="Karras and Aila 2013",
    options=SplitTreeletOptions,
)
def streelet(triangles: Triangles, options: SplitTreeletOptions, context: Context) -> Draft:
    """Split triangles up front, and rearrange the treelets of the Morton tree over the parts."""
    context.progress("splitting", 0.0)
    references = presplit(triangles, options.beta)
    context.progress("splitting", 1.0)
    draft = rearrange(radix_draft(references), options, context)
    draft.report["references"] = len(references)
    return draft
