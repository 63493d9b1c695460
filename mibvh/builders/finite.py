"""`finite`: a tree for the rays that are traced.

Builders since MacDonald and Booth (1990) take a box to be met by a share of rays in proportion
to its surface area, which is so for lines that nothing stops. Rays start on surfaces and end at
the next one, and not everywhere alike. This builder traces a small set of them and minimises
what they cost: the sum over the nodes of ``C_n m(n)``, where the measure of a box is the share
of the segments that start in it or enter it, plus a little of its area
(:class:`mibvh.measures.Flux`). The derivation and what each part is worth are in
``docs/better-trees.md``; no publication is known.

Stages
------
1. Build the area tree (`sbvh`), and cut the rays where they hit in it.
2. Make the tables of the measure, and build `sbvh` by it as well. Where the rays cost less in
   `bbvh` than in `sbvh`, as in foliage, build `bbvh` by both measures, too.
3. Optimise each by a few batches of insertion (`bittner`), by the measure.
   Where the area's start is nearly the cheapest, try it with more weight of the area, too: in
   scenes of mixed scale there are parts that are finer than the tables.
4. Go on with the tree that the rays cost least in, counted: split and merge its references where
   that lowers the measure (:mod:`mibvh.builders.resplit`), and optimise to the end. Where the
   rays do not gain by splits, optimise without.
5. The leaf collapse goes by the same measure.

What it gains, it gains by knowing where the rays of these cameras go. For cameras that are not
known, ``unseen`` chooses the weight of the area by cross-validation over the viewpoints, and keeps
the area tree where the gain is within its error.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mibvh.builders.draft import Draft
from mibvh.builders.finish import draft_sah, finish
from mibvh.builders.insertion import InsertionOptions, moved, reinserted
from mibvh.builders.options import Options, option
from mibvh.builders.registry import Context, builder
from mibvh.builders.resplit import Resplitter, Rules
from mibvh.errors import MibvhError
from mibvh.files import read_arrays
from mibvh.measures import Area, Flux, Segments
from mibvh.measures.flux import MAX_SEGMENTS
from mibvh.measures.walk import counted_cost, cut_at_hits
from mibvh.triangles import F32, I32, Triangles

#: What cross-validation over viewpoints chooses the weight of the area from, on how many parts.
_WEIGHTS = (0.6, 1.2)
_FOLDS = 4
#: Where the area's start tree costs at most so much times the cheapest, the area is tried with so
#: much more weight: scenes of mixed scale have parts finer than the tables.
_NEARLY, _HEAVIER = 1.02, 4.0
#: Rays between surfaces begin this share of the diagonal off them.
_OFF = 1e-5

#: References that splitting is tried on, per triangle: those of greatest measure.
_TRIALS = 0.05

#: Rays for a triangle, and fewest and most rays, where their number is not given.
_DENSITY, _FEWEST, _MOST = 0.25, 30_000, 1_000_000

#: Where fewer camera rays than this share of them make a ray, as many more are traced as it takes.
_SPARSE = 0.25

#: What a ray file holds.
_ARRAYS = ("o", "d", "tmax", "viewpoint", "bounce", "source")
#: Origins, directions, greatest distances and viewpoints of rays, and whether any hit ends them.
_Rays = tuple[F32, F32, F32, I32, bool]


@dataclasses.dataclass(frozen=True, kw_only=True)
class FiniteOptions(Options):
    """Options of `finite`."""

    rays: str = option("", "ray file to build for, instead of rays of the scene's cameras")
    kind: str = option(
        "diffuse", "kind of the rays from the scene's cameras: diffuse, bounce2, shadow, ao, ..."
    )
    count: int = option(
        0,
        "camera rays whose hits send the rays that the tree is built for; 0: one for four "
        "triangles, but 30,000 to a million, and more where most of them miss",
        0,
        MAX_SEGMENTS,
    )
    planes: int = option(64, "planes per axis of the measure's tables", 4, 256)
    area_weight: float = option(
        0.1, "weight of the area; more is safer for rays that are not known", 0.0, 1e6
    )
    unseen: bool = option(
        False,
        "build for other viewpoints of the same scene: choose area_weight by cross-validation",
    )
    budget: float = option(
        1.0, "references added at most, per triangle; 0 splits none after `sbvh`", 0.0, 8.0
    )
    effort: int = option(
        2, "1: one start tree, no splitting after it; 2: two start trees; 3: more passes", 1, 3
    )
    seed: int = option(20_130_719, "of the rays; a study measures with others", 0, 2**31 - 1)


def surface_rays(triangles: Triangles, count: int, seed: int) -> _Rays:
    """Draw rays that leave surfaces: even by area, cosine-distributed, on a side at random."""
    rng = np.random.default_rng(seed)
    a, b, c = (triangles.corners[:, i].astype(np.float64) for i in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    share = np.cumsum(area) if area.sum() > 0 else np.arange(1.0, len(area) + 1)
    ids = np.searchsorted(share, rng.random(count) * share[-1], side="right")
    ids = np.minimum(ids, len(area) - 1)
    u, v = rng.random((2, count, 1))
    root = np.sqrt(u)
    points = (1 - root) * a[ids] + root * (1 - v) * b[ids] + root * v * c[ids]
    # A cosine lobe is a unit normal plus a point on the unit sphere.
    normal = normals[ids] / np.maximum(area[ids], 1e-300)[:, None]
    normal *= rng.choice([-1.0, 1.0], (count, 1))
    ball = rng.standard_normal((count, 3))
    d = normal + ball / np.linalg.norm(ball, axis=1, keepdims=True)
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-30)
    o = points + normal * (_OFF * triangles.diagonal)
    return (
        o.astype(np.float32),
        d.astype(np.float32),
        np.full(count, np.inf, np.float32),
        np.zeros(count, np.int32),
        False,
    )


def training_rays(
    triangles: Triangles, options: FiniteOptions, context: Context
) -> tuple[_Rays, str]:
    """Rays to build for, and a sentence on where they are from."""
    count = options.count or int(min(max(_FEWEST, _DENSITY * len(triangles)), _MOST))
    if options.rays:
        arrays, meta = read_arrays(options.rays, "ray set", _ARRAYS)
        if meta.get("digest") not in (None, triangles.digest):
            raise MibvhError(
                f"{options.rays}: the rays were made for another geometry than {triangles.name}"
            )
        step = max(1, -(-len(arrays["o"]) // count))
        o, d, tmax, viewpoint = (arrays[name][::step] for name in _ARRAYS[:4])
        return (o, d, tmax, viewpoint, bool(meta.get("occlusion"))), f"rays of {options.rays}"
    trace = getattr(context.source, "few_rays", None)
    if trace is not None:
        rays = trace(count, options.seed, options.kind)
        if not options.count and 0 < len(rays) < _SPARSE * count:
            rays = trace(min(count * count // len(rays), _MOST), options.seed, options.kind)
        said = f"{options.kind} rays of {len(np.unique(rays.viewpoint))} viewpoints"
        return (rays.o, rays.d, rays.tmax, rays.viewpoint, rays.occlusion), said
    said = (
        "rays between surfaces, as there is no scene with cameras: worth hardly more than the "
        "area; hand the scene to the build"
    )
    return surface_rays(triangles, count, options.seed), said


@dataclasses.dataclass(frozen=True)
class _Tried:
    """A tree on the way: what it started from, by which measure, and what the rays cost in it."""

    start: str
    measure: Flux
    draft: Draft
    cost: float

    def with_draft(self, draft: Draft, cost: float) -> _Tried:
        return dataclasses.replace(self, draft=draft, cost=cost)


class _Search:
    """One tree for one measure, from whichever start tree is best."""

    def __init__(self, triangles: Triangles, options: FiniteOptions, context: Context) -> None:
        self.triangles, self.options, self.context = triangles, options, context
        self.common: dict[str, Any] = {
            name: getattr(options, name) for name in ("c_inner", "c_tri", "max_leaf")
        }
        # Beyond, a batch gains less than local minima differ.
        stop: dict[str, Any] = {"tolerance": 1e-4, "patience": 5} if options.effort < 3 else {}
        self.insertion = InsertionOptions(**self.common, **stop)
        # Ten batches gain 19 parts in 20: enough to tell which start is better.
        self.roughly = InsertionOptions(**self.common, tolerance=1e-3, patience=1)
        self.by_area = dataclasses.replace(context, measure=Area())
        self.start = self.by_area.start(triangles, "sbvh", options)
        self.scale = self.start.references.scale

    def cost(self, draft: Draft, segments: Segments) -> float:
        """Counted cost of segments in the tree of a draft."""
        tree = finish(
            draft, **self.common, meta={"triangles": len(self.triangles)}, measure=draft.measure
        )
        return counted_cost(
            tree, self.triangles, segments, self.options.c_inner, self.options.c_tri
        )

    def best(
        self, measure: Flux, segments: Segments, options: FiniteOptions
    ) -> tuple[Draft, dict[str, Any]]:
        """Find the best tree by a measure, and say how it came about."""
        flux = self._by(measure).start(self.triangles, "sbvh", options)
        splits = merges = 0
        if options.effort == 1:
            draft = self._moved(flux, self.insertion, measure)
            found = _Tried("flux", measure, draft, self.cost(draft, segments))
        else:
            found = self._started(flux, measure, segments, options)
        for _ in range(options.effort - 1):
            draft, split, merged = self._resplit(found.draft, found.measure)
            cost = self.cost(draft, segments)
            if cost >= found.cost:
                found = self._without_splits(found, segments)
                break
            found = found.with_draft(draft, cost)
            splits, merges = splits + split, merges + merged
        return found.draft, {
            "start": found.start,
            "split": splits,
            "merged": merges,
            "cost": found.cost,
            "area_weight": found.measure.area_weight,
        }

    def _started(
        self, flux: Draft, measure: Flux, segments: Segments, options: FiniteOptions
    ) -> _Tried:
        """Optimise each start by a few batches; return the one that the rays cost least in."""
        starts = {"flux": flux, "area": self.start}
        whole = self.by_area.start(self.triangles, "bbvh", options)
        if self.cost(whole, segments) < self.cost(self.start, segments):
            starts["area, bbvh"] = whole
            starts["flux, bbvh"] = self._by(measure).start(self.triangles, "bbvh", options)

        def rough(name: str, measure: Flux) -> _Tried:
            draft = self._moved(starts[name], self.roughly, measure)
            return _Tried(name, measure, draft, self.cost(draft, segments))

        best, area = rough("flux", measure), (np.inf, "")
        for name in list(starts)[1:]:  # of the trees on the way only the best is kept
            found = rough(name, measure)
            if name.startswith("area"):
                area = min(area, (found.cost, name))
            best = min(best, found, key=lambda one: one.cost)
        if area[0] < _NEARLY * best.cost:
            heavier = measure.with_weight(_HEAVIER * measure.area_weight)
            best = min(best, rough(area[1], heavier), key=lambda one: one.cost)
        return best

    def _without_splits(self, found: _Tried, segments: Segments) -> _Tried:
        draft = self._moved(found.draft, self.insertion, found.measure)
        cost = self.cost(draft, segments)
        return found.with_draft(draft, cost) if cost < found.cost else found

    def _by(self, measure: Flux) -> Context:
        return dataclasses.replace(self.context, measure=measure)

    def _moved(self, start: Draft, insertion: InsertionOptions, measure: Flux) -> Draft:
        context = self._by(measure)
        compiled = context.compiled_measure(start.references.scale)
        return dataclasses.replace(moved(start, insertion, context), measure=compiled)

    def _resplit(self, draft: Draft, measure: Flux) -> tuple[Draft, int, int]:
        context = self._by(measure)
        compiled = context.compiled_measure(self.scale)
        rules = Rules(budget=self.options.budget, trials=_TRIALS)
        state = Resplitter(self.triangles, draft, self.options, compiled, rules)
        splits, merges = state.split(context), state.merge(context)
        return self._moved(state.draft({}), self.insertion, measure), splits, merges

    def area_tree(self) -> Draft:
        """The best combination that knows no rays: `bittner` from `sbvh`, by area."""
        return reinserted(self.start, InsertionOptions(**self.common), self.by_area)

    def weight_for_unseen(self, segments: Segments) -> tuple[float, dict[str, list[float]]]:
        """Choose the weight of the area by cross-validation; infinite: the area alone.

        Each viewpoint in turn is left out (of many, a fourth of them), a tree is built for the
        others, and its cost for the one left out is taken relative to the area tree's. A weight
        is worth something where the mean over the viewpoints is below 1 by more than its
        standard error.

        Returns
        -------
        weight : float
        relative : dict of str to list of float
            By weight, the costs of the viewpoints left out.
        """
        viewpoints = np.unique(segments.viewpoint)
        folds = min(len(viewpoints), _FOLDS)
        if folds < 2:
            return np.inf, {}
        fold = np.searchsorted(viewpoints, segments.viewpoint) % folds
        quick = dataclasses.replace(self.options, effort=1)
        relative: dict[float, list[float]] = {weight: [] for weight in _WEIGHTS}
        area = self.area_tree()
        for left_out in range(folds):
            seen, other = segments.select(fold != left_out), segments.select(fold == left_out)
            alone = self.cost(area, other)
            for weight in _WEIGHTS:
                measure = Flux(seen, self.options.planes, weight)
                draft, _ = self.best(measure, seen, quick)
                relative[weight].append(self.cost(draft, other) / alone)
        at_most = {
            weight: np.mean(found) + np.std(found, ddof=1) / np.sqrt(folds)
            for weight, found in relative.items()
        }
        chosen = min(at_most, key=at_most.__getitem__)
        said = {str(weight): found for weight, found in relative.items()}
        return chosen if at_most[chosen] < 1.0 else np.inf, said


@builder(
    "finite",
    summary="the tree that a small traced ray set costs least: `sbvh`, insertion and splits by "
    "the share of rays that touch a box",
    source="mibvh, docs/better-trees.md",
    options=FiniteOptions,
    traces=True,
)
def finite(triangles: Triangles, options: FiniteOptions, context: Context) -> Draft:
    """Build for the rays of the scene's cameras, or those that are given."""
    search = _Search(triangles, options, context)
    first = finish(search.start, **search.common, meta={"triangles": len(triangles)})
    rays, said = training_rays(triangles, options, context)
    segments = cut_at_hits(first, triangles, *rays)
    weight = options.area_weight
    left_out: dict[str, list[float]] = {}
    if options.unseen:
        weight, left_out = search.weight_for_unseen(segments)
    if np.isinf(weight):
        draft = search.area_tree()
        report: dict[str, Any] = {"start": "area", "split": 0, "merged": 0}
        report |= {"cost": search.cost(draft, segments), "area_weight": "area alone"}
    else:
        draft, report = search.best(Flux(segments, options.planes, weight), segments, options)
    if left_out:
        report["left_out"] = left_out
    report = {
        **report,
        "rays": said,
        "ray_count": len(segments),
        "seed": options.seed,
        "references": len(draft.references),
        "start_cost": search.cost(search.start, segments),
        "sah": draft_sah(draft, **search.common),
    }
    return dataclasses.replace(draft, report=report)
