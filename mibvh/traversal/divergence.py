"""What warps in lockstep cost, predicted from what single rays cost.

A warp takes as long as its lanes make it take together. How far that is from what its rays need
depends on how much they differ: these functions measure that, and estimate what a warp issues, from
counts per ray of scalar lanes. Nothing is fitted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.triangles import F64, I32

Counts = npt.NDArray[Any]


def packets(values: Counts, width: int, dealt: I32 | None = None) -> F64:
    """Values of rays, a row of ``width`` for each packet of rays dealt side by side.

    Parameters
    ----------
    values : (R,) array
    width : int
    dealt : (R,) int32, optional
        Rays in the order in which they are dealt; as they stand by default. Rays that fill no
        packet are left out, unless there is not one full packet.

    Returns
    -------
    (R // width, width) float64
    """
    if width < 1:
        raise MibvhError(f"the width must be at least 1, not {width}")
    ordered = np.asarray(values if dealt is None else values[dealt], np.float64)
    full = len(ordered) // width
    return ordered[: full * width].reshape(full, width) if full else ordered[None]


def lcv(leaves: Counts) -> float:
    """Leaf count variability: standard deviation over the rays of the leaves visited.

    Aila, Karras and Laine, *On Quality Metrics of Bounding Volume Hierarchies* (HPG 2013).
    """
    return float(np.std(leaves, dtype=np.float64))


def relative_deviation(values: Counts) -> float:
    """Standard deviation over the rays, as a share of their mean; 0 where all are zero."""
    mean = float(np.mean(values, dtype=np.float64))
    return float(np.std(values, dtype=np.float64)) / mean if mean else 0.0


def within_packets(values: Counts, width: int, dealt: I32 | None = None) -> float:
    """Root mean square over packets of the standard deviation in a packet, over the mean.

    What :func:`relative_deviation` is without the share that lies between packets, which costs
    a warp nothing.
    """
    rows = packets(values, width, dealt)
    return float(np.sqrt(rows.var(axis=1).mean()) / rows.mean()) if rows.any() else 0.0


def expected_maximum(values: Counts, width: int) -> float:
    """Mean of the largest of ``width`` rays drawn at random, over the mean of a ray.

    Of the sorted values, the i-th of R is the largest of ``width`` draws (with replacement) with
    probability ``(i / R)**width - ((i - 1) / R)**width``.
    """
    ordered = np.sort(np.asarray(values, np.float64))
    if not ordered.any():
        return 1.0
    below = (np.arange(len(ordered) + 1) / len(ordered)) ** width
    return float((ordered * np.diff(below)).sum() / ordered.mean())


def packet_maximum(values: Counts, width: int, dealt: I32 | None = None) -> float:
    """Mean over packets of the largest of their rays, over the mean of a ray."""
    rows = packets(values, width, dealt)
    return float(rows.max(axis=1).mean() / rows.mean()) if rows.any() else 1.0
