"""The study behind the documentation: stage by stage, so that each stage leaves whole tables."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path

import mibvh
from mibvh.code import code_digest
from mibvh.errors import MibvhError
from mibvh.files import file_name
from mibvh.scene import scene_name
from mibvh.studies import Progress
from mibvh.studies.measure.store import Store
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.board import Board


class OutOfTime(Exception):
    """The time that was given is spent; what was measured is kept."""


def scenes_of(folder: Path, without: Sequence[str] = ()) -> list[Path]:
    """Return the scenes ``FOLDER/*/scene.xml``, those of small files first.

    Large scenes take longest, so they come last: what the time does not suffice for is theirs.

    Raises
    ------
    MibvhError
        If there is none, or one that is to be left out is not there.
    """
    found = {path.parent.name: path for path in sorted(folder.glob("*/scene.xml"))}
    for name in without:
        if found.pop(name, None) is None:
            raise MibvhError(f"{folder}: there is no scene {name!r} to leave out")
    if not found:
        raise MibvhError(f"{folder}: there is no folder with a scene.xml in it")
    return sorted(found.values(), key=_size)


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.parent.iterdir() if file.is_file())


def run(
    scenes: Sequence[Path],
    folder: Path,
    options: StudyOptions,
    ends: float = float("inf"),
) -> bool:
    """Study the scenes: first without experiments of any length, then one more at a time.

    Parameters
    ----------
    scenes : sequence of Path
    folder : Path
        Run again with the same folder to go on.
    options : StudyOptions
    ends : float
        Of :func:`time.monotonic`, when to stop wherever it is.

    Returns
    -------
    bool
        Whether all was done in the time.
    """
    try:
        for stage in stages(options):
            with Board(len(scenes), lines=False) as board:
                mibvh.study(list(scenes), folder, options=stage, progress=_Until(board, ends))
    except OutOfTime:
        return False
    return True


def stages(options: StudyOptions) -> list[StudyOptions]:
    """Return the options of each stage; the pieces of a stage are those of the next, too."""
    short = tuple(name for name in options.experiments if name in ("prediction", "depth"))
    rest = [name for name in options.experiments if name not in short]
    asked = [short or ("prediction",)]
    for name in rest:
        asked.append((*asked[-1], name))
    return [dataclasses.replace(options, experiments=names) for names in asked]


class _Until:
    """Passes the progress on, until the time is out."""

    def __init__(self, board: Board, ends: float) -> None:
        self._board, self._ends = board, ends

    def __call__(self, step: Progress) -> None:
        """Note that a step is reached."""
        self._board(step)
        if time.monotonic() > self._ends and step.done < 1.0:
            raise OutOfTime


def records_of(scenes: Sequence[Path], folder: Path, options: StudyOptions) -> list[SceneRecord]:
    """Return the records of the scenes that are finished, each of the last stage that it reached.

    Records of other options or of other code are left out: they are of another study.

    Raises
    ------
    MibvhError
        If no scene is finished.
    """
    store = Store(folder / "cache")
    code = code_digest("mibvh.studies.measure.scene")
    found = []
    for scene in scenes:
        kept = store.read("scene-" + file_name(scene_name(scene)))
        with contextlib.suppress(MibvhError):  # a record of another version
            record = SceneRecord.from_json(kept) if kept is not None else None
            if record and record.code == code and _same(record.options, options):
                found.append(record)
    if not found:
        raise MibvhError(f"{folder}: no scene is finished yet")
    return found


def _same(one: StudyOptions, other: StudyOptions) -> bool:
    """Whether two studies measure alike, whatever their experiments."""
    builders = other.builders or one.builders
    return dataclasses.replace(
        other, experiments=one.experiments, builders=builders
    ) == dataclasses.replace(one, builders=builders)
