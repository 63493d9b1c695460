"""The claims of the paper's slides, each beside what a study found, and whether it held.

A claim holds where all its conditions do, in part where some do. Where the stopwatch did not know
times well enough, claims are judged by counted cost, or not at all. The conditions are ours: the
slides say what was seen, not how much of it would do.
"""

from mibvh.studies.paper.claims.table import claims

__all__ = ["claims"]
