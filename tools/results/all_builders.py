"""``python -m tools.results.all_builders -o OUT [FOLDER]``: all builders, kinds of rays and widths.

Studies the scenes of FOLDER, for ``docs/results/all-builders.md``; without FOLDER, the bundled
scenes, which need nothing that is not in the package, for ``docs/results/bundled.md``. Run it again
with the same OUT to go on.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import mibvh
from mibvh.builders import get, later_names, names
from mibvh.bundled import scenes_package
from mibvh.errors import MibvhError
from mibvh.files import make_folder, write_text
from mibvh.studies import PROFILES, StudyOptions
from mibvh.studies.analyse.correlations import correlations
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.record.sheet import literal
from mibvh.studies.report.answer import answer
from mibvh.studies.report.board import Board
from mibvh.studies.report.tables import answers
from tools.results.later import later_sheets
from tools.results.pages import Page, tables_of
from tools.results.study import scenes_of

ROOT = Path(__file__).parents[2]
_KINDS, _WIDTHS = ("diffuse", "shadow", "ao"), (2, 8)
_SHEETS = (
    "overview",
    "pooled-*",
    "later-*",
    "cost-for-cost",
    "builders",
    "sah-over-best",
    "warp-*",
    "width-r",
    "width-builders",
    "kinds-r",
    "kinds-builders",
    "audit-failures",
)
BUNDLED = Page("bundled", "The bundled scenes, with all builders", _SHEETS)
REAL = Page("all-builders", "Real scenes, with all builders", _SHEETS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Study, and write the page. Returns the exit code."""
    chosen = _parser().parse_args(arguments)
    page = REAL if chosen.folder else BUNDLED
    try:
        pages = make_folder(chosen.docs / "docs/results")
        records = _study(chosen)
        write_text(pages / f"{page.file}.md", page_text(page, records, _command(chosen)))
    except MibvhError as error:
        sys.stderr.write(f"all_builders: {error}\n")
        return 2
    return 0


def _study(chosen: argparse.Namespace) -> list[SceneRecord]:
    options = StudyOptions(
        **{
            **PROFILES[chosen.profile],
            "builders": _builders(chosen),
            "experiments": ("prediction",),
            "samples": 1,
            "seconds": chosen.seconds,
            "widths": _WIDTHS,
            "kinds": _KINDS,
        }
    )
    scenes = _scenes(chosen)
    with Board(len(scenes), lines=False) as board:
        return mibvh.study(scenes, chosen.output, options=options, progress=board).scenes


def _builders(chosen: argparse.Namespace) -> tuple[str, ...]:
    """Return mibvh's own builders, but for those that are asked to be left out."""
    own = tuple(name for name in (*names(), *later_names()) if get(name).bundled)
    left_out = [name for name in chosen.without_builders.split(",") if name]
    for name in left_out:
        get(name)  # raises if there is none
    return tuple(name for name in own if name not in left_out)


def _scenes(chosen: argparse.Namespace) -> list[Path] | list[str]:
    if chosen.folder:
        return scenes_of(chosen.folder, chosen.without)
    every = chosen.scenes.split(",") if chosen.scenes else list(scenes_package().CATALOGUE)
    return [f"{name}@{chosen.triangles}" for name in every]


def _command(chosen: argparse.Namespace) -> str:
    """Return the command of a study of the same scenes, as it stands in the page."""
    folder = " SCENES" if chosen.folder else f" --triangles {chosen.triangles}"
    without = "".join(f" --without {name}" for name in chosen.without)
    return (
        f"python -m tools.results.all_builders -o DIR{folder}{without} --profile {chosen.profile} "
        f"--seconds {chosen.seconds:g} --without-builders '{chosen.without_builders}'"
    )


def page_text(page: Page, records: Sequence[SceneRecord], command: str) -> str:
    """Return the page: the command, what was found, the tables."""
    found = correlations(records)
    machine = records[-1].environment
    sizes = [record.triangles for record in records]
    lines = "\n".join(f"- {literal(line)}" for line in answer(records, found))
    tables = tables_of(page, [*answers(records, found), *later_sheets(records)])
    return (
        f"# {page.title}\n\n{len(records)} scenes of {min(sizes):,} to {max(sizes):,} triangles, "
        f"{len(records[0].trees)} trees each, by mibvh {machine['mibvh']} on {machine['cpu']}. "
        "[results.md](../results.md) says what the tables mean. Counts are exact; times have the "
        f"errors that are named below.\n\n    {command}\n\n{lines}\n\n{tables}"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tools.results.all_builders", description=__doc__
    )
    add = parser.add_argument
    add("folder", type=Path, nargs="?", metavar="FOLDER", help="of folders with a scene.xml each")
    add("-o", "--output", type=Path, required=True, help="folder of the study, kept")
    add("--without", action="append", default=[], metavar="NAME", help="a scene to leave out")
    add("--triangles", type=int, default=5_000, help="of each bundled scene, about")
    add("--scenes", default="", help="names of bundled scenes, comma-separated; all by default")
    another = "builders to leave out; by default Embree's, which is not in every Mitsuba"
    add("--without-builders", default="embree", metavar="NAMES", help=another)
    add("--profile", choices=list(PROFILES), default="quick")
    add("--seconds", type=float, default=0.5, help="stopwatch budget per lane mode")
    add("--docs", type=Path, default=ROOT, help="the checkout whose docs are written")
    return parser


if __name__ == "__main__":
    sys.exit(main())
