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
(:mod:`mibvh.builders.splitting`), and starts from the Morton tree over them unless told
otherwise.

A leaf of the finished tree holds a triangle once, however many of its parts are below. So
T[s] counts triangles, not parts, and where a leaf forms, the parts of a triangle in it become
one reference again. That is ours, not the paper's: its splitting spends the whole budget on
any scene, and a ground plane around a furnished room is cut into a grid of hundreds of cells
whose tree would otherwise stand above the room for good. For `treelet` it changes nothing.

The method is covered by US patents 10331632 (treelets) and 9547932 (splitting).
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.builders import lanes
from mibvh.builders.draft import Draft, References
from mibvh.builders.registry import Context, Options, builder, option
from mibvh.builders.rotations import box_area, depth_first, judged
from mibvh.builders.splitting import as_boxes, over_parts, presplit
from mibvh.measures.boxes import of_corners
from mibvh.parallel import run_blocks, thread_count
from mibvh.triangles import F32, I32, Triangles

#: References in the subtrees of one parallel step: well under a second of work, so that
#: progress is shown and Ctrl-C heard.
_STEP = 1 << 17
#: Disjoint subtrees that a thread takes at a time.
_ROOTS = 4
#: Treelets solved side by side.
_LANES = 8
#: What :func:`owners` says where no triangle is split.
_NONE_SPLIT = np.empty(0, np.int32)


class Nodes(NamedTuple):
    """The tree that is rearranged.

    Whose parts the leaf nodes are (:func:`owners`) stands beside it.
    """

    left: Any  #: (2 R - 1,) int32: the children; -1 at a leaf node
    right: Any  #: (2 R - 1,) int32
    box: Any  #: (2 R - 1, 6) float32: lower and upper corner
    count: Any  #: (2 R - 1,) int32: references below
    cost: Any  #: (2 R - 1,) float64: from :func:`subtree_costs`


class Costs(NamedTuple):
    """What a tree is judged by."""

    c_inner: float
    c_tri: float
    max_leaf: int
    measure: Any  #: of boxes; None is the area


@njit(allocates=False)
def _node_cost(node, nodes, costs):
    """Least cost of a subtree, times its area, from those of its children."""
    left, count, cost = nodes.left, nodes.count, nodes.cost
    area = box_area(costs.measure, nodes.box, node)
    leaf = costs.c_tri * area * count[node]
    if left[node] < 0:
        return leaf
    inner = costs.c_inner * area + (cost[left[node]] + cost[nodes.right[node]])
    return leaf if count[node] <= costs.max_leaf and leaf <= inner else inner


@njit
def subtree_costs(left, right, box, count, c_inner, c_tri, max_leaf, measure):
    """(2R - 1,) float64: the least cost of each subtree, times its area, after the collapse.

    Nodes must stand behind their parents, as :func:`depth_first` lays them out.
    """
    cost = np.empty(len(left), np.float64)
    nodes = Nodes(left, right, box, count, cost)
    costs = Costs(c_inner, c_tri, max_leaf, measure)
    for node in range(len(left) - 1, -1, -1):
        cost[node] = _node_cost(node, nodes, costs)
    return cost


@njit(allocates=False)
def _below(node, left, right, tips, tip, spare, free):
    """Append the leaf nodes below a node, itself included, to ``tips``, the others to ``spare``.

    Returns the new numbers of both. What has been appended to ``spare`` is the queue, too.
    """
    if left[node] < 0:
        tips[tip] = node
        return tip + 1, free
    at = free
    spare[free], free = node, free + 1
    while at < free:
        for child in (left[spare[at]], right[spare[at]]):
            if left[child] < 0:
                tips[tip], tip = child, tip + 1
            else:
                spare[free], free = child, free + 1
        at += 1
    return tip, free


