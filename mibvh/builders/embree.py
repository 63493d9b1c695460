"""Embree's own builder on the bench: ``rtcBuildBVH`` of the library that Mitsuba ships.

Wald, Woop, Benthin, Johnson and Ernst: *Embree: A Kernel Framework for Efficient CPU Ray Tracing*
(SIGGRAPH 2014). Embree decides the topology: Morton codes (``low``), binned SAH (``medium``), or
binned SAH with spatial splits (``high``), down to one reference per leaf. It asks for nodes, leaves
and parts of triangles through callbacks, which Numba compiles. Like any builder's, the draft then
gets its bounds and leaves from the shared finishing.
"""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import importlib.machinery
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.registry import Context, Options, builder, option
from mibvh.builders.splitting import MAX_CORNERS, split_reference
from mibvh.errors import MibvhError
from mibvh.triangles import Triangles

#: Mitsuba's Embree stands in a C++ namespace of its own, so its functions have mangled names
#: (Itanium ABI: Linux and macOS).
_NAMES = {
    "rtcNewDevice": "_ZN7mitsuba12rtcNewDeviceEPKc",
    "rtcGetDeviceError": "_ZN7mitsuba17rtcGetDeviceErrorEPNS_11RTCDeviceTyE",
    "rtcReleaseDevice": "_ZN7mitsuba16rtcReleaseDeviceEPNS_11RTCDeviceTyE",
    "rtcNewBVH": "_ZN7mitsuba9rtcNewBVHEPNS_11RTCDeviceTyE",
    "rtcBuildBVH": "_ZN7mitsuba11rtcBuildBVHEPKNS_17RTCBuildArgumentsE",
    "rtcReleaseBVH": "_ZN7mitsuba13rtcReleaseBVHEPNS_8RTCBVHTyE",
    "rtcThreadLocalAlloc": ("_ZN7mitsuba19rtcThreadLocalAllocEPNS_25RTCThreadLocalAllocatorTyEmm"),
}
_QUALITIES = {"low": 0, "medium": 1, "high": 2}
#: Deeper than any tree is; Embree gives up at the limit, the shared finishing mends depth.
_MAX_DEPTH = 1 << 20
#: Bytes of a node (its number of children, two pointers) and of a leaf (0, the triangle, its box).
_NODE, _LEAF = 24, 40
#: A row of Embree's ``RTCBuildPrimitive``.
_PRIMITIVE = np.dtype(
    [("lower", "f4", 3), ("geometry", "u4"), ("upper", "f4", 3), ("triangle", "u4")]
)
_ALIGNMENT = 64


class _Arguments(ctypes.Structure):
    """``RTCBuildArguments`` of Embree 3."""

    _fields_ = (
        ("byteSize", ctypes.c_size_t),
        ("buildQuality", ctypes.c_int),
        ("buildFlags", ctypes.c_int),
        ("maxBranchingFactor", ctypes.c_uint),
        ("maxDepth", ctypes.c_uint),
        ("sahBlockSize", ctypes.c_uint),
        ("minLeafSize", ctypes.c_uint),
        ("maxLeafSize", ctypes.c_uint),
        ("traversalCost", ctypes.c_float),
        ("intersectionCost", ctypes.c_float),
        ("bvh", ctypes.c_void_p),
        ("primitives", ctypes.c_void_p),
        ("primitiveCount", ctypes.c_size_t),
        ("primitiveArrayCapacity", ctypes.c_size_t),
        ("createNode", ctypes.c_void_p),
        ("setNodeChildren", ctypes.c_void_p),
        ("setNodeBounds", ctypes.c_void_p),
        ("createLeaf", ctypes.c_void_p),
        ("splitPrimitive", ctypes.c_void_p),
        ("buildProgress", ctypes.c_void_p),
        ("userPtr", ctypes.c_void_p),
    )


