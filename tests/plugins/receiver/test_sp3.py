"""SP3: precise orbits and clocks give the satellites that they were made of.

Oracle: Keplerian orbits and GLONASS state vectors of ESBC, each continued by its own equations; the examples
of the format's description (Hilla 2016).
"""

from __future__ import annotations

import gzip
from datetime import datetime, timedelta
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.cli.command_line import main
from bench.core.mathematics import earth
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS, LETTERS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.rinex.ephemerides import read_navigation
from bench.plugins.receiver.rinex.precise_orbits import make_tables, read_orbits, read_precise_orbits
from bench.simulation.signals import orbit_tables, orbits, receiver_solution
from bench.simulation.signals.orbits import C
from tests.data import gnss_file, stored_gnss_file

OBSERVATIONS, NAVIGATION = "ESBC00DNK_2020177_GREC_1800s.rnx.gz", "ESBC00DNK_2020177_GREC_MN.rnx.gz"
NOON = 1277121600.0  # 2020-06-25 12:00 GPS time
HOURS = 3
GLONASS_PART = 0.25  # h; its broadcast holds for 15 minutes

EXAMPLE = """\
#dV2001  8  8  0  0  0.00000000     192 ORBIT IGS97 HLM MGEX
## 1126 259200.00000000   900.00000000 52129 0.0000000000000
+    2   G01G02  0  0  0  0  0  0  0  0  0  0  0  0  0  0  0
++         7  8  0  0  0  0  0  0  0  0  0  0  0  0  0  0  0
%c G  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
%f  1.2500000  1.025000000  0.00000000000  0.000000000000000
%i    0    0    0    0      0      0      0      0         0
/* AN EXAMPLE ULTRA RAPID ORBIT, GPS ONLY.
*  2001  8  8  0  0  0.00000000
PG01 -11044.805800 -10475.672350  21929.418200    189.163300 18 18 18 219
EP    55   55   55     222  1234567 -1234567  5999999      -30       21 -1230000
VG01  20298.880364 -18462.044804   1381.387685     -4.534317 14 14 14 191
PG02 -12593.593500  10170.327650 -20354.534400    -55.976000 18 18 18 219 EP   P
EOF
"""


@cache
def pick_sets(system):
    """Return the healthy sets of ESBC nearest to noon, one for each satellite."""
    nav = read_navigation(stored_gnss_file(NAVIGATION))
    sets = nav.list_sets()[system][0]
    wanted = np.unique(sets.sat)
    rows = orbits.find_nearest(sets, wanted, np.full(len(wanted), NOON), 3600.0)
    return sets, rows[rows >= 0]


def write_sp3(path, systems=(GPS,), *, step=900.0, hours=HOURS, scale="GPS", ahead=0.0, edit=None):
    """Write an SP3 file of the sets nearest to noon; ``edit`` changes a line of a satellite or drops it."""
    t = NOON + np.arange(-hours * 3600.0, hours * 3600.0 + 1, step)
    lines, names = {k: [] for k in range(len(t))}, []
    for system in systems:
        sets, rows = pick_sets(system)
        for row in rows:
            name = f"{LETTERS[system]}{sets.sat[row]:02d}"
            names.append(name)
            found = orbits.compute_states(sets, np.full(len(t), row), t)
            eccentric = -2 * np.einsum("ki,ki->k", found.pos_e, found.vel_e) / C**2
            clock = found.clock + found.relativity - eccentric
            if system == GALILEO and sets.message == "I/NAV":  # of E1 and E5b; those of SP3 are E1 and E5a
                clock = clock - receiver_solution.find_group_delay(
                    sets, np.array([row]), np.array([[1, 5]]), True
                )
            if system == BEIDOU:  # of B3I
                clock = clock - receiver_solution.find_group_delay(
                    sets, np.array([row]), np.array([[2, 6]]), True
                )
            for k, (x, c) in enumerate(zip(found.pos_e / 1e3, 1e6 * clock, strict=True)):
                line = f"P{name}{x[0]:14.6f}{x[1]:14.6f}{x[2]:14.6f}{c:14.6f}"
                line = line if edit is None else edit(name, k, line)
                lines[k] += [line] if line else []
    first = datetime(1980, 1, 6) + timedelta(seconds=t[0] + ahead)
    rows = [" ".join(["+", f"{len(names):4d}", " ", "".join(names[:17])])]
    rows += ["+        " + "".join(names[k : k + 17]) for k in range(17, len(names), 17)]
    head = [
        f"#dP{first:%Y %m %d %H %M}  0.00000000 {len(t):7d} ORBIT IGS14 FIT TEST",
        f"## 2111 345600.00000000 {step:14.8f} 59025 0.0000000000000",
        *rows,
        *(f"++       {'  0' * 17}" for _ in rows),
        f"%c M  cc {scale} ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
    ]
    for k in range(len(t)):
        now = datetime(1980, 1, 6) + timedelta(seconds=t[k] + ahead)
        head += [f"*  {now:%Y %m %d %H %M} {now.second:11.8f}", *lines[k]]
    path.write_text("\n".join([*head, "EOF", ""]))
    return path


