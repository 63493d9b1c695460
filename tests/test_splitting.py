"""The split primitive against a polygon clip of its own, and pre-splitting."""

import numpy as np
import pytest
from conftest import clipped
from hypothesis import given, settings
from hypothesis import strategies as st

from mibvh import Triangles
from mibvh.builders.draft import References
from mibvh.builders.splitting import (
    MAX_CORNERS,
    _factor_for,
    _priorities,
    pack_boxes,
    presplit,
    split_reference,
)
from mibvh.errors import MibvhError

SCALE = 0.25


def split(corners, box, axis, plane):
    """Call the primitive; return (found, left, right) with (2, 3) boxes."""
    row = np.zeros((1, 8), np.float32)
    row[0, 0:3], row[0, 4:7] = box[0], -box[1]
    left, right = np.full((2, 8), np.nan, np.float32)
    scratch = np.empty((2, MAX_CORNERS, 3))
    found = split_reference(
        corners[None], 0, SCALE, row, 0, axis, np.float32(plane), left, right, *scratch
    )
    left, right = (np.stack([half[0:3], -half[4:7]]) for half in (left, right))
    return found, left, right


coordinate = st.one_of(
    st.integers(-4, 4).map(float), st.floats(-4, 4, width=32, allow_subnormal=False)
)
triangle = st.lists(st.tuples(*[coordinate] * 3), min_size=3, max_size=3).map(
    lambda c: np.array(c, np.float32)
)


@settings(max_examples=300, deadline=None)
@given(
    triangle,
    st.lists(st.tuples(st.integers(0, 2), st.floats(0.05, 0.95), st.booleans()), max_size=4),
)
def test_boxes_of_repeated_splits_are_those_of_the_clipped_polygon(corners, cuts):
    exact = list(corners.astype(np.float64) * SCALE)
    box = np.stack([corners.min(0), corners.max(0)]) * np.float32(SCALE)
    region = box.astype(np.float64)  # intersection of the half-spaces so far
    tolerance = 1e-6
    for axis, fraction, take_left in cuts:
        plane = np.float32(box[0, axis] + fraction * (box[1, axis] - box[0, axis]))
        if not box[0, axis] < plane < box[1, axis]:
            continue
        found, left, right = split(corners, box, axis, plane)
        for bit, new, side in ((1, left, 1), (2, right, 0)):
            inner = region.copy()
            inner[side, axis] = plane
            points = clipped(exact, *inner)
            if not found & bit:
                # Nothing of it is there, but for a touch of the plane itself or a rounding.
                assert len(points) == 0 or np.ptp(points[:, axis]) <= tolerance
                continue
            assert (new[0] <= new[1]).all()
            assert (new[0] >= box[0]).all()
            assert (new[1] <= box[1]).all()
            if len(points):
                assert (new[0] <= points.min(0) + 1e-12).all()
                assert (new[1] >= points.max(0) - 1e-12).all()
                if np.ptp(points[:, axis]) > tolerance:  # a sliver's section is ill-conditioned
                    slack = tolerance * np.ptp(region, axis=0).max() / np.ptp(points[:, axis])
                    np.testing.assert_allclose(new[0], points.min(0), atol=slack + tolerance)
                    np.testing.assert_allclose(new[1], points.max(0), atol=slack + tolerance)
        if found == 3:
            assert left[1, axis] == plane == right[0, axis]
        use_left = take_left if found == 3 else found == 1
        box = left if use_left else right
        region[1 if use_left else 0, axis] = plane


def test_split_of_a_diagonal_by_hand():
    # A right triangle in z = 0 with legs 4 along x and y, halved at x = 2 (0.5 when scaled).
    corners = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]], np.float32)
    found, left, right = split(corners, np.array([[0, 0, 0], [1, 1, 0]]), 0, 0.5)
    assert found == 3
    assert left.tolist() == [[0, 0, 0], [0.5, 1, 0]]
    assert right.tolist() == [[0.5, 0, 0], [1, 0.5, 0]]
    # The part right of x = 2, split at y = 1: its upper piece ends at x = 3.
    found, low, high = split(corners, right, 1, 0.25)
    assert found == 3
    assert low.tolist() == [[0.5, 0, 0], [1, 0.25, 0]]
    assert high.tolist() == [[0.5, 0.25, 0], [0.75, 0.5, 0]]


