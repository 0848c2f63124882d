"""RTCM 3 messages written bit by bit: what their fields mean, and what stands for none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.records.orbit_sets import GLONASS, GPS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams.rtcm import read_rtcm
from bench.plugins.receiver.receiver_streams.rtcm_ephemerides import read_messages, read_rtcm_navigation
from bench.simulation.signals.gps_time import gps_seconds
from tests.data import gnss_file

C = 299_792_458.0
L1, L2 = C / 1575.42e6, C / 1227.6e6  # [m]
NEAR = gps_seconds(2022, 1, 5)
SECOND = 259_200  # of that week: Wednesday


def frame(*fields):
    """A message of numbers with so many bits each, with its CRC-24Q."""
    text = "".join(f"{value & (1 << bits) - 1:0{bits}b}" for value, bits in fields)
    payload = int(text.ljust(-(-len(text) // 8) * 8, "0"), 2).to_bytes(-(-len(text) // 8), "big")
    whole = b"\xd3" + len(payload).to_bytes(2, "big") + payload
    crc = 0
    for byte in whole:
        crc ^= byte << 16
        for _ in range(8):
            crc = crc << 1 ^ (0x1864CFB if crc & 0x800000 else 0)
    return whole + crc.to_bytes(3, "big")


def satellite(sat=3, phase=0, lock=9, cn0=180, code=-50, phase_2=0, lock_2=9, cn0_2=160):
    """The 125 bits of a satellite in 1004: 20 000 km, of which 66 light milliseconds are whole."""
    first = [(sat, 6), (0, 1), (10_000_000, 24), (phase, 20), (lock, 7), (66, 8), (cn0, 8)]
    return [*first, (0, 2), (code, 14), (phase_2, 20), (lock_2, 7), (cn0_2, 8)]


def legacy(second, *satellites, station=1):
    head = [(1004, 12), (station, 12), (round(1000 * second), 30), (0, 1), (len(satellites), 5), (0, 4)]
    return frame(*head, *(field for one in satellites for field in one))


def place(x, y, z, station=1):
    return frame((1005, 12), (station, 12), (0, 10), (x, 38), (0, 2), (y, 38), (0, 2), (z, 38))


def msm(number, second, sats, signals, cells, station=1):
    """A message of so many satellites and signals; ``sats`` with their values, ``cells`` row by row."""
    head = [(number, 12), (station, 12), (second, 30), (0, 19)]
    rows = [sats[key] for key in sorted(sats)]
    mask = [(sum(1 << 64 - sat for sat in sats), 64), (sum(1 << 32 - one for one in signals), 32)]
    mask.append((int("".join(str(int(cell is not None)) for cell in cells), 2), len(cells)))
    of_sat = {4: (8, 10), 5: (8, 4, 10, 14), 6: (8, 10), 7: (8, 4, 10, 14)}[number % 10]
    of_cell = {
        4: (15, 22, 4, 1, 6),
        5: (15, 22, 4, 1, 6, 15),
        6: (20, 24, 10, 1, 10),
        7: (20, 24, 10, 1, 10, 15),
    }
    widths = of_cell[number % 10]
    body = [(row[k], bits) for k, bits in enumerate(of_sat) for row in rows]
    body += [(cell[k], bits) for k, bits in enumerate(widths) for cell in cells if cell is not None]
    return frame(*head, *mask, *body)


def read(path, *messages):
    path.write_bytes(b"".join(messages))
    return read_rtcm(path, near=NEAR)


def test_a_shorter_time_of_lock_is_a_slip(tmp_path):
    locks = [5, 5, 7, 6, 0, 0]
    raw = read(
        tmp_path / "a.rtcm3", *(legacy(SECOND + k, satellite(lock=one)) for k, one in enumerate(locks))
    )
    assert raw.slipped[:, 0].tolist() == [False, False, False, True, True, True]
    assert not raw.slipped[:, 1].any()
    assert_allclose(raw.t, np.arange(6.0))
    assert raw.origin == NEAR


def test_a_phase_that_begins_anew_by_1500_cycles_goes_on(tmp_path):
    """A phase range has 20 bits of 0.5 mm, so that the encoder takes 1500 cycles away (DF012, DF018)."""
    away = np.array([250.0, 255.0, 262.0, 255.0])
    sent = [away - 1500.0 * length * (away > 252.0) for length in (L1, L2)]
    pairs = np.round(np.array(sent).T / 0.0005).astype(int).tolist()
    raw = read(
        tmp_path / "a.rtcm3",
        *(legacy(SECOND + k, satellite(phase=a, phase_2=b)) for k, (a, b) in enumerate(pairs)),
    )
    for carrier, length in enumerate((L1, L2)):
        assert_allclose(np.diff(raw.phase[:, carrier]) * length, np.diff(away), atol=2e-3)


def test_values_of_legacy_messages_that_stand_for_none(tmp_path):
    """DF011 and DF014 in 0.02 m and milliseconds; DF017 -163.84 m, DF018 -262.144 m, C/N0 0."""
    no_code, no_phase = satellite(code=-8192), satellite(4, phase=-(2**19), phase_2=-(2**19), cn0=0, cn0_2=0)
    raw = read(
        tmp_path / "a.rtcm3", legacy(SECOND, no_code, no_phase, satellite(40), satellite(5, code=8191))
    )
    assert raw.sat.tolist() == [3, 4, 5]
    assert raw.others == {"SBAS": 1}
    first = 200_000.0 + 66e-3 * C
    assert_allclose(raw.pseudorange, [[first, np.nan], [first, first - 1.0], [first, first + 163.82]])
    assert raw.band.tolist() == [[1, 0], [1, 2], [1, 2]]
    assert np.isnan(raw.phase).tolist() == [[False, True], [True, True], [False, False]]
    assert_allclose(raw.cn0, [[45.0, np.nan], [np.nan, np.nan], [45.0, 40.0]])


def test_the_first_station_is_read_and_its_place_if_it_is_on_the_earth(tmp_path):
    here = (6_378_000_0000, 0, 1_000_0000)
    messages = [place(0, 0, 0), legacy(SECOND, satellite()), legacy(SECOND, satellite(9), station=2)]
    messages += [place(*here[::-1], station=2), place(*here), place(0, -63_780_000_000, 0)]
    raw = read(tmp_path / "a.rtcm3", *messages)
    assert raw.sat.tolist() == [3]
    assert_allclose(raw.approximate_e, np.array(here) * 1e-4)
    assert [text.partition(": ")[2] for text in raw.reasons] == ["2 messages of other stations than 1"]


def test_epochs_are_by_their_times_and_one_before_others_is_left_out(tmp_path):
    times = [0.0, 0.2, 0.2, 0.4, 0.2, 0.6]
    sats = [3, 3, 4, 3, 5, 3]
    raw = read(
        tmp_path / "a.rtcm3",
        *(legacy(SECOND + t, satellite(sat)) for t, sat in zip(times, sats, strict=True)),
    )
    assert_allclose(raw.t, [0.0, 0.2, 0.4, 0.6], atol=1e-6)
    assert raw.sat.tolist() == [3, 3, 4, 3, 3]
    assert [text.partition(": ")[2] for text in raw.reasons] == ["1 messages out of order in time"]


def cell(code=0, phase=0, lock=9, half=0, cn0=700, rate=0):
    return code, phase, lock, half, cn0, rate


SAT = (70, 0, 512, 100)  # 70.5 ms, 100 m/s


def test_signals_of_an_msm_are_taken_in_their_order_of_preference(tmp_path):
    """1C before 1W before 1P, 2W before 2C; codes of another band are passed over."""
    signals = [2, 3, 4, 8, 10, 22]  # 1C, 1P, 1W, 2C, 2W, 5I
    codes = [cell(code=k << 10) for k in range(6)]
    cells = [*codes, None, *codes[1:]]
    raw = read(tmp_path / "a.rtcm3", msm(1077, 1000 * SECOND, {3: SAT, 4: SAT}, signals, cells))
    off = (raw.pseudorange - 70.5e-3 * C) / (1e-3 * C * 2.0**-19)
    assert_allclose(off, [[0.0, 4.0], [2.0, 4.0]], atol=1e-3)
    assert_allclose(raw.doppler[:, 0], -100.0 / L1, rtol=1e-12)
    assert_allclose(raw.cn0, 700 / 16.0)


def test_values_of_an_msm_that_stand_for_none_and_half_cycles(tmp_path):
    """255 ms, the least fine range, phase and rate; 254 ms is a range. A half cycle counts as a slip."""
    sats = {**dict.fromkeys(range(1, 8), SAT), 2: (255, *SAT[1:]), 3: (254, *SAT[1:])}
    sats[4] = (70, 0, 512, -(2**13))
    cells = [cell(half=1), cell(), cell(), cell(), cell(code=-(2**19)), cell(phase=-(2**23))]
    cells.append(cell(rate=-(2**14)))
    raw = read(tmp_path / "a.rtcm3", msm(1077, 1000 * SECOND, sats, [2], cells))
    assert raw.sat.tolist() == [1, 3, 4, 6, 7]
    assert_allclose(raw.pseudorange[1, 0], 254.5e-3 * C)
    assert raw.slipped[:, 0].tolist() == [True, False, False, False, False]
    assert np.isnan(raw.doppler[:, 0]).tolist() == [False, False, True, False, True]
    assert np.isnan(raw.phase[:, 0]).tolist() == [False, False, False, True, False]


def test_channels_of_glonass_are_in_the_message_or_unknown(tmp_path):
    """0 to 13 are channels -7 to 6; the time is that of the day in Moscow, 18 s before GPS time."""
    sats = {k: (70, extended, 512, 100) for k, extended in enumerate((0, 13, 14, 15), 1)}
    ours = msm(1087, 1000 * (3 * 3600 - 18), sats, [2], [cell()] * 4)
    raw = read(tmp_path / "a.rtcm3", legacy(SECOND, satellite()), ours)
    assert_allclose(raw.t, [0.0])
    rows = raw.system == GLONASS
    channel = np.array([-7.0, 6.0])
    assert_allclose(raw.phase[rows, 0][:2], 70.5e-3 * (1602e6 + channel * 562.5e3))
    assert np.isnan(raw.phase[rows, 0][2:]).all()
    assert np.isfinite(raw.pseudorange[rows, 0]).all()


def test_an_msm4_has_steps_of_a_decibel(tmp_path):
    raw = read(tmp_path / "a.rtcm3", msm(1074, 1000 * SECOND, {3: (70, 512)}, [2], [(1 << 12, 0, 9, 0, 45)]))
    assert_allclose(raw.cn0[0, 0], 45.0)
    assert_allclose(raw.pseudorange[0, 0], (70.5 + 2.0**-12) * 1e-3 * C)
    assert np.isnan(raw.doppler[0, 0])
    assert raw.system.tolist() == [GPS]


def test_what_is_no_msm_with_ranges_is_left_out(tmp_path):
    """More than 64 cells are against the standard; other systems are counted."""
    sats = dict.fromkeys(range(1, 34), (70, 512))
    many = msm(1074, 1000 * SECOND, sats, [2, 3], [(0, 0, 9, 0, 45), *[None] * 65])
    others = [msm(number, 1000 * SECOND, {3: SAT}, [2], [cell()]) for number in (1107, 1117, 1137)]
    raw = read(tmp_path / "a.rtcm3", legacy(SECOND, satellite()), many, *others)
    assert raw.sat.tolist() == [3]
    assert raw.lost == 1
    assert raw.others == {"SBAS": 1, "QZSS": 1, "NavIC": 1}
    code = frame((1078, 12), (1, 12), (1000 * SECOND, 30), *[(0, 32)] * 8)
    with pytest.raises(ConfigError, match=r"a\.rtcm3: has no ranges"):
        read(tmp_path / "a.rtcm3", code)


def with_bits(text, at, value, count):
    return f"{text[:at]}{value:0{count}b}{text[at + count :]}"


@pytest.mark.parametrize(("number", "at", "end"), [(1045, 486, 496), (1046, 499, 504)])
@pytest.mark.parametrize("health", range(8))
def test_health_and_accuracy_of_galileo(tmp_path, number, at, end, health):
    """Two bits of the signal and one of the data; E1 of 1046 behind three of E5b. SISA 107 is 3.12 m."""
    name = "opec-2022-01-01.rtcm3"
    frames = []
    for found, payload in read_messages(gnss_file(name), name):
        if found == 1046:
            text = with_bits("".join(f"{byte:08b}" for byte in payload), 0, number, 12)
            text = with_bits(with_bits(text, 40, 107, 8), at, health, 3)[:end]
            frames.append(frame(*((int(bit), 1) for bit in text)))
    (tmp_path / "a.rtcm3").write_bytes(b"".join(frames))
    sets = read_rtcm_navigation(tmp_path / "a.rtcm3").galileo
    ours, other = sets if number == 1046 else sets[::-1]
    assert len(ours) > 10
    assert not len(other)
    assert (ours.healthy == (health == 0)).all()
    assert_allclose(ours.get("accuracy"), 3.12)
