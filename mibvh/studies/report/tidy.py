"""The study's data files, and the tables for people as files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from mibvh.files import atomic_path, file_name, make_folder, write_text
from mibvh.metrics.registry import Quantity
from mibvh.studies.measure.counts import lines_of
from mibvh.studies.measure.warps import simulated_rays
from mibvh.studies.record.experiment import TidyRow, experiments
from mibvh.studies.record.quantities import quantities
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.studies.record.serialise import to_json
from mibvh.studies.record.sheet import Sheet, write_csv

#: What a row of the tidy table is of, where its experiment says nothing else.
_USUAL = {
    "experiment": "prediction",
    "rotation": 0.0,
    "bounce": 0,
    "viewpoint": -1,
    "cut_depth": -1,
    "splits": -1,
    "width": 2,
    "kind": "",
}


def wide_table(records: Records) -> pd.DataFrame:
    """Return a table with one row per scene and tree."""
    known = quantities()
    names = [quantity.name for quantity in known.values() if quantity.per_tree]
    recorded = {name for record in records for tree in record.trees for name in tree.values}
    undeclared = sorted(recorded - set(known))  # by a plugin that is not here
    return pd.DataFrame(
        [
            {
                "scene": record.scene,
                "triangles": record.triangles,
                "builder": tree.builder,
                **{name: tree[name] for name in names},
                **{name: tree.values.get(name, float("nan")) for name in undeclared},
            }
            for record in records
            for tree in record.trees
        ]
    )


def tidy_table(records: Records) -> pd.DataFrame:
    """Return a table with one row per scene, tree and measurement, and its provenance.

    Beside the trees as they are (``experiment`` is ``prediction``) there are the rows of all
    experiments: of the rotated scene (``rotation``: degrees about (1, 1, 1)), of other leaf sizes,
    of the rays of each bounce and viewpoint alone, and of trees cut at a depth or after some
    splits. The columns are listed in ``docs/experiments.md``.
    """
    known = quantities()
    return pd.DataFrame([row for record in records for row in _of_scene(record, known)])


def _of_scene(record: SceneRecord, known: dict[str, Quantity]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a scene; shared values are computed once, because there are thousands."""
    common, rays = _common(record), _rays(record)
    for experiment in experiments():
        for tidy in experiment.shown("rows", record):
            yield from _rows(record, tidy, known, common, {**rays, **tidy.rays})


def _rows(
    record: SceneRecord,
    tidy: TidyRow,
    known: dict[str, Quantity],
    common: dict[str, Any],
    rays: dict[str, int],
) -> Iterator[dict[str, Any]]:
    """Yield a row for each quantity; undeclared ones have no unit."""
    tree, of = record.trees[tidy.place], dict(tidy.of)
    # Trees of other programs have no options.
    max_leaf = of.pop("max_leaf", tree.options.get("max_leaf", -1))
    before = {**common, "builder": tree.builder, "builder_options": _text(tree.options)}
    after = {**_USUAL, "max_leaf": max_leaf, **of}
    undeclared = [Quantity(name=name, unit="") for name in tidy.values if name not in known]
    for quantity in (*known.values(), *undeclared):
        if quantity.name in tidy.values:
            yield {
                **before,
                "rays": rays[quantity.rays] if quantity.rays else 0,
                **after,
                "measurement": quantity.name,
                "value": float(tidy.values[quantity.name]),
                "unit": quantity.unit,
            }


def _text(values: Mapping[str, Any]) -> str:
    """As JSON: the same for the same values, measured now or read back."""
    return json.dumps(values, sort_keys=True)


def _common(record: SceneRecord) -> dict[str, Any]:
    """Return the columns that all rows of a scene share."""
    machine = record.environment
    packages = machine["packages"]
    return {
        "scene": record.scene,
        "triangles": record.triangles,
        "digest": record.digest,
        "seed": record.rays.seed,
        "study_options": _text(to_json(record.options)),
        "mibvh": machine["mibvh"],
        "mitsuba": packages["mitsuba"],
        "drjit": packages["drjit"],
        "packages": _text(packages),
        **{name: machine[name] for name in ("llvm", "variant", "lane_width", "cpu", "threads")},
    }


def _rays(record: SceneRecord) -> dict[str, int]:
    """Return the sizes of the ray populations."""
    count = record.rays.count
    return {
        "all": count,
        "lines": lines_of(count),
        "warp": len(simulated_rays(count, record.options.warp_width)),
        **{lanes: timing.rays for lanes, timing in record.timing.items()},
    }


def write_tables(folder: Path, records: Records, correlations: pd.DataFrame) -> None:
    """Write ``results.parquet`` (tidy), ``results.csv`` (wide) and ``correlations.csv``."""
    with atomic_path(folder / "results.parquet") as path:
        tidy_table(records).to_parquet(path, index=False)
    for name, table in (("results", wide_table(records)), ("correlations", correlations)):
        write_csv(table, folder / f"{name}.csv")


def write_sheets(folder: Path, sheets: list[Sheet]) -> list[str]:
    """Write tables for people under ``tables/``: the values as CSV, the text as LaTeX.

    Returns
    -------
    list of str
        The files, relative to the folder.
    """
    make_folder(folder / "tables")
    names = [f"tables/{file_name(sheet.name)}" for sheet in sheets]
    for name, sheet in zip(names, sheets, strict=True):
        write_csv(sheet.values, folder / f"{name}.csv")
        write_text(folder / f"{name}.tex", sheet.latex())
    return [f"{name}.{kind}" for name in names for kind in ("csv", "tex")]
