import numpy as np
import pytest
from conftest import soup
from test_metrics import brute_force_fractions, hand_tree, hand_triangles, split_tree

import mibvh
from mibvh.metrics.epo import overlap
from mibvh.metrics.points import estimate_epo, point_costs, points_on, weight_at
from mibvh.metrics.sah import node_costs


def test_point_costs_by_hand():
    """In the hand tree of two squares, a point of a square lies in the root and its leaf."""
    triangles = hand_triangles()
    points = np.array([[0.5, 0.25, 0], [1.5, 0.25, 0], [1.0, 0.5, 0]])
    costs = point_costs(hand_tree(), triangles, points, np.array([0, 2, 0], np.int32))
    # Root 1.2, leaves 2 each; the third point stands on the closed face between the leaves.
    np.testing.assert_allclose(costs, [[0, 3.2], [0, 3.2], [2, 3.2]])


def test_estimate_covers_the_exact_value():
    """The 95% interval holds the exact value in 95% of 200 repetitions, give or take."""
    triangles = soup(400, 2, size=0.2)
    tree = mibvh.build(triangles, "lbvh")
    exact = mibvh.epo(tree, triangles)
    held = 0
    for seed in range(200):
        low, high = estimate_epo(tree, triangles, 600, seed).interval()
        held += low <= exact <= high
    # Binomial(200, 0.95) lies between 180 and 198 with probability 0.998.
    assert 180 <= held <= 199


def test_estimate_is_better_than_its_points_alone():
    triangles = soup(400, 2, size=0.2)
    tree = mibvh.build(triangles, "lbvh")
    found = mibvh.estimate_epo(tree, triangles, 4000)
    rng = np.random.default_rng(0)
    ids = rng.choice(len(triangles), 4000, p=triangles.areas / triangles.areas.sum()).astype(
        np.int32
    )
    plain = point_costs(tree, triangles, points_on(triangles, ids), ids)[:, 0]
    assert 0 < found.standard_error < plain.std() / np.sqrt(4000)
    with pytest.raises(mibvh.MibvhError, match="at least 4 points"):
        mibvh.estimate_epo(tree, triangles, 2)


def test_density_follows_where_rays_end():
    """Half of the triangles get all ray ends, a few of the others one each."""
    triangles = soup(2000, 3, size=0.05)
    busy = np.flatnonzero(triangles.corners[:, :, 0].mean(1) < 1.5).astype(np.int32)
    rng = np.random.default_rng(0)
    p = triangles.areas[busy] / triangles.areas[busy].sum()
    ids = rng.choice(busy, 50000, p=p).astype(np.int32)
    ends = mibvh.RayEnds(points_on(triangles, ids), ids, 50000)
    density = ends.density(triangles)
    expected = 50000 / triangles.areas[busy].sum()
    weighted = np.average(density[busy], weights=triangles.areas[busy])
    assert weighted == pytest.approx(expected, rel=0.03)
    idle = np.setdiff1d(np.arange(2000), busy)
    assert np.median(density[idle]) < 0.05 * expected
    # Few rays: triangles that none reached are not taken for unreachable.
    few = mibvh.RayEnds(ends.points[:500], ids[:500], 500).density(triangles)
    assert (few[busy] > 0).all()
    assert np.corrcoef(few, density)[0, 1] > 0.5


@pytest.fixture(scope="module")
def traced(cornell):
    rays = mibvh.diffuse_rays(cornell, width=64, height=48, samples=2)
    tree = mibvh.build(cornell.triangles, "lbvh")
    hits = mibvh.trace(tree, cornell.triangles, rays, repeats=1)
    return tree, cornell.triangles, rays, hits


def test_ray_ends_lie_on_their_triangles(traced):
    _, triangles, rays, hits = traced
    starts, ends = mibvh.ray_ends(triangles, rays, hits)
    assert len(starts) == len(rays)
    assert len(ends) == (hits.triangle >= 0).sum()
    assert ends.share == len(ends) / len(rays)
    np.testing.assert_allclose(starts.points, rays.o, atol=2e-4)
    for found in (starts, ends):
        low, high = triangles.lower[found.triangle], triangles.upper[found.triangle]
        assert (found.points >= low - 1e-6).all()
        assert (found.points <= high + 1e-6).all()


