"""Wide trees in warps in lockstep: a lane per ray, and a lane per child."""

import itertools

import numpy as np
import pytest
from cuts import cut
from test_traversal import random_rays, ray_set
from test_traversal_warp import Lane, assert_same, execute, float32_distances, kernel_hits

import mibvh
from mibvh.traversal.child_order import child_priority
from mibvh.traversal.records import leaf_rows, unit_scale
from mibvh.traversal.warp import STYLES, simulate
from mibvh.traversal.wide_rows import NETWORKS
from mibvh.traversal.wide_walk import walk_wide_tree

COUNTERS = ("inner", "boxes", "leaves", "tests")
#: Styles in which what a ray visits does not depend on the others of its warp.
ALONE = ("single", "while-while", "drjit-while-while")
F = np.float32


def rays_through(triangles, count, seed=3):
    """Rays between random points of the scene's box: from within, to all sides."""
    rng = np.random.default_rng(seed)
    lower, upper = triangles.bounds.astype(np.float64)
    o, to = (lower + (upper - lower) * rng.random((count, 3)) for _ in range(2))
    return ray_set(o.astype(F), (to - o).astype(F))


def wide_cut(name, kind, width, small=False):
    triangles, tree = cut(name, kind)
    assert tree.splits_triangles
    # Leaves of many triangles, so that those tested together are not all of them.
    wide = mibvh.collapse(tree, width, max_leaf=12, c_inner=6.0)
    assert wide.count.max(where=wide.is_leaf, initial=0) > 8
    return triangles, mibvh.quantised(wide) if small else wide


cuts = pytest.mark.parametrize(
    ("name", "kind"), [("pipes", "sbvh, all splits"), ("tiles", "streelet, many splits")]
)
widths = pytest.mark.parametrize("width", [2, 4, 8])


# ------------------------------------------------------------ against the wide kernel


@cuts
@widths
@pytest.mark.parametrize("small", [False, True])
def test_one_ray_per_warp_issues_what_the_wide_kernel_counts(name, kind, width, small):
    triangles, wide = wide_cut(name, kind, width, small)
    rays = rays_through(triangles, 3000)
    hits = mibvh.trace(wide, triangles, rays, repeats=1)
    for style in STYLES:
        alone = simulate(wide, triangles, rays, 1, style)
        group = simulate(wide, triangles, rays, width, style, lane_per="child", rays_per_lane=1)
        assert_same(alone, hits, ("t", "triangle"))
        assert_same(group, hits, ("t", "triangle"))
        if STYLES[style].postpone:
            continue
        assert_same(alone, hits, COUNTERS)
        assert_same(group, hits, COUNTERS)
        np.testing.assert_array_equal(alone.issued.T, [hits.inner, hits.tests])
        np.testing.assert_array_equal(group.issued[:, 0], hits.inner)
        assert alone.utilisation() == 1
        assert alone.c_inner == pytest.approx(1.2 + 0.2 * (width - 2))
        assert group.c_inner == 1.2
        idle = (width * hits.inner.astype(int) - hits.boxes).sum()
        assert group.active == (hits.boxes.sum(), hits.tests.sum())
        assert width * group.issued[:, 0].sum() - group.active[0] == idle


@cuts
def test_binary_trees_have_two_lanes_per_ray(name, kind):
    triangles, tree = cut(name, kind)
    rays = rays_through(triangles, 2000)
    wide = mibvh.collapse(tree, 2)
    for style in STYLES:
        binary = simulate(tree, triangles, rays, 32, style, lane_per="child")
        of_wide = simulate(wide, triangles, rays, 32, style, lane_per="child")
        assert_same(binary, of_wide, ("t", "triangle", *COUNTERS, "issued", "rounds"))
    hits = kernel_hits(tree, triangles, rays)
    single = simulate(tree, triangles, rays, 2, "single", lane_per="child")
    assert_same(single, hits)
    np.testing.assert_array_equal(single.issued[:, 0], hits.inner)


