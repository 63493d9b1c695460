"""The cache of a study: content-addressed pieces, so that a killed run continues where it stopped.

The key of a piece is a hash of everything that it depends on. A changed option therefore
recomputes what depends on it, and nothing else. A piece is written completely or not at all, and a
damaged one is recomputed.
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
    """Hash the inputs of a piece and the code that makes it.

    Parameters
    ----------
    *code : str
        Names of the modules that make it; everything that they import from this package counts.
    **parts
        The inputs, as JSON-able values.

    Returns
    -------
    str
        24 hexadecimal digits.
    """
    text = json.dumps({**parts, "code": code_digest(*code)}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


class Store:
    """A folder of pieces, and the time that they took.

    Parameters
    ----------
    folder : Path
        Created if it does not exist.

    Attributes
    ----------
    spent : dict of str to float
        Seconds that it took to make the pieces returned since :meth:`begin`, in whichever run
        they were made. Keys are the first words of the pieces' names.
    made, reused : Counter of str
        Number of pieces made, and found in the folder, since :meth:`begin`, by the same keys.

    Raises
    ------
    MibvhError
        If the folder cannot be created.
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
        """Reset the counts of pieces and seconds."""
        self.spent, self.made, self.reused = {}, Counter(), Counter()

    def array(self, kind: type[T], key: str | None, make: Callable[[], T]) -> T:
        """Return a tree or ray set: read from its file if that is intact, otherwise made and kept.

        Without a key it is always made: nothing tells whether a kept one would be the same.
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
        """Keep a tree or ray set, and return a function that reads it again, uncounted.

        The function raises MibvhError if the file was removed or damaged meanwhile.
        """
        path = self._path(kind, key)
        if not path.exists():
            value.save(path, key=key)
        return functools.partial(kind.load, path, key)

    def has(self, kind: type[Tree] | type[RaySet], key: str | None) -> bool:
        """Whether the file of a tree or ray set exists; it may still be damaged."""
        return key is not None and self._path(kind, key).exists()

    def _path(self, kind: type[Tree] | type[RaySet], key: str) -> Path:
        return self.folder / f"{kind.__name__.lower()}-{key}.npz"

    def record(self, name: str, kind: type[R], make: Callable[[], R]) -> R:
        """Return a dataclass: read from JSON if that is intact, otherwise made and kept."""
        value, seconds = self._held(name)
        if value is not None:
            try:
                found = from_json(kind, value)
            except MibvhError:  # of another version, or tampered with, checksum included
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
        """Return the JSON piece of that name, or None if it is missing or damaged."""
        return self._held(name)[0]

    def write(self, name: str, value: dict[str, Any], seconds: float | None = None) -> None:
        """Keep a JSON piece, and the seconds that it took to make."""
        held = {"checksum": _checksum(value), "seconds": seconds, "value": value}
        write_text(self.folder / f"{name}.json", json.dumps(held, indent=1))

    def _held(self, name: str) -> tuple[dict[str, Any] | None, float]:
        """Return a JSON piece (None if missing or damaged) and its seconds (NaN if unknown)."""
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
