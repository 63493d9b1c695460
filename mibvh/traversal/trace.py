"""Tracing ray sets: hits, exact counters, and kernel time."""

from __future__ import annotations

import dataclasses
import functools
import os
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.files import atomic_path
from mibvh.rays import RaySet
from mibvh.traversal.child_order import ChildOrder, child_priority
from mibvh.traversal.kernel_rays import kernel_rays
from mibvh.traversal.records import Layout, Records, make_records, own_memory, unit_scale
from mibvh.traversal.schedule import Schedule, issued_by_bursts, issued_in_step
from mibvh.traversal.wide_rows import as_wide
from mibvh.tree import Tree
from mibvh.triangles import F32, I32, as_triangles
from mibvh.variant import lane_width, mitsuba
from mibvh.wide_tree import C_BOX, WideTree

Lanes = Literal["simd", "scalar"]
Style = Literal["single", "while-while", "postponed", "wide"]
U32 = npt.NDArray[np.uint32]


@dataclasses.dataclass(frozen=True, eq=False)
class Hits:
    """What tracing a ray set through a tree gave.

    Attributes
    ----------
    t : (R,) float32
        Distances in units of the direction's length; infinite for a miss.
    triangle : (R,) int32
        Ids of the triangles hit; -1 for a miss.
    inner, leaves, tests : (R,) uint32
        Inner nodes visited (all child boxes tested), leaves visited, triangles tested. A binary
        tree's leaves, traced in the wide style, are single triangles.
    steps : (R,) uint32
        Steps the ray's lane was busy for: inner nodes and triangles.
    seconds : (K,) float64
        Kernel execution times of the timed launches, which carry no counters; may be empty.
    lanes : str
        ``simd``: every lane of a packet carries a ray; ``scalar``: one does.
    lane_width : int
        Lanes of a packet.
    issued : int
        Lane-steps that the packets went through, busy and idle lanes alike.
    style : str
        ``single`` (:mod:`mibvh.traversal.kernel`), ``while-while`` or ``postponed``
        (:mod:`mibvh.traversal.rounds`), or ``wide`` (:mod:`mibvh.traversal.wide`).
    boxes : (R,) uint32
        Child boxes tested: two per inner node of a binary tree.
    """

    t: F32
    triangle: I32
    inner: U32
    leaves: U32
    tests: U32
    steps: U32
    seconds: npt.NDArray[np.float64]
    lanes: str
    lane_width: int
    issued: int
    style: str
    boxes: U32

    def __len__(self) -> int:
        return len(self.t)

    @property
    def lcv(self) -> float:
        """Leaf count variability: standard deviation over the rays of the leaves visited.

        Of a binary tree in the wide style, whose leaves are then single triangles, it is not the
        paper's.
        """
        return float(np.std(self.leaves, dtype=np.float64))

    @property
    def ns_per_ray(self) -> float:
        """Median kernel time per ray in nanoseconds."""
        return float(np.median(self.seconds)) / len(self) * 1e9

    @property
    def lane_utilisation(self) -> float:
        """Share of the issued lane-steps in which the lane had work."""
        return float(self.steps.sum(dtype=np.int64) / self.issued) if self.issued else 1.0

    def counted_cost(self, c_inner: float = 1.2, c_tri: float = 1.0, c_box: float = C_BOX) -> float:
        """Mean over the rays of ``c_inner * inner + c_tri * tests``: cost without a stopwatch.

        Each child box of a node beyond its second costs ``c_box`` more, so that this is a wide
        tree's cost in the units of its SAH and EPO. Of a binary tree in the wide style, it is the
        cost of the tree that it was collapsed to: not to be set beside its own SAH and EPO.
        """
        further = float(self.boxes.sum(dtype=np.int64) - 2 * self.inner.sum(dtype=np.int64))
        cost = float(c_inner * self.inner.mean() + c_tri * self.tests.mean())
        return cost + c_box * further / len(self)

    def counters(self) -> dict[str, Any]:
        """Return what was counted, as JSON-able values.

        Returns
        -------
        dict
            Of the wide style, names of what counts its own tree, with eight children per node,
            begin with ``wide_``: they are not the paper's.
        """
        of_tree = {
            "inner_per_ray": float(self.inner.mean()),
            "boxes_per_ray": float(self.boxes.mean()),
            "leaves_per_ray": float(self.leaves.mean()),
            "triangles_per_ray": float(self.tests.mean()),
            "counted_cost": self.counted_cost(),
            "lcv": self.lcv,
            "inner_deviation": float(np.std(self.inner, dtype=np.float64)),
            "steps_deviation": float(np.std(self.steps, dtype=np.float64)),
        }
        prefix = "wide_" if self.style == "wide" else ""
        return {
            "hits": int((self.triangle >= 0).sum()),
            **{prefix + name: value for name, value in of_tree.items()},
            "lane_utilisation": self.lane_utilisation,
        }

    def summary(self) -> dict[str, Any]:
        """Return the figures as JSON-able values; see :meth:`counters` for those of the wide style.

        Needs at least one timed launch.
        """
        spread = np.percentile(self.seconds, [25, 75]) / len(self) * 1e9
        return {
            "rays": len(self),
            "lanes": self.lanes,
            "lane_width": self.lane_width,
            "style": self.style,
            "ns_per_ray": self.ns_per_ray,
            "ns_per_ray_quartiles": spread.tolist(),
            "launches": len(self.seconds),
            "mrays_per_second": 1e3 / self.ns_per_ray,
            **self.counters(),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write ``t``, ``triangle`` and the counters to an ``.npz`` file."""
        names = ("t", "triangle", "inner", "boxes", "leaves", "tests", "steps", "seconds")
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **{name: getattr(self, name) for name in names})


class Tracer:
    """A ray set in Dr.Jit's memory, ready to be traced through any tree of one scene.

    Parameters
    ----------
    rays : RaySet
    scale : float
        From scene units to those of the records (:attr:`Records.scale`).
    lanes : "simd" or "scalar"
        Scalar is the paper's way: one lane of each packet carries rays, all others have exited.
    style : "single", "while-while", "postponed" or "wide"
        The binary tree in one loop, as the study uses it; in rounds of descending and testing
        leaves, without and with a leaf put aside (the speculative kernel of Aila and Laine 2009);
        or the fastest kernel, nodes of eight children and lanes that fetch their next ray.
    cull : bool
        Re-test popped nodes against the current hit. Off, as in the paper, by default. The wide
        style does not know how.
    any_hit : bool
        End each ray at the first hit found.
    """

    def __init__(
        self,
        rays: RaySet,
        scale: float,
        lanes: Lanes = "simd",
        *,
        style: Style = "single",
        cull: bool = False,
        any_hit: bool = False,
    ) -> None:
        if lanes not in ("simd", "scalar"):
            raise MibvhError(f"lanes must be simd or scalar, not {lanes!r}")
        if style not in get_args(Style):
            raise MibvhError(f"style must be one of {', '.join(get_args(Style))}, not {style!r}")
        if cull and style == "wide":
            raise MibvhError("the wide style does not re-test popped nodes: leave cull off")
        if len(rays) == 0:
            raise MibvhError("there are no rays to trace")
        mitsuba()
        self.lanes, self.style, self.cull, self.any_hit = lanes, style, cull, any_hit
        self.count, self.width = len(rays), lane_width()
        o, d, tmax, unit = kernel_rays(rays, scale)
        #: From distances along the rays to the kernel's.
        self.unit = unit
        if style == "wide":
            self._prepare_wide(o, d, tmax)
        else:
            self._prepare_binary(o, d, tmax)

    @property
    def layout(self) -> Layout:
        """Layout of the records that the style reads."""
        return "wide" if self.style == "wide" else "binary"

    def _prepare_binary(self, o: F32, d: F32, tmax: F32) -> None:
        import drjit as dr

        mi = mitsuba()
        spread = self.width if self.lanes == "scalar" else 1
        self._active = mi.Bool(np.repeat(tmax >= 0, spread))
        if spread > 1:
            self._active &= dr.arange(mi.UInt32, self.count * spread) % spread == 0
        self._o = mi.Point3f(np.repeat(o, spread, axis=0).T)
        self._d = mi.Vector3f(np.repeat(d, spread, axis=0).T)
        self._tmax = mi.Float(np.repeat(tmax, spread))
        dr.eval(self._o, self._d, self._tmax, self._active)

    def _prepare_wide(self, o: F32, d: F32, tmax: F32) -> None:
        from mibvh.traversal.wide import RAY_ROW

        rows = np.zeros((self.count, RAY_ROW), np.float32)
        rows[:, :3], rows[:, 3:6], rows[:, 6] = o, d, tmax
        self._rows = own_memory(rows)
        self._schedule = Schedule.of(self.count, self.width, self.lanes == "scalar")
        self._first, self._end = self._schedule.rays()

    def run(self, records: Records, *, count: bool = False) -> tuple[tuple[Any, ...], float]:
        """Trace once.

        Returns
        -------
        outputs : tuple
            What :func:`mibvh.traversal.kernel.walk` returns, evaluated.
        seconds : float
            Kernel execution time, without tracing and compilation.
        """
        import drjit as dr

        if records.layout != self.layout:
            raise MibvhError(
                f"the {self.style} style reads {self.layout} records, not {records.layout} ones"
            )
        launch = self._launch_wide if self.style == "wide" else self._launch_binary
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            outputs = launch(records, count)
            dr.sync_thread()
            history = dr.kernel_history([dr.KernelType.JIT])
        return outputs, sum(kernel["execution_time"] for kernel in history) / 1e3

    def hits(self, records: Records, repeats: int = 0) -> Hits:
        """Launch once with counters, and, if asked for, so many times more to be timed.

        Parameters
        ----------
        records : Records
        repeats : int
            Timed launches, after one that is not counted.

        Returns
        -------
        Hits
        """
        outputs, _ = self.run(records, count=True)
        if repeats:
            self.run(records)  # the first launch may compile
        seconds = np.array([self.run(records)[1] for _ in range(repeats)])
        t, triangle, inner, leaves, tests, *boxes = (self.fetch(column) for column in outputs)
        return Hits(
            (t / self.unit).astype(np.float32), triangle.view(np.int32),
            inner, leaves, tests, inner + tests, seconds,
            self.lanes, self.width, self.issued(records, inner, leaves, tests), self.style,
            boxes[0] if boxes else 2 * inner,
        )  # fmt: skip

    def _launch_binary(self, records: Records, count: bool, longest: Any = None) -> tuple[Any, ...]:
        import drjit as dr

        from mibvh.traversal.kernel import walk
        from mibvh.traversal.rounds import walk_in_rounds

        rays = self._o, self._d, self._tmax, self._active
        if self.style == "single":
            outputs = walk(records, *rays, cull=self.cull, count=count, any_hit=self.any_hit)
        else:
            outputs = walk_in_rounds(
                records, *rays, postpone=self.style == "postponed",
                cull=self.cull, count=count, any_hit=self.any_hit, longest=longest,
            )  # fmt: skip
        dr.eval(outputs if count else outputs[:2])
        return outputs

    def _launch_wide(self, records: Records, count: bool) -> tuple[Any, ...]:
        import drjit as dr

        from mibvh.traversal.wide import walk_wide

        mi = mitsuba()
        t = dr.empty(mi.Float, self.count)
        triangle, *counts = (dr.empty(mi.UInt32, self.count) for _ in range(5))
        walk_wide(
            records, self._rows, self._first, self._end, self._schedule.lanes,
            dr.opaque(mi.UInt32, self._schedule.burst), t, triangle, counts,
            count=count, any_hit=self.any_hit,
        )  # fmt: skip
        dr.eval(t, triangle, counts)
        inner, boxes, leaves, tests = counts
        return t, triangle, inner, leaves, tests, boxes

    def fetch(self, column: Any) -> npt.NDArray[Any]:
        """One output as a NumPy array with a row per ray."""
        values = np.array(column)
        return values[:: self.width].copy() if len(values) > self.count else values

    def issued(self, records: Records, inner: U32, leaves: U32, tests: U32) -> int:
        """Lane-steps that the packets went through for rays of so many visits."""
        if self.style == "wide":
            return issued_by_bursts(inner + tests, self._schedule)
        if self.style == "single":
            return issued_in_step(inner + tests, self.width, self.lanes == "scalar")
        return int(self.rounds(records, leaves)[1].sum(dtype=np.int64)) * self.width

    def rounds(self, records: Records, leaves: U32) -> tuple[I32, U32]:
        """Launch once more, to see how long the rounds of each packet are.

        Parameters
        ----------
        records : Records
        leaves : (R,) uint32
            Leaves that each ray visits.

        Returns
        -------
        start : (P,) int32
            Each packet's first round.
        steps : (N, 2) uint32
            The most steps that a lane took in a round, in the descent and in the leaves. A packet
            has room for more rounds than it may take: the rest are zero.
        """
        import drjit as dr

        mi = mitsuba()
        lanes = 1 if self.lanes == "scalar" else self.width
        # Every round but the last has a leaf.
        room = np.maximum.reduceat(leaves, np.arange(0, self.count, lanes)).astype(np.int64) + 1
        start = np.cumsum(room) - room
        longest = [dr.zeros(mi.UInt32, int(room.sum())) for _ in range(2)]
        place = np.repeat(start.astype(np.uint32), self.width)[: dr.width(self._o)]
        self._launch_binary(records, True, (mi.UInt32(place), *longest))
        dr.eval(longest)
        return start.astype(np.int32), np.stack([np.array(column) for column in longest], axis=1)


@functools.lru_cache(maxsize=2)
def _cached_records(tree: Tree | WideTree, triangles: Any, layout: Layout, variant: str) -> Records:
    return make_records(tree, triangles, layout)


@functools.lru_cache(maxsize=2)
def _in_order(tree: Tree | WideTree, triangles: Any, child_order: ChildOrder) -> WideTree:
    wide = as_wide(tree, triangles)
    return wide.ordered(child_priority(wide, triangles, child_order))


def trace(
    tree: Tree | WideTree,
    triangles: Any,
    rays: RaySet,
    lanes: Lanes = "simd",
    *,
    style: Style = "single",
    cull: bool = False,
    any_hit: bool = False,
    child_order: ChildOrder | None = None,
    repeats: int = 5,
) -> Hits:
    """Trace a ray set through a tree: hits, exact counters and kernel times.

    Parameters
    ----------
    tree : Tree or WideTree
        A wide tree is traced in the wide style.
    triangles : Triangles, Scene or (N, 3, 3) array
        What the tree was built for.
    rays : RaySet
    lanes : "simd" or "scalar"
        Whether all lanes of a packet carry rays, or one does (the paper's scalar figures).
    style : "single", "while-while", "postponed" or "wide"
        The binary tree in one loop, as the study uses it; in rounds of descending and testing
        leaves, without and with a leaf put aside (the speculative kernel of Aila and Laine 2009);
        or the wide kernel, to which a binary tree is collapsed to eight children per node: the
        fastest.
    cull : bool
        Re-test popped nodes against the current hit. The paper's kernel does not, the wide
        style cannot.
    any_hit : bool
        End each ray at the first hit found instead of the closest.
    child_order : "larger", "blocking" or "worth", optional
        Of any-hit rays in the wide style: visit a node's children in this order
        (:func:`mibvh.traversal.child_order.child_priority`) instead of near first.
    repeats : int
        Timed launches, after one that is not counted.

    Returns
    -------
    Hits

    Raises
    ------
    MibvhError
        If the tree or the rays belong to another geometry, or an argument is out of range.
    """
    triangles = as_triangles(triangles)
    if repeats < 1:
        raise MibvhError(f"repeats must be at least 1, not {repeats}")
    belongs = rays.meta.get("digest")
    if belongs not in (None, triangles.digest):
        raise MibvhError(
            f"the rays (of {rays.meta.get('scene', 'another scene')}) were made for another "
            f"geometry than {triangles.name}"
        )
    if child_order is not None:
        if not any_hit or style != "wide":
            raise MibvhError("a child order is for any-hit rays in the wide style")
        tree = _in_order(tree, triangles, child_order)
    scale = float(unit_scale(triangles))
    tracer = Tracer(rays, scale, lanes, style=style, cull=cull, any_hit=any_hit)
    records = _cached_records(tree, triangles, tracer.layout, mitsuba().variant())
    return tracer.hits(records, repeats)
