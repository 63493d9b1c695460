"""Commands for trees: build, optimise, collapse, import and export."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

import mibvh
from mibvh.cli.options import (
    Define,
    FileOutput,
    Json,
    LayoutOption,
    SceneArgument,
    TreeArgument,
    TreeOutput,
    parse_options,
)
from mibvh.cli.printing import print_result
from mibvh.cli.progress import load, stages


def build(
    scene: SceneArgument,
    output: TreeOutput,
    builder: Annotated[str, typer.Option(help="a name from `mibvh builders`")] = "bbvh",
    option: Annotated[
        list[str] | None,
        typer.Option(help="an option of the builder, as NAME=VALUE; may be repeated"),
    ] = None,
    width: Annotated[int, typer.Option(help="children per node: 2, or 4 or 8 for a wide tree")] = 2,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Build a tree over a scene and save it."""
    options = parse_options(option)
    loaded = load(scene, define)  # whole: `finite` asks it for rays
    tree: mibvh.Tree | mibvh.WideTree
    with stages(f"build {builder}", builder) as show:
        if width == 2:
            tree = mibvh.build(loaded, builder, progress=show, **options)
        else:
            tree = mibvh.build_wide(loaded, builder, width, progress=show, **options)
    tree.save(output)
    stats = tree.stats()
    result = {
        "builder": builder,
        **{k: stats[k] for k in ("triangles", "references", "nodes", "leaves", "depth")},
        "sah": mibvh.sah(tree),
        "build_seconds": tree.meta["build_seconds"],
        "report": tree.meta["report"],
    }
    print_result(result, as_json)


def optimize(
    scene: SceneArgument,
    output: TreeOutput,
    option: Annotated[
        list[str] | None,
        typer.Option(help="an option of the builder `finite`, as NAME=VALUE; may be repeated"),
    ] = None,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Build the best tree for a scene and its cameras, and say what it saves."""
    options = parse_options(option)
    loaded = load(scene, define)
    with stages("optimize") as show:
        optimized = mibvh.optimize(loaded, progress=show, **options)
    optimized.tree.save(output)
    if not as_json:
        typer.echo(f"{output}: {optimized.sentence()}")
        return
    meta = optimized.tree.meta
    result = {
        "builder": meta["builder"],
        "costs": optimized.costs,
        "rays": optimized.rays,
        "report": meta["report"],
    }
    print_result(result, as_json)


def collapse(
    tree: TreeArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the wide tree file to write")],
    width: Annotated[int, typer.Option(help="largest number of children per node: 2, 4 or 8")] = 8,
    method: Annotated[
        str, typer.Option(help="optimal (the lowest SAH), or greedy (open the largest child first)")
    ] = "optimal",
    max_leaf: Annotated[
        int | None, typer.Option(help="also merge leaves where that is cheaper, up to this size")
    ] = None,
    quantise: Annotated[
        bool, typer.Option("--quantise", help="store boxes in 8 bits per coordinate")
    ] = False,
    as_json: Json = False,
) -> None:
    """Collapse a tree to nodes of more children, for `metrics`, `audit` and `trace`."""
    binary = mibvh.Tree.load(tree)
    wide = mibvh.collapse(binary, width, method=method, max_leaf=max_leaf)  # type: ignore[arg-type]
    wide = mibvh.quantised(wide) if quantise else wide
    wide.save(output)
    _print_tree(wide, as_json)


def import_tree(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="a tree of another program")],
    output: TreeOutput,
    layout: LayoutOption = None,
    scene: Annotated[
        str | None, typer.Option(help="the scene that it was built for, to check it against")
    ] = None,
    name: Annotated[str, typer.Option(help="name of the tree; by default that of the file")] = "",
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Import a tree of another program; no box, leaf or reference changes."""
    tree = mibvh.read_tree(file, layout, name)
    if scene is not None:
        triangles = load(scene, define).triangles
        tree.check_matches(triangles)
        tree = tree.replace(meta={**tree.meta, "digest": triangles.digest})
    tree.save(output)
    if (unused := tree.meta.get("unused_nodes", 0)) > len(tree):
        sys.stderr.write(
            f"note: {unused:,} of the {unused + len(tree):,} nodes in {file} are not "
            "reached from its root; does the SAH agree with yours?\n"
        )
    _print_tree(tree, as_json)


def _print_tree(tree: mibvh.Tree | mibvh.WideTree, as_json: bool) -> None:
    """Print the builder, SAH and statistics of a tree."""
    builder = tree.meta.get("builder")
    print_result({"builder": builder, "sah": mibvh.sah(tree), **tree.stats()}, as_json)


def export_tree(tree: TreeArgument, output: FileOutput, layout: LayoutOption = None) -> None:
    """Write a tree for another program."""
    mibvh.write_tree(mibvh.read_tree(tree, "npz"), output, layout)


def export_triangles(
    scene: SceneArgument, output: FileOutput, define: Define = None, as_json: Json = False
) -> None:
    """Write a scene's triangles for another program: nine little-endian float32 each, by id."""
    from mibvh.files import atomic_path

    triangles = load(scene, define).triangles
    with atomic_path(output) as path:
        path.write_bytes(triangles.corners.astype("<f4").tobytes())
    print_result({"triangles": len(triangles), "digest": triangles.digest}, as_json)
