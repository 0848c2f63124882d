"""Ephemerides from the bits that receivers record: words built by the tables of the interface documents.

Positions of bits are those of the documents, counted from 1 with the parity; the reader counts fields.
"""

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
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.core.words.exceptions import ConfigError
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from bench.io.logs.record_clock import meet_week
from bench.io.logs.rows import LogRows
from bench.plugins.receiver.receiver_streams import subframes, ubx_fixes
from bench.plugins.receiver.receiver_streams.ubx import read_ubx_navigation
from tests.data import stored_gnss_file

WALK = stored_gnss_file("walk-2025-08-28.ubx.gz")
WEEK, TOW = 2381, 408639.75
PI = np.pi

# IS-GPS-200, figure 20-1: name -> parts (first bit, number of bits), signed, unit of the last bit
GPS_BITS = {
    1: {
        "ura": ([(73, 4)], 0, 1), "health": ([(77, 6)], 0, 1), "group_delay": ([(197, 8)], 1, 2**-31),
        "issue": ([(211, 8)], 0, 1), "t_oc": ([(219, 16)], 0, 16), "af_2": ([(241, 8)], 1, 2**-55),
        "af_1": ([(249, 16)], 1, 2**-43), "af_0": ([(271, 22)], 1, 2**-31),
    },
    2: {
        "issue": ([(61, 8)], 0, 1), "c_rs": ([(69, 16)], 1, 2**-5), "delta_n": ([(91, 16)], 1, PI * 2**-43),
        "mean_anomaly": ([(107, 8), (121, 24)], 1, PI * 2**-31), "c_uc": ([(151, 16)], 1, 2**-29),
        "e": ([(167, 8), (181, 24)], 0, 2**-33), "c_us": ([(211, 16)], 1, 2**-29),
        "sqrt_a": ([(227, 8), (241, 24)], 0, 2**-19), "t_oe_week": ([(271, 16)], 0, 16),
    },
    3: {
        "c_ic": ([(61, 16)], 1, 2**-29), "node_0": ([(77, 8), (91, 24)], 1, PI * 2**-31),
        "c_is": ([(121, 16)], 1, 2**-29), "i_0": ([(137, 8), (151, 24)], 1, PI * 2**-31),
        "c_rc": ([(181, 16)], 1, 2**-5), "perigee": ([(197, 8), (211, 24)], 1, PI * 2**-31),
        "node_rate": ([(241, 24)], 1, PI * 2**-43), "issue": ([(271, 8)], 0, 1),
        "i_rate": ([(279, 14)], 1, PI * 2**-43),
    },
}  # fmt: skip
# BDS-SIS-ICD-B1I-3.0, figures 5-8 to 5-10
BEIDOU_BITS = {
    1: {
        "sick": ([(43, 1)], 0, 1), "ura": ([(49, 4)], 0, 1), "t_oc": ([(74, 9), (91, 8)], 0, 8),
        "group_delay": ([(99, 10)], 1, 1e-10), "group_delay_2": ([(109, 4), (121, 6)], 1, 1e-10),
        "af_2": ([(215, 11)], 1, 2**-66), "af_0": ([(226, 7), (241, 17)], 1, 2**-33),
        "af_1": ([(258, 5), (271, 17)], 1, 2**-50),
    },
    2: {
        "delta_n": ([(43, 10), (61, 6)], 1, PI * 2**-43), "c_uc": ([(67, 16), (91, 2)], 1, 2**-31),
        "mean_anomaly": ([(93, 20), (121, 12)], 1, PI * 2**-31), "e": ([(133, 10), (151, 22)], 0, 2**-33),
        "c_us": ([(181, 18)], 1, 2**-31), "c_rc": ([(199, 4), (211, 14)], 1, 2**-6),
        "c_rs": ([(225, 8), (241, 10)], 1, 2**-6), "sqrt_a": ([(251, 12), (271, 20)], 0, 2**-19),
        "t_oe_high": ([(291, 2)], 0, 2**18),
    },
    3: {
        "t_oe_low": ([(43, 10), (61, 5)], 0, 8), "i_0": ([(66, 17), (91, 15)], 1, PI * 2**-31),
        "c_ic": ([(106, 7), (121, 11)], 1, 2**-31), "node_rate": ([(132, 11), (151, 13)], 1, PI * 2**-43),
        "c_is": ([(164, 9), (181, 9)], 1, 2**-31), "i_rate": ([(190, 13), (211, 1)], 1, PI * 2**-43),
        "node_0": ([(212, 21), (241, 11)], 1, PI * 2**-31),
        "perigee": ([(252, 11), (271, 21)], 1, PI * 2**-31),
    },
}  # fmt: skip
# Galileo OS SIS ICD 2.0, tables 42 to 46: bits of a word of 128
GALILEO_BITS = {
    1: {
        "issue": ([(7, 10)], 0, 1), "t_oe_week": ([(17, 14)], 0, 60),
        "mean_anomaly": ([(31, 32)], 1, PI * 2**-31),
        "e": ([(63, 32)], 0, 2**-33), "sqrt_a": ([(95, 32)], 0, 2**-19),
    },
    2: {
        "issue": ([(7, 10)], 0, 1), "node_0": ([(17, 32)], 1, PI * 2**-31),
        "i_0": ([(49, 32)], 1, PI * 2**-31),
        "perigee": ([(81, 32)], 1, PI * 2**-31), "i_rate": ([(113, 14)], 1, PI * 2**-43),
    },
    3: {
        "issue": ([(7, 10)], 0, 1), "node_rate": ([(17, 24)], 1, PI * 2**-43),
        "delta_n": ([(41, 16)], 1, PI * 2**-43),
        "c_uc": ([(57, 16)], 1, 2**-29), "c_us": ([(73, 16)], 1, 2**-29), "c_rc": ([(89, 16)], 1, 2**-5),
        "c_rs": ([(105, 16)], 1, 2**-5), "sisa": ([(121, 8)], 0, 1),
    },
    4: {
        "issue": ([(7, 10)], 0, 1), "sat": ([(17, 6)], 0, 1), "c_ic": ([(23, 16)], 1, 2**-29),
        "c_is": ([(39, 16)], 1, 2**-29), "t_oc": ([(55, 14)], 0, 60), "af_0": ([(69, 31)], 1, 2**-34),
        "af_1": ([(100, 21)], 1, 2**-46), "af_2": ([(121, 6)], 1, 2**-59),
    },
    5: {
        "a_0": ([(7, 11)], 0, 0.25), "a_1": ([(18, 11)], 1, 2**-8), "a_2": ([(29, 14)], 1, 2**-15),
        "group_delay": ([(48, 10)], 1, 2**-32), "group_delay_2": ([(58, 10)], 1, 2**-32),
        "e5b": ([(68, 2)], 0, 1), "sick": ([(70, 2)], 0, 1), "unsure": ([(73, 1)], 0, 1),
    },
}  # fmt: skip
# ICD GLONASS 5.1, table 4.5: bits of a string of 85, counted from its end; a sign and a size
GLONASS_BITS = {
    1: {"vx": ([(41, 24)], 2, 2**-20), "ax": ([(36, 5)], 2, 2**-30), "x": ([(9, 27)], 2, 2**-11)},
    2: {
        "sick": ([(80, 1)], 0, 1), "t_b": ([(70, 7)], 0, 900), "vy": ([(41, 24)], 2, 2**-20),
        "ay": ([(36, 5)], 2, 2**-30), "y": ([(9, 27)], 2, 2**-11),
    },
    3: {
        "clock_rate": ([(69, 11)], 2, 2**-40), "unsure": ([(65, 1)], 0, 1), "vz": ([(41, 24)], 2, 2**-20),
        "az": ([(36, 5)], 2, 2**-30), "z": ([(9, 27)], 2, 2**-11),
    },
    4: {"tau": ([(59, 22)], 2, 2**-30)},
}  # fmt: skip


