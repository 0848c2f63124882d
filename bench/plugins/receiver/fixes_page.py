"""The report of the fixes of a GNSS receiver: where they lie, how they scatter, and with which satellites."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bench.core.mathematics.units import HOUR
from bench.core.records.findings import FindingTable, ShownText
from bench.core.records.findings.looks import find_look
from bench.core.records.findings.series import Plot
from bench.core.words.wording import format_number
from bench.plugins.receiver import receiver_plots
from bench.plugins.receiver.rinex_fixes import RinexFixes, tabulate_satellites
from bench.simulation.signals.orbits import DAY
from bench.views.report import page, svg

_LONG = 7200.0  # a longer record has an axis of hours [s]

_SATELLITES = "Epochs with a fix where each was used or left out; residuals of its ranges"


def make_page(solved: RinexFixes) -> str:
    """Return the report of the fixes of a RINEX file as HTML."""
    figures, against = solved.figures(), receiver_plots.name_reference(solved)
    named = [ShownText(receiver_plots.name_figure(name), tip=name) for name in figures]
    columns = {"figure": named, "value": list(figures.values())}
    good = solved.fixes.valid
    error, t = receiver_plots.find_errors(solved), receiver_plots.count_seconds(solved)
    placed = error[receiver_plots.find_placed(error, solved), :2]
    at_rest = solved.compared or not solved.moving
    distance = np.hypot(*placed.T)
    circles = [(f"{q} %", float(np.percentile(distance, q))) for q in (50, 95) if at_rest and len(placed)]
    instants = [("antenna" if solved.compared else "median", np.zeros(2))] if at_rest else []
    shift = _HourAxis.of(solved, float(t[-1]))
    plots = []
    if good.any():
        plots = [
            *receiver_plots.plot_fixes(solved, error),
            *receiver_plots.plot_residuals(solved),
            *receiver_plots.plot_satellites(solved),
        ]
    return page.render(
        "fixes.html.jinja",
        title=f"Fixes of {solved.name}",
        facts=list(_list_facts(solved)),
        card=_make_card(solved, figures),
        notes=solved.notes,
        satellites=tabulate_satellites(solved.list_satellites(), _SATELLITES),
        figures=FindingTable("figures", f"Errors are relative to {against}", columns),
        against=against,
        track=svg.draw_track([], placed, (), instants, circles) if len(placed) else "",
        circles=[f"{name} of the fixes within {format_number(radius, 3)} m" for name, radius in circles],
        plots=[page.make_figure(shift(plot), (shift.begin, shift.end), ()) for plot in plots],
        times=shift.words,
    )


class _HourAxis(NamedTuple):
    """The horizontal axis: hours since the start of the first day, or seconds of a short record."""

    begin: float
    end: float
    per_second: float
    unit: str
    words: str

    @classmethod
    def of(cls, solved: RinexFixes, duration: float) -> _HourAxis:
        """Return the axis of a record that lasts so long [s]."""
        if duration < _LONG:
            return cls(0.0, max(duration, 1.0), 1.0, "s", "Times are seconds since the first epoch.")
        begin = (solved.observations.origin + solved.observations.t[0]) % DAY / HOUR
        words = f"Times are hours since 0:00 of {solved.day}, GPS time."
        return cls(float(begin), float(begin) + duration / HOUR, 1.0 / HOUR, "h", words)

    def __call__(self, plot: Plot) -> Plot:
        """Return a plot over seconds since the first epoch with this axis."""
        series = tuple(replace(one, t=self.begin + one.t * self.per_second) for one in plot.series)
        return replace(plot, series=series, across=self.unit)


def _list_facts(solved: RinexFixes) -> Iterator[str]:
    """Yield when and where the receiver was, and how many fixes there are."""
    yield solved.hours
    good = solved.fixes.valid
    if good.any():
        lat, lon, height = receiver_plots.find_middle(solved.fixes.lla[good])
        yield f"near {np.degrees(lat):.5f}°, {np.degrees(lon):.5f}°, {height:.0f} m"
    yield f"{int(good.sum())} fixes in {len(good)} epochs"


def _make_card(solved: RinexFixes, figures: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the verdict with the errors; None if nothing is known of them."""
    word, sentence = solved.judge()
    if not word:
        return None
    lines = []
    for name, key in (("horizontal", "horizontal"), ("height", "vertical")):
        half, most = (figures[f"{key}_{which}_m"] for which in ("median", "95"))
        lines.append(f"{name} error {half:.1f} m (half of the fixes), {most:.1f} m (95 %)")
    return {"word": word, "look": find_look(word), "lines": [*lines, sentence]}