@njit(allocates=False)
def _first_of_each(tips, tip, owner):
    """Move the first leaf node of each triangle to the front, and return how many there are."""
    kept = 0
    for i in range(tip):
        j = 0
        while j < kept and owner[tips[j]] != owner[tips[i]]:
            j += 1
        if j == kept:
            tips[kept], tips[i] = tips[i], tips[kept]
            kept += 1
    return kept


@njit(allocates=False)
def _join_parts(node, tips, tip, spare, owner, nodes, costs):
    """Make the leaf nodes ``tips`` the subtree of ``node``, with one leaf for each triangle.

    Boxes of a triangle's parts are united. The other nodes the subtree needs are taken from
    ``spare``; those that are left over belong to the tree no more.
    """
    left, right, box, count, cost = nodes
    kept = _first_of_each(tips, tip, owner)
    for i in range(kept, tip):
        j = 0
        while owner[tips[j]] != owner[tips[i]]:
            j += 1
        for k in range(3):
            box[tips[j], k] = min(box[tips[j], k], box[tips[i], k])
            box[tips[j], k + 3] = max(box[tips[j], k + 3], box[tips[i], k + 3])
    for j in range(kept):
        cost[tips[j]] = _node_cost(tips[j], nodes, costs)
    if kept == 1:
        for k in range(6):
            box[node, k] = box[tips[0], k]
        left[node], right[node], owner[node] = -1, -1, owner[tips[0]]
        count[node], cost[node] = 1, cost[tips[0]]
        return
    last = tips[kept - 1]
    for j in range(kept - 2, -1, -1):
        # They will be one leaf of the tree, so a chain is as good as anything.
        parent = node if j == 0 else spare[j - 1]
        left[parent], right[parent] = tips[j], last
        _refit(parent, owner, nodes, costs)
        last = parent


@njit(allocates=False)
def _refit(node, owner, nodes, costs):
    """Compute owner, box, references and cost of a node from its children."""
    left, right, box, count, cost = nodes
    a, b = left[node], right[node]
    for k in range(3):
        box[node, k] = min(box[a, k], box[b, k])
        box[node, k + 3] = max(box[a, k + 3], box[b, k + 3])
    owner[node] = max(owner[a], owner[b])
    count[node] = count[a] + count[b]
    cost[node] = _node_cost(node, nodes, costs)


@njit
def join_small(owner, nodes, costs):
    """Join a triangle's parts in every subtree that is cheapest as one leaf.

    What :func:`subtree_costs` does where triangles are split; fills the nodes' ``cost``.
    """
    left, right, box, count, cost = nodes
    max_leaf = costs.max_leaf
    tips = np.empty(2 * max_leaf, np.int32)
    spare = np.empty(2 * max_leaf, np.int32)
    for node in range(len(left) - 1, -1, -1):
        if left[node] < 0:
            cost[node] = _node_cost(node, nodes, costs)
            continue
        _refit(node, owner, nodes, costs)
        if count[left[node]] > max_leaf or count[right[node]] > max_leaf:
            continue
        tip, _ = _below(node, left, right, tips, 0, spare, 0)
        kept = _first_of_each(tips, tip, owner)
        leaf = costs.c_tri * box_area(costs.measure, box, node) * kept
        if kept < tip and kept <= max_leaf and leaf <= cost[node]:
            _join_parts(node, tips, tip, spare[1:], owner, nodes, costs)


