"""Available memory, and the refusal of work that needs more."""

from __future__ import annotations

import contextlib
from pathlib import Path

from mibvh.errors import MibvhError

#: Peak bytes of work, measured on bundled and real scenes, rounded up: each triangle of a bundled
#: scene that is generated, and that is loaded; each ray from a camera that rays are made of, and
#: for each bounce beyond the first; each ray that is traced with counters; each reference of a
#: tree whose EPO is computed; each reference of a tree that is kept, with what is derived from it;
#: of the records that kernels read; each triangle of a scene that is turned beside the first.
#: Builders state theirs where they are registered.
BYTES = {
    "generate": 200.0,
    "load": 350.0,
    "rays": 290.0,
    "bounce": 120.0,
    "trace": 456.0,
    "epo": 480.0,
    "tree": 64.0,
    "records": 110.0,
    "turned": 120.0,
}
#: Bytes of what is loaded and compiled on the way through a study: kernels, renderers.
COMPILED = 3e8
#: References that a tree may have: its nodes, twice as many, are numbered by 31 bits.
MOST_REFERENCES = 1 << 30

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_MEMINFO = Path("/proc/meminfo")
_STATM = Path("/proc/self/statm")
#: Limits of containers, of the second and the first kind: (most, in use).
_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def available_memory() -> int | None:
    """Return the bytes that this process may still allocate; None if unknown.

    The least of what the machine has free, what the container leaves and what ``ulimit -v`` does.
    """
    found = [left for left in (_machine(), *map(_group, _GROUPS), _limit()) if left is not None]
    return max(min(found), 0) if found else None


def require_memory(needed: float, what: str) -> None:
    """Refuse work that needs more memory than available.

    Parameters
    ----------
    needed : float
        Bytes.
    what : str
        What needs them, for the message.

    Raises
    ------
    MibvhError
    """
    left = available_memory()
    if left is not None and needed > left:
        raise MibvhError(
            f"{what} need about {needed / 1e9:,.1f} GB of memory, of which {left / 1e9:,.1f} GB "
            "are free"
        )


def require_references(count: float, what: str) -> None:
    """Refuse a tree with more references than int32 can index.

    Raises
    ------
    MibvhError
    """
    if count > MOST_REFERENCES:
        raise MibvhError(
            f"{what} may be {count:,.0f} references, more than the {MOST_REFERENCES:,} that the "
            "indices of a tree can tell apart"
        )


def reset_peak() -> None:
    """Reset :func:`peak_memory`, if the system supports that."""
    with contextlib.suppress(OSError):
        _CLEAR.write_text("5")


def peak_memory() -> int | None:
    """Return the peak memory in bytes since :func:`reset_peak`; None if unknown."""
    try:
        lines = _STATUS.read_text().splitlines()
    except OSError:
        return None
    return next((int(w.split()[1]) * 1024 for w in lines if w.startswith("VmHWM:")), None)


def used_memory() -> int:
    """Return the bytes that this process has in memory; 0 if unknown."""
    try:
        return int(_STATM.read_text().split()[1]) * _page_size()
    except (ImportError, OSError, ValueError):
        return 0


def _page_size() -> int:
    import resource

    return resource.getpagesize()


def _machine() -> int | None:
    try:
        lines = _MEMINFO.read_text().splitlines()
    except OSError:
        return None
    return next((int(w.split()[1]) * 1024 for w in lines if w.startswith("MemAvailable:")), None)


def _group(files: tuple[str, str]) -> int | None:
    try:
        most, used = (Path(file).read_text().strip() for file in files)
        return int(most) - int(used)
    except (OSError, ValueError):  # no such limit, or "max"
        return None


def _limit() -> int | None:
    try:
        import resource

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        pages = int(_STATM.read_text().split()[0])
    except (ImportError, OSError, ValueError):
        return None
    return None if most == resource.RLIM_INFINITY else most - pages * _page_size()
