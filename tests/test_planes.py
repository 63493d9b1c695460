"""What spatial splits see and what they leave, against clipping every triangle at every plane."""

import numpy as np
import pytest
from conftest import clipped
from cuts import CUTS, cut

from mibvh import Triangles
from mibvh.builders import get
from mibvh.builders.planes import best_plane, new_bins
from mibvh.builders.registry import Context
from mibvh.builders.spatial_split import _unsplit
from mibvh.builders.sweep import ID_ZERO


def area(polygon):
    """Area of a plane convex polygon."""
    if len(polygon) < 3:
        return 0.0
    a, b = polygon[1:-1] - polygon[0], polygon[2:] - polygon[0]
    return 0.5 * np.linalg.norm(np.cross(a, b).sum(axis=0))


def scene(n, seed):
    """Small triangles, long beams and large walls, nothing parallel to an axis."""
    rng = np.random.default_rng(seed)
    size = rng.choice([0.02, 0.2, 1.0], (n, 1, 1), p=[0.7, 0.2, 0.1])
    return Triangles((rng.random((n, 1, 3)) + size * rng.normal(size=(n, 3, 3))).astype("f4"))


def references_of(triangles, **options):
    entry = get("sbvh")
    return entry.draft(triangles, entry.options(**options), Context()).references


def cheapest_plane(triangles, refs, rows, count):
    """(cost, axis, plane) by clipping every reference at every plane, and cost by (axis, plane)."""
    low, high = refs.lower[rows].astype(float), refs.upper[rows].astype(float)
    polygons = [list(triangles.corners[t] * refs.scale * 1.0) for t in refs.triangle[rows]]
    origin, extent = low.min(axis=0), high.max(axis=0) - low.min(axis=0)
    costs = {}
    for axis in range(3):
        for e in range(1, count):
            plane = origin[axis] + e * extent[axis] / count
            if not ((low[:, axis] < plane) & (high[:, axis] > plane)).any():
                continue
            cost = 0.0
            for side in range(2):
                there = low[:, axis] < plane if side == 0 else high[:, axis] > plane
                points = []
                for i in np.flatnonzero(there):
                    below, above = low[i].copy(), high[i].copy()
                    if side == 0:
                        above[axis] = min(above[axis], plane)
                    else:
                        below[axis] = max(below[axis], plane)
                    points.append(clipped(polygons[i], below, above))
                points = np.concatenate(points)
                x, y, z = points.max(axis=0) - points.min(axis=0)
                cost += (x * y + (x + y) * z) * there.sum()
            costs[axis, e] = cost
    return costs


def chosen_plane(triangles, refs, rows, count):
    """(cost by axis and plane, what `best_plane` finds), of these references alone."""
    size, times = len(rows), np.bincount(refs.triangle, minlength=len(triangles))
    lists = np.zeros((6 * size, 8), np.float32)
    lists[:size, 0:3], lists[:size, 4:7] = refs.lower[rows], -refs.upper[rows]
    ids = lists.view(np.int32)
    part = times[refs.triangle[rows]] > 1
    ids[:size, 3] = np.arange(size) + np.where(part, len(triangles), 0) + ID_ZERO
    ids[:size, 7] = refs.triangle[rows] + ID_ZERO
    whole = np.zeros(8, np.float32)
    whole[0:3], whole[4:7] = refs.lower[rows].min(axis=0), -refs.upper[rows].max(axis=0)
    axis, plane = best_plane(
        None,
        triangles.corners,
        refs.scale,
        lists,
        0,
        size,
        size,
        count,
        whole,
        np.float32(np.inf),
        new_bins(count, size, size),
    )
    width = (-whole[4 + axis] - whole[axis]) / count
    at = round((float(plane) - float(whole[axis])) / float(width))
    return cheapest_plane(triangles, refs, rows, count), (axis, at)


@pytest.mark.parametrize(("seed", "size", "count"), [(0, 3, 20), (1, 12, 24), (2, 60, 24)])
def test_best_plane_is_the_cheapest_of_all(seed, size, count):
    """Whole triangles and parts that were cut before, mixed, as at a node deep in a tree."""
    triangles = scene(80, seed)
    refs = references_of(triangles, alpha=0.0)
    assert np.bincount(refs.triangle).max() > 1
    rows = np.random.default_rng(seed).permutation(len(refs))[:size]
    costs, found = chosen_plane(triangles, refs, rows, count)
    assert costs[found] == pytest.approx(min(costs.values()), rel=1e-5)