def test_the_examples_of_the_format(tmp_path):
    (tmp_path / "a.sp3").write_text(EXAMPLE)
    found = read_precise_orbits(tmp_path / "a.sp3")
    assert found.names == ("G01", "G02")
    assert found.t.tolist() == [(datetime(2001, 8, 8) - datetime(1980, 1, 6)).total_seconds()]
    assert_allclose(found.values[0, 0, :3], [-11044805.8, -10475672.35, 21929418.2])
    assert_allclose(found.values[0, 0, 3:], [189.1633e-6, 0.128, 0, 0])  # 2^7 mm
    assert_allclose(found.values[1, 0, 3:], [-55.976e-6, np.hypot(0.256, 0.45), 0, 1])
    old = EXAMPLE.replace("#dV", "#aP").replace("PG0", "P  ").replace("G01G02", "  1  2")
    (tmp_path / "b.sp3").write_text(old)
    again = read_precise_orbits(tmp_path / "b.sp3")
    assert_allclose(again.values, found.values)
    assert again.names == found.names


@pytest.mark.parametrize("system", [GPS, GLONASS, GALILEO, BEIDOU])
def test_satellites_are_those_of_the_equations_of_motion(tmp_path, system):
    """Between epochs, in the middle and at the ends: position, velocity, clock, its rate and relativity."""
    hours = GLONASS_PART if system == GLONASS else HOURS
    step = 60.0 if system == GLONASS else 900.0
    nav = read_orbits([write_sp3(tmp_path / "day.sp3", [system], hours=hours, step=step)])
    [table] = nav.precise
    sets, rows = pick_sets(system)
    for t_0, most in (
        (NOON + 0.5 * step, 1e-3),
        (NOON - 0.98 * hours * 3600, 2e-2),
        (NOON + 0.98 * hours * 3600, 2e-2),
    ):
        t = np.full(len(rows), t_0)
        place = orbit_tables.find_rows(table, sets.sat[rows], t)
        assert (place >= 0).all()
        got, expected = orbit_tables.compute_states(table, place, t), orbits.compute_states(sets, rows, t)
        assert np.abs(got.pos_e - expected.pos_e).max() < most  # written to 1 mm
        assert np.abs(got.vel_e - expected.vel_e).max() < 6e-5
        if system == GLONASS:
            continue
        assert C * np.abs(got.relativity - expected.relativity).max() < 0.03  # its form for an ellipse
        assert C * np.abs(got.clock_rate - expected.clock_rate).max() < 3e-4


@pytest.fixture(scope="module")
def sp3(tmp_path_factory):
    return write_sp3(tmp_path_factory.mktemp("sp3") / "day.sp3", (GPS, GALILEO, BEIDOU))


