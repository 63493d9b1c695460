"""Tables on kinds of rays."""

from __future__ import annotations

import pandas as pd

from mibvh.studies.analyse.kinds import (
    kind_correlations,
    kind_facts,
    kind_predictors,
    kind_ranks,
)
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

SECTION = "Kinds of rays"
_NOTE = (
    "Rays of all kinds leave the same paths. Shadow and ambient occlusion rays are traced by the "
    "any-hit kernel, and cost what that visits. The mixture is weighted by the numbers of rays, as "
    "a path tracer has them, or as asked for."
)
#: Predictors whose α is shown: fitted, estimated by length, and by what is blocked as well.
_ALPHAS = {
    "fitted": "α fitted",
    "estimated": "α estimated",
    "estimated, any hit": "α estimated, any hit",
}
#: Predictors in units of cost, with nothing fitted, whose level is shown.
_LEVELS = ("finite rays", "any-hit rays", "touched, any hit")


def kind_sheets(records: Records) -> list[Sheet]:
    """Return the tables; none where no kinds of rays were made."""
    correlations = kind_correlations(records)
    if correlations.empty:
        return []
    return [_overview(correlations), _scenes(correlations, kind_facts(records)), _ranks(records)]


def _overview(correlations: pd.DataFrame) -> Sheet:
    groups = correlations.groupby(["predictor", "kind"], sort=False)["pearson"]
    table = groups.agg(["mean", "min"]).unstack("kind")
    known = [one for one in kind_predictors() if one.name in table.index]
    kinds = list(correlations["kind"].unique())
    parts = {f"{c} {kind}": table[(c, kind)] for kind in kinds for c in ("mean", "min")}
    frame = pd.DataFrame(parts).reindex([one.name for one in known])
    return Sheet(
        name="kinds-r",
        section=SECTION,
        title="r with counted cost over the scenes, by kind of rays",
        note=_NOTE,
        frame=frame.rename_axis("predictor").reset_index(),
        columns=[
            Column("predictor"),
            *(
                Column(f"{c} {kind}", f"{kind}: {c}", ".3f")
                for kind in kinds
                for c in ("mean", "min")
            ),
        ],
        glossary={one.name: one.formula for one in known},
    )


def _scenes(correlations: pd.DataFrame, facts: pd.DataFrame) -> Sheet:
    keys = ["scene", "kind"]
    by = {
        c: correlations.pivot(index=keys, columns="predictor", values=c)
        for c in ("pearson", "alpha", "level")
    }
    names = [one.name for one in kind_predictors() if one.name in by["pearson"]]
    frame = facts.set_index(keys)
    parts = [by["pearson"][names].add_prefix("r "), by["alpha"][list(_ALPHAS)].add_prefix("α ")]
    levels = [name for name in _LEVELS if name in by["level"]]
    frame = frame.join([*parts, by["level"][levels].add_prefix("level ")]).reset_index()
    return Sheet(
        name="kinds-scenes",
        section=SECTION,
        title="Each kind of rays in each scene",
        note="s: mean length over the mean chord of the scene's box. Level: predicted over counted "
        "cost, with nothing fitted.",
        frame=frame,
        columns=[
            Column("scene"),
            Column("kind"),
            Column("rays", format=",d"),
            Column("hit", format=".2f"),
            Column("s", format=".2f"),
            Column("radius", format=".3g", help="how far ambient occlusion reaches, scene units"),
            Column("weight", "of the mixture", ".0%"),
            *(Column(f"α {name}", title, ".2f") for name, title in _ALPHAS.items()),
            *(Column(f"r {name}", name, ".3f") for name in names),
            *(Column(f"level {name}", f"level of {name}", ".2f") for name in levels),
            Column("cheapest", "cheapest tree"),
            Column("spread", "dearest over it", ".2f"),
        ],
    )


def _ranks(records: Records) -> Sheet:
    table = kind_ranks(records)
    kinds, builders = table["kind"].unique(), table["builder"].unique()
    frame = table.pivot(index="builder", columns="kind", values="rank").reindex(builders)
    return Sheet(
        name="kinds-builders",
        section=SECTION,
        title="Mean rank of the builders by counted cost, by kind of rays",
        note="1 is the cheapest tree of a scene.",
        frame=frame.rename_axis(columns=None).reset_index(),
        columns=[
            Column("builder"),
            *(Column(kind, format=".1f", smaller_is_better=True) for kind in kinds),
        ],
    )
