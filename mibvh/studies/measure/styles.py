"""The experiment ``styles``: kernels timed in both lane modes, and simulated at the same width.

Dr.Jit's packets execute in lockstep as warps do, so what they issue can be counted exactly. The
experiment asks whether that tells which tree gains from packets, and which loses, by the stopwatch.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from mibvh.rays import RaySet
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.store import key_of
from mibvh.studies.measure.times import LANES, TreeTimes, kept_times
from mibvh.studies.measure.warps import simulated_rays
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import Result, Timing
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.trace import Tracer
from mibvh.traversal.warp import simulate
from mibvh.tree import Tree
from mibvh.triangles import Triangles
from mibvh.variant import backend, lane_width

#: The simulated kernels that issue what the timed ones do. The wide kernel tells itself.
SIMULATED = {
    "single": "single",
    "while-while": "drjit-while-while",
    "speculative": "drjit-speculative",
}


@dataclasses.dataclass(frozen=True)
class StyleTree:
    """A tree in one style.

    Attributes
    ----------
    scalar_ns, simd_ns : float
        Kernel time per ray, with one lane per packet and with all; NaN where the rays are too few.
    scalar_error, simd_error : float
        Their relative standard errors.
    scalar_cost, cost : float
        Simulated, per ray: of packets of one lane, and of packets as wide as those that were
        timed. Of the wide style, steps rather than cost: a node or a triangle each.
    """

    scalar_ns: float
    scalar_error: float
    simd_ns: float
    simd_error: float
    scalar_cost: float
    cost: float


@dataclasses.dataclass(frozen=True)
class StyleRun:
    """A scene's trees in one style.

    Attributes
    ----------
    style : str
    rays : int
        How many were simulated.
    timing : dict of str to Timing
        By lane mode.
    trees : list of StyleTree
        In the order of the study's.
    """

    style: str
    rays: int
    timing: dict[str, Timing]
    trees: list[StyleTree]


@dataclasses.dataclass(frozen=True)
class StylesResult(Result, experiment="styles"):
    """A scene's trees in every requested style."""

    lane_width: int
    runs: list[StyleRun]


@dataclasses.dataclass(frozen=True)
class _Costs:
    """Simulated cost of a tree in packets of one lane, and in full packets."""

    scalar: float
    packets: float


def styles_experiment(setting: Setting, report: Reporter) -> StylesResult:
    """Time and simulate the trees of a scene in the styles of the study's options."""
    styles = setting.options.styles
    share = 1.0 / len(styles)
    return StylesResult(
        lane_width=lane_width(),
        runs=[
            _run(setting, style, report.part(i * share, share)) for i, style in enumerate(styles)
        ],
    )


def _run(setting: Setting, style: str, report: Reporter) -> StyleRun:
    found = {
        lanes: kept_times(setting, lanes, style, report.part(0.45 * i, 0.45))
        for i, lanes in enumerate(LANES)
    }
    report(f"simulate {style}", 0.9)
    rays = packet_rays(setting.rays, style)
    costs = [_kept_costs(setting, name, rays, style) for name in setting.trees]
    return StyleRun(
        style,
        len(rays),
        {lanes: times.timing for lanes, times in found.items()},
        _trees(found["scalar"], found["simd"], costs),
    )


def _trees(scalar: TreeTimes, simd: TreeTimes, costs: list[_Costs]) -> list[StyleTree]:
    columns = zip(scalar.ns, scalar.error, simd.ns, simd.error, costs, strict=True)
    return [
        StyleTree(alone, alone_error, together, error, cost.scalar, cost.packets)
        for alone, alone_error, together, error, cost in columns
    ]


def packet_rays(rays: RaySet, style: str) -> RaySet:
    """Return the rays that packets are simulated with, in the order in which they are timed.

    The wide kernel deals rays by how many there are: it has all of them.
    """
    if style not in SIMULATED:
        return rays
    places = simulated_rays(len(rays), lane_width())
    return rays if len(places) == len(rays) else rays.select(places)


def _kept_costs(setting: Setting, name: str, rays: RaySet, style: str) -> _Costs:
    triangles = setting.scene.triangles
    key = key_of(
        __name__,
        tree=setting.trees.digest(name),
        digest=triangles.digest,
        rays=rays.digest,
        style=style,
        lanes=lane_width(),
        cull=setting.options.cull,
        backend=backend(),
    )

    def make() -> _Costs:
        return packet_costs(setting.trees[name], triangles, rays, style)

    return setting.store.record(f"styles-{key}", _Costs, make)


def packet_costs(tree: Tree, triangles: Triangles, rays: RaySet, style: str) -> _Costs:
    """Simulate the packets of a style: cost per ray in packets of one lane, and in full packets.

    Popped nodes are not re-tested in the simulation.
    """
    if style in SIMULATED:
        costs = tree.meta["c_inner"], tree.meta["c_tri"]
        alone, packets = (
            simulate(tree, triangles, rays, width, SIMULATED[style]).cost(*costs)
            for width in (1, lane_width())
        )
        return _Costs(alone, packets)
    tracer = Tracer(rays, float(unit_scale(triangles)), style=style)
    hits = tracer.hits(make_records(tree, triangles, tracer.layout))
    return _Costs(float(np.mean(hits.steps, dtype=np.float64)), hits.issued / len(rays))
