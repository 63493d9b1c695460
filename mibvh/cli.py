"""The command line: each command is one public function.

Results go to standard output (with ``--json`` as one JSON object), progress and logs to
standard error; ``study --json`` writes its progress as JSON lines before the result. Exit code 0,
or 2 with one sentence for a user's mistake.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import itertools
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text
from typer.core import TyperGroup

from mibvh.errors import MibvhError, users_code
from mibvh.heartbeat import Heartbeat

#: Exit code of a command that Ctrl-C ended, as of any program that it ends.
INTERRUPTED = 130


class _Commands(TyperGroup):
    """The commands; Ctrl-C ends them with a sentence rather than "Aborted!"."""

    def invoke(self, ctx: Any) -> Any:
        _keep_inputs(ctx.args)
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            # What a study has finished is kept; others write their one file at the end.
            goes_on = ctx.invoked_subcommand == "study"
            said = "interrupted; the same command goes on" if goes_on else "interrupted"
            sys.stderr.write(f"mibvh: {said}\n")
            raise SystemExit(INTERRUPTED) from None


def _keep_inputs(arguments: list[str]) -> None:
    """Refuse to write to a file that is also read."""
    for option, output in itertools.pairwise(arguments):
        if option in ("-o", "--output") and os.path.isfile(output):
            named = [a for a in arguments if os.path.isfile(a) and os.path.samefile(a, output)]
            if len(named) > 1:
                raise MibvhError(f"{output} is what is read; name another file for the output")


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Measures and predicts how fast a bounding volume hierarchy really is.",
)
scenes_app = typer.Typer(no_args_is_help=True, help="The bundled scenes: list, make, show.")
app.add_typer(scenes_app, name="scenes")

SceneArgument = Annotated[
    str, typer.Argument(metavar="SCENE", help="Mitsuba XML, a mesh file, or a bundled scene's name")
]
TreeArgument = Annotated[Path, typer.Argument(metavar="TREE.npz")]
RaysArgument = Annotated[Path, typer.Argument(metavar="RAYS.npz")]
Define = Annotated[
    list[str] | None,
    typer.Option("-D", "--define", help="NAME=VALUE for $NAME in a Mitsuba XML file"),
]
LayoutOption = Annotated[
    str | None,
    typer.Option(
        help="mibvh, tinybvh, madmann91, npz, or of wide trees mbvh4, mbvh8; by default npz by its "
        "ending, else mibvh"
    ),
]
#: Exit code of a command whose audit failed.
AUDIT_FAILED = 3

Json = Annotated[bool, typer.Option("--json", help="print one JSON object")]


def _print(result: dict[str, Any], as_json: bool) -> None:
    """Print a result: one JSON object, or a table of two columns."""
    if as_json:
        typer.echo(json.dumps(result))
        return
    table = Table(show_header=False, box=None)
    for name, value in result.items():
        text = f"{value:.6g}" if isinstance(value, float) else str(value)
        table.add_row(name, Text(text))  # brackets are no markup
    Console().print(table)


@contextlib.contextmanager
def _progress() -> Iterator[Any]:
    """A progress bar on standard error; where that is no terminal, a line every few seconds."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    terminal = sys.stderr.isatty()
    bar = Progress(
        TextColumn("{task.description:<28}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not terminal,
        transient=True,
    )

    def say() -> None:
        for task in bar.tasks[-1:]:
            sys.stderr.write(f"mibvh: {task.description} ({task.percentage:.0f}%)\n")

    with bar, contextlib.nullcontext() if terminal else Heartbeat(say):
        yield bar


def _doing(what: str) -> Heartbeat:
    """Say every few seconds what a command without progress is doing."""
    return Heartbeat(lambda: typer.echo(f"mibvh: {what} ...", err=True))


def _show(bar: Any, task: Any, what: str = "") -> Callable[[str, float], None]:
    """Show stages on a bar. Each stage has its own estimate of time left."""

    def show(stage: str, done: float) -> None:
        words = f"{what}: {stage}" if what else stage
        if bar.tasks[task].description != words:
            bar.reset(task, description=words)
        bar.update(task, completed=done)

    return show


def _load(source: str, define: list[str] | None = None) -> Any:
    """Load a scene, and say on standard error what could not be read as it is."""
    from mibvh import load

    with _doing(f"loading {source}"):
        scene = load(source, _parse_pairs(define or [], "-D"))
    for note in scene.notes:
        typer.echo(f"mibvh: {scene.name}: {note}", err=True)
    return scene


def _parse_pairs(pairs: list[str], option: str = "--option") -> dict[str, str]:
    """Split ``name=value`` pairs."""
    parsed = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise MibvhError(f"{option} takes NAME=VALUE, not {pair!r}")
        if name in parsed:
            raise MibvhError(f"{option} is given {name!r} twice")
        parsed[name] = value
    return parsed


def _parse_options(pairs: list[str]) -> dict[str, Any]:
    """Split ``name=value`` pairs; values as JSON where they are, otherwise as text."""
    options: dict[str, Any] = {}
    for name, value in _parse_pairs(pairs).items():
        try:
            options[name] = json.loads(value)
        except ValueError:
            options[name] = value
    return options


def _load_plugin(path: Path) -> None:
    """Run a Python file that registers builders."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.exists():
        raise MibvhError(f"--plugin {path}: there is no such Python file")
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)  # its neighbours; last, so that they hide nothing
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    try:
        with users_code("--plugin ", str(path)):
            spec.loader.exec_module(module)
    except MibvhError:
        del sys.modules[path.stem]
        raise


def _version(asked: bool) -> None:
    if asked:
        from mibvh import __version__

        typer.echo(f"mibvh {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    plugin: Annotated[
        list[Path] | None,
        typer.Option("--plugin", help="Python file that registers builders of your own"),
    ] = None,
    sandbox: Annotated[
        bool,
        typer.Option("--sandbox", help="try to load each scene in a separate process first"),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="show the traceback of an error")] = False,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="print the version"),
    ] = False,
) -> None:
    # In the environment, so that it holds for worker processes too.
    if sandbox:
        os.environ["MIBVH_SANDBOX"] = "1"
    if debug:
        os.environ["MIBVH_DEBUG"] = "1"
    for path in plugin or []:
        _load_plugin(path)


@app.command("build")
def build_command(
    scene: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the tree file to write")],
    builder: Annotated[str, typer.Option(help="a name from `mibvh builders`")] = "bbvh",
    option: Annotated[list[str] | None, typer.Option(help="NAME=VALUE, an option of it")] = None,
    width: Annotated[int, typer.Option(help="children per node: 4 or 8 for a wide tree")] = 2,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Build a tree over a scene and save it."""
    from mibvh import Tree, WideTree, build, build_wide, sah

    options = _parse_options(option or [])
    loaded = _load(scene, define)  # whole: `finite` asks it for rays
    tree: Tree | WideTree
    with _progress() as bar:
        task = bar.add_task(f"build {builder}", total=1.0)
        show = _show(bar, task, builder)
        if width == 2:
            tree = build(loaded, builder, progress=show, **options)
        else:
            tree = build_wide(loaded, builder, width, progress=show, **options)
    tree.save(output)
    stats = tree.stats()
    result = {
        "builder": builder,
        **{k: stats[k] for k in ("triangles", "references", "nodes", "leaves", "depth")},
        "sah": sah(tree),
        "build_seconds": tree.meta["build_seconds"],
        "report": tree.meta["report"],
    }
    _print(result, as_json)


@app.command("optimize")
def optimize_command(
    scene: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the tree file to write")],
    option: Annotated[
        list[str] | None, typer.Option(help="NAME=VALUE, an option of the builder `finite`")
    ] = None,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Build the best tree for a scene and its cameras, and say what it saves."""
    from mibvh import optimize

    options = _parse_options(option or [])
    loaded = _load(scene, define)
    with _progress() as bar:
        task = bar.add_task("optimize", total=1.0)
        optimized = optimize(loaded, progress=_show(bar, task), **options)
    optimized.tree.save(output)
    if as_json:
        result = {
            "builder": optimized.tree.meta["builder"],
            "costs": optimized.costs,
            "rays": optimized.rays,
        }
        _print({**result, "report": optimized.tree.meta["report"]}, True)
        return
    typer.echo(f"{output}: {optimized.sentence()}")


@app.command("collapse")
def collapse_command(
    tree: TreeArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the wide tree file to write")],
    width: Annotated[int, typer.Option(help="children of a node, at most: 2, 4 or 8")] = 8,
    method: Annotated[
        str, typer.Option(help="optimal (the least SAH), or greedy (the largest child first)")
    ] = "optimal",
    max_leaf: Annotated[
        int | None, typer.Option(help="make larger leaves where they are cheaper, up to this")
    ] = None,
    quantise: Annotated[bool, typer.Option("--quantise", help="boxes of 8 bits")] = False,
    as_json: Json = False,
) -> None:
    """Collapse a tree to nodes of more children: `metrics`, `audit` and `trace` take it, too."""
    from mibvh import Tree, collapse, quantised, sah

    wide = collapse(Tree.load(tree), width, method=method, max_leaf=max_leaf)  # type: ignore[arg-type]
    wide = quantised(wide) if quantise else wide
    wide.save(output)
    _print({"builder": wide.meta.get("builder"), "sah": sah(wide), **wide.stats()}, as_json)


@app.command()
def metrics(
    scene: SceneArgument, tree: TreeArgument, define: Define = None, as_json: Json = False
) -> None:
    """SAH, EPO and statistics of a tree."""
    from mibvh import epo, read_tree, sah

    triangles = _load(scene, define).triangles
    loaded = read_tree(tree, "npz")
    with _progress() as bar:
        task = bar.add_task("EPO", total=1.0)
        overlap = epo(loaded, triangles, progress=lambda done: bar.update(task, completed=done))
    builder = loaded.meta.get("builder")
    _print({"builder": builder, "sah": sah(loaded), "epo": overlap, **loaded.stats()}, as_json)


@app.command("import")
def import_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="a tree of another program")],
    output: Annotated[Path, typer.Option("-o", "--output", help="the tree file to write")],
    layout: LayoutOption = None,
    scene: Annotated[
        str | None, typer.Option(help="what it was built for; checks the tree against it")
    ] = None,
    name: Annotated[str, typer.Option(help="name of the tree; the file's by default")] = "",
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Import a tree of another program; no box, leaf or reference changes."""
    from mibvh import read_tree, sah

    tree = read_tree(file, layout, name)
    if scene is not None:
        triangles = _load(scene, define).triangles
        tree.check_matches(triangles)
        tree = tree.replace(meta={**tree.meta, "digest": triangles.digest})
    tree.save(output)
    if (unused := tree.meta.get("unused_nodes", 0)) > len(tree):
        sys.stderr.write(
            f"note: {unused:,} of the {unused + len(tree):,} nodes in {file} are not "
            "reached from its root; does the SAH agree with yours?\n"
        )
    _print({"builder": tree.meta.get("builder"), "sah": sah(tree), **tree.stats()}, as_json)


@app.command("compare")
def compare_command(
    scene: SceneArgument,
    first: Annotated[str, typer.Argument(metavar="A", help="a tree's file, or a builder")],
    second: Annotated[str, typer.Argument(metavar="B", help="as A")],
    rays: Annotated[Path | None, typer.Option(help="ray file; diffuse rays by default")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PNG of the difference over the scene")
    ] = None,
    sensor: Annotated[int, typer.Option(help="which of the scene's cameras the PNG shows")] = 0,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Compare two trees: figures, where their costs differ, and which rays cost more."""
    from mibvh import read_rays
    from mibvh.comparison import compare, difference_figure
    from mibvh.files import atomic_path

    if output is not None and (output.suffix.lower() != ".png" or not output.parent.is_dir()):
        raise MibvhError(f"{output}: the picture is a .png file in a folder that is there")
    asked = read_rays(rays) if rays else None
    loaded = _load(scene, define)
    compared = compare(loaded, first, second, rays=asked)
    if output is not None:
        figure = difference_figure(loaded, compared, sensor)
        with atomic_path(output) as path:
            figure.savefig(path, format="png", dpi=120, facecolor="white")
    if as_json:
        typer.echo(json.dumps(compared.to_json()))
    else:
        _print_comparison(compared)


def _print_comparison(compared: Any) -> None:
    console = Console()
    table = Table("", *(escape(name) for name in compared.names), "B over A", box=None)
    for name, (a, b) in compared.figures.items():
        table.add_row(name, f"{a:.6g}", f"{b:.6g}", f"{b / a:.3f}" if a else "–")
    console.print(table)
    table = Table("depth", "SAH: A", "B", "EPO: A", "B", box=None)
    for level in compared.by_depth:
        table.add_row(str(level.depth), *(f"{v:.3g}" for v in (*level.sah, *level.epo)))
    console.print(table)
    table = Table("of the rays", "cost in B less cost in A", box=None)
    for share, value in compared.quantiles.items():
        table.add_row(f"{share:.0%}", f"{value:+.4g}")
    console.print(table)
    shares = compared.shares
    console.print(
        f"{shares['cheaper']:.1%} of the rays are cheaper in B, {shares['dearer']:.1%} dearer, "
        f"{shares['same']:.1%} cost the same"
    )
    table = Table("bounce", "viewpoint", "rays", "cost in A", "in B", box=None)
    for one in compared.by_origin:
        costs = (f"{value:.4g}" for value in one.cost)
        table.add_row(str(one.bounce), str(one.viewpoint), f"{one.rays:,}", *costs)
    console.print(table)


@app.command("export")
def export_command(
    tree: TreeArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the file to write")],
    layout: LayoutOption = None,
) -> None:
    """Write a tree for another program."""
    from mibvh import read_tree, write_tree

    write_tree(read_tree(tree, "npz"), output, layout)


@app.command("triangles")
def triangles_command(
    scene: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the file to write")],
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Write a scene's triangles for another program: nine little-endian float32 each, by id."""
    from mibvh.files import atomic_path

    triangles = _load(scene, define).triangles
    with atomic_path(output) as path:
        path.write_bytes(triangles.corners.astype("<f4").tobytes())
    _print({"triangles": len(triangles), "digest": triangles.digest}, as_json)


@app.command("audit")
def audit_command(
    scene: SceneArgument,
    tree: TreeArgument,
    rays: Annotated[
        Path | None, typer.Argument(metavar="[RAYS.npz]", help="diffuse rays by default")
    ] = None,
    seed: Annotated[int, typer.Option(help="seed of points and samples")] = 0,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Check a tree and its numbers by independent code; exit code 3 if a check fails."""
    from mibvh import read_rays, read_tree
    from mibvh.audit import audit

    loaded = _load(scene, define)
    with _progress() as bar:
        task = bar.add_task("audit", total=1.0)
        audited = audit(
            loaded,
            read_tree(tree, "npz"),
            read_rays(rays) if rays else None,
            seed=seed,
            progress=_show(bar, task),
        )
    if as_json:
        typer.echo(json.dumps({**dataclasses.asdict(audited), "passed": audited.passed}))
    else:
        _print_audit(audited)
    if not audited.passed:
        raise typer.Exit(AUDIT_FAILED)


def _print_audit(audited: Any) -> None:
    """Print the checks as a table, failures in red."""
    table = Table(box=None)
    for heading in ("check", "", "value", "expected", "within", "compared"):
        table.add_column(heading)
    for check in audited.checks:
        table.add_row(
            check.name,
            "passed" if check.passed else "FAILED",
            f"{check.value:.6g}",
            f"{check.expected:.6g}",
            f"{check.tolerance:.3g}",
            check.detail,
            style=None if check.passed else "red",
        )
    Console().print(table)


@app.command()
def rays(
    scene: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the ray file to write")],
    viewpoints: Annotated[int | None, typer.Option(help="how many cameras; all by default")] = None,
    width: Annotated[int, typer.Option(help="pixels per viewpoint")] = 320,
    height: Annotated[int, typer.Option(help="pixels per viewpoint")] = 240,
    samples: Annotated[int, typer.Option(help="paths per pixel")] = 4,
    bounces: Annotated[int, typer.Option(help="diffuse rays per path, at most")] = 1,
    seed: Annotated[int, typer.Option(help="seed of the random numbers")] = 0,
    kind: Annotated[
        str, typer.Option(help="diffuse, primary, shadow, ao, or bounce2, shadow2, ...")
    ] = "diffuse",
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Path-trace diffuse rays, or others from the same paths, with Mitsuba and save them."""
    from mibvh import diffuse_rays, make_rays

    if kind != "diffuse" and bounces != 1:
        raise MibvhError("--bounces is for diffuse rays; name a later vertex as in shadow2")
    loaded = _load(scene, define)
    how: dict[str, Any] = {
        "viewpoints": viewpoints,
        "width": width,
        "height": height,
        "samples": samples,
        "seed": seed,
    }
    with _progress() as bar:
        task = bar.add_task("rays", total=1.0)
        how["progress"] = lambda done: bar.update(task, completed=done)
        if kind == "diffuse":
            made = diffuse_rays(loaded, bounces=bounces, **how)
        else:
            made = make_rays(loaded, kind, **how)
    made.save(output)
    per_bounce = {int(b): int((made.bounce == b).sum()) for b in sorted(set(made.bounce))}
    _print({"rays": len(made), **made.meta, "rays_per_bounce": per_bounce}, as_json)


@app.command()
def trace(
    scene: SceneArgument,
    tree: TreeArgument,
    rays: RaysArgument,
    lanes: Annotated[str, typer.Option(help="simd or scalar")] = "simd",
    style: Annotated[
        str | None,
        typer.Option(
            help="single (as the study; the default), while-while, speculative, or wide: the "
            "fastest, and the only one of wide trees"
        ),
    ] = None,
    cull: Annotated[bool, typer.Option(help="re-test popped nodes against the hit")] = False,
    any_hit: Annotated[bool, typer.Option(help="end at the first hit found")] = False,
    child_order: Annotated[
        str | None,
        typer.Option(
            help="of any-hit rays in the wide style, instead of near first: larger, blocking "
            "(most likely to block), or worth (that over the cost of looking)"
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(help="timed launches")] = 5,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="hits to write")] = None,
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Trace rays through a tree: hits, exact counters, kernel time."""
    from mibvh import read_rays, read_tree
    from mibvh.traversal.trace import trace as run

    triangles = _load(scene, define).triangles
    with _doing("tracing"):
        hits = run(
            read_tree(tree, "npz"),
            triangles,
            read_rays(rays),
            lanes,  # type: ignore[arg-type]
            style=style,
            cull=cull,
            any_hit=any_hit or None,
            child_order=child_order,  # type: ignore[arg-type]
            repeats=repeats,
        )
    if output:
        hits.save(output)
    _print(hits.summary(), as_json)


@app.command()
def render(
    scene: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the EXR or PNG to write")],
    integrator: Annotated[
        str | None,
        typer.Option(
            help="bvh_path, bvh_cost, bvh_rays, or any of Mitsuba's; by default the scene's own "
            "if it is one of the first three, else bvh_path"
        ),
    ] = None,
    builder: Annotated[
        str | None, typer.Option(help="the tree's; sbvh by default (bvh_path, bvh_cost)")
    ] = None,
    compare: Annotated[str | None, typer.Option(help="builder of a second tree (bvh_cost)")] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(help="NAME=VALUE, an option of the integrator or builder"),
    ] = None,
    define: Define = None,
    spp: Annotated[
        int | None, typer.Option(help="samples per pixel; the scene's by default")
    ] = None,
    size: Annotated[str | None, typer.Option(help="WxH in pixels; the scene's by default")] = None,
    sensor: Annotated[int, typer.Option(help="which of the scene's cameras")] = 0,
    seed: Annotated[int, typer.Option(help="seed of the image")] = 0,
    quantity: Annotated[
        list[str] | None, typer.Option(help="what a PNG of bvh_cost shows; may be repeated")
    ] = None,
    as_json: Json = False,
) -> None:
    """Render a scene through a tree, or heat maps of what rays cost in it."""
    from mibvh.mitsuba.render import render as run

    parameters = _parse_options(option or [])
    parameters |= {k: v for k, v in (("builder", builder), ("compare", compare)) if v is not None}
    pixels = None
    if size is not None:
        width, _, height = size.partition("x")
        if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
            raise MibvhError(f"--size takes WIDTHxHEIGHT, such as 640x480, not {size!r}")
        pixels = (int(width), int(height))
    with _progress() as bar:
        task = bar.add_task("scene", total=1.0)
        facts, notes = run(
            scene,
            output,
            integrator,
            parameters=parameters,
            size=pixels,
            spp=spp,
            sensor=sensor,
            defines=_parse_pairs(define or [], "-D"),
            seed=seed,
            quantities=quantity or (),
            progress=_show(bar, task),
        )
    for note in notes:
        typer.echo(f"mibvh: {scene}: {note}", err=True)
    means = facts.pop("means") if not as_json else {}
    _print({**facts, **{f"mean {name}": value for name, value in means.items()}}, as_json)


@app.command()
def study(
    scenes: Annotated[
        list[str], typer.Argument(metavar="SCENE...", help="as for build, or folders of scenes")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder of the results")],
    builders: Annotated[
        str | None,
        typer.Option(
            help='names, comma-separated; all of the paper\'s by default; "" for the given trees '
            "alone. With options: bittner(start=sbvh), or sbvh(bins=8..128:8) for a tree with "
            "each value"
        ),
    ] = None,
    tree: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FILE[,FILE...]",
            help="a finished tree, kept as it is; one file per scene; may be repeated",
        ),
    ] = None,
    rays: Annotated[
        str | None,
        typer.Option(
            metavar="FILE[,FILE...]",
            help="rays of your own, one file per scene; or kinds of rays to study beside the "
            "diffuse ones: diffuse, shadow, ao, primary, bounce2, ..., with weights as shadow:2",
        ),
    ] = None,
    width: Annotated[
        str, typer.Option(metavar="2,4,8", help="also collapse the trees to so many children")
    ] = "",
    profile: Annotated[str, typer.Option(help="quick or paper")] = "quick",
    experiments: Annotated[
        str, typer.Option(help="names from `mibvh experiments`, comma-separated; or all")
    ] = "",
    seconds: Annotated[float | None, typer.Option(help="stopwatch budget per lane mode")] = None,
    samples: Annotated[
        int | None, typer.Option(help="paths per pixel; the profile's by default")
    ] = None,
    seed: Annotated[int, typer.Option(help="seed of the rays")] = 0,
    warp_width: Annotated[int, typer.Option(help="lanes of the simulated warps")] = 32,
    warp_style: Annotated[
        str, typer.Option(help="their kernel: persistent (the paper's), speculative, single, ...")
    ] = "persistent",
    styles: Annotated[
        str,
        typer.Option(
            help="kernels to time and to simulate, comma-separated: single, while-while, "
            "speculative, wide"
        ),
    ] = "single",
    variant: Annotated[
        str | None,
        typer.Option(help="of Mitsuba: llvm_ad_rgb (the default), cuda_ad_rgb, ..."),
    ] = None,
    define: Define = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="a Dask cluster that studies the scenes")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="print JSON lines: progress, then the result")
    ] = False,
) -> None:
    """Build, measure, predict and report, for scenes and builders."""
    from mibvh import StudyOptions
    from mibvh import study as run
    from mibvh.builders.chosen import split
    from mibvh.scene import with_defines
    from mibvh.studies import PROFILES
    from mibvh.studies.paper.catalogue import scenes_in
    from mibvh.studies.record.options import kinds_or_files
    from mibvh.studies.report.board import Board
    from mibvh.variant import use_variant

    if variant is not None:
        if scheduler is not None:
            raise MibvhError("--variant is for this machine: set MIBVH_VARIANT for the workers")
        use_variant(variant)
    if profile not in PROFILES:
        raise MibvhError(f"--profile is one of {', '.join(PROFILES)}, not {profile!r}")
    warps = {"warp_width": warp_width, "warp_style": warp_style, "styles": split(styles)}
    choices = {**PROFILES[profile], **warps, "seed": seed}
    choices |= {
        name: value
        for name, value in (("seconds", seconds), ("samples", samples))
        if value is not None
    }
    if experiments:
        choices["experiments"] = split(experiments)
    defines = _parse_pairs(define or [], "-D")
    sources = [with_defines(str(part), defines) for source in scenes for part in scenes_in(source)]
    kinds, files = kinds_or_files(rays or "")
    options = StudyOptions(
        builders=None if builders is None else split(builders),
        widths=width,  # type: ignore[arg-type]
        kinds=kinds,
        **choices,
    )
    given = {name: files.split(",") for name, files in _parse_pairs(tree or [], "--tree").items()}
    with Board(len(sources), as_json) as board:
        result = run(
            sources,
            output,
            trees=given,
            rays=files or None,
            options=options,
            progress=board,
            scheduler=scheduler,
        )
    if as_json:
        rows = json.loads(result.table.to_json(orient="records"))
        r = json.loads(result.correlations.to_json(orient="records"))
        failed = [
            {"scene": scene, "tree": tree, **dataclasses.asdict(check)}
            for scene, tree, check in result.failures
        ]
        last = {
            "event": "result",
            "report": str(result.report),
            "trees": rows,
            "correlations": r,
            "audit_failures": failed,
            "left_out": result.left_out,
        }
        typer.echo(json.dumps(last))
    else:
        _print_study(result)
    for name, why in result.left_out.items():
        typer.echo(f"mibvh: {name} was left out: {why}", err=True)
    if result.failures:
        raise typer.Exit(AUDIT_FAILED)
    if result.left_out:
        raise typer.Exit(2)


def _print_study(result: Any) -> None:
    """Print the findings: ten lines, as all tables are in the report."""
    from mibvh.studies.report.answer import answer

    # A pipe has no width; 80 columns would cut the lines.
    console = Console(width=None if sys.stdout.isatty() else 160)
    for line in answer(result.scenes, result.correlations):
        console.print(Text(line))
    for scene, tree, check in result.failures:
        console.print(
            Text(
                f"audit FAILED: {scene}, {tree}: {check.name} is {check.value:.6g}, expected "
                f"{check.expected:.6g} within {check.tolerance:.3g} ({check.detail})",
                style="red",
            )
        )
    console.print(f"\nreport: {result.report}", soft_wrap=True)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="folder of a study")],
    figures: Annotated[
        str, typer.Option(help="what to draw figures as beside SVG: pdf, png or both")
    ] = "",
    as_json: Json = False,
) -> None:
    """Remake a study's tables and report without measuring again."""
    from mibvh.studies.run import remake_report

    with _doing("writing the report"):
        remade = remake_report(folder, [kind for kind in figures.split(",") if kind])
    _print({"report": str(remade.report), "scenes": len(remade.scenes)}, as_json)


@app.command()
def builders(as_json: Json = False) -> None:
    """List the builders, their sources and options."""
    from mibvh.builders import all_names, get

    described = [get(name).describe() for name in all_names()]
    if as_json:
        typer.echo(json.dumps({"builders": described}))
        return
    table = Table("builder", "what it does", "source", "options (default)", box=None)
    for entry in described:
        own = [f"{k} ({v['default']})" for k, v in entry["options"].items()]
        table.add_row(entry["name"], entry["summary"], entry["source"], ", ".join(own))
    Console().print(table)


@app.command()
def experiments(as_json: Json = False) -> None:
    """List the experiments of a study, and what each adds."""
    from mibvh.studies import EXPERIMENTS

    if as_json:
        listed = [{"name": name, "summary": summary} for name, summary in EXPERIMENTS.items()]
        typer.echo(json.dumps({"experiments": listed}))
        return
    _print(EXPERIMENTS, False)


@app.command()
def predictors(as_json: Json = False) -> None:
    """List the predictors of cost, their formulas and free parameters."""
    from mibvh.metrics.predictors import predictors as known

    if as_json:
        listed = [{"name": p.name, "formula": p.formula, "free": p.free} for p in known()]
        typer.echo(json.dumps({"predictors": listed}))
        return
    table = Table("predictor", "formula", "free parameters", box=None)
    for one in known():
        table.add_row(one.name, one.formula, one.free)
    Console().print(table)


@app.command()
def notebooks(
    output: Annotated[Path, typer.Option("-o", "--output", help="folder to copy them into")],
    as_json: Json = False,
) -> None:
    """Copy mibvh's notebooks into a folder to run them."""
    from mibvh.bundled import copy_notebooks

    copied = [str(path) for path in copy_notebooks(output)]
    if as_json:
        typer.echo(json.dumps({"notebooks": copied}))
        return
    typer.echo("\n".join(copied))


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say what this machine has and what to install."""
    from mibvh.environment import doctor as look

    state = look()
    if as_json:
        typer.echo(json.dumps(state))
    else:
        environment = state.pop("environment", {})
        _print(
            {**state, "advice": "; ".join(state["advice"]) or "none needed", **environment}, False
        )
    if not state["ready"]:
        raise typer.Exit(2)


@scenes_app.command("list")
def scenes_list(as_json: Json = False) -> None:
    """List the bundled scenes."""
    from mibvh.bundled import scenes_package

    catalogue = scenes_package().CATALOGUE.values()
    if as_json:
        import dataclasses

        typer.echo(json.dumps({"scenes": [dataclasses.asdict(info) for info in catalogue]}))
        return
    table = Table("scene", "kind", "triangles", "what it shows", box=None)
    for info in catalogue:
        table.add_row(info.name, info.kind, f"{info.triangles:,}", info.title)
    Console().print(table)


@scenes_app.command("paper")
def scenes_paper(as_json: Json = False) -> None:
    """List the paper's scenes: where to get each, and its published figures."""
    import dataclasses

    from mibvh.studies.paper.published import published

    known = published().known_scenes
    if as_json:
        typer.echo(json.dumps({"scenes": [dataclasses.asdict(scene) for scene in known]}))
        return
    table = Table("scene", "triangles", "r SAH", "r SAH+EPO", "alpha", "where", box=None)
    for scene in known:
        figures = (scene.r_sah, scene.r_sah_epo, scene.alpha)
        table.add_row(
            scene.name,
            f"{scene.triangles:,}" if scene.triangles else "",
            *("" if f is None else f"{f:g}" for f in figures),
            scene.where or "",
        )
    Console().print(table)
    typer.echo(
        f"\nThe slides name {len(known)} of the {published().scenes} scenes; what is not known is "
        "left out.\nTriangles are those of the available file; the paper's own may differ."
    )


@scenes_app.command("make")
def scenes_make(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME...]", help="all by default")
    ] = None,
    triangles: Annotated[int | None, typer.Option(help="size; each scene's own by default")] = None,
    seed: Annotated[int | None, typer.Option(help="each scene's own by default")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="folder; mibvh's cache by default")
    ] = None,
    as_json: Json = False,
) -> None:
    """Generate bundled scenes: XML and meshes."""
    from mibvh.bundled import bundled_scene, make_scene, scenes_package

    made = {}
    for name in names or list(scenes_package().CATALOGUE):
        with _doing(f"making {name}"):
            if output is None:
                made[name] = str(bundled_scene(name, triangles, seed))
            else:
                made[name] = str(make_scene(name, output / name, triangles, seed))
        if not as_json:
            typer.echo(made[name])
    if as_json:
        typer.echo(json.dumps({"scenes": made}))


@scenes_app.command("show")
def scenes_show(
    name: SceneArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="the PNG to write")],
    define: Define = None,
    as_json: Json = False,
) -> None:
    """Render a scene's first viewpoint to a PNG."""
    from mibvh.files import atomic_path
    from mibvh.picture import picture, png

    scene = _load(name, define)
    with _doing("rendering"), atomic_path(output) as path:
        path.write_bytes(png(picture(scene)))
    _print(
        {"scene": scene.name, "triangles": len(scene.triangles), "picture": str(output)}, as_json
    )


