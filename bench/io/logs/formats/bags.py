"""ROS 1 and ROS 2 bags, read with rosbags, and MCAP files, read with mcap.

imu: sensor_msgs/Imu, in the axes of the message (REP 103: forward, left, up; mounting_deg = [180, 0, 0]
converts them). gnss: sensor_msgs/NavSatFix and, if there is exactly one such topic,
geometry_msgs/TwistStamped or TwistWithCovarianceStamped with the same stamps, east, north, up. baro:
sensor_msgs/FluidPressure. Messages are those of ROS or, in MCAP, JSON with the same fields. Times are those
of the headers.
"""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files.disk_arrays import ROWS
from bench.core.files.file_checks import check_file
from bench.core.files.memory_limit import limit_memory
from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.formats.unreadable import describe_damage
from bench.io.logs.rows import MOST_ROWS, LogRows
from bench.io.logs.table_files import MOST_BYTES
from bench.simulation.signals.air import pressure_altitude

_MOST_RECORD = 256_000_000  # largest record of an MCAP file, chunks included [byte]
MOST_UNPACKED = 512_000_000  # memory for reading, beside twice the size of a file and its columns [byte]
_SAME_STAMP = 1e-3  # [s]
_TYPES = {
    "imu": ("sensor_msgs/msg/Imu",),
    "gnss": ("sensor_msgs/msg/NavSatFix",),
    "baro": ("sensor_msgs/msg/FluidPressure",),
}
_VELOCITIES = ("geometry_msgs/msg/TwistWithCovarianceStamped", "geometry_msgs/msg/TwistStamped")

Messages = Iterator[Any]
Bag = tuple[Mapping[str, str], Callable[[str], Messages]]
"""Topic -> type, and a function that yields the messages of a topic."""


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of a topic of a bag."""
    inside = [one for one in (path.rglob("*") if path.is_dir() else [path]) if one.exists()]
    for one in inside:
        check_file(one, one.name, MOST_BYTES)
    size = sum(one.stat().st_size for one in inside if one.is_file())
    if size > MOST_BYTES:
        raise ConfigError(f"{path.name}: larger than {MOST_BYTES // 1_000_000} MB")
    opened = _open_mcap if form == "mcap" else _open_bag
    try:
        with limit_memory(MOST_UNPACKED + 2 * size) as allow, opened(path) as (topics, messages):
            chosen = _choose_topic(path, topics, _TYPES[kind], topic)
            row = {"imu": _read_imu, "gnss": read_fix, "baro": _read_pressure}[kind]
            numbers = _read_numbers(path, messages(chosen), row, allow)
            twist = np.empty((0, 10))
            moving = [name for name, type_ in topics.items() if type_ in _VELOCITIES]
            if kind == "gnss" and len(moving) == 1:
                twist = _read_numbers(path, messages(moving[0]), read_twist, allow, numbers.nbytes)
    except ConfigError:
        raise
    except ModuleNotFoundError:
        raise
    except MemoryError:
        most = f"{MOST_UNPACKED / 1e6:g} MB"
        raise ConfigError(f"{path.name}: unpacks to more than the {most} it may take in memory") from None
    except Exception as error:  # a broken file can make the library raise anything
        raise describe_damage(path, error) from None
    t = numbers[:, 0]
    if kind == "imu":
        return LogRows(t, {"gyro": numbers[:, 1:4], "accel": numbers[:, 4:7]})
    if kind == "baro":
        return LogRows(
            t, {"alt_baro": pressure_altitude(np.where(numbers[:, 1:] > 0, numbers[:, 1:], np.nan))}
        )
    return make_fixes(numbers, twist)


def _choose_topic(path: Path, topics: Mapping[str, str], types: Sequence[str], topic: str | None) -> str:
    able = [name for name, type_ in topics.items() if type_ in types]
    if topic is not None and topic in able:
        return topic
    if topic is None and len(able) == 1:
        return able[0]
    there = ", ".join(f"{name} ({type_})" for name, type_ in sorted(topics.items()))[:300] or "none"
    if topic is not None:
        raise ConfigError(f"{path.name}: topic {topic!r} holds no {types[0]}; there are {there}")
    if able:
        raise ConfigError(f"{path.name}: several topics hold {types[0]}: {', '.join(able)}; set topic to one")
    raise ConfigError(f"{path.name}: no topic of {types[0]}; there are {there}")


def _read_numbers(
    path: Path,
    messages: Messages,
    row: Callable[[Any], tuple[float, ...]],
    allow: Callable[[int], None],
    columns: int = 0,
) -> FloatArray:
    """Return the numbers of the messages, one row each; ``columns`` are there already [byte]."""
    flat, width = array("d"), 0
    for count, message in enumerate(messages, 1):
        if count % ROWS == 0:  # they grow by an eighth at most, and are copied once
            allow(columns + 3 * flat.itemsize * len(flat))
        if count > MOST_ROWS:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} messages of one topic")
        try:
            values = row(message)
        except (AttributeError, KeyError, TypeError, ValueError, IndexError) as error:
            raise ConfigError(f"{path.name}: message {count} of a topic is wrong: {error}") from None
        width = len(values)
        flat.extend(values)
    return np.array(flat).reshape(-1, width) if width else np.empty((0, 10))


# --- messages -----------------------------------------------------------------------------------------


def _read_stamp(message: Any) -> float:
    stamp = message.header.stamp
    nanoseconds = getattr(stamp, "nanosec", None)
    return float(stamp.sec) + 1e-9 * float(stamp.nsec if nanoseconds is None else nanoseconds)


def _read_xyz(vector: Any) -> tuple[float, float, float]:
    return (float(vector.x), float(vector.y), float(vector.z))


def _read_imu(message: Any) -> tuple[float, ...]:
    return (
        _read_stamp(message),
        *_read_xyz(message.angular_velocity),
        *_read_xyz(message.linear_acceleration),
    )


def read_fix(message: Any) -> tuple[float, ...]:
    """Return time, place, standard deviations north, east, up and status of a NavSatFix."""
    place = (float(message.latitude), float(message.longitude), float(message.altitude))
    cov = np.asarray(message.position_covariance, float).reshape(9)
    known = int(message.position_covariance_type) > 0
    east, north, up = (math.sqrt(max(cov[k], 0.0)) if known else math.nan for k in (0, 4, 8))
    return (_read_stamp(message), *place, north, east, up, float(int(message.status.status)))


def read_twist(message: Any) -> tuple[float, ...]:
    """Return time, velocity and its variances, east, north, up, of a message of motion."""
    twist = message.twist
    cov = [math.nan] * 3
    if hasattr(twist, "twist"):
        matrix = np.asarray(twist.covariance, float).reshape(6, 6)
        cov, twist = [float(matrix[k, k]) for k in range(3)], twist.twist
    return (_read_stamp(message), *_read_xyz(twist.linear), *cov)


def _read_pressure(message: Any) -> tuple[float, ...]:
    return (_read_stamp(message), float(message.fluid_pressure))


def make_fixes(numbers: FloatArray, twist: FloatArray) -> LogRows:
    """Return fixes with the velocities of the same time."""
    t = numbers[:, 0]
    lla = np.column_stack([np.deg2rad(numbers[:, 1:3]), numbers[:, 3]])
    lla[numbers[:, 7] < 0] = np.nan  # STATUS_NO_FIX
    values = {"lla": lla, "quality": numbers[:, 7]}
    if (numbers[:, 4:7] > 0).any():
        values["sd_pos"] = numbers[:, 4:7]
    if len(twist):
        order = np.argsort(twist[:, 0], kind="stable")
        twist = twist[order]
        at = np.clip(np.searchsorted(twist[:, 0], t - _SAME_STAMP), 0, len(twist) - 1)
        same = np.abs(twist[at, 0] - t) <= _SAME_STAMP
        values["vel_n"] = np.where(same[:, None], twist[at][:, [2, 1, 3]] * [1.0, 1.0, -1.0], np.nan)
        variance = twist[at][:, [5, 4, 6]]
        values["sd_vel"] = np.sqrt(np.where(same[:, None] & (variance > 0), variance, np.nan))
    return LogRows(t, values)


# --- files --------------------------------------------------------------------------------------------


@contextmanager
def _open_bag(path: Path) -> Iterator[Bag]:
    """Open a ROS 1 file, a ROS 2 folder or a file in a ROS 2 folder."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        by_topic: dict[str, list[Any]] = {}
        for connection in reader.connections:
            by_topic.setdefault(connection.topic, []).append(connection)

        def messages(topic: str) -> Messages:
            for connection, _, raw in reader.messages(by_topic[topic]):
                yield reader.deserialize(raw, connection.msgtype)

        yield {topic: several[0].msgtype for topic, several in by_topic.items()}, messages


