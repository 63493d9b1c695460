"""What a study keeps: content-addressed pieces, so that a killed run goes on where it stopped.

A piece's key is a hash of everything it depends on, so a changed option recomputes what it
touches and nothing else. Pieces are written whole or not at all; a damaged one is made anew.
"""

from __future__ import annotations

import functools
import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from mibvh.code import code_digest
from mibvh.errors import MibvhError
from mibvh.files import write_text
from mibvh.rays import RaySet
from mibvh.studies.record.serialise import from_json, to_json
from mibvh.tree import Tree

T = TypeVar("T", Tree, RaySet)
R = TypeVar("R")


def key_of(*code: str, **parts: Any) -> str:
    """Hash of what a piece is made from, and of the code that makes it.

    Parameters
    ----------
    *code : str
        Modules that make it; all that they import from this package counts.
    **parts
        JSON-able.
    """
    text = json.dumps({**parts, "code": code_digest(*code)}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


class Store:
    """A folder of pieces.

    Parameters
    ----------
    folder : Path
        Made if it is not there.

    Attributes
    ----------
    spent : dict of str to float
        Seconds that it took to make the pieces handed out since :meth:`begin`, whenever that
        was, by the first word of their names.
    made, reused : Counter of str
        Pieces that were made, and that were here, since :meth:`begin`, by the same words.

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
        self.spent: dict[str, float] = {}
        self.made: Counter[str] = Counter()
        self.reused: Counter[str] = Counter()

    def begin(self) -> None:
        """Count pieces, and the seconds spent on them, from here on."""
        self.spent, self.made, self.reused = {}, Counter(), Counter()

    def array(self, kind: type[T], key: str | None, make: Callable[[], T]) -> T:
        """A tree or ray set: read if it is here and sound, otherwise made and kept.

        Without a key it is made anew: nothing tells whether one that is here would be the same.
        """
        if key is None:
            started = time.perf_counter()
            value = make()
            self._count(kind.__name__.lower(), time.perf_counter() - started, made=True)
            return value
        name = f"{kind.__name__.lower()}-{key}"
        path = self._path(kind, key)
        if path.exists():
            try:
                value = kind.load(path, key=key)
            except MibvhError:
                path.unlink()
            else:
                self._count(name, self._held(name)[1])
                return value
        started = time.perf_counter()
        value = make()
        seconds = time.perf_counter() - started
        value.save(path, key=key)
        self.write(name, {}, seconds)
        self._count(name, seconds, made=True)
        return value

    def again(self, kind: type[T], key: str, value: T) -> Callable[[], T]:
        """Keep a tree or ray set if it is not here, and return what reads it; that is not counted.

        Raises
        ------
        MibvhError
            When it is read, if it was removed or damaged meanwhile.
        """
        path = self._path(kind, key)
        if not path.exists():
            value.save(path, key=key)
        return functools.partial(kind.load, path, key)

    def has(self, kind: type[Tree] | type[RaySet], key: str | None) -> bool:
        """Whether a tree or ray set is here; it may turn out to be damaged."""
        return key is not None and self._path(kind, key).exists()

    def _path(self, kind: type[Tree] | type[RaySet], key: str) -> Path:
        return self.folder / f"{kind.__name__.lower()}-{key}.npz"

    def record(self, name: str, kind: type[R], make: Callable[[], R]) -> R:
        """Return a dataclass: read if it is here and sound, otherwise made and kept as JSON."""
        value, seconds = self._held(name)
        if value is not None:
            try:
                found = from_json(kind, value)
            except MibvhError:  # of another version, or somebody made the checksum fit
                pass
            else:
                self._count(name, seconds)
                return found
        started = time.perf_counter()
        value = to_json(make())
        seconds = time.perf_counter() - started
        self.write(name, value, seconds)
        self._count(name, seconds, made=True)
        return from_json(kind, value)

    def read(self, name: str) -> dict[str, Any] | None:
        """Return the JSON piece of that name, or None if it is not here or damaged."""
        return self._held(name)[0]

    def write(self, name: str, value: dict[str, Any], seconds: float | None = None) -> None:
        """Keep a JSON piece, and what it took to make."""
        held = {"checksum": _checksum(value), "seconds": seconds, "value": value}
        write_text(self.folder / f"{name}.json", json.dumps(held, indent=1))

    def _held(self, name: str) -> tuple[dict[str, Any] | None, float]:
        """A JSON piece, or None, and what it took to make, or NaN where that is not known."""
        path = self.folder / f"{name}.json"
        try:
            held = json.loads(path.read_text(encoding="utf-8"))
            sound = held["checksum"] == _checksum(held["value"])
            seconds = float("nan") if held.get("seconds") is None else float(held["seconds"])
        except (
            OSError,
            ValueError,
            LookupError,
            TypeError,
            AttributeError,
            OverflowError,
            RecursionError,
        ):
            return None, float("nan")
        return (held["value"], seconds) if sound else (None, float("nan"))

    def _count(self, name: str, seconds: float, *, made: bool = False) -> None:
        kind = name.partition("-")[0]
        (self.made if made else self.reused)[kind] += 1
        self.spent[kind] = self.spent.get(kind, 0.0) + seconds


def _checksum(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
