"""Renumber another program's binary tree, without changing a box, a leaf or a reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.nodes import PAPER_COSTS, Nodes

I64 = npt.NDArray[np.int64]

#: Messages for the violations that :func:`_renumber` returns.
_VIOLATIONS = {
    1: "node {node} has the children {left} and {right}, which are not among the {nodes} nodes",
    2: "node {node} is reached twice: it is the child of two nodes, or its own ancestor",
    3: "leaf {node} has no references (count = {count})",
    4: "leaf {node} has the references from {first}, {count} of them, and there are {references}",
    5: "the leaves have more references than there are: some share theirs (seen at leaf {node})",
}


def renumbered(
    lower: Any,
    upper: Any,
    left: Any,
    right: Any = None,
    first: Any = None,
    count: Any = None,
    references: Any = None,
    *,
    root: int | None = None,
    name: str = "imported",
) -> tuple[Any, ...]:
    """Return the arrays and the metadata of a tree; see :meth:`mibvh.Tree.from_arrays`."""
    left = int_column("left", left)
    nodes = len(left)
    if nodes == 0:
        raise MibvhError("there are no nodes")
    right = left + 1 if right is None else int_column("right", right, nodes)
    leaf, first, count = _leaves(left, first, count, nodes)
    ids = _ids(references, leaf, first, count)
    lower, upper = (
        box_column("lower", lower, nodes, -np.inf),
        box_column("upper", upper, nodes, np.inf),
    )
    left = np.where(leaf, -1, left)
    if not isinstance(root, int | np.integer | None):
        raise MibvhError(f"root is the number of a node, not {root!r}")
    start = _root(left, right, nodes) if root is None else int(root)
    if not 0 <= start < nodes:
        raise MibvhError(f"the root, {start}, is not among the {nodes} nodes")
    violation, n, order, child, starts, counts, taken = _renumber(
        left, right, first, count, len(ids), start
    )
    if violation:
        raise MibvhError(
            _VIOLATIONS[violation].format(
                node=n,
                left=left[n],
                right=right[n],
                nodes=nodes,
                first=first[n],
                count=count[n],
                references=len(ids),
            )
        )
    if root is None and not (order == 0).any():
        raise MibvhError("node 0 is its own ancestor, or its parent is: root= must name the root")
    given = ids[taken]
    meta = {"builder": name, "options": {}, **PAPER_COSTS, "report": {}}
    if triangles := _dense(given):
        meta["triangles"] = triangles
    if unused := nodes - len(order):
        meta["unused_nodes"] = unused
    return lower[order], upper[order], child, starts, counts, given, meta


def to_arrays(tree: Nodes) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a valid tree; see :meth:`mibvh.Tree.to_arrays`."""
    return {
        "lower": tree.lower,
        "upper": tree.upper,
        "left": tree.left,
        "right": np.where(tree.left < 0, -1, tree.left + 1).astype(np.int32),
        "first": tree.first,
        "count": tree.count,
        "references": tree.references,
    }


def int_column(name: str, values: Any, length: int | None = None) -> I64:
    """Return one column as int64; unsigned integers are reinterpreted as signed ones."""
    array = np.asarray(values)
    if array.dtype.kind not in "iu" or array.ndim != 1:
        raise MibvhError(f"{name} is {array.dtype} {array.shape}, not a row of whole numbers")
    if length is not None and len(array) != length:
        raise MibvhError(f"{name} has {len(array)} numbers for {length} nodes")
    if array.dtype.kind == "u":
        array = array.view(np.dtype(f"{array.dtype.byteorder}i{array.dtype.itemsize}"))
    return array.astype(np.int64)


def box_column(name: str, values: Any, nodes: int, away: float) -> npt.NDArray[np.float32]:
    """Return (M, 3) box corners as float32; wider types are rounded towards ``away``."""
    array = np.asarray(values)
    if array.dtype.kind != "f" or array.shape != (nodes, 3):
        raise MibvhError(f"{name} is {array.dtype} {array.shape}, not {nodes} corners of 3 numbers")
    with np.errstate(all="ignore"):  # what is not finite is refused later
        rounded = array.astype(np.float32)
        inside = rounded > array if away < 0 else rounded < array
        return np.where(inside, np.nextafter(rounded, np.float32(away)), rounded)


