"""Every figure on wide trees: the binary ones at width two, brute force at four and eight."""

import dataclasses

import numpy as np
import pytest
from conftest import clipped
from test_lines import some_lines

import mibvh
from mibvh.collapsing import binary_nodes, collapse, unfold
from mibvh.metrics.epo import overlap
from mibvh.metrics.lines import line_costs, ray_lines, sah_of_lines
from mibvh.metrics.points import (
    epo_at_ends,
    estimate_epo,
    point_costs,
    points_on,
    weight_at,
)
from mibvh.metrics.predictor import finite_ray_cost, path_length_ratio
from mibvh.metrics.sah import node_costs
from mibvh.quantise import quantised

BUILDERS = ("sbvh", "streelet", "lbvh")


@pytest.fixture(scope="module")
def room():
    """A room of large walls and small things: its trees split triangles."""
    triangles = mibvh.load("livingroom@300").triangles
    trees = {name: mibvh.build(triangles, name) for name in BUILDERS}
    assert trees["sbvh"].splits_triangles
    assert trees["streelet"].splits_triangles
    return triangles, trees


@pytest.fixture(scope="module")
def traced(room):
    triangles, trees = room
    rays = mibvh.diffuse_rays("livingroom@300", width=12, height=8, samples=1)
    return rays, mibvh.trace(trees["sbvh"], triangles, rays, repeats=1)


def owns(tree, node, triangle):
    return triangle in tree.references[tree.first[node] :][: tree.count[node]]


def brute_force_fractions(tree, triangles):
    """Every node against every triangle."""
    fractions = np.zeros(len(tree))
    for node in range(len(tree)):
        low, high = tree.lower[node], tree.upper[node]
        near = ((triangles.lower <= high) & (triangles.upper >= low)).all(axis=1)
        for t in np.flatnonzero(near):
            if owns(tree, node, t):
                continue
            part = clipped(
                list(triangles.corners[t].astype(float)), low.astype(float), high.astype(float)
            )
            if len(part) > 2:
                fan = np.cross(part[1:-1] - part[0], part[2:] - part[0]).sum(axis=0)
                fractions[node] += 0.5 * np.linalg.norm(fan)
    return fractions / triangles.areas.sum()


def costs_by_hand(tree):
    """What a visit of each node costs."""
    costs = np.empty(len(tree))
    for node in range(len(tree)):
        inner = 1.2 + 0.2 * (tree.children[node] - 2)
        costs[node] = inner if tree.child[node] >= 0 else tree.count[node]
    return costs