def encode(fields, values, width, *, reverse=False):
    """Return an integer of so many bits with values at their places, and the values as rounded."""
    bits, kept = 0, {}
    for name, (parts, signed, unit) in fields.items():
        total = sum(count for _, count in parts)
        raw = round(values[name] / unit)
        kept[name] = raw * unit
        if signed == 2:
            raw = abs(raw) | (raw < 0) << (total - 1)
        raw &= (1 << total) - 1
        for first, count in parts:
            total -= count
            part = raw >> total & (1 << count) - 1
            bits |= part << (first - 1 if reverse else width - (first - 1) - count)
    return bits, kept


def frame(kind, payload):
    body = kind + struct.pack("<H", len(payload)) + payload
    a = b = 0
    for byte in body:  # 8-bit Fletcher, u-blox interface description
        a = (a + byte) % 256
        b = (b + a) % 256
    return b"\xb5\x62" + body + bytes((a, b))


def write_words(system, sat, signal, words, freq=0):
    head = struct.pack(
        "<8B", {GPS: 0, GALILEO: 2, BEIDOU: 3, GLONASS: 6}[system], sat, signal, freq, len(words), 1, 2, 0
    )
    return frame(b"\x02\x13", head + struct.pack(f"<{len(words)}I", *words))


def split_300(bits):
    """Return the ten words of 30 bits; the two highest bits of a word are not specified."""
    return [bits >> 30 * k & (1 << 30) - 1 | 0x40000000 for k in range(9, -1, -1)]


