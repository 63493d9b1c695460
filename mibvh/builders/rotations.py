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
probability ``exp(-change / T)``. The paper's schedule is not known to us; ours is: ``T``
falls geometrically over ``sweeps`` sweeps, from ``hot`` to ``cold`` times the mean area of
an inner node of the start tree. The best tree seen at the end of a sweep is kept, and hill
climbing ends it.

Where the search starts is not told for the HPG 2013 comparison either. Kensler starts from
standard builders, so both start from `bbvh` unless told otherwise.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft
from mibvh.builders.finish import _preorder, draft_boxes, draft_sah
from mibvh.builders.registry import Context, Options, builder, option
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


@njit
def box_area(box, a):
    """Half the surface area of a node's box, in float64 (of the float32 box: no rounding
    worth a thought)."""
    x = np.float64(box[a, 3]) - np.float64(box[a, 0])
    y = np.float64(box[a, 4]) - np.float64(box[a, 1])
    z = np.float64(box[a, 5]) - np.float64(box[a, 2])
    return x * y + (x + y) * z


@njit
def _union_area(box, a, b):
    """Half the surface area of the box around two nodes."""
    x = np.float64(max(box[a, 3], box[b, 3])) - np.float64(min(box[a, 0], box[b, 0]))
    y = np.float64(max(box[a, 4], box[b, 4])) - np.float64(min(box[a, 1], box[b, 1]))
    z = np.float64(max(box[a, 5], box[b, 5])) - np.float64(min(box[a, 2], box[b, 2]))
    return x * y + (x + y) * z


@njit
def _fit(left, right, box, node):
    """Make a node's box the one around its children."""
    a, b = left[node], right[node]
    for k in range(3):
        box[node, k] = min(box[a, k], box[b, k])
        box[node, k + 3] = max(box[a, k + 3], box[b, k + 3])


@njit
def rotation_change(left, right, box, node, kind):
    """By how much a rotation changes the sum of inner areas; inf if there is no such one."""
    l, r = left[node], right[node]
    if kind < 2:
        if left[r] < 0:
            return np.inf
        stays = right[r] if kind == 0 else left[r]
        return _union_area(box, l, stays) - box_area(box, r)
    if kind < 4:
        if left[l] < 0:
            return np.inf
        stays = right[l] if kind == 2 else left[l]
        return _union_area(box, r, stays) - box_area(box, l)
    if left[l] < 0 or left[r] < 0:
        return np.inf
    goes, stays = (right[r], left[r]) if kind == 4 else (left[r], right[r])
    after = _union_area(box, goes, right[l]) + _union_area(box, left[l], stays)
    return after - (box_area(box, l) + box_area(box, r))


@njit
def rotate(left, right, box, node, kind):
    """Do one rotation, and fit the boxes of the children that it touches."""
    l, r = left[node], right[node]
    if kind == 0:
        left[node], left[r] = left[r], l
    elif kind == 1:
        left[node], right[r] = right[r], l
    elif kind == 2:
        right[node], left[l] = left[l], r
    elif kind == 3:
        right[node], right[l] = right[l], r
    elif kind == 4:
        left[l], right[r] = right[r], left[l]
    else:
        left[l], left[r] = left[r], left[l]
    if kind < 2 or kind > 3:
        _fit(left, right, box, r)
    if kind > 1:
        _fit(left, right, box, l)