@functools.cache
def _library() -> Any:
    """Load Embree, with the types of the functions used.

    Raises
    ------
    MibvhError
        If it is not there, or has other names for them.
    """
    # Once a variant is set, the module named mitsuba is another than the package.
    spec = importlib.machinery.PathFinder.find_spec("mitsuba")
    folders = [Path(p) for p in (spec.submodule_search_locations or [])] if spec else []
    found = sorted(f for folder in folders for f in folder.glob("libembree*"))
    if not found:
        raise MibvhError(
            "builder embree needs the Embree library that Mitsuba ships; it is not there"
        )
    try:
        library = ctypes.CDLL(str(found[0]))
        for name, mangled in _NAMES.items():
            function = getattr(library, mangled)
            function.restype, function.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
            setattr(library, name, function)
    except (OSError, AttributeError):
        raise MibvhError(
            f"builder embree cannot use {found[0].name} on {sys.platform}: it does not load, or "
            "hides rtcBuildBVH"
        ) from None
    library.rtcThreadLocalAlloc.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t]
    library.rtcGetDeviceError.restype = ctypes.c_int
    return library


# ------------------------------------------------------------------ callbacks


@intrinsic
def _pointer(typing: Any, address: Any) -> Any:
    """A pointer to an address."""

    def generate(context: Any, code: Any, signature: Any, arguments: Any) -> Any:
        return code.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


@functools.cache
def _callbacks() -> dict[str, Any]:
    """Compile what Embree calls, possibly from several threads."""
    allocate = _library().rtcThreadLocalAlloc
    pointer, size, uint = types.voidptr, types.uintp, types.uint32

    def create_node(allocator, children, _user):
        memory = allocate(allocator, _NODE, 16)
        words = numba.carray(_pointer(memory), 3, np.int64)
        words[0] = children
        return memory

    def set_children(node, children, count, _user):
        words = numba.carray(node, 3, np.int64)
        given = numba.carray(children, 2, np.int64)
        for i in range(count):
            words[1 + i] = given[i]

    def set_bounds(_node, _bounds, _count, _user):
        pass

    def create_leaf(allocator, primitives, _count, _user):
        memory = allocate(allocator, _LEAF, 16)
        words = numba.carray(_pointer(memory), 2, np.int64)
        box = numba.carray(_pointer(memory), 10, np.float32)
        given = numba.carray(primitives, 8, np.float32)
        words[0] = 0
        words[1] = numba.carray(primitives, 8, np.uint32)[7]
        for k in range(3):
            box[4 + k], box[7 + k] = given[k], given[4 + k]
        return memory

    def split(primitive, axis, plane, left, right, user):
        row = numba.carray(primitive, 8, np.float32)
        t = numba.carray(primitive, 8, np.uint32)[7]
        corners = numba.carray(user, (2**31, 3, 3), np.float64)
        boxes, parts = np.empty((1, 8), np.float32), np.empty((2, 8), np.float32)
        polygon = np.empty((2, MAX_CORNERS, 3))
        for k in range(4):
            boxes[0, k], boxes[0, 4 + k] = row[k], -row[4 + k]
        held = split_reference(
            corners, t, 1.0, boxes, 0, axis, plane, parts[0], parts[1], polygon[0], polygon[1]
        )
        for half in range(2):
            out = numba.carray(left if half == 0 else right, 8, np.float32)
            for k in range(3):
                there = held & (half + 1)
                out[k] = parts[half, k] if there else np.float32(np.inf)
                out[4 + k] = -parts[half, 4 + k] if there else np.float32(-np.inf)

    signatures = {
        "createNode": (create_node, types.intp(types.intp, uint, pointer)),
        "setNodeChildren": (set_children, types.void(pointer, pointer, uint, pointer)),
        "setNodeBounds": (set_bounds, types.void(pointer, pointer, uint, pointer)),
        "createLeaf": (create_leaf, types.intp(types.intp, pointer, size, pointer)),
        "splitPrimitive": (
            split,
            types.void(pointer, uint, types.float32, pointer, pointer, pointer),
        ),
    }
    return {
        name: numba.cfunc(signature, error_model="numpy")(function)
        for name, (function, signature) in signatures.items()
    }


