"""The fixes of a receiver as a rerun recording: track, errors, sky, C/N0, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from bench.core.files import durable
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.findings.series import BAND, FIX, Plot, round_number
from bench.core.words.exceptions import NothingToShowError
from bench.core.words.wording import format_number
from bench.plugins.receiver import receiver_plots
from bench.plugins.receiver.rinex_fixes import RinexFixes
from bench.views.recording import drawing, layout, sky_view
from bench.views.recording.drawing import TIMELINE

TRACK, MAP = "/track", "/map/fixes"
"""Entities of the fixes from above (x east, y south [m]) and on the map."""


def write_fixes(path: Path, solved: RinexFixes) -> None:
    """Write the recording of the fixes of a receiver; its time counts from the first epoch.

    Raises
    ------
    OSError
        If the file cannot be written.
    bench.core.words.exceptions.NothingToShowError
        If there is no fix, or none where the truth tells the place.
    """
    good = find_shown(solved)
    error, t = receiver_plots.find_errors(solved), receiver_plots.count_seconds(solved)
    plots = {
        "Errors": list(receiver_plots.plot_fixes(solved, error)),
        "Residuals": list(receiver_plots.plot_residuals(solved)),
        "Satellites": receiver_plots.plot_satellites(solved),
    }
    end = float(max(t[-1], 1.0))
    stream = rr.RecordingStream("bench fixes", batcher_config=rr.ChunkBatcherConfig.NEVER())
    memory = stream.memory_recording()
    stream.send_blueprint(_make_blueprint(solved, plots, error[good], end))
    stream.send_recording_name(f"{solved.name}, {solved.day}")
    _send_track(stream, t[good], error[good], solved.fixes.lla[good])
    sky_view.send_satellites(stream, solved.view_sky(t), 0.0)
    stream.log("/summary", rr.TextDocument(_write_summary(solved), media_type="text/markdown"), static=True)
    for plot in chain.from_iterable(plots.values()):
        drawing.send(stream, plot, ())
    durable.write(path, memory.drain_as_bytes())


def find_shown(solved: RinexFixes) -> BoolArray:
    """Return the epochs (M,) with a fix that lies somewhere; raise NothingToShowError if there is none."""
    shown = receiver_plots.find_placed(receiver_plots.find_errors(solved), solved)
    if not solved.fixes.valid.any():
        raise NothingToShowError("no epoch has a fix: there is nothing to record")
    if not shown.any():
        raise NothingToShowError("the truth covers no epoch with a fix: there is nothing to record")
    return shown


def _send_track(stream: Any, t: FloatArray, error: FloatArray, lla: FloatArray) -> None:
    """Send the fixes from above, all faint and the present one bright, and on the map."""
    flat = error[:, [1, 0]] * [1.0, -1.0]
    step = round_number(max(float(np.nanpercentile(np.linalg.norm(flat, axis=1), 99)), 1e-3))
    circle = np.linspace(0.0, 2.0 * np.pi, 73)
    rings = [k * step * np.column_stack([np.cos(circle), np.sin(circle)]) for k in (1, 2)]
    stream.log(f"{TRACK}/rings", rr.LineStrips2D(rings, colors=BAND), static=True)
    names = [f"{format_number(k * step)} m" for k in (1, 2)]
    tops = [[0.0, -k * step] for k in (1, 2)]
    stream.log(
        f"{TRACK}/distances",
        rr.Points2D(tops, labels=names, colors=BAND, radii=[-1.0], show_labels=True),
        static=True,
    )
    stream.log(f"{TRACK}/all", rr.Points2D(flat, colors=[[*FIX, 110]], radii=[-1.5]), static=True)
    time = [rr.TimeColumn(TIMELINE, duration=t)]
    for entity, points, positions in (
        (f"{TRACK}/fix", rr.Points2D, flat),
        (MAP, rr.GeoPoints, np.rad2deg(lla[:, :2])),
    ):
        stream.log(entity, points.from_fields(colors=[FIX], radii=[-5.0]), static=True)
        stream.send_columns(entity, time, points.columns(positions=positions))


def _write_summary(solved: RinexFixes) -> str:
    """Return the verdict, the notes and the figures as Markdown."""
    rows = [
        f"| {receiver_plots.name_figure(name)} | {format_number(v) if isinstance(v, float) else v} |"
        for name, v in solved.figures().items()
    ]
    notes = [f"- {note}" for note in (solved.judge()[1], *solved.notes) if note]
    return "\n".join(
        [f"# {solved.name}, {solved.day}", "", *notes, "", "| figure | value |", "|---|---|", *rows]
    )


def _make_blueprint(solved: RinexFixes, plots: dict[str, list[Plot]], error: FloatArray, end: float) -> Any:
    far = 1.1 * max(float(np.nanmax(np.abs(error[:, :2]))), 1e-3)
    track = rrb.Spatial2DView(
        origin=TRACK,
        name=f"Fixes from above, north up, from {receiver_plots.name_reference(solved, short=True)}",
        visual_bounds=rrb.VisualBounds2D(x_range=[-far, far], y_range=[-far, far]),
    )
    lat = float(np.nanmedian(solved.fixes.lla[:, 0]))
    zoom = np.log2(40_075_017.0 * np.cos(lat) / 256.0 / (2.8 * far / 500.0))
    where = rrb.MapView(
        origin="/map", name="Map (its background needs the network)", zoom=float(np.clip(zoom, 1.0, 18.0))
    )
    sky = sky_view.make_view("above the horizon without C/N0 red")
    words = rrb.TextDocumentView(origin="/summary", name="Summary")
    overview = rrb.Horizontal(
        rrb.Vertical(track, where, row_shares=[3, 2]),
        rrb.Vertical(*_make_views(plots["Errors"], end)),
        words,
        column_shares=[5, 5, 3],
        name="Overview",
    )
    satellites = rrb.Horizontal(
        sky, rrb.Vertical(*_make_views(plots["Satellites"], end)), column_shares=[1, 1], name="Satellites"
    )
    residuals = rrb.Vertical(*_make_views(plots["Residuals"], end), name="Residuals")
    return layout.LinkedBlueprint(
        end,
        rrb.Tabs(overview, satellites, residuals, active_tab=0),
        rrb.TimePanel(timeline=TIMELINE, play_state="paused", playback_speed=10.0, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _make_views(plots: Sequence[Plot], end: float) -> list[Any]:
    return [layout.make_plot(end, plot, legend=True) for plot in plots]
