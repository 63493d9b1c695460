"""Splitting and merging references of a finished tree, where that lowers its cost.

A reference is taken out of the tree, cut in two at a plane, and both parts are put where they
cost least (the search of :mod:`mibvh.builders.rows`); or two references of a triangle are
taken out and the box around both is put back. What is kept is what lowers::

    C_inner * sum of the inner nodes' measures + C_tri * sum of the references' measures

Splits in a top-down builder are chosen before the tree below is known. Here all of the tree is
known, and the gain is exact but for the leaf collapse that follows.

Stages of a pass
----------------
1. References by falling measure: what few rays meet is not worth a trial.
2. Cut each at the best of a few planes per axis: that of least summed measure.
3. Take it out, find the best places of both parts, the larger first, and keep them there if the
   cost falls by more than the price of a reference; otherwise put the reference back.
4. For triangles of several references, try to merge each with the one that it fits best.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.finish import draft_boxes
from mibvh.builders.options import Options
from mibvh.builders.registry import Context
from mibvh.builders.rows import insert, measure_of, refit, remove, rows_of, search
from mibvh.builders.splitting import MAX_CORNERS, pack_boxes, split_reference
from mibvh.measures.boxes import of_corners
from mibvh.triangles import I32, Triangles

#: Planes tried per axis of a reference, at even distances.
_PLANES = 3
#: References tried between two reports of progress.
_CHUNK = 4096
#: References of a triangle beyond these are not compared with each other to be merged.
_MOST_PARTS = 64


@njit
def _entries(rows, used, entry_of):
    """Note the entry of each reference."""
    links = rows.view(np.int32)
    for row in range(used):
        for side in range(2):
            link = links[row, (side << 3) + 7]
            if link < 0 and (row > 0 or side == 0):
                entry_of[~link] = 2 * row + side


@njit
def _take_out(measure, rows, links, up, entry_of, entry):
    """Remove an entry; return what is saved, where its sibling is now, and which row is free."""
    row = entry >> 1
    saved, place = remove(measure, rows, links, up, entry)
    link = links[place >> 1, ((place & 1) << 3) + 7]
    if link < 0:
        entry_of[~link] = place
    return saved, place, row


@njit
def _put(measure, rows, links, up, entry_of, place, row, box, link):
    """Insert an entry, and note where the two leaves are, if they are leaves."""
    insert(measure, rows, links, up, place, row, box, link)
    for side in range(2):
        below = links[row, (side << 3) + 7]
        if below < 0:
            entry_of[~below] = 2 * row + side


@njit
def _put_back(measure, rows, links, up, entry_of, place, entry, box, link):
    """Undo :func:`_take_out`: the entry is again the one it was."""
    row, at = entry >> 1, (entry & 1) << 3
    above, at_above = place >> 1, (place & 1) << 3
    for i in range(8):
        links[row, 8 - at + i] = links[above, at_above + i]
    for i in range(7):
        rows[row, at + i] = box[i]
    links[row, at + 7] = link
    for side in range(2):
        below = links[row, (side << 3) + 7]
        if below > 0:
            up[below] = 2 * row + side
        else:
            entry_of[~below] = 2 * row + side
    links[above, at_above + 7] = row
    up[row] = place
    refit(measure, rows, up, row)


@njit
def _measure_row(measure, box):
    """Measure of a box in the form of :mod:`mibvh.builders.simd`."""
    return of_corners(measure, box[0], box[1], box[2], -box[4], -box[5], -box[6])


@njit
def _best_cut(measure, corners, triangle, scale, boxes, row, halves, trial, polygon, spare):
    """Cut a reference at the plane of least summed measure; return the sum, inf if none cuts."""
    best, best_even = np.inf, np.inf
    for axis in range(3):
        low, high = boxes[row, axis], -boxes[row, axis + 4]
        for i in range(_PLANES):
            plane = low + (high - low) * np.float32((i + 1) / (_PLANES + 1))
            if not low < plane < high:
                continue
            found = split_reference(
                corners,
                triangle,
                scale,
                boxes,
                row,
                axis,
                plane,
                trial[0],
                trial[1],
                polygon,
                spare,
            )
            if found != 3:
                continue
            a, b = _measure_row(measure, trial[0]), _measure_row(measure, trial[1])
            if a + b < best or (a + b == best and max(a, b) < best_even):
                best, best_even = a + b, max(a, b)
                for k in range(8):
                    # The larger first.
                    halves[0, k] = trial[0, k] if a >= b else trial[1, k]
                    halves[1, k] = trial[1, k] if a >= b else trial[0, k]
    return best


@njit
def _to_box(measure, half, box):
    """Write a box of :mod:`mibvh.builders.simd` as insertion takes it."""
    for k in range(3):
        box[k], box[k + 3] = half[k], -half[k + 4]
    box[6] = _measure_row(measure, half)


class Parts(NamedTuple):
    """The references, and the tree of them, with room for more."""

    boxes: Any  #: (capacity, 8) float32; new references go behind
    triangle: Any  #: (capacity,) int32: of each reference; -1 for those that are gone
    rows: Any  #: (capacity, 16) float32: the tree, as in :mod:`mibvh.builders.rows`
    up: Any  #: (capacity,) int32
    entry_of: Any  #: (capacity,) int32: where each reference is in the tree
    free: Any  #: (capacity,) int32: rows not in use; the first ``tally[1]`` of them
    #: (4,) int64: references ever made, free rows, references in use, and splits
    tally: Any


@njit
def _split_some(measure, corners, scale, parts, chosen, heap, rules):
    """Try to split the chosen references, in turn.

    Parameters
    ----------
    parts : Parts
    chosen : (n,) int32
    heap : (capacity,) float64 and int32
        Scratch of the search.
    rules : (c_inner, c_tri, price, most references)
    """
    boxes, triangle, rows, up, entry_of, free, tally = parts
    links = rows.view(np.int32)
    keys, queue = heap
    c_inner, c_tri, price, most = rules
    polygon = np.empty((MAX_CORNERS, 3), np.float64)
    spare = np.empty((MAX_CORNERS, 3), np.float64)
    halves, trial = np.zeros((2, 8), np.float32), np.zeros((2, 8), np.float32)
    space = np.zeros((3, 7), np.float32)
    whole, first, second = space[0], space[1], space[2]
    for r in chosen:
        if tally[2] >= most or tally[0] >= len(triangle) or triangle[r] < 0:
            continue
        halved = _best_cut(
            measure, corners, triangle[r], scale, boxes, r, halves, trial, polygon, spare
        )
        if halved == np.inf:
            continue
        entry = entry_of[r]
        if entry == 0:
            continue
        _copy_box(rows, entry, whole)
        own = measure_of(measure, rows, entry >> 1, (entry & 1) << 3)
        _to_box(measure, halves[0], first)
        _to_box(measure, halves[1], second)
        saved, place, row = _take_out(measure, rows, links, up, entry_of, entry)
        # What the two insertions may cost together.
        limit = saved + (c_tri * (own - halved) - price * own) / c_inner
        least = _measure_row(measure, halves[1])
        to, cost = search(measure, rows, links, up, first, place, limit - least, keys, queue)
        if to >= 0:
            _put(measure, rows, links, up, entry_of, to, row, first, ~r)
            here = entry_of[r]
            to, _ = search(measure, rows, links, up, second, here, limit - cost, keys, queue)
            if to >= 0:
                new, tally[0] = np.int32(tally[0]), tally[0] + 1
                tally[1] -= 1
                _put(measure, rows, links, up, entry_of, to, free[tally[1]], second, ~new)
                for k in range(8):
                    boxes[r, k], boxes[new, k] = halves[0, k], halves[1, k]
                triangle[new] = triangle[r]
                tally[2] += 1
                tally[3] += 1
                continue
            _take_out(measure, rows, links, up, entry_of, here)
        _put_back(measure, rows, links, up, entry_of, place, entry, whole, ~r)


@njit
def _copy_box(rows, entry, box):
    """Copy an entry's box and measure."""
    for k in range(7):
        box[k] = rows[entry >> 1, ((entry & 1) << 3) + k]


