"""The entry point of the command line, and its exit codes after errors."""

from __future__ import annotations

import contextlib
import os
import sys
import traceback

from mibvh.cli.app import app
from mibvh.cli.exits import REFUSED
from mibvh.errors import MibvhError


def entry() -> None:
    """Entry point of the ``mibvh`` command, in a process of its own."""
    _keep_stdout_for_results()
    main()


def main() -> None:
    """Run the command line."""
    try:
        app(prog_name="mibvh")
    except MibvhError as error:
        _print_traceback(error)
        sys.stderr.write(f"mibvh: {error}\n")
        raise SystemExit(REFUSED) from None
    except OSError as error:
        _print_traceback(error)
        _say_refused(error)
        raise SystemExit(REFUSED) from None


def _keep_stdout_for_results() -> None:
    """Send what Mitsuba's log writes to standard output to standard error instead.

    The log writes to the file descriptor; results go where it pointed before.
    """
    sys.stdout.flush()
    results = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = os.fdopen(results, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)


def _print_traceback(error: Exception) -> None:
    """Print the traceback of an error, if ``--debug`` was given."""
    if os.environ.get("MIBVH_DEBUG"):
        traceback.print_exception(error)


def _say_refused(error: OSError) -> None:
    """Print an error of the system; one without a file name concerns standard output."""
    said = f"{error.filename}:" if error.filename else "standard output: cannot be written"
    with contextlib.suppress(OSError):  # standard error may be full too
        sys.stderr.write(f"mibvh: {said} ({error.strerror or error})\n")
    with contextlib.suppress(OSError, ValueError):  # Python would try it again, and complain
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
