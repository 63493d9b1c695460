import numpy as np
import pytest
from conftest import soup
from test_traversal import brute_force, children_hit, random_rays, ray_set

import mibvh
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.trace import Tracer

COUNTERS = ("inner", "leaves", "tests")


@pytest.fixture(scope="module")
def scene():
    triangles = soup(1500, 5, size=0.2)
    return triangles, random_rays(3000, 6)


def run_both(scene, builder, style, **options):
    triangles, rays = scene
    tree = mibvh.build(triangles, builder)
    return [
        mibvh.trace(tree, triangles, rays, style=style, repeats=1, **options)
        for style in ("single", style)
    ]


@pytest.mark.parametrize("options", [{}, {"cull": True}, {"any_hit": True}])
@pytest.mark.parametrize("builder", ["bbvh", "sbvh"])
def test_while_while_visits_what_the_single_loop_does(scene, builder, options):
    single, rounds = run_both(scene, builder, "while-while", **options)
    for name in ("t", "triangle", *COUNTERS, "steps"):
        np.testing.assert_array_equal(getattr(single, name), getattr(rounds, name))
    assert rounds.style == "while-while"


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize("builder", ["bbvh", "lbvh", "sbvh"])
def test_a_leaf_put_aside_costs_visits_and_changes_no_hit(scene, builder, cull):
    single, speculative = run_both(scene, builder, "speculative", cull=cull)
    np.testing.assert_array_equal(single.t, speculative.t)
    np.testing.assert_array_equal(single.triangle, speculative.triangle)
    for name in COUNTERS:
        fewer, more = (getattr(hits, name).astype(int) for hits in (single, speculative))
        assert fewer.sum() < more.sum() < 1.5 * fewer.sum()
        # A part of a split triangle may be hit outside its leaf, which then spares visits.
        assert (fewer <= more).all() or builder == "sbvh"


def reference_rounds(tree, triangles, rays, speculative):
    """Per ray a list of (inner nodes, triangles) per round: the same walk in plain Python."""
    distances, done = brute_force(triangles, rays), None
    for i, (o, d) in enumerate(zip(rays.o.astype(float), rays.d.astype(float), strict=True)):
        best, stack, node, rounds = np.inf, [], 0, []

        def is_leaf(node):
            return node is not done and tree.left[node] < 0

        def pop(stack=stack):
            return stack.pop() if stack else done

        while node is not done:
            inner, aside, tests = 0, done, 0
            while node is not done and not is_leaf(node):
                inner += 1
                found = children_hit(tree, node, o, d, best)
                stack += [child for _, child in found[1:]]
                node = found[0][1] if found else pop()
                if speculative and is_leaf(node) and aside is done:
                    aside, node = node, pop()
            while aside is not done or is_leaf(node):
                if aside is not done:
                    leaf, aside = aside, done
                else:
                    leaf, node = node, pop() if speculative else node
                ids = tree.references[tree.first[leaf] :][: tree.count[leaf]]
                tests += len(ids)
                best = min(best, distances[i, ids].min())
                if not speculative:
                    node = pop()
            rounds.append((inner, tests))
        yield rounds


def measured_rounds(scene, tree, style, lanes):
    """Rows of the packets' rounds, and each packet's first."""
    triangles, rays = scene
    tracer = Tracer(rays, float(unit_scale(triangles)), lanes, style=style)
    records = make_records(tree, triangles)
    leaves = tracer.fetch(tracer.run(records, count=True)[0][3])
    start, steps = tracer.launch.rounds(records, leaves)
    return np.split(steps, start[1:]), tracer.width


@pytest.mark.parametrize("style", ["while-while", "speculative"])
def test_rounds_against_plain_python(style):
    triangles = soup(200, 1, size=0.2)
    rays = random_rays(300)
    tree = mibvh.build(triangles, "bbvh")
    expected = list(reference_rounds(tree, triangles, rays, style == "speculative"))
    found, _ = measured_rounds((triangles, rays), tree, style, "scalar")
    assert np.mean([len(rounds) for rounds in expected]) > 1.5
    same = [
        np.array_equal(steps[: len(rounds)], rounds) and not steps[len(rounds) :].any()
        for steps, rounds in zip(found, expected, strict=True)
    ]
    # A box grazed within a rounding may be counted by one and not by the other.
    assert np.mean(same) > 0.99


@pytest.mark.parametrize("style", ["while-while", "speculative"])
def test_packets_take_the_longest_lane_of_every_round(scene, style):
    triangles, rays = scene
    tree = mibvh.build(triangles, "bbvh")
    alone, _ = measured_rounds(scene, tree, style, "scalar")
    packets, width = measured_rounds(scene, tree, style, "simd")
    assert len(packets) == -(-len(rays) // width)
    issued = 0
    for i, packet in enumerate(packets):
        longest = np.zeros((100, 2), int)
        for steps in alone[i * width : (i + 1) * width]:
            longest[: len(steps)] = np.maximum(longest[: len(steps)], steps)
        np.testing.assert_array_equal(packet, longest[: len(packet)])
        issued += width * longest.sum()
    hits = mibvh.trace(tree, triangles, rays, style=style, repeats=1)
    assert hits.issued == issued
    assert hits.lane_utilisation == hits.steps.sum() / issued


def test_rays_in_step_with_each_other_keep_all_lanes_busy(scene):
    triangles, rays = scene
    copies = [np.repeat(part[:1], 64, axis=0) for part in (rays.o, rays.d)]
    tree = mibvh.build(triangles, "bbvh")
    for style in ("while-while", "speculative"):
        hits = mibvh.trace(tree, triangles, ray_set(*copies), style=style, repeats=1)
        assert hits.lane_utilisation == 1
