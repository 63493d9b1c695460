"""The exception that mistakes of a user raise, and helpers for its messages."""

from __future__ import annotations

import contextlib
import difflib
import inspect
import traceback
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path


class MibvhError(ValueError):
    """A request that cannot be fulfilled; the message says what and where.

    The command line prints the message as one sentence and exits with code 2.
    """


class TreeFailed(MibvhError):
    """One tree of a scene failed; the study continues with the others."""


@contextlib.contextmanager
def of_one_tree() -> Iterator[None]:
    """Turn a MibvhError of the block into a TreeFailed.

    Raises
    ------
    TreeFailed
    """
    try:
        yield
    except MibvhError as error:
        raise TreeFailed(str(error)) from error


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
    """Return a hint at a similar name for a message; empty if there is none.

    >>> did_you_mean("cornel", ["cornell", "hairball"])
    " (did you mean 'cornell'?)"
    """
    near = difflib.get_close_matches(name.lower(), list(known), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


@contextlib.contextmanager
def users_code(what: str, file: str) -> Iterator[None]:
    """Turn whatever a user's code raises into one sentence.

    Parameters
    ----------
    what : str
        What the sentence begins with.
    file : str
        Where the code stands; the sentence names the last line of its folder that was reached.

    Raises
    ------
    MibvhError
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        raise MibvhError(f"{what}{_place(error, Path(file))}: {_said(error)}") from error


def is_bundled(function: Callable[..., object]) -> bool:
    """Whether a function is of this package, and not a user's own."""
    return (getattr(function, "__module__", None) or "").partition(".")[0] == "mibvh"


def guard(what: str, function: Callable[..., object]) -> contextlib.AbstractContextManager[None]:
    """Turn whatever a user's function raises in the block into one sentence.

    Parameters
    ----------
    what : str
        Such as ``metric balance``.
    function : callable
        Errors of one of this package are left as they are.
    """
    if is_bundled(function):
        return contextlib.nullcontext()
    return users_code(f"{what} failed: ", _file_of(function))


def _file_of(function: Callable[..., object]) -> str:
    """Return the file that defines a function; empty if unknown."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return code.co_filename if code else ""


def _place(error: BaseException, path: Path) -> str:
    """Return file and line at which a user's code failed: its last own frame, or a syntax error."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}, line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if Path(f.filename).parent == path.resolve().parent]
    own = own or [f for f in frames if f.filename == str(path)]
    return f"{own[-1].filename}, line {own[-1].lineno}" if own else str(path)


def _said(error: BaseException) -> str:
    text = error.msg if isinstance(error, SyntaxError) else " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
