"""A warp's lanes in lockstep, compiled: what the warps issue, and what each ray visits.

The arithmetic is that of :mod:`mibvh.traversal.geometry` and :mod:`mibvh.traversal.steps`,
operation by operation in float32, so that hits and visits are those of the Dr.Jit kernels.

A ray may have several lanes, one for each child of a node. They do the same at any time, so that
what is called a lane here is all lanes of a ray; they test as many triangles of a leaf at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.traversal.records import DONE
from mibvh.traversal.visits import Visits
from mibvh.traversal.wide_nodes import Children, WideNodes, enter_children, new_children

#: What a lane does with its leaves before the warp descends again: one of them; all at hand, the
#: warp waiting after each; all at hand, each lane at its own pace.
ONE_LEAF, LEAF_BY_LEAF, OWN_PACE = 0, 1, 2

_DONE = np.int32(DONE)
_NONE = np.int32(-1)
_ZERO, _ONE, _INF = np.float32(0), np.float32(1), np.float32(np.inf)
_TINY = np.float32(2.0**-80)
_OUTWARD = np.float32(1.0 + 2.0**-21)


class Plan(NamedTuple):
    """How warps go about it.

    Attributes
    ----------
    width : int
        Lanes of a warp, or as many rays as have its lanes.
    together : int
        Triangles of a leaf that are tested at once: the lanes of a ray.
    single : bool
        One loop whose steps do for each lane what it needs next; otherwise rounds.
    postpone, vote : bool
        A lane puts its first leaf aside and descends on; a descent ends once every lane that is
        still in it has put one aside.
    leaves : int
        ``ONE_LEAF``, ``LEAF_BY_LEAF`` or ``OWN_PACE``.
    threshold : int
        Lanes that are done fetch new rays once a round began with fewer busy lanes than this;
        0: once all are done.
    any_hit : bool
        The first hit found ends a ray.
    """

    width: int
    together: int
    single: bool
    postpone: bool
    vote: bool
    leaves: int
    threshold: int
    any_hit: bool


class Rays(NamedTuple):
    """Rays to trace, and in which order."""

    o: Any  # (R, 3) float32
    d: Any  # (R, 3) float32
    tmax: Any  # (R,) float32; negative for a ray that hits nothing
    order: Any  # (R,) int32


class Scene(NamedTuple):
    """A tree's records (:mod:`mibvh.traversal.records`).

    Of a wide tree the rows are those of its triangles; the code of an inner node is its number.
    """

    rows: Any  # (N, 16) float32
    codes: Any  # the same memory as int32
    root: Any  # int32: the root's code
    wide: bool
    nodes: WideNodes  # of a wide tree


class Lanes(NamedTuple):
    """What the lanes of some warps hold, a row each."""

    ray: Any  # (L,) int32: the ray that the lane traces
    o: Any  # (L, 3) float32
    d: Any  # (L, 3) float32
    inv: Any  # (L, 3) float32: 1 / d
    t: Any  # (L,) float32: distance of the current hit
    triangle: Any  # (L,) int32: the current hit; -1: none
    node: Any  # (L,) int32: code of the node to go to
    leaf: Any  # (L,) int32: code of the leaf at hand or put aside
    stack: Any  # (L, S) int32
    top: Any  # (L,) int32: entries of the stack
    found: Children  # of the last wide node visited


def new_lanes(count: int, stack: int) -> Lanes:
    """Lanes with no ray, and room for so many entries on their stacks."""

    def vectors() -> Any:
        return np.zeros((count, 3), np.float32)

    def codes(value: int) -> Any:
        return np.full(count, value, np.int32)

    return Lanes(
        codes(0),
        vectors(),
        vectors(),
        vectors(),
        np.zeros(count, np.float32),
        codes(-1),
        codes(DONE),
        codes(DONE),
        np.zeros((count, stack), np.int32),
        codes(0),
        new_children(),
    )


def new_visits(count: int) -> Visits:
    """Visits of rays that have not been traced."""
    return Visits(
        np.full(count, np.inf, np.float32),
        np.full(count, -1, np.int32),
        *(np.zeros(count, np.uint32) for _ in range(4)),
    )


# ------------------------------------------------------------ one lane


@njit(allocates=False)
def _smaller(a, b):
    return a if a < b else b


@njit(allocates=False)
def _larger(a, b):
    return a if a > b else b


@njit(allocates=False)
def _take(lanes, i, ray, rays, root, postpone):
    """Give a lane a ray. A root that is a leaf is put aside where first leaves are."""
    lanes.ray[i] = ray
    for k in range(3):
        c = rays.d[ray, k]
        lanes.o[i, k], lanes.d[i, k] = rays.o[ray, k], c
        lanes.inv[i, k] = _ONE / (np.copysign(_TINY, c) if abs(c) < _TINY else c)
    lanes.t[i], lanes.triangle[i], lanes.top[i] = rays.tmax[ray], _NONE, 0
    node = root if rays.tmax[ray] >= _ZERO else _DONE
    aside = postpone and node < 0
    lanes.node[i], lanes.leaf[i] = (_DONE, node) if aside else (node, _DONE)


@njit(allocates=False)
def _pop(lanes, i):
    if lanes.top[i] == 0:
        return _DONE
    lanes.top[i] -= 1
    return lanes.stack[i, lanes.top[i]]


@njit(allocates=False)
def _slabs(rows, row, at, o, inv, i):
    ax, bx = (rows[row, at] - o[i, 0]) * inv[i, 0], (rows[row, at + 3] - o[i, 0]) * inv[i, 0]
    ay, by = (rows[row, at + 1] - o[i, 1]) * inv[i, 1], (rows[row, at + 4] - o[i, 1]) * inv[i, 1]
    az, bz = (rows[row, at + 2] - o[i, 2]) * inv[i, 2], (rows[row, at + 5] - o[i, 2]) * inv[i, 2]
    near = _larger(_larger(_smaller(ax, bx), _smaller(ay, by)), _larger(_smaller(az, bz), _ZERO))
    far = _smaller(_smaller(_larger(ax, bx), _larger(ay, by)), _larger(az, bz))
    return near, far * _OUTWARD


@njit(allocates=False)
def _visit(lanes, i, scene, visits):
    """Visit the lane's node, and count it."""
    ray = lanes.ray[i]
    visits.inner[ray] += np.uint32(1)
    if scene.wide:
        visits.boxes[ray] += np.uint32(scene.nodes.children[lanes.node[i]])
        _wide_step(lanes, i, scene.nodes)
    else:
        visits.boxes[ray] += np.uint32(2)
        _node_step(lanes, i, scene)


