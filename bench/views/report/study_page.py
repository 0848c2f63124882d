"""The report of a study: its answer in sentences, its figures and its tables, on one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.core.mathematics.units import split_unit
from bench.core.records.findings import FindingTable, StudyResult
from bench.core.records.findings.series import Plot
from bench.core.words.notebook import format_cell
from bench.evaluation.ensembles.ensemble import qualify
from bench.views.report import page
from bench.views.report.page import CaptionedPlot

_LONG = 40  # text in a cell that is broken into lines


def make_page(result: StudyResult, written: str = "") -> str:
    """Return the report of a study, which was ``written`` on that day, as HTML."""
    return page.render(
        "study.html.jinja",
        title=f"Study: {result.name}",
        question=result.question,
        facts=[*_list_facts(result), *([f"written {written}"] if written else [])],
        verdicts=result.verdicts,
        figures=[_draw(plot) for plot in result.findings.figures],
        tables=[_lay_out(table) for table in result.findings.tables],
        command=result.command,
        options=[(key, _say(value)) for key, value in result.options.items() if value not in (None, (), [])],
        provenance=list(page.list_provenance(result.provenance)),
    )


def _list_facts(result: StudyResult) -> list[str]:
    runs = result.findings.runs
    return [
        f"at least {runs} runs behind each interval{qualify(runs)}"
        if runs
        else "nothing is drawn: the same each time",
        f"{result.wall_s:.1f} s",
    ]


def _say(value: object) -> str:
    return ", ".join(map(_say, value)) if isinstance(value, list | tuple) else f"{value}".removesuffix(".0")


def _draw(plot: Plot) -> CaptionedPlot:
    axis = f"{plot.over} [{plot.across}]" if plot.across else plot.over
    return page.make_figure(plot, _find_window(plot), ())._replace(title=f"{plot.title} over {axis}")


def _find_window(plot: Plot) -> tuple[float, float]:
    """Return where the horizontal axis begins and ends; names of dots have room to their right."""
    if plot.ticks:
        return plot.ticks[0][0] - 0.5, plot.ticks[-1][0] + 0.9
    ends = [(line.t[np.isfinite(line.t)].min(), line.t[np.isfinite(line.t)].max()) for line in plot.series]
    first, last = float(min(low for low, _ in ends)), float(max(high for _, high in ends))
    if first == last:
        first, last = (0.5 * first, 2.0 * last) if "x" in plot.log else (first - 1.0, last + 1.0)
    if any(line.marks for line in plot.series):  # whole dots at the ends, too
        margin = (last / first) ** 0.03 if "x" in plot.log else 0.03 * (last - first)
        first, last = (first / margin, last * margin) if "x" in plot.log else (first - margin, last + margin)
    return first, last


def _lay_out(table: FindingTable) -> tuple[FindingTable, dict[str, str]]:
    """Return a table with the words of its columns, and their classes."""
    heads = {name: _name_column(name) for name in table.columns}
    return replace(table, heads=heads), {name: _find_kind(values) for name, values in table.columns.items()}


def _name_column(name: str) -> str:
    words, unit = split_unit(name)
    return words.replace("_", " ") + (f" [{unit}]" if unit else "")


def _find_kind(values: Sequence[object]) -> str:
    """Return the class of a column: text is aligned left, long text wraps over several lines."""
    if not any(isinstance(value, str) for value in values):
        return "number"
    return "words" if max(len(format_cell(value)) for value in values) > _LONG else "text"
