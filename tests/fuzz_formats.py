"""Files of receivers, tracks, terrain and autopilots to damage: small whole ones, packed in every way."""

from __future__ import annotations

import contextlib
import gzip
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.core.words.exceptions import ConfigError
from bench.io.logs import formats
from bench.io.logs.mat_files.mat_file import read_mat
from bench.io.trajectories.track_files import read_track
from bench.plugins.receiver.receiver_streams import sbf_fixes
from bench.plugins.receiver.receiver_streams.rtcm import read_rtcm
from bench.plugins.receiver.receiver_streams.sbf import read_sbf, read_sbf_navigation
from bench.plugins.receiver.receiver_streams.ubx import read_ubx
from bench.plugins.receiver.rinex.lines import find_kind
from bench.plugins.receiver.rinex.observations import read_observations
from bench.plugins.receiver.rinex.precise_orbits import make_tables, read_precise_orbits
from bench.simulation.signals.terrain import describe_terrain
from tests.data import gnss_file, stored_gnss_file
from tests.exchange.matlab_hdf5 import write_hdf5
from tests.plugins.autopilots.telemetry_writer import write_telemetry
from tests.plugins.receiver.packed import compress

TRACKS = Path(__file__).parent / "exchange" / "tracks"
FLIGHTS = Path(__file__).parent / "logs" / "flights"


class Format(NamedTuple):
    """Name and content of a whole file, and what reads it; text is damaged by tokens and lines too."""

    name: str
    make: Callable[[], bytes]
    read: Callable[[Path], object]
    text: bool


def _cut(path: Path, lines: int) -> bytes:
    return b"".join(path.read_bytes().splitlines(keepends=True)[:lines])


def _make_kml() -> bytes:
    times = "".join(f"<when>2026-01-01T00:00:{k:02d}Z</when>" for k in range(20))
    places = "".join(f"<gx:coord>{11 + k * 1e-4} {47 + k * 1e-5} {600 + k}</gx:coord>" for k in range(20))
    space = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
    track = f"<Placemark><gx:Track>{times}{places}</gx:Track></Placemark>"
    return f'<?xml version="1.0"?><kml {space}><Document>{track}</Document></kml>'.encode()


def _make_gpx() -> bytes:
    points = "".join(
        f'<trkpt lat="{47 + k * 1e-5}" lon="{11 + k * 2e-5}"><ele>{500 + 0.1 * k}</ele>'
        f"<time>2026-01-01T00:00:{k:02d}Z</time></trkpt>"
        for k in range(20)
    )
    return f'<?xml version="1.0"?><gpx><trk><trkseg>{points}</trkseg></trk></gpx>'.encode()


def _make_grid() -> bytes:
    head = "ncols 9\nnrows 7\nxllcorner 11.0\nyllcorner 47.0\ncellsize 0.001\nNODATA_value -9999\n"
    return (head + "\n".join(" ".join(str(500 + k + j) for j in range(9)) for k in range(7))).encode()


def _cut_crinex() -> bytes:
    whole = stored_gnss_file("KMS300DNK_R_20221591000_01H_30S_MO.crx").read_bytes().splitlines(keepends=True)
    return b"".join(whole[:200])


def _cut_ubx() -> bytes:
    return gzip.decompress(stored_gnss_file("F9T-L2-2min.ubx.gz").read_bytes())[:12_000]


def _cut_rtcm() -> bytes:
    return gnss_file("walk-2025-08-28.rtcm3").read_bytes()


def _cut_sbf() -> bytes:
    return gnss_file("mosaic-x5.sbf").read_bytes() + gnss_file("walk-2025-08-28.sbf").read_bytes()


def _cut_novatel() -> bytes:
    return gnss_file("novatel-rawimusx.gps").read_bytes()


def _cut_sp3() -> bytes:
    packed = stored_gnss_file("COD0IGSRAP_20210780000_15M_ORB.SP3.gz").read_bytes()
    lines = gzip.decompress(packed).splitlines(keepends=True)
    epochs = [k for k, line in enumerate(lines) if line.startswith(b"*")]
    return b"".join([*lines[: epochs[2]], b"EOF\n"])


def _cut_rinex() -> bytes:
    packed = stored_gnss_file("07590920.05o.gz").read_bytes()
    return b"".join(gzip.decompress(packed).splitlines(keepends=True)[: 17 + 3 * 9])


def _read_observations(path: Path) -> object:
    return find_kind(path, path.name), read_observations(path, phase=True)


def _read_orbits(path: Path) -> object:
    return make_tables([read_precise_orbits(path)])


def _read_sbf(path: Path) -> object:
    for read in (read_sbf_navigation, lambda p: sbf_fixes.read("sbf", p, "gnss", None)):
        with contextlib.suppress(ConfigError):
            read(path)
    return read_sbf(path)


def _read_terrain(path: Path) -> object:
    return describe_terrain(path, path.name, 0.0, None)


def _read_flight(form: str) -> Callable[[Path], object]:
    return lambda path: [formats.read(form, path, kind, None) for kind in ("imu", "gnss", "baro")]


def _cut_flash() -> bytes:
    return (FLIGHTS / "copter.bin").read_bytes()[:50_000]


def _write_telemetry() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return write_telemetry(Path(folder) / "a.tlog", count=60).read_bytes()


def _write_hdf5() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path, t = Path(folder) / "a.mat", np.arange(300.0)
        write_hdf5(path, {"imu": {"t": t, "wb": np.column_stack([t, t, t]), "name": "a"}, "x": np.float32(t)})
        return path.read_bytes()


READERS: dict[str, Format] = {
    "track-igc": Format("a.igc", lambda: _cut(TRACKS / "glider.igc", 60), read_track, True),
    "track-gpx": Format("a.gpx", _make_gpx, read_track, True),
    "track-kml": Format("a.kml", _make_kml, read_track, True),
    "track-nmea": Format("a.nmea", lambda: _cut(TRACKS / "car.nmea", 100), read_track, True),
    "terrain-asc": Format("a.asc", _make_grid, _read_terrain, True),
    "terrain-hgt": Format(
        "N47E011.hgt", lambda: np.full(1201**2, 500, ">i2").tobytes(), _read_terrain, False
    ),
    "rinex-gz": Format("a.05o.gz", lambda: gzip.compress(_cut_rinex(), mtime=0), _read_observations, False),
    "rinex-z": Format("a.05o.Z", lambda: compress(_cut_rinex()), _read_observations, False),
    "crinex": Format("a.crx", _cut_crinex, _read_observations, True),
    "ubx": Format("a.ubx", _cut_ubx, read_ubx, False),
    "sbf": Format("a.sbf", _cut_sbf, _read_sbf, False),
    "rtcm": Format("a.rtcm3", _cut_rtcm, read_rtcm, False),
    "novatel": Format(
        "a.gps", _cut_novatel, lambda path: formats.read("novatel", path, "imu", "EPSON-G320"), False
    ),
    "sp3": Format("a.sp3", _cut_sp3, _read_orbits, True),
    "dataflash": Format("a.bin", _cut_flash, _read_flight("dataflash"), False),
    "tlog": Format("a.tlog", _write_telemetry, _read_flight("tlog"), False),
    "matlab-7.3": Format("a.mat", _write_hdf5, read_mat, False),
    "px4log": Format(
        "a.px4log", lambda: (FLIGHTS / "quad.px4log").read_bytes()[:50_000], _read_flight("dataflash"), False
    ),
}
"""Format -> its file and reader."""
