"""Pictures of trees, as matplotlib objects.

Each function draws into the Axes given as ``ax``, or makes a figure, and returns the Axes;
:func:`overview` returns a Figure. ``import mibvh`` does not load matplotlib; this does.
"""

from mibvh.plot.charts import by_depth, leaf_sizes, predicted_measured, sah_epo
from mibvh.plot.overview import overview
from mibvh.plot.slices import overlap_slice
from mibvh.plot.wireframe import wireframe

__all__ = [
    "by_depth",
    "leaf_sizes",
    "overlap_slice",
    "overview",
    "predicted_measured",
    "sah_epo",
    "wireframe",
]
