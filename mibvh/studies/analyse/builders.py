"""Comparisons of builders."""

from __future__ import annotations

import pandas as pd

from mibvh.studies.record.scene import Records


def relative_to(records: Records, name: str, base: str = "lbvh") -> pd.Series:
    """Mean over the scenes of a quantity, per builder, relative to one builder.

    Parameters
    ----------
    records : sequence of SceneRecord
    name : str
        A quantity, such as ``epo``.
    base : str
        The builder that is 1.

    Returns
    -------
    Series
        By builder; empty where no scene has the base builder.
    """
    rows = [
        {tree.builder: tree[name] / of_base[name] for tree in record.trees}
        for record in records
        for of_base in record.trees
        if of_base.builder == base and of_base[name] > 0
    ]
    return pd.DataFrame(rows).mean() if rows else pd.Series(dtype=float)


def relative_to_best(
    records: Records, name: str = "sah", without: frozenset[str] = frozenset()
) -> pd.DataFrame:
    """How far each builder's trees are above the best tree of the scene.

    Parameters
    ----------
    records : sequence of SceneRecord
    name : str
        A quantity.
    without : set of str
        Builders that are left out.

    Returns
    -------
    DataFrame
        Index ``builder``; ``mean`` and ``max`` over the scenes of the quantity over the least of
        the scene's trees, and ``scene``: where the greatest is.
    """
    rows = []
    for record in records:
        trees = [tree for tree in record.trees if tree.builder not in without]
        least = min((tree[name] for tree in trees), default=0.0)
        if least > 0:
            rows += [
                {"builder": tree.builder, "scene": record.scene, "ratio": tree[name] / least}
                for tree in trees
            ]
    table = pd.DataFrame(rows, columns=["builder", "scene", "ratio"])
    groups = table.groupby("builder", sort=False)["ratio"]
    found = pd.DataFrame({"mean": groups.mean(), "max": groups.max()})
    found["scene"] = table.loc[groups.idxmax(), "scene"].to_numpy() if len(table) else []
    return found


def splitting_builders(records: Records) -> frozenset[str]:
    """Builders that split triangles in some scene."""
    return frozenset(
        tree.builder for record in records for tree in record.trees if record.splits_triangles(tree)
    )
