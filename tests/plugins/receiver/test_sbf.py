"""SBF of Septentrio: a real receiver as pysbf2 lists its values, and what pysbf2 was given to encode."""

from __future__ import annotations

import contextlib
import gzip
import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.cli.command_line import main
from bench.core.mathematics import earth
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS, KEPLER
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import SBF, recognize
from bench.plugins.receiver.receiver_streams import sbf_fixes
from bench.plugins.receiver.receiver_streams.sbf import read_blocks, read_sbf, read_sbf_navigation
from bench.plugins.receiver.receiver_streams.ubx import read_ubx, read_ubx_navigation
from bench.plugins.receiver.rinex.ephemerides import read_navigation
from bench.plugins.receiver.rinex.lines import find_kind
from bench.plugins.receiver.rinex.observations import read_observations
from bench.simulation.signals.gps_time import gps_seconds
from bench.simulation.signals.orbits import find_frequency
from tests.damage import spoil
from tests.data import gnss_file, stored_gnss_file
from tests.plugins.receiver.test_rtcm import list_rows

REAL = "mosaic-x5.sbf"
WALK, OPEC = "walk-2025-08-28.sbf", "opec-2022-01-01.sbf"  # by pysbf2 from the UBX, the RINEX of these names
UBX = stored_gnss_file("walk-2025-08-28.ubx.gz")
OPEC_RINEX = "OPEC00NOR_S_20220010000_04H_600S_MO.rnx", "OPEC00NOR_S_20220010000_04H_MN.rnx"
WEEK, TOW = 2367, 482_303.0 + 18.0
C = 299_792_458.0


def test_a_real_epoch_has_the_values_that_pysbf2_reads():
    """2025-05-23 13:58:23 UTC; G17 is the first sub-block, R02 has G2 as its first signal."""
    raw = read_sbf(gnss_file(REAL))
    assert raw.origin + raw.t == pytest.approx([gps_seconds(2025, 5, 23, 50_303.0 + 18.0)])
    assert (len(raw.sat), raw.lost, raw.others) == (39, 0, {"SBAS": 4, "NavIC": 1})
    rows = list_rows(raw)
    one, length = rows[WEEK * 604_800 + TOW, GPS, 17], C / np.array([1575.42e6, 1227.6e6])
    first = 5 * 4294967.296 + 976531.514
    assert_allclose(one[0], [first, first - 65.536 + 63.565], atol=1e-6, rtol=0)
    assert_allclose(one[1], [2077.1658, 2077.1658 * 1227.6 / 1575.42 + 4e-4], atol=1e-9, rtol=0)
    assert_allclose(one[2], [46.0, 44.25])  # 10 dB-Hz are added to those of L1 C/A, not to those of L2 P
    assert_allclose(one[3] - one[0] / length, [2.039, 5.503], atol=1e-7, rtol=0)
    slot = rows[WEEK * 604_800 + TOW, GLONASS, 2]
    assert slot[0, 1] == pytest.approx(5 * 4294967.296 + 2574732.075, abs=1e-6)
    assert np.isnan(slot[3, 0])
    assert sorted(raw.sat[raw.system == BEIDOU].tolist()) == [5, 11, 14, 21, 28, 33, 34, 39, 42, 43]


def test_carriers_of_a_real_receiver_agree():
    """Doppler as the carriers, ranges to 20 m, phases aligned to the ranges to 9 m since 8 minutes ago.

    The channels of GLONASS are those in the header of station ESBC.
    """
    raw = read_sbf(gnss_file(REAL))
    channels = {2: -4, 3: 5, 4: 6, 5: 1, 10: -7, 11: 0, 18: -3, 19: 3, 20: 2}
    channel = np.array([channels.get(n, 0) for n in raw.sat.tolist()]) * (raw.system == GLONASS)
    assert set(raw.sat[raw.system == GLONASS].tolist()) == set(channels)
    f = np.column_stack([find_frequency(raw.system, raw.band[:, k], channel) for k in range(2)])
    both = np.isfinite(raw.doppler).all(axis=1)
    assert both.sum() == 37
    ratio = raw.doppler[both, 1] / raw.doppler[both, 0] * f[both, 0] / f[both, 1]
    assert_allclose(ratio, 1.0, atol=4e-4)
    assert (np.abs(np.diff(raw.pseudorange[both], axis=1)) < 20.0).all()
    away = raw.phase * C / f - raw.pseudorange
    assert np.isfinite(away).sum() == 74
    assert np.nanmax(np.abs(away)) < 9.0
    assert np.nanmedian(np.abs(away)) < 1.0


