"""The measures of a box: the tables against counting, and what they promise to searches."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import soup
from numba import njit
from test_builders_all import room, same

import mibvh
from mibvh.builders import get, names
from mibvh.builders.registry import Context
from mibvh.errors import MibvhError
from mibvh.measures import Area, Flux, Segments
from mibvh.measures.boxes import of_boxes
from mibvh.measures.lookup import touched
from mibvh.measures.walk import counted_cost, cut_at_hits, walk

ARRAYS = ("lower", "upper", "left", "first", "count", "references")


def segments(count=3000, seed=0, kind="open"):
    """Segments in a box of 3 x 1 x 2; ``room``: most start on its floor or a wall."""
    rng = np.random.default_rng(seed)
    start, end = rng.random((2, count, 3)) * [3, 1, 2]
    if kind == "room":
        start[: count // 2, 1] = 1e-5
        start[count // 2 : 3 * count // 4, 0] = 3 - 1e-5
        end[::3, 1] = 0
    if kind == "along axes":
        axis = rng.integers(0, 3, count)
        keep = axis[:, None] != np.arange(3)
        end[keep] = start[keep]
    return Segments(start.astype(np.float32), end.astype(np.float32), np.zeros(count, np.int32))


def touching(rays, low, high):
    """Count segments that touch a box, one by one: slabs in float64."""
    a, d = rays.start.astype(np.float64), rays.end.astype(np.float64) - rays.start
    with np.errstate(divide="ignore", invalid="ignore"):
        t0, t1 = (low - a) / d, (high - a) / d
    held = (a >= low) & (a <= high)
    near = np.where(d != 0, np.minimum(t0, t1), np.where(held, -np.inf, np.inf))
    far = np.where(d != 0, np.maximum(t0, t1), np.where(held, np.inf, -np.inf))
    return int(((near.max(1) <= far.min(1)) & (near.max(1) <= 1) & (far.min(1) >= 0)).sum())


def random_boxes(planes, rng, count):
    """Boxes with faces on planes, none of them flat: (count, 3, 2) plane numbers."""
    first = rng.integers(0, planes.shape[1] - 1, (count, 3))
    last = rng.integers(first + 1, planes.shape[1])
    return np.stack([first, last], axis=2)


@pytest.mark.parametrize("kind", ["open", "room", "along axes"])
@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_counts_are_exact_at_the_planes(kind, scale):
    rays = segments(kind=kind)
    flux = Flux(rays, planes=20)
    tables = flux.compiled(scale)
    planes = flux.plane_positions
    rng = np.random.default_rng(1)
    for box in random_boxes(planes, rng, 300):
        low, high = planes[np.arange(3), box.T]
        found = touched(tables, *(low * scale), *(high * scale))
        # A start is on a plane where a quantile is, and counts as below it.
        assert abs(found - touching(rays, low.astype(float), high.astype(float))) <= 3
    inner = np.sort(rng.random((40, 3, 2)), axis=2)
    assert any(touching(rays, *box.T) > 100 for box in inner * [[3], [1], [2]])


def test_counts_are_exact_where_no_start_is_on_a_plane():
    rays = segments(kind="room")
    flux = Flux(rays, planes=20)
    # Planes of other rays: quantiles of these have no start of those on them.
    other = Flux(segments(seed=9, kind="room"), planes=20)
    planes = other.plane_positions.copy()
    planes[:, 0] = np.minimum(planes[:, 0], flux.plane_positions[:, 0])
    planes[:, -1] = np.maximum(planes[:, -1], flux.plane_positions[:, -1])
    flux.__dict__["plane_positions"] = planes
    tables = flux.compiled(1.0)
    for box in random_boxes(planes, np.random.default_rng(2), 500):
        low, high = planes[np.arange(3), box.T]
        assert touched(tables, *low, *high) == touching(rays, low.astype(float), high.astype(float))


@pytest.mark.parametrize("kind", ["open", "room"])
def test_between_planes_counts_are_between_those_of_the_boxes_inside_and_outside(kind):
    flux = Flux(segments(kind=kind), planes=12)
    tables, planes = flux.compiled(1.0), flux.plane_positions.astype(np.float64)
    rng = np.random.default_rng(3)
    nested = 0
    for _ in range(400):
        low, high = np.sort(rng.random((2, 3)) * [3, 1, 2], axis=0).astype(np.float32)
        below = [np.searchsorted(planes[k], low[k], side="right") - 1 for k in range(3)]
        above = [np.searchsorted(planes[k], high[k], side="left") for k in range(3)]
        found = touched(tables, *low, *high)
        outside = touched(
            tables,
            *(np.float32(planes[k, below[k]]) for k in range(3)),
            *(np.float32(planes[k, above[k]]) for k in range(3)),
        )
        assert found <= outside + 1e-6
        if all(below[k] + 1 <= above[k] - 1 for k in range(3)):
            nested += 1
            inside = touched(
                tables,
                *(np.float32(planes[k, below[k] + 1]) for k in range(3)),
                *(np.float32(planes[k, above[k] - 1]) for k in range(3)),
            )
            assert found >= inside - 1e-6
    assert nested > 20


@pytest.mark.parametrize("kind", ["open", "room", "along axes"])
def test_measure_never_falls_where_a_box_grows(kind):
    compiled = Flux(segments(kind=kind), planes=16, area_weight=0.0).compiled(1.0)
    rng = np.random.default_rng(4)
    low = (rng.random((4000, 3)) * [3, 1, 2]).astype(np.float32)
    size = (rng.random((4000, 3)) * 10.0 ** rng.integers(-6, 1, (4000, 1))).astype(np.float32)
    boxes = np.concatenate([low, low + size], axis=1)
    step = (rng.random((4000, 6)) * 10.0 ** rng.integers(-6, 0, (4000, 1))).astype(np.float32)
    step *= rng.random((4000, 6)) < 0.5
    grown = boxes + step * np.float32([-1, -1, -1, 1, 1, 1])
    assert (of_boxes(compiled, grown) >= of_boxes(compiled, boxes) - 1e-7).all()
    assert (of_boxes(compiled, boxes) >= 0).all()


def test_the_whole_is_touched_by_all_and_nothing_by_none():
    flux = Flux(segments(), area_weight=0.5)
    tables = flux.compiled(1.0)
    assert touched(tables, *np.float32([-1, -1, -1, 4, 4, 4])) == len(flux.rays)
    assert touched(tables, *np.float32([5, 5, 5, 6, 6, 6])) == 0
    # Sides without a reference are infinite, and must not lead out of the tables.
    everywhere = np.float32([-np.inf, -np.inf, -np.inf, np.inf, np.inf, np.inf])
    assert touched(tables, *everywhere) == len(flux.rays)
    assert touched(tables, *-everywhere) == 0
    whole = 3 * 1 + 1 * 2 + 2 * 3
    box = np.float32([[0, 0, 0, 3, 1, 2]])
    assert of_boxes(tables, box)[0] == pytest.approx(0.5 * whole + whole, rel=2e-3)
    assert of_boxes(None, box)[0] == whole


def test_the_area_with_another_weight():
    flux = Flux(segments(), planes=16, area_weight=0.1)
    fresh = Flux(segments(), planes=16, area_weight=0.4)
    box = np.float32([[0.2, 0.3, 0.2, 1.5, 0.6, 1.7]])
    found = of_boxes(flux.with_weight(0.4).compiled(1.0), box)[0]
    assert found == of_boxes(fresh.compiled(1.0), box)[0] > of_boxes(flux.compiled(1.0), box)[0]


@pytest.mark.parametrize("ends", [0.0, 0.1])
def test_starts_on_a_floor_are_not_in_its_flat_box(ends):
    """They are a hair above it, and what ends on it is all that touches it."""
    rays = segments(kind="room")
    high = np.maximum(rays.end, np.float32([0, ends, 0]))
    flux = Flux(Segments(rays.start, high, rays.viewpoint), planes=20)
    found = touched(flux.compiled(1.0), *np.float32([-1, 0, -1, 4, 0, 3]))
    assert found == pytest.approx((high[:, 1] == 0).sum(), rel=0.1, abs=1)


def test_tables_refuse_what_they_cannot_count():
    rays = segments(20)
    for wrong in ({"planes": 3}, {"planes": 257}, {"area_weight": -0.1}):
        with pytest.raises(MibvhError, match=f"{next(iter(wrong))} must be from"):
            Flux(rays, **wrong)
    with pytest.raises(MibvhError, match="there are no segments"):
        rays.select(slice(0, 0))
    with pytest.raises(MibvhError, match="NaN or infinite"):
        Segments(rays.start * np.float32(np.nan), rays.end, rays.viewpoint)


@pytest.mark.parametrize("name", names())
def test_area_is_the_default_and_costs_no_bit(name):
    corners = room(800)
    options = {"sweeps": 20} if name == "anneal" else {}
    tree = mibvh.build(corners, name, **options)
    assert same(tree, mibvh.build(corners, name, measure=Area(), **options))


@njit
def _length(x0, y0, z0, x1, y1, z1):
    return x1 - x0


class Length:
    """A measure of the user's own: the extent on x."""

    name = "length"

    def __init__(self):
        self.scales = []

    def compiled(self, scale):
        self.scales.append(scale)
        return _length


