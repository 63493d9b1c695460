"""How fast the builders are, how good their trees, how much memory they take, how they scale.

    python benchmarks/builders.py [SCENE ...] [--builders a,b] [--repeats 5] [--yardstick]
                                  [-o TABLE.md]
    python benchmarks/builders.py --scaling SCENE SIZES [--plot FIGURE.png] [-o TABLE.md]

SCENE is whatever `mibvh build` takes, or an .npy file of (N, 3, 3) triangles; for --scaling the
name of a bundled scene, which is generated in each of the SIZES (10000,100000,...). Every scene
and builder gets a process of its own, so that its peak memory is known. Build times are of the
compiled code, medians over the repeats (none begins after the first minute): with one thread and
with all of them, or with all of them alone for --scaling. With --keep DIR every measurement is
kept, and those already there are taken over, so that a run that was killed goes on.

Seconds of a shared machine change from hour to hour. With --yardstick, every build takes turns
with one of Mitsuba's own scene over the same triangles, on as many threads (Embree 3, high
quality: eight-wide, with spatial splits), and the table has the ratio of the two medians.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

DEFAULT_SCENES = ["sculpture@70000", "city_italian@270000", "powerplant@1000000"]
#: Seconds after which a builder is not repeated.
_ENOUGH = 60.0

# ------------------------------------------------------------------ in processes of their own


def save_corners(scene: str, path: str) -> None:
    """Write the triangles of a scene to an .npy file."""
    import numpy as np

    import mibvh
    from mibvh.bundled import scenes_package

    name, _, size = scene.partition("@")
    package = scenes_package()
    if name in package.CATALOGUE and not Path(scene).exists():
        # Past Mitsuba, which would build its own tree over ten million triangles first.
        parts = package.generate(name, int(size) if size else None)
        corners = np.concatenate([vertices[faces] for vertices, faces in parts.values()])
    else:
        corners = mibvh.load(scene).triangles.corners
    np.save(path, corners)


def _peak() -> float:
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def embree_scene(corners: Any) -> Callable[[int], float]:
    """Return what builds Mitsuba's scene over triangles on so many threads, in seconds."""
    import drjit as dr
    import numpy as np

    from mibvh.variant import mitsuba

    mi = mitsuba()
    mesh = mi.Mesh("mesh", vertex_count=3 * len(corners), face_count=len(corners))
    values = mi.traverse(mesh)
    values["vertex_positions"] = mi.Float(np.ascontiguousarray(corners).reshape(-1))
    values["faces"] = mi.UInt32(np.arange(3 * len(corners), dtype=np.uint32))
    values.update()

    def build(threads: int) -> float:
        dr.set_thread_count(threads)
        started = time.perf_counter()
        mi.load_dict({"type": "scene", "mesh": mesh})
        return time.perf_counter() - started

    return build


def measure(
    path: str, name: str, repeats: int, threads: list[int], yardstick: bool
) -> dict[str, Any]:
    """Build the triangles of an .npy file with one builder."""
    import numpy as np

    import mibvh

    triangles = mibvh.Triangles(np.load(path, mmap_mode="r"))
    assert triangles.digest  # hashed once, before the clock runs
    mibvh.build(np.random.default_rng(0).random((64, 3, 3)), name)  # compiled, too
    empty = _peak()
    seconds, beside, embree = {}, {}, None
    facts: dict[str, Any] = {}
    for count in threads:
        os.environ["MIBVH_THREADS"] = str(count)
        times: list[float] = []
        peers: list[float] = []
        started = time.perf_counter()
        while len(times) < repeats and time.perf_counter() - started < _ENOUGH:
            tree = mibvh.build(triangles, name)
            times.append(tree.meta["build_seconds"])
            # Before Embree's, which takes memory, too.
            facts = facts or {"gigabytes": _peak(), **_facts(tree)}
            del tree  # or the next would be built beside it
            if yardstick:
                embree = embree or embree_scene(triangles.corners)
                peers.append(embree(count))
        seconds[str(count)] = float(np.median(times))
        if yardstick:
            beside[str(count)] = float(np.median(peers))
    return {
        "triangles": len(triangles),
        "seconds": seconds,
        "embree_seconds": beside,
        "gigabytes_before": empty,
        **facts,
    }


