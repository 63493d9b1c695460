"""The surface area heuristic for the lines that rays really lie on.

The heuristic assumes that a share ``A_n / A_root`` of the lines through the scene pierces box
``n``. That is true of lines that are uniformly distributed. Here the share is counted among the
lines of a ray set. Each line is weighted by the part of it that its ray covers, so that it counts
once however many rays lie on it. Derived in ``docs/alpha.md``.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.metrics.points import Estimate
from mibvh.metrics.sah import node_costs
from mibvh.parallel import run_blocks
from mibvh.tree import Tree
from mibvh.triangles import F64, as_triangles
from mibvh.wide_tree import WideTree, as_binary

_BLOCK = 1024
#: How far beyond its hit a ray is followed, as a share of the distance: that is rounded to float32,
#: so that half of the rays would end before the flat box of the wall that they hit.
BEYOND = 2.0**-20


@dataclasses.dataclass(frozen=True, eq=False)
class RayLines:
    """Rays that end where they hit, and the lines that they lie on.

    Attributes
    ----------
    o, d : (L, 3) float64
        Origin of each ray in scene units, and its direction.
    length : (L,) float64
        Where the ray ends, in lengths of ``d``; infinite for one that misses.
    share : (L,) float64
        Length of the ray inside the scene's box over that of the whole line inside it; 0 for
        a ray outside the box.
    """

    o: F64
    d: F64
    length: F64
    share: F64

    def __len__(self) -> int:
        return len(self.share)

    def sah(self, tree: Tree) -> Estimate:
        """SAH of a tree with these lines; see :func:`sah_of_lines`."""
        return sah_of_lines(tree, self)


def ray_lines(triangles: Any, rays: Any, hits: Any, count: int | None = None) -> RayLines:
    """Lines of a ray set.

    Parameters
    ----------
    triangles : Triangles or (N, 3, 3) array
    rays : RaySet
    hits : Hits
        Of these rays, from any tree.
    count : int, optional
        Take every k-th ray, with the smallest k that leaves at most this many; all by default.

    Returns
    -------
    RayLines

    Raises
    ------
    MibvhError
        If ``count`` is less than 1, or the hits are not those of the rays.
    """
    if count is not None and count < 1:
        raise MibvhError(f"count must be at least 1, not {count}")
    if len(hits.t) != len(rays):
        raise MibvhError(f"there are {len(rays)} rays, and hits of {len(hits.t)}")
    step = 1 if count is None else max(1, -(-len(rays) // count))
    o, d = rays.o[::step].astype(np.float64), rays.d[::step].astype(np.float64)
    length = np.minimum(hits.t[::step], rays.tmax[::step]).astype(np.float64)
    near, far = inside_box(as_triangles(triangles).bounds.astype(np.float64), o, d)
    inside = np.minimum(far, length) - np.maximum(near, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where((far > near) & (inside > 0), inside / (far - near), 0.0)
    return RayLines(o, d, length, share)


def inside_box(bounds: F64, o: F64, d: F64) -> tuple[F64, F64]:
    """Where lines enter and leave a box; for a line that misses, the exit lies before the entry."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (bounds[0] - o) / d, (bounds[1] - o) / d
    across = d != 0
    held = (bounds[0] <= o) & (o <= bounds[1])
    near = np.where(across, np.minimum(a, b), np.where(held, -np.inf, np.inf))
    far = np.where(across, np.maximum(a, b), np.where(held, np.inf, -np.inf))
    return near.max(axis=1), far.min(axis=1)


@njit
def _pierced(begin, end, o, d, start, stop, lower, upper, left, cost, depth, out):
    """Sum of the costs of the closed boxes that ``o + t d``, ``start <= t <= stop``, touches."""
    stack = np.empty(depth + 2, np.int32)
    for i in range(begin, end):
        total = 0.0
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            near, far = start, stop[i]
            for k in range(3):
                a, b = lower[node, k] - o[i, k], upper[node, k] - o[i, k]
                if d[i, k] != 0.0:
                    a, b = a / d[i, k], b / d[i, k]
                    near, far = max(near, min(a, b)), min(far, max(a, b))
                elif a > 0.0 or b < 0.0:
                    far = -np.inf
            if near > far:
                continue
            total += cost[node]
            if left[node] >= 0:
                stack[top] = left[node]
                stack[top + 1] = left[node] + 1
                top += 2
        out[i] = total


def line_costs(tree: Tree | WideTree, lines: RayLines, *, whole: bool = True) -> F64:
    """Cost of all nodes whose closed boxes a line pierces or a ray touches.

    Parameters
    ----------
    tree : Tree or WideTree
    lines : RayLines
    whole : bool
        Whether to take the whole line, or only the ray from its origin to its end. The latter
        is the least that a traversal can cost that knows beforehand where the ray ends.

    Returns
    -------
    (L,) float64
        In units of the cost constants that the tree was built with.
    """
    tree = as_binary(tree)
    costs = node_costs(tree)
    out = np.zeros(len(lines))
    start = -np.inf if whole else 0.0
    stop = np.full(len(lines), np.inf) if whole else lines.length * (1 + BEYOND)

    def work(_worker: int, begin: int, end: int) -> None:
        _pierced(
            begin,
            end,
            lines.o,
            lines.d,
            start,
            stop,
            tree.lower,
            tree.upper,
            tree.left,
            costs,
            tree.depth,
            out,
        )

    run_blocks(work, len(lines), _BLOCK)
    return out


def sah_of_lines(tree: Tree | WideTree, lines: RayLines) -> Estimate:
    """SAH with the rays' own lines instead of uniformly distributed ones.

    Parameters
    ----------
    tree : Tree or WideTree
    lines : RayLines
        From :func:`ray_lines`.

    Returns
    -------
    Estimate
        Mean cost of a line, weighted by the share of it that its ray covers.

    Raises
    ------
    MibvhError
        If fewer than two rays have a part inside the scene's box.
    """
    inside = int(np.count_nonzero(lines.share))
    if inside < 2:
        raise MibvhError(f"{inside} rays pass through the scene's box, too few to average over")
    costs, share = line_costs(tree, lines), lines.share
    value = float(share @ costs / share.sum())
    spread = share * (costs - value)  # of a ratio of two means
    error = float(np.sqrt(spread @ spread * inside / (inside - 1)) / share.sum())
    return Estimate(value, error, inside)
