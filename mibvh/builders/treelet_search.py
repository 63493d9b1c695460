"""The best tree of a treelet, by dynamic programming over the subsets of its leaves.

The method is that of Karras and Aila (HPG 2013); :mod:`mibvh.builders.treelet` describes it.
"""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.builders import lanes
from mibvh.builders.rotations import box_area
from mibvh.builders.subtrees import join_parts, leaves_below, node_cost
from mibvh.measures.boxes import of_corners

#: Treelets solved side by side.
_LANES = 8


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
            tip, _ = leaves_below(leaves[i, lane], left, right, tips, 0, spare, 0)
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
                        tip, free = leaves_below(
                            leaves[i, lane], left, right, tips, tip, spare, free
                        )
                        members += 1
                for _ in range(members - 2):
                    spare[free] = inner[used, lane]
                    used, free = used + 1, free + 1
                join_parts(node, tips, tip, spare, owner, nodes, costs)
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
            cost[root] = node_cost(root, nodes, costs)
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
def improve_all(roots, ends, size, owner, nodes, costs):
    """Rearrange the treelets with roots ordered by height. Returns how many were rebuilt."""
    rebuilt, begin = 0, 0
    for end in ends:
        rebuilt += _improve(roots[begin:end], size, owner, nodes, costs)
        begin = end
    return rebuilt


@njit
def improve_subtrees(tops, least, size, owner, nodes, costs):
    """Rearrange subtrees one after the other. Returns treelets looked at and rebuilt."""
    looked, rebuilt = 0, 0
    for i in range(len(tops)):
        roots, ends = nodes_above(tops[i], least, nodes.left, nodes.right, nodes.count)
        looked += len(roots)
        rebuilt += improve_all(roots, ends, size, owner, nodes, costs)
    return looked, rebuilt
