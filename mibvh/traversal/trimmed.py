"""Records that are in memory only as far as the rays at hand read them.

Of a large tree, a set of rays reads few rows. Trees that are timed in turn are all in memory at
once, and what is not read need not be.
"""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.traversal.pages import ROW, in_place, pages_of
from mibvh.traversal.records import Records
from mibvh.traversal.trace import Tracer
from mibvh.variant import mitsuba

#: Rows in a page of memory.
_PAGE = mmap.PAGESIZE // (4 * ROW)


def trimmed(records: Records, tracer: Tracer) -> Records:
    """Copy records without the pages of memory that a tracer's rays do not read.

    All rows keep their places: the rays find what they read at the same distances in memory, so
    that they take the same time.

    Parameters
    ----------
    records : Records
        Of the binary layout, on a processor.
    tracer : Tracer
        Its rays, and any part of them, can be traced with the copy; no others.

    Raises
    ------
    MibvhError
        If the rays do not hit the same in the copy.
    """
    import drjit as dr

    mi = mitsuba()
    marked = _with_rows(records, records.rows)
    marked.seen = dr.zeros(mi.UInt32, dr.width(records.rows) // ROW)
    dr.eval(marked.seen)
    before, _ = tracer.run(marked)
    pages = np.unique(np.flatnonzero(np.array(marked.seen)) // _PAGE)
    whole = np.array(records.rows, copy=False).reshape(-1, ROW)
    rows = pages_of(len(whole))
    _copy(whole, pages, _PAGE, rows)
    found = _with_rows(records, in_place(rows))
    after, _ = tracer.run(found)
    for a, b in zip(before[:2], after[:2], strict=True):
        if not np.array_equal(np.array(a), np.array(b)):
            raise MibvhError("rays hit something else where rows that they do not read are missing")
    return found


@njit
def _copy(whole, pages, size, rows):
    for page in pages:
        rows[page * size : (page + 1) * size] = whole[page * size : (page + 1) * size]


def _with_rows(records: Records, rows: Any) -> Records:
    return Records(rows, records.root, records.scale, records.layout)
