"""Arguments shared by several commands, and parsers for NAME=VALUE."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from mibvh.errors import MibvhError

SceneArgument = Annotated[
    str, typer.Argument(metavar="SCENE", help="Mitsuba XML, a mesh file, or a bundled scene's name")
]
TreeArgument = Annotated[Path, typer.Argument(metavar="TREE.npz")]
RaysArgument = Annotated[Path, typer.Argument(metavar="RAYS.npz")]
TreeOutput = Annotated[Path, typer.Option("-o", "--output", help="the tree file to write")]
FileOutput = Annotated[Path, typer.Option("-o", "--output", help="the file to write")]
Define = Annotated[
    list[str] | None,
    typer.Option("-D", "--define", help="sets $NAME in a Mitsuba XML file, as NAME=VALUE"),
]
LayoutOption = Annotated[
    str | None,
    typer.Option(
        help="mibvh, tinybvh, madmann91, npz; for wide trees mbvh4, mbvh8; by default npz for "
        "that file ending, otherwise mibvh"
    ),
]
Json = Annotated[bool, typer.Option("--json", help="print one JSON object")]


def parse_pairs(pairs: list[str] | None, option: str = "--option") -> dict[str, str]:
    """Split ``name=value`` pairs; errors name the option that they were given as."""
    parsed = {}
    for pair in pairs or []:
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise MibvhError(f"{option} takes NAME=VALUE, not {pair!r}")
        if name in parsed:
            raise MibvhError(f"{option} is given {name!r} twice")
        parsed[name] = value
    return parsed


def parse_defines(pairs: list[str] | None) -> dict[str, str]:
    """Split the pairs given by ``-D``."""
    return parse_pairs(pairs, "-D")


def parse_options(pairs: list[str] | None) -> dict[str, Any]:
    """Split ``name=value`` pairs; values are parsed as JSON, or else are text."""
    options: dict[str, Any] = {}
    for name, value in parse_pairs(pairs).items():
        try:
            options[name] = json.loads(value)
        except ValueError:
            options[name] = value
    return options
