"""Meshes and scenes in every format, whole, cut short and damaged, from seeds.

Each case writes a small file whose surface is known, mostly damages it, and loads it. It must be
read or refused in one sentence; a whole file must have its area and its triangles; one that is cut
short must be refused, or have all of its triangles still. ``python -m tools.fuzz.meshes SECONDS
[SEED]`` runs it in this process.
"""

from __future__ import annotations

import atexit
import collections
import json
import random
import shutil
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import mibvh
from mibvh.loading import read_mesh
from mibvh.loading.parser import parse_file

#: What hostile numbers look like.
_NUMBERS = tuple(
    "-1 0 1e39 nan inf 4294967295 -9223372036854775808 1e-400 99999999999 2147483648 65535 '' [] "
    "null {} 0x10 1_0 ² ".encode().split(b" ")
)


class Meshes:
    """A bench for ``tools.fuzz``.

    Parameters
    ----------
    folder : Path, optional
        Where its files go; a temporary one that is removed at the end of the process by default.
    """

    def __init__(self, folder: Path | None = None) -> None:
        if folder is None:
            folder = Path(tempfile.mkdtemp(prefix="mibvh-fuzz-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
        self.folder = folder
        (self.folder / "corner.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")

    def run(self, seed: int) -> str:
        """Run a case.

        Returns
        -------
        str
            The format and ``whole``, ``read`` or ``refused``.

        Raises
        ------
        AssertionError
            If a file was read wrongly, or refused in more than a sentence.
        """
        rng = random.Random(seed)
        kind, make = rng.choice(list(_FORMATS.items()))
        corners = _corners(rng)
        whole = make(corners, rng)
        how = rng.choice((_as_it_is, _cut, _flip, _swap_numbers, _shuffle, _insert))
        data = how(whole, rng)
        path = self.folder / f"a.{kind.partition('_')[0]}"
        path.write_bytes(data)
        try:
            triangles = _load(path)
        except mibvh.MibvhError as error:
            said = str(error)
            assert "\n" not in said, said
            assert f"a.{kind}" in said, said
            assert data != whole, f"a whole {kind} file is refused: {said}"
            return f"{kind} refused"
        assert np.isfinite(triangles.corners).all()
        if data == whole:
            area = _area(corners)
            assert len(triangles) == len(corners), kind
            assert abs(triangles.areas.sum() - area) <= 1e-4 * area, kind
            return f"{kind} whole"
        if how is _cut and kind in _DECLARING:
            assert len(triangles) == len(corners), f"a {kind} file that is cut short is read short"
        return f"{kind} read"


def run(seconds: float, seed: int = 0) -> dict[str, int]:
    """Run cases for a time, in this process.

    Returns
    -------
    dict
        How many cases ended how.
    """
    bench, end = Meshes(), time.monotonic() + seconds
    counts: collections.Counter[str] = collections.Counter()
    while time.monotonic() < end:
        counts[bench.run(seed)] += 1
        seed += 1
    return dict(counts)


def _load(path: Path) -> mibvh.Triangles:
    if path.suffix != ".xml":
        return read_mesh(path)[0]
    parse_file(path, {}, flatten=False)
    return mibvh.load(path).triangles


def _area(corners: np.ndarray) -> float:
    a, b, c = (corners[:, i].astype(np.float64) for i in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _corners(rng: random.Random) -> np.ndarray:
    """(N, 3, 3) float32: a few triangles."""
    count = rng.randint(1, 12)
    return np.array([rng.uniform(-9, 9) for _ in range(9 * count)], np.float32).reshape(-1, 3, 3)


# ------------------------------------------------------------------ files


def _obj(corners: np.ndarray, rng: random.Random) -> bytes:
    """Absolute or relative indices, after each triangle or at the end."""
    lines = ["# a mesh", "o a"]
    faces = []
    relative = rng.random() < 0.5
    for i, triangle in enumerate(corners):
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in triangle.tolist()]
        if relative:
            lines.append("f -3//1 -2//1 -1//1")
        else:
            faces.append(f"f {3 * i + 1}/1 {3 * i + 2}/1 {3 * i + 3}/1")
    return "\n".join([*lines, *faces, ""]).encode()


def _off(corners: np.ndarray, rng: random.Random) -> bytes:
    lines = ["OFF", f"{3 * len(corners)} {len(corners)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in corners.reshape(-1, 3).tolist()]
    lines += [f"3 {3 * i} {3 * i + 1} {3 * i + 2}" for i in range(len(corners))]
    return "\n".join([*lines, ""]).encode()


def _stl(corners: np.ndarray, rng: random.Random) -> bytes:
    if rng.random() < 0.5:
        rows = [struct.pack("<3f9fH", 0, 0, 0, *t.ravel().tolist(), 0) for t in corners]
        return b"solid".ljust(80) + struct.pack("<I", len(corners)) + b"".join(rows)
    lines = ["solid a"]
    for triangle in corners.tolist():
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x!r} {y!r} {z!r}" for x, y, z in triangle]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid a", ""]).encode()


