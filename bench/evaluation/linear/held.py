"""Comparison of filters with the best linear filter on a flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import DEG, SAME_INSTANT
from bench.core.records.data import SensorData, Trajectory
from bench.core.records.run_records import ErrorSeries, Sensed
from bench.core.records.sensor_specs import SensorsSpec, TriadSpec
from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear.best_linear import Bound, bound_errors, find_epochs
from bench.evaluation.linear.path import make_path
from bench.evaluation.linear.quantities import QUANTITIES, compare_run
from bench.evaluation.linear.terms import check_sensors, model_errors
from bench.navigation.error_state_filter.aiding_sensors import BARO, FIXES
from bench.navigation.models.loose_tight import Fusion
from bench.navigation.models.smoother import Smoother

LINEAR = 10.0 * DEG
"""Largest standard deviation of an angle in a linear model [rad]: its sine is within 0.5 % of it."""
_RATE = 1.0  # of the epochs of a run that are held against the bound [Hz]


def check_aiding(label: str, estimator: object) -> None:
    """Raise ConfigError if a filter uses more than IMU, fixes and barometer."""
    one = estimator.filter if isinstance(estimator, Smoother) else estimator
    if not isinstance(one, Fusion):
        return
    more = [sensor.option for sensor in one.aiding() if sensor not in (FIXES, BARO)]
    more += [name for name in ("standstill", "nonholonomic", "coordinated") if getattr(one.options, name)]
    if more:
        raise ConfigError(
            f"{label}: the linear model knows IMU, fixes and barometer, not {', '.join(more)}; "
            "leave the option out"
        )


def check_flight(spec: SensorsSpec, estimators: Mapping[str, object]) -> None:
    """Raise ConfigError if sensors or filters by label have no linear model."""
    check_sensors(spec)
    for label, one in estimators.items():
        check_aiding(label, one)


def smooths(estimator: object) -> bool:
    """Return whether a filter uses the measurements after a time."""
    return isinstance(estimator, Smoother)


def bound_flight(
    truth: Trajectory, spec: SensorsSpec, data: SensorData, seed: int, t: FloatArray, *, smooth: bool
) -> Bound:
    """Return the covariances of the best linear filter of a record at epochs t (M,) [s]."""
    model = model_errors(truth, spec, seed, known_jumps=False)
    stops = [record.t for record in (data.fixes, data.baro) if record is not None]
    path = make_path(truth, spec.imu, np.concatenate([t, *stops]))
    output = np.searchsorted(path.t, t - SAME_INSTANT)
    return bound_errors(path, model, find_epochs(path, data), output, data.antenna_b, smooth=smooth)


def bound_in_range(
    truth: Trajectory,
    spec: SensorsSpec,
    data: SensorData,
    seed: int,
    t: FloatArray,
    *,
    smooth: bool,
    attitude_known: bool = False,
) -> Bound:
    """Return the covariances of :func:`bound_flight`, if a linear model of the attitude is valid.

    If the standard deviation of an angle exceeds `LINEAR`, initially or later, the sine of the angle is not
    the angle. Then, and if ``attitude_known``, the attitude is assumed exactly known and its variances are
    NaN. More knowledge means less error, so the other variances stay below those of any filter.
    """
    if not attitude_known:
        bound = bound_flight(truth, spec, data, seed, t, smooth=smooth)
        angles = np.einsum("...ii->...i", bound.causal)[:, 6:9].max(initial=0.0)
        if max(float(angles), float(np.diag(bound.start)[6:9].max())) <= LINEAR**2:
            return bound
    told = replace(spec, imu=replace(spec.imu, gyro=TriadSpec()), initial_tilt_sd=0.0, initial_heading_sd=0.0)
    bound = bound_flight(truth, told, data, seed, t, smooth=smooth)
    for covariance in (bound.causal, bound.smoothed):
        covariance[:, 6:9], covariance[:, :, 6:9] = np.nan, np.nan
    return bound


def variance_of(bound: Bound, *, smooth: bool) -> FloatArray:
    """Return the variances (M, 9) of position, velocity and attitude."""
    return np.asarray(np.einsum("mii->mi", bound.smoothed if smooth else bound.causal[:, :9, :9]))


def list_phases(t: FloatArray, begin: float, spec: SensorsSpec) -> dict[str, BoolArray]:
    """Return which epochs (M,) from ``begin`` [s] on have GNSS, and which have none."""
    late, lost = t >= begin, np.zeros(len(t), np.bool_)
    for start, stop in spec.gnss_outages:
        lost |= (t >= start) & (t < stop)
    return {"with GNSS": late & ~lost} | ({"without GNSS": late & lost} if (late & lost).any() else {})


def hold_run(
    truth: Trajectory,
    spec: SensorsSpec,
    sensed: Sensed,
    seed: int,
    begin: float,
    errors: Mapping[str, ErrorSeries],
    smoothing: Mapping[str, bool],
) -> dict[str, list[dict[str, Any]]]:
    """Return by filter the ratios of the errors of one run to the bound, a row by phase and quantity.

    ``smoothing`` tells which filters are held against the bound of smoothers; ``begin`` [s] is the end of
    the alignment window. Filters without errors have no rows.
    """
    t = next(iter(errors.values())).t
    step = max(1, round((len(t) - 1) / (_RATE * float(t[-1] - t[0])))) if len(t) > 1 else 1
    rows = np.arange(0, len(t), step)
    bound = bound_in_range(truth, spec, sensed.data, seed, t[rows], smooth=any(smoothing.values()))
    found: dict[str, list[dict[str, Any]]] = {}
    for label, series in errors.items():
        own = np.hstack([series.pos_n, series.vel_n, series.phi_n])[rows]
        least = variance_of(bound, smooth=smoothing[label])
        found[label] = [
            {"phase": phase, "quantity": quantity.title, "unit": quantity.unit, **asdict(ratio)}
            for phase, inside in list_phases(bound.t, begin, spec).items()
            for quantity in QUANTITIES
            if (ratio := compare_run(own[inside], least[inside], quantity)) is not None
        ]
    return found
