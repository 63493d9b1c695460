"""`treelet` and `streelet`: exhaustive rearrangement of treelets.

Karras and Aila: *Fast Parallel Construction of High-Quality Bounding Volume Hierarchies*
(HPG 2013), known as TRBVH. A treelet is a node with a few of its descendants: it grows from
its root by opening, again and again, the treelet leaf of largest area, until it has n = 7
leaves. Of all binary trees over these n subtrees the best is found by dynamic programming
over their 2^n subsets s::

    c[s] = min( C_inner A[s] + min over p of (c[p] + c[s without p]),  C_tri A[s] T[s] )

where A[s] is the area of the box around the subset, T[s] the number of triangles in it, and
the second term, the subset as one leaf, is there as long as T[s] <= max_leaf. For a single
subtree c is the least cost of that subtree, which is kept for every node of the tree. The
treelet is rebuilt where that lowers its cost, so SAH after the leaf collapse never rises.

A round goes through all nodes with at least gamma references below, bottom-up; gamma is n
in the first round and doubles with each further one, as the small subtrees are the first to
have settled. Disjoint subtrees are rearranged in parallel: what happens below a node depends
on nothing else, so the tree is the same on any number of threads.

`streelet` is the same over the references that the triangle splitting of that paper makes
(:mod:`mibvh.builders.splitting`), and starts from the Morton tree over them unless told
otherwise.

A leaf of the finished tree holds a triangle once, however many of its parts are below. So
T[s] counts triangles, not parts, and where a leaf forms, the parts of a triangle in it become
one reference again. That is ours, not the paper's: its splitting spends the whole budget on
any scene, and a ground plane around a furnished room is cut into a grid of hundreds of cells
whose tree would otherwise stand above the room for good. For `treelet` it changes nothing.

The method is covered by US patents 10331632 (treelets) and 9547932 (splitting).
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

from mibvh.builders.draft import Draft, References
from mibvh.builders.options import Options, option
from mibvh.builders.registry import Context, builder
from mibvh.builders.rotations import depth_first, judged
from mibvh.builders.splitting import as_boxes, over_parts, presplit
from mibvh.builders.subtrees import (
    NONE_SPLIT,
    Costs,
    Nodes,
    join_small,
    owners,
    subtree_costs,
    without_joined,
)
from mibvh.builders.treelet_search import improve_all, improve_subtrees, nodes_above
from mibvh.parallel import run_blocks, thread_count
from mibvh.triangles import I32, Triangles

#: References in the subtrees of one parallel step: well under a second of work, so that
#: progress is shown and Ctrl-C heard.
_STEP = 1 << 17
#: Disjoint subtrees that a thread takes at a time.
_ROOTS = 4


def _improve_disjoint(roots: I32, least: int, arrays: tuple[Any, ...]) -> tuple[int, int]:
    """Rearrange disjoint subtrees on several threads; the outcome is the same for any number."""
    done = np.zeros((thread_count(), 2), np.int64)

    def work(worker: int, begin: int, end: int) -> None:
        done[worker] += improve_subtrees(roots[begin:end], least, *arrays)

    run_blocks(work, len(roots), _ROOTS)
    looked, rebuilt = done.sum(axis=0)
    return int(looked), int(rebuilt)


def rearrange(draft: Draft, options: RearrangeOptions, context: Context) -> Draft:
    """Rearrange the treelets of a draft, round by round.

    Parameters
    ----------
    draft : Draft
        The start tree.
    options : RearrangeOptions
        The treelets' size, the rounds, the costs.
    context : Context
        Told of the progress.

    Returns
    -------
    Draft
        With ``start_sah``, ``end_sah``, ``iterations`` (rounds), and the treelets looked at
        and rebuilt in its report.
    """
    measure = context.compiled_measure(draft.references.scale)
    costs = Costs(options.c_inner, options.c_tri, options.max_leaf, measure)
    left, right, reference, count, box = depth_first(draft)
    cost = subtree_costs(left, right, box, count, *costs)
    nodes = Nodes(left, right, box, count, cost)
    owner = NONE_SPLIT
    if options.rounds:
        owner = owners(draft.references.triangle, left, reference)
    if len(owner) > 0:
        join_small(owner, nodes, costs)
    # A scene of fewer triangles is a smaller treelet.
    size = min(options.size, int(count[0]))
    rounds = options.rounds if size > 2 else 0
    arrays = (size, owner, nodes, costs)
    # Subtrees of at most `limit` references are the units of parallel work; the few nodes
    # above them follow. The limit depends on the scene alone, as the outcome must.
    limit = max(256, len(draft.references) // 256)
    looked, rebuilt = 0, 0
    for turn in range(rounds):
        least = size << turn
        top, heights = nodes_above(0, max(limit + 1, least), left, right, count)
        roots = np.concatenate([left[top], right[top]]) if len(top) else np.zeros(1, np.int32)
        roots = np.sort(roots[(count[roots] <= limit) & (count[roots] >= least)])
        ends = np.cumsum(count[roots], dtype=np.int64)
        cuts = np.searchsorted(ends, np.arange(0, len(left) + _STEP, _STEP))
        for begin, end in itertools.pairwise(cuts):
            if begin < end:
                done = _improve_disjoint(roots[begin:end], least, arrays)
                looked, rebuilt = looked + done[0], rebuilt + done[1]
                context.progress("treelets", (turn + end / len(roots)) / rounds)
        begin = 0
        for ends in np.split(heights, range(_STEP, len(heights), _STEP)):
            rebuilt += improve_all(top[begin:], ends - begin, *arrays)
            begin = ends[-1] if len(ends) else begin
        looked += len(top)
    if len(owner) > 0:
        result = without_joined(draft.references.scale, owner, left, right, box)
    else:
        result = Draft(draft.references, left, right, reference)
    report = {"iterations": rounds, "treelets": looked, "rebuilt": rebuilt}
    return judged(measure, draft, result, options, report)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RearrangeOptions(Options):
    """What `treelet` and `streelet` have in common."""

    size: int = option(7, "leaves of a treelet; one more triples the time", 4, 8)
    rounds: int = option(3, "passes over the tree; later ones leave small subtrees out", 0, 24)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TreeletOptions(RearrangeOptions):
    """What `treelet` takes."""

    start: str = option("lbvh", "builder of the tree to start from")


@dataclasses.dataclass(frozen=True, kw_only=True)
class SplitTreeletOptions(RearrangeOptions):
    """What `streelet` takes."""

    beta: float = option(
        0.3, "references that splitting may add, per triangle; more overlap less", 0.0, 8.0
    )
    base: str = option("lbvh", "builder of the tree over the parts; bbvh is slower and better")


@builder(
    "treelet",
    summary="TRBVH: the best rearrangement of every treelet of 7 subtrees, bottom-up, repeated",
    source="Karras and Aila 2013",
    options=TreeletOptions,
    memory=230,
)
def treelet(triangles: Triangles, options: TreeletOptions, context: Context) -> Draft:
    """Rearrange the treelets of a start tree."""
    draft = context.start(triangles, options.start, options)
    draft = rearrange(draft, options, context)
    draft.report["start"] = options.start
    return draft


def start_over(references: References, options: SplitTreeletOptions, context: Context) -> Draft:
    """Build the start tree over given references."""
    draft = context.start(as_boxes(references), options.base, options)
    return dataclasses.replace(over_parts(draft, references, options.base), report={})


@builder(
    "streelet",
    summary="triangle splitting, a Morton tree over the parts, then `treelet`",
    source="Karras and Aila 2013",
    options=SplitTreeletOptions,
    memory=400,
)
def streelet(triangles: Triangles, options: SplitTreeletOptions, context: Context) -> Draft:
    """Split triangles up front, and rearrange the treelets of a start tree over the parts."""
    context.progress("splitting", 0.0)
    references = presplit(triangles, options.beta)
    context.progress("splitting", 1.0)
    draft = rearrange(start_over(references, options, context), options, context)
    draft.report["base"] = options.base
    draft.report["references"] = len(references)
    draft.report["joined"] = len(references) - len(draft.references)
    return draft