@njit(allocates=False)
def _find_repeats(size, lane, leaves, owner, nodes, max_leaf, work, s_again):
    """Count, for every subset of a treelet's leaves, the references it could do without.

    Only parts of split triangles can be such, and most subtrees hold none.
    """
    left, right, count = nodes.left, nodes.right, nodes.count
    tips, spare, keys = work
    s_again[:, lane] = 0.0
    used = 0
    for i in range(size):
        # A larger subtree is not in any leaf.
        if count[leaves[i, lane]] <= max_leaf and owner[leaves[i, lane]] >= 0:
            tip, _ = _below(leaves[i, lane], left, right, tips, 0, spare, 0)
            for j in range(tip):
                if owner[tips[j]] >= 0:
                    keys[used] = np.int64(owner[tips[j]]) << 3 | i
                    used += 1
    # By insertion: they are few, and Numba takes a second to compile its own sort.
    for i in range(1, used):
        key, j = keys[i], i
        while j > 0 and keys[j - 1] > key:
            keys[j] = keys[j - 1]
            j -= 1
        keys[j] = key
    begin = 0
    while begin < used:
        end = begin + 1
        while end < used and keys[end] >> 3 == keys[begin] >> 3:
            end += 1
        if end - begin > 1:
            for s in range(1, 1 << size):
                held = 0
                for j in range(begin, end):
                    held += (s >> (keys[j] & 7)) & 1
                if held > 1:
                    s_again[s, lane] += held - 1
        begin = end


@njit
def _grow(measure, root, size, lane, nodes, leaves, inner):
    """Grow a treelet: open the leaf of largest area until there are ``size`` leaves.

    There must be that many references below the root. Fills column ``lane`` of ``leaves``
    and of ``inner``, the root first.
    """
    left, right, box = nodes.left, nodes.right, nodes.box
    area = np.empty(8, np.float64)
    node, place = root, 0
    for n in range(1, size):
        inner[n - 1, lane] = node
        for i, child in ((place, left[node]), (n, right[node])):
            leaves[i, lane] = child
            area[i] = box_area(measure, box, child) if left[child] >= 0 else -1.0
        place = 0
        for i in range(1, n + 1):
            if area[i] > area[place]:
                place = i
        node = leaves[place, lane]


@njit(allocates=False)
def _solve(size, owner, c_inner, c_tri, max_leaf, measure, s_box, s_count, s_again, s_cost):
    """Run the dynamic programme, for eight treelets side by side.

    Parameters
    ----------
    size : int
        Leaves of a treelet, n.
    owner : (2R - 1,) int32
        From :func:`owners`; empty where no triangle is split, and there is nothing in ``s_again``.
    c_inner, c_tri, max_leaf, measure : float, float, int, None or tuple
        The costs, and what they are of; None is the area.
    s_box : (2**n, 6, 8) float32
        Box of every subset of the leaves; a subset is a bit mask.
    s_count, s_cost : (2**n, 8) float64
        Its references, and its least cost. Like the boxes, they hold the single leaves
        already, and this fills in the rest.
    s_again : (2**n, 8) float64
        How many of its references are further ones of a triangle it holds already.
    """
    inner_factor, leaf_factor = lanes.fill(c_inner), lanes.fill(c_tri)
    most, never = lanes.fill(float(max_leaf)), lanes.fill(np.inf)
    split = len(owner) > 0
    # Unsigned indices, as Numba spends time on negative ones.
    one, two, six = np.uint64(1), np.uint64(2), np.uint64(6)
    for s in range(one + two, one << np.uint64(size)):
        rest = s & (s - one)
        if rest == 0:
            continue
        # Proper subsets are smaller numbers, so they are ready. Of a partition in two, one
        # side holds the lowest bit; the other side runs through the non-empty subsets of
        # the rest.
        low = s ^ rest
        best = lanes.add(lanes.load(s_cost, low), lanes.load(s_cost, rest))
        p = (rest - one) & rest
        while p:
            both = lanes.add(lanes.load(s_cost, p), lanes.load(s_cost, s ^ p))
            best = lanes.least(both, best)
            p = (p - one) & rest
        x = _side_of_union(s_box, s * six, low * six, rest * six)
        y = _side_of_union(s_box, s * six + one, low * six + one, rest * six + one)
        z = _side_of_union(s_box, s * six + two, low * six + two, rest * six + two)
        area = lanes.add(lanes.multiply(x, y), lanes.multiply(lanes.add(x, y), z))
        if measure is not None:
            for i in range(_LANES):
                s_cost[s, i] = of_corners(
                    measure,
                    s_box[s, 0, i],
                    s_box[s, 1, i],
                    s_box[s, 2, i],
                    s_box[s, 3, i],
                    s_box[s, 4, i],
                    s_box[s, 5, i],
                )
            area = lanes.load(s_cost, s)
        count = lanes.add(lanes.load(s_count, low), lanes.load(s_count, rest))
        lanes.store(s_count, s, count)
        if split:
            count = lanes.subtract(count, lanes.load(s_again, s))
        inner = lanes.add(lanes.multiply(inner_factor, area), best)
        leaf = lanes.multiply(lanes.multiply(leaf_factor, area), count)
        leaf = lanes.where_at_most(count, most, leaf, never)
        lanes.store(s_cost, s, lanes.least(leaf, inner))


