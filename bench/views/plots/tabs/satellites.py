"""The satellites of a measurement-level receiver: C/N0, number of used satellites, DOP."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.findings.series import AXIS_COLORS, SLOW, Plot, Rows, Series, draw_dots, draw_line
from bench.core.records.orbit_sets import SYSTEM_NAMES, name_satellite
from bench.core.records.run_records import SkyView
from bench.core.words.palette import Color
from bench.simulation.signals import dilution
from bench.views.plots.content import Content, Tab

USED: Color = (80, 190, 90)
_FRAME: Color = (120, 120, 120)
_WORST = 50.0  # a larger DOP is no geometry to speak of


def _plots(content: Content) -> Mapping[str, Rows]:
    sky = content.sensed.sky
    if sky is None or not len(sky):
        return {}
    return {"": [[plot] for plot in plot_sky(sky)]}


def plot_sky(sky: SkyView, above: str = "the mask") -> list[Plot]:
    """Return C/N0 by system if any is known, satellites ``above`` something and used, DOP."""
    first, t = find_epochs(sky)
    start = np.append(first, len(sky))
    count = np.add.reduceat(sky.used, first, dtype=np.int64).astype(float)
    seen = np.diff(start).astype(float)
    dop = dilution.compute_dop(start, _toward_n(sky), sky.system, sky.used)
    strength = []
    for code, name in enumerate(SYSTEM_NAMES):
        rows = (sky.system == code) & np.isfinite(sky.cn0)
        if rows.any():
            lines = draw_satellites(code, sky.sat[rows], sky.t[rows], sky.cn0[rows], t)
            strength.append(Plot(("satellites", "cn0", name), f"C/N0 of {name} satellites [dB-Hz]", lines))
    counts = (
        draw_line("above", t, seen, f"above {above}", _FRAME),
        draw_line("used", t, count, "used", USED),
    )
    numbers = Plot(("satellites", "number"), f"Satellites above {above}, and used", counts)
    values = np.column_stack([dop.p, dop.h, dop.v])
    values[~(values < _WORST)] = np.nan
    lines_of_dop = Series("dop", t, values, ("PDOP", "HDOP", "VDOP"), AXIS_COLORS, (1.5,) * 3, most=SLOW)
    return [*strength, numbers, Plot(("satellites", "dop"), "Dilution of precision", (lines_of_dop,))]


def find_epochs(sky: SkyView) -> tuple[IntArray, FloatArray]:
    """Return the first row (M,) and the time (M,) of each epoch."""
    first: IntArray = np.append(0, np.flatnonzero(np.diff(sky.t) != 0) + 1)
    return first, sky.t[first]


def _toward_n(sky: SkyView) -> FloatArray:
    level = np.cos(sky.elevation)
    return np.column_stack([level * np.cos(sky.azimuth), level * np.sin(sky.azimuth), -np.sin(sky.elevation)])


def draw_satellites(
    system: int, sat: IntArray, t: FloatArray, values: FloatArray, epochs: FloatArray, *, marks: bool = False
) -> tuple[Series, ...]:
    """Return a line, or dots, for each satellite of a system from rows (K,); NaN at other ``epochs`` (M,)."""
    series = []
    for number in np.unique(sat).tolist():
        mine = sat == number
        name = name_satellite(system, number)
        hue = colorsys.hsv_to_rgb(0.618 * float(number) % 1.0, 0.7, 0.95)  # neighbors far apart
        color = (int(255 * hue[0]), int(255 * hue[1]), int(255 * hue[2]))
        if marks:
            series.append(draw_dots(name, t[mine], values[mine], name, color))
            continue
        column = np.full(len(epochs), np.nan)
        column[np.searchsorted(epochs, t[mine])] = values[mine]
        series.append(draw_line(name, epochs, column, name, color))
    return tuple(series)


SATELLITES = Tab("Satellites", 80, _plots)
