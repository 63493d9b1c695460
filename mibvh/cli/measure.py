"""Commands that measure: metrics, audit, ray sets, traversal."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import mibvh
from mibvh.cli.exits import AUDIT_FAILED
from mibvh.cli.options import Define, Json, RaysArgument, SceneArgument, TreeArgument
from mibvh.cli.printing import print_json, print_result
from mibvh.cli.progress import doing, load, shares, stages
from mibvh.errors import MibvhError

if TYPE_CHECKING:
    from mibvh.audit import Audit


def metrics(
    scene: SceneArgument, tree: TreeArgument, define: Define = None, as_json: Json = False
) -> None:
    """SAH, EPO and statistics of a tree."""
    triangles = load(scene, define).triangles
    loaded = mibvh.read_tree(tree, "npz")
    with shares("EPO") as show:
        overlap = mibvh.epo(loaded, triangles, progress=show)
    result = {"builder": loaded.meta.get("builder"), "sah": mibvh.sah(loaded), "epo": overlap}
    print_result({**result, **loaded.stats()}, as_json)


def audit(
    scene: SceneArgument,
    tree: TreeArgument,
    rays: Annotated[
        Path | None, typer.Argument(metavar="[RAYS.npz]", help="diffuse rays by default")
    ] = None,
    seed: Annotated[int, typer.Option(help="seed of points and samples")] = 0,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Check a tree and its numbers by independent code; exit code 3 if a check fails."""
    from mibvh.audit import audit as run

    loaded = load(scene, define)
    with stages("audit") as show:
        audited = run(
            loaded,
            mibvh.read_tree(tree, "npz"),
            mibvh.read_rays(rays) if rays else None,
            seed=seed,
            progress=show,
        )
    if as_json:
        print_json({**dataclasses.asdict(audited), "passed": audited.passed})
    else:
        _print_audit(audited)
    if not audited.passed:
        raise typer.Exit(AUDIT_FAILED)


def _print_audit(audited: Audit) -> None:
    """Print the checks as a table, failures in red."""
    from rich.console import Console
    from rich.table import Table

    table = Table("check", "", "value", "expected", "within", "compared", box=None)
    for check in audited.checks:
        table.add_row(
            check.name,
            "passed" if check.passed else "FAILED",
            f"{check.value:.6g}",
            f"{check.expected:.6g}",
            f"{check.tolerance:.3g}",
            check.detail,
            style=None if check.passed else "red",
        )
    Console().print(table)


def rays(
    scene: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the ray file to write")],
    viewpoints: Annotated[
        int | None, typer.Option(help="number of cameras; all by default")
    ] = None,
    width: Annotated[int, typer.Option(help="pixels per viewpoint")] = 320,
    height: Annotated[int, typer.Option(help="pixels per viewpoint")] = 240,
    samples: Annotated[int, typer.Option(help="paths per pixel")] = 4,
    bounces: Annotated[int, typer.Option(help="largest number of diffuse rays per path")] = 1,
    seed: Annotated[int, typer.Option(help="seed of the random numbers")] = 0,
    kind: Annotated[
        str, typer.Option(help="diffuse, primary, shadow, ao, or bounce2, shadow2, ...")
    ] = "diffuse",
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Path-trace diffuse rays, or others from the same paths, with Mitsuba and save them."""
    if kind != "diffuse" and bounces != 1:
        raise MibvhError("--bounces is for diffuse rays; name a later vertex as in shadow2")
    loaded = load(scene, define)
    how: dict[str, Any] = {
        "viewpoints": viewpoints,
        "width": width,
        "height": height,
        "samples": samples,
        "seed": seed,
    }
    with shares("rays") as show:
        if kind == "diffuse":
            made = mibvh.diffuse_rays(loaded, bounces=bounces, progress=show, **how)
        else:
            made = mibvh.make_rays(loaded, kind, progress=show, **how)
    made.save(output)
    per_bounce = {int(b): int((made.bounce == b).sum()) for b in sorted(set(made.bounce))}
    print_result({"rays": len(made), **made.meta, "rays_per_bounce": per_bounce}, as_json)


def trace(
    scene: SceneArgument,
    tree: TreeArgument,
    rays: RaysArgument,
    lanes: Annotated[str, typer.Option(help="simd or scalar")] = "simd",
    style: Annotated[
        str | None,
        typer.Option(
            help="single (as the study; the default), while-while, speculative, or wide: the "
            "fastest, and the only one of wide trees"
        ),
    ] = None,
    cull: Annotated[
        bool, typer.Option(help="re-test popped nodes against the current hit")
    ] = False,
    any_hit: Annotated[bool, typer.Option(help="end each ray at the first hit found")] = False,
    child_order: Annotated[
        str | None,
        typer.Option(
            help="order of children for any-hit rays in the wide style, instead of near first: "
            "larger, blocking (likeliest to block), or worth (that likelihood over the cost)"
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(help="number of timed launches")] = 5,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="hits to write")] = None,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Trace rays through a tree: hits, exact counters, kernel time."""
    triangles = load(scene, define).triangles
    with doing("tracing"):
        hits = mibvh.trace(
            mibvh.read_tree(tree, "npz"),
            triangles,
            mibvh.read_rays(rays),
            lanes,  # type: ignore[arg-type]
            style=style,
            cull=cull,
            any_hit=any_hit or None,
            child_order=child_order,  # type: ignore[arg-type]
            repeats=repeats,
        )
    if output:
        hits.save(output)
    print_result(hits.summary(), as_json)
