"""The report of the fixes of a GNSS receiver: where they lie, how they scatter, and with which satellites."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench import earth
from bench.arrays import FloatArray
from bench.exchange.rinex_fixes import RinexFixes
from bench.findings import series
from bench.findings.series import AXIS_COLOURS, FIX, Plot, Series
from bench.report import page, svg
from bench.wording import format_number

_WORST = 50.0  # a larger DOP is no geometry to speak of
_SIGMA = "±3σ, as computed"


def make_page(solved: RinexFixes) -> str:
    """Return the report of the fixes of a RINEX file as HTML."""
    figures = solved.figures()
    fixes, good = solved.fixes, solved.fixes.valid
    compared = "horizontal_median_m" in figures
    error = _find_errors(solved, compared)
    window = (float(fixes.t[0]), float(max(fixes.t[-1], fixes.t[0] + 1.0)))
    plots = list(_plot(solved, error)) if good.any() else []
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
        against=_name_reference(solved, compared),
        track=svg.draw_track([], error[good, :2]) if good.any() else "",
        plots=[page.make_figure(plot, window, ()) for plot in plots],
    )


def _name_reference(solved: RinexFixes, compared: bool) -> str:
    if not compared:
        return "the median of the fixes"
    return "the position in the header of the file" if solved.truth is None else "the truth"


def _find_errors(solved: RinexFixes, compared: bool) -> FloatArray:
    """Return where the fixes lie (M, 3) [m], n: from the known antenna, or from their median."""
    if compared or not solved.fixes.valid.any():
        return solved.errors() if compared else np.full((len(solved.fixes), 3), np.nan)
    return earth.difference_n(solved.fixes.lla, np.median(solved.fixes.lla[solved.fixes.valid], axis=0))


def _plot(solved: RinexFixes, error: FloatArray) -> Iterator[Plot]:
    """Yield the errors of position with the computed sigma, velocity, satellites, and DOP."""
    fixes, good = solved.fixes, solved.fixes.valid
    t, sd = fixes.t[good], np.sqrt(np.einsum("mii->mi", fixes.cov_pos_n[good]))
    for k, axis in enumerate(series.AXES_N):
        bounds = Series(
            "bounds", t, np.column_stack([3.0 * sd[:, k], -3.0 * sd[:, k]]), (_SIGMA,) * 2,
            (series.BAND,) * 2, (1.0, 1.0), band=(0, 1),
        )  # fmt: skip
        dots = series.draw_dots("fix", t, error[good, k], "fix", FIX)
        yield Plot(("fixes", axis), f"{axis} position [m]", (bounds, dots))
    moving = np.isfinite(fixes.vel_n).all(axis=1) & good
    if moving.any():
        lines = tuple(
            series.draw_dots(axis, fixes.t[moving], fixes.vel_n[moving, k], axis, AXIS_COLOURS[k])
            for k, axis in enumerate(series.AXES_N)
        )
        yield Plot(("fixes", "velocity"), "velocity [m/s]", lines)
    used = series.draw_line("used", fixes.t, fixes.satellites.astype(float), "used", series.ESTIMATORS[0])
    yield Plot(("fixes", "satellites"), "satellites used", (used,))
    dop = np.column_stack([solved.dop.h, solved.dop.v])
    dop[~(dop < _WORST)] = np.nan
    lines = (Series("dop", fixes.t, dop, ("HDOP", "VDOP"), AXIS_COLOURS[:2], (1.5, 1.5)),)
    yield Plot(("fixes", "dop"), "dilution of precision", lines)
