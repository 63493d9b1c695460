"""`bittner`: insertion-based optimisation of a finished tree.

Bittner, Hapala, Havran: *Fast Insertion-Based Optimization of Bounding Volume Hierarchies*
(Computer Graphics Forum 32(1), 2013). What counts is the sum of the areas of the inner
nodes; the leaves' part of the SAH cannot change while each holds one reference. Batch by
batch, nodes that look inefficient are taken out and their children put where they cost
least:

1. *Select* the hundredth of the inner nodes with the highest inefficiency, the product of
   ``M_SUM`` (area over the mean area of the children), ``M_MIN`` (area over the lesser of
   them) and ``M_AREA`` (area).
2. *Remove* a selected node and its parent: the sibling takes the parent's place, and the
   boxes above shrink.
3. *Search* the best place for each of the two children, the larger first. A node X as a
   new sibling costs the area of the joint box, plus what the nodes above X grow: the
   induced cost. Branch and bound in the order of induced cost ends where that plus the
   child's own area is no less than the best so far. The bound is good from the start, as
   the place the child came from is a candidate.
4. *Insert* the child there, refit upwards.

After ``random_after`` batches without gain nodes are selected at random, and after
``patience`` of them it is over; a gain counts both from zero.

One departure from the paper, as the default and with ``undo=False`` to be without it: a
node whose children found no better places is put back, and is not selected again before
all others had their turn. Where the tree was good already, the paper's rule ends above the
start (in SAH, from `bbvh` on the bunny of 70 thousand triangles: 1.2% above, with undoing
1.0% below).

The tree is kept as rows with the boxes of both children (:mod:`mibvh.builders.rows`). Areas are
computed in float64 from float32 boxes, so that the
gains of a million moves add up to the change of the tree's cost.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.builders.draft import Draft
from mibvh.builders.finish import draft_boxes, draft_sah
from mibvh.builders.options import Options, option
from mibvh.builders.registry import Context, builder
from mibvh.builders.rows import draft_of, insert, measure_of, remove, rows_of, search
from mibvh.triangles import F32, I32, Triangles

#: Nodes handled between two reports of progress.
_CHUNK = 8192
#: The area a child counts at least for, as a part of its parent's: inefficiency stays finite.
_LEAST = 1e-6
#: A move must gain this part of the moved node's area, or it is rounding.
_GAIN = 1e-6


@dataclasses.dataclass(frozen=True, kw_only=True)
class InsertionOptions(Options):
    """Options of `bittner`."""

    start: str = option("bbvh", "builder of the tree to improve; the better it is, the better ends")
    batch: float = option(0.01, "part of the nodes selected at once; more is coarser", 1e-6, 1.0)
    patience: int = option(10, "stop after so many batches without gain", 1, 1_000_000)
    random_after: int = option(
        5, "select at random after so many batches without gain", 1, 1_000_000
    )
    tolerance: float = option(
        1e-6, "least relative gain of a batch that counts; 0 goes on to the last move", 0.0, 1.0
    )
    undo: bool = option(True, "put a node back if moving its children gains nothing")
    seed: int = option(0, "seed of the random selection", 0, 2**63 - 1)


@njit(allocates=False)
def _move(measure, rows, links, up, node, undo, boxes, keys, queue):
    """Remove a node and its parent, reinsert its two children.

    Returns
    -------
    moved : bool
        False where the node was put back.
    saved : float
        The area the tree loses.
    """
    larger = 0 if measure_of(measure, rows, node, 0) >= measure_of(measure, rows, node, 8) else 8
    entry = up[node]
    parent = entry >> 1
    for i in range(7):
        boxes[0, i] = rows[node, larger + i]
        boxes[1, i] = rows[node, 8 - larger + i]
        boxes[2, i] = rows[parent, ((entry & 1) << 3) + i]
    link_0, link_1 = links[node, larger + 7], links[node, 15 - larger]
    least_1 = measure_of(measure, rows, node, 8 - larger)
    own = measure_of(measure, rows, parent, (entry & 1) << 3)
    saved, place = remove(measure, rows, links, up, entry)
    saved += own
    limit = saved - _GAIN * own if undo else np.inf
    to, cost_0 = search(measure, rows, links, up, boxes[0], place, limit - least_1, keys, queue)
    if to >= 0:
        insert(measure, rows, links, up, to, node, boxes[0], link_0)
        near = 2 * node + 1
        to, cost_1 = search(measure, rows, links, up, boxes[1], near, limit - cost_0, keys, queue)
        if to >= 0:
            insert(measure, rows, links, up, to, parent, boxes[1], link_1)
            return True, saved - cost_0 - cost_1
        remove(measure, rows, links, up, near)
    for i in range(7):
        rows[node, i], rows[node, i + 8] = boxes[0, i], boxes[1, i]
    links[node, 7], links[node, 15] = link_0, link_1
    if link_0 > 0:
        up[link_0] = 2 * node
    if link_1 > 0:
        up[link_1] = 2 * node + 1
    insert(measure, rows, links, up, place, parent, boxes[2], node)
    return False, 0.0


@njit
def _batch(measure, rows, up, selected, batch, done_in, tried, undo, keys, queue):
    """Move the selected nodes in turn; return how many moved, and the area saved.

    A row that this batch has used already is another node by now, and is left alone:
    ``done_in`` holds the last batch that each row was used in.
    """
    links = rows.view(np.int32)
    boxes = np.zeros((3, 7), np.float32)
    moves, saved = 0, 0.0
    for node in selected:
        parent = up[node] >> 1
        if parent == 0 or done_in[node] == batch:
            continue
        moved, gain = _move(measure, rows, links, up, node, undo, boxes, keys, queue)
        done_in[node] = batch
        if moved:
            done_in[parent] = batch
            tried[node], tried[parent] = False, False
            moves += 1
            saved += gain
        else:
            tried[node] = True
    return moves, saved


@njit
def _inefficiency(measure, rows, up, tried):
    """M_COMB of each row; 0 for rows that cannot be selected. Also the tree's summed area."""
    out = np.zeros(len(rows), np.float32)
    total = 0.0
    for r in range(1, len(rows)):
        area = measure_of(measure, rows, up[r] >> 1, (up[r] & 1) << 3)
        total += area
        if up[r] > 0 and not tried[r] and area > 0:
            a, b = measure_of(measure, rows, r, 0), measure_of(measure, rows, r, 8)
            least = max(min(a, b), _LEAST * area)
            mean = max(0.5 * (a + b), _LEAST * area)
            out[r] = (area / mean) * (area / least) * area
    return out, total


