"""Warps in lockstep: against the Dr.Jit kernels, and against a literal, slow execution."""

import dataclasses
import itertools

import numpy as np
import pytest
from cuts import cut
from test_traversal import random_rays, ray_set

import mibvh
from mibvh.builders import names
from mibvh.traversal.records import binary_rows, make_records, unit_scale
from mibvh.traversal.trace import Tracer
from mibvh.traversal.warp import STYLES, WIDTHS, simulate
from mibvh.variant import lane_width

COUNTERS = ("inner", "leaves", "tests")
#: The Dr.Jit kernel whose rays visit what a lane alone visits.
ALONE = {"drjit-speculative": "speculative", "drjit-while-while": "while-while"}
#: Generated architecture: pipes, and the flat walls that make spatial splits go deep.
SCENES = ("powerplant@1500", "livingroom@1500")


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    loaded = mibvh.load(request.param)
    return loaded.triangles, mibvh.diffuse_rays(loaded, viewpoints=2, width=32, height=24)


def kernel_hits(tree, triangles, rays, style="single", any_hit=False):
    tracer = Tracer(rays, float(unit_scale(triangles)), style=style, any_hit=any_hit)
    return tracer.hits(make_records(tree, triangles))


def assert_same(warps, hits, fields=("t", "triangle", *COUNTERS)):
    for name in fields:
        np.testing.assert_array_equal(getattr(warps, name), getattr(hits, name), err_msg=name)


# ------------------------------------------------------------ against the kernels


@pytest.mark.parametrize("builder", names())
def test_a_warp_of_one_is_what_is_counted(scene, builder):
    triangles, rays = scene
    tree = mibvh.build(triangles, builder)
    counted = {
        style: kernel_hits(tree, triangles, rays, style) for style in ("single", *ALONE.values())
    }
    for style in STYLES:
        hits = counted[ALONE.get(style, "single")]
        warps = simulate(tree, triangles, rays, 1, style)
        assert_same(warps, hits)
        assert warps.cost() == warps.counted_cost() == hits.counted_cost()
        assert warps.utilisation() == 1
        assert warps.lcv == hits.lcv
    assert_same(
        simulate(tree, triangles, rays, 1, "speculative", vote=False), counted["speculative"]
    )


@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "streelet"])
@pytest.mark.parametrize("style", STYLES)
def test_hits_are_the_kernels_at_every_width(scene, builder, style):
    triangles, rays = scene
    tree = mibvh.build(triangles, builder)
    hits = kernel_hits(tree, triangles, rays)
    if builder != "bbvh":
        assert tree.splits_triangles
    for width in WIDTHS:
        for order in ("stored", "random"):
            warps = simulate(tree, triangles, rays, width, style, order=order, rays_per_lane=5)
            assert_same(warps, hits, ("t", "triangle"))
            if not STYLES[style].postpone:
                assert_same(warps, hits, COUNTERS)


@pytest.mark.parametrize("builder", ["lbvh", "sbvh"])
def test_packets_of_the_kernels_issue_what_is_simulated(scene, builder):
    triangles, rays = scene
    tree = mibvh.build(triangles, builder)
    for style, simulated in [("single", "single"), *((b, a) for a, b in ALONE.items())]:
        hits = kernel_hits(tree, triangles, rays, style)
        warps = simulate(tree, triangles, rays, lane_width(), simulated)
        steps = warps.rounds if style == "single" else warps.issued
        assert hits.issued == steps.sum() * lane_width()
        assert_same(warps, hits)


@pytest.mark.parametrize("builder", ["bbvh", "sbvh"])
def test_rays_that_any_hit_ends(scene, builder):
    triangles, rays = scene
    tree = mibvh.build(triangles, builder)
    for style in STYLES:
        hits = kernel_hits(tree, triangles, rays, ALONE.get(style, "single"), any_hit=True)
        assert_same(simulate(tree, triangles, rays, 1, style, any_hit=True), hits)
        wide = simulate(tree, triangles, rays, 32, style, any_hit=True)
        np.testing.assert_array_equal(wide.triangle >= 0, hits.triangle >= 0)
        assert wide.tests.sum() < simulate(tree, triangles, rays, 32, style).tests.sum()
    shadows = dataclasses.replace(rays, meta={**rays.meta, "occlusion": True})
    assert_same(simulate(tree, triangles, shadows, 32, style), wide)


# ------------------------------------------------------------ against a literal execution