def _facts(tree: Any) -> dict[str, Any]:
    """Return what does not change from build to build."""
    import mibvh

    return {
        "sah": mibvh.sah(tree),
        "references": len(tree.references),
        "depth": tree.depth,
        "iterations": tree.meta["report"].get("iterations"),
    }


# ------------------------------------------------------------------ what starts them


def _child(*arguments: str) -> str:
    """Run this file in a process of its own; return what it printed."""
    ran = subprocess.run([sys.executable, __file__, *arguments], capture_output=True, text=True)
    if ran.returncode:
        said = ran.stderr.strip().splitlines() or [f"ended with exit code {ran.returncode}"]
        raise SystemExit(f"{' '.join(arguments)}: {said[-1]}")
    return ran.stdout


def measurements(
    scenes: list[str],
    builders: list[str],
    repeats: int,
    threads: list[int],
    yardstick: bool,
    keep: Path,
) -> list[dict[str, Any]]:
    """Measure every scene with every builder, but for what is kept already."""
    from mibvh.files import write_text

    keep.mkdir(parents=True, exist_ok=True)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for scene in scenes:
            label = Path(scene).name.removesuffix(".npy").removesuffix(".xml")
            if Path(scene).name == "scene.xml":
                label = Path(scene).resolve().parent.name
            corners = Path(scene) if scene.endswith(".npy") else Path(folder, f"{label}.npy")
            for name in builders:
                beside = "-embree" if yardstick else ""
                record = keep / f"{label}-{name}-{'-'.join(map(str, threads))}{beside}.json"
                if not record.exists():
                    if not corners.exists():
                        _child("--corners", scene, str(corners))
                    given = [str(corners), name, str(repeats), *map(str, threads)]
                    also = ["--yardstick"] if yardstick else []
                    figures = json.loads(_child("--measure", *given, *also))
                    about = {"scene": label, "builder": name, **_machine()}
                    write_text(record, json.dumps({**about, **figures}, indent=1) + "\n")
                found.append(json.loads(record.read_text(encoding="utf-8")))
                shown = {k: found[-1][k] for k in ("scene", "builder", "seconds", "gigabytes")}
                print(json.dumps(shown), file=sys.stderr, flush=True)
            if corners.parent == Path(folder):
                corners.unlink(missing_ok=True)
    return found


def _machine() -> dict[str, str]:
    from mibvh.environment import cpu_model
    from mibvh.version import __version__

    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {
        "mibvh": __version__,
        "machine": f"{cpu_model()}, {memory:.0f} GB",
        "date": datetime.date.today().isoformat(),
    }


def _heading(found: list[dict[str, Any]], repeats: int) -> list[str]:
    """Say which code, machine and days the figures are from."""
    versions = ", ".join(sorted({r["mibvh"] for r in found}))
    machines = " and ".join(sorted({r["machine"] for r in found}))
    days = sorted({r["date"] for r in found})
    when = days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"
    return [f"mibvh {versions}; {machines}; {when}; medians of up to {repeats}", ""]


def table(found: list[dict[str, Any]], repeats: int) -> list[str]:
    """Lay the measurements out as a table: on one thread and on all."""
    most = max(int(count) for r in found for count in r["seconds"])
    yardstick = any(r["embree_seconds"] for r in found)
    lines = [
        *_heading(found, repeats),
        f"| scene | triangles | builder | seconds, 1 thread | {most} threads | speed-up "
        "| M triangles/s, 1 thread | all | SAH | references | depth | peak GB |"
        + (f" of Embree's time, 1 thread | {most} threads |" if yardstick else ""),
        "|---|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|" + yardstick * "---:|---:|",
    ]
    for r in found:
        one, every = r["seconds"]["1"], r["seconds"][str(most)]
        lines.append(
            f"| {r['scene']} | {r['triangles']:,} | {r['builder']} | {one:.3f} | {every:.3f} "
            f"| {one / every:.2f} | {r['triangles'] / one / 1e6:.3g} "
            f"| {r['triangles'] / every / 1e6:.3g} | {r['sah']:.2f} "
            f"| {r['references'] / r['triangles']:.3f} | {r['depth']} | {r['gigabytes']:.2f} |"
        )
        if yardstick:
            shares = [r["seconds"][t] / r["embree_seconds"][t] for t in ("1", str(most))]
            lines[-1] += "".join(f" {share:.2f} |" for share in shares)
    return lines


