"""One way to compile with Numba: cached, GIL-free, NumPy error model."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.dispatcher import Dispatcher


def njit(
    function: Callable[..., Any] | None = None, /, *, allocates: bool = True, **options: Any
) -> Any:
    """Compile ``function`` with the project's Numba settings.

    Numba counts references to the arrays that a function is handed, atomically; for one
    called at each node of a tree, that can be a fifth of the time on one thread, and more
    on several. A function that makes no array, nor returns one, does without the counts if
    ``allocates`` is false.

    Numba stamps a cached kernel with the file it stands in, and so keeps running an old
    copy of a callee or a constant from another file that has changed since. A stale kernel
    is a wrong number, so the stamp here covers those too.
    """
    if function is None:
        return functools.partial(njit, allocates=allocates, **options)
    # Said either way: a callee takes it from its caller otherwise.
    options["_nrt"] = allocates
    compiled = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    compiled.mibvh_files = _files(function)
    cache_file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if cache_file is not None and hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = _stamp(function, compiled.mibvh_files)
    return compiled


def _files(function: Callable[..., Any]) -> frozenset[str]:
    """The function's own file, and those of all compiled functions that its file imports."""
    files = {function.__code__.co_filename}
    for value in function.__globals__.values():
        if isinstance(value, Dispatcher):
            files |= getattr(value, "mibvh_files", set())
    return frozenset(files)


def _stamp(function: Callable[..., Any], files: frozenset[str]) -> Any:
    """State of the files, and the numbers that the function takes from its module."""
    numbers = sorted(
        (name, value)
        for name in function.__code__.co_names
        if isinstance(value := function.__globals__.get(name), int | float)
    )
    state = [Path(name).stat() for name in sorted(files)]
    return tuple((s.st_mtime_ns, s.st_size) for s in state), tuple(numbers)
