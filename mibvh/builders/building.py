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

#: Builders that have run in this process, and therefore are compiled.
_warm: set[str] = set()


def next_to_nothing() -> Triangles:
    """Return 24 random triangles, to compile builders on."""
    corners = np.random.default_rng(0).random((24, 3, 3))
    return Triangles(corners.astype(np.float32), "warm-up")


def warm_up(name: str, progress: Callable[[str, float], None] = lambda stage, done: None) -> None:
    """Compile a builder by running it once on a few triangles.

    Otherwise the build time of the first tree would include compilation, or loading compiled code.
    Of a user's builder only the shared finishing is compiled.

    Parameters
    ----------
    name : str
        Name of a builder.
    progress : callable
        Called as ``progress("compiling", 0.0)`` if there is anything to do.
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
    """Run a builder over the references that splitting triangles beforehand makes."""
    from mibvh.builders.splitting import as_boxes, over_parts, presplit  # compiled code

    references = presplit(triangles, options.presplit)
    plain = dataclasses.replace(options, presplit=0.0)
    return over_parts(entry.draft(as_boxes(references), plain, context), references, entry.name)


def draft_of(
    entry: Builder, triangles: Triangles, options: Options, context: Context
) -> Draft | Tree:
    """Run a builder, over split triangles if its options say so; a finished tree stays one."""
    if options.presplit > 0:
        return _over_parts(entry, triangles, options, context)
    return entry.run(triangles, options, context)


def origin_of(
    builder: str, options: Options, triangles: Triangles, report: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the ``meta`` of a tree: builder, options, triangles, cost constants and report."""
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
        The geometry. A builder that traces rays needs a scene.
    builder : str
        A name from :func:`names`.
    progress : callable, optional
        Called as ``progress(stage, done)`` with ``done`` from 0 to 1.
    measure : Measure, optional
        The cost of a box: by default ``Area()``, as in the papers; ``Flux(segments)``, or your own
        (:mod:`mibvh.measures`).
    **options
        The builder's options; ``max_leaf``, ``c_inner`` and ``c_tri`` are common to all.

    Returns
    -------
    Tree
        The same bits for the same input and options, on any number of threads.

    Raises
    ------
    MibvhError
        If the builder is unknown, an option is impossible, memory is too small, or a user's
        builder fails or makes an invalid tree.
    """
    source, triangles = triangles, as_triangles(triangles)
    entry = get(builder)
    chosen = entry.options_of(options)
    entry.check_room(triangles, chosen)
    context = Context(progress or Context.progress, measure or Area(), source)
    warm_up(builder, context.progress)
    context.progress("building", 0.0)
    started, before = time.perf_counter(), spared()
    draft = draft_of(entry, triangles, chosen, context)
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
    # The paper's builders are validated by the tests instead.
    if not of_paper(entry) and (violations := tree.validate(triangles)):
        raise MibvhError(f"builder {builder} made an invalid tree: {'; '.join(violations)}")
    return tree.replace(meta=meta)