@njit(allocates=False)
def _side_of_union(s_box, s, a, b):
    """Write lower and upper bound of the union of two boxes on one axis; return its length.

    ``s``, ``a`` and ``b`` are the rows of the lower bounds; those of the upper stand three
    below.
    """
    three = np.uint64(3)
    low = lanes.least(lanes.load(s_box, a), lanes.load(s_box, b))
    high = lanes.greatest(lanes.load(s_box, a + three), lanes.load(s_box, b + three))
    lanes.store(s_box, s, low)
    lanes.store(s_box, s + three, high)
    return lanes.subtract(lanes.widen(high), lanes.widen(low))


@njit
def _rebuild(size, lane, leaves, inner, owner, nodes, costs, work, subsets):
    """Write the best tree of a treelet into its own inner nodes; the root stays the root.

    Where a leaf holds several parts of a triangle, they become one.
    """
    left, right, box, count, cost = nodes
    tips, spare, _ = work
    s_box, s_count, s_again, s_cost = subsets
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
        if len(owner) > 0:
            distinct = s_count[s, lane] - s_again[s, lane]
            leaf = costs.c_tri * box_area(costs.measure, box, node) * distinct
            if s_again[s, lane] > 0.0 and distinct <= costs.max_leaf and leaf <= s_cost[s, lane]:
                tip, free, members = 0, 0, 0
                for i in range(size):
                    if s >> i & 1:
                        tip, free = _below(leaves[i, lane], left, right, tips, tip, spare, free)
                        members += 1
                for _ in range(members - 2):
                    spare[free] = inner[used, lane]
                    used, free = used + 1, free + 1
                _join_parts(node, tips, tip, spare, owner, nodes, costs)
                continue
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
    if len(owner) > 0:
        # Joining parts leaves fewer references; children stand behind their parents in `inner`.
        for i in range(used - 1, -1, -1):
            node = inner[i, lane]
            if left[node] >= 0:
                count[node] = count[left[node]] + count[right[node]]
                owner[node] = max(owner[left[node]], owner[right[node]])