@njit(allocates=False)
def _wide_step(lanes, i, nodes):
    """Test all children of the lane's node, push those hit, the nearest last, and pop it."""
    node, found = lanes.node[i], lanes.found
    o = (lanes.o[i, 0], lanes.o[i, 1], lanes.o[i, 2])
    inv = (lanes.inv[i, 0], lanes.inv[i, 1], lanes.inv[i, 2])
    enter_children(nodes, node, o, inv, lanes.t[i], found)
    for place in range(7, -1, -1):
        which = found.order[place]
        if found.near[which] < _INF:
            child = nodes.child[node] + which
            code = child if nodes.child[child] >= 0 else ~nodes.first[child]
            lanes.stack[i, lanes.top[i]] = code
            lanes.top[i] += 1
    lanes.node[i] = _pop(lanes, i)


@njit(allocates=False)
def _node_step(lanes, i, scene):
    """Test both children of the lane's node, push the farther, go to the nearer; or pop."""
    rows, codes = scene.rows, scene.codes
    row, t = lanes.node[i], lanes.t[i]
    near_l, far_l = _slabs(rows, row, 0, lanes.o, lanes.inv, i)
    near_r, far_r = _slabs(rows, row, 6, lanes.o, lanes.inv, i)
    hit_l = near_l <= _smaller(far_l, t)
    hit_r = near_r <= _smaller(far_r, t)
    left, right = codes[row, 12], codes[row, 13]
    swap = hit_r and (not hit_l or near_r < near_l)
    if hit_l and hit_r:
        lanes.stack[i, lanes.top[i]] = left if swap else right
        lanes.top[i] += 1
    if hit_l or hit_r:
        lanes.node[i] = right if swap else left
    else:
        lanes.node[i] = _pop(lanes, i)


@njit(allocates=False)
def _triple(dx, dy, dz, ax, ay, az, bx, by, bz):
    sx, sy, sz = ax + bx, ay + by, az + bz
    ex, ey, ez = bx - ax, by - ay, bz - az
    return dx * (sy * ez - sz * ey) + (dy * (sz * ex - sx * ez) + dz * (sx * ey - sy * ex))