def test_a_real_ephemeris_and_fix_have_the_values_that_pysbf2_reads():
    """E36, F/NAV: angles in semicircles, SISA 107 of E5a is 3.12 m, BGD of E5b unknown."""
    nav = read_sbf_navigation(gnss_file(REAL))
    assert [len(one) for one in nav.galileo] == [0, 1]
    one = nav.galileo[1]
    assert (one.sat.tolist(), one.healthy.tolist()) == ([36], [True])
    expected = {
        "t_oe": WEEK * 604_800 + 481_800.0, "sqrt_a": 5440.6060581207275, "c_rc": 145.15625, "accuracy": 3.12,
        "mean_anomaly": 0.4124071183614433 * np.pi, "node_rate": -1.7097363524953835e-09 * np.pi,
        "af_0": -0.0003986151423305273, "group_delay": 4.423782229423523e-09, "group_delay_2": 0.0,
    }  # fmt: skip
    for name, value in expected.items():
        assert one.get(name)[0] == pytest.approx(value, rel=1e-12)
    rows = sbf_fixes.read("sbf", gnss_file(REAL), "gnss", None)
    assert rows.t == pytest.approx([gps_seconds(2025, 5, 23, 50_829.0 + 18.0)])
    assert_allclose(rows.values["lla"], [[0.9310293523340808, -0.03921206770879602, 131.18596542546626]])
    assert_allclose(rows.values["vel_n"], [[0.00122622714, -0.00079572264, -0.00048171318]], rtol=1e-6)
    assert_allclose(rows.values["sd_pos"], np.sqrt([[0.1617997735, 0.0982736870, 0.4769186377]]), rtol=1e-6)
    assert_allclose(rows.values["sd_vel"], np.sqrt([[2.6072719e-5, 1.85492917e-5, 4.58288e-5]]), rtol=1e-6)
    assert (rows.values["quality"], rows.values["satellites"]) == ([3.0], [36.0])


# --- what another program encoded ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", [WALK, OPEC])
def test_observations_are_those_of_the_file_that_was_encoded(name):
    """Steps: 1 mm, 1e-4 Hz, 0.25 dB-Hz, 1e-3 cycles, beside whole cycles; a third begins with carrier 2."""
    raw = read_sbf(gnss_file(name))
    other = read_ubx(UBX) if name == WALK else read_observations(gnss_file(OPEC_RINEX[0]), phase=True)
    ours, theirs = list_rows(raw), list_rows(other)
    times = {key[0] for key in ours}
    assert len(times) == {WALK: 17, OPEC: 4}[name]
    assert ours.keys() == {key for key in theirs if key[0] in times and np.isfinite(theirs[key][0]).any()}
    off = np.array([ours[key] - theirs[key] for key in ours])
    assert (np.isfinite(off) == [np.isfinite(theirs[key]) for key in ours]).all()
    off[:, 3] -= np.round(off[:, 3])
    for k, step in enumerate((5.1e-4, 1.1e-4, 0.126, 4e-3)):
        assert np.nanmax(np.abs(off[:, k]), initial=0.0) < step
    assert np.isfinite(off[:, 0]).sum() > 200


@pytest.mark.parametrize("name", [WALK, OPEC])
def test_ephemerides_are_those_of_the_file_that_was_encoded(name):
    """To the 24 bits of the smaller fields; GLONASS in GPS time, BeiDou 14 s behind it."""
    ours = read_sbf_navigation(gnss_file(name))
    theirs = read_ubx_navigation(UBX) if name == WALK else read_navigation(gnss_file(OPEC_RINEX[1]))
    for system, listed in ours.list_sets().items():
        for one, other in zip(listed, theirs.list_sets()[system], strict=True):
            assert len(one) > 7 or name == WALK or one.message == "F/NAV"
            table, reference = (x.state if system == GLONASS else x.elements for x in (one, other))
            columns = np.arange(table.shape[1])
            if system != GLONASS:  # the accuracy of RINEX is rounded otherwise
                columns = np.delete(columns, KEPLER.index("accuracy"))
            for k in range(len(one)):
                at = np.flatnonzero((other.sat == one.sat[k]) & (other.t == one.t[k]))
                off = np.abs(reference[at] - table[k])[:, columns]
                same = (off <= 1e-7 * np.abs(table[k, columns]) + 1e-18).all(axis=1)
                assert same.any()
                assert one.healthy[k] in other.healthy[at[same]]
                if system == GLONASS:
                    assert one.channel[k] == other.channel[at[same][0]]
    for a, b in ((ours.klobuchar, theirs.klobuchar), (ours.level, theirs.level)):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            assert_allclose(a, b, rtol=1e-6)


