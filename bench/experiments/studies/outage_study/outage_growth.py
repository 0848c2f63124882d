"""Position drift without GNSS over runs, and paired comparisons of IMUs on the same runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.evaluation.ensembles.ensemble import estimate_quantile, pool_rmse
from bench.evaluation.ensembles.paired_draws import PairedRatio, compare_draws_of
from bench.experiments.studies.outage_study.outage_grades import find_time


@dataclass(frozen=True)
class Drift:
    """The error growth of one IMU in one phase over runs, at every second of the outage."""

    grid: FloatArray  # (D,) since the loss [s]
    grown: (
        FloatArray  # (R, D, 5) north, east, down [m]; horizontal error squared, its variance [m^2]; NaN: lost
    )
    law: Mapping[str, FloatArray]  # (D,) by source, horizontal, closed form, root mean square [m]

    @cached_property
    def good(self) -> FloatArray:
        """Return the runs (K, D, 5) with finite drift."""
        return self.grown[np.isfinite(self.grown).all(axis=(1, 2))]

    @property
    def lost(self) -> int:
        """Runs without a finite error at some time."""
        return len(self.grown) - len(self.good)

    @property
    def sizes(self) -> FloatArray:
        """Horizontal growth (K, D) [m]."""
        return np.asarray(np.hypot(self.good[:, :, 0], self.good[:, :, 1]))

    @cached_property
    def rms(self) -> FloatArray:
        """Root mean square of the horizontal growth, and its 95 % interval (D, 3) [m]."""
        return self._pool(np.square(self.sizes))

    @cached_property
    def error(self) -> FloatArray:
        """RMS of the horizontal error, including its initial value, and its 95 % interval (D, 3) [m]."""
        return self._pool(self.good[:, :, 3])

    def _pool(self, squares: FloatArray) -> FloatArray:
        if len(squares) < 2:
            return np.full((len(self.grid), 3), np.nan)
        found = [pool_rmse(column) for column in squares.T]
        return np.array([(one.value, one.low, one.high) for one in found])

    @property
    def claimed(self) -> FloatArray:
        """The horizontal error that the filter reports, root mean square over the runs (D,) [m]."""
        return np.asarray(np.sqrt(self.good[:, :, 4].mean(axis=0)))

    @property
    def whole_law(self) -> FloatArray:
        """The closed form of all sources together (D,) [m]."""
        return np.asarray(
            np.sqrt(sum((np.square(one) for one in self.law.values()), np.zeros(len(self.grid))))
        )

    def quantile(self, k: int, fraction: float) -> float | None:
        """Return a quantile of the horizontal growth over the runs at a time [m]."""
        return estimate_quantile(self.sizes[:, k], fraction).value if len(self.good) else None

    def find_times(self, limit: float) -> tuple[float | None, float | None, float | None]:
        """Return the time at which the drift exceeds a limit [m], and its 95 % interval [s]; None: never."""
        value, low, high = self.rms.T
        reached = (find_time(self.grid, column, limit) for column in (value, high, low))
        return tuple(reached)  # type: ignore[return-value]


def pair_units(
    drifts: Mapping[tuple[str, str], Drift], units: Sequence[str], phase: str, near: float = 60.0
) -> Iterator[PairedRatio]:
    """Yield each unit over the next better one, by their drift on the same runs near a time [s]."""
    kept = [name for name in units if not drifts[name, phase].lost]
    k = {name: int(np.argmin(np.abs(drifts[name, phase].grid - near))) for name in kept}
    ordered = sorted(kept, key=lambda name: float(drifts[name, phase].rms[k[name], 0]))
    for better, worse in pairwise(ordered):
        first, second = (drifts[name, phase].sizes[:, k[name]] for name in (better, worse))
        yield compare_draws_of((better, worse), first, second)
