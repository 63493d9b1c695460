"""Times of a scene's trees: launches handed to the stopwatch, in either lane mode."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.measure.stopwatch import measure
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import Timing
from mibvh.traversal.records import Records, make_records, unit_scale
from mibvh.traversal.trace import Tracer
from mibvh.tree import Tree

Lanes = Literal["scalar", "simd"]
LANES: tuple[Lanes, ...] = ("scalar", "simd")
#: Fewest rays of a portion that is timed: some hundredths of a second.
_PORTION = {"scalar": 8192, "simd": 32768}


@dataclasses.dataclass(frozen=True)
class TreeTimes:
    """Times of trees.

    Attributes
    ----------
    ns, error : list of float
        Nanoseconds per ray of each tree, and their relative standard errors.
    timing : Timing
    """

    ns: list[float]
    error: list[float]
    timing: Timing


def times(
    trees: list[Tree],
    scene: Scene,
    rays: RaySet,
    lanes: Lanes,
    options: StudyOptions,
    report: Reporter,
) -> TreeTimes:
    """Time all trees of a scene, and the first one a second time under another name."""
    some = timed_rays(rays, lanes, options)
    tracers = portions(some, scene, lanes, options)
    # A tree's records are made anew for its second name: they lie elsewhere in memory.
    launches = [launch_of(tracers, tree, scene) for tree in (*trees, trees[0])]
    found = run_stopwatch(launches, len(tracers), len(some), options, report, f"time {lanes}")
    difference = found.ns[-1] / found.ns[0] - 1
    timing = dataclasses.replace(found.timing, repeat_difference=difference)
    return TreeTimes(found.ns[:-1], found.error[:-1], timing)


def run_stopwatch(
    launches: Sequence[Callable[[int], float]],
    portion_count: int,
    rays: int,
    options: StudyOptions,
    report: Reporter,
    stage: str,
) -> TreeTimes:
    """Time launches that trace the same number of rays."""
    timings = measure(
        launches,
        portions=portion_count,
        seconds=options.seconds,
        standard_error=options.standard_error,
        progress=functools.partial(report, stage),
    )
    ns = timings.estimate / rays * 1e9
    return TreeTimes(
        ns=ns.tolist(),
        error=timings.relative_error.tolist(),
        timing=Timing(
            rounds=len(timings.seconds),
            complete=timings.complete,
            rays=rays,
            portions=portion_count,
        ),
    )


def timed_rays(rays: RaySet, lanes: Lanes, options: StudyOptions) -> RaySet:
    """The rays that are timed: all, or with one lane per packet every k-th."""
    step = -(-len(rays) // options.scalar_rays) if lanes == "scalar" else 1
    return rays.select(slice(None, None, step))


def portions(rays: RaySet, scene: Scene, lanes: Lanes, options: StudyOptions) -> list[Tracer]:
    """Split rays into runs of neighbours that are long enough to be timed; at most eight."""
    count = min(max(len(rays) // _PORTION[lanes], 1), 8)
    ends = np.linspace(0, len(rays), count + 1).astype(int)
    scale = float(unit_scale(scene.triangles))
    return [
        Tracer(rays.select(slice(begin, end)), scale, lanes, cull=options.cull)
        for begin, end in itertools.pairwise(ends)
    ]


def launch_of(tracers: list[Tracer], tree: Tree, scene: Scene) -> Callable[[int], float]:
    """Return what traces a portion of the rays through a tree and tells its kernel seconds."""
    return functools.partial(_launch, tracers, make_records(tree, scene.triangles))


def _launch(tracers: list[Tracer], records: Records, portion: int) -> float:
    return tracers[portion].run(records)[1]
