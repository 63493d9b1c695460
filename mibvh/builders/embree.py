"""Embree's own builder on the bench: ``rtcBuildBVH`` of the library that Mitsuba ships.

Wald, Woop, Benthin, Johnson and Ernst: *Embree: A Kernel Framework for Efficient CPU Ray Tracing*
(SIGGRAPH 2014). Embree decides the topology: Morton codes (``low``), binned SAH (``medium``), or
binned SAH with spatial splits (``high``), down to one reference per leaf. It asks for nodes, leaves
and parts of triangles through callbacks, which Numba compiles. Like any builder's, the draft then
gets its bounds and leaves from the shared finishing.

A tree of four or eight children per node (:func:`mibvh.build_wide`) is Embree's own, leaves
included: no finishing touches it.
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
from mibvh.builders.options import Options, option
from mibvh.builders.registry import Context, builder
from mibvh.builders.splitting import MAX_CORNERS, split_reference
from mibvh.errors import MibvhError
from mibvh.tree import MAX_DEPTH
from mibvh.triangles import Triangles
from mibvh.wide_tree import C_BOX, WideTree

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
#: Deeper than any tree is. Embree gives up at the limit; the shared finishing mends depth. Near the
#: limit of a wide tree, Embree halves what is left.
_MAX_DEPTH = 1 << 20
#: Triangles that Embree puts into a leaf at most.
_MAX_LEAF = 32
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

    # A node is its number of children, then pointers to them; a leaf is the number of its
    # references, negative, then their rows, 16 bytes further on.
    def create_node(allocator, children, _user):
        memory = allocate(allocator, 8 * (1 + children), 16)
        words = numba.carray(_pointer(memory), 1, np.int64)
        words[0] = children
        return memory

    def set_children(node, children, count, _user):
        words = numba.carray(node, 1 + count, np.int64)
        given = numba.carray(children, count, np.int64)
        for i in range(count):
            words[1 + i] = given[i]

    def set_bounds(_node, _bounds, _count, _user):
        pass

    def create_leaf(allocator, primitives, count, _user):
        memory = allocate(allocator, 16 + 32 * count, 16)
        words = numba.carray(_pointer(memory), 2 + 4 * count, np.int64)
        given = numba.carray(primitives, 4 * count, np.int64)
        words[0] = -np.int64(count)
        for i in range(4 * count):
            words[2 + i] = given[i]
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
        if words[0] < 0:
            triangle[leaves] = _row(address, 0, lower[leaves], upper[leaves])
            reference[place] = leaves
            leaves += 1
            continue
        left[place], right[place] = nodes, nodes + 1
        todo[top, 0], todo[top, 1] = words[2], nodes + 1
        todo[top + 1, 0], todo[top + 1, 1] = words[1], nodes
        nodes, top = nodes + 2, top + 2
    links = left[:nodes].copy(), right[:nodes].copy(), reference[:nodes].copy()
    return links, lower[:leaves].copy(), upper[:leaves].copy(), triangle[:leaves].copy()


@njit
def _row(leaf, i, lower, upper):
    """Copy the box of a leaf's reference, and return its triangle."""
    box = numba.carray(_pointer(leaf + 16 + 32 * i), 8, np.float32)
    for k in range(3):
        lower[k], upper[k] = box[k], box[4 + k]
    return np.int32(numba.carray(_pointer(leaf + 16 + 32 * i), 8, np.uint32)[7])


