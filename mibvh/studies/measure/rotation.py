"""The rotation experiment: a scene and its rays rotated 45 degrees about (1, 1, 1).

The paper's additional test (slides, "Rotated scenes"): boxes fit worse, so every cost grows, but
that of rays that begin and end in the scene grows more than SAH says. The stored rays are rotated
with the triangles, so both frames trace the same paths; all trees are built anew, but for those
that were given.
"""

from __future__ import annotations

import dataclasses
import functools
import math

from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.measure.counts import RayCounter
from mibvh.studies.measure.memory import make_room
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.store import key_of
from mibvh.studies.measure.times import Frame, TreeTimes, time_frames
from mibvh.studies.measure.trees import study_trees
from mibvh.studies.measure.warps import WarpRules
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import Result, Timing, TreeRow
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.trace import Tracer
from mibvh.triangles import F64, rotation_about

AXIS = (1.0, 1.0, 1.0)
DEGREES = 45.0


@dataclasses.dataclass(frozen=True)
class RotationResult(Result, experiment="rotation"):
    """A scene's trees in the rotated frame.

    Attributes
    ----------
    axis : tuple of float
    degrees : float
    digest : str
        Hash of the rotated triangles.
    same_hits : float
        Share of the rays that hit the same triangle in both frames.
    trees : list of TreeRow
        Of the builders; given trees are not among them. Without SIMD times, and with
        ``scalar_ns_before``: the time of the tree of the given
        frame in the same rounds of the stopwatch.
    timing : Timing
    """

    axis: tuple[float, ...]
    degrees: float
    digest: str
    same_hits: float
    trees: list[TreeRow]
    timing: Timing


@dataclasses.dataclass(frozen=True)
class _SameHits:
    share: float


@dataclasses.dataclass(eq=False)
class _Rotated(Scene):
    """A rotated scene whose cameras stay in place; the rays made from them are rotated.

    Attributes
    ----------
    before : Scene
    matrix : (3, 3) float64
    """

    before: Scene | None = None
    matrix: F64 | None = None

    def few_rays(self, count: int, seed: int, kind: str = "diffuse") -> RaySet:
        """As :meth:`mibvh.Scene.few_rays`."""
        assert self.before is not None
        assert self.matrix is not None
        found: RaySet = self.before.few_rays(count, seed, kind)
        return found.rotated(self.matrix, self.triangles)


def rotated(scene: Scene, rays: RaySet) -> tuple[Scene, RaySet]:
    """Rotate a scene's triangles together with its rays."""
    matrix = rotation_about(AXIS, DEGREES)
    triangles = dataclasses.replace(scene.triangles.rotated(matrix), name=scene.name)
    moved = rays.rotated(matrix, triangles)
    facts = {field.name: getattr(scene, field.name) for field in dataclasses.fields(Scene)}
    facts["triangles"] = triangles
    return _Rotated(**facts, before=scene, matrix=matrix), moved


def rotation_experiment(setting: Setting, report: Reporter) -> RotationResult:
    """Build the trees of the rotated scene, compute their metrics, and count and time the rays."""
    options, store = setting.options, setting.store
    scene, rays = rotated(setting.scene, setting.rays)
    # A tree that was given cannot be built anew.
    sources = {name: source for name, source in setting.sources.items() if source.given is None}
    if not sources:
        return _nothing(scene)
    counter = RayCounter(scene, rays, options.cull, WarpRules(**options.warps()))
    trees, rows = study_trees(sources, counter, store, report.part(0.0, 1.1))
    if not rows:
        return _nothing(scene)
    names = list(trees)
    before = Frame(setting.scene, setting.rays, setting.trees, names)
    after = Frame(scene, rays, trees, names)
    keys = {
        "before": [setting.trees.digest(name) for name in names],
        "after": [trees.digest(name) for name in names],
        "rays": [setting.rays.digest, rays.digest],
    }
    times_key = key_of(
        __name__, **keys, machine=setting.machine, options=options.stopwatch("scalar")
    )
    make_room(setting.scene)
    make_room(scene)
    # Both frames in the same rounds, so that drift cancels in the factors.
    make_times = functools.partial(
        time_frames, [before, after], "scalar", options, report.part(0.6, 0.4)
    )
    found = store.record(f"rotation-{times_key}", TreeTimes, make_times)
    same = store.record(
        f"same-{key_of(__name__, **keys)}", _SameHits, lambda: _same_hits(before, after)
    )
    count = len(rows)
    timed = zip(rows, found.ns[:count], found.ns[count:], found.error[count:], strict=True)
    return RotationResult(
        axis=AXIS,
        degrees=DEGREES,
        digest=scene.triangles.digest,
        same_hits=same.share,
        trees=[
            row.with_values(scalar_ns_before=old, scalar_ns=new, scalar_error=error)
            for row, old, new, error in timed
        ],
        timing=found.timing,
    )


def _nothing(scene: Scene) -> RotationResult:
    """Return the result if no tree can be rebuilt."""
    timing = Timing(rounds=0, complete=False, rays=0, portions=0)
    return RotationResult(AXIS, DEGREES, scene.triangles.digest, math.nan, [], timing)


def _same_hits(before: Frame, after: Frame) -> _SameHits:
    """Share of the rays that hit the same triangle, or nothing, in both frames."""
    hits = []
    for frame in (before, after):
        tracer = Tracer(frame.rays, float(unit_scale(frame.scene.triangles)))
        tree = frame.trees[frame.names[0]]
        outputs, _ = tracer.run(make_records(tree, frame.scene.triangles))
        hits.append(tracer.fetch(outputs.triangle))
    return _SameHits(float((hits[0] == hits[1]).mean()))
