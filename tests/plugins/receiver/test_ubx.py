"""Raw measurements of a u-blox receiver: the values that pyubx2 reads, and ranges smoothed with the phase."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams.ubx import read_ubx
from bench.plugins.receiver.rinex.lines import find_kind
from bench.simulation.signals import orbits, smoothing
from tests.data import stored_gnss_file

F9T = stored_gnss_file("F9T-L2-2min.ubx.gz")


def test_rawx_has_the_values_that_pyubx2_reads():
    """Of the first epoch, G01 with pyubx2 1.4."""
    raw = read_ubx(F9T)
    assert len(raw.t) == 120
    assert raw.origin + raw.t[0] == pytest.approx(2379 * 604800 + 163891.001, abs=1e-6)
    first = np.flatnonzero((raw.system == GPS) & (raw.sat == 1))[0]
    assert raw.pseudorange[first, 0] == pytest.approx(21360867.69643313, abs=1e-8)
    assert raw.phase[first, 0] == pytest.approx(112252116.07057768, abs=1e-7)
    assert raw.doppler[first, 0] == pytest.approx(804.3385620117188, abs=1e-9)
    assert raw.cn0[first, 0] == 47.0
    assert raw.band[first].tolist() == [1, 2]
    assert set(np.unique(raw.system).tolist()) == {GPS, GALILEO, BEIDOU}
    assert raw.others.keys() == {"SBAS"}
    assert raw.lost == 0


def write_rawx(path, *messages, weeks=()):
    """Write messages of rows (system, satellite, signal, range [m], lock [ms]), a second apart."""
    content = b""
    for k, rows in enumerate(messages):
        week = weeks[k] if weeks else 2379
        body = struct.pack("<dHbBB3x", 1000.0 + k, week, 18, len(rows), 0)
        for system, sat, signal, distance, lock in rows:
            body += struct.pack(
                "<ddf4BH6B", distance, 1e8, 9.0, system, sat, signal, 7, lock, 40, 0, 0, 0, 3, 0
            )
        body = b"\x02\x15" + struct.pack("<H", len(body)) + body
        a = b = 0
        for byte in body:  # 8-bit Fletcher, u-blox interface description
            a = (a + byte) % 256
            b = (a + b) % 256
        content += b"\xb5\x62" + body + bytes((a, b))
    path.write_bytes(content)
    return read_ubx(path)


def test_signals_have_their_carrier_and_cycles_counted_anew_are_told(tmp_path):
    """E5b is the second carrier with the digit 7; of two signals of a carrier the first counts."""
    first = [(0, 5, 0, 2.1e7, 900), (0, 5, 3, 2.2e7, 1), (0, 5, 4, 2.3e7, 900)]  # L1 C/A, L2 CL, L2 CM
    first += [(2, 8, 0, 2.4e7, 0), (2, 8, 6, 2.5e7, 900), (6, 255, 0, 2.6e7, 900), (6, 254, 0, 2.7e7, 900)]
    raw = write_rawx(tmp_path / "a.ubx", first, [(0, 5, 0, 2.1e7, 899), (2, 8, 0, 2.4e7, 1000)])
    assert raw.system.tolist() == [GPS, GALILEO, GLONASS, GPS, GALILEO]  # a GLONASS without a slot is 255
    assert raw.sat.tolist() == [5, 8, 254, 5, 8]
    assert raw.band.tolist() == [[1, 2], [1, 7], [1, 0], [1, 0], [1, 0]]
    assert_allclose(raw.pseudorange[:2], [[2.1e7, 2.2e7], [2.4e7, 2.5e7]])
    assert raw.slipped.tolist() == [[False] * 2, [True, False], [False] * 2, [True, False], [False] * 2]
    assert (raw.origin + raw.t).tolist() == [2379 * 604800 + 1000.0, 2379 * 604800 + 1001.0]


def test_epochs_before_the_receiver_has_the_time_are_left_out(tmp_path):
    row = [(0, 5, 0, 2.1e7, 900)]
    raw = write_rawx(tmp_path / "cold.ubx", row, row, row, weeks=(0, 0, 2379))
    assert raw.origin + raw.t == pytest.approx([2379 * 604800 + 1002.0])
    assert raw.lost == 2
    assert raw.reasons[0].endswith("2 epochs before the receiver set its clock")
    with pytest.raises(ConfigError, match=r"cold\.ubx: 1 epochs before the receiver set its clock"):
        write_rawx(tmp_path / "cold.ubx", row, weeks=(0,))


def test_damaged_messages_are_left_out(tmp_path):
    content = bytearray(gzip.decompress(F9T.read_bytes()))
    places = [k for k in range(len(content)) if content[k : k + 4] == b"\xb5\x62\x02\x15"]
    content[places[3] + 40] ^= 1  # a wrong checksum
    path = tmp_path / "a.ubx"
    path.write_bytes(content[: places[110] + 100])
    raw = read_ubx(path)
    assert len(raw.t) == 109
    assert raw.lost == 2
    (tmp_path / "b.ubx").write_bytes(b"\xb5\x62\x01\x07" + bytes(100))
    with pytest.raises(ConfigError, match=r"b\.ubx: has no raw measurements"):
        read_ubx(tmp_path / "b.ubx")


def test_ubx_behind_the_messages_of_the_program_that_recorded_it(tmp_path):
    """As gpsd writes it; a RINEX comment with the same two characters is RINEX."""
    path = tmp_path / "gpsd.log"
    path.write_bytes(b'{"class":"VERSION","release":"3.26.2"}\n' * 20 + gzip.decompress(F9T.read_bytes()))
    assert find_kind(path, "gpsd.log") == "ubx"
    assert len(read_ubx(path).t) == 120
    first = f"{'     3.04           OBSERVATION DATA    M':60}RINEX VERSION / TYPE\n"
    path.write_bytes((first + f"{chr(0xB5)}b{'':58}COMMENT\n").encode("latin-1"))
    assert find_kind(path, "site.rnx") == "observations"


def test_fixes_names_what_is_missing_beside_ubx(capsys):
    assert main(["fixes", str(F9T)]) == 2
    said = capsys.readouterr().err
    assert "has no whole ephemeris (UBX-RXM-SFRBX) in it; give the navigation file of the day, too" in said


def rows_of(raw):
    satellite, t = 1000 * raw.system + raw.sat, np.repeat(raw.t, np.diff(raw.epoch_start))
    frequency = orbits.find_frequency(raw.system, raw.band[:, 0], np.zeros_like(raw.sat))
    return satellite, t, frequency


def test_real_ranges_are_smoothed_without_moving():
    """Code against phase at 1 Hz: steps between seconds fall to less than a tenth; the mean stays."""
    raw = read_ubx(F9T)
    satellite, t, frequency = rows_of(raw)
    found = smoothing.smooth_ranges(
        t, satellite, raw.pseudorange[:, 0], raw.phase[:, 0], raw.doppler[:, 0], raw.slipped[:, 0], frequency,
        100.0,
    )  # fmt: skip
    carrier = orbits.C / frequency * raw.phase[:, 0]
    sound = [
        k for one in np.unique(satellite) if found.begun[k := satellite == one].sum() == 1 and k.sum() == 120
    ]
    assert len(sound) >= 15
    for rows in sound:
        before, after = raw.pseudorange[rows, 0] - carrier[rows], found.pseudorange[rows] - carrier[rows]
        assert np.std(np.diff(after)[60:]) < 0.1 * np.std(np.diff(before)[60:])
        assert abs(after[-1] - before.mean()) < 0.3
        assert found.noise[rows][-1] == pytest.approx(np.sqrt(1 / 100), rel=0.1)


def test_the_noise_is_that_of_the_filter_and_slips_begin_an_arc_anew():
    """Monte Carlo of 400 satellites: sd over time within 99.9 %; slips of 3 cycles, gaps and lost locks."""
    draw, n, window = np.random.default_rng(4), 60, 20.0
    satellites = 400
    t = np.repeat(np.arange(float(n)), satellites)
    which = np.tile(np.arange(satellites), n)
    frequency = np.full(len(t), orbits.L1)
    wave = orbits.C / orbits.L1
    distance = 2e7 + 500.0 * t + 0.05 * t**2
    rate = 500.0 + 0.1 * t
    phase = distance / wave + 1234.0 * which
    noisy = distance + draw.standard_normal(len(t))

    def smooth(phase, slipped=None, doppler=-rate / wave):
        none = np.zeros(len(t), bool) if slipped is None else slipped
        return smoothing.smooth_ranges(t, which, noisy, phase, doppler, none, frequency, window)

    found = smooth(phase)
    error = (found.pseudorange - distance).reshape(n, satellites)
    assert found.begun.sum() == satellites
    for k in (0, 4, 19, 59):
        expected = found.noise.reshape(n, satellites)[k, 0]
        assert abs(error[k].std() / expected - 1) < 3.29 / np.sqrt(2 * satellites)
    assert found.noise.reshape(n, satellites)[19, 0] == pytest.approx(np.sqrt(1 / 20))
    assert found.noise.reshape(n, satellites)[59, 0] == pytest.approx(np.sqrt(1 / 39), rel=0.02)
    slip = np.where(t >= 30, phase + 5.0, phase)
    assert found.begun.reshape(n, satellites)[1:].sum() == 0
    again = smooth(slip)
    assert again.begun.reshape(n, satellites)[30].all()
    assert abs((again.pseudorange - distance).reshape(n, satellites)[35].mean()) < 3.29 / np.sqrt(
        6 * satellites
    )
    told = smooth(phase, slipped=t == 40)
    assert told.begun.reshape(n, satellites)[40].all()
    lost = smooth(np.where((t > 10) & (t < 16), np.nan, phase))
    assert lost.begun.reshape(n, satellites)[11:17].all()
    assert not lost.begun.reshape(n, satellites)[17:].any()
    assert_allclose(lost.noise.reshape(n, satellites)[12], 1.0)