@pytest.mark.parametrize("name", CUTS)
@pytest.mark.parametrize("count", [20, 70])
def test_best_plane_on_cuts_of_real_geometry(name, count):
    """Neighbours in a split tree: edges cross few planes, or more than eight at a time."""
    triangles, _ = cut(name, "sbvh")
    refs = references_of(triangles)
    split = np.flatnonzero(np.bincount(refs.triangle)[refs.triangle] > 1)
    for middle in np.random.default_rng(count).choice(split, 4):
        rows = np.arange(max(middle - 6, 0), min(middle + 6, len(refs)))
        costs, found = chosen_plane(triangles, refs, rows, count)
        assert costs[found] == pytest.approx(min(costs.values()), rel=1e-5)


def test_parts_share_their_triangle_and_their_boxes_are_tight():
    """The parts of a triangle add up to it, and none has a box larger than itself.

    A box that was not clipped with its triangle would hold more than its own part.
    """
    # Needles across each other: nothing but cutting keeps their boxes apart.
    rng = np.random.default_rng(7)
    ends = rng.random((120, 2, 3))
    needles = np.concatenate([ends, ends[:, :1] + 0.02 * rng.normal(size=(120, 1, 3))], axis=1)
    triangles = Triangles(needles.astype("f4"))
    refs = references_of(triangles, c_inner=0.02, budget=8.0)
    assert len(refs) > 1.4 * len(triangles)
    held = np.zeros(len(triangles))
    for low, high, t in zip(refs.lower, refs.upper, refs.triangle, strict=True):
        polygon = clipped(
            list(triangles.corners[t] * refs.scale * 1.0), low.astype(float), high.astype(float)
        )
        held[t] += area(polygon)
        # Boxes are float32, rounded outward; the more so along a grazing edge.
        np.testing.assert_allclose(polygon.min(axis=0), low, atol=1e-6)
        np.testing.assert_allclose(polygon.max(axis=0), high, atol=1e-6)
    np.testing.assert_allclose(held, triangles.areas * refs.scale**2, rtol=1e-4)


def test_unsplitting_by_hand():
    """Each cut reference stays cut or goes whole to a side, whichever is the cheapest of three.

    Left is [0, 1] and right [1, 2] on x, both 1 x 1 across: half areas 1 + 2 x. Five
    references are on each side, three of them cut.

    - [0.9, 1.001] costs 3 * 5 + 3 * 5 = 30 cut, 3.002 * 5 + 3 * 4 = 27.01 on the left.
    - [0.999, 1.8] then costs 27.01 cut, 3.002 * 4 + 3.002 * 4 = 24.016 on the right.
    - [0.1, 1.9] then costs 24.016 cut, 4.8 * 4 + 3.002 * 3 = 28.206 on the left, as much on
      the right.
    """
    lists, parts, halves = np.zeros((3, 8), "f4"), np.zeros((2, 3, 8), "f4"), np.zeros((3, 8), "f4")
    lists[:, 4:7] = halves[:, 4:7] = -1
    lists[:, 0], lists[:, 4] = [0.9, 0.999, 0.1], [-1.001, -1.8, -1.9]
    lists.view(np.int32)[:, 3] = np.arange(3) + ID_ZERO
    halves[1, [0, 4]] = 1, -2
    parts[:] = np.arange(3)[:, None]
    rows, side = np.arange(3, dtype=np.uint32), np.full(3, 9, np.uint8)
    left, right, cut, cost = _unsplit(None, lists, 3, 5, 5, rows, side, parts, halves)
    assert (left, right, cut) == (4, 4, 1)
    assert cost == pytest.approx(24.016, rel=1e-5)
    assert side.tolist() == [0, 1, 2]
    assert rows[0] == 2
    assert (parts[:, 0] == 2).all()
    np.testing.assert_allclose(halves[:2, [0, 4]], [[0, -1.001], [0.999, -2]], rtol=1e-6)
