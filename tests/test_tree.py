import numpy as np
import pytest
from conftest import soup

import mibvh


@pytest.fixture(scope="module")
def tree(small_soup):
    return mibvh.build(small_soup, "bbvh")


def test_round_trip(tree, tmp_path):
    tree.save(tmp_path / "t.npz")
    again = mibvh.Tree.load(tmp_path / "t.npz")
    for name in ("lower", "upper", "left", "first", "count", "references"):
        np.testing.assert_array_equal(getattr(again, name), getattr(tree, name))
    assert again.meta == tree.meta
    assert [p.name for p in tmp_path.iterdir()] == ["t.npz"]


def test_damage_is_noticed(tree, tmp_path):
    path = tmp_path / "t.npz"
    tree.save(path)
    whole = path.read_bytes()
    at = whole.index(tree.references.tobytes())  # stored uncompressed
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with pytest.raises(mibvh.MibvhError, match="damaged"):
        mibvh.Tree.load(path)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(mibvh.MibvhError, match="not a tree file"):
        mibvh.Tree.load(path)
    path.write_text("no tree")
    with pytest.raises(mibvh.MibvhError, match="not a tree file"):
        mibvh.Tree.load(path)
    with pytest.raises(mibvh.MibvhError, match="no such tree file"):
        mibvh.Tree.load(tmp_path / "absent.npz")
    with pytest.raises(mibvh.MibvhError, match="cannot be written"):
        tree.save(tmp_path / "absent" / "t.npz")


def test_other_geometry_is_refused(tree):
    with pytest.raises(mibvh.MibvhError, match="another geometry"):
        mibvh.epo(tree, soup(60, seed=1))


def test_depths_against_parents(tree):
    for node in range(1, len(tree)):
        assert tree.depths[node] == tree.depths[tree.parents[node]] + 1
    assert tree.depths[0] == 0


def _spoil(tree, name, index, value):
    array = getattr(tree, name).copy()
    array[index] = value
    return tree.replace(**{name: array})


@pytest.mark.parametrize(
    ("name", "index", "value", "said"),
    [
        ("left", 0, 0, "behind it"),
        ("left", 0, 3, "not those of its children"),
        ("lower", 0, np.nan, "inverted or NaN"),
        ("upper", 1, 1e9, "stick out of their parents"),
        ("references", 0, 1, "in no leaf|twice"),
        ("references", 0, 10**6, "beyond the triangles"),
        ("count", 0, 1, "root's range"),
    ],
)
def test_validate_finds_each_fault(tree, small_soup, name, index, value, said):
    assert tree.validate(small_soup) == []
    found = _spoil(tree, name, index, value).validate(small_soup)
    assert any(any(part in fault for part in said.split("|")) for fault in found), found


def test_validate_finds_a_leaf_that_does_not_hold_its_triangle(tree, small_soup):
    leaf = np.flatnonzero(tree.is_leaf)[0]
    shrunk = _spoil(tree, "upper", leaf, tree.lower[leaf])
    assert any("stick out of their leaves" in fault for fault in shrunk.validate(small_soup))


def test_validate_finds_uncovered_parts_of_a_split_triangle():
    corners = np.array(
        [[[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[0, 0, 1], [2, 0, 1], [0, 2, 1]]], np.float32
    )
    # Triangle 0 under two leaves of which each holds its half x <= 1 or x >= 1.
    whole = mibvh.Tree(
        lower=np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0]], np.float32),
        upper=np.array([[2, 2, 1], [1, 2, 1], [2, 2, 1]], np.float32),
        left=np.array([1, -1, -1], np.int32),
        first=np.array([0, 0, 2], np.int32),
        count=np.array([4, 2, 2], np.int32),
        references=np.array([0, 1, 0, 1], np.int32),
        meta={"triangles": 2},
    )
    triangles = mibvh.Triangles(corners)
    assert whole.splits_triangles
    assert whole.validate(triangles) == []
    gap = _spoil(whole, "upper", 1, [0.5, 2, 1])
    assert gap.validate(triangles) == [
        "2 split triangles are not covered by their leaves (first: triangle 0)"
    ]
