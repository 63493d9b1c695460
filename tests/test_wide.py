import numpy as np
import pytest
from conftest import closed_box, soup
from test_traversal import random_rays, ray_set

import mibvh
from mibvh.traversal.collapse import LARGEST, WIDTH, collapse
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.schedule import Schedule, issued_by_bursts


def wide_tree(triangles, builder="bbvh"):
    tree = mibvh.build(triangles, builder)
    scale = unit_scale(triangles)
    corners = triangles.corners * scale
    collapsed = collapse(tree, corners, tree.lower * scale, tree.upper * scale)
    shapes = np.zeros((len(tree.references), 16), np.float32)
    shapes[:, 0] = np.arange(len(shapes)) + 1  # each row tells which it is
    rows, root, depth = collapsed.rows(shapes)
    return tree, corners, rows, root, depth


def children(row):
    """Row numbers, inner ones first, how many those are, and the boxes on their grid."""
    bits = row.view(np.uint32)
    base, inner = int(bits[3] & (1 << 28) - 1), int(bits[3] >> 28)
    grid = 2.0 ** (LARGEST - 8 - (bits[:3] & 63).astype(int))
    planes = bits[4:].view(np.uint8).reshape(2, 3, WIDTH)  # little-endian
    present = planes[0, 0] <= planes[1, 0]
    boxes = row[:3, None].astype(float) + planes * grid[:, None]
    return base + np.arange(present.sum()), inner, boxes[:, :, present]


@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "lbvh"])
def test_every_reference_is_below_boxes_that_hold_it(builder):
    triangles = soup(300, 3, size=0.3)
    tree, corners, rows, root, depth = wide_tree(triangles, builder)
    assert root == 1
    found, deepest = [], 0
    todo = [(0, 0, np.full(3, -np.inf), np.full(3, np.inf))]
    while todo:
        at, level, low, high = todo.pop()
        deepest = max(deepest, level)
        ids, inner, boxes = children(rows[at])
        assert len(ids) >= 2
        for i, child in enumerate(ids):
            lower, upper = np.maximum(low, boxes[0, :, i]), np.minimum(high, boxes[1, :, i])
            if i < inner:
                todo.append((child, level + 1, lower, upper))
                continue
            reference = int(rows[child, 0]) - 1
            found.append(reference)
            if not tree.splits_triangles:
                corner = corners[tree.references[reference]]
                assert (lower < corner.min(0)).all()
                assert (corner.max(0) < upper).all()
    assert sorted(found) == list(range(len(tree.references)))
    assert deepest == depth
    assert len(rows) < 1.5 * len(found)  # nodes are full


def test_leaves_of_many_coinciding_triangles():
    one = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32)
    many = mibvh.Triangles(np.repeat(one, 100, axis=0))
    tree = mibvh.build(many, "bbvh")
    rays = ray_set([[0.2, 0.2, -1], [0.9, 0.9, -1]], [[0, 0, 1], [0, 0, 1]])
    hits = mibvh.trace(tree, many, rays, style="wide", repeats=1)
    assert hits.t.tolist() == [1.0, np.inf]


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
    with pytest.raises(mibvh.MibvhError, match="leave cull off"):
        mibvh.trace(tree, triangles, rays, style="wide", cull=True)
    from mibvh.traversal.trace import Tracer

    with pytest.raises(mibvh.MibvhError, match="reads wide records"):
        Tracer(rays, 1.0, style="wide").run(make_records(tree, triangles))
