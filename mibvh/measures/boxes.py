"""The one compiled function that tells what a box costs.

Kernels take a measure as an argument that is None for the area, a tuple of tables for the flux,
and a compiled function for one of the user's own. Numba
compiles a kernel for each type of argument and drops the branches that a type rules out, so the
area costs what it cost when there was nothing else, and a kernel is compiled for another measure
only when somebody asks for one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from mibvh._jit import njit
from mibvh.measures.lookup import FluxTables, touched_share


def _other(measure: Any, x0: Any, y0: Any, z0: Any, x1: Any, y1: Any, z1: Any) -> Any:
    """Measure of a box by anything but the area; compiled code only."""


@overload(_other)
def _compile_other(measure, x0, y0, z0, x1, y1, z1):
    if isinstance(measure, types.NamedTuple) and measure.instance_class is FluxTables:
        return _of_flux
    if isinstance(measure, types.Dispatcher):
        return _of_function
    return None


def _of_flux(measure, x0, y0, z0, x1, y1, z1):
    return touched_share(measure, x0, y0, z0, x1, y1, z1)


def _of_function(measure, x0, y0, z0, x1, y1, z1):
    return measure(x0, y0, z0, x1, y1, z1)


@njit(allocates=False)
def of_corners(measure, x0, y0, z0, x1, y1, z1):
    """Measure of a box, float64, rounded to float32 where it is not the area.

    Rounded, it can be kept beside a box in half the space, and what is kept is what would be
    computed again, so that sums of differences do not drift.

    Parameters
    ----------
    measure : None, FluxTables or compiled function
        None: half the surface area.
    x0, y0, z0, x1, y1, z1 : float32
        Lower and upper corner in builder units.
    """
    if measure is None:
        x = np.float64(x1) - np.float64(x0)
        y = np.float64(y1) - np.float64(y0)
        z = np.float64(z1) - np.float64(z0)
        return x * y + (x + y) * z
    return np.float64(np.float32(_other(measure, x0, y0, z0, x1, y1, z1)))


@njit
def of_boxes(measure, boxes):
    """(M,) float64: measures of boxes given as rows: lower corner, then upper."""
    out = np.empty(len(boxes), np.float64)
    for i in range(len(boxes)):
        out[i] = of_corners(
            measure,
            boxes[i, 0],
            boxes[i, 1],
            boxes[i, 2],
            boxes[i, 3],
            boxes[i, 4],
            boxes[i, 5],
        )
    return out
