"""Warps in lockstep, simulated exactly: what a GPU's warp issues for the rays that it traces.

A warp's lanes execute one instruction at a time, together; a lane that has nothing to do for it
waits. What a kernel takes is therefore what its warps *issue*, and not what its rays need. The
kernels are those of Aila and Laine (*Understanding the Efficiency of Ray Traversal on GPUs*, HPG
2009) and of Aila, Laine and Karras (*Understanding the Efficiency of Ray Traversal on GPUs: Kepler
and Fermi Addendum*, NVIDIA NVR-2012-02), as published with them; Aila, Karras and Laine measured
with the last one (*On Quality Metrics of Bounding Volume Hierarchies*, HPG 2013). No GPU is needed,
and there is no noise.

==================  ================================================  ==========================
style               what a round of a warp is                         published as
==================  ================================================  ==========================
``single``          one step: for each lane what it needs next, a     this package's own
                    node or a triangle                                :mod:`~mibvh.traversal.kernel`
``while-while``     lanes descend until each has a leaf or is done;   ``tesla_persistent_while_
                    each tests one leaf                               while.cu``
``speculative``     a lane puts its first leaf aside and goes on to   ``fermi_speculative_while_
                    its second; the descent ends once every lane in   while.cu``
                    it has put one aside (the vote); lanes test all
                    leaves at hand, waiting for each other after each
``persistent``      the same; and after a round that began with less  ``kepler_dynamic_fetch.cu``
                    than 20 busy lanes of 32, lanes that are done
                    fetch new rays
``drjit-...``       the rounds of :mod:`mibvh.traversal.rounds`: no   this package's own
                    vote, and each lane tests its leaves at its own
                    pace
==================  ================================================  ==========================

A wide tree (:class:`mibvh.WideTree`) is traced in one of two modes. With a lane per *ray*, one
lane tests all children of a node, as in kernels for compressed wide trees (Ylitie, Karras and
Laine, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs*, HPG 2017). With a
lane per *child*, a ray has as many lanes of the warp as nodes have children, and they test the
children of a node, or as many triangles of a leaf, in one step: in a warp of 32, four rays for
nodes of eight. That is how CPUs use their lanes for single rays (Wald, Benthin and Boulos, *Getting
Rid of Packets: Efficient SIMD Single-Ray Traversal using Multi-branching BVHs*, RT 2008), brought
to GPUs by Lier, Stamminger and Selgrad (*CPU-Style SIMD Ray Traversal on GPUs*, HPG 2018), whose
published kernels are a single loop: ``single`` here.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.parallel import run_blocks, thread_count
from mibvh.rays.rayset import RaySet
from mibvh.traversal import lockstep
from mibvh.traversal.divergence import Rounds, packets
from mibvh.traversal.kernel_rays import kernel_rays
from mibvh.traversal.order import Order, ray_order
from mibvh.traversal.records import binary_rows, leaf_rows, unit_scale
from mibvh.traversal.visits import Visits
from mibvh.traversal.wide_nodes import wide_nodes
from mibvh.tree import Tree
from mibvh.triangles import F32, F64, I32, Triangles, as_triangles
from mibvh.wide_tree import C_BOX, WideTree

#: What a lane of a warp is for: a ray, or a child of the node that a ray is at.
LanePer = Literal["ray", "child"]
U32 = npt.NDArray[np.uint32]
I64 = npt.NDArray[np.int64]

WIDTHS = (1, 2, 4, 8, 16, 32, 64)
#: Queues that one call of compiled code works through.
_BLOCK = 64


@dataclasses.dataclass(frozen=True)
class WarpStyle:
    """The rules of one kernel.

    Attributes
    ----------
    name : str
    rounds : bool
        Rounds of descending and testing leaves; otherwise a single loop.
    postpone : bool
        A lane puts its first leaf aside and descends on ("speculative": Aila and Laine 2009,
        section 4.3).
    vote : bool
        A descent ends once every lane that is still in it has put a leaf aside (``__any`` in the
        published kernels).
    leaves : int
        One leaf per round; all at hand, leaf by leaf; all at hand, each lane at its own pace.
    fetch : bool
        Lanes that are done fetch new rays once few are busy (Aila, Laine and Karras 2012).
    """

    name: str
    rounds: bool = True
    postpone: bool = False
    vote: bool = False
    leaves: int = lockstep.LEAF_BY_LEAF
    fetch: bool = False


STYLES = {
    style.name: style
    for style in (
        WarpStyle("single", rounds=False),
        WarpStyle("while-while", leaves=lockstep.ONE_LEAF),
        WarpStyle("speculative", postpone=True, vote=True),
        WarpStyle("persistent", postpone=True, vote=True, fetch=True),
        WarpStyle("drjit-while-while", leaves=lockstep.OWN_PACE),
        WarpStyle("drjit-speculative", postpone=True, leaves=lockstep.OWN_PACE),
    )
}

#: Lanes of 32 below which the Kepler kernel fetches rays (``DYNAMIC_FETCH_THRESHOLD``).
FETCH_BELOW = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Warps:
    """What simulating a ray set's warps gave.

    Attributes
    ----------
    width : int
        Lanes of a warp.
    style, order : str
    vote : bool
        Whether the vote ended descents.
    threshold : int
        Busy lanes below which lanes that are done fetched rays; 0: none did.
    t : (R,) float32
        Distances in units of the direction's length; infinite for a miss.
    triangle : (R,) int32
        Ids of the triangles hit; -1 for a miss.
    inner, leaves, tests : (R,) uint32
        Inner nodes and leaves visited, triangles tested, ray by ray as they stand in the set.
    issued : (P, 2) int64
        Steps that each warp issued: of nodes, of triangles.
    rounds : (P,) int64
        Rounds of each warp; of the single loop, its steps.
    dealt : (R,) int32
        The rays in the order in which they were dealt to lanes.
    boxes : (R,) uint32
        Child boxes tested, ray by ray.
    children : int
        Children that the tree's nodes may have.
    lanes : int
        Lanes of each ray: 1, or ``children``.
    """

    width: int
    style: str
    order: str
    vote: bool
    threshold: int
    t: F32
    triangle: I32
    inner: U32
    leaves: U32
    tests: U32
    issued: I64
    rounds: I64
    dealt: I32
    boxes: U32
    children: int = 2
    lanes: int = 1

    def __len__(self) -> int:
        """Return the number of rays."""
        return len(self.t)

    @property
    def active(self) -> tuple[int, int]:
        """Lane-steps in which a lane had work: of nodes, of triangles."""
        nodes = self.boxes if self.lanes > 1 else self.inner
        return int(nodes.sum(dtype=np.int64)), int(self.tests.sum(dtype=np.int64))

    @property
    def c_inner(self) -> float:
        """What a step of nodes costs by default.

        1.2, and 0.2 for each box beyond two that a lane tests, whether there is a child or not.
        """
        return 1.2 + C_BOX * max(0, self.children // self.lanes - 2)

    def cost(self, c_inner: float | None = None, c_tri: float = 1.0) -> float:
        """What a ray costs: issued steps, weighted, times the width, per ray.

        A warp's issued step occupies all of its lanes, so that at width 1 this is
        :meth:`counted_cost`.
        """
        nodes, triangles = self.issued.sum(axis=0) * self.width / len(self)
        return float(self._c_inner(c_inner) * nodes + c_tri * triangles)

    def counted_cost(self, c_inner: float | None = None, c_tri: float = 1.0) -> float:
        """Mean over the rays of the steps in which their lanes have work, weighted.

        With a lane per ray ``c_inner * inner + c_tri * tests``: what the rays themselves need; with
        a lane per child ``c_inner * boxes + c_tri * tests``. With a vote, lanes of wide warps visit
        more than a lane alone would.
        """
        nodes, triangles = (steps / len(self) for steps in self.active)
        return float(self._c_inner(c_inner) * nodes + c_tri * triangles)

    def _c_inner(self, given: float | None) -> float:
        return self.c_inner if given is None else given

    def utilisation(self, c_inner: float | None = None, c_tri: float = 1.0) -> float:
        """Share of the issued lane-steps, weighted by cost, in which the lane had work.

        With a lane per child, work is a child that there is, or a triangle.
        """
        cost = self.cost(c_inner, c_tri)
        return self.counted_cost(c_inner, c_tri) / cost if cost else 1.0

    def maxima(self, counts: npt.NDArray[Any]) -> F64:
        """Largest of a count in each packet of rays that are dealt side by side.

        Parameters
        ----------
        counts : (R,) array
            Such as ``leaves``, or ``1.2 * inner + tests``.

        Returns
        -------
        (P,) float64
            Of full packets. Where lanes fetch rays, these are no longer a warp's rays at one time.
        """
        return packets(counts, self.width // self.lanes, self.dealt).max(axis=1)

    @property
    def lcv(self) -> float:
        """Leaf count variability: standard deviation over the rays of the leaves visited."""
        return float(np.std(self.leaves, dtype=np.float64))


def simulate(
    tree: Tree | WideTree,
    triangles: object,
    rays: RaySet,
    width: int = 32,
    style: str = "persistent",
    *,
    lane_per: LanePer = "ray",
    vote: bool | None = None,
    any_hit: bool | None = None,
    fetch_below: int = FETCH_BELOW,
    order: Order = "stored",
    seed: int = 0,
    rays_per_lane: int = 64,
    warps: int = 1,
    threads: int | None = None,
) -> Warps:
    """Trace a ray set through a tree as warps in lockstep would.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles, Scene or (N, 3, 3) array
        What the tree was built for.
    rays : RaySet
    width : int
        Lanes of a warp, from 1 to 64.
    style : str
        One of :data:`STYLES`.
    lane_per : "ray" or "child"
        Whether each lane traces a ray of its own, or a ray has a lane for each child that a node
        may have. A ray that any hit ends is then ended by the first of the hits found at once.
    vote : bool, optional
        Leave the vote out, or put it in; as the style has it by default.
    any_hit : bool, optional
        End each ray at the first hit found instead of the closest; by default as the rays are
        (:attr:`mibvh.RaySet.occlusion`).
    fetch_below : int
        Of the persistent style: busy lanes of 32 below which those that are done fetch rays;
        in proportion for other widths, rounded up.
    order : "stored", "path", "morton" or "random"
        See :func:`mibvh.traversal.order.ray_order`.
    seed : int
        Of the random order.
    rays_per_lane : int
        Of the persistent style: rays in a queue, for each lane that it feeds.
    warps : int
        Of the persistent style: warps that share a queue. They are equally fast: the next round
        is that of the warp that has issued least.
    threads : int, optional
        :func:`mibvh.parallel.thread_count` by default. The result does not depend on it.

    Returns
    -------
    Warps

    Raises
    ------
    MibvhError
        If the tree or the rays belong to another geometry, or an argument is out of range.
    """
    geometry = as_triangles(triangles)
    tree.check_matches(geometry)
    rays.check_matches(geometry)
    rules = _rules(style, vote)
    children = tree.width if isinstance(tree, WideTree) else 2
    lanes = _lanes(lane_per, children, width)
    groups = width // lanes
    for name, value in (
        ("fetch_below", fetch_below),
        ("rays_per_lane", rays_per_lane),
        ("warps", warps),
    ):
        if value < 1:
            raise MibvhError(f"{name} must be at least 1, not {value}")
    if len(rays) == 0:
        raise MibvhError("there are no rays to trace")
    plan = lockstep.Plan(
        groups,
        lanes,
        not rules.rounds,
        rules.postpone,
        rules.vote,
        rules.leaves,
        min(-(-fetch_below * groups // 32), groups) if rules.fetch else 0,
        rays.occlusion if any_hit is None else any_hit,
    )
    sharing, per_lane = (warps, rays_per_lane) if rules.fetch else (1, 1)
    dealt = ray_order(rays, geometry.bounds, order, seed)
    visits, issued, unit = _run(
        plan, tree, geometry, rays, dealt, sharing, sharing * per_lane * groups, threads
    )
    return Warps(
        width,
        style,
        order,
        rules.vote,
        plan.threshold,
        (visits.t / unit).astype(np.float32),
        *visits[1:5],
        issued[:, :2].copy(),
        issued[:, 2].copy(),
        dealt,
        visits.boxes,
        children,
        lanes,
    )


def _lanes(lane_per: str, children: int, width: int) -> int:
    """Lanes of a ray."""
    if lane_per not in get_args(LanePer):
        raise MibvhError(f"lane_per must be {' or '.join(get_args(LanePer))}, not {lane_per!r}")
    lanes = children if lane_per == "child" else 1
    check_rules(width)
    if lanes > width:
        raise MibvhError(f"a warp of {width} lanes holds no ray with a lane per child of {lanes}")
    return lanes


def check_rules(width: int, style: str = "single") -> None:
    """Refuse a width or style that there are no warps of.

    Raises
    ------
    MibvhError
        If the width is none of :data:`WIDTHS`, or the style none of :data:`STYLES`.
    """
    if width not in WIDTHS:
        raise MibvhError(
            f"the warp width must be one of {', '.join(map(str, WIDTHS))}, not {width}"
        )
    _rules(style, None)


def _rules(style: str, vote: bool | None) -> WarpStyle:
    if style not in STYLES:
        raise MibvhError(f"the warp style must be one of {', '.join(STYLES)}, not {style!r}")
    rules = STYLES[style]
    if vote is None or vote == rules.vote:
        return rules
    if vote and not rules.postpone:
        raise MibvhError(f"the {style} style puts no leaf aside, so there is nothing to vote on")
    return dataclasses.replace(rules, vote=vote)


def ray_rounds(tree: Tree, triangles: object, rays: RaySet, threads: int | None = None) -> Rounds:
    """Cut every ray's way to its closest hit into rounds: a descent, and the leaf at its end.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles, Scene or (N, 3, 3) array
        What the tree was built for.
    rays : RaySet
    threads : int, optional
        :func:`mibvh.parallel.thread_count` by default.

    Raises
    ------
    MibvhError
        If the tree or the rays belong to another geometry.
    """
    geometry = as_triangles(triangles)
    tree.check_matches(geometry)
    rays.check_matches(geometry)
    dealt = np.arange(len(rays), dtype=np.int32)
    scene, work, _ = _prepare(tree, geometry, rays, dealt, any_hit=False)
    visits, per_ray = lockstep.new_visits(len(rays)), np.zeros(len(rays), np.uint32)
    workers = threads or thread_count()
    # No descent is longer than the tree has inner nodes, no leaf than its largest.
    descents = np.zeros((workers, len(tree) // 2 + 2), np.int64)
    lengths = np.zeros((workers, int(tree.count[tree.is_leaf].max()) + 1), np.int64)
    lanes = [lockstep.new_lanes(1, tree.depth + 1) for _ in range(workers)]

    def block(worker: int, begin: int, end: int) -> None:
        lockstep.count_rounds(
            lanes[worker],
            begin,
            end,
            work,
            scene,
            visits,
            per_ray,
            descents[worker],
            lengths[worker],
        )

    run_blocks(block, len(rays), 4096, workers)
    return Rounds(
        per_ray, np.trim_zeros(descents.sum(axis=0), "b"), np.trim_zeros(lengths.sum(axis=0), "b")
    )


def _prepare(
    tree: Tree | WideTree, triangles: Triangles, rays: RaySet, dealt: I32, any_hit: bool
) -> tuple[lockstep.Scene, lockstep.Rays, npt.NDArray[np.float64]]:
    """Records, rays in their units, and the units of distance."""
    scale = unit_scale(triangles)
    if isinstance(tree, WideTree):
        rows = leaf_rows(tree, triangles, scale)
        root, nodes = -1 if tree.is_leaf[0] else 0, wide_nodes(tree, scale, any_hit)
    else:
        rows, root = binary_rows(tree, triangles)
        nodes = wide_nodes(None, scale, any_hit)
    prepared = kernel_rays(rays, float(scale))
    scene = lockstep.Scene(
        rows, rows.view(np.int32), np.int32(root), isinstance(tree, WideTree), nodes
    )
    return (
        scene,
        lockstep.Rays(*prepared[:3], dealt),
        prepared.unit,
    )


def _run(
    plan: lockstep.Plan,
    tree: Tree | WideTree,
    triangles: Triangles,
    rays: RaySet,
    dealt: I32,
    warps: int,
    length: int,
    threads: int | None,
) -> tuple[Visits, I64, npt.NDArray[np.float64]]:
    """Run queues of so many rays, with so many warps each, on several threads."""
    scene, work, unit = _prepare(tree, triangles, rays, dealt, plan.any_hit)
    begins = np.arange(0, len(rays), length)
    queues = np.stack([begins, np.minimum(begins + length, len(rays))], axis=1)
    issued = np.zeros((len(queues), warps, 4), np.int64)
    visits = lockstep.new_visits(len(rays))
    # At each level all children but the one that is gone to are put off, and for a moment that one.
    stack = tree.depth * (tree.width - 1 if isinstance(tree, WideTree) else 1) + 1

    @functools.cache
    def lanes(worker: int) -> lockstep.Lanes:
        return lockstep.new_lanes(warps * plan.width, stack)

    def block(worker: int, begin: int, end: int) -> None:
        lockstep.run_queues(
            lanes(worker), plan, queues[begin:end], work, scene, visits, issued[begin:end]
        )

    run_blocks(block, len(queues), max(1, _BLOCK * 64 // length), threads)
    return visits, issued.reshape(-1, 4), unit
