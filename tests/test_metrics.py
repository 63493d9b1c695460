import itertools

import numpy as np
import pytest
from conftest import soup

import mibvh
from mibvh.metrics.epo import overlap
from mibvh.metrics.sah import node_costs


def hand_tree(**changes):
    """Two unit-square leaves, side by side in a 2 x 1 x 0 root."""
    tree = mibvh.Tree(
        lower=np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0]], np.float32),
        upper=np.array([[2, 1, 0], [1, 1, 0], [2, 1, 0]], np.float32),
        left=np.array([1, -1, -1], np.int32),
        first=np.array([0, 0, 2], np.int32),
        count=np.array([4, 2, 2], np.int32),
        references=np.array([0, 1, 2, 3], np.int32),
        meta={"triangles": 4, "c_inner": 1.2, "c_tri": 1.0},
    )
    return tree.replace(**changes)


def hand_triangles(shift=0.0):
    """The two squares' four triangles; the second square moved left by ``shift``."""
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    return mibvh.Triangles(np.concatenate([square, square + [1 - shift, 0, 0]]).astype(np.float32))


def test_sah_by_hand():
    # Half areas 2, 1, 1: (1.2 * 2 + 2 * 1 + 2 * 1) / 2 = 3.2.
    assert mibvh.sah(hand_tree()) == pytest.approx(3.2, abs=1e-12)
    assert mibvh.sah(hand_tree(), c_inner=1.0, c_tri=2.0) == pytest.approx(5.0, abs=1e-12)


def test_sah_of_a_tree_without_area():
    point = mibvh.build(np.zeros((1, 3, 3)), "bbvh")
    assert mibvh.sah(point) == 1.0


def test_epo_is_zero_for_a_spatial_partition():
    assert mibvh.epo(hand_tree(), hand_triangles()) == 0.0


def test_the_picture_of_the_docs_by_hand():
    # The second square reaches 0.25 into the first leaf and the second leaf begins at 0.75:
    # a quarter of each square (area 0.25 of 2) lies in the other's leaf, at a cost of 2 each.
    tree = hand_tree(
        lower=np.array([[0, 0, 0], [0, 0, 0], [0.75, 0, 0]], np.float32),
        upper=np.array([[1.75, 1, 0], [1, 1, 0], [1.75, 1, 0]], np.float32),
    )
    triangles = hand_triangles(0.25)
    assert mibvh.epo(tree, triangles) == pytest.approx(2 * 2 * 0.25 / 2, abs=1e-12)
    # Half areas 1.75, 1, 1.
    assert mibvh.sah(tree) == pytest.approx((1.2 * 1.75 + 2 + 2) / 1.75, abs=1e-12)
    # Rays straight down: of seven strips, one lies in both leaves.
    o = np.stack([(np.arange(1400) + 0.5) / 800, np.full(1400, 0.3), np.ones(1400)], axis=1)
    zeros = np.zeros(1400, np.int32)
    down = np.tile(np.array([0, 0, -1], np.float32), (1400, 1))
    far = np.full(1400, np.inf, np.float32)
    rays = mibvh.RaySet(o.astype(np.float32), down, far, zeros, zeros, zeros)
    hits = mibvh.trace(tree, triangles, rays, repeats=1)
    assert hits.leaves.mean() == pytest.approx(8 / 7, abs=1e-12)
    assert hits.lcv == pytest.approx(np.sqrt(6 / 7 * 1 / 7), abs=1e-12)


def test_epo_of_a_split_tree_partition_is_zero():
    """Both triangles cross the plane between the leaves and are in both: nothing is foreign."""
    corners = np.array(
        [[[0, 0, 0], [2, 0, 0], [0, 1, 0]], [[2, 0, 0], [2, 1, 0], [0, 1, 0]]], np.float32
    )
    tree = hand_tree(
        references=np.array([0, 1, 0, 1], np.int32),
        meta={"triangles": 2, "c_inner": 1.2, "c_tri": 1.0},
    )
    assert mibvh.epo(tree, corners) == 0.0


