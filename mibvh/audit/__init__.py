"""The instrument audits itself: each number compared with one that shares no code with it."""

from __future__ import annotations

from mibvh.audit.record import Audit, Check
from mibvh.audit.run import audit, check_self_hits, check_tree

__all__ = ["Audit", "Check", "audit", "check_self_hits", "check_tree"]
