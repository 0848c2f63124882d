"""Raw measurements of phones: against the RINEX that the same program wrote, and against known ranges."""

from __future__ import annotations

import contextlib
import gzip

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.core.mathematics import earth
from bench.core.records.orbit_sets import LETTERS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams.android_log import read_android
from bench.plugins.receiver.rinex.observations import read_observations
from bench.simulation.signals import orbits
from tests.data import stored_gnss_file

PHONE = stored_gnss_file("gnsslogger-2023-11-07.txt.gz")
ESBC = ("ESBC00DNK_2020177_GREC_1800s.rnx.gz", "ESBC00DNK_2020177_GREC_MN.rnx.gz")
WRITTEN = {
    "G04": (23486031.359, -3555.811), "G05": (24230151.016, 1114.347), "G07": (20925307.911, 32.757),
    "G08": (21963818.665, 156.808), "G09": (21098826.586, -2447.218), "G14": (22072800.418, 2470.440),
    "R02": (19471865.208, -1844.106), "R13": (20027911.565, 697.662), "R01": (22808550.469, -4590.220),
    "E07": (24249151.562, -1948.415), "E19": (26976344.365, 2368.388), "E27": (23308482.573, 23.045),
}  # fmt: skip
"""Range [m] and Doppler [Hz] in pixel6.23o of gnss_lib_py, 1 s after the fourth epoch."""
CHANNELS = {"R02": -4, "R13": -2, "R01": 1}
NAMES = (
    "Raw,utcTimeMillis,TimeNanos,LeapSecond,TimeUncertaintyNanos,FullBiasNanos,BiasNanos,"
    "HardwareClockDiscontinuityCount,Svid,TimeOffsetNanos,State,ReceivedSvTimeNanos,"
    "ReceivedSvTimeUncertaintyNanos,Cn0DbHz,PseudorangeRateMetersPerSecond,AccumulatedDeltaRangeState,"
    "AccumulatedDeltaRangeMeters,CarrierFrequencyHz,ConstellationType"
)


def test_ranges_are_those_of_the_rinex_that_the_program_wrote():
    """It takes the bias of each epoch, bench the first: one difference for all satellites, and noise."""
    raw = read_android(PHONE)
    assert raw.origin + raw.t == pytest.approx(1383435812.0002733 + 18.0 * np.arange(5), abs=1e-6)
    assert raw.lost == 0
    rows = range(raw.epoch_start[3], raw.epoch_start[4])
    found = {f"{LETTERS[raw.system[k]]}{raw.sat[k]:02d}": k for k in rows}
    frequency = {n: 1602e6 + 562.5e3 * CHANNELS[n] if n[0] == "R" else 1575.42e6 for n in WRITTEN}
    apart = []
    for name, (distance, doppler) in WRITTEN.items():
        assert raw.doppler[found[name], 0] == pytest.approx(doppler, abs=8.0)
        apart.append(raw.pseudorange[found[name], 0] - distance - doppler * orbits.C / frequency[name])
    drift = 129e-9 * 54 * orbits.C  # DriftNanosPerSecond over three epochs
    assert np.median(apart) == pytest.approx(drift, rel=0.05)
    assert np.abs(apart - np.median(apart)).max() < 12.0
    assert {LETTERS[k] for k in raw.system} == {"G", "R", "E"}
    assert raw.band[found["E07"]].tolist() == [1, 5]
    assert raw.band[found["G08"]].tolist() == [1, 0]
    assert raw.sd[found["G04"], 0] == pytest.approx(16e-9 * orbits.C)


def write_phone(path, *, shift=0, edit=lambda fields: fields, bias=12.25):
    """Write the ranges of ESBC as a phone measures them; return the names of the satellites left out."""
    raw = read_observations(stored_gnss_file(ESBC[0]))
    lines, start, count = [f"# {NAMES}"], 10**9, 0
    constellation = {"G": 1, "R": 3, "E": 6, "C": 5}
    full = -round(raw.origin + raw.t[0]) * 10**9 + start
    for m, t in enumerate(raw.t):
        if m == 20:  # the clock of the phone begins anew
            full, count, start = full + shift, 1, start + shift
        clock = start + round((t - raw.t[0]) * 1e9)
        now = clock - full
        for k in range(raw.epoch_start[m], raw.epoch_start[m + 1]):
            letter = LETTERS[raw.system[k]]
            if not np.isfinite(raw.pseudorange[k, 0]):
                continue
            sent = now - round(raw.pseudorange[k, 0] / orbits.C * 1e9 + bias)
            sent += {"R": 10800 - 18, "C": -14}.get(letter, 0) * 10**9
            period = (86400 if letter == "R" else 604800) * 10**9
            state = 1 | 128 if letter == "R" else 1 | 8
            frequency = {"G": 1575.42e6, "E": 1575.42e6, "R": 1602e6, "C": 1561.098e6}[letter]
            fields = [
                "Raw", 0, clock, 18, "", full, bias, count, raw.sat[k], 0.0, state,
                sent % period, 1, raw.cn0[k, 0], -raw.doppler[k, 0] * orbits.C / frequency, 0, 0.0, frequency,
                constellation[letter],
            ]  # fmt: skip
            lines.append(",".join(str(one) for one in edit(fields)))
    path.write_text("\n".join(lines) + "\n")
    return raw


