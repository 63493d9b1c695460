"""Where the units of measurements were until 0.1; see :mod:`mibvh.studies.record.quantities`."""

from __future__ import annotations

import warnings


def __getattr__(name: str) -> dict[str, str]:
    if name != "UNITS":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from mibvh.studies.record.quantities import quantities

    warnings.warn(
        "mibvh.studies.tables.UNITS is deprecated: use mibvh.studies.quantities()",
        DeprecationWarning,
        stacklevel=2,
    )
    return {quantity.name: quantity.unit for quantity in quantities().values()}