def scaling_table(found: list[dict[str, Any]], repeats: int) -> list[str]:
    """Lay the measurements out as a table: one row for each builder and size."""
    lines = [
        *_heading(found, repeats),
        "| builder | triangles | seconds | M triangles/s | ns / (n log2 n) | SAH | depth "
        "| peak GB | bytes per triangle |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    import math

    for r in sorted(found, key=lambda r: (r["order"], r["triangles"])):
        n, seconds = r["triangles"], min(r["seconds"].values())
        grown = (r["gigabytes"] - r["gigabytes_before"]) * 2**30 / n
        lines.append(
            f"| {r['builder']} | {n:,} | {seconds:.3g} | {n / seconds / 1e6:.3g} "
            f"| {seconds / (n * math.log2(n)) * 1e9:.3g} | {r['sah']:.2f} | {r['depth']} "
            f"| {r['gigabytes']:.2f} | {grown:.0f} |"
        )
    return lines


def scaling_plot(found: list[dict[str, Any]], builders: list[str], path: Path) -> None:
    """Draw build time over triangles, both logarithmic, with n log n as a guide."""
    import matplotlib as mpl
    import numpy as np
    from matplotlib.figure import Figure

    from mibvh.plot.marks import STYLE, builder_colour

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.6), layout="constrained")
        axis = figure.subplots()
        for number, name in enumerate(builders):
            points = sorted(
                (r["triangles"], min(r["seconds"].values())) for r in found if r["builder"] == name
            )
            axis.plot(
                *zip(*points, strict=True),
                marker="o",
                markersize=3,
                color=builder_colour(number),
                label=name,
            )
        sizes = np.array(sorted({r["triangles"] for r in found}), np.float64)
        guide = sizes * np.log(sizes)
        first = min(s for r in found if r["triangles"] == sizes[0] for s in r["seconds"].values())
        axis.plot(sizes, 0.4 * first / guide[0] * guide, "--", color="#7F7F7F", label="n log n")
        axis.set(xscale="log", yscale="log", xlabel="triangles", ylabel="build time, seconds")
        axis.grid(alpha=0.25, which="major")
        # In the order in which the lines end on the right.
        lines = sorted(axis.lines, key=lambda line: -np.asarray(line.get_ydata())[-1])
        axis.legend(handles=lines, loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.savefig(path, format="png", dpi=160, facecolor="white")


def main() -> None:
    """Make the table, and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=DEFAULT_SCENES)
    parser.add_argument("--builders", default="", help="all of them by default")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--yardstick", action="store_true", help="beside Mitsuba's own scene")
    parser.add_argument("--scaling", nargs=2, metavar=("SCENE", "SIZES"))
    parser.add_argument("--plot", type=Path, help="where the figure of --scaling goes (PNG)")
    parser.add_argument("--keep", type=Path, help="folder of the measurements")
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--corners", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--measure", nargs="+", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.corners:
        save_corners(*arguments.corners)
        return
    if arguments.measure:
        path, name, repeats, *threads = arguments.measure
        counts = [int(count) for count in threads]
        print(json.dumps(measure(path, name, int(repeats), counts, arguments.yardstick)))
        return
    import numba

    from mibvh.builders import names

    builders = [name for name in arguments.builders.split(",") if name] or names()
    scenes, threads = arguments.scenes, sorted({1, numba.config.NUMBA_NUM_THREADS})
    if arguments.scaling:
        scene, sizes = arguments.scaling
        scenes, threads = [f"{scene}@{size}" for size in sizes.split(",")], threads[-1:]
    with tempfile.TemporaryDirectory() as folder:
        keep = arguments.keep or Path(folder)
        found = measurements(
            scenes, builders, arguments.repeats, threads, arguments.yardstick, keep
        )
    if arguments.scaling:
        for r in found:
            r["order"] = builders.index(r["builder"])
        lines = scaling_table(found, arguments.repeats)
        if arguments.plot:
            scaling_plot(found, builders, arguments.plot)
    else:
        lines = table(found, arguments.repeats)
    text = "\n".join(lines) + "\n"
    if arguments.output:
        arguments.output.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