F = np.float32
DONE = -(2**31)


class Lane:
    """One thread of the published kernels, in plain Python with float32 numbers."""

    def __init__(self):
        self.node = self.leaf = DONE
        self.ray = -1

    def take(self, ray, rays, root):
        self.ray, self.stack = ray, []
        self.o, self.d = rays.o[ray], rays.d[ray]
        self.inv = F(1) / self.d
        self.t, self.hit, self.inner, self.leaves, self.tests = F(np.inf), -1, 0, 0, 0
        self.node, self.leaf = root, DONE

    def pop(self):
        return self.stack.pop() if self.stack else DONE

    def visit(self, row, codes):
        self.inner += 1
        found = []
        for child in range(2):
            a = (row[6 * child : 6 * child + 3] - self.o) * self.inv
            b = (row[6 * child + 3 : 6 * child + 6] - self.o) * self.inv
            near = max(np.minimum(a, b).max(), F(0))
            far = np.maximum(a, b).min() * F(1 + 2.0**-21)
            if near <= min(far, self.t):
                found.append((near, child))
        found.sort()
        self.stack += [int(codes[12 + child]) for _, child in found[1:]]
        self.node = int(codes[12 + found[0][1]]) if found else self.pop()

    def test(self, code, rows, codes, distances):
        """Test a leaf; how many triangles it has."""
        row, steps = ~code, 1
        while True:
            triangle = codes[row, 12]
            if distances[self.ray, triangle] < self.t:
                self.t, self.hit = distances[self.ray, triangle], triangle
            if codes[row, 13]:
                break
            row, steps = row + 1, steps + 1
        self.leaves, self.tests = self.leaves + 1, self.tests + steps
        return steps


def triple(d, a, b):
    s, e = a + b, b - a
    return d[..., 0] * (s[..., 1] * e[..., 2] - s[..., 2] * e[..., 1]) + (
        d[..., 1] * (s[..., 2] * e[..., 0] - s[..., 0] * e[..., 2])
        + d[..., 2] * (s[..., 0] * e[..., 1] - s[..., 1] * e[..., 0])
    )


def float32_distances(rows, inners, rays, count):
    """(rays, triangles) float32: where each ray hits each triangle; infinite for a miss."""
    shapes, ids = rows[inners:], rows.view(np.int32)[inners:, 12]
    o, d = rays.o[:, None], rays.d[:, None]
    a, b, c = (shapes[None, :, 3 * k : 3 * k + 3] - o for k in range(3))
    u, v, w = triple(d, c, b), triple(d, a, c), triple(d, b, a)
    inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
    n = shapes[None, :, 9:12]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (n[..., 0] * a[..., 0] + n[..., 1] * a[..., 1] + n[..., 2] * a[..., 2]) / (
            n[..., 0] * d[..., 0] + n[..., 1] * d[..., 1] + n[..., 2] * d[..., 2]
        )
        t = np.where(inside & (t >= 0), t, F(np.inf))
    all_ids = np.full((len(rays.o), count), F(np.inf), F)
    all_ids[:, ids] = t
    return all_ids


