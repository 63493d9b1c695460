"""`hill` and `anneal`: tree rotations, taken greedily or at random.

Kensler: *Tree Rotations for Improving Bounding Volume Hierarchies* (IEEE Symposium on
Interactive Ray Tracing 2008). A rotation at a node with children L and R exchanges two
subtrees below it, so that the node's own box stays and only the boxes of L, R or both
change::

    0: L  <-> RL    1: L  <-> RR    2: R <-> LL    3: R <-> LR
    4: LL <-> RR    5: LL <-> RL

(LR <-> RL and LR <-> RR give mirror images of 4 and 5.) The change of SAH is therefore
local and exact: the new areas of the one or two children, less the old ones. It is the SAH
of the tree with one reference a leaf; what a rotation is worth after the common leaf
collapse shows at the end, where the start tree is kept if it is the better one then.

`hill` sweeps bottom-up and takes at each node the best rotation, if that lowers SAH, until
a sweep changes nothing: no single rotation can lower SAH then.

`anneal` proposes one random rotation at each node in every sweep and takes it with
probability ``exp(-change / T)``. The paper's schedule is not known to us; ours is: climb
first; then ``T`` falls geometrically over ``sweeps`` sweeps, from ``hot`` to ``cold`` times
the mean area of an inner node; the best tree seen at the end of a sweep is kept, the climbed
one included, and hill climbing ends it. Climbing first makes the outcome no worse than
`hill`'s, and on every scene tried it was better than annealing the start tree itself.

Where the search starts is not told for the HPG 2013 comparison either. Kensler starts from
standard builders, so both start from `bbvh` unless told otherwise.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft
from mibvh.builders.finish import draft_sah
from mibvh.builders.options import Options, option
from mibvh.builders.registry import Context, builder
from mibvh.measures.boxes import of_corners
from mibvh.triangles import F32, I32, Triangles

#: A rotation must lower the sum of areas by this share of the node's area. It is far above
#: the rounding of the sums and far below anything that matters; without it, hill climbing
#: could go in circles.
_LEAST = 1e-12

#: Proposals between two calls of ``progress``.
_CHUNK = 1 << 21

# What hill climbing remembers of a node from one sweep to the next.
_DIRTY = np.uint8(1)  # something its rotations depend on has changed
_BELOW = np.uint8(2)  # there is a dirty node below it
_CHANGED = np.uint8(4)  # it was rotated in this sweep, which its parent must hear of


@njit(allocates=False)
def box_area(measure, box, a):
    """Measure of a node's box, in float64: half its surface area where ``measure`` is None."""
    if measure is not None:
        return of_corners(measure, box[a, 0], box[a, 1], box[a, 2], box[a, 3], box[a, 4], box[a, 5])
    x = np.float64(box[a, 3]) - np.float64(box[a, 0])
    y = np.float64(box[a, 4]) - np.float64(box[a, 1])
    z = np.float64(box[a, 5]) - np.float64(box[a, 2])
    return x * y + (x + y) * z


@njit(allocates=False)
def union_area(measure, box, a, b):
    """Measure of the box around two nodes."""
    if measure is not None:
        return of_corners(
            measure,
            min(box[a, 0], box[b, 0]),
            min(box[a, 1], box[b, 1]),
            min(box[a, 2], box[b, 2]),
            max(box[a, 3], box[b, 3]),
            max(box[a, 4], box[b, 4]),
            max(box[a, 5], box[b, 5]),
        )
    x = np.float64(max(box[a, 3], box[b, 3])) - np.float64(min(box[a, 0], box[b, 0]))
    y = np.float64(max(box[a, 4], box[b, 4])) - np.float64(min(box[a, 1], box[b, 1]))
    z = np.float64(max(box[a, 5], box[b, 5])) - np.float64(min(box[a, 2], box[b, 2]))
    return x * y + (x + y) * z


@njit(allocates=False)
def fit_box(left, right, box, node):
    """Make a node's box the one around its children."""
    a, b = left[node], right[node]
    for k in range(3):
        box[node, k] = min(box[a, k], box[b, k])
        box[node, k + 3] = max(box[a, k + 3], box[b, k + 3])


