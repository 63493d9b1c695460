"""`agglo` against the definition of greedy agglomeration, ties included."""

from __future__ import annotations

import numpy as np
import pytest

import mibvh
from mibvh.builders import Context, Options, get
from mibvh.builders.agglomerative import (
    _MAX_LEVELS,
    _WIDTH,
    Clusters,
    _index,
    _nearest,
    _offsets,
    _refresh,
)
from mibvh.builders.finish import draft_boxes


def draft_of(triangles):
    return get("agglo").draft(mibvh.Triangles(triangles, "test"), Options(), Context())


def half_area(a, b):
    """float32 half area of the joint box of two (6,) boxes (negated lower, upper)."""
    x, y, z = np.maximum(a, b)[3:] + np.maximum(a, b)[:3]
    return x * y + (x + y) * z


def greedy(lower, upper):
    """Merge the closest pair until one is left: all pairs, every time."""
    clusters = {i: (frozenset([i]), np.r_[-lower[i], upper[i]]) for i in range(len(lower))}
    sets, costs = set(), []
    while len(clusters) > 1:
        area, _, a, b = min(
            (half_area(clusters[i][1], clusters[j][1]), len(clusters[i][0] | clusters[j][0]), i, j)
            for i in clusters
            for j in clusters
            if i < j
        )
        members, box = clusters.pop(b)
        clusters[a] = (clusters[a][0] | members, np.maximum(clusters[a][1], box))
        sets.add(clusters[a][0])
        costs.append(area)
    return sets, costs


def sets_of(draft):
    """The references below each inner node."""
    below = [None] * len(draft.left)
    order, stack = [], [0]
    while stack:
        node = stack.pop()
        order.append(node)
        if draft.left[node] >= 0:
            stack += [draft.left[node], draft.right[node]]
    for node in reversed(order):
        if draft.left[node] < 0:
            below[node] = frozenset([int(draft.reference[node])])
        else:
            below[node] = below[draft.left[node]] | below[draft.right[node]]
    return below


