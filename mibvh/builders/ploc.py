"""`ploc`: parallel locally-ordered clustering.

Meister and Bittner: *Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy
Construction* (TVCG 2018). References stand in Morton order as clusters. Each looks for the
cluster within ``radius`` places whose common box is smallest; two that find each other are
merged, in the place of the first; and so on until one is left. An approximation of `agglo`.

``group`` gives the order of H-PLOC (Benthin, Meister, Barczak, Mehalwal, Tsakok, Kensler 2024;
16 there): the Morton tree is gone through bottom-up, and at each node that holds more clusters
than that, those of its two children are merged until no more are left; at the root, one. So
clusters of far-apart branches never meet low down.

Ties are broken by the pair's places, the same way from both sides: otherwise, clusters of equal
boxes could wait for each other for ever.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.measured import cost_of
from mibvh.builders.morton import radix_tree
from mibvh.builders.options import Options, option
from mibvh.builders.radix import sort_keys
from mibvh.builders.registry import Context, builder
from mibvh.builders.simd import load, store, union
from mibvh.builders.splitting import pack_boxes
from mibvh.morton import morton_codes
from mibvh.triangles import Triangles


@njit
def _nearest(measure, boxes, begin, end, i, radius):
    """Place of the nearest cluster: least (measure of the common box, first, second place)."""
    own = load(boxes, i)
    best, at = np.float32(np.inf), -1
    for j in range(max(begin, i - radius), min(end, i + radius + 1)):
        if j == i:
            continue
        distance = cost_of(measure, union(own, load(boxes, j)))
        # The pair (i, j) in order; of those at equal distance, the first.
        if (
            at < 0
            or distance < best
            or (distance == best and (min(i, j), max(i, j)) < (min(i, at), max(i, at)))
        ):
            best, at = distance, j
    return at


@njit
def _reduce(measure, boxes, ids, begin, end, target, radius, near, left, right, made):
    """Merge the clusters from ``begin`` to ``end`` until no more than ``target`` are left.

    Returns where they end now, and how many nodes were made so far.
    """
    while end - begin > target:
        for i in range(begin, end):
            near[i] = _nearest(measure, boxes, begin, end, i, radius)
        kept = begin
        for i in range(begin, end):
            j = near[i]
            mutual = near[j] == i
            if mutual and j < i:
                continue
            box = load(boxes, i)
            cluster = ids[i]
            if mutual:
                box = union(box, load(boxes, np.int64(j)))
                left[made], right[made] = cluster, ids[j]
                cluster, made = made, made + 1
            store(boxes, kept, box)
            ids[kept] = cluster
            kept += 1
        end = kept
    return end, made


@njit
def _cluster_in_groups(
    measure, boxes, ids, group, radius, near, tree_left, tree_right, left, right
):
    """Merge along the Morton tree, bottom-up, at most ``group`` clusters for each node."""
    n = len(ids)
    # Clusters of what has been gone through stand at the front; a node's begin where it began.
    stack = np.empty((n + 1, 2), np.int64)
    stack[0, 0], stack[0, 1], top = 0, -1, 1
    used, leaf, made = 0, 0, n
    while top > 0:
        top -= 1
        node, begin = stack[top, 0], stack[top, 1]
        if tree_left[node] < 0:
            # Leaves come in Morton order, and are at or behind where they go.
            store(boxes, used, load(boxes, leaf))
            ids[used] = ids[leaf]
            used, leaf = used + 1, leaf + 1
            continue
        if begin < 0:
            stack[top, 1] = used
            stack[top + 1, 0], stack[top + 1, 1] = tree_right[node], -1
            stack[top + 2, 0], stack[top + 2, 1] = tree_left[node], -1
            top += 3
            continue
        target = 1 if node == 0 else group
        used, made = _reduce(
            measure, boxes, ids, begin, used, target, radius, near, left, right, made
        )
    return made


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlocOptions(Options):
    """Options of `ploc`."""

    radius: int = option(
        16, "places on either side where a neighbour is looked for; 100 in the paper", 1, 4096
    )
    group: int = option(
        0,
        "clusters kept per node of the Morton tree: H-PLOC's order (16); 0: none is",
        0,
        4096,
    )


@builder(
    "ploc",
    summary="bottom-up: merge what is nearest to each other within 16 places of the Morton order",
    source="Meister and Bittner 2018; Benthin et al. 2024",
    options=PlocOptions,
    memory=130,
)
def ploc(triangles: Triangles, options: PlocOptions, context: Context) -> Draft:
    """Build the PLOC tree; O(n radius), on one thread."""
    refs = References.of(triangles)
    n = len(refs)
    codes, order = sort_keys(morton_codes(refs.lower, refs.upper), 63)
    measure = context.compiled_measure(refs.scale)
    boxes = pack_boxes(refs)[order]
    ids = np.asarray(order, np.int32).copy()
    near = np.empty(n, np.int64)
    left, right = np.full((2, 2 * n - 1), -1, np.int32)
    if options.group:
        tree_left, tree_right, _ = radix_tree(codes, order)
        _cluster_in_groups(
            measure,
            boxes,
            ids,
            options.group,
            options.radius,
            near,
            tree_left,
            tree_right,
            left,
            right,
        )
    else:
        _reduce(measure, boxes, ids, 0, n, 1, options.radius, near, left, right, n)
    # Node 0 is the root, the last cluster made.
    total = 2 * n - 1
    reference = np.full(total, -1, np.int32)
    reference[total - n :] = np.arange(n - 1, -1, -1)
    left, right = (np.where(c < 0, -1, total - 1 - c)[::-1].copy() for c in (left, right))
    return Draft(refs, left, right, reference, {"merges": n - 1})