@pytest.mark.parametrize("systems", ["gps", "glonass", "galileo", "beidou", "all"])
def test_the_solution_is_that_of_the_file_that_was_encoded(systems):
    """With its own ephemerides, of four systems; the ranges have steps of 1 mm."""
    rinex = [gnss_file(name) for name in OPEC_RINEX]
    own = bench.solve_rinex(gnss_file(OPEC), gnss_file(OPEC), systems=systems)
    other = bench.solve_rinex(rinex[0], rinex[1], systems=systems)
    assert own.fixes.valid.sum() >= 3
    n = len(own.observations.t)
    good = own.fixes.valid & other.fixes.valid[:n]
    assert (own.fixes.valid == other.fixes.valid[:n]).all()
    away = earth.difference_n(own.fixes.lla[good], other.fixes.lla[:n][good])
    assert np.abs(away).max() < 0.02


def test_a_stream_is_solved_alone_and_its_ephemerides_may_be_in_another_file(tmp_path, capsys):
    content = gnss_file(WALK).read_bytes()
    at = content.index(next(body for number, body in read_blocks(gnss_file(WALK), "") if number == 4027)) - 8
    (tmp_path / "nav.sbf").write_bytes(content[:at])
    (tmp_path / "own.sbf").write_bytes(content[at:])
    assert main(["fixes", str(gnss_file(WALK)), "--json"]) == 0
    alone = capsys.readouterr().out
    assert '"fixes": 17' in alone
    assert main(["fixes", str(tmp_path / "own.sbf"), str(tmp_path / "nav.sbf"), "--json"]) == 0
    assert '"fixes": 17' in capsys.readouterr().out
    assert main(["fixes", str(tmp_path / "own.sbf")]) == 2
    said = capsys.readouterr().err
    assert "own.sbf: has no ephemeris (SBF GPSNav, GLONav, GALNav, BDSNav) in it; give the navigation" in said


# --- blocks from the published layout -----------------------------------------------------------------------


def block(number, body, *, revision=0):
    """A block with its CRC: polynomial 0x1021, first bit first, from 0, over all behind the CRC."""
    body += bytes(-len(body) % 4)
    rest = struct.pack("<HH", number | revision << 13, 8 + len(body)) + body
    crc = 0
    for byte in rest:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return b"$@" + struct.pack("<H", crc) + rest


def signal(
    identifier=5, kind=0, *, code=21_000_000_000, rate=10_000, phase=1000, cn0=120, lock=9, info=0, more=()
):
    parts = (code >> 32, code & 0xFFFFFFFF, rate, phase & 0xFFFF, phase >> 16, cn0, lock, info, len(more))
    return struct.pack("<4BIiHbBHBB", 1, kind, identifier, *parts) + b"".join(more)


def next_signal(kind=2, *, code=-2000, rate=0, phase=1000, cn0=120, lock=9, info=0):
    high = code >> 16 & 7 | (rate >> 16 & 31) << 3
    return struct.pack(
        "<4BbBHHH", kind, lock, cn0, high, phase >> 16, info, code & 0xFFFF, phase & 0xFFFF, rate & 0xFFFF
    )


def epoch(*signals, tow=1000, week=WEEK, flags=0):
    head = struct.pack("<IH6B", tow, week, len(signals), 20, 12, flags, 0, 0)
    return block(4027, head + b"".join(signals), revision=1)


def read_written(path, *blocks):
    path.write_bytes(b"".join(blocks))
    return read_sbf(path)


