"""The contribution of each sensor error to the errors of a filter, at every time of a flight.

Predicted: the actual covariance of the filter's errors under the gains of one run, in a model with all errors
of the sensors on board, each source alone (Maybeck, Stochastic Models, vol. 1, ch. 6). Measured, by Monte
Carlo: the same filter on sensors with one source switched on, and with all. If the ratio of the two variances
differs from 1 by more than the runs allow, the error is too large for a linear model, and the study prints
it. If the runs are too few to decide, the study prints this, too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np

from bench import pipeline
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.findings import Findings, FindingTable, series
from bench.core.records.findings.series import Plot, Series
from bench.core.records.specs import Profile
from bench.core.words.exceptions import ConfigError
from bench.core.words.palette import Color
from bench.evaluation.linear.error_budget import Budget, split_errors
from bench.evaluation.linear.gains import record_gains
from bench.evaluation.linear.held import check_aiding
from bench.evaluation.linear.quantities import LEVEL, QUANTITIES, Quantity, root_mean_interval
from bench.evaluation.linear.terms import model_errors
from bench.experiments.studies.drawn_errors import (
    Draws,
    UnitFlight,
    draw_errors,
    find_choice,
    join_words,
    key_instants,
    output_times,
    split_draws,
)
from bench.experiments.studies.study import Count, StudyWorkers, UnitOptions, ask_each
from bench.navigation.models.loose_tight import Loose
from bench.simulation import sensors

STUDY = 5, "budget"
QUESTION = "How much does each sensor error contribute to the errors of a filter, at every time?"

_PARTS = 8  # of the runs of a source, so that all workers have something to do
_WIDE = 1.5  # an interval of a variance whose upper end is so many times its lower end squared tells nothing
_UNKNOWN = "cannot tell"
_SMALL = 0.01  # share of a variance below which a source is not held against its runs
_SHOWN = 5  # sources with an area of their own
_ALL, _OTHERS = "all sources", "all others"


class Options(UnitOptions):
    """Options of the study."""

    estimator: str | None = None
    """loosely coupled filter: label of the profile, or built-in name; default: the first of the profile"""
    runs: Count = 200
    """runs of each error source that is not negligible"""


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return the contributions by covariance and by Monte Carlo."""
    return ask_each("budget", options, work, lambda one: _choose(_choose_flight(one).read()), _ask)


def _choose_flight(options: Options) -> UnitFlight:
    asked = None if options.estimator is None else (options.estimator,)
    return UnitFlight(options.profile, options.imu, asked, options.overrides, options.seed)


def _ask(options: Options, work: StudyWorkers) -> Findings:
    flight = _choose_flight(options)
    profile, truth = flight.load()
    label = _choose(profile)
    t = output_times(truth, profile)
    work.progress("covariance of each source", 0, 1)
    sensed = sensors.sense(truth, profile.sensors, profile.seed, 0)
    one = cast(Loose, pipeline.build_estimator(find_choice(profile, label)))
    gains = record_gains(one, sensed, truth, t)
    budget = split_errors(gains, model_errors(truth, profile.sensors, profile.seed, known_jumps=True))
    at = key_instants(budget.t, profile)
    names = [*find_sources(budget, list(at.values())), _ALL]
    parts = list(split_draws(options.runs, _PARTS))
    jobs = [
        Draws(flight, label, first, count, None if name is _ALL else name)
        for name in names
        for first, count in parts
    ]
    found = work.map("drawing each source alone", square_errors, jobs, first=(0,))
    sums = np.array(found).reshape(len(names), len(parts), *found[0].shape).sum(axis=1)
    drawn = dict(zip(names, sums / options.runs, strict=True))
    pairs = pair_variances(budget, drawn, at, options.runs)
    told = [
        *(rank(budget, k, words) for words, k in at.items()),
        *compare(pairs, options.runs),
        *judge_claim(budget, at, label, gains.refused),
    ]
    sides = FindingTable("side_by_side", f"{label}: covariance beside {options.runs} runs", *_units(pairs))
    return Findings(
        verdicts=tuple(told),
        tables=(tabulate_budget(budget, at, label), sides),
        figures=tuple(plot_budget(budget, label)),
        runs=options.runs,
        good="no" not in pairs["agrees"],
        undecided=_UNKNOWN in pairs["agrees"],
    )


def square_errors(runs: Draws) -> FloatArray:
    """Return the squares (M, 9) of the errors of runs, summed over them."""
    return np.asarray(np.square(draw_errors(runs)).sum(axis=0))


def find_sources(budget: Budget, rows: list[int]) -> list[str]:
    """Return the sources that contribute to the variance of any quantity at any epoch."""
    return [
        name
        for s, name in enumerate(budget.sources)
        if any(
            (by_source := _stack(budget.variance, quantity)[k])[s] >= _SMALL * by_source.sum()
            for quantity in QUANTITIES
            for k in rows
        )
    ]


