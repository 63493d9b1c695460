"""End-point overlap (Aila, Karras and Laine 2013).

``EPO = sum_n C_n area((S - Q(n)) in box(n)) / area(S)``: the surfaces ``S`` without those
that belong to triangles referenced below the node, as far as they lie in the node's closed
box. A triangle with any reference below a node counts as the node's own (triangle-level
exclusion), so that a spatial partition has an EPO of zero.

The walk (:mod:`mibvh.metrics.overlap_walk`) goes triangle by triangle through the subtrees beside
the triangle's own paths. The part of the triangle inside a node is clipped from the part inside
that node's parent: most clips cut a small polygon by one or two planes, and a polygon inside a
box is not clipped. Areas are summed as 64-bit integers in units of 2**-60 of the total, so the
result is bit-identical for any number of threads.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.memory import BYTES, require_memory
from mibvh.metrics.overlap_walk import Nodes, add_up, walk, workspace
from mibvh.metrics.points import epo_at_ends, estimate_epo, triangle_positions
from mibvh.metrics.sah import node_costs
from mibvh.parallel import run_blocks, thread_count
from mibvh.tree import Tree
from mibvh.triangles import F64, as_triangles
from mibvh.wide_tree import WideTree

#: Areas are accumulated as integers in these units of the total area.
_UNIT = 2.0**-60
_BLOCK = 8192


@dataclasses.dataclass(frozen=True, eq=False)
class OverlapResult:
    """Where the surfaces overlap foreign nodes.

    Attributes
    ----------
    fraction : (M,) float64
        Share of all surface (or of all ray ends, if weighted) that is foreign to each node
        and lies in its box.
    pairs : int
        Overlapping (triangle, foreign node) pairs of positive area; time is proportional to them.
    visits : int
        Boxes tested.
    clips : int
        Polygons cut.
    """

    fraction: F64
    pairs: int
    visits: int
    clips: int


def overlap(
    tree: Tree | WideTree,
    triangles: Any,
    *,
    weights: npt.ArrayLike | None = None,
    fragments: bool = False,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> OverlapResult:
    """Measure for every node which share of the surfaces is foreign and in its box.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
    weights : (N,) array, optional
        Density of ray ends on each triangle, up to a factor; by default the same on all, as
        in the paper.
    fragments : bool
        For trees with split triangles, the other reading of "not in the subtree". A reference
        owns only the part of its triangle that lies in its leaf's box; other parts of the same
        triangle count as foreign.
    threads : int, optional
        The result is the same to the last bit for any number.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    OverlapResult

    Raises
    ------
    MibvhError
        If the tree was built for another geometry, or a weight is missing or negative.
    """
    if isinstance(tree, WideTree):
        found = overlap(
            tree.binary,
            triangles,
            weights=weights,
            fragments=fragments,
            threads=threads,
            progress=progress,
        )
        return dataclasses.replace(found, fraction=found.fraction[tree.binary.place])
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    density = np.ones(len(triangles)) if weights is None else np.asarray(weights, np.float64)
    if density.shape != (len(triangles),) or not (density >= 0).all():
        raise MibvhError(f"weights must be {len(triangles)} non-negative numbers")
    total = float((density * triangles.areas).sum())
    if not total > 0:
        return OverlapResult(np.zeros(len(tree)), 0, 0, 0)
    if fragments:
        starts = np.arange(len(tree.references) + 1)
        positions = starts[:-1].astype(np.int32)
        walked = np.ones(len(tree.references), np.bool_)
    else:
        starts, positions = triangle_positions(tree, len(triangles))
        walked = np.zeros(len(tree.references), np.bool_)
        walked[positions[starts[:-1][starts[:-1] < starts[1:]]]] = True
    box = np.concatenate([tree.lower, tree.upper], axis=1).ravel()
    nodes = Nodes(box, tree.left, tree.first, tree.count)
    workers = threads or thread_count()
    needed = (BYTES["epo"] + 16.0 * workers) * len(tree.references)  # nodes have a sum per worker
    require_memory(needed, f"{len(tree.references):,} references, for their EPO,")
    sums = np.zeros((workers, len(tree)), np.int64)
    counts = np.zeros((workers, 3), np.int64)
    work_on = [workspace(tree.depth) for _ in range(workers)]
    unit = 1.0 / (total * _UNIT)
    below = np.zeros((0, 2), np.int64)  # fragments are measured one by one
    if not fragments:
        below = add_up(
            nodes,
            tree.parents,
            walked,
            starts,
            positions,
            tree.references,
            triangles.areas,
            density,
            unit,
        )

    def work(worker: int, begin: int, end: int) -> None:
        counts[worker] += walk(
            begin,
            end,
            walked,
            fragments,
            triangles.corners,
            density,
            starts,
            positions,
            tree.references,
            nodes,
            unit,
            below,
            work_on[worker],
            sums[worker],
        )

    run_blocks(work, len(tree.references), _BLOCK, workers, progress)
    pairs, visits, clips = (int(c) for c in counts.sum(axis=0))
    return OverlapResult(sums.sum(axis=0) * _UNIT, pairs, visits, clips)


def epo_per_node(tree: Tree | WideTree, triangles: Any, **options: Any) -> F64:
    """Each node's share of the EPO; they sum to it.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
        What the tree was built for.
    **options
        ``weights``, ``fragments``, ``threads``, ``progress``, as for :func:`mibvh.epo`.

    Returns
    -------
    (M,) float64
        In units of the cost constants that the tree was built with.

    Raises
    ------
    MibvhError
        As for :func:`mibvh.epo`.
    """
    return node_costs(tree) * overlap(tree, triangles, **options).fraction


def epo_per_depth(tree: Tree | WideTree, triangles: Any, **options: Any) -> F64:
    """EPO of the nodes of each depth; they sum to that of the tree.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
        What the tree was built for.
    **options
        ``weights``, ``fragments``, ``threads``, ``progress``, as for :func:`mibvh.epo`.

    Returns
    -------
    (depth + 1,) float64
        Root first, in units of the cost constants that the tree was built with.

    Raises
    ------
    MibvhError
        As for :func:`mibvh.epo`.
    """
    shares = epo_per_node(tree, triangles, **options)
    return np.bincount(tree.depths, shares, tree.depth + 1).astype(np.float64)


def epo(
    tree: Tree | WideTree,
    triangles: Any,
    *,
    weights: npt.ArrayLike | None = None,
    fragments: bool = False,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
    **deprecated: Any,
) -> float:
    """Expected extra cost of a point query at a ray's end, due to overlap.

    End-point overlap, the metric of Aila, Karras and Laine (*On Quality Metrics of Bounding
    Volume Hierarchies*, HPG 2013): ``1 / A`` times the sum over the nodes of a node's
    cost times the area, inside its box, of the surfaces of triangles that it does not hold.

    Ray ends are taken as uniformly distributed over all surfaces. :func:`mibvh.epo_at_ends` uses
    the points where given rays end. :func:`mibvh.estimate_epo` estimates EPO from random points,
    for scenes where the exact value takes too long.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
        What the tree was built for.
    weights : (N,) array, optional
        Density of ray ends on each triangle, up to a factor; by default the same on all, as
        in the paper.
    fragments : bool
        Whether a reference owns only the part of its triangle in its leaf's box; see
        :func:`mibvh.metrics.epo.overlap`.
    threads : int, optional
        The result is the same to the last bit for any number.
    progress : callable, optional
        Called with the share done.
    **deprecated
        ``samples`` and ``seed``, or ``ray_ends``: arguments of the functions named above.

    Returns
    -------
    float
        In units of the cost constants that the tree was built with; 0 where no surface lies
        in a foreign node.

    Raises
    ------
    MibvhError
        If the tree was built for another geometry, or a weight is missing or negative.
    """
    exact = {
        "weights": weights,
        "fragments": fragments,
        "threads": threads,
        "progress": progress,
    }
    if deprecated:
        return _estimated(tree, triangles, exact, deprecated)
    return float(epo_per_node(tree, triangles, **exact).sum())


def _estimated(
    tree: Tree | WideTree, triangles: Any, exact: dict[str, Any], asked: dict[str, Any]
) -> Any:
    """Return what ``epo(samples=...)`` and ``epo(ray_ends=...)`` were before 0.2, an Estimate."""
    for name in asked:
        if name not in ("samples", "seed", "ray_ends"):
            raise TypeError(f"epo() got an unexpected keyword argument {name!r}")
    idle = {name for name, value in exact.items() if value is None or value is False}
    given = sorted((set(exact) - idle) | set(asked))
    if given not in (["samples"], ["samples", "seed"], ["ray_ends"]):
        raise MibvhError(f"epo() does not take this combination of arguments: {', '.join(given)}")
    instead = "epo_at_ends" if "ray_ends" in asked else "estimate_epo"
    warnings.warn(
        f"epo({', '.join(f'{name}=' for name in given)}) is now {instead}()",
        DeprecationWarning,
        stacklevel=3,
    )
    if "ray_ends" in asked:
        return epo_at_ends(tree, triangles, asked["ray_ends"])
    return estimate_epo(tree, triangles, **asked)
