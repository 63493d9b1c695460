import itertools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mibvh
from mibvh.traversal import divergence
from mibvh.traversal.divergence import Rounds, rounds_cost
from mibvh.traversal.warp import ray_rounds, simulate

VALUES = np.array([3, 1, 4, 1, 5, 9, 2, 6])


# ------------------------------------------------------------ differences between rays


def test_packets_are_rays_dealt_side_by_side():
    assert divergence.packets(VALUES, 3).tolist() == [[3, 1, 4], [1, 5, 9]]
    back = np.arange(8)[::-1].astype(np.int32)
    assert divergence.packets(VALUES, 4, back).tolist() == [[6, 2, 9, 5], [1, 4, 1, 3]]
    assert divergence.packets(VALUES, 16).tolist() == [VALUES.tolist()]
    with pytest.raises(mibvh.MibvhError, match="width"):
        divergence.packets(VALUES, 0)


@pytest.mark.parametrize("width", [1, 2, 3])
def test_expected_maximum_over_all_draws(width):
    every = [max(draw) for draw in itertools.product(VALUES, repeat=width)]
    expected = np.mean(every) / VALUES.mean()
    assert divergence.expected_maximum(VALUES, width) == pytest.approx(expected, rel=1e-12)


def test_packets_by_hand():
    # Packets (3 1 4 1) and (5 9 2 6): maxima 4 and 9, mean 31/8, variances 1.6875 and 6.25.
    assert divergence.packet_maximum(VALUES, 4) == pytest.approx(6.5 / (31 / 8))
    assert divergence.within_packets(VALUES, 4) == pytest.approx(3.96875**0.5 / (31 / 8))
    assert divergence.within_packets(VALUES, 8) == pytest.approx(
        divergence.relative_deviation(VALUES)
    )
    assert divergence.lcv(VALUES) == np.std(VALUES)
    assert divergence.within_packets(VALUES, 1) == 0
    assert divergence.packet_maximum(VALUES, 1) == divergence.expected_maximum(VALUES, 1) == 1


def test_simd_cost_by_hand():
    # Mean 4, standard deviation 1: 2. LCV of 1, 33 is 16, its fourth root 2.
    assert divergence.simd_cost(np.array([3, 5])) == 2
    assert divergence.simd_cost(np.array([3, 5]), np.array([1, 33])) == pytest.approx(4)


def test_rays_that_visit_nothing():
    none = np.zeros(8)
    assert divergence.relative_deviation(none) == divergence.within_packets(none, 4) == 0
    assert divergence.expected_maximum(none, 4) == divergence.packet_maximum(none, 4) == 1


# ------------------------------------------------------------ rounds


@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "streelet", "lbvh"])
def test_rounds_are_those_of_single_rays(builder):
    scene = mibvh.load("powerplant@1500")
    rays = mibvh.diffuse_rays(scene, viewpoints=2, width=32, height=24)
    tree = mibvh.build(scene, builder)
    alone = simulate(tree, scene, rays, 1, "while-while")
    for threads in (1, 3):
        rounds = ray_rounds(tree, scene, rays, threads)
        np.testing.assert_array_equal(rounds.per_ray, alone.rounds)
        for counts, visited in ((rounds.descents, alone.inner), (rounds.lengths, alone.tests)):
            assert counts.sum() == rounds.per_ray.sum()
            assert (counts * np.arange(len(counts))).sum() == visited.sum()
            assert counts[-1] > 0


@pytest.fixture
def drawn():
    rng = np.random.default_rng(1)
    return Rounds(
        rng.integers(1, 20, 4000).astype(np.uint32),
        np.array([5, 9, 4, 3, 2, 1, 0, 0, 1]),
        np.array([1, 6, 3, 2]),
    )


def mean_round(rounds):
    steps, tests = (
        float((c * np.arange(len(c))).sum() / c.sum()) for c in (rounds.descents, rounds.lengths)
    )
    return 1.2 * steps + tests


