"""Results that a study failed to get."""

from __future__ import annotations

from mibvh.metrics.predictors import faults
from mibvh.studies.record.quantities import targets
from mibvh.studies.record.scene import Missing, Records, samples


def missing(records: Records) -> list[tuple[str, Missing]]:
    """Return all missing results, each with the name of its scene.

    That is what the study went on without, and predictors of the user's own that fail.
    """
    found = [(record.scene, one) for record in records for one in record.missing]
    for target in targets():
        timed = [record for record in records if record.knows(target.name)]
        known = samples(timed, target.name)
        for place, record in enumerate(timed):
            for name, why in faults(known, place).items():
                found.append((record.scene, Missing(f"predictor {name}", str(why))))
    return list(dict.fromkeys(found))