def inner_boxes(tree):
    return np.concatenate([tree.lower, tree.upper], axis=1)[~tree.is_leaf]


@pytest.mark.slow
def test_a_measure_of_the_users_own_counts_everywhere():
    """In the start tree, in the optimiser and in the collapse."""
    corners, mine = room(500), Length()
    tree = mibvh.build(corners, "bittner", measure=mine)
    assert tree.validate(mibvh.Triangles(corners)) == []
    assert len(mine.scales) >= 3
    assert len(set(mine.scales)) == 1
    lengths = [
        np.ptp(inner_boxes(t).reshape(-1, 2, 3)[..., 0], axis=1).sum()
        for t in (tree, mibvh.build(corners, "bittner"))
    ]
    assert lengths[0] < 0.9 * lengths[1]


@pytest.mark.parametrize(
    "name",
    ["bbvh", "sbvh", "hill", "anneal", "bittner", pytest.param("treelet", marks=pytest.mark.slow)],
)
def test_builders_minimise_the_measure_they_are_given(name):
    """Rays cross a corner of the room only: what they touch is less than in the area tree."""
    corners = room(500)
    options = {"sweeps": 20} if name == "anneal" else {}
    low, high = mibvh.Triangles(corners).bounds
    rng = np.random.default_rng(0)
    ends = (low + (high - low) * rng.random((2, 2000, 3)) ** 3).astype(np.float32)
    flux = Flux(Segments(*ends, np.zeros(2000, np.int32)), planes=24, area_weight=0.01)
    compiled = flux.compiled(1.0)
    tree, area = (mibvh.build(corners, name, measure=m, **options) for m in (flux, None))
    assert tree.validate(mibvh.Triangles(corners)) == []
    touches = [of_boxes(compiled, inner_boxes(t)).sum() for t in (tree, area)]
    assert touches[0] < 0.99 * touches[1]


