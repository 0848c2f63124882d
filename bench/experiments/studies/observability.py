"""The effect of straight flight and turns on the sigma of heading, tilt and biases.

The covariance is the bound of `bench study bound`: what the best linear filter cannot determine, no filter
can. Directions are combinations of heading, tilts and biases, each in units of its standard deviation at the
start; the direction that keeps the largest part is the least observable. The reference flight is the one of
equations 7.1: level at 200 m/s, with an S-turn of two minutes from 240 s on, and the same without turns.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import DEG, HOUR, STANDARD_GRAVITY
from bench.core.records.findings import Findings, FindingTable, series
from bench.core.records.findings.series import Plot
from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear.directions import (
    Observed,
    describe_direction,
    find_turns,
    observe,
)
from bench.evaluation.linear.held import bound_flight
from bench.experiments.studies.drawn_errors import UnitFlight, output_times
from bench.experiments.studies.linear_flight import GRADES, LinearFlight
from bench.experiments.studies.study import StudyWorkers, UnitOptions, Words, ask_each
from bench.simulation import sensors

STUDY = 7, "observability"
QUESTION = "How much do turns improve the observability of heading, tilt and biases?"

_LONG = 3.0  # a phase of the flight lasts at least so long [s]
_BEFORE, _AFTER, _LATE = 240, 400, 1800  # of the reference flight [s]
_HEADING = 8  # its state
_SHOWN = ("grade-3", "MEMS")  # grades of its figure
_FIGURES = (  # column -> states of `FIGURES`, SI over unit
    ("heading_deg", "heading", "deg", (2,), DEG),
    ("tilt_deg", "tilt, larger axis", "deg", (0, 1), DEG),
    ("gyro_bias_deg_h", "gyro bias, worst axis", "deg/h", (3, 4, 5), DEG / HOUR),
    ("accel_bias_ug", "accelerometer bias, worst axis", "ug", (6, 7, 8), 1e-6 * STANDARD_GRAVITY),
)


class Options(UnitOptions):
    """Options of the study."""

    profiles: Words = ("s-turns",)
    """names of shipped profiles, or .toml files of your own, separated by commas"""


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return the uncertainties before, in and after turns."""
    return ask_each("observability", options, work, lambda one: _choose(one).read(), _ask)


def _choose(options: Options) -> UnitFlight:
    return UnitFlight(options.profile, options.imu, None, options.overrides, options.seed)


def _ask(options: Options, work: StudyWorkers) -> Findings:
    profile, truth = _choose(options).load()
    work.progress("the best linear filter", 0, 1)
    data = sensors.sense(truth, profile.sensors, profile.seed, 0).data
    t = output_times(truth, profile)
    seen = observe(bound_flight(truth, profile.sensors, data, profile.seed, t, smooth=False))
    if not seen.left.size:
        raise ConfigError(f"study observability: on {profile.name} start and unit have no error to observe")
    turning = smooth_phases(find_turns(truth, seen.t), seen.t)
    phases = split_phases(turning)
    cases = [(name, turns) for name in GRADES for turns in (True, False)]
    headings = dict(zip(cases, work.map("the reference flight", _fly_reference, cases), strict=True))
    reference, lines = tabulate_reference(headings)
    return Findings(
        verdicts=(*tell_observed(profile.name, seen, phases), *_tell_reference(reference)),
        tables=(tabulate_phases(seen, phases), tabulate_directions(seen, phases), reference),
        figures=(*plot_observed(seen, turning), lines),
    )


def smooth_phases(turning: BoolArray, t: FloatArray) -> BoolArray:
    """Return phases, with phases shorter than `_LONG` merged into the phase before."""
    edges = np.flatnonzero(np.diff(turning)) + 1
    out = turning.copy()
    for a, b in zip(edges, [*edges[1:], len(t)], strict=True):
        if t[b - 1] - t[a] < _LONG:
            out[a:b] = out[a - 1]
    return out


