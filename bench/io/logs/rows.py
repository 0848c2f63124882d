"""The columns of a log, in which every format is read."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.core.files.spawned import machine_memory
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import matrix_en, to_geodetic
from bench.core.records.fields import columns_of
from bench.core.records.instruments import INSTRUMENTS, Instrument
from bench.io.logs.table_files import UNITS, Group, TableColumns, group, list_names
from bench.simulation.signals.air import pressure_altitude

ROW_MEMORY = 300.0
"""Memory to read and navigate a row of an IMU in blocks, several times what was measured [byte]."""
ROW_SPACE = 1100.0
"""Address space for it, that of its files on disk included [byte]."""


def count_affordable_rows() -> float:
    """Return how many rows of an IMU this process has room for: by the machine, or by its own limits."""
    limits = [machine_memory() / ROW_MEMORY]
    with contextlib.suppress(ImportError):  # Windows has no such limits
        import resource

        address_space = resource.getrlimit(resource.RLIMIT_AS)[0]
        if address_space != resource.RLIM_INFINITY:
            limits.append(address_space / ROW_SPACE)
    return min(limits)


MOST_ROWS = int(min(5e6, count_affordable_rows()))
"""Most rows of a file of a log: 3.5 hours at 400 Hz, or what the memory holds."""

_TIMES = (group("clock", "t"), group("clock", "time"))


def _name_axes(dimension: str, stem: str) -> dict[str, str]:
    return group(dimension, *(f"{stem}_{axis}" for axis in "xyz"))


def _name_covariance(block: str) -> dict[str, str]:
    return group("", *(f"cov_{block}_{a}_{block}_{b}" for a in "ned" for b in "ned"))


_FRACTION = {"fraction": (group("clock", "t_fraction"),)}
"""What is added to times that are whole seconds."""

_FLAGS: Mapping[str, tuple[Group, ...]] = {
    **_FRACTION,
    "arrival": (group("clock", "t_arrival"),),
    "valid": (group("", "valid"),),
}

IMU: Mapping[str, tuple[Group, ...]] = {
    "time": _TIMES,
    **_FRACTION,
    "interval": (group("time", "dt"),),
    "valid": _FLAGS["valid"],
    "motion": (
        {**_name_axes("rate", "gyro"), **_name_axes("acceleration", "accel")},
        {**_name_axes("angle", "dtheta"), **_name_axes("speed", "dvel")},
    ),
}
"""Rates and specific forces, or increments of angle and velocity, in the axes of the IMU."""

LOCAL_AXES: Mapping[tuple[str, ...], str] = {
    **dict.fromkeys((("x", "y", "z"), ("pos_x", "pos_y", "pos_z")), ""),
    **dict.fromkeys((("east", "north", "up"), ("pos_e", "pos_n", "pos_u"), ("pe", "pn", "pu")), "enu"),
    **dict.fromkeys((("north", "east", "down"), ("pos_n", "pos_e", "pos_d"), ("pn", "pe", "pd")), "ned"),
}
"""Columns of positions in a local frame -> its axes; those of x, y, z are named elsewhere."""

GNSS: Mapping[str, tuple[Group, ...]] = {
    "time": _TIMES,
    "position": (
        {**group("angle", "lat", "lon"), **group("length", "alt")},
        {**group("angle", "lat", "lon"), **group("length", "height")},
        group("length", "ecef_x", "ecef_y", "ecef_z"),
        *(group("length", *stems) for stems in LOCAL_AXES),
    ),
    "velocity": (
        group("speed", "vel_n", "vel_e", "vel_d"),
        group("speed", "vel_n", "vel_e", "vel_u"),
        group("speed", "ecef_vel_x", "ecef_vel_y", "ecef_vel_z"),
        {**group("speed", "speed"), **group("angle", "course")},
    ),
    "position sd": (
        group("length", "sd_n", "sd_e", "sd_d"),
        group("length", "sd_n", "sd_e", "sd_u"),
        group("length", "accuracy_h", "accuracy_v"),
        group("length", "accuracy_h"),
    ),
    "velocity sd": (
        group("speed", "sd_vn", "sd_ve", "sd_vd"),
        group("speed", "sd_vn", "sd_ve", "sd_vu"),
        group("speed", "accuracy_speed"),
    ),
    "position covariance": (_name_covariance("pos"),),
    "velocity covariance": (_name_covariance("vel"),),
    "quality": (group("", "quality"),),
    "dilution": (group("", "hdop", "vdop"), group("", "hdop")),
    "signal": (group("signal", "cn0"),),
    "satellites": (group("", "satellites"),),
    **_FLAGS,
}
"""Position and velocity of the antenna: geodetic WGS 84 with ellipsoidal height, Earth-fixed, or local."""

BARO: Mapping[str, tuple[Group, ...]] = {
    "time": _TIMES,
    "altitude": (group("length", "alt_baro"), group("pressure", "pressure")),
    "sd": (group("length", "sd"),),
    **_FLAGS,
}
"""Barometric altitude, or static pressure."""


def _name_columns(row: Instrument) -> Mapping[str, tuple[Group, ...]]:
    dimension = next(one for one, units in UNITS.items() if row.unit in units)
    stems = [name.rpartition("_")[0] for name in columns_of(row.record)[row.value].names]
    sd = {"sd": (group(dimension, "sd"),)} if row.spreads else {}
    return {"time": _TIMES, row.value: (group(dimension, *stems),), **sd, **_FLAGS}


INSTRUMENT_ROWS: Mapping[str, Mapping[str, tuple[Group, ...]]] = {
    **{name: _name_columns(row) for name, row in INSTRUMENTS.items()},
    "baro": BARO,
}
"""Instrument -> kinds of columns: the value of its record, forward, right, down where it has axes."""

_ALONE = ("interval", "arrival", "valid", "sd", "quality", "signal", "satellites")
_SPREADS = {
    "position sd": "sd_pos",
    "velocity sd": "sd_vel",
    "position covariance": "cov_pos",
    "velocity covariance": "cov_vel",
    "dilution": "dilution",
}
OPTIONAL = ("velocity", "fraction", *_SPREADS, *_ALONE)
"""Kinds of columns that may be missing."""

COLUMNS = {
    what: "; ".join(f"{kind}: {list_names(groups)}" for kind, groups in kinds.items())
    for what, kinds in {"imu": IMU, "gnss": GNSS, **INSTRUMENT_ROWS}.items()
}
"""Column names of the tables of a log, as text."""


@dataclass(frozen=True, slots=True)
class LogRows:
    """The rows of one file in SI, in the axes of the IMU or in n.

    ``values`` of an IMU: ``gyro`` [rad/s] and ``accel`` [m/s^2] or ``dtheta`` [rad] and ``dvel`` [m/s], (N,
    3). Of a receiver: ``lla`` (N, 3) and, if the file has them, ``vel_n``, ``sd_pos``, ``sd_vel`` (N, 3),
    ``cov_pos``, ``cov_vel`` (N, 9), ``dilution`` (N, 1 or 2), ``quality``, ``signal`` [dB-Hz] and
    ``satellites`` (N,). Of a solution: also ``q_nb`` (N, 4). Of an instrument: the column of its record, as
    (N, k), and ``sd`` (N,) if the file says it. Of any: ``interval`` [s], ``arrival`` on the clock of the
    file [s], ``valid`` (N,).
    """

    t: FloatArray  # (N,) on the clock of the file [s]
    values: Mapping[str, FloatArray]
    notes: tuple[str, ...] = ()
    assumed: str = ""  # place of local positions without an origin, in words
    week_ends: bool = False  # its times were seconds of a week that ends in it

    @classmethod
    def from_table(cls, table: TableColumns, shown: str) -> LogRows:
        """Return the rows of a table."""
        found, stems = table.columns, table.stems
        values: dict[str, FloatArray] = {}
        if "motion" in found:
            rates = stems["motion"][0] == "gyro_x"
            values["gyro" if rates else "dtheta"] = found["motion"][:, :3]
            values["accel" if rates else "dvel"] = found["motion"][:, 3:]
        if "position" in found:
            lla, local = found["position"], stems["position"] in LOCAL_AXES
            if stems["position"][0] == "ecef_x":
                lla = to_lla(lla)
            values["pos_l" if local else "lla"] = lla
            if "velocity" in found:
                values["vel_n"] = _to_vel_n(found["velocity"], stems["velocity"], lla)
            values |= {new: _spread(found[old], stems[old]) for old, new in _SPREADS.items() if old in found}
        if "altitude" in found:
            pressure = stems["altitude"][0] == "pressure"
            values["alt_baro"] = _to_altitude(found["altitude"]) if pressure else found["altitude"]
        values |= {row.value: found[row.value] for row in INSTRUMENTS.values() if row.value in found}
        values |= {name: found[name][:, 0] for name in _ALONE if name in found}
        notes = (f"{shown}: {table.list_unused()}",) if table.unused else ()
        t = found["time"][:, 0]
        return cls(t + found["fraction"][:, 0] if "fraction" in found else t, values, notes)


def _to_vel_n(vel: FloatArray, stems: tuple[str, ...], lla: FloatArray) -> FloatArray:
    if stems[0] == "ecef_vel_x":
        return np.asarray(np.einsum("kji,kj->ki", matrix_en(lla[:, 0], lla[:, 1]), vel))
    if stems[0] == "speed":
        return to_horizontal(*vel.T)
    return vel * [1.0, 1.0, -1.0] if stems[2] == "vel_u" else vel


def to_horizontal(speed: FloatArray, course: FloatArray) -> FloatArray:
    """Return velocities (N, 3) whose component down is NaN; phones write -1 for unknown."""
    known = (speed > 0) & (course >= 0)
    still = speed == 0
    north, east = (
        np.where(known, speed * turn(course), np.where(still, 0.0, np.nan)) for turn in (np.cos, np.sin)
    )
    return np.column_stack([north, east, np.full(len(speed), np.nan)])


def spread_accuracy(accuracy: FloatArray) -> FloatArray:
    """Return standard deviations along north, east, down of accuracies (N, 1 or 2), horizontal and vertical.

    A horizontal accuracy is the root sum square of north and east; the vertical one is NaN if there is none.
    """
    h = accuracy[:, 0] / np.sqrt(2.0)
    return np.column_stack([h, h, accuracy[:, 1] if accuracy.shape[1] > 1 else np.full(len(h), np.nan)])


def _spread(values: FloatArray, stems: tuple[str, ...]) -> FloatArray:
    if stems[0] == "accuracy_speed":
        return np.column_stack([values[:, 0], values[:, 0], np.full(len(values), np.nan)])
    return spread_accuracy(values) if stems[0] == "accuracy_h" else values


def to_lla(pos_e: FloatArray) -> FloatArray:
    """Convert Earth-fixed to geodetic positions (N, 3); rows that are not finite become NaN."""
    lla = np.full_like(pos_e, np.nan)
    good = np.isfinite(pos_e).all(axis=1)
    lla[good] = to_geodetic(pos_e[good])
    return lla


def _to_altitude(pressure: FloatArray) -> FloatArray:
    """Convert pressures [Pa] to pressure altitudes [m]; values that are not positive become NaN."""
    altitude = np.full_like(pressure, np.nan)
    good = np.isfinite(pressure) & (pressure > 0)
    altitude[good] = pressure_altitude(pressure[good])
    return altitude
