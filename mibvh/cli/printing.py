"""Results on standard output: JSON, or tables for people.

Rich is imported when something is printed: it takes as long as all else that ``--help`` needs.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def print_json(result: Any) -> None:
    """Print one JSON object on a line."""
    typer.echo(json.dumps(result))


def print_result(result: dict[str, Any], as_json: bool) -> None:
    """Print a result: one JSON object, or a table of two columns."""
    if as_json:
        print_json(result)
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None)
    for name, value in result.items():
        text = f"{value:.6g}" if isinstance(value, float) else str(value)
        table.add_row(name, Text(text))  # brackets are no markup
    Console().print(table)


def print_table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(*headings, box=None)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def as_objects(records: Iterable[DataclassInstance]) -> list[dict[str, Any]]:
    """Turn records into JSON-able objects."""
    return [dataclasses.asdict(record) for record in records]
