r"""The plain layout that a few lines of C or C++ write: ``docs/examples/mibvh_tree.h``.

Little-endian: the eight bytes ``MIBVH\x01\r\n``; uint32 number of nodes, and of references; nodes
of 40 bytes: lower corner, upper corner (three float32 each), int32 left, right, first, count; the
references, uint32 triangle ids. Node 0 is the root. A leaf has ``left = -1`` and the range
``first``, ``count`` of the references; of inner nodes these are not looked at.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.layouts import Layout
from mibvh.tree import Tree

MAGIC = b"MIBVH\x01\r\n"
NODE = np.dtype(
    [
        ("lower", "<f4", 3),
        ("upper", "<f4", 3),
        ("left", "<i4"),
        ("right", "<i4"),
        ("first", "<i4"),
        ("count", "<i4"),
    ]
)


def parse(data: bytes) -> dict[str, Any]:
    """Arrays of a file's bytes."""
    if data[:8] != MAGIC or len(data) < 16:
        raise MibvhError(
            "is no tree of the plain layout (it does not begin with MIBVH); a "
            "tree of another program is converted first, by mibvh import FILE --layout NAME -o "
            "TREE.npz"
        )
    nodes, references = (int(n) for n in np.frombuffer(data, "<u4", 2, 8))
    wanted = 16 + NODE.itemsize * nodes + 4 * references
    if len(data) != wanted:
        raise MibvhError(
            f"has {len(data)} bytes, and {nodes} nodes and {references} references take {wanted}"
        )
    table = np.frombuffer(data, NODE, nodes, 16)
    ids = np.frombuffer(data, "<u4", references, 16 + NODE.itemsize * nodes)
    return {**{name: table[name] for name in NODE.names or ()}, "references": ids, "root": 0}


def pack(tree: Tree) -> bytes:
    """Bytes of a file."""
    arrays = tree.to_arrays()
    table = np.zeros(len(tree), NODE)
    for name in NODE.names or ():
        table[name] = arrays[name]
    sizes = np.array([len(tree), len(tree.references)], "<u4")
    return MAGIC + sizes.tobytes() + table.tobytes() + tree.references.astype("<u4").tobytes()


LAYOUT = Layout(
    "plain nodes of 40 bytes, written by docs/examples/mibvh_tree.h", parse, pack, magic=MAGIC
)