def _ply(corners: np.ndarray, rng: random.Random) -> bytes:
    form = rng.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    head = (
        f"ply\nformat {form} 1.0\nelement vertex {3 * len(corners)}\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {len(corners)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    ).encode()
    if form == "ascii":
        points = [f"{x!r} {y!r} {z!r}\n" for x, y, z in corners.reshape(-1, 3).tolist()]
        faces = [f"3 {3 * i} {3 * i + 1} {3 * i + 2}\n" for i in range(len(corners))]
        return head + "".join(points + faces).encode()
    order = "<" if "little" in form else ">"
    body = corners.astype(order + "f4").tobytes()
    faces_ = [struct.pack(f"{order}B3i", 3, *range(3 * i, 3 * i + 3)) for i in range(len(corners))]
    return head + body + b"".join(faces_)


def _glb(corners: np.ndarray, rng: random.Random) -> bytes:
    """Several nodes, indices or none, and a sparse accessor at times."""
    points = corners.reshape(-1, 3)
    data = points.tobytes()
    bounds = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    position = {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"}
    document: dict[str, object] = {
        "asset": {"version": "2.0"},
        "nodes": [{"children": [1]}, {"mesh": 0}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "accessors": [{**position, **bounds}],
    }
    primitive: dict[str, object] = {"attributes": {"POSITION": 0}}
    if rng.random() < 0.7:
        indices = np.arange(len(points), dtype="<u2").tobytes()
        document["bufferViews"] += [  # type: ignore[operator]
            {"buffer": 0, "byteOffset": len(data), "byteLength": len(indices)}
        ]
        document["accessors"] += [  # type: ignore[operator]
            {"bufferView": 1, "componentType": 5123, "count": len(points), "type": "SCALAR"}
        ]
        primitive["indices"] = 1
        data += indices
    document["meshes"] = [{"primitives": [primitive]}]
    document["buffers"] = [{"byteLength": len(data)}]
    text = json.dumps(document).encode()
    text, data = text + b" " * (-len(text) % 4), data + b"\0" * (-len(data) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _xml(corners: np.ndarray, rng: random.Random) -> bytes:
    """Each triangle is an instance of the one in ``corner.obj``."""
    shapes = "".join(
        '<shape type="instance"><ref id="g"/><transform name="to_world">'
        f'<matrix value="{_placing(t)}"/></transform></shape>'
        for t in corners
    )
    return (
        '<scene version="3.0.0"><sensor type="perspective"/><default name="k" value="1"/>'
        '<shape type="shapegroup" id="g"><shape type="obj">'
        '<string name="filename" value="corner.obj"/></shape></shape>'
        f"{shapes}</scene>"
    ).encode()


def _placing(triangle: np.ndarray) -> str:
    """The matrix that takes the unit corner to a triangle."""
    a, b, c = triangle.astype(np.float64)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = b - a, c - a, a
    matrix[:3, 2] = np.cross(b - a, c - a)
    return " ".join(map(repr, matrix.ravel().tolist()))


_FORMATS: dict[str, Callable[[np.ndarray, random.Random], bytes]] = {
    "obj": _obj,
    "off": _off,
    "stl": _stl,
    "ply": _ply,
    "glb": _glb,
    "xml": _xml,
}
#: Formats whose files say how much there is in them.
_DECLARING = {"off", "stl", "ply", "glb"}


# ------------------------------------------------------------------ damage


def _as_it_is(data: bytes, rng: random.Random) -> bytes:
    return data


def _cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _flip(data: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def _swap_numbers(data: bytes, rng: random.Random) -> bytes:
    """Put a hostile number in the place of some bytes that look like one."""
    places = [i for i, byte in enumerate(data) if 0x30 <= byte <= 0x39]
    if not places:
        return _flip(data, rng)
    at = rng.choice(places)
    end = at
    while end < len(data) and data[end] in b"0123456789.":
        end += 1
    return data[:at] + rng.choice(_NUMBERS) + data[end:]


def _shuffle(data: bytes, rng: random.Random) -> bytes:
    """Repeat, drop or swap pieces."""
    i, j = sorted(rng.randrange(len(data)) for _ in range(2))
    return rng.choice((data[:j] + data[i:], data[:i] + data[j:], data[j:] + data[:j]))


def _insert(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + rng.randbytes(rng.randint(1, 9)) + data[at:]


if __name__ == "__main__":
    found = run(float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    for outcome, count in sorted(found.items()):
        sys.stdout.write(f"{outcome:<16}{count:>8}\n")
