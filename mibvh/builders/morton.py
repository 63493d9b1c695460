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
from mibvh.builders.radix import sort_keys
from mibvh.builders.registry import Context, Options, builder
from mibvh.triangles import Triangles


@njit
def morton_codes(lower, upper):
    """(R,) uint64: 63-bit Morton codes of the box centres within the box of all centres."""
    n = np.uint64(len(lower))
    low = np.empty(3, np.float32)
    scale = np.zeros(3, np.float64)
    for k in range(np.uint64(3)):
        least, most = np.float32(np.inf), np.float32(-np.inf)
        for i in range(n):
            c = lower[i, k] + upper[i, k]
            least = c if c < least else least
            most = c if c > most else most
        low[k] = least
        if most > least:
            scale[k] = 2097151.999 / (np.float64(most) - np.float64(least))
    x0, y0, z0 = np.float64(low[0]), np.float64(low[1]), np.float64(low[2])
    sx, sy, sz = scale[0], scale[1], scale[2]
    codes = np.empty(n, np.uint64)
    for i in range(n):
        x = np.uint64(np.int64((np.float64(lower[i, 0] + upper[i, 0]) - x0) * sx))
        y = np.uint64(np.int64((np.float64(lower[i, 1] + upper[i, 1]) - y0) * sy))
        z = np.uint64(np.int64((np.float64(lower[i, 2] + upper[i, 2]) - z0) * sz))
        codes[i] = _spread(x) << np.uint64(2) | _spread(y) << np.uint64(1) | _spread(z)
    return codes


@njit
def _spread(x):
    """Move the 21 bits of x to every third bit."""
    x = (x | (x << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)


@njit
def _radix_tree(codes, order):
    """Make the binary radix tree over sorted codes, in one pass.

    The split between neighbours i and i + 1 stands the higher, the higher the bit in which
    their codes differ (equal codes: their indices), so the tree is the Cartesian tree of
    those differences, built with a stack of the nodes on its right border.

    Parameters
    ----------
    codes : (N,) uint64
        Sorted.
    order : (N,) int32
        The reference of each code.
    """
    n = len(order)
    nodes = 2 * n - 1
    left = np.empty(nodes, np.int32)
    right = np.empty(nodes, np.int32)
    reference = np.empty(nodes, np.int32)
    # The inner node of split i is node i, leaf i is node n - 1 + i.
    left[n - 1 :] = -1
    right[n - 1 :] = -1
    reference[: n - 1] = -1
    reference[n - 1 :] = order
    border = np.empty(n, np.uint64)
    key_high = np.empty(n, np.uint64)
    key_low = np.empty(n, np.uint64)
    one, top = np.uint64(1), np.uint64(0)
    for i in range(np.uint64(n - 1)):
        high = codes[i] ^ codes[i + one]
        low = i ^ (i + one)
        last = np.int32(i + np.uint64(n - 1))  # the subtree that ends at leaf i
        # A subtree of the border is complete where the new split stands higher.
        while top > np.uint64(0) and _below(key_high[top - one], key_low[top - one], high, low):
            top -= one
            right[border[top]] = last
            last = np.int32(border[top])
        left[i] = last
        border[top], key_high[top], key_low[top] = i, high, low
        top += one
    last = np.int32(nodes - 1)
    while top > np.uint64(0):
        top -= one
        right[border[top]] = last
        last = np.int32(border[top])
    # Bring the root to node 0 by exchanging names with split 0, which is the last inner node
    # on the way from the root to the left.
    root = last
    if root != 0:
        node = root
        while left[node] != 0:
            node = left[node]
        left[node] = root
        left[0], left[root] = left[root], left[0]
        right[0], right[root] = right[root], right[0]
    return left, right, reference


@njit
def _below(a_high, a_low, b_high, b_low):
    """Whether the highest set bit of a is below that of b (128-bit values).

    Found without finding the bits: so it is if a < b and a < (a ^ b).
    """
    if a_high | b_high:
        return a_high < b_high and a_high < (a_high ^ b_high)
    return a_low < b_low and a_low < (a_low ^ b_low)


def radix_draft(references: References) -> Draft:
    """Build the Morton tree over given references, split ones included."""
    codes = morton_codes(references.lower, references.upper)
    return Draft(references, *_radix_tree(*sort_keys(codes, 63)))


@builder(
    "lbvh",
    summary="linear BVH: split where the Morton codes of the box centres first differ",
    source="Lauterbach et al. 2009; Karras 2012",
)
def lbvh(triangles: Triangles, options: Options, context: Context) -> Draft:
    """Build the Morton tree; O(n) after one radix sort."""
    return radix_draft(References.of(triangles))
