"""tinybvh's ``MBVH<4>`` and ``MBVH<8>``: trees of four or eight children per node.

A node (https://github.com/jbikker/tinybvh, ``tiny_bvh.h``, ``struct MBVHNode``) is ``aabbMin``
(three float32), ``firstTri`` (uint32), ``aabbMax``, ``triCount``, ``child[M]``, ``childCount``, and
three words that fill it up: 64 bytes for four children, 80 for eight. A leaf has ``triCount`` above
0, an inner node its children at the first ``childCount`` numbers of ``child``. Node 0 is the root;
nodes that nothing reaches are left of the binary tree that it was made of.

Read are dumps: the numbers of nodes and of ids (uint32 ``usedNodes``, ``bvh.idxCount``),
``mbvhNode``, ``bvh.primIdx``. tinybvh saves its other wide layouts, but those of one machine: their
boxes are on grids, or stand in the order of SIMD lanes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.layouts import Layout
from mibvh.wide_tree import WideTree

_SIZES = 8


def node(width: int) -> np.dtype[Any]:
    """A node of so many children."""
    return np.dtype(
        [
            ("lower", "<f4", 3),
            ("first", "<u4"),
            ("upper", "<f4", 3),
            ("count", "<u4"),
            ("child", "<u4", width),
            ("children", "<u4"),
            ("unused", "<u4", 3),
        ]
    )


def _parse(data: bytes, width: int) -> dict[str, Any]:
    """Arrays of a file's bytes."""
    kind = node(width)
    if len(data) < _SIZES:
        raise MibvhError(f"is too short for a tree of tinybvh's MBVH<{width}>")
    nodes, references = (int(n) for n in np.frombuffer(data, "<u4", 2))
    wanted = _SIZES + nodes * kind.itemsize + 4 * references
    if not nodes or len(data) != wanted:
        raise MibvhError(
            f"has {len(data)} bytes, and {nodes} nodes and {references} ids of tinybvh's "
            f"MBVH<{width}> take {wanted}"
        )
    table = np.frombuffer(data, kind, nodes, _SIZES)
    inner = (table["count"] == 0) & (table["children"] > 0)
    if (table["children"][inner] > width).any():
        n = int(np.flatnonzero(inner & (table["children"] > width))[0])
        raise MibvhError(f"node {n} has {table['children'][n]} children, more than {width}")
    used = inner[:, None] & (np.arange(width) < table["children"][:, None])
    return {
        "lower": table["lower"],
        "upper": table["upper"],
        "children": np.where(used, table["child"].astype(np.int64), -1),
        "first": table["first"].astype(np.int64),
        "count": table["count"].astype(np.int64),
        "references": np.frombuffer(data, "<u4", references, _SIZES + nodes * kind.itemsize),
    }


def _pack(tree: WideTree, width: int) -> bytes:
    """Bytes of a dump."""
    table = np.zeros(len(tree), node(width))
    table["lower"], table["upper"], leaf = tree.lower, tree.upper, tree.is_leaf
    table["first"][leaf], table["count"][leaf] = tree.first[leaf], tree.count[leaf]
    place = np.arange(width)
    used = place < tree.children[:, None]
    table["child"] = np.where(used, tree.child[:, None] + place, 0)
    table["children"] = tree.children
    sizes = np.array([len(tree), len(tree.references)], "<u4")
    return sizes.tobytes() + table.tobytes() + tree.references.astype("<u4").tobytes()


def _layout(width: int) -> Layout:
    return Layout(
        f"tinybvh's MBVHNode of {width} children: two sizes, the nodes, the index list",
        lambda data: _parse(data, width),
        lambda tree: _pack(tree, width),
        width,
    )


FOUR, EIGHT = _layout(4), _layout(8)