def _leaves(left: I64, first: Any, count: Any, nodes: int) -> tuple[Any, I64, I64]:
    """Return which nodes are leaves, and their ranges, for each convention of `from_arrays`."""
    negative = left < 0
    if count is None and first is not None:
        raise MibvhError("first needs count")
    if count is None:
        return negative, ~left, np.ones(nodes, np.int64)
    count = int_column("count", count, nodes)
    if first is not None:
        return negative, int_column("first", first, nodes), count
    if negative.any():
        return negative, ~left, count
    return count > 0, left, count


def _ids(references: Any, leaf: Any, first: I64, count: I64) -> npt.NDArray[np.int32]:
    """Return the triangle ids that the ranges index; by default the positions themselves."""
    if references is None:
        end = int((first[leaf] + count[leaf]).max(initial=0))
        if end > count[leaf].sum():
            raise MibvhError(f"the leaves' ranges reach to {end}, beyond the references they have")
        return np.arange(end, dtype=np.int32)
    return triangle_ids(references)


def triangle_ids(references: Any) -> npt.NDArray[np.int32]:
    """Return triangle ids as int32.

    Raises
    ------
    MibvhError
        If they are not integers, or one is negative or too large.
    """
    ids = int_column("references", references)
    if len(ids) and not (ids.min() >= 0 and ids.max() < 2**31):
        raise MibvhError("a reference is negative, or does not fit into 31 bits")
    return ids.astype(np.int32)


def _root(left: I64, right: I64, nodes: int) -> int:
    """Return the root: node 0 or, if that is a child, the only node without a parent."""
    inner = np.flatnonzero(left >= 0)
    children = np.concatenate([left[inner], right[inner]])
    named = np.zeros(nodes, bool)
    named[children[(children >= 0) & (children < nodes)]] = True
    if not named[0]:
        return 0
    free = np.flatnonzero(~named)
    if len(free) != 1:
        raise MibvhError(
            f"node 0 is a child, and {len(free)} nodes have no parent: root= must name the root"
        )
    return int(free[0])


def _dense(ids: npt.NDArray[np.int32]) -> int | None:
    """Return the number of triangles if each has a reference, otherwise None."""
    largest = int(ids.max(initial=-1)) + 1
    if largest > len(ids):
        return None
    return largest if len(np.unique(ids)) == largest else None


@njit
def _renumber(left, right, first, count, references, root):
    """Order the nodes: parents first, siblings side by side, left subtrees before right ones.

    Returns a violation (0: none) and its node, the old number of each node, the new first child
    or -1, ranges of whole subtrees, and where each reference stood.
    """
    nodes = len(left)
    order = np.empty(nodes, np.int64)
    child, starts, counts = np.full((3, nodes), -1, np.int32)
    taken = np.empty(references, np.int64)
    seen = np.zeros(nodes, np.bool_)
    stack = np.empty(nodes + 1, np.int64)
    order[0], stack[0], top, used, written, violation, at = root, 0, 1, 1, 0, 0, 0
    seen[root] = True
    while top > 0 and violation == 0:
        top -= 1
        place = stack[top]
        n = at = order[place]
        if left[n] < 0:
            if count[n] < 1:
                violation = 3
            elif first[n] < 0 or count[n] > references or first[n] + count[n] > references:
                violation = 4
            elif written + count[n] > references:
                violation = 5
            else:
                starts[place], counts[place] = written, count[n]
                for i in range(count[n]):
                    taken[written + i] = first[n] + i
                written += count[n]
            continue
        a, b = left[n], right[n]
        if a >= nodes or b < 0 or b >= nodes:
            violation = 1
        elif a == b or seen[a] or seen[b]:
            violation, at = 2, a if seen[a] or a == b else b
        else:
            seen[a] = seen[b] = True
            order[used], order[used + 1], child[place] = a, b, used
            stack[top], stack[top + 1] = used + 1, used
            used, top = used + 2, top + 2
    if violation == 0:
        for place in range(used - 1, -1, -1):
            c = child[place]
            if c >= 0:
                starts[place], counts[place] = starts[c], counts[c] + counts[c + 1]
    return (
        violation,
        at,
        order[:used],
        child[:used].copy(),
        starts[:used].copy(),
        counts[:used].copy(),
        taken[:written],
    )