@cuts
@pytest.mark.parametrize("order", [None, "worth"])
def test_rays_that_any_hit_ends(name, kind, order):
    triangles, wide = wide_cut(name, kind, 8)
    if order:
        wide = wide.ordered(child_priority(wide, triangles, order))
    rays = rays_through(triangles, 2000)
    hits = mibvh.trace(wide, triangles, rays, any_hit=True, repeats=1)
    assert_same(
        simulate(wide, triangles, rays, 1, "single", any_hit=True),
        hits,
        ("t", "triangle", *COUNTERS),
    )
    group = simulate(wide, triangles, rays, 32, "single", lane_per="child", any_hit=True)
    assert_same(group, hits, ("t", "triangle", "inner", "boxes", "leaves"))
    # Lanes beside the one that finds the hit test their triangles, too.
    more = group.tests.astype(int) - hits.tests
    assert ((more >= 0) & (more < 8)).all()
    assert more[hits.triangle < 0].max(initial=0) == 0 < more.max()


# ------------------------------------------------------------ against plain Python


def own_steps(walk, wide, ray, lanes):
    """A ray's steps as the wide kernel's slow twin tells them: ``n`` of nodes, ``t`` of triangles.

    As many triangles of a leaf as the ray has lanes are one step; ``|`` ends a leaf.
    """
    last = wide.first[wide.is_leaf] + wide.count[wide.is_leaf] - 1
    ends, steps, tested = set(last.tolist()), "", 0
    for step in walk.steps[walk.starts[ray] : walk.starts[ray + 1]]:
        if step >= 0:
            steps += "n"
            continue
        steps += "t" if tested % lanes == 0 else ""
        tested += 1
        if ~step in ends:
            steps, tested = f"{steps}|", 0
    return steps


def issued_together(rays, style):
    """Steps of nodes and of triangles that a warp issues for the steps of its rays."""
    if style == "single":
        steps = itertools.zip_longest(*(ray.replace("|", "") for ray in rays))
        return np.sum([["n" in now, "t" in now] for now in steps], axis=0)
    rounds = []
    for ray in rays:
        leaves = ray.split("|")
        if style == "drjit-while-while":  # a round ends where a node follows
            leaves = ray.replace("|n", "#n").replace("|", "").split("#")
        rounds.append([(leaf.count("n"), leaf.count("t")) for leaf in leaves])
    together = itertools.zip_longest(*rounds, fillvalue=(0, 0))
    return np.sum([np.max(now, axis=0) for now in together], axis=0)


@cuts
@pytest.mark.parametrize(("width", "small"), [(2, False), (4, True), (8, False)])
@pytest.mark.parametrize("lane_per", ["ray", "child"])
def test_issued_is_what_single_rays_need_put_together(name, kind, width, small, lane_per):
    triangles, wide = wide_cut(name, kind, width, small)
    rays = rays_through(triangles, 300)
    walk = walk_wide_tree(wide, triangles, rays, steps=True)
    lanes = width if lane_per == "child" else 1
    steps = [own_steps(walk, wide, ray, lanes) for ray in range(len(rays))]
    for style, lanes_of_warp in itertools.product(ALONE, (8, 32)):
        warps = simulate(wide, triangles, rays, lanes_of_warp, style, lane_per=lane_per)
        assert_same(warps, walk, ("t", "triangle", *COUNTERS))
        groups = lanes_of_warp // lanes
        for warp, issued in enumerate(warps.issued):
            packet = steps[warp * groups : (warp + 1) * groups]
            np.testing.assert_array_equal(issued, issued_together(packet, style))
        lane_steps = warps.issued.sum(axis=0) * lanes_of_warp
        work = (walk.boxes if lanes > 1 else walk.inner).sum() * 1.2 + walk.tests.sum()
        assert warps.utilisation(1.2) == pytest.approx(work / (lane_steps @ [1.2, 1]))