@pytest.mark.parametrize("ionosphere", ["klobuchar", "free"])
def test_ranges_are_corrected_as_by_the_messages(sp3, ionosphere):
    """Orbit, clock, relativity and group delays together, of messages that SP3 was made of: mm."""
    files = stored_gnss_file(OBSERVATIONS), stored_gnss_file(NAVIGATION)
    options = {"systems": "gps,galileo,beidou", "ionosphere": ionosphere}
    one = bench.solve_rinex(files[0], [files[1], sp3], **options)
    two = bench.solve_rinex(*files, **options)
    assert one.observations.t.tolist() == two.observations.t.tolist()
    nearest = np.argmin(np.abs(one.observations.origin + one.observations.t - NOON))
    a, b = one.seen, two.seen
    rows = np.flatnonzero((a.epoch == nearest) & np.isfinite(a.sat_clock) & np.isfinite(b.sat_clock))
    for system in (GPS, GALILEO, BEIDOU):
        assert (a.system[rows] == system).sum() >= 4
    near = np.abs(a.sat_pos_e - b.sat_pos_e)[rows].max(axis=1) < 0.01
    assert near.mean() > 0.9  # the others have a later message
    rows = rows[near]
    apart = np.abs((a.sat_clock - a.group_delay) - (b.sat_clock - b.group_delay))[rows]
    assert np.isfinite(apart).mean() > 0.5
    other = (ionosphere == "free") & (a.system[rows] == GALILEO)  # F/NAV against I/NAV
    assert np.nanmax(apart[~other]) < 0.01
    assert np.nanmax(apart) < 0.3
    assert np.abs(a.sat_vel_e - b.sat_vel_e)[rows].max() < 1e-4
    assert (a.sd_pseudorange[rows] < b.sd_pseudorange[rows] + 1e-9).mean() > 0.9


def replace_place(line, km):
    return line[:4] + f"{km:14.6f}" * 3 + line[46:]


def find_gaps(tmp_path, name, edit, sat=5):
    """Return at which quarters after each epoch a satellite has no state, and the file."""
    path = write_sp3(tmp_path / name, edit=edit)
    file = read_precise_orbits(path)
    [table] = make_tables([file])
    t = table.t[:-1] + 225.0
    place = orbit_tables.find_rows(table, np.full(len(t), sat), t)
    return np.flatnonzero(place < 0).tolist(), file


def test_nothing_is_interpolated_over_a_gap_an_event_or_a_manoeuvre(tmp_path):
    """A clock is linear between two epochs; an orbit needs ten, of which the first and last ones are few."""
    count = 2 * HOURS * 4 + 1

    def change(k_0, change_line):
        return lambda name, k, line: change_line(line) if (name, k) == ("G05", k_0) else line

    assert find_gaps(tmp_path, "a.sp3", None)[0] == []
    gaps, file = find_gaps(tmp_path, "b.sp3", change(12, lambda line: line[:46] + " 999999.999999"))
    assert gaps == [11, 12]
    assert "has no clock at this many of its 25 epochs: G05 1" in file.gaps[0]
    assert find_gaps(tmp_path, "c.sp3", change(12, lambda line: line.ljust(74) + "E"))[0] == [11]
    gaps, file = find_gaps(
        tmp_path, "d.sp3", change(12, lambda line: line[:4] + "      0.000000" * 3 + line[46:])
    )
    assert gaps == list(range(7, 17))
    assert "has no orbit at this many" in file.gaps[0]
    assert find_gaps(tmp_path, "e.sp3", change(12, lambda line: line.ljust(78) + "M"))[0] == list(
        range(7, 16)
    )
    assert find_gaps(tmp_path, "f.sp3", change(12, lambda line: ""))[0] == list(range(7, 17))
    assert find_gaps(tmp_path, "g.sp3", None, sat=44)[0] == list(range(count - 1))


def cut_sp3(source, path, start, stop, edit=lambda line: line):
    """Write the epochs from ``start`` to before ``stop`` of a file."""
    text = source.read_text().split("\n*  ")
    path.write_text(
        "\n*  ".join([text[0], *map(edit, text[1:][start:stop])]).removesuffix("\nEOF\n") + "\nEOF\n"
    )
    return path


def assert_same(got, expected):
    assert [table.system for table in got] == [table.system for table in expected]
    for one, other in zip(got, expected, strict=True):
        for name in ("sat", "t", "pos_e", "clock", "sd", "joined"):
            a, b = getattr(one, name), getattr(other, name)
            assert np.array_equal(a, b, equal_nan=a.dtype == float), name


