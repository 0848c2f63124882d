"""Files as their owners have them, written from the published layout of each format: one drive of a car,
90 s, at rest for the first 15 s, so that what is read of them can be known."""

from __future__ import annotations

import json
import math
import sqlite3
import struct
import zipfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np

RATE_HZ = 50
START = datetime(2026, 3, 2, 10, 0, 0, tzinfo=UTC)
G = 9.80665


class Drive:
    """Sensors of a car on a plane: times [s], gyros [rad/s], specific force [m/s^2] forward, right, down."""

    def __init__(self) -> None:
        self.t = np.arange(90 * RATE_HZ) / RATE_HZ
        self.v = 14 * np.clip((self.t - 15) / 10, 0, 1)
        self.psi = 1.0 + 0.8 * np.sin(0.15 * np.clip(self.t - 25, 0, None))
        noise = np.random.default_rng(60).normal
        turn, gain = np.gradient(self.psi, self.t), np.gradient(self.v, self.t)
        self.gyro = np.stack([0 * turn, 0 * turn, turn], 1) + noise(0, 0.002, (len(turn), 3))
        self.force = np.stack([gain, self.v * turn, -G + 0 * turn], 1) + noise(0, 0.02, (len(turn), 3))
        north = np.cumsum(self.v * np.cos(self.psi)) / RATE_HZ + 0.5 * noise(0, 1, len(turn))
        east = np.cumsum(self.v * np.sin(self.psi)) / RATE_HZ + 0.5 * noise(0, 1, len(turn))
        self.lat = 47.0 + north / 111_200
        self.lon = 11.0 + east / 75_900
        self.alt = 600.0 + noise(0, 0.8, len(turn))
        self.fixes = range(0, len(self.t), RATE_HZ)

    def utc(self, k: int) -> datetime:
        return START + timedelta(seconds=float(self.t[k]))


D = Drive()


def lines(path: Path, *rows: str, end: str = "\n") -> Path:
    path.write_text(end.join(rows) + end, newline="")
    return path


def row(*values: object) -> str:
    return ",".join(f"{one:.9g}" if isinstance(one, float) else str(one) for one in values)


def empty(folder: Path) -> Path:
    (folder / "log.csv").touch()
    return folder / "log.csv"


def header_only(folder: Path) -> Path:
    return lines(folder / "imu.csv", "t_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s,acc_x_g,acc_y_g,acc_z_g")


def photo(folder: Path) -> Path:
    exif = b"Exif\0\0II*\0\x08\0\0\0\0\0"
    (folder / "DSC0001.JPG").write_bytes(
        b"\xff\xd8\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + bytes(500) + b"\xff\xd9"
    )
    return folder / "DSC0001.JPG"


def video(folder: Path) -> Path:
    (folder / "GX010042.MP4").write_bytes(
        struct.pack(">I4s4sI4s", 20, b"ftyp", b"mp41", 0, b"mp41")
        + struct.pack(">I4s", 508, b"mdat")
        + bytes(500)
    )
    return folder / "GX010042.MP4"


