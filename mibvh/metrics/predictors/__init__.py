"""Predictors of cost: one file per family, and a registry that users can add to."""

from mibvh.metrics.predictors.registry import (
    Predictor,
    Sample,
    Values,
    Weights,
    add_predictor,
    alpha_of,
    faults,
    glossary,
    predictor,
    predictors,
)

__all__ = [
    "Predictor",
    "Sample",
    "Values",
    "Weights",
    "add_predictor",
    "alpha_of",
    "faults",
    "glossary",
    "predictor",
    "predictors",
]
