"""Which error of the sensors contributes what to the errors of a filter, at every instant of a flight.

The actual covariance of the filter's errors under the gains it had in one run, in a model with all errors of
the sensors on board, each source alone (Maybeck, Stochastic Models, vol. 1, ch. 6). Beside it, Monte Carlo:
the same filter on sensors with one source switched on, and with all. Where the two differ by more than the
draws allow, an error is not small enough for a linear model, and the study says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from bench import pipeline, sensors
from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.evaluation.linear.error_budget import Budget, split_errors
from bench.evaluation.linear.gains import record_gains
from bench.evaluation.linear.held import check_aiding
from bench.evaluation.linear.quantities import LEVEL, QUANTITIES, Quantity, root_mean_interval
from bench.evaluation.linear.terms import model_errors
from bench.navigation.models.loose_tight import Loose
from bench.plots import series
from bench.plots.series import Plot, Series
from bench.specs import Profile
from bench.studies.drawn_errors import (
    Draws,
    Flight,
    draw_errors,
    find_choice,
    join_words,
    key_instants,
    output_times,
)
from bench.studies.study import Count, Findings, StudyOptions, StudyTable, Work

_SMALL = 0.01  # share of a variance below which a source is not held against its draws
_SHOWN = 5  # sources with an area of their own
_ALL, _OTHERS = "all sources", "all others"


class Options(StudyOptions):
    """What may be asked."""

    profile: str
    """name of a shipped profile, or the path of a .toml file"""
    estimator: str | None = None
    """a loose filter: label of the profile, or built-in name; left out: the first of the profile"""
    imu: str | None = None
    """IMU of the catalog instead of that of the profile"""
    draws: Count = 20
    """noise draws of each source"""


def run(options: Options, work: Work) -> Findings:
    """Return the contributions by covariance and by Monte Carlo."""
    asked = None if options.estimator is None else (options.estimator,)
    flight = Flight(options.profile, options.imu, asked)
    profile, truth = flight.load()
    label = _choose(profile)
    t = output_times(truth, profile)
    work.progress("covariance of each source", 0, 1)
    sensed = sensors.sense(truth, profile.sensors, profile.seed, 0)
    one = cast(Loose, pipeline.build_estimator(find_choice(profile, label)))
    gains = record_gains(one, sensed, truth, t)
    budget = split_errors(gains, model_errors(truth, profile.sensors, profile.seed, known_jumps=True))
    names = [*budget.sources, _ALL]
    jobs = [Draws(flight, label, 0, options.draws, None if name is _ALL else name) for name in names]
    drawn = work.map("drawing each source alone", draw_errors, jobs, first=(0,))
    squares = np.stack([np.mean(np.square(one), axis=0) for one in drawn], axis=-1)  # (M, 9, S + 1)
    at = key_instants(budget.t, profile)
    pairs = _pair(budget, squares, at, options.draws)
    told = [
        *(_rank(budget, k, words) for words, k in at.items()),
        *_compare(pairs, options.draws),
        *_judge_claim(budget, at, label, gains.refused),
    ]
    sides = StudyTable("side_by_side", f"{label}: covariance beside {options.draws} draws", *_units(pairs))
    return Findings(
        verdicts=tuple(told),
        tables=(_tabulate(budget, at, label), sides),
        figures=tuple(_plot(budget, label)),
        draws=options.draws,
        good=all(flag != "no" for flag in pairs["agrees"]),
    )


def _choose(profile: Profile) -> str:
    """Return the label of the first estimator that has a linear model."""
    for choice in profile.estimators:
        one = pipeline.build_estimator(choice)
        if isinstance(one, Loose):
            check_aiding(choice.label, one)
            return choice.label
    raise ConfigError(
        "budget takes loose-15, loose-22, loose-mems, loose-full, baro-inertial or free-inertial, and "
        f"{profile.name} was asked for {', '.join(one.label for one in profile.estimators)}; "
        "--estimator names one"
    )


def _stack(variance: FloatArray, quantity: Quantity) -> FloatArray:
    """Return the variance of a quantity by source (M, S) from that of the states (M, 9, S)."""
    return np.asarray(variance[:, quantity.states].sum(axis=1)) / quantity.scale**2


def _tabulate(budget: Budget, at: dict[str, int], label: str) -> StudyTable:
    """Return the standard deviation by source at each instant, the largest first."""
    columns: dict[str, list[Any]] = {"t_s": [], "source": [], "share_percent": []}
    columns |= {quantity.name: [] for quantity in QUANTITIES}
    for k in at.values():
        by_source = {q.name: np.sqrt(_stack(budget.variance, q)[k]) for q in QUANTITIES}
        share = np.square(by_source[QUANTITIES[0].name])
        whole = share.sum()
        for s in np.argsort(-share, kind="stable").tolist():
            columns["t_s"].append(float(budget.t[k]))
            columns["source"].append(budget.sources[s])
            columns["share_percent"].append(float(100.0 * share[s] / whole))
            for name, values in by_source.items():
                columns[name].append(float(values[s]))
    units = {q.name: q.unit for q in QUANTITIES} | {"t_s": "s", "share_percent": "%"}
    title = f"{label}: standard deviation by source, share of the horizontal variance"
    return StudyTable("budget", title, columns, units)


def _pair(budget: Budget, squares: FloatArray, at: dict[str, int], draws: int) -> dict[str, list[Any]]:
    """Return the rows of sources that matter, by covariance and by draws, with the interval of the latter."""
    whole = np.concatenate([budget.variance, budget.total[:, :, None]], axis=2)
    columns: dict[str, list[Any]] = {
        name: []
        for name in ("t_s", "quantity", "source", "covariance", "drawn", "low", "high", "unit", "agrees")
    }
    for k in at.values():
        for quantity in QUANTITIES:
            expected, found = (_stack(one, quantity)[k] for one in (whole, squares))
            low, high = root_mean_interval(np.sqrt(found), draws)
            for s in np.argsort(-expected, kind="stable").tolist():
                if expected[s] < _SMALL * expected[-1]:
                    continue
                sd = float(np.sqrt(expected[s]))
                row = (
                    float(budget.t[k]), quantity.title, [*budget.sources, _ALL][s], sd,
                    float(np.sqrt(found[s])), float(low[s]), float(high[s]), quantity.unit,
                    "yes" if low[s] <= sd <= high[s] else "no",
                )  # fmt: skip
                for column, value in zip(columns.values(), row, strict=True):
                    column.append(value)
    return columns


def _units(columns: dict[str, list[Any]]) -> tuple[dict[str, list[Any]], dict[str, str]]:
    return columns, {"t_s": "s"}


def _rank(budget: Budget, k: int, words: str) -> str:
    """Return the ranking of the sources at an instant, in words."""
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


def _compare(pairs: dict[str, list[Any]], draws: int) -> list[str]:
    """Return how covariance and draws agree, and each pair that does not."""
    wrong = [k for k, agrees in enumerate(pairs["agrees"]) if agrees == "no"]
    level = f"{100.0 * LEVEL:g} % intervals of {draws} draws"
    told = [
        f"Covariance and Monte Carlo agree in {len(pairs['agrees']) - len(wrong)} of {len(pairs['agrees'])} "
        f"figures, by {level}; sources below {100.0 * _SMALL:g} % of a variance are not compared."
    ]
    told += [
        f"They disagree on {pairs['source'][k]}, {pairs['quantity'][k]} at {pairs['t_s'][k]:g} s: "
        f"{pairs['covariance'][k]:.3g} by covariance, {pairs['drawn'][k]:.3g} {pairs['unit'][k]} drawn. "
        "There the errors are not small enough for a linear model, or the filter refused measurements."
        for k in wrong
    ]
    return told


def _judge_claim(budget: Budget, at: dict[str, int], label: str, refused: int) -> list[str]:
    """Return what the filter claims against what it does."""
    texts = []
    for words, k in at.items():
        ratio = {q.title: float(q.sd(budget.total[k]) / q.sd(budget.claimed[k])) for q in QUANTITIES}
        worst = max(ratio, key=lambda name: ratio[name])
        texts.append(f"{ratio[worst]:.3g} times the {worst} it claims at {words}")
    told = [f"{label} errs by {join_words(texts)}, its worst claims."]
    if refused:
        told.append(
            f"In the recorded run it refused {refused} scalar measurements; the gains are those of the rest."
        )
    return told


def _plot(budget: Budget, label: str) -> list[Plot]:
    """Return for each quantity the stacked shares of the variance, and claimed and actual error."""
    plots = []
    colours: dict[str, series.Colour] = {}
    for quantity in QUANTITIES:
        by_source = _stack(budget.variance, quantity)
        whole = by_source.sum(axis=1, keepdims=True)
        share = 100.0 * np.divide(by_source, whole, out=np.zeros_like(by_source), where=whole > 0)
        weight = share.mean(axis=0) + 100.0 * by_source.sum(axis=0) / whole.sum()  # mostly, and at its worst
        order = np.argsort(-weight, kind="stable").tolist()
        layers = [(budget.sources[s], share[:, s]) for s in order[:_SHOWN]]
        _give_colours(colours, [name for name, _ in layers])
        if len(order) > _SHOWN:
            layers.append((_OTHERS, share[:, order[_SHOWN:]].sum(axis=1)))
        key = quantity.title.replace(" ", "-")
        title = f"share of the variance of {quantity.title} [%]"
        plots.append(Plot(("budget", f"{key}-shares"), title, tuple(_draw_layers(budget.t, layers, colours))))
        lines = (
            series.draw_line("actual", budget.t, quantity.sd(budget.total), "actual", series.ESTIMATORS[0]),
            series.draw_line(
                "claimed", budget.t, quantity.sd(budget.claimed), "claimed", series.ESTIMATORS[1]
            ),
        )
        title = f"{quantity.title} of {label}, 1 sigma [{quantity.unit}]"
        plots.append(Plot(("budget", key), title, lines))
    return plots


def _give_colours(colours: dict[str, series.Colour], names: list[str]) -> None:
    """Let each source keep the colour it has, unless two of one figure have the same."""
    for name in names:
        taken = {colours[other] for other in names if other in colours and other != name}
        if name not in colours or colours[name] in taken:
            colours[name] = next(colour for colour in series.ESTIMATORS if colour not in taken)


def _draw_layers(
    t: FloatArray, layers: list[tuple[str, FloatArray]], colours: dict[str, series.Colour]
) -> Iterator[Series]:
    """Yield an area for each layer on those before it, and its upper edge."""
    below = np.zeros(len(t))
    for k, (name, values) in enumerate(layers):
        edges, colour = np.column_stack([below + values, below]), colours.get(name, series.BAND)
        yield Series(f"layer {k}", t, edges, (name, name), (colour, colour), (0.5, 0.5), band=(0, 1))
        if name != _OTHERS:
            yield series.draw_line(f"edge {k}", t, below + values, name, colour)
        below = below + values
