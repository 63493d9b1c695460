"""The study's tables as files: one tidy, one per tree, and those that people read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from mibvh.files import atomic_path, write_text
from mibvh.studies.sheet import Sheet

#: Measurements of a tree and their units, in the order of the tables.
UNITS = {
    "build_seconds": "s",
    "sah": "cost",
    "epo": "cost",
    "epo_fragments": "cost",
    "epo_starts": "cost",
    "epo_ends": "cost",
    "point_query": "cost",
    "sah_lines": "cost",
    "touched": "cost",
    "lcv": "leaves",
    "scalar_ns": "ns/ray",
    "simd_ns": "ns/ray",
    "scalar_error": "share",
    "simd_error": "share",
    "counted_cost": "cost",
    "inner_per_ray": "nodes/ray",
    "leaves_per_ray": "leaves/ray",
    "triangles_per_ray": "tests/ray",
    "inner_deviation": "nodes/ray",
    "steps_deviation": "steps/ray",
    "lane_utilisation": "share",
    "references": "count",
    "nodes": "count",
    "leaves": "count",
    "depth": "levels",
    "mean_leaf_size": "references",
    "epo_pairs": "count",
}


def wide_table(records: list[dict[str, Any]]) -> pd.DataFrame:
    """One row per scene and tree."""
    return pd.DataFrame([
        {"scene": r["scene"], "triangles": r["triangles"], "builder": tree["builder"],
         **{name: tree[name] for name in UNITS}}
        for r in records for tree in r["trees"]
    ])  # fmt: skip


def tidy_table(records: list[dict[str, Any]]) -> pd.DataFrame:
    """One row per scene, tree and measurement, with what it was made with.

    Beside the trees as they are (``experiment`` is ``prediction``) there are rows of the turned
    scene (``rotation``: degrees about (1, 1, 1)), of other leaf sizes, and of the rays of each
    bounce and viewpoint alone (``bounce`` 0 and ``viewpoint`` -1 stand for all of the ray set).
    """
    rows = []
    for r in records:
        environment = r["environment"]
        common = {
            "scene": r["scene"], "triangles": r["triangles"], "digest": r["digest"],
            "seed": r["rays"]["seed"],
            "study_options": json.dumps(r["options"]), "mibvh": environment["mibvh"],
            "mitsuba": environment["packages"]["mitsuba"],
            "drjit": environment["packages"]["drjit"], "llvm": environment["llvm"],
            "variant": environment["variant"], "lane_width": environment["lane_width"],
            "cpu": environment["cpu"], "threads": environment["threads"],
        }  # fmt: skip
        for place, what, values in _measured(r):
            tree = r["trees"][place]
            for name, unit in UNITS.items():
                if name in values:
                    rows.append({
                        **common, "builder": tree["builder"],
                        "builder_options": json.dumps(tree["options"]),
                        "rays": r["rays"]["count"], "experiment": "prediction", "rotation": 0.0,
                        "max_leaf": tree["options"]["max_leaf"], "bounce": 0, "viewpoint": -1,
                        **what, "measurement": name, "value": float(values[name]), "unit": unit,
                    })  # fmt: skip
    return pd.DataFrame(rows)


def _measured(record: dict[str, Any]) -> Iterator[tuple[int, dict[str, Any], dict[str, Any]]]:
    """Yield the place of a tree, what is other than usual, and measurements, of all experiments."""
    for place, tree in enumerate(record["trees"]):
        yield place, {}, tree
    if rotation := record.get("rotation"):
        for place, tree in enumerate(rotation["trees"]):
            yield place, {"experiment": "rotation", "rotation": rotation["degrees"]}, tree
    if sensitivity := record.get("sensitivity"):
        for place, (tree, sizes, deeper) in enumerate(
            zip(record["trees"], sensitivity["leaf_sizes"], sensitivity["bounces"], strict=True)
        ):
            for size in sizes:
                what = {name: size[name] for name in ("max_leaf", "rays")}
                yield place, {"experiment": "leaf size", **what}, size
            for origin in [*tree["costs_by_origin"], *deeper]:
                what = {name: origin[name] for name in ("bounce", "viewpoint", "rays")}
                yield place, {"experiment": "origin", **what}, {"counted_cost": origin["cost"]}


def write_tables(folder: Path, records: list[dict[str, Any]], correlations: pd.DataFrame) -> None:
    """Write ``results.parquet`` (tidy), ``results.csv`` (wide) and ``correlations.csv``."""
    with atomic_path(folder / "results.parquet") as path:
        tidy_table(records).to_parquet(path, index=False)
    for name, table in (("results", wide_table(records)), ("correlations", correlations)):
        with atomic_path(folder / f"{name}.csv") as path:
            table.to_csv(path, index=False)


def write_sheets(folder: Path, sheets: list[Sheet]) -> None:
    """Write tables for people under ``tables/``: the values as CSV, the text as LaTeX."""
    (folder / "tables").mkdir(exist_ok=True)
    for sheet in sheets:
        with atomic_path(folder / "tables" / f"{sheet.name}.csv") as path:
            sheet.frame.to_csv(path, index=False)
        write_text(folder / "tables" / f"{sheet.name}.tex", sheet.latex())
