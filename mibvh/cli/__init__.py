"""The command line: each command is one public function.

Results go to standard output (with ``--json`` as one JSON object), progress and logs to
standard error; ``study --json`` writes its progress as JSON lines before the result. Exit code 0,
or 2 with one sentence for a user's mistake.

``app`` lists the commands; a file per subject holds them: ``trees``, ``compare``, ``measure``,
``render``, ``study``, ``listings`` and ``scenes``. What they share is in ``options`` (arguments),
``progress`` (signs of life) and ``printing`` (results).
"""

from mibvh.cli.app import app
from mibvh.cli.start import entry, main

__all__ = ["app", "entry", "main"]
