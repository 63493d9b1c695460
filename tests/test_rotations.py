"""`hill` and `anneal`: each rotation against the tree drawn anew, and sweeps against plain ones."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from conftest import soup

import mibvh
from mibvh.builders import Builder, Context, Options, get, registry
from mibvh.builders.draft import Draft, References
from mibvh.builders.morton import radix_draft
from mibvh.builders.rotations import (
    _LEAST,
    _anneal_chunk,
    box_area,
    climb,
    depth_first,
    inner_area,
    rotate,
    rotation_change,
)
from mibvh.builders.splitting import presplit

CONTEXT = Context()
EXPONENTIAL = -np.log((np.arange(4096) + 0.5) / 4096).astype(np.float32)


def draft_of(triangles, name="lbvh", **options):
    entry = get(name)
    return entry.draft(triangles, entry.options(**options), CONTEXT)


def random_tree(count, seed):
    """Arrays of a tree over a soup, merged at random."""
    rng = np.random.default_rng(seed)
    parts = [np.array([i]) for i in range(count)]
    while len(parts) > 1:
        a, b = (parts.pop(rng.integers(len(parts))) for _ in range(2))
        parts.append((a, b))
    draft = Draft.from_nested(parts[0], soup(count, seed))
    return draft, *depth_first(draft)


def shape(left, right, node=0):
    """A tree as nested unordered pairs, so that mirror images are equal."""
    if left[node] < 0:
        return int(node)
    return frozenset([shape(left, right, left[node]), shape(left, right, right[node])])


def drawn_anew(left, right, reference, references, node=0):
    """Box of a node and inner area below it, from the references alone."""
    if left[node] < 0:
        r = reference[node]
        return np.float64([references.lower[r], references.upper[r]]), 0.0
    (a, area_a), (b, area_b) = (
        drawn_anew(left, right, reference, references, side[node]) for side in (left, right)
    )
    box = np.array([np.minimum(a[0], b[0]), np.maximum(a[1], b[1])])
    x, y, z = box[1] - box[0]
    return box, area_a + area_b + x * y + y * z + z * x


def possible(left, right, box, node):
    return [k for k in range(6) if rotation_change(None, left, right, box, node, k) < np.inf]


def test_the_change_of_every_rotation_is_that_of_the_tree_drawn_anew():
    tried = np.zeros(6, int)
    for seed in range(4):
        draft, left, right, reference, _, box = random_tree(24, seed)
        _, before = drawn_anew(left, right, reference, draft.references)
        for node in np.flatnonzero(left >= 0):
            for kind in possible(left, right, box, node):
                change = rotation_change(None, left, right, box, node, kind)
                a, b, c = left.copy(), right.copy(), box.copy()
                rotate(a, b, c, node, kind)
                _, after = drawn_anew(a, b, reference, draft.references)
                assert change == pytest.approx(after - before, abs=1e-12)
                assert inner_area(None, a, c) == pytest.approx(after, rel=1e-12)
                tried[kind] += 1
    assert tried.min() > 20


def test_the_six_rotations_are_all_there_are():
    """Every exchange of subtrees up to two levels below a node, less mirror images."""
    draft = Draft.from_nested(((0, 1), (2, 3)), soup(4))
    left, right, _, _, box = depth_first(draft)
    slots = [(left, 0), (right, 0), *itertools.product((left, right), (left[0], right[0]))]
    expected = set()
    for (a, i), (b, j) in itertools.combinations(slots, 2):
        new_left, new_right = left.copy(), right.copy()
        x, y = (new_left if s is left else new_right for s in (a, b))
        if a[i] == j or b[j] == i:
            continue  # a node and its own child cannot change places
        x[i], y[j] = y[j], x[i]
        expected.add(shape(new_left, new_right))
    found = []
    for kind in range(6):
        new = left.copy(), right.copy(), box.copy()
        rotate(*new, 0, kind)
        found.append(shape(*new[:2]))
    assert len(set(found)) == 6
    assert set(found) == expected - {shape(left, right)}


def test_a_rotation_below_which_there_is_nothing_is_refused():
    _, left, right, _, _, box = random_tree(2, 0)
    assert possible(left, right, box, 0) == []
    draft = Draft.from_nested((0, (1, 2)), soup(3))
    left, right, _, _, box = depth_first(draft)
    assert possible(left, right, box, 0) == [0, 1]


def plain_climb(left, right, box):
    """Hill climbing that looks at every node in every sweep."""

    def visit(node):
        if left[node] < 0:
            return 0
        done = visit(left[node]) + visit(right[node])
        changes = [rotation_change(None, left, right, box, node, k) for k in range(6)]
        if min(changes) < -_LEAST * box_area(None, box, node):
            rotate(left, right, box, node, int(np.argmin(changes)))
            done += 1
        return done

    done = [visit(0)]
    while done[-1]:
        done.append(visit(0))
    return len(done), sum(done)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 40, 200])
def test_climbing_equals_sweeps_over_all_nodes_and_ends_in_a_local_minimum(count):
    _, left, right, _, _, box = random_tree(count, count)
    twin = left.copy(), right.copy(), box.copy()
    before = inner_area(None, left, box)
    sweeps, rotations = climb(None, left, right, box, 1000, CONTEXT)
    if count > 1:
        assert (sweeps, rotations) == plain_climb(*twin)
    for mine, plain in zip((left, right, box), twin, strict=True):
        np.testing.assert_array_equal(mine, plain)
    for node in np.flatnonzero(left >= 0):
        for kind in range(6):
            assert rotation_change(None, left, right, box, node, kind) >= -_LEAST * box_area(
                None, box, node
            )
    assert inner_area(None, left, box) < before or rotations == 0
    assert count < 5 or rotations > 0


def test_climbing_stops_after_the_sweeps_it_is_given():
    _, left, right, _, _, box = random_tree(200, 5)
    assert climb(None, left, right, box, 1, CONTEXT)[0] == 1
    assert climb(None, left, right, box, 0, CONTEXT) == (0, 0)
    assert climb(None, left, right, box, 1000, CONTEXT)[0] > 1


def test_annealing_accepts_with_the_probability_it_says():
    """Three references: two of the six rotations exist at the root, none elsewhere."""
    draft = Draft.from_nested((0, (1, 2)), soup(3, seed=3, size=1.0))
    left, right, _, _, box = depth_first(draft)
    changes = np.array([rotation_change(None, left, right, box, 0, k) for k in range(6)])
    temperature = np.abs(changes[:2]).max()
    taken = 0
    for sweep in range(6000):
        a, b, c = left.copy(), right.copy(), box.copy()
        done, change = _anneal_chunk(
            None, a, b, c, 0, 5, np.uint64(1), np.uint64(sweep), temperature, EXPONENTIAL
        )
        taken += done
        assert change == pytest.approx(
            inner_area(None, a, c) - inner_area(None, left, box), abs=1e-12
        )
    expected = np.minimum(np.exp(-changes / temperature), 1.0).mean()
    assert taken / 6000 == pytest.approx(expected, abs=0.025)


def test_annealing_keeps_count_of_the_area():
    draft, left, right, reference, _, box = random_tree(300, 8)
    before = inner_area(None, left, box)
    args = np.uint64(3), np.uint64(5), before / 300, EXPONENTIAL
    done, change = _anneal_chunk(None, left, right, box, 0, len(left), *args)
    _, after = drawn_anew(left, right, reference, draft.references)
    assert done > 30
    assert before + change == pytest.approx(after, rel=1e-9)
    assert inner_area(None, left, box) == pytest.approx(after, rel=1e-9)


@pytest.fixture
def split_start(monkeypatch):
    """Name of a builder whose drafts hold triangles in several parts."""

    def split(triangles, options, context):
        return radix_draft(presplit(triangles, 0.5))

    entry = Builder("split", "", "", Options, split)
    monkeypatch.setitem(registry._registered, "split", entry)
    return "split"


@pytest.mark.parametrize("start", ["lbvh", "bbvh", "split"])
@pytest.mark.parametrize("max_leaf", [1, 8])
def test_never_worse_than_the_start_and_sound(start, max_leaf, split_start):
    triangles = soup(400, seed=2)
    begin = draft_of(triangles, start, max_leaf=max_leaf)
    assert (len(begin.references) > len(triangles)) == (start == split_start)
    for name, extra in (("hill", {}), ("anneal", {"sweeps": 40})):
        tree = mibvh.build(triangles, name, start=start, max_leaf=max_leaf, **extra)
        report = tree.meta["report"]
        assert tree.validate(triangles) == []
        assert tree.count[tree.left < 0].max() <= max_leaf
        assert report["end_sah"] <= report["start_sah"]
        assert mibvh.sah(tree) == pytest.approx(report["end_sah"], rel=1e-5)
        assert report["iterations"] > 0


def test_hill_lowers_a_morton_tree_and_a_hot_anneal_leaves_the_start_alone():
    triangles = soup(1000, seed=4)
    report = draft_of(triangles, "hill", start="lbvh").report
    assert report["end_sah"] < 0.9 * report["start_sah"]
    assert report["rotations"] > 100
    start = draft_of(triangles, "hill", start="bbvh")
    hot = draft_of(triangles, "anneal", start="bbvh", sweeps=5, hot=1e6, cold=1e6)
    assert hot.report["end_sah"] <= start.report["start_sah"]
    assert hot.report["rotations"] > 2 * len(triangles)


def test_annealing_is_seeded():
    triangles = soup(500, seed=6)

    def annealed(seed):
        return draft_of(triangles, "anneal", start="lbvh", sweeps=500, seed=seed)

    first, again, other = annealed(1), annealed(1), annealed(2)
    np.testing.assert_array_equal(first.left, again.left)
    np.testing.assert_array_equal(first.right, again.right)
    assert first.report == again.report
    assert not np.array_equal(first.left, other.left)
    assert first.report["end_sah"] < draft_of(triangles, "hill", start="lbvh").report["end_sah"]


def test_a_start_as_deep_as_it_is_long():
    triangles = soup(3000, seed=9)
    nested = 0
    for i in range(1, len(triangles)):
        nested = (i, nested)
    left, right, reference, count, box = depth_first(Draft.from_nested(nested, triangles))
    assert count[0] == len(triangles)
    climb(None, left, right, box, 1000, CONTEXT)
    assert sorted(reference[left < 0]) == list(range(len(triangles)))


def test_depth_first_is_the_same_tree_in_order():
    draft, left, right, reference, count, box = random_tree(50, 3)
    inner = left >= 0
    np.testing.assert_array_equal(left[inner], np.flatnonzero(inner) + 1)
    np.testing.assert_array_equal(right[inner], left[inner] + 2 * count[left[inner]] - 1)

    def leaves(left, right, reference, node=0):
        if left[node] < 0:
            return int(reference[node])
        return tuple(leaves(left, right, reference, side[node]) for side in (left, right))

    assert leaves(left, right, reference) == leaves(draft.left, draft.right, draft.reference)
    whole, area = drawn_anew(left, right, reference, References.of(soup(50, 3)))
    np.testing.assert_array_equal(box[0], whole.ravel())
    assert inner_area(None, left, box) == pytest.approx(area, rel=1e-12)