def epoch(tow=TOW, week=WEEK):
    return frame(b"\x02\x15", struct.pack("<dHbBB3x", tow, week, 18, 0, 0))


def draw(seed, fields, limits=()):
    """Return random values over the whole range of each field, those of an orbit within its limits."""
    draw, low_high = np.random.default_rng(seed), {
        "e": (0, 0.02), "i_0": (0.9, 1.0), "sqrt_a": (5153, 5154), "t_oe_week": (400000, 410000),
        "t_oc": (400000, 410000), "issue": (77, 77), "health": (0, 0), "ura": (0, 5), "sick": (0, 0),
        "unsure": (0, 0), "sisa": (100, 110), "sat": (12, 12), **dict(limits),
    }  # fmt: skip
    values = {}
    for part in fields.values():
        for name, (parts, signed, unit) in part.items():
            span = 2.0 ** sum(count for _, count in parts) * unit
            low, high = low_high.get(name, (-0.45 * span, 0.45 * span) if signed else (0, 0.99 * span))
            values[name] = draw.uniform(low, high)
    return values


def check_elements(sets, kept, late=0.0):
    names = "c_rs delta_n mean_anomaly c_uc e c_us sqrt_a c_ic node_0 c_is i_0 c_rc perigee node_rate i_rate"
    for name in f"{names} af_0 af_1 af_2 group_delay".split():
        assert sets.get(name)[0] == pytest.approx(kept[name], rel=1e-12, abs=1e-18), name
    assert sets.get("t_oe")[0] == pytest.approx(WEEK * 604800 + kept["t_oe_week"] + late)
    assert sets.get("t_oc")[0] == pytest.approx(WEEK * 604800 + kept["t_oc"] + late)
    assert sets.healthy.tolist() == [True]


def read(tmp_path, *messages):
    path = tmp_path / "a.ubx"
    path.write_bytes(b"".join(messages))
    return read_ubx_navigation(path)


@pytest.mark.parametrize("seed", range(5))
def test_gps_ephemerides_have_the_values_that_were_broadcast(tmp_path, seed):
    values, kept, messages = draw(seed, GPS_BITS), {}, []
    for number, fields in GPS_BITS.items():
        bits, rounded = encode(fields, values, 300)
        bits |= 0x8B << 292 | number << 300 - 52
        kept |= rounded
        messages.append(write_words(GPS, 9, 0, split_300(bits)))
    nav = read(tmp_path, *messages, epoch())  # before the receiver has the time
    check_elements(nav.gps, kept)
    assert nav.gps.sat.tolist() == [9]
    assert nav.gps.get("accuracy")[0] == pytest.approx(2 ** (1 + kept["ura"] / 2))
    assert nav.klobuchar is None
    with pytest.raises(ConfigError, match=r"a\.ubx: has no whole ephemeris \(UBX-RXM-SFRBX\) in it"):
        read(tmp_path, messages[0], messages[2], epoch())
    with pytest.raises(ConfigError, match="has no whole ephemeris"):
        read(tmp_path, *messages)  # no time
    other, _ = encode(GPS_BITS[3], values | {"issue": 78}, 300)
    changed = write_words(GPS, 9, 0, split_300(other | 0x8B << 292 | 3 << 300 - 52))
    with pytest.raises(ConfigError, match="has no whole ephemeris"):
        read(tmp_path, *messages[:2], changed, epoch())  # of two issues


