"""Is what a file gives back the state of a filter? It is checked before the filter goes on from it.

A saved state is data of somebody. Names, shapes and types are held against the state of the same filter
before its first piece. What compiled code takes as a place in memory, without a check of its own, is held
against the size of that memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.arrays import IntArray
from bench.data import GLONASS
from bench.navigation.engine.kept_rows import Rows
from bench.navigation.error_state_filter.measurement_rows import SATELLITE_ROWS
from bench.navigation.error_state_filter.state_blocks import GLONASS_RANGES, GPS_RANGES

_GROWING = ("epoch_start", "H", "z", "r", "tags", "live", "misses", "since", "used")
"""Arrays that have rows before the first piece, and get more."""

_SUB_VECTOR = 3  # its longest [components]


def check_state(found: Any, fresh: Any, place: str = "") -> None:
    """Check names, types and shapes of a state against those of a filter before its first piece.

    What is None there, or empty, or has no rows, has come with the pieces.

    Raises
    ------
    ValueError
        With the name of what differs.
    """
    if fresh is None or (found is None and isinstance(fresh, Mapping)):
        return
    if isinstance(fresh, Mapping):
        _require(isinstance(found, Mapping), place, "must be a table")
        if fresh:
            _require(found.keys() == fresh.keys(), place, f"must hold {', '.join(fresh)}")
            for name, inner in fresh.items():
                check_state(found[name], inner, f"{place}/{name}")
    elif isinstance(fresh, np.ndarray):
        _require(
            isinstance(found, np.ndarray) and found.dtype == fresh.dtype, place, f"must be {fresh.dtype}"
        )
        grows = fresh.ndim and (not len(fresh) or place.rpartition("/")[2] in _GROWING)
        shape = ("N", *fresh.shape[1:]) if grows else fresh.shape
        same = fresh.shape == (0,) or (
            found.ndim == fresh.ndim and found.shape[grows:] == fresh.shape[grows:]
        )
        _require(same, place, f"must have shape {shape}; got {found.shape}")
        finite = found.dtype.kind != "f" or not np.isfinite(fresh).all() or grows or np.isfinite(found).all()
        _require(finite, place, "must be finite")
    elif isinstance(fresh, list | tuple):
        _check_list(found, fresh, place)
    else:
        kinds = (int, float) if isinstance(fresh, float) else type(fresh)
        same = isinstance(found, kinds) and isinstance(found, bool) == isinstance(fresh, bool)
        _require(same, place, f"must be a {type(fresh).__name__}; got {found!r:.40}")
        finite = not isinstance(fresh, float) or not np.isfinite(fresh) or np.isfinite(found)
        _require(finite, place, "must be finite")


def _check_list(found: Any, fresh: Sequence[Any], place: str) -> None:
    """Check a list: one of numbers has a fixed length, others may have got longer, or shorter."""
    _require(isinstance(found, list | tuple), place, "must be a list")
    if fresh and isinstance(fresh[0], int | float):
        _require(len(found) == len(fresh), place, f"must have {len(fresh)} entries; got {len(found)}")
    for k, one in enumerate(found if fresh else ()):
        check_state(one, fresh[min(k, len(fresh) - 1)], f"{place}/{k}")


def check_parts(restored: object) -> None:
    """Check a filter that has been given a state, before its first step.

    Raises
    ------
    ValueError
        With the name of what is wrong.
    """
    from bench.navigation.error_state_filter.filter_run import ForwardRun
    from bench.navigation.error_state_filter.schedule import Schedule
    from bench.navigation.models.loose_tight import Passage
    from bench.navigation.start.headings import ManyHeadings
    from bench.navigation.start.restart import BetweenGaps

    for part in _list_parts(restored):
        if isinstance(part, Schedule):
            _check_schedule(part)
        elif isinstance(part, ForwardRun):
            _check_run(part)
        elif isinstance(part, ManyHeadings):
            _require(0 <= part.best < len(part.log), "best", "must be one of the hypotheses")
            _require(part.span > 0, "span", "must be positive")
    for part in _list_parts(restored):
        if isinstance(part, Passage):
            _check_passage(part)
        elif isinstance(part, BetweenGaps) and part.filter is not None:
            _require(part.intake.newest == part.filter.end, "taken", "must be the last sample of the filter")


def _list_parts(whole: object) -> Iterator[object]:
    """Yield the objects of the navigation that an object is made of, itself included."""
    seen, todo = set[int](), [whole]
    while todo:
        one = todo.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, list | tuple):
            todo += one
        elif isinstance(one, Mapping):
            todo += one.values()
        elif type(one).__module__.startswith("bench.navigation.") and hasattr(one, "__dict__"):
            yield one
            todo += vars(one).values()


def _check_schedule(schedule: Any) -> None:
    """Check what the step kernels take from a `Schedule`."""
    imu, sky = schedule.imu, schedule.sky
    for name, rows in (("earlier", schedule._earlier), ("rows", schedule.rows)):
        _require(rows.ndim == 1, name, "must have one row for each sample")
        _check_range(name, rows, len(imu))
        _require(bool((np.diff(rows) > 0).all()), name, "must increase")
    used = (imu.t[schedule.rows], imu.dtheta_b[schedule.rows], imu.dvel_b[schedule.rows], schedule.span)
    _require(all(np.isfinite(column).all() for column in used), "imu", "must be finite where it is used")
    _require(len(schedule.span) == len(schedule.rows), "span", "must have one row for each sample")
    _require(bool((schedule.span > 0).all()), "span", "must be positive")
    reached = np.concatenate([[schedule.t], used[0]])
    _require(bool((np.diff(reached) >= 0).all()), "imu/t", "must increase, and begin where the filter is")
    _require(
        schedule.end == (used[0][-1] if len(used[0]) else schedule.t), "taken", "must be the last sample"
    )
    _require(schedule.output_t.ndim == 1, "output_t", "must have one row for each answer")
    count, epochs = len(sky.t), len(sky.epoch_start) - 1
    widths = {"values": 2, "variance": 2, "sat": 6, "which": 5}
    shapes: dict[str, tuple[int, ...]] = {name: (count, width) for name, width in widths.items()}
    shapes |= {"t": (count,), "ionosphere": (count,), "sizes": (4,)} | ({"klobuchar": (8,)} if count else {})
    for name, shape in shapes.items():
        _require(getattr(sky, name).shape == shape, f"sky/{name}", f"must have shape {shape}")
    start = sky.epoch_start
    whole = epochs >= 0 and start[0] == 0 and start[-1] == count and bool((np.diff(start) >= 0).all())
    _require(whole, "sky/epoch_start", f"must rise from 0 to {count}")
    _require(not count or len(sky.zenith) > 1, "sky/zenith", "must be a table")
    for kind, rows in schedule._kinds.items():
        _check_waiting(f"kinds/{kind}", rows)
        _check_range(f"kinds/{kind}/number", rows.number, epochs if kind == SATELLITE_ROWS else 1)


def _check_waiting(place: str, rows: Rows) -> None:
    """Check the columns of measurements that wait."""
    m = len(rows.t)
    shapes = ((m,), (m,), (m, 9), (m, 6), (m,), (m,))
    for name, column, shape in zip(Rows._fields, rows, shapes, strict=True):
        wanted = np.dtype(np.int64 if name in ("slot", "number") else np.float64)
        same = isinstance(column, np.ndarray) and column.shape == shape and column.dtype == wanted
        _require(same, f"{place}/{name}", f"must be {wanted} of shape {shape}")


def _check_run(run: Any) -> None:
    """Check what the filter kernel takes from a `ForwardRun`."""
    n, gate, pending = run.model.layout.size, run.gate, run.pending
    P = run.work.ahead.P
    now = {"state": (n + 1,), "P": P.shape, "dx": (n,)}
    for name, shape in now.items():
        _require_numbers(f"now/{name}", getattr(run.now, name), shape)
    sensors, trust = len(gate.opens), gate.trust
    channels = len(trust.misses)
    _require(channels >= sensors, "gate/trust/misses", f"must have at least {sensors} rows")
    for name in ("since", "used"):
        same = getattr(trust, name).shape == (channels,)
        _require(same, f"gate/trust/{name}", f"must have {channels} rows")
    _require_numbers("gate/level", gate.level, (sensors,))
    slots, width = len(pending.live), pending.width
    rows = slots * width
    _require(width >= 2 * _SUB_VECTOR and slots > 0, "pending/width", "must hold a fix")
    shapes = {"H": (rows, n), "z": (rows,), "r": (rows,), "tags": (rows, 4)}
    for name, shape in shapes.items():
        column = getattr(pending, name)
        _require(column.shape == shape, f"pending/{name}", f"must have shape {shape}; got {column.shape}")
    _check_range("pending/live", pending.live, width + 1)
    waiting = np.arange(width)[None, :] < pending.live[:, None]
    code, channel, component, length = pending.tags.reshape(slots, width, 4)[waiting].T
    _check_range("pending/tags (sensor)", code + 1, sensors + 1)  # one that is absent has -1
    _check_range("pending/tags (channel)", channel, channels)
    _check_range("pending/tags (component)", component, _SUB_VECTOR)
    _check_range("pending/tags (length)", length - 1, _SUB_VECTOR)


def _check_passage(passage: Any) -> None:
    """Check that schedule and filter of a `Passage` belong together."""
    schedule, run = passage.schedule, passage.run
    live = run.pending.live
    kinds = {sensor.kind for sensor in passage.used} | passage.samplers.keys()
    _require(schedule._kinds.keys() <= kinds, "kinds", "must be those of the sensors of the filter")
    most = np.zeros(len(live), np.int64)
    for kind, rows in schedule._kinds.items():
        _check_range(f"kinds/{kind}/slot", rows.slot, len(live))
        held = np.full(len(rows.t), 2 * _SUB_VECTOR)
        if kind == SATELLITE_ROWS and len(held):
            held = 2 * np.diff(schedule.sky.epoch_start)[rows.number]
        np.maximum.at(most, rows.slot, held)
    most[0] = 2 * _SUB_VECTOR
    _require(bool((live <= most).all()), "pending/live", "must be of the measurements that wait")
    which, glonass = schedule.sky.which, schedule.sky.which[:, 0] == GLONASS
    _check_range("sky/which (channel)", which[:, 1:3], len(run.gate.trust.misses))
    for rows, states in ((~glonass, GPS_RANGES), (glonass, GLONASS_RANGES)):
        _check_range("sky/which (state)", which[rows, 3] + 1, states + 1)  # one that has none has -1
    shapes = {passage.channels.held.shape, passage.channels.seen.shape}
    _require(shapes == {(GPS_RANGES + GLONASS_RANGES,)}, "channels", "must have a row for each state")


def _require(good: bool, place: str, wanted: str) -> None:
    if not good:
        raise ValueError(f"{place.strip('/')} {wanted}")


def _require_numbers(name: str, values: Any, shape: tuple[int, ...]) -> None:
    _require(values.shape == shape, name, f"must have shape {shape}; got {values.shape}")
    _require(bool(np.isfinite(values).all()), name, "must be finite")


def _check_range(name: str, numbers: IntArray, end: int) -> None:
    """Check that all numbers are places in something of a length."""
    inside = numbers.dtype == np.int64 and bool(((numbers >= 0) & (numbers < end)).all())
    _require(inside, name, f"must be whole numbers from 0 to {end - 1}")
