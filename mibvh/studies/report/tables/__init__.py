"""The study's tables for people, a file per subject; every form of the report lays out these."""

from mibvh.studies.report.tables.all import answers
from mibvh.studies.report.tables.scene import scene_answers

__all__ = ["answers", "scene_answers"]
