import numpy as np
import pytest
from conftest import closed_box, soup
from test_traversal import random_rays, ray_set

import mibvh
from mibvh.measures import Area, Flux
from mibvh.measures.nodes import node_measures
from mibvh.measures.walk import cut_at_hits
from mibvh.metrics.sah import node_costs
from mibvh.traversal.pages import ROW
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.schedule import Schedule, issued_by_bursts
from mibvh.traversal.wide_rows import LARGEST, SPAN, as_wide, wide_rows
from mibvh.traversal.wide_walk import node_visits, walk_wide_tree


def rows_of(wide, triangles):
    shapes = np.zeros((len(wide.references), ROW), np.float32)
    shapes[:, 0] = np.arange(len(shapes)) + 1  # each row tells which it is
    return wide_rows(wide, shapes, unit_scale(triangles))


def small_children(row):
    """First row, how many inner children, and the boxes on their grid by place."""
    bits = row.view(np.uint32)
    grid = 2.0 ** (LARGEST - 8 - (bits[:3] & 63).astype(int))
    planes = bits[4:].view(np.uint8).reshape(2, 3, 8)  # little-endian
    present = planes[0, 0] <= planes[1, 0]
    origin = (bits[:3] & ~np.uint32(63)).view(np.float32).astype(float)
    boxes = origin[:, None] + planes * grid[:, None]
    return bits[3], boxes[:, :, present]


def plain_children(rows, order, width):
    """The same of a node with float32 boxes."""
    bits = rows.view(np.uint32).ravel()
    planes = rows.ravel()[: 6 * width].reshape(2, 3, width).astype(float)
    present = np.isfinite(planes[0, 0])
    places = [int(order >> 4 * i & 7) for i in range(present.sum())]
    assert bits[6 * width + 1] == order
    return bits[6 * width], planes[:, :, :][:, :, np.argsort(places)]


@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "lbvh"])
@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("small", [False, True])
def test_rows_hold_the_tree(builder, width, small):
    triangles = soup(300, 3, size=0.3)
    wide = mibvh.collapse(mibvh.build(triangles, builder), width)
    wide = mibvh.quantised(wide) if small else wide
    rows, order, root = rows_of(wide, triangles)
    span = 1 if small else SPAN[width]
    scale = float(unit_scale(triangles))
    assert root == 1
    assert len(rows) == len(wide.references) + span * (~wide.is_leaf).sum()
    todo = [(0, 0)]
    while todo:
        node, at = todo.pop()
        if wide.child[node] < 0:
            found = []
            while not found or at:
                found.append(int(rows[at, 0]) - 1)
                at = rows[at].view(np.int32)[13]
            assert found == list(range(wide.first[node], wide.first[node] + wide.count[node]))
            continue
        if small:
            word, boxes = small_children(rows[at])
        else:
            word, boxes = plain_children(rows[at : at + span], order[at], width)
        base, inner = int(word & (1 << 28) - 1), int(word >> 28)
        group = wide.child[node] + np.arange(wide.children[node])
        assert inner == (wide.child[group] >= 0).sum()
        for i, child in enumerate(group):
            entry = int(order[at] >> 4 * i) & 15
            assert entry >> 3 == 1
            place = entry & 7
            assert (place < inner) == (wide.child[child] >= 0)
            np.testing.assert_array_equal(boxes[0, :, place], wide.lower[child] * scale)
            np.testing.assert_array_equal(boxes[1, :, place], wide.upper[child] * scale)
            todo.append((child, base + place + (span - 1) * min(place, inner)))


def test_a_binary_tree_is_collapsed_to_full_nodes_of_single_triangles():
    triangles = soup(300, 3, size=0.3)
    wide = as_wide(mibvh.build(triangles, "sbvh"), triangles)
    assert wide.quantised
    assert (wide.count[wide.is_leaf] == 1).all()
    assert wide.validate(triangles) == []
    assert (~wide.is_leaf).sum() < 0.5 * wide.is_leaf.sum()
    assert as_wide(wide, triangles) is wide


@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "lbvh"])
def test_same_hits_as_the_binary_kernel_in_fewer_steps(builder):
    triangles = soup(2000, 5, size=0.2)
    tree = mibvh.build(triangles, builder)
    rays = random_rays(5000, 6)
    binary, wide = (
        mibvh.trace(tree, triangles, rays, style=style, repeats=1) for style in ("single", "wide")
    )
    np.testing.assert_array_equal(binary.t, wide.t)
    assert wide.inner.sum() < 0.6 * binary.inner.sum()
    np.testing.assert_array_equal(wide.leaves, wide.tests)
    assert (binary.style, wide.style) == ("single", "wide")


