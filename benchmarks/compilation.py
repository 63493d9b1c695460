"""How long compilation takes: CPU time of the first call of each, from an empty cache.

python benchmarks/compilation.py [NAME ...]

Each NAME, a builder, ``epo`` or ``warp``, runs in a process of its own with a cache of its own; and
all of them in one, as a study does. CPU time depends less than wall time on what else the machine
does. "compiled" counts functions, Numba's own included.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from typing import Any

from numba.core import event


class Compilation(event.Listener):
    """CPU seconds spent in compiling, and how many functions were compiled."""

    def __init__(self) -> None:
        self.seconds, self.functions, self._begun = 0.0, 0, [0.0]

    def on_start(self, event: Any) -> None:
        """Note when an outermost compilation begins."""
        self._begun.append(time.process_time())

    def on_end(self, event: Any) -> None:
        """Add an outermost compilation; those within are part of it."""
        begun = self._begun.pop()
        self.functions += 1
        if len(self._begun) == 1:
            self.seconds += time.process_time() - begun


def first_calls(names: list[str]) -> tuple[float, float, int]:
    """CPU seconds of the process so far, those of them that compiled, and functions compiled."""
    import mibvh
    from mibvh.traversal.warp import simulate

    heard = Compilation()
    event.register("numba:compile", heard)
    scene = mibvh.load("cornell@2000")
    tree = None
    for name in names:
        if name not in ("epo", "warp"):
            tree = mibvh.build(scene.triangles, name)
            continue
        tree = tree or mibvh.build(scene.triangles, "lbvh")
        if name == "epo":
            mibvh.epo(tree, scene.triangles)
        else:
            rays = mibvh.diffuse_rays(scene, width=32, height=24)
            simulate(tree, scene.triangles, rays)
    return time.process_time(), heard.seconds, heard.functions


def in_new_process(names: list[str]) -> str:
    """Return the same as words, measured in a process with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        environ = os.environ | {"NUMBA_CACHE_DIR": folder}
        command = [sys.executable, __file__, "--child", *names]
        return subprocess.run(
            command, env=environ, stdout=subprocess.PIPE, text=True, check=True
        ).stdout.splitlines()[-1]


def main() -> None:
    """Measure every builder of the paper, EPO and the simulated warps."""
    from mibvh.builders import names

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", default=[*names(), "epo", "warp"])
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        total, compiling, functions = first_calls(arguments.names)
        print(f"{total:.1f} | {compiling:.1f} | {functions}")
        return
    print(
        "| first call | CPU, s | of which compiling, s | compiled |",
        "|---|---:|---:|---:|",
        sep="\n",
    )
    for name in arguments.names:
        print(f"| {name} | {in_new_process([name])} |", flush=True)
    if len(arguments.names) > 1:
        print(f"| all in one process | {in_new_process(arguments.names)} |", flush=True)


if __name__ == "__main__":
    main()