def test_two_files_are_one_table_and_times_are_those_of_their_system(tmp_path):
    whole = write_sp3(tmp_path / "whole.sp3")
    parts = [cut_sp3(whole, tmp_path / "two.sp3", 13, 25), cut_sp3(whole, tmp_path / "one.sp3", 0, 14)]
    [alone] = read_orbits([whole]).precise
    assert_same(read_orbits(parts).precise, [alone])
    for scale, ahead in (("UTC", -18.0), ("TAI", 19.0), ("BDT", -14.0), ("GAL", 0.0)):
        other = write_sp3(tmp_path / "other.sp3", scale=scale, ahead=ahead)
        assert np.array_equal(read_precise_orbits(other).t, alone.t)


def test_files_of_single_systems_and_of_other_hours_are_those_of_all(tmp_path):
    """Each system has its own epochs: a table that went on beside the other's would lose intervals."""
    both = write_sp3(tmp_path / "both.sp3", (GPS, GALILEO))
    gps = write_sp3(tmp_path / "gps.sp3")
    galileo = write_sp3(tmp_path / "gal.sp3", [GALILEO])
    assert_same(read_orbits([gps, galileo]).precise, read_orbits([both]).precise)
    short = cut_sp3(galileo, tmp_path / "short.sp3", 6, 18)
    assert_same(
        read_orbits([gps, short]).precise, [*read_orbits([gps]).precise, *read_orbits([short]).precise]
    )


def test_of_several_values_of_a_satellite_the_first_that_is_one_counts(tmp_path):
    """Midnight is in two files, in the first without clocks; orbits are those of the first."""
    whole = write_sp3(tmp_path / "whole.sp3")

    def blank(text):
        rows = [row[:46] + " 999999.999999" if row.startswith("P") else row for row in text.split("\n")]
        return "\n".join(rows) if "12 00  0.0" in rows[0] else text

    def move(text):
        rows = [row[:16] + "99" + row[18:] if row.startswith("PG05") else row for row in text.split("\n")]
        return "\n".join(rows)

    one = cut_sp3(whole, tmp_path / "one.sp3", 0, 13, blank)
    two = cut_sp3(whole, tmp_path / "two.sp3", 12, 25, move)
    [joined], [alone] = (read_orbits(paths).precise for paths in ([one, two], [whole]))
    assert joined.joined.all()
    assert np.array_equal(joined.clock, alone.clock)
    moved = np.abs(joined.pos_e - alone.pos_e).max(axis=2) > 0
    assert not moved[:, :13].any()
    assert moved[joined.sat == 5, 13:].all()


def test_files_of_other_steps_and_gaps_are_tables_of_their_own(tmp_path):
    coarse, fine = write_sp3(tmp_path / "a.sp3"), write_sp3(tmp_path / "b.sp3", hours=1, step=300.0)
    far = tmp_path / "far.sp3"
    far.write_text(coarse.read_text().replace("2020 06 25", "2021 06 25"))
    late = write_sp3(tmp_path / "late.sp3", scale="BDT")  # its quarters of an hour are others
    files = [fine, coarse, far, late]
    assert_same(read_orbits(files).precise, [read_orbits([path]).precise[0] for path in files])
    observations = stored_gnss_file(OBSERVATIONS)
    options = {"systems": "gps", "ionosphere": "free"}
    best, both, other = (
        bench.solve_rinex(observations, paths, **options) for paths in (coarse, [fine, coarse, far], fine)
    )
    hour = np.isfinite(other.seen.sat_clock)
    assert 0 < hour.sum() < np.isfinite(best.seen.sat_clock).sum()
    for solved, rows in ((other, hour), (best, ~hour)):
        assert np.array_equal(both.seen.sat_pos_e[rows], solved.seen.sat_pos_e[rows], equal_nan=True)