def split_phases(turning: BoolArray) -> list[tuple[str, int, int]]:
    """Return name, first and last row of each phase; the last row is the first of the next."""
    edges = [0, *(np.flatnonzero(np.diff(turning)) + 1).tolist(), len(turning) - 1]
    return [("turn" if turning[a] else "straight", a, b) for a, b in pairwise(edges) if b > a]


def _figure(seen: Observed, states: tuple[int, ...], scale: float) -> FloatArray:
    return np.asarray(seen.sd[:, states].max(axis=1) / scale)


def tabulate_phases(seen: Observed, phases: list[tuple[str, int, int]]) -> FindingTable:
    """Return the uncertainties before and after each phase."""
    columns: dict[str, list[Any]] = {
        "from_s": [float(seen.t[a]) for _, a, _ in phases],
        "to_s": [float(seen.t[b]) for _, _, b in phases],
        "phase": [name for name, _, _ in phases],
    }
    units = {"from_s": "s", "to_s": "s"}
    for name, _, unit, states, scale in _FIGURES:
        values = _figure(seen, states, scale)
        stem, short = name.split("_")[0], name.removesuffix("_deg_h").rsplit("_", 1)[1]
        ends = {"before": [a for _, a, _ in phases], "after": [b for _, _, b in phases]}
        for when, rows in ends.items():
            key = f"{stem}_{when}_{'deg_h' if short == 'bias' else short}"
            columns[key], units[key] = values[rows].tolist(), unit
    return FindingTable("phases", "Known before and after each phase of the flight, 1 sigma", columns, units)


