"""The fixes of a receiver and its satellites: errors with the computed sigma, C/N0, residuals, DOP."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import split_unit
from bench.core.records.findings import series
from bench.core.records.findings.series import AXIS_COLORS, FIX, Plot, Series
from bench.core.records.orbit_sets import SYSTEM_NAMES
from bench.plugins.receiver.rinex_fixes import RinexFixes
from bench.views.plots.tabs.satellites import draw_satellites, plot_sky

SIGMA = "±3σ, as computed"
_WORDS = {
    "nees_3": "NEES / 3 (1 is right)",
    "nees_horizontal_2": "horizontal NEES / 2 (1 is right)",
    "hdop_median": "HDOP, median",
    "vdop_median": "VDOP, median",
}
"""Figures whose identifier is no words -> their words."""


def count_seconds(solved: RinexFixes) -> FloatArray:
    """Return the times of the epochs (M,) since the first [s]."""
    t = solved.observations.t
    return np.asarray(t - t[0])


def find_errors(solved: RinexFixes) -> FloatArray:
    """Return where the fixes lie (M, 3) [m], n: from the known antenna, or from their median."""
    if solved.compared:
        return solved.errors()
    lla, good = solved.fixes.lla, solved.fixes.valid
    if not good.any():
        return np.full((len(lla), 3), np.nan)
    return earth.difference_n(lla, find_middle(lla[good]))


def find_middle(lla: FloatArray) -> FloatArray:
    """Return the median (3,) of places lla (M, 3), which may lie on both sides of the date line."""
    middle = earth.displace(lla[0], np.median(earth.difference_n(lla, lla[0]), axis=0))
    middle[1] = math.remainder(middle[1], math.tau)
    return middle


def find_placed(error: FloatArray, solved: RinexFixes) -> BoolArray:
    """Return a mask (M,) of the epochs with a fix and a known error (M, 3): a truth may not cover all."""
    return np.asarray(solved.fixes.valid & np.isfinite(error).all(axis=1))


def name_reference(solved: RinexFixes, *, short: bool = False) -> str:
    """Return in words what the errors are relative to; ``short`` for a heading."""
    if not solved.compared:
        return "their median" if short else "the median of the fixes"
    header = "the header" if short else "the position in the header of the file"
    name = header if solved.truth is None else "the truth"
    if not solved.truth_sd:
        return name
    return (
        f"{name}, sd {solved.truth_sd:g} m"
        if short
        else f"{name}, good to {solved.truth_sd:g} m (sd along each axis)"
    )


def name_figure(name: str) -> str:
    """Return a figure of `RinexFixes.figures` in words, with its unit."""
    words, unit = split_unit(name)
    words = _WORDS.get(name) or words.replace("_95", ", 95 % below").replace("_median", ", median")
    return words.replace("_", " ") + (f" [{unit}]" if unit else "")


def plot_fixes(solved: RinexFixes, error: FloatArray) -> Iterator[Plot]:
    """Yield the errors (M, 3) of position with the computed sigma, and the velocity if there is any."""
    fixes, good = solved.fixes, solved.fixes.valid
    t, sd = count_seconds(solved), np.sqrt(np.einsum("mii->mi", fixes.cov_pos_n))
    for k, axis in enumerate(series.AXES_N):
        bounds = Series(
            "bounds", t[good], 3.0 * np.column_stack([sd[good, k], -sd[good, k]]), (SIGMA,) * 2,
            (series.BAND,) * 2, (1.0, 1.0), band=(0, 1),
        )  # fmt: skip
        dots = series.draw_dots("fix", t[good], error[good, k], "fix", FIX)
        yield Plot(("fixes", axis), f"{axis} position [m]", (bounds, dots))
    moving = np.isfinite(fixes.vel_n).all(axis=1) & good
    if moving.any():
        lines = tuple(
            series.draw_dots(axis, t[moving], fixes.vel_n[moving, k], axis, AXIS_COLORS[k])
            for k, axis in enumerate(series.AXES_N)
        )
        yield Plot(("fixes", "velocity"), "velocity [m/s]", lines)


def plot_satellites(solved: RinexFixes) -> list[Plot]:
    """Return C/N0 of each satellite by system if it is known, the number of satellites, and DOP."""
    sky = solved.view_sky(count_seconds(solved))
    return plot_sky(sky, "the horizon") if len(sky) else []


def plot_residuals(solved: RinexFixes) -> Iterator[Plot]:
    """Yield the residuals of the ranges that are used, by system, without satellites left out."""
    seen, residual = solved.seen, solved.solution.residual
    t = count_seconds(solved)
    for system, name in enumerate(SYSTEM_NAMES):
        rows = (seen.system == system) & solved.solution.used & np.isfinite(residual)
        if rows.any():
            dots = draw_satellites(system, seen.sat[rows], t[seen.epoch[rows]], residual[rows], t, marks=True)
            yield Plot(("fixes", "residuals", name), f"residuals of {name} ranges [m]", dots)
