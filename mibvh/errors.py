"""The one exception a user's mistake raises."""

from __future__ import annotations


class MibvhError(ValueError):
    """Something the caller asked for cannot be done; the message says what and where.

    The command line prints the message as one sentence and exits with code 2.
    """
