"""What a study writes for people, made from its records alone: tables, figures, the report."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from mibvh.errors import MibvhError
from mibvh.files import write_text
from mibvh.studies.analyse.missing import missing
from mibvh.studies.finished import Study, read_study
from mibvh.studies.lock import alone_in
from mibvh.studies.measure.store import Store
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.record.serialise import from_json

#: The tables and figures that the last run wrote.
_WRITTEN = "study-files"
#: What the names of these look like, relative to the folder.
_OUTPUT = re.compile(r"(?:tables|figures)/[^/\\]+\.(?:csv|tex|svg|pdf|png)")


@dataclasses.dataclass(frozen=True)
class _Written:
    files: list[str]


def write_outputs(
    folder: Path,
    records: Sequence[SceneRecord],
    left_out: Mapping[str, str] | None = None,
    figures: Sequence[str] = (),
) -> None:
    """Write the tables, the environment and the report of the finished scenes.

    Tables and figures that only an earlier run wrote are removed. Whatever the records contain,
    nothing outside the folder is written or removed.

    Parameters
    ----------
    folder : Path
        The study's folder.
    records : sequence of SceneRecord
    left_out : mapping of str to str, optional
        Names of the scenes that could not be studied, and why.
    figures : sequence of str
        Further formats of the figures, ``pdf`` or ``png``, besides SVG.

    Raises
    ------
    MibvhError
        If a file cannot be written.
    """
    from mibvh.studies.analyse.correlations import correlations
    from mibvh.studies.record.sheet import literal
    from mibvh.studies.report.answer import answer
    from mibvh.studies.report.html import write_report
    from mibvh.studies.report.tables import answers, scene_answers
    from mibvh.studies.report.tidy import write_sheets, write_tables

    found = correlations(records)
    sheets = answers(records, found)
    of_scenes = [scene_answers(record, found) for record in records]
    write_tables(folder, records, found)
    written = write_sheets(folder, [*sheets, *(sheet for scene in of_scenes for sheet in scene)])
    write_text(folder / "environment.json", json.dumps(records[-1].environment, indent=2))
    without = [f"Left out: {name}: {why}\n" for name, why in (left_out or {}).items()]
    without += [f"Missing of {scene}: {literal(f'{one}')}\n" for scene, one in missing(records)]
    findings = "".join(f"- {literal(line)}\n" for line in answer(records, found))
    parts = [*without, findings, *(sheet.markdown() for sheet in sheets)]
    write_text(folder / "results.md", "\n".join(parts))
    written += write_report(folder, records, found, sheets, of_scenes, left_out or {}, figures)
    store = Store(folder / "cache")
    for name in _written_before(store) - set(written):
        with contextlib.suppress(OSError):
            (folder / name).unlink()
    store.write(_WRITTEN, {"files": written})


def _written_before(store: Store) -> set[str]:
    """Return the tables and figures of the last run; names of any other files are ignored."""
    try:
        found = from_json(_Written, store.read(_WRITTEN) or {"files": []})
    except MibvhError:
        return set()
    return {name for name in found.files if _OUTPUT.fullmatch(name)}


def remake_report(folder: str | os.PathLike[str], figures: Sequence[str] = ()) -> Study:
    """Write a study's tables and report again, without measuring.

    The folder may come from somebody else: its records are treated as untrusted data.

    Parameters
    ----------
    folder : path
    figures : sequence of str
        Further formats of the figures, ``pdf`` or ``png``, besides SVG.

    Returns
    -------
    Study

    Raises
    ------
    MibvhError
        As for :func:`read_study`, or if the records are inconsistent, a study is running in the
        folder, the folder cannot be written, or a format is unknown.
    """
    from mibvh.studies.report.drawing import KINDS

    for kind in figures:
        if kind not in KINDS:
            raise MibvhError(f"figures are drawn as {' or '.join(KINDS)} beside SVG, not {kind!r}")
    found = read_study(folder)
    with alone_in(found.folder):
        try:
            write_outputs(found.folder, found.scenes, found.left_out, figures)
        except MibvhError:
            raise
        # The types are right, but not what they tell together: lists of other lengths, a picture
        # that is none, quantities that are missing. Nearly anything can come of it.
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            raise MibvhError(
                f"{folder}: no report can be made of this study's records ({reason})"
            ) from error
    return found
