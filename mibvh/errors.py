"""The one exception a user's mistake raises."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class MibvhError(ValueError):
    """Something the caller asked for cannot be done; the message says what and where.

    The command line prints the message as one sentence and exits with code 2.
    """


def expect(kind: type | tuple[type, ...], **values: object) -> None:
    """Refuse arguments of another type.

    Parameters
    ----------
    kind : type or tuple of type
        Any of them will do; the first is the one named.
    **values
        Arguments by their names.

    Raises
    ------
    MibvhError
        Naming the first that is none.

    Examples
    --------
    >>> expect(int, count=2)
    """
    for name, value in values.items():
        if not isinstance(value, kind):
            wanted = kind[0] if isinstance(kind, tuple) else kind
            raise MibvhError(f"{name} must be a {wanted.__name__}, not a {type(value).__name__}")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Guess a misspelt name, to stand in a message; empty where none is near.

    >>> did_you_mean("cornel", ["cornell", "hairball"])
    " (did you mean 'cornell'?)"
    """
    near = difflib.get_close_matches(name.lower(), list(known), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""
