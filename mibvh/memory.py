"""How much memory there is: work that needs more is refused before it begins."""

from __future__ import annotations

from pathlib import Path

from mibvh.errors import MibvhError

_MEMINFO = Path("/proc/meminfo")
_STATM = Path("/proc/self/statm")
#: Limits of containers, of the second and the first kind: (most, in use).
_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def available_memory() -> int | None:
    """Bytes that this process may still ask for; None where the system does not tell.

    The least of what the machine has free, what the container leaves and what ``ulimit -v`` does.
    """
    found = [left for left in (_machine(), *map(_group, _GROUPS), _limit()) if left is not None]
    return max(min(found), 0) if found else None


def require_memory(needed: float, what: str) -> None:
    """Refuse work that memory is too small for.

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
    return None if most == resource.RLIM_INFINITY else most - pages * resource.getpagesize()