def test_a_file_that_serves_no_satellite_says_why(tmp_path):
    """Beside a good one: a line for the system; alone: the error with the hours and what was left out."""
    gps, galileo = write_sp3(tmp_path / "gps.sp3"), write_sp3(tmp_path / "gal.sp3", [GALILEO])
    later, short = tmp_path / "later.sp3", cut_sp3(gps, tmp_path / "short.sp3", 0, 8)
    later.write_text(gps.read_text().replace("2020 06 25", "2021 06 25"))
    short.write_text(short.read_text().removesuffix("EOF\n"))
    few = f"{short}: no orbit for GPS: has 8 epochs in a row; 10 are needed"
    wrong = f"{later}: 2021-06-25 09:00 to 15:00, no orbit for GPS at the times observed"
    observations, options = stored_gnss_file(OBSERVATIONS), {"systems": "gps,galileo", "ionosphere": "free"}
    for path, note in ((later, wrong), (short, few), (gps, None)):
        solved = bench.solve_rinex(observations, [path, galileo], **options)
        assert [line for line in solved.notes if "no orbit for" in line] == ([note] if note else [])
    solved = bench.solve_rinex(observations, [later, galileo], systems="galileo", ionosphere="free")
    assert not any("no orbit for" in line for line in solved.notes)
    with pytest.raises(ConfigError, match="short") as error:
        bench.solve_rinex(observations, short, **options)
    said = str(error.value)
    assert said.startswith(f"{short}: its ephemerides, 2020-06-25 09:00 to 10:45, fit no satellite of ")
    assert f"2020-06-25 00:00 to 23:30; {few}; {short}: line" in said
    assert said.endswith("the file ends without EOF after 8 of 25 epochs")


