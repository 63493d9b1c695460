"""The binary traversal kernel: one Dr.Jit source for LLVM and CUDA.

Each lane carries one ray. A step of the loop does for every lane what that lane needs next:
test the two children of an inner node, or one triangle of a leaf. The nearer child is gone to,
the farther one pushed; a popped node is taken as it is (the kernel of Aila, Laine and Karras
2012, as in the paper), or, with ``cull``, only if it still begins before the current hit.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from mibvh.traversal.geometry import inverse, slabs, smaller, triangle_hit
from mibvh.traversal.records import DONE, ROW, Records
from mibvh.tree import MAX_DEPTH
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
    stack = dr.alloc_local(mi.Int32, MAX_DEPTH)
    if dr.hint(cull, mode="scalar"):
        stack_t = dr.alloc_local(mi.Float, MAX_DEPTH)
    top = dr.full(mi.UInt32, 0, n)
    t = dr.select(active, tmax, 0)
    triangle = dr.full(mi.UInt32, 0xFFFFFFFF, n)
    node = dr.select(active, mi.Int32(records.root), mi.Int32(DONE))
    inner = dr.full(mi.UInt32, 0, n)
    leaves = dr.full(mi.UInt32, 0, n)
    tests = dr.full(mi.UInt32, 0, n)
    fresh = dr.full(mi.Bool, True, n)

    while node != DONE:
        pop = mi.Bool(False)
        # One fetch for both kinds of row: ~node for a leaf.
        row = dr.gather(mi.ArrayXf, records.rows, mi.UInt32(node ^ (node >> 31)), shape=(ROW, n))
        if node >= 0:
            near_l, far_l = slabs(row, 0, o, inv)
            near_r, far_r = slabs(row, 6, o, inv)
            hit_l = near_l <= smaller(far_l, t)
            hit_r = near_r <= smaller(far_r, t)
            left = dr.reinterpret_array(mi.Int32, row[12])
            right = dr.reinterpret_array(mi.Int32, row[13])
            # -- go to the nearer, push the farther
            swap = hit_r & (~hit_l | (near_r < near_l))
            if hit_l & hit_r:
                stack[top] = dr.select(swap, left, right)
                if dr.hint(cull, mode="scalar"):
                    stack_t[top] = dr.select(swap, near_l, near_r)
                top += 1
            node = dr.select(swap, right, left)
            pop = ~(hit_l | hit_r)
            if dr.hint(count, mode="scalar"):
                inner += 1
                fresh = mi.Bool(True)
        else:
            hit, at = triangle_hit(row, o, d, t)
            t = dr.select(hit, at, t)
            triangle = dr.select(hit, dr.reinterpret_array(mi.UInt32, row[12]), triangle)
            pop = dr.reinterpret_array(mi.UInt32, row[13]) != 0
            if dr.hint(count, mode="scalar"):
                tests += 1
                leaves += dr.select(fresh, mi.UInt32(1), mi.UInt32(0))
                fresh = mi.Bool(pop)
            node -= 1
            if dr.hint(any_hit, mode="scalar"):
                if hit:
                    top = mi.UInt32(0)
                    pop = mi.Bool(True)
        if pop:
            node = mi.Int32(DONE)
            if dr.hint(cull, mode="scalar"):
                while (top > 0) & (node == DONE):
                    top -= 1
                    node = dr.select(stack_t[top] <= t, stack[top], mi.Int32(DONE))
            else:
                if top > 0:
                    top -= 1
                    node = stack[top]
    t = dr.select(triangle == 0xFFFFFFFF, dr.inf, t)
    return t, triangle, inner, leaves, tests
