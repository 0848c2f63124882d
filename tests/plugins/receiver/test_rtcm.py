"""RTCM 3: the values that pyrtcm reads, and the ranges and ephemerides that RTKLIB's encoder was given."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS, KEPLER
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams import rtcm_ephemerides
from bench.plugins.receiver.receiver_streams.rtcm import read_rtcm
from bench.plugins.receiver.receiver_streams.rtcm_ephemerides import read_messages, read_rtcm_navigation
from bench.plugins.receiver.receiver_streams.ubx import read_ubx, read_ubx_navigation
from bench.plugins.receiver.rinex.ephemerides import read_navigation
from bench.plugins.receiver.rinex.lines import find_kind
from bench.plugins.receiver.rinex.observations import read_observations
from bench.simulation.signals.gps_time import gps_seconds
from tests.damage import spoil
from tests.data import gnss_file, stored_gnss_file

STATION = "testglo-2009-12-18.rtcm3"  # recorded: 1004, 1012, 1005, 1019, 1020
WALK = "walk-2025-08-28.rtcm3"  # MSM7, 1019 and 1042 by RTKLIB's encoder from the UBX file of that name
OPEC = "opec-2022-01-01.rtcm3"  # MSM4 of GPS, MSM5 of GLONASS, MSM6 of Galileo, MSM7 of BeiDou, by the same
FIELDS = ("pseudorange", "doppler", "cn0", "phase")


def list_rows(raw):
    """Return (time, system, satellite) -> the values of `FIELDS` of both carriers."""
    t = raw.origin + np.repeat(raw.t, np.diff(raw.epoch_start))
    keys = zip(np.round(t, 3).tolist(), raw.system.tolist(), raw.sat.tolist(), strict=True)
    return dict(zip(keys, np.stack([getattr(raw, name) for name in FIELDS], axis=1), strict=True))


def compare(raw, other, system):
    """Return the differences (K, 4, 2) of the rows of a system, all of which the other file has."""
    ours, theirs = list_rows(raw), list_rows(other)
    rows = [key for key in ours if key[1] == system]
    assert len(rows) > 20
    times = {key[0] for key in ours}
    assert set(rows) == {key for key in theirs if key[1] == system and key[0] in times and key in ours}
    return np.array([ours[key] - theirs[key] for key in rows])


def test_legacy_messages_have_the_values_that_pyrtcm_reads():
    """First epoch, pyrtcm 1.2.1. G03: DF011 127836.44, DF014 67, DF012 0.0675, DF017 -0.44, DF018 0.202."""
    raw = read_rtcm(gnss_file(STATION))
    assert raw.origin + raw.t[0] == gps_seconds(2009, 12, 18, 82_820.0 + 400.0)  # DF004 515220000 ms, Friday
    assert (len(raw.t), raw.lost) == (60, 0)
    rows = list_rows(raw)
    one = rows[515_220.0 + 1562 * 604_800, GPS, 3]
    first = 127836.44 + 67 * 299792.458
    assert_allclose(one[0], [first, first - 0.44], atol=1e-6, rtol=0)
    assert_allclose(one[2], [50.0, 42.25])
    length = 299792458.0 / np.array([1575.42e6, 1227.6e6])
    assert_allclose(one[3] * length, [first + 0.0675, first + 0.202], atol=1e-6, rtol=0)
    # R14: DF041 85134.08, DF042 -0.1605, DF044 32, DF047 8.16, DF048 0.233, channel 0 - 7
    one, first = rows[515_220.0 + 1562 * 604_800, GLONASS, 14], 85134.08 + 32 * 599584.916
    assert_allclose(one[0], [first, first + 8.16], atol=1e-6, rtol=0)
    length = 299792458.0 / (np.array([1602e6, 1246e6]) - 7 * np.array([562_500.0, 437_500.0]))
    assert_allclose(one[3] * length, [first - 0.1605, first + 0.233], atol=1e-6, rtol=0)
    assert np.isnan(one[1]).all()
    assert_allclose(raw.approximate_e, [-3869297.5138, 3436571.3345, 3717369.3757], atol=1e-4, rtol=0)


def test_msm7_has_the_values_of_the_ubx_file_that_was_encoded():
    """Steps of the fields: range 2^-29 ms, Doppler 1e-4 m/s, C/N0 1/16 dB-Hz."""
    raw, ubx = read_rtcm(gnss_file(WALK)), read_ubx(stored_gnss_file("walk-2025-08-28.ubx.gz"))
    assert len(raw.t) == 8
    for system in (GPS, GALILEO):
        off = compare(raw, ubx, system)
        assert_allclose(off[:, 0][np.isfinite(off[:, 0])], 0.0, atol=3e-4)
        assert_allclose(off[:, 1][np.isfinite(off[:, 1])], 0.0, atol=3e-4)
        assert np.isfinite(off[:, 1]).sum() > 40
        assert_allclose(off[:, 2][np.isfinite(off[:, 2])], 0.0, atol=1.0 / 16)
    nav, ours = (
        read_ubx_navigation(stored_gnss_file("walk-2025-08-28.ubx.gz")),
        read_rtcm_navigation(gnss_file(WALK)),
    )
    for sets, of in ((nav.gps, ours.gps), (nav.beidou, ours.beidou)):
        assert len(of) >= 4
        for k in range(len(of)):
            at = (sets.sat == of.sat[k]) & (sets.t == of.t[k])
            assert (np.abs(sets.elements[at] - of.elements[k]) < 1e-12 * np.abs(of.elements[k]) + 1e-30).all()
            assert at.any()


def test_msm4_to_msm7_have_the_values_of_the_rinex_file_that_was_encoded():
    """Of the first carrier, where RTKLIB takes the same code; MSM4 and MSM5 have steps of 2^-24 ms."""
    raw = read_rtcm(gnss_file(OPEC))
    rinex = read_observations(gnss_file("OPEC00NOR_S_20220010000_04H_600S_MO.rnx"), phase=True)
    assert_allclose(raw.t, [0.0, 600.0, 1200.0, 1800.0])
    for system, step in ((GPS, 9e-3), (GLONASS, 9e-3), (GALILEO, 3e-4), (BEIDOU, 3e-4)):
        off = compare(raw, rinex, system)[:, :, 0]
        assert_allclose(off[:, 0], 0.0, atol=step)
        cycles = off[:, 3][np.isfinite(off[:, 3])]
        assert len(cycles) > 20
        assert_allclose(cycles, np.round(cycles), atol=2e-3)
    assert_allclose(raw.approximate_e, rinex.approximate_e, atol=1e-4, rtol=0)


@pytest.mark.parametrize("system", [GPS, GALILEO, BEIDOU])
def test_ephemerides_are_those_of_the_rinex_file_that_was_encoded(system):
    """Except the accuracy, an index of which RTKLIB rounds otherwise."""
    ours, theirs = (
        read(gnss_file(name)).list_sets()[system][0]
        for read, name in (
            (read_rtcm_navigation, OPEC),
            (read_navigation, "OPEC00NOR_S_20220010000_04H_MN.rnx"),
        )
    )
    assert len(ours) >= 16
    columns = [k for k, name in enumerate(KEPLER) if name != "accuracy"]
    for k in range(len(ours)):
        at = np.flatnonzero((theirs.sat == ours.sat[k]) & (theirs.t == ours.t[k]))
        off = np.abs(theirs.elements[at] - ours.elements[k])[:, columns]
        assert (off < 1e-7 * np.abs(ours.elements[k, columns]) + 1e-19).all(axis=1).any()
    assert ours.healthy.all()


def test_states_of_glonass_are_those_of_the_rinex_file_that_was_encoded():
    ours = read_rtcm_navigation(gnss_file(OPEC)).glonass
    theirs = read_navigation(gnss_file("OPEC00NOR_S_20220010000_04H_MN.rnx")).glonass
    assert len(ours) == 8
    for k in range(len(ours)):
        at = np.flatnonzero((theirs.sat == ours.sat[k]) & (np.abs(theirs.t - ours.t[k]) < 1.0))[0]
        assert_allclose(ours.state[k], theirs.state[at], rtol=1e-11, atol=1e-14)
        assert ours.channel[k] == theirs.channel[at]


def test_fixes_of_a_stream_with_its_own_ephemerides(capsys):
    assert main(["fixes", str(stored_gnss_file(f"{STATION}.gz")), "--json"]) == 0
    said = capsys.readouterr().out
    assert '"fixes": 60' in said
    assert (
        main(
            ["fixes", str(stored_gnss_file(f"{STATION}.gz")), "--systems", "glonass", "--ionosphere", "none"]
        )
        == 0
    )
    assert "3d_median_m" in capsys.readouterr().out


def split(name):
    """Return the frames of a file by whether they are ephemerides."""
    content, kinds = gnss_file(name).read_bytes(), {True: b"", False: b""}
    for number, payload in read_messages(gnss_file(name), name):
        end = content.index(payload) + len(payload) + 3
        kinds[number in rtcm_ephemerides.MESSAGES] += content[end - len(payload) - 6 : end]
    return kinds


def test_ephemerides_may_be_in_another_file_and_without_any_the_date_is_asked_for(tmp_path, capsys):
    own, nav = tmp_path / "own.rtcm3", tmp_path / "nav.rtcm3"
    frames = split(OPEC)
    own.write_bytes(frames[False])
    nav.write_bytes(frames[True])
    assert main(["fixes", str(own)]) == 2
    assert "own.rtcm3: has no ephemeris with a date (RTCM 1019, 1020" in capsys.readouterr().err
    with pytest.raises(ConfigError, match=r"own: RTCM 3 has no date, .* the day, too: bench fixes own NAV"):
        read_rtcm(own, "own")
    rinex = stored_gnss_file("OPEC00NOR_S_20220010000_04H_MN.rnx.gz")
    for other in (nav, rinex):
        assert main(["fixes", str(own), str(other)]) == 0
        assert "2022-01-01, 4 epochs" in capsys.readouterr().out


def test_a_week_modulo_1024_is_the_last_one_unless_other_ephemerides_tell_it(tmp_path, monkeypatch):
    path = tmp_path / "gps.rtcm3"
    content = gnss_file(STATION).read_bytes()
    for number, payload in read_messages(gnss_file(STATION), STATION):
        if number == 1020:
            content = content.replace(payload, bytes(len(payload)))
    path.write_bytes(content)
    assert read_rtcm(path).origin == gps_seconds(2009, 12, 18)

    class Later(rtcm_ephemerides.date):
        @classmethod
        def today(cls):
            return cls(2031, 1, 1)

    monkeypatch.setattr(rtcm_ephemerides, "date", Later)
    assert read_rtcm(path).origin == gps_seconds(2009, 12, 18) + 1024 * 604_800
    assert read_rtcm(path, near=gps_seconds(2010, 5, 1)).origin == gps_seconds(2009, 12, 18)
    assert read_rtcm(gnss_file(STATION)).origin == gps_seconds(2009, 12, 18)


def test_damaged_messages_are_left_out_and_a_stream_may_begin_in_a_message(tmp_path):
    content = bytearray(gnss_file(WALK).read_bytes())
    whole = read_rtcm(gnss_file(WALK))
    content[len(content) // 2] ^= 1
    path = tmp_path / "a.rtcm3"
    path.write_bytes(content[7:-9])
    raw = read_rtcm(path)
    assert raw.lost == 2
    assert raw.reasons[0].endswith("2 damaged messages")
    assert len(raw.sat) < len(whole.sat)
    assert find_kind(path, "a") == "rtcm"


def read_damaged(read, path):
    """Read a damaged file: rows, or one line that names it."""
    said = "a.rtcm3: read"
    try:
        read(path)
    except ConfigError as error:
        said = str(error)
    assert said.startswith("a.rtcm3: ")
    assert "\n" not in said


@pytest.mark.parametrize("name", [STATION, WALK, OPEC])
def test_a_file_that_ends_early_or_has_wrong_bits_gives_rows_or_one_line(name, tmp_path):
    path = tmp_path / "a.rtcm3"
    for piece in spoil(gnss_file(name).read_bytes(), 3):
        path.write_bytes(piece)
        for read in (read_rtcm, read_rtcm_navigation):
            read_damaged(read, path)


def test_a_message_with_a_right_checksum_and_wrong_content_is_left_out(tmp_path):
    """Random bits in the payload: the CRC is made anew."""
    rng, path = np.random.default_rng(4), tmp_path / "a.rtcm3"
    table = rtcm_ephemerides._tabulate_crc()
    for _ in range(40):
        content = b""
        for _, payload in read_messages(gnss_file(OPEC), OPEC):
            flipped = bytearray(payload[: rng.integers(2, len(payload) + 1)])
            for at in rng.integers(1, len(flipped), size=rng.integers(3)):
                flipped[at] ^= 1 << rng.integers(8)
            frame = b"\xd3" + len(flipped).to_bytes(2, "big") + flipped
            crc = 0
            for byte in frame:
                crc = (crc << 8 & 0xFFFFFF) ^ int(table[0, crc >> 16 ^ byte])
            content += frame + crc.to_bytes(3, "big")
        path.write_bytes(content)
        for read in (read_rtcm, read_rtcm_navigation):
            read_damaged(read, path)


def test_packed_files_are_read(tmp_path):
    path = tmp_path / "a.rtcm3.gz"
    path.write_bytes(gzip.compress(gnss_file(WALK).read_bytes()))
    assert len(read_rtcm(path).t) == 8