@pytest.fixture(scope="module")
def room():
    """A room of large walls and small things, with trees that split triangles, and its rays."""
    scene = mibvh.load("livingroom@2000")
    rays = mibvh.diffuse_rays(scene, width=60, height=40, samples=1)
    trees = {name: mibvh.build(scene, name) for name in ("sbvh", "streelet", "lbvh")}
    assert trees["sbvh"].splits_triangles
    return scene, rays, trees


COUNTERS = ("inner", "boxes", "leaves", "tests")


@pytest.mark.parametrize("builder", ["sbvh", "streelet", "lbvh"])
@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("small", [False, True])
@pytest.mark.parametrize("lanes", ["simd", "scalar"])
def test_hits_are_the_binary_kernels_and_counters_the_slow_twins(
    room, builder, width, small, lanes
):
    scene, rays, trees = room
    wide = mibvh.collapse(trees[builder], width)
    wide = mibvh.quantised(wide) if small else wide
    binary = mibvh.trace(trees[builder], scene, rays, repeats=1)
    hits = mibvh.trace(wide, scene, rays, lanes, style="wide", repeats=1)
    np.testing.assert_array_equal(hits.t, binary.t)
    assert (hits.triangle != binary.triangle).mean() < 1e-3  # two at one distance
    walk = walk_wide_tree(wide, scene, rays, steps=True)
    np.testing.assert_array_equal(hits.t, walk.t)
    np.testing.assert_array_equal(hits.triangle, walk.triangle)
    for name in COUNTERS:
        np.testing.assert_array_equal(getattr(hits, name), getattr(walk, name))
    np.testing.assert_array_equal(hits.steps, hits.inner + hits.tests)
    assert (hits.leaves <= hits.tests).all()
    assert (hits.leaves < hits.tests).any()
    # -- what the twin tells of its steps adds up to what it counts
    inner = walk.steps >= 0
    ray = np.repeat(np.arange(len(rays)), np.diff(walk.starts))
    np.testing.assert_array_equal(np.bincount(ray[inner], minlength=len(rays)), walk.inner)
    np.testing.assert_array_equal(np.bincount(ray[~inner], minlength=len(rays)), walk.tests)
    boxes = np.bincount(ray[inner], wide.children[walk.steps[inner]], len(rays))
    np.testing.assert_array_equal(boxes, walk.boxes)
    starts = set(wide.first[wide.is_leaf].tolist())
    leaves = np.array([place in starts for place in ~walk.steps[~inner]])
    np.testing.assert_array_equal(np.bincount(ray[~inner], leaves, len(rays)), walk.leaves)


@pytest.mark.parametrize("builder", ["sbvh", "streelet", "lbvh"])
def test_width_two_costs_what_the_binary_kernel_does(room, builder):
    scene, rays, trees = room
    for any_hit in (False, True):
        binary = mibvh.trace(trees[builder], scene, rays, any_hit=any_hit, repeats=1)
        wide = mibvh.trace(
            mibvh.collapse(trees[builder], 2), scene, rays, style="wide", any_hit=any_hit, repeats=1
        )
        for name in ("t", "triangle", *COUNTERS):
            np.testing.assert_array_equal(getattr(wide, name), getattr(binary, name))
        assert wide.counted_cost() == binary.counted_cost()
        assert wide.counted_cost(2.0, 0.7) == binary.counted_cost(2.0, 0.7)
        assert wide.lcv == binary.lcv