def test_the_ionosphere_of_gps_is_on_page_18(tmp_path):
    names = [("alpha", k, p) for k, p in enumerate((-30, -27, -24, -24))]
    names += [("beta", k, p) for k, p in enumerate((11, 14, 16, 16))]
    places = [(69, 8), (77, 8), (91, 8), (99, 8), (107, 8), (121, 8), (129, 8), (137, 8)]
    fields = {f"{n}_{k}": ([place], 1, 2.0**p) for (n, k, p), place in zip(names, places, strict=True)}
    fields["page"] = ([(63, 6)], 0, 1)
    values = draw(3, {4: fields}, {"page": (56, 56)}.items())
    values["page"] = 56
    bits, kept = encode(fields, values, 300)
    messages = []
    for number, part in GPS_BITS.items():
        body, _ = encode(part, draw(1, GPS_BITS), 300)
        messages.append(write_words(GPS, 9, 0, split_300(body | 0x8B << 292 | number << 300 - 52)))
    page = write_words(GPS, 3, 0, split_300(bits | 0x8B << 292 | 4 << 300 - 52))
    nav = read(tmp_path, epoch(), page, *messages)
    assert_allclose(nav.klobuchar, [kept[name] for name in list(fields)[:8]])


@pytest.mark.parametrize("seed", range(5))
def test_galileo_ephemerides_have_the_values_that_were_broadcast(tmp_path, seed):
    values = draw(seed, GALILEO_BITS, {"sqrt_a": (5440, 5441)}.items())
    kept, messages = {}, []
    for number, fields in GALILEO_BITS.items():
        bits, rounded = encode(fields, values, 128)
        bits |= number << 122
        kept |= rounded
        even = bits >> 16  # 112 bits behind two zeros, six tail bits and eight of padding
        words = [even >> 82, even >> 50 & 0xFFFFFFFF, even >> 18 & 0xFFFFFFFF, (even & 0x3FFFF) << 14 | 0x3F5]
        odd = 0b10 << 30 | (bits & 0xFFFF) << 14 | 0x2ABC
        messages.append(write_words(GALILEO, 12, 1, [*words, odd, 1, 2, 3]))
    nav = read(tmp_path, epoch(), *messages)
    check_elements(nav.galileo[0], kept)
    assert nav.galileo[0].get("group_delay_2")[0] == pytest.approx(kept["group_delay_2"], rel=1e-12)
    assert nav.galileo[0].get("accuracy")[0] == pytest.approx(2.0 + 0.16 * (kept["sisa"] - 100))
    assert_allclose(nav.level, [kept["a_0"], kept["a_1"], kept["a_2"]])
    assert len(nav.galileo[1]) == 0


@pytest.mark.parametrize("seed", range(5))
def test_beidou_ephemerides_are_of_one_frame(tmp_path, seed):
    limits = {"sqrt_a": (5282, 5283), "t_oe_high": (2**18, 2**18), "t_oe_low": (140000, 141000)}
    values, kept, messages = draw(seed, BEIDOU_BITS, limits.items()), {}, []
    for number, fields in BEIDOU_BITS.items():
        bits, rounded = encode(fields, values, 300)
        bits |= 0b11100010010 << 289 | number << 300 - 18
        kept |= rounded
        messages.append(write_words(BEIDOU, 21, 4, split_300(bits)))
    kept["t_oe_week"] = kept["t_oe_high"] + kept["t_oe_low"]
    nav = read(tmp_path, epoch(), *messages)
    check_elements(nav.beidou, kept, late=14.0)
    assert nav.beidou.get("group_delay_2")[0] == pytest.approx(kept["group_delay_2"])
    with pytest.raises(ConfigError, match="has no whole ephemeris"):
        read(tmp_path, epoch(), *messages[:2], epoch(TOW + 60), messages[2])


@pytest.mark.parametrize("seed", range(5))
def test_glonass_states_have_the_values_that_were_broadcast(tmp_path, seed):
    draw_place = np.random.default_rng(seed).standard_normal(3)
    place = 25.5e3 * draw_place / np.linalg.norm(draw_place)
    limits = {axis: (x, x) for axis, x in zip("xyz", place, strict=True)} | {"t_b": (72000, 72000)}
    values, kept, messages = draw(seed, GLONASS_BITS, limits.items()), {}, []
    for number, fields in GLONASS_BITS.items():
        bits, rounded = encode(fields, values, 85, reverse=True)
        bits = (bits | number << 80) << 11
        kept |= rounded
        words = [bits >> 64, bits >> 32 & 0xFFFFFFFF, bits & 0xFFFFFFFF, 5]
        messages.append(write_words(GLONASS, 7, 0, words, freq=3))
    nav = read(tmp_path, epoch(), *messages)
    state = dict(zip(subframes.STATE, nav.glonass.state[0], strict=True))
    for name in ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az"):
        assert state[name] == pytest.approx(1e3 * kept[name], rel=1e-12), name
    assert (state["clock"], state["clock_rate"]) == pytest.approx((-kept["tau"], kept["clock_rate"]))
    moscow = 2381 * 604800 + 4 * 86400 + 72000 - 10800 + 18  # Thursday, 20:00
    assert state["t_b"] == pytest.approx(moscow)
    assert (nav.glonass.sat.tolist(), nav.glonass.channel.tolist()) == ([7], [-4])
    assert nav.glonass.healthy.tolist() == [True]


