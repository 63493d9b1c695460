"""Claims on SIMD time and on leaf count variability."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.studies.analyse.builders import relative_to
from mibvh.studies.analyse.correlations import SCALAR, SIMD, overview
from mibvh.studies.analyse.noise import simd_deviation
from mibvh.studies.paper.claims.common import NONE, TOP_DOWN, number, shares, steady
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.scene import Records

_TOPIC = "SIMD"


def simd_claims(records: Records, found: pd.DataFrame) -> Iterator[Claim]:
    """Judge the claims; those on times only where times are known well enough."""
    timed = steady(records, SCALAR) and steady(records, SIMD)
    yield _lowest(records)
    yield _deviation(records, timed)
    yield _predicted(found, timed)


def _lowest(records: Records) -> Claim:
    lcv = relative_to(records, "lcv")
    sweeps = [b for b in TOP_DOWN if b in lcv.index]
    others = lcv.drop(sweeps)
    enough = bool(sweeps) and len(others) > 0
    return Claim(
        topic=_TOPIC,
        claim="top-down sweeps have the lowest LCV of all",
        paper="lower than any other method",
        ours=shares(lcv.sort_values().head(4).to_dict()) + " of lbvh's" if enough else NONE,
        judged="each below every other builder",
        conditions=tuple(bool(lcv[b] < others.min()) for b in sweeps) if enough else (),
    )


def _deviation(records: Records, timed: bool) -> Claim:
    typical = float(simd_deviation(records)["deviation"].mean())
    enough = timed and len(records[0].trees) > 2
    return Claim(
        topic=_TOPIC,
        claim="SIMD deviates from scalar by little",
        paper="5 to 10%",
        ours=f"{typical:.0%} on average over trees and scenes",
        judged="10% or less",
        conditions=(typical <= 0.1,) if enough else (),
    )


def _predicted(found: pd.DataFrame, timed: bool) -> Claim:
    r = overview(found)["mean"]
    scalar = r[(SCALAR.ns, "fitted")]
    simd, own, others = (r[(SIMD.ns, n)] for n in ("fitted", "with LCV", "LCV from others"))
    known = bool(np.isfinite([simd, own, scalar]).all())
    return Claim(
        topic=_TOPIC,
        claim="with LCV, SIMD time is predicted as well as scalar time",
        paper="as well as scalar",
        ours=f"mean r {simd:.3f} without LCV, {own:.3f} with its weight fitted per scene, "
        f"{number(others)} with that of the other scenes; scalar {scalar:.3f}"
        if known
        else NONE,
        judged="mean r at most 0.01 below the scalar one, with either weight",
        conditions=tuple(bool(v >= scalar - 0.01) for v in (own, others) if np.isfinite(v))
        if known and timed
        else (),
    )