def _instants(seen: Observed, phases: list[tuple[str, int, int]]) -> dict[str, int]:
    """Return the rows at which directions are reported: around the first turn, and at the end."""
    found = {}
    for name, a, b in phases:
        if name == "turn":
            found = {"before the first turn": a, "in the first turn": (a + b) // 2, "after the first turn": b}
            break
    return found | {"at the end": len(seen.t) - 1}


def tabulate_directions(seen: Observed, phases: list[tuple[str, int, int]]) -> FindingTable:
    """Return the most and the least observable direction at the ends of phases."""
    columns: dict[str, list[Any]] = {
        name: []
        for name in ("t_s", "when", "left_percent", "least_observable", "best_percent", "best", "condition")
    }
    for when, k in _instants(seen, phases).items():
        left, directions = seen.left[k], seen.directions[k]
        row = (
            float(seen.t[k]), when, float(100.0 * left[-1]), describe_direction(directions[:, -1]),
            float(100.0 * left[0]), describe_direction(directions[:, 0]), float(left[-1] / left[0]),
        )  # fmt: skip
        for column, value in zip(columns.values(), row, strict=True):
            column.append(value)
    title = "What is left of the uncertainty at the start, along the least and the most observable direction"
    return FindingTable("directions", title, columns, {"t_s": "s", "left_percent": "%", "best_percent": "%"})


def tell_observed(name: str, seen: Observed, phases: list[tuple[str, int, int]]) -> list[str]:
    """Return the sentences on the heading and on the least observable direction."""
    told = []
    at = _instants(seen, phases)
    heading = seen.sd[:, 2] / DEG
    if "after the first turn" in at:
        a, b = at["before the first turn"], at["after the first turn"]
        told.append(
            f"On {name} the heading is known to {heading[0]:.3g} deg at the start, {heading[a]:.3g} deg "
            f"before the first turn at {seen.t[a]:g} s, {heading[b]:.3g} deg after it, and "
            f"{heading[-1]:.3g} deg at the end."
        )
        straight = [seen.sd[b, 2] / seen.sd[a, 2] for kind, a, b in phases[1:] if kind == "straight"]
        turns = [seen.sd[b, 2] / seen.sd[a, 2] for kind, a, b in phases if kind == "turn"]
        if straight:
            told.append(
                f"A turn leaves {100.0 * float(np.median(turns)):.0f} % of the heading uncertainty, straight "
                f"flight after it {100.0 * float(np.median(straight)):.0f} %, in the median."
            )
    else:
        told.append(
            f"On {name} there is no turn: the heading goes from {heading[0]:.3g} to {heading[-1]:.3g} deg."
        )
    told += [
        f"{when.capitalize()} ({seen.t[k]:g} s) the least observable direction is "
        f"{describe_direction(seen.directions[k][:, -1])}: {100.0 * seen.left[k, -1]:.0f} % of its "
        f"uncertainty at the start; condition {seen.left[k, -1] / seen.left[k, 0]:.0f}."
        for when, k in at.items()
    ]
    return told


def _fly_reference(case: tuple[str, bool]) -> FloatArray:
    """Return the heading (seconds + 1,) of a grade on the reference flight, with turns or without [deg]."""
    grade, turns = case
    return np.asarray(LinearFlight(turns=turns).predict_sd(GRADES[grade], _LATE)[:, _HEADING] / DEG)


def tabulate_reference(headings: Mapping[tuple[str, bool], FloatArray]) -> tuple[FindingTable, Plot]:
    """Return the heading on the reference flight by grade, with turns and without."""
    lines = []
    found: dict[str, list[float]] = {name: [] for name in ("before", "after", "late", "straight")}
    seconds = np.arange(_LATE + 1.0)
    for name in GRADES:
        heading, straight = headings[name, True], headings[name, False]
        values = (heading[_BEFORE], heading[_AFTER], heading[_LATE], straight[_LATE])
        for column, value in zip(found.values(), values, strict=True):
            column.append(float(value))
        if name in _SHOWN:
            colors = series.ESTIMATORS[2 * _SHOWN.index(name) :]
            lines += [
                series.draw_line(name, seconds, heading, f"{name}, S-turns", colors[0]),
                series.draw_line(f"{name} straight", seconds, straight, f"{name}, straight", colors[1]),
            ]
    names = [f"at_{_BEFORE}_s_deg", f"at_{_AFTER}_s_deg", f"at_{_LATE}_s_deg", f"straight_{_LATE}_s_deg"]
    columns: dict[str, list[Any]] = {"grade": list(GRADES), **dict(zip(names, found.values(), strict=True))}
    title = "Heading on the reference flight, an S-turn from 240 to 360 s, 1 sigma"
    table = FindingTable("reference", title, columns, dict.fromkeys(names, "deg"))
    title = "heading on the reference flight, 1 sigma [deg]"
    return table, Plot(("observability", "reference-heading"), title, tuple(lines), log="y")


def _tell_reference(table: FindingTable) -> list[str]:
    grade, *values = table.columns.values()
    rows = {name: [column[k] for column in values] for k, name in enumerate(grade)}
    texts = []
    for name in _SHOWN:
        before, after, _, straight = rows[name]
        texts.append(f"{name} from {before:.2g} to {after:.2g} deg ({straight:.2g} in straight flight)")
    return [f"Heading needs turns: an S-turn of the reference flight reduces its sigma: {', '.join(texts)}."]


def plot_observed(seen: Observed, turning: BoolArray) -> list[Plot]:
    """Return the standard deviations, with a dot at the foot for each second of a turn."""
    plots = []
    for name, words, unit, states, scale in _FIGURES:
        values = _figure(seen, states, scale)
        foot = np.full(int(turning.sum()), 0.8 * values[values > 0].min(initial=np.inf))
        lines = [series.draw_line("known", seen.t, values, words, series.ESTIMATORS[0])]
        if len(foot):
            lines.append(series.draw_dots("turns", seen.t[turning], foot, "turn", series.OUTAGE, 2.0))
        key = name.rsplit("_", 1)[0].replace("_deg", "").replace("_", "-")
        plots.append(Plot(("observability", key), f"{words}, 1 sigma [{unit}]", tuple(lines), log="y"))
    left = seen.left[:, [-1, 0]]
    names, colors = ("least observable", "most observable"), series.ESTIMATORS[:2]
    both = tuple(
        series.draw_line(name, seen.t, 100.0 * left[:, k], name, color)
        for k, (name, color) in enumerate(zip(names, colors, strict=True))
    )
    title = "left of the uncertainty at the start [%]"
    plots.append(Plot(("observability", "directions"), title, both, log="y"))
    return plots
