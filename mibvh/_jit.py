"""One way to compile with Numba: cached, GIL-free, NumPy error model."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


@functools.cache
def _package_stamp() -> tuple[float, int]:
    """Newest change and total size of the package's sources."""
    files = [path.stat() for path in Path(__file__).parent.rglob("*.py")]
    return max(f.st_mtime for f in files), sum(f.st_size for f in files)


def njit(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile ``function`` with the project's Numba settings.

    Numba stamps a cached kernel with the file it stands in, and so keeps running an old
    copy of a callee from another file that has changed since. A stale kernel is a wrong
    number, so the cache is stamped with the whole package instead.
    """
    if function is None:
        return functools.partial(njit, **options)
    compiled = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    cache_file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = _package_stamp()
    return compiled
