"""From a builder's name to a tree: options, the builder, the shared finishing."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mibvh.builders.draft import Draft
from mibvh.builders.finish import finish
from mibvh.builders.options import Options
from mibvh.builders.registry import Builder, Context, get, of_paper
from mibvh.builders.sharing import spared
from mibvh.errors import MibvhError
from mibvh.measures import Area, Measure
from mibvh.nodes import PAPER_COSTS
from mibvh.tree import Tree
from mibvh.triangles import Triangles, as_triangles
from mibvh.version import __version__

#: Builders that have run in this process, so that nothing of theirs is left to compile.
_warm: set[str] = set()


def next_to_nothing() -> Triangles:
    """Triangles that builders run on once, so that they are compiled."""
    corners = np.random.default_rng(0).random((24, 3, 3))
    return Triangles(corners.astype(np.float32), "warm-up")


def warm_up(name: str, progress: Callable[[str, float], None] = lambda stage, done: None) -> None:
    """Run a builder of this package, or what finishes a user's draft, once on next to nothing.

    So the seconds reported for a tree hold no compilation, nor the loading of compiled code.
    """
    if name in _warm:
        return
    progress("compiling", 0.0)
    triangles, entry = next_to_nothing(), get(name)
    if entry.bundled:
        draft = entry.draft(triangles, entry.options(), Context())
    else:
        draft = Draft.from_nested(np.arange(len(triangles)), triangles)
    finish(draft, **PAPER_COSTS, max_leaf=8, meta={"triangles": len(triangles)})
    _warm.add(name)


def _over_parts(entry: Builder, triangles: Triangles, options: Options, context: Context) -> Draft:
    """Run a builder over the parts that splitting triangles up front makes."""
    from mibvh.builders.splitting import as_boxes, over_parts, presplit  # compiled code

    references = presplit(triangles, options.presplit)
    plain = dataclasses.replace(options, presplit=0.0)
    return over_parts(entry.draft(as_boxes(references), plain, context), references, entry.name)


def origin_of(
    builder: str, options: Options, triangles: Triangles, report: Mapping[str, Any]
) -> dict[str, Any]:
    """What a tree's ``meta`` says of where it comes from."""
    return {
        "builder": builder,
        "options": dataclasses.asdict(options),
        "triangles": len(triangles),
        "digest": triangles.digest,
        "c_inner": options.c_inner,
        "c_tri": options.c_tri,
        "report": dict(report),
        "mibvh": __version__,
    }


def build(
    triangles: Any,
    builder: str = "bbvh",
    *,
    progress: Callable[[str, float], None] | None = None,
    measure: Measure | None = None,
    **options: Any,
) -> Tree:
    """Build a tree.

    Parameters
    ----------
    triangles : Triangles, Scene, (N, 3, 3) array, or a name or file that `load` takes
        The geometry.
    builder : str
        A name from :func:`names`.
    progress : callable, optional
        Called as ``progress(stage, done)`` with ``done`` from 0 to 1.
    measure : Measure, optional
        What a box costs: ``Area()``, as in the papers, by default; ``Flux(segments)``, or one of
        your own (:mod:`mibvh.measures`).
    **options
        The builder's options; ``max_leaf``, ``c_inner`` and ``c_tri`` are common to all.

    Returns
    -------
    Tree
        The same bits for the same input and options, on any number of threads.

    Raises
    ------
    MibvhError
        For an unknown builder or an impossible option, or where a builder of the user's own made
        an invalid tree.
    """
    source, triangles = triangles, as_triangles(triangles)
    entry = get(builder)
    chosen = entry.options_of(options)
    entry.check_room(triangles, chosen)
    context = Context(progress or Context.progress, measure or Area(), source)
    warm_up(builder, context.progress)
    context.progress("building", 0.0)
    started, before = time.perf_counter(), spared()
    draft: Draft | Tree
    if chosen.presplit > 0:
        draft = _over_parts(entry, triangles, chosen, context)
    else:
        draft = entry.run(triangles, chosen, context)
    report = draft.meta.get("report", {}) if isinstance(draft, Tree) else draft.report
    meta = origin_of(builder, chosen, triangles, report)
    if isinstance(draft, Tree):
        tree = draft.replace(meta=meta)
    else:
        tree = finish(
            draft,
            c_inner=chosen.c_inner,
            c_tri=chosen.c_tri,
            max_leaf=chosen.max_leaf,
            meta=meta,
            measure=draft.measure or context.compiled_measure(draft.references.scale),
        )
    meta = {**tree.meta, "build_seconds": time.perf_counter() - started + spared() - before}
    # The tests see to it that the paper's builders make sound trees.
    if not of_paper(entry) and (violations := tree.validate(triangles)):
        raise MibvhError(f"builder {builder} made an invalid tree: {'; '.join(violations)}")
    return tree.replace(meta=meta)
