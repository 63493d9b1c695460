import numpy as np
import pytest
from conftest import closed_box, soup
from cuts import cut

import mibvh
from mibvh.metrics.lines import line_costs
from mibvh.metrics.sah import node_costs


def even_lines(triangles, count, seed):
    """Whole lines through a scene's box, of even place and direction.

    Points evenly spread on the faces, with directions by the cosine law, lie on such lines.
    """
    rng = np.random.default_rng(seed)
    lower, upper = triangles.bounds.astype(float)
    extent = upper - lower
    faces = np.prod(extent) / extent
    axis = rng.choice(3, count, p=faces / faces.sum())
    side = rng.integers(0, 2, count)
    o = lower + extent * rng.random((count, 3))
    rows = np.arange(count)
    o[rows, axis] = np.where(side == 0, lower[axis], upper[axis])
    inwards = np.sqrt(rng.random(count))
    angle = 2 * np.pi * rng.random(count)
    along = np.sqrt(1 - inwards**2)
    d = np.empty((count, 3))
    d[rows, axis] = np.where(side == 0, inwards, -inwards)
    d[rows, (axis + 1) % 3] = along * np.cos(angle)
    d[rows, (axis + 2) % 3] = along * np.sin(angle)
    return mibvh.RayLines(o, d, np.full(count, np.inf), np.ones(count))