def binary_scene(tree, triangles, rays):
    """Rows, codes, the root's code, and where each ray hits each triangle."""
    rows, root = binary_rows(tree, triangles)
    distances = float32_distances(rows, (len(tree) - 1) // 2, rays, len(triangles))
    return rows, rows.view(np.int32), root, distances


def execute(scene, rays, width, style, threshold=0, per_lane=1, warps=1, new_lane=Lane):
    """Warps executed as the published kernels say, loop by loop, with masks of active lanes."""
    rules = STYLES[style]
    rows, codes, root, distances = scene
    counts, hits = np.zeros((len(rays.o), 3), int), np.full(len(rays.o), -1)
    issued = []

    def round_of(lanes):
        nodes = triangles_tested = 0
        inside = [lane for lane in lanes if lane.node >= 0]
        while inside:  # while node is inner
            nodes += 1
            for lane in inside:
                lane.visit(rows[lane.node], codes[lane.node])
                if rules.postpone and DONE < lane.node < 0 and lane.leaf == DONE:
                    lane.leaf, lane.node = lane.node, lane.pop()
            if rules.vote and not any(lane.leaf == DONE for lane in inside):
                break
            inside = [lane for lane in inside if lane.node >= 0]
        if style == "while-while":
            holders = [lane for lane in lanes if DONE < lane.node < 0]
            lengths = [lane.test(lane.node, rows, codes, distances) for lane in holders]
            for lane in holders:
                lane.node = lane.pop()
            return nodes, max(lengths, default=0)
        holders = [lane for lane in lanes if lane.leaf != DONE]
        while holders:  # while there is a leaf put aside
            triangles_tested += max(
                lane.test(lane.leaf, rows, codes, distances) for lane in holders
            )
            for lane in holders:
                lane.leaf = DONE
                if DONE < lane.node < 0:
                    lane.leaf, lane.node = lane.node, lane.pop()
            holders = [lane for lane in holders if lane.leaf != DONE]
        return nodes, triangles_tested

    def put_away(lane):
        if lane.ray >= 0:
            counts[lane.ray] = lane.inner, lane.leaves, lane.tests
            hits[lane.ray] = lane.hit

    def run(begin, end):
        """A kernel's launch: each warp is suspended after each of its rounds."""
        queue = list(range(begin, end))

        def warp(total):
            lanes = [new_lane() for _ in range(width)]
            while True:
                for lane in lanes:
                    if lane.node == DONE and queue:
                        put_away(lane)
                        lane.take(queue.pop(0), rays, root)
                while any(lane.node != DONE for lane in lanes):
                    entered = sum(lane.node != DONE for lane in lanes)
                    total += (*round_of(lanes), 1)
                    yield
                    if entered < threshold:
                        break
                if not queue and all(lane.node == DONE for lane in lanes):
                    break
            for lane in lanes:
                put_away(lane)

        totals = [np.zeros(3, int) for _ in range(warps)]
        running = {i: warp(totals[i]) for i in range(warps)}
        while running:
            turn = min(running, key=lambda i: (1.2 * totals[i][0] + totals[i][1], i))
            if next(running[turn], "ended") == "ended":
                del running[turn]
        issued.extend(totals)

    length = width * per_lane * warps
    for begin in range(0, len(rays.o), length):
        run(begin, min(begin + length, len(rays.o)))
    return np.array(issued), counts, hits


@pytest.mark.parametrize("width", [4, 32])
@pytest.mark.parametrize(
    ("style", "options"),
    [
        ("while-while", {}),
        ("speculative", {}),
        ("persistent", {"rays_per_lane": 3}),
        ("persistent", {"rays_per_lane": 4, "warps": 3}),
    ],
)
@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "streelet"])
def test_against_a_literal_execution(scene, builder, style, options, width):
    triangles, rays = scene
    rays = rays.select(slice(0, 200))
    scale = unit_scale(triangles)
    tree = mibvh.build(triangles, builder)
    scaled = ray_set(rays.o * scale, rays.d)
    threshold = {4: 3, 32: 20}[width] if style == "persistent" else 0
    issued, counts, hits = execute(
        binary_scene(tree, triangles, scaled),
        scaled,
        width,
        style,
        threshold,
        options.get("rays_per_lane", 1),
        options.get("warps", 1),
    )
    warps = simulate(tree, triangles, rays, width, style, **options)
    assert warps.threshold == threshold
    # Grazing a box, a direction scaled by a power of two rounds as the unscaled one does.
    np.testing.assert_array_equal(warps.triangle, hits)
    for column, name in enumerate(COUNTERS):
        np.testing.assert_array_equal(getattr(warps, name), counts[:, column])
    np.testing.assert_array_equal(warps.issued, issued[:, :2])
    np.testing.assert_array_equal(warps.rounds, issued[:, 2])


def own_rounds(lane, rows, codes, distances, style):
    """What a ray takes alone in this package's own kernels: rounds of a descent and its leaves.

    Of the single loop, every step is a round.
    """
    while lane.node != DONE:
        if style == "single":
            if lane.node >= 0:
                lane.visit(rows[lane.node], codes[lane.node])
                yield 1, 0
                continue
            yield from [(0, 1)] * lane.test(lane.node, rows, codes, distances)
            lane.node = lane.pop()
            continue
        nodes = tests = 0
        while lane.node >= 0:
            nodes += 1
            lane.visit(rows[lane.node], codes[lane.node])
            if style == "drjit-speculative" and DONE < lane.node < 0 and lane.leaf == DONE:
                lane.leaf, lane.node = lane.node, lane.pop()
        if style == "drjit-while-while":
            while DONE < lane.node < 0:
                tests += lane.test(lane.node, rows, codes, distances)
                lane.node = lane.pop()
        while lane.leaf != DONE:
            tests += lane.test(lane.leaf, rows, codes, distances)
            lane.leaf = DONE
            if DONE < lane.node < 0:
                lane.leaf, lane.node = lane.node, lane.pop()
        yield nodes, tests


