"""The builders that came after the paper: their choices against plain ones."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import soup
from test_builders_all import room, same

import mibvh
from mibvh.builders import Context, Draft, References, later_names, names
from mibvh.builders.binned import BinnedOptions, binned
from mibvh.builders.finish import draft_boxes
from mibvh.builders.ploc import PlocOptions, ploc
from mibvh.builders.reinsertion import (
    _costs,
    _find_some,
    _move_all,
    _parents_and_depth,
)
from mibvh.builders.rotations import depth_first
from mibvh.errors import MibvhError
from mibvh.metrics.sah import sah
from mibvh.morton import morton_codes


def half_area(low, high):
    x, y, z = high.astype(np.float64) - low
    return x * y + y * z + z * x


def children_sets(draft):
    """The references below each child of the root."""
    out = []
    for child in (draft.left[0], draft.right[0]):
        found, work = [], [child]
        while work:
            node = work.pop()
            if draft.left[node] < 0:
                found.append(int(draft.reference[node]))
            else:
                work += [draft.left[node], draft.right[node]]
        out.append(sorted(found))
    return out


@pytest.mark.parametrize("seed", range(6))
def test_the_root_of_binned_is_split_at_the_best_plane(seed):
    triangles = soup(300, seed)
    refs, bins = References.of(triangles), 8
    centers = refs.lower + refs.upper
    low, high = centers.min(axis=0), centers.max(axis=0)
    costs = {}
    for axis in range(3):
        at = ((centers[:, axis] - low[axis]) * (np.float32(bins) / (high - low)[axis])).astype(int)
        at = np.minimum(at, bins - 1)
        for plane in range(1, bins):
            sides = [np.flatnonzero(at < plane), np.flatnonzero(at >= plane)]
            if all(map(len, sides)):
                costs[axis, plane] = (
                    sum(
                        len(s) * half_area(refs.lower[s].min(0), refs.upper[s].max(0))
                        for s in sides
                    ),
                    sides,
                )
    least = min(cost for cost, _ in costs.values())
    found = children_sets(binned(triangles, BinnedOptions(bins=bins), Context()))
    cost = sum(
        len(s) * half_area(refs.lower[s].min(0), refs.upper[s].max(0)) for s in map(np.array, found)
    )
    assert cost == pytest.approx(least, rel=1e-5)


def plain_ploc(refs, radius):
    """Nested pairs, by the rule in its plainest form."""
    order = np.argsort(morton_codes(refs.lower, refs.upper), kind="stable")
    clusters = [((int(i),), refs.lower[i], refs.upper[i]) for i in order]
    merged = set()
    while len(clusters) > 1:
        near = []
        for i, (_, low, high) in enumerate(clusters):
            around = range(max(0, i - radius), min(len(clusters), i + radius + 1))
            near.append(
                min(
                    (
                        np.float32(
                            half_area(
                                np.minimum(low, clusters[j][1]), np.maximum(high, clusters[j][2])
                            )
                        ),
                        min(i, j),
                        max(i, j),
                        j,
                    )
                    for j in around
                    if j != i
                )[3]
            )
        kept = []
        for i, cluster in enumerate(clusters):
            j = near[i]
            if near[j] == i and j < i:
                continue
            if near[j] == i:
                other = clusters[j]
                cluster = (
                    cluster[0] + other[0],
                    np.minimum(cluster[1], other[1]),
                    np.maximum(cluster[2], other[2]),
                )
                merged.add(tuple(sorted(cluster[0])))
            kept.append(cluster)
        clusters = kept
    return merged


def subtrees(draft):
    """The sets of references below the inner nodes."""
    out, below = set(), {}
    order, work = [], [0]
    while work:
        node = work.pop()
        order.append(node)
        if draft.left[node] >= 0:
            work += [draft.left[node], draft.right[node]]
    for node in reversed(order):
        if draft.left[node] < 0:
            below[node] = [int(draft.reference[node])]
        else:
            below[node] = below[draft.left[node]] + below[draft.right[node]]
            out.add(tuple(sorted(below[node])))
    return out


@pytest.mark.parametrize("radius", [1, 4, 100])
def test_ploc_merges_what_the_plain_rule_merges(radius):
    for seed in range(4):
        triangles = soup(70, seed)
        draft = ploc(triangles, PlocOptions(radius=radius), Context())
        assert subtrees(draft) == plain_ploc(References.of(triangles), radius)


def test_ploc_ends_where_all_boxes_are_equal():
    corners = np.repeat(soup(1).corners, 300, axis=0)
    for group in (0, 16):
        tree = mibvh.build(corners, "ploc", group=group)
        assert tree.validate(mibvh.Triangles(corners)) == []


def test_ploc_in_groups_is_another_tree_of_about_equal_cost():
    triangles = mibvh.Triangles(room(3000))
    whole, groups = (mibvh.build(triangles, "ploc", group=g) for g in (0, 16))
    assert not same(whole, groups)
    assert sah(groups) == pytest.approx(sah(whole), rel=0.1)
    # All that fit into one group are merged as they would be without: at the root.
    few = mibvh.Triangles(room(16))
    assert same(*(mibvh.build(few, "ploc", group=g) for g in (0, 16)))


# ------------------------------------------------------------------ reinsertion


def arrays_of(triangles):
    """A tree over the triangles in any order: as bad as trees get."""
    order = np.random.default_rng(1).permutation(len(triangles))
    draft = Draft.from_nested(order, triangles)
    left, right, _, _, box = depth_first(draft)
    return left, right, box


def find_all(nodes, *arrays):
    places, gains = np.empty(len(nodes), np.int32), np.empty(len(nodes), np.float64)
    _find_some(0, len(nodes), nodes, places, gains, None, *arrays)
    return places, gains


def inner_area(left, box):
    return _costs(None, box)[left >= 0].sum()


@pytest.mark.parametrize("seed", range(3))
def test_gains_are_those_of_the_best_move_of_all_the_root_included(seed):
    left, right, box = arrays_of(soup(24, seed, size=0.2))
    parent, _, depth = _parents_and_depth(left, right)
    nodes = np.arange(1, len(left), dtype=np.int32)
    places, gains = find_all(nodes, left, right, parent, box, _costs(None, box), depth)
    before, across = inner_area(left, box), 0
    for node, place, gain in zip(nodes, places, gains, strict=True):
        best = 0.0
        for to in range(1, len(left)):
            up = to
            while up > 0 and up != node:
                up = parent[up]
            if up == node or to in (parent[node],) or parent[to] == parent[node]:
                continue
            moved = [a.copy() for a in (left, right, parent, box)]
            cost = _costs(None, box)
            done = _move_all(
                None,
                np.array([node], np.int32),
                np.array([to], np.int32),
                *moved,
                cost,
                np.zeros(len(left), np.bool_),
            )
            assert done == 1
            saved = before - inner_area(moved[0], moved[3])
            best = max(best, saved)
            if to == place:
                assert gain == pytest.approx(saved, rel=1e-6, abs=1e-9)
        assert gain == pytest.approx(best, rel=1e-6, abs=1e-9)
        across += place >= 0 and _below_root(parent, node) != _below_root(parent, place)
    assert across > 0  # what the widely copied code leaves out


def _below_root(parent, node):
    while parent[node] != 0:
        node = parent[node]
    return node


def test_moves_leave_a_tree():
    left, right, box = arrays_of(mibvh.Triangles(room(400)))
    rng = np.random.default_rng(0)
    for _ in range(20):
        parent, _, depth = _parents_and_depth(left, right)
        nodes = rng.permutation(np.arange(1, len(left), dtype=np.int32))
        cost = _costs(None, box)
        places, _ = find_all(nodes, left, right, parent, box, cost, depth)
        nodes, places = nodes[places >= 0], places[places >= 0]
        _move_all(
            None, nodes, places, left, right, parent, box, cost, np.zeros(len(left), np.bool_)
        )
        again, belongs, _ = _parents_and_depth(left, right)
        assert belongs.all()
        np.testing.assert_array_equal(parent, again)
        inner = np.flatnonzero(left >= 0)
        for k, least in ((slice(3), np.minimum), (slice(3, 6), np.maximum)):
            joined = least(box[left[inner], k], box[right[inner], k])
            np.testing.assert_array_equal(box[inner, k], joined)
        np.testing.assert_array_equal(cost, _costs(None, box))


def test_reinsertion_is_as_good_as_insertion():
    triangles = mibvh.Triangles(room(3000))
    bittner = sah(mibvh.build(triangles, "bittner"))
    assert sah(mibvh.build(triangles, "reinsertion", start="bbvh")) < 1.03 * bittner


@pytest.mark.parametrize("passes", [0, 1])
def test_reinsertion_reports_the_passes_that_it_made(passes):
    report = mibvh.build(room(100), "reinsertion", passes=passes).meta["report"]
    assert report["iterations"] == (3 if passes else 0)
    assert passes or report["moves"] == 0


# ------------------------------------------------------------------ splitting up front


@pytest.mark.parametrize("name", ["bbvh", "binned", "lbvh", "ploc", "agglo", "bittner", "hill"])
def test_any_builder_that_splits_none_takes_split_triangles(name):
    triangles = mibvh.Triangles(room(1500))
    tree = mibvh.build(triangles, name, presplit=0.3)
    assert tree.validate(triangles) == []
    assert len(triangles) < len(tree.references) <= 1.3 * len(triangles)
    assert sah(tree) < sah(mibvh.build(triangles, name))


def test_builders_that_split_refuse_split_triangles():
    with pytest.raises(MibvhError, match="for builders that split none; sbvh does"):
        mibvh.build(room(1500), "sbvh", presplit=0.3)


def test_presplit_of_nothing_changes_no_bit():
    corners = room(300)
    assert same(mibvh.build(corners, "bbvh"), mibvh.build(corners, "bbvh", presplit=0.0))


@pytest.mark.parametrize("combined", ["bittner_sbvh", "bittner_streelet", "treelet_sbvh"])
def test_named_combinations_are_the_combinations(combined):
    corners = room(800)
    name, start = combined.split("_")
    assert same(mibvh.build(corners, combined), mibvh.build(corners, name, start=start))


def test_studies_take_the_later_builders_only_by_name():
    assert not set(later_names()) & set(names())
    assert {"binned", "bittner_sbvh", "embree", "finite"} <= set(later_names())


def test_draft_boxes_of_ploc_hold_their_children():
    draft = ploc(soup(200), PlocOptions(), Context())
    boxes = draft_boxes(draft)
    inner = np.flatnonzero(draft.left >= 0)
    assert (boxes[inner, :3] <= boxes[draft.left[inner], :3]).all()
    assert (boxes[inner, 3:] >= boxes[draft.right[inner], 3:]).all()
