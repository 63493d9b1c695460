"""Draft: what a builder hands over, and the references it starts from.

A builder decides topology only. Bounds, the collapse to leaves, de-duplication, depth and
memory layout are the same code for all of them (:mod:`mibvh.builders.finish`), so that
trees differ by algorithm alone.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.triangles import F32, I32, Triangles


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
        corners = triangles.corners.reshape(-1, 9)
        # Not beyond what float32 holds, whose smallest numbers have larger reciprocals.
        largest = np.uint32(_largest(corners.reshape(-1).view(np.uint32))).view(np.float32)
        exponent = min(126, -int(np.frexp(largest)[1]))
        lower = np.empty((len(corners), 3), np.float32)
        upper = np.empty((len(corners), 3), np.float32)
        scale = 2.0**exponent
        _boxes(corners, np.float32(scale), np.float32(1.0 / scale), lower, upper)
        return cls(lower, upper, np.arange(len(corners), dtype=np.int32), scale)


@njit(allocates=False)
def _largest(bits):
    """Bits of the largest magnitude, from the bits of float32 values.

    Without the sign, they compare as integers, which takes LLVM to vector instructions.
    """
    largest = np.uint32(0)
    for i in range(np.uint64(len(bits))):
        largest = max(largest, bits[i] & np.uint32(0x7FFFFFFF))
    return largest


@njit(allocates=False)
def _boxes(corners, scale, unscale, lower, upper):
    """Scaled boxes of triangles, given as rows of nine coordinates.

    Beside huge coordinates, tiny ones are scaled into the range where float32 loses
    digits. Then a box is moved outwards by the smallest number there is, so that it holds
    its triangle all the same.
    """
    tiny = np.float32(2.0**-149)
    for i in range(np.uint64(len(corners))):
        for k in range(np.uint64(3)):
            a, b, c = corners[i, k], corners[i, k + np.uint64(3)], corners[i, k + np.uint64(6)]
            low = a if a < b else b
            low = low if low < c else c
            high = a if a > b else b
            high = high if high > c else c
            x, y = low * scale, high * scale
            lower[i, k] = x - tiny if x * unscale > low else x
            upper[i, k] = y + tiny if y * unscale < high else y


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
    measure : None or tuple
        Compiled measure that leaves are to be collapsed by, where that is not the one the build
        was asked for.
    """

    references: References
    left: I32
    right: I32
    reference: I32
    report: dict[str, Any] = dataclasses.field(default_factory=dict)
    measure: Any = None

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

        Raises
        ------
        MibvhError
            If a leaf is empty, a tuple is no pair, or not every triangle has exactly one place.
        """
        left: list[int] = [-1]
        right: list[int] = [-1]
        reference: list[int] = [-1]
        work: list[tuple[int, Any]] = [(0, nested)]
        while work:
            node, value = work.pop()
            if not isinstance(value, tuple):
                ids = _ids(value)
                if len(ids) == 1:
                    reference[node] = int(ids[0])
                    continue
                value = (ids[: len(ids) // 2], ids[len(ids) // 2 :])
            if len(value) != 2:
                raise MibvhError(f"an inner node must be a pair, not {len(value)} parts")
            children = [len(left), len(left) + 1]
            left[node], right[node] = children
            for child, part in zip(children, value, strict=True):
                left.append(-1)
                right.append(-1)
                reference.append(-1)
                work.append((child, part))
        leaves = [ids for ids, child in zip(reference, left, strict=True) if child < 0]
        if not np.array_equal(np.sort(leaves), np.arange(len(triangles))):
            missing = len(np.setdiff1d(np.arange(len(triangles)), leaves))
            raise MibvhError(
                f"each of the {len(triangles)} triangles must have one place in the tree; there "
                f"are {len(leaves)} places, and {missing} triangles have none"
            )
        return cls(
            References.of(triangles),
            np.array(left, np.int32),
            np.array(right, np.int32),
            np.array(reference, np.int32),
        )

    def check(self, triangles: Triangles) -> None:
        """Refuse a draft that compiled code could not walk; its boxes are checked with the tree.

        Raises
        ------
        MibvhError
            If an array has another shape or type than it should, or the nodes make no tree.
        """
        refs, nodes = self.references, 2 * len(self.references) - 1
        arrays = {
            "left": (self.left, np.int32, (nodes,)),
            "right": (self.right, np.int32, (nodes,)),
            "reference": (self.reference, np.int32, (nodes,)),
            "references.triangle": (refs.triangle, np.int32, (len(refs),)),
            "references.lower": (refs.lower, np.float32, (len(refs), 3)),
            "references.upper": (refs.upper, np.float32, (len(refs), 3)),
        }
        for name, (array, dtype, shape) in arrays.items():
            if not isinstance(array, np.ndarray) or (array.dtype, array.shape) != (dtype, shape):
                raise MibvhError(f"{name} of its draft is no array {shape} of {np.dtype(dtype)}")
        ids, inner = refs.triangle, self.left >= 0
        if ids.min() < 0 or ids.max() >= len(triangles):
            raise MibvhError("its draft has references to triangles that are not there")
        children = np.sort(np.concatenate([self.left[inner], self.right[inner]]))
        held = np.sort(self.reference[~inner])
        sound = np.array_equal(children, np.arange(1, nodes)) and np.array_equal(
            held, np.arange(len(refs))
        )
        if not sound or _reached(self.left, self.right) < nodes:
            raise MibvhError(
                "its draft is no tree: from node 0, each node must be reached once, and each "
                "reference in one leaf"
            )


@njit
def _reached(left, right):
    """How many nodes are reached from node 0, of nodes that are each the child of one at most."""
    stack = np.zeros(len(left), np.int32)
    top, reached = 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        reached += 1
        if left[node] >= 0:
            stack[top], stack[top + 1] = left[node], right[node]
            top += 2
    return reached


def _ids(value: Any) -> npt.NDArray[np.int64]:
    """Triangle ids of a leaf, one or several."""
    try:
        ids = np.atleast_1d(np.asarray(value))
    except (ValueError, TypeError, RecursionError):
        ids = np.empty(0)
    if ids.ndim > 1 or len(ids) == 0 or ids.dtype.kind not in "iu":
        said = " ".join(repr(value).split())
        said = said if len(said) < 80 else f"{said[:77]}..."
        raise MibvhError(f"a leaf must be the ids of triangles, not {said}")
    return ids.astype(np.int64)
