"""The satellites of a measurement-level receiver: C/N0 of each, how many are used, DOP."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.data import SkyView
from bench.findings.series import (
    AXIS_COLOURS,
    SLOW,
    Plot,
    Rows,
    Series,
    draw_line,
)
from bench.orbit_sets import SYSTEM_NAMES, name_satellite
from bench.palette import Colour
from bench.plots.content import Content, Tab
from bench.signals import dilution

USED: Colour = (80, 190, 90)
_FRAME: Colour = (120, 120, 120)
_WORST = 50.0  # a larger DOP is no geometry to speak of


def _plots(content: Content) -> Mapping[str, Rows]:
    """Return C/N0 by system, satellites used, DOP."""
    sky = content.sensed.sky
    if sky is None or not len(sky):
        return {}
    first, t = find_epochs(sky)
    start = np.append(first, len(sky))
    count = np.add.reduceat(sky.used, first, dtype=np.int64).astype(float)
    above = np.diff(start).astype(float)
    dop = dilution.compute_dop(start, _toward_n(sky), sky.system, sky.used)
    strength = [
        Plot(("satellites", "cn0", name), f"C/N0 of {name} satellites [dB-Hz]", series)
        for code, name in enumerate(SYSTEM_NAMES)
        if (series := _strengths(sky, code, t))
    ]
    counts = (
        draw_line("above", t, above, "above the mask", _FRAME),
        draw_line("used", t, count, "used", USED),
    )
    numbers = Plot(("satellites", "number"), "Satellites above the mask, and used", counts)
    values = np.column_stack([dop.p, dop.h, dop.v])
    values[~(values < _WORST)] = np.nan
    lines = Series("dop", t, values, ("PDOP", "HDOP", "VDOP"), AXIS_COLOURS, (1.5,) * 3, most=SLOW)
    geometry = Plot(("satellites", "dop"), "Dilution of precision", (lines,))
    return {"": [[plot] for plot in (*strength, numbers, geometry)]}


def find_epochs(sky: SkyView) -> tuple[IntArray, FloatArray]:
    """Return the first row (M,) and the time (M,) of each epoch."""
    first: IntArray = np.append(0, np.flatnonzero(np.diff(sky.t) != 0) + 1)
    return first, sky.t[first]


def _toward_n(sky: SkyView) -> FloatArray:
    level = np.cos(sky.elevation)
    return np.column_stack([level * np.cos(sky.azimuth), level * np.sin(sky.azimuth), -np.sin(sky.elevation)])


def _strengths(sky: SkyView, system: int, t: FloatArray) -> tuple[Series, ...]:
    """Return C/N0 of every satellite of a system that was received, NaN where it was not."""
    series = []
    for sat in np.unique(sky.sat[(sky.system == system) & np.isfinite(sky.cn0)]):
        mine = (sky.system == system) & (sky.sat == sat)
        values = np.full(len(t), np.nan)
        values[np.searchsorted(t, sky.t[mine])] = sky.cn0[mine]
        name = name_satellite(system, int(sat))
        hue = colorsys.hsv_to_rgb(0.618 * float(sat) % 1.0, 0.7, 0.95)  # neighbours far apart
        colour = (int(255 * hue[0]), int(255 * hue[1]), int(255 * hue[2]))
        series.append(draw_line(name, t, values, name, colour))
    return tuple(series)


SATELLITES = Tab("Satellites", 80, _plots)