def crc16(data: bytes) -> int:
    """CRC-CCITT of an SBF block, from its ID on."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def septentrio(folder: Path) -> Path:
    """PVTGeodetic blocks (4007) of a Septentrio receiver: position in rad, velocity north, east, up."""
    blocks = b""
    for k in D.fixes:
        ms, vel = (
            int(1000 * (122_400 + D.t[k])),
            (D.v[k] * math.cos(D.psi[k]), D.v[k] * math.sin(D.psi[k]), 0.0),
        )
        place = (math.radians(D.lat[k]), math.radians(D.lon[k]), float(D.alt[k]))
        body = struct.pack("<IHBB3df3ff", ms, 2408, 1, 0, *place, 48.0, *vel, -2e10).ljust(88, b"\0")
        rest = struct.pack("<HH", 4007, len(body) + 8) + body
        blocks += b"$@" + struct.pack("<H", crc16(rest)) + rest
    (folder / "rover.sbf").write_bytes(blocks)
    return folder / "rover.sbf"


def fit(folder: Path) -> Path:
    """A FIT activity: a definition of `record` (20), then its rows; positions in semicircles."""
    body = b"\x40\0\0" + struct.pack("<HB", 20, 3) + bytes((253, 4, 0x86, 0, 4, 0x85, 1, 4, 0x85))
    for k in D.fixes:
        place = (int(D.lat[k] * 2**31 / 180), int(D.lon[k] * 2**31 / 180))
        body += b"\0" + struct.pack("<Iii", 1_141_380_000 + int(D.t[k]), *place)
    (folder / "ride.fit").write_bytes(
        struct.pack("<BBHI4sH", 14, 32, 2132, len(body), b".FIT", 0) + body + b"\0\0"
    )
    return folder / "ride.fit"


def telemetry(folder: Path) -> Path:
    """A .tlog: each message of MAVLink 1 behind the time [us, big-endian]; RAW_IMU and GPS_RAW_INT."""

    def frame(kind: int, seq: int, payload: bytes, extra: int) -> bytes:
        head = struct.pack("<BBBBB", len(payload), seq & 255, 1, 1, kind)
        crc = 0xFFFF
        for byte in head + payload + bytes((extra,)):
            byte ^= crc & 0xFF
            byte ^= byte << 4 & 0xFF
            crc = crc >> 8 ^ byte << 8 ^ byte << 3 ^ byte >> 4
        return b"\xfe" + head + payload + struct.pack("<H", crc & 0xFFFF)

    out = b""
    for k in range(0, len(D.t), 10):
        us = int(D.t[k] * 1e6)
        stamp = struct.pack(">Q", int(D.utc(k).timestamp() * 1e6))
        counts = [*(int(x * 1000 / G) for x in D.force[k]), *(int(x * 1000) for x in D.gyro[k]), 200, 0, 400]
        out += stamp + frame(27, k, struct.pack("<Q9h", us, *counts), 144)
        if k % RATE_HZ == 0:
            place = (int(D.lat[k] * 1e7), int(D.lon[k] * 1e7), int(D.alt[k] * 1000))
            speed = (90, 120, int(D.v[k] * 100), int(math.degrees(D.psi[k]) * 100))
            out += stamp + frame(24, k, struct.pack("<Qiii4HBB", us, *place, *speed, 3, 12), 24)
    (folder / "flight.tlog").write_bytes(out)
    return folder / "flight.tlog"


def blackbox(folder: Path) -> Path:
    head = (
        "H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\nH I interval:32\n"
        "H Field I name:loopIteration,time,gyroADC[0],gyroADC[1],gyroADC[2],accSmooth[0]\n"
        "H Firmware revision:Betaflight 4.4.2 (23d066d08) STM32F7X2\nH acc_1G:2048\n"
    )
    (folder / "btfl_001.bbl").write_bytes(head.encode() + bytes(range(256)) * 8)
    return folder / "btfl_001.bbl"


def matlab73(folder: Path) -> Path:
    """A structure `imu` as save -v7.3 of MATLAB stores it: HDF5 behind 512 bytes of text, transposed."""
    path = folder / "drive.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in (("t", D.t[None]), ("gyro", D.gyro.T), ("acc", D.force.T)):
            file[f"imu/{name}"] = value
            file[f"imu/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
        file["imu"].attrs["MATLAB_class"] = np.bytes_("struct")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Mar  2 10:00:00 2026 HDF5 schema 1.00 ."
    raw = bytearray(path.read_bytes())
    raw[:128] = head.ljust(116, b" ") + bytes(8) + b"\0\2IM"
    path.write_bytes(raw)
    return path


def sbet(folder: Path) -> Path:
    """A drive other than that of the run, as Applanix writes it: 17 doubles a row, seconds of the week."""
    rows = [
        struct.pack(
            "<17d", 122_400 + D.t[k], math.radians(D.lat[k]), math.radians(D.lon[k]), D.alt[k],
            D.v[k] * math.cos(D.psi[k]), D.v[k] * math.sin(D.psi[k]), 0, 0, 0, D.psi[k], 0,
            *D.force[k], *D.gyro[k],
        )
        for k in range(0, len(D.t), 5)
    ]  # fmt: skip
    (folder / "sbet_Mission 1.out").write_bytes(b"".join(rows))
    return folder / "sbet_Mission 1.out"


def kitti_oxts(folder: Path) -> Path:
    """A raw recording of KITTI: a file of 30 numbers for each row, and one for the times."""
    data = folder / "oxts" / "data"
    data.mkdir(parents=True)
    times = []
    for n, k in enumerate(range(0, len(D.t), 5)):
        yaw = math.pi / 2 - D.psi[k]
        vel = (D.v[k] * math.cos(D.psi[k]), D.v[k] * math.sin(D.psi[k]), D.v[k], 0.0, 0.0)
        f = D.force[k] * (1, -1, -1)
        w = D.gyro[k] * (1, -1, -1)
        values = (D.lat[k], D.lon[k], D.alt[k], 0.0, 0.0, yaw, *vel, *f, *f, *w, *w, 0.05, 0.01)
        lines(data / f"{n:010d}.txt", " ".join(f"{x:.12g}" for x in values) + " 4 9 4 4 0")
        times.append(D.utc(k).strftime("%Y-%m-%d %H:%M:%S.%f000"))
    lines(folder / "oxts" / "timestamps.txt", *times)
    return folder / "oxts"


def kitti_row(folder: Path) -> Path:
    return kitti_oxts(folder) / "data" / "0000000000.txt"


def euroc(folder: Path) -> Path:
    axes = "w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],"
    rows = [
        row(1_403_636_579_763_555_584 + int(D.t[k] * 1e9), *map(float, D.gyro[k]), *map(float, D.force[k]))
        for k in range(len(D.t))
    ]
    return lines(folder / "data.csv", f"#timestamp [ns],{axes}a_RS_S_z [m s^-2]", *rows, end="\r\n")


def airdata(folder: Path) -> Path:
    names = (
        "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),"
        "altitude_above_seaLevel(feet),speed(mph),satellites,gpslevel,voltage(v), xSpeed(mph), ySpeed(mph),"
        " zSpeed(mph), compass_heading(degrees), pitch(degrees), roll(degrees),isPhoto,isVideo"
    )
    rows = [
        row(
            int(1000 * D.t[k]), D.utc(k).strftime("%Y-%m-%d %H:%M:%S"), D.lat[k], D.lon[k], 0.0,
            D.alt[k] / 0.3048, D.v[k] / 0.44704, 14, 5, 15.2, D.v[k] * math.cos(D.psi[k]) / 0.44704,
            D.v[k] * math.sin(D.psi[k]) / 0.44704, 0.0, math.degrees(D.psi[k]), 0.0, 0.0, 0, 0,
        )
        for k in range(0, len(D.t), 5)
    ]  # fmt: skip
    return lines(folder / "Mar-2nd-2026-Flight-Airdata.csv", names, *rows)


def dji_flight_record(folder: Path) -> Path:
    names = (
        "CUSTOM.date [local],CUSTOM.updateTime [local],OSD.flyTime,OSD.flyTime [s],OSD.latitude,"
        "OSD.longitude,OSD.height [ft],OSD.altitude [ft],OSD.hSpeed [MPH],OSD.xSpeed [MPH],OSD.ySpeed [MPH],"
        "OSD.zSpeed [MPH],OSD.pitch,OSD.roll,OSD.yaw,OSD.gpsNum,OSD.gpsLevel"
    )
    rows = [
        row(
            "3/2/2026", D.utc(k).strftime("%I:%M:%S.%f %p"), f"0m {D.t[k]:.1f}s", D.t[k], D.lat[k], D.lon[k],
            10.0,
            D.alt[k] / 0.3048, D.v[k] / 0.44704, D.v[k] * math.cos(D.psi[k]) / 0.44704,
            D.v[k] * math.sin(D.psi[k]) / 0.44704, 0.0, 0.0, 0.0, math.degrees(D.psi[k]), 17, 5,
        )
        for k in range(0, len(D.t), 5)
    ]  # fmt: skip
    return lines(folder / "DJIFlightRecord_2026-03-02.csv", "sep=,", names, *rows)


def torque(folder: Path) -> Path:
    """A log of Torque, a phone in a car: accelerometer in g, dates of both clocks, '-' for no value."""
    names = (
        "GPS Time, Device Time, Longitude, Latitude,GPS Speed (Meters/second), Horizontal Dilution of"
        " Precision, Altitude, Bearing, G(x), G(y), G(z), G(calibrated),Engine RPM(rpm),Speed (OBD)(km/h)"
    )
    rows = [
        row(
            D.utc(k).strftime("%a %b %d %H:%M:%S GMT+00:00 %Y"),
            D.utc(k).strftime("%d-%b-%Y %H:%M:%S.%f")[:-3],
            D.lon[k], D.lat[k], D.v[k], 4.0, D.alt[k], math.degrees(D.psi[k]),
            *(float(x) for x in D.force[k] / G), 0.0, "-", 3.6 * D.v[k],
        )
        for k in D.fixes
    ]  # fmt: skip
    return lines(folder / "trackLog-2026-Mar-02.csv", names, *rows)


def vbox(folder: Path) -> Path:
    """A .vbo of Racelogic: minutes of arc, west positive; hhmmss.ss; km/h."""
    head = (
        "File created on 02/03/2026 @ 10:00:00\n\n[header]\nsatellites\ntime\nlatitude\nlongitude\n"
        "velocity kmh\nheading\nheight\n\n[comments]\nVBOX III Version 2.5 build 0062\n\n[column names]\n"
        "sats time lat long velocity heading height\n\n[data]"
    )
    rows = [
        f"012 {D.utc(k):%H%M%S}.{int(D.t[k] * 100) % 100:02d} +{D.lat[k] * 60:010.5f} "
        f"{-D.lon[k] * 60:+011.5f} {3.6 * D.v[k]:07.3f} {np.degrees(D.psi[k]) % 360:06.2f} +{D.alt[k]:08.2f}"
        for k in range(0, len(D.t), 5)
    ]
    return lines(folder / "lap.vbo", head, *rows, end="\r\n")


def sensor_logger(folder: Path) -> Path:
    """The unpacked folder of Sensor Logger, phone flat on the seat, its top forward."""
    ns = [int(D.utc(k).timestamp() * 1e9) for k in range(len(D.t))]
    top = {"x": (1, 1), "y": (0, 1), "z": (2, -1)}  # its x right, y forward, z up
    for name, values in (("Gyroscope", D.gyro), ("TotalAcceleration", D.force)):
        rows = [
            row(ns[k], D.t[k], *(float(values[k, i] * sign) for i, sign in (top["z"], top["y"], top["x"])))
            for k in range(len(D.t))
        ]
        lines(folder / f"{name}.csv", "time,seconds_elapsed,z,y,x", *rows)
    names = (
        "time,seconds_elapsed,bearingAccuracy,speedAccuracy,verticalAccuracy,horizontalAccuracy,speed,bearing"
    )
    rows = [
        row(ns[k], D.t[k], 5, 0.5, 4, 3.5, D.v[k], math.degrees(D.psi[k]), D.alt[k], D.lon[k], D.lat[k])
        for k in D.fixes
    ]
    lines(folder / "Location.csv", f"{names},altitude,longitude,latitude", *rows)
    lines(folder / "Metadata.csv", "version,device name,platform", "1,pixel,android")
    return folder


def xsens_dot(folder: Path) -> Path:
    head = [
        "sep=,",
        "DeviceTag:,D422CD00A1B2",
        "FirmwareVersion:,2.0.0",
        "AppVersion:,2021.0.1",
        "SyncStatus:,Synced",
    ]
    names = "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z,Status"
    flu = (1, -1, -1)
    rows = [
        row(
            k,
            1_000_000 + int(D.t[k] * 1e6),
            *map(float, D.force[k] * flu),
            *map(float, np.degrees(D.gyro[k] * flu)),
            0,
        )
        for k in range(len(D.t))
    ]
    return lines(folder / "D422CD00A1B2_20260302.csv", *head, "", names, *rows)


def vectornav(folder: Path) -> Path:
    def sentence(k: int) -> str:
        values = (math.degrees(D.psi[k]), 0.0, 0.0, 0.2, 0.0, 0.4)
        body = "VNYMR," + ",".join(f"{x:+09.4f}" for x in (*values, *D.force[k], *D.gyro[k]))
        check = 0
        for byte in body.encode():
            check ^= byte
        return f"${body}*{check:02X}"

    return lines(folder / "vn100.txt", *(sentence(k) for k in range(len(D.t))), end="\r\n")


def dataflash_text(folder: Path) -> Path:
    """A .log of ArduPilot, as Mission Planner converts a .bin: FMT lines, then rows."""
    out = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 129, 31, PARM, QNf, TimeUS,Name,Value",
        "FMT, 130, 51, GPS, QBIHBcLLeffffB, TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
        "FMT, 131, 51, IMU, QffffffIIfBBHH, TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz",
        "MSG, 100000, ArduRover V4.2.3 (abcd1234)",
        "PARM, 200000, FORMAT_VERSION, 16",
    ]
    for k in range(len(D.t)):
        us = 1_000_000 + int(D.t[k] * 1e6)
        six = ", ".join(f"{x:.7f}" for x in (*D.gyro[k], *D.force[k]))
        out.append(f"IMU, {us}, {six}, 0, 0, 40, 1, 1, 1000, 1000")
        if k % 10 == 0:
            ms = int(1000 * (122_418 + D.t[k]))
            out.append(
                f"GPS, {us}, 3, {ms}, 2408, 14, 0.8, {D.lat[k]:.7f}, {D.lon[k]:.7f}, {D.alt[k]:.2f}, "
                f"{D.v[k]:.3f}, {math.degrees(D.psi[k]):.3f}, 0, 0, 1"
            )
    return lines(folder / "00000042.log", *out, end="\r\n")


def rostopic(folder: Path) -> Path:
    def message(k: int) -> str:
        w, f = (values[k] * (1, -1, -1) for values in (D.gyro, D.force))
        xyz = [f"  x: {v[0]}\n  y: {v[1]}\n  z: {v[2]}" for v in (w, f)]
        clock = f"    secs: {1772445600 + k // 50}\n    nsecs: {k % 50 * 20_000_000}\n"
        stamp = f"header: \n  seq: {k}\n  stamp: \n{clock}"
        return (
            f'{stamp}  frame_id: "imu_link"\norientation: \n  x: 0.0\n  y: 0.0\n  z: 0.0\n  w: 1.0\n'
            f"angular_velocity: \n{xyz[0]}\nlinear_acceleration: \n{xyz[1]}\n---"
        )

    return lines(folder / "imu_echo.txt", *(message(k) for k in range(200)))


def sbg(folder: Path) -> Path:
    """Tables of sbgBasicLogger: names, then units, separated by tabs; times of the device in us."""
    names = "timestamp\tstatus\taccelX\taccelY\taccelZ\tgyroX\tgyroY\tgyroZ\ttemp"
    units = "(us)\t(na)\t(m.s^-2)\t(m.s^-2)\t(m.s^-2)\t(deg.s^-1)\t(deg.s^-1)\t(deg.s^-1)\t(degC)"
    rows = [
        "\t".join(
            [
                str(int(D.t[k] * 1e6)),
                "0x01FF",
                *(f"{x:.6f}" for x in (*D.force[k], *np.degrees(D.gyro[k]))),
                "31.5",
            ]
        )
        for k in range(len(D.t))
    ]
    return lines(folder / "imuData.txt", names, units, *rows)


def gyroflow(folder: Path) -> Path:
    head = (
        "GYROFLOW IMU LOG\nversion,1.3\nid,custom_logger\norientation,XYZ\nnote,car\ntimestamp,1772445600\n"
        "tscale,0.001\ngscale,0.00122173047\nascale,0.00048828125\nt,gx,gy,gz,ax,ay,az"
    )
    rows = [
        row(k * 20, *(int(x / 0.00122173047) for x in D.gyro[k]), *(int(x / G * 2048) for x in D.force[k]))
        for k in range(len(D.t))
    ]
    return lines(folder / "clip.gcsv", head, *rows)


def ros2_storage(folder: Path) -> Path:
    """The .db3 of a ROS 2 bag, taken out of its folder."""
    with sqlite3.connect(folder / "drive_0.db3") as base:
        base.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB NOT NULL)"
        )
        base.execute("INSERT INTO topics VALUES(1, '/imu', 'sensor_msgs/msg/Imu', 'cdr', '')")
    return folder / "drive_0.db3"


def workbook(folder: Path) -> Path:
    with zipfile.ZipFile(folder / "flight.xlsx", "w") as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("xl/workbook.xml", "<workbook/>")
    return folder / "flight.xlsx"


def timeline(folder: Path) -> Path:
    places = [
        {"latitudeE7": int(D.lat[k] * 1e7), "longitudeE7": int(D.lon[k] * 1e7), "accuracy": 8,
         "timestamp": D.utc(k).isoformat().replace("+00:00", "Z")}
        for k in D.fixes
    ]  # fmt: skip
    (folder / "Records.json").write_text(json.dumps({"locations": places}, indent=2))
    return folder / "Records.json"
