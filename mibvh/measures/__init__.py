"""Measures: the cost of a box, for builders, optimisers and the leaf collapse."""

from mibvh.measures.area import Area, Measure
from mibvh.measures.flux import Flux
from mibvh.measures.segments import Segments

__all__ = ["Area", "Flux", "Measure", "Segments"]
