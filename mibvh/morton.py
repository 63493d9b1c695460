"""Morton codes: positions in space as integers; close positions tend to have close codes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit

U64 = npt.NDArray[np.uint64]


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
def interleave(cells):
    """(N,) uint64: interleave the low 21 bits of the three columns of (N, 3) uint64."""
    codes = np.empty(len(cells), np.uint64)
    for i in range(len(cells)):
        x, y, z = _spread(cells[i, 0]), _spread(cells[i, 1]), _spread(cells[i, 2])
        codes[i] = x << np.uint64(2) | y << np.uint64(1) | z
    return codes


@njit(allocates=False)
def _spread(x):
    """Move the 21 bits of x to every third bit."""
    x = (x | (x << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)


def ray_codes(o: Any, d: Any, bounds: Any) -> U64:
    """Morton codes of rays: first by origin (10 bits an axis), then by direction (5).

    Parameters
    ----------
    o, d : (R, 3) float32
        Origins, and directions of unit length.
    bounds : (2, 3) float32
        The box in which origins are quantised, lower corner first.

    Returns
    -------
    (R,) uint64
        45 bits each.
    """
    lower, upper = np.asarray(bounds, np.float64)
    cell = (o - lower) / np.maximum(upper - lower, 1e-30)
    origin = interleave(np.clip(cell * 1024, 0, 1023).astype(np.uint64))
    direction = interleave(np.clip((d + 1.0) * 16, 0, 31).astype(np.uint64))
    return (origin << np.uint64(15)) | direction