@njit
def _improve(roots, size, owner, nodes, costs):
    """Rearrange the treelets with these roots; none may stand below another one.

    Their descendants' costs must be up to date. Returns how many were rebuilt.
    """
    left, right, box, count, cost = nodes
    c_inner, c_tri, max_leaf, measure = costs
    leaves = np.zeros((8, _LANES), np.int32)
    inner = np.zeros((8, _LANES), np.int32)
    grown = np.zeros(_LANES, np.int32)
    s_box = np.zeros((1 << size, 6, _LANES), np.float32)
    s_count = np.zeros((1 << size, _LANES), np.float64)
    s_cost = np.zeros((1 << size, _LANES), np.float64)
    s_again = np.zeros((1 << size, _LANES), np.float64)
    subsets = (s_box, s_count, s_again, s_cost)
    room = 8 * (max_leaf + 1) if len(owner) > 0 else 0
    work = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int64)
    rebuilt, begin = 0, 0
    while begin < len(roots):
        used = 0
        while used < _LANES and begin < len(roots):
            root = roots[begin]
            begin += 1
            # Parts may have been joined below.
            count[root] = count[left[root]] + count[right[root]]
            cost[root] = _node_cost(root, nodes, costs)
            if count[root] < size:
                continue
            grown[used] = root
            _grow(measure, root, size, used, nodes, leaves, inner)
            for i in range(size):
                leaf = leaves[i, used]
                for k in range(6):
                    s_box[1 << i, k, used] = box[leaf, k]
                s_count[1 << i, used] = count[leaf]
                s_cost[1 << i, used] = cost[leaf]
            if len(owner) > 0:
                _find_repeats(size, used, leaves, owner, nodes, max_leaf, work, s_again)
            used += 1
        _solve(size, owner, c_inner, c_tri, max_leaf, measure, *subsets)
        for lane in range(used):
            if s_cost[(1 << size) - 1, lane] < cost[grown[lane]]:
                _rebuild(size, lane, leaves, inner, owner, nodes, costs, work, subsets)
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
    for h in range(1, len(ends)):
        ends[h] += ends[h - 1]
    nodes = np.empty(end, np.int32)
    for i in range(end):
        nodes[ends[height[i]]] = found[i]
        ends[height[i]] += 1
    return nodes, ends[:-1]


@njit
def _improve_all(roots, ends, size, owner, nodes, costs):
    """Rearrange the treelets with roots ordered by height. Returns how many were rebuilt."""
    rebuilt, begin = 0, 0
    for end in ends:
        rebuilt += _improve(roots[begin:end], size, owner, nodes, costs)
        begin = end
    return rebuilt


@njit
def _improve_subtrees(tops, least, size, owner, nodes, costs):
    """Rearrange subtrees one after the other. Returns treelets looked at and rebuilt."""
    looked, rebuilt = 0, 0
    for i in range(len(tops)):
        roots, ends = nodes_above(tops[i], least, nodes.left, nodes.right, nodes.count)
        looked += len(roots)
        rebuilt += _improve_all(roots, ends, size, owner, nodes, costs)
    return looked, rebuilt