def test_the_accuracy_of_an_index():
    found = [subframes.find_ura(GALILEO, index) for index in (0, 49, 50, 74, 75, 100, 107, 125)]
    assert_allclose(found, [0.0, 0.49, 0.5, 0.98, 1.0, 2.0, 3.12, 6.0])
    assert_allclose(
        [subframes.find_ura(GPS, index) for index in (0, 1, 6, 7, 14)], [2, 2.83, 16, 32, 4096], rtol=1e-2
    )


# --- a real receiver ---------------------------------------------------------------------------------------


def test_a_receiver_is_solved_with_its_own_ephemerides(tmp_path, capsys):
    """Against its RTK fixes, whose base is off by one vector: each system alone finds the same track."""
    track = tmp_path / "fixes.csv"
    assert main(["fixes", str(WALK), "-o", str(track)]) == 0
    assert "walk-2025-08-28.ubx.gz: 2025-08-28, 34 epochs" in capsys.readouterr().out
    nav = read_ubx_navigation(WALK)
    assert nav.gps.sat.tolist() == [23, 10, 32, 27]
    assert sorted(nav.galileo[0].sat[nav.galileo[0].healthy].tolist()) == [7, 8, 13, 26, 29, 33]
    assert not nav.galileo[0].healthy[nav.galileo[0].sat == 14].any()  # on its eccentric orbit
    rows = ubx_fixes.read("ubx", WALK, "gnss", None)
    offsets = []
    for systems in ("gps", "galileo"):
        solved = bench.solve_rinex(WALK, WALK, systems=systems)
        good, t = solved.fixes.valid, solved.observations.origin + solved.observations.t
        assert good.sum() > 30
        own = np.column_stack([np.interp(t, rows.t, column) for column in rows.values["lla"].T])
        away = earth.difference_n(solved.fixes.lla, own)[good]
        offsets.append(np.median(away, axis=0))
        assert (np.std(away, axis=0) < [1.5, 1.5, 4.0]).all()
    assert np.abs(offsets[0] - offsets[1]).max() < 4.0


def test_fixes_of_a_receiver_have_the_values_that_pyubx2_reads():
    """The first of the file with pyubx2 1.4: iTOW 17:30:21.75 UTC on 2025-08-28."""
    rows = ubx_fixes.read("ubx", WALK, "gnss", None)
    assert len(rows.t) == 134
    assert rows.t[0] == pytest.approx(WEEK * 604800 + TOW)
    assert np.rad2deg(rows.values["lla"][0, :2]) == pytest.approx([40.0966916, -105.1471665], abs=1e-10)
    assert rows.values["lla"][0, 2] == pytest.approx(1580.048)
    assert rows.values["vel_n"][0] == pytest.approx([0.001, -0.002, -0.027])
    assert rows.values["sd_pos"][0] == pytest.approx([0.014 / 2**0.5, 0.014 / 2**0.5, 0.010])
    assert rows.values["sd_vel"][0] == pytest.approx([0.070 / 3**0.5] * 3)
    assert (rows.values["quality"][0], rows.values["satellites"][0]) == (1.0, 25.0)


def write_pvt(*, tow=163891000, year=2025, day=(8, 11), time=(21, 31, 13), timely=7, fix=3, flags=1, bad=0):
    head = struct.pack("<IH6BIi4B", tow, year, *day, *time, timely, 30, 0, fix, flags, 0, 20)
    place = struct.pack(
        "<4i2I5i2I2H", -1213140001, 440688002, 1234567, 1250000, 700, 900, 10, 20, 30, 22, 0, 50, 0, 95, bad
    )
    return frame(b"\x01\x07", head + place + bytes(12))