def test_split_of_a_loose_box_leaves_the_empty_side_out():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    found, left, _ = split(corners, np.array([[0, 0, 0], [1, 1, 1]]), 0, 0.5)
    assert found == 1
    assert left.tolist() == [[0, 0, 0], [0.25, 0.25, 0]]


def test_split_of_a_box_that_misses_its_triangle_halves_the_box():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    found, left, right = split(corners, np.array([[0, 0, 0.5], [1, 1, 1]]), 0, 0.5)
    assert found == 3
    assert left.tolist() == [[0, 0, 0.5], [0.5, 1, 1]]
    assert right.tolist() == [[0.5, 0, 0.5], [1, 1, 1]]


# ------------------------------------------------------------------ pre-splitting


def soup(n, seed, size=0.3):
    rng = np.random.default_rng(seed)
    return Triangles((rng.random((n, 1, 3)) + size * rng.normal(size=(n, 3, 3))).astype("f4"))


def uncovered(triangles, refs, seed=0):
    """Count random surface points (float64) that no box of their triangle holds."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet([0.5, 0.5, 0.5], size=64)
    missed = 0
    order = np.argsort(refs.triangle, kind="stable")
    bounds = np.searchsorted(refs.triangle[order], np.arange(len(triangles) + 1))
    for t in range(len(triangles)):
        rows = order[bounds[t] : bounds[t + 1]]
        points = weights @ (triangles.corners[t].astype(np.float64) * refs.scale)
        slack = 1e-9 * np.abs(points).max()
        held = (points[:, None] >= refs.lower[rows] - slack) & (
            points[:, None] <= refs.upper[rows] + slack
        )
        missed += int((~held.all(axis=2).any(axis=1)).sum())
    return missed


@pytest.mark.parametrize("beta", [0.0, 0.3, 2.0])
def test_presplit_covers_every_triangle_within_its_budget(beta):
    triangles = soup(400, 1)
    refs = presplit(triangles, beta)
    assert len(refs) <= 400 + beta * 400
    assert len(refs) >= 400 + 0.8 * beta * 400
    assert refs.triangle[:400].tolist() == list(range(400))
    assert (refs.lower <= refs.upper).all()
    assert uncovered(triangles, refs) == 0


def test_presplit_of_nothing_is_one_reference_a_triangle():
    triangles = soup(50, 2)
    split_refs, whole = presplit(triangles, 0.0), References.of(triangles)
    np.testing.assert_array_equal(split_refs.lower, whole.lower)
    np.testing.assert_array_equal(split_refs.upper, whole.upper)
    assert split_refs.scale == whole.scale


def test_presplit_grows_with_its_budget_and_lowers_the_area():
    triangles = soup(300, 3)
    previous, previous_total = presplit(triangles, 0.0), np.inf
    for beta in (0.05, 0.2, 0.5, 1.0, 3.0):
        refs = presplit(triangles, beta)
        times = np.bincount(refs.triangle, minlength=300)
        assert (times >= np.bincount(previous.triangle, minlength=300)).all()
        assert len(refs) > len(previous)
        extent = refs.upper.astype(np.float64) - refs.lower
        # The areas of one triangle's boxes tend to that of its three projections.
        area = 2 * (extent * np.roll(extent, 1, axis=1)).sum(axis=1)
        e1 = np.diff(triangles.corners.astype(np.float64), axis=1) * refs.scale
        ideal = np.abs(np.cross(e1[:, 0], e1[:, 1])).sum(axis=1)
        total = np.bincount(refs.triangle, weights=area)
        assert (total >= ideal * (1 - 1e-6)).all()
        assert total.sum() < previous_total
        previous, previous_total = refs, total.sum()


def test_presplit_cuts_the_one_long_diagonal_at_the_middle_of_the_scene():
    # Scene box [0, 1]^3; the small triangles waste nothing worth the budget of one split.
    small = soup(3, 4, size=1e-3).corners * np.float32(0.1)
    frame = np.array([[[0, 0, 0]] * 3, [[1, 1, 1]] * 3])
    diagonal = np.array([[[0.1, 0.1, 0.1], [0.9, 0.7, 0.6], [0.9, 0.7, 0.6]]])
    triangles = Triangles(np.concatenate([frame, diagonal, np.abs(small)]).astype("f4"))
    refs = presplit(triangles, 1 / len(triangles))
    assert len(refs) == len(triangles) + 1
    assert refs.triangle[-1] == 2
    # All three middle planes cross it; the cut is along x, its longest extent.
    middle = 0.5 * refs.scale
    assert refs.upper[2, 0] == refs.lower[-1, 0] == np.float32(middle)
    np.testing.assert_allclose(refs.upper[2, 1], (0.1 + 0.5 * 0.6) * refs.scale, rtol=1e-6)


def test_presplit_cuts_grid_aligned_boxes_at_the_next_finer_plane():
    # Faces exactly on coarse planes: the box of the right half is only crossed at x = 3 / 4.
    frame = np.array([[[0, 0, 0]] * 3, [[1, 1, 1]] * 3])
    half = np.array([[[0.5, 0, 0.2], [1, 0.1, 0.2], [0.5, 0.1, 0.3]]])
    triangles = Triangles(np.concatenate([frame, half]).astype("f4"))
    refs = presplit(triangles, 0.34)
    assert len(refs) == 4
    assert refs.upper[2, 0] == refs.lower[3, 0] == np.float32(0.75 * refs.scale)


@pytest.mark.parametrize("scale", [1e-20, 1.0, 1e15])
def test_presplit_takes_degenerate_input(scale):
    rng = np.random.default_rng(5)
    corners = rng.random((40, 3, 3))
    corners[:5, 1] = corners[:5, 0]  # needles
    corners[5:10] = corners[5:10, :1]  # points
    corners[10:20, :, 2] = 0.5  # coplanar
    corners[20:30] = corners[20]  # duplicates
    triangles = Triangles((corners * scale).astype("f4"))
    refs = presplit(triangles, 1.0)
    assert 40 < len(refs) <= 80
    assert (refs.lower <= refs.upper).all()
    assert uncovered(triangles, refs) == 0


def test_presplit_of_one_flat_triangle():
    refs = presplit(Triangles(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], "f4")), 3.0)
    assert 2 <= len(refs) <= 4


def test_presplit_refuses_a_negative_budget():
    with pytest.raises(MibvhError, match="beta"):
        presplit(soup(3, 0), -0.1)


def test_priorities_by_hand():
    # The scene box is [0, 8]^3. The first triangle is half of the rectangle x = [3, 5],
    # y = [0, 4]: its box has area 2 * 2 * 4, the components of its edges' cross product add
    # up to 8, and it crosses the middle of the scene, which is level -1. The second is the
    # first moved to x = [1, 3], where the coarsest planes inside it are x = 2 and y = 2, of
    # level -2: y = 4 is only its border.
    frame = np.array([[[0, 0, 0]] * 3, [[8, 8, 8]] * 3], float)
    first = np.array([[3, 0, 0], [5, 0, 0], [3, 4, 0]], float)
    second = first - [2, 0, 0]
    triangles = Triangles(np.concatenate([frame, [first, second]]).astype("f4"))
    refs = References.of(triangles)
    origin, extent = np.zeros(3), np.full(3, 8 * refs.scale)
    found = np.zeros(4)
    seen = triangles.corners, refs.scale, pack_boxes(refs), origin, extent
    _priorities(0, 4, found, *seen)
    expected = [0, 0, (2**-1 * 8) ** (1 / 3), (2**-2 * 8) ** (1 / 3)]
    np.testing.assert_allclose(found, np.array(expected) * refs.scale ** (2 / 3), rtol=1e-6)


def test_splits_go_by_priority_until_the_budget_is_spent():
    rng = np.random.default_rng(6)
    for budget in (1, 7, 40, 1000):
        priorities = rng.random(50) ** 3
        factor = _factor_for(priorities, budget)
        assert np.floor(factor * priorities).sum() <= budget
        # A little more would not fit: the bisection is not cut short.
        assert np.floor(factor * (1 + 1e-9) * priorities).sum() > budget - 1