class WideLane(Lane):
    """A ray in a wide tree, in plain Python with float32 numbers."""

    def __init__(self, wide, scale, lanes):
        super().__init__()
        self.wide, self.lanes = wide, lanes
        self.lower, self.upper = wide.lower * scale, wide.upper * scale

    def visit(self, node, _):
        self.inner += 1
        begin, size = self.wide.child[node], self.wide.children[node]
        entered = [F(np.inf)] * self.wide.width
        for i in range(size):
            a = (self.lower[begin + i] - self.o) * self.inv
            b = (self.upper[begin + i] - self.o) * self.inv
            near = max(np.minimum(a, b).max(), F(0))
            if near <= min(np.maximum(a, b).min() * F(1 + 2.0**-21), self.t):
                entered[i] = near
        order = list(range(self.wide.width))
        for p, q in NETWORKS[self.wide.width]:
            if entered[order[q]] < entered[order[p]]:
                order[p], order[q] = order[q], order[p]
        for child in (begin + i for i in reversed(order) if entered[i] < np.inf):
            leaf = self.wide.child[child] < 0
            self.stack.append(int(~self.wide.first[child] if leaf else child))
        self.node = self.pop()

    def test(self, code, rows, codes, distances):
        return -(-super().test(code, rows, codes, distances) // self.lanes)


@cuts
@pytest.mark.parametrize("width", [4, 8])
@pytest.mark.parametrize("lane_per", ["ray", "child"])
@pytest.mark.parametrize(
    ("style", "options"),
    [
        ("while-while", {}),
        ("speculative", {}),
        ("persistent", {"rays_per_lane": 3}),
        ("persistent", {"rays_per_lane": 4, "warps": 3}),
    ],
)
def test_against_a_literal_execution(name, kind, width, lane_per, style, options):
    triangles, wide = wide_cut(name, kind, width)
    rays = rays_through(triangles, 150)
    scale = unit_scale(triangles)
    scaled = ray_set(rays.o * scale, rays.d)
    lanes = width if lane_per == "child" else 1
    groups = 32 // lanes
    rows = leaf_rows(wide, triangles, scale)

    class Rows:
        """Triangles' rows; of an inner node its number."""

        def __getitem__(self, at):
            return rows[at] if isinstance(at, tuple) else at

    scene = (
        Rows(),
        rows.view(np.int32),
        0,
        float32_distances(rows, 0, scaled, len(triangles)),
    )
    issued, counts, hits = execute(
        scene,
        scaled,
        groups,
        style,
        -(-20 * groups // 32) if style == "persistent" else 0,
        options.get("rays_per_lane", 1),
        options.get("warps", 1),
        lambda: WideLane(wide, scale, lanes),
    )
    warps = simulate(wide, triangles, rays, 32, style, lane_per=lane_per, **options)
    np.testing.assert_array_equal(warps.triangle, hits)
    for column, counter in enumerate(("inner", "leaves", "tests")):
        np.testing.assert_array_equal(getattr(warps, counter), counts[:, column])
    np.testing.assert_array_equal(warps.issued, issued[:, :2])
    np.testing.assert_array_equal(warps.rounds, issued[:, 2])


# ------------------------------------------------------------ properties


@pytest.mark.parametrize("style", STYLES)
def test_any_number_of_threads_gives_the_same(style):
    triangles, wide = wide_cut("tiles", "streelet, many splits", 4)
    rays = rays_through(triangles, 1000)
    options = {"lane_per": "child", "rays_per_lane": 3}
    one = simulate(wide, triangles, rays, 32, style, threads=1, **options)
    for threads in (2, 5):
        more = simulate(wide, triangles, rays, 32, style, threads=threads, **options)
        assert_same(more, one, ("t", "triangle", *COUNTERS, "issued", "rounds"))


def test_maxima_are_those_of_the_rays_of_a_warp():
    triangles, wide = wide_cut("pipes", "sbvh, all splits", 8)
    rays = rays_through(triangles, 1000)
    warps = simulate(wide, triangles, rays, 32, lane_per="child", order="random")
    inner = warps.inner[warps.dealt].reshape(-1, 4)
    np.testing.assert_array_equal(warps.maxima(warps.inner), inner.max(axis=1))


@pytest.mark.parametrize("style", STYLES)
def test_a_tree_that_is_one_leaf(style):
    one = mibvh.Triangles(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32))
    wide = mibvh.collapse(mibvh.build(one, "bbvh"), 8)
    rays = ray_set([[0.2, 0.2, -1], [0.9, 0.9, -1]], [[0, 0, 1]] * 2)
    for lane_per in ("ray", "child"):
        warps = simulate(wide, one, rays, 8, style, lane_per=lane_per)
        assert warps.triangle.tolist() == [0, -1]
        assert (warps.tests.tolist(), warps.inner.tolist()) == ([1, 1], [0, 0])


def test_impossible_requests(small_soup):
    wide = mibvh.collapse(mibvh.build(small_soup, "sbvh"), 8)
    rays = random_rays(10)
    with pytest.raises(mibvh.MibvhError, match="a warp of 4 lanes holds no ray"):
        simulate(wide, small_soup, rays, 4, lane_per="child")
    with pytest.raises(mibvh.MibvhError, match="lane_per must be ray or child, not 'box'"):
        simulate(wide, small_soup, rays, 8, lane_per="box")
