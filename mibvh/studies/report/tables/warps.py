"""Tables on warps in lockstep: how their cost departs from that of scalar rays."""

from __future__ import annotations

from mibvh.studies.analyse.warps import deviation_by_builder, deviation_by_scene, warp_rules
from mibvh.studies.measure.warps import MOST_RAYS
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

_SECTION = "What warps in lockstep cost"


def warp_sheets(records: Records) -> list[Sheet]:
    """Return the deviation by builder and by scene, beside the timed one."""
    return [_by_builder(records), _by_scene(records)]


def _by_builder(records: Records) -> Sheet:
    return Sheet(
        name="warp-deviation",
        section=_SECTION,
        title="Warp cost against scalar: deviation by builder",
        note=f"Simulated warps ({warp_rules(records)}; at most {MOST_RAYS:,} rays per scene). A "
        "tree's deviation is the logarithm of warp cost over counted cost of the same rays, less "
        "the mean of the scene's trees: below zero, the tree gains from warps. The timed "
        "deviation is that of SIMD over scalar time, with this machine's lanes and kernel, "
        "noise included; the two need not agree.",
        frame=deviation_by_builder(records),
        columns=[
            Column("builder"),
            Column("simulated", "mean deviation", "+.1%"),
            Column("least", "least of a scene", "+.1%"),
            Column("greatest", "greatest", "+.1%"),
            Column("timed", "timed: mean", "+.1%"),
            Column("utilisation", "lanes busy", ".0%", "share of the warp cost"),
            Column("scenes"),
        ],
    )


def _by_scene(records: Records) -> Sheet:
    return Sheet(
        name="warp-deviation-scenes",
        section=_SECTION,
        title="Warp cost against scalar: size of the deviation, and its correlations",
        note="Mean size over a scene's trees. r is Pearson's over the trees, with the simulated "
        "deviation: of LCV, of the spread (standard deviation of a ray's counted cost over its "
        "mean), and of the timed deviation; the first two as logarithms.",
        frame=deviation_by_scene(records),
        columns=[
            Column("scene"),
            Column("simulated", "mean deviation", ".1%"),
            Column("largest", format=".1%"),
            Column("timed", "timed: mean", ".1%"),
            Column("r_lcv", "r of LCV", ".2f"),
            Column("r_spread", "r of the spread", ".2f"),
            Column("r_timed", "r of the timed", ".2f"),
        ],
    )
