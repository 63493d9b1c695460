"""`sbvh`: top-down SAH with spatial splits.

Stich, Friedrich, Dietrich: *Spatial Splits in Bounding Volume Hierarchies* (HPG 2009).
"""

from __future__ import annotations

import dataclasses
import heapq
import math
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any, NamedTuple

import numba
import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References, centers_twice
from mibvh.builders.radix import argsort_keys, float_keys
from mibvh.builders.registry import Context, Options, builder, option
from mibvh.builders.splitting import MAX_CORNERS, clip_to_box, pack_boxes, split_reference
from mibvh.builders.sweep import _sweep_axis
from mibvh.triangles import Triangles

_SPATIAL_DEPTH = 48
_GRAIN = 32768


class _Work(NamedTuple):
    corners: Any
    scale: Any
    box: Any
    triangle: Any
    is_split: Any
    order0: Any
    order1: Any
    order2: Any
    side: Any
    buffer: Any
    right_area: Any
    left: Any
    right: Any
    reference: Any


class _Rules(NamedTuple):
    bins: Any
    overlap: Any
    c_inner: Any
    c_tri: Any
    max_leaf: Any
    spatial_depth: Any
    leafrule: Any


class _Bins(NamedTuple):
    box: Any
    enter: Any
    leave: Any
    area: Any
    polygon: Any
    spare: Any
    halves: Any


@njit
def _area(b):
    x, y, z = b[4] - b[0], b[5] - b[1], b[6] - b[2]
    return x * y + (x + y) * z


@njit
def _clear(b):
    for k in range(3):
        b[k] = np.inf
        b[k + 4] = -np.inf


@njit
def _grow(b, other):
    for k in range(3):
        b[k] = min(b[k], other[k])
        b[k + 4] = max(b[k + 4], other[k + 4])


@njit
def _grow_row(b, boxes, r):
    for k in range(3):
        b[k] = min(b[k], boxes[r, k])
        b[k + 4] = max(b[k + 4], boxes[r, k + 4])


@njit
def _grow_bin(bins, axis, e, x, y, z):
    bins[axis, e, 0] = min(bins[axis, e, 0], np.float32(x))
    bins[axis, e, 1] = min(bins[axis, e, 1], np.float32(y))
    bins[axis, e, 2] = min(bins[axis, e, 2], np.float32(z))
    bins[axis, e, 4] = max(bins[axis, e, 4], np.float32(x))
    bins[axis, e, 5] = max(bins[axis, e, 5], np.float32(y))
    bins[axis, e, 6] = max(bins[axis, e, 6], np.float32(z))


@njit
def _chop(polygon, size, axis, first, last, origin, inverse, width, bins):
    for i in range(size):
        j = i + 1 if i + 1 < size else 0
        a = min(max(int((polygon[i, axis] - origin) * inverse), first), last)
        b = min(max(int((polygon[j, axis] - origin) * inverse), first), last)
        _grow_bin(bins, axis, a, polygon[i, 0], polygon[i, 1], polygon[i, 2])
        if a == b:
            continue
        dx = polygon[j, 0] - polygon[i, 0]
        dy = polygon[j, 1] - polygon[i, 1]
        dz = polygon[j, 2] - polygon[i, 2]
        length = polygon[j, axis] - polygon[i, axis]
        for e in range(min(a, b), max(a, b)):
            t = (origin + (e + 1) * width - polygon[i, axis]) / length
            t = min(max(t, 0.0), 1.0)
            x, y, z = polygon[i, 0] + t * dx, polygon[i, 1] + t * dy, polygon[i, 2] + t * dz
            _grow_bin(bins, axis, e, x, y, z)
            _grow_bin(bins, axis, e + 1, x, y, z)


