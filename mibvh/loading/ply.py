"""PLY (Stanford polygon format): text, and binary of either byte order.

Written here, as no library of a fitting licence was found that reads faces of mixed sizes from
binary files and refuses those that are cut short (plyfile does, but is under the GPL).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from mibvh.loading.mesh import (
    I64,
    Mesh,
    Refused,
    check_indices,
    check_room,
    corners_of,
    indices_of,
    numbers,
    whole,
)
from mibvh.loading.polygons import triangulate
from mibvh.loading.text import decode
from mibvh.triangles import F64

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDICES = ("vertex_indices", "vertex_index")
#: No header is longer.
_LONGEST_HEADER = 1 << 20


@dataclasses.dataclass(frozen=True)
class Property:
    """A property of an element; ``length`` is the type of a list's length, "" for no list."""

    name: str
    kind: str
    length: str = ""


@dataclasses.dataclass
class Element:
    """Rows of equal kind, such as all vertices."""

    name: str
    count: int
    properties: list[Property] = dataclasses.field(default_factory=list)

    @property
    def smallest_row(self) -> int:
        """Bytes that a binary row takes at least."""
        return sum(np.dtype(p.length or p.kind).itemsize for p in self.properties)


@dataclasses.dataclass(frozen=True)
class Header:
    """What a file declares: byte order ("" for text), elements, and where the rows begin."""

    order: str
    elements: list[Element]
    size: int


def read(data: bytes) -> Mesh:
    """Read a PLY file.

    Raises
    ------
    Refused
        If it has no faces, or holds other rows than its header declares.
    """
    header = parse_header(data)
    check_counts(header, len(data))
    columns, notes = _rows(data, header)
    vertices = _vertices(columns)
    indices, sizes = _polygons(header, columns)
    faces, more = triangulate(vertices, indices, sizes)
    return Mesh(corners_of(vertices, faces), notes + more)


def vertex_columns(data: bytes) -> dict[str, npt.NDArray[np.generic]]:
    """Properties of the vertices by name, (V,) each; lists are left out.

    Raises
    ------
    Refused
        If it holds other rows than its header declares.
    """
    header = parse_header(data)
    check_counts(header, len(data))
    columns, _ = _rows(data, header)
    return {
        name: column
        for (element, name), column in columns.items()
        if element == "vertex" and not isinstance(column, tuple)
    }


def check_file(path: Path) -> None:
    """Refuse what readers that believe a file crash on: lengths and indices beyond what it holds.

    Raises
    ------
    Refused
    """
    with path.open("rb") as file:
        header = _header_of(file)
        check_counts(header, path.stat().st_size)
        file.seek(0)
        data = file.read()
    try:
        columns, _ = _rows(data, header)
    except Refused:
        return  # they say it themselves
    vertices = sum(element.count for element in header.elements if element.name == "vertex")
    for name in _INDICES:
        column = columns.get(("face", name))
        if isinstance(column, tuple):
            check_indices(indices_of(column[0]), vertices)


def _header_of(file: BinaryIO) -> Header:
    return parse_header(file.read(_LONGEST_HEADER))


def check_counts(header: Header, size: int) -> None:
    """Refuse counts that a file of ``size`` bytes cannot hold."""
    room = size - header.size
    for element in header.elements:
        # Text takes two bytes for each property at least.
        each = element.smallest_row if header.order else 2 * max(len(element.properties), 1)
        check_room(f"rows of {element.name!r}", element.count, each, room + 1)


