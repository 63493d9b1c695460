"""Which libLLVM Dr.Jit uses: the system's, or that of the wheel ``karellen-llvm-core``.

Dr.Jit looks for the library once, when it is imported. So the choice is made before that.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path

from mibvh.errors import MibvhError

#: Names the library to Dr.Jit.
VARIABLE = "DRJIT_LIBLLVM_PATH"
WHEEL = "karellen-llvm-core"
#: Libraries of the wheel that its libLLVM needs, in the order in which they need each other.
_NEEDED = ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0")
#: Mitsuba renders with a maximum, on which LLVM 15 aborts where the processor has AVX-512.
_PROBE = """
import drjit as dr, drjit.llvm as llvm
assert dr.has_backend(dr.JitBackend.LLVM)
dr.eval(dr.maximum(dr.arange(llvm.Float, 64), 3))
"""
_PROBE_SECONDS = 60


def choose_llvm() -> None:
    """Point Dr.Jit to the wheel's libLLVM where it would find none that works.

    Does nothing where Dr.Jit is imported already, the caller has chosen a library, or the
    wheel is not installed.
    """
    if "drjit" in sys.modules or VARIABLE in os.environ:
        return
    library = wheel_library()
    if library is not None and not usable():
        use(library)


def wheel_library() -> Path | None:
    """Return the wheel's libLLVM, or None if the wheel is not installed."""
    return _installed("libLLVM.so.")


def usable(library: Path | None = None) -> bool:
    """Whether Dr.Jit can compile with a library, or with what it finds by itself.

    Tried in a process of its own: a library that does not fit may end it.
    """
    prepare = f"from mibvh.llvm import use; from pathlib import Path; use(Path({str(library)!r}))"
    code = _PROBE if library is None else f"{prepare}\n{_PROBE}"
    try:
        run = subprocess.run(
            [sys.executable, "-c", code],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=_PROBE_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return run.returncode == 0


def use(library: Path) -> None:
    """Load what the wheel's libLLVM needs, and name it to Dr.Jit."""
    for name in _NEEDED:
        needed = _installed(name)
        if needed is None:
            raise MibvhError(f"{library}: the wheel {WHEEL} lacks {name}; install it again")
        # Local: libunwind does not stand being seen by the rest of the process.
        ctypes.CDLL(str(needed), mode=os.RTLD_LOCAL)
    os.environ[VARIABLE] = str(library)


def _installed(prefix: str) -> Path | None:
    """Return the wheel's file whose name begins so, or None."""
    try:
        files = importlib.metadata.files(WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        path = Path(str(file.locate()))
        if path.name.startswith(prefix) and path.is_file():
            return path.resolve()
    return None
