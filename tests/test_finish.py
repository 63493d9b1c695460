"""From draft to tree: the collapse against all prunings, de-duplication, depth, layout."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mibvh.builders.draft import Draft, References
from mibvh.builders.finish import draft_boxes, draft_sah, finish
from mibvh.metrics.sah import sah
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import Triangles

COSTS = {"c_inner": 1.2, "c_tri": 1.0, "max_leaf": 8}


def random_draft(n: int, seed: int, split: bool = False, chain: bool = False) -> Draft:
    """A random tree over random boxes, its nodes in random order in memory."""
    rng = np.random.default_rng(seed)
    # Few distinct values on a coarse lattice: exact arithmetic, and many ties.
    lower = (rng.integers(0, 8, (n, 3)) / 16).astype(np.float32)
    upper = lower + (rng.integers(0, 8, (n, 3)) / 16).astype(np.float32)
    triangle = rng.integers(0, max(1, n // 2), n) if split else np.arange(n)
    triangle = np.unique(triangle, return_inverse=True)[1]  # none is left out
    left, right, reference = np.full((3, 2 * n - 1), -1, np.int32)
    names = [0, *(rng.permutation(2 * n - 2) + 1).tolist()]
    work = [(names.pop(0), rng.permutation(n))]
    while work:
        node, ids = work.pop()
        if len(ids) == 1:
            reference[node] = ids[0]
            continue
        at = 1 if chain else int(rng.integers(1, len(ids)))
        left[node], right[node] = names.pop(), names.pop()
        work += [(left[node], ids[:at]), (right[node], ids[at:])]
    refs = References(lower, upper, triangle.astype(np.int32), 0.25)
    return Draft(refs, left, right, reference)


def tree_of(draft: Draft, **costs: float) -> Tree:
    ids = draft.references.triangle
    meta = {"triangles": len(np.unique(ids)), "c_inner": 1.2, "c_tri": 1.0}
    return finish(draft, **{**COSTS, **costs}, meta=meta)


def references_below(draft: Draft, node: int) -> list[int]:
    if draft.left[node] < 0:
        return [int(draft.reference[node])]
    return references_below(draft, draft.left[node]) + references_below(draft, draft.right[node])


def half_area(refs: References, ids: list[int]) -> float:
    x, y, z = (
        refs.upper[ids].max(axis=0).astype(np.float64) - refs.lower[ids].min(axis=0)
    ).tolist()
    return x * y + y * z + z * x


def prunings(draft: Draft, node: int, max_leaf: int) -> list[float]:
    """Costs, times area, of all the trees that the subtree can be cut back to."""
    refs = draft.references
    ids = references_below(draft, node)
    size = len(np.unique(refs.triangle[ids]))
    costs = [1.0 * size * half_area(refs, ids)] if size <= max_leaf or len(ids) == 1 else []
    if draft.left[node] >= 0:
        own = 1.2 * half_area(refs, ids)
        costs += [
            own + a + b
            for a in prunings(draft, draft.left[node], max_leaf)
            for b in prunings(draft, draft.right[node], max_leaf)
        ]
    return costs


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("max_leaf", [1, 3, 8])
@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_collapse_is_the_best_of_all_prunings(n, max_leaf, split):
    for seed in range(12):
        draft = random_draft(n, seed, split)
        area = half_area(draft.references, list(range(n)))
        best = min(prunings(draft, 0, max_leaf)) / area
        tree = tree_of(draft, max_leaf=max_leaf)
        assert sah(tree) == pytest.approx(best, rel=1e-12)
        assert draft_sah(draft, **{**COSTS, "max_leaf": max_leaf}) == pytest.approx(best, rel=1e-12)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    n=st.integers(1, 300),
    seed=st.integers(0, 2**31),
    split=st.booleans(),
    max_leaf=st.integers(1, 40),
)
def test_draft_sah_is_that_of_the_tree(n, seed, split, max_leaf):
    draft = random_draft(n, seed, split)
    tree = tree_of(draft, max_leaf=max_leaf)
    expected = draft_sah(draft, **{**COSTS, "max_leaf": max_leaf})
    assert sah(tree) == pytest.approx(expected, rel=1e-12)
    assert tree.validate() == []


def test_draft_sah_without_area():
    refs = References(
        np.zeros((3, 3), np.float32), np.zeros((3, 3), np.float32), np.arange(3, dtype=np.int32)
    )
    draft = Draft(
        refs,
        np.array([1, -1, 3, -1, -1], np.int32),
        np.array([2, -1, 4, -1, -1], np.int32),
        np.array([-1, 0, -1, 1, 2], np.int32),
    )
    for max_leaf, expected in ((8, 3.0), (2, 1.2 + 1 + 2), (1, 2 * 1.2 + 3)):
        assert sah(tree_of(draft, max_leaf=max_leaf)) == pytest.approx(expected)
        assert draft_sah(draft, **{**COSTS, "max_leaf": max_leaf}) == pytest.approx(expected)


@pytest.mark.parametrize("split", [False, True])
def test_layout(split):
    """Depth-first: the left subtree's nodes and references stand before the right one's."""
    draft = random_draft(200, 3, split)
    tree = tree_of(draft, max_leaf=4)
    used, written = 1, 0
    stack = [0]
    while stack:
        node = stack.pop()
        assert tree.first[node] == written
        if tree.left[node] < 0:
            written += tree.count[node]
        else:
            assert tree.left[node] == used
            used += 2
            stack += [tree.left[node] + 1, tree.left[node]]
    assert used == len(tree)
    assert written == len(tree.references)


def test_boxes_are_the_union_of_what_is_below():
    draft = random_draft(60, 9)
    refs = draft.references
    boxes = draft_boxes(draft)
    for node in range(len(draft.left)):
        ids = references_below(draft, node)
        assert np.array_equal(boxes[node, :3], refs.lower[ids].min(axis=0))
        assert np.array_equal(boxes[node, 3:], refs.upper[ids].max(axis=0))
    tree = tree_of(draft)
    for node in range(len(tree)):
        ids = tree.references[tree.first[node] : tree.first[node] + tree.count[node]]
        assert np.array_equal(tree.lower[node], refs.lower[ids].min(axis=0) * 4)
        assert np.array_equal(tree.upper[node], refs.upper[ids].max(axis=0) * 4)


def test_leaf_holds_a_split_triangle_once():
    """Three references of two triangles in one place become a leaf of two."""
    lower, upper = np.zeros((3, 3), np.float32), np.ones((3, 3), np.float32)
    draft = Draft(
        References(lower, upper, np.array([1, 0, 1], np.int32)),
        np.array([1, -1, 3, -1, -1], np.int32),
        np.array([2, -1, 4, -1, -1], np.int32),
        np.array([-1, 0, -1, 1, 2], np.int32),
    )
    tree = tree_of(draft)
    assert tree.references.tolist() == [1, 0]
    assert tree.left.tolist() == [-1]
    assert sah(tree) == pytest.approx(2.0)


@pytest.mark.parametrize("n", [80, 300])
@pytest.mark.parametrize("max_leaf", [1, 8])
def test_depth_is_repaired(n, max_leaf):
    draft = random_draft(n, 1, chain=True)
    # Boxes in the order of the chain, each far from the last: nothing collapses.
    refs = draft.references
    chain, node = [], 0
    while draft.left[node] >= 0:
        chain.append(int(draft.reference[draft.left[node]]))
        node = draft.right[node]
    chain.append(int(draft.reference[node]))
    refs.lower[chain] = np.arange(n)[:, None] / np.float32(512)
    refs.upper[chain] = refs.lower[chain] + np.float32(0.0001)
    links = [array.copy() for array in (draft.left, draft.right, draft.reference)]
    tree = tree_of(draft, max_leaf=max_leaf)
    assert tree.meta["depth_repaired"]
    assert tree.depth <= MAX_DEPTH
    assert tree.validate() == []
    assert sorted(tree.references.tolist()) == list(range(n))
    # What is above the repair stays as it was: one reference cut off after the other.
    assert tree.references[:40].tolist() == chain[:40]
    for before, after in zip(links, (draft.left, draft.right, draft.reference), strict=True):
        assert np.array_equal(before, after)


def test_shallow_draft_is_left_alone():
    tree = tree_of(random_draft(MAX_DEPTH + 1, 1, chain=True), max_leaf=1)
    assert tree.depth == MAX_DEPTH
    assert "depth_repaired" not in tree.meta


@pytest.mark.parametrize("largest", [1e15, 1.0, 1e-20, 1e-38, 0.0])
def test_references_scale_exactly(largest):
    """Near one in size, and back in scene units exactly what the triangles are."""
    corners = np.random.default_rng(0).standard_normal((50, 3, 3))
    triangles = Triangles((corners / np.abs(corners).max() * largest).astype(np.float32))
    refs = References.of(triangles)
    assert np.abs([refs.lower, refs.upper]).max() <= 1
    assert largest < 1e-37 or np.abs([refs.lower, refs.upper]).max() >= 0.5
    assert largest < 1e-37 or np.array_equal(
        refs.lower * np.float32(1 / refs.scale), triangles.lower
    )
    assert np.log2(refs.scale) == int(np.log2(refs.scale))


def test_tiny_box_beside_a_huge_one_still_holds_its_triangle():
    corners = np.zeros((2, 3, 3), np.float32)
    corners[0] = 1e15 * np.eye(3)
    corners[1] = 1.1e-30 * np.eye(3) - 0.7e-29
    refs = References.of(Triangles(corners))
    unscale = np.float32(1 / refs.scale)
    assert (refs.lower * unscale <= corners.min(axis=1)).all()
    assert (refs.upper * unscale >= corners.max(axis=1)).all()
