"""Tracing ray sets: hits, exact counters, and kernel time."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import time
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError, expect
from mibvh.files import check_columns, read_arrays, write_arrays
from mibvh.memory import BYTES, require_memory
from mibvh.nodes import C_INNER, C_TRI
from mibvh.ranges import check
from mibvh.rays.rayset import RaySet
from mibvh.traversal.child_order import ChildOrder, child_priority
from mibvh.traversal.kernel_rays import kernel_rays
from mibvh.traversal.records import Layout, Records, make_records, unit_scale
from mibvh.traversal.styles import find_style
from mibvh.traversal.visits import Visits
from mibvh.traversal.wide_rows import as_wide
from mibvh.tree import Tree
from mibvh.triangles import F32, I32, as_triangles
from mibvh.variant import backend, lane_width, mitsuba
from mibvh.wide_tree import C_BOX, WideTree

Lanes = Literal["simd", "scalar"]
#: Name of a style in :data:`mibvh.traversal.styles.STYLES`.
Style = str
U32 = npt.NDArray[np.uint32]
_COLUMNS = {
    "t": "float32",
    "triangle": "int32",
    "inner": "uint32",
    "leaves": "uint32",
    "tests": "uint32",
    "steps": "uint32",
    "boxes": "uint32",
}
_ARRAYS = (*_COLUMNS, "seconds")
#: What else a file of hits tells.
_FACTS = {"lanes": str, "lane_width": int, "issued": int, "style": str}


@dataclasses.dataclass(frozen=True, eq=False)
class Hits:
    """The result of tracing a ray set through a tree: hits, counters and times.

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
        One of :data:`mibvh.traversal.styles.STYLES`.
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

    def __repr__(self) -> str:
        hit = int((self.triangle >= 0).sum())
        return f"Hits({len(self):,} rays, {hit:,} hits, {self.lanes}, {self.style!r})"

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

    def counted_cost(
        self, c_inner: float = C_INNER, c_tri: float = C_TRI, c_box: float = C_BOX
    ) -> float:
        """Mean over the rays of ``c_inner * inner + c_tri * tests``: cost without a stopwatch.

        Each child box of a node beyond its second costs ``c_box`` more, so that this is a wide
        tree's cost in the units of its SAH and EPO. Of a binary tree in the wide style, it is the
        cost of the tree that it was collapsed to: not to be set beside its own SAH and EPO.
        """
        further = float(self.boxes.sum(dtype=np.int64) - 2 * self.inner.sum(dtype=np.int64))
        cost = float(c_inner * self.inner.mean() + c_tri * self.tests.mean())
        return cost + c_box * further / len(self)

    def costs(
        self, c_inner: float = C_INNER, c_tri: float = C_TRI, c_box: float = C_BOX
    ) -> npt.NDArray[np.float64]:
        """(R,) float64: the counted cost of each ray; see :meth:`counted_cost`."""
        inner, tests = self.inner.astype(np.float64), self.tests.astype(np.float64)
        return c_inner * inner + c_tri * tests + c_box * (self.boxes - 2 * inner)

    def counters(self) -> dict[str, Any]:
        """Return the means of the counters as JSON-able values.

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
        prefix = find_style(self.style).prefix
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
        """Write an ``.npz`` file; see :func:`mibvh.files.write_arrays`."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        write_arrays(path, arrays, {name: getattr(self, name) for name in _FACTS}, kind="hits")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Hits:
        """Read hits back.

        Raises
        ------
        MibvhError
            If the file is missing, holds no hits, is damaged, or comes from a newer format.
        """
        arrays, meta = read_arrays(path, "hits", _ARRAYS)
        check_columns(path, "hits", arrays, _COLUMNS)
        if arrays["seconds"].dtype != np.float64 or arrays["seconds"].ndim != 1:
            raise MibvhError(f"{path}: hits: the seconds are no times")
        for name, kind in _FACTS.items():
            if type(meta.get(name)) is not kind:
                raise MibvhError(f"{path}: hits: {name} is {meta.get(name)!r}")
        fields: dict[str, Any] = {**arrays, **{name: meta[name] for name in _FACTS}}
        hits = cls(**fields)
        if not (hits.t >= 0).all() or not (np.isfinite(hits.t) == (hits.triangle >= 0)).all():
            raise MibvhError(f"{path}: hits: a distance is no distance, or has no triangle")
        if (hits.triangle < -1).any() or not (
            np.isfinite(hits.seconds) & (hits.seconds >= 0)
        ).all():
            raise MibvhError(f"{path}: hits: a triangle or a time is negative")
        return hits


class LaunchSeconds(NamedTuple):
    """Seconds of a launch, by two clocks.

    Attributes
    ----------
    kernel : float
        Wall time of the kernel.
    process : float
        CPU time of the process while the kernel ran, all threads together; NaN on a GPU, where no
        processor runs it.
    """

    kernel: float
    process: float


