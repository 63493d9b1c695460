"""The numbers of a tree that a study measures with rays and a stopwatch, each declared once.

Those of the tree alone are declared by the metrics (``mibvh/metrics/cost.py``, ``shape.py``), those
of an experiment by the experiment. Every column of the tables of trees, every measurement of
``results.parquet`` and everything that predictors are compared with comes from here.
"""

from __future__ import annotations

from mibvh.errors import MibvhError
from mibvh.metrics.registry import DIGITS, Quantity, metrics
from mibvh.studies.record.experiment import experiments

#: Computed by :mod:`mibvh.studies.measure.counts`.
COUNTED = (
    Quantity(
        name="counted_cost",
        unit="cost",
        rays="all",
        heading="counted cost",
        format=".2f",
        help="1.2 per inner node and 1.0 per triangle, per ray",
        smaller_is_better=True,
        main=True,
        target=True,
        figure="counted",
        caption="Counted cost per ray against the prediction: exact for its rays.",
        place=4,
    ),
    Quantity(
        name="lcv",
        unit="leaves",
        rays="all",
        heading="LCV",
        format=".3f",
        help="leaf count variability",
        smaller_is_better=True,
        main=True,
        place=3,
    ),
    Quantity(
        name="inner_per_ray",
        unit="nodes/ray",
        rays="all",
        heading="inner",
        format=".1f",
        help="inner nodes visited per ray",
        place=20,
    ),
    Quantity(
        name="leaves_per_ray",
        unit="leaves/ray",
        rays="all",
        heading="leaves",
        format=".2f",
        help="leaves visited per ray",
        place=21,
    ),
    Quantity(
        name="triangles_per_ray",
        unit="tests/ray",
        rays="all",
        heading="triangles",
        format=".2f",
        help="triangles tested per ray",
        place=22,
    ),
    Quantity(name="inner_deviation", unit="nodes/ray", rays="all"),
    Quantity(name="steps_deviation", unit="steps/ray", rays="all"),
    # Standard deviation over the rays of what one costs.
    Quantity(name="cost_deviation", unit="cost", rays="all"),
    Quantity(
        name="lane_utilisation",
        unit="share",
        rays="all",
        heading="lanes busy",
        format=".0%",
        help="active lane-steps over issued ones",
        place=23,
    ),
    Quantity(name="epo_starts", unit="cost", rays="all"),
    Quantity(name="epo_starts_error", unit="cost", rays="all"),
    Quantity(name="epo_ends", unit="cost", rays="all"),
    Quantity(name="point_query", unit="cost", rays="all"),
    Quantity(name="hit_share", unit="share", rays="all"),
    Quantity(name="length_ratio", unit="share", rays="all"),
    Quantity(name="sah_lines", unit="cost", rays="lines"),
    Quantity(name="sah_lines_error", unit="cost", rays="lines"),
    Quantity(name="touched", unit="cost", rays="lines"),
    Quantity(name="line_share", unit="share", rays="lines"),
)

#: Computed by :mod:`mibvh.studies.measure.warps`.
SIMULATED = (
    Quantity(
        name="warp_cost",
        unit="cost",
        rays="warp",
        heading="warp cost",
        format=".2f",
        help="issued by simulated warps in lockstep, times their width, per ray",
        smaller_is_better=True,
        main=True,
        target=True,
        figure="warp",
        caption="Cost per ray in simulated warps against the prediction: exact for its rays.",
        place=7,
    ),
    # Of the same rays, each in a lane of its own.
    Quantity(name="warp_scalar_cost", unit="cost", rays="warp"),
    Quantity(
        name="warp_overhead",
        unit="factor",
        rays="warp",
        heading="warp / scalar",
        format=".2f",
        help="warp cost over counted cost of the same rays",
        place=24,
    ),
    Quantity(
        name="warp_utilisation",
        unit="share",
        rays="warp",
        heading="warp lanes busy",
        format=".0%",
        help="share of the warp cost in which a lane had work",
        place=25,
    ),
)

#: Computed by :mod:`mibvh.studies.measure.times`.
TIMED = (
    Quantity(
        name="scalar_ns",
        unit="ns/ray",
        rays="scalar",
        heading="scalar ns/ray",
        format=DIGITS,
        help="kernel time, one lane per packet",
        smaller_is_better=True,
        main=True,
        target=True,
        figure="scalar",
        caption="Scalar time per ray against the prediction.",
        error="scalar_error",
        place=5,
    ),
    Quantity(name="scalar_error", unit="share", rays="scalar"),
    Quantity(
        name="simd_ns",
        unit="ns/ray",
        rays="simd",
        heading="SIMD ns/ray",
        format=DIGITS,
        help="kernel time, all lanes",
        smaller_is_better=True,
        main=True,
        target=True,
        figure="simd",
        caption="SIMD time per ray against the prediction.",
        error="simd_error",
        place=6,
    ),
    Quantity(name="simd_error", unit="share", rays="simd"),
    # By either clock of the stopwatch; the times above are by the better of the two.
    Quantity(name="scalar_ns_kernel", unit="ns/ray", rays="scalar"),
    Quantity(name="scalar_ns_process", unit="ns/ray", rays="scalar"),
    Quantity(name="simd_ns_kernel", unit="ns/ray", rays="simd"),
    Quantity(name="simd_ns_process", unit="ns/ray", rays="simd"),
    # The first tree, timed a second time under another name.
    Quantity(name="scalar_ns_again", unit="ns/ray", rays="scalar", per_tree=False),
    Quantity(name="simd_ns_again", unit="ns/ray", rays="simd", per_tree=False),
)


def quantities() -> dict[str, Quantity]:
    """Return all quantities by name: of metrics, counted, simulated, timed, of experiments.

    Raises
    ------
    MibvhError
        If two have one name.
    """
    found: dict[str, Quantity] = {}
    of_metrics = (q for metric in metrics() for q in metric.quantities)
    of_experiments = (q for experiment in experiments() for q in experiment.quantities)
    for quantity in (*of_metrics, *COUNTED, *SIMULATED, *TIMED, *of_experiments):
        if quantity.name in found:
            raise MibvhError(f"two quantities are called {quantity.name}")
        found[quantity.name] = quantity
    return found


def columns(main: bool = False) -> list[Quantity]:
    """Return the quantities that tables of trees show, in the order of the columns.

    Parameters
    ----------
    main : bool
        Only those of the table over all scenes.
    """
    shown = [q for q in quantities().values() if q.heading and (q.main or not main)]
    return sorted(shown, key=lambda quantity: quantity.place)


def targets() -> list[Quantity]:
    """Return the measurements that predictors are compared with, in the order of the tables."""
    return [quantity for quantity in columns() if quantity.target]