def _most(values: F32, count: int) -> I32:
    """Pick the ``count`` greatest values that are not 0; their indices in rising order.

    A partial sort is enough. Of equal values the first are taken, on any machine.
    """
    threshold = np.partition(values, len(values) - count)[len(values) - count]
    chosen = values > threshold
    if threshold > 0:
        equal = np.flatnonzero(values == threshold)
        chosen[equal[: count - np.count_nonzero(chosen)]] = True
    return np.flatnonzero(chosen).astype(np.int32)


class _Optimiser:
    """The state of an optimisation, and one batch of it at a time."""

    def __init__(self, draft: Draft, options: InsertionOptions, measure: Any = None) -> None:
        boxes = draft_boxes(draft)
        self.rows, self.up = rows_of(draft.left, draft.right, draft.reference, boxes, measure)
        self.measure = measure
        n = len(self.rows)
        self.options = options
        self.count = max(1, int(n * options.batch))
        self.random = np.random.default_rng(options.seed)
        self.tried: npt.NDArray[np.bool_] = np.zeros(n, np.bool_)
        self.done_in = np.zeros(n, np.int32)
        self.heap = np.empty(n, np.float64), np.empty(n, np.int32)
        self.batches = self.moves = self.reinsertions = 0
        self.cost = _inefficiency(self.measure, self.rows, self.up, self.tried)[1]

    def select(self, at_random: bool) -> I32:
        """Rows of the next batch, in the order they have in memory; none if all is said."""
        values, _ = _inefficiency(self.measure, self.rows, self.up, self.tried)
        if not values.any():
            self.tried[:] = False
            values, _ = _inefficiency(self.measure, self.rows, self.up, self.tried)
        if at_random:
            able = np.flatnonzero(values)
            if len(able) == 0:
                return able.astype(np.int32)
            drawn = self.random.integers(0, len(able), self.count)
            return np.unique(able[drawn]).astype(np.int32)
        return _most(values, self.count)

    def batch(self, selected: I32, context: Context) -> None:
        """Move the selected nodes."""
        self.batches += 1
        self.reinsertions += 2 * len(selected)
        for begin in range(0, len(selected), _CHUNK):
            moves, saved = _batch(
                self.measure,
                self.rows,
                self.up,
                selected[begin : begin + _CHUNK],
                self.batches,
                self.done_in,
                self.tried,
                self.options.undo,
                *self.heap,
            )
            self.moves += moves
            self.cost -= saved
            # Nobody knows how many batches there will be; most gain is in the first hundred.
            context.progress("reinserting nodes", self.batches / (self.batches + 100))


