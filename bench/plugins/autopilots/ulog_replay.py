"""ULog of PX4: a run in the message definitions and parameters of a log of the user's own firmware.

PX4's Replay drops a topic whose format is not that of its firmware, so the definitions are those of that log,
byte for byte, but for the parameters of lever arms and of the age of a fix, which are of the run.
Layout of the file: docs.px4.io, "ULog File Format"; what the fields mean: msg/*.msg of PX4-Autopilot.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files import durable
from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.exports.outgoing import ExportData
from bench.simulation.signals.air import standard_atmosphere

FORMATS = {"ulog": "PX4: a log of the sensors for Replay, as --like OWN.ulg of one's own firmware defines it"}
NEEDS_LIKE = True
FILE = "run.ulg"

_MAGIC = b"ULog\x01\x12\x35"
_HEAD = 16  # [byte]
_DEFINITIONS = b"BFIMPQ"
_MOST = 4_000_000_000  # [byte]
_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "bool": "u1", "char": "S1", "int16_t": "<i2", "uint16_t": "<u2",
    "int32_t": "<i4", "uint32_t": "<u4", "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8",
}  # fmt: skip
_BOOTED = 10.0
"""Time of t = 0 since the boot of the autopilot [s]: fixes may be older than the first sample of the IMU."""
_INVALID = 32767
"""``RELATIVE_TIMESTAMP_INVALID`` of ekf2_timestamps: nothing new of a sensor."""
_STANDS = 1.0
"""Ground speed by the receiver below which the vehicle is told to have landed [m/s]."""
_GAUSS = 1e-4  # [T]
_SAME_FIX = 0.05  # between a heading and the fix it is told with [s]
_LONGEST = 60_000  # of a message [byte]
_NEEDED = ("sensor_combined", "vehicle_gps_position")

Values = Mapping[str, Any]
"""Field of a message -> its column, or one value for all rows."""


@dataclass(frozen=True, slots=True)
class Definitions:
    """The definitions of a log: their bytes, the layouts of messages, parameters and where these lie."""

    raw: bytes
    layouts: Mapping[str, np.dtype[np.void]]
    parameters: Mapping[str, tuple[float, int, str]]  # value, place in ``raw``, code of `struct`


def read_definitions(path: Path) -> Definitions:
    """Return the definitions at the head of a ULog.

    Raises
    ------
    ConfigError
        If it is none.
    """
    try:
        check_file(path, path.name, _MOST)
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"--like {path}: {error.strerror}") from None
    if data[: len(_MAGIC)] != _MAGIC:
        raise ConfigError(f"--like {path.name}: not a ULog; take a .ulg of your own firmware")
    at, layouts, parameters = _HEAD, {}, {}
    while at + 3 <= len(data):
        size, kind = struct.unpack_from("<HB", data, at)
        if kind not in _DEFINITIONS or at + 3 + size > len(data):
            break
        body = data[at + 3 : at + 3 + size]
        if kind == ord("F"):
            name, _, fields = body.decode("latin-1").partition(":")
            layout = _make_layout(fields)
            if layout is not None:
                layouts[name] = layout
        elif kind == ord("P") and size > 5 and 1 + body[0] + 4 == size:
            form, _, name = body[1 : 1 + body[0]].decode("latin-1").partition(" ")
            code = {"int32_t": "<i", "float": "<f"}.get(form)
            if code:
                parameters[name] = struct.unpack(code, body[-4:])[0], at + 3 + size - 4, code
        at += 3 + size
    missing = [name for name in _NEEDED if name not in layouts]
    if missing:
        raise ConfigError(f"--like {path.name}: it does not define {' nor '.join(missing)}")
    longest = max(layouts, key=lambda name: layouts[name].itemsize)
    if layouts[longest].itemsize > _LONGEST:
        raise ConfigError(f"--like {path.name}: {longest} is too long for a message")
    return Definitions(data[:at], layouts, parameters)


def _make_layout(fields: str) -> np.dtype[np.void] | None:
    """Return the layout of a message as logged, without padding at its end; None if not plain fields."""
    rows: list[tuple[Any, ...]] = []
    for field in fields.split(";"):
        form, _, name = field.strip().partition(" ")
        kind, _, count = form.rstrip("]").partition("[")
        if not field.strip():
            continue
        if kind not in _TYPES or (count and not (count.isdecimal() and 0 < int(count) < 1000)):
            return None
        rows.append((name, _TYPES[kind], (int(count),)) if count else (name, _TYPES[kind]))
    while rows and rows[-1][0].startswith("_padding"):
        rows.pop()
    names = [row[0] for row in rows]
    return np.dtype(rows) if len(set(names)) == len(names) and "timestamp" in names else None


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write ``run.ulg``; return its description for the README."""
    assert out.like is not None
    like = read_definitions(out.like)
    raw = _set_parameters(like, out)
    messages = dict(_make_messages(like, out))
    written, left = {}, []
    for name, (stamps, values) in messages.items():
        if name in like.layouts and len(stamps):
            written[name] = (
                _fill(f"--like {out.like.name}: {name}", like.layouts[name], stamps, values),
                stamps,
            )
        elif name not in like.layouts:
            left.append(name)
    with durable.open_binary(folder / FILE) as file:
        file.write(raw)
        for number, name in enumerate(written):
            body = struct.pack("<BH", 0, number) + name.encode()
            file.write(struct.pack("<HB", len(body), ord("A")) + body)
        file.write(_merge(list(written.values())))
    listed = "".join(f"- `{name}`, {len(stamps)} rows\n" for name, (_, stamps) in written.items())
    lost = f"Not defined there, and not written: {', '.join(left)}.\n" if left else ""
    return f"""For the Replay of PX4 (docs.px4.io, "System-wide Replay"), and for all that reads a ULog:

    replay={FILE} make px4_sitl_default

Definitions and parameters are those of {out.like.name}, byte for byte, but for the parameters of lever
arms and of the age of a fix, which are of this run. No autopilot has replayed this file here; `pyulog` reads
it.

{listed}
{lost}
t = 0 is {_BOOTED:g} s after boot. Heights over the sea are those over the ellipsoid: no geoid is modeled.
`hdop`, `vdop` and what else the run does not know is 0, a heading of a receiver with one antenna NaN.
`vehicle_land_detected` says landed below {_STANDS:g} m/s by the receiver; `vehicle_status` says armed, a
fixed wing."""


