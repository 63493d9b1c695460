"""Mutations of the ``.npz`` files that mibvh writes: of their bytes, and of what is in them."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from typing import Any

import numpy as np

from mibvh.files import checksum

Random = np.random.Generator

INTEGERS = [0, 1, -1, 2, -2, 7, 255, 5000, 2**24, 2**30, 2**31 - 1, -(2**31)]
FLOATS = [0.0, -0.0, np.nan, np.inf, -np.inf, 1.0, -1.0, 1e-45, 1e15, -1e15, 3e38, -3e38]
VALUES: list[Any] = [
    None,
    True,
    0,
    -1,
    2,
    1e300,
    float("nan"),
    10**30,
    "",
    "x",
    [],
    {},
    [[1]],
    "é" * 99,
]
TYPES = [">f4", "<f8", "<f2", "<i4", ">i4", "<i8", "<u4", "<i2", "?", "S4", "<U3", "<c8", "V4"]


@dataclasses.dataclass
class Contents:
    """What is in a file: its arrays, its header, and whether the checksum is made to fit."""

    arrays: dict[str, np.ndarray]
    header: dict[str, Any]

    def packed(self) -> bytes:
        """Return the file's bytes, with the right checksum."""
        facts = {name: self.header.get(name) for name in ("format", "kind", "key", "meta")}
        header = {**self.header, "checksum": checksum(self.arrays, facts)}
        buffer = io.BytesIO()
        np.savez(buffer, header=np.array(json.dumps(header)), **self.arrays)  # type: ignore[arg-type]
        return buffer.getvalue()


def contents(data: bytes) -> Contents:
    """Unpack a sound file."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        found = {
            name.removesuffix(".npy"): np.lib.format.read_array(io.BytesIO(archive.read(name)))
            for name in archive.namelist()
        }
    header = json.loads(str(found.pop("header")))
    return Contents(found, header)


def damaged(data: bytes, rng: Random) -> bytes:
    """Damage the bytes: bits, runs, cuts, insertions."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(out)))
        if rng.random() < 0.3:  # the directory of the archive is at its end
            at = max(0, len(out) - 1 - int(rng.integers(1500)))
        size = int(2 ** rng.uniform(0, 12))
        match rng.integers(7):
            case 0 | 1:
                out[at] ^= 1 << int(rng.integers(8))
            case 2:
                out[at : at + size] = rng.bytes(min(size, len(out) - at))
            case 3:
                out[at : at + size] = bytes([int(rng.choice([0, 255]))]) * size
            case 4:
                del out[at : at + size]
            case 5:
                out[at:at] = rng.bytes(size)
            case _:
                del out[at:]
        if not out:
            return bytes(out)
    return bytes(out)


def hostile(data: bytes, rng: Random) -> bytes:
    """Change what is in a file, and make the checksum fit."""
    held = contents(data)
    if "left" in held.arrays and rng.random() < 0.4:
        _change_gently(held.arrays, rng)
        return held.packed()
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        if rng.random() < 0.1:
            _change_header(held, rng)
        elif held.arrays:
            _change_array(held, rng)
    return held.packed()


def _change_gently(arrays: dict[str, np.ndarray], rng: Random) -> None:
    """Change a tree so that it may still be one: a box's face, or the order in a leaf."""
    n = int(rng.integers(len(arrays["left"])))
    if rng.random() < 0.3:
        leaves = np.flatnonzero((arrays["left"] < 0) & (arrays["count"] > 1))
        n = int(rng.choice(leaves))
        run = slice(arrays["first"][n], arrays["first"][n] + arrays["count"][n])
        arrays["references"][run] = rng.permutation(arrays["references"][run])
        return
    name, other = rng.permutation(["lower", "upper"])
    axis = int(rng.integers(3))
    face = arrays[name][n, axis]
    size = abs(arrays[other][n, axis] - face)
    away = np.float32(-np.inf if name == "lower" else np.inf)
    match rng.integers(4):
        case 0:  # larger by a rounding
            face = np.nextafter(face, away)
        case 1:  # smaller by a rounding
            face = np.nextafter(face, -away)
        case 2:  # larger
            face += np.sign(away) * size * np.float32(10 ** rng.uniform(-4, 1))
        case _:  # smaller
            face -= np.sign(away) * size * np.float32(10 ** rng.uniform(-6, 0))
    arrays[name][n, axis] = face


