"""What several test files build: statistical bands, records with rows changed, ensembles of runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.testing import assert_array_equal
from scipy.special import gammaincinv, ndtri

from bench.arrays import FloatArray
from bench.data import NavSolution, Sensed, Trajectory
from bench.evaluation import consistency, ensemble_consistency
from bench.evaluation.error_series import error_series

TAIL = 0.0005
"""Probability beyond each side of a 99.9 % band."""
Z = -float(ndtri(TAIL))
"""Half-width of the 99.9 % band of a standard normal, 3.29."""


def band(count: Any, states: int = 1) -> tuple[Any, Any]:
    """Return the 99.9 % band of the mean of ``count`` chi-square variables of ``states`` each.

    With one state: of the mean of ``count`` squared standard normals, or of a variance estimate with so many
    degrees of freedom over the true variance.

    Examples
    --------
    >>> low, high = band(100)
    >>> print(f"{low:.2f} to {high:.2f}")
    0.60 to 1.53
    """
    half = np.multiply(states / 2, count)
    return 2 * gammaincinv(half, TAIL) / count, 2 * gammaincinv(half, 1 - TAIL) / count


# --- records --------------------------------------------------------------------------------------------


def take(record: Any, rows: Any) -> Any:
    """Return rows of a record, in this order."""
    return type(record)(*(getattr(record, f.name)[rows] for f in fields(record)))


def put(record: Any, row: Any, **values: Any) -> Any:
    """Return a record with values of some rows replaced."""
    columns = {name: getattr(record, name).copy() for name in values}
    for name, value in values.items():
        columns[name][row] = value
    return replace(record, **columns)


def first_rows(truth: Trajectory, n: int) -> Trajectory:
    """Return the first ``n`` rows of a truth; air data, controls and events stay whole."""
    columns = {name: getattr(truth, name)[:n] for name in ("t", "lla", "vel_n", "q_nb")}
    columns |= {name: getattr(truth, name)[: n - 1] for name in ("dtheta_b", "dvel_b")}
    return replace(truth, **columns)


def assert_same_solution(solution: NavSolution, expected: NavSolution) -> None:
    """Assert that two solutions have the same bits, innovations included."""
    for name in ("t", "lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov", "extra", "extra_sd"):
        assert_array_equal(getattr(solution, name), getattr(expected, name), err_msg=name)
    for f in fields(solution.innovations):
        found, wanted = (getattr(s.innovations, f.name) for s in (solution, expected))
        assert_array_equal(found, wanted, err_msg=f.name)


# --- ensembles ------------------------------------------------------------------------------------------


@dataclass
class Ensemble:
    """NEES and NIS of an estimator over several draws of the sensors on one flight."""

    t: FloatArray = field(default_factory=lambda: np.empty(0))  # (M,) [s]
    nees: list[FloatArray] = field(default_factory=list)  # (M,) of each draw
    nis: dict[str, list[Any]] = field(default_factory=dict)  # by sensor, a series of each draw

    def averages(self) -> FloatArray:
        """Return the NEES of each draw averaged over time: these are independent of each other."""
        return np.mean(self.nees, axis=1)

    def pooled_nis(self) -> dict[str, Any]:
        """Return the mean NIS of each sensor over all draws with its band."""
        pooled = {}
        for sensor, each in self.nis.items():
            nis, dof = (np.concatenate([getattr(series, name) for series in each]) for name in ("nis", "dof"))
            pooled[sensor] = consistency.mean_nis(nis, dof)
        return pooled

    def claims(self, states: int = 9, nees_factor: float = 1.0) -> Any:
        """Return the verdict on the three claims of consistency: NEES at whole seconds, and NIS."""
        whole = np.abs(self.t - np.round(self.t)) < 1e-6
        nees = nees_factor * np.array(self.nees)[:, whole]
        return ensemble_consistency.check_consistency(nees, states, self.nis)


def ensemble(
    estimator: Any,
    truth: Trajectory,
    draw: Callable[[int], Sensed],
    runs: int,
    from_s: float,
    assumed: Any = None,
) -> Ensemble:
    """Run an estimator on the draws 0 ... runs - 1 of the sensors, judged from an instant on.

    ``assumed`` replaces the datasheets that the estimator believes.
    """
    found = Ensemble()
    for run in range(runs):
        sensed = draw(run)
        data = sensed.data if assumed is None else replace(sensed.data, specs=assumed)
        solution = estimator.run(data, sensed.initial)
        errors = error_series(truth, solution)
        late = errors.t >= from_s
        found.t = errors.t[late]
        found.nees.append(errors.nees[late])
        for sensor, series in consistency.nis_by_sensor(solution.innovations, from_s).items():
            found.nis.setdefault(sensor, []).append(series)
    return found
