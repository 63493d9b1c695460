import numpy as np
import pytest
from conftest import soup

import mibvh


def test_bounds_and_areas_of_a_known_triangle():
    one = mibvh.Triangles(np.array([[[0, 0, 0], [2, 0, 0], [0, 3, 0]]], np.float32))
    assert one.areas.tolist() == [3.0]
    assert one.bounds.tolist() == [[0, 0, 0], [2, 3, 0]]


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        (np.zeros((0, 3, 3)), "no triangles"),
        (np.zeros((4, 3)), "shape"),
        (np.full((1, 3, 3), np.nan), "NaN"),
        (np.full((1, 3, 3), np.inf), "NaN, infinite"),
        (np.full((1, 3, 3), 2e15), "overlarge"),
    ],
)
def test_impossible_triangles_are_refused(corners, said):
    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.Triangles(corners, "mesh.ply")


def test_input_is_not_shared():
    array = np.random.default_rng(0).random((3, 3, 3)).astype(np.float32)
    triangles = mibvh.Triangles(array)
    array[:] = 0
    assert triangles.areas.min() > 0
    with pytest.raises(ValueError, match="read-only"):
        triangles.corners[0] = 0


class Tracked(np.ndarray):
    """What trimesh and others have arrays of: asking NumPy for a plain one shares the memory."""


@pytest.mark.parametrize("view", [lambda a: a.view(Tracked), lambda a: np.broadcast_to(a, a.shape)])
def test_views_are_not_shared(view):
    """Nor is what only this view cannot write to."""
    given = np.random.default_rng(0).random((4, 3, 3)).astype(np.float32)
    triangles = mibvh.Triangles(view(given))
    before, digest = triangles.corners.copy(), triangles.digest
    given += 1
    np.testing.assert_array_equal(triangles.corners, before)
    assert mibvh.Triangles(triangles.corners.copy()).digest == digest


def test_rotation_keeps_areas_and_turns_the_axes():
    turn = mibvh.rotation_about((1, 1, 1), 120)
    np.testing.assert_allclose(turn @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    triangles = soup(50)
    turned = triangles.rotated(mibvh.rotation_about((1, 1, 1), 45))
    np.testing.assert_allclose(turned.areas, triangles.areas, rtol=1e-4)
    assert turned.digest != triangles.digest
