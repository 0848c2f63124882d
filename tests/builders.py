"""What several test files build: statistical bands, records with rows changed, ensembles of runs.

And whether a process that they started still runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import psutil
from numpy.testing import assert_array_equal
from scipy.special import gammaincinv, ndtri, stdtrit

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import NavSolution, Trajectory, no_air, no_controls, no_events
from bench.core.records.run_records import Sensed
from bench.evaluation.consistency import chi_square
from bench.evaluation.ensembles import ensemble_consistency
from bench.evaluation.errors.error_series import error_series
from bench.navigation import mechanization

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


def student(draws: int) -> float:
    """Return the half-width of the 99.9 % band of the mean of normal draws, in standard errors of theirs.

    Examples
    --------
    >>> print(f"{student(10):.2f} {student(40):.2f}")
    4.78 3.56
    """
    return float(stdtrit(draws - 1, 1.0 - TAIL))


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


# --- truths by formula ----------------------------------------------------------------------------------


def at_rest(
    duration: float, rate: float, lla: Any, roll: float = 0.0, pitch: float = 0.0, heading: float = 0.0
) -> Trajectory:
    """Return a truth that stands: what the Earth does to a strapped-down unit, exactly."""
    n = round(duration * rate)
    q = rotation.from_euler(roll, pitch, heading)
    earth_n = earth.EARTH_RATE * np.array([np.cos(lla[0]), 0.0, -np.sin(lla[0])])
    increments = [
        np.tile(rotation.rotate(rotation.conjugate(q), v_n) / rate, (n, 1))
        for v_n in (earth_n, -earth.gravity_n(lla[0], lla[2]))
    ]
    columns = [np.tile(column, (n + 1, 1)) for column in (np.asarray(lla, float), np.zeros(3), q)]
    return Trajectory(np.arange(n + 1) / rate, *columns, *increments, no_air(), no_controls(), no_events())


def steered(
    duration: float,
    rate: float,
    lla: Any,
    heading: float,
    speed: float = 0.0,
    *,
    push: Callable[[FloatArray], FloatArray] = np.zeros_like,
    turn: Callable[[FloatArray], FloatArray] = np.zeros_like,
    climb: Callable[[FloatArray], FloatArray] = np.zeros_like,
) -> Trajectory:
    """Return a truth that moves along its nose: push [m/s^2], turn [rad/s] and climb [m/s] by time.

    The body stays level. The increments are those of a motion over the ellipsoid, and the truth is what the
    mechanization makes of them: an error-free navigator returns it exactly, wherever it starts.
    """
    n = round(duration * rate)
    t = np.arange(n + 1) / rate
    middle, dt = 0.5 * (t[1:] + t[:-1]), 1.0 / rate

    def middles(start: float, slope: FloatArray) -> FloatArray:
        ends = start + dt * np.concatenate([[0.0], np.cumsum(slope)])
        return np.asarray(0.5 * (ends[1:] + ends[:-1]))

    pushed, turned, up = push(middle), turn(middle), climb(middle)
    v, psi = middles(speed, pushed), middles(heading, turned)
    s, c, zero = np.sin(psi), np.cos(psi), np.zeros(n)
    lat = middles(lla[0], v * c / (earth.radii(lla[0])[0] + lla[2]))
    alt = middles(lla[2], up)
    R_M, R_P = earth.radii(lat)
    vel_n = np.column_stack([v * c, v * s, -up])
    w_ie = earth.EARTH_RATE * np.column_stack([np.cos(lat), zero, -np.sin(lat)])
    w_en = np.column_stack([v * s / (R_P + alt), -v * c / (R_M + alt), -v * s * np.tan(lat) / (R_P + alt)])
    rise = np.gradient(up, dt) if n > 1 else zero
    acc_n = np.column_stack([pushed * c - v * turned * s, pushed * s + v * turned * c, -rise])
    f_n = acc_n + np.cross(2 * w_ie + w_en, vel_n) - earth.gravity_n(lat, alt)
    back = rotation.conjugate(rotation.from_euler(zero, zero, psi))
    dtheta = dt * (rotation.rotate(back, w_ie + w_en) + np.column_stack([zero, zero, turned]))
    dvel = dt * rotation.rotate(back, f_n)
    vel = speed * np.array([np.cos(heading), np.sin(heading), 0.0]) - [0.0, 0.0, up[0]]
    q = rotation.from_euler(0.0, 0.0, heading)
    nav = mechanization.propagate(lla, vel, q, np.full(n, dt), dtheta, dvel)
    nav[:, 1] = np.mod(nav[:, 1] + np.pi, 2 * np.pi) - np.pi
    return Trajectory(
        t, nav[:, :3], nav[:, 3:6], rotation.continuous(nav[:, 6:]), dtheta, dvel, no_air(), no_controls(),
        no_events(),
    )  # fmt: skip


# --- ensembles ------------------------------------------------------------------------------------------


@dataclass
class Ensemble:
    """NEES and NIS of a filter over several runs of the sensors on one flight."""

    t: FloatArray = field(default_factory=lambda: np.empty(0))  # (M,) [s]
    nees: list[FloatArray] = field(default_factory=list)  # (M,) of each run
    nis: dict[str, list[Any]] = field(default_factory=dict)  # by sensor, a series of each run

    def averages(self) -> FloatArray:
        """Return the NEES of each run averaged over time: these are independent of each other."""
        return np.mean(self.nees, axis=1)

    def pooled_nis(self) -> dict[str, Any]:
        """Return the mean NIS of each sensor over all draws with its band."""
        pooled = {}
        for sensor, each in self.nis.items():
            nis, dof = (np.concatenate([getattr(series, name) for series in each]) for name in ("nis", "dof"))
            pooled[sensor] = chi_square.mean_nis(nis, dof)
        return pooled

    def claims(self, states: int = 9, nees_factor: float = 1.0) -> Any:
        """Return the verdict on the three tests of consistency: NEES at whole seconds, and NIS."""
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
    """Run a filter on the runs 0 ... runs - 1 of the sensors, evaluated from a time on.

    ``assumed`` replaces the datasheets that the filter assumes.
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
        for sensor, series in chi_square.nis_by_sensor(solution.innovations, from_s).items():
            found.nis.setdefault(sensor, []).append(series)
    return found


def is_running(pid: int) -> bool:
    """Whether a process lives; one that ended and waits for its parent does not."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
