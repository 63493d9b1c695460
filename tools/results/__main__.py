"""``python -m tools.results FOLDER -o OUT``: study scenes, and write what the docs say of them.

Run it again with the same OUT to go on. Pages are written after every run, from the scenes that are
finished by then; an experiment that is not finished on all of them keeps its old page, marked.
"""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from mibvh.errors import MibvhError
from mibvh.files import write_text
from mibvh.scene import scene_name
from mibvh.studies import PROFILES, StudyOptions, study
from mibvh.studies.analyse.correlations import correlations
from mibvh.studies.outputs import remake_report, write_outputs
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.tables import answers
from mibvh.studies.report.tables.audit import failures
from tools.results import blocks, quoted, rotation_figure
from tools.results.pages import write_pages
from tools.results.study import records_of, run, scenes_of

ROOT = Path(__file__).parents[2]
#: Experiments with a section of their own in ``docs/results.md``.
_SECTIONS = ("rotation", "sensitivity")
#: What the figures of README and docs are drawn as.
_PNG = ("png",)
FAILED = 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Study, write, and say what is old. Returns the exit code."""
    chosen = _parser().parse_args(arguments)
    try:
        return _make(chosen)
    except MibvhError as error:
        sys.stderr.write(f"results: {error}\n")
        return 2


def _make(chosen: argparse.Namespace) -> int:
    options = StudyOptions(
        **{
            **PROFILES[chosen.profile],
            "samples": chosen.samples,
            "seconds": chosen.seconds,
            "experiments": chosen.experiments,
            "builders": chosen.builders or None,
        }
    )
    scenes = scenes_of(chosen.scenes, chosen.without)
    ends = time.monotonic() + 60 * chosen.minutes
    if not chosen.pages_only and not run(scenes, chosen.output, options, ends):
        sys.stderr.write("results: out of time; run it again to go on\n")
    records = records_of(scenes, chosen.output, options)
    finished = {record.scene for record in records}
    missing = [name for name in map(scene_name, scenes) if name not in finished]
    write_outputs(chosen.output, records, {}, _PNG)
    old = write_docs(records, chosen.docs, _command(chosen))
    _figures(records, chosen)
    sys.stdout.write(
        f"{len(records)} of {len(scenes)} scenes; report: {chosen.output}/report.html\n"
    )
    if missing:
        sys.stdout.write(f"not finished, and left out: {', '.join(missing)}\n")
    if old:
        sys.stdout.write(f"still of version 0.1: {', '.join(old)}\n")
    for scene, tree, check in failures(records):
        sys.stdout.write(f"audit FAILED: {scene}, {tree}: {check.name}, {check.detail}\n")
    return FAILED if failures(records) else 0


def write_docs(records: Sequence[SceneRecord], root: Path, command: str) -> list[str]:
    """Write tables, numbers and blocks into the README and docs of a checkout.

    Parameters
    ----------
    records : sequence of SceneRecord
    root : Path
        Of the checkout.
    command : str
        That made them.

    Returns
    -------
    list of str
        What is still of version 0.1: pages, and keys of quoted numbers.
    """
    docs, found = root / "docs", correlations(records)
    done = set.intersection(*({"prediction", *record.results} for record in records))
    done_records = [
        dataclasses.replace(r, results={k: v for k, v in r.results.items() if k in done})
        for r in records
    ]
    pages = write_pages(docs, answers(done_records, found), done, _said(records))
    held = quoted.read(docs / "results/quoted.json")
    new = quoted.quoted(done_records, found)
    # What was not measured anew keeps its number, and is named.
    kept = {key: value for key, value in held["values"].items() if key not in new}
    before = quoted.read(docs / "results/quoted-0.1.json")["values"]
    quoted.write(
        docs / "results/quoted.json",
        new | kept,
        version=records[-1].environment["mibvh"],
        scenes=", ".join(record.scene for record in records),
        kept="not measured again: " + (", ".join(kept) or "none"),
    )
    _fill(root, new | kept)
    path = docs / "results.md"
    text = path.read_text(encoding="utf-8")
    text = blocks.put(text, "command", command, path.name)
    text = blocks.put(text, "changed", blocks.changed(before, new, []), path.name)
    for name in _SECTIONS:
        text = blocks.put(text, name, blocks.status(name in done), path.name)
    write_text(path, text)
    return [f"{page}.md" for page, is_new in pages.items() if not is_new] + sorted(kept)


def _fill(root: Path, values: dict[str, str]) -> None:
    for page in (root / "README.md", *sorted((root / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        filled = quoted.fill(text, values, page.name)
        if filled != text:
            write_text(page, filled)


def _said(records: Sequence[SceneRecord]) -> str:
    """What was measured, with what and on what."""
    machine = records[-1].environment
    return (
        f"Tables of the study on {len(records)} scenes by mibvh {machine['mibvh']}, "
        f"{machine['cpu']}, {machine['threads']} threads, {machine['lane_width']} lanes."
    )


def _command(chosen: argparse.Namespace) -> str:
    """Return the command of a study of the same scenes, as it stands in the page."""
    names = chosen.experiments
    without = "".join(f" --without {name}" for name in chosen.without)
    return (
        f"    python -m tools.results SCENES -o DIR{without} --profile {chosen.profile} "
        f"--samples {chosen.samples} \\\n        --seconds {chosen.seconds:g} "
        f"--experiments {names}"
    )


def _figures(records: Sequence[SceneRecord], chosen: argparse.Namespace) -> None:
    """Put the figures of README and docs in their places."""
    images = chosen.docs / "docs/images"
    shutil.copy(chosen.output / "figures/summary.png", images / "results-summary.png")
    if all("rotation" in record.results for record in records):
        rotation_figure.draw(chosen.docs / "docs")
    if not chosen.pages_only:
        folder = chosen.output / "readme"
        study([chosen.readme_scene], folder, builders=chosen.builders or None)
        found = remake_report(folder, _PNG)
        name = f"{chosen.readme_scene}-counted.png"
        shutil.copy(found.folder / "figures" / name, images / "livingroom.png")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tools.results", description=__doc__)
    add = parser.add_argument
    add("scenes", type=Path, metavar="FOLDER", help="of folders with a scene.xml each")
    add("-o", "--output", type=Path, required=True, help="folder of the study, kept")
    add("--without", action="append", default=[], metavar="NAME", help="a scene to leave out")
    add("--experiments", default="prediction,depth,rotation,sensitivity")
    add("--builders", default="")
    add("--profile", choices=list(PROFILES), default="paper")
    add("--samples", type=int, default=1)
    add("--seconds", type=float, default=10.0)
    add("--minutes", type=float, default=float("inf"), help="stop measuring after so many")
    add("--pages-only", action="store_true", help="write from what is measured already")
    of_study = "of the README's figure; by default the one of `make study`"
    add("--readme-scene", default="livingroom@10000", metavar="SCENE", help=of_study)
    add("--docs", type=Path, default=ROOT, help="the checkout whose docs are written")
    return parser


if __name__ == "__main__":
    sys.exit(main())
