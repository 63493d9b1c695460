"""The paper's claims on prediction, judged for trees of more children per node."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.studies.analyse.widths import over_best, wide_trees, width_correlations, widths_of
from mibvh.studies.paper.claims.common import NONE, number, r_words
from mibvh.studies.paper.published import published
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.scene import Records

_TOPIC = "wide trees"
_BY = "; by counted cost of wide trees"


def width_claims(records: Records, correlations: pd.DataFrame) -> Iterator[Claim]:
    """Judge them at every width beyond two."""
    wide = [width for width in widths_of(records) if width > 2]
    if not wide:
        return
    of_all = width_correlations(records)
    trees = wide_trees(records)
    for width in wide:
        of = of_all[of_all["width"] == width]
        yield from _predicted(of, width)
        yield _same_best(trees, width)
    yield _alpha(of_all, wide[-1])


def _predicted(of: pd.DataFrame, width: int) -> Iterator[Claim]:
    r = of.groupby("predictor")["pearson"].agg(["mean", "min", "count"])
    alone, both, fixed = (r.loc[name] for name in ("SAH", "fitted", "fixed 0.79"))
    paper, scenes = published().r, int(alone["count"])
    known = bool(np.isfinite(alone["mean"]))
    yield Claim(
        topic=_TOPIC,
        claim=f"{width} children per node: SAH alone is not a reliable predictor",
        paper=r_words(paper["SAH"].mean, paper["SAH"].low),
        ours=r_words(alone["mean"], alone["min"]) if known else NONE,
        judged="some scene's r below 0.90" + _BY,
        conditions=(bool(alone["min"] < 0.90),) if known else (),
        scenes=scenes,
    )
    yield Claim(
        topic=_TOPIC,
        claim=f"{width} children per node: with EPO, α fitted per scene, cost is predicted very "
        "well",
        paper=r_words(paper["fitted"].mean, paper["fitted"].low),
        ours=r_words(both["mean"], both["min"]) if np.isfinite(both["mean"]) else NONE,
        judged="mean r at least 0.99; every scene's at least 0.90" + _BY,
        conditions=(bool(both["mean"] >= 0.99), bool(both["min"] >= 0.90))
        if np.isfinite(both["mean"])
        else (),
        scenes=int(both["count"]),
    )
    yield Claim(
        topic=_TOPIC,
        claim=f"{width} children per node: with one α for all scenes EPO still helps",
        paper=f"α 0.79: {r_words(paper['fixed 0.79'].mean, paper['fixed 0.79'].low)}",
        ours=f"α 0.79: {r_words(fixed['mean'], fixed['min'])}" if known else NONE,
        judged="α 0.79 above SAH alone in the mean, and at the worst" + _BY,
        conditions=tuple(bool(fixed[c] > alone[c]) for c in ("mean", "min")) if known else (),
        scenes=scenes,
    )


def _same_best(trees: pd.DataFrame, width: int) -> Claim:
    """Not the paper's, but what it would have to hold for its ranking to be of use."""
    means = over_best(trees).pivot(index="builder", columns="width", values="mean")
    first = {w: means[w].idxmin() for w in (2, width)}
    return Claim(
        topic=_TOPIC,
        claim=f"{width} children per node: the best binary trees make the best wide ones",
        paper=NONE,
        ours=f"least cost in the mean: {first[2]}, after the collapse {first[width]}",
        judged="the same builder has the least mean cost over the scene's best tree",
        conditions=(first[2] == first[width],) if len(means) > 1 else (),
        scenes=trees["scene"].nunique(),
    )


def _alpha(of_all: pd.DataFrame, width: int) -> Claim:
    """Whether overlap weighs more in wide trees."""
    fitted = of_all[of_all["predictor"] == "fitted"]
    alpha = fitted.pivot(index="scene", columns="width", values="alpha").dropna()
    more = int((alpha[width] > alpha[2]).sum()) if len(alpha) else 0
    return Claim(
        topic=_TOPIC,
        claim=f"EPO weighs as much with {width} children per node as with two",
        paper=NONE,
        ours=f"α {number(alpha[2].mean())} at two, {number(alpha[width].mean())}; greater in "
        f"{more} of {len(alpha)} scenes"
        if len(alpha)
        else NONE,
        judged="mean fitted α within 0.1",
        conditions=(bool(abs(alpha[width].mean() - alpha[2].mean()) <= 0.1),) if len(alpha) else (),
        scenes=len(alpha),
    )