def _change_header(held: Contents, rng: Random) -> None:
    table = held.header if rng.random() < 0.3 else held.header["meta"]
    if not isinstance(table, dict) or not table:
        return
    name = str(rng.choice(sorted(table)))
    if rng.random() < 0.2:
        del table[name]
    else:
        table[name] = VALUES[rng.integers(len(VALUES))]
    held.header.setdefault("meta", {})


def _change_array(held: Contents, rng: Random) -> None:
    name = str(rng.choice(sorted(held.arrays)))
    array = held.arrays[name].copy()
    kind = rng.integers(14)
    if kind < 9 and array.size:
        _change_values(array, rng, int(kind))
    elif kind == 9:
        array = array[: int(rng.integers(len(array) + 1))] if array.ndim else array
    elif kind == 10:
        array = np.concatenate([array, array[: int(rng.integers(5))]]) if array.ndim else array
    elif kind == 11:
        array = _other_type(array, rng)
    elif kind == 12:
        array = _other_shape(array, rng)
    elif rng.random() < 0.3:
        del held.arrays[name]
        return
    else:
        other = str(rng.choice(sorted(held.arrays)))
        held.arrays[other], array = array, held.arrays[other]
    held.arrays[name] = array


def _change_values(array: np.ndarray, rng: Random, kind: int) -> None:
    """Change elements or rows in place."""
    flat = array.reshape(-1)
    a, b = (int(i) for i in rng.integers(len(flat), size=2))
    special = FLOATS if array.dtype.kind == "f" else INTEGERS
    with np.errstate(all="ignore"):
        if kind < 3:
            value = special[rng.integers(len(special))]
            flat[a] = np.array(value).astype(array.dtype)
        elif kind == 3:
            flat[a] = flat[b]
        elif kind == 4:
            rows = [int(i) for i in rng.integers(len(array), size=2)] if array.ndim else [0, 0]
            if array.ndim:
                array[rows] = array[rows[::-1]]
        elif kind == 5:
            size = int(2 ** rng.uniform(0, 8))
            flat[a : a + size] = flat[a : a + size][::-1].copy()
        elif kind == 6:
            flat.view(np.uint8)[rng.integers(flat.nbytes)] ^= 1 << int(rng.integers(8))
        elif kind == 7 and array.dtype.kind in "iuf":
            step = rng.choice([-2, -1, 1, 2]) if array.dtype.kind != "f" else rng.normal() * 0.1
            flat[a] = (flat[a] + step).astype(array.dtype)
        else:
            size = int(2 ** rng.uniform(0, 8))
            flat[a : a + size] = flat[b]


def _other_type(array: np.ndarray, rng: Random) -> np.ndarray:
    dtype = np.dtype(TYPES[rng.integers(len(TYPES))])
    with np.errstate(all="ignore"):
        if rng.random() < 0.5 and array.nbytes % dtype.itemsize == 0:
            return np.frombuffer(array.tobytes(), dtype)  # the same bytes, read as something else
        try:
            return array.astype(dtype)
        except (TypeError, ValueError):
            return array


def _other_shape(array: np.ndarray, rng: Random) -> np.ndarray:
    match rng.integers(5):
        case 0:
            return array.reshape(-1)
        case 1:
            return array.T.copy()
        case 2:
            return array[None]
        case 3:
            return array[:0] if array.ndim else array
        case _:
            return array.reshape(-1)[0] if array.size else array
