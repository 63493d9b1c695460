"""The commands by name, and the options that precede them."""

from __future__ import annotations

import importlib.util
import itertools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from mibvh.cli import listings, measure, scenes, trees
from mibvh.cli.compare import compare
from mibvh.cli.exits import INTERRUPTED
from mibvh.cli.progress import signs_of_life
from mibvh.cli.render import render
from mibvh.cli.study import report, study
from mibvh.errors import MibvhError, users_code

#: The commands, in the order in which the help lists them.
COMMANDS: dict[str, Callable[..., None]] = {
    "build": trees.build,
    "optimize": trees.optimize,
    "collapse": trees.collapse,
    "metrics": measure.metrics,
    "import": trees.import_tree,
    "compare": compare,
    "export": trees.export_tree,
    "triangles": trees.export_triangles,
    "audit": measure.audit,
    "rays": measure.rays,
    "trace": measure.trace,
    "render": render,
    "study": study,
    "report": report,
    "builders": listings.builders,
    "experiments": listings.experiments,
    "predictors": listings.predictors,
    "notebooks": listings.notebooks,
    "doctor": listings.doctor,
}


class _Commands(TyperGroup):
    """The commands; Ctrl-C ends them with a sentence rather than "Aborted!"."""

    def invoke(self, ctx: Any) -> Any:
        _keep_inputs(ctx.args)
        try:
            with signs_of_life():
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


def _print_version(asked: bool) -> None:
    if asked:
        from mibvh import __version__

        typer.echo(f"mibvh {__version__}")
        raise typer.Exit


def _load_plugin(path: Path) -> None:
    """Run a Python file that registers builders, metrics, predictors or experiments."""
    # It may be called random.py: others that import random get the module they mean.
    taken = path.stem in sys.modules or path.stem in sys.stdlib_module_names
    name = f"mibvh_plugin_{path.stem}" if taken else path.stem
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.exists():
        raise MibvhError(f"--plugin {path}: there is no such Python file")
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)  # its neighbours; last, so that they hide nothing
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with users_code("--plugin ", str(path)):
            spec.loader.exec_module(module)
    except MibvhError:
        del sys.modules[name]
        raise


def _common(
    plugin: Annotated[
        list[Path] | None,
        typer.Option(
            "--plugin",
            help="Python file that registers your own builders, metrics, predictors or experiments",
        ),
    ] = None,
    sandbox: Annotated[
        bool,
        typer.Option("--sandbox", help="try to load each scene in a separate process first"),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="show the traceback of an error")] = False,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="print the version"),
    ] = False,
) -> None:
    # In the environment, so that it holds for worker processes too.
    if sandbox:
        os.environ["MIBVH_SANDBOX"] = "1"
    if debug:
        os.environ["MIBVH_DEBUG"] = "1"
    for path in plugin or []:
        _load_plugin(path)


app = typer.Typer(
    cls=_Commands,
    callback=_common,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Measures and predicts how fast a bounding volume hierarchy really is.",
)
for _name, _command in COMMANDS.items():
    app.command(_name)(_command)
app.add_typer(scenes.app, name="scenes")
