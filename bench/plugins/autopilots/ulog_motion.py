"""The truth of a simulator and the estimates of EKF2 in a ULog.

EKF2 runs for each IMU and magnetometer; ``estimator_selector_status`` says which one flies. Its position is
``vehicle_local_position``, in meters from a reference; its covariances: ``eph``, ``epv``, ``evh``, ``evv``
there, and the diagonal of the covariance in ``estimator_states`` (before PX4 1.12 ``estimator_status``). That
has four elements of the quaternion, from PX4 1.15 on three angles in n.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pyulog import ULog

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import displace
from bench.core.records.data import EventRow
from bench.core.words.exceptions import ConfigError
from bench.io.logs.log_contents import (
    OwnEstimate,
    OwnMotion,
    list_steps,
    no_values,
    tell_innovations,
    turn_quaternion,
)

Data = Mapping[str, FloatArray]
TRUTH = "vehicle_local_position_groundtruth"
MESSAGES = (
    *("vehicle_attitude", "vehicle_local_position", "estimator_selector_status", "estimator_states"),
    *("estimator_attitude", "estimator_local_position", "estimator_status", "estimator_sensor_bias"),
    *("estimator_innovations", "estimator_innovation_variances", "ekf2_innovations"),
    *(TRUTH, "vehicle_attitude_groundtruth", "vehicle_global_position_groundtruth"),
)
"""Messages that are read here."""
_INNOVATIONS: Mapping[str, tuple[str, ...]] = {
    "gnss_position": ("gps_hpos[0]", "gps_hpos[1]", "gps_vpos"),
    "gnss_velocity": ("gps_hvel[0]", "gps_hvel[1]", "gps_vvel"),
    "baro": ("baro_vpos",),
    "magnetometer": ("mag_field[0]", "mag_field[1]", "mag_field[2]"),
    "airspeed": ("airspeed",),
}
_OLD_INNOVATIONS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    name: (tuple(f"{stem}{k}" for k in of), tuple(f"{stem.replace('innov', 'innov_var')}{k}" for k in of))
    for name, stem, of in (
        ("gnss_velocity", "vel_pos_innov", ("[0]", "[1]", "[2]")),
        ("gnss_position", "vel_pos_innov", ("[3]", "[4]", "[5]")),
        ("magnetometer", "mag_innov", ("[0]", "[1]", "[2]")),
    )
}
_RESETS = {
    "xy_reset_counter": "position",
    "z_reset_counter": "height",
    "vxy_reset_counter": "velocity",
    "vz_reset_counter": "vertical velocity",
    "heading_reset_counter": "heading",
}


def find(log: ULog, name: str, instance: int = 0) -> Data | None:
    """Return the columns of a message; None if it has no rows."""
    for data in log.data_list:
        if data.name == name and data.multi_id == instance and len(data.data.get("timestamp", ())):
            found: Data = data.data
            return found
    return None


def times(data: Data) -> FloatArray:
    """Return the times (N,) of the samples, of the message where it has none of those [s]."""
    sample = data.get("timestamp_sample")
    return 1e-6 * np.asarray(data["timestamp"] if sample is None or not np.any(sample) else sample, float)


def stack(data: Data, *names: str) -> FloatArray:
    """Return columns beside each other."""
    return np.stack([np.asarray(data[name], float) for name in names], axis=-1)


def read_truth(log: ULog, undulation: float, fixed: float) -> OwnMotion:
    """Return the truth of a simulator, with heights over the sea ``undulation`` below ellipsoidal ones.

    One whose heights are all 0 has none: it gets ``fixed``, that of the receiver.

    Raises
    ------
    ConfigError
        If there is none.
    """
    local, attitude = find(log, TRUTH), find(log, "vehicle_attitude_groundtruth")
    if local is None:
        raise ConfigError(f"no rows of {TRUTH}")
    place = find(log, "vehicle_global_position_groundtruth")
    motion = _join(local, attitude, undulation, place)
    heights = [local["ref_alt"], local["z"], *([] if place is None else [place["alt"]])]
    if not any(np.any(one) for one in heights):
        motion.lla[:, 2] = fixed
    return motion


def _join(local: Data, attitude: Data | None, undulation: float, place: Data | None = None) -> OwnMotion:
    t, ned = times(local), stack(local, "x", "y", "z")
    origin = stack(local, "ref_lat", "ref_lon", "ref_alt") * [np.pi / 180, np.pi / 180, 1.0]
    if place is not None and not origin[:, 2].any() and np.any(place["alt"]):
        height = np.interp(t, times(place), np.asarray(place["alt"], float))  # the reference has none
        origin[:, 2] = np.median(height + ned[:, 2])
    origin[:, 2] += undulation
    known = origin[:, :2].any(axis=1) & np.isfinite(ned).all(axis=1)
    if "xy_valid" in local:
        known &= (np.asarray(local["xy_valid"]) > 0) & (np.asarray(local["z_valid"]) > 0)
    lla = np.full_like(ned, np.nan)
    lla[known] = displace(origin[known], ned[known])
    attitude_t, q_nb = np.empty(0), np.empty((0, 4))
    if attitude is not None:
        attitude_t, q_nb = times(attitude), stack(attitude, *(f"q[{k}]" for k in range(4)))
    return OwnMotion(t, lla, stack(local, "vx", "vy", "vz"), attitude_t, q_nb)


def has_estimate(log: ULog) -> bool:
    """Return whether the autopilot estimated a position on Earth."""
    local = find(log, "vehicle_local_position")
    return local is not None and bool(np.isfinite(_join(local, None, 0.0).lla).any())


def read_estimate(log: ULog, instance: int | None, undulation: float) -> OwnEstimate:
    """Return the estimate of an instance of EKF2; None selects the instance that flew at each time.

    Raises
    ------
    ConfigError
        If there is none.
    """
    source, number = ("vehicle", 0) if instance is None else ("estimator", instance)
    local, attitude = find(log, f"{source}_local_position", number), find(log, f"{source}_attitude", number)
    if local is None or attitude is None:
        what = "of the autopilot" if instance is None else f"of instance {instance}"
        raise ConfigError(f"no estimate {what}: the log lacks {source}_local_position or {source}_attitude")
    selector = find(log, "estimator_selector_status")
    if instance is None and selector is not None:
        number = int(np.median(np.asarray(selector["primary_instance"])))
    motion = _join(local, attitude, undulation)
    events = list_steps(
        motion.t, {what: np.asarray(local[key]) for key, what in _RESETS.items() if key in local}, "reset"
    )
    if "quat_reset_counter" in attitude:
        counter = np.asarray(attitude["quat_reset_counter"])
        events += list_steps(motion.attitude_t, {"attitude": counter}, "reset")
    if instance is None and selector is not None:
        events += _list_lanes(selector)
    return OwnEstimate(
        motion,
        _read_variances(log, local, number, motion),
        _read_biases(log, number),
        tell_innovations(_read_innovations(log, number)),
        tuple(sorted(events)),
    )


def _list_lanes(selector: Data) -> list[EventRow]:
    t, lane = times(selector), np.asarray(selector["primary_instance"])
    return [
        (float(t[k + 1]), float(t[k + 1]), "lane", f"instance {lane[k + 1]} after {lane[k]}")
        for k in np.flatnonzero(np.diff(lane.astype(int)) != 0)
    ]


def _read_variances(
    log: ULog, local: Data, instance: int, motion: OwnMotion
) -> tuple[FloatArray, FloatArray]:
    """Return the covariances: of position and velocity as published, of the attitude by the covariance."""
    variance = np.full((len(motion.t), 9), np.nan)
    for first, h, v in ((0, "eph", "epv"), (3, "evh", "evv")):
        if h in local and np.any(local[h]):
            level = 0.5 * np.square(np.asarray(local[h], float))
            variance[:, first : first + 3] = np.column_stack([level, level, np.square(local[v])])
    states = find(log, "estimator_states", instance) or find(log, "estimator_status", instance)
    if states is None or "covariances[8]" not in states or not len(motion.attitude_t):
        return motion.t, variance
    t, diagonal = times(states), stack(states, *(f"covariances[{k}]" for k in range(9)))
    level = np.interp(t, motion.t, variance[:, 0] + variance[:, 1])
    angles = np.median(np.abs(diagonal[:, 6] + diagonal[:, 7] - level))
    quaternion = np.median(np.abs(diagonal[:, 7] + diagonal[:, 8] - level))
    row = np.clip(np.searchsorted(motion.attitude_t, t), 0, len(motion.attitude_t) - 1)
    phi = diagonal[:, :3] if angles < quaternion else turn_quaternion(diagonal[:, :4], motion.q_nb[row])
    phi = np.where(phi > 0, phi, np.nan)
    variance[:, 6:] = np.column_stack([np.interp(motion.t, t, column) for column in phi.T])
    return motion.t, variance


def _read_biases(log: ULog, instance: int) -> tuple[FloatArray, FloatArray]:
    data = find(log, "estimator_sensor_bias", instance)
    if data is None or "gyro_bias[0]" not in data:
        return no_values(6)
    return times(data), stack(data, *(f"{one}_bias[{k}]" for one in ("gyro", "accel") for k in range(3)))


def _read_innovations(log: ULog, instance: int) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    values = find(log, "estimator_innovations", instance)
    variances = find(log, "estimator_innovation_variances", instance)
    if values is not None and variances is not None:
        t = times(values)
        near = np.clip(np.searchsorted(times(variances), t - 1e-6), 0, len(variances["timestamp"]) - 1)
        return {
            name: (t, stack(values, *columns), stack(variances, *columns)[near])
            for name, columns in _INNOVATIONS.items()
            if set(columns) <= values.keys() & variances.keys()
        }
    old = find(log, "ekf2_innovations", instance)
    if old is None:
        return {}
    t = times(old)
    return {
        name: (t, stack(old, *z), stack(old, *S))
        for name, (z, S) in _OLD_INNOVATIONS.items()
        if {*z, *S} <= old.keys()
    }