def test_flux_tree_is_the_same_on_any_number_of_threads(monkeypatch):
    flux = Flux(segments(2000), planes=16)
    triangles = soup(6000, size=0.1)
    trees = []
    for threads in ("1", "2"):
        monkeypatch.setenv("MIBVH_THREADS", threads)
        trees.append(mibvh.build(triangles, "sbvh", measure=flux))
    assert same(*trees)


# ------------------------------------------------------------------ walking


@pytest.fixture(scope="module")
def split_tree(cornell):
    """A tree with split references of a real scene's cut, and rays."""
    tree = mibvh.build(cornell, "sbvh", alpha=0.0)
    assert tree.splits_triangles
    return tree, mibvh.diffuse_rays(cornell, width=24, height=16, samples=1)


def test_walk_counts_what_the_kernel_counts(split_tree, cornell):
    tree, rays = split_tree
    t, visits = walk(tree, cornell.triangles, rays.o, rays.d, rays.tmax)
    hits = mibvh.trace(tree, cornell, rays, repeats=1)
    assert np.isfinite(t).mean() > 0.5
    # The kernel computes in float32: a ray in a thousand meets an edge differently.
    assert (
        np.isclose(t, hits.t, rtol=1e-4, atol=1e-4) | (np.isinf(t) & np.isinf(hits.t))
    ).mean() > 0.995
    assert visits[:, 0].mean() == pytest.approx(hits.inner.mean(), rel=0.01)
    assert visits[:, 1].mean() == pytest.approx(hits.tests.mean(), rel=0.01)


