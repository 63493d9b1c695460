"""One case: a study that is killed at a random moment, some twice, and begun again.

A case passes if the last run has the figures of one that nobody killed, and leaves no half a file.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import mibvh
from tools.fuzz.pieces import CHOICES, SCENE, known

PROGRAM = """
import json, sys, mibvh
scene, folder, choices = json.loads(sys.argv[1])
choices["builders"] = tuple(choices["builders"])
print("begun", flush=True)
mibvh.study([scene], folder, **choices)
print("done", flush=True)
"""


class Kills:
    """Studies in processes of their own."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="mibvh-fuzz-"))
        self.truth = known(mibvh.study([SCENE], self.folder / "whole", **CHOICES))
        started = time.monotonic()
        self._begin(self.folder / "timed", float("inf"))
        self.seconds = time.monotonic() - started

    def _begin(self, folder: Path, seconds: float) -> bool:
        """Study for so long; return whether it came to its end."""
        given = json.dumps([SCENE, str(folder), CHOICES])
        with subprocess.Popen(
            [sys.executable, "-c", PROGRAM, given],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            try:
                _, said = process.communicate(timeout=min(seconds, 600.0))
            except subprocess.TimeoutExpired:
                process.kill()
                return False
            if process.returncode:
                raise AssertionError(f"a study that is begun again fails: {said.splitlines()[-1]}")
        return True

    def run(self, seed: int) -> str:
        """Run a case; return what became of it."""
        rng = np.random.default_rng(seed)
        case = self.folder / "case"
        shutil.rmtree(case, ignore_errors=True)
        kills = 0
        for _ in range(int(rng.integers(1, 4))):
            kills += not self._begin(case, float(rng.uniform(0.1, 1.0) * self.seconds))
        found = known(mibvh.study([SCENE], case, **CHOICES))
        if found != self.truth:
            raise AssertionError(f"wrong numbers after {kills} kills")
        left = [path.name for path in case.rglob(".*")]
        if left:
            raise AssertionError(f"half a file is left: {left[0]}")
        return f"killed {kills} times"