@njit(allocates=False)
def _test(lanes, i, row, scene):
    """Test one triangle; whether it is a nearer hit."""
    rows = scene.rows
    x, y, z = lanes.o[i, 0], lanes.o[i, 1], lanes.o[i, 2]
    dx, dy, dz = lanes.d[i, 0], lanes.d[i, 1], lanes.d[i, 2]
    ax, ay, az = rows[row, 0] - x, rows[row, 1] - y, rows[row, 2] - z
    bx, by, bz = rows[row, 3] - x, rows[row, 4] - y, rows[row, 5] - z
    cx, cy, cz = rows[row, 6] - x, rows[row, 7] - y, rows[row, 8] - z
    u = _triple(dx, dy, dz, cx, cy, cz, bx, by, bz)
    v = _triple(dx, dy, dz, ax, ay, az, cx, cy, cz)
    w = _triple(dx, dy, dz, bx, by, bz, ax, ay, az)
    if (u >= _ZERO and v >= _ZERO and w >= _ZERO) or (u <= _ZERO and v <= _ZERO and w <= _ZERO):
        nx, ny, nz = rows[row, 9], rows[row, 10], rows[row, 11]
        at = (nx * ax + ny * ay + nz * az) / (nx * dx + ny * dy + nz * dz)
        if at >= _ZERO and at < lanes.t[i]:
            lanes.t[i], lanes.triangle[i] = at, scene.codes[row, 12]
            return True
    return False


@njit(allocates=False)
def _triangle_step(lanes, i, code, plan, scene):
    """Test as many triangles of a leaf as go together.

    Returns
    -------
    ended : bool
        Whether these are the last that are tested of the leaf.
    tested : int
    """
    row, tested, ended, found = ~code, 0, False, False
    while tested < plan.together and not ended:
        # The first of several hits ends a ray that any hit ends; they are found at once.
        if not found and _test(lanes, i, row, scene):
            found = plan.any_hit
        ended = scene.codes[row, 13] != 0
        tested += 1
        row += 1
    if found:
        lanes.node[i], lanes.top[i] = _DONE, 0
    return ended or found, tested


@njit(allocates=False)
def _leaf(lanes, i, code, plan, scene, visits):
    """Test all triangles of a leaf; in how many steps."""
    ray, steps, ended = lanes.ray[i], 0, False
    while not ended:
        ended, tested = _triangle_step(lanes, i, code, plan, scene)
        visits.tests[ray] += np.uint32(tested)
        code -= np.int32(plan.together)
        steps += 1
    visits.leaves[ray] += np.uint32(1)
    return steps


# ------------------------------------------------------------ one warp


@njit(allocates=False)
def _busy(lanes, first, width):
    """Lanes of a warp that have something left to do."""
    busy = 0
    for i in range(first, first + width):
        busy += lanes.node[i] != _DONE or lanes.leaf[i] != _DONE
    return busy


@njit(allocates=False)
def _descend(lanes, first, plan, scene, visits):
    """Lanes descend until each has a leaf, or its second, or none; steps that the warp issues."""
    steps = 0
    while True:
        inside = searching = 0  # lanes in this step, and those that have put no leaf aside
        for i in range(first, first + plan.width):
            if lanes.node[i] < 0:
                continue
            inside += 1
            _visit(lanes, i, scene, visits)
            if plan.postpone:
                if lanes.node[i] < 0 and lanes.node[i] != _DONE and lanes.leaf[i] == _DONE:
                    lanes.leaf[i] = lanes.node[i]
                    lanes.node[i] = _pop(lanes, i)
                searching += lanes.leaf[i] == _DONE
        steps += inside > 0
        if inside == 0 or (plan.vote and searching == 0):
            return steps


@njit(allocates=False)
def _next_leaf(lanes, i, postpone):
    """Of a lane whose leaf is done: take the next, if there is one before an inner node."""
    if not postpone:
        lanes.node[i] = _pop(lanes, i)
    lanes.leaf[i] = lanes.node[i] if lanes.node[i] < 0 else _DONE
    if postpone and lanes.leaf[i] != _DONE:
        lanes.node[i] = _pop(lanes, i)


@njit(allocates=False)
def _test_leaves(lanes, first, plan, scene, visits):
    """Lanes test their leaves; steps that the warp issues."""
    if not plan.postpone:
        for i in range(first, first + plan.width):
            lanes.leaf[i] = lanes.node[i] if lanes.node[i] < 0 else _DONE
    issued = 0
    while True:
        longest = 0
        for i in range(first, first + plan.width):
            steps = 0
            while lanes.leaf[i] != _DONE:
                steps += _leaf(lanes, i, lanes.leaf[i], plan, scene, visits)
                _next_leaf(lanes, i, plan.postpone)
                if plan.leaves != OWN_PACE:
                    break
            if plan.leaves == ONE_LEAF:
                lanes.leaf[i] = _DONE
            longest = max(longest, steps)
        issued += longest
        if longest == 0 or plan.leaves != LEAF_BY_LEAF:
            return issued