@njit
def _fill(work, begin, end, node_box, count, inverse, width, bins):
    """Enter references into the bins of all three axes."""
    corners, scale, box = work.corners, work.scale, work.box
    order, triangle, is_split = work.order0, work.triangle, work.is_split
    bin_box, enter, leave = bins.box, bins.enter, bins.leave
    polygon, spare = bins.polygon, bins.spare
    for k in range(3):
        for e in range(count):
            for c in range(3):
                bin_box[k, e, c] = np.inf
                bin_box[k, e, c + 4] = -np.inf
            enter[k, e] = 0
            leave[k, e] = 0
    for i in range(begin, end):
        r = order[i]
        size = 0
        for k in range(3):
            a = int((np.float64(box[r, k]) - node_box[k]) * inverse[k])
            b = math.ceil((np.float64(box[r, k + 4]) - node_box[k]) * inverse[k]) - 1
            a = min(a, count - 1)
            b = min(max(b, a), count - 1)
            enter[k, a] += 1
            leave[k, b] += 1
            if a == b:
                for c in range(3):
                    bin_box[k, a, c] = min(bin_box[k, a, c], box[r, c])
                    bin_box[k, a, c + 4] = max(bin_box[k, a, c + 4], box[r, c + 4])
                continue
            if size == 0:
                t = triangle[r]
                if is_split[r]:
                    size = clip_to_box(corners, t, scale, box, r, polygon, spare)
                else:
                    size = 3
                    for p in range(3):
                        for c in range(3):
                            polygon[p, c] = np.float64(corners[t, p, c]) * scale
            _chop(polygon, size, k, a, b, np.float64(node_box[k]), inverse[k], width[k], bin_box)


@njit
def _best_plane(n, slack, count, axis, best, best_axis, best_at, bins):
    box, enter, leave, area = bins.box, bins.enter, bins.leave, bins.area
    inf = np.float32(np.inf)
    x0, y0, z0, x1, y1, z1 = inf, inf, inf, -inf, -inf, -inf
    for e in range(count - 1, 0, -1):
        x0, y0, z0 = (
            min(x0, box[axis, e, 0]),
            min(y0, box[axis, e, 1]),
            min(z0, box[axis, e, 2]),
        )
        x1, y1, z1 = (
            max(x1, box[axis, e, 4]),
            max(y1, box[axis, e, 5]),
            max(z1, box[axis, e, 6]),
        )
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        area[e] = dx * dy + (dx + dy) * dz
    x0, y0, z0, x1, y1, z1 = inf, inf, inf, -inf, -inf, -inf
    n_left, n_right = 0, n
    for e in range(1, count):
        x0, y0, z0 = (
            min(x0, box[axis, e - 1, 0]),
            min(y0, box[axis, e - 1, 1]),
            min(z0, box[axis, e - 1, 2]),
        )
        x1, y1, z1 = (
            max(x1, box[axis, e - 1, 4]),
            max(y1, box[axis, e - 1, 5]),
            max(z1, box[axis, e - 1, 6]),
        )
        n_left += enter[axis, e - 1]
        n_right -= leave[axis, e - 1]
        if n_left == 0 or n_right == 0 or n_left + n_right - n > slack:
            continue
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        cost = (dx * dy + (dx + dy) * dz) * np.float32(n_left) + area[e] * np.float32(n_right)
        if cost < best:
            best, best_axis, best_at = cost, axis, e
    return best, best_axis, best_at


@njit
def _partition_to(order, begin, end, side, buffer, target):
    """Stable partition; the right part goes to ``target``."""
    a, b = begin, 0
    for i in range(begin, end):
        r = order[i]
        if side[r]:
            order[a] = r
            a += 1
        else:
            buffer[begin + b] = r
            b += 1
    for i in range(b):
        order[target + i] = buffer[begin + i]


@njit
def _sorted_new(box, ids, axis):
    n = len(ids)
    keys = np.empty(n, np.float32)
    for i in range(n):
        keys[i] = box[ids[i], axis] + box[ids[i], axis + 4] + np.float32(0)
    bits = keys.view(np.uint32)
    packed = np.empty(n, np.uint64)
    for i in range(n):
        b = bits[i]
        b = ~b if b >> np.uint32(31) else b | np.uint32(0x80000000)
        packed[i] = (np.uint64(b) << np.uint64(32)) | np.uint64(ids[i])
    packed.sort()
    out = np.empty(n, np.int32)
    for i in range(n):
        out[i] = np.int32(packed[i] & np.uint64(0xFFFFFFFF))
    return out


@njit
def _merge(order, first, last, fresh, box, axis, target):
    """Merge order[first:last] with the fresh ids, from the back, to end where both fit from target."""
    i, j = last - 1, len(fresh) - 1
    out = target + (last - first) + len(fresh) - 1
    while j >= 0:
        if i >= first and (
            box[order[i], axis] + box[order[i], axis + 4]
            > box[fresh[j], axis] + box[fresh[j], axis + 4]
        ):
            order[out] = order[i]
            i -= 1
        else:
            order[out] = fresh[j]
            j -= 1
        out -= 1


