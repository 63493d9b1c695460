"""The common base class of binary and wide trees."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.files import Stored
from mibvh.triangles import F32, F64, I32, Triangles, read_only


class Hierarchy(Stored):
    """Base class of trees: closed node boxes over ranges of references. An immutable value.

    A subclass is a frozen dataclass. It adds how nodes name their children, and the invariants.
    """

    lower: F32
    upper: F32
    first: I32
    count: I32
    references: I32

    def __post_init__(self) -> None:
        for name in self._ARRAYS:
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields exchanged."""
        return dataclasses.replace(self, **changes)  # type: ignore[type-var] # a dataclass

    # ------------------------------------------------------------ derived arrays

    @property
    def is_leaf(self) -> npt.NDArray[np.bool_]:
        """(M,) bool."""
        raise NotImplementedError

    @functools.cached_property
    def depths(self) -> I32:
        """(M,) int32: edges from the root."""
        raise NotImplementedError

    @functools.cached_property
    def half_areas(self) -> F64:
        """(M,) float64: half the surface area of each node's box."""
        self.check()
        x, y, z = (self.upper.astype(np.float64) - self.lower).T
        return x * y + y * z + z * x

    @property
    def depth(self) -> int:
        """Edges on the longest path from the root to a leaf."""
        return int(self.depths.max())

    @property
    def triangle_count(self) -> int:
        """Number of triangles, of which each has at least one reference."""
        return int(self.meta.get("triangles") or len(np.unique(self.references)))

    @property
    def splits_triangles(self) -> bool:
        """Whether some triangle has more than one reference."""
        return len(self.references) > self.triangle_count

    def stats(self) -> dict[str, Any]:
        """Counts of nodes, leaves and references, leaf sizes, depth and bytes."""
        self.check()
        leaf = self.is_leaf
        sizes, leaf_depths = self.count[leaf], self.depths[leaf]
        return {
            "triangles": self.triangle_count,
            "references": len(self.references),
            "nodes": len(leaf),
            "leaves": len(sizes),
            "depth": self.depth,
            "mean_leaf_depth": float(leaf_depths.mean()),
            "mean_leaf_size": float(sizes.mean()),
            "max_leaf_size": int(sizes.max()),
            "bytes": sum(array.nbytes for array in self._arrays().values()),
        }

    # ------------------------------------------------------------ invariants

    def check(self) -> None:
        """Raise if the tree is invalid, as far as can be checked without its triangles.

        Raises
        ------
        MibvhError
            With the first violation.
        """
        raise NotImplementedError

    def check_matches(self, triangles: Triangles) -> None:
        """Raise if the tree is invalid, or was not built for these triangles.

        Every function that takes a tree and its triangles calls this first. The arrays are
        read-only, so each geometry is checked only once.

        Raises
        ------
        MibvhError
            If the recorded digest or number of triangles does not fit, or with the first
            violation that ``validate`` returns.
        """
        self.check()
        self.check_built_for(triangles)
        if triangles.digest not in self._sound:
            self._refuse(self._geometry_violations(triangles))
            self._sound.add(triangles.digest)

    def check_built_for(self, triangles: Triangles) -> None:
        """Raise if the tree's metadata name other triangles.

        Raises
        ------
        MibvhError
            If the recorded digest or number of triangles does not fit.
        """
        digest, count = self.meta.get("digest"), self.meta.get("triangles")
        if (digest or triangles.digest) != triangles.digest or (count or len(triangles)) != len(
            triangles
        ):
            raise MibvhError(
                f"the {self._KIND} ({self.meta.get('builder', 'unknown builder')}, "
                f"{self.meta.get('triangles', '?')} triangles) was built for another geometry "
                f"than {triangles.name} ({len(triangles)} triangles)"
            )

    def _geometry_violations(self, triangles: Triangles) -> list[str]:
        raise NotImplementedError

    @functools.cached_property
    def _sound(self) -> set[str]:
        """Checks that the arrays have passed: "structure", and digests of triangles."""
        return set()

    def _refuse(self, violations: list[str]) -> None:
        if violations:
            raise MibvhError(f"invalid {self._KIND}: {violations[0]}")

    @classmethod
    def _restored(cls, arrays: dict[str, npt.NDArray[Any]], header: dict[str, Any]) -> Self:
        tree = super()._restored(arrays, header)
        tree.check()
        return tree
