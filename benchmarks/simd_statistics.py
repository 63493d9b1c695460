"""What explains the deviation of SIMD from scalar cost: over all trees, less each scene's mean."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from simd_measured import Row

F64 = npt.NDArray[np.float64]

#: Products of quantities to powers: the slopes found over the scenes, rounded.
EQUATIONS: dict[str, dict[str, float]] = {
    "(std of cost / mean)^1/2": {"cost_cv": 0.5},
    "(std of cost / mean)^1/2 x LCV^1/4": {"cost_cv": 0.5, "lcv": 0.25},
}
_RESAMPLED = 1000


class Scenes:
    """The measured trees, scene by scene."""

    def __init__(self, rows: list[Row]) -> None:
        rows_of = {row.scene: [r for r in rows if r.scene == row.scene] for row in rows}
        most = max(map(len, rows_of.values()), default=0)
        #: Only scenes of which all trees are measured.
        self.rows = {name: trees for name, trees in rows_of.items() if len(trees) == most}
        self.names = list(self.rows)

    def deviation(self, kernel: str) -> list[F64]:
        """Logarithm of SIMD over scalar cost, less the scene's mean: an array per scene."""
        return [
            centred([row.costs[kernel] / row.scalar for row in self.rows[name]])
            for name in self.names
        ]

    def quantity(self, name: str) -> list[F64]:
        """Logarithm of a quantity, less the scene's mean."""
        return [centred([row.quantities[name] for row in self.rows[scene]]) for scene in self.names]

    def equation(self, name: str) -> list[F64]:
        """Logarithm of a product of quantities to powers, less the scene's mean."""
        terms = [
            [power * x for x in self.quantity(quantity)]
            for quantity, power in EQUATIONS[name].items()
        ]
        return [np.sum(scene, axis=0) for scene in zip(*terms, strict=True)]


def centred(values: list[float]) -> F64:
    """Logarithms of some values, less their mean."""
    logarithms = np.log(values)
    return logarithms - logarithms.mean()


def pooled_r(x: list[F64], y: list[F64]) -> float:
    """Pearson's r over all trees of all scenes."""
    return float(np.corrcoef(np.concatenate(x), np.concatenate(y))[0, 1])


def explained(x: list[F64], y: list[F64], fitted: bool = True) -> F64:
    """(scenes, 2): squares of the deviation that are left, and all.

    A scene's deviation is predicted by the quantity times a slope: that of the other scenes, or 1.
    """
    slopes = [slope([x], y, i)[0] if fitted else 1.0 for i in range(len(x))]
    return np.array(
        [(((v - b * u) ** 2).sum(), (v**2).sum()) for u, v, b in zip(x, y, slopes, strict=True)]
    )


def slope(columns: list[list[F64]], y: list[F64], without: int) -> F64:
    """Slopes of some quantities together, by least squares over all scenes but one."""
    others = [j for j in range(len(y)) if j != without]
    xs = np.stack([np.concatenate([x[j] for j in others]) for x in columns], axis=1)
    return np.linalg.lstsq(xs, np.concatenate([y[j] for j in others]), rcond=None)[0]


def together(columns: list[list[F64]], y: list[F64]) -> list[F64]:
    """Deviation that some quantities predict, each scene with the slopes of the others."""
    return [np.stack([x[i] for x in columns], axis=1) @ slope(columns, y, i) for i in range(len(y))]


def share(squares: F64) -> float:
    """Share of the squared deviation that is explained."""
    left, all_of_it = squares.sum(axis=0)
    return float(1 - left / all_of_it)


def interval(values: list[float]) -> str:
    """The middle 95% of bootstrapped values."""
    low, high = np.percentile(values, [2.5, 97.5])
    return f"{low:+.2f} to {high:+.2f}"


def resampled(count: int) -> npt.NDArray[np.int64]:
    """Scenes drawn with replacement, many times."""
    return np.random.default_rng(0).integers(0, count, (_RESAMPLED, count))