@njit
def _spatial_split(work, task, axis, plane, bins, limit):
    """Try to carry out a spatial split. Returns (n_left, n_right, new references); 0,0,0 if not possible."""
    box, side, triangle = work.box, work.side, work.triangle
    begin, n, slack, first_id = task[0], task[1], task[2], task[3]
    order = work.order0
    halves = bins.halves
    left, right = halves[0], halves[1]
    _clear(left)
    _clear(right)
    n_left, n_right, straddling = 0, 0, 0
    for i in range(begin, begin + n):
        r = order[i]
        if box[r, axis + 4] <= plane:
            side[r] = 1
            n_left += 1
            _grow_row(left, box, r)
        elif box[r, axis] >= plane:
            side[r] = 0
            n_right += 1
            _grow_row(right, box, r)
        else:
            side[r] = 2
            straddling += 1
    if straddling > slack:
        return 0, 0, 0
    ids = np.empty(straddling, np.int32)
    cut = np.empty((straddling, 2, 8), np.float32)
    s = 0
    for i in range(begin, begin + n):
        r = order[i]
        if side[r] != 2:
            continue
        found = split_reference(
            work.corners,
            triangle[r],
            work.scale,
            box,
            r,
            axis,
            plane,
            cut[s, 0],
            cut[s, 1],
            bins.polygon,
            bins.spare,
        )
        if found == 3:
            _grow(left, cut[s, 0])
            _grow(right, cut[s, 1])
            n_left += 1
            n_right += 1
            ids[s] = r
            s += 1
        elif found == 1:
            side[r] = 1
            n_left += 1
            _grow_row(left, box, r)
        else:
            side[r] = 0
            n_right += 1
            _grow_row(right, box, r)
    # Unsplitting
    area_left, area_right = _area(left), _area(right)
    kept = 0
    for i in range(s):
        r = ids[i]
        both = area_left * np.float32(n_left) + area_right * np.float32(n_right)
        a = halves[2]
        a[:] = left
        _grow_row(a, box, r)
        only_left = _area(a) * np.float32(n_left) + area_right * np.float32(n_right - 1)
        b = halves[3]
        b[:] = right
        _grow_row(b, box, r)
        only_right = area_left * np.float32(n_left - 1) + _area(b) * np.float32(n_right)
        if only_left <= both and only_left <= only_right:
            side[r] = 1
            left[:] = a
            area_left = _area(left)
            n_right -= 1
        elif only_right <= both:
            side[r] = 0
            right[:] = b
            area_right = _area(right)
            n_left -= 1
        else:
            ids[kept] = r
            cut[kept] = cut[i]
            kept += 1
    if n_left == 0 or n_right == 0:
        return 0, 0, 0
    if not area_left * np.float32(n_left) + area_right * np.float32(n_right) < limit:
        return 0, 0, 0
    # Carry out
    new = np.empty(kept, np.int32)
    for i in range(kept):
        r = ids[i]
        q = first_id + i
        new[i] = q
        for k in range(8):
            box[r, k] = cut[i, 0, k]
            box[q, k] = cut[i, 1, k]
        triangle[q] = triangle[r]
        work.is_split[r] = True
        work.is_split[q] = True
    room = slack - kept
    left_room = room * n_left // (n_left + n_right)
    target = begin + n_left + left_room
    for k in range(3):
        o = work.order0 if k == 0 else (work.order1 if k == 1 else work.order2)
        # unsplit ones
        a, b = begin, 0
        for i in range(begin, begin + n):
            r = o[i]
            w = side[r]
            if w == 1:
                o[a] = r
                a += 1
            elif w == 0:
                work.buffer[begin + b] = r
                b += 1
        _merge(o, begin, a, _sorted_new(box, ids[:kept], k), box, k, begin)
        for i in range(b):
            o[target + i] = work.buffer[begin + i]
        _merge(o, target, target + b, _sorted_new(box, new, k), box, k, target)
    return n_left, n_right, kept


