"""Claims on SIMD and on leaf count variability.

Each is judged by simulated warps, which have no noise, and apart from that by the times of this
machine's lanes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.builders.chosen import builder_of
from mibvh.studies.analyse.builders import relative_to
from mibvh.studies.analyse.correlations import SCALAR, SIMD, overview
from mibvh.studies.analyse.noise import simd_deviation
from mibvh.studies.analyse.warps import (
    deviation_by_builder,
    deviation_by_scene,
    explained,
    warp_rules,
)
from mibvh.studies.paper.claims.common import (
    NONE,
    TOP_DOWN,
    number,
    scenes_with,
    shares,
    steady,
)
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.scene import Records

_TOPIC = "SIMD"
#: Sizes that the slides give for the deviation.
_LOW, _HIGH = 0.05, 0.10


def simd_claims(records: Records, correlations: pd.DataFrame) -> Iterator[Claim]:
    """Judge the claims; those on times only where times are known well enough."""
    timed = steady(records, SCALAR) and steady(records, SIMD)
    warps = f"; simulated warps, {warp_rules(records)}"
    yield _lowest(records)
    yield _friendly(records, warps)
    yield _simulated_deviation(records, warps)
    yield _timed_deviation(records, timed)
    yield _by_lcv(records, warps)
    yield _simulated_with_lcv(correlations, warps)
    yield _timed_with_lcv(correlations, timed)


def _lowest(records: Records) -> Claim:
    lcv = relative_to(records, "lcv")
    sweeps = [b for b in TOP_DOWN if b in lcv.index]
    # The same builders with other options are no other methods.
    others = lcv.drop([b for b in lcv.index if builder_of(b) in TOP_DOWN])
    enough = bool(sweeps) and len(others) > 0
    return Claim(
        topic=_TOPIC,
        claim="top-down sweeps have the lowest LCV of all",
        paper="lower than any other method",
        ours=shares(lcv.sort_values().head(4).to_dict()) + " of lbvh's" if enough else NONE,
        judged="each below every other builder; by the leaves that rays visit, counted",
        conditions=tuple(bool(lcv[b] < others.min()) for b in sweeps) if enough else (),
        scenes=scenes_with(records, "lbvh", *sweeps),
    )


def _friendly(records: Records, warps: str) -> Claim:
    mean = deviation_by_builder(records).set_index("builder")["simulated"]
    sweeps = [b for b in TOP_DOWN if b in mean.index]
    enough = bool(sweeps) and len(mean) > 2 and bool(mean.notna().all())
    return Claim(
        topic=_TOPIC,
        claim="top-down sweeps are SIMD friendly",
        paper="SIMD friendly",
        ours=", ".join(f"{b} {mean[b]:+.1%}" for b in sweeps)
        + f"; least {mean.idxmin()} {mean.min():+.1%}, greatest {mean.idxmax()} {mean.max():+.1%}"
        if enough
        else NONE,
        judged="each deviates from scalar cost to below the mean of the scene's trees, on average"
        + warps,
        conditions=tuple(bool(mean[b] < 0) for b in sweeps) if enough else (),
        scenes=scenes_with(records, *sweeps),
    )


def _simulated_deviation(records: Records, warps: str) -> Claim:
    of = deviation_by_scene(records)
    typical, largest = float(of["simulated"].mean()), float(of["largest"].mean())
    return Claim(
        topic=_TOPIC,
        claim="SIMD deviates from scalar by 5 to 10%, in simulated warps",
        paper=f"{_LOW:.0%} to {_HIGH:.0%}",
        ours=f"{typical:.1%} on average over trees and scenes; {largest:.1%} for a scene's most "
        f"deviating tree, {of['largest'].max():.1%} at most",
        judged="the average from 5 to 10%; that of the most deviating trees from 5 to 10%" + warps,
        conditions=tuple(_LOW <= value <= _HIGH for value in (typical, largest))
        if len(records[0].trees) > 2 and np.isfinite(typical)
        else (),
        scenes=int(of["simulated"].count()),
    )


def _by_lcv(records: Records, warps: str) -> Claim:
    r = explained(records)
    known = bool(np.isfinite(list(r.values())).all()) and len(records[0].trees) > 2
    return Claim(
        topic=_TOPIC,
        claim="LCV explains best how SIMD deviates from scalar, in simulated warps",
        paper="best of what was tried",
        ours=f"r {r['lcv']:.2f} of LCV, {r['spread']:.2f} of the spread of the rays' counted cost; "
        "over all trees, logarithms less the scene's mean"
        if known
        else NONE,
        judged="r² of LCV at least 0.5, and r at least that of the spread" + warps,
        conditions=(r["lcv"] ** 2 >= 0.5 and r["lcv"] > 0, r["lcv"] >= r["spread"])
        if known
        else (),
        scenes=len(records),
    )


def _timed_deviation(records: Records, timed: bool) -> Claim:
    typical = float(simd_deviation(records)["deviation"].mean())
    enough = timed and len(records[0].trees) > 2
    return Claim(
        topic=_TOPIC,
        claim="SIMD deviates from scalar by little",
        paper="5 to 10%",
        ours=f"{typical:.0%} on average over trees and scenes",
        judged="10% or less; by times of this machine's lanes",
        conditions=(typical <= 0.1,) if enough else (),
        scenes=len(records),
    )


def _simulated_with_lcv(correlations: pd.DataFrame, warps: str) -> Claim:
    return _with_lcv(
        correlations,
        "warp_cost",
        "counted_cost",
        "with LCV, the cost of simulated warps is predicted as well as scalar cost",
        warps,
        True,
    )


def _timed_with_lcv(correlations: pd.DataFrame, timed: bool) -> Claim:
    return _with_lcv(
        correlations,
        SIMD.ns,
        SCALAR.ns,
        "with LCV, SIMD time is predicted as well as scalar time",
        "; by times of this machine's lanes",
        timed,
    )


def _with_lcv(
    correlations: pd.DataFrame, simd: str, scalar: str, claim: str, by: str, steady: bool
) -> Claim:
    summary = overview(correlations)
    r = summary["mean"]
    alone = r[(scalar, "fitted")]
    without, own, others = (r[(simd, n)] for n in ("fitted", "with LCV", "LCV from others"))
    known = bool(np.isfinite([without, own, alone]).all())
    return Claim(
        topic=_TOPIC,
        claim=claim,
        paper="as well as scalar",
        ours=f"mean r {without:.3f} without LCV, {own:.3f} with its weight fitted per scene, "
        f"{number(others)} with that of the other scenes; scalar {alone:.3f}"
        if known
        else NONE,
        judged="mean r at most 0.01 below the scalar one, with either weight" + by,
        conditions=tuple(bool(v >= alone - 0.01) for v in (own, others) if np.isfinite(v))
        if known and steady
        else (),
        scenes=int(summary.loc[(simd, "with LCV"), "scenes"]),
    )
