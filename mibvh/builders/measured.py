"""Measures of boxes in a register: of none but these do the builders' kernels know."""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.builders.simd import coordinate, half_area, half_area_exact
from mibvh.measures.boxes import of_corners


@njit(allocates=False)
def _other(measure, box):
    return of_corners(
        measure,
        coordinate(box, 0),
        coordinate(box, 1),
        coordinate(box, 2),
        -coordinate(box, 4),
        -coordinate(box, 5),
        -coordinate(box, 6),
    )


@njit(allocates=False)
def cost_of(measure, box):
    """Measure of a box, float32: half its area where ``measure`` is None; inf for no box."""
    if measure is None:
        return half_area(box)
    if coordinate(box, 0) > -coordinate(box, 4):
        return np.float32(np.inf)
    return np.float32(_other(measure, box))


@njit(allocates=False)
def exact_cost_of(measure, box):
    """Measure of a box, float64."""
    if measure is None:
        return half_area_exact(box)
    return _other(measure, box)
