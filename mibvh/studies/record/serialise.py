"""Dataclasses to and from JSON: the one way in which records are written and read."""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from mibvh.errors import MibvhError
from mibvh.files import plain

T = TypeVar("T")


def to_json(value: Any) -> Any:
    """Turn dataclasses, and containers of them, into what :mod:`json` writes."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_json(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_json(of) for key, of in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(of) for of in value]
    return value


def from_json(kind: type[T], data: Any) -> T:
    """Turn what :func:`to_json` returned back into a dataclass.

    Parameters
    ----------
    kind : type
        A dict, or a dataclass whose fields are numbers, text, other dataclasses, and lists,
        tuples and dicts of these.
    data
        As read by :mod:`json`.

    Raises
    ------
    MibvhError
        If a field is missing, there is one too many, or one is of another type or too large.
        Whatever the data, nothing else.
    """
    try:
        return typing.cast(T, _read(kind, data))
    except RecursionError:
        raise MibvhError("this is no record of mibvh: it is nested too deeply") from None


def _read(kind: Any, data: Any) -> Any:
    return _reader(kind)(data)


@functools.cache
def _reader(kind: Any) -> Callable[[Any], Any]:
    """Return what reads data of a type; records hold a hundred thousand numbers, of few types."""
    if dataclasses.is_dataclass(kind):
        return functools.partial(_read_dataclass, typing.cast(type, kind))
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):
        one = _reader(next(i for i in inner if i is not type(None)))
        return lambda data: None if data is None else one(data)
    if origin in (tuple, list):
        item = _reader(inner[0])
        return lambda data: origin([item(of) for of in _checked(list, data)])
    if origin is dict:
        item = _reader(inner[1])
        return lambda data: {plain(k): item(of) for k, of in _checked(dict, data).items()}
    if kind is float:
        return lambda data: data if type(data) is float else _harmless(_checked(float, data))
    return lambda data: _harmless(_checked(kind, data))


def _checked(kind: Any, data: Any) -> Any:
    """See that data are of a type; integers stay integers where any number will do."""
    wanted = {float: int | float, Any: object}.get(kind, kind)
    if not isinstance(data, wanted) or (kind in (int, float) and isinstance(data, bool)):
        raise MibvhError(f"this is no record of mibvh: {str(data)[:40]!r} is no {wanted}")
    return data


def _harmless(data: Any) -> Any:
    """What JSON can hold but no table or file of text can: made harmless, or refused."""
    if isinstance(data, str):
        return plain(data)
    if isinstance(data, dict):
        return {plain(key): _harmless(of) for key, of in data.items()}
    if isinstance(data, list):
        return [_harmless(of) for of in data]
    if isinstance(data, int) and abs(data) >= 1 << 64:
        raise MibvhError("this is no record of mibvh: it holds a number of more than 64 bits")
    return data


def _read_dataclass(kind: type, data: Any) -> Any:
    fields = _types(kind)
    if not isinstance(data, dict) or set(data) != set(fields):
        raise MibvhError(f"this is no {kind.__name__} of this version of mibvh")
    return kind(**{name: _read(of, data[name]) for name, of in fields.items()})


@functools.cache
def _types(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}