@pytest.mark.parametrize("shift", [0, 7_300_000_000_000])
def test_known_ranges_come_back_and_give_the_fixes_of_their_rinex(tmp_path, shift):
    """To the nanoseconds of the log, 0.3 m; also if the clock of the phone jumps."""
    path = tmp_path / "phone.txt"
    raw, found = write_phone(path, shift=shift), read_android(path)
    rows = np.isfinite(raw.pseudorange[:, 0])
    assert_allclose(found.pseudorange[:, 0], raw.pseudorange[rows, 0], atol=0.5)
    assert found.sat.tolist() == raw.sat[rows].tolist()
    assert_allclose(found.origin + found.t, raw.origin + raw.t, atol=1e-6)
    nav = stored_gnss_file(ESBC[1])
    solved, expected = bench.solve_rinex(path, nav), bench.solve_rinex(stored_gnss_file(ESBC[0]), nav)
    away = earth.difference_n(solved.fixes.lla, expected.fixes.lla)
    assert solved.fixes.valid.all()
    assert np.abs(away).max() < 1.0


@pytest.mark.parametrize(
    ("edit", "kept"),
    [
        (lambda f: [*f[:10], f[10] | 16, *f[11:]], 0),  # milliseconds are not known
        (lambda f: [*f[:10], f[10] & ~1, *f[11:]], 0),  # no lock
        (lambda f: [*f[:10], 1, *f[11:]], 0),  # no time
        (lambda f: [*f[:10], 1 << 10 | 1 << 14 | 1 << 15, *f[11:]], 1),  # as newer phones say it
        (lambda f: [*f[:12], 1000000000, *f[13:]], 0),  # as long as there is no time of transmission
        (lambda f: [*f[:17], 1207140000, f[18]], 0),  # another carrier
        (lambda f: [*f[:17], "", f[18]], 1),  # a phone of one carrier
        (lambda f: [*f[:18], 4], 0),  # QZSS
    ],
)
def test_measurements_that_are_no_range_are_left_out(tmp_path, edit, kept):
    path = tmp_path / "phone.txt"
    write_phone(path, edit=edit)
    if kept:
        assert len(read_android(path).sat) > 500
    else:
        with pytest.raises(ConfigError, match=r"phone\.txt: has no range of GPS, GLONASS"):
            read_android(path)


def test_a_log_without_what_is_needed_gets_one_line(tmp_path):
    path = tmp_path / "phone.txt"
    write_phone(path, edit=lambda f: [*f[:5], "", *f[6:]])
    with pytest.raises(ConfigError, match="has no line Raw with a clock bias"):
        read_android(path)
    path.write_text(f"# {NAMES.replace('State,', 'Status,')}\n")
    with pytest.raises(ConfigError, match="has no column State in the lines Raw"):
        read_android(path)


def test_a_wide_uncertainty_takes_weight(tmp_path):
    """A range whose time of transmission is known to 100 ns counts as 30 m."""
    path, nav = tmp_path / "phone.txt", stored_gnss_file(ESBC[1])
    write_phone(path, edit=lambda f: [*f[:12], 100, *f[13:]] if f[18] == 6 else f)
    found = bench.solve_rinex(path, nav)
    galileo = found.seen.system == 2
    assert np.median(found.seen.sd_pseudorange[galileo]) > 25.0
    assert np.median(found.seen.sd_pseudorange[~galileo]) < 5.0


def test_a_damaged_log_costs_what_is_damaged(tmp_path):
    content, path, rng = gzip.decompress(PHONE.read_bytes()), tmp_path / "a.txt", np.random.default_rng(1)
    for k in range(40):
        piece = bytearray(content[: int(rng.integers(1, len(content)))] if k < 20 else content)
        for place in rng.integers(0, len(piece), 0 if k < 20 else 50):
            piece[place] ^= int(rng.integers(1, 256))
        path.write_bytes(piece)
        with contextlib.suppress(ConfigError):
            read_android(path)
