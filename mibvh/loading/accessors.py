"""Accessors of glTF: typed views of its buffers, sparse and normalised ones too."""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.loading.mesh import I64, Refused
from mibvh.triangles import F64

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


class Accessors:
    """The accessors of a document.

    Parameters
    ----------
    document : dict
    buffers : list of bytes or None
        From :func:`mibvh.loading.container.open_document`.
    """

    def __init__(self, document: dict[str, Any], buffers: list[bytes | None]) -> None:
        self._document = document
        self._buffers = buffers
        self._bytes = sum(len(b) for b in buffers if b is not None)

    def has_data(self, index: int) -> bool:
        """Whether an accessor has values of its own, beside a compressed form."""
        entry = entry_of(self._document, "accessors", index)
        return "bufferView" in entry or "sparse" in entry

    def read(self, index: int, kind: str | None = None) -> F64:
        """(N, C) float64: the values of an accessor, (N,) for scalars.

        Raises
        ------
        Refused
            If it is of another kind, or has other values than it declares.
        """
        entry = entry_of(self._document, "accessors", index)
        if kind is not None and entry.get("type") != kind:
            raise Refused(f"accessor {index} is of {entry.get('type')}, not {kind}")
        raw = self._raw(entry, index)
        self.check(entry, raw)
        if not entry.get("normalized"):
            return raw.astype(np.float64)
        limits = np.iinfo(raw.dtype)
        return np.maximum(raw.astype(np.float64) / limits.max, -1.0 if limits.min < 0 else 0.0)

    def read_indices(self, index: int) -> I64:
        """(N,) int64."""
        entry = entry_of(self._document, "accessors", index)
        if entry.get("type") != "SCALAR" or entry.get("componentType") not in (5121, 5123, 5125):
            raise Refused(f"accessor {index} holds no indices")
        return self._raw(entry, index).astype(np.int64)

    def view(self, index: int) -> bytes:
        """The bytes of a buffer view."""
        entry = entry_of(self._document, "bufferViews", index)
        buffer = self._buffer(entry)
        start, size = entry.get("byteOffset", 0), entry.get("byteLength", 0)
        if start < 0 or size < 0 or start + size > len(buffer):
            raise Refused(f"bufferView {index} is longer than its buffer: cut short, or damaged")
        return buffer[start : start + size]

    def check(self, entry: dict[str, Any], values: Any, slack: float = 1e-4) -> None:
        """Refuse values that an accessor's own count and bounds do not fit.

        Parameters
        ----------
        entry : dict
        values : (N, C) array
            As stored: before normalisation.
        slack : float
            Share of the extent: bounds are often rounded, and compressed values are.
        """
        if len(values) != entry.get("count"):
            raise Refused(f"{entry.get('count')} values are declared, {len(values)} found")
        if not len(values) or "min" not in entry or "max" not in entry:
            return
        found = np.stack([values.min(axis=0), values.max(axis=0)]).astype(np.float64)
        found = found.reshape(2, -1)
        if {len(entry["min"]), len(entry["max"])} != {found.shape[1]}:
            raise Refused("an accessor's bounds have another shape than its values")
        declared = np.array([entry["min"], entry["max"]], dtype=np.float64)
        room = slack * (declared[1] - declared[0]).max() + 1e-5 * np.abs(declared).max()
        if not (np.abs(declared - found) <= max(room, 0)).all():
            raise Refused(
                f"its values go from {found[0].tolist()} to {found[1].tolist()}, but it declares "
                f"{declared[0].tolist()} to {declared[1].tolist()}: damaged"
            )

    # -------------------------------------------------------------- parts

    def _raw(self, entry: dict[str, Any], index: int) -> Any:
        kind, component = entry.get("type"), entry.get("componentType")
        if kind not in _SIZES or component not in _COMPONENTS:
            raise Refused(f"accessor {index} is of type {kind} of {component}, which is not read")
        count, size, dtype = entry.get("count", 0), _SIZES[kind], np.dtype(_COMPONENTS[component])
        if not isinstance(count, int) or not 0 <= count <= self._bytes:
            raise Refused(f"accessor {index} declares {count} values: more than the file has bytes")
        if "bufferView" in entry:
            start = entry.get("byteOffset", 0)
            values = self._strided(entry["bufferView"], start, count, size, dtype, index)
        elif "sparse" in entry:
            values = np.zeros((count, size), dtype)
        else:
            raise Refused(f"accessor {index} has no values: an extension that is not read has them")
        if "sparse" in entry:
            values = self._overridden(values, entry["sparse"], index)
        return values[:, 0] if size == 1 else values

    def _strided(
        self, view: int, start: int, count: int, size: int, dtype: np.dtype[Any], index: int
    ) -> Any:
        data = self.view(view)
        packed = size * dtype.itemsize
        stride = entry_of(self._document, "bufferViews", view).get("byteStride", packed)
        if count == 0:
            return np.zeros((0, size), dtype)
        if start < 0 or stride < packed or start + stride * (count - 1) + packed > len(data):
            raise Refused(f"accessor {index} is longer than its bufferView: cut short, or damaged")
        return np.ndarray((count, size), dtype, data, start, (stride, dtype.itemsize))

    def _overridden(self, values: Any, sparse: dict[str, Any], index: int) -> Any:
        count, where, what = sparse["count"], sparse["indices"], sparse["values"]
        dtype = np.dtype(_COMPONENTS[where["componentType"]])
        rows = self._strided(
            where["bufferView"], where.get("byteOffset", 0), count, 1, dtype, index
        )
        new = self._strided(
            what["bufferView"],
            what.get("byteOffset", 0),
            count,
            values.shape[1],
            values.dtype,
            index,
        )
        rows = rows[:, 0].astype(np.int64)
        if len(rows) and rows.max() >= len(values):
            raise Refused(f"accessor {index} overrides values that it does not have")
        values = values.copy()
        values[rows] = new
        return values

    def _buffer(self, view: dict[str, Any]) -> bytes:
        index = view.get("buffer")
        if not isinstance(index, int) or not 0 <= index < len(self._buffers):
            raise Refused(f"buffer {index!r} is named, but there are {len(self._buffers)}")
        buffer = self._buffers[index]
        if buffer is None:
            name = next((n for n in _MESHOPT if n in view.get("extensions", {})), None)
            raise Refused(
                f"{name} is not read; unpack it first (gltfpack -noq, or gltf-transform)"
                if name
                else f"its buffer {index} has no data: cut short, or damaged"
            )
        return buffer


def entry_of(document: dict[str, Any], kind: str, index: Any) -> dict[str, Any]:
    """One of a document's nodes, meshes, accessors, ...

    Raises
    ------
    Refused
        If there is no such entry, or it is no object.
    """
    entries = document.get(kind, [])
    if not isinstance(index, int) or not 0 <= index < len(entries):
        raise Refused(f"{kind} {index!r} is named, but there are {len(entries)}")
    if not isinstance(entries[index], dict):
        raise Refused(f"number {index} of its {kind} is no object")
    return dict(entries[index])
