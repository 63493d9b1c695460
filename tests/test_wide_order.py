"""Orders in which any-hit rays visit a wide node's children."""

import dataclasses

import numpy as np
import pytest
from conftest import closed_box, soup

import mibvh
from mibvh.metrics.sah import node_costs
from mibvh.traversal.child_order import blocked_share, child_priority
from mibvh.traversal.wide_rows import as_wide


def below(tree, node):
    """A node and all that is below it."""
    found = [node]
    for n in found:
        found += range(tree.child[n], tree.child[n] + tree.children[n])
    return found


def test_priorities_by_hand():
    triangles = soup(200, 4, size=0.3)
    wide = mibvh.collapse(mibvh.build(triangles, "sbvh"), 4)
    assert wide.splits_triangles
    times = np.bincount(wide.references)
    costs = node_costs(wide)
    share, worth = np.zeros(len(wide)), np.zeros(len(wide))
    for n in range(len(wide)):
        surfaces = 0.0
        for t in wide.references[wide.first[n] :][: wide.count[n]]:
            surfaces += triangles.areas[t] / times[t]
        x, y, z = (wide.upper[n] - wide.lower[n]).astype(float)
        share[n] = 1 - np.exp(-2 * surfaces / (2 * (x * y + y * z + z * x)))
        cost = sum(costs[m] * wide.half_areas[m] for m in below(wide, n)) / wide.half_areas[n]
        worth[n] = share[n] / cost
    np.testing.assert_allclose(blocked_share(wide, triangles), share, rtol=1e-6)
    np.testing.assert_allclose(child_priority(wide, triangles, "blocking"), share, rtol=1e-6)
    np.testing.assert_allclose(child_priority(wide, triangles, "worth"), worth, rtol=1e-6)
    np.testing.assert_array_equal(child_priority(wide, triangles, "larger"), wide.half_areas)


def test_the_share_of_blocked_lines_is_that_of_independent_surfaces():
    """Lines through the box of many small triangles, spread evenly: so many are blocked."""
    rng = np.random.default_rng(2)
    centres = rng.random((3000, 1, 3))
    triangles = mibvh.Triangles((centres + rng.normal(size=(3000, 3, 3)) * 0.012).astype("f4"))
    tree = mibvh.build(triangles, "bbvh")
    wide = as_wide(tree, triangles)
    share = blocked_share(wide, triangles)[0]
    assert 0.2 < share < 0.8
    # Even lines: points on the faces, directions by the cosine law.
    lower, extent = triangles.bounds[0], np.ptp(triangles.bounds, axis=0)
    count = 6000
    axis = rng.choice(3, count, p=(np.prod(extent) / extent) / (np.prod(extent) / extent).sum())
    side = rng.integers(0, 2, count)
    o = lower + extent * rng.random((count, 3))
    o[np.arange(count), axis] = (lower + side[:, None] * extent)[np.arange(count), axis]
    u, phi = rng.random(count), 2 * np.pi * rng.random(count)
    d = np.empty((count, 3))
    d[np.arange(count), axis] = np.sqrt(u) * (1 - 2 * side)
    d[np.arange(count), (axis + 1) % 3] = np.sqrt(1 - u) * np.cos(phi)
    d[np.arange(count), (axis + 2) % 3] = np.sqrt(1 - u) * np.sin(phi)
    zeros, far = np.zeros(count, np.int32), np.full(count, np.inf, np.float32)
    rays = mibvh.RaySet(o.astype("f4"), d.astype("f4"), far, zeros, zeros, zeros)
    hits = mibvh.trace(wide, triangles, rays, style="wide", any_hit=True, repeats=1)
    assert np.isfinite(hits.t).mean() == pytest.approx(share, abs=4 * 0.5 / np.sqrt(count))


def test_boxes_without_area_block_all():
    flat = mibvh.Triangles(np.zeros((3, 3, 3), np.float32))
    wide = mibvh.collapse(mibvh.build(flat, "lbvh"), 8)
    assert (blocked_share(wide, flat) == 1).all()
    assert np.isfinite(child_priority(wide, flat, "worth")).all()


@pytest.mark.parametrize("order", ["larger", "worth"])
def test_an_order_saves_visits_of_occluded_rays(order):
    """A closed room full of small things: whatever is hit will do, and the walls are large."""
    corners = np.concatenate([closed_box(0, 3, 1), soup(3000, 5, 0.02).corners])
    triangles = mibvh.Triangles(corners)
    tree = mibvh.build(triangles, "bbvh")
    rng = np.random.default_rng(3)
    d = rng.normal(size=(2000, 3))
    zeros, far = np.zeros(2000, np.int32), np.full(2000, np.inf, np.float32)
    o = 0.2 + 0.6 * rng.random((2000, 3))
    rays = mibvh.RaySet(o.astype("f4"), d.astype("f4"), far, zeros, zeros, zeros)
    near, ordered = (
        mibvh.trace(tree, triangles, rays, style="wide", any_hit=True, child_order=by, repeats=1)
        for by in (None, order)
    )
    assert np.isfinite(near.t).all()
    assert np.isfinite(ordered.t).all()
    assert ordered.counted_cost() < 0.8 * near.counted_cost()
    # Rays that hit nothing go everywhere in any order.
    out = dataclasses.replace(rays, tmax=np.full(2000, 1e-4, np.float32))
    near, ordered = (
        mibvh.trace(tree, triangles, out, style="wide", any_hit=True, child_order=by, repeats=1)
        for by in (None, order)
    )
    missed = ~np.isfinite(near.t)
    assert missed.mean() > 0.9
    np.testing.assert_array_equal(near.inner[missed], ordered.inner[missed])


def test_impossible_requests():
    triangles = soup(50, 1)
    tree = mibvh.build(triangles, "bbvh")
    zeros, far = np.zeros(4, np.int32), np.full(4, np.inf, np.float32)
    rays = mibvh.RaySet(np.zeros((4, 3), "f4"), np.ones((4, 3), "f4"), far, zeros, zeros, zeros)
    for options in ({"any_hit": False, "style": "wide"}, {"any_hit": True, "style": "single"}):
        with pytest.raises(mibvh.MibvhError, match="for any-hit rays in the wide style"):
            mibvh.trace(tree, triangles, rays, child_order="worth", repeats=1, **options)
    with pytest.raises(mibvh.MibvhError, match="ordered by larger, blocking, worth, not 'best'"):
        mibvh.trace(tree, triangles, rays, style="wide", any_hit=True, child_order="best")
    with pytest.raises(mibvh.MibvhError, match="built for another geometry"):
        child_priority(as_wide(tree, triangles), soup(50, 2), "worth")