def test_segments_end_where_rays_do(split_tree, cornell):
    tree, rays = split_tree
    cut = cut_at_hits(tree, cornell.triangles, rays.o, rays.d, rays.tmax, rays.viewpoint)
    low, high = cornell.triangles.bounds
    margin = 1e-4 * cornell.triangles.diagonal
    assert len(cut) == len(rays)
    assert (cut.end >= low - margin).all()
    assert (cut.end <= high + margin).all()
    length = np.linalg.norm(cut.end - cut.start, axis=1)
    hits = mibvh.trace(tree, cornell, rays, repeats=1)
    found = np.isfinite(hits.t)
    assert np.isclose(length, hits.t, rtol=1e-3, atol=margin)[found].mean() > 0.995
    cost = counted_cost(tree, cornell.triangles, cut, 1.2, 1.0)
    assert cost == pytest.approx(hits.counted_cost(), rel=0.01)


@pytest.mark.parametrize("kind", ["ao", "shadow"])
def test_any_hit_walk_counts_what_the_kernel_counts(split_tree, cornell, kind):
    tree, _ = split_tree
    rays = mibvh.make_rays(cornell, kind, width=24, height=18, samples=1)
    t, visits = walk(tree, cornell.triangles, rays.o, rays.d, rays.tmax, any_hit=True)
    hits = mibvh.trace(tree, cornell, rays, repeats=1)
    found = np.isfinite(t)
    assert found.any()
    # Rounding may tell a hit on an edge from a miss.
    assert (found != (hits.triangle >= 0)).mean() < 0.01
    cost = (visits * [1.2, 1.0]).sum(axis=1).mean()
    assert cost == pytest.approx(hits.counted_cost(), rel=0.01)
    closest, more = walk(tree, cornell.triangles, rays.o, rays.d, rays.tmax)
    assert (t[found] >= closest[found]).all()
    assert visits.sum() < more.sum()
    arrays = rays.o, rays.d, rays.tmax, rays.viewpoint
    whole = cut_at_hits(tree, cornell.triangles, *arrays, any_hit=True)
    assert whole.select(slice(5)).any_hit
    ratio = counted_cost(tree, cornell.triangles, whole, 1.2, 1.0) / cost
    assert ratio == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize("any_hit", [False, True])
@pytest.mark.parametrize("farthest", [np.inf, 0.3])
def test_segments_that_leave_the_scene_at_once_keep_their_direction(any_hit, farthest):
    """From a sheet that is a side of the scene's box, they end where they start, but for 1e-8."""
    rng = np.random.default_rng(0)
    corners = rng.random((300, 3, 3)).astype(np.float32)
    corners[:150, :, 2] = 0.0
    corners[:, :, 2] += 1000  # float32 has steps of 6e-5 there
    triangles = mibvh.Triangles(corners)
    tree = mibvh.build(triangles, "bbvh")
    o = np.hstack([rng.random((500, 2)), np.full((500, 1), np.nextafter(np.float32(1000), 0))])
    d = rng.normal(size=(500, 3)) * [1, 1, 0.05]
    d[:, 2] = -abs(d[:, 2])
    d[:100, 2] *= -1
    o, d, tmax = o.astype(np.float32), d.astype(np.float32), np.full(500, farthest, np.float32)
    cut = cut_at_hits(tree, triangles, o, d, tmax, np.zeros(500, np.int32), any_hit)
    _, visits = walk(tree, triangles, o, d, tmax, any_hit)
    for some in (slice(None), slice(5, 300, 3)):
        cost = counted_cost(tree, triangles, cut.select(some), 1.2, 1.0)
        assert cost == pytest.approx((visits[some] * [1.2, 1.0]).sum(axis=1).mean(), rel=1e-3)


def test_rays_that_are_no_numbers_make_no_segments(split_tree, cornell):
    tree, rays = split_tree
    o = rays.o.copy()
    o[:5] = np.nan
    cut = cut_at_hits(tree, cornell.triangles, o, rays.d, rays.tmax, rays.viewpoint)
    assert len(cut) == len(rays) - 5


def test_measured_context_compiles_none_for_the_area():
    assert Context().compiled_measure(2.0) is None
    assert get("finite").options().area_weight > 0