@njit
def _joint_measure(measure, boxes, a, b):
    """Measure of the box around two references."""
    return of_corners(
        measure,
        min(boxes[a, 0], boxes[b, 0]),
        min(boxes[a, 1], boxes[b, 1]),
        min(boxes[a, 2], boxes[b, 2]),
        -min(boxes[a, 4], boxes[b, 4]),
        -min(boxes[a, 5], boxes[b, 5]),
        -min(boxes[a, 6], boxes[b, 6]),
    )


@njit
def _merge_some(measure, parts, order, starts, heap, rules):
    """Try to merge references of each triangle.

    ``order`` are references by triangle, those of the i-th from ``starts[i]`` on; otherwise as
    for :func:`_split_some`.
    """
    boxes, triangle, rows, up, entry_of, free, tally = parts
    links = rows.view(np.int32)
    keys, queue = heap
    c_inner, c_tri, price, _ = rules
    space = np.zeros((3, 7), np.float32)
    first, second, joint = space[0], space[1], space[2]
    for i in range(len(starts) - 1):
        for j in range(starts[i], min(starts[i + 1], starts[i] + _MOST_PARTS)):
            a = order[j]
            # The partner that adds least.
            partner, least = -1, np.inf
            for k in range(j + 1, min(starts[i + 1], starts[i] + _MOST_PARTS)):
                if triangle[order[k]] >= 0:
                    both = _joint_measure(measure, boxes, a, order[k])
                    row, at = entry_of[order[k]] >> 1, (entry_of[order[k]] & 1) << 3
                    added = both - measure_of(measure, rows, row, at)
                    if added < least:
                        partner, least = order[k], added
            if partner < 0:
                continue
            b = partner
            _copy_box(rows, entry_of[a], first)
            _copy_box(rows, entry_of[b], second)
            for k in range(3):
                joint[k] = min(first[k], second[k])
                joint[k + 3] = max(first[k + 3], second[k + 3])
            united = _joint_measure(measure, boxes, a, b)
            joint[6] = united
            own_a = measure_of(measure, rows, entry_of[a] >> 1, (entry_of[a] & 1) << 3)
            own_b = measure_of(measure, rows, entry_of[b] >> 1, (entry_of[b] & 1) << 3)
            entry_a = entry_of[a]
            saved_a, place_a, row_a = _take_out(measure, rows, links, up, entry_of, entry_a)
            entry_b = entry_of[b]
            if entry_b == 0:
                _put_back(measure, rows, links, up, entry_of, place_a, entry_a, first, ~a)
                continue
            saved_b, place_b, row_b = _take_out(measure, rows, links, up, entry_of, entry_b)
            limit = saved_a + saved_b
            limit += (c_tri * (own_a + own_b - united) + price * min(own_a, own_b)) / c_inner
            to, _ = search(measure, rows, links, up, joint, place_b, limit, keys, queue)
            if to >= 0:
                _put(measure, rows, links, up, entry_of, to, row_b, joint, ~b)
                free[tally[1]] = row_a
                tally[1] += 1
                for k in range(3):
                    boxes[b, k], boxes[b, k + 4] = joint[k], -joint[k + 3]
                triangle[a] = -1
                tally[2] -= 1
                continue
            _put_back(measure, rows, links, up, entry_of, place_b, entry_b, second, ~b)
            _put_back(measure, rows, links, up, entry_of, place_a, entry_a, first, ~a)


