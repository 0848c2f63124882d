"""The report of a results folder: one HTML page that needs no other file and no network."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import bench
from bench.core.files.places import PACKAGE
from bench.core.records.findings import FindingTable, make_table, series
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError
from bench.core.words.notebook import ShownFigure, ShownText, format_cell
from bench.core.words.palette import write_variables
from bench.core.words.wording import replace_control
from bench.evaluation.consistency import verdict
from bench.evaluation.consistency.headline import NEES, make_headline
from bench.evaluation.metrics.key_figures import MEANING, explain_rows, list_key_figures, tabulate_metrics
from bench.evaluation.metrics.outages import DRIFT_MEANING, tabulate_drifts
from bench.evaluation.metrics.run_metrics import find_metric
from bench.evaluation.requirements.required_metrics import judge_result, trace
from bench.io import results
from bench.views.plots.content import Content, gather_content
from bench.views.plots.facts import list_facts, list_units
from bench.views.plots.tabs import TABS
from bench.views.report import overview, svg

_INTRODUCTIONS = {
    "Comparison": "All filters in one plot each, scaled to those that stay near the middle one.",
    "Position": "Estimate minus {against}, and the reported ±3σ: a consistent filter stays inside.",
    "Velocity": "Estimate minus {against}, and ±3σ as the filter reports it.",
    "Attitude": "Error angles about north, east and down, and ±3σ as the filter reports it.",
    "Biases": "Biases as estimated, with ±3σ{drawn}.",
    "Innovations": "Measured minus expected, with ±3√S. NIS and NEES, with the central 95 % of chi-square.",
    "Flight": "How it was flown, and what the instruments reported of it.",
    "Satellites": "What the receiver had of the sky.",
}
"""Name of a tab -> what its plots show."""

_FIGURES = "Main metrics of each filter, with the bounds of one run"
_WORST_FIRST = ("bad", "wide", "none", "good")
_TRUTH = "truth"
_COLUMNS = 3  # of plots on a wide page


class CaptionedPlot(NamedTuple):
    """A plot with its caption."""

    title: str
    legend: tuple[tuple[str, str, str], ...]  # (name, color, kind) of each line, band or dots
    drawing: str


def check_page(path: Path, *, force: bool) -> None:
    """Raise ConfigError if a page cannot be written: no folder, or a file that bench did not write.

    A page of bench is replaced with ``force`` only.
    """
    if path.is_file() and b'name="generator" content="bench' not in path.read_bytes()[:2000]:
        raise ConfigError(f"{path}: not replaced, bench did not write it; -o names another file")
    results.check_file(path, force=force)


def make_page(name: str, result: RunResult) -> str:
    """Return the report of a result as HTML; ``name`` is the name of its folder."""
    content = gather_content(result, in_space=False)
    profile = result.profile
    shades = series.shades(result.events) if content is not None else ()
    window = (float(content.motion.t[0]), float(content.motion.t[-1])) if content else (0.0, 1.0)
    sections = list(_draw_sections(content, window, shades, _name_standard(result))) if content else []
    key_figures = list_key_figures(result.metrics)
    cards = [_make_card(label, values, result) for label, values in result.metrics.items()]
    return render(
        "page.html.jinja",
        title=str(profile.get("title", name)),
        name=name,
        facts=list(list_facts(result)),
        cards=cards,
        worst=min(cards, key=lambda card: _WORST_FIRST.index(card["kind"]))["label"] if cards else "",
        nees=NEES,
        figures=tabulate_metrics(result.metrics, key_figures, _FIGURES),
        all_figures=tabulate_metrics(result.metrics, _list_all(result.metrics), "All metrics"),
        meaning=MEANING,
        explanations=explain_rows(key_figures),
        required=trace(judge_result(profile, result.metrics)),
        drifts=_tabulate_drifts(result),
        drift_meaning=DRIFT_MEANING,
        checks=result.more.get("validity", ()),
        comparisons=result.more.get("comparisons", ()),
        overview=_draw_errors(content, window, shades) if content else None,
        track=overview.draw_track(content, shades) if content else "",
        track_legend=overview.list_track_legend(content) if content else (),
        phases=_list_phases(content, window) if content else (),
        shades=[(shade.key, shade.name) for shade in shades],
        sections=sections,
        units=list(list_units(profile)),
        events=_tabulate_events(result),
        provenance=list(list_provenance(result.provenance)),
        command=_find_command(result),
        document=results.to_json(profile),
    )


# --- words and tables ---------------------------------------------------------------------------------


def _make_card(label: str, values: Mapping[str, Any], result: RunResult) -> dict[str, Any]:
    headline = make_headline(label, values)
    remarks = [
        f"{begun:g} to {end:g} s: {text}"
        for what in ("alignment", "restart", "reset", "ended")
        if label in result.solutions
        for begun, end, text in result.solutions[label].events.select(what)
    ]
    return {
        "label": label,
        "word": headline.word,
        "kind": headline.look.kind,
        "mark": headline.look.mark,
        "lines": [line for line in (headline.reason, headline.error, *headline.more) if line],
        "text": str(values.get("verdict_text") or ""),
        "drifts": [
            text.removeprefix(f"{label}, ").removeprefix(f"{label}: ")
            for text in verdict.list_sentences(values)
        ],
        "remarks": remarks,
        "unmodeled_errors": list(values.get("unmodeled_errors") or ()),
    }


def _list_all(measured: Mapping[str, Mapping[str, Any]]) -> list[str]:
    names = dict.fromkeys(name for values in measured.values() for name in values)
    return [name for name in names if find_metric(name) is not None]


def _tabulate_drifts(result: RunResult) -> FindingTable:
    """Return the table of the drift in each outage, with each interval in the line of its quantile."""
    table = tabulate_drifts(result.more.get("outages", ()))
    return replace(table, columns={name: list(map(str, cells)) for name, cells in table.columns.items()})


def _tabulate_comparison(one: Mapping[str, Any]) -> FindingTable:
    """Return the table of a comparison of two results."""
    rows = one["rows"]
    columns = {
        "estimator": [row["estimator"] for row in rows],
        "metric": [ShownText(row["metric"], tip=row["name"]) for row in rows],
        "first": [row["old"] for row in rows],
        "second": [row["new"] for row in rows],
    }
    if not one["single"]:
        columns["verdict"] = [ShownText(row["word"], row["kind"]) for row in rows]
        columns["change"] = [row["change"] for row in rows]
    title = f"{one['first']} beside {one['other']}. {one['meaning']}"
    return FindingTable("comparison", title, columns, heads={"first": one["first"], "second": one["other"]})


def _tabulate_events(result: RunResult) -> FindingTable:
    rows = [(start, end, "", kind, text) for start, end, kind, text, *_ in result.events.rows()]
    for label, solution in result.solutions.items():
        rows += [(start, end, label, kind, text) for start, end, kind, text, *_ in solution.events.rows()]
    shown = [
        (f"{start:.1f}" if end <= start else f"{start:.1f} to {end:.1f}", label, kind.replace("_", " "), text)
        for start, end, label, kind, text in sorted(rows)
    ]
    return make_table("events", "", ("time [s]", "estimator", "kind", "what"), shown)


def read_day(result: Path) -> str:
    """Return the time at which the file of a result was written, day and minute of local time."""
    return write_minute(datetime.fromtimestamp(result.stat().st_mtime))


def write_minute(moment: datetime) -> str:
    """Return day and minute as the pages write them."""
    return f"{moment:%Y-%m-%d %H:%M}"


def list_provenance(provenance: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    """Yield name and text of each entry of the provenance."""
    for key, value in provenance.items():
        if isinstance(value, Mapping):
            inner = (f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in value.items())
            yield key.replace("_", " "), ", ".join(inner)
        else:
            yield key.replace("_", " "), "-" if value is None else str(value)


def _name_standard(result: RunResult) -> str:
    """Return what errors are relative to."""
    if "log" not in result.more:
        return _TRUTH
    return "the reference" if "reference" in result.profile else "the fixes that were kept from the filters"


def _find_command(result: RunResult) -> str:
    """Return the command that makes the same result again."""
    name = result.provenance.get("profile")
    if name is None:
        return ""
    if "log" in result.more:
        return f"bench navigate {name}"
    return f"bench run {name} --seed {result.seed}" + (f" --run {result.run}" if result.run else "")


# --- drawings -----------------------------------------------------------------------------------------


def _draw_sections(
    content: Content, window: tuple[float, float], shades: tuple[series.Shade, ...], against: str
) -> Iterable[dict[str, Any]]:
    for tab in TABS:
        groups = [
            _make_group(label, rows, window, shades)
            for label, rows in tab.plots(content).items()
            if any(rows)
        ]
        if groups:
            drawn = ", and as they were drawn" if against == _TRUTH else ""
            introduction = _INTRODUCTIONS.get(tab.name, "").format(against=against, drawn=drawn)
            yield {"name": tab.name, "introduction": introduction, "groups": groups}


def _make_group(
    label: str, rows: series.Rows, window: tuple[float, float], shades: tuple[series.Shade, ...]
) -> dict[str, Any]:
    """Return the figures of a filter on a tab; a legend common to all of them is in the heading."""
    paired = len(rows) > 1 and all(len(row) == 2 for row in rows)
    plots = [plot for row in (zip(*rows, strict=True) if paired else rows) for plot in row]
    figures = [make_figure(plot, window, shades) for plot in plots]
    legends = {figure.legend for figure in figures}
    return {
        "label": label,
        "figures": figures,
        "columns": len(rows) if paired else _COLUMNS,  # pairs stand above each other
        "legend": legends.pop() if len(legends) == 1 and len(figures) > 1 else (),
    }


def make_figure(
    plot: series.Plot, window: tuple[float, float], shades: tuple[series.Shade, ...]
) -> CaptionedPlot:
    """Draw a plot with its legend."""
    legend: dict[str, tuple[str, str, str]] = {}
    for one in plot.series:
        for k, (name, color) in enumerate(zip(one.names, one.colors, strict=True)):
            in_band = one.band is not None and k in one.band
            kind = "band" if in_band else "dots" if one.marks else "line dashed" if one.dashed else "line"
            shown = one.colors[0] if in_band else color
            legend.setdefault(name, (name, svg.css_color(shown), kind))
    title = plot.title.partition(": ")[2] or plot.title
    return CaptionedPlot(title, tuple(legend.values()), svg.draw(plot, window, shades))


def _draw_errors(
    content: Content, window: tuple[float, float], shades: tuple[series.Shade, ...]
) -> CaptionedPlot | None:
    plot = overview.plot_errors(content)
    return make_figure(plot, window, shades) if plot else None


def _list_phases(content: Content, window: tuple[float, float]) -> list[tuple[float, float, str, float]]:
    """Return left edge and width [%], words and start [s] of each leg."""
    length = window[1] - window[0]
    legs = content.motion.events.select("leg")
    return [
        (100.0 * (start - window[0]) / length, 100.0 * (end - start) / length, text, start)
        for start, end, text in legs
    ]


# --- the page -----------------------------------------------------------------------------------------


def _read(name: str) -> str:
    return (PACKAGE / "views" / "report" / name).read_text(encoding="utf-8")


def read_style() -> str:
    """Return the style of pages and drawings with the palette for the ground that the reader has."""
    light, dark = (write_variables(dark=one) for one in (False, True))
    on_dark = f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"
    return f":root {{ {light} }}\n{on_dark}\n{_read('page.css')}"


def render(template: str, *, interactive: bool = True, **values: Any) -> str:
    """Return a page from a template of this package, with the style and the script all pages share.

    What a value holds is text: nothing in it is read as HTML. The policy of the page allows its own
    script, no other, and no network. An interactive page holds uPlot, which moves its plots.
    """
    script, style = _read("page.js"), read_style()
    if interactive:
        terms, library = _read("uplot/LICENSE"), _read("uplot/uPlot.iife.min.js")
        script = f"/*\n{terms}*/\n{library}{script}"
        style = f"{_read('uplot/uPlot.min.css')}\n{style}"
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src '{_hash(script)}'"
    page: str = (
        _load_templates()
        .get_template(template)
        .render(style=style, script=script, policy=policy, version=bench.__version__, **values)
    )
    return page


@cache
def _load_templates() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_clean,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"cell": _make_cell, "comparison": _tabulate_comparison}
    return environment


def _make_cell(value: object) -> dict[str, Any]:
    """Return the text of a cell of a table, and all that a figure or a text may have besides."""
    shown = value if isinstance(value, ShownFigure | ShownText) else ShownText(format_cell(value))
    return ShownFigure("")._asdict() | ShownText("")._asdict() | shown._asdict()


def _clean(value: Any) -> Any:
    """Return a text without control characters; what is HTML already stays."""
    return replace_control(value) if type(value) is str else value


def _hash(script: str) -> str:
    """Return the hash by which the security policy of the page allows its own script and no other."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