def test_closed_boxes_count_coplanar_triangles():
    """A wall in the face of a foreign box counts in full."""
    tree = hand_tree(
        lower=np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0]], np.float32),
        upper=np.array([[1, 1, 1], [1, 1, 1], [1, 1, 0]], np.float32),
        first=np.array([0, 0, 1], np.int32),
        count=np.array([2, 1, 1], np.int32),
        references=np.array([0, 1], np.int32),
        meta={"triangles": 2, "c_inner": 1.2, "c_tri": 1.0},
    )
    corners = np.array(
        [[[0, 0, 0], [1, 0, 1], [0, 1, 1]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32
    )
    triangles = mibvh.Triangles(corners)
    wall = overlap(tree, triangles).fraction[1]
    assert wall == pytest.approx(triangles.areas[1] / triangles.areas.sum(), rel=1e-12)


def test_neighbours_that_share_an_edge_are_not_clipped():
    found = overlap(hand_tree(), hand_triangles())
    assert found.visits == 6  # the sibling of either leaf, and that for each triangle
    assert found.clips == found.pairs == 0


def test_a_subtree_in_a_foreign_box_is_not_walked():
    """Specks along the diagonal of a cube, and a triangle across the cube in its own leaf."""
    at = (np.arange(1024) + 0.25)[:, None, None] / 1024
    speck = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]]) * 2.0**-12
    wide = np.array([[[0, 0, 0], [1, 0, 1], [0, 1, 1]]])
    triangles = mibvh.Triangles(np.concatenate([at + speck, wide]).astype(np.float32))
    tree = mibvh.build(triangles, "bbvh", max_leaf=1)
    (around,) = np.flatnonzero(tree.is_leaf & (tree.upper - tree.lower > 0.9).all(axis=1))
    found = overlap(tree, triangles, threads=1)
    expected = triangles.areas[:-1].sum() / triangles.areas.sum()
    assert found.fraction[around] == pytest.approx(expected, rel=1e-9)
    # Each node tests its sibling. Most siblings only touch; the leaf around the specks gets their
    # areas in one sum, and no speck tests it.
    assert found.visits < 1.1 * len(tree)


def clipped_area(corners, lower, upper):
    """Area of a triangle inside a closed box: Sutherland and Hodgman, plainly."""
    polygon = [np.asarray(c, np.float64) for c in corners]
    for axis, sign in itertools.product(range(3), (1, -1)):
        limit = lower[axis] if sign > 0 else upper[axis]
        inside = [sign * (p[axis] - limit) >= 0 for p in polygon]
        kept = []
        for i, p in enumerate(polygon):
            q = polygon[i - 1]
            if inside[i] != inside[i - 1]:
                kept.append(q + (p - q) * (limit - q[axis]) / (p[axis] - q[axis]))
            if inside[i]:
                kept.append(p)
        polygon = kept
        if len(polygon) < 3:
            return 0.0
    fan = [
        np.cross(polygon[i] - polygon[0], polygon[i + 1] - polygon[0])
        for i in range(1, len(polygon) - 1)
    ]
    return 0.5 * float(np.linalg.norm(np.sum(fan, axis=0)))


def brute_force_fractions(tree, triangles):
    """Every node against every triangle."""
    total = triangles.areas.sum()
    fractions = np.zeros(len(tree))
    for node in range(len(tree)):
        own = set(tree.references[tree.first[node] :][: tree.count[node]].tolist())
        for t in set(range(len(triangles))) - own:
            lower, upper = tree.lower[node].astype(float), tree.upper[node].astype(float)
            fractions[node] += clipped_area(triangles.corners[t], lower, upper) / total
    return fractions


def split_tree(triangles):
    """A tree over triangles of which some are referenced from both halves."""
    tree = mibvh.build(triangles, "lbvh")
    left, right = tree.left[0], tree.left[0] + 1
    both = tree.references[tree.first[right] : tree.first[right] + 5]
    # Give the last leaf of the left half five triangles of the right half as well.
    leaves = np.flatnonzero(tree.is_leaf)
    last = leaves[
        np.argmax(np.where(tree.first[leaves] < tree.first[right], tree.first[leaves], -1))
    ]
    cut = tree.first[right]
    count, first = tree.count.copy(), tree.first.copy()
    first[first >= cut] += 5
    node = last
    while node >= 0:
        count[node] += 5
        node = tree.parents[node]
    assert count[left] == tree.count[left] + 5
    references = np.insert(tree.references, cut, both).astype(np.int32)
    return tree.replace(first=first, count=count, references=references)


@pytest.mark.parametrize("builder", ["bbvh", "lbvh"])
@pytest.mark.parametrize("seed", range(3))
def test_epo_against_brute_force(builder, seed):
    triangles = soup(60, seed, size=0.3)
    tree = mibvh.build(triangles, builder)
    expected = brute_force_fractions(tree, triangles)
    assert expected.max() > 0.01
    np.testing.assert_allclose(overlap(tree, triangles).fraction, expected, rtol=1e-9, atol=1e-12)


def test_epo_of_split_references_against_brute_force():
    triangles = soup(60, 3, size=0.3)
    tree = split_tree(triangles)
    expected = brute_force_fractions(tree, triangles)
    np.testing.assert_allclose(overlap(tree, triangles).fraction, expected, rtol=1e-9, atol=1e-12)


