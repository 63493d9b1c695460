"""The command that compares two trees of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import mibvh
from mibvh.cli.options import Define, Json, SceneArgument
from mibvh.cli.printing import print_json, print_table
from mibvh.cli.progress import doing, load
from mibvh.errors import MibvhError

if TYPE_CHECKING:
    from mibvh.comparison import Comparison


def compare(
    scene: SceneArgument,
    first: Annotated[str, typer.Argument(metavar="A", help="a tree's file, or a builder")],
    second: Annotated[str, typer.Argument(metavar="B", help="as A")],
    rays: Annotated[Path | None, typer.Option(help="ray file; diffuse rays by default")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PNG of the difference over the scene")
    ] = None,
    sensor: Annotated[int, typer.Option(help="which of the scene's cameras the PNG shows")] = 0,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Compare two trees: figures, where their costs differ, and which rays cost more."""
    from mibvh.comparison import difference_figure
    from mibvh.files import atomic_path

    if output is not None and (output.suffix.lower() != ".png" or not output.parent.is_dir()):
        raise MibvhError(f"{output}: the picture is a .png file in a folder that is there")
    asked = mibvh.read_rays(rays) if rays else None
    loaded = load(scene, define)
    with doing("comparing"):
        compared = mibvh.compare(loaded, first, second, rays=asked)
    if output is not None:
        with doing("drawing the difference"), atomic_path(output) as path:
            figure = difference_figure(loaded, compared, sensor)
            figure.savefig(path, format="png", dpi=120, facecolor="white")
    if as_json:
        print_json(compared.to_json())
    else:
        _print_comparison(compared)


def _print_comparison(compared: Comparison) -> None:
    from rich.console import Console
    from rich.markup import escape

    print_table(
        ("", *(escape(name) for name in compared.names), "B over A"),
        (
            (name, f"{a:.6g}", f"{b:.6g}", f"{b / a:.3f}" if a else "–")
            for name, (a, b) in compared.figures.items()
        ),
    )
    print_table(
        ("depth", "SAH: A", "B", "EPO: A", "B"),
        (
            (str(level.depth), *(f"{v:.3g}" for v in (*level.sah, *level.epo)))
            for level in compared.by_depth
        ),
    )
    print_table(
        ("of the rays", "cost in B less cost in A"),
        ((f"{share:.0%}", f"{value:+.4g}") for share, value in compared.quantiles.items()),
    )
    shares = compared.shares
    Console().print(
        f"{shares['cheaper']:.1%} of the rays are cheaper in B, {shares['dearer']:.1%} dearer, "
        f"{shares['same']:.1%} cost the same"
    )
    print_table(
        ("bounce", "viewpoint", "rays", "cost in A", "in B"),
        (
            (
                str(origin.bounce),
                str(origin.viewpoint),
                f"{origin.rays:,}",
                *(f"{cost:.4g}" for cost in origin.cost),
            )
            for origin in compared.by_origin
        ),
    )