def _choose(profile: Profile) -> str:
    """Return the label of the first filter that has a linear model."""
    for choice in profile.estimators:
        one = pipeline.build_estimator(choice)
        if isinstance(one, Loose):
            check_aiding(choice.label, one)
            return choice.label
    raise ConfigError(
        "budget supports loose-15, loose-22, loose-mems, loose-full, baro-inertial and free-inertial, not "
        f"{', '.join(one.label for one in profile.estimators)} of {profile.name}; "
        "name a supported filter with --estimator"
    )


def _stack(variance: FloatArray, quantity: Quantity) -> FloatArray:
    """Return the variance of a quantity by source (M, S) from the variances of the states (M, 9, S)."""
    return np.asarray(variance[:, quantity.states].sum(axis=1)) / quantity.scale**2


def tabulate_budget(budget: Budget, at: dict[str, int], label: str) -> FindingTable:
    """Return the standard deviation by source at each time, the largest first."""
    columns: dict[str, list[Any]] = {"t_s": [], "source": [], "percent": []}
    columns |= {quantity.name: [] for quantity in QUANTITIES}
    for k in at.values():
        by_source = {q.name: np.sqrt(_stack(budget.variance, q)[k]) for q in QUANTITIES}
        share = np.square(by_source[QUANTITIES[0].name])
        whole = share.sum()
        for s in np.argsort(-share, kind="stable").tolist():
            columns["t_s"].append(float(budget.t[k]))
            columns["source"].append(budget.sources[s])
            columns["percent"].append(float(100.0 * share[s] / whole))
            for name, values in by_source.items():
                columns[name].append(float(values[s]))
    units = {q.name: q.unit for q in QUANTITIES} | {"t_s": "s", "percent": "%"}
    title = f"{label}: standard deviation by source, share of the horizontal variance"
    return FindingTable("budget", title, columns, units)


def pair_variances(
    budget: Budget, drawn: Mapping[str, FloatArray], at: dict[str, int], runs: int
) -> dict[str, list[Any]]:
    """Return the rows of non-negligible sources: by covariance, by runs, and the ratio of the variances.

    ``drawn`` has the mean squares (M, 9) of the errors by source. A ratio of a variance of so many runs over
    the true one is chi-square over its degrees of freedom; its interval has the probability `LEVEL`.
    """
    columns: dict[str, list[Any]] = {
        name: []
        for name in (
            *("t_s", "quantity", "source", "covariance", "drawn", "unit"),
            *("variance_ratio", "low", "high", "agrees"),
        )
    }
    variance = {name: budget.variance[:, :, s] for s, name in enumerate(budget.sources)} | {
        _ALL: budget.total
    }
    least, most = (float(one[0]) ** 2 for one in root_mean_interval(np.ones(1), runs))
    for k in at.values():
        for quantity in QUANTITIES:
            whole = float(quantity.sd(budget.total[k])) ** 2
            expected = {
                name: float(quantity.sd(one[k])) ** 2 for name, one in variance.items() if name in drawn
            }
            for name in sorted(expected, key=lambda name: -expected[name]):
                if expected[name] < _SMALL * whole:
                    continue
                found = float(quantity.sd(drawn[name][k])) ** 2
                ratio = found / expected[name]
                row = (
                    *(float(budget.t[k]), quantity.title, name, expected[name] ** 0.5, found**0.5),
                    *(quantity.unit, ratio, least * ratio, most * ratio),
                    judge_ratio(least * ratio, most * ratio),
                )  # fmt: skip
                for column, value in zip(columns.values(), row, strict=True):
                    column.append(value)
    return columns


def judge_ratio(low: float, high: float) -> str:
    """Return "yes" if a ratio of variances in an interval is 1, else "no", or "cannot tell" if it is wide.

    Examples
    --------
    >>> judge_ratio(0.8, 1.3), judge_ratio(1.1, 1.6), judge_ratio(0.4, 3.7)
    ('yes', 'no', 'cannot tell')
    """
    if not low <= 1.0 <= high:
        return "no"
    return _UNKNOWN if high > _WIDE**2 * low else "yes"


def _units(columns: dict[str, list[Any]]) -> tuple[dict[str, list[Any]], dict[str, str]]:
    return columns, {"t_s": "s"}


def rank(budget: Budget, k: int, words: str) -> str:
    """Return the ranking of the sources at a time, in words."""
    texts = []
    for quantity in (QUANTITIES[0], QUANTITIES[1], QUANTITIES[4]):
        by_source = _stack(budget.variance, quantity)[k]
        whole = by_source.sum()
        first = np.argsort(-by_source, kind="stable")[:4]
        parts = [
            f"{budget.sources[s]} {100.0 * by_source[s] / whole:.0f} %"
            for s in first.tolist()
            if by_source[s] >= 0.02 * whole
        ]
        texts.append(f"{quantity.title} {np.sqrt(whole):.3g} {quantity.unit} by {join_words(parts)}")
    return f"At {words}, of the variance: {'; '.join(texts)}."