def test_epo_at_ends_agrees_with_the_density(traced):
    """Two estimators of one thing: points where rays end, and areas weighted by their density."""
    tree, triangles, rays, hits = traced
    starts, ends = mibvh.ray_ends(triangles, rays, hits)
    both = starts.joined(ends)
    at_points = mibvh.epo_at_ends(tree, triangles, both)
    by_density = mibvh.epo(tree, triangles, weights=both.density(triangles))
    evenly = mibvh.epo(tree, triangles)
    assert abs(at_points.value - by_density) < 0.03 * at_points.value
    assert at_points.standard_error < 0.01 * at_points.value
    # Neither is the EPO of ends spread evenly, from which this scene's are far.
    assert evenly < 0.8 * at_points.value


def test_fragments_against_brute_force():
    """Every reference's part of its triangle, cut to its leaf, against every node."""
    triangles = soup(40, 4, size=0.3)
    tree = split_tree(triangles)
    from test_metrics import clipped_area

    leaves = np.flatnonzero(tree.is_leaf)
    expected = np.zeros(len(tree))
    for leaf in leaves:
        for position in range(tree.first[leaf], tree.first[leaf] + tree.count[leaf]):
            corners = triangles.corners[tree.references[position]]
            for node in range(len(tree)):
                if tree.first[node] <= position < tree.first[node] + tree.count[node]:
                    continue
                low = np.maximum(tree.lower[node], tree.lower[leaf]).astype(float)
                high = np.minimum(tree.upper[node], tree.upper[leaf]).astype(float)
                if (low <= high).all():
                    expected[node] += clipped_area(corners, low, high)
    expected /= triangles.areas.sum()
    found = overlap(tree, triangles, fragments=True).fraction
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    assert (node_costs(tree) * found).sum() > 0


def test_fragments_make_no_difference_without_splits():
    triangles = soup(100, 5)
    tree = mibvh.build(triangles, "bbvh")
    assert mibvh.epo(tree, triangles, fragments=True) == pytest.approx(mibvh.epo(tree, triangles))
    np.testing.assert_allclose(
        overlap(tree, triangles).fraction, brute_force_fractions(tree, triangles), atol=1e-12
    )


def test_per_depth_adds_up(traced):
    tree, triangles, _, _ = traced
    shares = mibvh.epo_per_depth(tree, triangles)
    assert shares[0] == 0.0  # nothing is foreign to the root
    assert shares.sum() == pytest.approx(mibvh.epo(tree, triangles))
    with pytest.raises(mibvh.MibvhError, match="weights must be"):
        mibvh.epo(tree, triangles, weights=[1.0])


def chain(depth):
    """A tree in which each inner node has a leaf and the rest of the tree."""
    count = depth + 1
    at = np.arange(count, dtype=np.float32)[:, None, None]
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32) + at * [0, 0, 1]
    triangles = mibvh.Triangles(corners.astype(np.float32))
    nodes = 2 * depth + 1
    left = np.full(nodes, -1, np.int32)
    first, counts = np.zeros(nodes, np.int32), np.ones(nodes, np.int32)
    counts[0] = count
    for level in range(depth):
        node = 2 * level  # the root, and then each second child
        left[node] = 2 * level + 1
        first[left[node]], first[left[node] + 1] = level, level + 1
        counts[left[node] + 1] = depth - level
    low, high = triangles.lower, triangles.upper
    lower = np.array([low[f : f + c].min(0) for f, c in zip(first, counts, strict=True)])
    upper = np.array([high[f : f + c].max(0) for f, c in zip(first, counts, strict=True)])
    references = np.arange(count, dtype=np.int32)
    meta = {"triangles": count, "c_inner": 1.2, "c_tri": 1.0}
    return mibvh.Tree(lower, upper, left, first, counts, references, meta)


def test_point_queries_of_trees_of_any_depth():
    """In a chain of 600 nodes the leaves of all levels wait while the last is looked at."""
    tree = chain(600)
    assert tree.depth == 600
    at = np.array([[0.25, 0.25, 0.0], [0.25, 0.25, 600.0], [0.25, 0.25, 10.0]])
    # A point is in its leaf, and in the inner nodes above it: the last two leaves share a level.
    np.testing.assert_array_equal(weight_at(tree, at, np.ones(len(tree))), [2, 601, 12])


def test_point_queries_refuse_what_does_not_fit():
    triangles, tree = hand_triangles(), hand_tree()
    points = np.zeros((2, 3))
    with pytest.raises(mibvh.MibvhError, match=r"not \(2, 3\) and \(1,\)"):
        mibvh.point_costs(tree, triangles, points, np.zeros(1, np.int32))
    for wrong in ([0, 4], [-1, 0], [0.0, 1.0]):
        with pytest.raises(mibvh.MibvhError, match="from 0 to 3"):
            mibvh.point_costs(tree, triangles, points, np.array(wrong))
