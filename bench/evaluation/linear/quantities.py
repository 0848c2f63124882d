"""Errors of position, velocity and attitude, and their ratios to the errors of the best linear filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import DEG

LEVEL = 0.999
"""Probability of an interval."""
_ALIKE = 1e-6  # least variance of mean squares over their square, so that draws may be alike


@dataclass(frozen=True, slots=True)
class Quantity:
    """Quantity derived from the errors of position, velocity and attitude: the root of a sum of variances."""

    name: str  # as in columns, with its unit
    title: str
    unit: str
    states: tuple[int, ...]
    scale: float = 1.0  # SI over unit

    def sd(self, variance: FloatArray) -> FloatArray:
        """Return the figure of variances (..., 9)."""
        return np.asarray(np.sqrt(variance[..., self.states].sum(axis=-1)) / self.scale)


QUANTITIES = (
    Quantity("horizontal_m", "horizontal position", "m", (0, 1)),
    Quantity("height_m", "height", "m", (2,)),
    Quantity("velocity_mps", "horizontal velocity", "m/s", (3, 4)),
    Quantity("tilt_deg", "tilt", "deg", (6, 7), DEG),
    Quantity("heading_deg", "heading", "deg", (8,), DEG),
)


@dataclass(frozen=True, slots=True)
class Ratio:
    """Ratio of a root mean square error to the bound of the best linear filter, with its `LEVEL` interval."""

    rmse: float
    bound: float
    ratio: float
    low: float
    high: float


def root_mean_interval(rms: FloatArray, freedom: float) -> tuple[FloatArray, FloatArray]:
    """Return the `LEVEL` interval of standard deviations estimated as ``rms``.

    ``freedom``: degrees of freedom of each estimate (chi-square), such as the number of runs.
    """
    tail = 0.5 * (1.0 - LEVEL)
    low, high = (2.0 * float(gammaincinv(0.5 * freedom, p)) / freedom for p in (tail, 1.0 - tail))
    return rms / high**0.5, rms / low**0.5


def compare_draws(errors: FloatArray, least: FloatArray, quantity: Quantity) -> Ratio | None:
    """Return the ratio of the errors (R, M, 9) of R runs to variances (M, 9); None if either is unknown."""
    squares = np.mean(quantity.sd(np.square(errors)) ** 2, axis=1)
    if not np.isfinite(squares).all():
        return None
    return _make_ratio(float(squares.mean()), least, quantity, count_freedom(squares))


def count_freedom(squares: FloatArray) -> float:
    """Return the degrees of freedom of the chi-square as broad as the mean squares (R,) of R runs.

    Their spread says how many independent errors they hold. Of a few draws it is itself not well known, so
    its upper 95 % limit counts.
    """
    mean, draws = float(squares.mean()), len(squares)
    widest = float(np.sum((squares - mean) ** 2)) / (2.0 * float(gammaincinv(0.5 * (draws - 1), 0.05)))
    return draws * max(1.0, 2.0 * mean**2 / max(widest, _ALIKE * mean**2))


def compare_run(errors: FloatArray, least: FloatArray, quantity: Quantity) -> Ratio | None:
    """Return the ratio of the errors (M, 9) of one run to variances (M, 9); None if either is unknown.

    The correlation in time of the errors, in units of the bound, says how many independent ones they hold:
    ``M / (1 + 2 sum rho^2)`` of each axis.
    """
    mean = float(np.mean(quantity.sd(np.square(errors)) ** 2))
    if not np.isfinite(mean) or not np.isfinite(quantity.sd(least)).all():
        return None
    freedom = 0.0
    for state in quantity.states:
        e = errors[:, state] / np.sqrt(least[:, state])
        spectrum = np.abs(np.fft.rfft(e, 2 * len(e))) ** 2
        lagged = np.fft.irfft(spectrum)[: len(e)]
        rho = lagged / lagged[0] if lagged[0] > 0 else np.eye(1, len(e))[0]
        freedom += max(1.0, len(e) / (1.0 + 2.0 * float(np.sum(rho[1:] ** 2))))
    return _make_ratio(mean, least, quantity, freedom)


def _make_ratio(mean: float, least: FloatArray, quantity: Quantity, freedom: float) -> Ratio | None:
    bound = float(np.mean(quantity.sd(least) ** 2)) ** 0.5
    if not np.isfinite(bound):
        return None
    low, high = root_mean_interval(np.array(mean**0.5), freedom)
    return Ratio(mean**0.5, bound, mean**0.5 / bound, float(low) / bound, float(high) / bound)
