"""The process in which :mod:`mibvh.loading.sandbox` loads a scene on trial."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

from mibvh.errors import MibvhError
from mibvh.scene import load


def main(source: str) -> int:
    """Load a scene; where memory runs out, let this process be the one that is ended."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")
    try:
        load(source)
    except MibvhError as error:
        sys.stderr.buffer.write(f"{error}\n".encode("utf-8", "backslashreplace"))
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1]))
