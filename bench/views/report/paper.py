"""Figures of a result for a paper: the plots of a tab below each other, as PDF, SVG or PNG."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import numpy as np

from bench.core.files import durable
from bench.core.records.findings import series
from bench.core.records.findings.series import Plot, Shade
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError
from bench.core.words.palette import Color, find_light
from bench.core.words.wording import suggest
from bench.views.plots.content import gather_content
from bench.views.plots.tabs import TABS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bench.core.records.findings import StudyResult
    from bench.experiments.campaigns.outcome import Campaign
    from bench.experiments.card.card_making import Card

_T = TypeVar("_T")

FORMATS = ("pdf", "svg", "png")
COLUMN_MM = 88.0
"""Width of a column of a journal [mm]."""

_INCH_MM = 25.4
_ROW_MM = 32.0  # height of a plot [mm]
_POINT_MM = _INCH_MM / 72.0
_TITLE, _NAME = 8.0, 6.0  # size of a title and of a name in a legend [pt]
_LETTER = 0.53  # width of a letter over its size, on the average
_SAMPLE = 20.0  # width of a line before its name, and what is between them [pt]
_NAME_ROW = 8.5  # height of a row of a legend [pt]
_MARGIN = 40.0  # left of a plot [pt]
_TURNED_MM = 24.0  # height of names that are turned [mm]
_MOST_LETTERS = 40  # of the names below a plot that stand upright
_MOST_NAMES = 6  # in a legend; a line for each satellite has none
_DARKER = 0.72  # of the colors of the viewer, for white paper
_RATIOS = ("accuracy", "height", "velocity", "tilt", "heading", "outages", "robustness", "honesty")
"""Topics of a card whose figures are ratios."""
_SHADES = {"outage": (0.9, 0.9, 0.9), "fault": (0.94, 0.87, 0.94)}


def plot_result(
    result: RunResult | StudyResult | Campaign | Card,
    tab: str | None = None,
    estimator: str | None = None,
    *,
    width_mm: float = COLUMN_MM,
    serif: bool = False,
) -> Figure:
    """Draw a tab of a run, a figure of a study, a quantity of a campaign, or a topic of a card.

    Parameters
    ----------
    result : RunResult, StudyResult, Campaign or Card
        As `bench.run`, `bench.study`, `bench.campaign` or their ``load`` return it, or `bench.read_card`.
    tab : str or None
        Of a run the name of a tab of the recording, such as "position", capitals do not matter; of a study
        the name of a figure; of a campaign a column of its table of epochs, such as "pos_err_n_m"; of a
        card a topic whose figures are ratios, such as "accuracy". None takes the first one.
    estimator : str or None
        Of a run: whose; None takes the first one. Tabs that belong to no filter have one drawing.
    width_mm : float
        Width of the figure [mm].
    serif : bool
        Letters with serifs.

    Returns
    -------
    figure : matplotlib.figure.Figure
        It belongs to no window: save it, or return it in a notebook.

    Raises
    ------
    ConfigError
        If there is no such tab or filter, or nothing to draw.
    """
    plots: Sequence[Plot]
    shades: Sequence[Shade] = ()
    if isinstance(result, RunResult):
        plots, shades = _find_drawing(result, tab, estimator)
    elif estimator is not None:
        raise ConfigError(f"estimator = {estimator!r}: only the plots of a run belong to a filter")
    elif hasattr(result, "lines"):
        plots = [_choose(_draw_topics(cast("Card", result)), tab, "topics")]
    elif hasattr(result, "figures"):
        plots = [_choose(result.figures, tab, "figures")]
    else:
        plots, shades = _find_courses(result, tab)
    return _draw(plots, shades, width_mm, serif)


def _find_drawing(
    result: RunResult, tab: str | None, estimator: str | None
) -> tuple[list[Plot], Sequence[Shade]]:
    """Return the plots of a tab, and what is shaded."""
    drawings = {(name.lower(), label): plots for name, label, plots in list_drawings(result)}
    by_tab: dict[str, list[str]] = {}
    for name, label in drawings:
        by_tab.setdefault(name, []).append(label)
    name = tab.lower() if tab is not None else next(iter(by_tab), "")
    labels = _choose(by_tab, name, "tabs")
    label = labels[0] if estimator is None or labels == [""] else estimator
    if label not in labels:
        raise ConfigError(f"estimator = {label!r} has no plots there{suggest(label, labels, 'filters')}")
    return drawings[name, label], series.shades(result.events)


def _find_courses(campaign: Campaign, quantity: str | None) -> tuple[list[Plot], Sequence[Shade]]:
    """Return the plot of a quantity along the runs of each condition, and the outages of the first."""
    from bench.views.report import campaign_page

    colors = series.estimator_colors(list(dict.fromkeys(one.label for one in campaign.outcomes)))
    by_name: dict[str, list[Plot]] = {}
    shaded: Sequence[Shade] = ()
    for number, plots, shades in campaign_page.plot_courses(campaign, colors):
        shaded = shaded if number else shades
        for plot in plots:
            by_name.setdefault(plot.path[-1], []).append(plot)
    return _choose(by_name, quantity, "quantities"), shaded


def _draw_topics(card: Card) -> dict[str, Plot]:
    """Return a plot of each topic with ratios: on each flight the value and its interval."""
    plots = {}
    for topic in _RATIOS:
        lines = [one for one in card.lines if one.topic == topic and one.value and one.low and one.high]
        if lines:
            x = np.arange(len(lines), dtype=float)
            ends = np.array([(one.low, one.high, np.nan) for one in lines], float).ravel()
            values = np.array([one.value for one in lines], float)
            color = series.ESTIMATORS[0]
            drawn = (
                series.draw_line("interval", np.repeat(x, 3), ends, "95 % interval", color),
                series.draw_dots("value", x, values, card.estimator, color),
            )
            names = tuple((float(k), one.flight) for k, one in enumerate(lines))
            over = "" if topic == "honesty" else f" over that of {card.against}"
            title = f"{card.estimator}: {lines[0].figure}{over}"
            plots[topic] = Plot((topic,), title, drawn, over="flight", across="", log="y", ticks=names)
    return plots


def _choose(known: Mapping[str, _T], name: str | None, what: str) -> _T:
    """Return the value of a name, the first if it is None; `ConfigError` if there is none."""
    chosen = next(iter(known), "") if name is None else name
    if chosen not in known:
        raise ConfigError(f"{chosen!r} has no plots{suggest(chosen, known, what)}")
    return known[chosen]


def write_figures(
    folder: Path, result: RunResult, form: str, *, width_mm: float = COLUMN_MM, serif: bool = False
) -> list[Path]:
    """Draw every tab of a result into a folder, one file for each filter, and return the files."""
    drawings = {
        "-".join(part for part in (label, name.lower()) if part): plots
        for name, label, plots in list_drawings(result)
    }
    return write_drawings(
        folder, drawings, series.shades(result.events), form, width_mm=width_mm, serif=serif
    )


def write_drawings(
    folder: Path,
    drawings: Mapping[str, Sequence[Plot]],
    shades: Sequence[Shade],
    form: str,
    *,
    width_mm: float = COLUMN_MM,
    serif: bool = False,
) -> list[Path]:
    """Draw plots below each other into a file for each name, and return the files."""
    import matplotlib as mpl

    written = []
    for name, plots in drawings.items():
        path = folder / f"{name}.{form}"
        with mpl.rc_context({"svg.hashsalt": "bench"}), durable.open_binary(path) as file:
            figure = _draw(plots, shades, width_mm, serif)
            figure.savefig(file, format=form, metadata=_METADATA[form])
        written.append(path)
    return written


_METADATA: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}
"""What keeps the clock out of a file: the same result gives the same figure."""


def list_drawings(result: RunResult) -> Iterator[tuple[str, str, list[Plot]]]:
    """Yield the name of the tab, the label of the filter, and the plots of each drawing."""
    content = gather_content(result, in_space=False)
    if content is None:
        return
    for tab in TABS:
        for label, rows in tab.plots(content).items():
            plots = [plot for row in rows for plot in row]
            if plots:
                yield tab.name, label, plots


def _draw(plots: Sequence[Plot], shades: Sequence[Shade], width_mm: float, serif: bool) -> Figure:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    family = "serif" if serif else "sans-serif"
    style: Any = {"font.size": 8.0, "font.family": family, "axes.linewidth": 0.6}
    with mpl.rc_context(style):
        legends = _plan_legends(plots, width_mm / _POINT_MM - _MARGIN)
        height = len(plots) * _ROW_MM + sum(one.rows for one in legends) * _NAME_ROW * _POINT_MM
        height += _TURNED_MM * any(map(_is_crowded, plots))
        size = (width_mm / _INCH_MM, height / _INCH_MM + 0.35)
        figure = Figure(figsize=size, dpi=300, layout="constrained")
        rows = figure.subplots(len(plots), 1, sharex=True, squeeze=False)[:, 0]
        for axes, plot, legend in zip(rows, plots, legends, strict=True):
            _draw_plot(axes, plot, shades)
            axes.set_title(_shorten_title(plot), fontsize=_TITLE, loc="left", pad=2 + legend.rows * _NAME_ROW)
            if legend.columns:
                corner, at = ("lower left", (0.0, 1.0)) if legend.rows else ("lower right", (1.0, 1.0))
                axes.legend(
                    fontsize=_NAME, frameon=False, ncols=legend.columns, loc=corner, bbox_to_anchor=at,
                    borderaxespad=0.0, borderpad=0.2, handlelength=1.5, handletextpad=0.4, columnspacing=1.0,
                    labelspacing=0.3,
                )  # fmt: skip
        axis = plots[-1]
        rows[-1].set_xlabel(f"{axis.over} [{axis.across}]" if axis.across else axis.over)
    return figure


class _Legend(NamedTuple):
    """Place of the legend of a plot: beside its title, or in rows below it."""

    columns: int  # 0: without a legend
    rows: int  # 0: beside the title


def _plan_legends(plots: Sequence[Plot], room: float) -> list[_Legend]:
    """Return the legend of each plot, outside its lines; no legend if a plot above already has the names.

    ``room`` is the width of a plot [pt].
    """
    legends, told = [], set[str]()
    for plot in plots:
        names = _list_names(plot)
        widths = [_SAMPLE + len(name) * _LETTER * _NAME for name in names]
        if told >= {*names} or len(names) > _MOST_NAMES:
            legends.append(_Legend(0, 0))
        elif (len(_shorten_title(plot)) + 1) * _LETTER * _TITLE + sum(widths) <= room:
            legends.append(_Legend(len(names), 0))
        else:
            columns = min(max(int(room / max(widths)), 1), len(names))
            legends.append(_Legend(columns, -(-len(names) // columns)))
        told |= {*names}
    return legends


def _list_names(plot: Plot) -> list[str]:
    """Return the names of the lines, bands and dots of a plot."""
    return list(dict.fromkeys(name for one in plot.series for name in one.names))


def _shorten_title(plot: Plot) -> str:
    return plot.title.partition(": ")[2] or plot.title


def _draw_plot(axes: Axes, plot: Plot, shades: Sequence[Shade]) -> None:
    """Draw the lines, bands and dots of a plot."""
    for shade in shades:
        for start, end in shade.intervals:
            axes.axvspan(start, end, color=_SHADES[shade.key], lw=0)
    for one in plot.series:
        if one.band is not None:
            low, high = (one.values[:, k] for k in one.band)
            color = _darken(one.colors[0])
            axes.fill_between(one.t, low, high, color=color, alpha=0.25, lw=0, label=one.names[one.band[0]])
    seen = {one.names[one.band[0]] for one in plot.series if one.band is not None}
    for one in plot.series:
        for k, (name, color) in enumerate(zip(one.names, one.colors, strict=True)):
            if one.band is None or k not in one.band:
                label = name if name not in seen else None
                line: dict[str, Any] = {"lw": 0.8, "ls": "--" if one.dashed else "-"}
                if one.marks:
                    line = {"ls": "", "marker": ".", "ms": 1.5}
                axes.plot(one.t, one.values[:, k], color=_darken(color), label=label, **line)
                for x, y, text in zip(one.t, one.values[:, k], one.labels, strict=False):
                    axes.annotate(text, (x, y), (3, 0), textcoords="offset points", fontsize=_NAME)
                seen.add(name)
    for axis in plot.log:
        getattr(axes, f"set_{axis}scale")("log")
    if plot.ticks:
        turned: dict[str, Any] = {"rotation": 40, "ha": "right"} if _is_crowded(plot) else {}
        axes.set_xticks([at for at, _ in plot.ticks], [name for _, name in plot.ticks], **turned)
        axes.set_xlim(plot.ticks[0][0] - 0.5, plot.ticks[-1][0] + 0.9)
    axes.set_ylim(plot.limits())
    axes.tick_params(width=0.6, length=2.5)
    axes.spines[["top", "right"]].set_visible(False)


def _is_crowded(plot: Plot) -> bool:
    """Return whether the names below a plot have no room side by side."""
    return sum(len(name) for _, name in plot.ticks) > _MOST_LETTERS


def _darken(color: Color) -> tuple[float, float, float]:
    """Return the tone of a color for white paper [1]."""
    light = find_light(color)
    tone, factor = (color, _DARKER) if light is None else (light, 1.0)
    red, green, blue = (float(factor * part / 255.0) for part in np.asarray(tone))
    return red, green, blue
