"""`treelet` and `streelet` against all trees there are, and their own bookkeeping."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import soup

import mibvh
from mibvh.builders import Context, get
from mibvh.builders.draft import Draft, References
from mibvh.builders.finish import draft_boxes, draft_sah
from mibvh.builders.morton import radix_draft
from mibvh.builders.rotations import box_area, depth_first
from mibvh.builders.splitting import presplit
from mibvh.builders.subtrees import Costs, Nodes, owners, subtree_costs, without_joined
from mibvh.builders.treelet import RearrangeOptions, rearrange, start_over
from mibvh.builders.treelet_search import _LANES, _grow, _solve, improve_all, nodes_above
from mibvh.errors import MibvhError

CONTEXT = Context()
NONE_SPLIT = np.empty(0, np.int32)


def all_trees(leaves):
    """Every binary tree over the leaves, as nested pairs: (2n - 3)!! of them."""
    if len(leaves) == 1:
        yield leaves[0]
        return

    def with_leaf(tree, leaf):
        yield (tree, leaf)
        if isinstance(tree, tuple):
            yield from ((new, tree[1]) for new in with_leaf(tree[0], leaf))
            yield from ((tree[0], new) for new in with_leaf(tree[1], leaf))

    for tree in all_trees(leaves[:-1]):
        yield from with_leaf(tree, leaves[-1])


def tree_cost(tree, box, count, cost, c_inner, c_tri, max_leaf):
    """Box, triangles and cost of a tree whose every subtree may be one leaf instead."""
    if not isinstance(tree, tuple):
        return box[tree], count[tree], cost[tree]
    (box_a, count_a, cost_a), (box_b, count_b, cost_b) = (
        tree_cost(part, box, count, cost, c_inner, c_tri, max_leaf) for part in tree
    )
    joint = np.concatenate([np.minimum(box_a, box_b)[:3], np.maximum(box_a, box_b)[3:]])
    x, y, z = joint[3:].astype(np.float64) - joint[:3]
    area, total = x * y + y * z + z * x, count_a + count_b
    best = c_inner * area + cost_a + cost_b
    if total <= max_leaf:
        best = min(best, c_tri * area * total)
    return joint, total, best


def cheapest(*args):
    leaves = list(range(len(args[0])))
    return min(tree_cost(tree, *args)[2] for tree in all_trees(leaves))


def options_of(**options):
    return RearrangeOptions(**options)


def sah_of(draft, options):
    return draft_sah(draft, c_inner=options.c_inner, c_tri=options.c_tri, max_leaf=options.max_leaf)


@pytest.mark.parametrize("size", [3, 4, 5, 6])
def test_the_programme_finds_the_best_of_all_trees(size):
    """Costs of subtrees, triangles and limits of all kinds, so that leaves form or do not."""
    rng = np.random.default_rng(size)
    for c_inner, c_tri, max_leaf in ((1.2, 1.0, 8), (1.2, 1.0, 1), (5.0, 0.3, 12), (0.0, 1.0, 255)):
        lower = rng.random((size, 3, _LANES)) * [[[3], [1], [2]]]
        box = np.concatenate([lower, lower + rng.random((size, 3, _LANES)) ** 3], axis=1)
        count = rng.integers(1, 5, (size, _LANES)).astype(np.float64)
        cost = count * rng.random((size, _LANES))
        arrays = [np.zeros((1 << size, *part.shape[1:])) for part in (box, count, count, cost)]
        arrays[0] = arrays[0].astype(np.float32)
        for array, part in zip(arrays, (box, count, 0 * count, cost), strict=True):
            array[1 << np.arange(size)] = part
        _solve(size, NONE_SPLIT, c_inner, c_tri, max_leaf, None, *arrays)
        for lane in range(_LANES):
            treelet = box.astype(np.float32)[..., lane], count[:, lane], cost[:, lane]
            expected = cheapest(*treelet, c_inner, c_tri, max_leaf)
            assert arrays[3][-1, lane] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("max_leaf", [1, 2, 8])
@pytest.mark.parametrize("count", [2, 3, 5, 6])
def test_a_scene_of_one_treelet_gets_the_best_tree_there_is(count, max_leaf):
    options = options_of(max_leaf=max_leaf)
    for seed in range(5):
        triangles = soup(count, seed, size=0.4)
        refs = References.of(triangles)
        boxes = np.concatenate([refs.lower, refs.upper], axis=1)
        x, y, z = (boxes[:, 3:].astype(np.float64) - boxes[:, :3]).T
        areas = x * y + y * z + z * x
        args = boxes, np.ones(count), areas * options.c_tri
        least = cheapest(*args, options.c_inner, options.c_tri, max_leaf)
        result = rearrange(radix_draft(refs), options, CONTEXT)
        whole = box_area(None, draft_boxes(result), 0)
        assert sah_of(result, options) == pytest.approx(least / whole, rel=1e-6)


def test_treelets_grow_by_their_largest_leaf():
    draft = radix_draft(References.of(soup(300, 3)))
    left, right, _, count, box = depth_first(draft)
    tree = Nodes(left, right, box, count, np.zeros(len(left)))
    for root in np.flatnonzero(count >= 7):
        leaves, inner = [left[root], right[root]], [root]
        while len(leaves) < 7:
            areas = [box_area(None, box, n) if left[n] >= 0 else -1.0 for n in leaves]
            node = leaves.pop(int(np.argmax(areas)))
            inner.append(node)
            leaves += [left[node], right[node]]
        got = np.full((2, 8, _LANES), -1, np.int32)
        _grow(None, root, 7, 3, tree, got[0], got[1])
        assert set(got[0, :7, 3]) == set(leaves)
        assert got[1, :6, 3].tolist() == inner
        assert (got[:, :, [0, 1, 2, 4, 5, 6, 7]] == -1).all()


def test_nodes_come_lowest_first_and_never_two_on_one_path_together():
    left, right, _, count, _ = depth_first(radix_draft(References.of(soup(500, 1))))
    for least in (2, 7, 100, 500, 501):
        nodes, ends = nodes_above(0, least, left, right, count)
        assert sorted(nodes) == np.flatnonzero((count >= least) & (left >= 0)).tolist()
        assert len(nodes) == (ends[-1] if len(ends) else 0)
        height = np.zeros(len(left), int)
        height[nodes] = 1 + np.searchsorted(ends, np.arange(len(nodes)), side="right")
        np.testing.assert_array_equal(
            height[nodes], 1 + np.maximum(height[left[nodes]], height[right[nodes]])
        )


@pytest.mark.parametrize("max_leaf", [1, 8])
def test_costs_boxes_and_counts_are_kept_up_to_date(max_leaf):
    refs = References.of(soup(700, 5))
    left, right, reference, count, box = depth_first(radix_draft(refs))
    costs = Costs(1.2, 1.0, max_leaf, None)
    cost = subtree_costs(left, right, box, count, *costs)
    before = cost[0]
    for least in (7, 14, 28):
        nodes, ends = nodes_above(0, least, left, right, count)
        tree = Nodes(left, right, box, count, cost)
        rebuilt = improve_all(nodes, ends, 7, NONE_SPLIT, tree, costs)
        assert rebuilt > 0
        assert cost[0] < before
        before = cost[0]
        result = Draft(refs, left, right, reference)
        np.testing.assert_array_equal(box, draft_boxes(result))
        drawn = depth_first(result)
        anew = subtree_costs(*drawn[:2], drawn[4], drawn[3], *costs)
        np.testing.assert_array_equal(np.sort(cost), np.sort(anew))
        np.testing.assert_array_equal(np.sort(count), np.sort(drawn[3]))
        sah = draft_sah(result, c_inner=1.2, c_tri=1.0, max_leaf=max_leaf)
        assert sah == pytest.approx(cost[0] / box_area(None, box, 0), rel=1e-5)


@pytest.mark.parametrize("max_leaf", [1, 8])
def test_a_better_tree_from_any_start(max_leaf):
    triangles = soup(1500, seed=7)
    for name, options in (
        ("treelet", {}),
        ("treelet", {"start": "bbvh"}),
        ("treelet", {"size": 4, "rounds": 1}),
        ("treelet", {"size": 8}),
        ("streelet", {}),
        ("streelet", {"base": "bbvh", "beta": 1.0}),
        ("treelet", {"start": "streelet"}),
    ):
        tree = mibvh.build(triangles, name, max_leaf=max_leaf, **options)
        report = tree.meta["report"]
        assert tree.validate(triangles) == []
        assert tree.count[tree.left < 0].max() <= max_leaf
        assert report["end_sah"] < report["start_sah"]
        assert mibvh.sah(tree) == pytest.approx(report["end_sah"], rel=1e-5)
        assert report["iterations"] == options.get("rounds", 3)
        assert 0 < report["rebuilt"] <= report["treelets"]


def test_more_rounds_and_larger_treelets_lower_sah():
    draft = radix_draft(References.of(soup(3000, seed=8)))
    sah = {
        (size, rounds): rearrange(draft, options_of(size=size, rounds=rounds), CONTEXT).report[
            "end_sah"
        ]
        for size, rounds in ((4, 1), (7, 1), (7, 3), (7, 0), (7, 24))
    }
    assert sah[7, 3] < sah[7, 1] < sah[4, 1] < sah[7, 0]
    assert sah[7, 24] <= sah[7, 3]


def test_the_same_tree_on_one_thread_and_on_two(monkeypatch):
    triangles = soup(6000, seed=1)
    drafts = []
    for threads in ("1", "2"):
        monkeypatch.setenv("MIBVH_THREADS", threads)
        entry = get("streelet")
        drafts.append(entry.draft(triangles, entry.options(), CONTEXT))
    np.testing.assert_array_equal(drafts[0].left, drafts[1].left)
    np.testing.assert_array_equal(drafts[0].right, drafts[1].right)
    assert drafts[0].report == drafts[1].report


def test_splitting_adds_what_beta_allows():
    triangles = soup(800, seed=3, size=0.3)
    entry = get("streelet")
    for beta in (0.0, 0.3, 1.0):
        draft = entry.draft(triangles, entry.options(beta=beta), CONTEXT)
        assert draft.report["references"] == len(presplit(triangles, beta))
        assert len(draft.references) + draft.report["joined"] == draft.report["references"]
        assert len(draft.references) <= (1 + beta) * len(triangles)
        assert (len(draft.references) > len(triangles)) == (beta > 0)


def parts_of(references, owner):
    """References that several share an owner of; no geometry behind them is needed."""
    return References(references.lower, references.upper, np.asarray(owner, np.int32))


def cheapest_with_parts(boxes, owner, c_inner, c_tri, max_leaf):
    """Cost of the best of all trees whose leaves hold each triangle once."""

    def cost(tree):
        if not isinstance(tree, tuple):
            return boxes[tree], {owner[tree]}, c_tri * area_of(boxes[tree])
        (box_a, held_a, cost_a), (box_b, held_b, cost_b) = map(cost, tree)
        box = np.concatenate([np.minimum(box_a, box_b)[:3], np.maximum(box_a, box_b)[3:]])
        held, best = held_a | held_b, c_inner * area_of(box) + cost_a + cost_b
        if len(held) <= max_leaf:
            best = min(best, c_tri * area_of(box) * len(held))
        return box, held, best

    return min(cost(tree)[2] for tree in all_trees(list(range(len(boxes)))))


def area_of(box):
    x, y, z = box[3:].astype(np.float64) - box[:3]
    return x * y + y * z + z * x


@pytest.mark.parametrize("max_leaf", [1, 2, 8])
@pytest.mark.parametrize("owner", [(0, 0, 1, 1, 2), (0, 1, 2, 0, 0, 1), (0, 0, 0, 0)])
def test_leaves_hold_a_triangle_once_and_that_is_what_they_cost(owner, max_leaf):
    costs = Costs(1.2, 1.0, max_leaf, None)
    joined = 0
    for seed in range(8):
        refs = parts_of(References.of(soup(len(owner), seed, size=0.8)), owner)
        boxes = np.concatenate([refs.lower, refs.upper], axis=1)
        left, right, reference, count, box = depth_first(radix_draft(refs))
        cost = subtree_costs(left, right, box, count, *costs)
        owner_of = owners(refs.triangle, left, reference)
        root, end = np.zeros(1, np.int32), np.ones(1, np.int64)
        improve_all(root, end, len(owner), owner_of, Nodes(left, right, box, count, cost), costs)
        least = cheapest_with_parts(boxes, owner, *costs[:3])
        assert cost[0] == pytest.approx(least, rel=1e-6)
        result = without_joined(refs.scale, owner_of, left, right, box)
        sah = draft_sah(result, c_inner=1.2, c_tri=1.0, max_leaf=max_leaf)
        assert sah == pytest.approx(least / box_area(None, box, 0), rel=1e-6)
        assert count[0] == len(result.references)
        assert set(result.references.triangle) == set(owner)
        joined += len(owner) - len(result.references)
    assert joined > 0


def test_joined_parts_keep_their_room():
    """Of each triangle, the parts that are left cover what the parts before did."""
    triangles = soup(900, seed=4, size=0.5)
    before = presplit(triangles, 2.0)
    after = rearrange(radix_draft(before), options_of(), CONTEXT).references
    assert len(triangles) < len(after) < len(before)
    for t in range(len(triangles)):
        old, new = before.triangle == t, after.triangle == t
        inside = (after.lower[new][:, None] <= before.lower[old]).all(axis=2)
        inside &= (after.upper[new][:, None] >= before.upper[old]).all(axis=2)
        assert inside.any(axis=0).all()


def test_a_ground_of_two_triangles_costs_what_it_costs_unsplit():
    """Around a small crowd, splitting a huge quad pays nothing; its parts must not linger."""
    crowd = soup(3000, seed=2).corners
    quad = np.array([[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50]], np.float32)
    triangles = mibvh.Triangles(np.concatenate([crowd, quad[[[0, 1, 2], [0, 2, 3]]]]))
    whole = mibvh.sah(mibvh.build(triangles, "treelet"))
    split = mibvh.build(triangles, "streelet")
    assert split.meta["report"]["joined"] > 0
    assert mibvh.sah(split) < 1.1 * whole


def test_the_start_over_parts_is_that_of_their_boxes():
    triangles = soup(500, seed=6, size=0.5)
    parts = presplit(triangles, 0.5)
    entry = get("streelet")
    draft = start_over(parts, entry.options(), CONTEXT)
    expected = radix_draft(parts)
    assert draft.references is parts
    for key in ("left", "right", "reference"):
        np.testing.assert_array_equal(getattr(draft, key), getattr(expected, key))
    with pytest.raises(MibvhError, match="split none; sbvh does"):
        start_over(parts, entry.options(base="sbvh"), CONTEXT)


def test_a_start_as_deep_as_it_is_long():
    triangles = soup(3000, seed=9)
    nested = 0
    for i in range(1, len(triangles)):
        nested = (i, nested)
    result = rearrange(Draft.from_nested(nested, triangles), options_of(), CONTEXT)
    assert result.report["end_sah"] < 0.5 * result.report["start_sah"]
    assert sorted(result.reference[result.left < 0]) == list(range(len(triangles)))


def test_progress_is_told_and_rises():
    told = []
    draft = radix_draft(References.of(soup(2000, seed=2)))
    rearrange(draft, options_of(), Context(lambda stage, done: told.append(done)))
    assert told == sorted(told)
    assert 0.0 < told[0] <= told[-1] == 1.0


def test_impossible_options_are_refused():
    for options in ({"size": 9}, {"size": 3}, {"rounds": -1}, {"start": "nothing"}):
        with pytest.raises(MibvhError):
            mibvh.build(soup(10), "treelet", **options)