@njit
def _run(work, rules, task, single, pending):
    """Split one node (single) or build its whole subtree. Returns number of pending children."""
    count = rules.bins
    bins = _Bins(
        np.empty((3, count, 8), np.float32),
        np.empty((3, count), np.int32),
        np.empty((3, count), np.int32),
        np.empty(count, np.float32),
        np.empty((MAX_CORNERS, 3), np.float64),
        np.empty((MAX_CORNERS, 3), np.float64),
        np.empty((4, 8), np.float32),
    )
    halves = bins.halves
    node_box = np.empty(8, np.float32)
    inverse = np.empty(3, np.float64)
    width = np.empty(3, np.float64)
    order0, order1, order2, box = work.order0, work.order1, work.order2, work.box
    stack = np.empty((130, 7), np.int64)
    stack[0] = task
    top = 1
    while top > 0:
        top -= 1
        task = stack[top].copy()
        begin, n, slack, first_id, node, depth, spatial = (
            task[0],
            task[1],
            task[2],
            task[3],
            task[4],
            task[5],
            task[6],
        )
        end = begin + n
        if n == 1:
            work.reference[node] = order0[begin]
            continue
        cost, even, axis, at = np.float32(np.inf), n + 1, 0, 1
        area = work.right_area[begin:]
        cost, even, axis, at = _sweep_axis(order0, begin, end, box, area, cost, even, 0, axis, at)
        cost, even, axis, at = _sweep_axis(order1, begin, end, box, area, cost, even, 1, axis, at)
        cost, even, axis, at = _sweep_axis(order2, begin, end, box, area, cost, even, 2, axis, at)
        chosen = order0 if axis == 0 else (order1 if axis == 1 else order2)
        n_left, n_right, new = 0, 0, 0
        if spatial and slack > 0 and depth < rules.spatial_depth:
            left, right = halves[0], halves[1]
            _clear(left)
            _clear(right)
            for i in range(begin, begin + at):
                _grow_row(left, box, chosen[i])
            for i in range(begin + at, end):
                _grow_row(right, box, chosen[i])
            overlap = np.float32(0)
            x = min(left[4], right[4]) - max(left[0], right[0])
            y = min(left[5], right[5]) - max(left[1], right[1])
            z = min(left[6], right[6]) - max(left[2], right[2])
            best = cost
            node_box[:] = left
            _grow(node_box, right)
            if x >= 0 and y >= 0 and z >= 0:
                overlap = x * y + (x + y) * z
                if overlap >= rules.overlap:
                    best_axis, best_at = -1, 0
                    for k in range(3):
                        length = np.float64(node_box[k + 4]) - node_box[k]
                        width[k] = length / count
                        inverse[k] = count / length if length > 0 else 0.0
                    _fill(work, begin, end, node_box, count, inverse, width, bins)
                    for k in range(3):
                        best, best_axis, best_at = _best_plane(
                            n, slack, count, k, best, best_axis, best_at, bins
                        )
                    if rules.leafrule and n <= rules.max_leaf and (
                        rules.c_tri * n * _area(node_box)
                        <= rules.c_inner * _area(node_box) + rules.c_tri * best
                    ):
                        best_axis = -1
                        spatial = 0
                    if best_axis >= 0:
                        plane = np.float32(node_box[best_axis] + best_at * width[best_axis])
                        n_left, n_right, new = _spatial_split(
                            work, task, best_axis, plane, bins, cost
                        )
        if n_left == 0:
            side = work.side
            for i in range(begin, end):
                side[chosen[i]] = i < begin + at
            n_left, n_right = at, n - at
            left_room = slack * n_left // n
            target = begin + n_left + left_room
            _partition_to(order0, begin, end, side, work.buffer, target)
            _partition_to(order1, begin, end, side, work.buffer, target)
            _partition_to(order2, begin, end, side, work.buffer, target)
        else:
            left_room = (slack - new) * n_left // (n_left + n_right)
            target = begin + n_left + left_room
        right_room = slack - new - left_room
        left_node = node + 1
        right_node = node + 2 * (n_left + left_room)
        work.left[node] = left_node
        work.right[node] = right_node
        # larger first, so that the smaller one is done first
        a, b = (0, 1) if n_left + left_room > n_right + right_room else (1, 0)
        for c in range(2):
            s = top + (a if c == 0 else b)
            stack[s, 0] = begin if c == 0 else target
            stack[s, 1] = n_left if c == 0 else n_right
            stack[s, 2] = left_room if c == 0 else right_room
            stack[s, 3] = first_id + new + (0 if c == 0 else left_room)
            stack[s, 4] = left_node if c == 0 else right_node
            stack[s, 5] = depth + 1
            stack[s, 6] = spatial
        top += 2
        if single:
            pending[:] = stack[:2]
            return 2
    return 0


