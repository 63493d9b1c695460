"""``python -m mibvh``."""

from mibvh.cli import main

main()
