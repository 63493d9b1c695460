"""Times of a scene's trees in either lane mode."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.stopwatch import CLOCKS, SHORTEST, Timings, measure
from mibvh.studies.measure.store import key_of
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import Timing
from mibvh.traversal.records import Records, make_records, unit_scale
from mibvh.traversal.trace import LaunchSeconds, Tracer
from mibvh.traversal.trimmed import trimmed
from mibvh.tree import Tree
from mibvh.variant import backend

Lanes = Literal["scalar", "simd"]
LANES: tuple[Lanes, ...] = ("scalar", "simd")
#: Smallest number of rays in a timed portion, which takes some hundredths of a second.
_PORTION = {"scalar": 8192, "simd": 32768}
_MOST_PORTIONS = 8
#: How often the rays of a small set may be repeated to fill a launch. With more copies, the times
#: would depend on these few rays more than on the tree, and a GPU would not be filled.
_MOST_COPIES = {"llvm": 256, "cuda": 4096}
#: If all records together have more bytes, only the pages that the rays read are kept in memory.
LARGE = 1e9

Launch = Callable[[int], LaunchSeconds]


@dataclasses.dataclass(frozen=True)
class TreeTimes:
    """Times of several trees.

    Attributes
    ----------
    ns, error : list of float
        Nanoseconds per ray of each tree, and their relative standard errors; NaN if the rays
        are too few to be timed.
    ns_by_clock : dict of str to list of float
        Nanoseconds per ray by each clock of the stopwatch.
    timing : Timing
    """

    ns: list[float]
    error: list[float]
    ns_by_clock: dict[str, list[float]]
    timing: Timing


@dataclasses.dataclass(frozen=True)
class Frame:
    """Trees of a scene, and the rays that they are timed with.

    Attributes
    ----------
    scene : Scene
    rays : RaySet
    trees : mapping of str to Tree
        Trees by name; accessed one at a time.
    names : sequence of str
        Names of the trees to time, in order.
    """

    scene: Scene
    rays: RaySet
    trees: Mapping[str, Tree]
    names: Sequence[str]


def times(
    trees: Mapping[str, Tree],
    scene: Scene,
    rays: RaySet,
    lanes: Lanes,
    options: StudyOptions,
    report: Reporter,
    style: str = "single",
) -> TreeTimes:
    """Time all trees of a scene, and the first and the last one twice to estimate errors.

    If two builders made identical trees, the difference of their times is an error, too.

    Parameters
    ----------
    trees : mapping of str to Tree
        Trees by name; accessed one at a time.
    scene : Scene
    rays : RaySet
    lanes : "scalar" or "simd"
    options : StudyOptions
    report : Reporter
    style : str
        Style of traversal, from :data:`mibvh.traversal.styles.STYLES`.

    Returns
    -------
    TreeTimes
        In the order of ``trees``.
    """
    # The second timing of a tree has its own records, which are elsewhere in memory.
    names = list(trees)
    frame = Frame(scene, rays, trees, [*names, names[0], names[-1]])
    count = len(trees)
    digests = [trees[name].digest for name in names[:count]]
    alike = [(digests.index(own), i) for i, own in enumerate(digests) if own in digests[:i]]
    same = [(0, count), (count - 1, count + 1), *alike]
    found = time_frames([frame], lanes, options, report, same, style)
    return TreeTimes(
        found.ns[:count],
        found.error[:count],
        {clock: ns[:count] for clock, ns in found.ns_by_clock.items()},
        found.timing,
    )


def kept_times(setting: Setting, lanes: Lanes, style: str, report: Reporter) -> TreeTimes:
    """Return the times of a scene's trees: from the store, or measured and kept."""
    options, trees = setting.options, setting.trees
    key = key_of(
        __name__,
        trees=[trees.digest(name) for name in trees],
        rays=setting.rays.digest,
        lanes=lanes,
        style=style,
        machine=setting.machine,
        options=options.stopwatch(lanes),
    )
    make = functools.partial(
        times, trees, setting.scene, setting.rays, lanes, options, report, style
    )
    return setting.store.record(f"timing-{key}", TreeTimes, make)


