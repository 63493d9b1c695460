"""mibvh's own files, which :meth:`mibvh.Tree.save` and :meth:`mibvh.WideTree.save` write."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class NativeLayout:
    """A layout that the trees read and write themselves, with a checksum."""

    summary: str
    magic: bytes = b"PK\x03\x04"  # a zip archive


LAYOUT = NativeLayout("mibvh's own .npz")
