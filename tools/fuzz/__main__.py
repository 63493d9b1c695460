"""Run cases from seeds, each part in a process of its own with a watchdog.

``FUZZ_SECONDS=60 python -m tools.fuzz [PART...]`` goes on as long as told, from ``FUZZ_SEED``
(0); ``FUZZ_CASES`` instead of seconds runs so many. It prints how many cases ended how, and names
the seeds of faults: a crash, a case that takes too long, an exception that is no sentence, a wrong
number. Exit code 1 if there are any.

A part is a class in :data:`PARTS`: made once per process, with ``run(seed)`` that returns what
became of the case, or raises.
"""

from __future__ import annotations

import argparse
import collections
import importlib
import os
import queue
import subprocess
import sys
import threading
import time
import traceback
from pathlib import Path

#: Name of a part, and the class that runs its cases.
PARTS = {
    "files": "tools.fuzz.files:Bench",
    "imports": "tools.fuzz.layouts:Imports",
    "meshes": "tools.fuzz.meshes:Meshes",
    "soups": "tools.fuzz.soups:Soups",
    "pieces": "tools.fuzz.pieces:Pieces",
    "kills": "tools.fuzz.kills:Kills",
}
#: A case that is not done after so many seconds hangs; the first one compiles.
PATIENCE, FIRST_PATIENCE = 30.0, 600.0
#: So do later cases of these parts, when they first meet a builder or a style of traversal; or they
#: are whole studies.
LONG = {"files": 300.0, "imports": 300.0, "soups": 300.0, "pieces": 300.0, "kills": 600.0}
#: Faults of one part after which it ends.
MOST_FAULTS = 20


def work(part: str, first: int) -> None:
    """In the child: run cases for ever, a line each: seed, outcome."""
    module, _, name = PARTS.get(part, part).partition(":")
    bench = getattr(importlib.import_module(module), name)()
    seed = first
    while True:
        try:
            outcome = bench.run(seed)
        except Exception:
            outcome = "FAULT " + " | ".join(traceback.format_exc().splitlines()[-3:])
        sys.stdout.write(f"case {seed} {outcome}\n")
        sys.stdout.flush()
        seed += 1


class Child:
    """A process that runs cases, and what it says."""

    def __init__(self, part: str, first: int) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tools.fuzz", "--work", part, str(first)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            cwd=Path(__file__).parents[2],
        )
        self.lines: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        self.errors: collections.deque[str] = collections.deque(maxlen=5)
        threading.Thread(target=self._read_errors, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            if line.startswith("case "):
                self.lines.put(line)
        self.lines.put(None)

    def _read_errors(self) -> None:
        assert self.process.stderr
        self.errors.extend(self.process.stderr)

    def end(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.wait()


def fuzz(part: str, first: int, seconds: float, cases: int) -> tuple[dict[str, int], list[str]]:
    """Run cases of a part; return how many ended how, and a line for each fault."""
    counts: collections.Counter[str] = collections.Counter()
    faults: list[str] = []
    seed, begun = first, time.monotonic()
    child, patience = Child(part, seed), FIRST_PATIENCE
    while len(faults) < MOST_FAULTS and seed < first + cases:
        if time.monotonic() - begun > seconds:
            break
        try:
            line = child.lines.get(timeout=patience)
        except queue.Empty:
            faults.append(f"{part} seed {seed}: takes longer than {patience:g} s")
        else:
            patience = LONG.get(part, PATIENCE)
            if line is not None:
                _, number, outcome = line.rstrip("\n").split(" ", 2)
                seed = int(number) + 1
                if outcome.startswith("FAULT"):
                    faults.append(f"{part} seed {number}: {outcome[6:]}")
                else:
                    counts[outcome] += 1
                continue
            child.process.wait()
            said = " ".join("".join(child.errors).split())
            faults.append(f"{part} seed {seed}: exit code {child.process.returncode} {said}")
        child.end()
        seed += 1
        child, patience = Child(part, seed), FIRST_PATIENCE
    child.end()
    return dict(counts), faults


def _parts(words: list[str]) -> list[str]:
    """Parts that a command asks for; ends it where there is no such part, or help is wanted."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.fuzz",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parts = parser.parse_args(words).parts
    # A module's path and a class, as in PARTS, is a part of one's own.
    unknown = [part for part in parts if part not in PARTS and ":" not in part]
    if unknown:
        parser.error(f"there is no part {unknown[0]!r}; there are: {', '.join(PARTS)}")
    return parts or list(PARTS)


def main() -> int:
    """Run the parts asked for, or all, in turn."""
    if sys.argv[1:2] == ["--work"]:
        work(sys.argv[2], int(sys.argv[3]))
    parts = _parts(sys.argv[1:])
    first = int(os.environ.get("FUZZ_SEED", "0"))
    most = os.environ.get("FUZZ_CASES")
    seconds = float("inf") if most else float(os.environ.get("FUZZ_SECONDS", "60")) / len(parts)
    failed = False
    for part in parts:
        counts, faults = fuzz(part, first, seconds, int(most) if most else sys.maxsize)
        sys.stdout.write(f"{part}: {sum(counts.values()) + len(faults)} cases from {first}\n")
        for outcome, count in sorted(counts.items()):
            sys.stdout.write(f"  {outcome:<24}{count:>8}\n")
        sys.stdout.write(f"  {'faults':<24}{len(faults):>8}\n")
        for fault in faults:
            sys.stdout.write(f"    {fault}\n")
        failed = failed or bool(faults)
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
