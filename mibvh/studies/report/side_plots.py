"""Figures of wide trees and of kinds of rays, one panel each."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mibvh.metrics.predictor import pearson
from mibvh.metrics.predictors import Sample
from mibvh.studies.analyse.correlations import predicted
from mibvh.studies.measure.widths import WidthResult, columns_at
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.agreement import limits_beside, scatter
from mibvh.studies.report.axes import Panel
from mibvh.studies.report.drawing import Drawing
from mibvh.studies.report.layout import row_of_panels


def at_widths(record: SceneRecord, found: WidthResult) -> Drawing:
    """Draw SAH with EPO against counted cost of a scene's trees, one panel per width.

    Parameters
    ----------
    record : SceneRecord
    found : WidthResult
        Of this scene.
    """
    samples = {}
    for width in found.widths:
        values = columns_at(found, width)
        samples[f"{width} children"] = Sample(values, values["counted_cost"])
    return side_by_side(record, samples)


def side_by_side(record: SceneRecord, samples: Mapping[str, Sample]) -> Drawing:
    """Draw SAH with EPO against counted cost of a scene's trees, one panel per sample.

    Parameters
    ----------
    record : SceneRecord
    samples : mapping of str to Sample
        By the titles of their panels.
    """
    builders = [tree.builder for tree in record.trees]
    sheet, parts = row_of_panels(panels=len(samples))
    for part, (title, sample) in zip(parts, samples.items(), strict=True):
        alpha, values = predicted("fitted", sample)
        if not np.isfinite(alpha):
            alpha, values = predicted("fixed 0.79", sample)
        r = pearson(values, sample.measured)
        said = f"{title}, α = {alpha:.2f}" + (f":  r = {r:.3f}" if np.isfinite(r) else "")
        limits = limits_beside(values, sample.measured)
        panel = Panel(sheet, part, *limits, title=said, labels=("predicted cost", "counted cost"))
        tips = [
            f"{name}, {title}: counted cost {y:.4g}, predicted {x:.4g}"
            for name, x, y in zip(builders, values, sample.measured, strict=True)
        ]
        scatter(panel, builders, values, sample.measured, tips)
    return sheet