def _keep_stdout_for_results() -> None:
    """Send what Mitsuba's log writes to standard output to standard error instead.

    The log writes to the file descriptor; results go where it pointed before.
    """
    sys.stdout.flush()
    results = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = os.fdopen(results, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)


def entry() -> None:
    """Entry point of the ``mibvh`` command, in a process of its own."""
    _keep_stdout_for_results()
    main()


def main() -> None:
    """Run the command line."""
    try:
        app(prog_name="mibvh")
    except MibvhError as error:
        if os.environ.get("MIBVH_DEBUG"):
            traceback.print_exception(error)
        sys.stderr.write(f"mibvh: {error}\n")
        raise SystemExit(2) from None
    except OSError as error:
        if os.environ.get("MIBVH_DEBUG"):
            traceback.print_exception(error)
        _say_refused(error)
        raise SystemExit(2) from None


def _say_refused(error: OSError) -> None:
    """Say what the system refused: without a name, that is standard output."""
    said = f"{error.filename}:" if error.filename else "standard output: cannot be written"
    with contextlib.suppress(OSError):  # standard error may be full too
        sys.stderr.write(f"mibvh: {said} ({error.strerror or error})\n")
    with contextlib.suppress(OSError, ValueError):  # Python would try it again, and complain
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    entry()