class Tracer:
    """A ray set in Dr.Jit's memory, ready to be traced through any tree of one scene.

    Parameters
    ----------
    rays : RaySet
    scale : float
        From scene units to those of the records (:attr:`Records.scale`).
    lanes : "simd" or "scalar"
        Scalar is the paper's way: one lane of each packet carries rays, all others have exited.
    style : "single", "while-while", "speculative" or "wide"
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
        self._style = find_style(style)
        if cull and not self._style.culls:
            raise MibvhError(
                f"the {self.style} style does not re-test popped nodes: leave cull off"
            )
        if len(rays) == 0:
            raise MibvhError("there are no rays to trace")
        mitsuba()
        self.lanes, self.count, self.width = lanes, len(rays), lane_width()
        prepared = kernel_rays(rays, scale)
        #: From distances along the rays to the kernel's.
        self.unit = prepared.unit
        self.launch = self._style.prepare(prepared, lanes == "scalar", cull, any_hit)

    @property
    def style(self) -> str:
        """Name of the style."""
        return self._style.name

    @property
    def layout(self) -> Layout:
        """Layout of the records that the style reads."""
        return self._style.layout

    def run(self, records: Records, *, count: bool = False) -> tuple[Visits, LaunchSeconds]:
        """Trace once.

        Returns
        -------
        visits : Visits
            Dr.Jit arrays, evaluated; the counters only if they were asked for.
        seconds : LaunchSeconds
            Without tracing and compilation.
        """
        import drjit as dr

        if records.layout != self.layout:
            raise MibvhError(
                f"the {self.style} style reads {self.layout} records, not {records.layout} ones"
            )
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            process, thread = time.process_time(), time.thread_time()
            visits = self.launch(records, count)
            # Until here this thread has traced the kernel; others execute it.
            thread = time.thread_time() - thread
            dr.sync_thread()
            process = time.process_time() - process - thread if backend() == "llvm" else math.nan
            history = dr.kernel_history([dr.KernelType.JIT])
        kernel = sum(launched["execution_time"] for launched in history) / 1e3
        return visits, LaunchSeconds(kernel, process)

    def fetch(self, column: Any) -> npt.NDArray[Any]:
        """One column of visits as a NumPy array with an entry per ray."""
        return self.launch.fetch(column)

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
        seconds = np.array([self.run(records)[1].kernel for _ in range(repeats)])
        visits = Visits(*(self.fetch(column) for column in outputs if column is not None))
        return Hits(
            (visits.t / self.unit).astype(np.float32),
            visits.triangle.view(np.int32),
            visits.inner,
            visits.leaves,
            visits.tests,
            visits.inner + visits.tests,
            seconds,
            self.lanes,
            self.width,
            self.launch.issued(records, visits),
            self.style,
            2 * visits.inner if visits.boxes is None else visits.boxes,
        )


@functools.lru_cache(maxsize=2)
def _cached_records(tree: Tree | WideTree, triangles: Any, layout: Layout, variant: str) -> Records:
    return make_records(tree, triangles, layout)


@functools.lru_cache(maxsize=2)
def _in_order(tree: Tree | WideTree, triangles: Any, child_order: ChildOrder) -> WideTree:
    wide = as_wide(tree, triangles)
    return wide.ordered(child_priority(wide, triangles, child_order))


def release_records() -> None:
    """Release the trees and records that :func:`trace` keeps for its next calls."""
    _cached_records.cache_clear()
    _in_order.cache_clear()


def trace(
    tree: Tree | WideTree,
    triangles: Any,
    rays: RaySet,
    lanes: Lanes = "simd",
    *,
    style: Style | None = None,
    cull: bool = False,
    any_hit: bool | None = None,
    child_order: ChildOrder | None = None,
    repeats: int = 5,
) -> Hits:
    """Trace a ray set through a tree: hits, exact counters and kernel times.

    Parameters
    ----------
    tree : Tree or WideTree
        A wide tree is traced in the wide style, and in no other.
    triangles : Triangles, Scene or (N, 3, 3) array
        What the tree was built for.
    rays : RaySet
    lanes : "simd" or "scalar"
        Whether all lanes of a packet carry rays, or one does (the paper's scalar figures).
    style : "single", "while-while", "speculative" or "wide", optional
        The binary tree in one loop, as the study uses it; in rounds of descending and testing
        leaves, without and with a leaf put aside (the speculative kernel of Aila and Laine 2009);
        or the wide kernel, to which a binary tree is collapsed to eight children per node: the
        fastest. By default ``single``, or ``wide`` for a wide tree and with a child order.
    cull : bool
        Re-test popped nodes against the current hit. The paper's kernel does not, the wide
        style cannot.
    any_hit : bool, optional
        End each ray at the first hit found instead of the closest; by default as the rays are
        (:attr:`mibvh.RaySet.occlusion`).
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
    expect((Tree, WideTree), tree=tree)
    expect(RaySet, rays=rays)
    triangles = as_triangles(triangles)
    check(repeats=repeats)
    rays.check_matches(triangles)
    any_hit = rays.occlusion if any_hit is None else any_hit
    style = style or ("wide" if isinstance(tree, WideTree) or child_order else "single")
    if child_order is not None:
        if not any_hit or style != "wide":
            raise MibvhError("a child order is for any-hit rays in the wide style")
        tree.check_matches(triangles)
        tree = _in_order(tree, triangles, child_order)
    needed = BYTES["trace"] * len(rays) + BYTES["records"] * len(tree.references)
    require_memory(needed, f"{len(rays):,} rays traced with counters")
    scale = float(unit_scale(triangles))
    tracer = Tracer(rays, scale, lanes, style=style, cull=cull, any_hit=any_hit)
    records = _cached_records(tree, triangles, tracer.layout, mitsuba().variant())
    return tracer.hits(records, repeats)
