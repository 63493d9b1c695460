"""The numbers that the prose of README and docs quotes: taken from the study, not typed.

A number in the prose is followed by a comment with its key, which no reader of the page sees:
``0.925<!--r.scalar.SAH.mean-->``. ``make results`` writes the numbers into
``docs/results/quoted.json`` and in front of their keys; a test holds the prose against the file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mibvh.errors import MibvhError
from mibvh.files import write_text
from mibvh.studies.analyse.builders import relative_to, relative_to_best
from mibvh.studies.analyse.calibration import absolute_errors
from mibvh.studies.analyse.correlations import LANES, overview, worst_error
from mibvh.studies.analyse.noise import simd_deviation
from mibvh.studies.analyse.rotation import headings, rotation_factors
from mibvh.studies.record.scene import Records

#: A number in the prose, and the key behind it.
MARKED = re.compile(r"([^\s<>(|]+)<!--([^\s<>]+)-->")
#: What measurements are called in keys.
_MEASURED = {"counted_cost": "counted", "scalar_ns": "scalar", "simd_ns": "SIMD"}


def quoted(records: Records, found: pd.DataFrame) -> dict[str, str]:
    """Return the numbers as they are written, by key.

    Parameters
    ----------
    records : sequence of SceneRecord
    found : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    sizes = [record.triangles for record in records]
    return {
        "scenes": str(len(records)),
        "trees": str(sum(len(record.trees) for record in records)),
        "triangles.min": f"{min(sizes):,}",
        "triangles.max": f"{max(sizes):,}",
        **dict(_correlations(found)),
        **dict(_builders(records)),
        **dict(_level(records)),
        **dict(_rotation(records)),
        **dict(_times(records)),
    }


def _correlations(found: pd.DataFrame) -> Iterator[tuple[str, str]]:
    summary = overview(found)
    for (measured, name), row in summary.iterrows():
        if measured in _MEASURED and np.isfinite(row["mean"]):
            key = f"{_MEASURED[measured]}.{name.replace(' ', '-')}"
            yield f"r.{key}.mean", f"{row['mean']:.3f}"
            yield f"r.{key}.min", f"{row['min']:.3f}"
            yield f"error.{key}.max", f"{row['worst_error']:.0%}"
    fitted = found[(found["predictor"] == "fitted") & (found["measurement"] == "counted_cost")]
    if fitted["alpha"].notna().any():
        yield "alpha.min", f"{fitted['alpha'].min():.2f}"
        yield "alpha.max", f"{fitted['alpha'].max():.2f}"
        yield "alpha.mean", f"{fitted['alpha'].mean():.2f}"
    one = found[(found["predictor"] == "fixed best") & (found["measurement"] == "counted_cost")]
    if one["alpha"].notna().any():
        yield "alpha.best", f"{one['alpha'].mean():.2f}"
    worst = found[(found["predictor"] == "SAH") & (found["measurement"] == "scalar_ns")]
    yield "error.scalar.SAH.scenes-of-30%", str(int((worst["worst_error"] >= 0.3).sum()))


def _builders(records: Records) -> Iterator[tuple[str, str]]:
    for name in ("sah", "epo", "counted_cost", "scalar_ns"):
        for builder, share in relative_to(records, name).items():
            yield f"relative.{builder}.{name}", f"{share:.0%}"
    for builder, row in relative_to_best(records).iterrows():
        yield f"over-best.{builder}.mean", f"{row['mean'] - 1:.0%}"
        yield f"over-best.{builder}.max", f"{row['max'] - 1:.0%}"


def _level(records: Records) -> Iterator[tuple[str, str]]:
    table = absolute_errors(records)
    yield "level.finite.low", f"{table['bias'].min():+.0%}"
    yield "level.finite.high", f"{table['bias'].max():+.0%}"
    yield "level.finite.within-15%", str(int((table["bias"].abs() <= 0.15).sum()))
    yield "level.finite.spread.max", f"{table['spread'].max():.0%}"
    yield "level.finite.spread.median", f"{table['spread'].median():.0%}"


def _rotation(records: Records) -> Iterator[tuple[str, str]]:
    factors = rotation_factors(records)
    if factors.empty:
        return
    keys = list(headings())
    by_scene = factors.groupby("scene", sort=False)[keys].mean()
    for key in keys:
        yield f"rotation.{key}", f"{by_scene[key].mean():.1f}"
    for builder, row in factors.groupby("builder", sort=False)[keys].mean().iterrows():
        yield f"rotation.{builder}.scalar_ns", f"{row['scalar_ns']:.1f}"
    yield "rotation.scenes", str(len(by_scene))


def _times(records: Records) -> Iterator[tuple[str, str]]:
    for lanes in LANES:
        yield f"times.{lanes.title}.error.max", f"{worst_error(records, lanes.error):.1%}"
        twice = [abs(record.timing[lanes.key].repeat_difference) for record in records]
        yield f"times.{lanes.title}.twice.max", f"{np.nanmax(twice):.1%}"
    yield "simd.deviation.mean", f"{simd_deviation(records)['deviation'].mean():.0%}"


def fill(text: str, values: Mapping[str, str], page: str = "") -> str:
    """Write the numbers in front of their keys.

    Raises
    ------
    MibvhError
        If a key has no number.
    """

    def replaced(found: re.Match[str]) -> str:
        if found[2] not in values:
            raise MibvhError(f"{page}: no number is known for {found[2]}")
        return f"{values[found[2]]}<!--{found[2]}-->"

    return MARKED.sub(replaced, text)


def read(path: Path) -> dict[str, Any]:
    """Return what ``quoted.json`` holds: the numbers as ``values``, and what they are of."""
    return dict(json.loads(path.read_text(encoding="utf-8")))


def write(path: Path, values: Mapping[str, str], **of: str) -> None:
    """Write ``quoted.json``."""
    held = {**of, "values": dict(values)}
    write_text(path, json.dumps(held, indent=1, ensure_ascii=False) + "\n")