@njit(allocates=False)
def rotation_change(measure, left, right, box, node, kind):
    """By how much a rotation changes the sum of inner areas; inf if there is no such one."""
    a, b = left[node], right[node]
    if kind < 2:
        if left[b] < 0:
            return np.inf
        stays = right[b] if kind == 0 else left[b]
        return union_area(measure, box, a, stays) - box_area(measure, box, b)
    if kind < 4:
        if left[a] < 0:
            return np.inf
        stays = right[a] if kind == 2 else left[a]
        return union_area(measure, box, b, stays) - box_area(measure, box, a)
    if left[a] < 0 or left[b] < 0:
        return np.inf
    goes, stays = (right[b], left[b]) if kind == 4 else (left[b], right[b])
    after = union_area(measure, box, goes, right[a]) + union_area(measure, box, left[a], stays)
    return after - (box_area(measure, box, a) + box_area(measure, box, b))


@njit(allocates=False)
def rotate(left, right, box, node, kind):
    """Do one rotation, and fit the boxes of the children that it touches."""
    a, b = left[node], right[node]
    if kind == 0:
        left[node], left[b] = left[b], a
    elif kind == 1:
        left[node], right[b] = right[b], a
    elif kind == 2:
        right[node], left[a] = left[a], b
    elif kind == 3:
        right[node], right[a] = right[a], b
    elif kind == 4:
        left[a], right[b] = right[b], left[a]
    else:
        left[a], left[b] = left[b], left[a]
    if kind < 2 or kind > 3:
        fit_box(left, right, box, b)
    if kind > 1:
        fit_box(left, right, box, a)


@njit(allocates=False)
def _hill_chunk(measure, left, right, box, state, stack, top, steps):
    """Go on with a sweep of hill climbing, bottom-up, for at most so many steps.

    A sweep begins with the root alone on the stack and ends when the stack is empty. Nodes
    are only looked at where something has changed since they were last found to have no
    rotation to offer: the outcome is that of looking at all of them.

    Returns the new top of the stack and the number of rotations done.
    """
    done = 0
    for _ in range(steps):
        if top == 0:
            break
        top -= 1
        node = stack[top]
        if node >= 0:  # on the way down: come back to the node (~node) after its children
            stack[top] = ~node
            top += 1
            for child in (left[node], right[node]):
                if state[child]:
                    stack[top] = child
                    top += 1
            continue
        node = ~node
        a, b = left[node], right[node]
        dirty = (state[node] & _DIRTY) | ((state[a] | state[b]) & _CHANGED)
        state[a] &= ~_CHANGED
        state[b] &= ~_CHANGED
        own = np.uint8(0)
        if dirty:
            best, kind = -_LEAST * box_area(measure, box, node), -1
            for k in range(6):
                change = rotation_change(measure, left, right, box, node, k)
                if change < best:
                    best, kind = change, k
            if kind >= 0:
                rotate(left, right, box, node, kind)
                done += 1
                own = _DIRTY | _CHANGED
                # What now hangs below the touched children may hold dirty nodes.
                if kind < 2 or kind > 3:
                    state[b] = _DIRTY | _below(left, right, state, b)
                if kind > 1:
                    state[a] = _DIRTY | _below(left, right, state, a)
        state[node] = own | _below(left, right, state, node)
    return top, done


@njit(allocates=False)
def _below(left, right, state, node):
    if (state[left[node]] | state[right[node]]) & (_DIRTY | _BELOW):
        return _BELOW
    return np.uint8(0)