def test_signals_have_their_carrier_and_cycles_counted_anew_are_told(tmp_path):
    """Of L2C and L2P the second is used; other antennas, signals and slots are passed over."""
    both = (next_signal(3, code=-1000), next_signal(2), next_signal(4), next_signal(2 | 32, code=0))
    first = [signal(more=both), signal(62, 8), signal(45, 8, info=(6 + 8) << 3), signal(5, 32, code=1)]
    first += [signal(79, 17, lock=0), signal(130, 24), signal(183, 6), signal(78, 17, code=0)]
    later = [signal(more=(next_signal(3),), lock=300), signal(79, 17, info=4), signal(45, 8, lock=8)]
    raw = read_written(tmp_path / "a.sbf", epoch(*first), epoch(*later, tow=2000))
    assert raw.sat.tolist() == [5, 8, 9, 5, 9, 8]
    assert raw.system.tolist() == [GPS, GLONASS, GALILEO, GPS, GALILEO, GLONASS]
    assert_allclose(raw.pseudorange[0], [21e6, 21e6 - 2.0])
    assert raw.band.tolist()[:2] == [[1, 2], [1, 0]]
    assert raw.phase[1, 0] - 21e6 / C * (1602e6 + 6 * 562.5e3) == pytest.approx(1.0, abs=1e-6)
    assert raw.slipped[:, 0].tolist() == [False, False, True, False, True, True]
    assert raw.slipped[[0, 3], 1].tolist() == [False, True]  # another signal of the same carrier
    assert raw.others == {"SBAS": 1, "QZSS": 1}
    assert (raw.origin + raw.t).tolist() == [WEEK * 604_800 + 1.0, WEEK * 604_800 + 2.0]


def test_identifiers_times_of_lock_and_flags_at_their_limits(tmp_path):
    """R25 is 63, as 62 is a slot unknown; a second signal has at most 254 s; bit 6 is no scrambling."""
    master = signal(kind=3, lock=300)
    raw = read_written(
        tmp_path / "a.sbf",
        epoch(master, signal(63, 8), flags=0x40),
        epoch(signal(more=(next_signal(3, lock=254),)), tow=2000),
        block(4027, bytes(4)),
    )
    assert raw.sat.tolist() == [5, 25, 5]
    assert raw.slipped[:, 1].tolist() == [False, False, False]
    assert raw.lost == 1


def patch(name, number, changes):
    """Blocks of a file with values of a layout at places of their bodies, and their CRC made anew."""
    out = []
    for one, body in read_blocks(gnss_file(name), ""):
        if one == number:
            changed = bytearray(body)
            for at, layout, value in changes:
                struct.pack_into(layout, changed, at, value)
            out.append(block(one, bytes(changed)))
    return b"".join(out)


@pytest.mark.parametrize(
    ("number", "at", "layout", "value", "healthy"),
    [
        *((4004, 77, "B", bits, bits < 4) for bits in (0, 3, 4)),  # B_n: the first of three bits counts
        *(
            (4002, 122, "<H", bits, bits not in (0b0011, 0b0101, 0b1001))
            for bits in (0, 1, 3, 5, 9, 14, 0xF00)
        ),
    ],
)
def test_health_is_that_of_the_message(tmp_path, number, at, layout, value, healthy):
    """Of Galileo's E1: a bit that it is known, that of the data, and two of the signal."""
    path = tmp_path / "a.sbf"
    path.write_bytes(patch(OPEC, number, [(at, layout, value)]))
    nav = read_sbf_navigation(path)
    one = nav.glonass if number == 4004 else nav.galileo[0]
    assert len(one) > 4
    assert (one.healthy == healthy).all()


def test_an_ephemeris_with_an_impossible_value_is_left_out(tmp_path):
    path = tmp_path / "a.sbf"
    path.write_bytes(patch(OPEC, 4004, [(8, "<d", 1e20)]) + patch(OPEC, 4002, [(8, "<d", np.nan)]))
    with pytest.raises(ConfigError, match=r"a\.sbf: has no ephemeris"):
        read_sbf_navigation(path)


def test_values_that_stand_for_none(tmp_path):
    nothing = next_signal(phase=-128 << 16, rate=-16 << 16, cn0=255, lock=255)
    none = signal(6, rate=-(2**31), phase=-128 << 16, cn0=255, lock=65535, more=(next_signal(rate=5),))
    raw = read_written(tmp_path / "a.sbf", epoch(signal(more=(nothing,)), none))
    assert np.isnan([raw.doppler[0, 1], raw.cn0[0, 1], raw.phase[0, 1]]).all()
    assert np.isnan([*raw.doppler[1], raw.cn0[1, 0], raw.phase[1, 0]]).all()
    assert_allclose(raw.pseudorange, [[21e6, 21e6 - 2.0]] * 2)
    missing = next_signal(code=-4 << 16)
    raw = read_written(tmp_path / "a.sbf", epoch(signal(more=(missing,))))
    assert raw.band.tolist() == [[1, 0]]