@njit
def _gather_wide(root, room, width):
    """Nodes of a wide tree in Embree's memory, parents before children, in builder units.

    What splitting left of a triangle in one leaf is one reference again.
    """
    lower, upper = np.empty((2 * room, 3), np.float32), np.empty((2 * room, 3), np.float32)
    rows = np.full((2 * room, width), -1, np.int32)
    parent = np.full(2 * room, -1, np.int32)
    first, count = np.zeros(2 * room, np.int32), np.zeros(2 * room, np.int32)
    triangle = np.empty(room, np.int32)
    low, high = np.empty(3, np.float32), np.empty(3, np.float32)
    todo = np.empty((room + 1, 2), np.int64)
    todo[0, 0], todo[0, 1], top = root, 0, 1
    nodes, used = 1, 0
    while top > 0:
        top -= 1
        address, n = todo[top, 0], todo[top, 1]
        size = numba.carray(_pointer(address), 1, np.int64)[0]
        lower[n], upper[n] = np.inf, -np.inf
        if size > 0:
            words = numba.carray(_pointer(address), 1 + size, np.int64)
            for i in range(size):
                rows[n, i], parent[nodes] = nodes, n
                todo[top, 0], todo[top, 1] = words[1 + i], nodes
                nodes, top = nodes + 1, top + 1
            continue
        first[n] = used
        for i in range(-size):
            triangle[used] = _row(address, i, low, high)
            _widen(lower[n], upper[n], low, high)
            if triangle[used] not in triangle[first[n] : used]:
                used += 1
        count[n] = used - first[n]
    for n in range(nodes - 1, 0, -1):
        _widen(lower[parent[n]], upper[parent[n]], lower[n], upper[n])
    return (
        lower[:nodes],
        upper[:nodes],
        rows[:nodes],
        first[:nodes],
        count[:nodes],
        triangle[:used],
    )


@njit
def _widen(lower, upper, low, high):
    for k in range(3):
        lower[k], upper[k] = min(lower[k], low[k]), max(upper[k], high[k])


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


def _built(
    triangles: Triangles, options: EmbreeOptions, width: int, gather: Any
) -> tuple[Any, float]:
    """Let Embree build, and take its nodes over before it lets go of them.

    Returns
    -------
    What ``gather`` returns of the root and the room for references, and the units' scale.
    """
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
            byteSize=ctypes.sizeof(_Arguments),
            buildQuality=_QUALITIES[options.quality],
            maxBranchingFactor=width,
            maxDepth=_MAX_DEPTH if width == 2 else MAX_DEPTH,
            sahBlockSize=1,
            minLeafSize=1,
            maxLeafSize=1 if width == 2 else min(options.max_leaf, _MAX_LEAF),
            # Embree counts splits: a node of `width` children is made by one fewer.
            traversalCost=(options.c_inner + C_BOX * (width - 2)) / (width - 1),
            intersectionCost=options.c_tri,
            bvh=bvh,
            primitives=rows.ctypes.data,
            primitiveCount=count,
            primitiveArrayCapacity=room,
            userPtr=corners.ctypes.data,
            **{name: function.address for name, function in callbacks.items()},
        )
        root = library.rtcBuildBVH(ctypes.byref(arguments))
        error = library.rtcGetDeviceError(device)
        if not root or error:
            raise MibvhError(f"builder embree: Embree gave up (its error {error})")
        return gather(root, room), references.scale
    finally:
        library.rtcReleaseBVH(bvh)
        library.rtcReleaseDevice(device)


def embree_wide(triangles: Triangles, options: EmbreeOptions, width: int) -> WideTree:
    """Let Embree build nodes of up to ``width`` children, and leaves of up to ``max_leaf``."""

    def gather(root: int, room: int) -> Any:
        return _gather_wide(root, room, width)

    (lower, upper, *rest), scale = _built(triangles, options, width, gather)
    unscale = np.float32(1.0 / scale)
    return WideTree.from_nodes(lower * unscale, upper * unscale, *rest)


@builder(
    "embree",
    summary="the builder of the Embree library that Mitsuba ships",
    source="Wald et al. 2014",
    options=EmbreeOptions,
    wide=embree_wide,
    memory=330,
)
def embree(triangles: Triangles, options: EmbreeOptions, context: Context) -> Draft:
    """Let Embree build down to single references."""
    (links, lower, upper, triangle), scale = _built(triangles, options, 2, _gather)
    return Draft(References(lower, upper, triangle, scale), *links, {"references": len(triangle)})
