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
) -> tuple[Any, ...]:
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
    t : Float
        Distance of the closest hit in the records' units; infinite for a miss.
    triangle : UInt32
        Its id; 2**32 - 1 for a miss.
    inner, leaves, tests : UInt32
        Inner nodes and leaves visited, triangles tested; zero unless counted.
    """
    mi = mitsuba()
    n = dr.width(o)
    inv = inverse(d)
    stack, begins = new_stack(cull)
    top = dr.full(mi.UInt32, 0, n)
    t = dr.select(active, tmax, 0)
    triangle = dr.full(mi.UInt32, 0xFFFFFFFF, n)
    node = dr.select(active, mi.Int32(records.root), mi.Int32(DONE))
    inner = dr.full(mi.UInt32, 0, n)
    leaves = dr.full(mi.UInt32, 0, n)
    tests = dr.full(mi.UInt32, 0, n)
    fresh = dr.full(mi.Bool, True, n)

    while node != DONE:
        lost = mi.Bool(False)
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
    return t, triangle, inner, leaves, tests
