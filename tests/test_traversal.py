import numpy as np
import pytest
from conftest import closed_box, soup
from cuts import cut

import mibvh
from mibvh.traversal import records
from mibvh.traversal.records import binary_rows
from mibvh.variant import lane_width, mitsuba

STYLES = ["single", "while-while", "speculative", "wide"]
in_every_style = pytest.mark.parametrize("style", STYLES)


def random_rays(count, seed=0, low=-0.5, high=3.5):
    rng = np.random.default_rng(seed)
    o = rng.uniform(low, high, (count, 3)).astype(np.float32)
    d = rng.normal(size=(count, 3))
    return ray_set(o, d / np.linalg.norm(d, axis=1, keepdims=True))


def ray_set(o, d, tmax=np.inf):
    o, d = np.asarray(o, np.float32), np.asarray(d, np.float32)
    zeros = np.zeros(len(o), np.int32)
    limit = np.broadcast_to(np.float32(tmax), len(o)).copy()
    return mibvh.RaySet(o, d, limit, zeros, zeros, zeros - 1)


def brute_force(triangles, rays):
    """All distances, (rays, triangles) float64; infinite for a miss."""
    v0, v1, v2 = np.moveaxis(triangles.corners.astype(np.float64), 1, 0)
    e1, e2 = v1 - v0, v2 - v0
    o, d = rays.o.astype(np.float64)[:, None], rays.d.astype(np.float64)[:, None]
    p = np.cross(d, e2)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / (p * e1).sum(-1)
        s = o - v0
        u = (s * p).sum(-1) * inverse
        q = np.cross(s, e1)
        v = (d * q).sum(-1) * inverse
        t = (e2 * q).sum(-1) * inverse
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= rays.tmax[:, None])
    return np.where(hit, t, np.inf)


def children_hit(tree, node, o, d, best):
    """Children that a ray enters before ``best``, with where it does, the nearer first."""
    found = []
    for child in (tree.left[node], tree.left[node] + 1):
        a, b = (tree.lower[child] - o) / d, (tree.upper[child] - o) / d
        near, far = max(np.minimum(a, b).max(), 0), min(np.maximum(a, b).min(), best)
        if near <= far:
            found.append((near, child))
    return sorted(found, key=lambda entry: entry[0])


def reference_counts(tree, triangles, rays, cull, any_hit=False):
    """The same walk, one ray at a time: inner nodes, leaves and triangles visited."""
    counts = np.zeros((len(rays), 3), int)
    distances = brute_force(triangles, rays)
    for i, (o, d) in enumerate(zip(rays.o.astype(float), rays.d.astype(float), strict=True)):
        best, stack, node, begins = float(rays.tmax[i]), [], 0, 0.0
        while node is not None:
            if cull and begins > best:
                node, begins = stack.pop() if stack else (None, 0.0)
                continue
            if tree.left[node] < 0:
                ids = tree.references[tree.first[node] :][: tree.count[node]]
                met = np.flatnonzero(distances[i, ids] < best)
                if any_hit and len(met):
                    counts[i] += 0, 1, met[0] + 1
                    break
                counts[i] += 0, 1, len(ids)
                best = min(best, distances[i, ids].min())
                node, begins = stack.pop() if stack else (None, 0.0)
                continue
            counts[i, 0] += 1
            found = children_hit(tree, node, o, d, best)
            stack += [(child, near) for near, child in found[1:]]
            if found:
                begins, node = found[0]
            else:
                node, begins = stack.pop() if stack else (None, 0.0)
    return counts


def assert_same_hits(hits, distances):
    closest = distances.min(axis=1)
    np.testing.assert_array_equal(np.isinf(hits.t), np.isinf(closest))
    found = np.isfinite(closest)
    np.testing.assert_allclose(hits.t[found], closest[found], rtol=2e-4, atol=1e-5)
    # Of triangles at the same distance, any may be named.
    named = distances[np.flatnonzero(found), hits.triangle[found]]
    np.testing.assert_allclose(named, closest[found], rtol=2e-4, atol=1e-5)
    assert (hits.triangle[~found] == -1).all()


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize("builder", ["bbvh", "lbvh"])
def test_hits_and_counters_against_plain_python(builder, cull):
    triangles = soup(200, 1, size=0.2)
    rays = random_rays(300)
    tree = mibvh.build(triangles, builder)
    hits = mibvh.trace(tree, triangles, rays, cull=cull, repeats=1)
    distances = brute_force(triangles, rays)
    assert np.isfinite(distances.min(1)).sum() > 50
    assert_same_hits(hits, distances)
    expected = reference_counts(tree, triangles, rays, cull)
    counted = np.stack([hits.inner, hits.leaves, hits.tests], axis=1)
    # A box grazed within a rounding may be counted by one and not by the other.
    assert (counted == expected).all(axis=1).mean() > 0.99
    assert counted.sum() == pytest.approx(expected.sum(), rel=2e-3)
    assert (hits.steps == hits.inner + hits.tests).all()


