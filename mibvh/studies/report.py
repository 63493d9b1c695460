"""The report: one HTML file that works offline, and its figures and tables as files."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mibvh.files import atomic_path, write_text
from mibvh.studies import figures
from mibvh.studies.analyse import (
    MEASUREMENTS,
    PREDICTORS,
    calibrate,
    column,
    overview,
    relative_to,
)

#: What the paper's slides give for Pearson's r over 22 scenes (mean, minimum, maximum).
PAPER = {"SAH": (0.915, 0.652, 0.998), "fitted": (0.994, 0.988, 0.999),
         "fixed 0.79": (0.980, 0.886, 0.999)}  # fmt: skip
#: Columns of the per-builder table: key, heading, format, what it says.
COLUMNS = [
    ("sah", "SAH", "{:.2f}", "surface area heuristic"),
    ("epo", "EPO", "{:.3f}", "end-point overlap"),
    ("lcv", "LCV", "{:.3f}", "leaf count variability"),
    ("counted_cost", "counted cost", "{:.2f}", "1.2 per inner node and 1.0 per triangle, per ray"),
    ("scalar_ns", "scalar ns/ray", "{:.0f}", "kernel time, one lane per packet"),
    ("simd_ns", "SIMD ns/ray", "{:.0f}", "kernel time, all lanes"),
    ("inner_per_ray", "inner", "{:.1f}", "inner nodes visited per ray"),
    ("leaves_per_ray", "leaves", "{:.2f}", "leaves visited per ray"),
    ("triangles_per_ray", "triangles", "{:.2f}", "triangles tested per ray"),
    ("lane_utilisation", "lanes busy", "{:.0%}", "active lane-steps over issued ones"),
    ("nodes", "nodes", "{:,}", "inner nodes and leaves"),
    ("references", "references", "{:,}", "entries of the leaves"),
    ("depth", "depth", "{}", "levels"),
    ("mean_leaf_size", "leaf size", "{:.2f}", "references per leaf"),
    ("build_seconds", "build s", "{:.2f}", "seconds to build"),
]


@functools.cache
def _template() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("mibvh.studies", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html")


def write_report(folder: Path, records: list[dict[str, Any]], table: pd.DataFrame) -> Path:
    """Write ``report.html``, and each figure as SVG and PNG under ``figures/``."""
    drawn = {"summary": figures.summary(table)}
    for record in records:
        name = record["scene"]
        drawn[f"{name}-scalar"] = figures.predicted_measured(record, "scalar_ns")
        drawn[f"{name}-counted"] = figures.predicted_measured(record, "counted_cost")
        drawn[f"{name}-depth"] = figures.by_depth(record)
    (folder / "figures").mkdir(exist_ok=True)
    inline = {}
    for name, figure in drawn.items():
        inline[name] = figures.svg(figure)
        write_text(folder / "figures" / f"{name}.svg", inline[name].replace("currentColor", "#222"))
        with atomic_path(folder / "figures" / f"{name}.png") as path:
            path.write_bytes(figures.png(figure))
    page = _template().render(
        records=records,
        overview=_overview_rows(overview(table)),
        scenes=[_scene(record, table, inline) for record in records],
        summary=inline["summary"],
        columns=COLUMNS,
        predictors=PREDICTORS,
        calibration={lanes: calibrate(records, f"{lanes}_ns") for lanes in ("scalar", "simd")},
        relative=_relative(records),
        environment=records[-1]["environment"],
        options=records[-1]["options"],
    )
    target = folder / "report.html"
    write_text(target, page)
    return target


#: The slides' EPO per builder, relative to lbvh.
PAPER_EPO = {
    "agglo": 1.07,
    "anneal": 0.81,
    "treelet": 0.52,
    "bbvh": 0.46,
    "bittner": 0.45,
    "lbvh": 1.0,
}


def _relative(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the table of metrics relative to lbvh, mean over the scenes."""
    names = ("sah", "epo", "lcv", "counted_cost", "scalar_ns", "simd_ns")
    columns = [relative_to(records, name) for name in names]
    return [
        {
            "builder": builder,
            "values": [c.get(builder, float("nan")) for c in columns],
            "paper": PAPER_EPO.get(builder),
        }
        for builder in columns[0].index
    ]


def _number(value: float, form: str = "{:.3f}") -> str:
    return form.format(value) if np.isfinite(value) else "–"


def _overview_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows = []
    for (measurement, predictor), row in table.iterrows():
        paper = PAPER.get(predictor) if measurement == "scalar_ns" else None
        rows.append({
            "measurement": MEASUREMENTS[measurement], "predictor": predictor,
            "values": [_number(row[c]) for c in ("mean", "min", "max")],
            "worst": _number(row["worst_error"], "{:.0%}"),
            "help": PREDICTORS[predictor],
            "scenes": int(row["scenes"]),
            "paper": [_number(v) for v in paper] if paper else ["", "", ""],
        })  # fmt: skip
    return rows


def _scene(record: dict[str, Any], table: pd.DataFrame, inline: dict[str, str]) -> dict[str, Any]:
    best = {key: column(record, key).min() for key in ("sah", "epo", "lcv", "counted_cost",
                                                        "scalar_ns", "simd_ns")}  # fmt: skip
    rows = [
        [
            {
                "text": form.format(tree[key]),
                "sort": tree[key],
                "best": key in best and tree[key] == best[key],
                "error": f"±{tree[key.replace('_ns', '_error')]:.1%}"
                if key.endswith("_ns")
                else "",
            }
            for key, _, form, _ in COLUMNS
        ]
        for tree in record["trees"]
    ]
    of = table[table["scene"] == record["scene"]]
    return {
        "name": record["scene"],
        "triangles": f"{record['triangles']:,}",
        "rays": f"{record['rays']['count']:,}",
        "viewpoints": record["rays"]["viewpoints"],
        "notes": record["notes"],
        "picture": record["picture"]["png"],
        "builders": [tree["builder"] for tree in record["trees"]],
        "rows": rows,
        "timing": record["timing"],
        "correlations": [
            {
                "measurement": MEASUREMENTS[row["measurement"]],
                "predictor": row["predictor"],
                "alpha": _number(row["alpha"], "{:.2f}"),
                "values": [_number(row[c]) for c in ("pearson", "low", "high", "held_out",
                                                     "without_worst", "spearman", "kendall")],
                "worst": _number(row["worst_error"], "{:.1%}"),
                "trees": row["trees"],
            }
            for _, row in of.iterrows()
        ],
        "scalar": inline[f"{record['scene']}-scalar"],
        "counted": inline[f"{record['scene']}-counted"],
        "depth": inline[f"{record['scene']}-depth"],
    }  # fmt: skip
