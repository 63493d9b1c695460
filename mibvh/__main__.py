"""``python -m mibvh``."""

from mibvh.cli import entry

entry()
