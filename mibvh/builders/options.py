"""Options of builders: declared with their ranges, checked when they are given."""

from __future__ import annotations

import dataclasses
from typing import Any

from mibvh.errors import MibvhError
from mibvh.nodes import C_INNER, C_TRI


def option(default: Any, help: str, low: float | None = None, high: float | None = None) -> Any:
    """Declare a builder option.

    Parameters
    ----------
    default : bool, int, float or str
        Values must be of its type.
    help : str
        What it does.
    low, high : float, optional
        Ends of the range, allowed themselves; both or none.

    Returns
    -------
    dataclasses.Field
    """
    return dataclasses.field(default=default, metadata={"help": help, "low": low, "high": high})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """What every builder takes. A builder's own options inherit from this.

    Attributes
    ----------
    max_leaf : int
        Triangles in a leaf, at most.
    c_inner, c_tri : float
        Cost of an inner node, and of a triangle test; the paper's constants by default (Aila,
        Karras and Laine, HPG 2013).
    presplit : float
        References that splitting triangles up front may add, as a share of the triangles.

    Raises
    ------
    MibvhError
        If a value is of the wrong type or outside its range.
    """

    max_leaf: int = option(8, "largest number of triangles in a leaf", 1, 255)
    c_inner: float = option(C_INNER, "cost of an inner node (the paper's constant)", 0.0, 1e6)
    c_tri: float = option(C_TRI, "cost of a triangle test (the paper's constant)", 1e-6, 1e6)
    presplit: float = option(
        0.0,
        "references that splitting triangles up front may add, per triangle (0.3); for builders "
        "that split none themselves",
        0.0,
        8.0,
    )

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value, kind = getattr(self, field.name), type(field.default)
            if kind is float and isinstance(value, int):
                value = float(value)
                object.__setattr__(self, field.name, value)
            if type(value) is not kind:
                raise MibvhError(
                    f"option {field.name} must be of type {kind.__name__}, not {value!r}"
                )
            low, high = field.metadata.get("low"), field.metadata.get("high")
            if low is not None and high is not None and not low <= value <= high:
                raise MibvhError(f"option {field.name} must be from {low} to {high}, not {value}")