@njit(allocates=False)
def _single_loop(lanes, first, plan, scene, visits, issued):
    """Steps of the single loop, until all lanes are done: each does what it needs next."""
    while True:
        nodes = triangles = 0  # whether the warp issues a node's step, and a triangle's
        for i in range(first, first + plan.width):
            node, ray = lanes.node[i], lanes.ray[i]
            if node >= 0:
                _visit(lanes, i, scene, visits)
                nodes = 1
            elif node != _DONE:
                ended, tested = _triangle_step(lanes, i, node, plan, scene)
                visits.tests[ray] += np.uint32(tested)
                visits.leaves[ray] += np.uint32(ended)
                lanes.node[i] = _pop(lanes, i) if ended else node - np.int32(plan.together)
                triangles = 1
        if nodes + triangles == 0:
            break
        issued[0] += nodes
        issued[1] += triangles
        issued[2] += 1


@njit(allocates=False)
def _store(lanes, i, visits):
    if lanes.triangle[i] >= 0:
        visits.t[lanes.ray[i]], visits.triangle[lanes.ray[i]] = lanes.t[i], lanes.triangle[i]


@njit(allocates=False)
def _fetch(lanes, first, plan, begin, end, rays, scene, visits):
    """Lanes that are done put their rays away and take the next ones; the first ray not taken."""
    for i in range(first, first + plan.width):
        if lanes.node[i] == _DONE and lanes.leaf[i] == _DONE:
            _store(lanes, i, visits)
            lanes.triangle[i] = _NONE
            if begin < end:
                _take(lanes, i, rays.order[begin], rays, scene.root, plan.postpone)
                begin += 1
    return begin


@njit(allocates=False)
def _round(lanes, first, plan, scene, visits, issued):
    """One round of a warp; ``issued`` grows by what it issues."""
    issued[0] += _descend(lanes, first, plan, scene, visits)
    issued[1] += _test_leaves(lanes, first, plan, scene, visits)
    issued[2] += 1


@njit(allocates=False)
def _go_on(lanes, first, plan, begin, end, rays, scene, visits, issued):
    """A warp's next round, after fetching rays where it is time to; the first ray not taken."""
    busy = _busy(lanes, first, plan.width)
    if busy == 0 or issued[3] < plan.threshold:
        begin = _fetch(lanes, first, plan, begin, end, rays, scene, visits)
        busy = _busy(lanes, first, plan.width)
    issued[3] = busy
    if plan.single:
        _single_loop(lanes, first, plan, scene, visits, issued)
    elif busy:
        _round(lanes, first, plan, scene, visits, issued)
    return begin


# ------------------------------------------------------------ many warps


@njit(allocates=False)
def run_queue(lanes, plan, begin, end, rays, scene, visits, issued):
    """Warps that share a queue of rays, until it is empty and all are done.

    All are equally fast: the warp that has issued least goes on first.

    Parameters
    ----------
    lanes : Lanes
        ``plan.width`` for each warp.
    plan : Plan
    begin, end : int
        The queue: places in the order of the rays.
    rays : Rays
    scene : Scene
    visits : Visits
        Written at the rays' places.
    issued : (P, 4) int64
        Added to, a row per warp: node steps, triangle steps, rounds; and the lanes that were busy
        when its last round began.
    """
    while True:
        first = -1  # the warp whose turn it is
        for p in range(len(issued)):
            waits = begin < end or _busy(lanes, p * plan.width, plan.width) > 0
            if waits and (first < 0 or _clock(issued, p) < _clock(issued, first)):
                first = p
        if first < 0:
            break
        begin = _go_on(
            lanes, first * plan.width, plan, begin, end, rays, scene, visits, issued[first]
        )
    for i in range(len(lanes.node)):
        _store(lanes, i, visits)
        lanes.triangle[i] = _NONE


@njit(allocates=False)
def _clock(issued, p):
    return 1.2 * issued[p, 0] + issued[p, 1]


@njit(allocates=False)
def run_queues(lanes, plan, queues, rays, scene, visits, issued):
    """One queue after another: ``(begin, end)`` a row, and their warps' rows of ``issued``."""
    for q in range(len(queues)):
        run_queue(lanes, plan, queues[q, 0], queues[q, 1], rays, scene, visits, issued[q])


@njit(allocates=False)
def count_rounds(lanes, begin, end, rays, scene, visits, per_ray, descents, lengths):
    """Rounds of each ray alone, and how many are so long: node steps, triangle steps."""
    plan = Plan(1, 1, False, False, False, ONE_LEAF, 0, False)
    for ray in range(begin, end):
        _take(lanes, 0, ray, rays, scene.root, False)
        while lanes.node[0] != _DONE:
            descents[_descend(lanes, 0, plan, scene, visits)] += 1
            lengths[_test_leaves(lanes, 0, plan, scene, visits)] += 1
            per_ray[ray] += np.uint32(1)