def some_lines(count, seed):
    """Rays of all sorts about a unit cube, some along the axes, some within a face."""
    rng = np.random.default_rng(seed)
    o = rng.uniform(-0.3, 1.3, (count, 3))
    d = rng.normal(size=(count, 3))
    d[: count // 4, rng.integers(0, 3)] = 0.0
    d[: count // 8] = [1.0, 0.0, 0.0]
    o[: count // 16] = np.round(4 * o[: count // 16]) / 4
    return mibvh.RayLines(o, d, rng.random(count), rng.random(count))


@pytest.mark.parametrize("whole", [True, False])
def test_line_costs_against_brute_force(whole):
    """Every line against every box, by clipping it at the six planes one after the other."""
    tree = mibvh.build(soup(80, 1, 0.3), "lbvh")
    lines = some_lines(160, 2)
    expected = np.zeros(len(lines))
    for i, (o, d, length) in enumerate(zip(lines.o, lines.d, lines.length, strict=True)):
        for node, cost in enumerate(node_costs(tree)):
            low, high = (-np.inf, np.inf) if whole else (0.0, length)
            for x, v, a, b in zip(o, d, tree.lower[node], tree.upper[node], strict=True):
                if v == 0:
                    low, high = (low, high) if a <= x <= b else (1.0, 0.0)
                    continue
                ends = sorted(((float(a) - x) / v, (float(b) - x) / v))
                low, high = max(low, ends[0]), min(high, ends[1])
            expected[i] += cost * (low <= high)
    assert expected.max() > 5 * expected[expected > 0].min()
    np.testing.assert_allclose(line_costs(tree, lines, whole=whole), expected, rtol=1e-12)


def test_the_sah_of_evenly_spread_lines_is_the_sah():
    """The estimate converges to the ratio of areas, and knows its error."""
    triangles = soup(500, 3, 0.1)
    tree = mibvh.build(triangles, "bbvh")
    z = []
    for seed in range(40):
        found = mibvh.sah_of_lines(tree, even_lines(triangles, 2000, seed))
        z.append((found.value - mibvh.sah(tree)) / found.standard_error)
    assert found.standard_error < 0.04 * found.value
    # Of 40 standard normal numbers: a mean of no more than 3.5 / sqrt(40), a deviation near 1.
    assert abs(np.mean(z)) < 0.55
    assert 0.65 < np.std(z) < 1.4


def test_a_line_counts_once_however_many_rays_lie_on_it():
    """Chop half of the evenly spread lines to pieces: each piece's share keeps the balance."""
    triangles = soup(500, 3, 0.1)
    tree = mibvh.build(triangles, "bbvh")
    lines = even_lines(triangles, 4000, 1)
    whole = mibvh.sah_of_lines(tree, lines)
    lower, upper = triangles.bounds.astype(float)
    with np.errstate(divide="ignore"):
        sides = np.stack([(lower - lines.o) / lines.d, (upper - lines.o) / lines.d])
    chord = sides.max(axis=0).min(axis=1)
    piece = np.repeat(np.arange(2000), 5)
    place = np.tile(np.arange(5), 2000)
    o = np.concatenate(
        [lines.o[piece] + (place / 5 * chord[piece])[:, None] * lines.d[piece], lines.o[2000:]]
    )
    d = np.concatenate([lines.d[piece], lines.d[2000:]])
    length = np.concatenate([chord[piece] / 5, chord[2000:]])
    count = len(o)
    zeros = np.zeros(count, np.int32)
    rays = mibvh.RaySet(
        o.astype(np.float32),
        d.astype(np.float32),
        np.full(count, np.inf, np.float32),
        zeros,
        zeros,
        zeros,
    )

    class Ends:
        t = length.astype(np.float32)

    found = mibvh.ray_lines(triangles, rays, Ends)
    np.testing.assert_allclose(found.share, np.r_[np.full(10000, 0.2), np.ones(2000)], atol=1e-3)
    assert mibvh.sah_of_lines(tree, found).value == pytest.approx(whole.value, rel=1e-3)
    # With every ray counted alike, the chopped half has five times the weight.
    assert line_costs(tree, found)[:10000].mean() == pytest.approx(
        line_costs(tree, lines)[:2000].mean(), rel=1e-3
    )


def test_lines_of_traced_rays_by_hand():
    """In a unit cube, a ray up from a quarter of the height has three quarters of its line."""
    box = mibvh.Triangles(closed_box())
    o = np.array([[0.5, 0.5, 0.25], [0.3, 0.4, 0.5], [5, 5, 5]], np.float32)
    d = np.array([[0, 0, 1], [1, 0, 0], [1, 0, 0]], np.float32)
    zeros = np.zeros(3, np.int32)
    rays = mibvh.RaySet(o, d, np.full(3, np.inf, np.float32), zeros, zeros, zeros)
    tree = mibvh.build(box, "bbvh")
    hits = mibvh.trace(tree, box, rays, repeats=1)
    lines = mibvh.ray_lines(box, rays, hits)
    np.testing.assert_allclose(lines.share, [0.75, 0.7, 0.0])
    np.testing.assert_allclose(lines.length[:2], [0.75, 0.7], rtol=1e-6)
    whole, part = line_costs(tree, lines), line_costs(tree, lines, whole=False)
    assert (part < whole)[:2].all()
    found = mibvh.sah_of_lines(tree, lines)
    assert found.value == pytest.approx((0.75 * whole[0] + 0.7 * whole[1]) / 1.45)
    assert found.points == 2
    assert len(mibvh.ray_lines(box, rays, hits, 2)) == 2
    with pytest.raises(mibvh.MibvhError, match="too few"):
        mibvh.sah_of_lines(tree, mibvh.ray_lines(box, rays, hits, 1))
    with pytest.raises(mibvh.MibvhError, match="at least 1, not"):
        mibvh.ray_lines(box, rays, hits, 0)
    with pytest.raises(mibvh.MibvhError, match="hits of 3"):
        mibvh.ray_lines(box, rays.select([0]), hits)


def test_no_traversal_costs_less_than_what_a_ray_touches():
    triangles = soup(2000, 4, 0.1)
    tree = mibvh.build(triangles, "lbvh")
    rng = np.random.default_rng(0)
    o, d = rng.random((500, 3)).astype(np.float32), rng.normal(size=(500, 3)).astype(np.float32)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    zeros = np.zeros(500, np.int32)
    rays = mibvh.RaySet(o, d, np.full(500, np.inf, np.float32), zeros, zeros, zeros)
    hits = mibvh.trace(tree, triangles, rays, repeats=1)
    touched = line_costs(tree, mibvh.ray_lines(triangles, rays, hits), whole=False)
    # Boxes that begin where the ray ends count as touched, but need not be visited.
    assert (1.2 * hits.inner + hits.tests >= touched - 1e-6).mean() > 0.98
    assert touched.mean() > 0.5 * hits.counted_cost()


@pytest.mark.parametrize("kind", ["sbvh", "bittner from sbvh"])
def test_a_ray_touches_the_flat_box_that_it_hits(kind):
    """The hit's distance is rounded; what is touched is told by places, in float64."""
    triangles, tree = cut("tiles", kind)
    rng = np.random.default_rng(1)
    o = rng.uniform([0, 0, 0.1], [10, 8, 3], (2000, 3)).astype(np.float32)
    d = rng.normal(size=(2000, 3)).astype(np.float32)
    rays = mibvh.RaySet(o, d / np.linalg.norm(d, axis=1, keepdims=True))
    hits = mibvh.trace(tree, triangles, rays, repeats=1)
    at = hits.triangle >= 0
    assert at.mean() > 0.5
    a, b, c = np.moveaxis(triangles.corners[hits.triangle].astype(float), 1, 0)
    normal = np.cross(b - a, c - a)
    o, d = rays.o.astype(float), rays.d.astype(float)
    end = np.where(at, ((a - o) * normal).sum(1) / (d * normal).sum(1), np.inf)
    with np.errstate(divide="ignore"):
        low, high = ((box - o[:, None]) / d[:, None] for box in (tree.lower, tree.upper))
    near = np.maximum(np.minimum(low, high).max(axis=2), 0)
    far = np.maximum(low, high).min(axis=2)
    expected = (near <= np.minimum(far, (1 + 1e-9) * end[:, None])) @ node_costs(tree)
    touched = line_costs(tree, mibvh.ray_lines(triangles, rays, hits), whole=False)
    assert np.isclose(touched, expected, atol=1e-9).mean() > 0.999


def test_lines_take_the_cost_constants_of_the_tree(small_soup):
    tree = mibvh.build(small_soup, "lbvh")
    with pytest.raises(mibvh.MibvhError, match="cost constants are those the tree was built with"):
        mibvh.sah(tree, c_inner=2.0, ray_lines=even_lines(small_soup, 10, 0))
