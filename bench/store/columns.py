"""How the records lie in columns: each with its name, its unit and its frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bench.unit_names import unit_of


@dataclass(frozen=True, slots=True)
class Columns:
    """The columns of one field of a record, in the order of its flattened rows."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    frame: str = ""
    shape: tuple[int, ...] = ()  # of one row


Layout = Mapping[str, Columns]
"""Field of a record -> its columns."""

_NED = ("n", "e", "d")
_XYZ = ("x", "y", "z")


def _one(name: str, frame: str = "") -> Columns:
    return Columns((name,), (unit_of(name) or "1",), frame)


def _vector(stem: str, unit: str, frame: str) -> Columns:
    axes = _NED if frame == "n" else _XYZ
    names = tuple(f"{stem}_{axis}_{unit}" for axis in axes)
    return Columns(names, tuple(unit_of(name) for name in names), frame, (3,))


def _tesla(stem: str) -> Columns:
    """Name the axes of a magnetic field, whose unit is too short to end names of others in."""
    return Columns(tuple(f"{stem}_{axis}_t" for axis in _XYZ), ("T",) * 3, "b", (3,))


def _matrix(stem: str, states: Sequence[tuple[str, str]], frame: str) -> Columns:
    """Name the elements of a covariance by their two states, each (name, unit)."""
    names = tuple(f"{stem}_{a}_{b}" for a, _ in states for b, _ in states)
    units = tuple(f"{u} {v}" if u != v else f"({u})^2" for _, u in states for _, v in states)
    return Columns(names, units, frame, (len(states), len(states)))


_LLA = Columns(("lat_rad", "lon_rad", "alt_m"), ("rad", "rad", "m"), "WGS 84, geodetic", (3,))
_Q_NB = Columns(tuple(f"q_nb_{c}" for c in "wxyz"), ("1",) * 4, "b to n, scalar first", (4,))
_BLOCKS = (("pos", "m"), ("vel", "m/s"), ("phi", "rad"))
_STATES = [(f"{block}_{axis}", unit) for block, unit in _BLOCKS for axis in _NED]

T: Layout = {"t": _one("t_s")}
INTERVAL: Layout = {**T, "dt": _one("dt_s")}
ARRIVAL: Layout = {**T, "t_arrival": _one("t_arrival_s"), "valid": _one("valid")}
MOTION: Layout = {**T, "lla": _LLA, "vel_n": _vector("vel", "mps", "n"), "q_nb": _Q_NB}
INCREMENTS: Layout = {"dtheta_b": _vector("dtheta", "rad", "b"), "dvel_b": _vector("dvel", "mps", "b")}
AIR: Layout = {
    **T,
    "pressure": _one("pressure_pa"),
    "temperature": _one("temperature_k"),
    "airspeed_true": _one("airspeed_true_mps"),
    "airspeed_calibrated": _one("airspeed_calibrated_mps"),
    "alpha": _one("alpha_rad"),
    "beta": _one("beta_rad"),
    "wind_n": _vector("wind", "mps", "n"),
    "engine_speed": _one("engine_speed_rad_s"),
}
CONTROLS: Layout = {**T, **{name: _one(name) for name in ("aileron", "elevator", "rudder", "throttle")}}
EVENTS: Layout = {**T, "t_end": _one("t_end_s"), "kind": _one("kind"), "text": _one("text")}
IMU: Layout = {**INTERVAL, "valid": _one("valid"), **INCREMENTS}
GNSS: Layout = {
    **ARRIVAL,
    "lla": _LLA,
    "vel_n": _vector("vel", "mps", "n"),
    "cov_pos_n": _matrix("cov", _STATES[0:3], "n"),
    "cov_vel_n": _matrix("cov", _STATES[3:6], "n"),
    "satellites": _one("satellites"),
}


def observations(bands: int) -> Layout:
    """Return the layout of GNSS observations on one or more carriers."""

    def banded(stem: str, unit: str) -> Columns:
        names = tuple(f"{stem}_{band + 1}_{unit}" for band in range(bands))
        return Columns(names, tuple(unit_of(name) for name in names), "", (bands,))

    return {
        **T,
        "t_arrival": _one("t_arrival_s"),
        "system": _one("system"),
        "sat": _one("sat"),
        "frequency": banded("frequency", "hz"),
        "pseudorange": banded("pseudorange", "m"),
        "range_rate": banded("range_rate", "mps"),
        "cn0": banded("cn0", "dbhz"),
        "sat_pos_e": _vector("sat_pos", "m", "e at transmission"),
        "sat_vel_e": _vector("sat_vel", "mps", "e at transmission"),
        "sat_clock": _one("sat_clock_m"),
        "sat_clock_rate": _one("sat_clock_rate_mps"),
        "group_delay": _one("group_delay_m"),
        "sd_pseudorange": _one("sd_pseudorange_m"),
        "sd_range_rate": _one("sd_range_rate_mps"),
    }


SKY: Layout = {
    **T,
    "system": _one("system"),
    "sat": _one("sat"),
    "azimuth": _one("azimuth_rad", "n"),
    "elevation": _one("elevation_rad", "n"),
    "cn0": _one("cn0_dbhz"),
    "used": _one("used"),
}
BARO: Layout = {**ARRIVAL, "alt_baro": _one("alt_baro_m"), "sd": _one("sd_m")}
MAG: Layout = {**ARRIVAL, "field_b": _tesla("field"), "sd": Columns(("sd_t",), ("T",))}
AIRSPEED: Layout = {**ARRIVAL, "airspeed_true": _one("airspeed_true_mps"), "sd": _one("sd_mps")}
BIASES: Layout = {
    "gyro_bias_b": _vector("gyro_bias", "rad_s", "b"),
    "accel_bias_b": _vector("accel_bias", "m_s2", "b"),
}
DRAWN: Layout = {
    **T,
    **BIASES,
    "baro_bias": _one("baro_bias_m"),
    "mag_bias_b": _tesla("mag_bias"),
    "airspeed_bias": _one("airspeed_bias_mps"),
}
ERRORS: Layout = {
    **T,
    "pos_n": _vector("pos_err", "m", "n"),
    "vel_n": _vector("vel_err", "mps", "n"),
    "phi_n": _vector("phi", "rad", "n"),
    "heading": _one("heading_err_rad"),
    "nees": _one("nees"),
}
INNOVATIONS: Layout = {
    **T,
    "sensor": _one("sensor"),
    "component": _one("component", "n"),
    "z": Columns(("z",), ("of the sensor",), "n"),
    "S": Columns(("S",), ("of the sensor, squared",), "n"),
    "nis": _one("nis"),
    "accepted": _one("accepted"),
}


def solution(extra_names: Sequence[str]) -> Layout:
    """Return the layout of a solution with the given states beyond position, velocity, attitude."""
    n = len(extra_names)
    units = tuple(unit_of(name) or "1" for name in extra_names)
    return {
        **MOTION,
        **BIASES,
        "cov": _matrix("cov", _STATES, "n"),
        "extra": Columns(tuple(f"state_{name}" for name in extra_names), units, "", (n,)),
        "extra_sd": Columns(tuple(f"sd_{name}" for name in extra_names), units, "", (n,)),
    }
