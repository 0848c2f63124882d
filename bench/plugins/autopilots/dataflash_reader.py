"""The reader of DataFlash logs: rows by `flash_rows`, truth of a simulator, the autopilot's own estimates.

EKF3 (``XKF``), EKF2 (``NKF``), the EKF of ArduPilot before 2017 (``EKF1`` to ``EKF4``), and the estimate of
PX4 before 2017 (``LPOS``, ``ATT``). A core is a lane; ``XKF4.PI`` says which one flies. Variances are in
``XKV1`` only. ``SV``, ``SP``, ``SH`` are no variances but test ratios, the root of sum z^2 / (gate^2 sum S);
the mean variance of the innovations ``IVN``, ``IPN`` ... follows from them (AP_NavEKF3_PosVelFusion.cpp).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import displace
from bench.core.records.data import EventRow
from bench.core.words.exceptions import ConfigError
from bench.io.logs.log_contents import OwnEstimate, OwnMotion, no_values, tell_innovations, turn_quaternion
from bench.plugins.autopilots.dataflash import DataFlash
from bench.plugins.autopilots.flash_rows import find_undulation, open_log, read_parameters, take_records
from bench.plugins.autopilots.flash_rows import look as look
from bench.plugins.autopilots.flash_rows import read as read

FORMAT = {"endings": (".bin", ".px4log"), "topics": True, "knows": True}
"""Its row in `bench.io.log_formats`."""

_FAMILIES: Mapping[float, str] = {3: "XKF", 2: "NKF", 1: "EKF"}
"""AHRS_EKF_TYPE -> how the names of its records begin."""
_GATES = {
    "gnss_velocity": ("VEL", "SV", ("IVN", "IVE", "IVD"), 5.0),
    "gnss_position": ("POS", "SP", ("IPN", "IPE"), 5.0),
    "baro": ("HGT", "SH", ("IPD",), 5.0),
}
"""Innovation -> its gate among the parameters, test ratio, components, and the usual gate [sigma]."""
_RESETS = ("lane", "reset", "alignment", "EKF variance", "GPS Glitch", "emergency")
"""Words of messages that tell an event of a filter."""


def read_truth(path: Path) -> OwnMotion:
    """Return the truth of the simulator of ArduPilot, ``SIM`` and ``SIM2``.

    Raises
    ------
    ConfigError
        If there is none.
    """
    log = open_log(path)
    if "SIM" not in log:
        raise ConfigError("no records SIM")
    t, data = take_records(log, "SIM")
    lla = np.column_stack(
        [np.deg2rad(data["Lat"]), np.deg2rad(data["Lng"]), data["Alt"] - find_undulation(log)]
    )
    vel_n = np.full((len(t), 3), np.nan)
    if "SIM2" in log:
        at, more = take_records(log, "SIM2")
        vel_n = np.column_stack([np.interp(t, at, more[f"V{axis}"]) for axis in "NED"])
    return OwnMotion(t, lla, vel_n, t, _read_attitude(data))


def _read_attitude(data: Mapping[str, FloatArray], scale: float = np.pi / 180) -> FloatArray:
    """Return attitudes (N, 4), by the quaternion where it has one."""
    if "Q1" in data and np.any(data["Q1"]):
        return np.stack([data[f"Q{k}"] for k in range(1, 5)], axis=-1)
    return rotation.from_euler(*(scale * data[name] for name in ("Roll", "Pitch", "Yaw")))


def read_estimate(path: Path, core: int | None) -> OwnEstimate:
    """Return the estimate of a core; None selects the core that flew at each time.

    Raises
    ------
    ConfigError
        If there is none.
    """
    log = open_log(path)
    if "LPOS" in log and "ATT" in log:
        return _read_px4(log)
    parameters = read_parameters(log)
    flown = _FAMILIES.get(parameters.get("AHRS_EKF_TYPE", 0), "")
    family = next((one for one in (flown, *_FAMILIES.values()) if one and f"{one}1" in log), None)
    if family is None:
        raise ConfigError("no estimate of the autopilot: no records XKF1, NKF1, EKF1 or LPOS")
    lanes = _Lanes(log, family, core)
    t, data = lanes.take(1)
    lla = np.full((len(t), 3), np.nan)
    origin_t, origin = _find_origins(log)
    if len(origin_t):
        k = np.clip(np.searchsorted(origin_t, t, side="right") - 1, 0, len(origin_t) - 1)
        lla = displace(origin[k], np.stack([data["PN"], data["PE"], data["PD"]], axis=-1))
    has_quaternion = family == "XKF" and "XKQ" in log
    attitude_t, attitude = lanes.take("Q") if has_quaternion else (t, data)
    vel_n = np.stack([data["VN"], data["VE"], data["VD"]], axis=-1)
    motion = OwnMotion(t, lla, vel_n, attitude_t, _read_attitude(attitude))
    return OwnEstimate(
        motion,
        _read_variances(lanes, motion),
        _read_biases(lanes),
        tell_innovations(_read_innovations(lanes, parameters)),
        tuple(sorted([*_list_messages(log), *lanes.events])),
    )


class _Lanes:
    """The records of one core of a family, or of the core that flew at each time."""

    def __init__(self, log: DataFlash, family: str, core: int | None) -> None:
        self.log, self.family, self.events = log, family, list[EventRow]()
        self.cores, self.t, self.flown = [core or 0], np.empty(0), np.empty(0)
        record = f"{family}4"
        if core is None and record in log and "PI" in log.read(record):
            self.t, data = take_records(log, record)
            self.flown = data["PI"]
            if not np.isfinite(self.flown).all():
                raise ConfigError(f"{record}.PI is not the number of a core")
            self.cores = [int(one) for one in np.unique(self.flown)]
            self.events = [
                (float(self.t[k + 1]),) * 2 + ("lane", f"core {self.flown[k + 1]:g} after {self.flown[k]:g}")
                for k in np.flatnonzero(np.diff(self.flown))
            ]

    def take(self, of: int | str) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return times and columns of a numbered record, or of one with a letter; in order of time."""
        parts = []
        for core in self.cores:
            t, data = self._take_core(of, core)
            rows = np.ones(len(t), np.bool_)
            if len(self.cores) > 1:
                k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
                rows = self.flown[k] == core
            parts.append((t[rows], {name: column[rows] for name, column in data.items()}))
        t = np.concatenate([one for one, _ in parts])
        order = np.argsort(t, kind="stable")
        names = parts[0][1].keys()
        return t[order], {name: np.concatenate([one[name] for _, one in parts])[order] for name in names}

    def _take_core(self, of: int | str, core: int) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return the records of a core: by a field of EKF3, by numbers five on for each core of EKF2."""
        numbered = isinstance(of, int) and self.family == "NKF"
        record = f"{self.family}{of}" if isinstance(of, int) else f"{self.family[:2]}{of}"
        if isinstance(of, int) and numbered:
            record = f"{self.family}{of + 5 * core}"
        if record in self.log and "C" in self.log.read(record):
            return take_records(self.log, f"{record}:{core}")
        if record not in self.log or (core and not numbered):
            raise ConfigError(f"no core {core}: no such records {record}")
        return take_records(self.log, record)


def _find_origins(log: DataFlash) -> tuple[FloatArray, FloatArray]:
    """Return since when (K,) positions count from which origin (K, 3); before EKF2 that is home."""
    if "ORGN" in log:
        t, data = take_records(log, "ORGN")
        rows = data["Type"] == 0 if (data["Type"] == 0).any() else np.ones(len(t), np.bool_)
    elif "CMD" in log:
        t, data = take_records(log, "CMD")
        rows = (data["CNum"] == 0) & (data["Lat"] != 0)
    else:
        return np.empty(0), np.empty((0, 3))
    height = data["Alt"] - find_undulation(log)
    return t[rows], np.column_stack([np.deg2rad(data["Lat"]), np.deg2rad(data["Lng"]), height])[rows]


def _list_messages(log: DataFlash) -> list[EventRow]:
    """Return the messages of the filters on their resets; old logs have these messages without a time."""
    if "MSG" not in log or not log.read("MSG"):
        return []
    t, _ = take_records(log, "MSG")
    return [
        (float(at), float(at), "reset", text)
        for at, text in zip(t, log.read_text("MSG", "Message"), strict=True)
        if "EKF" in text.upper() and any(word.lower() in text.lower() for word in _RESETS)
    ]


def _read_variances(lanes: _Lanes, motion: OwnMotion) -> tuple[FloatArray, FloatArray]:
    """Return the covariances of EKF3; covariances of the quaternion become angles in n."""
    if lanes.family != "XKF" or "XKV1" not in lanes.log:
        return no_values(9)
    t, data = lanes.take("V1")
    diagonal = np.stack([data[f"V{k:02d}"] for k in range(10)], axis=-1)
    row = np.clip(np.searchsorted(motion.attitude_t, t), 0, len(motion.attitude_t) - 1)
    phi = turn_quaternion(diagonal[:, :4], motion.q_nb[row])
    return t, np.hstack([diagonal[:, 7:10], diagonal[:, 4:7], phi])


def _read_biases(lanes: _Lanes) -> tuple[FloatArray, FloatArray]:
    """Return biases: gyros in deg/s; of the accelerometers only EKF3 has three, in m/s^2."""
    t, first = lanes.take(1)
    gyro = np.deg2rad(np.stack([first[f"G{axis}"] for axis in "XYZ"], axis=-1))
    accel = np.full_like(gyro, np.nan)
    if lanes.family == "XKF" and "XKF2" in lanes.log:
        at, second = lanes.take(2)
        accel = np.column_stack([np.interp(t, at, second[f"A{axis}"]) for axis in "XYZ"])
    return t, np.hstack([gyro, accel])


def _read_innovations(
    lanes: _Lanes, parameters: Mapping[str, float]
) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    numbered = {"XKF": "EK3", "NKF": "EK2"}.get(lanes.family)
    try:
        t, z_of = lanes.take(3)
        at, ratios = lanes.take(4)
    except ConfigError:
        return {}
    near = np.clip(np.searchsorted(at, t - 0.01), 0, len(at) - 1)
    found = {}
    for name, (stem, ratio, labels, usual) in _GATES.items():
        gate = usual
        if numbered:
            gate = 0.01 * parameters.get(f"{numbered}_{stem}_I_GATE", 100 * usual)
        else:
            gate = parameters.get(f"EKF_{stem}_GATE", usual)
        z, over = np.stack([z_of[label] for label in labels], axis=-1), ratios[ratio][near] * gate
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.sum(z**2, axis=1) / over**2 / len(labels)
        S = np.repeat(np.where(over > 0, mean, np.nan)[:, None], len(labels), axis=1)
        found[name] = t, z, S
    return found


def _read_px4(log: DataFlash) -> OwnEstimate:
    """Return the estimate of PX4 before 2017: a position, and the attitude of another filter."""
    t, local = take_records(log, "LPOS")
    attitude_t, attitude = take_records(log, "ATT")
    origin = np.column_stack([np.deg2rad(local["RLat"]), np.deg2rad(local["RLon"]), _find_height(log, local)])
    lla = displace(origin, np.stack([local["X"], local["Y"], local["Z"]], axis=-1))
    lla[~origin[:, :2].any(axis=1)] = np.nan
    vel_n = np.stack([local["VX"], local["VY"], local["VZ"]], axis=-1)
    motion = OwnMotion(t, lla, vel_n, attitude_t, _read_attitude(attitude, 1.0))
    variance = np.full((len(t), 9), np.nan)
    if "EPH" in local:
        level = 0.5 * local["EPH"] ** 2
        variance[:, :3] = np.column_stack([level, level, local["EPV"] ** 2])
    return OwnEstimate(motion, (t, variance), no_values(6))


def _find_height(log: DataFlash, local: Mapping[str, FloatArray]) -> FloatArray:
    """Return the height of the reference (N,) by the first fix, because its own height is barometric."""
    _, gps = take_records(log, "GPS")
    fixed = gps["Fix"] >= 3
    height = float(gps["Alt"][fixed][0] + local["Z"][0]) if fixed.any() else np.nan
    return np.full(len(local["Z"]), height)