def _stamp(t: FloatArray) -> np.ndarray[Any, np.dtype[np.int64]]:
    return np.rint(1e6 * (t + _BOOTED)).astype(np.int64)


_POSITIONS = ("EKF2_GPS_POS_", "SENS_GPS0_OFF")
_DELAY, _OWN_DELAY = "EKF2_GPS_DELAY", "SENS_GPS0_DELAY"


def _set_parameters(like: Definitions, out: ExportData) -> bytes:
    """Return the definitions with the lever arms and the age of the fixes of the run."""
    antenna = [float(one) for one in out.start["antenna_b_m"]]
    late = 1e3 * _late(out)
    given = {f"EKF2_IMU_POS_{axis}": 0.0 for axis in "XYZ"}
    given |= {f"{stem}{axis}": x for stem in _POSITIONS for axis, x in zip("XYZ", antenna, strict=True)}
    given |= {_DELAY: late, _OWN_DELAY: late}
    raw = bytearray(like.raw)
    for name, value in given.items():
        if name in like.parameters:
            _, at, code = like.parameters[name]
            struct.pack_into(code, raw, at, value if code == "<f" else round(value))
    if raw[_HEAD + 2] == ord("B") and len(raw) > _HEAD + 3 + 16:
        raw[_HEAD + 3 + 8] &= 0xFE  # nothing is appended
    return bytes(raw)


