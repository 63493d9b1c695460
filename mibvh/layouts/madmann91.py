"""What ``Bvh::serialize`` of https://github.com/madmann91/bvh writes, version 2.

Numbers of nodes and of ``prim_ids`` (size_t: uint64), the nodes, the ``prim_ids`` (uint64). A node
is its bounds, ``min x, max x, min y, max y, min z, max z``, in float32 or float64, and its index:
the first child or first ``prim_id``, and the number of triangles, 0 for an inner node. Older code
writes the two as uint64, later code as one number with the number of triangles in its lowest four
bits. Which of the four it is shows in the file's length.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.layouts import Layout
from mibvh.tree import Tree

_NODES = [
    np.dtype([("bounds", scalar, 6), *index])
    for scalar, packed in (("<f4", "<u4"), ("<f8", "<u8"))
    for index in ([("index", packed)], [("first", "<u8"), ("count", "<u8")])
]
#: Bits of an index that tell the number of triangles.
_COUNT_BITS = 4


def parse(data: bytes) -> dict[str, Any]:
    """Arrays of a file's bytes."""
    if len(data) < 16:
        raise MibvhError("is too short for a tree of madmann91's bvh")
    nodes, references = (int(n) for n in np.frombuffer(data, "<u8", 2))
    for kind in _NODES:
        if nodes and len(data) == 16 + nodes * kind.itemsize + 8 * references:
            break
    else:
        raise MibvhError(
            f"has {len(data)} bytes, which are not {nodes} nodes and {references} ids of "
            "madmann91's bvh"
        )
    table = np.frombuffer(data, kind, nodes, 16)
    ids = np.frombuffer(data, "<u8", references, 16 + nodes * kind.itemsize)
    if "index" in (kind.names or ()):
        index = table["index"].astype(np.uint64)
        first, count = index >> np.uint64(_COUNT_BITS), index & np.uint64(2**_COUNT_BITS - 1)
    else:
        first, count = table["first"], table["count"]
    bounds = table["bounds"]
    return {
        "lower": bounds[:, ::2],
        "upper": bounds[:, 1::2],
        "left": np.where(count == 0, first.astype(np.int64), -1),
        "first": first.astype(np.int64),
        "count": count.astype(np.int64),
        "references": ids,
        "root": 0,
    }


def pack(tree: Tree) -> bytes:
    """Bytes of a file, as later code of the library reads it."""
    largest = int(tree.count[tree.is_leaf].max())
    if largest >= 2**_COUNT_BITS:
        raise MibvhError(
            f"a leaf has {largest} triangles; madmann91's bvh takes {2**_COUNT_BITS - 1} at most"
        )
    table = np.zeros(len(tree), _NODES[0])
    table["bounds"][:, ::2], table["bounds"][:, 1::2] = tree.lower, tree.upper
    first, count = np.where(tree.is_leaf, [tree.first, tree.count], [tree.left, 0 * tree.count])
    table["index"] = (first.astype(np.uint64) << np.uint64(_COUNT_BITS)) | count.astype(np.uint64)
    sizes = np.array([len(tree), len(tree.references)], "<u8")
    return sizes.tobytes() + table.tobytes() + tree.references.astype("<u8").tobytes()


LAYOUT = Layout("what Bvh::serialize of madmann91/bvh writes (version 2)", parse, pack)
