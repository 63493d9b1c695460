"""bvh_path beside Mitsuba's own `path`: the same image, interleaved, time of a whole render.

    python benchmarks/path.py SCENE.xml... [--size 480x320] [--spp 16] [--builder sbvh] [--rounds 5]

Speed is as a share of `path`'s, the median over the rounds of the ratio, by the wall clock and by
the CPU time of the process. Building and compiling are done beforehand.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

#: Beside `path`.
STYLES = ("wide", "single")


def integrators(builder: str) -> dict[str, Any]:
    """`path` and `bvh_path` in each style, with the same longest path."""
    import mitsuba as mi

    own = {
        style: mi.load_dict(
            {"type": "bvh_path", "builder": builder, "style": style, "max_depth": 8}
        )
        for style in STYLES
    }
    return {"path": mi.load_dict({"type": "path", "max_depth": 8}), **own}


def seconds(render: Callable[[], Any]) -> tuple[float, float]:
    """Wall and CPU time of a render."""
    import drjit as dr

    wall, cpu = time.perf_counter(), time.process_time()
    dr.eval(render())
    dr.sync_thread()
    return time.perf_counter() - wall, time.process_time() - cpu


def measure(source: str, size: tuple[int, int], spp: int, builder: str, rounds: int) -> str:
    """Measure a scene; return a line of the table."""
    import mitsuba as mi

    scene = mi.load_file(source)
    camera = scene.sensors()[0]
    params = mi.traverse(camera)
    params["film.size"] = list(size)
    params.update()
    found = integrators(builder)
    renders = {
        name: functools.partial(one.render, scene, camera, seed=0, spp=spp)
        for name, one in found.items()
    }
    images = {name: np.array(render()) for name, render in renders.items()}
    times = np.array([[seconds(render) for render in renders.values()] for _ in range(rounds)])
    shares = np.median(times[:, :1] / times[:, 1:], axis=0)
    mean = float(images["path"].mean())
    styles = float(np.abs(images["wide"] - images["single"]).max()) / mean
    off = float(np.abs(images["wide"] - images["path"]).mean()) / mean
    cells = [f"{value:.2f}" for value in shares.ravel()]
    return f"| {source} | {' | '.join(cells)} | {styles:.1e} | {off:.1e} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", help="Mitsuba XML files")
    parser.add_argument("--size", default="480x320")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--builder", default="sbvh")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    import mibvh.mitsuba  # noqa: F401 - registers the integrators
    from mibvh.variant import mitsuba

    mitsuba()
    width, height = (int(n) for n in arguments.size.split("x"))
    heads = [f"{style}, {clock}" for style in STYLES for clock in ("wall", "CPU")]
    print(f"| scene | {' | '.join(heads)} | largest difference of styles | mean off `path` |")
    print("|---|" + "---:|" * (len(heads) + 2))
    for source in arguments.scenes:
        line = measure(source, (width, height), arguments.spp, arguments.builder, arguments.rounds)
        print(line, flush=True)


if __name__ == "__main__":
    main()
