"""All checks of one tree."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mibvh.audit.hits import (
    check_brute_force,
    check_mitsuba,
    check_same_counts,
    check_same_hits,
    some_rays,
)
from mibvh.audit.overlap import check_epo, check_sah
from mibvh.audit.record import Audit, Check
from mibvh.metrics.epo import epo
from mibvh.metrics.sah import sah
from mibvh.rays import RaySet, diffuse_rays
from mibvh.scene import load
from mibvh.traversal.trace import Hits, Tracer, make_records, unit_scale
from mibvh.tree import Tree
from mibvh.triangles import Triangles

#: Rays that are traced once more with one lane of each packet.
_SCALAR_RAYS = 4096
#: Rays of each viewpoint, if the caller has none.
_WIDTH, _HEIGHT = 160, 120


def audit(
    scene: Any,
    tree: Tree,
    rays: RaySet | None = None,
    *,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Audit:
    """Check a tree, its figures, and the rays traced through it.

    Each number is held against another path through the code: the tree against its invariants,
    SAH against a sum over boxes, EPO against points on the surfaces, hits against brute force and
    Mitsuba, one lane of a packet against all, counts against a second launch.

    Parameters
    ----------
    scene : Scene, or what :func:`mibvh.load` takes
    tree : Tree
        Of any builder, or the caller's own.
    rays : RaySet, optional
        Diffuse rays from the scene's cameras by default.
    seed : int
        Of points and samples.
    progress : callable, optional
        Called as ``progress(stage, done)``.

    Returns
    -------
    Audit
        Of an unsound tree, it has nothing but the faults: no other number would mean a thing.

    Raises
    ------
    MibvhError
        If the scene cannot be loaded, or tree or rays belong to another geometry.
    """
    report = progress or (lambda stage, done: None)
    scene = load(scene)
    triangles = scene.triangles
    name = str(tree.meta.get("builder", "tree"))
    report("tree", 0.0)
    sound = check_tree(tree, triangles)
    if not sound.passed:
        return Audit(name, (sound,))
    tree.check_matches(triangles)
    report("EPO", 0.1)
    checks = [
        sound,
        check_sah(tree, sah(tree)),
        check_epo(tree, triangles, epo(tree, triangles), seed),
    ]
    report("rays", 0.4)
    rays = rays or diffuse_rays(scene, width=_WIDTH, height=_HEIGHT, samples=1, seed=seed)
    report("hits", 0.6)
    records = make_records(tree, triangles)
    scale = float(unit_scale(triangles))
    tracer = Tracer(rays, scale)
    hits, again = tracer.hits(records), tracer.hits(records)
    chosen = some_rays(len(rays), _SCALAR_RAYS, seed)
    some = rays.select(chosen)
    simd, scalar = (Tracer(some, scale, lanes).hits(records) for lanes in ("simd", "scalar"))
    report("brute force", 0.8)
    return Audit(
        name,
        (
            *checks,
            check_self_hits(rays, hits),
            check_brute_force(triangles, rays, hits, seed),
            check_mitsuba(scene, rays, hits, seed),
            check_same_counts(hits, again, "counts"),
            check_same_hits(triangles, some, simd, scalar, "lanes: hits"),
            check_same_counts(simd, scalar, "lanes: counts"),
        ),
    )


def check_tree(tree: Tree, triangles: Triangles) -> Check:
    """Check the invariants of a tree, coverage of split triangles included."""
    faults = tree.validate(triangles)
    return Check.of("tree", len(faults), 0, 0, faults[0] if faults else "invariants")


def check_self_hits(rays: RaySet, hits: Hits) -> Check:
    """Count rays that hit the triangle they leave: a flat one cannot be."""
    own = int(np.count_nonzero((rays.source >= 0) & (rays.source == hits.triangle)))
    return Check.of(
        "self hits", own, 0, 1e-4 * len(rays), f"of {len(rays):,} rays hit the triangle they leave"
    )