@in_every_style
def test_scalar_lanes_take_the_same_steps(small_soup, style):
    tree = mibvh.build(small_soup, "bbvh")
    rays = random_rays(1000, 2)
    simd, scalar = (
        mibvh.trace(tree, small_soup, rays, lanes, style=style, repeats=1)
        for lanes in ("simd", "scalar")
    )
    for name in ("t", "triangle", "inner", "leaves", "tests", "steps"):
        np.testing.assert_array_equal(getattr(simd, name), getattr(scalar, name))
    assert scalar.lane_utilisation == 1 / lane_width()
    assert 1 / lane_width() < simd.lane_utilisation < 1
    assert simd.lcv == pytest.approx(np.std(simd.leaves.astype(float)))


@in_every_style
def test_any_hit_finds_a_hit_where_there_is_one(small_soup, style):
    tree = mibvh.build(small_soup, "bbvh")
    rays = random_rays(2000, 3)
    closest = mibvh.trace(tree, small_soup, rays, style=style, repeats=1)
    some = mibvh.trace(tree, small_soup, rays, any_hit=True, style=style, repeats=1)
    np.testing.assert_array_equal(some.triangle >= 0, closest.triangle >= 0)
    assert (some.t >= closest.t).all()
    assert some.inner.sum() < closest.inner.sum()


@in_every_style
def test_tmax_is_respected(small_soup, style):
    tree = mibvh.build(small_soup, "bbvh")
    rays = random_rays(1000, 4)
    full = mibvh.trace(tree, small_soup, rays, style=style, repeats=1)
    hit = np.isfinite(full.t)
    for share, found in [(0.999, False), (1.001, True)]:
        limit = np.where(hit, full.t * np.float32(share), 1.0)
        near = mibvh.trace(tree, small_soup, ray_set(rays.o, rays.d, limit), style=style, repeats=1)
        assert np.isfinite(near.t[hit]).all() if found else np.isinf(near.t[hit]).all()


@in_every_style
def test_hits_against_mitsuba(cornell, style):
    mi = mitsuba()
    rays = mibvh.diffuse_rays(cornell, width=64, height=48, samples=2, bounces=2)
    tree = mibvh.build(cornell.triangles, "bbvh")
    hits = mibvh.trace(tree, cornell.triangles, rays, style=style, repeats=1)
    theirs = cornell.geometry.ray_intersect_preliminary(
        mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T)), coherent=False
    )
    t = np.array(theirs.t)
    both = np.isfinite(t) & np.isfinite(hits.t)
    differ = np.isinf(t) != np.isinf(hits.t)
    differ[both] |= np.abs(t[both] - hits.t[both]) > 1e-3 * np.maximum(t[both], 1e-2)
    assert both.sum() > 1000
    assert differ.sum() <= 1


@in_every_style
def test_a_tree_that_is_one_leaf(style):
    one = mibvh.Triangles(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32))
    tree = mibvh.build(one, "bbvh")
    rays = ray_set([[0.2, 0.2, -1], [0.9, 0.9, -1]], [[0, 0, 1], [0, 0, 1]])
    hits = mibvh.trace(tree, one, rays, style=style, repeats=1)
    assert hits.t.tolist() == [1.0, np.inf]
    assert hits.triangle.tolist() == [0, -1]
    assert hits.inner.tolist() == [0, 0]
    assert hits.leaves.tolist() == [1, 1]


@in_every_style
@pytest.mark.parametrize("scale", [1e-20, 1e15])
def test_extreme_scales(scale, style):
    triangles = soup(100, 6, size=0.3)
    largest = float(np.abs(triangles.corners).max())
    factor = np.float32(scale / largest)
    scaled = mibvh.Triangles(triangles.corners * factor)
    rays = random_rays(500, 5)
    far = ray_set(rays.o * factor, rays.d)
    plain = mibvh.trace(mibvh.build(triangles, "bbvh"), triangles, rays, style=style, repeats=1)
    hits = mibvh.trace(mibvh.build(scaled, "bbvh"), scaled, far, style=style, repeats=1)
    same = hits.triangle == plain.triangle
    assert same.mean() > 0.99
    found = same & (plain.triangle >= 0)
    np.testing.assert_allclose(hits.t[found] / factor, plain.t[found], rtol=1e-3, atol=1e-5)


