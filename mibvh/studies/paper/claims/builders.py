"""Claims on what the builders optimise."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from mibvh.builders.chosen import builder_of
from mibvh.studies.analyse.builders import relative_to, relative_to_best, splitting_builders
from mibvh.studies.analyse.depth import remaining_relative
from mibvh.studies.measure.depth import DepthResult
from mibvh.studies.paper.claims.common import NONE, TOP_DOWN, scenes_with, shares
from mibvh.studies.paper.published import published
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.scene import Records

_TOPIC = "builders"


def builder_claims(records: Records, correlations: pd.DataFrame) -> Iterator[Claim]:
    """Judge the claims on SAH and EPO of the builders."""
    yield from _of_epo(records)
    best = relative_to_best(records, without=splitting_builders(records))
    yield from _of_sah(best, scenes_with(records, "bbvh"))


def _of_epo(records: Records) -> Iterator[Claim]:
    epo, sah = relative_to(records, "epo"), relative_to(records, "sah")
    paper = published().epo
    known = [b for b in paper if b in epo.index and b != "lbvh"]
    yield Claim(
        topic=_TOPIC,
        claim="EPO per builder (lbvh = 100%)",
        paper=shares({b: paper[b] for b in known or paper}),
        ours=shares({b: epo[b] for b in known}) if known else NONE,
        judged="each within 15 points of the paper's",
        conditions=tuple(bool(abs(epo[b] - paper[b]) <= 0.15) for b in known),
        scenes=scenes_with(records, "lbvh", *known),
    )
    sweeps = [b for b in TOP_DOWN if b in epo.index]
    yield Claim(
        topic=_TOPIC,
        claim="top-down sweeps optimise EPO much better than SAH",
        paper=f"bbvh: EPO {paper['bbvh']:.0%} of lbvh's",
        ours=", ".join(f"{b}: EPO {epo[b]:.0%}, SAH {sah[b]:.0%}" for b in sweeps) or NONE,
        judged="their EPO is a smaller share of lbvh's than their SAH",
        conditions=tuple(bool(epo[b] < sah[b]) for b in sweeps),
        scenes=scenes_with(records, "lbvh", *sweeps),
    )


def _of_sah(best: pd.DataFrame, scenes: int) -> Iterator[Claim]:
    """Judge the sweep by how far it is above the best of the trees that split no triangle."""
    enough = "bbvh" in best.index and len(best) >= 4
    sweep = best.loc["bbvh"] if enough else None
    rank = int(best["mean"].rank(ascending=False).get("bbvh", 0)) if enough else 0
    yield Claim(
        topic=_TOPIC,
        claim="the sweep is among the worst in SAH",
        paper="among the worst",
        ours=f"{sweep['mean'] - 1:.0%} above the best without split triangles on average, "
        f"place {rank} of {len(best)} counted from the worst"
        if sweep is not None
        else NONE,
        judged="among the worse third of the builders that do not split triangles",
        conditions=(rank <= round(len(best) / 3),) if enough else (),
        scenes=scenes,
    )
    yield Claim(
        topic=_TOPIC,
        claim="the sweep does not reliably minimise SAH",
        paper=_above_the_best(),
        ours=f"{sweep['scene']}: {sweep['max'] - 1:.0%} above the best without split triangles"
        if sweep is not None
        else NONE,
        judged="60% above the best tree without split triangles, in some scene",
        conditions=(bool(sweep["max"] >= 1.6),) if sweep is not None else (),
        scenes=scenes,
    )


def _above_the_best() -> str:
    """Scenes of the paper in which the sweep is known to be far above the best."""
    return ", ".join(
        f"{scene.name}: at least {scene.bbvh_sah - 1:.0%} above the optimum"
        for scene in published().known_scenes
        if scene.bbvh_sah is not None
    )


def depth_claims(records: Records, correlations: pd.DataFrame) -> Iterator[Claim]:
    """Judge the claim on the worst case that remains as a tree goes down."""
    remaining = remaining_relative(records)
    splitting = splitting_builders(records)
    others = [b for b in remaining.index if builder_of(b) != "bbvh" and b not in splitting]
    # Splits that every builder's trees have in some scene.
    shown = [
        n for n in (1, 7, 63) if n in remaining.columns and others and remaining[n].notna().all()
    ]
    least = {n: remaining.loc[others, n] for n in shown}
    yield Claim(
        topic=_TOPIC,
        claim="the sweep minimises the worst-case triangle cost that remains",
        paper="by construction, split by split",
        ours="; ".join(
            f"after {n} split{'s' * (n > 1)} {of.idxmin()} {of.min():.0%} of bbvh's"
            for n, of in least.items()
        )
        or NONE,
        judged="in the mean over the scenes, no other builder that does not split triangles "
        "leaves less after 1, 7 or 63 splits",
        conditions=tuple(bool(of.min() >= 1 - 1e-9) for of in least.values()),
        scenes=sum(record.result(DepthResult) is not None for record in records),
    )
