"""Rows in memory that kernels read: where they begin, and how Dr.Jit gets at them."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np

from mibvh.triangles import F32
from mibvh.variant import mitsuba

#: Floats per row: a cache line.
ROW = 16


def pages_of(rows: int) -> F32:
    """(rows, 16) float32 zeros at the beginning of a page; pages take memory when written to."""
    memory = mmap.mmap(-1, max(rows, 1) * ROW * 4)
    return np.frombuffer(memory, np.float32, rows * ROW).reshape(rows, ROW)


def in_place(rows: F32) -> Any:
    """Rows of :func:`pages_of` as a Dr.Jit array: on a processor the same memory, which it reads.

    At the beginning of a page it is aligned, as Dr.Jit's own is (see :func:`own_memory`).
    """
    import drjit as dr

    found = mitsuba().Float(rows.ravel())
    dr.eval(found)
    return found


def own_memory(array: F32) -> Any:
    """Copy into Dr.Jit's own memory.

    Of NumPy's it does not know the alignment, and gathers from it element by element.
    """
    import drjit as dr

    mi = mitsuba()
    bits = mi.UInt32(np.ascontiguousarray(array).view(np.uint32).ravel())
    copy = dr.reinterpret_array(mi.Float, bits + dr.opaque(mi.UInt32, 0))
    dr.eval(copy)
    return copy
