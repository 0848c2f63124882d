"""How far each estimator is from the best linear one, on one flight.

The bound is the covariance of a Kalman filter of the whole truth model along the true motion, with errors
that are not Gaussian by an equal autocovariance (Tichavsky, Muravchik, Nehorai 1998): no causal linear
estimator errs less. Smoothers are held against the bound of smoothing, which uses the measurements to the
end. The errors of the estimators are drawn; a ratio of 1 leaves nothing to gain, with these sensors on this
flight.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from bench import pipeline, sensors
from bench.arrays import BoolArray, FloatArray
from bench.data import Trajectory
from bench.evaluation.linear.best_linear import Bound, bound_errors, find_epochs
from bench.evaluation.linear.path import make_path
from bench.evaluation.linear.terms import model_errors
from bench.navigation.smoother import Smoother
from bench.plots import series
from bench.plots.series import Plot
from bench.specs import Profile
from bench.studies.drawn_errors import (
    LEVEL,
    QUANTITIES,
    Draws,
    Flight,
    Quantity,
    check_aiding,
    draw_errors,
    find_choice,
    key_instants,
    output_times,
    root_mean_interval,
    split_draws,
)
from bench.studies.study import Count, Findings, StudyOptions, StudyTable, Words, Work

_PARTS = 4  # of the draws of an estimator, so that all workers have something to do


class Options(StudyOptions):
    """What may be asked."""

    profile: str
    """name of a shipped profile, or the path of a .toml file"""
    estimators: Words | None = None
    """estimators to hold against the bound; left out: those of the profile"""
    imu: str | None = None
    """IMU of the catalog instead of that of the profile"""
    draws: Count = 20
    """noise draws of each estimator"""


def run(options: Options, work: Work) -> Findings:
    """Return the bound and the ratio of each estimator to it."""
    flight = Flight(options.profile, options.imu, options.estimators)
    profile, truth = flight.load()
    for choice in profile.estimators:
        check_aiding(choice)
    labels = [choice.label for choice in profile.estimators]
    smoothing = {label: _smooths(profile, label) for label in labels}
    work.progress("the best linear estimator", 0, 1)
    bound = bound_flight(profile, truth, smooth=any(smoothing.values()))
    parts = list(split_draws(options.draws, _PARTS))
    jobs = [Draws(flight, label, first, count) for label in labels for first, count in parts]
    found = work.map("drawing the estimators", draw_errors, jobs, first=(0,))
    errors = {
        label: np.concatenate(found[k * len(parts) : (k + 1) * len(parts)]) for k, label in enumerate(labels)
    }
    phases = _list_phases(profile, bound.t)
    columns: dict[str, list[Any]] = {
        name: []
        for name in ("estimator", "phase", "quantity", "rmse", "bound", "ratio", "low", "high", "unit")
    }
    told, good = [], True
    for label in labels:
        least = variance_of(bound, smooth=smoothing[label])
        for phase, rows in phases.items():
            texts = []
            for quantity in QUANTITIES:
                row = _hold(errors[label], least, quantity, rows)
                values = (label, phase, quantity.title, *row, quantity.unit)
                for column, value in zip(columns.values(), values, strict=True):
                    column.append(value)
                if row[2] is not None and row[4] is not None:
                    texts.append(f"{quantity.title} {row[2]:.3g}")
                    good = good and row[4] >= 1.0
            kind = "smoothing bound" if smoothing[label] else "bound"
            told.append(f"{label}, {phase}, over the {kind}: {', '.join(texts) or 'no errors'}.")
    below = "No estimator is below its bound" if good else "An estimator is below its bound"
    told.append(f"{below}, by {100.0 * LEVEL:g} % intervals of {options.draws} draws.")
    title = f"Root mean square errors over {options.draws} draws, over those of the best linear estimator"
    return Findings(
        verdicts=tuple(told),
        tables=(
            StudyTable("bound", title, columns, {}),
            _tabulate(bound, key_instants(bound.t, profile).values()),
        ),
        figures=tuple(_plot(bound, errors, smoothing)),
        draws=options.draws,
        good=good,
    )


def bound_flight(profile: Profile, truth: Trajectory, *, smooth: bool) -> Bound:
    """Return the covariances of the best linear estimator on a flight, at the instants of a study."""
    t = output_times(truth, profile)
    sensed = sensors.sense(truth, profile.sensors, profile.seed, 0)
    model = model_errors(truth, profile.sensors, profile.seed, known_jumps=False)
    data = sensed.data
    stops = [record.t for record in (data.fixes, data.baro) if record is not None]
    path = make_path(truth, profile.sensors.imu, np.concatenate([t, *stops]))
    output = np.searchsorted(path.t, t - 1e-6)
    return bound_errors(path, model, find_epochs(path, data), output, data.antenna_b, smooth=smooth)


def variance_of(bound: Bound, *, smooth: bool) -> FloatArray:
    """Return the variances (M, 9) of position, velocity and attitude."""
    return np.asarray(np.einsum("mii->mi", bound.smoothed if smooth else bound.causal[:, :9, :9]))


def _smooths(profile: Profile, label: str) -> bool:
    return isinstance(pipeline.build_estimator(find_choice(profile, label)), Smoother)


def _list_phases(profile: Profile, t: FloatArray) -> dict[str, BoolArray]:
    """Return which instants (M,) count: after the alignment window, with GNSS and without."""
    late = t >= profile.evaluation_from
    lost = np.zeros(len(t), bool)
    for start, stop in profile.sensors.gnss_outages:
        lost |= (t >= start) & (t < stop)
    return {"with GNSS": late & ~lost} | ({"without GNSS": late & lost} if (late & lost).any() else {})


def _hold(
    errors: FloatArray, least: FloatArray, quantity: Quantity, rows: BoolArray
) -> tuple[float | None, float, float | None, float | None, float | None]:
    """Return RMSE, bound, their ratio and its interval, by the spread of the mean squares of the draws."""
    bound2 = float(np.mean(quantity.sd(least[rows]) ** 2))
    squares = np.mean(quantity.sd(np.square(errors[:, rows])) ** 2, axis=1)
    if not np.isfinite(squares).all():
        return None, bound2**0.5, None, None, None
    mean, draws = float(squares.mean()), len(squares)
    freedom = draws * max(1.0, 2.0 * mean**2 / float(squares.var(ddof=1)))  # of a chi-square as broad
    low, high = root_mean_interval(mean**0.5, freedom)
    return mean**0.5, bound2**0.5, (mean / bound2) ** 0.5, low / bound2**0.5, high / bound2**0.5


def _tabulate(bound: Bound, at: Iterable[int]) -> StudyTable:
    """Return the standard deviations of the best linear estimator and of the best smoother at instants."""
    rows = list(at)
    columns: dict[str, Any] = {"t_s": bound.t[rows].tolist()}
    units = {"t_s": "s"}
    for smooth in (False, True)[: 2 if len(bound.smoothed) else 1]:
        least = variance_of(bound, smooth=smooth)[rows]
        for quantity in QUANTITIES:
            stem, unit = quantity.name.rsplit("_", 1)
            name = f"{stem}_smoothed_{unit}" if smooth else quantity.name
            columns[name], units[name] = quantity.sd(least).tolist(), quantity.unit
    return StudyTable("best_linear", "Standard deviations of the best linear estimator", columns, units)


def _plot(bound: Bound, errors: dict[str, FloatArray], smoothing: dict[str, bool]) -> list[Plot]:
    colours = series.estimator_colours(errors)
    plots = []
    for quantity in QUANTITIES:
        lines = []
        for label, drawn in errors.items():
            rms = np.sqrt(np.mean(quantity.sd(np.square(drawn)) ** 2, axis=0))
            lines.append(series.draw_line(label, bound.t, rms, f"{label}, drawn", colours[label]))
        causal = quantity.sd(variance_of(bound, smooth=False))
        lines.append(series.draw_line("bound", bound.t, causal, "bound", series.TRUTH))
        if any(smoothing.values()):
            smoothed = quantity.sd(variance_of(bound, smooth=True))
            lines.append(series.draw_line("smoothing", bound.t, smoothed, "smoothing bound", series.FIX))
        key = quantity.title.replace(" ", "-")
        title = f"{quantity.title}, 1 sigma [{quantity.unit}]"
        plots.append(Plot(("bound", key), title, tuple(lines), log="y"))
    return plots