def test_epo_against_point_queries():
    """Shares no code with the walk: points on the surfaces, and the boxes that hold them."""
    triangles = soup(3000, 5)
    tree = mibvh.build(triangles, "lbvh")
    rng = np.random.default_rng(0)
    ids = rng.choice(len(triangles), 4000, p=triangles.areas / triangles.areas.sum())
    u, v = rng.random((2, len(ids), 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = np.moveaxis(triangles.corners[ids].astype(np.float64), 1, 0)
    points = a + u * (b - a) + v * (c - a)
    position = np.argsort(tree.references)[ids]
    costs = np.zeros(len(ids))
    for node, cost in enumerate(node_costs(tree)):
        inside = ((points >= tree.lower[node]) & (points <= tree.upper[node])).all(axis=1)
        own = (position >= tree.first[node]) & (position < tree.first[node] + tree.count[node])
        costs += cost * (inside & ~own)
    error = costs.std() / np.sqrt(len(costs))
    assert error < 0.05 * costs.mean()
    assert abs(mibvh.epo(tree, triangles) - costs.mean()) < 4 * error


def test_epo_does_not_depend_on_threads_scale_or_place():
    triangles = soup(20000, 7, size=0.05)
    tree = mibvh.build(triangles, "lbvh")
    one = overlap(tree, triangles, threads=1)
    two = overlap(tree, triangles, threads=2)
    np.testing.assert_array_equal(one.fraction, two.fraction)
    assert one.pairs == two.pairs
    doubled = mibvh.Triangles(triangles.corners * 2)
    assert mibvh.epo(mibvh.build(doubled, "lbvh"), doubled) == pytest.approx(
        mibvh.epo(tree, triangles), rel=1e-12
    )
    moved = mibvh.Triangles(triangles.corners.astype(np.float64) + [8, -4, 2])
    assert mibvh.epo(mibvh.build(moved, "lbvh"), moved) == pytest.approx(
        mibvh.epo(tree, triangles),
        rel=1e-2,  # float32 boxes move by roundings
    )


def test_weights_move_epo_to_where_rays_end():
    tree = hand_tree(
        lower=np.array([[0, 0, 0], [0, 0, 0], [0.75, 0, 0]], np.float32),
        upper=np.array([[1.75, 1, 0], [1, 1, 0], [1.75, 1, 0]], np.float32),
    )
    # Only the second square has ray ends: a quarter of its area lies in the first leaf.
    weighted = mibvh.epo(tree, hand_triangles(0.25), weights=[0, 0, 5, 5])
    assert weighted == pytest.approx(2 * 0.25, abs=1e-12)


def test_what_epo_does_not_know_or_use_is_refused():
    tree, triangles = hand_tree(), hand_triangles(0.25)
    with pytest.raises(TypeError, match=r"epo\(\) got an unexpected keyword argument 'fragmets'"):
        mibvh.epo(tree, triangles, samples=64, fragmets=True)
    with pytest.raises(TypeError, match="'fragmets'"):
        mibvh.epo(tree, triangles, fragmets=True)
    with pytest.raises(TypeError, match="'lines'"):
        mibvh.sah(tree, lines=3)
    for unused in ({"weights": [1] * 4}, {"fragments": True}, {"threads": 2}, {"ray_ends": None}):
        with pytest.raises(mibvh.MibvhError, match=r"combination of arguments: .*, "):
            mibvh.epo(tree, triangles, samples=64, **unused)
    with pytest.raises(mibvh.MibvhError, match=r"combination of arguments: seed$"):
        mibvh.epo(tree, triangles, seed=3)


def test_estimates_by_their_old_names_warn():
    triangles = soup(60, 1, 0.3)
    tree = mibvh.build(triangles, "lbvh")
    with pytest.warns(DeprecationWarning, match="now estimate_epo"):
        old = mibvh.epo(tree, triangles, samples=64, seed=3)
    assert old == mibvh.estimate_epo(tree, triangles, 64, 3)
    ids = np.arange(60, dtype=np.int32)
    ends = mibvh.RayEnds(triangles.corners[:, 0].astype(np.float64), ids, 60)
    with pytest.warns(DeprecationWarning, match="now epo_at_ends"):
        old = mibvh.epo(tree, triangles, ray_ends=ends)
    assert old == mibvh.epo_at_ends(tree, triangles, ends)
    lines = mibvh.RayLines(ends.points, np.ones((60, 3)), np.full(60, np.inf), np.ones(60))
    with pytest.warns(DeprecationWarning, match="now sah_of_lines"):
        old = mibvh.sah(tree, ray_lines=lines)
    assert old == mibvh.sah_of_lines(tree, lines)


def test_the_headline_predictors_are_public():
    for name in (
        "sah_of_lines",
        "epo_at_ends",
        "estimate_epo",
        "finite_ray_cost",
        "point_costs",
        "path_length_ratio",
        "fit_alpha",
        "estimate_alpha",
    ):
        assert name in mibvh.__all__
        assert callable(getattr(mibvh, name))
