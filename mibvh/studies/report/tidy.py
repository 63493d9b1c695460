"""The study's tables as files: one tidy, one per tree, and those that people read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from mibvh.files import atomic_path, write_text
from mibvh.studies.measure.depth import SPLITS
from mibvh.studies.measure.trees import LINES
from mibvh.studies.sheet import Sheet

#: Measurements of a tree and their units, in the order of the tables.
UNITS = {
    "build_seconds": "s",
    "sah": "cost",
    "epo": "cost",
    "sah_inner": "cost / C_inner",
    "sah_leaves": "cost / C_tri",
    "epo_inner": "cost / C_inner",
    "epo_leaves": "cost / C_tri",
    "epo_fragments": "cost",
    "epo_starts": "cost",
    "epo_starts_error": "cost",
    "epo_ends": "cost",
    "point_query": "cost",
    "sah_lines": "cost",
    "sah_lines_error": "cost",
    "touched": "cost",
    "hit_share": "share",
    "length_ratio": "share",
    "line_share": "share",
    "same_hits": "share",
    "lcv": "leaves",
    "scalar_ns": "ns/ray",
    "scalar_ns_before": "ns/ray",
    "scalar_ns_again": "ns/ray",
    "simd_ns": "ns/ray",
    "simd_ns_again": "ns/ray",
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
    "sah_at_depth": "cost",
    "epo_at_depth": "cost",
    "nodes_at_depth": "count",
    "spent_above_cut": "cost",
    "worst_case_below_cut": "cost",
}
#: Lists by depth in a tree's row, and the measurements that they are.
_BY_DEPTH = {
    "nodes_by_depth": "nodes_at_depth",
    "sah_by_depth": "sah_at_depth",
    "epo_by_depth": "epo_at_depth",
    "spent_by_depth": "spent_above_cut",
    "remaining_by_depth": "worst_case_below_cut",
}
#: Of the measurements, what stands in the table of one row per tree.
_OF_TREES = tuple(
    name for name in UNITS if not name.endswith(("_again", "_before", "_depth", "_cut", "_hits"))
)
#: Measurements by what rays they are of; all others need none.
_RAYS = {
    **dict.fromkeys(("scalar_ns", "scalar_ns_before", "scalar_ns_again", "scalar_error"), "scalar"),
    **dict.fromkeys(("simd_ns", "simd_ns_again", "simd_error"), "simd"),
    **dict.fromkeys(("sah_lines", "sah_lines_error", "touched", "line_share"), "lines"),
    **dict.fromkeys((
        "epo_starts", "epo_starts_error", "epo_ends", "point_query", "hit_share", "length_ratio",
        "same_hits", "lcv", "counted_cost", "inner_per_ray", "leaves_per_ray", "triangles_per_ray",
        "inner_deviation", "steps_deviation", "lane_utilisation",
    ), "all"),
}  # fmt: skip


def wide_table(records: list[dict[str, Any]]) -> pd.DataFrame:
    """One row per scene and tree."""
    return pd.DataFrame([
        {"scene": r["scene"], "triangles": r["triangles"], "builder": values["builder"],
         **{name: values[name] for name in _OF_TREES}}
        for r in records for values in map(_with_parts, r["trees"])
    ])  # fmt: skip


def tidy_table(records: list[dict[str, Any]]) -> pd.DataFrame:
    """One row per scene, tree and measurement, with what it was made with.

    Beside the trees as they are (``experiment`` is ``prediction``) there are rows of the turned
    scene (``rotation``: degrees about (1, 1, 1)), of other leaf sizes, of the rays of each bounce
    and viewpoint alone, and of trees cut at a depth or after some splits. The columns are listed
    in ``docs/experiments.md``.
    """
    rows = []
    for r in records:
        environment = r["environment"]
        common = {
            "scene": r["scene"], "triangles": r["triangles"], "digest": r["digest"],
            "seed": r["rays"]["seed"],
            "study_options": json.dumps(r["options"]), "mibvh": environment["mibvh"],
            "mitsuba": environment["packages"]["mitsuba"],
            "drjit": environment["packages"]["drjit"],
            "packages": json.dumps(environment["packages"]), "llvm": environment["llvm"],
            "variant": environment["variant"], "lane_width": environment["lane_width"],
            "cpu": environment["cpu"], "threads": environment["threads"],
        }  # fmt: skip
        own_rays = _rays(r, r["timing"])
        turned_rays = _rays(r, {"scalar": r["rotation"]["timing"]}) if "rotation" in r else {}
        for place, what, values in _measured(r):
            tree = r["trees"][place]
            max_leaf = what.get("max_leaf", tree["options"]["max_leaf"])
            rays = turned_rays if what.get("experiment") == "rotation" else own_rays
            for name, unit in UNITS.items():
                if name in values:
                    rows.append({
                        **common, "builder": tree["builder"],
                        "builder_options": json.dumps({**tree["options"], "max_leaf": max_leaf}),
                        "rays": rays[_RAYS[name]] if name in _RAYS else 0,
                        "experiment": "prediction", "rotation": 0.0, "max_leaf": max_leaf,
                        "bounce": 0, "viewpoint": -1, "cut_depth": -1, "splits": -1,
                        **{key: of for key, of in what.items() if key != "rays" or name in _RAYS},
                        "measurement": name, "value": float(values[name]), "unit": unit,
                    })  # fmt: skip
    return pd.DataFrame(rows)


def _rays(record: dict[str, Any], timing: dict[str, Any]) -> dict[str, int]:
    """How many rays the measurements of a scene are of, those of each lane mode as timed."""
    count = record["rays"]["count"]
    return {
        "all": count,
        "lines": -(-count // -(-count // LINES)),  # every so-many-eth
        **{lanes: found["rays"] for lanes, found in timing.items()},
    }


def _with_parts(tree: dict[str, Any]) -> dict[str, Any]:
    """A tree's row with the parts of SAH and EPO under names of their own."""
    parts = {
        f"{metric}_{part}": value
        for metric in ("sah", "epo")
        for part, value in zip(("inner", "leaves"), tree[f"{metric}_parts"], strict=True)
    }
    return {**tree, **parts}