@pytest.mark.parametrize("style", ["single", "drjit-while-while", "drjit-speculative"])
@pytest.mark.parametrize("kind", ["sbvh, all splits", "streelet, many splits"])
@pytest.mark.parametrize("name", ["pipes", "tiles"])
def test_own_kernels_against_plain_python_on_cuts(name, kind, style):
    triangles, tree = cut(name, kind)
    assert tree.splits_triangles
    rng = np.random.default_rng(3)
    lower, upper = triangles.bounds.astype(np.float64)
    o, to = (lower + (upper - lower) * rng.random((100, 3)) for _ in range(2))
    rays = ray_set(o.astype(F), (to - o).astype(F))
    scaled = ray_set(rays.o * unit_scale(triangles), rays.d)
    rows, root = binary_rows(tree, triangles)
    codes, inners = rows.view(np.int32), (len(tree) - 1) // 2
    distances = float32_distances(rows, inners, scaled, len(triangles))
    lanes = [Lane() for _ in range(len(rays))]
    alone = []
    for ray, lane in enumerate(lanes):
        lane.take(ray, scaled, root)
        alone.append(list(own_rounds(lane, rows, codes, distances, style)))
    for width in (1, 8, 32):
        warps = simulate(tree, triangles, rays, width, style)
        packets = [alone[begin : begin + width] for begin in range(0, len(rays), width)]
        for packet, issued, rounds in zip(packets, warps.issued, warps.rounds, strict=True):
            together = itertools.zip_longest(*packet, fillvalue=(0, 0))
            longest = np.array([np.max(lanes_steps, axis=0) for lanes_steps in together])
            np.testing.assert_array_equal(issued, longest.sum(axis=0))
            assert rounds == len(longest)
        np.testing.assert_array_equal(warps.triangle, [lane.hit for lane in lanes])
        for counter in COUNTERS:
            counted = [getattr(lane, counter) for lane in lanes]
            np.testing.assert_array_equal(getattr(warps, counter), counted)


# ------------------------------------------------------------ properties


@pytest.fixture(scope="module")
def small(small_soup):
    return mibvh.build(small_soup, "sbvh"), small_soup, random_rays(1000, 8)


@pytest.mark.parametrize("style", STYLES)
def test_any_number_of_threads_gives_the_same(small, style):
    one = simulate(*small, 8, style, rays_per_lane=3, threads=1)
    for threads in (2, 3, 7):
        more = simulate(*small, 8, style, rays_per_lane=3, threads=threads)
        assert_same(more, one, ("t", "triangle", *COUNTERS, "issued", "rounds"))


def test_maxima_are_those_of_packets_as_dealt(small):
    warps = simulate(*small, 8, "single", order="random")
    steps = (warps.inner + warps.tests)[warps.dealt].reshape(-1, 8)
    np.testing.assert_array_equal(warps.maxima(warps.inner + warps.tests), steps.max(axis=1))
    # In a single loop all wait for the longest.
    np.testing.assert_array_equal(warps.rounds, steps.max(axis=1))


@pytest.mark.parametrize("style", STYLES)
def test_rays_in_step_with_each_other_keep_all_lanes_busy(small, style):
    tree, triangles, rays = small
    copies = [np.repeat(part[:40], 64, axis=0) for part in (rays.o, rays.d)]
    warps = simulate(tree, triangles, ray_set(*copies), 64, style)
    assert warps.utilisation() == 1
    assert warps.cost() == simulate(tree, triangles, ray_set(*copies), 1, "single").cost() or (
        style == "drjit-speculative"
    )


def test_wide_warps_issue_more_and_random_rays_more_still(scene):
    triangles, rays = scene
    tree = mibvh.build(triangles, "bbvh")
    costs = [simulate(tree, triangles, rays, width, "while-while").cost() for width in WIDTHS]
    assert costs == sorted(costs)
    shuffled = simulate(tree, triangles, rays, 32, "while-while", order="random")
    assert shuffled.cost() > simulate(tree, triangles, rays, 32, "while-while").cost()


def test_fetching_rays_keeps_lanes_busier(scene):
    triangles, rays = scene
    tree = mibvh.build(triangles, "bbvh")
    waiting = simulate(tree, triangles, rays, 32, "speculative")
    fetching = simulate(tree, triangles, rays, 32, "persistent")
    assert fetching.utilisation() > waiting.utilisation()
    assert (fetching.threshold, waiting.threshold) == (20, 0)


