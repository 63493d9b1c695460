"""`bbvh` against a sweep that tries everything in O(n^2)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mibvh._jit import njit
from mibvh.builders import get
from mibvh.builders.draft import Draft, References
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


def brute_force(refs: References, ids: list[int]) -> int | tuple:
    """Nested pairs of reference ids: all splits of all axes, tried one by one."""
    if len(ids) == 1:
        return ids[0]
    centers = refs.lower + refs.upper
    n = len(ids)
    candidates = []
    for axis in range(3):
        order = sorted(ids, key=lambda i: (float(centers[i, axis]), i))
        for at in range(1, n):
            a, b = order[:at], order[at:]
            cost = np.float32(0)
            cost += area(refs.lower[a], refs.upper[a]) * np.float32(at)
            cost += area(refs.lower[b], refs.upper[b]) * np.float32(n - at)
            candidates.append((float(cost), abs(2 * at - n), axis, at, a, b))
    *_, a, b = min(candidates, key=lambda c: c[:4])
    return brute_force(refs, a), brute_force(refs, b)


def nested(draft: Draft, node: int = 0) -> int | tuple:
    if draft.left[node] < 0:
        return int(draft.reference[node])
    return nested(draft, draft.left[node]), nested(draft, draft.right[node])


def build(corners: np.ndarray) -> Draft:
    bbvh = get("bbvh")
    return bbvh.draft(Triangles(corners), bbvh.options(), Context())


def check(corners: np.ndarray) -> None:
    draft = build(corners)
    assert nested(draft) == brute_force(draft.references, list(range(len(corners))))


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 15, 16, 17, 18, 40, 90])
def test_equals_brute_force(n):
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
def test_any_scene_equals_brute_force(n, cells, flat, seed):
    rng = np.random.default_rng(seed)
    corners = rng.integers(-cells, cells + 1, (n, 3, 3)).astype(np.float32)
    corners[:, :, flat] = 0
    check(corners)


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