@builder(
    "bittner",
    summary="insertion-based optimisation: move the children of inefficient nodes where they "
    "cost least",
    source="Bittner, Hapala, Havran 2013",
    options=InsertionOptions,
    memory=300,
)
def bittner(triangles: Triangles, options: InsertionOptions, context: Context) -> Draft:
    """Improve a tree by reinsertion; never returns one of higher SAH than it started from."""
    start = context.start(triangles, options.start, options)
    draft = reinserted(start, options, context)
    draft.report["start"] = options.start
    return draft


def moved(start: Draft, options: InsertionOptions, context: Context) -> Draft:
    """Move nodes of a draft until batches gain little: parameters as for :func:`reinserted`.

    The sum of the inner nodes' measures never rises, but the SAH of the collapsed tree may.
    """
    state = _Optimiser(start, options, context.compiled_measure(start.references.scale))
    best, best_rows, failures = state.cost, state.rows, 0
    while failures < options.patience:
        selected = state.select(failures >= options.random_after)
        if len(selected) == 0:
            break
        if best_rows is state.rows and not options.undo:
            best_rows = state.rows.copy()  # what follows may be worse
        state.batch(selected, context)
        failures += 1
        if state.cost < best:
            if state.cost < best * (1 - options.tolerance):
                failures = 0
            best, best_rows = state.cost, state.rows
    context.progress("reinserting nodes", 1.0)
    report = {
        **start.report,
        "iterations": state.batches,
        "moves": state.moves,
        "reinsertions": state.reinsertions,
    }
    return draft_of(best_rows, start.references, report)


def reinserted(start: Draft, options: InsertionOptions, context: Context) -> Draft:
    """Improve a draft by reinsertion.

    Parameters
    ----------
    start : Draft
    options : InsertionOptions
    context : Context
        Whose measure counts, and who is told of the progress.

    Returns
    -------
    Draft
        The start itself, with another report, where nothing better was found.
    """
    measure = context.compiled_measure(start.references.scale)
    common: dict[str, Any] = {
        "c_inner": options.c_inner,
        "c_tri": options.c_tri,
        "max_leaf": options.max_leaf,
        "measure": measure,
    }
    start_sah = draft_sah(start, **common)
    draft = moved(start, options, context)
    # What the start says of its own start is overwritten.
    report = {**draft.report, "start_sah": start_sah, "end_sah": start_sah}
    draft = dataclasses.replace(draft, report=report)
    report["end_sah"] = draft_sah(draft, **common)
    if report["end_sah"] > start_sah:
        report["end_sah"] = start_sah
        return dataclasses.replace(start, report=report)
    return draft
