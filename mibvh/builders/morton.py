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
from mibvh.builders.options import Options
from mibvh.builders.radix import sort_keys
from mibvh.builders.registry import Context, builder
from mibvh.morton import morton_codes
from mibvh.triangles import Triangles


@njit
def radix_tree(codes, order):
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
    for i in range(n):  # item by item: quicker to compile
        reference[n - 1 + i] = order[i]
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


@njit(allocates=False)
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
    return Draft(references, *radix_tree(*sort_keys(codes, 63)))


@builder(
    "lbvh",
    summary="linear BVH: split where the Morton codes of the box centres first differ",
    source="Lauterbach et al. 2009; Karras 2012",
    memory=140,
)
def lbvh(triangles: Triangles, options: Options, context: Context) -> Draft:
    """Build the Morton tree; O(n) after one radix sort."""
    return radix_draft(References.of(triangles))
