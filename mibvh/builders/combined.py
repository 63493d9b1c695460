"""Optimisers started from trees that split triangles, by names of their own.

Any optimiser takes another start tree (``start=``). A study compares names, so the combinations
that a study should have are builders, too.
"""

from __future__ import annotations

import dataclasses

from mibvh.builders.draft import Draft
from mibvh.builders.insertion import InsertionOptions, bittner
from mibvh.builders.options import option
from mibvh.builders.registry import Context, builder
from mibvh.builders.treelet import TreeletOptions, treelet
from mibvh.triangles import Triangles


@dataclasses.dataclass(frozen=True, kw_only=True)
class InsertionFromSbvh(InsertionOptions):
    """Options of `bittner_sbvh`."""

    start: str = option("sbvh", "builder of the tree to improve")


@dataclasses.dataclass(frozen=True, kw_only=True)
class InsertionFromStreelet(InsertionOptions):
    """Options of `bittner_streelet`."""

    start: str = option("streelet", "builder of the tree to improve")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TreeletFromSbvh(TreeletOptions):
    """Options of `treelet_sbvh`."""

    start: str = option("sbvh", "builder of the tree to start from")


@builder(
    "bittner_sbvh",
    summary="insertion-based optimisation of `sbvh`: the best combination that knows no rays",
    source="Bittner, Hapala, Havran 2013; Stich, Friedrich and Dietrich 2009",
    options=InsertionFromSbvh,
)
def bittner_sbvh(triangles: Triangles, options: InsertionFromSbvh, context: Context) -> Draft:
    """Improve the SBVH by reinsertion."""
    return bittner(triangles, options, context)


@builder(
    "bittner_streelet",
    summary="insertion-based optimisation of `streelet`",
    source="Bittner, Hapala, Havran 2013; Karras and Aila 2013",
    options=InsertionFromStreelet,
)
def bittner_streelet(
    triangles: Triangles, options: InsertionFromStreelet, context: Context
) -> Draft:
    """Improve the tree of treelets over split triangles by reinsertion."""
    return bittner(triangles, options, context)


@builder(
    "treelet_sbvh",
    summary="treelets of `sbvh` rearranged",
    source="Karras and Aila 2013; Stich, Friedrich and Dietrich 2009",
    options=TreeletFromSbvh,
)
def treelet_sbvh(triangles: Triangles, options: TreeletFromSbvh, context: Context) -> Draft:
    """Rearrange the treelets of the SBVH."""
    return treelet(triangles, options, context)