@pytest.mark.parametrize("builder", BUILDERS)
def test_width_two_gives_the_binary_figures_to_the_last_digit(room, traced, builder):
    triangles, trees = room
    rays, hits = traced
    tree = trees[builder]
    wide = collapse(tree, 2)
    np.testing.assert_array_equal(node_costs(wide), node_costs(tree))
    np.testing.assert_array_equal(node_costs(wide, 2.0, 0.7), node_costs(tree, 2.0, 0.7))
    assert mibvh.sah(wide) == mibvh.sah(tree)
    assert mibvh.sah(wide, 2.0, 0.7) == mibvh.sah(tree, 2.0, 0.7)
    np.testing.assert_array_equal(mibvh.sah_per_node(wide), mibvh.sah_per_node(tree))
    for options in ({}, {"fragments": True}, {"weights": np.arange(len(triangles))}):
        assert mibvh.epo(wide, triangles, **options) == mibvh.epo(tree, triangles, **options)
    np.testing.assert_array_equal(
        mibvh.epo_per_node(wide, triangles), mibvh.epo_per_node(tree, triangles)
    )
    np.testing.assert_array_equal(
        mibvh.epo_per_depth(wide, triangles), mibvh.epo_per_depth(tree, triangles)
    )
    assert estimate_epo(wide, triangles, 500) == estimate_epo(tree, triangles, 500)
    starts, ends = mibvh.ray_ends(triangles, rays, hits)
    assert epo_at_ends(wide, triangles, ends) == epo_at_ends(tree, triangles, ends)
    queries = [point_costs(t, triangles, starts.points, starts.triangle) for t in (wide, tree)]
    np.testing.assert_array_equal(*queries)
    ratio = path_length_ratio(triangles, rays, hits)
    finite = [
        finite_ray_cost(mibvh.sah(t), q.sum(axis=1).mean(), ratio)
        for t, q in zip((wide, tree), queries, strict=True)
    ]
    assert finite[0] == finite[1]
    lines = ray_lines(triangles, rays, hits)
    assert sah_of_lines(wide, lines) == sah_of_lines(tree, lines)
    for whole in (True, False):
        np.testing.assert_array_equal(
            line_costs(wide, lines, whole=whole), line_costs(tree, lines, whole=whole)
        )
    somewhere = np.random.default_rng(1).random((50, 3)) * np.ptp(triangles.bounds, axis=0)
    weights = np.random.default_rng(2).random(len(tree))
    np.testing.assert_array_equal(
        weight_at(wide, triangles.bounds[0] + somewhere, weights),
        weight_at(tree, triangles.bounds[0] + somewhere, weights),
    )


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("width", [4, 8])
@pytest.mark.parametrize("kind", ["float32", "8-bit", "unfolded", "ordered"])
def test_sah_and_epo_against_brute_force(room, builder, width, kind):
    triangles, trees = room
    tree = unfold(trees[builder], triangles) if kind == "unfolded" else trees[builder]
    wide = collapse(tree, width)
    if kind == "8-bit":
        wide = quantised(wide)
    if kind == "ordered":
        wide = wide.ordered(wide.half_areas)
    costs = costs_by_hand(wide)
    np.testing.assert_allclose(node_costs(wide), costs, rtol=1e-15)
    e = (wide.upper - wide.lower).astype(float)
    areas = 2 * (e[:, 0] * e[:, 1] + e[:, 1] * e[:, 2] + e[:, 2] * e[:, 0])
    assert mibvh.sah(wide) == pytest.approx(costs @ areas / areas[0], rel=1e-6)
    expected = brute_force_fractions(wide, triangles)
    assert expected.max() > 0.01
    found = overlap(wide, triangles)
    np.testing.assert_allclose(found.fraction, expected, rtol=1e-9, atol=1e-12)
    assert mibvh.epo(wide, triangles) == pytest.approx(costs @ expected, rel=1e-9)
    by_depth = mibvh.epo_per_depth(wide, triangles)
    assert len(by_depth) == wide.depth + 1
    for depth in range(wide.depth + 1):
        here = wide.depths == depth
        assert by_depth[depth] == pytest.approx(costs[here] @ expected[here], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("width", [4, 8])
def test_a_collapsed_tree_is_a_part_of_the_binary_one(room, builder, width):
    """Its nodes have the overlap that they have in the binary tree."""
    triangles, trees = room
    tree = unfold(trees[builder], triangles)
    wide = collapse(tree, width)
    nodes = binary_nodes(wide, tree)
    for name in ("lower", "upper", "first", "count"):
        np.testing.assert_array_equal(getattr(tree, name)[nodes], getattr(wide, name))
    expected = overlap(tree, triangles).fraction[nodes]
    np.testing.assert_allclose(overlap(wide, triangles).fraction, expected, rtol=1e-9, atol=1e-12)
    with pytest.raises(mibvh.MibvhError, match="not collapsed from this tree"):
        binary_nodes(wide, mibvh.build(triangles, "hill"))


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("width", [4, 8])
@pytest.mark.parametrize("small", [False, True])
def test_point_queries_against_brute_force(room, builder, width, small):
    triangles, trees = room
    wide = collapse(trees[builder], width)
    wide = quantised(wide) if small else wide
    ids = np.random.default_rng(3).integers(0, len(triangles), 150).astype(np.int32)
    points = points_on(triangles, ids, 4)
    costs = costs_by_hand(wide)
    expected = np.zeros((len(ids), 2))
    for i, (point, t) in enumerate(zip(points, ids, strict=True)):
        inside = ((wide.lower <= point) & (point <= wide.upper)).all(axis=1)
        for node in np.flatnonzero(inside):
            expected[i, int(owns(wide, node, t))] += costs[node]
    assert expected[:, 0].max() > 1
    np.testing.assert_allclose(
        point_costs(wide, triangles, points, ids), expected, rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(
        weight_at(wide, points, costs), expected.sum(axis=1), rtol=1e-12, atol=1e-12
    )
    ends = mibvh.RayEnds(points, ids, 200)
    found = epo_at_ends(wide, triangles, ends)
    assert found.value == pytest.approx(expected[:, 0].mean(), rel=1e-12)
    sampled = estimate_epo(wide, triangles, 20_000, seed=5)
    assert abs(sampled.value - mibvh.epo(wide, triangles)) < 4 * sampled.standard_error


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("width", [4, 8])
def test_lines_against_brute_force(room, builder, width):
    triangles, trees = room
    wide = quantised(collapse(trees[builder], width))
    lines = some_lines(120, 2)
    lower, extent = triangles.bounds[0].astype(float), np.ptp(triangles.bounds, axis=0)
    lines = dataclasses.replace(lines, o=lower + extent * lines.o, length=2 * lines.length)
    costs = costs_by_hand(wide)
    for whole in (True, False):
        expected = np.zeros(len(lines))
        for i, (o, d, length) in enumerate(zip(lines.o, lines.d, lines.length, strict=True)):
            with np.errstate(divide="ignore", invalid="ignore"):
                a, b = (wide.lower - o) / d, (wide.upper - o) / d
            held = (wide.lower <= o) & (o <= wide.upper)
            near = np.where(d == 0, np.where(held, -np.inf, np.inf), np.minimum(a, b)).max(axis=1)
            far = np.where(d == 0, np.where(held, np.inf, -np.inf), np.maximum(a, b)).min(axis=1)
            if not whole:
                near, far = np.maximum(near, 0), np.minimum(far, length)
            expected[i] = costs @ (near <= far)
        assert np.ptp(expected) > 10
        np.testing.assert_allclose(line_costs(wide, lines, whole=whole), expected, rtol=1e-12)
    pierced = sah_of_lines(wide, lines)
    share, whole_costs = lines.share, line_costs(wide, lines)
    assert pierced.value == pytest.approx(share @ whole_costs / share.sum(), rel=1e-12)


def test_the_figures_do_not_depend_on_threads(room):
    triangles, trees = room
    wide = collapse(trees["sbvh"], 8)
    np.testing.assert_array_equal(
        overlap(wide, triangles, threads=1).fraction, overlap(wide, triangles, threads=3).fraction
    )
