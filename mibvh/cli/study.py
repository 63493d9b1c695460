"""The commands that run a study and write its report."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import mibvh
from mibvh.cli.exits import AUDIT_FAILED, REFUSED
from mibvh.cli.options import Define, Json, parse_defines, parse_pairs
from mibvh.cli.printing import print_json, print_result
from mibvh.cli.progress import doing
from mibvh.errors import MibvhError

if TYPE_CHECKING:
    from mibvh.studies import Study


def study(
    scenes: Annotated[
        list[str], typer.Argument(metavar="SCENE...", help="as for build; or folders of scenes")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder of the results")],
    builders: Annotated[
        str | None,
        typer.Option(
            help="names, comma-separated; by default the paper's nine and your own; '' for given "
            "trees only. With options: bittner(start=sbvh), or sbvh(bins=8..128:8) for one tree "
            "with each value"
        ),
    ] = None,
    tree: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FILE[,FILE...]",
            help="a finished tree, used unchanged; one file per scene; may be repeated",
        ),
    ] = None,
    rays: Annotated[
        str | None,
        typer.Option(
            metavar="FILE[,FILE...]",
            help="your own rays, one file per scene; or kinds of rays to study as well: diffuse, "
            "shadow, ao, primary, bounce2, ..., all or none with weights: diffuse:1,shadow:2",
        ),
    ] = None,
    widths: Annotated[
        str,
        typer.Option(
            "--widths",
            "--width",
            metavar="2,4,8",
            help="also collapse the trees to nodes of so many children",
        ),
    ] = "",
    profile: Annotated[str, typer.Option(help="quick or paper")] = "quick",
    experiments: Annotated[
        str, typer.Option(help="names from `mibvh experiments`, comma-separated; or all")
    ] = "",
    seconds: Annotated[
        float | None,
        typer.Option(
            help="time budget of the stopwatch per scene and lane mode; the profile's by default"
        ),
    ] = None,
    samples: Annotated[
        int | None, typer.Option(help="paths per pixel; the profile's by default")
    ] = None,
    seed: Annotated[int, typer.Option(help="seed of the rays")] = 0,
    warp_width: Annotated[int, typer.Option(help="lanes of the simulated warps")] = 32,
    warp_style: Annotated[
        str,
        typer.Option(
            help="kernel of the simulated warps: persistent (the paper's), speculative, single, ..."
        ),
    ] = "persistent",
    styles: Annotated[
        str,
        typer.Option(
            help="kernels to time and to simulate, comma-separated: single, while-while, "
            "speculative, wide"
        ),
    ] = "single",
    variant: Annotated[
        str | None,
        typer.Option(help="Mitsuba's variant: llvm_ad_rgb (the default), cuda_ad_rgb, ..."),
    ] = None,
    define: Define = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="scheduler of a Dask cluster to study the scenes on"),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="print JSON lines: progress, then the result")
    ] = False,
) -> None:
    """Build, measure, predict and report, for scenes and builders."""
    from mibvh.scene import with_defines
    from mibvh.studies.paper.catalogue import scenes_in
    from mibvh.studies.record.options import kinds_or_files
    from mibvh.studies.report.board import Board
    from mibvh.variant import use_variant

    if variant is not None:
        if scheduler is not None:
            raise MibvhError("--variant is for this machine: set MIBVH_VARIANT for the workers")
        use_variant(variant)
    choices = _profile(profile)
    choices |= {"seed": seed, "warp_width": warp_width, "warp_style": warp_style, "styles": styles}
    of_profile = {"seconds": seconds, "samples": samples, "experiments": experiments or None}
    choices |= {name: value for name, value in of_profile.items() if value is not None}
    defines = parse_defines(define)
    sources = [with_defines(str(part), defines) for source in scenes for part in scenes_in(source)]
    kinds, files = kinds_or_files(rays or "")
    options = mibvh.StudyOptions(
        builders=builders,  # type: ignore[arg-type]
        widths=widths,  # type: ignore[arg-type]
        kinds=kinds,
        **choices,
    )
    given = {name: paths.split(",") for name, paths in parse_pairs(tree, "--tree").items()}
    with Board(len(sources), as_json) as board:
        result = mibvh.study(
            sources,
            output,
            trees=given,
            rays=files or None,
            options=options,
            progress=board,
            scheduler=scheduler,
        )
    _print_study(result, as_json)
    for name, why in result.left_out.items():
        typer.echo(f"mibvh: {name} was left out: {why}", err=True)
    for name, one in result.missing:
        typer.echo(f"mibvh: {name}: {one}", err=True)
    if result.failures:
        raise typer.Exit(AUDIT_FAILED)
    if result.left_out or result.missing:
        raise typer.Exit(REFUSED)


def _profile(name: str) -> dict[str, Any]:
    """Return the study options that a profile sets."""
    from mibvh.studies import PROFILES

    if name not in PROFILES:
        raise MibvhError(f"--profile is one of {', '.join(PROFILES)}, not {name!r}")
    return dict(PROFILES[name])


def _print_study(result: Study, as_json: bool) -> None:
    """Print everything as the last JSON line, or the findings for people."""
    if not as_json:
        _print_findings(result)
        return
    failed = [
        {"scene": scene, "tree": tree, **dataclasses.asdict(check)}
        for scene, tree, check in result.failures
    ]
    print_json(
        {
            "event": "result",
            "report": str(result.report),
            "trees": json.loads(result.table.to_json(orient="records")),
            "correlations": json.loads(result.correlations.to_json(orient="records")),
            "audit_failures": failed,
            "left_out": result.left_out,
            "missing": [{"scene": s, **dataclasses.asdict(one)} for s, one in result.missing],
        }
    )


def _print_findings(result: Study) -> None:
    """Print the main findings, in about ten lines; the report has all tables."""
    from rich.console import Console
    from rich.text import Text

    from mibvh.studies.report.answer import answer

    # A pipe has no width; 80 columns would cut the lines.
    console = Console(width=None if sys.stdout.isatty() else 160)
    for line in answer(result.scenes, result.correlations):
        console.print(Text(line))
    for scene, tree, check in result.failures:
        console.print(
            Text(
                f"audit FAILED: {scene}, {tree}: {check.name} is {check.value:.6g}, expected "
                f"{check.expected:.6g} within {check.tolerance:.3g} ({check.detail})",
                style="red",
            )
        )
    console.print(f"\nreport: {result.report}", soft_wrap=True)


def report(
    folder: Annotated[Path, typer.Argument(help="folder of a study")],
    figures: Annotated[
        str, typer.Option(help="further formats of the figures, which are SVG: pdf, png or pdf,png")
    ] = "",
    as_json: Json = False,
) -> None:
    """Remake a study's tables and report without measuring again."""
    from mibvh.studies.outputs import remake_report

    with doing("writing the report"):
        remade = remake_report(folder, [kind for kind in figures.split(",") if kind])
    print_result({"report": str(remade.report), "scenes": len(remade.scenes)}, as_json)