def time_frames(
    frames: Sequence[Frame],
    lanes: Lanes,
    options: StudyOptions,
    report: Reporter,
    same: Sequence[tuple[int, int]] = (),
    style: str = "single",
) -> TreeTimes:
    """Time the trees of one or more frames in the same rounds.

    Parameters
    ----------
    frames : sequence of Frame
        All with the same number of rays.
    lanes : "scalar" or "simd"
    options : StudyOptions
    report : Reporter
    same : sequence of pairs of int
        Pairs of identical trees, as indices over the trees of all frames.
    style : str
        Style of traversal, from :data:`mibvh.traversal.styles.STYLES`.

    Returns
    -------
    TreeTimes
        Of the trees of all frames, in order.
    """
    stage = f"time {lanes}" if style == "single" else f"time {style} {lanes}"
    report(stage, 0.0)
    chosen = [timed_rays(frame.rays, lanes, options) for frame in frames]
    count = len(chosen[0])
    trees = sum(len(frame.names) for frame in frames)
    prepared = []
    for i, (frame, some) in enumerate(zip(frames, chosen, strict=True)):
        tracer = _tracers(frame.scene, some, 1, lanes, options, style)[0]
        # The first frame decides how the rays are split; the stopwatch warms all trees up.
        prepared.append([_prepared(frame, name, tracer, trees, i == 0) for name in frame.names])
    shortest = min(seconds for _, seconds in prepared[0])
    copies, portions = _sizes(shortest, count, lanes)
    if copies > _MOST_COPIES[backend()]:
        none = [math.nan] * trees
        timing = Timing(rounds=0, complete=False, rays=count, portions=0)
        return TreeTimes(none, none, dict.fromkeys(CLOCKS, none), timing)
    launches: list[Launch] = []
    for frame, some, found in zip(frames, chosen, prepared, strict=True):
        tracers = _tracers(frame.scene, repeated(some, copies), portions, lanes, options, style)
        launches += [functools.partial(_launch, tracers, records) for records, _ in found]
    timings = measure(
        launches,
        portions=portions,
        seconds=options.seconds,
        standard_error=options.standard_error,
        same=same,
        progress=functools.partial(report, stage),
    )
    return _per_ray(timings, count, copies, portions)


def _per_ray(timings: Timings, rays: int, copies: int, portions: int) -> TreeTimes:
    scale = 1e9 / (rays * copies)
    clock = timings.clock
    differences = timings.same_tree_differences(clock)
    return TreeTimes(
        ns=(timings.estimate * scale).tolist(),
        error=timings.relative_error.tolist(),
        ns_by_clock={c: (timings.estimate_by(c) * scale).tolist() for c in CLOCKS},
        timing=Timing(
            rounds=timings.rounds,
            complete=timings.complete,
            rays=rays,
            portions=portions,
            copies=copies,
            clock=clock,
            repeat_difference=float(differences[0]) if len(differences) else math.nan,
        ),
    )


def _prepared(
    frame: Frame, name: str, tracer: Tracer, trees: int, timed: bool
) -> tuple[Records, float]:
    """Return the records of one tree, and the seconds of a launch of all rays, if it is timed."""
    records = make_records(frame.trees[name], frame.scene.triangles, tracer.layout)
    # Without compilation, so that the first launch will do.
    seconds = tracer.run(records)[1].kernel if timed else math.nan
    if records.layout == "binary" and backend() == "llvm" and trees * records.size > LARGE:
        records = trimmed(records, tracer)
    return records, seconds


def _sizes(shortest: float, rays: int, lanes: Lanes) -> tuple[int, int]:
    """Return how often to repeat the rays, and into how many portions to split them.

    The fastest tree decides: each of its launches is to be long enough for the stopwatch. All rays
    take it the shortest seconds.
    """
    if shortest < SHORTEST:
        return math.ceil(SHORTEST / max(shortest, 1e-9)), 1
    most = min(rays // _PORTION[lanes], int(shortest / SHORTEST), _MOST_PORTIONS)
    return 1, max(most, 1)


def repeated(rays: RaySet, copies: int) -> RaySet:
    """Return the rays several times over, one set after the other."""
    return rays if copies == 1 else rays.select(np.tile(np.arange(len(rays)), copies))


def timed_rays(rays: RaySet, lanes: Lanes, options: StudyOptions) -> RaySet:
    """Return the rays to time: all, or every k-th with one lane per packet."""
    step = -(-len(rays) // options.scalar_rays) if lanes == "scalar" else 1
    return rays.select(slice(None, None, step))


def _tracers(
    scene: Scene, rays: RaySet, portions: int, lanes: Lanes, options: StudyOptions, style: str
) -> list[Tracer]:
    """Split rays into contiguous portions, each ready to launch."""
    ends = np.linspace(0, len(rays), portions + 1).astype(int)
    scale = float(unit_scale(scene.triangles))
    return [
        Tracer(rays.select(slice(begin, end)), scale, lanes, style=style, cull=options.cull)
        for begin, end in itertools.pairwise(ends)
    ]


def _launch(tracers: list[Tracer], records: Records, portion: int) -> LaunchSeconds:
    return tracers[portion].run(records)[1]