@njit
def _compact(left, right, reference, box, triangle):
    nodes = len(left)
    number = np.empty(nodes, np.int32)
    total, refs = 0, 0
    for n in range(nodes):
        number[n] = total
        if left[n] >= 0 or reference[n] >= 0:
            total += 1
        if reference[n] >= 0:
            refs += 1
    out_left = np.full(total, -1, np.int32)
    out_right = np.full(total, -1, np.int32)
    out_reference = np.full(total, -1, np.int32)
    lower = np.empty((refs, 3), np.float32)
    upper = np.empty((refs, 3), np.float32)
    out_triangle = np.empty(refs, np.int32)
    r = 0
    for n in range(nodes):
        m = number[n]
        if left[n] >= 0:
            out_left[m] = number[left[n]]
            out_right[m] = number[right[n]]
        elif reference[n] >= 0:
            q = reference[n]
            out_reference[m] = r
            for k in range(3):
                lower[r, k] = box[q, k]
                upper[r, k] = box[q, k + 4]
            out_triangle[r] = triangle[q]
            r += 1
    return out_left, out_right, out_reference, lower, upper, out_triangle


@dataclasses.dataclass(frozen=True, kw_only=True)
class SpatialOptions(Options):
    """Options of `sbvh`."""

    alpha: float = option(1e-5, "least overlap", 0.0, 1.0)
    bins: int = option(128, "planes tried on each axis", 8, 256)
    budget: float = option(1.0, "references added at most, as a share of the triangles", 0.0, 8.0)
    leafrule: int = option(1, "x", 0, 1)


@builder(
    "sbvh",
    summary="x",
    source="Stich, Friedrich and Dietrich 2009",
    options=SpatialOptions,
)
def sbvh(triangles: Triangles, options: SpatialOptions, context: Context) -> Draft:
    """Build."""
    refs = References.of(triangles)
    n = len(refs)
    slack = int(options.budget * n)
    room = n + slack
    box = pack_boxes(refs, slack)
    centers = centers_twice(refs)
    orders = []
    for k in range(3):
        o = np.empty(room, np.int32)
        o[:n] = argsort_keys(float_keys(centers[:, k]), 32)
        orders.append(o)
    x, y, z = (refs.upper.max(0) - refs.lower.min(0)).tolist()
    work = _Work(
        triangles.corners,
        refs.scale,
        box,
        np.concatenate([refs.triangle, np.zeros(slack, np.int32)]),
        np.zeros(room, np.bool_),
        *orders,
        np.zeros(room, np.uint8),
        np.empty(room, np.int32),
        np.empty(room + 1, np.float32),
        np.full(2 * room - 1, -1, np.int32),
        np.full(2 * room - 1, -1, np.int32),
        np.full(2 * room - 1, -1, np.int32),
    )
    rules = _Rules(
        options.bins,
        options.alpha * (x * y + y * z + z * x),
        options.c_inner,
        options.c_tri,
        options.max_leaf,
        _SPATIAL_DEPTH,
        options.leafrule,
    )
    first = np.array([0, n, slack, n, 0, 0, 1], np.int64)
    queue = [(-n, 0, first)]
    running: dict[Future[Any], Any] = {}
    done = 0
    threads = numba.get_num_threads()
    with ThreadPoolExecutor(threads) as pool:
        while queue or running:
            while queue and len(running) < threads:
                _, _, task = heapq.heappop(queue)
                pending = np.empty((2, 7), np.int64)
                single = task[1] > _GRAIN
                running[pool.submit(_run, work, rules, task, single, pending)] = (task, pending)
            for f in wait(running, return_when=FIRST_COMPLETED).done:
                task, pending = running.pop(f)
                if f.result():
                    for p in pending:
                        heapq.heappush(queue, (-p[1], p[4], p.copy()))
                else:
                    done += task[1]
                    context.progress("splitting", done / room)
    left, right, reference, lower, upper, triangle = _compact(
        work.left, work.right, work.reference, box, work.triangle
    )
    return Draft(References(lower, upper, triangle, refs.scale), left, right, reference, {})
