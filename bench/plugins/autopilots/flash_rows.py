"""Rows of the sensors in a DataFlash log, of ArduPilot (``.bin``) or of PX4 before 2017 (``.px4log``).

ArduPilot, imu: ``RISI``, the increments of its filter, or else ``IMU``; gnss: ``GPS`` with the accuracies of
``GPA`` or ``UBX3``, heading: that of two antennas in ``GPS``; ``BARO``, ``MAG``, ``ARSP``, ``RFND``; forward,
right, down; where a driver has several, the first. Old logs count them in the name (``IMU2``), later ones in
a field (``IMU:1``). PX4: ``IMU``, ``GPS``, ``SENS``; their time is that of the last ``TIME`` before. Heights
are over the ellipsoid where the log has the undulation, else over the sea. Fixes are as old as the parameters
of the autopilot say.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.log_contents import (
    Contents,
    Vector,
    day_of_gps,
    day_of_unix,
    split_instance,
)
from bench.io.logs.rows import MOST_ROWS, LogRows
from bench.plugins.autopilots.dataflash import DataFlash
from bench.simulation.signals.air import (
    GAS_CONSTANT,
    SEA_LEVEL_PRESSURE,
    SEA_LEVEL_TEMPERATURE,
    pressure_altitude,
)

MILLI, MICRO = 1e-3, 1e-6
GAUSS = 1e-4
"""[T]"""
_RECORDS: Mapping[str, tuple[str, ...]] = {
    "imu": ("RISI", "IMU"),
    "gnss": ("GPS",),
    "baro": ("BARO", "SENS"),
    "mag": ("MAG", "IMU"),
    "airspeed": ("ARSP",),
    "radar": ("RFND",),
    "heading": ("GPS",),
}
_INSTANCES = ("I", "C", "Instance")
"""Fields that count the sensors or filters of a kind."""
_ACCURACIES = {"GPA": ("HAcc", "VAcc", "SAcc"), "UBX3": ("hAcc", "vAcc", "sAcc")}
_LATE = 0.5  # an accuracy so much away in time is another fix's [s]
_DELAYS = {"GPS_DELAY_MS": MILLI, "GPS1_DELAY_MS": MILLI, "EKF_POS_DELAY": MILLI, "INAV_DELAY_GPS": 1.0}
"""Parameters that say how old a fix is, and their unit [s]."""
_BARO_SD = ("EK3_ALT_M_NSE", "EK2_ALT_M_NSE", "EKF_ALT_NOISE")
"""Parameters that say the noise of the barometer [m]: AP_NavEKF3, AP_NavEKF2, AP_NavEKF."""
_MOST_SD = 1e3  # a larger one is damage [m]
_UBLOX_DELAY = 0.12  # where the parameter leaves it to the driver: AP_GPS_UBLOX::get_lag of M8 and later [s]
_HIGHEST = 1e5  # a height farther from 0 is not known: ArduPilot writes -2e7 then [m]
_RANGE_GOOD = 4.0  # RangeFinder::Status::Good


@lru_cache(maxsize=1)
def _open(path: Path, changed: int) -> DataFlash:
    return DataFlash(path)


def open_log(path: Path) -> DataFlash:
    """Return the records of a log; the last one stays open, so that each sensor does not read it again."""
    return _open(path, path.stat().st_mtime_ns if path.exists() else 0)


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of a sensor; ``topic`` is a record, or ``record:instance``."""
    if kind not in _RECORDS:
        raise ConfigError(f"{path.name}: no {kind} is read from a DataFlash log")
    log = open_log(path)
    wanted = (topic,) if topic else _RECORDS[kind]
    found = next((name for name in wanted if name.partition(":")[0] in log), None)
    if found is None:
        there = ", ".join(log.names)[:300]
        raise ConfigError(f"{path.name}: no records {' or '.join(wanted)}; it has {there}")
    try:
        t, data = take_records(log, found)
        if len(t) > MOST_ROWS:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
        values, notes = _READERS[kind](log, t, data)
    except KeyError as error:
        raise ConfigError(f"{path.name}: records {found} have no field {error.args[0]!r}") from None
    if log.skipped:
        notes = (*notes, f"{log.skipped} bytes of it are no records and are skipped")
    arrival = values.pop("arrival", None)
    if arrival is not None:  # the rows are as old as the log says
        t, values = t - arrival, {**values, "arrival": t}
    return LogRows(t, values, tuple(f"{path.name}: {note}" for note in notes))


