"""The distance of each filter from the best linear filter, on one flight.

The bound is the covariance of a Kalman filter with the whole truth model along the true motion. Errors that
are not Gaussian are replaced by Gaussian ones with the same autocovariance (Tichavsky, Muravchik, Nehorai
1998). No causal linear filter has a smaller error. Smoothers are compared with the bound of smoothing, which
uses the measurements to the end. The errors of the filters come from runs; at a ratio of 1 nothing is left to
gain with these sensors on this flight.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import astuple
from typing import Any

import numpy as np

from bench import pipeline
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import DEG
from bench.core.records.findings import Findings, FindingTable, series
from bench.core.records.findings.series import Plot
from bench.core.records.specs import Profile
from bench.evaluation.linear.best_linear import Bound
from bench.evaluation.linear.held import (
    LINEAR,
    bound_in_range,
    check_flight,
    list_phases,
    smooths,
    variance_of,
)
from bench.evaluation.linear.quantities import LEVEL, QUANTITIES, compare_draws
from bench.experiments.studies.drawn_errors import (
    Draws,
    UnitFlight,
    draw_errors,
    key_instants,
    output_times,
    split_draws,
)
from bench.experiments.studies.study import Count, StudyWorkers, UnitOptions, Words, ask_each
from bench.navigation.estimator import Estimator
from bench.simulation import sensors

STUDY = 6, "bound"
QUESTION = "How far is each filter from the best linear filter, on a flight?"

_PARTS = 4  # of the runs of a filter, so that all workers have something to do


class Options(UnitOptions):
    """Options of the study."""

    estimators: Words | None = None
    """filters to compare with the bound; default: all of the profile"""
    runs: Count = 20
    """runs of each filter"""


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return the bound and the ratio of each filter to it."""
    return ask_each("bound", options, work, lambda one: _check(_choose(one).read()), _ask)


def _choose(options: Options) -> UnitFlight:
    return UnitFlight(options.profile, options.imu, options.estimators, options.overrides, options.seed)


def _check(profile: Profile) -> Mapping[str, Estimator]:
    """Return the filters by label; ConfigError if one has no linear model."""
    built = pipeline.build_estimators(profile)
    check_flight(profile.sensors, built)
    return built


def _ask(options: Options, work: StudyWorkers) -> Findings:
    flight = _choose(options)
    profile, truth = flight.load()
    built = _check(profile)
    labels, smoothing = list(built), {label: smooths(one) for label, one in built.items()}
    work.progress("the best linear filter", 0, 1)
    data = sensors.sense(truth, profile.sensors, profile.seed, 0).data
    t = output_times(truth, profile)
    bound = bound_in_range(truth, profile.sensors, data, profile.seed, t, smooth=any(smoothing.values()))
    parts = list(split_draws(options.runs, _PARTS))
    jobs = [Draws(flight, label, first, count) for label in labels for first, count in parts]
    found = work.map("running the filters", draw_errors, jobs, first=(0,))
    errors = {
        label: np.concatenate(found[k * len(parts) : (k + 1) * len(parts)]) for k, label in enumerate(labels)
    }
    phases = list_phases(bound.t, profile.evaluation.begin, profile.sensors)
    columns, told, good = hold_draws(bound, errors, smoothing, phases)
    below = "No filter is below its bound" if good else "A filter is below its bound"
    if np.isnan(variance_of(bound, smooth=False)).any():
        told.append(
            f"An angle is not known within {LINEAR / DEG:g} deg, the range of a linear model: no attitude is "
            "held against a bound, and the bound of position and velocity assumes a known attitude."
        )
    told.append(f"{below}, by {100.0 * LEVEL:g} % intervals of {options.runs} runs.")
    title = f"RMS errors over {options.runs} runs / errors of the best linear filter"
    return Findings(
        verdicts=tuple(told),
        tables=(
            FindingTable("bound", title, columns, {}),
            tabulate_bound(bound, key_instants(bound.t, profile).values()),
        ),
        figures=tuple(plot_bound(bound, errors, smoothing)),
        runs=options.runs,
        good=good,
    )


def hold_draws(
    bound: Bound,
    errors: Mapping[str, FloatArray],
    smoothing: Mapping[str, bool],
    phases: Mapping[str, BoolArray],
) -> tuple[dict[str, list[Any]], list[str], bool]:
    """Return the ratios of errors (R, M, 9) to the bound by filter, sentences, and whether all reach 1."""
    columns: dict[str, list[Any]] = {
        name: []
        for name in ("estimator", "phase", "quantity", "rmse", "bound", "ratio", "low", "high", "unit")
    }
    told, good = [], True
    for label, drawn in errors.items():
        least = variance_of(bound, smooth=smoothing[label])
        for phase, rows in phases.items():
            texts = []
            for quantity in QUANTITIES:
                held = compare_draws(drawn[:, rows], least[rows], quantity)
                if held is None:
                    continue
                values = (label, phase, quantity.title, *astuple(held), quantity.unit)
                for column, value in zip(columns.values(), values, strict=True):
                    column.append(value)
                texts.append(f"{quantity.title} {held.ratio:.3g}")
                good = good and held.high >= 1.0
            kind = "smoothing bound" if smoothing[label] else "bound"
            told.append(f"{label}, {phase}, over the {kind}: {', '.join(texts) or 'no errors'}.")
    return columns, told, good


def tabulate_bound(bound: Bound, at: Iterable[int]) -> FindingTable:
    """Return the standard deviations of the best linear filter and of the best smoother at epochs."""
    rows = list(at)
    columns: dict[str, Any] = {"t_s": bound.t[rows].tolist()}
    units = {"t_s": "s"}
    for smooth in (False, True)[: 2 if len(bound.smoothed) else 1]:
        least = variance_of(bound, smooth=smooth)[rows]
        for quantity in QUANTITIES:
            stem, unit = quantity.name.rsplit("_", 1)
            name = f"{stem}_smoothed_{unit}" if smooth else quantity.name
            columns[name], units[name] = quantity.sd(least).tolist(), quantity.unit
    return FindingTable("best_linear", "Standard deviations of the best linear filter", columns, units)


def plot_bound(bound: Bound, errors: dict[str, FloatArray], smoothing: dict[str, bool]) -> list[Plot]:
    """Return for each quantity the errors of the filters and the bounds."""
    colors = series.estimator_colors(errors)
    plots = []
    for quantity in QUANTITIES:
        lines = []
        for label, drawn in errors.items():
            rms = np.sqrt(np.mean(quantity.sd(np.square(drawn)) ** 2, axis=0))
            lines.append(series.draw_line(label, bound.t, rms, f"{label}, drawn", colors[label]))
        causal = quantity.sd(variance_of(bound, smooth=False))
        lines.append(series.draw_line("bound", bound.t, causal, "bound", series.TRUTH))
        if any(smoothing.values()):
            smoothed = quantity.sd(variance_of(bound, smooth=True))
            lines.append(series.draw_line("smoothing", bound.t, smoothed, "smoothing bound", series.FIX))
        key = quantity.title.replace(" ", "-")
        title = f"{quantity.title}, 1 sigma [{quantity.unit}]"
        plots.append(Plot(("bound", key), title, tuple(lines), log="y"))
    return plots
