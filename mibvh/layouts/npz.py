"""Our own files, which :meth:`mibvh.Tree.save` writes."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Own:
    """Read and written by the tree itself."""

    summary: str
    magic: bytes = b"PK\x03\x04"  # a zip archive


LAYOUT = Own("mibvh's own .npz")
