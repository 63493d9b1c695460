"""A wide node's children along a ray, compiled: which it enters, and in which order.

Computed in float32 as the wide kernel does, from the tree's own arrays rather than its rows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.quantise import finest_step, grid
from mibvh.traversal.wide_rows import ENTRY, NETWORKS
from mibvh.wide_tree import WideTree

_OUTWARD, _OUTWARD_SMALL = np.float32(1.0 + 2.0**-21), np.float32(1.0 + 2.0**-20)
_SLACK = np.float32(2.0**-16)
_NEAREST = np.float32(2.0**-100)
_ZERO, _INF = np.float32(0), np.float32(np.inf)


class WideNodes(NamedTuple):
    """A wide tree's nodes, in the kernel's units."""

    lower: Any  # (M, 3) float32
    upper: Any  # (M, 3) float32
    child: Any  # (M,) int32
    children: Any  # (M,) int32
    first: Any  # (M,) int32
    count: Any  # (M,) int32
    small: bool  # boxes of 8 bits
    finest: int  # exponent of the finest step of their grids
    network: Any  # (S, 2) int64: sorts children by distance; none: they are taken as they stand


class Children(NamedTuple):
    """What :func:`enter_children` finds for one node, written over at each call."""

    near: Any  # (8,) float32: where the ray enters each child; infinite for those it misses
    bits: Any  # the same memory as uint32
    far: Any  # (8,) float32
    order: Any  # (8,) int64: the children, first to visit first


def wide_nodes(tree: WideTree | None, scale: np.float32, any_hit: bool) -> WideNodes:
    """Nodes of a wide tree for closest-hit or any-hit rays; of none, nodes of the same type."""
    if tree is None:
        boxes, numbers = np.empty((0, 3), np.float32), np.empty(0, np.int32)
        network = np.empty((0, 2), np.int64)
        return WideNodes(boxes, boxes, *(numbers,) * 4, False, 0, network)
    stored = any_hit and bool(tree.meta.get("ordered"))
    lower, upper = tree.lower * scale, tree.upper * scale
    return WideNodes(
        lower,
        upper,
        tree.child.copy(),
        tree.children.copy(),
        tree.first.copy(),
        tree.count.copy(),
        tree.quantised,
        int(finest_step(lower[0], upper[0])),
        np.array([] if stored else NETWORKS[tree.width], np.int64).reshape(-1, 2),
    )


def new_children() -> Children:
    """Room for one node's children."""
    near = np.empty(8, np.float32)
    return Children(near, near.view(np.uint32), np.empty(8, np.float32), np.empty(8, np.int64))


@njit(allocates=False)
def enter_children(nodes, node, o, inv, t, found):
    """Find where a ray enters a node's children before t, and the order to visit them in.

    Parameters
    ----------
    nodes : WideNodes
    node : int
        An inner one.
    o, inv : three float32
        The ray's origin, and 1 over its direction.
    t : float32
    found : Children
        Written.
    """
    begin, size = nodes.child[node], nodes.children[node]
    if nodes.small:
        _enter_small(nodes, begin, size, o, inv, t, found)
        _tag(nodes, begin, size, found)
    else:
        _enter_plain(nodes, begin, size, o, inv, t, found.near)
    for i in range(size, 8):
        found.near[i] = _INF
    for i in range(8):
        found.order[i] = i
    for s in range(len(nodes.network)):
        p, q = nodes.network[s, 0], nodes.network[s, 1]
        a, b = found.order[p], found.order[q]
        if found.near[b] < found.near[a]:
            found.order[p], found.order[q] = b, a


@njit(allocates=False)
def _enter_plain(nodes, begin, size, o, inv, t, entered):
    for i in range(size):
        near, far = _ZERO, _INF
        for k in range(3):
            a = (nodes.lower[begin + i, k] - o[k]) * inv[k]
            b = (nodes.upper[begin + i, k] - o[k]) * inv[k]
            near, far = max(near, min(a, b)), min(far, max(a, b))
        entered[i] = near if near <= min(far * _OUTWARD, t) else _INF


@njit(allocates=False)
def _fma(a, b, c):
    """Multiply and add, rounded once but for the rarest of double roundings."""
    return np.float32(np.float64(a) * np.float64(b) + np.float64(c))


@njit(allocates=False)
def _enter_small(nodes, begin, size, o, inv, t, found):
    near, far = found.near, found.far
    for i in range(size):
        near[i], far[i] = _NEAREST, _INF
    for k in range(3):
        low, high = nodes.lower[begin, k], nodes.upper[begin, k]
        for i in range(1, size):
            low, high = min(low, nodes.lower[begin + i, k]), max(high, nodes.upper[begin + i, k])
        origin, exponent = grid(low, high, nodes.finest)
        steps = 2.0 ** (exponent + 8)
        length = np.float32(steps)
        scale = length * inv[k]
        start = (np.float32(origin) - o[k] - length) * inv[k]
        slack = abs(scale) * _SLACK
        for i in range(size):
            a = 1.0 + (np.float64(nodes.lower[begin + i, k]) - origin) / steps
            b = 1.0 + (np.float64(nodes.upper[begin + i, k]) - origin) / steps
            if inv[k] < _ZERO:
                a, b = b, a
            near[i] = max(near[i], _fma(a, scale, start - slack))
            far[i] = min(far[i], _fma(b, scale, start + slack))
    for i in range(size):
        if not near[i] <= min(far[i] * _OUTWARD_SMALL, t):
            near[i] = _INF


@njit(allocates=False)
def _tag(nodes, begin, size, found):
    """Replace the four lowest bits of distances by the child's place, inner nodes first."""
    inners = 0
    for i in range(size):
        inners += nodes.child[begin + i] >= 0
    inner, leaf = 0, inners
    for i in range(size):
        if nodes.child[begin + i] >= 0:
            place = inner
            inner += 1
        else:
            place = leaf
            leaf += 1
        if found.near[i] < _INF:
            kept = found.bits[i] & np.uint32(0xFFFFFFF0)
            found.bits[i] = np.uint32(kept | np.uint32(ENTRY | place))
