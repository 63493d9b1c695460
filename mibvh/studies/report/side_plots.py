"""Plots of trees of more children per node, and of kinds of rays: a panel for each."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from mibvh.metrics.predictor import pearson
from mibvh.metrics.predictors import Sample
from mibvh.plot.marks import named_points
from mibvh.studies.analyse.correlations import predicted
from mibvh.studies.measure.widths import WidthResult, columns_at
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.plots import _figure, _name, _tip, style


def at_widths(record: SceneRecord, found: WidthResult) -> Figure:
    """SAH with EPO against counted cost of a scene's trees, a panel per width.

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


def side_by_side(record: SceneRecord, samples: Mapping[str, Sample]) -> Figure:
    """SAH with EPO against counted cost of a scene's trees, a panel per sample.

    Parameters
    ----------
    record : SceneRecord
    samples : mapping of str to Sample
        By the titles of their panels.
    """
    builders = [tree.builder for tree in record.trees]
    with style():
        figure, axes = _figure(len(samples))
        for axis, (title, sample) in zip(axes, samples.items(), strict=True):
            alpha, values = predicted("fitted", sample)
            if not np.isfinite(alpha):
                alpha, values = predicted("fixed 0.79", sample)
            gids = [
                f"{_tip(name)}{name}, {title}: counted cost {y:.4g}, predicted {x:.4g}"
                for name, x, y in zip(builders, values, sample.measured, strict=True)
            ]
            named_points(axis, builders, values, sample.measured, line=True, gids=gids)
            r = pearson(values, sample.measured)
            said = f"{title}, α = {alpha:.2f}" + (f":  r = {r:.3f}" if np.isfinite(r) else "")
            _name(axis, said, "predicted cost", "counted cost")
    return figure