def _measured(record: dict[str, Any]) -> Iterator[tuple[int, dict[str, Any], dict[str, Any]]]:
    """Yield the place of a tree, what is other than usual, and measurements, of all experiments."""
    for place, tree in enumerate(record["trees"]):
        yield place, {}, _with_parts(tree)
        for what, values in _cuts(tree):
            yield place, what, values
    # The first tree is timed a second time under another name.
    first = record["trees"][0]
    again = {
        f"{lanes}_ns_again": first[f"{lanes}_ns"] * (1 + timing["repeat_difference"])
        for lanes, timing in record["timing"].items()
    }
    yield 0, {}, again
    if rotation := record.get("rotation"):
        what = {"experiment": "rotation", "rotation": rotation["degrees"],
                "digest": rotation["digest"]}  # fmt: skip
        for place, tree in enumerate(rotation["trees"]):
            yield place, what, _with_parts(tree)
        yield 0, what, {"same_hits": rotation["same_hits"]}
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


def _cuts(tree: dict[str, Any]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield where a tree is cut and what is found there; nothing without that experiment."""
    if "remaining_by_depth" not in tree:
        return
    for depth, values in enumerate(zip(*(tree[name] for name in _BY_DEPTH), strict=True)):
        what = {"experiment": "depth", "cut_depth": depth}
        yield what, dict(zip(_BY_DEPTH.values(), values, strict=True))
    for splits, value in zip(SPLITS, tree["remaining_after_splits"], strict=True):
        if value is not None:
            yield {"experiment": "splits", "splits": splits}, {"worst_case_below_cut": value}


def write_tables(folder: Path, records: list[dict[str, Any]], correlations: pd.DataFrame) -> None:
    """Write ``results.parquet`` (tidy), ``results.csv`` (wide) and ``correlations.csv``."""
    with atomic_path(folder / "results.parquet") as path:
        tidy_table(records).to_parquet(path, index=False)
    for name, table in (("results", wide_table(records)), ("correlations", correlations)):
        with atomic_path(folder / f"{name}.csv") as path:
            table.to_csv(path, index=False)


def write_sheets(folder: Path, sheets: list[Sheet]) -> list[str]:
    """Write tables for people under ``tables/``: the values as CSV, the text as LaTeX.

    Returns
    -------
    list of str
        The files, relative to the folder.
    """
    (folder / "tables").mkdir(exist_ok=True)
    for sheet in sheets:
        with atomic_path(folder / "tables" / f"{sheet.name}.csv") as path:
            sheet.frame.to_csv(path, index=False)
        write_text(folder / "tables" / f"{sheet.name}.tex", sheet.latex())
    return [f"tables/{sheet.name}.{kind}" for sheet in sheets for kind in ("csv", "tex")]
