"""NMEA 0183: GGA and RMC sentences of each fix, with checksums.

Fields: NMEA 0183 as GPS receivers print it, version 2.3 on (RMC with its mode indicator).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.core.files import durable
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import GnssFixes
from bench.io.exports.outgoing import Calendar, ExportData, thin

FORMATS = {"nmea": "GGA and RMC sentences of the fixes"}
_KNOT = 1852.0 / 3600.0  # [m/s]
_TRACK_RATE = 10.0  # largest rate of the sentences of a track [Hz]


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write the sentences of the fixes and the requested tracks; return their description for the README."""
    out.select_fixes()
    fixes = out.fixes
    assert fixes is not None  # there are rows
    with durable.open_text(folder / "gnss.nmea", "ascii", "") as file:
        for k in range(len(fixes)):
            file.writelines(make_fix_sentences(out.calendar, fixes, k))
    files = [
        f"- `gnss.nmea`, {len(fixes)} epochs: GGA, then RMC, of every fix at its time of "
        "validity; void if invalid."
    ]
    for name, track in out.tracks.items():
        rows = thin(track.t, _TRACK_RATE)
        with durable.open_text(folder / f"{name}.nmea", "ascii", "") as file:
            for k in rows:
                valid = bool(np.isfinite(track.lla[k]).all())
                file.writelines(
                    make_sentences(out.calendar, track.t[k], track.lla[k], track.vel_n[k], -1, valid=valid)
                )
        files.append(f"- `{name}.nmea`: the same for the IMU, at most {_TRACK_RATE:g} epochs per second.")
    return "\n".join(
        [
            "NMEA 0183, one sentence per line with checksum: GGA (position, quality, satellites, height) "
            "and RMC (position, ground speed, track, date).\n",
            *files,
            "",
            "Height in GGA is above the ellipsoid, with a geoidal separation of 0; the sum of both is the "
            "same as from a receiver. HDOP is empty. These sentences have no fields for vertical speed and "
            "standard deviations. Quality is 1 (autonomous) if valid. Digits: time 1 ms, position 0.2 mm, "
            "height 1 mm, speed 0.5 mm/s, track 0.001 deg.",
        ]
    )


def make_fix_sentences(calendar: Calendar, fixes: GnssFixes, k: int) -> Iterator[str]:
    """Yield the GGA and the RMC sentence of a fix, with their line ends."""
    valid = bool(fixes.valid[k] and np.isfinite(fixes.lla[k]).all())
    yield from make_sentences(
        calendar, fixes.t[k], fixes.lla[k], fixes.vel_n[k], int(fixes.satellites[k]), valid=valid
    )


def make_sentences(
    calendar: Calendar,
    t: float,
    lla: FloatArray,
    vel_n: FloatArray,
    satellites: int,
    *,
    valid: bool,
) -> Iterator[str]:
    """Yield the GGA and the RMC sentence at time t [s], for lla [rad, rad, m] and vel_n [m/s].

    A negative number of satellites means not known; the field is left empty.
    """
    when = calendar.at(t)
    clock, day = f"{when:%H%M%S}.{when.microsecond // 1000:03d}", f"{when:%d%m%y}"
    if not valid:
        yield make_sentence(f"GPGGA,{clock},,,,,0,{_format_count(satellites)},,,M,,M,,")
        yield make_sentence(f"GPRMC,{clock},V,,,,,,,{day},,,N")
        return
    north, east = "NS"[int(lla[0] < 0)], "EW"[int(lla[1] < 0)]
    place = f"{_format_angle(lla[0], 2)},{north},{_format_angle(lla[1], 3)},{east}"
    yield make_sentence(f"GPGGA,{clock},{place},1,{_format_count(satellites)},,{lla[2]:.3f},M,0.0,M,,")
    motion = ","
    if np.isfinite(vel_n).all():
        course = round(math.degrees(math.atan2(vel_n[1], vel_n[0])) % 360.0, 3) % 360.0
        motion = f"{math.hypot(vel_n[0], vel_n[1]) / _KNOT:.3f},{course:.3f}"
    yield make_sentence(f"GPRMC,{clock},A,{place},{motion},{day},,,A")


def make_sentence(body: str) -> str:
    """Return a sentence with its start, its checksum (exclusive or of the characters) and its line end.

    Examples
    --------
    >>> make_sentence("GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,")[-5:]
    '*47\\r\\n'
    """
    check = 0
    for character in body.encode("ascii"):
        check ^= character
    return f"${body}*{check:02X}\r\n"


def _format_count(satellites: int) -> str:
    return "" if satellites < 0 else f"{min(satellites, 99):02d}"


def _format_angle(angle: float, digits: int) -> str:
    """Return the absolute value of an angle [rad] as ddmm.mmmmmmm: degrees, minutes to 1e-7."""
    ten_millionths = round(abs(math.degrees(angle)) * 60e7)
    degrees, rest = divmod(ten_millionths, 60 * 10**7)
    minutes, decimals = divmod(rest, 10**7)
    return f"{degrees:0{digits}d}{minutes:02d}.{decimals:07d}"
