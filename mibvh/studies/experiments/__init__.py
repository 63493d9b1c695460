"""The experiments of a study, a file each.

A new one is a file here with an ``EXPERIMENT``, and its line below. The first is the base of all
others and always made; tables, claims and rows of files come in this order.
"""

from mibvh.studies.experiments import (
    depth,
    kinds,
    prediction,
    rotation,
    sensitivity,
    styles,
    width,
)
from mibvh.studies.record.experiment import add_experiment

for _module in (prediction, depth, rotation, sensitivity, styles, width, kinds):
    add_experiment(_module.EXPERIMENT)
