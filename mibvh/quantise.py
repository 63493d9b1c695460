"""Boxes on grids of 8 bits, as compressed wide trees have them (Ylitie, Karras and Laine 2017).

The boxes of a node's children lie on a grid of the node's own: on each axis planes at whole
multiples of a step, a power of two, of which 255 reach from the grid's origin to the last plane.
As steps are powers of two and no finer than float32 is there, the widened boxes are float32 boxes
like any others; and as a child's step is never larger than its parent's, they are nested.
"""

from __future__ import annotations

import math

import numpy as np

from mibvh._jit import njit
from mibvh.wide_tree import WideTree

#: Steps between the first plane of a grid and the last.
_STEPS = 255
#: No step is finer than this, for a tree whose largest coordinate is near 1.
_FINEST = -66
#: A grid's origin is a float32 whose lowest bits are zero: so many are free for other use.
FREE_BITS = 6


def quantised(tree: WideTree) -> WideTree:
    """Widen a tree's boxes to the planes of 8-bit grids.

    Parameters
    ----------
    tree : WideTree

    Returns
    -------
    WideTree
        The same tree with boxes that hold the former ones; the root's is what its children need.
        A tree whose boxes lie on their grids already comes out as it is.

    Raises
    ------
    MibvhError
        If the tree is invalid.
    """
    tree.check()
    lower, upper = _quantise(tree.lower, tree.upper, tree.child, tree.children)
    return tree.replace(lower=lower, upper=upper, quantised=True)


@njit
def finest_step(lower, upper):
    """Exponent of the finest step that the grids of a tree with this root box may have."""
    largest = 0.0
    for k in range(3):
        largest = max(largest, abs(np.float64(lower[k])), abs(np.float64(upper[k])))
    if largest == 0.0:
        return _FINEST
    # Rounded up to a power of two, which widening the boxes does not change.
    part, exponent = math.frexp(largest)
    return _FINEST + (exponent - 1 if part == 0.5 else exponent)


@njit
def grid(low, high, finest):
    """Origin of an axis's grid, and the exponent of its step, for planes from low to high."""
    low, high = np.float64(low), np.float64(high)
    largest = max(abs(low), abs(high))
    # No finer than float32 there; powers of two that no float32 has are left to the finest step.
    exponent = max(finest, math.frexp(largest)[1] - 24) if largest > 0.0 else finest
    if high > low:
        exponent = max(exponent, math.frexp(high - low)[1] - 9)
    coarse = math.frexp(low)[1] - 24 + FREE_BITS if low != 0.0 else finest
    while True:
        origin = _floor(low, max(exponent, coarse))
        if _ceil(high, exponent) - origin <= math.ldexp(_STEPS, exponent):
            return origin, exponent
        exponent += 1


@njit
def _floor(x, exponent):
    """Greatest multiple of ``2**exponent`` that is not above x."""
    return math.ldexp(np.floor(math.ldexp(x, -exponent)), exponent)


@njit
def _ceil(x, exponent):
    return math.ldexp(np.ceil(math.ldexp(x, -exponent)), exponent)


@njit
def _quantise(lower, upper, child, children):
    lo, hi = lower.copy(), upper.copy()
    finest = finest_step(lower[0], upper[0])
    for n in range(len(child)):
        begin, end = child[n], child[n] + children[n]
        for k in range(3 if children[n] > 0 else 0):
            _, exponent = grid(lower[begin:end, k].min(), upper[begin:end, k].max(), finest)
            for c in range(begin, end):
                lo[c, k] = _floor(np.float64(lower[c, k]), exponent)
                hi[c, k] = _ceil(np.float64(upper[c, k]), exponent)
    for c in range(child[0], child[0] + children[0]):
        for k in range(3):
            lo[0, k], hi[0, k] = min(lo[0, k], lo[c, k]), max(hi[0, k], hi[c, k])
    return lo, hi