def test_epochs_without_a_time_scrambled_or_damaged_are_left_out(tmp_path):
    good = epoch(signal(), tow=5000)
    short = epoch(signal(more=(next_signal(),)), tow=3000)[8:-12]
    lost = [epoch(signal(), week=0xFFFF), epoch(signal(), tow=0xFFFFFFFF), epoch(signal(), flags=0x80)]
    lost += [block(4027, short), block(4027, bytes(8))]
    raw = read_written(tmp_path / "a.sbf", *lost, good, good[:20])
    assert raw.origin + raw.t == pytest.approx([WEEK * 604_800 + 5.0])
    reasons = [
        "2 epochs before the receiver set its clock",
        "1 epochs with ranges that the receiver scrambled",
    ]
    assert [text.partition(": ")[2] for text in raw.reasons] == [*reasons, "3 damaged blocks"]
    with pytest.raises(
        ConfigError, match=r"a\.sbf: has no ranges \(SBF MeasEpoch\).*; a\.sbf: 1 epochs with"
    ):
        read_written(tmp_path / "a.sbf", epoch(signal(), flags=0x80))


def test_a_receiver_that_stores_other_ranges_is_told_apart(tmp_path, capsys):
    path = tmp_path / "a.sbf"
    other = block(4109, struct.pack("<IH", 1000, WEEK) + bytes(30))
    path.write_bytes(gnss_file(REAL).read_bytes()[1572:] + other)
    assert main(["fixes", str(path)]) == 2
    assert "a.sbf: has no ranges (SBF MeasEpoch) in it; sbf2rin of Septentrio" in capsys.readouterr().err


def fix(tow=1000, mode=4, error=0, lla=(0.8, 0.2, 500.0), vel=(1.0, 2.0, 3.0), tail=b"", week=WEEK, count=12):
    body = struct.pack(
        "<IHBB3df3ffdf3B", tow, week, mode, error, *lla, 48.0, *vel, 0.0, 0.0, 0.0, 0, 0, count
    )
    return block(4007, body + tail, revision=2 if tail else 0)


def covariance(number, tow, *variances):
    return block(number, struct.pack("<IHBB10f", tow, WEEK, 1, 0, *variances, *[0.5] * 7))


def read_fixes(path, *blocks):
    path.write_bytes(b"".join(blocks))
    return sbf_fixes.read("sbf", path, "gnss", None)


def test_fixes_have_classes_of_rtklib_and_those_that_are_none_are_not_used(tmp_path):
    """Accuracies are 2 sigma, horizontal and vertical, 95 cm and 120 cm; a solution in 2D is none."""
    tail = struct.pack("<BHHIBBHHHHB", 0, 0, 0, 0, 0, 0, 0, 0, 95, 120, 0)
    modes = [1, 2, 4, 5, 6, 7, 8, 10, 0, 3, 9, 0x84]
    rows = [fix(tow=1000 * k, mode=mode, tail=tail) for k, mode in enumerate(modes, 1)]
    nothing = (-2e10,) * 3
    rows += [fix(tow=50_000, error=1), fix(tow=51_000, lla=nothing), fix(tow=52_000, vel=nothing)]
    spread = [covariance(5906, 1000, 4.0, 9.0, 16.0), covariance(5908, 2000, 1.0, 4.0, -2e10)]
    found = read_fixes(tmp_path / "gnss.sbf", *rows, *spread, fix(week=0xFFFF))
    values = found.values
    assert_allclose(found.t - WEEK * 604_800, [*range(1, 13), 50.0, 51.0, 52.0])
    assert_allclose(values["quality"][:12], [5, 4, 1, 2, 3, 1, 2, 6, np.nan, np.nan, np.nan, 1])
    assert np.isfinite(values["lla"]).all(axis=1).tolist() == [True] * 8 + [False] * 6 + [True]
    assert_allclose(values["vel_n"][[0, -1]], [[1.0, 2.0, -3.0], [np.nan] * 3])
    assert_allclose(values["sd_pos"][:2], [[2.0, 3.0, 4.0], [0.475 / 2**0.5] * 2 + [0.6]])
    assert np.isnan(values["sd_pos"][-1]).all()
    assert_allclose(values["sd_vel"][:2], [[np.nan] * 3, [1.0, 2.0, np.nan]])
    assert (values["satellites"] == 12.0).all()
    assert_allclose(
        read_fixes(tmp_path / "gnss.sbf", fix(count=254), fix(tow=2000, count=255)).values["satellites"],
        [254.0, np.nan],
    )
    assert "1 fixes before the receiver set its clock" in found.notes[0]