def test_high_precision_positions_and_rows_that_are_no_fix(tmp_path):
    """NAV-HPPOSLLH adds 1e-9 deg and 0.1 mm; no fix: 2D, not sound, invalid position, without a date."""
    path = tmp_path / "gnss.ubx"
    exact = struct.pack(
        "<B2xBI4i4b2I", 0, 0, 163891000, -1213140001, 440688002, 1234567, 1250000, -49, 17, 3, 0, 123, 456
    )
    rows = [write_pvt(timely=0), write_pvt(), frame(b"\x01\x14", exact), write_pvt(tow=163892000, fix=2)]
    rows += [
        write_pvt(tow=163893000, flags=0),
        write_pvt(tow=163894000, bad=1),
        write_pvt(tow=163895000, flags=0b01000011),
    ]
    path.write_bytes(b"".join(rows) + write_pvt()[:50])
    found = ubx_fixes.read("ubx", path, "gnss", None)
    assert (found.t - 2379 * 604800).tolist() == [163891.0, 163892.0, 163893.0, 163894.0, 163895.0]
    lat, lon = np.rad2deg(found.values["lla"][0, :2])
    assert (lat, lon) == pytest.approx((44.068800217, -121.314000149), abs=1e-11)
    assert found.values["lla"][0, 2] == pytest.approx(1234.5673)
    assert found.values["sd_pos"][0] == pytest.approx([0.0123 / 2**0.5] * 2 + [0.0456])
    assert np.isfinite(found.values["lla"][:, 0]).tolist() == [True, False, False, False, True]
    assert found.values["quality"].tolist() == [5.0, 5.0, 5.0, 5.0, 2.0]
    assert any("1 damaged messages" in note for note in found.notes)
    assert any("1 fixes before the receiver set its clock" in note for note in found.notes)
    with pytest.raises(ConfigError, match="is a u-blox UBX recording; put it beside a table of an IMU"):
        ubx_fixes.read("ubx", path, "imu", None)
    path.write_bytes(epoch())
    with pytest.raises(
        ConfigError, match=r"gnss\.ubx: has no fix \(UBX-NAV-PVT\); bench fixes gnss\.ubx computes"
    ):
        ubx_fixes.read("ubx", path, "gnss", None)


def test_a_damaged_stream_costs_what_is_damaged(tmp_path):
    """Cut off and with flipped bytes: an answer or one line, never anything else."""
    content, path = gzip.decompress(WALK.read_bytes()), tmp_path / "a.ubx"
    rng = np.random.default_rng(6)
    for k in range(30):
        piece = bytearray(content[: int(rng.integers(1, len(content)))] if k < 15 else content)
        for place in rng.integers(0, len(piece), 0 if k < 15 else 50):
            piece[place] ^= int(rng.integers(1, 256))
        path.write_bytes(piece)
        for use in (read_ubx_navigation, lambda p: ubx_fixes.read("ubx", p, "gnss", None), solve_alone):
            with contextlib.suppress(ConfigError):
                use(path)


def solve_alone(path):
    return bench.solve_rinex(path, path)


def test_a_table_of_an_imu_finds_the_receiver_beside_it(tmp_path, capsys):
    """The fixes go on the clock of the IMU, seconds since 1970."""
    path = tmp_path / "imu.csv"
    t = np.arange(0.0, 134.0, 0.02) + WEEK * 604800 + TOW + 315964800.0 - 18.0
    draw = np.random.default_rng(2).normal([0.0] * 5 + [-9.8], 0.01, (len(t), 6))
    rows = [",".join(f"{value:.6f}" for value in row) for row in np.column_stack([t, draw])]
    names = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
    path.write_text("\n".join([names, *rows]) + "\n")
    (tmp_path / "gnss.ubx").write_bytes(gzip.decompress(WALK.read_bytes()))
    assert main(["new", "log", str(path)]) == 0
    assert "gnss: gnss.ubx" in capsys.readouterr().out
    records = read_records(load_log(str(tmp_path / "imu.toml")))
    assert any("taken as UTC; if it counts GPS time" in note for note in records.notes)
    assert len(records.fixes.t) == 134


@pytest.mark.parametrize(("begin", "taken"), [(-18.0, "UTC"), (0.0, "GPS time"), (-40.0, "UTC")])
def test_the_clock_of_1970_is_utc_unless_gps_time_has_more_in_common(begin, taken):
    t = np.arange(100.0) + 1440437440.0
    moved = meet_week(LogRows(t, {"arrival": t + 0.1}), t[0] + 315964800 + begin, t[-1] + 315964800 + begin)
    shift = {"UTC": 315964800.0 - 18.0, "GPS time": 315964800.0}[taken]
    assert_allclose(moved.t - t, shift)
    assert_allclose(moved.values["arrival"] - t, shift + 0.1)
    assert f"taken as {taken};" in moved.notes[0]
    apart = meet_week(LogRows(t, {}), t[0] + 315964800 + 500, t[-1] + 315964800 + 900)
    assert apart.t is t
