"""One way to compile with Numba: cached, GIL-free, NumPy error model."""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
from numba import types
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic


def njit(
    function: Callable[..., Any] | None = None, /, *, allocates: bool = True, **options: Any
) -> Any:
    """Compile ``function`` with the project's Numba settings.

    Numba counts references to the arrays that a function is handed, atomically; for one
    called at each node of a tree, that can be a fifth of the time on one thread, and more
    on several. A function that makes no array, nor returns one, does without the counts if
    ``allocates`` is false.

    Numba stamps a cached kernel with the file it stands in, and so keeps running an old
    copy of a callee, an intrinsic or a constant from another file that has changed since. A
    stale kernel is a wrong number, so the stamp here covers those too.

    Compiled code is kept beside the source, or in the user's cache, or, where neither can be
    written, among the temporary files. ``NUMBA_CACHE_DIR`` names another place.
    """
    if function is None:
        return functools.partial(njit, allocates=allocates, **options)
    # Said either way: a callee takes it from its caller otherwise.
    options["_nrt"] = allocates
    options |= {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    kernel = numba.njit(cache=True, pipeline_class=_Compiler, **options)
    try:
        compiled = kernel(function)
    except RuntimeError:  # neither the package nor the home can be written
        numba.config.CACHE_DIR = _temporary_cache()
        compiled = kernel(function)
    compiled.mibvh_files = _files(function)
    _keep_if_possible(compiled)
    _compile_once(compiled)
    cache_file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if cache_file is not None and hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = _stamp(function, compiled.mibvh_files)
        _read_if_sound(cache_file)
    return compiled


def cache_folder(kernel: Dispatcher) -> Path:
    """Return the folder in which the compiled code of a kernel is kept."""
    return Path(kernel.stats.cache_path)


class _Compiler(Compiler):
    """Numba's compiler without garbage collection: each collection goes through all modules."""

    def _compile_core(self) -> Any:
        enabled = gc.isenabled()
        gc.disable()
        try:
            return super()._compile_core()
        finally:
            if enabled:
                gc.enable()


@functools.cache
def _temporary_cache() -> str:
    """Return a folder for compiled code among the temporary files.

    One for all runs of this user; one for this run alone if somebody else could write to it, as
    what is in it is run.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    path = Path(tempfile.gettempdir()) / f"mibvh-compiled-{user}"
    with contextlib.suppress(OSError):
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o077:
            return str(path)
    alone = tempfile.mkdtemp(prefix="mibvh-compiled-")
    atexit.register(shutil.rmtree, alone, ignore_errors=True)
    return alone


def _keep_if_possible(compiled: Dispatcher) -> None:
    """Let a full disk cost no more than the next run's time."""
    cache = compiled._cache
    save = cache.save_overload

    def save_overload(signature: Any, data: Any) -> None:
        with contextlib.suppress(OSError):
            save(signature, data)

    cache.save_overload = save_overload


def _read_if_sound(cache_file: Any) -> None:
    """Take what cannot be read for no cache at all, and compile anew.

    An index that another version of this package left names types that may be gone; Numba reads
    it before it looks at the stamp. A file may be damaged, too.
    """
    load_index, load_data = cache_file._load_index, cache_file._load_data

    def index() -> Any:
        try:
            return load_index()
        except Exception:  # unpickling fails in many ways
            return {}

    def data(name: str) -> Any:
        try:
            return load_data(name)
        except Exception as error:
            raise OSError(f"{name} cannot be read") from error  # for Numba, it is not there

    cache_file._load_index, cache_file._load_data = index, data


def _compile_once(compiled: Dispatcher) -> None:
    """Compile a callee once for all signed integers, constants among them.

    Numba would compile a copy for each width and for constants, with all that it calls in turn.
    """
    template = compiled.get_call_template

    def get_call_template(args: Any, kws: Any) -> Any:
        return template([_wide(a) for a in args], {name: _wide(a) for name, a in kws.items()})

    compiled.get_call_template = get_call_template


def _wide(kind: Any) -> Any:
    kind = types.unliteral(kind) if isinstance(kind, types.Literal) else kind
    return types.int64 if isinstance(kind, types.Integer) and kind.signed else kind


def _files(function: Callable[..., Any]) -> frozenset[str]:
    """The function's own file, and those of all compiled functions that its file imports.

    Intrinsics write instructions into the function as their own file says, and what that imports.
    """
    files = {function.__code__.co_filename}
    of_others: set[str] = set()
    waiting = [function.__globals__]
    while waiting:
        names = waiting.pop()
        files |= {names["__file__"]} if names.get("__file__") else set()
        for value in names.values():
            further = None
            if isinstance(value, Dispatcher):
                of_others |= getattr(value, "mibvh_files", set())
            elif isinstance(value, _Intrinsic):
                further = value._defn.__globals__
            elif isinstance(value, ModuleType) and _of_one_package(value.__name__, names):
                further = vars(value)
            if further is not None and further.get("__file__", "") not in {"", *files}:
                waiting.append(further)
    return frozenset(files | of_others)


def _of_one_package(module: str, names: dict[str, Any]) -> bool:
    return module.partition(".")[0] == str(names["__name__"]).partition(".")[0]


def _stamp(function: Callable[..., Any], files: frozenset[str]) -> Any:
    """State of the files, and the numbers that the function takes from its module."""
    numbers = sorted(
        (name, value)
        for name in function.__code__.co_names
        if isinstance(value := function.__globals__.get(name), int | float)
    )
    state = [Path(name).stat() for name in sorted(files)]
    return tuple((s.st_mtime_ns, s.st_size) for s in state), tuple(numbers)