@contextmanager
def _open_mcap(path: Path) -> Iterator[Bag]:
    """Open an MCAP file of ROS 1, ROS 2 or JSON messages."""
    from mcap.reader import NonSeekingReader

    with path.open("rb") as file:

        def every() -> Iterator[Any]:
            file.seek(0)
            reader = NonSeekingReader(file, record_size_limit=_MOST_RECORD)
            return reader.iter_messages(log_time_order=False)

        def messages(topic: str) -> Messages:
            decoders: dict[int, Callable[[bytes], Any]] = {}
            for schema, channel, message in every():
                if channel.topic == topic:
                    if channel.id not in decoders:
                        decoders[channel.id] = _make_decoder(path, schema, channel)
                    yield decoders[channel.id](message.data)

        topics: dict[str, str] = {}
        for schema, channel, _ in every():
            if schema is not None:
                topics.setdefault(channel.topic, _ros2_name(schema.name))
        yield topics, messages


def _make_decoder(path: Path, schema: Any, channel: Any) -> Callable[[bytes], Any]:
    """Return the function that decodes the bytes of a channel, by the definition in the file."""
    encoding = channel.message_encoding
    if encoding == "json":
        return lambda raw: _JsonMessage(json.loads(raw))
    if encoding not in ("cdr", "ros1"):
        raise ConfigError(
            f"{path.name}: topic {channel.topic!r} is in {encoding!r}, not in cdr, ros1 or json"
        )
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types, name = get_typestore(Stores.EMPTY), _ros2_name(schema.name)
    types.register(get_types_from_msg(schema.data.decode(), name))
    if encoding == "cdr":
        return lambda raw: types.deserialize_cdr(raw, name)
    return lambda raw: types.deserialize_ros1(raw, name)


def _ros2_name(name: str) -> str:
    """Return the ROS 2 name of a type."""
    return name if "/msg/" in name else name.replace("/", "/msg/", 1)


class _JsonMessage(dict[str, Any]):
    """A JSON object with its entries as attributes."""

    def __getattr__(self, name: str) -> Any:
        try:
            value = self[name]
        except KeyError:
            raise AttributeError(f"no field {name!r}") from None
        return _JsonMessage(value) if isinstance(value, dict) else value
