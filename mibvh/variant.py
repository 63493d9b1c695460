"""Which Mitsuba variant is in use. No module sets one at import; work that needs one asks here."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import warnings
from collections.abc import Iterator
from typing import Any

from mibvh.errors import MibvhError
from mibvh.llvm import choose_llvm
from mibvh.parallel import thread_count

DEFAULT = "llvm_ad_rgb"
#: What to do where Dr.Jit finds no LLVM.
LLVM_HINT = (
    "install LLVM 15 or newer (Debian, Ubuntu: apt install libllvm19; macOS: brew install llvm; "
    "without root: pip install 'mibvh[llvm]'), or point DRJIT_LIBLLVM_PATH at its libLLVM"
)
#: The variant that needs neither LLVM nor a GPU: it can read scenes, but not trace many rays.
_READER = "scalar_rgb"
_reading = False


def mitsuba() -> Any:
    """Return the ``mitsuba`` module with a JIT variant active.

    A variant that the caller has set is kept; otherwise ``MIBVH_VARIANT`` or
    ``llvm_ad_rgb`` is set.

    Raises
    ------
    MibvhError
        For a ``scalar_*`` variant, or where the LLVM or CUDA library cannot be used.
    """
    choose_llvm()
    import mitsuba as mi

    if _reading:
        return mi
    if mi.variant() is None:
        _set(mi, os.environ.get("MIBVH_VARIANT", DEFAULT), "MIBVH_VARIANT: ")
    _check(mi.variant())
    return mi


def use_variant(name: str) -> None:
    """Use a variant from here on, whichever was in use.

    Parameters
    ----------
    name : str
        Such as ``cuda_ad_rgb``.

    Raises
    ------
    MibvhError
        If Mitsuba has no such variant, or this machine lacks what it needs; the variant that was
        in use stays so.
    """
    choose_llvm()
    import mitsuba as mi

    before = mi.variant()
    try:
        _set(mi, name)
        _check(name)
    except MibvhError:
        if before is not None:
            mi.set_variant(before)
        raise
    os.environ["MIBVH_VARIANT"] = name  # of processes that are started


def _set(mi: Any, wanted: str, where: str = "") -> None:
    if wanted not in mi.variants():
        raise MibvhError(
            f"{where}this Mitsuba has no variant {wanted!r}; it has: {', '.join(mi.variants())}"
        )
    try:
        mi.set_variant(wanted)
    except ImportError:  # what Dr.Jit raises without its library
        raise MibvhError(f"the variant {wanted} cannot be used: {_hint(wanted)}") from None


def _check(variant: str) -> None:
    """See that a variant traces rays with Dr.Jit, and that this machine can."""
    if variant.startswith("scalar"):
        raise MibvhError(
            f"mibvh traces rays with Dr.Jit, which the variant {variant} does not use; "
            "set an llvm_* or cuda_* variant instead"
        )
    _prepare(backend_of(variant))


def backend_of(variant: str) -> str:
    """``llvm`` or ``cuda``."""
    return variant.split("_")[0]


def backend() -> str:
    """Backend of the variant in use: counts may differ between the two, which round otherwise."""
    return backend_of(mitsuba().variant())


def mitsuba_traces() -> bool:
    """Whether Mitsuba's own ray tracing can be used: on a GPU it takes OptiX, which may lack.

    mibvh's kernels need no more than CUDA.
    """
    mi = mitsuba()
    return backend() != "cuda" or _optix(mi.variant())


@functools.cache
def _optix(variant: str) -> bool:
    mi = mitsuba()
    try:
        scene = mi.load_dict({"type": "scene", "shape": {"type": "rectangle"}})
        ray = mi.Ray3f(mi.Point3f(0, 0, 1), mi.Vector3f(0, 0, -1))
        return float(scene.ray_intersect_preliminary(ray).t[0]) == 1.0
    except RuntimeError:
        return False


@contextlib.contextmanager
def reading_variant() -> Iterator[None]:
    """Let Mitsuba read scenes without Dr.Jit for a while: its variant on a GPU needs OptiX.

    What it makes in the meantime serves for triangles alone.
    """
    global _reading
    mi = mitsuba()
    before = mi.variant()
    mi.set_variant(_READER)
    _reading = True
    try:
        yield
    finally:
        _reading = False
        mi.set_variant(before)


@functools.cache
def _prepare(backend: str) -> None:
    """Once per backend: see that it works, and give it our number of threads."""
    import drjit as dr

    jit = dr.JitBackend.LLVM if backend == "llvm" else dr.JitBackend.CUDA
    if not dr.has_backend(jit):
        raise MibvhError(f"Dr.Jit cannot use its {backend.upper()} backend: {_hint(backend)}")
    if "MIBVH_THREADS" in os.environ:
        dr.set_thread_count(thread_count())


@contextlib.contextmanager
def two_threads() -> Iterator[None]:
    """Give Dr.Jit two threads for a while, at least.

    On one, Mitsuba waits for itself for ever where it reads or writes OpenEXR.
    """
    import drjit as dr

    threads = dr.thread_count()
    if threads < 2:
        dr.set_thread_count(2)
    try:
        yield
    finally:
        if threads < 2:
            dr.set_thread_count(threads)


def _hint(variant: str) -> str:
    return LLVM_HINT if variant.startswith("llvm") else "an NVIDIA driver is needed"


def release_memory() -> None:
    """Release to the system the memory of freed arrays that Dr.Jit keeps for new ones."""
    import drjit as dr

    dr.flush_malloc_cache()


def give_back_memory() -> None:
    """The former name of :func:`release_memory`."""
    warnings.warn("give_back_memory is now called release_memory", DeprecationWarning, stacklevel=2)
    release_memory()


def lane_width() -> int:
    """Lanes of a Dr.Jit packet: the vector width on LLVM, the warp on CUDA.

    Dr.Jit does not tell its vector width, so it is read off the code of a small kernel.
    """
    return _lane_width(mitsuba().variant())


@functools.cache
def _lane_width(variant: str) -> int:
    if backend_of(variant) == "cuda":
        return 32
    import drjit as dr

    mi = mitsuba()

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(dr.arange(mi.Float, 1000) * 2.5 + 1.25)
        source = dr.kernel_history([dr.KernelType.JIT])[0]["ir"].getvalue()
    return max(int(width) for width in re.findall(r"<(\d+) x float>", source))
