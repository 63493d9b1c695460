"""Which Mitsuba variant is in use. No module sets one at import; work that needs one asks here."""

from __future__ import annotations

import functools
import os
import re
import warnings
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

    if mi.variant() is None:
        wanted = os.environ.get("MIBVH_VARIANT", DEFAULT)
        if wanted not in mi.variants():
            raise MibvhError(
                f"MIBVH_VARIANT: this Mitsuba has no variant {wanted!r}; it has: "
                f"{', '.join(mi.variants())}"
            )
        try:
            mi.set_variant(wanted)
        except ImportError:  # what Dr.Jit raises without its library
            raise MibvhError(f"the variant {wanted} cannot be used: {_hint(wanted)}") from None
    if mi.variant().startswith("scalar"):
        raise MibvhError(
            f"mibvh traces rays with Dr.Jit, which the variant {mi.variant()} does not use; "
            "set an llvm_* or cuda_* variant instead"
        )
    _prepare(mi.variant().split("_")[0])
    return mi


@functools.cache
def _prepare(backend: str) -> None:
    """Once per backend: see that it works, and give it our number of threads."""
    import drjit as dr

    jit = dr.JitBackend.LLVM if backend == "llvm" else dr.JitBackend.CUDA
    if not dr.has_backend(jit):
        raise MibvhError(f"Dr.Jit cannot use its {backend.upper()} backend: {_hint(backend)}")
    if "MIBVH_THREADS" in os.environ:
        dr.set_thread_count(thread_count())


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


@functools.cache
def lane_width() -> int:
    """Lanes of a Dr.Jit packet: the vector width on LLVM, the warp on CUDA.

    Dr.Jit does not tell its vector width, so it is read off the code of a small kernel.
    """
    mi = mitsuba()
    if mi.variant().startswith("cuda"):
        return 32
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(dr.arange(mi.Float, 1000) * 2.5 + 1.25)
        source = dr.kernel_history([dr.KernelType.JIT])[0]["ir"].getvalue()
    return max(int(width) for width in re.findall(r"<(\d+) x float>", source))
