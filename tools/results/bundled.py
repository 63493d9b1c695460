"""``python -m tools.results.bundled -o OUT``: study all bundled scenes, and write what came out.

All builders, kinds of rays and widths; nothing is needed that is not in the package. It writes
``docs/results/bundled.md``. Run it again with the same OUT to go on.
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
from mibvh.studies import StudyOptions
from mibvh.studies.analyse.correlations import correlations
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.record.sheet import literal
from mibvh.studies.report.answer import answer
from mibvh.studies.report.board import Board
from mibvh.studies.report.tables import answers
from tools.results.pages import Page, tables_of

ROOT = Path(__file__).parents[2]
#: Embree's is another library's, and not in every Mitsuba.
_WITHOUT = ("embree",)
_KINDS, _WIDTHS = ("diffuse", "shadow", "ao"), (2, 8)
PAGE = Page(
    "bundled",
    "The bundled scenes, with all builders",
    (
        "overview",
        "pooled-*",
        "builders",
        "sah-over-best",
        "warp-*",
        "width-r",
        "width-builders",
        "kinds-r",
        "kinds-builders",
        "audit-failures",
    ),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Study, and write the page. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.results.bundled", description=__doc__)
    add = parser.add_argument
    add("-o", "--output", type=Path, required=True, help="folder of the study, kept")
    add("--triangles", type=int, default=5_000, help="of each scene, about")
    add("--seconds", type=float, default=0.5, help="stopwatch budget per lane mode")
    add("--scenes", default="", help="names, comma-separated; all by default")
    add("--docs", type=Path, default=ROOT, help="the checkout whose docs are written")
    chosen = parser.parse_args(arguments)
    try:
        pages = make_folder(chosen.docs / "docs/results")
        records = _study(chosen)
        write_text(pages / f"{PAGE.file}.md", page_text(records, chosen))
    except MibvhError as error:
        sys.stderr.write(f"bundled: {error}\n")
        return 2
    return 0


def _study(chosen: argparse.Namespace) -> list[SceneRecord]:
    every = chosen.scenes.split(",") if chosen.scenes else list(scenes_package().CATALOGUE)
    options = StudyOptions(
        builders=tuple(
            name
            for name in (*names(), *later_names())
            if get(name).bundled and name not in _WITHOUT
        ),
        experiments=("prediction",),
        seconds=chosen.seconds,
        widths=_WIDTHS,
        kinds=_KINDS,
    )
    scenes = [f"{name}@{chosen.triangles}" for name in every]
    with Board(len(scenes), lines=False) as board:
        return mibvh.study(scenes, chosen.output, options=options, progress=board).scenes


def page_text(records: Sequence[SceneRecord], chosen: argparse.Namespace) -> str:
    """Return the page: the command, what was found, the tables."""
    found = correlations(records)
    machine = records[-1].environment
    command = f"python -m tools.results.bundled -o DIR --triangles {chosen.triangles}"
    lines = "\n".join(f"- {literal(line)}" for line in answer(records, found))
    tables = tables_of(PAGE, answers(records, found))
    return (
        f"# {PAGE.title}\n\n{len(records)} scenes of about {chosen.triangles:,} triangles, "
        f"{len(records[0].trees)} trees each, by mibvh {machine['mibvh']} on {machine['cpu']}. "
        "[results.md](../results.md) says what the tables mean. Times were taken briefly and "
        "beside other work, so mind their errors; counts are exact.\n\n"
        f"    {command}\n\n{lines}\n\n{tables}"
    )


if __name__ == "__main__":
    sys.exit(main())
