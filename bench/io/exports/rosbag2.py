"""A ROS 2 bag, written with rosbags: standard messages in the frames of REP 103."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import GnssFixes
from bench.core.words.exceptions import ExportError
from bench.io.exports.local import to_enu, to_flu, to_poses
from bench.io.exports.outgoing import Calendar, ExportData

FORMATS = {"rosbag2": "a ROS 2 bag in the axes of REP 103 (needs the package rosbags)"}
FOLDER = "bag"
_STANDARD = (101325.0, 288.15, 0.0065, 5.25588)  # ISO 2533: [Pa], [K], [K/m], g / (R L) below 11 km


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write the bag; return its description for the README."""
    if find_spec("rosbags") is None:
        raise ExportError("rosbag2 needs the package rosbags: pip install rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    calendar = out.calendar
    messages = _Messages(types.types, calendar)
    topics = {"/imu/data_raw": ("sensor_msgs/msg/Imu", "imu_link", messages.imu(out))}
    if out.fixes is not None:
        topics["/gnss/fix"] = ("sensor_msgs/msg/NavSatFix", "gnss_link", messages.fixes(out.fixes))
        velocities = messages.velocities(out.fixes)
        topics["/gnss/vel"] = ("geometry_msgs/msg/TwistWithCovarianceStamped", "enu", velocities)
    if "baro" in out.instruments:
        topics["/baro/pressure"] = ("sensor_msgs/msg/FluidPressure", "baro_link", messages.pressures(out))
    for name in out.tracks:
        topic = "/" + "".join(c if c.isalnum() else "_" for c in name)
        topics[topic] = ("nav_msgs/msg/Odometry", "map", messages.odometry(out, name))
    with Writer(folder / FOLDER, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        for topic, (kind_of, frame, rows) in topics.items():
            connection = bag.add_connection(topic, kind_of, typestore=types)
            for t, fields in rows:
                message = types.types[kind_of](header=messages.header(t, frame), **fields)
                bag.write(connection, calendar.nanoseconds(t), types.serialize_cdr(message, kind_of))
    listed = "\n".join(
        f"- `{topic}`: {kind_of}{_CONTENTS.get(topic, _TRACK)}" for topic, (kind_of, *_) in topics.items()
    )
    lla = _find_origin(out)
    lat, lon = np.rad2deg(lla[:2])
    return f"""`ros2 bag play {FOLDER}`; messages of ROS 2 Humble in SQLite, stamped with their time of
validity in UTC.

{listed}

Frames of REP 103: body `imu_link` forward, left, up; `enu` and `map` east, north, up; `map` is the tangent
frame at latitude {lat:.9f} deg, longitude {lon:.9f} deg, height {lla[2]:.3f} m. The axes in the bag are
these, not those below."""


_CONTENTS = {
    "/imu/data_raw": ": mean angular rate [rad/s] and specific force [m/s^2] over the interval that "
    "ends at the stamp; no orientation (covariance -1)",
    "/gnss/fix": ": of the antenna, latitude, longitude [deg], height [m], covariance east, north, up [m^2]; "
    "status -1 if the receiver marks it as invalid",
    "/gnss/vel": ": of the antenna in `enu`, linear [m/s] with its covariance",
    "/baro/pressure": ": [Pa], from the altitude of the barometer, by the standard atmosphere (ISO 2533)",
}
_TRACK = ": pose of the IMU in `map`, velocity in `imu_link`"


def _find_origin(out: ExportData) -> FloatArray:
    """Return the origin (3,) of `map` [rad, rad, m]: the filters' initial position, or the first fix."""
    initial = out.start["initial"]
    places = [np.array([initial["lat_rad"], initial["lon_rad"], initial["alt_m"]], float)]  # NaN if not known
    if out.fixes is not None:
        places += list(out.fixes.lla[out.fixes.valid])
    origin = next((place for place in places if np.isfinite(place).all()), None)
    if origin is None:
        raise ExportError("the run has neither an initial position nor a fix, of which this format needs one")
    return origin


Rows = Iterator[tuple[float, dict[str, Any]]]
"""Time [s] and fields, besides the header, of each message of a topic."""


class _Messages:
    """The messages of each topic."""

    def __init__(self, types: Any, calendar: Calendar) -> None:
        self._types, self._calendar = types, calendar

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._types[kind.replace("/", "/msg/")](**fields)

    def header(self, t: float, frame: str) -> Any:
        seconds, nanoseconds = divmod(self._calendar.nanoseconds(t), 1_000_000_000)
        stamp = self._make("builtin_interfaces/Time", sec=seconds, nanosec=nanoseconds)
        return self._make("std_msgs/Header", stamp=stamp, frame_id=frame)

    def _vector(self, xyz: Any) -> Any:
        x, y, z = (float(value) for value in xyz)
        return self._make("geometry_msgs/Vector3", x=x, y=y, z=z)

    def _quaternion(self, q: Any) -> Any:
        w, x, y, z = (float(value) for value in q)
        return self._make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def imu(self, out: ExportData) -> Rows:
        rates, forces = (to_flu(values) for values in out.rates())
        step = float(np.median(out.imu.dt))
        variance = {triad: out.assumed(triad)["random_walk"] ** 2 / step for triad in ("gyro", "accel")}
        constant = {
            "orientation": self._quaternion((1, 0, 0, 0)),
            "orientation_covariance": np.array([-1.0] + [0.0] * 8),
            "angular_velocity_covariance": np.diag([variance["gyro"]] * 3).ravel(),
            "linear_acceleration_covariance": np.diag([variance["accel"]] * 3).ravel(),
        }
        for t, rate, force in zip(out.imu.t, rates, forces, strict=True):
            moving = {"angular_velocity": self._vector(rate), "linear_acceleration": self._vector(force)}
            yield t, constant | moving

    def fixes(self, fixes: GnssFixes) -> Rows:
        for k, t in enumerate(fixes.t):
            status = self._make("sensor_msgs/NavSatStatus", status=0 if fixes.valid[k] else -1, service=1)
            lat, lon = np.rad2deg(fixes.lla[k, :2])
            yield (
                t,
                {
                    "status": status,
                    "latitude": float(lat),
                    "longitude": float(lon),
                    "altitude": float(fixes.lla[k, 2]),
                    "position_covariance": _to_enu_matrix(fixes.cov_pos_n[k]).ravel(),
                    "position_covariance_type": 3,  # COVARIANCE_TYPE_KNOWN
                },
            )

    def velocities(self, fixes: GnssFixes) -> Rows:
        for k, t in enumerate(fixes.t):
            cov = np.zeros((6, 6))
            cov[:3, :3] = _to_enu_matrix(fixes.cov_vel_n[k])
            yield t, {"twist": self._twist(to_enu(fixes.vel_n[k]), cov)}

    def pressures(self, out: ExportData) -> Rows:
        baro = out.instruments["baro"]
        pressure_0, temperature_0, lapse, exponent = _STANDARD
        ratio = 1.0 - lapse * baro.alt_baro / temperature_0
        pressure = pressure_0 * ratio**exponent
        slope = pressure_0 * exponent * lapse / temperature_0 * ratio ** (exponent - 1.0)  # [Pa/m]
        for k, t in enumerate(baro.t):
            variance = float((slope[k] * baro.sd[k]) ** 2)
            yield t, {"fluid_pressure": float(pressure[k]), "variance": variance}

    def odometry(self, out: ExportData, name: str) -> Rows:
        track = out.tracks[name]
        position, attitude = to_poses(track.lla, track.q_nb, _find_origin(out))
        vel_b = to_flu(rotation.rotate(rotation.conjugate(track.q_nb), track.vel_n))
        none = np.zeros((6, 6))
        for k, t in enumerate(track.t):
            x, y, z = (float(value) for value in position[k])
            place = self._make("geometry_msgs/Point", x=x, y=y, z=z)
            pose = self._make("geometry_msgs/Pose", position=place, orientation=self._quaternion(attitude[k]))
            placed = self._make("geometry_msgs/PoseWithCovariance", pose=pose, covariance=none.ravel())
            yield t, {"child_frame_id": "imu_link", "pose": placed, "twist": self._twist(vel_b[k], none)}

    def _twist(self, linear: Any, cov: Any) -> Any:
        still = self._vector((0, 0, 0))
        twist = self._make("geometry_msgs/Twist", linear=self._vector(linear), angular=still)
        return self._make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=cov.ravel())


def _to_enu_matrix(cov_n: Any) -> Any:
    turn = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return turn @ cov_n @ turn.T