@njit
def _gather(root, room):
    """Draft of the tree in Embree's memory: its links, and the references in leaf order."""
    left, right, reference = np.full((3, 2 * room - 1), -1, np.int32)
    lower, upper = np.empty((room, 3), np.float32), np.empty((room, 3), np.float32)
    triangle = np.empty(room, np.int32)
    todo = np.empty((room + 1, 2), np.int64)
    todo[0, 0], todo[0, 1], top = root, 0, 1
    nodes, leaves = 1, 0
    while top > 0:
        top -= 1
        address, place = todo[top, 0], todo[top, 1]
        words = numba.carray(_pointer(address), 3, np.int64)
        if words[0] == 0:
            box = numba.carray(_pointer(address), 10, np.float32)
            reference[place], triangle[leaves] = leaves, words[1]
            for k in range(3):
                lower[leaves, k], upper[leaves, k] = box[4 + k], box[7 + k]
            leaves += 1
            continue
        left[place], right[place] = nodes, nodes + 1
        todo[top, 0], todo[top, 1] = words[2], nodes + 1
        todo[top + 1, 0], todo[top + 1, 1] = words[1], nodes
        nodes, top = nodes + 2, top + 2
    links = left[:nodes].copy(), right[:nodes].copy(), reference[:nodes].copy()
    return links, lower[:leaves].copy(), upper[:leaves].copy(), triangle[:leaves].copy()


# ------------------------------------------------------------------ the builder


@dataclasses.dataclass(frozen=True, kw_only=True)
class EmbreeOptions(Options):
    """Options of `embree`."""

    quality: str = option(
        "medium", "low (Morton codes), medium (binned SAH) or high (with spatial splits)"
    )
    budget: float = option(
        0.5, "references that spatial splits may add, per triangle (high quality)", 0.0, 8.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.quality not in _QUALITIES:
            known = ", ".join(_QUALITIES)
            raise MibvhError(f"option quality must be one of {known}, not {self.quality!r}")


def _primitives(references: References, room: int) -> Any:
    """Embree's rows of the references, with room for more; aligned as it wants them."""
    memory = np.zeros(room * _PRIMITIVE.itemsize + _ALIGNMENT, np.uint8)
    skip = -memory.ctypes.data % _ALIGNMENT
    rows = memory[skip : skip + room * _PRIMITIVE.itemsize].view(_PRIMITIVE)
    count = len(references)
    rows["lower"][:count], rows["upper"][:count] = references.lower, references.upper
    rows["triangle"][:count] = references.triangle
    return rows


@builder(
    "embree",
    summary="the builder of the Embree library that Mitsuba ships",
    source="Wald et al. 2014",
    options=EmbreeOptions,
)
def embree(triangles: Triangles, options: EmbreeOptions, context: Context) -> Draft:
    """Let Embree build down to single references."""
    references = References.of(triangles)
    count = len(references)
    room = count + int(options.budget * count) if options.quality == "high" else count
    library, callbacks = _library(), _callbacks()
    rows = _primitives(references, room)
    corners = triangles.corners.astype(np.float64) * references.scale
    # One thread: which references are split would depend on the order in which threads come.
    device = library.rtcNewDevice(b"threads=1")
    if not device:
        raise MibvhError("builder embree: Embree makes no device on this machine")
    bvh = library.rtcNewBVH(device)
    try:
        arguments = _Arguments(
            byteSize=ctypes.sizeof(_Arguments), buildQuality=_QUALITIES[options.quality],
            maxBranchingFactor=2, maxDepth=_MAX_DEPTH, sahBlockSize=1, minLeafSize=1, maxLeafSize=1,
            traversalCost=options.c_inner, intersectionCost=options.c_tri, bvh=bvh,
            primitives=rows.ctypes.data, primitiveCount=count, primitiveArrayCapacity=room,
            userPtr=corners.ctypes.data,
            **{name: function.address for name, function in callbacks.items()},
        )  # fmt: skip
        root = library.rtcBuildBVH(ctypes.byref(arguments))
        error = library.rtcGetDeviceError(device)
        if not root or error:
            raise MibvhError(f"builder embree: Embree gave up (its error {error})")
        links, lower, upper, triangle = _gather(root, room)
    finally:
        library.rtcReleaseBVH(bvh)
        library.rtcReleaseDevice(device)
    return Draft(
        References(lower, upper, triangle, references.scale), *links, {"references": len(triangle)}
    )
