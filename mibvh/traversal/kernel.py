"""The binary traversal kernel: one Dr.Jit source for LLVM and CUDA.

Each lane carries one ray. A step of the loop does for every lane what that lane needs next:
test the two children of an inner node, or one triangle of a leaf.
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
def walk(
    records: Records,
    o: Any,
    d: Any,
    tmax: Any,
    active: Any,
    *,
    cull: bool,
    count: bool,
    any_hit: bool,
) -> Visits:
    """Trace rays through a tree in one loop.

    Parameters
    ----------
    records : Records
    o : Point3f
        Origins in the records' units.
    d : Vector3f
    tmax : Float
        In the records' units.
    active : Bool
        Lanes that carry a ray.
    cull : bool
        Re-test popped nodes against the current hit.
    count : bool
        Count visits; the timed kernel carries no counters.
    any_hit : bool
        End at the first hit found.

    Returns
    -------
    Visits
        The counters are zero unless counted.
    """
    mi = mitsuba()
    n = dr.width(o)
    inv = inverse(d)
    stack, begins = new_stack(cull)  # nodes put off; where they begin, if popped ones are re-tested
    top = dr.full(mi.UInt32, 0, n)  # entries of the stack
    t = dr.select(active, tmax, 0)  # distance of the current hit
    triangle = dr.full(mi.UInt32, 0xFFFFFFFF, n)  # the current hit
    # Code of the inner node, or of the leaf's next triangle, that the next step is for.
    node = dr.select(active, mi.Int32(records.root), mi.Int32(DONE))
    inner = dr.full(mi.UInt32, 0, n)  # inner nodes visited
    leaves = dr.full(mi.UInt32, 0, n)  # leaves visited
    tests = dr.full(mi.UInt32, 0, n)  # triangles tested
    fresh = dr.full(mi.Bool, True, n)  # the next triangle is the first of its leaf

    while node != DONE:
        lost = mi.Bool(False)  # the lane has nowhere to go but to the stack
        # One fetch for both kinds of row.
        row = fetch(records, node)
        if node >= 0:
            node, lost, top = node_step(row, o, inv, t, stack, begins, top)
            if dr.hint(count, mode="scalar"):
                inner += 1
                fresh = mi.Bool(True)
        else:
            t, triangle, hit, lost = triangle_step(row, o, d, t, triangle)
            if dr.hint(count, mode="scalar"):
                tests += 1
                leaves += dr.select(fresh, mi.UInt32(1), mi.UInt32(0))
                fresh = mi.Bool(lost)
            node -= 1
            if dr.hint(any_hit, mode="scalar"):
                if hit:
                    top = mi.UInt32(0)
                    lost = mi.Bool(True)
        if lost:
            node, top = pop(stack, begins, top, t)
    t = dr.select(triangle == 0xFFFFFFFF, dr.inf, t)
    return Visits(t, triangle, inner, leaves, tests)
