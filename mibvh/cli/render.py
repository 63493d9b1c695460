"""Pictures of a scene through a tree."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mibvh.cli.options import Define, Json, SceneArgument, parse_defines, parse_options
from mibvh.cli.printing import print_result
from mibvh.cli.progress import say_notes, stages
from mibvh.errors import MibvhError


def render(
    scene: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the EXR or PNG to write")],
    integrator: Annotated[
        str | None,
        typer.Option(
            help="bvh_path, bvh_cost, bvh_rays, or any of Mitsuba's; by default the scene's own "
            "if it is one of the first three, else bvh_path"
        ),
    ] = None,
    builder: Annotated[
        str | None, typer.Option(help="the tree's; sbvh by default (bvh_path, bvh_cost)")
    ] = None,
    compare: Annotated[str | None, typer.Option(help="builder of a second tree (bvh_cost)")] = None,
    tree: Annotated[Path | None, typer.Option(help="tree file in the place of --builder")] = None,
    compare_tree: Annotated[
        Path | None, typer.Option(help="tree file in the place of --compare")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(help="NAME=VALUE, an option of the integrator or builder"),
    ] = None,
    define: Define = None,
    spp: Annotated[
        int | None, typer.Option(help="samples per pixel; the scene's by default")
    ] = None,
    size: Annotated[str | None, typer.Option(help="WxH in pixels; the scene's by default")] = None,
    sensor: Annotated[int, typer.Option(help="which of the scene's cameras")] = 0,
    seed: Annotated[int, typer.Option(help="seed of the image")] = 0,
    quantity: Annotated[
        list[str] | None, typer.Option(help="what a PNG of bvh_cost shows; may be repeated")
    ] = None,
    as_json: Json = False,
) -> None:
    """Render a scene through a tree, or heat maps of what rays cost in it."""
    from mibvh.mitsuba.render import render as run

    parameters = parse_options(option)
    trees = {"builder": builder, "compare": compare, "tree": tree, "compare_tree": compare_tree}
    parameters |= {name: str(given) for name, given in trees.items() if given is not None}
    pixels = None if size is None else _parse_size(size)
    with stages("scene") as show:
        facts, notes = run(
            scene,
            output,
            integrator,
            parameters=parameters,
            size=pixels,
            spp=spp,
            sensor=sensor,
            defines=parse_defines(define),
            seed=seed,
            quantities=quantity or (),
            progress=show,
        )
    say_notes(scene, notes)
    means = facts.pop("means") if not as_json else {}
    print_result({**facts, **{f"mean {name}": value for name, value in means.items()}}, as_json)


def _parse_size(size: str) -> tuple[int, int]:
    """Read ``640x480``."""
    width, _, height = size.partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise MibvhError(f"--size takes WIDTHxHEIGHT, such as 640x480, not {size!r}")
    return int(width), int(height)
