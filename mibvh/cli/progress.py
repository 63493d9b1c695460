"""Progress on standard error, and loading scenes with it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import typer

import mibvh
from mibvh.cli.options import parse_defines
from mibvh.heartbeat import Heartbeat

if TYPE_CHECKING:
    from mibvh.scene import Scene


@contextlib.contextmanager
def progress_bar() -> Iterator[Any]:
    """A progress bar on standard error, or a line every few seconds if that is no terminal."""
    from rich.console import Console
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

    def say() -> bool:
        for task in bar.tasks[-1:]:
            sys.stderr.write(f"mibvh: {task.description} ({task.percentage:.0f}%)\n")
        return bool(bar.tasks)

    with bar, contextlib.nullcontext() if terminal else Heartbeat(say):
        yield bar


@contextlib.contextmanager
def shares(what: str) -> Iterator[Callable[[float], None]]:
    """Show one task; yield a callback for the share that is done."""
    with progress_bar() as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)


@contextlib.contextmanager
def stages(what: str, prefix: str = "") -> Iterator[Callable[[str, float], None]]:
    """Show one stage after the other; yield a callback for the stage and its share."""
    with progress_bar() as bar:
        yield show_stages(bar, bar.add_task(what, total=1.0), prefix)


def show_stages(bar: Any, task: Any, prefix: str = "") -> Callable[[str, float], None]:
    """Show stages on a bar. Each stage has its own estimate of time left."""

    def show(stage: str, done: float) -> None:
        words = f"{prefix}: {stage}" if prefix else stage
        if bar.tasks[task].description != words:
            bar.reset(task, description=words)
        bar.update(task, completed=done)

    return show


def doing(what: str) -> Heartbeat:
    """Name the work of a command without progress every few seconds."""

    def say() -> bool:
        typer.echo(f"mibvh: {what} ...", err=True)
        return True

    return Heartbeat(say)


@contextlib.contextmanager
def signs_of_life() -> Iterator[None]:
    """Print a line now and then while a command is at work, if there is no terminal."""
    with contextlib.nullcontext() if sys.stderr.isatty() else doing("at work"):
        yield


def load(source: str, define: list[str] | None = None) -> Scene:
    """Load a scene, and print its notes on standard error."""
    with doing(f"loading {source}"):
        scene = mibvh.load(source, parse_defines(define))
    say_notes(scene.name, scene.notes)
    return scene


def say_notes(scene: str, notes: list[str]) -> None:
    """Print the notes of a scene on standard error."""
    for note in notes:
        typer.echo(f"mibvh: {scene}: {note}", err=True)
