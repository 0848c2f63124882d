"""The sky over a receiver: its satellites, and where its antenna is blind."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.findings.series import thin
from bench.core.records.orbit_sets import name_satellite
from bench.core.records.run_records import SkyView
from bench.core.words.palette import Color
from bench.views.plots.content import Content
from bench.views.plots.tabs.satellites import USED, find_epochs
from bench.views.recording.drawing import TIMELINE

SKY = "/sky"
"""Entity of the sky plot: x east, y south, 1 at the horizon."""

RECEIVED: Color = (255, 205, 50)
LOST: Color = (230, 70, 70)
_FRAME: Color = (120, 120, 120)
_ANTENNA: Color = (90, 140, 250)
_PACE = 1.0  # of the sky plot [Hz]


def send(stream: Any, content: Content) -> None:
    """Send the sky plot: satellites and, with a truth, where the antenna ends to see."""
    sky, truth, antenna_mask = content.sensed.sky, content.motion, content.antenna_mask
    if sky is None:
        return
    t, shown_from = send_satellites(stream, sky, float(truth.t[0]))
    if not len(t) or antenna_mask is None or not isinstance(truth, Trajectory):
        return
    circle = np.linspace(0.0, 2.0 * np.pi, 73)
    at = np.clip(np.searchsorted(truth.t, t - 1e-6), 0, len(truth) - 1)
    down, across = -np.sin(antenna_mask), np.cos(antenna_mask)
    edge_b = np.column_stack([across * np.cos(circle), across * np.sin(circle), np.full(73, down)])
    edges = []
    for q_nb in truth.q_nb[at]:
        n, e, d = rotation.rotate(np.tile(q_nb, (73, 1)), edge_b).T
        edges.append(place(np.maximum(np.arcsin(np.clip(-d, -1.0, 1.0)), 0.0), np.arctan2(e, n)))
    color = np.tile(np.array(_ANTENNA, np.uint8), (len(edges), 1))
    stream.send_columns(
        f"{SKY}/antenna",
        [rr.TimeColumn(TIMELINE, duration=shown_from)],
        rr.LineStrips2D.columns(strips=edges, colors=color).partition(np.ones(len(edges), np.int64)),
    )


def send_satellites(stream: Any, sky: SkyView, begin: float) -> tuple[FloatArray, FloatArray]:
    """Send rings and satellites by what the receiver has of them; return the epochs, and when they are shown.

    The first epoch stands from ``begin`` on [s]: a recording opens there.
    """
    circle = np.linspace(0.0, 2.0 * np.pi, 73)
    rings = [place(np.full(73, np.deg2rad(el)), circle) for el in (0.0, 30.0, 60.0)]
    stream.log(f"{SKY}/rings", rr.LineStrips2D(rings, colors=_FRAME), static=True)
    corners = [[0.0, -1.07], [1.07, 0.0], [0.0, 1.07], [-1.07, 0.0]]
    names = rr.Points2D(corners, labels=["N", "E", "S", "W"], colors=_FRAME, radii=0.005, show_labels=True)
    stream.log(f"{SKY}/directions", names, static=True)
    if not len(sky):
        return np.empty(0), np.empty(0)
    first, t = find_epochs(sky)
    keep = np.arange(len(t))[thin(t, _PACE)]
    if t[0] > begin:
        keep = np.append(keep[0], keep)
    counts = np.diff(np.append(first, len(sky)))[keep]
    shown = np.concatenate([np.arange(first[k], first[k] + n) for k, n in zip(keep, counts, strict=True)])
    shown_from = t[keep]
    shown_from[0] = min(shown_from[0], begin)
    state = np.where(sky.used, 2, np.isfinite(sky.cn0).astype(int))[shown]
    stream.send_columns(
        f"{SKY}/satellites",
        [rr.TimeColumn(TIMELINE, duration=shown_from)],
        rr.Points2D.columns(
            positions=place(sky.elevation[shown], sky.azimuth[shown]),
            colors=np.array([LOST, RECEIVED, USED], np.uint8)[state],
            labels=[
                name_satellite(int(s), int(n)) for s, n in zip(sky.system[shown], sky.sat[shown], strict=True)
            ],
            radii=np.full(len(shown), 0.02),
        ).partition(counts),
    )
    return t[keep], shown_from


def make_view(words: str = "not received red; blue edge: below it the antenna is blind") -> Any:
    """Return the view of the sky plot; ``words`` explain what is neither used nor received."""
    return rrb.Spatial2DView(
        origin=SKY,
        name=f"Sky: used green, received yellow, {words}",
        visual_bounds=rrb.VisualBounds2D(x_range=[-1.2, 1.2], y_range=[-1.2, 1.2]),
    )


def place(elevation: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return places (N, 2) of directions (N,) in the sky plot: north up, east right, zenith in the middle."""
    away = 1.0 - elevation / (0.5 * np.pi)
    return np.column_stack([away * np.sin(azimuth), -away * np.cos(azimuth)])
