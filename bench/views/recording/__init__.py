"""A run as a rerun recording: the flight in space, and every error with the 3 sigma of the filter.

Spatial data are float32 meters in the local level frame of the start (rigid, north, east, down); plots are
float64. The recording is for viewing a run, not for archiving it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import numpy as np
import rerun as rr

from bench.core.files import disk_arrays, durable
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.findings import series
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError, NothingToShowError
from bench.evaluation.consistency.headline import find_best
from bench.io import results
from bench.views.plots.content import gather_content
from bench.views.plots.tabs import TABS
from bench.views.recording import drawing, layout, recording_text, sky_view, space
from bench.views.recording.drawing import TIMELINE


def write(path: Path, name: str, result: RunResult) -> None:
    """Write the recording of a result.

    Parameters
    ----------
    path : Path
        The file to write, ``flight.rrd``; it is written completely or not at all.
    name : str
        Of the profile or log. The viewer keeps one layout for each name.
    result : RunResult
        As `bench.run`, `bench.navigate` or `bench.read_result` returns it. The overview shows the first
        filter whose covariance holds; without a truth, the first of all carries the vehicle.

    Raises
    ------
    OSError
        If the file cannot be written.
    bench.core.words.exceptions.NothingToShowError
        If there is no truth and no filter has a motion to show.
    """
    content = gather_content(result)
    if content is None:
        raise NothingToShowError("no filter has position, velocity and attitude at any time")
    plots = {
        tab.name: {
            label: [[drawing.linearize(plot) for plot in row] for row in rows]
            for label, rows in tab.plots(content).items()
        }
        for tab in TABS
    }
    scene = space.make_scene(content)
    main = find_best({label: result.metrics.get(label, {}) for label in result.solutions})
    shades = series.shades(content.sensed.events)
    with _strict():
        # the viewer keeps one layout per application: another profile is another application
        # chunks are cut by content and not by the clock, so that the same run gives the same recording
        stream = rr.RecordingStream(f"bench {name}", batcher_config=rr.ChunkBatcherConfig.NEVER())
        memory = stream.memory_recording()  # rerun's own file writer waits for ever when the disk is full
        stream.send_blueprint(layout.make_blueprint(scene, plots, main))
        known = result.truth is not None
        stream.send_recording_name(f"{name}, seed {result.seed}, run {result.run}" if known else name)
        space.send(stream, result.more.get("scene", {}), content)
        disk_arrays.release()
        recording_text.send(stream, result, content)
        for by_label in plots.values():
            for plot in chain.from_iterable(chain.from_iterable(by_label.values())):
                drawing.send(stream, plot, shades)
        sky_view.send(stream, content)
        durable.write(path, memory.drain_as_bytes())


def write_recording(folder: str | Path, out: str | Path | None = None, *, force: bool = False) -> Path:
    """Write the recording of a results folder, even if it was written without one, and return its path.

    Parameters
    ----------
    folder : str or Path
        A results folder, of a run or of a log.
    out : str, Path or None
        The file to write. Default ``flight.rrd`` in the results folder, which is made again.
    force : bool
        Replace the recording ``out``.

    Raises
    ------
    bench.ConfigError
        If it is not a results folder, or ``out`` is another kind of file, or there already.
    bench.core.words.exceptions.NothingToShowError
        If no solution has a motion to show.
    OSError
        If the file cannot be written; an existing file is left unchanged.
    """
    folder = Path(folder)
    result = results.read_result(folder)
    path = folder / results.RECORDING if out is None else Path(out)
    check_recording(path, force=force or out is None)
    write(path, result.name or folder.resolve().name, result)
    if out is None:
        results.add_to_mark(folder, results.RECORDING)
    return path


def check_recording(path: Path, *, force: bool) -> None:
    """Raise ConfigError if a recording cannot be written: no folder, or a file of another kind.

    A recording is replaced with ``force`` only.
    """
    if path.suffix != ".rrd":
        raise ConfigError(f"{path}: a recording is an .rrd file")
    if path.is_file():
        with path.open("rb") as file:
            if file.read(4) != b"RRF2":
                raise ConfigError(f"{path}: not replaced, it is not a recording; -o names another file")
    results.check_file(path, force=force)


def column(
    path: Path, entity: str, component: str, timeline: str = TIMELINE
) -> tuple[FloatArray, FloatArray]:
    """Read one component of a recording back.

    Parameters
    ----------
    path : Path
        The recording.
    entity, component : str
        Such as "/filters/loose-15/position/north/error" and "Scalars:scalars".
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
