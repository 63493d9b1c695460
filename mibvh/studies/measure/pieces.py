"""Typed pieces of a study, kept in its store."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from mibvh.errors import MibvhError
from mibvh.studies.measure.store import Store
from mibvh.studies.record.serialise import from_json, to_json

T = TypeVar("T")


def kept(store: Store, name: str, kind: type[T], make: Callable[[], T]) -> T:
    """Return a dataclass: read if the store has it and it is sound, otherwise made and kept."""
    held = store.read(name)
    if held is not None:
        try:
            from_json(kind, held)
        except MibvhError:  # of another version, or somebody made the checksum fit
            (store.folder / f"{name}.json").unlink(missing_ok=True)
    return from_json(kind, store.kept(name, lambda: to_json(make())))