@njit
def _names(left, right):
    """New numbers of the nodes that still belong to the tree, in their order; -1 for others.

    Returns them, and how many there are.
    """
    name = np.full(len(left), -1, np.int32)
    stack = np.empty(len(left) // 2 + 1, np.int32)
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        name[node] = 0
        if left[node] >= 0:
            stack[top], stack[top + 1] = left[node], right[node]
            top += 2
    used = 0
    for node in range(len(left)):
        if name[node] == 0:
            name[node], used = used, used + 1
    return name, used


@njit
def _compact(name, used, owner, left, right, box):
    """Links and leaves of the nodes that have a name."""
    links = np.full((3, used), -1, np.int32)
    bounds = np.empty((2, used // 2 + 1, 3), np.float32)
    triangle = np.empty(used // 2 + 1, np.int32)
    leaves = 0
    for node in range(len(left)):
        new = name[node]
        if new < 0:
            continue
        if left[node] >= 0:
            links[0, new], links[1, new] = name[left[node]], name[right[node]]
            continue
        links[2, new] = leaves
        triangle[leaves] = max(owner[node], ~owner[node])
        for k in range(3):
            bounds[0, leaves, k], bounds[1, leaves, k] = box[node, k], box[node, k + 3]
        leaves += 1
    return links, bounds, triangle


def owners(triangle: I32, left: I32, reference: I32) -> I32:
    """Say whose parts the leaf nodes are.

    Returns
    -------
    (2R - 1,) int32
        At a leaf node, the triangle if it is split, and ``~triangle`` if it is not. Further
        up, where :func:`join_small` has been, not negative wherever some part of a split
        triangle is below. Empty if no triangle is split: compiled code then counts references,
        not triangles.
    """
    times = np.bincount(triangle)
    if times.max() == 1:
        return _NONE_SPLIT
    value = np.where(times[triangle] > 1, triangle, ~triangle)
    return np.where(left < 0, value[reference], np.int32(-1))


def without_joined(scale: float, owner: I32, left: I32, right: I32, box: F32) -> Draft:
    """Make the draft whose references are the leaves that are left."""
    links, bounds, triangle = _compact(*_names(left, right), owner, left, right, box)
    return Draft(References(*bounds, triangle, scale), *links)


def _improve_disjoint(roots: I32, least: int, arrays: tuple[Any, ...]) -> tuple[int, int]:
    """Rearrange disjoint subtrees on several threads; the outcome is the same for any number."""
    done = np.zeros((thread_count(), 2), np.int64)

    def work(worker: int, begin: int, end: int) -> None:
        done[worker] += _improve_subtrees(roots[begin:end], least, *arrays)

    run_blocks(work, len(roots), _ROOTS)
    looked, rebuilt = done.sum(axis=0)
    return int(looked), int(rebuilt)


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
    measure = context.compiled_measure(draft.references.scale)
    costs = Costs(options.c_inner, options.c_tri, options.max_leaf, measure)
    left, right, reference, count, box = depth_first(draft)
    cost = subtree_costs(left, right, box, count, *costs)
    nodes = Nodes(left, right, box, count, cost)
    owner = _NONE_SPLIT
    if options.rounds:
        owner = owners(draft.references.triangle, left, reference)
    if len(owner) > 0:
        join_small(owner, nodes, costs)
    # A scene of fewer triangles is a smaller treelet.
    size = min(options.size, int(count[0]))
    rounds = options.rounds if size > 2 else 0
    arrays = (size, owner, nodes, costs)
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
                done = _improve_disjoint(roots[begin:end], least, arrays)
                looked, rebuilt = looked + done[0], rebuilt + done[1]
                context.progress("treelets", (turn + end / len(roots)) / rounds)
        begin = 0
        for ends in np.split(heights, range(_STEP, len(heights), _STEP)):
            rebuilt += _improve_all(top[begin:], ends - begin, *arrays)
            begin = ends[-1] if len(ends) else begin
        looked += len(top)
    if len(owner) > 0:
        result = without_joined(draft.references.scale, owner, left, right, box)
    else:
        result = Draft(draft.references, left, right, reference)
    report = {"iterations": rounds, "treelets": looked, "rebuilt": rebuilt}
    return judged(measure, draft, result, options, report)


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
    base: str = option("lbvh", "builder of the tree over the parts; bbvh is slower and better")


@builder(
    "treelet",
    summary="TRBVH: the best rearrangement of every treelet of 7 subtrees, bottom-up, repeated",
    source="Karras and Aila 2013",
    options=TreeletOptions,
    memory=230,
)
def treelet(triangles: Triangles, options: TreeletOptions, context: Context) -> Draft:
    """Rearrange the treelets of a start tree."""
    draft = context.start(triangles, options.start, options)
    draft = rearrange(draft, options, context)
    draft.report["start"] = options.start
    return draft


def start_over(references: References, options: SplitTreeletOptions, context: Context) -> Draft:
    """Build the start tree over given references."""
    draft = context.start(as_boxes(references), options.base, options)
    return dataclasses.replace(over_parts(draft, references, options.base), report={})


@builder(
    "streelet",
    summary="triangle splitting, a Morton tree over the parts, then `treelet`",
    source="Karras and Aila 2013",
    options=SplitTreeletOptions,
    memory=400,
)
def streelet(triangles: Triangles, options: SplitTreeletOptions, context: Context) -> Draft:
    """Split triangles up front, and rearrange the treelets of a start tree over the parts."""
    context.progress("splitting", 0.0)
    references = presplit(triangles, options.beta)
    context.progress("splitting", 1.0)
    draft = rearrange(start_over(references, options, context), options, context)
    draft.report["base"] = options.base
    draft.report["references"] = len(references)
    draft.report["joined"] = len(references) - len(draft.references)
    return draft