@njit(allocates=False)
def _mix(x):
    """Scramble a 64-bit counter (the finaliser of SplitMix64): the same bits everywhere."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(allocates=False)
def _anneal_chunk(measure, left, right, box, begin, end, seed, sweep, temperature, exponential):
    """Propose one random rotation at each inner node from ``begin`` to ``end``.

    With u uniform, ``u < exp(-change / T)`` says the same as ``change < T * -log(u)``;
    ``exponential`` is a table of ``-log(u)``, so that no processor's own ``exp`` has a say.
    Returns the rotations done and the change of the sum of areas.
    """
    done, changed = 0, 0.0
    key = _mix(_mix(seed) + sweep)
    for node in range(begin, end):
        if left[node] < 0:
            continue
        random = _mix(key + np.uint64(node) * np.uint64(0x9E3779B97F4A7C15))
        kind = np.int64(((random >> np.uint64(32)) * np.uint64(6)) >> np.uint64(32))
        change = rotation_change(measure, left, right, box, node, kind)
        if change < temperature * exponential[random & np.uint64(len(exponential) - 1)]:
            rotate(left, right, box, node, kind)
            done += 1
            changed += change
    return done, changed


@njit(allocates=False)
def inner_area(measure, left, box):
    """Sum of the measures of all inner nodes."""
    total = 0.0
    for node in range(len(left)):
        if left[node] >= 0:
            total += box_area(measure, box, node)
    return total


@njit
def _lay_out(left, right, reference, lower, upper):
    nodes = len(left)
    new_left = np.full(nodes, -1, np.int32)
    new_right = np.full(nodes, -1, np.int32)
    new_reference = np.full(nodes, -1, np.int32)
    count = np.ones(nodes, np.int32)
    box = np.empty((nodes, 6), np.float32)
    stack = np.empty((nodes // 2 + 1, 2), np.int32)  # nodes, and whose right children they are
    stack[0, 0], stack[0, 1], top = 0, -1, 1
    place = 0
    while top > 0:
        top -= 1
        node = stack[top, 0]
        if stack[top, 1] >= 0:
            new_right[stack[top, 1]] = place
        while left[node] >= 0:
            stack[top, 0], stack[top, 1] = right[node], place
            top += 1
            new_left[place] = place + 1
            node = left[node]
            place += 1
        new_reference[place] = reference[node]
        place += 1
    for node in range(nodes - 1, -1, -1):
        if new_left[node] < 0:
            for k in range(3):
                box[node, k] = lower[new_reference[node], k]
                box[node, k + 3] = upper[new_reference[node], k]
        else:
            count[node] = count[new_left[node]] + count[new_right[node]]
            fit_box(new_left, new_right, box, node)
    return new_left, new_right, new_reference, count, box


def depth_first(draft: Draft) -> tuple[I32, I32, I32, I32, F32]:
    """Lay a draft out depth-first, so that what is near in the tree is near in memory.

    Returns
    -------
    left, right, reference, count : (2R - 1,) int32
        The draft, parents before children, and the number of references below each node.
    box : (2R - 1, 6) float32
        Boxes of the nodes, lower corner then upper, in builder units.
    """
    refs = draft.references
    return _lay_out(draft.left, draft.right, draft.reference, refs.lower, refs.upper)


def climb(
    measure: Any, left: I32, right: I32, box: F32, most: int, context: Context
) -> tuple[int, int]:
    """Hill climbing in place, to a local minimum or for ``most`` sweeps.

    Returns
    -------
    sweeps, rotations : int
        How many were done; the last sweep did none unless there were ``most``.
    """
    state = np.where(left >= 0, _DIRTY | _BELOW, np.uint8(0))
    stack = np.zeros(len(left) + 2, np.int32)
    sweeps = rotations = 0
    while sweeps < most and len(left) > 1:
        stack[0], top, rotated = 0, 1, 0
        while top > 0:
            top, done = _hill_chunk(measure, left, right, box, state, stack, top, _CHUNK)
            rotated += done
            context.progress("hill climbing", 1.0 - 1.0 / (sweeps + 2))
        sweeps += 1
        rotations += rotated
        if rotated == 0:
            break
    context.progress("hill climbing", 1.0)
    return sweeps, rotations


def judged(
    measure: Any, start: Draft, end: Draft, options: Options, report: dict[str, Any]
) -> Draft:
    """Return the better one of two drafts after the collapse, with a report on both."""
    costs: dict[str, Any] = {
        name: getattr(options, name) for name in ("c_inner", "c_tri", "max_leaf")
    }
    costs["measure"] = measure
    start_sah, end_sah = draft_sah(start, **costs), draft_sah(end, **costs)
    better = end if end_sah <= start_sah else start
    report = {"start_sah": start_sah, "end_sah": min(start_sah, end_sah), **report}
    return dataclasses.replace(better, report=report)


@dataclasses.dataclass(frozen=True, kw_only=True)
class HillOptions(Options):
    """What `hill` takes."""

    start: str = option("bbvh", "builder of the tree to start from")
    sweeps: int = option(1000, "stop after so many sweeps, local minimum or not", 0, 1_000_000)


@builder(
    "hill",
    summary="tree rotations by hill climbing: the best of six at each node, to a local minimum",
    source="Kensler 2008",
    options=HillOptions,
    memory=300,
)
def hill(triangles: Triangles, options: HillOptions, context: Context) -> Draft:
    """Rotate until no rotation lowers SAH."""
    start = context.start(triangles, options.start, options)
    measure = context.compiled_measure(start.references.scale)
    left, right, reference, _, box = depth_first(start)
    sweeps, rotations = climb(measure, left, right, box, options.sweeps, context)
    end = Draft(start.references, left, right, reference)
    report = {"start": options.start, "iterations": sweeps, "rotations": rotations}
    return judged(measure, start, end, options, report)


@dataclasses.dataclass(frozen=True, kw_only=True)
class AnnealOptions(Options):
    """What `anneal` takes."""

    start: str = option("bbvh", "builder of the tree to start from")
    seed: int = option(0, "random numbers; another seed gives another tree", 0, 2**63 - 1)
    sweeps: int = option(600, "sweeps of annealing; more find better trees", 0, 1_000_000)
    hot: float = option(
        0.1, "first temperature, in mean inner areas; hotter forgets more of the start", 1e-12, 1e6
    )
    cold: float = option(1e-5, "last temperature, in mean inner areas", 1e-12, 1e6)


@builder(
    "anneal",
    summary="random tree rotations by simulated annealing, ended by hill climbing",
    source="Kensler 2008",
    options=AnnealOptions,
    memory=300,
)
def anneal(triangles: Triangles, options: AnnealOptions, context: Context) -> Draft:
    """Rotate at random while the temperature falls, and climb before and after."""
    start = context.start(triangles, options.start, options)
    measure = context.compiled_measure(start.references.scale)
    left, right, reference, _, box = depth_first(start)
    hill_sweeps, hill_rotations = climb(measure, left, right, box, HillOptions.sweeps, context)
    area = inner_area(measure, left, box)
    mean = area / max(len(left) // 2, 1)
    # Quantiles of the exponential distribution; float32, so that the last bit of
    # somebody's logarithm decides nothing.
    exponential = -np.log((np.arange(4096) + 0.5) / 4096).astype(np.float32)
    best, best_left, best_right = area, left.copy(), right.copy()
    accepted = 0
    for sweep in range(options.sweeps):
        done = sweep / max(options.sweeps - 1, 1)
        temperature = mean * options.hot ** (1.0 - done) * options.cold**done
        for begin in range(0, len(left), _CHUNK):
            taken, change = _anneal_chunk(
                measure,
                left,
                right,
                box,
                begin,
                min(begin + _CHUNK, len(left)),
                np.uint64(options.seed),
                np.uint64(sweep),
                temperature,
                exponential,
            )
            accepted += taken
            area += change
            context.progress("annealing", (sweep + begin / len(left)) / options.sweeps)
        if area < best:
            best = area
            best_left[:], best_right[:] = left, right
    best_draft = Draft(start.references, best_left, best_right, reference)
    left, right, reference, _, box = depth_first(best_draft)
    sweeps, rotations = climb(measure, left, right, box, HillOptions.sweeps, context)
    end = Draft(start.references, left, right, reference)
    scale = options.c_inner * mean / box_area(measure, box, 0) if area > 0 else 0.0
    report = {
        "start": options.start,
        "iterations": hill_sweeps + options.sweeps + sweeps,
        "rotations": hill_rotations + accepted + rotations,
        "accepted": accepted,
        # In units of SAH: a change of so much was taken with probability 1 / e.
        "temperatures": [scale * options.hot, scale * options.cold],
    }
    return judged(measure, start, end, options, report)
