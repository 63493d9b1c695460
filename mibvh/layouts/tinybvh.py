"""tinybvh's ``BVH``: its nodes of 32 bytes, and its index list.

A node is ``aabbMin`` (three float32), ``leftFirst`` (uint32), ``aabbMax``, ``triCount``: the Wald
layout of https://github.com/jbikker/tinybvh (``tiny_bvh.h``, ``struct BVHNode``), and of the many
programs that followed Bikker's articles. An inner node has ``triCount`` 0 and its children at
``leftFirst`` and the next; a leaf its triangles at ``leftFirst`` in the index list. Node 0 is the
root; node 1 is left out, so that siblings share a cache line.

Read are plain dumps, ``bvhNode`` (``usedNodes`` of them) and then ``primIdx`` (``idxCount``), and
files of ``BVH::Save``, which has a copy of the class in front, of a size that differs between
versions. Where the nodes begin and end is told by the tree: it must end where the file does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.layouts import Layout
from mibvh.tree import Tree

NODE = np.dtype([("lower", "<f4", 3), ("first", "<u4"), ("upper", "<f4", 3), ("count", "<u4")])
#: What ``BVH::Save`` has in front of the class: version and layout, number of triangles.
_HEADER = 8
#: No class of tinybvh is larger.
_LARGEST_CLASS = 2048


def parse(data: bytes) -> dict[str, Any]:
    """Arrays of a file's bytes."""
    places = [0, *range(_HEADER + 64, _HEADER + _LARGEST_CLASS, 4)]
    for place in places:
        nodes = _nodes(data, place)
        if nodes:
            break
    else:
        raise MibvhError("holds no nodes of tinybvh whose tree ends where the file does")
    table = np.frombuffer(data, NODE, nodes, place)
    rest = np.frombuffer(data, "<u4", offset=place + nodes * NODE.itemsize)
    if len(rest) and rest.max() > np.iinfo(np.int32).max:
        raise MibvhError("the index list (primIdx) behind the nodes is missing, or damaged")
    first, count = table["first"].astype(np.int64), table["count"].astype(np.int64)
    return {
        "lower": table["lower"],
        "upper": table["upper"],
        "left": np.where(count == 0, first, -1),
        "first": first,
        "count": count,
        "references": rest,
        "root": 0,
    }


def _nodes(data: bytes, place: int) -> int:
    """How many nodes begin at a place, if a tree does whose index list ends with the file."""
    rest = len(data) - place
    if rest < NODE.itemsize + 4 or rest % 4:
        return 0
    words = np.frombuffer(data, "<u4", offset=place)
    nodes, references = _extent(words)
    # Room for an index list of just that many ids, or, after later splits, for a longer one.
    left_over = rest - nodes * NODE.itemsize - 4 * references
    return nodes if nodes and left_over >= 0 else 0


@njit
def _extent(words):
    """Nodes and references of the tree that begins with the first word; 0, 0 if none does."""
    room = len(words) // 8
    seen = np.zeros(room, np.bool_)
    stack = np.empty(room + 1, np.int64)
    stack[0], top, last, references = 0, 1, 0, 0
    while top > 0:
        top -= 1
        n = stack[top]
        if seen[n]:
            return 0, 0
        seen[n] = True
        last = max(last, n)
        first, count = np.int64(words[8 * n + 3]), np.int64(words[8 * n + 7])
        if count == 0:
            if first < 1 or first + 1 >= room or top + 2 > room:
                return 0, 0
            stack[top], stack[top + 1] = first, first + 1
            top += 2
        else:
            references = max(references, first + count)
            if references > len(words):
                return 0, 0
    return last + 1, references


def pack(tree: Tree) -> bytes:
    """Bytes of a plain dump."""
    table = np.zeros(len(tree) + 1, NODE)
    place = np.arange(len(tree)) + (np.arange(len(tree)) > 0)
    table["lower"][place], table["upper"][place] = tree.lower, tree.upper
    table["first"][place] = np.where(tree.is_leaf, tree.first, tree.left + 1)
    table["count"][place] = np.where(tree.is_leaf, tree.count, 0)
    if len(tree) == 1:
        table = table[:1]
    return table.tobytes() + tree.references.astype("<u4").tobytes()


LAYOUT = Layout("tinybvh's BVHNode (32 bytes), then its index list; or BVH::Save", parse, pack)