@pytest.mark.parametrize("width", [4, 8])
@pytest.mark.parametrize("small", [False, True])
@pytest.mark.parametrize("order", [None, "area", "random"])
def test_any_hit_rays_in_every_order(room, width, small, order):
    scene, rays, trees = room
    reach = np.random.default_rng(1).uniform(0, 4, len(rays)).astype(np.float32)
    rays = mibvh.RaySet(rays.o, rays.d, reach, rays.viewpoint, rays.bounce, rays.source, rays.meta)
    closest = mibvh.trace(trees["sbvh"], scene, rays, repeats=1)
    wide = mibvh.collapse(trees["sbvh"], width)
    wide = mibvh.quantised(wide) if small else wide
    if order == "area":
        wide = wide.ordered(wide.half_areas)
    if order == "random":
        wide = wide.ordered(np.random.default_rng(2).random(len(wide)))
    hits = mibvh.trace(wide, scene, rays, style="wide", any_hit=True, repeats=1)
    np.testing.assert_array_equal(np.isfinite(hits.t), np.isfinite(closest.t))
    assert 0.1 < np.isfinite(hits.t).mean() < 0.9
    walk = walk_wide_tree(wide, scene, rays, any_hit=True)
    for name in ("t", "triangle", *COUNTERS):
        np.testing.assert_array_equal(getattr(hits, name), getattr(walk, name))
    # Rays that meet nothing visit the same nodes in any order.
    plain = walk_wide_tree(wide.replace(meta={}), scene, rays, any_hit=True)
    missed = ~np.isfinite(hits.t)
    np.testing.assert_array_equal(plain.inner[missed], walk.inner[missed])
    assert (plain.inner != walk.inner).any() == (order is not None)


def test_collapsing_by_a_measure_is_cheaper_for_its_rays(room):
    scene, rays, trees = room
    seen, unseen = (rays.select(slice(first, None, 2)) for first in (0, 1))
    tree = trees["sbvh"]
    flux = Flux(cut_at_hits(tree, scene.triangles, seen.o, seen.d, seen.tmax, seen.viewpoint))
    by_area, by_flux = (as_wide(tree, scene.triangles, measure) for measure in (None, flux))
    assert by_flux.validate(scene.triangles) == []
    hits = [
        mibvh.trace(wide, scene, unseen, style="wide", repeats=1) for wide in (by_area, by_flux)
    ]
    np.testing.assert_array_equal(hits[0].t, hits[1].t)
    assert hits[1].counted_cost() < hits[0].counted_cost()
    # The measure of each node is what is brought to its least sum.
    collapsed = [mibvh.collapse(tree, 8, measure=measure) for measure in (Area(), flux)]
    sums = [
        (node_costs(wide) * node_measures(wide, flux)).sum(dtype=np.float64) for wide in collapsed
    ]
    assert sums[1] < sums[0]
    weights = node_measures(tree, flux)
    given = mibvh.collapse(tree, 8, weights=weights)
    np.testing.assert_array_equal(given.child, collapsed[1].child)
    np.testing.assert_array_equal(collapsed[0].child, mibvh.collapse(tree, 8).child)
    assert collapsed[1].meta["collapse"]["weights"] == "flux"
    with pytest.raises(mibvh.MibvhError, match="by weights or by a measure, not by both"):
        mibvh.collapse(tree, 8, weights=weights, measure=flux)


def test_collapsing_by_visits_is_cheaper_for_such_rays(room):
    scene, rays, trees = room
    seen, unseen = (rays.select(slice(first, None, 2)) for first in (0, 1))
    tree = trees["lbvh"]
    visits = node_visits(tree, scene, seen)
    binary = mibvh.trace(tree, scene, seen, repeats=1)
    assert visits[~tree.is_leaf].sum() == pytest.approx(binary.inner.mean(), rel=1e-12)
    assert visits[tree.is_leaf].sum() == pytest.approx(binary.leaves.mean(), rel=1e-12)
    tests = (visits * tree.count)[tree.is_leaf].sum()
    assert tests == pytest.approx(binary.tests.mean(), rel=1e-12)
    assert visits[0] == 1
    assert visits.max() == 1
    costs = [
        mibvh.trace(
            mibvh.collapse(tree, 8, weights=weights), scene, unseen, style="wide", repeats=1
        ).counted_cost()
        for weights in (None, visits)
    ]
    assert costs[1] < costs[0]
    wide = mibvh.collapse(tree, 8)
    hits = mibvh.trace(wide, scene, seen, style="wide", repeats=1)
    inner = node_visits(wide, scene, seen)[~wide.is_leaf]
    assert inner.sum() == pytest.approx(hits.inner.mean(), rel=1e-12)


def test_counted_cost_of_wide_nodes_by_hand(room):
    scene, rays, trees = room
    wide = mibvh.collapse(trees["sbvh"], 8)
    hits = mibvh.trace(wide, scene, rays, style="wide", repeats=1)
    walk = walk_wide_tree(wide, scene, rays, steps=True)
    inner = walk.steps[walk.steps >= 0]
    by_node = (
        1.2 * len(inner) + 0.2 * (wide.children[inner] - 2).sum() + len(walk.steps) - len(inner)
    )
    assert hits.counted_cost() == pytest.approx(by_node / len(rays), rel=1e-12)
    assert hits.counted_cost(c_box=0.0) < hits.counted_cost()
    assert hits.lcv == pytest.approx(np.std(walk.leaves.astype(float)), rel=1e-12)