def compare(pairs: dict[str, list[Any]], runs: int) -> list[str]:
    """Return how well covariance and runs agree, and each pair that does not."""
    count = Counter(pairs["agrees"])
    level = f"{100.0 * LEVEL:g} % intervals of {runs} runs"
    told = [
        f"Covariance and Monte Carlo agree in {count['yes']} of {len(pairs['agrees'])} figures, by the "
        f"ratio of their variances and {level}; sources below {100.0 * _SMALL:g} % of a variance are not "
        "compared."
    ]
    if count[_UNKNOWN]:
        told.append(
            f"In {count[_UNKNOWN]} figures {runs} runs cannot tell: an interval of a factor of "
            f"{_WIDE**2:g} and more holds nearly any variance; 200 runs would decide."
        )
    told += [
        f"They disagree on {pairs['source'][k]}, {pairs['quantity'][k]} at {pairs['t_s'][k]:g} s: "
        f"{pairs['covariance'][k]:.3g} by covariance, {pairs['drawn'][k]:.3g} {pairs['unit'][k]} drawn. "
        "There the errors are not small enough for a linear model, or the filter rejected measurements."
        for k, agrees in enumerate(pairs["agrees"])
        if agrees == "no"
    ]
    return told


def judge_claim(budget: Budget, at: dict[str, int], label: str, refused: int) -> list[str]:
    """Return the sentence that compares the reported with the actual error of the filter."""
    texts = []
    for words, k in at.items():
        ratio = {q.title: float(q.sd(budget.total[k]) / q.sd(budget.claimed[k])) for q in QUANTITIES}
        worst = max(ratio, key=lambda name: ratio[name])
        texts.append(f"at {words}, its {worst} error is {ratio[worst]:.3g} times what it reports")
    told = [f"The worst reported sigmas of {label}: {'; '.join(texts)}."]
    if refused:
        told.append(
            f"In the recorded run it rejected {refused} scalar measurements; the gains follow from the rest."
        )
    return told


def plot_budget(budget: Budget, label: str) -> list[Plot]:
    """Return for each quantity the stacked shares of the variance, and reported and actual error."""
    plots = []
    colors: dict[str, Color] = {}
    for quantity in QUANTITIES:
        by_source = _stack(budget.variance, quantity)
        whole = by_source.sum(axis=1, keepdims=True)
        share = 100.0 * np.divide(by_source, whole, out=np.zeros_like(by_source), where=whole > 0)
        weight = share.mean(axis=0) + 100.0 * by_source.sum(axis=0) / whole.sum()  # mostly, and at its worst
        order = np.argsort(-weight, kind="stable").tolist()
        layers = [(budget.sources[s], share[:, s]) for s in order[:_SHOWN]]
        give_colors(colors, [name for name, _ in layers])
        if len(order) > _SHOWN:
            layers.append((_OTHERS, share[:, order[_SHOWN:]].sum(axis=1)))
        key = quantity.title.replace(" ", "-")
        title = f"share of the variance of {quantity.title} [%]"
        plots.append(Plot(("budget", f"{key}-shares"), title, tuple(_draw_layers(budget.t, layers, colors))))
        lines = (
            series.draw_line("actual", budget.t, quantity.sd(budget.total), "actual", series.ESTIMATORS[0]),
            series.draw_line(
                "claimed", budget.t, quantity.sd(budget.claimed), "claimed", series.ESTIMATORS[1]
            ),
        )
        title = f"{quantity.title} of {label}, 1 sigma [{quantity.unit}]"
        plots.append(Plot(("budget", key), title, lines))
    return plots


def give_colors(colors: dict[str, Color], names: list[str]) -> None:
    """Keep the color of each source, unless two sources of one figure have the same color."""
    for name in names:
        taken = {colors[other] for other in names if other in colors and other != name}
        if name not in colors or colors[name] in taken:
            colors[name] = next(color for color in series.ESTIMATORS if color not in taken)


def _draw_layers(
    t: FloatArray, layers: list[tuple[str, FloatArray]], colors: dict[str, Color]
) -> Iterator[Series]:
    """Yield an area for each layer on top of the layers before it, and its upper edge."""
    below = np.zeros(len(t))
    for k, (name, values) in enumerate(layers):
        edges, color = np.column_stack([below + values, below]), colors.get(name, series.BAND)
        yield Series(f"layer {k}", t, edges, (name, name), (color, color), (0.5, 0.5), band=(0, 1))
        if name != _OTHERS:
            yield series.draw_line(f"edge {k}", t, below + values, name, color)
        below = below + values
