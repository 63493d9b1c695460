"""All checks of one tree."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mibvh.audit.hits import check_brute_force, check_mitsuba, check_same_hits, some_rays
from mibvh.audit.overlap import check_epo, check_sah
from mibvh.audit.record import Audit, Check
from mibvh.collapsing import collapse
from mibvh.errors import MibvhError
from mibvh.metrics.epo import epo
from mibvh.metrics.sah import sah
from mibvh.ranges import check
from mibvh.rays import RaySet, diffuse_rays
from mibvh.rays.make import MOST_SELF_HITS
from mibvh.scene import load
from mibvh.traversal.agreement import lane_faults
from mibvh.traversal.trace import Hits, trace
from mibvh.traversal.wide_walk import walk_wide_tree
from mibvh.tree import Tree
from mibvh.triangles import Triangles
from mibvh.variant import backend, mitsuba_traces
from mibvh.wide_tree import WideTree

#: Rays that are traced in scalar lanes, and without Dr.Jit.
_LANE_RAYS = 1024
#: Rays of each viewpoint, if the caller has none.
_WIDTH, _HEIGHT = 160, 120


def audit(
    scene: Any,
    tree: Tree | WideTree,
    rays: RaySet | None = None,
    *,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Audit:
    """Check a tree, its figures, and the rays traced through it.

    Each number is compared with another path through the code: the tree against its invariants,
    SAH against a sum over boxes, EPO against points on the surfaces, hits against brute force and
    Mitsuba, SIMD lanes against scalar ones and a simulation without Dr.Jit, counts against a
    second launch; of occlusion rays, also which are blocked, against their closest hits. On a GPU
    the simulation is left out, and Mitsuba too where OptiX, by which it intersects there, is
    missing.

    Parameters
    ----------
    scene : Scene, or what :func:`mibvh.load` takes
    tree : Tree or WideTree
        Of any builder, or the caller's own. A wide tree is traced by the wide kernel, and held
        against a walk through it that is compiled by Numba.
    rays : RaySet, optional
        Diffuse rays from the scene's cameras by default.
    seed : int
        Of points and samples.
    progress : callable, optional
        Called as ``progress(stage, done)``.

    Returns
    -------
    Audit
        Of an invalid tree, it has nothing but the first fault: no other number would mean a thing.

    Raises
    ------
    MibvhError
        If the scene cannot be loaded, tree or rays belong to another geometry, the ray set is
        empty, or the seed is out of range.
    """
    check(seed=seed)
    report = progress or (lambda stage, done: None)
    scene = load(scene)
    triangles = scene.triangles
    name = str(tree.meta.get("builder", "tree"))
    report("tree", 0.0)
    sound = check_tree(tree, triangles)
    if not sound.passed:
        return Audit(name, (sound,))
    report("EPO", 0.1)
    figures = audit_figures(tree, triangles, sah(tree), epo(tree, triangles), seed)
    report("rays", 0.4)
    if rays is None:
        rays = diffuse_rays(scene, width=_WIDTH, height=_HEIGHT, samples=1, seed=seed)
    if not len(rays):
        raise MibvhError("an audit needs rays, and there are none in the set")
    report("hits", 0.6)
    hits = trace(tree, triangles, rays, repeats=1)
    traced = audit_hits(scene, tree, rays, hits, seed=seed)
    return Audit(name, (sound, *figures, *traced))


def audit_figures(
    tree: Tree | WideTree, triangles: Triangles, sah: float, epo: float, seed: int = 0
) -> tuple[Check, ...]:
    """Check the SAH and EPO of a valid tree."""
    return check_sah(tree, sah), check_epo(tree, triangles, epo, seed)


def audit_hits(
    scene: Any,
    tree: Tree | WideTree,
    rays: RaySet,
    hits: Hits,
    *,
    counted_cost: float | None = None,
    others: Hits | None = None,
    seed: int = 0,
) -> tuple[Check, ...]:
    """Check what tracing rays through a valid tree gave.

    Parameters
    ----------
    scene : Scene
    tree : Tree or WideTree
    rays : RaySet
    hits : Hits
        In SIMD lanes by the ``single`` style, or the ``wide`` one of a wide tree.
    counted_cost : float, optional
        As it was counted before; that of a second launch by default.
    others : Hits, optional
        The closest hits in another tree of the scene.
    seed : int
        Of the samples.

    Returns
    -------
    tuple of Check
        Of occlusion rays, brute force and Mitsuba judge the closest hits; which hit ends a ray
        depends on the order of the walk, so :func:`check_any_hit` holds those against these.
    """
    triangles = scene.triangles
    closest = trace(tree, triangles, rays, any_hit=False, repeats=1) if rays.occlusion else hits
    names = ("c_inner", "c_tri", "c_box")
    costs = {name: tree.meta[name] for name in names if name in tree.meta}
    again = trace(tree, triangles, rays, repeats=1) if counted_cost is None else hits
    first = hits.counted_cost(**costs) if counted_cost is None else counted_cost
    checks = [
        check_self_hits(rays, closest),
        check_brute_force(triangles, rays, closest, seed),
        *([check_mitsuba(scene, rays, closest, seed)] if mitsuba_traces() else []),
        Check.of("counts", first, again.counted_cost(**costs), 1e-9 * abs(first), "counted again"),
        check_lanes(tree, triangles, rays),
    ]
    if rays.occlusion:
        checks += check_any_hit(tree, triangles, rays, hits, closest)
    if others is not None:
        checks.append(check_same_hits(triangles, rays, closest, others, "trees"))
    return tuple(checks)


def check_tree(tree: Tree | WideTree, triangles: Triangles) -> Check:
    """Check the invariants of a tree, coverage of split triangles included."""
    tree.check_built_for(triangles)
    faults = tree.validate(triangles)
    return Check.of("tree", len(faults), 0, 0, faults[0] if faults else "invariants")


def check_lanes(tree: Tree | WideTree, triangles: Triangles, rays: RaySet) -> Check:
    """Check that SIMD lanes, scalar lanes and a simulation without Dr.Jit agree to the last bit."""
    faults = lane_faults(tree, triangles, rays, rays_checked=_LANE_RAYS)
    return Check.of(
        "lanes", len(faults), 0, 0, faults[0] if faults else "SIMD, scalar, and simulated"
    )


def check_any_hit(
    tree: Tree | WideTree, triangles: Triangles, rays: RaySet, hits: Hits, closest: Hits
) -> tuple[Check, ...]:
    """Check what tracing occlusion rays to any hit gave.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles
    rays : RaySet
    hits : Hits
        By the any-hit kernel, in the ``single`` style, or the ``wide`` one of a wide tree.
    closest : Hits
        The closest hits of the same rays in any tree.

    Returns
    -------
    tuple of Check
        A ray is blocked if it has a closest hit; and some of the rays visit what a walk without
        Dr.Jit does, compiled by Numba, that takes a binary tree for a wide one of two children.
        On a GPU, which may contract products and sums, the walk is left out.
    """
    differ = int(np.count_nonzero((hits.triangle >= 0) != (closest.triangle >= 0)))
    blocked = Check.of(
        "blocked",
        differ,
        0,
        0,
        f"of {len(rays):,} rays, blocked without a closest hit or vice versa",
    )
    if backend() != "llvm":
        return (blocked,)
    chosen = some_rays(len(rays), _LANE_RAYS)
    wide = tree if isinstance(tree, WideTree) else collapse(tree, 2)
    walk = walk_wide_tree(wide, triangles, rays.select(chosen), any_hit=True)
    wrong = sum(
        int(np.count_nonzero(getattr(hits, name)[chosen] != getattr(walk, name)))
        for name in ("t", "triangle", "inner", "leaves", "tests")
    )
    detail = f"counts of {len(chosen):,} rays that a walk without Dr.Jit has otherwise"
    return blocked, Check.of("any hit", wrong, 0, 0, detail)


def check_self_hits(rays: RaySet, hits: Hits) -> Check:
    """Count rays that hit the triangle they leave: a flat one cannot be."""
    own = int(np.count_nonzero((rays.source >= 0) & (rays.source == hits.triangle)))
    return Check.of(
        "self hits",
        own,
        0,
        MOST_SELF_HITS * len(rays),
        f"of {len(rays):,} rays, their own triangle",
    )
