"""Convert recorded IMU, GNSS and barometer files to the records that filters read.

The adapter of each format reads a file into the same columns (`LogRows`). t = 0 is the first row of the IMU.
A rate is the mean over the interval that ends at its time. An interval much longer than the median is a gap;
the row after it covers one median interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray, find_later
from bench.core.mathematics.rotation import from_euler, multiply, rotate
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import GnssFixes, GnssObservations, ImuData
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.run_records import SkyView
from bench.core.words.exceptions import ConfigError
from bench.io.config.log import RANGES, LogSpec, SourceSpec
from bench.io.foreign.solution_rows import Placing, reject_placing
from bench.io.log_formats import find_format
from bench.io.logs import formats
from bench.io.logs.formats.navego_structures import list_sensors
from bench.io.logs.local_tables import ASSUMED, place_rows
from bench.io.logs.log_heights import find_ground, set_altimeter
from bench.io.logs.log_ranges import read_ranges
from bench.io.logs.record_clock import check_order, meet_week, unwrap_week
from bench.io.logs.row_selection import (
    drop_frozen,
    drop_others,
    drop_repeated,
    drop_timeless,
    drop_unreported,
)
from bench.io.logs.rows import GNSS, IMU, INSTRUMENT_ROWS, MOST_ROWS, OPTIONAL, LogRows
from bench.io.logs.sensor_axes import turn_axes
from bench.io.logs.split_imu import read_split
from bench.io.logs.table_files import find_first, read_table
from bench.navigation.engine.kept_rows import take_rows
from bench.simulation.signals.air import SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE, airspeed_sd
from bench.simulation.signals.orbits import DAY

MOST_INSTANTS = 400_000
"""Most epochs of a solution, each of some kB: 11 hours at 10 Hz."""
GAP = 3.0
"""An interval longer than this many median intervals is a gap [1]."""


@dataclass(frozen=True, slots=True)
class LogRecords:
    """Recorded data, in b and on one clock."""

    imu: ImuData
    fixes: GnssFixes  # in the order of the file
    observations: GnssObservations | None  # of a receiver whose ranges are there, too
    sky: SkyView | None  # of such a receiver
    instruments: Mapping[str, Any]  # name -> record
    ground_alt: float  # ellipsoidal height of the ground below a radar [m]
    reported: str  # by what the receiver tells how good a fix is, in words; empty: by nothing
    origin: float  # t = 0 on the clock of the files, with the offset of the IMU [s]
    notes: tuple[str, ...]  # content of the files that is not used
    week_ends: bool  # times are seconds of a week that ends in the record
    assumed: str  # place of local positions without an origin, in words; empty otherwise
    no_ranges: str  # why a receiver with ranges has no observations, in words; empty otherwise


def read_records(spec: LogSpec) -> LogRecords:
    """Read the records of a log; rows keep the order of their files, and none is repaired.

    Raises
    ------
    ConfigError
        If a file cannot be read, lacks columns, or has an impossible value: one line with file and row.
    """
    imu_rows, observations, sky, no_ranges = read_rows(spec.imu, "imu"), None, None, ""
    gnss_rows: LogRows | None = None
    if spec.gnss is None:
        pass
    elif spec.gnss.format == RANGES:
        assert spec.assumed.gnss is not None
        gnss_rows, observations, sky, no_ranges = read_ranges(spec.gnss, spec.assumed.gnss)
    else:
        gnss_rows = read_rows(spec.gnss, "gnss")
    others = {kind: read_rows(source, kind) for kind, source in spec.instruments.items()}
    origin, end = float(imu_rows.t[0]), float(imu_rows.t.max())
    others = {kind: meet_week(rows, origin, end) for kind, rows in others.items()}
    imu = _make_imu(imu_rows, spec, origin)
    _check_length(imu, spec)
    fixes, last = _no_fixes(), float(np.nanmax(imu.t))
    if gnss_rows is not None:
        gnss_rows = meet_week(gnss_rows, origin, end)
        fixes = _make_fixes(gnss_rows, spec, origin)
    if spec.gnss is not None and not ((fixes.t >= 0) & (fixes.t <= last)).any():
        there = f"{fixes.t.min() + origin:.9g} to {fixes.t.max() + origin:.9g} s"
        raise ConfigError(
            f"{spec.gnss.path.name}: its times, {there}, do not overlap with {spec.imu.path.name}, "
            f"{origin:.9g} to {last + origin:.9g} s; both files must use one clock"
        )
    if sky is not None:
        t = sky.t - origin
        sky = take_rows(replace(sky, t=t), (t >= 0.0) & (t <= min(last, spec.until)))
    if observations is not None and spec.gnss is not None:
        t = observations.t - origin
        day = float((origin - spec.gnss.time_offset) % DAY)
        observations = replace(observations, t=t, t_arrival=t, gps_t0=day)
    if np.isfinite(spec.until):
        imu, fixes = _cut(imu, spec.until), _cut(fixes, spec.until)
    if not imu.valid.any():
        raise ConfigError(
            f"{spec.imu.path.name}: every row of the IMU has a missing value, so no filter can run"
        )
    for source, record in ((spec.imu, imu), (spec.gnss, fixes)):
        if source is not None:
            check_order(record.t, record.valid, origin, source.path.name)
    instruments = {
        kind: _cut(_make_instrument(kind, rows, spec, origin), spec.until) for kind, rows in others.items()
    }
    if "baro" in instruments and len(fixes) and find_format(spec.imu.format).knows:
        instruments["baro"] = set_altimeter(instruments["baro"], fixes, spec.start.at, spec.evaluation.begin)
    every = [rows for rows in (imu_rows, gnss_rows, *others.values()) if rows is not None]
    return LogRecords(
        imu=imu,
        fixes=fixes,
        sky=sky,
        observations=observations if observations is not None and len(observations) else None,
        instruments=instruments,
        ground_alt=find_ground(spec, instruments, fixes),
        reported="" if gnss_rows is None else _find_report(gnss_rows.values, spec),
        origin=origin,
        notes=tuple(note for rows in every for note in rows.notes),
        week_ends=any(rows.week_ends for rows in every),
        assumed="" if gnss_rows is None else gnss_rows.assumed,
        no_ranges=no_ranges,
    )


def _cut(record: Any, until: float) -> Any:
    """Return the rows of a record until a time [s]."""
    rows = record.t <= until
    return replace(record, **{one.name: getattr(record, one.name)[rows] for one in fields(record)})


def read_rows(source: SourceSpec, kind: str) -> LogRows:
    """Return the rows of a sensor of a log, an IMU in its own axes; ConfigError as for `read_records`."""
    shown, topic = source.path.name, source.topic
    form = "navego" if _is_navego(source, kind) else source.format
    if source.gyro_path is not None:
        rows = read_split(source)
    elif form == "table":
        kinds = {"imu": IMU, "gnss": GNSS, **INSTRUMENT_ROWS}[kind]
        table = read_table(source.path, kinds, OPTIONAL, MOST_ROWS, source.columns, structure=topic)
        rows = LogRows.from_table(table, shown)
        if kind == "gnss":
            rows = place_rows(rows, table, Placing(source.frame, source.origin, ASSUMED), shown)[0]
    else:
        reject_placing(shown, frame=source.frame, origin=source.origin)
        rows = formats.read(form, source.path, kind, topic)
    count = len(rows.t)
    rows = drop_timeless(rows, kind, shown)
    bad = ~np.isfinite(rows.t)
    if bad.all():
        raise ConfigError(f"{shown}: {'no row has a time; record or export it too' if count else 'no rows'}")
    if (k := find_first(bad)) is not None:
        raise ConfigError(f"{shown}: row {k + 1}: its time is not a finite number")
    rows = unwrap_week(rows, shown)
    if kind == "imu" and len(rows.t) < 2:
        raise ConfigError(f"{shown}: one row; an IMU record needs at least two")
    if kind == "imu":
        rows = drop_others(rows, shown)
    if kind == "gnss":
        rows = drop_unreported(drop_frozen(drop_repeated(rows, shown), shown), shown)
    values = dict(rows.values)
    if "arrival" in values:
        values["arrival"] = _add(values["arrival"], source.time_offset)
    return turn_axes(replace(rows, t=_add(rows.t, source.time_offset), values=values), source)


def _add(t: FloatArray, offset: float) -> FloatArray:
    return disk_arrays.fill(len(t), lambda rows: t[rows] + offset)


def _is_navego(source: SourceSpec, kind: str) -> bool:
    """Return whether a table is a structure with the fields of NaveGo, and the log names no columns."""
    if source.path.suffix.lower() != ".mat" or source.format != "table" or source.columns:
        return False
    name = source.topic or kind
    return any(one == name or one.endswith(f".{name}") for one in list_sensors(source.path, kind))


def _make_imu(rows: LogRows, spec: LogSpec, origin: float) -> ImuData:
    t, values = _add(rows.t, -origin), rows.values
    steps = np.diff(t)
    forward = steps[steps > 0]
    del steps
    if not len(forward):
        raise ConfigError(f"{spec.imu.path.name}: its times never increase")
    median = float(np.median(forward, overwrite_input=True))
    del forward
    if median > 1.0 / _LEAST_RATE:
        raise ConfigError(
            f"{spec.imu.path.name}: has {1.0 / median:.3g} rows of an IMU a second, too few to navigate (at "
            f"least {_LEAST_RATE:g}); record it faster"
        )

    def make_intervals(block: slice) -> FloatArray:
        dt = np.diff(t[block], prepend=t[max(block.start - 1, 0)])
        dt[(dt <= 0) | (dt > GAP * median)] = median
        if "interval" in values:
            given = values["interval"][block]
            dt = np.where(np.isfinite(given) & (given > 0), given, dt)
        return dt

    dt = disk_arrays.fill(len(t), make_intervals)
    rates = "dtheta" not in values
    gyro, accel = (values[name] for name in (("gyro", "accel") if rates else ("dtheta", "dvel")))

    def integrate(of: FloatArray, block: slice) -> FloatArray:
        if rates or "interval" in values:
            return of[block] * dt[block, None] if rates else of[block]
        steps = dt[block, None] / median  # an increment is that of one sample, whatever is missing before it
        return of[block] * np.where(steps > MISSING, steps, 1.0)

    def find_finite(block: slice) -> BoolArray:
        both = np.hstack([integrate(gyro, block), integrate(accel, block)])
        return np.asarray(np.isfinite(both).all(axis=1))

    q_bs = multiply(from_euler(*spec.misalignment), from_euler(*spec.mounting))

    def turn(of: FloatArray, block: slice) -> FloatArray:
        with np.errstate(invalid="ignore"):  # infinite values; such rows are not valid
            return rotate(q_bs, integrate(of, block))

    dtheta_b, dvel_b = (disk_arrays.fill((len(t), 3), partial(turn, of)) for of in (gyro, accel))
    good = disk_arrays.fill(len(t), find_finite, np.bool_) & _find_flagged(rows)
    return ImuData(t=t, dt=dt, valid=good, dtheta_b=dtheta_b, dvel_b=dvel_b)


def _find_flagged(rows: LogRows) -> BoolArray:
    """Return a mask (N,) of the rows that the instrument reports as valid: all rows if it does not report."""
    return np.asarray(rows.values.get("valid", np.ones(len(rows.t))) > 0)


def _find_arrival(rows: LogRows, origin: float) -> FloatArray:
    """Return the time at which each row (N,) reached the filter [s]: its own time, if the file has none."""
    t = rows.t - origin
    arrival = rows.values.get("arrival", rows.t) - origin
    return np.where(arrival >= t, arrival, t)


def _check_length(imu: ImuData, spec: LogSpec) -> None:
    """Raise ConfigError if the times span so much that the solution would not fit into the memory."""
    if imu.t.max() * spec.output_rate <= MOST_INSTANTS:
        return
    step = np.diff(imu.t)
    row = int(np.argmax(step))
    raise ConfigError(
        f"{spec.imu.path.name}: its times span {imu.t.max():.6g} s, at output_hz = {spec.output_rate:g} more "
        f"than {MOST_INSTANTS} epochs; the longest interval, {step[row]:.6g} s, ends at row {row + 2}"
    )


MISSING = 1.5
"""Interval, in usual intervals, from which samples are missing before its row."""
_LEAST_RATE = 5.0  # of an IMU [Hz]
_LIMITS = (("latitude", "deg", -90.0, 90.0), ("longitude", "deg", -180.0, 360.0), ("height", "m", -1e3, 1e5))


def _no_fixes() -> GnssFixes:
    n, v, c = np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3))
    return GnssFixes(n, n, np.empty(0, np.bool_), v, v, c, c, np.empty(0, np.int64))


def _make_fixes(rows: LogRows, spec: LogSpec, origin: float) -> GnssFixes:
    assert spec.gnss is not None
    shown, values = spec.gnss.path.name, rows.values
    lla = values["lla"]
    place = np.column_stack([np.rad2deg(lla[:, :2]), lla[:, 2]])
    for column, (what, unit, low, high) in zip(place.T, _LIMITS, strict=True):
        if (k := find_first((column < low - 1e-9) | (column > high + 1e-9))) is not None:
            text = f"{what} {column[k]:.9g} {unit} is outside {low:g} to {high:g}"
            raise ConfigError(f"{shown}: row {k + 1}: {text}")
    t = rows.t - origin
    vel_n = _shift_velocities(t, values.get("vel_n"), spec.velocity_offset, shown)
    valid = np.asarray(np.isfinite(lla).all(axis=1)) & lla[:, :2].any(axis=1) & _find_flagged(rows)
    if spec.quality:
        if "quality" not in values:
            raise ConfigError(f"{shown}: [gnss] quality is set, but the file has no column quality")
        valid &= np.isin(values["quality"], spec.quality)
    gnss = spec.assumed.gnss
    assert gnss is not None
    h = np.hypot(gnss.pos_h_white_sd, gnss.pos_h_markov_sd)
    pos_sd = np.array([h, h, np.hypot(gnss.pos_v_white_sd, gnss.pos_v_markov_sd)])
    vel_sd = np.hypot(gnss.vel_white_sd_n, gnss.vel_markov_sd)
    pos_factor, vel_factor = _weigh_by_report(values, spec, pos_sd, len(t))
    told = {} if spec.velocity_sd is not None else values
    return GnssFixes(
        t=t,
        t_arrival=_find_arrival(rows, origin),
        valid=valid,
        lla=lla,
        vel_n=vel_n,
        cov_pos_n=_make_covariance(values, "pos", pos_sd * pos_factor),
        cov_vel_n=_make_covariance(told, "vel", vel_sd * vel_factor),
        satellites=np.nan_to_num(values.get("satellites", np.zeros(len(t)))).astype(np.int64),
    )


def _shift_velocities(t: FloatArray, vel_n: FloatArray | None, offset: float, shown: str) -> FloatArray:
    """Return velocities at the times of the fixes, from velocities at offset times; NaN without any."""
    if vel_n is None:
        return np.full((len(t), 3), np.nan)
    if offset == 0.0:
        return vel_n
    if (k := find_first(np.diff(t) <= 0)) is not None:
        raise ConfigError(f"{shown}: row {k + 2}: velocity_offset_s needs times that increase")
    own = t + offset
    moved = np.stack([np.interp(t, own, column, left=np.nan, right=np.nan) for column in vel_n.T], axis=-1)
    step = np.diff(own)
    after = np.clip(np.searchsorted(own, t), 1, len(own) - 1)
    moved[step[after - 1] > GAP * np.median(step)] = np.nan  # no velocity near enough
    return moved


def _find_report(values: Mapping[str, FloatArray], spec: LogSpec) -> str:
    """Return the accuracy indicator of a fix, in words; empty if there is none."""
    if {"sd_pos", "cov_pos"} & values.keys():
        return "standard deviation"
    if "quality" in values and spec.quality_sd:
        return "quality class"
    words = {"dilution": "dilution of precision", "signal": "C/N0"}
    return next((text for name, text in words.items() if name in values), "")


def _weigh_by_report(
    values: Mapping[str, FloatArray], spec: LogSpec, pos_sd: FloatArray, n: int
) -> tuple[FloatArray, FloatArray]:
    """Return by what (N, 3) to multiply the sd of position and velocity that the datasheet gives.

    A class has the sd that the log gives it. With twice the median dilution of precision, or a C/N0 of 6 dB
    below its median, a fix is half as good. Without any, and where it is not a number, a factor is 1.
    """
    pos, vel = np.ones((n, 3)), np.ones((n, 3))
    by = _find_report(values, spec)
    if by == "quality class":
        for quality, sd in spec.quality_sd.items():
            pos[values["quality"] == quality] = sd / pos_sd
    elif by == "dilution of precision":
        dilution = np.where(values["dilution"] > 0, values["dilution"], np.nan)
        factor = dilution / np.nanmedian(dilution, axis=0) if np.isfinite(dilution).any() else dilution
        pos = np.nan_to_num(factor[:, [0, 0, -1]], nan=1.0)
        vel = pos
    elif by == "C/N0":
        below = np.nan_to_num(np.nanmedian(values["signal"]) - values["signal"])
        pos = vel = np.repeat(10.0 ** (below / 20.0), 3).reshape(n, 3)
    return pos, vel


def _make_covariance(values: Mapping[str, FloatArray], block: str, otherwise: FloatArray) -> FloatArray:
    """Return covariances (N, 3, 3) as reported; of other sd (N, 3) along an axis where none above 0 is."""
    if f"cov_{block}" in values:
        cov = values[f"cov_{block}"].reshape(-1, 3, 3).copy()
        variance = np.einsum("mii->mi", cov).copy()
    else:
        sd = values.get(f"sd_{block}", otherwise)
        cov, variance = np.zeros((len(sd), 3, 3)), np.where(sd > 0, sd, np.nan) ** 2
    known = np.isfinite(variance) & (variance > 0)
    cov[~(known[:, :, None] & known[:, None, :] & np.isfinite(cov))] = 0.0
    cov[:, range(3), range(3)] = np.where(known, variance, otherwise**2)
    return cov


def _make_instrument(kind: str, rows: LogRows, spec: LogSpec, origin: float) -> Any:
    """Return the record of an instrument; the sd is from its datasheet, if the file contains none."""
    row, assumed = INSTRUMENTS[kind], getattr(spec.assumed, kind)
    t, value = rows.t - origin, rows.values[row.value].reshape(len(rows.t), row.width)
    sd = rows.values.get("sd")
    if sd is None and kind == "airspeed":
        known = np.where(np.isfinite(value[:, 0]), value[:, 0], 0.0)
        sd = airspeed_sd(assumed, known, SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE)
    columns: dict[str, Any] = {row.value: value if row.width > 1 else value[:, 0]}
    columns["sd"] = np.full(len(t), assumed.white_sd) if sd is None else sd
    return row.record(
        t=t,
        t_arrival=_find_arrival(rows, origin),
        valid=np.asarray(np.isfinite(value).all(axis=1)) & _find_flagged(rows),
        **columns,
    )


def divide_intervals(imu: ImuData, cuts: FloatArray) -> ImuData:
    """Return an IMU record with intervals that also end at the given cuts, divided in proportion to time.

    A fix between two samples is then used at its own time. At 16 m/s a fix used half a sample late (5 ms) is
    8 cm off. Rows whose time is not later than that of all rows before are left unchanged.

    Parameters
    ----------
    imu : ImuData
        The record to divide.
    cuts : (M,) array
        Epochs [s]; those outside all intervals have no effect.
    """
    parents = np.flatnonzero(find_later(imu.t) & imu.valid)
    cuts = np.unique(cuts)
    at = np.searchsorted(imu.t[parents], cuts)
    inside = at < len(parents)
    cuts, at = cuts[inside], parents[at[inside]]
    start = imu.t[at] - imu.dt[at]
    inside = (cuts > start + SAME_INSTANT) & (cuts < imu.t[at] - SAME_INSTANT)
    cuts, at = cuts[inside], at[inside]
    divided = {
        name: disk_arrays.empty((len(imu) + len(cuts), *column.shape[1:]), column.dtype.type)
        for name, column in ((f.name, getattr(imu, f.name)) for f in fields(imu))
    }
    filled = 0
    for block in disk_arrays.blocks(len(imu)):
        first, last = np.searchsorted(at, [block.start, block.stop])
        part = _divide_block(imu, block, cuts[first:last], at[first:last])
        for name, rows in part.items():
            divided[name][filled : filled + len(rows)] = rows
        filled += len(part["t"])
    return ImuData(**divided)


def _divide_block(imu: ImuData, block: slice, cuts: FloatArray, at: IntArray) -> dict[str, NDArray[Any]]:
    """Return the columns of a block of rows, of which the rows ``at`` (M,) are divided at the cuts (M,)."""
    count = block.stop - block.start
    row = np.concatenate([np.arange(block.start, block.stop), at])
    end = np.concatenate([imu.t[block], cuts])
    order = np.lexsort((np.concatenate([np.ones(count), np.zeros(len(cuts))]), row))
    row, end = row[order], end[order]
    same = np.concatenate([[False], row[1:] == row[:-1]])
    begin = np.where(same, np.concatenate([[0.0], end[:-1]]), imu.t[row] - imu.dt[row])
    several = np.bincount(row - block.start, minlength=count)[row - block.start] > 1
    dt = np.where(several, end - begin, imu.dt[row])
    share = (dt / imu.dt[row])[:, None]
    return {
        "t": end,
        "dt": dt,
        "valid": imu.valid[row],
        "dtheta_b": imu.dtheta_b[row] * share,
        "dvel_b": imu.dvel_b[row] * share,
    }
