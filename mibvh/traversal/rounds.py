"""The binary kernel in rounds: all lanes descend until they have a leaf, then all test triangles.

The while-while styles of Aila and Laine (*Understanding the Efficiency of Ray Traversal on
GPUs*, HPG 2009). In plain while-while a lane descends to its next leaf, and tests leaves until
its next node is an inner one: the same nodes in the same order as in the single loop. In the
speculative one, which the paper's kernel uses, a lane puts its first leaf aside and goes on to the
second: rounds are fewer and longer, and it visits nodes that a hit in the leaf put aside would
have spared it.

There, a vote ends the descent as soon as every lane of the packet has a leaf. Dr.Jit has no vote
within a loop, neither on LLVM nor on CUDA: here each lane descends until it has its second leaf
or the stack is empty.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from mibvh.traversal.geometry import inverse
from mibvh.traversal.records import DONE, Records
from mibvh.traversal.steps import fetch, new_stack, node_step, pop, triangle_step
from mibvh.traversal.visits import Visits
from mibvh.variant import mitsuba


@dr.syntax
def walk_in_rounds(
    records: Records,
    o: Any,
    d: Any,
    tmax: Any,
    active: Any,
    *,
    postpone: bool,
    cull: bool,
    count: bool,
    any_hit: bool,
    longest: Any = None,
) -> Visits:
    """Trace rays through a tree in rounds.

    Parameters
    ----------
    records, o, d, tmax, active, cull, count, any_hit
        As of :func:`mibvh.traversal.kernel.walk`.
    postpone : bool
        Put the first leaf of a round aside, and descend until the second.
    longest : tuple of three UInt32, optional
        To measure what the packets issue: per lane the place of its packet's first round in two
        buffers of zeros, and these. Into them go the most steps that a lane took in each round,
        of the descent and of the leaves.

    Returns
    -------
    Visits
        As from :func:`mibvh.traversal.kernel.walk`.
    """
    mi = mitsuba()
    n = dr.width(o)
    inv = inverse(d)
    stack, begins = new_stack(cull)  # nodes put off; where they begin, if popped ones are re-tested
    top = dr.full(mi.UInt32, 0, n)  # entries of the stack
    t = dr.select(active, tmax, 0)  # distance of the current hit
    triangle = dr.full(mi.UInt32, 0xFFFFFFFF, n)  # the current hit
    # Code of the node to go to: an inner one; or the leaf at which the descent ended.
    node = dr.select(active, mi.Int32(records.root), mi.Int32(DONE))
    # Code of the next triangle of the leaf at hand, or of the leaf put aside.
    leaf = dr.full(mi.Int32, DONE, n)
    if dr.hint(postpone and records.root < 0, mode="scalar"):
        node, leaf = mi.Int32(leaf), mi.Int32(node)
    inner = dr.full(mi.UInt32, 0, n)  # inner nodes visited
    leaves = dr.full(mi.UInt32, 0, n)  # leaves visited
    tests = dr.full(mi.UInt32, 0, n)  # triangles tested
    # Where the packet's round is in the buffers of the longest.
    place = dr.full(mi.UInt32, 0, n) if longest is None else mi.UInt32(longest[0])

    while (node != DONE) | (leaf != DONE):
        descended, tested = mi.UInt32(0), mi.UInt32(0)  # steps of this round
        # -- descend
        while node >= 0:
            row = fetch(records, node)
            node, lost, top = node_step(row, o, inv, t, stack, begins, top)
            if lost:
                node, top = pop(stack, begins, top, t)
            if dr.hint(postpone, mode="scalar"):
                if (node < 0) & (node != DONE) & (leaf == DONE):
                    leaf = mi.Int32(node)
                    node, top = pop(stack, begins, top, t)
            if dr.hint(count, mode="scalar"):
                descended += 1
        # -- test the leaves at hand
        if dr.hint(not postpone, mode="scalar"):
            leaf = dr.select(node < 0, node, mi.Int32(DONE))
        while leaf != DONE:
            row = fetch(records, leaf)
            t, triangle, hit, ended = triangle_step(row, o, d, t, triangle)
            leaf -= 1
            if dr.hint(any_hit, mode="scalar"):
                if hit:
                    top = mi.UInt32(0)
                    node = mi.Int32(DONE)
                    ended = mi.Bool(True)
            if ended:
                if dr.hint(postpone, mode="scalar"):
                    leaf = dr.select(node < 0, node, mi.Int32(DONE))
                    if leaf != DONE:
                        node, top = pop(stack, begins, top, t)
                else:
                    node, top = pop(stack, begins, top, t)
                    leaf = dr.select(node < 0, node, mi.Int32(DONE))
            if dr.hint(count, mode="scalar"):
                tested += 1
                leaves += dr.select(ended, mi.UInt32(1), mi.UInt32(0))
        if dr.hint(count, mode="scalar"):
            inner += descended
            tests += tested
            if dr.hint(longest is not None, mode="scalar"):
                dr.scatter_reduce(dr.ReduceOp.Max, longest[1], descended, place)
                dr.scatter_reduce(dr.ReduceOp.Max, longest[2], tested, place)
                place += 1
    t = dr.select(triangle == 0xFFFFFFFF, dr.inf, t)
    return Visits(t, triangle, inner, leaves, tests)
