"""Commands for the bundled scenes, and for those of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mibvh.cli.options import Define, Json, SceneArgument
from mibvh.cli.printing import as_objects, print_json, print_result, print_table
from mibvh.cli.progress import doing, load

app = typer.Typer(no_args_is_help=True, help="The bundled scenes: list, make, show.")


@app.command("list")
def list_bundled(as_json: Json = False) -> None:
    """List the bundled scenes."""
    from mibvh.bundled import scenes_package

    catalogue = scenes_package().CATALOGUE.values()
    if as_json:
        print_json({"scenes": as_objects(catalogue)})
        return
    print_table(
        ("scene", "kind", "triangles", "what it shows"),
        ((info.name, info.kind, f"{info.triangles:,}", info.title) for info in catalogue),
    )


@app.command("paper")
def list_paper(as_json: Json = False) -> None:
    """List the paper's scenes: where to get each, and its published figures."""
    from mibvh.studies.paper.published import published

    known = published().known_scenes
    if as_json:
        print_json({"scenes": as_objects(known)})
        return
    print_table(
        ("scene", "triangles", "r SAH", "r SAH+EPO", "alpha", "where"),
        (
            (
                scene.name,
                f"{scene.triangles:,}" if scene.triangles else "",
                *(
                    "" if f is None else f"{f:g}"
                    for f in (scene.r_sah, scene.r_sah_epo, scene.alpha)
                ),
                scene.where or "",
            )
            for scene in known
        ),
    )
    typer.echo(
        f"\nThe slides name {len(known)} of the {published().scenes} scenes; what is not known is "
        "left out.\nTriangles are those of the available file; the paper's own may differ."
    )


@app.command()
def make(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME...]", help="all by default")
    ] = None,
    triangles: Annotated[int | None, typer.Option(help="size; each scene's own by default")] = None,
    seed: Annotated[int | None, typer.Option(help="each scene's own by default")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="folder; mibvh's cache by default")
    ] = None,
    as_json: Json = False,
) -> None:
    """Generate bundled scenes: XML and meshes."""
    from mibvh.bundled import bundled_scene, make_scene, scenes_package

    made = {}
    for name in names or list(scenes_package().CATALOGUE):
        with doing(f"making {name}"):
            if output is None:
                made[name] = str(bundled_scene(name, triangles, seed))
            else:
                made[name] = str(make_scene(name, output / name, triangles, seed))
        if not as_json:
            typer.echo(made[name])
    if as_json:
        print_json({"scenes": made})


@app.command()
def show(
    name: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the PNG to write")],
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Render a scene's first viewpoint to a PNG."""
    from mibvh.files import atomic_path
    from mibvh.picture import picture, png

    scene = load(name, define)
    with doing("rendering"), atomic_path(output) as path:
        path.write_bytes(png(picture(scene)))
    result = {"scene": scene.name, "triangles": len(scene.triangles), "picture": str(output)}
    print_result(result, as_json)
