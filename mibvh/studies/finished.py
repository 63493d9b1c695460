"""A finished study: what it found, and how its folder keeps that.

The records are in ``cache/scene-NAME.json``; ``cache/study.json`` lists those of the last run. All
tables and the report are made from them (:mod:`mibvh.studies.outputs`).
"""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mibvh.code import code_digest
from mibvh.errors import MibvhError
from mibvh.files import file_name
from mibvh.studies.analyse.depth import depth_table
from mibvh.studies.analyse.missing import missing
from mibvh.studies.analyse.rotation import rotation_factors
from mibvh.studies.analyse.sensitivity import sensitivity_table
from mibvh.studies.measure.store import Store
from mibvh.studies.record.scene import FORMAT, Missing, SceneRecord
from mibvh.studies.record.serialise import from_json, to_json

if TYPE_CHECKING:
    import pandas as pd

    from mibvh.audit.record import Check

_RECORD = "scene-"
_LIST = "study"


@dataclasses.dataclass(frozen=True)
class _List:
    """The scenes that the last run finished, in order, and those that it left out."""

    scenes: list[str]
    format: int
    left_out: dict[str, str]


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """A finished study.

    Attributes
    ----------
    folder : Path
        Where its files are.
    scenes : list of SceneRecord
        One per scene.
    environment : dict
        What it was measured on.
    left_out : dict of str to str
        Scenes that could not be studied, and why.
    """

    folder: Path
    scenes: list[SceneRecord]
    environment: dict[str, Any]
    left_out: dict[str, str] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def table(self) -> pd.DataFrame:
        """One row per scene and tree."""
        from mibvh.studies.report.tidy import wide_table

        return wide_table(self.scenes)

    @functools.cached_property
    def correlations(self) -> pd.DataFrame:
        """One row per scene, measurement and predictor."""
        from mibvh.studies.analyse.correlations import correlations

        return correlations(self.scenes)

    @functools.cached_property
    def rotation(self) -> pd.DataFrame:
        """Factors by which rotation changes costs; see :mod:`mibvh.studies.analyse.rotation`."""
        return rotation_factors(self.scenes)

    @functools.cached_property
    def sensitivity(self) -> pd.DataFrame:
        """Results with other choices; see :mod:`mibvh.studies.analyse.sensitivity`."""
        return sensitivity_table(self.scenes)

    @functools.cached_property
    def depth(self) -> pd.DataFrame:
        """Cost and overlap at each depth; see :mod:`mibvh.studies.analyse.depth`."""
        return depth_table(self.scenes)

    @property
    def failures(self) -> list[tuple[str, str, Check]]:
        """Scene, tree and check of every failed audit."""
        from mibvh.studies.report.tables.audit import failures

        return failures(self.scenes)

    @functools.cached_property
    def missing(self) -> list[tuple[str, Missing]]:
        """Scene and missing result, for everything that failed without ending the study."""
        return missing(self.scenes)

    @property
    def report(self) -> Path:
        """The HTML report."""
        return self.folder / "report.html"


def keep_record(store: Store, record: SceneRecord) -> None:
    """Keep what was found of a scene."""
    store.write(_RECORD + file_name(record.scene), record.to_json())


def keep_list(store: Store, records: Sequence[SceneRecord], left_out: Mapping[str, str]) -> None:
    """Keep which scenes this run finished: the folder may hold scenes of earlier ones too."""
    names = [record.scene for record in records]
    store.write(_LIST, to_json(_List(names, FORMAT, dict(left_out))))


def read_study(folder: str | os.PathLike[str]) -> Study:
    """Read a study back from its folder.

    Raises
    ------
    MibvhError
        If there is no finished scene in it, or another version of mibvh or damage left it
        unreadable.
    """
    cache = Path(folder) / "cache"
    store = Store(cache) if cache.is_dir() else None
    finished = store.read(_LIST) if store else None
    if store is None or finished is None:
        raise MibvhError(f"{folder}: there is no finished scene of a study in this folder")
    if isinstance(finished, dict) and finished.get("format", FORMAT) != FORMAT:
        raise MibvhError(
            f"{folder}: this study was made by another version of mibvh; run it again with this one"
        )
    try:
        listed = from_json(_List, finished)
        records = [_read_record(store, name) for name in listed.scenes]
    except MibvhError as error:
        raise MibvhError(
            f"{folder}: a scene of this study is damaged, or made with a --plugin that is missing "
            f"here ({error}); run it again to mend it"
        ) from None
    if not records:
        raise MibvhError(f"{folder}: there is no finished scene of a study in this folder")
    return Study(Path(folder), records, records[-1].environment, listed.left_out)


def _read_record(store: Store, name: str) -> SceneRecord:
    found = store.read(_RECORD + file_name(name))
    if found is None:
        raise MibvhError(f"{name}: damaged")
    return _with_code_note(SceneRecord.from_json(found))


def _with_code_note(record: SceneRecord) -> SceneRecord:
    """Say of a scene if other code than this one measured it."""
    if record.code == code_digest("mibvh.studies.measure.scene"):
        return record
    note = "Measured by other code than that of this mibvh: run the study again to bring it up."
    return dataclasses.replace(record, notes=[*record.notes, note])