@pytest.mark.parametrize("small", [False, True])
def test_wide_trees_of_one_leaf_and_of_many_coinciding_triangles(small):
    one = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32)
    rays = ray_set([[0.2, 0.2, -1], [0.9, 0.9, -1]], [[0, 0, 1], [0, 0, 1]])
    for times in (1, 3, 100):
        many = mibvh.Triangles(np.repeat(one, times, axis=0))
        wide = mibvh.collapse(mibvh.build(many, "bbvh"), 8)
        wide = mibvh.quantised(wide) if small else wide
        hits = mibvh.trace(wide, many, rays, style="wide", repeats=1)
        assert hits.t.tolist() == [1.0, np.inf]
        walk = walk_wide_tree(wide, many, rays)
        np.testing.assert_array_equal(hits.tests, walk.tests)


def test_flat_boxes_far_from_the_origin_are_not_lost():
    box = closed_box(-1, 1, cells=6) * np.float32(1e-3) + np.float32(7)
    triangles = mibvh.Triangles(box.astype(np.float32))
    rng = np.random.default_rng(1)
    d = rng.normal(size=(3000, 3))
    rays = ray_set(np.full((3000, 3), 7), d / np.linalg.norm(d, axis=1, keepdims=True))
    tree = mibvh.build(triangles, "bbvh")
    assert np.isfinite(mibvh.trace(tree, triangles, rays, style="wide", repeats=1).t).all()


@pytest.mark.parametrize("style", ["single", "wide"])
def test_length_of_directions_does_not_matter(style):
    triangles = soup(500, 7, size=0.3)
    tree = mibvh.build(triangles, "bbvh")
    rays = random_rays(500, 8)
    plain = mibvh.trace(tree, triangles, rays, style=style, repeats=1)
    assert np.isfinite(plain.t).sum() > 50
    for factor in (2.0**-100, 2.0**100):
        longer = ray_set(rays.o, rays.d * np.float32(factor))
        hits = mibvh.trace(tree, triangles, longer, style=style, repeats=1)
        np.testing.assert_array_equal(hits.triangle, plain.triangle)
        np.testing.assert_array_equal(hits.inner, plain.inner)
        np.testing.assert_array_equal(hits.t * np.float32(factor), plain.t)


def test_issued_lane_steps_by_hand():
    # Two lanes with three rays each, in bursts of four: 5 then 1, 1, against 2 then 9, 0.
    steps = np.array([5, 2, 1, 9, 1, 0], np.uint32)
    schedule = Schedule(count=6, width=2, lanes=2, per_lane=3, burst=4)
    # 4 (5 > 1, 2) + 4 (1, 9 > 5) + 4 (1, 5 > 1) + 1 (1)
    assert issued_by_bursts(steps, schedule) == 2 * (4 + 4 + 4 + 1)
    alone = Schedule(count=6, width=2, lanes=1, per_lane=6, burst=4)
    assert issued_by_bursts(steps, alone) == 2 * steps.sum()


def test_every_ray_is_handed_to_one_lane():
    for count, scalar in [(1, False), (5000, False), (100003, False), (5000, True)]:
        schedule = Schedule.of(count, 16, scalar)
        first, end = (np.array(column, dtype=np.int64) for column in schedule.rays())
        taken = [np.arange(f, e, schedule.lanes) for f, e in zip(first, end, strict=True)]
        np.testing.assert_array_equal(np.sort(np.concatenate(taken)), np.arange(count))


def test_impossible_requests():
    triangles = soup(50, 1)
    tree = mibvh.build(triangles, "bbvh")
    rays = random_rays(4)
    with pytest.raises(mibvh.MibvhError, match="style must be one of"):
        mibvh.trace(tree, triangles, rays, style="narrow")
    with pytest.raises(mibvh.MibvhError, match="a wide tree is traced in the wide style"):
        mibvh.trace(mibvh.collapse(tree, 4), triangles, rays, style="single", repeats=1)
    with pytest.raises(mibvh.MibvhError, match="leave cull off"):
        mibvh.trace(tree, triangles, rays, style="wide", cull=True)
    from mibvh.traversal.trace import Tracer

    with pytest.raises(mibvh.MibvhError, match="reads wide records"):
        Tracer(rays, 1.0, style="wide").run(make_records(tree, triangles))