@njit
def _measures_of(measure, boxes, triangle):
    """Measure of each reference; -1 for those that are gone."""
    out = np.full(len(triangle), -1.0)
    for r in range(len(triangle)):
        if triangle[r] >= 0:
            out[r] = _measure_row(measure, boxes[r])
    return out


@njit
def _to_links(rows, leaves):
    """Turn rows into links of a draft, parents first, with references numbered as they come."""
    links = rows.view(np.int32)
    left = np.full(2 * leaves - 1, -1, np.int32)
    right = np.full(2 * leaves - 1, -1, np.int32)
    reference = np.full(2 * leaves - 1, -1, np.int32)
    order = np.empty(leaves, np.int32)
    stack = np.empty((leaves + 1, 2), np.int32)
    stack[0, 0], stack[0, 1], top = links[0, 7], 0, 1
    made, found = 1, 0
    while top > 0:
        top -= 1
        link, node = stack[top, 0], stack[top, 1]
        if link < 0:
            reference[node], order[found] = found, ~link
            found += 1
            continue
        left[node], right[node] = made, made + 1
        stack[top, 0], stack[top, 1] = links[link, 15], made + 1
        stack[top + 1, 0], stack[top + 1, 1] = links[link, 7], made
        made += 2
        top += 2
    return left, right, reference, order


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rules:
    """What splitting and merging go by.

    Attributes
    ----------
    budget : float
        References at most, per triangle beyond the first.
    price : float
        What a reference costs beside its tests, in shares of the measure of what is split.
    trials : float
        References tried in a pass, at most, per triangle.
    """

    budget: float
    price: float = 0.0
    trials: float = 0.5