def parse_header(data: bytes) -> Header:
    """Read what a file declares.

    Raises
    ------
    Refused
        If that is not a PLY header.
    """
    if data[:3] != b"ply":
        raise Refused("it does not begin with 'ply'")
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    line_end = data.find(b"\n" if b"\n" in data[:end] else b"\r", end)
    if end < 0:
        raise Refused("its header does not end")
    size = (line_end if line_end >= 0 else len(data) - 1) + 1
    order = None
    elements: list[Element] = []
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", name, "1.0"] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isascii() and count.isdigit():
                _once(name, elements, "elements")
                elements.append(Element(name, int(count)))
            case ["property", "list", length, kind, name] if elements:
                if not {length, kind} <= set(_TYPES) or _TYPES[length][0] == "f":
                    raise Refused(f"its header has a list of unknown type: {line.strip()[:60]!r}")
                _once(name, elements[-1].properties, f"properties of {elements[-1].name!r}")
                elements[-1].properties.append(Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                _once(name, elements[-1].properties, f"properties of {elements[-1].name!r}")
                elements[-1].properties.append(Property(name, _TYPES[kind]))
            case _:
                raise Refused(f"its header has a line that says nothing: {line.strip()[:60]!r}")
    if order is None:
        raise Refused("its header names no format that is known")
    return Header(order, elements, size)


def _once(name: str, there: Sequence[Element | Property], what: str) -> None:
    """Refuse a second one of a name: which of them is meant, nobody can tell."""
    if any(other.name == name for other in there):
        raise Refused(f"its header has two {what} of the name {name[:40]!r}")


# ------------------------------------------------------------------ rows

#: A column of an element by (element, property): values, or (values in a row, lengths).
Column = npt.NDArray[np.generic] | tuple[npt.NDArray[np.generic], I64]
Columns = dict[tuple[str, str], Column]


def _rows(data: bytes, header: Header) -> tuple[Columns, list[str]]:
    if header.order:
        return _binary(data, header)
    return _text(decode(data[header.size :]).split("\n"), header), []


def _binary(data: bytes, header: Header) -> tuple[Columns, list[str]]:
    columns: Columns = {}
    at = header.size
    for element in header.elements:
        at = _binary_element(data, at, element, header.order, columns)
    left = len(data) - at
    # Programs that pad, or end a file like a text, are common; a row too many is not.
    if left >= 16:
        return columns, [f"{left:,} bytes after what its header declares were left out"]
    return columns, []


def _binary_element(data: bytes, at: int, element: Element, order: str, columns: Columns) -> int:
    """Read the rows of an element; return where they end."""
    lengths = _first_lengths(data, at, element, order)
    fields = []
    for i, prop in enumerate(element.properties):
        if prop.length:
            fields.append((f"length{i}", order + prop.length))
            fields.append((f"value{i}", order + prop.kind, (lengths[i],)))  # type: ignore[arg-type]
        else:
            fields.append((f"value{i}", order + prop.kind))
    row = np.dtype(fields)
    end = at + row.itemsize * element.count
    if end <= len(data):
        rows = np.frombuffer(data, row, element.count, at)
        if all((rows[f"length{i}"] == n).all() for i, n in lengths.items()):
            for i, prop in enumerate(element.properties):
                values = rows[f"value{i}"]
                columns[element.name, prop.name] = (
                    (values.ravel(), np.full(element.count, lengths[i], np.int64))
                    if prop.length
                    else values
                )
            return end
    if not lengths:
        raise Refused(_short(element))
    return _rows_of_mixed_lengths(data, at, element, order, columns)


def _first_lengths(data: bytes, at: int, element: Element, order: str) -> dict[int, int]:
    """Lengths of the lists in an element's first row."""
    lengths: dict[int, int] = {}
    for i, prop in enumerate(element.properties):
        if prop.length:
            lengths[i] = 0
            kind = np.dtype(order + prop.length)
            if element.count and at + kind.itemsize <= len(data):
                lengths[i] = max(int(np.frombuffer(data, kind, 1, at)[0]), 0)
            at += kind.itemsize + lengths[i] * np.dtype(prop.kind).itemsize
            if element.count and at > len(data):
                raise Refused(_short(element))
        else:
            at += np.dtype(prop.kind).itemsize
    return lengths


def _rows_of_mixed_lengths(
    data: bytes, at: int, element: Element, order: str, columns: Columns
) -> int:
    """Walk rows whose lists differ in length, one by one; return where they end."""
    count = element.count
    places = [np.empty(count, np.int64) for _ in element.properties]
    lengths = [np.ones(count, np.int64) for _ in element.properties]
    sizes = [np.dtype(p.kind).itemsize for p in element.properties]
    widths = [np.dtype(p.length).itemsize if p.length else 0 for p in element.properties]
    signed = [p.length.startswith("i") for p in element.properties]
    byteorder = "big" if order == ">" else "little"
    for k in range(count):
        for i, width in enumerate(widths):
            n = 1
            if width:
                n = int.from_bytes(data[at : at + width], byteorder, signed=signed[i])  # type: ignore[arg-type]
                at += width
                if n < 0:
                    raise Refused(f"row {k} of {element.name!r} has a list of length {n}")
                lengths[i][k] = n
            places[i][k] = at
            at += n * sizes[i]
        if at > len(data):
            raise Refused(_short(element))
    raw = np.frombuffer(data, np.uint8)
    for i, prop in enumerate(element.properties):
        many = lengths[i]
        within = np.arange(int(many.sum())) - np.repeat(np.cumsum(many) - many, many)
        first = np.repeat(places[i], many) + within * sizes[i]
        values = raw[first[:, None] + np.arange(sizes[i])].reshape(-1).view(order + prop.kind)
        columns[element.name, prop.name] = (values, many) if prop.length else values
    return at


def _short(element: Element) -> str:
    return (
        f"its header declares {element.count:,} rows of {element.name!r}, but it has fewer: cut "
        "short, or damaged"
    )


def _text(lines: list[str], header: Header) -> Columns:
    columns: Columns = {}
    rows = [line for line in lines if line.strip()]
    at = 0
    for element in header.elements:
        mine = rows[at : at + element.count]
        at += element.count
        if len(mine) < element.count:
            raise Refused(_short(element))
        _text_element(mine, element, columns)
    if at < len(rows):
        raise Refused(f"it has {len(rows) - at:,} rows more than its header declares")
    return columns


def _text_element(rows: list[str], element: Element, columns: Columns) -> None:
    properties = element.properties
    if not any(p.length for p in properties):
        table = numbers(rows, tuple(range(len(properties)))) if properties else None
        for i, prop in enumerate(properties):
            columns[element.name, prop.name] = table[:, i]  # type: ignore[index]
        return
    values: list[list[float]] = [[] for _ in properties]
    lengths: list[list[int]] = [[] for _ in properties]
    for row in rows:
        words = row.split()
        at = 0
        try:
            for i, prop in enumerate(properties):
                n = 1
                if prop.length:
                    n = whole(words[at])
                    at += 1
                    lengths[i].append(n)
                values[i].extend(map(float, words[at : at + n]))
                at += n
        except (ValueError, IndexError):
            at = -1
        if at != len(words) or "_" in row:  # float() takes 1_0
            raise Refused(
                f"a row of {element.name!r} is not what is declared: {row.strip()[:40]!r}"
            )
    for i, prop in enumerate(properties):
        found = np.array(values[i], dtype=np.float64)
        columns[element.name, prop.name] = (
            (found, np.array(lengths[i], dtype=np.int64)) if prop.length else found
        )


# ------------------------------------------------------------------ what the rows mean


def _vertices(columns: Columns) -> F64:
    """(V, 3) float64."""
    parts = [columns.get(("vertex", name)) for name in "xyz"]
    if any(part is None or isinstance(part, tuple) for part in parts):
        raise Refused("its vertices have no x, y and z")
    return np.stack([np.asarray(part, dtype=np.float64) for part in parts], axis=1)


def _polygons(header: Header, columns: Columns) -> tuple[I64, I64]:
    """Corners of all faces in a row, and how many each has; strips behind polygons."""
    found: list[tuple[I64, I64]] = []
    for element in ("face", "tristrips"):
        lists = [columns.get((element, name)) for name in _INDICES]
        match [column for column in lists if isinstance(column, tuple) and len(column[1])]:
            case [(values, lengths)]:
                indices = indices_of(values)
                found.append((indices, lengths) if element == "face" else _strips(indices, lengths))
            case [_, _]:
                raise Refused(f"its {element!r} has two lists of vertices; keep one")
    if not found:
        counts = ", ".join(f"{e.count:,} of {e.name!r}" for e in header.elements)
        raise Refused(f"there are no faces in it ({counts or 'nothing'})")
    indices, sizes = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return indices, sizes


def _strips(indices: I64, lengths: I64) -> tuple[I64, I64]:
    """Triangles of strips, which end at the end of a list or at an index of -1."""
    triangles: list[I64] = []
    for row in np.split(indices, np.cumsum(lengths)[:-1]):
        for strip in np.split(row, np.flatnonzero(row < 0)):
            run = strip[strip >= 0]
            if len(run) >= 3:
                triangles.append(np.stack([run[:-2], run[1:-1], run[2:]], axis=1))
    found = np.concatenate(triangles) if triangles else np.zeros((0, 3), np.int64)
    # A repeated corner ties two strips together; it has no area.
    a, b, c = found.T
    found = found[(a != b) & (b != c) & (a != c)]
    return found.ravel(), np.full(len(found), 3, np.int64)
