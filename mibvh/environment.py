"""A description of this machine, kept with every result and shown by ``mibvh doctor``."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

from mibvh.parallel import thread_count
from mibvh.version import __version__

_PACKAGES = ("drjit", "mitsuba", "numba", "numpy", "scipy", "pandas", "trimesh")


def cpu_model() -> str:
    """Return the processor's name."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def gpu_model() -> str | None:
    """Return name and driver of the first graphics card, as NVIDIA's own tool tells them."""
    command = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    except (OSError, subprocess.SubprocessError):
        return None
    return next(iter(told.stdout.splitlines()), None)


def environment() -> dict[str, Any]:
    """Versions, processor or graphics card, LLVM, lanes and threads, as JSON-able values.

    Raises
    ------
    MibvhError
        If no JIT variant can be used.
    """
    import drjit as dr

    from mibvh.variant import lane_width, mitsuba

    mi = mitsuba()
    llvm = mi.variant().startswith("llvm")
    return {
        "mibvh": __version__,
        "python": platform.python_version(),
        "packages": {name: importlib.metadata.version(name) for name in _PACKAGES},
        "system": f"{platform.system()} {platform.release()}",
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "threads": thread_count(),
        "variant": mi.variant(),
        **({} if llvm else {"gpu": gpu_model()}),
        "llvm": ".".join(map(str, dr.detail.llvm_version())) if llvm else None,
        "libllvm": os.environ.get("DRJIT_LIBLLVM_PATH", "system"),
        "lane_width": lane_width(),
    }


def doctor() -> dict[str, Any]:
    """Check what the machine offers to mibvh; never raises.

    Returns
    -------
    dict
        ``ready`` (bool), ``llvm`` and ``cuda`` (whether Dr.Jit can use them), ``advice`` (what
        to install, in sentences), and the :func:`environment` if there is a usable backend.
    """
    from mibvh.errors import MibvhError
    from mibvh.llvm import choose_llvm

    choose_llvm()
    import drjit as dr

    llvm, cuda = (bool(dr.has_backend(b)) for b in (dr.JitBackend.LLVM, dr.JitBackend.CUDA))
    state: dict[str, Any] = {"ready": llvm or cuda, "llvm": llvm, "cuda": cuda, "advice": []}
    try:
        state["environment"] = environment()
    except MibvhError as error:
        state["ready"] = False
        state["advice"].append(str(error))
    return state
