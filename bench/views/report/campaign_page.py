"""The report of a campaign: the statistics of many runs, on one HTML page."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import unit_of
from bench.core.records.findings import FindingTable, make_table, series
from bench.core.records.findings.looks import find_look
from bench.core.records.findings.series import Plot, Series
from bench.core.records.specs import EvaluationWindow
from bench.core.words.notebook import ShownFigure, ShownText
from bench.core.words.palette import Color
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import CONFIDENCE, qualify
from bench.evaluation.metrics.metric_words import find_words, name_metric
from bench.evaluation.metrics.run_metrics import find_metric
from bench.evaluation.requirements.required_metrics import trace
from bench.experiments.campaigns.outcome import POOLED, RATIO, Campaign, Outcome, tabulate
from bench.experiments.campaigns.plan import Condition
from bench.io import results
from bench.views.report import page, svg
from bench.views.report.page import CaptionedPlot

_MOST_CONDITIONS = 6  # that have plots
_MOST_NAMED = 4  # seeds and units in the head of the page
_MOST_LOST = 50  # runs that are listed
_FAR = 20.0  # a filter that errs so many times more than the middle one does not scale a plot, has no band
_POOLED = (
    f"Pooled over the runs that converged, with {100 * CONFIDENCE:.0f} % intervals; NEES / n of a consistent "
    "filter is 1 (98 %)"
)
_EXTREMES = "Horizontal position error, root mean square of the run, and the command that repeats it"

_COURSES = (
    ("pos_err_n_m", "north position error [m]"),
    ("pos_err_e_m", "east position error [m]"),
    ("pos_err_d_m", "down position error [m]"),
    ("vel_err_n_mps", "north velocity error [m/s]"),
    ("vel_err_e_mps", "east velocity error [m/s]"),
    ("vel_err_d_mps", "down velocity error [m/s]"),
    ("tilt_deg", "tilt error [deg]"),
    ("heading_err_deg", "heading error [deg]"),
    ("nees", "NEES, mean of the runs"),
    ("pos_sd_h_m", "reported horizontal sigma [m]"),
    ("pos_sd_d_m", "reported vertical sigma [m]"),
    ("heading_sd_deg", "reported heading sigma [deg]"),
)
"""Columns of the table of epochs -> title."""


class Section(NamedTuple):
    """The plots of one condition."""

    name: str
    values: str  # what is varied
    courses: list[CaptionedPlot]
    distributions: list[CaptionedPlot]


def make_page(name: str, campaign: Campaign, comparisons: Sequence[Mapping[str, Any]] = ()) -> str:
    """Return the report of a campaign as HTML.

    Parameters
    ----------
    name : str
        Of its folder.
    campaign : Campaign
        What to show.
    comparisons : sequence of mapping
        Tables of a comparison, if the campaign is several in one.
    """
    labels = list(dict.fromkeys(one.label for one in campaign.outcomes))
    colors = series.estimator_colors(labels)
    lost = _list_lost(campaign)
    several = len(campaign.conditions) > 1
    return page.render(
        "campaign.html.jinja",
        title=name if comparisons else _find_title(name, campaign),
        comparisons=comparisons,
        facts=list(_list_facts(campaign)),
        cards=[] if several else [_make_card(one) for one in campaign.outcomes],
        sentences=[] if several else [one.sentence for one in campaign.comparisons],
        figures=_tabulate(campaign),
        confidence=f"{100 * CONFIDENCE:.0f} %",
        legend=[(label, svg.css_color(color), "line") for label, color in colors.items()],
        sweep=[figure for plot in plot_sweep(campaign, colors) for figure in _draw(plot)],
        sections=list(_draw_conditions(campaign, colors)),
        left_out=max(len(campaign.conditions) - _MOST_CONDITIONS, 0),
        extremes=_tabulate_extremes(campaign, labels),
        required=trace(campaign.requirements),
        lost=make_table("lost", "", ("estimator", "reason", "command"), lost[:_MOST_LOST]),
        lost_count=len(lost),
        provenance=list(page.list_provenance({**campaign.provenance, **campaign.uncertainty})),
        document=results.to_json([dict(one) for one in campaign.conditions]),
    )


# --- words and tables ---------------------------------------------------------------------------------


def _find_title(name: str, campaign: Campaign) -> str:
    if len(campaign.conditions) == 1:
        return str(campaign.conditions[0]["as_flown"].get("title", name))
    return name


def _list_facts(campaign: Campaign) -> Iterator[str]:
    yield f"{campaign.finished} of {campaign.planned} runs"
    if len(campaign.conditions) > 1:
        yield f"{len(campaign.conditions)} conditions"
    if campaign.failed:
        yield f"{len(campaign.failed)} runs failed as a whole"
    flown = [one["as_flown"] for one in campaign.conditions]
    units = dict.fromkeys((one.get("sensors") or one.get("assumed") or {}).get("imu") for one in flown)
    for name, values in (("seed", dict.fromkeys(one.get("seed") for one in flown)), ("IMU", units)):
        known = [str(value) for value in values if value is not None]
        if known:
            yield f"{name} {', '.join(known[:_MOST_NAMED])}" + (" ..." if len(known) > _MOST_NAMED else "")
    if campaign.folder is not None:
        yield f"written {page.read_day(campaign.folder / results.CAMPAIGN_RESULT)}"
    rare = qualify(campaign.fewest)
    yield f"figures are over the runs that converged, with {100 * CONFIDENCE:.0f} % intervals{rare}"


def _make_card(outcome: Outcome) -> dict[str, Any]:
    word = outcome.consistency.word if outcome.consistency else "too few runs for a verdict"
    kind, mark = find_look(word) if outcome.consistency else ("none", "–")
    first = outcome.sentences[0].removeprefix(f"{outcome.label}: ")
    reasons = outcome.consistency.reasons if outcome.consistency else ()
    return {
        "label": outcome.label,
        "word": word,
        "kind": kind,
        "mark": mark,
        "lines": list(_list_errors(outcome)),
        "text": outcome.consistency.sentence.removeprefix(f"{word}: ") if outcome.consistency else "",
        "drifts": [first, *outcome.scatter, *reasons],
    }


def _list_errors(outcome: Outcome) -> Iterator[str]:
    """Yield the main errors with their units and intervals."""
    for metric in ("pos_rmse_h_m", "pos_rmse_d_m", "vel_rmse_3d_mps", "heading_rmse_deg"):
        if (found := outcome.errors.get(metric)) is not None:
            words = find_words(metric)
            few = qualify(outcome.converged_runs)
            yield f"{words.words} {format_number(found.value, 3)} {words.unit} ({found.interval}{few})"


def _tabulate(campaign: Campaign) -> FindingTable:
    """Return a row for each condition and estimator: verdict, errors and NEES over the runs."""
    outcomes = campaign.outcomes
    errors = list(dict.fromkeys(name for one in outcomes for name in one.errors))
    table = tabulate(
        outcomes, {name: name for name in (*errors, RATIO)}, f"{_POOLED}{qualify(campaign.fewest)}"
    )
    words = [one.consistency.word if one.consistency else "" for one in outcomes]
    verdicts = [ShownText(word or "–", find_look(word).kind if word else "none") for word in words]
    columns = {
        name: [ShownFigure("–") if cell is None else cell for cell in cells]
        for name, cells in table.columns.items()
    }
    first = {name: columns.pop(name) for name in ("condition", "estimator", "converged")}
    heads = {name: _name_error(name) for name in errors}
    return replace(table, columns={**first, "verdict": verdicts, **columns}, heads=heads)


def _name_error(name: str) -> str:
    """Return an error over the runs in words with its unit; a circle of error is named as the field does."""
    circle = re.fullmatch(r"cep(\d+)_m", name)
    return f"CEP{circle[1]} [m]" if circle else name_metric(name)


def _tabulate_extremes(campaign: Campaign, labels: Iterable[str]) -> FindingTable:
    """Return filter, which run, its horizontal error and its command: the median and the worst run."""
    table, found = campaign.runs.to_pydict(), []
    names = ("estimator", "pos_rmse_h_m", "command")
    rows = list(zip(*map(table.get, names), strict=True)) if names[1] in table else []
    for label in labels:
        mine = sorted((error, command) for one, error, command in rows if one == label and error is not None)
        for which, k in (("median", len(mine) // 2), ("worst", len(mine) - 1)):
            if mine:
                found.append((label, which, mine[k][0], ShownText(mine[k][1], code=True)))
    return make_table("extremes", _EXTREMES, ("estimator", "run", "error [m]", "command"), found)


def _list_lost(campaign: Campaign) -> list[tuple[str, str, ShownText]]:
    """Return filter, reason and command of each run that did not converge."""
    table = campaign.runs.to_pydict()
    columns = (table[name] for name in ("estimator", "converged", "reason", "command"))
    return [
        (label, str(reason or ""), ShownText(command, code=True))
        for label, converged, reason, command in zip(*columns, strict=True)
        if not converged
    ]


# --- drawings -----------------------------------------------------------------------------------------


def _draw_conditions(campaign: Campaign, colors: Mapping[str, Color]) -> Iterator[Section]:
    """Yield the plots of the first conditions."""
    runs = {name: np.array(column) for name, column in campaign.runs.to_pydict().items()}
    for number, plots, shades in plot_courses(campaign, colors):
        condition = campaign.conditions[number]
        of_runs = {name: column[runs["condition"] == number] for name, column in runs.items()}
        yield Section(
            str(condition["profile"]),
            ", ".join(f"{key} = {value}" for key, value in condition["values"].items()),
            [figure for plot in plots for figure in _draw(plot, shades)],
            [figure for plot in _plot_distributions(of_runs, colors) for figure in _draw(plot)],
        )


def plot_courses(
    campaign: Campaign, colors: Mapping[str, Color]
) -> Iterator[tuple[int, list[Plot], tuple[series.Shade, ...]]]:
    """Yield number, plots of each channel along the run, and outages of the first conditions."""
    epochs = {name: np.array(column) for name, column in campaign.epochs.to_pydict().items()}
    for number, condition in enumerate(campaign.conditions[:_MOST_CONDITIONS]):
        here = {name: column[epochs["condition"] == number] for name, column in epochs.items()}
        if len(here["t_s"]):
            flown = condition["as_flown"]
            begun = EvaluationWindow.of_document(flown).begin
            lost = tuple(
                (float(row["start_s"]), float(row["start_s"]) + float(row["duration_s"]))
                for row in flown.get("gnss_outage", ())
            )
            shades = (series.Shade("outage", "GNSS outage", series.OUTAGE, lost),) if lost else ()
            yield number, list(_plot_courses(here, colors, begun)), shades


def _plot_courses(
    epochs: Mapping[str, FloatArray], colors: Mapping[str, Color], begun: float
) -> Iterator[Plot]:
    """Yield a plot of each channel along the run: the median of the runs, and the middle 90 % as a band."""
    for channel, title in _COURSES:
        lines = []
        for label, color in colors.items():
            mine = epochs["estimator"] == label
            middle, low, high = (
                np.asarray(epochs[f"{channel}_{end}"][mine], float) for end in ("p50", "p05", "p95")
            )
            if channel == "nees":  # its mean has a known band
                middle = np.asarray(epochs["nees_mean"][mine], float)
                low, high = (np.asarray(epochs[f"nees_{end}"][mine], float) for end in ("low", "high"))
            if np.isfinite(middle).any():
                values = np.column_stack([middle, low, high])
                of_band = series.BAND if channel == "nees" else color
                lines.append(_make_line(label, epochs["t_s"][mine], values, color, of_band))
        if lines:
            yield Plot(("campaign", channel), title, tuple(_drop_far_bands(lines, begun)), begun, _FAR)


def _drop_far_bands(lines: Sequence[Series], begun: float) -> Iterator[Series]:
    reach = np.array([np.nanmax(np.abs(line.values[line.t >= begun]), initial=0.0) for line in lines])
    for line, far in zip(lines, reach > _FAR * np.median(reach), strict=True):
        yield replace(line, values=line.values * [1.0, np.nan, np.nan]) if far else line


def _make_line(label: str, t: FloatArray, values: FloatArray, color: Color, of_band: Color) -> Series:
    return Series(label, t, values, (label,) * 3, (color, of_band, of_band), (1.5, 1.0, 1.0), band=(1, 2))


def _plot_distributions(runs: Mapping[str, Any], colors: Mapping[str, Color]) -> Iterator[Plot]:
    """Yield a plot of each main metric: the share of the runs in which it is at most so large."""
    for metric in POOLED:
        known = find_metric(metric)
        lines = []
        for label, color in colors.items():
            values = np.array(runs[metric][runs["estimator"] == label] if metric in runs else (), float)
            values = np.sort(values[np.isfinite(values)])
            if len(values):
                share = 100.0 * np.arange(len(values) + 1) / len(values)
                x, y = np.repeat(values, 2), np.repeat(share, 2)[1:-1]
                lines.append(series.draw_line(label, x, y, label, color))
        if lines and known is not None:
            title = f"runs with at most this {find_words(metric).words} [%]"
            yield Plot(("campaign", metric), title, tuple(lines), across=known.unit)


def plot_sweep(campaign: Campaign, colors: Mapping[str, Color]) -> Iterator[Plot]:
    """Yield a plot of each error over the value that is varied, if it is the only one, and a number."""
    keys = {key for one in campaign.conditions for key in one["values"]}
    if len(keys) != 1 or len({one["profile"] for one in campaign.conditions}) != 1:
        return
    (key,) = keys
    values = {
        Condition(one["profile"], one["values"]).name: one["values"].get(key) for one in campaign.conditions
    }
    if not all(isinstance(value, int | float) for value in values.values()) or len(set(values.values())) < 2:
        return
    for metric in dict.fromkeys(name for one in campaign.outcomes for name in one.errors):
        lines = []
        for label, color in colors.items():
            found = sorted(
                (float(values[one.condition]), one.errors[metric])
                for one in campaign.outcomes
                if one.label == label and metric in one.errors
            )
            if found:
                x = np.array([value for value, _ in found])
                estimates = np.array([(one.value, one.low, one.high) for _, one in found])
                lines.append(_make_line(label, x, estimates, color, color))
        if lines:
            yield Plot(
                ("campaign", metric),
                f"{_name_error(metric)} by {key}",
                tuple(lines),
                far=_FAR,
                across=unit_of(key) or "1",
            )


def _draw(plot: Plot, shades: tuple[series.Shade, ...] = ()) -> Iterator[CaptionedPlot]:
    """Yield a plot; the axis of a distribution leaves out filters that err far more."""
    ends = np.array([line.t[-1] for line in plot.series])
    if plot.across == "s":
        yield page.make_figure(plot, (0.0, float(ends.max())), shades)
        return
    near = ends[ends <= _FAR * np.median(ends)]
    first = min(0.0, *(float(line.t[0]) for line in plot.series))
    yield page.make_figure(plot, (first, 1.05 * float(near.max()) or 1.0), ())
