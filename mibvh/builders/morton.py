"""`lbvh`: the linear BVH along the Morton curve.

Lauterbach, Garland, Sengupta, Luebke, Manocha: *Fast BVH Construction on GPUs* (2009);
tree and tie-break as in Karras: *Maximizing Parallelism in the Construction of BVHs,
Octrees, and k-d Trees* (HPG 2012). Box centres, 21 bits an axis, cells normalised by each
axis's own extent.
"""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.radix import argsort_keys
from mibvh.builders.registry import Context, Options, builder
from mibvh.triangles import Triangles


@njit
def morton_codes(lower, upper):
    """(R,) uint64: 63-bit Morton codes of the box centres within the box of all centres."""
    n = len(lower)
    low = np.full(3, np.inf, np.float32)
    high = np.full(3, -np.inf, np.float32)
    for i in range(n):
        for k in range(3):
            c = lower[i, k] + upper[i, k]
            low[k] = min(low[k], c)
            high[k] = max(high[k], c)
    scale = np.zeros(3, np.float64)
    for k in range(3):
        if high[k] > low[k]:
            scale[k] = 2097151.999 / (np.float64(high[k]) - np.float64(low[k]))
    codes = np.empty(n, np.uint64)
    for i in range(n):
        code = np.uint64(0)
        for k in range(3):
            c = np.float64(lower[i, k] + upper[i, k]) - np.float64(low[k])
            code |= _spread(np.uint64(c * scale[k])) << np.uint64(2 - k)
        codes[i] = code
    return codes


@njit
def _spread(x):
    """Move the 21 bits of x to every third bit."""
    x = (x | (x << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    x = (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)
    return x


@njit
def _radix_tree(codes, order):
    """The binary radix tree over sorted codes, in one pass.

    The split between neighbours i and i + 1 stands the higher, the higher the bit in which
    their codes differ (equal codes: their indices), so the tree is the Cartesian tree of
    those differences, built with a stack of the nodes on its right border.
    """
    n = len(order)
    nodes = 2 * n - 1
    left = np.full(nodes, -1, np.int32)
    right = np.full(nodes, -1, np.int32)
    reference = np.full(nodes, -1, np.int32)
    if n == 1:
        reference[0] = order[0]
        return left, right, reference
    # Inner node of split i is i + 1 (node 0 is kept for the root), leaf i is n + i.
    border = np.empty(n, np.int32)
    key_high = np.empty(n, np.uint64)
    key_low = np.empty(n, np.uint64)
    top = 0
    for i in range(n - 1):
        a, b = codes[order[i]], codes[order[i + 1]]
        high = a ^ b
        low = np.uint64(i) ^ np.uint64(i + 1)
        last = np.int32(n - 1 + i)  # the subtree that ends at leaf i
        # A subtree of the border is complete where the new split stands higher. Highest
        # differing bits are compared without finding them: x stands below y if x < y and
        # x < (x ^ y).
        while top > 0 and _below(key_high[top - 1], key_low[top - 1], high, low):
            top -= 1
            right[border[top]] = last
            last = border[top]
        node = np.int32(i)
        left[node] = last
        border[top], key_high[top], key_low[top] = node, high, low
        top += 1
    last = np.int32(2 * n - 2)
    while top > 0:
        top -= 1
        right[border[top]] = last
        last = border[top]
    for i in range(n):
        reference[n - 1 + i] = order[i]
    # Bring the root to node 0 by exchanging names with the node that is there.
    root = last
    if root != 0:
        left[0], left[root] = left[root], left[0]
        right[0], right[root] = right[root], right[0]
        for node in range(n - 1):
            if left[node] == 0:
                left[node] = root
            elif right[node] == 0:
                right[node] = root
    return left, right, reference


@njit
def _below(a_high, a_low, b_high, b_low):
    """Whether the highest set bit of a is below that of b (128-bit values)."""
    if a_high | b_high:
        return a_high < b_high and a_high < (a_high ^ b_high)
    return a_low < b_low and a_low < (a_low ^ b_low)


@builder(
    "lbvh",
    summary="linear BVH: split where the Morton codes of the box centres first differ",
    source="Lauterbach et al. 2009; Karras 2012",
)
def lbvh(triangles: Triangles, options: Options, context: Context) -> Draft:
    """Build the Morton tree; O(n) after one radix sort."""
    refs = References.of(triangles)
    codes = morton_codes(refs.lower, refs.upper)
    order = argsort_keys(codes, 63)
    return Draft(refs, *_radix_tree(codes, order))
