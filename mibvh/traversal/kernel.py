"""The traversal kernel: one Dr.Jit source for LLVM and CUDA.

Each lane carries one ray. A step of the loop does for every lane what that lane needs next:
test the two children of an inner node, or one triangle of a leaf. The nearer child is gone to,
the farther one pushed; a popped node is taken as it is (the kernel of Aila, Laine and Karras
2012, as in the paper), or, with ``cull``, only if it still begins before the current hit.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from mibvh.traversal.records import DONE, NODE_ROW, TRIANGLE_ROW, Records
from mibvh.tree import MAX_DEPTH
from mibvh.variant import mitsuba

#: Directions nearer to zero than this are moved to it, so that no slab distance is 0 * inf.
_TINY = 2.0**-80
#: Rounding of the slab distances, at most three half ulps, must not lose a box that is just
#: touched (Ize: Robust BVH Ray Traversal, JCGT 2013).
_OUTWARD = 1.0 + 2.0**-21


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
    """Trace rays through a tree.

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
    inner, leaves, tests, steps : UInt32
        Inner nodes and leaves visited, triangles tested, loop steps taken by the lane; zero
        unless counted.
    """
    mi = mitsuba()
    n = dr.width(o)
    sx = dr.select(dr.abs(d.x) < _TINY, dr.copysign(mi.Float(_TINY), d.x), d.x)
    sy = dr.select(dr.abs(d.y) < _TINY, dr.copysign(mi.Float(_TINY), d.y), d.y)
    sz = dr.select(dr.abs(d.z) < _TINY, dr.copysign(mi.Float(_TINY), d.z), d.z)
    ix, iy, iz = 1 / sx, 1 / sy, 1 / sz

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
    steps = dr.full(mi.UInt32, 0, n)
    fresh = dr.full(mi.Bool, True, n)

    while node != DONE:
        pop = mi.Bool(False)
        if dr.hint(count, mode="scalar"):
            steps += 1
        if node >= 0:
            row = dr.gather(mi.ArrayXf, records.nodes, mi.UInt32(node), shape=(NODE_ROW, n))
            # -- slabs of the left and of the right child
            near_l, far_l = _slabs(row, 0, o, ix, iy, iz)
            near_r, far_r = _slabs(row, 6, o, ix, iy, iz)
            hit_l = near_l <= _min(far_l, t)
            hit_r = near_r <= _min(far_r, t)
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
            tri = dr.gather(
                mi.ArrayXf, records.triangles, mi.UInt32(~node), shape=(TRIANGLE_ROW, n)
            )
            # -- the three edges as seen along the ray; an edge's value in the one triangle is
            # exactly minus that in its neighbour, so that no ray slips between them
            ax, ay, az = tri[0] - o.x, tri[1] - o.y, tri[2] - o.z
            bx, by, bz = tri[3] - o.x, tri[4] - o.y, tri[5] - o.z
            cx, cy, cz = tri[6] - o.x, tri[7] - o.y, tri[8] - o.z
            u = _triple(d, cx, cy, cz, bx, by, bz)
            v = _triple(d, ax, ay, az, cx, cy, cz)
            w = _triple(d, bx, by, bz, ax, ay, az)
            inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
            # -- the plane; the normal is the triangle's own, so that its size cancels
            at = (tri[9] * ax + tri[10] * ay + tri[11] * az) / (
                tri[9] * d.x + tri[10] * d.y + tri[11] * d.z
            )
            hit = inside & (at >= 0) & (at < t)
            t = dr.select(hit, at, t)
            triangle = dr.select(hit, dr.reinterpret_array(mi.UInt32, tri[12]), triangle)
            pop = dr.reinterpret_array(mi.UInt32, tri[13]) != 0
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
    return t, triangle, inner, leaves, tests, steps


def _slabs(row: Any, at: int, o: Any, ix: Any, iy: Any, iz: Any) -> tuple[Any, Any]:
    """Where a ray enters and leaves the closed box whose corners stand at ``row[at:at + 6]``."""
    ax, bx = (row[at] - o.x) * ix, (row[at + 3] - o.x) * ix
    ay, by = (row[at + 1] - o.y) * iy, (row[at + 4] - o.y) * iy
    az, bz = (row[at + 2] - o.z) * iz, (row[at + 5] - o.z) * iz
    near = _max(_max(_min(ax, bx), _min(ay, by)), _max(_min(az, bz), 0.0))
    far = _min(_min(_max(ax, bx), _max(ay, by)), _max(az, bz))
    return near, far * _OUTWARD


def _triple(d: Any, ax: Any, ay: Any, az: Any, bx: Any, by: Any, bz: Any) -> Any:
    """Twice ``d . (a x b)``, rounded such that exchanging a and b changes the sign alone.

    Computed as ``d . ((a + b) x (b - a))``: a x b itself is the small difference of large
    products where the edge is short and far away.
    """
    sx, sy, sz = ax + bx, ay + by, az + bz
    ex, ey, ez = bx - ax, by - ay, bz - az
    return d.x * (sy * ez - sz * ey) + (d.y * (sz * ex - sx * ez) + d.z * (sx * ey - sy * ex))


def _min(a: Any, b: Any) -> Any:
    """Minimum by comparison.

    ``dr.minimum`` propagates NaN, which LLVM 15 cannot select on AVX-512 machines and others do
    slowly.
    """
    return dr.select(a < b, a, b)


def _max(a: Any, b: Any) -> Any:
    return dr.select(a > b, a, b)