def take_records(log: DataFlash, name: str) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return times (N,) and columns of ``record:instance``, or of the first instance of ``record``.

    Times are since the start of the autopilot [s].

    Raises
    ------
    ConfigError
        If there are no such rows.
    """
    record, instance = split_instance(name)
    if record not in log:
        raise ConfigError(f"{log.shown}: no records {record}")
    data = log.read(record)
    t = _read_times(log, record, data)
    field = next((one for one in _INSTANCES if one in data), None)
    if field is not None:
        of = data[field]
        rows = of == (of.min() if instance is None else instance)
        t, data = t[rows], {label: column[rows] for label, column in data.items()}
    if not len(t) or (instance is not None and field is None):
        raise ConfigError(f"{log.shown}: no records {name}")
    return t, data


def list_instances(log: DataFlash, record: str) -> list[str]:
    """Return the names of a record by which :func:`take_records` finds each of its instances."""
    if record not in log:
        return []
    data = log.read(record)
    field = next((one for one in _INSTANCES if one in data), None)
    return [record] if field is None else [f"{record}:{k:g}" for k in np.unique(data[field])]


def _read_times(log: DataFlash, record: str, data: Mapping[str, FloatArray]) -> FloatArray:
    if "TimeUS" in data:
        return data["TimeUS"] * MICRO
    if record == "GPS" and "T" in data:  # TimeMS is that of the week
        return data["T"] * MILLI
    if "TimeMS" in data:
        return data["TimeMS"] * MILLI
    for head, label in (("TIME", "StartTime"), ("RFRH", "TimeUS")):  # one heads the records that follow
        if head in log:
            before = np.searchsorted(log.find_starts(head), log.find_starts(record)) - 1
            times = log.read(head)[label] * MICRO
            return np.where(before >= 0, times[np.maximum(before, 0)], np.nan)
    raise KeyError("TimeUS")


def read_parameters(log: DataFlash) -> dict[str, float]:
    """Return the parameters at the end of a log."""
    if "PARM" not in log:
        return {}
    values = log.read("PARM")["Value"]
    return dict(zip(log.read_text("PARM", "Name"), values.tolist(), strict=True))


def look(path: Path) -> Contents:
    """Return the contents of a log."""
    log = open_log(path)
    parameters = read_parameters(log)
    sensors = tuple(kind for kind in _RECORDS if _has_rows(path, kind))
    return Contents(
        sensors,
        _find_place(parameters, "INS_POS1_"),
        _find_place(parameters, "GPS_POS1_") or _find_place(parameters, "GPS1_POS_"),
        _find_day(log),
        "SIM" in log,
        any(record in log for record in ("XKF1", "NKF1", "EKF1", "LPOS")),
        next(
            ((parameters[name], name) for name in _BARO_SD if 0.0 < parameters.get(name, 0.0) < _MOST_SD),
            None,
        ),
    )


def _has_rows(path: Path, kind: str) -> bool:
    try:
        rows = read("dataflash", path, kind, None)
    except ConfigError:
        return False
    measured = rows.values["lla" if kind == "gnss" else next(iter(rows.values))]
    return bool(np.isfinite(measured).any() and (kind == "imu" or np.any(measured != 0)))


def _find_place(parameters: Mapping[str, float], stem: str) -> Vector | None:
    x, y, z = (parameters.get(f"{stem}{axis}", np.nan) for axis in "XYZ")
    return (x, y, z) if np.isfinite([x, y, z]).all() else None


def _find_day(log: DataFlash) -> datetime.date | None:
    if "GPS" not in log:
        return None
    data = log.read("GPS")
    if "GPSTime" in data:
        return day_of_unix(float(np.median(data["GPSTime"])) * MICRO)
    fixed = data["Status"] >= 3
    week = next((data[name][fixed] for name in ("GWk", "Week") if name in data), np.empty(0))
    of_week = next((data[name][fixed] for name in ("GMS", "TimeMS") if name in data), np.empty(0))
    return day_of_gps(week[-1], MILLI * of_week[-1]) if len(week) and len(of_week) else None


Accuracies = tuple[FloatArray | None, FloatArray | None, FloatArray | None]
Read = tuple[dict[str, FloatArray], tuple[str, ...]]


def _stack(data: Mapping[str, FloatArray], *labels: str) -> FloatArray:
    return np.stack([data[label] for label in labels], axis=-1)


def _read_imu(log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray]) -> Read:
    if "DAX" in data:
        turn, gain = _stack(data, "DAX", "DAY", "DAZ"), _stack(data, "DVX", "DVY", "DVZ")
        long: BoolArray = (data["DADT"] > 0) & (data["DVDT"] > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = gain * (data["DADT"] / data["DVDT"])[:, None]  # over the interval of the angles
        return {"dtheta": turn, "dvel": gain, "interval": data["DADT"], "valid": long.astype(float)}, ()
    gyro = "Gyr" if "GyrX" in data else "Gyro"
    values = {
        "gyro": _stack(data, *(f"{gyro}{axis}" for axis in "XYZ")),
        "accel": _stack(data, "AccX", "AccY", "AccZ"),
    }
    return values, ()


def _read_gnss(log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray]) -> Read:
    old_px4 = "Fix" in data
    status = data["Fix"] if old_px4 else data["Status"]
    place = np.deg2rad(data["Lat"]), np.deg2rad(data["Lon" if old_px4 else "Lng"]), data["Alt"]
    lla = np.column_stack(place)
    lla[status < 3] = np.nan
    values, notes = {"lla": lla, "quality": status}, []
    accuracies: Accuracies
    if old_px4:
        values["vel_n"] = _stack(data, "VelN", "VelE", "VelD")
        accuracies = data["EPH"], data["EPV"], None
        values["satellites"] = data["nSat"]
    else:
        course = np.deg2rad(data["GCrs"])
        values["vel_n"] = np.column_stack(
            [data["Spd"] * np.cos(course), data["Spd"] * np.sin(course), data["VZ"]]
        )
        values["satellites"] = data["NSats"]
        accuracies = _find_accuracies(log, t, data, values)
    h, v, speed = accuracies
    if h is None or v is None:
        values["dilution"] = data["HDop"][:, None]
    else:
        values["sd_pos"] = np.stack([h / np.sqrt(2.0), h / np.sqrt(2.0), v], axis=-1)
    if speed is not None:
        values["sd_vel"] = np.stack([speed / np.sqrt(3.0)] * 3, axis=-1)
    undulation = find_undulation(log)
    if undulation:
        lla[:, 2] -= undulation
    else:
        notes.append("its heights are over the sea; it has no undulation of the geoid")
    delay, why = _find_delay(log)
    values["arrival"] = np.full(len(t), delay)
    notes.append(f"a fix is {delay:.3g} s old when it is logged, {why}")
    return values, tuple(notes)


def _read_heading(log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray]) -> Read:
    """Return the headings of the vehicle by two antennas; exactly 0 means no heading."""
    yaw = data["Yaw"]
    told = np.isfinite(yaw) & (yaw != 0.0)
    values = {
        "heading": np.deg2rad(np.where(told, yaw, np.nan)),
        "arrival": np.full(len(t), _find_delay(log)[0]),
    }
    accuracies = _find_nearest(log, t, data, "GPA")
    if accuracies is not None and "YAcc" in accuracies:
        sd = np.deg2rad(accuracies["YAcc"])
        if (sd[told] > 0).all():
            values["sd"] = sd
    return values, ()


def _find_accuracies(
    log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray], values: dict[str, FloatArray]
) -> Accuracies:
    """Return the accuracies (N,) of position, horizontal and vertical, and of speed by the receiver."""
    for record, labels in _ACCURACIES.items():
        near = _find_nearest(log, t, data, record)
        if near is not None:
            if "VV" in near:
                values["vel_n"][near["VV"] == 0, 2] = np.nan
            return near[labels[0]], near[labels[1]], near[labels[2]]
    return None, None, None


def _find_nearest(
    log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray], record: str
) -> dict[str, FloatArray] | None:
    """Return the rows of a record of the same receiver nearest in time; NaN where none is near."""
    there = list_instances(log, record)
    name = f"{record}:{data['I'][0]:g}" if "I" in data else next(iter(there), "")
    if name not in there:
        return None
    at, other = take_records(log, name)
    k = np.searchsorted(0.5 * (at[1:] + at[:-1]), t)
    near = np.abs(at[k] - t) < _LATE
    return {label: np.where(near, column[k], np.nan) for label, column in other.items()}


def find_undulation(log: DataFlash) -> float:
    """Return by how much heights over the sea are above ellipsoidal ones [m]; 0 if it is not known."""
    if "GPA" not in log:
        return 0.0
    accuracies = log.read("GPA")
    found = accuracies.get("Und", np.empty(0))
    if "AEl" in accuracies and "GPS" in log:  # newer firmware: the height over the ellipsoid itself
        t, data = take_records(log, "GPS")
        near = _find_nearest(log, t, data, "GPA")
        if near is not None and "Alt" in data:
            found = (data["Alt"] - near["AEl"])[(data["Status"] >= 3) & (np.abs(near["AEl"]) < _HIGHEST)]
    known = found[np.isfinite(found)]
    return float(np.median(known)) if len(known) else 0.0


def _find_delay(log: DataFlash) -> tuple[float, str]:
    parameters = read_parameters(log)
    for name, unit in _DELAYS.items():
        if parameters.get(name, 0.0) > 0.0:
            return parameters[name] * unit, f"by {name}"
    return _UBLOX_DELAY, "as the driver of the autopilot assumes"


def _read_baro(log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray]) -> Read:
    pressure = data["Press"] if "Press" in data else 100.0 * data["BaroPres"]
    return {"alt_baro": pressure_altitude(np.where(pressure > 0, pressure, np.nan))[:, None]}, ()


def _read_mag(log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray]) -> Read:
    if "GyroX" in data:  # PX4: gauss
        return {"field_b": GAUSS * _stack(data, "MagX", "MagY", "MagZ")}, ()
    values = {"field_b": MILLI * GAUSS * _stack(data, "MagX", "MagY", "MagZ")}  # its offsets are in it
    if "Health" in data:
        values["valid"] = data["Health"]
    return values, ()


def _read_airspeed(log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray]) -> Read:
    """Return true airspeeds: those indicated, by the density of the air at its pressure and temperature."""
    speed = data["Airspeed"]
    note = "its airspeed is indicated: true by the air density of its barometer"
    at, baro = take_records(log, "BARO")
    density = baro["Press"] / (GAS_CONSTANT * (baro["GndTemp" if "GndTemp" in baro else "Temp"] + 273.15))
    at_sea = SEA_LEVEL_PRESSURE / (GAS_CONSTANT * SEA_LEVEL_TEMPERATURE)
    true = speed * np.sqrt(at_sea / np.interp(t, at, density))
    values = {"airspeed_true": true}
    if "Health" in data or "H" in data:
        values["valid"] = data["Health" if "Health" in data else "H"]
    return values, (note,)


def _read_radar(log: DataFlash, t: FloatArray, data: Mapping[str, FloatArray]) -> Read:
    old = "Dist1" in data
    values = {"height": data["Dist1" if old else "Dist"]}
    if "Stat" in data:
        values["valid"] = (data["Stat"] == _RANGE_GOOD).astype(float)
    return values, ()


_READERS = {
    "imu": _read_imu,
    "gnss": _read_gnss,
    "baro": _read_baro,
    "mag": _read_mag,
    "airspeed": _read_airspeed,
    "radar": _read_radar,
    "heading": _read_heading,
}
