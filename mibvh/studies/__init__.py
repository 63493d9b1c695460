"""The study: measure, analyse, store, report. The only room that knows all the others."""

from mibvh.studies.options import PROFILES, StudyOptions
from mibvh.studies.run import Study, study

__all__ = ["PROFILES", "Study", "StudyOptions", "study"]
