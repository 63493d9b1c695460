"""`agglo`: exact greedy agglomeration, bottom-up.

Walter, Bala, Kulkarni, Pingali: *Fast Agglomerative Clustering for Rendering* (IEEE
Symposium on Interactive Ray Tracing 2008). Every reference starts as a cluster, and again
and again the two clusters whose common box has the least surface area become one.

The order of merges is free. Let the key of a pair be (half area of the common box, number
of references of both, smaller name, larger name), a cluster's name being its smallest
reference. When C and D merge, no key involving the new cluster is below the least of those
of C and D: a box that holds another never has the smaller area (in float32 too, as rounding
is monotone), and the number of references has grown. So two clusters that are each other's
nearest stay so whatever else merges, the globally closest pair will one day be these two,
and merging them at once gives the same tree (the paper's "locally ordered" algorithm). The
number of references comes second in the key to make the argument hold for ties as well, and
to make a balanced tree of a heap of equal boxes where names alone would make a chain.

The stages, repeated in sweeps until one cluster is left:

1. *Index*: the clusters along the Morton curve of their centres, in blocks of eight, eight
   blocks under one, and so on.
2. *Sweep*: from each cluster in turn, follow nearest neighbours until two are mutual, and
   merge these. A neighbour once found holds until it is merged itself. Each start brings a
   merge, so a sweep leaves at most two thirds of the clusters, and often far less than half.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.options import Options
from mibvh.builders.radix import argsort_keys
from mibvh.builders.registry import Context, builder
from mibvh.morton import morton_codes
from mibvh.triangles import Triangles

#: Entries of a block (a power of two) and its logarithm.
_WIDTH = 8
_SHIFT = 3
#: The index of 2**31 clusters has eleven levels; a search puts off up to seven a level.
_MAX_LEVELS = 12
#: The (references, name) of a place that holds no cluster.
_NOBODY = np.iinfo(np.int64).max
#: Starts between two reports of progress.
_CHUNK = 2048


class Clusters(NamedTuple):
    """All clusters ever made; C is twice the number of references, less one."""

    lower: Any  #: (C, 3) float32
    upper: Any  #: (C, 3) float32
    rank: Any  #: (C,) int64: number of references, and name (smallest reference) below that
    left: Any  #: (C,) int32: the two that were merged; -1 for a single reference
    right: Any  #: (C,) int32
    neighbour: Any  #: (C,) int32: the nearest cluster, where it was looked for; or -1
    slot_of: Any  #: (C,) int32: place in the index; -1 for what is none, or is merged


class Index(NamedTuple):
    """The clusters of a sweep, along the Morton curve, in blocks of blocks; see :func:`_index`."""

    members: Any  #: (places,) int32: the cluster at each place; -1 for none any more
    offsets: Any  #: (levels + 1,) int64: from :func:`_offsets`
    bound: Any  #: (B, 6, 8) float32
    least: Any  #: (B, 8) int64


def _offsets(clusters: int) -> npt.NDArray[np.int64]:
    """First block of each level of the index, and the number of all blocks at the end."""
    offsets = [0]
    while True:
        blocks = -(-clusters // _WIDTH)
        offsets.append(offsets[-1] + blocks)
        if blocks == 1:
            return np.array(offsets, np.int64)
        clusters = blocks


@njit
def _index(members, offsets, clusters):
    """Build the index over clusters in the order given.

    An entry of level 0 is a cluster: its box and its rank (number of references in the high
    half, name in the low half). An entry of a higher level bounds a block of the level below:
    the *greatest* lower corner and the *least* upper corner of its clusters, and their least
    rank. The box that joins a query to any of them holds the box that joins it to these two
    corners, so one formula gives distances and lower bounds of distances. Empty places hold
    all of space and so are infinitely far.
    """
    lower, upper, rank, slot_of = clusters.lower, clusters.upper, clusters.rank, clusters.slot_of
    blocks = offsets[-1]
    bound = np.empty((blocks, 6, _WIDTH), np.float32)
    least = np.empty((blocks, _WIDTH), np.int64)
    for b in range(blocks):
        for k in range(_WIDTH):
            for i in range(3):
                bound[b, i, k] = -np.inf
                bound[b, i + 3, k] = np.inf
            least[b, k] = _NOBODY
    for s in range(len(members)):
        c = members[s]
        slot_of[c] = s
        b, k = s >> _SHIFT, s & (_WIDTH - 1)
        for i in range(3):
            bound[b, i, k] = lower[c, i]
            bound[b, i + 3, k] = upper[c, i]
        least[b, k] = rank[c]
    for level in range(len(offsets) - 2):
        for b in range(offsets[level], offsets[level + 1]):
            _summarise(bound, least, b, offsets[level + 1], b - offsets[level])
    return Index(members, offsets, bound, least)


@njit(allocates=False)
def _summarise(bound, least, block, above, entry):
    """Write what a block holds into its entry of the level above; tell whether it changed."""
    b, k = above + (entry >> _SHIFT), entry & (_WIDTH - 1)
    changed = False
    for i in range(3):
        low, high = bound[block, i, 0], bound[block, i + 3, 0]
        for j in range(1, _WIDTH):
            low = max(low, bound[block, i, j])
            high = min(high, bound[block, i + 3, j])
        changed |= low != bound[b, i, k] or high != bound[b, i + 3, k]
        bound[b, i, k] = low
        bound[b, i + 3, k] = high
    rank = least[block, 0]
    for j in range(1, _WIDTH):
        rank = min(rank, least[block, j])
    changed |= rank != least[b, k]
    least[b, k] = rank
    return changed


@njit(allocates=False)
def _refresh(bound, least, offsets, slot):
    """Carry a changed place upwards, as far as it matters."""
    entry = slot
    for level in range(len(offsets) - 2):
        entry >>= _SHIFT
        if not _summarise(bound, least, offsets[level] + entry, offsets[level + 1], entry):
            break


@njit(allocates=False)
def _distances(bound, block, x0, y0, z0, x1, y1, z1, width, out):
    """Half area of the box that joins the query to each entry of a block.

    ``width`` is always eight; as an argument it keeps the loop whole for the vectoriser.
    """
    for k in range(width):
        dx = max(x1, bound[block, 3, k]) - min(x0, bound[block, 0, k])
        dy = max(y1, bound[block, 4, k]) - min(y0, bound[block, 1, k])
        dz = max(z1, bound[block, 5, k]) - min(z0, bound[block, 2, k])
        out[k] = dx * dy + (dx + dy) * dz


@njit(allocates=False)
def _nearest(slot, bound, least, offsets, width, distance, stack_area, stack_place):
    """Nearest neighbour of the cluster at a slot: least (area, references, name).

    Climbs from the slot to the root, and at every level goes down into the other entries of
    the block where their bound allows something nearer than the nearest so far.

    Returns
    -------
    int
        The slot of the neighbour; -1 if there is none.
    """
    block, lane = slot >> _SHIFT, slot & (_WIDTH - 1)
    x0, y0, z0 = bound[block, 0, lane], bound[block, 1, lane], bound[block, 2, lane]
    x1, y1, z1 = bound[block, 3, lane], bound[block, 4, lane], bound[block, 5, lane]
    best_area, best_rank, best = np.float32(np.inf), np.int64(_NOBODY), -1
    entry = slot
    for climbed in range(len(offsets) - 1):
        # The query's own entry is left out on the way up; going down never meets it.
        top = 0
        level, place, skip = climbed, entry >> _SHIFT, entry & (_WIDTH - 1)
        while True:
            block = offsets[level] + place
            _distances(bound, block, x0, y0, z0, x1, y1, z1, width, distance)
            base = top
            for k in range(_WIDTH):
                area = distance[k]
                if area > best_area or k == skip:
                    continue
                rank = least[block, k]
                if area == best_area and rank >= best_rank:
                    continue
                if level == 0:
                    best_area, best_rank, best = area, rank, (place << _SHIFT) + k
                    continue
                # Put off, the most promising of this block on top.
                code = ((place << _SHIFT) + k) * _MAX_LEVELS + level - 1
                j = top
                while j > base and (
                    stack_area[j - 1] < area
                    or (
                        stack_area[j - 1] == area
                        and _rank_of(stack_place[j - 1], least, offsets) < rank
                    )
                ):
                    stack_area[j], stack_place[j] = stack_area[j - 1], stack_place[j - 1]
                    j -= 1
                stack_area[j], stack_place[j] = area, code
                top += 1
            found = False
            while top > 0 and not found:
                top -= 1
                if stack_area[top] < best_area or (
                    stack_area[top] == best_area
                    and _rank_of(stack_place[top], least, offsets) < best_rank
                ):
                    level = stack_place[top] % _MAX_LEVELS
                    place = stack_place[top] // _MAX_LEVELS
                    skip = -1
                    found = True
            if not found:
                break
        entry >>= _SHIFT
    return best


@njit(allocates=False)
def _rank_of(code, least, offsets):
    """Least rank of a block that was put off."""
    level, place = code % _MAX_LEVELS + 1, code // _MAX_LEVELS
    return least[offsets[level] + (place >> _SHIFT), place & (_WIDTH - 1)]


@njit(allocates=False)
def _neighbour_of(a, neighbour, members, slot_of, search):
    """Nearest neighbour of a cluster; one once found holds until it is merged itself."""
    b = neighbour[a]
    if b < 0 or slot_of[b] < 0:
        b = members[_nearest(slot_of[a], *search)]
        neighbour[a] = b
    return b


@njit
def _sweep(begin, end, limit, made, index, clusters, width):
    """Merge once from each start of ``members[begin:end]`` that is still a cluster.

    Clusters made in this sweep (``limit`` and above) are no starts of it. Returns the number
    of clusters ever made.
    """
    members, offsets, bound, least = index
    lower, upper, rank, left, right, neighbour, slot_of = clusters
    distance = np.empty(_WIDTH, np.float32)
    stack_area = np.empty(_MAX_LEVELS * _WIDTH, np.float32)
    stack_place = np.empty(_MAX_LEVELS * _WIDTH, np.int64)
    search = (bound, least, offsets, width, distance, stack_area, stack_place)
    total = len(slot_of)
    for s in range(begin, end):
        a = members[s]
        if a < 0 or a >= limit or made == total:
            continue
        while True:
            b = _neighbour_of(a, neighbour, members, slot_of, search)
            if _neighbour_of(b, neighbour, members, slot_of, search) == a:
                break
            a = b
        # The new cluster takes the place of one, the place of the other becomes empty.
        new = made
        made += 1
        if (rank[b] & 0xFFFFFFFF) < (rank[a] & 0xFFFFFFFF):
            a, b = b, a
        left[new], right[new] = a, b
        keep, drop = slot_of[a], slot_of[b]
        members[keep], members[drop] = new, -1
        slot_of[new], slot_of[a], slot_of[b] = keep, -1, -1
        rank[new] = rank[a] + (rank[b] >> 32 << 32)
        block, lane = keep >> _SHIFT, keep & (_WIDTH - 1)
        other, lane_other = drop >> _SHIFT, drop & (_WIDTH - 1)
        for i in range(3):
            lower[new, i] = min(lower[a, i], lower[b, i])
            upper[new, i] = max(upper[a, i], upper[b, i])
            bound[block, i, lane], bound[block, i + 3, lane] = lower[new, i], upper[new, i]
            bound[other, i, lane_other], bound[other, i + 3, lane_other] = -np.inf, np.inf
        least[block, lane], least[other, lane_other] = rank[new], _NOBODY
        _refresh(bound, least, offsets, drop)
        _refresh(bound, least, offsets, keep)
    return made


@builder(
    "agglo",
    summary="bottom-up: always merge the two clusters whose common box is smallest",
    source="Walter et al. 2008",
    memory=230,
)
def agglo(triangles: Triangles, options: Options, context: Context) -> Draft:
    """Build the tree of exact greedy agglomeration; about O(n log n) on scenes.

    Large triangles among small ones, duplicates and regular grids cost nothing extra. Where
    most boxes overlap most others (needles through one point, a soup of huge triangles),
    areas of joint boxes hardly differ, no bound helps, and time nears O(n^2).
    """
    refs = References.of(triangles)
    n = len(refs)
    total = 2 * n - 1
    lower, upper = np.empty((2, total, 3), np.float32)
    lower[:n], upper[:n] = refs.lower, refs.upper
    rank = np.empty(total, np.int64)
    rank[:n] = (1 << 32) + np.arange(n)
    left, right, neighbour, slot_of = np.full((4, total), -1, np.int32)
    clusters = Clusters(lower, upper, rank, left, right, neighbour, slot_of)
    members = np.arange(n, dtype=np.int32)
    made = n
    while made < total:
        codes = morton_codes(lower[members], upper[members])
        members = members[argsort_keys(codes, 63)]
        index = _index(members, _offsets(len(members)), clusters)
        limit = made
        for begin in range(0, len(members), _CHUNK):
            end = min(begin + _CHUNK, len(members))
            made = _sweep(begin, end, limit, made, index, clusters, _WIDTH)
            context.progress("merging clusters", (made - n) / (n - 1))
        members = members[members >= 0]
    # Node 0 is the root, the last cluster made.
    reference = np.full(total, -1, np.int32)
    reference[total - n :] = np.arange(n - 1, -1, -1)
    left, right = (np.where(c < 0, -1, total - 1 - c)[::-1].copy() for c in (left, right))
    return Draft(refs, left, right, reference, {"merges": n - 1})