@in_every_style
def test_degenerate_rays_hit_nothing_and_leave_their_neighbours_alone(style):
    box = mibvh.Triangles(closed_box())
    tree = mibvh.build(box, "bbvh")
    sane = random_rays(64, 7, 0.1, 0.9)
    odd = [
        ([np.nan, 0, 0], [0, 0, 1]),
        ([0.5, 0.5, 0.5], [np.nan, 0, 1]),
        ([0.5] * 3, [0, 0, 0]),
        ([np.inf, 0, 0], [1, 0, 0]),
        ([0.5] * 3, [np.inf, 0, 0]),
    ]
    both = ray_set(np.repeat(sane.o, 2, axis=0), np.repeat(sane.d, 2, axis=0))
    for i in range(64):  # a ray set is not made of such rays, but the kernel survives them
        both.o[2 * i + 1], both.d[2 * i + 1] = odd[i % len(odd)]
    hits = mibvh.trace(tree, box, both, style=style, repeats=1)
    alone = mibvh.trace(tree, box, sane, style=style, repeats=1)
    np.testing.assert_array_equal(hits.t[::2], alone.t)
    assert np.isfinite(hits.t[::2]).all()  # inside a closed box
    assert np.isinf(hits.t[1::2]).all()


@in_every_style
def test_axis_parallel_rays_along_faces_and_from_edges(style):
    """Zero direction components, origins on faces, edges and vertices: no ray gets out."""
    box = mibvh.Triangles(closed_box())
    tree = mibvh.build(box, "bbvh")
    grid = np.linspace(0.125, 0.875, 4)
    o, d = [], []
    for axis in range(3):
        for sign in (-1, 1):
            for a in grid:
                for b in grid:  # on the cells' edges, vertices and diagonals
                    o.append(np.insert([a, b], axis, 0.5))
                    d.append(np.insert([0.0, 0.0], axis, sign))
    hits = mibvh.trace(tree, box, ray_set(o, d), style=style, repeats=1)
    np.testing.assert_allclose(hits.t, 0.5)


@in_every_style
@pytest.mark.parametrize(("along", "most"), [((0.1, 0.25, 0.5, 0.9), 0), ((0.0, 1.0), 0.005)])
def test_leaks_of_a_closed_box(style, along, most):
    """From inside a finely cut, rotated box, aimed at its edges, and exactly at its vertices.

    At a vertex all edges are seen as points, and rounding can put the ray outside of each of its
    triangles. Mitsuba's own kernel lets a tenth of these rays out.
    """
    turn = mibvh.rotation_about((1, 2, 3), 33)
    box = mibvh.Triangles(closed_box(-1, 1, cells=12)).rotated(turn)
    tree = mibvh.build(box, "bbvh")
    rng = np.random.default_rng(0)
    edges = np.concatenate([box.corners[:, [0, 1]], box.corners[:, [1, 2]]])
    edges = edges[rng.integers(0, len(edges), 20000)]
    at = edges[:, 0] + rng.choice(along, (20000, 1)) * (edges[:, 1] - edges[:, 0])
    o = rng.uniform(-0.5, 0.5, (20000, 3)).astype(np.float32)
    d = at - o
    rays = ray_set(o, d / np.linalg.norm(d, axis=1, keepdims=True))
    hits = mibvh.trace(tree, box, rays, style=style, repeats=1)
    assert np.isinf(hits.t).mean() <= most


def test_impossible_requests(small_soup):
    tree = mibvh.build(small_soup, "bbvh")
    rays = random_rays(4)
    with pytest.raises(mibvh.MibvhError, match="lanes must be simd or scalar"):
        mibvh.trace(tree, small_soup, rays, "vector")
    with pytest.raises(mibvh.MibvhError, match="no rays"):
        mibvh.trace(tree, small_soup, rays.select(slice(0)))
    with pytest.raises(mibvh.MibvhError, match="repeats"):
        mibvh.trace(tree, small_soup, rays, repeats=0)
    with pytest.raises(mibvh.MibvhError, match="another geometry"):
        mibvh.trace(tree, soup(60, 9), rays)


def test_records_do_not_depend_on_threads(monkeypatch):
    """Rows of triangles are written in blocks, by several threads."""
    triangles, tree = cut("pipes", "sbvh, all splits")
    monkeypatch.setenv("MIBVH_THREADS", "1")
    whole, root = binary_rows(tree, triangles)
    monkeypatch.setenv("MIBVH_THREADS", "3")
    monkeypatch.setattr(records, "_BLOCK", 7)
    parts, same_root = binary_rows(tree, triangles)
    assert len(tree.references) > 7 * 3
    assert root == same_root
    assert np.array_equal(whole.view(np.uint32), parts.view(np.uint32))
