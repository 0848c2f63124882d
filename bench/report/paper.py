"""Figures of a result for a paper: the plots of a tab below each other, as PDF, SVG or PNG."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.errors import ConfigError
from bench.plots import series
from bench.plots.content import gather_content
from bench.plots.series import Colour, Plot, Shade
from bench.plots.tabs import TABS
from bench.run_result import RunResult
from bench.wording import suggest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("pdf", "svg", "png")
COLUMN_MM = 88.0
"""Width of a column of a journal [mm]."""

_INCH_MM = 25.4
_ROW_MM = 32.0  # height of a plot [mm]
_INSIDE = 70  # letters of all names of a legend for which there is room in a plot
_MOST_NAMES = 6  # in a legend; a line for each satellite has none
_DARKER = 0.72  # of the colours of the viewer, for white paper
_SHADES = {"outage": (0.9, 0.9, 0.9), "fault": (0.94, 0.87, 0.94)}


def plot_result(
    result: RunResult,
    tab: str,
    estimator: str | None = None,
    *,
    width_mm: float = COLUMN_MM,
    serif: bool = False,
) -> Figure:
    """Draw the plots of a tab below each other.

    Parameters
    ----------
    result : RunResult
        As `bench.run` or `bench.load` returns it.
    tab : str
        Name of a tab of the recording, such as "position"; capitals do not matter.
    estimator : str or None
        Whose; None takes the first one. Tabs that belong to no estimator have one drawing.
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
        If there is no such tab or estimator, or nothing to draw.
    """
    drawings = {(name.lower(), label): plots for name, label, plots in _list_drawings(result)}
    tabs = dict.fromkeys(name for name, _ in drawings)
    if tab.lower() not in tabs:
        raise ConfigError(f"tab = {tab!r} has no plots{suggest(tab.lower(), tabs, 'tabs')}")
    labels = [label for name, label in drawings if name == tab.lower()]
    label = labels[0] if estimator is None or labels == [""] else estimator
    if label not in labels:
        raise ConfigError(f"estimator = {label!r} has no plots there{suggest(label, labels, 'estimators')}")
    return _draw(drawings[tab.lower(), label], series.shades(result.events), width_mm, serif)


def write_figures(
    folder: Path, result: RunResult, form: str, *, width_mm: float = COLUMN_MM, serif: bool = False
) -> list[Path]:
    """Draw every tab of a result into a folder, one file for each estimator, and return the files."""
    drawings = {
        "-".join(part for part in (label, name.lower()) if part): plots
        for name, label, plots in _list_drawings(result)
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
        with mpl.rc_context({"svg.hashsalt": "bench"}):
            _draw(plots, shades, width_mm, serif).savefig(path, metadata=_METADATA[form])
        written.append(path)
    return written


_METADATA: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}
"""What keeps the clock out of a file: the same result gives the same figure."""


def _list_drawings(result: RunResult) -> Iterator[tuple[str, str, list[Plot]]]:
    """Yield the name of the tab, the label of the estimator, and the plots of each drawing."""
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
        size = (width_mm / _INCH_MM, len(plots) * _ROW_MM / _INCH_MM + 0.35)
        figure = Figure(figsize=size, dpi=300, layout="constrained")
        rows = figure.subplots(len(plots), 1, sharex=True, squeeze=False)[:, 0]
        told: set[str] = set()
        for axes, plot in zip(rows, plots, strict=True):
            names = _draw_plot(axes, plot, shades)
            if not names <= told and len(names) <= _MOST_NAMES:
                _add_legend(figure, axes, names)
            told |= names
        rows[-1].set_xlabel(f"{plots[-1].over} [{plots[-1].across}]")
    return figure


def _add_legend(figure: Figure, axes: Axes, names: set[str]) -> None:
    """Put the legend into a plot, or below all where its names are too long for that."""
    if sum(map(len, names)) <= _INSIDE:
        axes.legend(fontsize=6, frameon=False, ncols=3, loc="upper right", borderaxespad=0.1)
    else:
        lines = axes.get_legend_handles_labels()
        figure.legend(*lines, fontsize=6, frameon=False, ncols=2, loc="outside lower center")


def _draw_plot(axes: Axes, plot: Plot, shades: Sequence[Shade]) -> set[str]:
    """Draw a plot and return the names of its lines, bands and dots."""
    for shade in shades:
        for start, end in shade.intervals:
            axes.axvspan(start, end, color=_SHADES[shade.key], lw=0)
    for one in plot.series:
        if one.band is not None:
            low, high = (one.values[:, k] for k in one.band)
            colour = _darken(one.colours[0])
            axes.fill_between(one.t, low, high, color=colour, alpha=0.25, lw=0, label=one.names[one.band[0]])
    seen = {one.names[one.band[0]] for one in plot.series if one.band is not None}
    for one in plot.series:
        for k, (name, colour) in enumerate(zip(one.names, one.colours, strict=True)):
            if one.band is None or k not in one.band:
                label = name if name not in seen else None
                line = {"ls": "", "marker": ".", "ms": 1.5} if one.marks else {"lw": 0.8}
                axes.plot(one.t, one.values[:, k], color=_darken(colour), label=label, **line)
                seen.add(name)
    for axis in plot.log:
        getattr(axes, f"set_{axis}scale")("log")
    axes.set_ylim(plot.limits())
    axes.set_title(plot.title.partition(": ")[2] or plot.title, fontsize=8, loc="left", pad=2)
    axes.tick_params(width=0.6, length=2.5)
    axes.spines[["top", "right"]].set_visible(False)
    return seen


def _darken(colour: Colour) -> tuple[float, float, float]:
    red, green, blue = (float(_DARKER * part / 255.0) for part in np.asarray(colour))
    return red, green, blue
