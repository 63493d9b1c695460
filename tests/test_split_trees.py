"""Fast metrics against their slow twins on cuts of real geometry, with deep split trees."""

import numpy as np
import pytest
import twins
from cuts import CUTS, cut, every_cut

import mibvh
from mibvh.metrics.epo import epo_per_depth, overlap
from mibvh.metrics.lines import line_costs
from mibvh.metrics.points import points_on, triangle_positions, weight_at

few_trees = pytest.mark.parametrize(
    ("name", "kind"), [(n, k) for n in CUTS for k in ("sbvh", "streelet, many splits")]
)


@every_cut
def test_the_trees_are_valid_and_split(name, kind):
    triangles, tree = cut(name, kind)
    assert tree.validate(triangles) == []
    assert 900 < len(triangles) < 2000
    assert len(tree.references) > 1.1 * len(triangles)
    assert tree.depth >= 11


@every_cut
def test_epo(name, kind):
    triangles, tree = cut(name, kind)
    expected = twins.foreign_fractions(tree, triangles)
    np.testing.assert_allclose(overlap(tree, triangles).fraction, expected, rtol=1e-9, atol=1e-14)
    assert mibvh.epo(tree, triangles) == pytest.approx(twins.node_costs(tree) @ expected, rel=1e-12)


@few_trees
def test_epo_of_fragments(name, kind):
    triangles, tree = cut(name, kind)
    expected = twins.fragment_fractions(tree, triangles)
    found = overlap(tree, triangles, fragments=True).fraction
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)


@few_trees
def test_epo_with_weights(name, kind):
    triangles, tree = cut(name, kind)
    weights = np.random.default_rng(0).lognormal(0, 2, len(triangles))
    weights[::5] = 0.0
    expected = twins.foreign_fractions(tree, triangles, weights)
    found = overlap(tree, triangles, weights=weights).fraction
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)


@few_trees
def test_epo_per_depth(name, kind):
    triangles, tree = cut(name, kind)
    depth = np.zeros(len(tree), int)
    for node in np.flatnonzero(tree.left >= 0):
        depth[tree.left[node] : tree.left[node] + 2] = depth[node] + 1
    shares = twins.node_costs(tree) * twins.foreign_fractions(tree, triangles)
    expected = [shares[depth == d].sum() for d in range(depth.max() + 1)]
    np.testing.assert_allclose(epo_per_depth(tree, triangles), expected, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("name", CUTS)
def test_epo_is_the_same_for_any_number_of_threads_and_blocks(name, monkeypatch):
    triangles, tree = cut(name, "sbvh, all splits")
    one = overlap(tree, triangles, threads=1)
    for block in (1, 7, 100):
        monkeypatch.setattr("mibvh.metrics.epo._BLOCK", block)
        several = overlap(tree, triangles, threads=5)
        np.testing.assert_array_equal(one.fraction, several.fraction)
        assert one.pairs == several.pairs


@pytest.mark.parametrize("builder", ["lbvh", "sbvh"])
def test_epo_of_a_thicket(builder):
    """Hundreds of nodes reach into most boxes: more than are passed on in place of one."""
    rng = np.random.default_rng(0)
    middle, along = rng.normal(size=(2, 1200, 1, 3))
    blade = np.array([-1, 1, 1.01])[:, None]
    corners = 0.2 * middle + along * blade + 0.01 * rng.normal(size=(1200, 3, 3))
    corners[::3] = 0.1 * middle[::3] + 0.1 * rng.normal(size=(400, 3, 3))
    triangles = mibvh.Triangles(corners.astype(np.float32))
    tree = mibvh.build(triangles, builder)
    expected = twins.foreign_fractions(tree, triangles)
    np.testing.assert_allclose(overlap(tree, triangles).fraction, expected, rtol=1e-9, atol=1e-14)


@every_cut
def test_the_estimate_of_epo_covers_the_exact_value(name, kind):
    """Within 4 standard errors: a false alarm in 16,000 runs each, and the seed is fixed."""
    triangles, tree = cut(name, kind)
    estimate = mibvh.estimate_epo(tree, triangles, 40000)
    assert estimate.standard_error < 0.05 * estimate.value
    assert abs(mibvh.epo(tree, triangles) - estimate.value) < 4 * estimate.standard_error


@every_cut
def test_point_costs(name, kind):
    triangles, tree = cut(name, kind)
    ids = np.random.default_rng(1).integers(0, len(triangles), 300).astype(np.int32)
    points = points_on(triangles, ids, 2)
    points[:100] = triangles.corners[ids[:100], 0]  # on faces of boxes
    expected = twins.point_costs(tree, triangles, points, ids)
    found = mibvh.point_costs(tree, triangles, points, ids)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    at = weight_at(tree, points, twins.node_costs(tree))
    np.testing.assert_allclose(at, expected.sum(axis=1), rtol=1e-12)


@every_cut
def test_positions_of_references(name, kind):
    triangles, tree = cut(name, kind)
    starts, positions = triangle_positions(tree, len(triangles))
    for t in range(len(triangles)):
        assert (positions[starts[t] : starts[t + 1]] == np.flatnonzero(tree.references == t)).all()


def rays_about(triangles, count, seed):
    """Rays from and to points of the box around triangles; some along its axes."""
    rng = np.random.default_rng(seed)
    low, high = triangles.bounds.astype(float)
    o, to = low + (high - low) * rng.uniform(-0.1, 1.1, (2, count, 3))
    d = to - o
    d[: count // 4, 0] = 0.0
    d[: count // 8, 1] = 0.0
    o[: count // 2] = triangles.corners[rng.integers(0, len(triangles), count // 2), 0]
    return o, d, rng.random(count)


@every_cut
@pytest.mark.parametrize("whole", [True, False])
def test_line_costs(name, kind, whole):
    triangles, tree = cut(name, kind)
    o, d, length = rays_about(triangles, 200, 3)
    lines = mibvh.RayLines(o, d, length, np.ones(len(o)))
    start, stop = (-np.inf, np.full(len(o), np.inf)) if whole else (0.0, length)
    expected = twins.line_costs(tree, o, d, start, stop)
    np.testing.assert_allclose(line_costs(tree, lines, whole=whole), expected, rtol=1e-12)


@few_trees
def test_sah_of_lines(name, kind):
    triangles, tree = cut(name, kind)
    o, d, length = rays_about(triangles, 200, 4)
    share = np.random.default_rng(5).random(len(o))
    costs = twins.line_costs(tree, o, d, -np.inf, np.full(len(o), np.inf))
    found = mibvh.sah_of_lines(tree, mibvh.RayLines(o, d, length, share))
    assert found.value == pytest.approx((share * costs).sum() / share.sum(), rel=1e-12)


@every_cut
def test_sah(name, kind):
    _, tree = cut(name, kind)
    x, y, z = (tree.upper.astype(float) - tree.lower.astype(float)).T
    area = x * y + y * z + z * x
    expected = (twins.node_costs(tree) * area).sum() / area[0]
    assert mibvh.sah(tree) == pytest.approx(expected, rel=1e-12)
