"""The study: measure, analyse, hold against the paper, report.

The only room that knows all the others; ``docs/architecture.md`` is its map.
"""

from mibvh.studies import experiments as _experiments  # noqa: F401  registers them
from mibvh.studies.finished import Study, read_study
from mibvh.studies.record.experiment import Experiment, add_experiment
from mibvh.studies.record.options import EXPERIMENTS, PROFILES, StudyOptions
from mibvh.studies.record.progress import Progress
from mibvh.studies.record.quantities import quantities
from mibvh.studies.run import study

__all__ = [
    "EXPERIMENTS",
    "PROFILES",
    "Experiment",
    "Progress",
    "Study",
    "StudyOptions",
    "add_experiment",
    "quantities",
    "read_study",
    "study",
]
