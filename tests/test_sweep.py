"""`bbvh` against the plain sweep, which sorts every node anew and tries every split."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mibvh
from mibvh._jit import njit
from mibvh.builders import get, registry
from mibvh.builders.draft import Draft
from mibvh.builders.options import Options
from mibvh.builders.plain import plain_sweep
from mibvh.builders.registry import Context
from mibvh.builders.simd import (
    half_area,
    half_area_exact,
    load,
    load_corners,
    nothing,
    store,
    store_corners,
    union,
)
from mibvh.triangles import Triangles


def area(lower: np.ndarray, upper: np.ndarray) -> np.float32:
    dx, dy, dz = upper.max(axis=0) - lower.min(axis=0)
    return dx * dy + (dx + dy) * dz


def nested(draft: Draft, node: int = 0) -> int | tuple:
    if draft.left[node] < 0:
        return int(draft.reference[node])
    return nested(draft, draft.left[node]), nested(draft, draft.right[node])


def build(corners: np.ndarray) -> Draft:
    bbvh = get("bbvh")
    return bbvh.draft(Triangles(corners), bbvh.options(), Context())


def check(corners: np.ndarray) -> None:
    plain = plain_sweep(Triangles(corners), Options(), Context())
    assert nested(build(corners)) == plain


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 15, 16, 17, 18, 40, 90])
def test_equals_the_plain_sweep(n):
    rng = np.random.default_rng(n)
    sizes = rng.choice([0.01, 0.1, 2.0], (n, 1, 1))
    check((rng.random((n, 1, 3)) + sizes * rng.random((n, 3, 3))).astype(np.float32))


@pytest.mark.parametrize("n", [3, 8, 16, 17, 30, 60])
def test_ties_on_a_lattice(n):
    """Equal costs everywhere: the most even split, then the lower axis, then position."""
    rng = np.random.default_rng(n)
    corners = rng.integers(0, 3, (n, 1, 3)) + np.array([[0, 0, 0], [1, 0, 1], [0, 1, 0]])
    check(corners.astype(np.float32))


@pytest.mark.parametrize("n", [2, 5, 16, 33])
def test_all_alike(n):
    """Splits of equal boxes are all of one cost: halves, in order of index."""
    corners = np.broadcast_to(np.eye(3, dtype=np.float32), (n, 3, 3)).copy()
    check(corners)
    draft = build(corners)
    leaves = draft.reference[draft.reference >= 0]
    assert leaves.tolist() == list(range(n))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    n=st.integers(1, 45),
    cells=st.sampled_from([1, 2, 4, 1000]),
    flat=st.lists(st.integers(0, 2), max_size=3),
    seed=st.integers(0, 2**31),
)
def test_any_scene_equals_the_plain_sweep(n, cells, flat, seed):
    rng = np.random.default_rng(seed)
    corners = rng.integers(-cells, cells + 1, (n, 3, 3)).astype(np.float32)
    corners[:, :, flat] = 0
    check(corners)


def test_a_scene_gets_the_tree_of_the_plain_sweep():
    """Through the finish too: a registered plain sweep gives the nine's tree, array by array."""
    scene = mibvh.load("cornell@1000")
    mibvh.builder("plain")(plain_sweep)
    try:
        plain, fast = mibvh.build(scene, "plain"), mibvh.build(scene, "bbvh")
    finally:
        del registry._registered["plain"]
    for name in ("lower", "upper", "left", "first", "count", "references"):
        assert np.array_equal(getattr(plain, name), getattr(fast, name)), name


def test_the_plain_sweep_finds_the_cheapest_split():
    """Its areas and sides against counting all ways to cut a sorted list, in float64."""
    rng = np.random.default_rng(1)
    triangles = Triangles(rng.random((12, 1, 3)) + 0.3 * rng.random((12, 3, 3)))
    low, high = triangles.lower.astype(float), triangles.upper.astype(float)

    def cost(ids):
        return len(ids) * area(low[ids], high[ids])

    costs = {}
    for axis in range(3):
        order = sorted(range(12), key=lambda i: low[i, axis] + high[i, axis])
        for at in range(1, 12):
            costs[tuple(sorted(order[:at]))] = cost(order[:at]) + cost(order[at:])
    left, _ = plain_sweep(triangles, Options(), Context())
    assert tuple(sorted(flat(left))) == min(costs, key=costs.__getitem__)


def flat(nested):
    return [nested] if isinstance(nested, int) else [i for part in nested for i in flat(part)]


def test_split_by_hand():
    """Two pairs far apart along y: the split between them is the cheapest."""
    at = np.array([[0, 0, 0], [0, 9, 0], [1, 0, 0], [1, 9, 0]], np.float32)
    corners = at[:, None] + np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0.5]], np.float32)
    assert nested(build(corners)) == ((0, 2), (1, 3))


@njit
def _joined(lower, upper, rows, out_lower, out_upper):
    """Area of the union of two boxes, which is written out on the way, doubled in size."""
    store(rows, 0, load_corners(lower, upper, 0))
    box = union(union(nothing(), load(rows, 0)), load_corners(lower, upper, 1))
    store_corners(out_lower, out_upper, 0, box, np.float32(2))
    return half_area(box), half_area_exact(box)


@pytest.mark.parametrize("seed", range(5))
def test_boxes_in_registers(seed):
    rng = np.random.default_rng(seed)
    lower = rng.standard_normal((2, 3)).astype(np.float32)
    upper = lower + rng.random((2, 3)).astype(np.float32)
    out_lower, out_upper = np.zeros((2, 1, 3), np.float32)
    result = _joined(lower, upper, np.zeros((1, 8), np.float32), out_lower, out_upper)
    assert np.array_equal(out_lower[0], 2 * lower.min(axis=0))
    assert np.array_equal(out_upper[0], 2 * upper.max(axis=0))
    assert result[0] == area(lower, upper)
    assert result[1] == pytest.approx(
        float(area(lower.astype(np.float64), upper.astype(np.float64))), rel=1e-6
    )


def test_progress_is_reported():
    seen = []
    rng = np.random.default_rng(0)
    bbvh = get("bbvh")
    bbvh.draft(
        Triangles(rng.random((50, 3, 3))),
        bbvh.options(),
        Context(lambda stage, done: seen.append(stage)),
    )
    assert seen[0] == "sort"
    assert set(seen[1:]) == {"sweep"}
