"""Claims on what rotating the scenes costs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.studies.analyse.rotation import rotation_factors
from mibvh.studies.paper.claims.common import NONE, steady_rotated
from mibvh.studies.paper.published import published
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.scene import Records

_TOPIC = "rotation"


def rotation_claims(records: Records, correlations: pd.DataFrame) -> Iterator[Claim]:
    """Judge the claims by the mean factors of the scenes."""
    factors = rotation_factors(records).drop(columns="builder")
    mean = factors.groupby("scene").mean()
    yield from _of_sah(mean, mean.mean(), timed=steady_rotated(records))
    yield from _of_epo(mean.mean(), len(mean))


def _of_sah(mean: pd.DataFrame, m: pd.Series, timed: bool) -> Iterator[Claim]:
    done, paper = len(mean) > 0, published().rotation
    judged_by = ("counted_cost", "scalar_ns") if timed else ("counted_cost",)
    yield Claim(
        topic=_TOPIC,
        claim="rotating the scene by 45° costs finite rays much more than SAH says",
        paper=f"time {paper['scalar_ns']}×, SAH {paper['sah']}×",
        ours=f"time {m['scalar_ns']:.1f}×, counted {m['counted_cost']:.1f}×, SAH {m['sah']:.1f}×"
        if done
        else NONE,
        judged="on average counted cost, and time where it is known, grow by more than SAH",
        conditions=tuple(bool(m[n] > m["sah"]) for n in judged_by) if done else (),
        scenes=len(mean),
    )
    less = int((mean["sah"] < mean["counted_cost"]).sum())
    yield Claim(
        topic=_TOPIC,
        claim="SAH underestimates the cost of rotating consistently",
        paper="consistently",
        ours=f"in {less} of {len(mean)} scenes (counted cost)" if done else NONE,
        judged="in all scenes",
        conditions=(less == len(mean),) if done else (),
        scenes=len(mean),
    )


def _of_epo(m: pd.Series, scenes: int) -> Iterator[Claim]:
    done, paper = bool(np.isfinite(m["sah"])), published().rotation
    yield Claim(
        topic=_TOPIC,
        claim="of all figures EPO grows most with rotating",
        paper=f"EPO {paper['epo']}×",
        ours=f"EPO {m['epo']:.1f}×" if done else NONE,
        judged="EPO grows by more than SAH, counted cost and the predictor",
        conditions=(bool(m["epo"] > m[["sah", "counted_cost", "fitted"]].max()),)  # skips NaN
        if done
        else (),
        scenes=scenes,
    )
    gap = {name: abs(np.log(m[name] / m["counted_cost"])) for name in ("fitted", "sah")}
    yield Claim(
        topic=_TOPIC,
        claim="SAH + EPO with average α predicts the cost of rotating",
        paper=f"{paper['fitted']}× for {paper['scalar_ns']}×",
        ours=f"{m['fitted']:.1f}× for {m['scalar_ns']:.1f}× (time), "
        f"{m['counted_cost']:.1f}× (counted)"
        if done
        else NONE,
        judged="nearer to counted cost than SAH, and within 20% of it",
        conditions=(bool(gap["fitted"] < gap["sah"]), bool(gap["fitted"] < np.log(1.2)))
        if done and np.isfinite(m["fitted"])
        else (),
        scenes=scenes,
    )