@njit
def _hill_sweep(left, right, box, state, stack):
    """One sweep of hill climbing, bottom-up. Returns the rotations done and what they gained.

    Nodes are only looked at where something has changed since they were last found to have
    no rotation to offer: the outcome is that of looking at all of them.
    """
    done, gained = 0, 0.0
    stack[0], top = 0, 1
    while top > 0:
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
        l, r = left[node], right[node]
        dirty = (state[node] & _DIRTY) | ((state[l] | state[r]) & _CHANGED)
        state[l] &= ~_CHANGED
        state[r] &= ~_CHANGED
        own = np.uint8(0)
        if dirty:
            best, kind = -_LEAST * box_area(box, node), -1
            for k in range(6):
                change = rotation_change(left, right, box, node, k)
                if change < best:
                    best, kind = change, k
            if kind >= 0:
                rotate(left, right, box, node, kind)
                done += 1
                gained -= best
                own = _DIRTY | _CHANGED
                # What now hangs below the touched children may hold dirty nodes.
                if kind < 2 or kind > 3:
                    state[r] = _DIRTY | _below(left, right, state, r)
                if kind > 1:
                    state[l] = _DIRTY | _below(left, right, state, l)
        state[node] = own | _below(left, right, state, node)
    state[0] &= ~_CHANGED
    return done, gained


@njit
def _below(left, right, state, node):
    if (state[left[node]] | state[right[node]]) & (_DIRTY | _BELOW):
        return _BELOW
    return np.uint8(0)


@njit
def _mix(x):
    """Scramble a 64-bit counter (the finaliser of SplitMix64): the same bits everywhere."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit
def _anneal_chunk(left, right, box, begin, end, key, temperature, exponential):
    """Propose one random rotation at each inner node from ``begin`` to ``end``.

    With u uniform, ``u < exp(-change / T)`` says the same as ``change < T * -log(u)``;
    ``exponential`` is a table of ``-log(u)``, so that no processor's own ``exp`` has a say.
    Returns the rotations done and the change of the sum of areas.
    """
    done, changed = 0, 0.0
    for node in range(begin, end):
        if left[node] < 0:
            continue
        random = _mix(key + np.uint64(node) * np.uint64(0x9E3779B97F4A7C15))
        kind = np.int64(((random >> np.uint64(32)) * np.uint64(6)) >> np.uint64(32))
        change = rotation_change(left, right, box, node, kind)
        if change < temperature * exponential[random & np.uint64(len(exponential) - 1)]:
            rotate(left, right, box, node, kind)
            done += 1
            changed += change
    return done, changed


@njit
def inner_area(left, box):
    """Sum of the areas of all inner nodes."""
    total = 0.0
    for node in range(len(left)):
        if left[node] >= 0:
            total += box_area(box, node)
    return total


def depth_first(draft: Draft) -> tuple[I32, I32, I32, I32, F32]:
    """Lay a draft out depth-first, so that what is near in the tree is near in memory.

    Returns
    -------
    left, right, reference, count : (2R - 1,) int32
        The draft, and the number of references below each node.
    box : (2R - 1, 6) float32
        Boxes of the nodes, lower corner then upper, in builder units.
    """
    order, leaf_order, _, first, count = _preorder(draft.left, draft.right, draft.reference)
    inner = count > 1
    left = np.where(inner, np.arange(1, len(count) + 1, dtype=np.int32), np.int32(-1))
    right = np.where(inner, left + 2 * np.roll(count, -1) - 1, np.int32(-1)).astype(np.int32)
    reference = np.where(inner, np.int32(-1), leaf_order[first])
    return left, right, reference, count, draft_boxes(draft)[order]


def climb(left: I32, right: I32, box: F32, sweeps: int, context: Context) -> dict[str, int]:
    """Hill climbing in place, to a local minimum or for so many sweeps.

    Returns
    -------
    dict
        ``sweeps`` and ``rotations`` done.
    """
    inner = left >= 0
    state = np.where(inner, _DIRTY | _BELOW, np.uint8(0))
    stack = np.empty(len(left) + 2, np.int32)
    rotations = 0
    for sweep in range(1, sweeps + 1):
        done, _ = _hill_sweep(left, right, box, state, stack)
        rotations += done
        # Every sweep does about half the rotations of the one before.
        context.progress("hill climbing", 1.0 if done == 0 else 1.0 - 1.0 / (sweep + 1))
        if done == 0:
            break
    return {"sweeps": sweep, "rotations": rotations}
