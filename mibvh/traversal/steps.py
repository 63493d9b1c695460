"""The steps of a binary tree's traversal, out of which every style of it is put together.

The nearer child is gone to, the farther one pushed; a popped node is taken as it is (the kernel of
Aila, Laine and Karras 2012, as in the paper), or, where the stack has distances, only if it still
begins before the current hit.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from mibvh.traversal.geometry import slabs, smaller, triangle_hit
from mibvh.traversal.pages import ROW
from mibvh.traversal.records import DONE, Records
from mibvh.tree import MAX_DEPTH
from mibvh.variant import mitsuba


def new_stack(cull: bool) -> tuple[Any, Any]:
    """Stacks of node codes and, to cull popped nodes, of the distances at which they begin."""
    mi = mitsuba()
    return dr.alloc_local(mi.Int32, MAX_DEPTH), (
        dr.alloc_local(mi.Float, MAX_DEPTH) if cull else None
    )


def mark(records: Records, row: Any) -> None:
    """Mark a row as read, if the records have where."""
    if records.seen is not None:
        dr.scatter(records.seen, mitsuba().UInt32(1), row)


def fetch(records: Records, code: Any) -> Any:
    """Row of an inner node, or of a leaf's triangle: of ``code`` or of ``~code``."""
    mi = mitsuba()
    at = mi.UInt32(code ^ (code >> 31))
    mark(records, at)
    return dr.gather(mi.ArrayXf, records.rows, at, shape=(ROW, dr.width(code)))


@dr.syntax
def node_step(row: Any, o: Any, inv: Any, t: Any, stack: Any, begins: Any, top: Any) -> Any:
    """Test both children of an inner node, and push the farther one if both are hit.

    Returns
    -------
    node : Int32
        Code of the nearer child that is hit.
    lost : Bool
        Neither is.
    top : UInt32
    """
    mi = mitsuba()
    near_l, far_l = slabs(row, 0, o, inv)
    near_r, far_r = slabs(row, 6, o, inv)
    hit_l = near_l <= smaller(far_l, t)
    hit_r = near_r <= smaller(far_r, t)
    left = dr.reinterpret_array(mi.Int32, row[12])
    right = dr.reinterpret_array(mi.Int32, row[13])
    swap = hit_r & (~hit_l | (near_r < near_l))
    if hit_l & hit_r:
        stack[top] = dr.select(swap, left, right)
        if dr.hint(begins is not None, mode="scalar"):
            begins[top] = dr.select(swap, near_l, near_r)
        top += 1
    return dr.select(swap, right, left), ~(hit_l | hit_r), top


def triangle_step(row: Any, o: Any, d: Any, t: Any, triangle: Any) -> tuple[Any, Any, Any, Any]:
    """Test one triangle of a leaf.

    Returns
    -------
    t, triangle : Float, UInt32
        The current hit.
    hit : Bool
        It is this triangle.
    last : Bool
        The leaf has no more.
    """
    mi = mitsuba()
    hit, at = triangle_hit(row, o, d, t)
    return (
        dr.select(hit, at, t),
        dr.select(hit, dr.reinterpret_array(mi.UInt32, row[12]), triangle),
        hit,
        dr.reinterpret_array(mi.UInt32, row[13]) != 0,
    )


@dr.syntax
def pop(stack: Any, begins: Any, top: Any, t: Any) -> Any:
    """Take a node from the stack; DONE if there is none.

    Returns
    -------
    node, top : Int32, UInt32
    """
    mi = mitsuba()
    node = mi.Int32(DONE)
    if dr.hint(begins is not None, mode="scalar"):
        while (top > 0) & (node == DONE):
            top -= 1
            node = dr.select(begins[top] <= t, stack[top], mi.Int32(DONE))
    else:
        if top > 0:
            top -= 1
            node = stack[top]
    return node, top
