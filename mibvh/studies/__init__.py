"""The study: measure, analyse, store, report. The only room that knows all the others."""

from mibvh.studies.options import EXPERIMENTS, PROFILES, StudyOptions
from mibvh.studies.run import Study, study

__all__ = ["EXPERIMENTS", "PROFILES", "Study", "StudyOptions", "study"]
