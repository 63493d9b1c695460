"""A sweep to read: the tree of `bbvh` in plain Python, without its speed.

MacDonald and Booth: *Heuristics for ray tracing using space subdivision* (The Visual Computer
1990). The function below has the shape of any builder of a user's own: triangles in, nested
pairs of triangle ids out. It is not registered; ``mibvh.builder("plain")(plain_sweep)`` does that.

`bbvh` (:mod:`mibvh.builders.sweep`) decides the same splits, bit for bit, and the tests hold it
against this function. It is faster by thousands of times because it sorts once instead of in
every node, leaves out splits that cannot win, works in vector registers and on all threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.builders.draft import References
from mibvh.builders.options import Options
from mibvh.builders.registry import Context
from mibvh.triangles import F32, Triangles


def plain_sweep(triangles: Triangles, options: Options, context: Context) -> Any:
    """Build a tree top-down, trying every split of every node on all three axes.

    Parameters
    ----------
    triangles : Triangles
    options : Options
        Not used: the splits depend on no cost constant, as every split has the same cost of
        an inner node.
    context : Context
        Not used.

    Returns
    -------
    int or tuple
        Nested pairs of triangle ids, for :meth:`mibvh.Draft.from_nested`.

    Examples
    --------
    Two pairs of triangles, far apart along y:

    >>> import numpy as np
    >>> import mibvh
    >>> corners = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0.5]])
    >>> places = np.array([[0, 0, 0], [0, 9, 0], [1, 0, 0], [1, 9, 0]])
    >>> plain_sweep(mibvh.Triangles(places[:, None] + corners), mibvh.Options(), mibvh.Context())
    ((0, 2), (1, 3))
    """
    boxes = References.of(triangles)
    return _split(boxes, np.arange(len(boxes)))


def _split(boxes: References, ids: Any) -> Any:
    """Split one node; ``ids`` are its triangles, in ascending order."""
    # A node of one triangle is a leaf. Larger leaves are made later, for all builders alike.
    n = len(ids)
    if n == 1:
        return int(ids[0])

    candidates = []
    for axis in range(3):
        # Sort by box centre. The sort is stable, so equal centres stay in order of id.
        centers = boxes.lower[ids, axis] + boxes.upper[ids, axis]  # doubled: the order is the same
        order = ids[np.argsort(centers, kind="stable")]

        # Sweep from both ends. left[i] is the area of the box of the first i + 1 triangles,
        # right[i] that of the last n - i.
        left = _areas_of_prefixes(boxes, order)
        right = _areas_of_prefixes(boxes, order[::-1])[::-1]

        # The SAH of a split, as far as splits differ: area times triangles, of both sides.
        for at in range(1, n):
            cost = left[at - 1] * np.float32(at) + right[at] * np.float32(n - at)
            # Of equal costs take the most even split, then the lower axis, then the lower place.
            candidates.append((float(cost), abs(2 * at - n), axis, at, order))

    _, _, _, at, order = min(candidates, key=lambda candidate: candidate[:4])

    # Go on with both sides.
    return _split(boxes, np.sort(order[:at])), _split(boxes, np.sort(order[at:]))


def _areas_of_prefixes(boxes: References, order: Any) -> F32:
    """Half the surface area of the box around the first 1, 2, ... of some triangles."""
    lower = np.minimum.accumulate(boxes.lower[order])
    upper = np.maximum.accumulate(boxes.upper[order])
    x, y, z = (upper - lower).T
    return x * y + (x + y) * z
