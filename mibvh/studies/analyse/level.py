"""The error in the level of finite rays, as a product of three factors.

``s SAH + Q`` is held against counted cost by way of two figures between them: the same formula with
the rays' own lines, and ``touched``, the cost of all nodes that a ray touches up to its hit.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import finite_ray_cost
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.triangles import F64

_NEEDS = ("sah", "point_query", "length_ratio", "sah_lines", "line_share", "touched")


def level_pieces(records: Records) -> pd.DataFrame:
    """Factor the error in the level of finite rays.

    Returns
    -------
    DataFrame
        Per scene the geometric mean over its trees of

        - ``which_lines``: finite rays over finite by lines. Rays do not lie on uniformly
          distributed lines, and their share of a chord is not that of the mean lengths.
        - ``along``: finite by lines over ``touched``. A ray does not meet its line's cost evenly:
          it begins in dense geometry, and one that leaves the scene ends in empty space.
        - ``order``: ``touched`` over counted cost. A traversal visits nodes that it pushed before
          it knew where the ray ends.
        - ``level``: their product, finite rays over counted cost.
        - ``hit_share``: the rays that hit something.
    """
    rows = []
    for record in records:
        if all(name in tree.values for tree in record.trees for name in _NEEDS):
            rows.append({"scene": record.scene, **_pieces(record)})
    return pd.DataFrame(
        rows, columns=["scene", "hit_share", "level", "which_lines", "along", "order"]
    )


def _pieces(record: SceneRecord) -> dict[str, float]:
    query, touched = record.column("point_query"), record.column("touched")
    share = float(record.column("line_share")[0])
    finite = finite_ray_cost(record.column("sah"), query, float(record.column("length_ratio")[0]))
    by_lines = finite_ray_cost(record.column("sah_lines"), query, share)
    counted = record.column("counted_cost")
    return {
        "hit_share": float(record.column("hit_share")[0]),
        "level": _mean(finite / counted),
        "which_lines": _mean(finite / by_lines),
        "along": _mean(by_lines / touched),
        "order": _mean(touched / counted),
    }


def _mean(ratios: F64) -> float:
    """Geometric mean; NaN if a ratio is NaN or negative."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.exp(np.log(ratios).mean()))
