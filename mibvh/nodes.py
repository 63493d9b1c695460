"""The arrays of a tree as a protocol, for checks and layouts; and constants of trees."""

from __future__ import annotations

from typing import Any, Protocol

from mibvh.triangles import F32, I32

#: Inner nodes on a path; the traversal stack holds as many entries.
MAX_DEPTH = 64
#: Deeper trees are refused altogether: exact EPO takes memory by the square of the depth.
DEEPEST = 1024
#: Cost of an inner node and of a triangle test (Aila, Karras and Laine, HPG 2013), where a tree
#: records no others.
C_INNER, C_TRI = 1.2, 1.0
#: The same, as the names in a tree's ``meta`` and the arguments of functions have them.
PAPER_COSTS = {"c_inner": C_INNER, "c_tri": C_TRI}
#: Children that a node has at most, by the kind of tree.
WIDTHS = (2, 4, 8)


class Nodes(Protocol):
    """The arrays of a :class:`mibvh.Tree`, whose docstring describes them."""

    @property
    def lower(self) -> F32: ...  # noqa: D102
    @property
    def upper(self) -> F32: ...  # noqa: D102
    @property
    def left(self) -> I32: ...  # noqa: D102
    @property
    def first(self) -> I32: ...  # noqa: D102
    @property
    def count(self) -> I32: ...  # noqa: D102
    @property
    def references(self) -> I32: ...  # noqa: D102
    @property
    def meta(self) -> dict[str, Any]: ...  # noqa: D102
    @property
    def depth(self) -> int: ...  # noqa: D102

    def __len__(self) -> int: ...


class WideNodes(Nodes, Protocol):
    """The further arrays of a :class:`mibvh.WideTree`, whose docstring describes them."""

    @property
    def child(self) -> I32: ...  # noqa: D102
    @property
    def children(self) -> I32: ...  # noqa: D102
    @property
    def width(self) -> int: ...  # noqa: D102
    @property
    def quantised(self) -> bool: ...  # noqa: D102
