"""The satellites of a measurement-level receiver: C/N0 of each, how many are used, DOP, the sky over it."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from bench import rotation
from bench.arrays import FloatArray, IntArray
from bench.data import GPS, SkyView, Trajectory
from bench.recording.content import Content, Tab
from bench.recording.drawing import (
    AXIS_COLOURS,
    SLOW,
    TIMELINE,
    Colour,
    Plot,
    Rows,
    Series,
    draw_line,
    entity,
    thin,
)
from bench.signals import least_squares

SKY = "/sky"
"""Entity of the sky plot: x east, y south, 1 at the horizon."""

USED: Colour = (80, 190, 90)
RECEIVED: Colour = (255, 205, 50)
LOST: Colour = (230, 70, 70)
_FRAME: Colour = (120, 120, 120)
_ANTENNA: Colour = (90, 140, 250)
_PACE = 1.0  # of the sky plot [Hz]
_WORST = 50.0  # a larger DOP is no geometry to speak of


def _plots(content: Content) -> Mapping[str, Rows]:
    """Return C/N0 by system, satellites used, DOP."""
    sky = content.sensed.sky
    if sky is None or not len(sky):
        return {}
    first, t = _epochs(sky)
    start = np.append(first, len(sky))
    count = np.add.reduceat(sky.used, first, dtype=np.int64).astype(float)
    above = np.diff(start).astype(float)
    dop = least_squares.compute_dop(start, _toward_n(sky), sky.system, sky.used)
    strength = [
        Plot(entity("satellites", "cn0", name), f"C/N0 of {name} satellites [dB-Hz]", series)
        for name, code in (("GPS", GPS), ("GLONASS", 1 - GPS))
        if (series := _strengths(sky, code, t))
    ]
    counts = (
        draw_line("above", t, above, "above the mask", _FRAME),
        draw_line("used", t, count, "used", USED),
    )
    numbers = Plot(entity("satellites", "number"), "Satellites above the mask, and used", counts)
    values = np.column_stack([dop.p, dop.h, dop.v])
    values[~(values < _WORST)] = np.nan
    keep = thin(t, SLOW)
    lines = Series("dop", t[keep], values[keep], ("PDOP", "HDOP", "VDOP"), AXIS_COLOURS, (1.5,) * 3)
    geometry = Plot(entity("satellites", "dop"), "Dilution of precision", (lines,))
    return {"": [[plot] for plot in (*strength, numbers, geometry)]}


def _send(stream: Any, content: Content) -> None:
    """Send the sky plot: satellites by what the receiver has of them, and where its antenna ends to see."""
    sky, truth, antenna_mask = content.sensed.sky, content.motion, content.antenna_mask
    if sky is None or antenna_mask is None or not isinstance(truth, Trajectory):
        return
    circle = np.linspace(0.0, 2.0 * np.pi, 73)
    rings = [_place(np.full(73, np.deg2rad(el)), circle) for el in (0.0, 30.0, 60.0)]
    stream.log(f"{SKY}/rings", rr.LineStrips2D(rings, colors=_FRAME), static=True)
    corners = [[0.0, -1.07], [1.07, 0.0], [0.0, 1.07], [-1.07, 0.0]]
    names = rr.Points2D(corners, labels=["N", "E", "S", "W"], colors=_FRAME, radii=0.005, show_labels=True)
    stream.log(f"{SKY}/directions", names, static=True)
    if not len(sky):
        return
    first, t = _epochs(sky)
    keep = np.arange(len(t))[thin(t, _PACE)]
    counts = np.diff(np.append(first, len(sky)))[keep]
    shown = np.concatenate([np.arange(first[k], first[k] + n) for k, n in zip(keep, counts, strict=True)])
    state = np.where(sky.used, 2, np.isfinite(sky.cn0).astype(int))[shown]
    stream.send_columns(
        f"{SKY}/satellites",
        [rr.TimeColumn(TIMELINE, duration=t[keep])],
        rr.Points2D.columns(
            positions=_place(sky.elevation[shown], sky.azimuth[shown]),
            colors=np.array([LOST, RECEIVED, USED], np.uint8)[state],
            labels=[name_of(int(s), int(n)) for s, n in zip(sky.system[shown], sky.sat[shown], strict=True)],
            radii=np.full(len(shown), 0.02),
        ).partition(counts),
    )
    at = np.clip(np.searchsorted(truth.t, t[keep] - 1e-6), 0, len(truth) - 1)
    down, across = -np.sin(antenna_mask), np.cos(antenna_mask)
    edge_b = np.column_stack([across * np.cos(circle), across * np.sin(circle), np.full(73, down)])
    edges = []
    for q_nb in truth.q_nb[at]:
        n, e, d = rotation.rotate(np.tile(q_nb, (73, 1)), edge_b).T
        edges.append(_place(np.maximum(np.arcsin(np.clip(-d, -1.0, 1.0)), 0.0), np.arctan2(e, n)))
    colour = np.tile(np.array(_ANTENNA, np.uint8), (len(edges), 1))
    stream.send_columns(
        f"{SKY}/antenna",
        [rr.TimeColumn(TIMELINE, duration=t[keep])],
        rr.LineStrips2D.columns(strips=edges, colors=colour).partition(np.ones(len(edges), np.int64)),
    )


def _view() -> Any:
    """Return the view of the sky plot."""
    return rrb.Spatial2DView(
        origin=SKY,
        name="Sky: used green, received yellow, not received red; blue edge: below it the antenna is blind",
        visual_bounds=rrb.VisualBounds2D(x_range=[-1.2, 1.2], y_range=[-1.2, 1.2]),
    )


def name_of(system: int, sat: int) -> str:
    """Return the RINEX name of a satellite.

    Examples
    --------
    >>> name_of(0, 5)
    'G05'
    """
    return f"{'GR'[system]}{sat:02d}"


def _epochs(sky: SkyView) -> tuple[IntArray, FloatArray]:
    """Return the first row (M,) and the time (M,) of each epoch."""
    first: IntArray = np.append(0, np.flatnonzero(np.diff(sky.t) != 0) + 1)
    return first, sky.t[first]


def _toward_n(sky: SkyView) -> FloatArray:
    level = np.cos(sky.elevation)
    return np.column_stack([level * np.cos(sky.azimuth), level * np.sin(sky.azimuth), -np.sin(sky.elevation)])


def _place(elevation: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return places (N, 2) of directions (N,) in the sky plot: north up, east right, zenith in the middle."""
    away = 1.0 - elevation / (0.5 * np.pi)
    return np.column_stack([away * np.sin(azimuth), -away * np.cos(azimuth)])


def _strengths(sky: SkyView, system: int, t: FloatArray) -> tuple[Series, ...]:
    """Return C/N0 of every satellite of a system that was received, NaN where it was not."""
    series = []
    for sat in np.unique(sky.sat[(sky.system == system) & np.isfinite(sky.cn0)]):
        mine = (sky.system == system) & (sky.sat == sat)
        values = np.full(len(t), np.nan)
        values[np.searchsorted(t, sky.t[mine])] = sky.cn0[mine]
        name = name_of(system, int(sat))
        hue = colorsys.hsv_to_rgb(0.618 * float(sat) % 1.0, 0.7, 0.95)  # neighbours far apart
        colour = (int(255 * hue[0]), int(255 * hue[1]), int(255 * hue[2]))
        series.append(draw_line(name, t, values, name, colour))
    return tuple(series)


SATELLITES = Tab("Satellites", 80, _plots, _view, _send)