DAMAGED = {
    "version": (lambda text: text.replace("#dP", "#zP", 1), "line 1: must begin with '#', a version"),
    "empty": (lambda text: text[: text.index("*  ")] + "EOF\n", "the file ends before the first epoch"),
    "header only": (lambda text: text[:200], "the file ends before the first epoch"),
    "time system": (lambda text: text.replace("GPS ccc", "XYZ ccc"), "time system must be one of GPS"),
    "nothing": (lambda text: text.replace("\nPG", "\nPS"), "has no position of a satellite of GPS"),
}
LEFT_OUT = {
    "number": (lambda line, k: line.replace(line[4:18], "      xyz     "), "x must be a number; got 'xyz'"),
    "radius": (
        lambda line, k: replace_place(line, 1.0),
        "a radius of 2 km is outside 20000",
    ),
    "name": (lambda line, k: "PG?5" + line[4:], "a satellite must be a letter and two digits; got 'G?5'"),
    "short": (lambda line, k: line[:30], "z must be a number; got ''"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_broken_file_gets_one_line(tmp_path, case):
    edit, words = DAMAGED[case]
    path = write_sp3(tmp_path / "day.sp3")
    path.write_text(edit(path.read_text()))
    with pytest.raises(ConfigError, match=r"day\.sp3") as error:
        read_precise_orbits(path)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("case", LEFT_OUT)
def test_a_broken_record_is_left_out_with_its_line(tmp_path, case):
    edit, words = LEFT_OUT[case]
    gaps, file = find_gaps(
        tmp_path, "day.sp3", lambda name, k, line: edit(line, k) if (name, k) == ("G05", 12) else line
    )
    assert gaps == list(range(7, 17))
    assert file.lost == 1
    assert words in file.reasons[0]
    assert "day.sp3: line" in file.reasons[0]


def test_cut_off_and_repeated_epochs(tmp_path):
    path = write_sp3(tmp_path / "day.sp3")
    text = path.read_text().splitlines()
    starts = [k for k, line in enumerate(text) if line.startswith("*")]
    path.write_text("\n".join(text[: starts[20] + 5]))
    file = read_precise_orbits(path)
    assert len(file.t) == 21
    assert "the file ends without EOF after 21 of 25 epochs" in file.reasons[0]
    path.write_text("\n".join([*text[: starts[3]], *text[starts[1] : starts[2]], *text[starts[3] :]]))
    file = read_precise_orbits(path)
    assert len(file.t) == 25
    assert file.lost == 1
    assert "the times of epochs must increase" in file.reasons[0]


def test_bench_fixes_with_sp3(sp3, tmp_path, capsys):
    """Packed, by its content; without messages it needs two carriers, or knows what it does not know."""
    observations, navigation = str(stored_gnss_file(OBSERVATIONS)), str(stored_gnss_file(NAVIGATION))
    packed = tmp_path / "orbits.gz"
    packed.write_bytes(gzip.compress(sp3.read_bytes()))
    assert main(["fixes", str(packed), observations, navigation, "--systems", "gps,galileo"]) == 0
    said = capsys.readouterr().out
    assert "too few satellites with an ephemeris or orbit of that time" in said  # SP3 has six of the hours
    assert main(["fixes", str(sp3), observations]) == 0
    assert "has no ionosphere parameters: --ionosphere free, the" in capsys.readouterr().out
    free = bench.solve_rinex(observations, sp3, systems="gps", ionosphere="free").figures()
    beside = bench.solve_rinex(observations, [sp3, navigation], systems="gps", ionosphere="free").figures()
    assert free == pytest.approx(beside, rel=1e-4)
    alone = bench.solve_rinex(observations, sp3, systems="gps", ionosphere="none")
    beside = bench.solve_rinex(observations, [sp3, navigation], systems="gps", ionosphere="none")
    rows = np.isfinite(alone.seen.sat_clock)
    more = alone.seen.sd_pseudorange[rows] ** 2 - beside.seen.sd_pseudorange[rows] ** 2
    unknown = np.array([2.3, 1.4, 3.2, 7.7])[alone.seen.system[rows]]
    assert np.isclose(more, unknown**2, rtol=0.01).mean() > 0.99  # one has no elevation


def test_a_real_day_agrees_with_the_messages_and_is_better(tmp_path):
    """Orbits of CODE beside the messages of 15 minutes: 1 m apart, but G28, whose message errs by 4 m."""
    observations, navigation, table = (
        stored_gnss_file(name)
        for name in (
            "SEPT_2021078_1200_15M_30S_MO.rnx.gz",
            "SEPT_2021078_1200_15M_MN.rnx.gz",
            "COD0IGSRAP_20210780000_15M_ORB.SP3.gz",
        )
    )
    truth = np.array([-3962108.6617, 3381309.5232, 3668678.6410])  # surveyed
    broadcast, precise = (
        bench.solve_rinex(observations, files, ionosphere="free")
        for files in ([navigation], [navigation, table])
    )
    used = broadcast.solution.used & precise.solution.used
    assert used.sum() == broadcast.solution.used.sum()
    a, b = broadcast.seen, precise.seen
    apart = np.linalg.norm(a.sat_pos_e - b.sat_pos_e, axis=1)[used]
    assert 0.4 < np.median(apart) < 1.2
    assert apart.max() < 2.2
    medians = [
        np.median(np.linalg.norm(earth.to_ecef(one.fixes.lla) - truth, axis=1))
        for one in (broadcast, precise)
    ]
    assert medians[1] < 0.7 < medians[0]
    rms = [
        {one.name: one.residual_rms for one in solved.list_satellites()}["G28"]
        for solved in (broadcast, precise)
    ]
    assert rms[0] > 4.0
    assert rms[1] < 1.6


def test_glonass_needs_its_channels(tmp_path):
    path = write_sp3(tmp_path / "day.sp3", (GPS, GLONASS), hours=GLONASS_PART, step=60.0)
    files = gnss_file("ESBC00DNK_2020177_GR_360s.rnx"), stored_gnss_file(NAVIGATION)
    options = {"systems": "both", "ionosphere": "free"}
    alone = bench.solve_rinex(files[0], path, **options)
    assert any("GLONASS needs a navigation file beside SP3" in note for note in alone.notes)
    assert not any("no orbit for" in note for note in alone.notes)
    assert np.isnan(alone.seen.sat_clock[alone.seen.system == GLONASS]).all()
    beside = bench.solve_rinex(files[0], [path, files[1]], **options)
    broadcast = bench.solve_rinex(*files, **options)
    near = np.argmin(np.abs(beside.observations.origin + beside.observations.t - NOON))
    a, b = beside.seen, broadcast.seen
    rows = np.flatnonzero((a.epoch == near) & (a.system == GLONASS) & np.isfinite(a.sat_clock + b.sat_clock))
    assert len(rows) >= 4
    assert np.abs(a.sat_pos_e - b.sat_pos_e)[rows].max() < 0.01
    assert np.abs(a.sat_clock - b.sat_clock)[rows].max() < 0.01
    assert_allclose(a.frequency[rows], b.frequency[rows])
