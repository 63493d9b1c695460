"""Tree: a binary BVH as flat arrays, with its invariants, statistics and file format."""

from __future__ import annotations

import dataclasses
import functools
import os
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.files import read_arrays, write_arrays
from mibvh.triangles import F32, F64, I32, Triangles

#: Inner nodes on a path; the traversal stack holds as many entries.
MAX_DEPTH = 64
_ARRAYS = ("lower", "upper", "left", "first", "count", "references")


@dataclasses.dataclass(frozen=True, eq=False)
class Tree:
    """A binary bounding volume hierarchy. An immutable value: arrays and a little metadata.

    Node 0 is the root; the children of an inner node ``n`` are ``left[n]`` and
    ``left[n] + 1``; parents come before their children.

    Attributes
    ----------
    lower, upper : (M, 3) float32
        Closed node boxes in scene units.
    left : (M,) int32
        First child; -1 for a leaf.
    first, count : (M,) int32
        The node's range in ``references`` (for inner nodes too: all of their subtree).
    references : (R,) int32
        Triangle ids in leaf order. An id stands more than once where spatial splits made
        several references of one triangle.
    meta : dict
        JSON-able: builder, options, build_seconds, triangles (count), digest, c_inner,
        c_tri, and what the builder reports.
    """

    lower: F32
    upper: F32
    left: I32
    first: I32
    count: I32
    references: I32
    meta: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self.left)

    def replace(self, **changes: Any) -> Tree:
        """Return a copy with some fields exchanged."""
        return dataclasses.replace(self, **changes)

    # ------------------------------------------------------------ derived arrays

    @property
    def is_leaf(self) -> npt.NDArray[np.bool_]:
        """(M,) bool."""
        return self.left < 0

    @functools.cached_property
    def half_areas(self) -> F64:
        """(M,) float64: half the surface area of each node's box."""
        x, y, z = (self.upper.astype(np.float64) - self.lower).T
        return x * y + y * z + z * x

    @functools.cached_property
    def parents(self) -> I32:
        """(M,) int32: each node's parent; -1 for the root."""
        parents = np.full(len(self), -1, np.int32)
        inner = np.flatnonzero(~self.is_leaf).astype(np.int32)
        parents[self.left[inner]] = inner
        parents[self.left[inner] + 1] = inner
        return parents

    @functools.cached_property
    def depths(self) -> I32:
        """(M,) int32: edges from the root."""
        depths = np.zeros(len(self), np.int32)
        level = np.zeros(1, np.int64)
        while len(level := level[self.left[level] >= 0]):
            children = np.concatenate([self.left[level], self.left[level] + 1])
            depths[children] = depths[level[0]] + 1
            level = children
        return depths

    @property
    def depth(self) -> int:
        """Edges on the longest path from the root to a leaf."""
        return int(self.depths.max())

    @property
    def splits_triangles(self) -> bool:
        """Whether some triangle has more than one reference."""
        return len(self.references) > self.meta.get("triangles", len(np.unique(self.references)))

    def stats(self) -> dict[str, Any]:
        """Counts of nodes, leaves and references, leaf sizes, depth and bytes."""
        sizes = self.count[self.is_leaf]
        leaf_depths = self.depths[self.is_leaf]
        return {
            "triangles": int(self.meta.get("triangles", len(np.unique(self.references)))),
            "references": len(self.references),
            "nodes": len(self),
            "leaves": len(sizes),
            "depth": self.depth,
            "mean_leaf_depth": float(leaf_depths.mean()),
            "mean_leaf_size": float(sizes.mean()),
            "max_leaf_size": int(sizes.max()),
            "bytes": sum(getattr(self, name).nbytes for name in _ARRAYS),
        }

    # ------------------------------------------------------------ invariants

    def validate(self, triangles: Triangles | None = None) -> list[str]:
        """Check every invariant and return the faults found, as sentences.

        Parameters
        ----------
        triangles : Triangles, optional
            With them, also check that leaf boxes hold their triangles, and that every
            split triangle is covered by the leaves it is in.

        Returns
        -------
        list of str
            Empty for a sound tree.
        """
        from mibvh.validation import faults

        return faults(self, triangles)

    # ------------------------------------------------------------ files

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an ``.npz`` file; see :func:`mibvh.files.write_arrays`."""
        write_arrays(path, {name: getattr(self, name) for name in _ARRAYS}, self.meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Tree:
        """Read a tree back.

        Raises
        ------
        MibvhError
            If the file is missing, is no tree, is damaged, or comes from a newer format.
        """
        arrays, meta = read_arrays(path, "tree", _ARRAYS)
        return cls(**arrays, meta=meta)

    def check_matches(self, triangles: Triangles) -> None:
        """Refuse triangles that this tree was not built for.

        Raises
        ------
        MibvhError
            If the recorded digest, or failing one the reference range, does not fit.
        """
        digest = self.meta.get("digest")
        fits = (
            int(self.references.max()) < len(triangles)
            if digest is None
            else (digest == triangles.digest)
        )
        if not fits:
            raise MibvhError(
                f"the tree ({self.meta.get('builder', 'unknown builder')}, "
                f"{self.meta.get('triangles', '?')} triangles) was built for another geometry "
                f"than {triangles.name} ({len(triangles)} triangles)"
            )
