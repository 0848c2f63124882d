"""Column names of programs that write tables of sensors: the one place that knows them.

A table is of a program if it has one of its marks. Names are compared by letters and digits alone, in lower
case, without units in brackets: ``field.angular_velocity.x`` is ``fieldangularvelocityx``. A name of ours
without a unit gets it by the values: the program, or its settings, write more than one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bench.core.mathematics.units import split_unit

FORWARD_LEFT_UP = (180.0, 0.0, 0.0)
"""Roll, pitch, yaw of axes forward, left, up [deg]."""


class Exporter(NamedTuple):
    """A program, and what it calls the columns of a log."""

    title: str
    marks: tuple[str, ...]  # patterns of names, one of which is there
    columns: Mapping[str, tuple[str, ...]]  # name of ours -> patterns of theirs, the best first
    axes: tuple[float, float, float] | None = None  # of its IMU [deg]; None: as it was mounted
    sign: str = ""  # of its accelerometers, if it is not that of specific force
    gyro_clock: str = ""  # pattern of the time of its gyros [s], if they have their own
    epochs: tuple[str, str] = ("", "")  # patterns of the times of IMU and fixes [s], on two clocks
    hints: Mapping[str, str] = {}  # name of ours -> what to ask of its unit, or to do if it has none


def _name_axes(ours: str, *theirs: str, unit: str = "") -> dict[str, tuple[str, ...]]:
    """Return three columns; ``{}`` is the axis in their names."""
    return {f"{ours}_{axis}{unit}": tuple(one.format(axis) for one in theirs) for axis in "xyz"}


def _number_axes(ours: str, theirs: str, unit: str) -> dict[str, tuple[str, ...]]:
    return {f"{ours}_{axis}{unit}": (f"{theirs}{k}",) for k, axis in enumerate("xyz")}


_DECODE = "decode the log again by blackbox_decode --unit-rotation deg/s --unit-acceleration m/s2"
_BLACKBOX = {
    "t": ("time",),
    **_number_axes("gyro", "gyroadc", ""),
    **_number_axes("accel", "accsmooth", ""),
    "lat_deg": ("gpscoord0",),
    "lon_deg": ("gpscoord1",),
    "speed_mps": ("gpsspeed",),
    "course_deg": ("gpsgroundcourse",),
    "satellites": ("gpsnumsat",),
}
_ROS_TIMES = {"t_ns": ("(field)?headerstamp",), "t_s": (".*headerstampsecs?",), "t": (".*time",)}
EXPORTERS = (
    # VectorNav SDK and Sensor Explorer; ICD: TimeStartup in ns, rates in rad/s, DeltaTheta in deg
    Exporter(
        "VectorNav",
        ("(imu)?timestartup", "(imu)?uncompgyrox", "angularratex", "gnss1poslat"),
        {
            "t_ns": ("(time)?timestartup", "timegps"),
            **_name_axes("gyro", "(imu)?uncompgyro{}", "angularrate{}", "gyro{}", unit="_rad_s"),
            **_name_axes("accel", "(imu)?uncompacc(el)?{}", "acc(el)?{}", unit="_m_s2"),
            **_name_axes("dtheta", "deltatheta{}", unit="_deg"),
            **_name_axes("dvel", "deltavel{}", unit="_mps"),
            "dt_s": ("deltatime",),
            "lat_deg": ("(gnss1|gps1?)?pos(lla)?lat(itude)?", "lat(itude)?"),
            "lon_deg": ("(gnss1|gps1?)?pos(lla)?lon(gitude)?", "lon(gitude)?"),
            "alt_m": ("(gnss1|gps1?)?pos(lla)?alt(itude)?", "alt(itude)?"),
            **{f"vel_{a}_mps": (f"(gnss1|gps1?)?vel(ned)?{n}",) for a, n in zip("ned", "xyz", strict=True)},
            **{f"sd_{a}_m": (f"gnss1posuncertainty{a}",) for a in "ned"},
        },
    ),
    # Xsens MT Manager: SampleTimeFine counts 10 kHz; its velocities are in axes that the user chooses
    Exporter(
        "Xsens MT Manager",
        ("packetcounter", "sampletimefine"),
        {
            "t_100us": ("sampletimefine",),
            **_name_axes("gyro", "gyr{}", unit="_rad_s"),
            **_name_axes("accel", "acc{}", unit="_m_s2"),
            "lat_deg": ("lat(itude)?",),
            "lon_deg": ("lon(gitude)?",),
            "alt_m": ("alt(itude)?", "altitudeellipsoid"),
        },
        FORWARD_LEFT_UP,
    ),
    # MicroStrain SensorConnect: scaled channels in g and rad/s; its delta velocity is in g s
    Exporter(
        "MicroStrain",
        (".*scaledaccelx",),
        {
            "t": (".*time(stamp)?",),
            **_name_axes("gyro", ".*scaledgyro{}", unit="_rad_s"),
            **_name_axes("accel", ".*scaledaccel{}", unit="_g"),
            "lat_deg": (".*latitude",),
            "lon_deg": (".*longitude",),
            "alt_m": (".*height(above)?ellipsoid",),
        },
    ),
    Exporter(
        "MicroStrain",  # the same program, for sensors that stream by message
        ("gpstflags",),
        {
            "t_s": ("gpstow",),
            **_name_axes("gyro", "{}gyro", unit="_rad_s"),
            **_name_axes("accel", "{}accel", unit="_g"),
            "lat_deg": ("lat",),
            "lon_deg": ("long",),
            "alt_m": ("height",),
        },
    ),
    # sbgECom, sbgBasicLogger; the units stand below the names
    Exporter(
        "SBG Systems",
        ("accelx", "gpstow"),
        {
            "t": ("timestamp",),
            **_name_axes("gyro", "gyro{}"),
            **_name_axes("accel", "accel{}"),
            "lat_deg": ("latitude",),
            "lon_deg": ("longitude",),
            "alt_m": ("altitude",),
            **{f"vel_{a}_mps": (f"vel{a}",) for a in "ned"},
            "sd_n_m": ("latitudestd",),
            "sd_e_m": ("longitudestd",),
            "sd_d_m": ("altitudestd",),
            **{f"sd_v{a}_mps": (f"velstd{a}",) for a in "ned"},
            "satellites": ("numsvused",),
        },
    ),
    # Advanced Navigation, logs of its managers: seconds since 1970, and microseconds beside them
    Exporter(
        "Advanced Navigation",
        ("unixtime(seconds)?",),
        {
            "t_s": ("unixtime(seconds)?",),
            "t_fraction_us": ("microseconds",),
            **_name_axes("gyro", "gyroscope{}", "angularvelocity{}"),
            **_name_axes("accel", "accelerometer{}"),
            "lat_deg": ("latitude",),
            "lon_deg": ("longitude",),
            "alt_m": ("height",),
            **{f"vel_{w[0]}_mps": (f"velocity{w}",) for w in ("north", "east", "down")},
            "sd_n_m": ("latitude(sd|standarddeviation)",),
            "sd_e_m": ("longitude(sd|standarddeviation)",),
            "sd_d_m": ("height(sd|standarddeviation)",),
        },
    ),
    # u-blox UBX-NAV-PVT: integers are those of the message, 1e-7 deg, mm, mm/s
    Exporter(
        "u-blox",
        ("itow",),
        {
            "t_ms": ("itow",),
            "lat": ("lat",),
            "lon": ("lon",),
            "alt": ("height",),
            **{f"vel_{a}": (f"vel{a}",) for a in "ned"},
            "satellites": ("numsv",),
        },
    ),
    # PX4's ulog2csv; sensor_combined, vehicle_imu, vehicle_gps_position and sensor_gps
    Exporter(
        "PX4 ulog2csv",
        ("gyrorad0", "deltaangle0", "latitudedeg", "timeutcusec"),
        {
            "t_us": ("timestampsample", "timestamp"),
            **_number_axes("gyro", "gyrorad", "_rad_s"),
            **_number_axes("accel", "accelerometerms2", "_m_s2"),
            **_number_axes("dtheta", "deltaangle", "_rad"),
            **_number_axes("dvel", "deltavelocity", "_mps"),
            "dt_us": ("deltaangledt",),
            "lat": ("lat(itudedeg)?",),
            "lon": ("lon(gitudedeg)?",),
            "alt": ("alt(itude)?ellipsoidm?",),
            **{f"vel_{a}_mps": (f"vel{a}ms",) for a in "ned"},
            "satellites": ("satellitesused",),
        },
    ),
    # src/blackbox_decode.c of github.com/betaflight/blackbox-tools; axes of src/main/flight/imu.c of the
    # firmware, where a positive pitch is nose down. orangebox reads the log itself, but uv rejects its wheel
    Exporter("iNav blackbox", ("gpshdop",), {**_BLACKBOX, "alt_m": ("gpsaltitude",)}, FORWARD_LEFT_UP),
    Exporter(
        "Betaflight blackbox",
        ("gyroadc0", "gpscoord0"),
        {**_BLACKBOX, "alt_dm": ("gpsaltitude",)},
        FORWARD_LEFT_UP,
        hints={
            "alt_dm": "taken as dm, as Betaflight 4 writes it; name it alt_cm for earlier versions",
            "accel_x": _DECODE,
        },
    ),
    # ROS: rostopic echo -p, bagpy, PlotJuggler; sensor_msgs/Imu and NavSatFix, axes of REP 103
    Exporter(
        "ROS",
        (".*angularvelocityx", ".*positioncovariance0"),
        {
            **_ROS_TIMES,
            "t_fraction_ns": (".*headerstampn(ano)?secs?",),
            **_name_axes("gyro", ".*angularvelocity{}", unit="_rad_s"),
            **_name_axes("accel", ".*linearacceleration{}", unit="_m_s2"),
            "lat_deg": (".*latitude",),
            "lon_deg": (".*longitude",),
            "alt_m": (".*altitude",),
        },
        FORWARD_LEFT_UP,
    ),
    # ASL data sets: EuRoC, TUM-VI; the IMU as it was mounted
    Exporter(
        "EuRoC",
        ("wrssx",),
        {
            "t_ns": ("timestamp",),
            **_name_axes("gyro", "wrss{}", unit="_rad_s"),
            **_name_axes("accel", "arss{}", unit="_m_s2"),
        },
    ),
    # Android: Physics Toolbox; its ax, ay, az are without gravity
    Exporter(
        "Physics Toolbox",
        ("gfx",),
        {
            "t": ("time",),
            **_name_axes("gyro", "w{}", unit="_rad_s"),
            **_name_axes("accel", "gf{}", unit="_g"),
            "lat_deg": ("latitude",),
            "lon_deg": ("longitude",),
            "alt_m": ("altitude", "height"),
        },
    ),
    # Android: AndroSensor, and the tables made of it
    Exporter(
        "AndroSensor",
        ("locationlatitude", "timesincestart(inms)?"),
        {
            "t_ms": ("timesincestart(inms)?",),
            **_name_axes("gyro", "gyroscope{}", unit="_rad_s"),
            **_name_axes("accel", "accelerometer{}", unit="_m_s2"),
            "lat_deg": ("(location|gps)latitude",),
            "lon_deg": ("(location|gps)longitude",),
            "alt_m": ("(location|gps)altitude",),
        },
    ),
    # SensorLog for iOS: forces with the sign of gravity (CMAccelerometerData); clocks since the boot and 1970
    Exporter(
        "SensorLog",
        ("accelerometertimestampsincereboots?",),
        {
            "t_s": ("accelerometertimestampsincereboots?",),
            **_name_axes("gyro", "gyrorotation{}", unit="_rad_s"),
            **_name_axes("accel", "accelerometeracceleration{}", unit="_g"),
        },
        sign="gravity",
        gyro_clock="gyrotimestampsincereboots?",
        epochs=("accelerometertimestampsincereboots?", "locationtimestampsince1970s?"),
    ),
    Exporter(
        "SensorLog",
        ("locationtimestampsince1970s?",),
        {
            "t_s": ("locationtimestampsince1970s?",),
            "lat_deg": ("locationlatitude",),
            "lon_deg": ("locationlongitude",),
            "alt_m": ("locationaltitude",),
            "speed_mps": ("locationspeed",),
            "course_deg": ("locationcourse",),
            "accuracy_h_m": ("locationhorizontalaccuracy",),
            "accuracy_v_m": ("locationverticalaccuracy",),
        },
    ),
    # Sensor Logger, UNITS.md of github.com/tszheichoi/awesome-sensor-logger: its Location.csv
    Exporter(
        "Sensor Logger",
        ("secondselapsed",),
        {
            "t_ns": ("time",),
            "lat_deg": ("latitude",),
            "lon_deg": ("longitude",),
            "alt_m": ("altitude",),
            "speed_mps": ("speed",),
            "course_deg": ("bearing",),
            "accuracy_h_m": ("horizontalaccuracy",),
            "accuracy_v_m": ("verticalaccuracy",),
            "accuracy_speed_mps": ("speedaccuracy",),
        },
    ),
    # phyphox: its Location.csv; units in brackets
    Exporter(
        "phyphox",
        ("direction",),
        {
            "t_s": ("time",),
            "lat_deg": ("latitude",),
            "lon_deg": ("longitude",),
            "alt_m": ("altitudewgs84", "height", "altitude"),
            "speed_mps": ("velocity", "speed"),
            "course_deg": ("direction",),
            "accuracy_h_m": ("horizontalaccuracy",),
            "accuracy_v_m": ("verticalaccuracy",),
        },
    ),
    # car loggers on phones, as in github.com/balzer82/Kalman: milliseconds since 1970, deg/s, km/h
    Exporter(
        "car logger",
        ("rollrate",),
        {
            "t_ms": ("millis",),
            **{
                f"gyro_{a}_deg_s": (f"{n}rate",) for a, n in zip("xyz", ("roll", "pitch", "yaw"), strict=True)
            },
            **_name_axes("accel", "a{}", unit="_m_s2"),
            "lat_deg": ("latitude",),
            "lon_deg": ("longitude",),
            "alt_m": ("altitude",),
            "speed_km_h": ("speed",),
            "course_deg": ("course",),
            "hdop": ("hdop",),
            "vdop": ("vdop",),
            "satellites": ("satellitesused",),
        },
    ),
    # gnss-ins-sim: units in brackets; the velocity is along n
    Exporter(
        "gnss-ins-sim",
        ("gpslat", "gpsvn"),
        {
            "t_s": ("(gps)?time",),
            "lat_deg": ("gpslat",),
            "lon_deg": ("gpslon",),
            "alt_m": ("gpsalt",),
            **{f"vel_{a}_mps": (f"gpsv{a}",) for a in "ned"},
            **_name_axes("gyro", "gyro{}", unit="_deg_s"),
            **_name_axes("accel", "accel{}", unit="_m_s2"),
        },
    ),
    # bare names: gyros in g, accelerometers in a
    Exporter(
        "ax ... gz",
        ("gx",),
        {"t": ("t|time|timestamp|.*time",), **_name_axes("gyro", "g{}"), **_name_axes("accel", "a{}")},
    ),
)
"""What is tried in this order, before names are told by their words."""


def make_plain(name: str) -> str:
    """Return the letters and digits of a name, without a unit in brackets; an index there is kept."""
    return re.sub(r"[^a-z0-9]", "", re.sub(r"[\[(](?!\d+[\])])[^\])]*[\])]?", "", name.lower()))


_CLOCK = re.compile(r"t(_[a-z0-9]+)?")


def match_exporter(
    names: Sequence[str], needed: Sequence[Sequence[str]]
) -> tuple[Exporter, dict[str, str]] | None:
    """Return the program that wrote a table, and its columns: name of ours -> name in the file.

    ``needed``: sets of stems of ours, one of which has to be there whole; times are always needed.
    """
    plain = {name: make_plain(name) for name in names}
    for exporter in EXPORTERS:
        if not any(re.fullmatch(mark, one) for mark in exporter.marks for one in plain.values()):
            continue
        found: dict[str, str] = {}
        for ours, patterns in exporter.columns.items():
            theirs = (name for p in patterns for name, one in plain.items() if re.fullmatch(p, one))
            if (first := next(theirs, None)) is not None:
                found[ours] = first
        clock = next((ours for ours in found if _CLOCK.fullmatch(ours)), None)
        stems = {ours if ours in one else split_unit(ours)[0] for one in needed for ours in found}
        if clock is not None and any(set(one) <= stems for one in needed):
            return exporter, {
                ours: name
                for ours, name in found.items()
                if ours == clock
                or not (_CLOCK.fullmatch(ours) or (ours.startswith("t_fraction") and clock != "t_s"))
            }
    return None
