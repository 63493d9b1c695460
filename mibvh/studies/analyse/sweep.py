"""Sweeps: trees of one builder that differ in one numeric option."""

from __future__ import annotations

import dataclasses
import json

import numpy as np

from mibvh.builders.chosen import builder_of
from mibvh.studies.record.scene import SceneRecord, TreeRow
from mibvh.triangles import F64

#: Trees that make a curve.
_FEWEST = 3


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Trees of a scene that differ in one option of their builder.

    Attributes
    ----------
    builder, option : str
    values : list of float
        Of the option, rising.
    trees : list of TreeRow
        One for each value.
    """

    builder: str
    option: str
    values: list[float]
    trees: list[TreeRow]

    @property
    def name(self) -> str:
        """A title for the trees."""
        return f"{self.builder}, {len(self.trees)} trees"

    def column(self, name: str) -> F64:
        """(K,) float64: a quantity of each tree."""
        return np.array([tree[name] for tree in self.trees], dtype=np.float64)


def sweeps(record: SceneRecord) -> list[Sweep]:
    """Find the groups of trees that differ in one numeric option only.

    Returns
    -------
    list of Sweep
        The longest of each builder and option.
    """
    longest: dict[tuple[str, str], Sweep] = {}
    groups: dict[tuple[str, str, str], list[TreeRow]] = {}
    for tree in record.trees:
        for option, value in tree.options.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                others = {name: of for name, of in tree.options.items() if name != option}
                alike = json.dumps(others, sort_keys=True)
                groups.setdefault((builder_of(tree.builder), option, alike), []).append(tree)
    for (builder, option, _), trees in groups.items():
        if len(trees) < _FEWEST:
            continue
        trees.sort(key=lambda tree: float(tree.options[option]))
        found = Sweep(builder, option, [float(t.options[option]) for t in trees], trees)
        known = longest.get((builder, option))
        if known is None or len(known.trees) < len(trees):
            longest[builder, option] = found
    return list(longest.values())
