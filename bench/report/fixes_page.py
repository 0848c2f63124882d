"""The report of the fixes of a GNSS receiver: where they lie, how they scatter, and with which satellites."""

from __future__ import annotations

from bench.exchange.rinex_fixes import RinexFixes
from bench.plots import receiver_plots
from bench.report import page, svg
from bench.wording import format_number


def make_page(solved: RinexFixes) -> str:
    """Return the report of the fixes of a RINEX file as HTML."""
    figures = solved.figures()
    fixes, good = solved.fixes, solved.fixes.valid
    error, t = receiver_plots.find_errors(solved), receiver_plots.count_seconds(solved)
    placed = error[receiver_plots.find_placed(error, solved), :2]
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
        facts=[f"{solved.day}, GPS time", f"{len(fixes)} epochs", f"{int(good.sum())} fixes"],
        notes=[*filter(None, [solved.verdict()]), *solved.notes],
        satellites=[
            (one.name, one.epochs, one.excluded, *(format_number(v) for v in one[3:]))
            for one in solved.list_satellites()
        ],
        figures=[
            (name, format_number(value) if isinstance(value, float) else str(value))
            for name, value in figures.items()
        ],
        against=receiver_plots.name_reference(solved),
        track=svg.draw_track([], placed) if len(placed) else "",
        plots=[page.make_figure(plot, (0.0, float(max(t[-1], 1.0))), ()) for plot in plots],
    )
