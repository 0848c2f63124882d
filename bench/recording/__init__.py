"""A run as a rerun recording: the flight in space, and every error with the 3 sigma of the filter.

Spatial data are float32 metres in the local level frame of the start (rigid, north, east, down); plots are
float64. The recording is for viewing a run, not for archiving it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from bench.arrays import FloatArray
from bench.config.log import LogSpec
from bench.data import ErrorSeries, NavSolution, Sensed, Trajectory
from bench.plots import series
from bench.plots.content import Content, carrier
from bench.plots.tabs import TABS
from bench.recording import drawing, layout, sky_view, space, words
from bench.recording.drawing import TIMELINE
from bench.specs import Profile


def write(
    path: Path,
    profile: Profile | LogSpec,
    truth: Trajectory | None,
    sensed: Sensed,
    solutions: Mapping[str, NavSolution],
    errors: Mapping[str, ErrorSeries],
    metrics: Mapping[str, Mapping[str, Any]],
    outages: Sequence[Mapping[str, Any]] = (),
) -> None:
    """Write the recording of one run.

    Parameters
    ----------
    path : Path
        The file to write, ``flight.rrd``; it is written completely or not at all.
    profile : Profile or LogSpec
        The experiment, for the summary.
    truth, sensed : Trajectory or None, Sensed
        The flight and one draw of the sensors; without a truth the first estimator carries the vehicle.
    solutions, errors, metrics : mappings by estimator
        What the estimators made of it. The first is the main one: the overview shows it.
    outages : sequence of mappings
        Rows of the drift table of a log, as `bench.evaluation.outages.make_drift_row` makes them.

    Raises
    ------
    OSError
        If the file cannot be written.
    bench.errors.NothingToShowError
        If there is no truth and no estimator has a motion to show.
    """
    motion = carrier(solutions) if truth is None else truth
    sky = profile.sensors.gnss.sky if isinstance(profile, Profile) and profile.sensors.gnss else None
    mask = None if sky is None else sky.antenna_mask
    content = Content(motion, sensed, solutions, errors, profile.evaluation_from, mask)
    plots = {tab.name: tab.plots(content) for tab in TABS}
    scene = space.make_scene(motion, sensed, solutions)
    shades = series.shades(sensed.events)
    part = path.with_name(f"{path.name}.tmp")
    with _strict():
        # the viewer keeps one layout per application: another profile is another application
        # chunks are cut by content and not by the clock, so that the same run gives the same recording
        stream = rr.RecordingStream(f"bench {profile.name}", batcher_config=rr.ChunkBatcherConfig.NEVER())
        memory = stream.memory_recording()  # rerun's own file writer waits for ever when the disk is full
        stream.send_blueprint(layout.make_blueprint(scene, plots, next(iter(solutions), "")))
        title, mesh = profile.name, None
        if isinstance(profile, Profile):
            title, mesh = f"{profile.name}, seed {profile.seed}", profile.flight.mesh
        stream.send_recording_name(title)
        space.send(stream, mesh, motion, sensed, solutions)
        words.send(stream, profile, motion, sensed, solutions, metrics, outages)
        for by_label in plots.values():
            for plot in chain.from_iterable(chain.from_iterable(by_label.values())):
                drawing.send(stream, plot, shades)
        sky_view.send(stream, content)
        try:
            part.write_bytes(memory.drain_as_bytes())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


def column(
    path: Path, entity: str, component: str, timeline: str = TIMELINE
) -> tuple[FloatArray, FloatArray]:
    """Read one component of a recording back.

    Parameters
    ----------
    path : Path
        The recording.
    entity, component : str
        Such as "/estimators/loose-15/position/north/error" and "Scalars:scalars".
    timeline : str
        Its times.

    Returns
    -------
    t : (N,) array
        Times [s], in order.
    values : (N, k) array
        All numbers of each row, NaN where the row is empty: a gap in a line.

    Raises
    ------
    KeyError
        If the recording has no such column.
    """
    from rerun.chunk import RrdReader

    t, values = [], []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path != entity or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        if component not in batch.schema.names:
            continue
        flat = batch.column(component)
        there = flat.value_lengths().to_numpy(zero_copy_only=False) > 0
        while flat.type.num_fields:  # a list in a list in a column
            flat = flat.flatten()
        numbers = flat.to_numpy(zero_copy_only=False).reshape(int(there.sum()), -1)
        rows = np.full((len(there), numbers.shape[1]), np.nan)
        rows[there] = numbers
        t.append(batch.column(timeline).cast("int64").to_numpy() * 1e-9)
        values.append(rows)
    if not t:
        raise KeyError(f"{path}: no column {component} at {entity}")
    times = np.concatenate(t)
    order = np.argsort(times, kind="stable")
    return times[order], np.concatenate(values)[order]


@contextmanager
def _strict() -> Iterator[None]:
    """Make rerun raise where it would print a warning and drop the data."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)
