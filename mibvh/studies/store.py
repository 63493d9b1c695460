"""What a study keeps: content-addressed pieces, so that a killed run goes on where it stopped.

A piece's key is a hash of everything it depends on, so a changed option recomputes what it
touches and nothing else. Pieces are written whole or not at all; a damaged one is made anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from mibvh.errors import MibvhError
from mibvh.files import write_text
from mibvh.rays import RaySet
from mibvh.tree import Tree
from mibvh.version import __version__

T = TypeVar("T", Tree, RaySet)


def key_of(**parts: Any) -> str:
    """Hash of JSON-able parts and of mibvh's version."""
    text = json.dumps({**parts, "mibvh": __version__}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


class Store:
    """A folder of pieces.

    Parameters
    ----------
    folder : Path
        Made if it is not there.

    Raises
    ------
    MibvhError
        If the folder cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MibvhError(f"{folder}: cannot be made a folder ({error.strerror})") from None
        self.folder = folder

    def array(self, kind: type[T], key: str, make: Callable[[], T]) -> T:
        """A tree or ray set: read if it is here and sound, otherwise made and kept."""
        path = self.folder / f"{kind.__name__.lower()}-{key}.npz"
        if path.exists():
            try:
                return kind.load(path)
            except MibvhError:
                path.unlink()
        value = make()
        value.save(path)
        return value

    def read(self, name: str) -> dict[str, Any] | None:
        """Return the JSON piece of that name, or None if it is not here or damaged."""
        path = self.folder / f"{name}.json"
        try:
            held = json.loads(path.read_text(encoding="utf-8"))
            sound = held["checksum"] == _checksum(held["value"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return held["value"] if sound else None

    def write(self, name: str, value: dict[str, Any]) -> None:
        """Keep a JSON piece."""
        text = json.dumps({"checksum": _checksum(value), "value": value}, indent=1)
        write_text(self.folder / f"{name}.json", text)


def _checksum(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
