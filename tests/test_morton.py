"""`lbvh` against a radix tree built by asking for every bit, and the radix sort."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mibvh.builders import get
from mibvh.builders.draft import Draft, References
from mibvh.builders.morton import radix_tree
from mibvh.builders.radix import argsort_keys, float_keys, sort_keys
from mibvh.builders.registry import Context
from mibvh.morton import morton_codes
from mibvh.triangles import Triangles


def brute_codes(lower: np.ndarray, upper: np.ndarray) -> list[int]:
    """63-bit codes, bit by bit: x the highest of each three."""
    center = (lower + upper).astype(np.float64)
    low, extent = center.min(axis=0), np.ptp(center, axis=0)
    scale = np.where(extent > 0, 2097151.999 / np.where(extent > 0, extent, 1), 0)
    cells = ((center - low) * scale).astype(int)
    return [
        sum(
            ((int(x) >> b & 1) << 2 | (int(y) >> b & 1) << 1 | (int(z) >> b & 1)) << 3 * b
            for b in range(21)
        )
        for x, y, z in cells
    ]


def brute_tree(keys: list[int], begin: int, end: int) -> int | tuple:
    """Split the sorted keys where the highest bit that differs within them changes."""
    if end - begin == 1:
        return begin
    highest = (keys[begin] ^ keys[end - 1]).bit_length() - 1
    split = next(i for i in range(begin, end) if keys[i] >> highest & 1)
    return brute_tree(keys, begin, split), brute_tree(keys, split, end)


def nested(
    left: np.ndarray, right: np.ndarray, reference: np.ndarray, node: int = 0
) -> int | tuple:
    if left[node] < 0:
        return int(reference[node])
    return (
        nested(left, right, reference, left[node]),
        nested(left, right, reference, right[node]),
    )


def build(corners: np.ndarray) -> Draft:
    lbvh = get("lbvh")
    return lbvh.draft(Triangles(corners), lbvh.options(), Context())


@pytest.mark.parametrize("n", [1, 2, 3, 10, 200])
def test_codes(n):
    rng = np.random.default_rng(n)
    corners = (rng.standard_normal((n, 3, 3)) * [1, 10, 0.1]).astype(np.float32)
    refs = References.of(Triangles(corners))
    assert morton_codes(refs.lower, refs.upper).tolist() == brute_codes(refs.lower, refs.upper)


def test_codes_by_hand():
    """Corners of the unit cube: each axis has its own bit, x above y above z."""
    points = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    assert (morton_codes(points, points) >> np.uint64(60)).tolist() == list(range(8))
    assert morton_codes(points[:1], points[:1]).tolist() == [0]


@settings(max_examples=100, deadline=None, derandomize=True)
@given(codes=st.lists(st.integers(0, 2**63 - 1) | st.integers(0, 5), min_size=1, max_size=60))
def test_radix_tree_equals_brute_force(codes):
    codes = sorted(codes)
    n = len(codes)
    tree = radix_tree(np.array(codes, np.uint64), np.arange(n, dtype=np.int32))
    # Equal codes are told apart by their positions, as lower bits.
    keys = [code << 32 | i for i, code in enumerate(codes)]
    assert nested(*tree) == brute_tree(keys, 0, n)
    assert all(len(array) == 2 * n - 1 for array in tree)


@pytest.mark.parametrize("n", [1, 2, 7, 300])
def test_whole_builder_equals_brute_force(n):
    rng = np.random.default_rng(n)
    corners = np.round(rng.random((n, 1, 3)) * 4 + rng.random((n, 3, 3)), 1).astype(np.float32)
    draft = build(corners)
    codes = brute_codes(draft.references.lower, draft.references.upper)
    order = sorted(range(n), key=lambda i: (codes[i], i))
    keys = [codes[i] << 32 | k for k, i in enumerate(order)]

    def renamed(tree: int | tuple) -> int | tuple:
        return order[tree] if isinstance(tree, int) else (renamed(tree[0]), renamed(tree[1]))

    assert nested(draft.left, draft.right, draft.reference) == renamed(brute_tree(keys, 0, n))


@pytest.mark.parametrize("kind", [np.uint32, np.uint64])
@pytest.mark.parametrize(
    ("n", "values"), [(1, 9), (2, 1), (100, 3), (5000, 2**31), (5000, 40), (3000, 2**11)]
)
def test_sort_is_stable(kind, n, values):
    keys = np.random.default_rng(n).integers(0, values, n).astype(kind)
    result, order = sort_keys(keys, 32)
    assert np.array_equal(order, np.argsort(keys, kind="stable"))
    assert np.array_equal(result, np.sort(keys))
    assert np.array_equal(argsort_keys(keys, 32), order)


@pytest.mark.parametrize("spread", [1, 2, 20, 25, 200, 4000])
def test_sort_of_clusters(spread):
    """Long and short runs of keys that agree in the leading digits, and equal keys in them."""
    rng = np.random.default_rng(spread)
    lead = rng.integers(0, max(1, 4000 // spread), 4000).astype(np.uint64) << np.uint64(50)
    tail = rng.integers(0, 2**30, 4000).astype(np.uint64)
    tail[rng.random(4000) < 0.2] = 7
    keys = lead | tail
    before = keys.copy()
    result, order = sort_keys(keys, 63)
    assert np.array_equal(order, np.argsort(keys, kind="stable"))
    assert np.array_equal(result, keys[order])
    assert np.array_equal(keys, before)


def test_float_keys_order_as_floats():
    values = np.array([-np.inf, -2.5, -1e-45, -0.0, 0.0, 1e-45, 3, np.inf], np.float32)
    keys = float_keys(values)
    assert keys[3] == keys[4]
    assert (np.diff(np.delete(keys, 3).astype(np.int64)) > 0).all()
