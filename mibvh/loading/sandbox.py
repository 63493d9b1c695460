"""A scene loaded on trial in a process of its own: what crashes or hangs there, ends there.

Mitsuba's parsers and the libraries below them are compiled code: a hostile file can end the
process. This is a guard against crashes, endless work and a full memory; it is none against code
that a file would smuggle in, as the scene is loaded again here once the trial went well.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from mibvh.errors import MibvhError
from mibvh.loading import printable

#: Set to 1 to try every scene file so; ``mibvh --sandbox`` does it.
VARIABLE = "MIBVH_SANDBOX"
#: Seconds that a trial may take.
LIMIT = 600.0


def wanted() -> bool:
    """Whether scenes are to be tried first."""
    return os.environ.get(VARIABLE, "") not in ("", "0")


def try_to_load(source: str | os.PathLike[str], limit: float = LIMIT) -> None:
    """Load a scene in a process of its own, and forget it.

    Parameters
    ----------
    source : path
        What :func:`mibvh.load` takes.
    limit : float
        Seconds after which the process is ended.

    Raises
    ------
    MibvhError
        If it cannot be loaded, crashes, or takes too long.
    """
    name = printable(source)
    command = [sys.executable, "-m", "mibvh.loading.trial", os.fspath(source)]
    package = str(Path(__file__).resolve().parents[2])
    paths = [package, *filter(None, [os.environ.get("PYTHONPATH")])]
    around = {**os.environ, VARIABLE: "0", "PYTHONPATH": os.pathsep.join(paths)}
    try:
        ran = subprocess.run(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=around,
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise MibvhError(f"{name}: was not loaded within {limit:g} seconds") from None
    lines = ran.stderr.decode("utf-8", "replace").strip().splitlines()
    if ran.returncode == 2 and lines:
        raise MibvhError(lines[-1])
    if ran.returncode < 0:
        kind = signal.Signals(-ran.returncode).name
        raise MibvhError(f"{name}: the process that loaded it on trial was ended by {kind}")
    if ran.returncode:
        said = lines[-1] if lines else f"exit code {ran.returncode}"
        raise MibvhError(f"{name}: could not be loaded on trial ({said})")
