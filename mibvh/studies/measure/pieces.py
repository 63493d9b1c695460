"""Typed pieces of a study, kept in its store."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from mibvh.studies.measure.store import Store
from mibvh.studies.record.serialise import from_json, to_json

T = TypeVar("T")


def kept(store: Store, name: str, kind: type[T], make: Callable[[], T]) -> T:
    """Return a dataclass: read if the store has it and it is sound, otherwise made and kept."""
    return from_json(kind, store.kept(name, lambda: to_json(make())))
