"""Draft: what a builder hands over, and the references it starts from.

A builder decides topology only. Bounds, the collapse to leaves, de-duplication, depth and
memory layout are the same code for all of them (:mod:`mibvh.builders.finish`), so that
trees differ by algorithm alone.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mibvh.triangles import F32, F64, I32, Triangles


@dataclasses.dataclass(frozen=True, eq=False)
class References:
    """Boxes that a tree is built over: one per triangle, or several where it was split.

    Attributes
    ----------
    lower, upper : (R, 3) float32
        Boxes in builder units: scene units times ``scale``.
    triangle : (R,) int32
        The triangle each box belongs to.
    scale : float
        A power of two that brings the scene's extent near 1, so that areas neither
        underflow nor overflow in float32 and scaling back is exact.
    """

    lower: F32
    upper: F32
    triangle: I32
    scale: float = 1.0

    def __len__(self) -> int:
        return len(self.triangle)

    @classmethod
    def of(cls, triangles: Triangles) -> References:
        """One reference per triangle, under the triangle's own box."""
        largest = float(np.abs(triangles.bounds).max())
        scale = 2.0 ** -np.frexp(largest)[1] if largest > 0 else 1.0
        scale = float(np.float32(scale))
        return cls(
            triangles.lower * np.float32(scale),
            triangles.upper * np.float32(scale),
            np.arange(len(triangles), dtype=np.int32),
            scale,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Draft:
    """A binary tree over references, with exactly one reference in each leaf.

    Attributes
    ----------
    references : References
        The boxes at the leaves.
    left, right : (2R - 1,) int32
        Children of each node, in any order in memory; -1 for a leaf. Node 0 is the root.
    reference : (2R - 1,) int32
        A leaf's reference; -1 for an inner node.
    report : dict
        JSON-able facts the builder wants kept with the tree (iterations, SAH before and
        after, ...).
    """

    references: References
    left: I32
    right: I32
    reference: I32
    report: dict[str, Any] = dataclasses.field(default_factory=dict)

    @classmethod
    def from_nested(cls, nested: Any, triangles: Triangles) -> Draft:
        """Make a draft from nested pairs, the easy way to write a builder of one's own.

        Parameters
        ----------
        nested : tuple or array of int
            Either a pair ``(left, right)`` of such values, or the ids of the triangles of a
            leaf. Leaves of several triangles are halved in the order given, and the common
            leaf collapse joins them again where that is cheaper.
        triangles : Triangles
            What the ids index.
        """
        left: list[int] = [-1]
        right: list[int] = [-1]
        reference: list[int] = [-1]
        work: list[tuple[int, Any]] = [(0, nested)]
        while work:
            node, value = work.pop()
            if not isinstance(value, tuple):
                ids = np.atleast_1d(np.asarray(value, dtype=np.int64))
                if len(ids) == 1:
                    reference[node] = int(ids[0])
                    continue
                value = (ids[: len(ids) // 2], ids[len(ids) // 2 :])
            children = [len(left), len(left) + 1]
            left[node], right[node] = children
            for child, part in zip(children, value, strict=True):
                left.append(-1)
                right.append(-1)
                reference.append(-1)
                work.append((child, part))
        return cls(
            References.of(triangles),
            np.array(left, np.int32),
            np.array(right, np.int32),
            np.array(reference, np.int32),
        )


def centers_twice(references: References) -> F32:
    """(R, 3) float32: twice the box centres, which is what the sweeps sort by.

    Box centres, not triangle centroids: on mixed triangle sizes centroids cost a peer
    21% in SAH.
    """
    return references.lower + references.upper


def reference_areas(references: References) -> F64:
    """(R,) float64: half the surface area of each box, in builder units."""
    x, y, z = (references.upper.astype(np.float64) - references.lower).T
    return x * y + y * z + z * x