def test_what_has_no_fix_is_refused_by_one_line(tmp_path):
    path = tmp_path / "a.sbf"
    with pytest.raises(ConfigError, match=r"a Septentrio SBF recording; put it beside a table of an IMU"):
        sbf_fixes.read("sbf", gnss_file(REAL), "imu", None)
    with pytest.raises(
        ConfigError, match=r"a\.sbf: has no fix \(SBF PVTGeodetic\); bench fixes a\.sbf computes"
    ):
        read_fixes(path, epoch(signal()))
    with pytest.raises(ConfigError, match=r"a\.sbf: has no fix with a time"):
        read_fixes(path, fix(week=0xFFFF))


def test_a_table_of_an_imu_finds_the_receiver_beside_it(tmp_path, capsys):
    t = np.arange(0.0, 60.0, 0.02) + WEEK * 604_800
    draw = np.random.default_rng(2).normal([0.0] * 5 + [-9.8], 0.01, (len(t), 6))
    names = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
    rows = [",".join(f"{value:.6f}" for value in row) for row in np.column_stack([t, draw])]
    (tmp_path / "imu.csv").write_text("\n".join([names, *rows]) + "\n")
    (tmp_path / "gnss.sbf").write_bytes(b"".join(fix(tow=1000 * k) for k in range(1, 60)))
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == 0
    assert "gnss: gnss.sbf" in capsys.readouterr().out


def test_a_stream_is_recognized_that_begins_in_a_block(tmp_path):
    content = gnss_file(OPEC).read_bytes()
    for begin in (0, 1, 70):
        (tmp_path / "a").write_bytes(content[begin:])
        assert recognize(content[begin : begin + 4096]).name == SBF
        assert find_kind(tmp_path / "a", "a") == "sbf"
    (tmp_path / "a.gz").write_bytes(gzip.compress(content))
    assert find_kind(tmp_path / "a.gz", "a.gz") == "sbf"
    assert len(read_sbf(tmp_path / "a.gz").t) == 4


# --- damage -------------------------------------------------------------------------------------------------


def read_damaged(path):
    """Read a damaged file: rows, or one line that names it."""
    for read in (read_sbf, read_sbf_navigation, lambda p: sbf_fixes.read("sbf", p, "gnss", None)):
        said = "a.sbf: read"
        try:
            read(path)
        except ConfigError as error:
            said = str(error)
        assert said.startswith("a.sbf: ")
        assert "\n" not in said


@pytest.mark.parametrize("name", [REAL, WALK])
def test_a_file_that_ends_early_or_has_wrong_bits_gives_rows_or_one_line(name, tmp_path):
    path = tmp_path / "a.sbf"
    for piece in spoil(gnss_file(name).read_bytes(), 3):
        path.write_bytes(piece)
        read_damaged(path)
        with contextlib.suppress(ConfigError):
            bench.solve_rinex(path, path)


def test_a_block_with_a_right_checksum_and_wrong_content_is_read_or_left_out(tmp_path):
    """Random bits in the body, and bodies that end early: the CRC is made anew."""
    rng, path = np.random.default_rng(4), tmp_path / "a.sbf"
    for _ in range(15):
        blocks = []
        for number, body in read_blocks(gnss_file(WALK if rng.integers(2) else REAL), ""):
            flipped = bytearray(body[: rng.integers(8, len(body) + 1)] if rng.integers(8) == 0 else body)
            for at in rng.integers(6, len(flipped), size=rng.integers(4)):
                flipped[at] = rng.integers(256)
            blocks.append(block(number, bytes(flipped)))
        path.write_bytes(b"".join(blocks))
        read_damaged(path)
