"""Subtrees and what they cost at least after the leaf collapse, with split triangles' parts joined.

A leaf of the finished tree holds a triangle once, however many of its parts are below. So where a
leaf forms, the parts of a triangle in it become one reference again.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.rotations import box_area
from mibvh.triangles import F32, I32

#: What :func:`owners` says where no triangle is split.
NONE_SPLIT = np.empty(0, np.int32)


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
def node_cost(node, nodes, costs):
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
        cost[node] = node_cost(node, nodes, costs)
    return cost


@njit(allocates=False)
def leaves_below(node, left, right, tips, tip, spare, free):
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
def join_parts(node, tips, tip, spare, owner, nodes, costs):
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
        cost[tips[j]] = node_cost(tips[j], nodes, costs)
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
    cost[node] = node_cost(node, nodes, costs)


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
            cost[node] = node_cost(node, nodes, costs)
            continue
        _refit(node, owner, nodes, costs)
        if count[left[node]] > max_leaf or count[right[node]] > max_leaf:
            continue
        tip, _ = leaves_below(node, left, right, tips, 0, spare, 0)
        kept = _first_of_each(tips, tip, owner)
        leaf = costs.c_tri * box_area(costs.measure, box, node) * kept
        if kept < tip and kept <= max_leaf and leaf <= cost[node]:
            join_parts(node, tips, tip, spare[1:], owner, nodes, costs)


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
        return NONE_SPLIT
    value = np.where(times[triangle] > 1, triangle, ~triangle)
    return np.where(left < 0, value[reference], np.int32(-1))


def without_joined(scale: float, owner: I32, left: I32, right: I32, box: F32) -> Draft:
    """Make the draft whose references are the leaves that are left."""
    links, bounds, triangle = _compact(*_names(left, right), owner, left, right, box)
    return Draft(References(*bounds, triangle, scale), *links)