def _make_messages(
    like: Definitions, out: ExportData
) -> Iterator[tuple[str, tuple[np.ndarray[Any, Any], Values]]]:
    """Yield the stamps [us] and the values of each message."""
    good = out.imu.valid & np.isfinite(out.imu.dtheta_b).all(axis=1) & np.isfinite(out.imu.dvel_b).all(axis=1)
    stamps = _stamp(out.imu.t[good])
    yield "sensor_combined", (stamps, _describe_imu(like, out, good))
    ids = {f"{kind}_device_id": like.parameters.get(name, (1,))[0] for kind, name in _IDS.items()}
    yield "sensor_selection", (stamps[:1], {key: max(int(value), 1) for key, value in ids.items()})
    seen = {}
    fixes, values = _describe_fixes(out)
    seen["gps"] = fixes + round(1e6 * _late(out))  # what the firmware takes off again
    yield "vehicle_gps_position", (seen["gps"], {**values, "timestamp_sample": fixes})
    baro, mag = out.instruments.get("baro"), out.instruments.get("mag")
    if baro is not None:
        kept = baro.valid & np.isfinite(baro.alt_baro)
        seen["vehicle_air_data"] = _stamp(baro.t[kept])
        yield "vehicle_air_data", (seen["vehicle_air_data"], _describe_air(baro.alt_baro[kept]))
    if mag is not None:
        kept = mag.valid & np.isfinite(mag.field_b).all(axis=1)
        seen["vehicle_magnetometer"] = _stamp(mag.t[kept])
        field = {"magnetometer_ga": mag.field_b[kept] / _GAUSS, "device_id": 1}
        yield "vehicle_magnetometer", (seen["vehicle_magnetometer"], field)
    landed = values["vel_ned_valid"] & (np.hypot(values["vel_n_m_s"], values["vel_e_m_s"]) < _STANDS)
    state = dict.fromkeys(("landed", "ground_contact", "maybe_landed"), landed)
    yield "vehicle_land_detected", (seen["gps"], state)
    yield "vehicle_status", (seen["gps"], {"arming_state": 2, "vehicle_type": 2})  # armed, a fixed wing
    fields = ("airspeed", "airspeed_validated", "distance_sensor", "optical_flow", "visual_odometry", "gps",
              "vehicle_air_data", "vehicle_magnetometer")  # fmt: skip
    yield (
        "ekf2_timestamps",
        (
            stamps,
            {f"{name}_timestamp_rel": _relate(seen.get(name), stamps) for name in fields},
        ),
    )


_IDS = {"accel": "CAL_ACC0_ID", "gyro": "CAL_GYRO0_ID"}


def _describe_imu(like: Definitions, out: ExportData, good: BoolArray) -> dict[str, Any]:
    gyro, accel = out.rates()
    layout = like.layouts["sensor_combined"]
    old = "gyro_integral_dt" in (layout.names or ()) and layout["gyro_integral_dt"].kind == "f"  # in seconds
    length: FloatArray = out.imu.dt[good] if old else np.rint(1e6 * out.imu.dt[good])
    return {
        "gyro_rad": gyro[good],
        "accelerometer_m_s2": accel[good],
        "gyro_integral_dt": length,
        "accelerometer_integral_dt": length,
    }


def _late(out: ExportData) -> float:
    """Return how old a fix is when it arrives [s], by the median."""
    fixes = out.select_fixes()
    return float(np.median(fixes.t_arrival - fixes.t))