def soup(kind, n, seed):
    """Triangles with few, many, or only ties."""
    rng = np.random.default_rng(seed)
    place = rng.random((n, 1, 3), np.float32)
    if kind == "mixed sizes":
        return place + rng.random((n, 3, 3), np.float32) * rng.random((n, 1, 1), np.float32) ** 6
    if kind == "grid":
        place = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 1, 3)[:n]
        return place + np.array([[0, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.5]])
    if kind == "coarse":  # corners on a coarse lattice: equal areas, equal boxes, flat boxes
        return rng.integers(0, 4, (n, 3, 3)).astype(np.float32)
    if kind == "duplicates":
        return np.repeat(rng.random((-(-n // 4), 3, 3), np.float32), 4, axis=0)[:n]
    if kind == "equal":
        return np.ones((n, 1, 1)) * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1.0]])
    if kind == "points":  # no area anywhere
        return np.zeros((n, 3, 3)) + rng.integers(0, 5, (n, 1, 1)) * np.array([1.0, 0, 0])
    if kind == "ground":  # one triangle under everything
        triangles = place + 0.01 * rng.random((n, 3, 3), np.float32)
        triangles[n // 2] = [[-9, -9, 0], [9, -9, 0], [0, 9, 0]]
        return triangles
    assert kind == "doubling"  # a chain of nearest neighbours as long as the list
    return 2.0 ** np.arange(-n, 0)[:, None, None] * np.ones((n, 3, 3))


KINDS = ["mixed sizes", "grid", "coarse", "duplicates", "equal", "points", "ground", "doubling"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", [2, 9, 30])
def test_equals_greedy_over_all_pairs(kind, n):
    draft = draft_of(soup(kind, n, seed=n))
    refs = draft.references
    sets, costs = greedy(refs.lower, refs.upper)
    below = sets_of(draft)
    inner = np.flatnonzero(draft.left >= 0)
    assert {below[node] for node in inner} == sets
    assert np.all(np.diff(costs) >= 0)  # what makes the order of merges free
    # A merge costs the area of the node it makes: the same areas, bit for bit.
    boxes = draft_boxes(draft)
    areas = [half_area(np.r_[-b[:3], b[3:]], np.r_[-b[:3], b[3:]]) for b in boxes[inner]]
    assert np.array_equal(np.sort(areas), np.sort(np.array(costs, np.float32)))


@pytest.mark.parametrize("kind", KINDS)
def test_nearest_neighbour_equals_brute_force_while_clusters_vanish(kind):
    rng = np.random.default_rng(7)
    triangles = mibvh.Triangles(soup(kind, 64 if kind == "grid" else 150, seed=3), "test")
    n = len(triangles)
    refs = mibvh.builders.References.of(triangles)
    offsets = _offsets(n)
    members, slot_of = rng.permutation(n).astype(np.int32), np.full(n, -1, np.int32)
    rank = rng.integers(1, 4, n) * 2**32 + np.arange(n)
    none = np.zeros(0, np.int32)
    clusters = Clusters(refs.lower, refs.upper, rank, none, none, none, slot_of)
    _, _, bound, least = _index(members, offsets, clusters)
    scratch = (
        np.empty(_WIDTH, np.float32),
        np.empty(_MAX_LEVELS * _WIDTH, np.float32),
        np.empty(_MAX_LEVELS * _WIDTH, np.int64),
    )
    boxes = np.hstack([-refs.lower, refs.upper])
    alive = list(range(n))
    while len(alive) > 1:
        for a in rng.choice(alive, 4):
            expected = min((half_area(boxes[a], boxes[b]), rank[b], b) for b in alive if b != a)
            got = members[_nearest(slot_of[a], bound, least, offsets, _WIDTH, *scratch)]
            assert got == expected[2]
        for a in rng.choice(alive, 1 + len(alive) // 8, replace=False):
            alive.remove(a)
            block, lane = divmod(slot_of[a], _WIDTH)
            bound[block, :3, lane], bound[block, 3:, lane] = -np.inf, np.inf
            least[block, lane] = np.iinfo(np.int64).max
            _refresh(bound, least, offsets, slot_of[a])


def test_two_pairs_by_hand():
    # Boxes [0,1], [8,9], [1,2], [6,7] along x: {0,2} and {1,3} tie at half area 1 * 2 + ...
    x = np.array([0.0, 8, 1, 6])[:, None, None]
    triangles = np.array([[0, 0, 0], [1, 1, 0], [0, 0, 1.0]]) + x * [1.0, 0, 0]
    draft = draft_of(triangles)
    assert {s for s in sets_of(draft) if len(s) > 1} == {
        frozenset({0, 2}),
        frozenset({1, 3}),
        frozenset(range(4)),
    }


def test_a_heap_of_equal_triangles_makes_a_balanced_tree():
    tree = mibvh.build(soup("equal", 4096, 0), "agglo", max_leaf=1)
    assert tree.depth == 12


@pytest.mark.parametrize("scale", [1e-20, 1.0, 1e14])
@pytest.mark.parametrize("kind", KINDS)
def test_trees_are_valid_and_repeat(kind, scale):
    n = 64 if kind == "grid" else 100
    triangles = soup(kind, n, seed=1) * scale
    tree = mibvh.build(triangles, "agglo")
    assert tree.validate() == []
    again = mibvh.build(triangles, "agglo")
    assert np.array_equal(tree.left, again.left)
    assert np.array_equal(tree.references, again.references)
    assert tree.lower.tobytes() == again.lower.tobytes()


def test_one_triangle():
    assert mibvh.build(np.eye(3)[None], "agglo").validate() == []


def test_progress_rises_to_one():
    seen = []
    mibvh.build(
        soup("mixed sizes", 5000, 0), "agglo", progress=lambda stage, done: seen.append(done)
    )
    assert seen == sorted(seen)
    assert len(seen) > 2
    assert seen[-1] == 1.0