def test_without_the_vote_rounds_are_fewer_and_longer(scene):
    triangles, rays = scene
    tree = mibvh.build(triangles, "bbvh")
    voting = simulate(tree, triangles, rays, 32, "speculative")
    not_voting = simulate(tree, triangles, rays, 32, "speculative", vote=False)
    assert not_voting.rounds.sum() < voting.rounds.sum()
    # What a lane visits is then no other lane's business, as in the Dr.Jit kernel.
    assert_same(not_voting, kernel_hits(tree, triangles, rays, "speculative"))


def test_orders(small_soup):
    tree = mibvh.build(small_soup, "bbvh")
    rays = random_rays(500, 3)
    stored = simulate(tree, small_soup, rays, 8, "speculative")
    np.testing.assert_array_equal(stored.dealt, np.arange(500))
    shuffled = simulate(tree, small_soup, rays, 8, "speculative", order="random", seed=1)
    again = simulate(tree, small_soup, rays.select(shuffled.dealt), 8, "speculative")
    np.testing.assert_array_equal(shuffled.issued, again.issued)
    np.testing.assert_array_equal(shuffled.t[shuffled.dealt], again.t)
    assert (
        simulate(tree, small_soup, rays, 8, order="random", seed=2).dealt != shuffled.dealt
    ).any()


def test_morton_order_is_that_of_sorted_rays(cornell):
    options = {"width": 16, "height": 12, "bounces": 2}
    paths, stored = (mibvh.diffuse_rays(cornell, sort=sort, **options) for sort in (False, True))
    tree = mibvh.build(cornell.triangles, "bbvh")
    sorted_now = simulate(tree, cornell, paths, 32, order="morton")
    np.testing.assert_array_equal(paths.o[sorted_now.dealt], stored.o)
    np.testing.assert_array_equal(simulate(tree, cornell, stored, 32).issued, sorted_now.issued)
    np.testing.assert_array_equal(
        simulate(tree, cornell, paths, order="path").dealt, np.arange(len(paths))
    )
    with pytest.raises(mibvh.MibvhError, match="sort=False"):
        simulate(tree, cornell, stored, order="path")


@pytest.mark.parametrize("style", STYLES)
def test_a_tree_that_is_one_leaf_and_rays_that_are_no_rays(style):
    one = mibvh.Triangles(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32))
    tree = mibvh.build(one, "bbvh")
    rays = ray_set([[0.2, 0.2, -1], [0, 0, 0], [0.9, 0.9, -1], [0.2, 0.2, -1]], [[0, 0, 1]] * 4)
    rays.o[1], rays.d[3] = np.nan, 0  # a ray set is not made of such rays
    for width in (1, 2, 4):
        warps = simulate(tree, one, rays, width, style)
        assert warps.t.tolist() == [1, np.inf, np.inf, np.inf]
        assert warps.triangle.tolist() == [0, -1, -1, -1]
        assert warps.tests.tolist() == [1, 0, 1, 0]
        assert warps.leaves.tolist() == [1, 0, 1, 0]
        assert warps.inner.sum() == 0


def test_only_rays_that_are_no_rays(small):
    tree, triangles, _ = small
    rays = random_rays(100)
    rays.o[:] = np.nan
    warps = simulate(tree, triangles, rays, 8)
    assert (warps.cost(), warps.utilisation()) == (0, 1)


def test_impossible_requests(small):
    tree, triangles, rays = small
    for options, message in [
        ({"width": 3}, "width must be one of"),
        ({"style": "packet"}, "style must be one of"),
        ({"order": "sorted"}, "order must be one of"),
        ({"fetch_below": 0}, "fetch_below"),
        ({"warps": 0}, "warps"),
        ({"rays_per_lane": 0}, "rays_per_lane"),
        ({"style": "single", "vote": True}, "nothing to vote on"),
    ]:
        with pytest.raises(mibvh.MibvhError, match=message):
            simulate(tree, triangles, rays, **options)
    with pytest.raises(mibvh.MibvhError, match="no rays"):
        simulate(tree, triangles, rays.select(slice(0)))
    with pytest.raises(mibvh.MibvhError, match="another geometry"):
        simulate(tree, mibvh.Triangles(triangles.corners[:9]), rays)