@pytest.mark.parametrize("fetch", [True, False])
@pytest.mark.parametrize("postpone", [True, False])
def test_at_width_one_it_is_what_the_rays_need(drawn, fetch, postpone):
    cost = rounds_cost(drawn, 1, fetch=fetch, postpone=postpone)
    assert cost == pytest.approx(drawn.per_ray.mean() * mean_round(drawn), rel=0.03)


@pytest.mark.parametrize(
    "options",
    [{"fetch": True}, {"fetch": False}, {"fetch": False, "dealt": np.arange(640, dtype=np.int32)}],
)
def test_rounds_that_are_alike_cost_the_same_at_any_width(options):
    alike = Rounds(np.full(640, 7, np.uint32), np.array([0, 0, 0, 9]), np.array([0, 0, 9]))
    for width in (1, 4, 32):
        assert rounds_cost(alike, width, **options) == pytest.approx(7 * (1.2 * 3 + 2))


def test_without_a_leaf_aside_a_round_is_the_greatest_of_each_kind(drawn):
    d, tests = (np.repeat(np.arange(len(c)), c) for c in (drawn.descents, drawn.lengths))
    most = 1.2 * divergence.expected_maximum(d, 8) * d.mean() + (
        divergence.expected_maximum(tests, 8) * tests.mean()
    )
    cost = rounds_cost(drawn, 8, fetch=True, postpone=False)
    assert cost == pytest.approx(drawn.per_ray.mean() * most, rel=0.01)


def plain(rounds, width, postpone, warps, rng):
    """Warps of drawn rounds that wait for their last lane, one lane at a time."""
    d, tests = (np.repeat(np.arange(len(c)), c) for c in (rounds.descents, rounds.lengths))
    total = 0.0
    for _ in range(warps):
        left = rng.choice(rounds.per_ray, width).astype(int)
        ahead = rng.choice(d, width)
        while left.any():
            longest = max(ahead[i] for i in range(width) if left[i])
            leaves = [[] for _ in range(width)]
            for i in range(width):
                slack = longest - ahead[i] if postpone else 0
                while left[i]:
                    leaves[i].append(rng.choice(tests))
                    left[i] -= 1
                    ahead[i] = rng.choice(d)
                    if ahead[i] > slack or not postpone:
                        ahead[i] -= min(slack, ahead[i]) if postpone else 0
                        break
                    slack = 0  # a lane stops at its second leaf; later ones stand on the stack
            total += 1.2 * longest
            total += sum(max(step) for step in itertools.zip_longest(*leaves, fillvalue=0))
    return total / warps


@pytest.mark.parametrize("postpone", [True, False])
def test_rounds_drawn_one_lane_at_a_time(drawn, postpone):
    slow = plain(drawn, 4, postpone, 1500, np.random.default_rng(2))
    assert rounds_cost(drawn, 4, fetch=False, postpone=postpone) == pytest.approx(slow, rel=0.02)


def test_rays_dealt_alike_wait_less(drawn):
    order = np.argsort(drawn.per_ray, kind="stable").astype(np.int32)
    alike = rounds_cost(drawn, 32, fetch=False, dealt=order)
    assert alike < 0.9 * rounds_cost(drawn, 32, fetch=False)


# ------------------------------------------------------------ the experiment


def test_the_benchmark_prints_its_tables(tmp_path):
    script = Path(__file__).parent.parent / "benchmarks" / "simd.py"
    command = [
        sys.executable,
        str(script),
        "--keep",
        str(tmp_path / "simd.json"),
        "--width",
        "48",
        "--figure",
        str(tmp_path / "simd.svg"),
    ]
    told = subprocess.run(
        [*command, "cornell@300", "powerplant@300"], capture_output=True, text=True, check=True
    ).stdout
    assert "2 scenes, 18 trees" in told
    for heading in ("Deviation of SIMD", "Builders", "What explains", "r with the cost", "Width"):
        assert heading in told
    assert "nan" not in told
    assert (tmp_path / "simd.svg").stat().st_size > 10_000
    again = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert again == told[told.index("2 scenes") :]
