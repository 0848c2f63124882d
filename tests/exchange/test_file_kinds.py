"""A file that cannot be read is named for what it is, with what its owner can do; others are left alone."""

from __future__ import annotations

import gzip
import struct
import zipfile

import numpy as np
import pytest

from bench.cli.command_line import main
from bench.io.log_formats import guess_format
from bench.io.logs.file_kinds import HEAD, KINDS, recognize

RNG = np.random.default_rng(59)


def rtcm(length: int) -> bytes:
    """A message of RTCM 3: preamble, length, content, check sum."""
    return b"\xd3" + length.to_bytes(2, "big") + RNG.bytes(length) + b"\x01\x02\x03"


def sbet(*rows: tuple[float, ...]) -> bytes:
    return b"".join(struct.pack("<17d", *row, *[0.1] * (17 - len(row))) for row in rows)


FRAME = (1_700_000_000_000_000).to_bytes(8, "big") + b"\xfd" + bytes(30)
HEADS = {
    "gzip": gzip.compress(b"t_s\n0\n"),
    "PDF": b"%PDF-1.7\n",
    "picture": b"\x89PNG\r\n\x1a\n",
    "HDF5": b"\x89HDF\r\n\x1a\n",
    "FIT": b"\x0e\x10\xd9\x07\x00\x00\x00\x00.FIT" + bytes(40),
    "telemetry": FRAME + FRAME,
    "blackbox": b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n",
    "UBX": b"\xb5\x62\x02\x15\x10\x00" + bytes(30),
    "SBF": b"$@" + bytes(30),
    "NovAtel binary": b"\xaa\x44\x12\x1c" + bytes(30),
    "Unicore": b"\xaa\x44\xb5" + bytes(30),
    "NovAtel ASCII": b"#BESTPOSA,COM1,0,55.0,FINESTEERING,2000,1.0\n",
    "RTCM": b"\x00\x00" + rtcm(200) + rtcm(80),
    "GnssLogger": b"# \n# Version: v3.0\n# Raw,utcTimeMillis,TimeNanos\n",
    "RINEX": b"     3.04           OBSERVATION DATA    M".ljust(60) + b"RINEX VERSION / TYPE\n",
    "NMEA": b"$GNGGA,101010.00,4700.0,N,01100.0,E,1,12,0.8,500,M,48,M,,*5A\n",
    "GPX": b'<?xml version="1.0"?>\n<gpx version="1.1">\n',
    "SBET": sbet((345600.0, 0.8, 0.2, 500.0), (345600.005, 0.8, 0.2, 500.0)),
}


@pytest.mark.parametrize("name", HEADS)
def test_a_kind_is_recognized_by_its_first_bytes(name, tmp_path, capsys):
    kind = recognize(HEADS[name])
    assert kind is not None
    assert name in kind.name
    path = tmp_path / "brought.dat"
    path.write_bytes(HEADS[name])
    assert main(["navigate", str(path)]) == 2
    err = capsys.readouterr().err
    if guess_format(path) is None:
        assert err == f"error: brought.dat: is {kind.name}; {kind.advice}\n"
    else:  # it is read
        assert err.startswith("error: brought.dat: no ")


def test_an_archive_is_named(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("imu.csv", "t_s\n")
    kind = recognize((tmp_path / "a.zip").read_bytes())
    assert kind is not None
    assert kind.name == "a ZIP archive"


@pytest.mark.parametrize("name", ["NovAtel binary", "Unicore", "telemetry", "SBET"])
def test_a_receiver_file_of_another_format_is_named_by_fixes(name, tmp_path, capsys):
    path = tmp_path / "station.dat"
    path.write_bytes(HEADS[name] + RNG.bytes(60_000) + b"\xb5b")
    assert main(["fixes", str(path)]) == 2
    assert f"station.dat: is {recognize(HEADS[name]).name};" in capsys.readouterr().err


def test_tables_texts_and_noise_are_of_no_kind():
    texts = (b"t_s,gyro_x_rad_s\n0,1\n", b"", b"title = 'a'\n[imu]\n", b"%RAW data of my logger\n1 2 3\n")
    for head in texts:
        assert recognize(head) is None
    found = [recognize(RNG.bytes(HEAD)) for _ in range(3000)]
    # two bytes at the start (gzip, SBF), or UBX with one of 7 classes at one of 200 places: 0.35 by chance
    assert sum(one is not None for one in found) <= 4  # 99.9 % of Poisson


def test_an_sbet_has_times_that_increase_and_places_on_earth():
    assert recognize(sbet((345600.0, 0.8, 0.2, 500.0), (345599.0, 0.8, 0.2, 500.0))) is None
    assert recognize(sbet((345600.0, 1.8, 0.2, 500.0), (345600.1, 1.8, 0.2, 500.0))) is None
    assert recognize(sbet((345600.0, 0.8, 0.2, 500.0))) is None


def test_each_kind_has_a_name_with_its_article_and_advice():
    for kind, _ in KINDS:
        assert kind.name.startswith(("a ", "an "))
        assert kind.advice