def _describe_fixes(out: ExportData) -> tuple[np.ndarray[Any, Any], dict[str, Any]]:
    """Return the validity times of fixes [us] and their values, in the fields of all firmware versions."""
    fixes = out.select_fixes()
    stamps = _stamp(fixes.t)
    lat, lon, h = fixes.lla.T
    known = np.asarray(np.isfinite(fixes.vel_n).all(axis=1))
    north, east, down = np.where(known[:, None], fixes.vel_n, 0.0).T
    variances = np.einsum("mii->mi", fixes.cov_pos_n)
    speeds = np.einsum("mii->mi", fixes.cov_vel_n).sum(axis=1)
    return stamps, {
        "lat": np.rint(1e7 * np.rad2deg(lat)), "lon": np.rint(1e7 * np.rad2deg(lon)),
        "alt": np.rint(1e3 * h), "alt_ellipsoid": np.rint(1e3 * h),
        "latitude_deg": np.rad2deg(lat), "longitude_deg": np.rad2deg(lon),
        "altitude_msl_m": h, "altitude_ellipsoid_m": h,
        "vel_n_m_s": north, "vel_e_m_s": east, "vel_d_m_s": down,
        "vel_m_s": np.hypot(north, east), "cog_rad": np.arctan2(east, north), "vel_ned_valid": known,
        "eph": np.sqrt(variances[:, 0] + variances[:, 1]), "epv": np.sqrt(variances[:, 2]),
        "s_variance_m_s": np.sqrt(np.where(np.isfinite(speeds), speeds, 0.0)),
        "fix_type": 3, "satellites_used": np.clip(fixes.satellites, 0, 255),
        **_describe_heading(out, fixes.t), "heading_offset": 0.0,
        "time_utc_usec": [out.calendar.nanoseconds(float(t)) // 1000 for t in fixes.t],
        "device_id": 1,
    }  # fmt: skip


def _describe_heading(out: ExportData, t: FloatArray) -> dict[str, FloatArray]:
    """Return the heading of two antennas at the nearest time to each fix, NaN where there is none near."""
    found = {"heading": np.full(len(t), np.nan), "heading_accuracy": np.full(len(t), np.nan)}
    heading = out.instruments.get("heading")
    if heading is None or not (kept := heading.valid & np.isfinite(heading.heading)).any():
        return found
    own = heading.t[kept]
    k = np.searchsorted(0.5 * (own[1:] + own[:-1]), t)
    near = np.abs(own[k] - t) < _SAME_FIX
    wrapped = np.angle(np.exp(1j * heading.heading[kept]))
    for name, values in (("heading", wrapped), ("heading_accuracy", heading.sd[kept])):
        found[name][near] = values[k[near]]
    return found


def _describe_air(alt: FloatArray) -> dict[str, Any]:
    pressure, temperature, density = standard_atmosphere(alt)
    sea = standard_atmosphere(0.0)[2]
    return {
        "baro_alt_meter": alt,
        "baro_pressure_pa": pressure,
        "baro_temp_celcius": temperature - 273.15,
        "ambient_temperature": temperature - 273.15,
        "rho": density,
        "eas2tas": np.sqrt(sea / density),
        "baro_device_id": 1,
    }


def _relate(of: np.ndarray[Any, Any] | None, to: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the newest stamp of a sensor since the row before, relative to each row [0.1 ms]."""
    if of is None or not len(of):
        return np.full(len(to), _INVALID, np.int64)
    newest = np.searchsorted(of, to, "right") - 1
    fresh = np.diff(newest, prepend=-1) > 0
    apart = of[np.maximum(newest, 0)] // 100 - to // 100
    return np.where(fresh & (np.abs(apart) < _INVALID), apart, _INVALID)


def _fill(
    shown: str, layout: np.dtype[np.void], stamps: np.ndarray[Any, Any], values: Values
) -> np.ndarray[Any, Any]:
    """Return the rows of a message; fields without a value are 0."""
    rows = np.zeros(len(stamps), layout)
    rows["timestamp"] = stamps
    for name in layout.names or ():
        if name not in values:
            continue
        if np.ndim(values[name]) and np.shape(values[name]) != rows[name].shape:
            raise ConfigError(
                f"{shown}.{name} holds {rows[name][0].size} numbers, not {np.size(values[name][0])}"
            )
        rows[name] = values[name]
    return rows


def _merge(tables: list[tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]]) -> bytes:
    """Return the data of all messages in the order of their stamps."""
    parts: list[tuple[int, int, bytes]] = []
    for number, (rows, stamps) in enumerate(tables):
        size = rows.dtype.itemsize
        head = struct.pack("<HBH", size + 2, ord("D"), number)
        body = rows.tobytes()
        parts += [
            (int(stamp), number, head + body[k * size : (k + 1) * size]) for k, stamp in enumerate(stamps)
        ]
    parts.sort(key=lambda part: part[:2])
    return b"".join(part[2] for part in parts)