class Resplitter:
    """A tree whose references are split and merged."""

    def __init__(
        self, triangles: Triangles, start: Draft, options: Options, measure: Any, rules: Rules
    ) -> None:
        refs = start.references
        n = len(refs)
        self.most = max(n, int((1.0 + rules.budget) * len(triangles)))
        # Split references never give their number back, so there is room for later passes.
        room = n + 2 * (self.most - n) + 1024
        boxes = draft_boxes(start)
        rows, up = rows_of(start.left, start.right, start.reference, boxes, measure)
        self.rows = np.zeros((room, 16), np.float32)
        self.up = np.full(room, -1, np.int32)
        self.rows[:n], self.up[:n] = rows, up
        self.boxes = np.zeros((room, 8), np.float32)
        self.boxes[:n] = pack_boxes(refs)
        self.triangle: I32 = np.full(room, -1, np.int32)
        self.triangle[:n] = refs.triangle
        self.entry_of = np.full(room, -1, np.int32)
        _entries(self.rows, n, self.entry_of)
        self.free = np.arange(room, dtype=np.int32)[::-1].copy()
        self.heap = np.empty(room, np.float64), np.empty(room, np.int32)
        self.tally = np.array([n, room - n, n, 0], np.int64)
        self.triangles, self.scale, self.measure = triangles, refs.scale, measure
        self.tried_at_most = max(1, int(rules.trials * len(triangles)))
        self.rules = (max(options.c_inner, 1e-12), options.c_tri, rules.price, self.most)

    def _parts(self) -> Parts:
        return Parts(
            self.boxes, self.triangle, self.rows, self.up, self.entry_of, self.free, self.tally
        )

    def split(self, context: Context) -> int:
        """Try to split the references of greatest measure; return how many were."""
        before = self.tally[3]
        values = _measures_of(self.measure, self.boxes, self.triangle)
        order = np.argsort(-values, kind="stable")[: self.tried_at_most]
        order = order[values[order] >= 0].astype(np.int32)
        for begin in range(0, len(order), _CHUNK):
            _split_some(
                self.measure,
                self.triangles.corners,
                self.scale,
                self._parts(),
                order[begin : begin + _CHUNK],
                self.heap,
                self.rules,
            )
            context.progress("splitting references", begin / len(order))
        return int(self.tally[3] - before)

    def merge(self, context: Context) -> int:
        """Try to merge references of one triangle; return how many are gone."""
        before = self.tally[2]
        alive = np.flatnonzero(self.triangle >= 0).astype(np.int32)
        owner = self.triangle[alive]
        several = np.bincount(owner)[owner] > 1
        alive, owner = alive[several], owner[several]
        order = alive[np.argsort(owner, kind="stable")]
        starts = np.flatnonzero(np.diff(np.sort(owner), prepend=-1)).astype(np.int64)
        starts = np.append(starts, len(order))
        for begin in range(0, len(starts) - 1, _CHUNK):
            some = starts[begin : begin + _CHUNK + 1]
            _merge_some(self.measure, self._parts(), order, some, self.heap, self.rules)
            context.progress("merging references", begin / len(starts))
        return int(before - self.tally[2])

    def draft(self, report: dict[str, Any]) -> Draft:
        """Return the tree as a draft."""
        left, right, reference, order = _to_links(self.rows, int(self.tally[2]))
        boxes = self.boxes[order]
        refs = References(
            boxes[:, :3].copy(), -boxes[:, 4:7], self.triangle[order].copy(), self.scale
        )
        return Draft(refs, left, right, reference, report)
