"""Hits, counters and what is computed from them, on cuts of real geometry with deep split trees."""

import dataclasses
import functools

import numpy as np
import pytest
from cuts import CUTS, cut, every_cut
from test_traversal import STYLES, assert_same_hits, brute_force, ray_set, reference_counts

import mibvh
from mibvh.studies.measure.depth import remaining_after_splits, remaining_by_depth

few_trees = pytest.mark.parametrize(
    ("name", "kind"), [(n, k) for n in CUTS for k in ("sbvh, all splits", "streelet, many splits")]
)


def rays_through(triangles, count, seed):
    """Rays from points in the box around triangles to points of theirs."""
    rng = np.random.default_rng(seed)
    low, high = triangles.bounds.astype(float)
    o = low + (high - low) * rng.uniform(-0.1, 1.1, (count, 3))
    share = rng.dirichlet([1, 1, 1], count)
    to = np.einsum("ij,ijk->ik", share, triangles.corners[rng.integers(0, len(triangles), count)])
    d = to - o + rng.normal(size=(count, 3)) * 0.02
    return ray_set(o, d / np.linalg.norm(d, axis=1, keepdims=True))


@functools.cache
def traced(name):
    """Rays through a cut, and all distances."""
    triangles = mibvh.Triangles(CUTS[name]())
    rays = rays_through(triangles, 150, 7)
    return rays, brute_force(triangles, rays)


@few_trees
@pytest.mark.parametrize("style", STYLES)
def test_hits(name, kind, style):
    triangles, tree = cut(name, kind)
    rays, distances = traced(name)
    assert np.isfinite(distances.min(1)).sum() > 50
    assert_same_hits(mibvh.trace(tree, triangles, rays, style=style, repeats=1), distances)


@few_trees
@pytest.mark.parametrize("cull", [False, True])
def test_counters_and_lcv(name, kind, cull):
    """Tilted, as which of two boxes in one plane a ray enters first is a matter of roundings."""
    triangles, tree = cut(name, kind, tilted=True)
    rays = rays_through(triangles, 150, 7)
    expected = reference_counts(tree, triangles, rays, cull)
    hits = mibvh.trace(tree, triangles, rays, cull=cull, repeats=1)
    counted = np.stack([hits.inner, hits.leaves, hits.tests], axis=1)
    # A box grazed within a rounding may be counted by one and not by the other.
    assert (counted == expected).all(axis=1).mean() > 0.97
    assert counted.sum() == pytest.approx(expected.sum(), rel=5e-3)
    mean = sum(hits.leaves.tolist()) / len(rays)
    variance = sum((n - mean) ** 2 for n in hits.leaves.tolist()) / len(rays)
    assert hits.lcv == pytest.approx(variance**0.5, rel=1e-12)
    assert hits.lcv == pytest.approx(expected[:, 1].std(), rel=2e-2)


@few_trees
def test_counters_of_rays_that_any_hit_ends(name, kind):
    """Half of them are of limited length. Of a leaf, triangles up to the first hit count."""
    triangles, tree = cut(name, kind, tilted=True)
    rays = rays_through(triangles, 150, 7)
    tmax = np.where(np.arange(150) % 2, np.inf, 0.3 * triangles.diagonal).astype(np.float32)
    rays = dataclasses.replace(rays, tmax=tmax)
    expected = reference_counts(tree, triangles, rays, cull=False, any_hit=True)
    hits = mibvh.trace(tree, triangles, rays, any_hit=True, repeats=1)
    counted = np.stack([hits.inner, hits.leaves, hits.tests], axis=1)
    assert (counted == expected).all(axis=1).mean() > 0.97
    assert counted.sum() == pytest.approx(expected.sum(), rel=5e-3)
    whole = reference_counts(tree, triangles, rays, cull=False)
    assert expected.sum() < 0.95 * whole.sum()
    blocked = (brute_force(triangles, rays) < tmax[:, None]).any(axis=1)
    np.testing.assert_array_equal(hits.triangle >= 0, blocked)


@few_trees
def test_lane_utilisation(name, kind):
    """Packets of consecutive rays go on until their longest is done."""
    triangles, tree = cut(name, kind)
    rays, _ = traced(name)
    hits = mibvh.trace(tree, triangles, rays, repeats=1)
    busy = [int(i) + int(t) for i, t in zip(hits.inner, hits.tests, strict=True)]
    issued = 0
    for start in range(0, len(busy), hits.lane_width):
        issued += hits.lane_width * max(busy[start : start + hits.lane_width])
    assert hits.lane_utilisation == pytest.approx(sum(busy) / issued, rel=1e-12)


@every_cut
def test_what_remains_below_a_cut(name, kind):
    """Node by node from the root, in the tables' own words."""
    _, tree = cut(name, kind)
    x, y, z = (tree.upper.astype(float) - tree.lower.astype(float)).T
    area = x * y + y * z + z * x
    spent, remaining = remaining_by_depth(tree)
    inner, leaves, level = 0.0, 0.0, [0]
    for depth in range(tree.depth + 1):
        at_depth = sum(tree.count[n] * area[n] for n in level) / area[0]
        assert spent[depth] == pytest.approx(1.2 * inner / area[0], rel=1e-12)
        assert remaining[depth] == pytest.approx(leaves / area[0] + at_depth, rel=1e-12)
        leaves += sum(tree.count[n] * area[n] for n in level if tree.left[n] < 0)
        inner += sum(area[n] for n in level if tree.left[n] >= 0)
        level = [c for n in level if tree.left[n] >= 0 for c in (tree.left[n], tree.left[n] + 1)]
    assert spent[-1] + remaining[-1] == pytest.approx(mibvh.sah(tree), rel=1e-12)


@few_trees
def test_what_remains_after_splits(name, kind):
    _, tree = cut(name, kind)
    x, y, z = (tree.upper.astype(float) - tree.lower.astype(float)).T
    worst = tree.count * (x * y + y * z + z * x)
    found = remaining_after_splits(tree, (0, 1, 2, 3, 7, 20))
    open_nodes, expected = [0], []
    for splits in range(21):
        if splits in (0, 1, 2, 3, 7, 20):
            expected.append(sum(worst[n] for n in open_nodes) / worst[0] * tree.count[0])
        node = max((n for n in open_nodes if tree.left[n] >= 0), key=lambda n: worst[n])
        open_nodes.remove(node)
        open_nodes += [tree.left[node], tree.left[node] + 1]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
