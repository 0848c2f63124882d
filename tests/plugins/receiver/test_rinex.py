"""RINEX and YUMA files: real ones solve to the medians of an independent computation, broken ones one line.

Real data: stations ESBC (EUREF, via nav-solutions/data) and 0759 (GSI, via RTKLIB), broadcast ephemerides of
CDDIS (via RTKLIB), in tests/data/gnss.
"""

from __future__ import annotations

import codecs
import re
import tracemalloc
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.cli.command_line import main
from bench.core.files import durable
from bench.core.mathematics import earth
from bench.core.records.orbit_sets import KEPLER, STATE
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver import almanac, rinex_fixes
from bench.plugins.receiver.receiver_plots import find_middle
from bench.plugins.receiver.rinex import codes, ephemerides, lines, observations
from bench.simulation.signals.processing import ErrorBudget, Processing
from tests.data import gnss_file

ESBC = ("ESBC00DNK_2020177_GR_360s.rnx", "ESBC00DNK_2020177_GR_MN.rnx")
JAPAN = ("07590920.05o", "07590920.05n")

OBS_3 = """\
     3.05           OBSERVATION DATA    M                   RINEX VERSION / TYPE
HERE                                                        MARKER NAME
  4186000.0000   835000.0000  4723000.0000                  APPROX POSITION XYZ
G    4 C1C C2W D1C S1C                                      SYS / # / OBS TYPES
R    2 C1C S1C                                              SYS / # / OBS TYPES
  2020     6    25     0     0    0.0000000     GPS         TIME OF FIRST OBS
                                                            END OF HEADER
> 2020 06 25 00 00 00.0000000  0  3
G05  20947300.931 8  20947300.413 9     -1037.205 8        50.500
J03  23947300.931 8
R24  21947300.931 8        41.000
> 2020 06 25 00 00 30.5000000  4  1
A NEW COMMENT                                               COMMENT
> 2020 06 25 00 01 00.0010000  0  1
G05  20947301.931                     -1037.205
"""

OBS_2 = (
    """\
     2.10           OBSERVATION DATA    M                   RINEX VERSION / TYPE
     6    L1    C1    L2    P2    D1    S1                  # / TYPES OF OBSERV
                                                            END OF HEADER
 05  4  2  0  0  0.0000000  0 13G 3G 7G 8G11G19G20G24G28G 1G 2G 4G 5
                                R 6
"""
    + 13 * ("  55923622.160    24767686.375    43647388.2424   24767684.8224     -1037.205\n        45.000\n")
)

NAV_2 = """\
     2              NAVIGATION DATA                         RINEX VERSION / TYPE
                                                            END OF HEADER
 1 12 10 31  0  0  0.0 0.280183739960D-03 0.170530256582D-11 0.000000000000D+00
    0.160000000000D+02-0.343750000000D+02 0.477555606394D-08-0.712852183121D+00
   -0.175461173058D-05 0.135910103563D-02 0.710599124432D-05 0.515370994186D+04
    0.259200000000D+06 0.204890966415D-07 0.229351786584D+01 0.149011611938D-07
    0.960012929923D+00 0.242218750000D+03 0.504015801138D+00-0.808212236712D-08
   -0.432160858377D-09 0.000000000000D+00 0.171200000000D+04 0.000000000000D+00
    0.200000000000D+01 0.000000000000D+00 0.838190317154D-08 0.160000000000D+02
    0.252000000000D+06 0.400000000000D+01 0.499063314480-269 0.000000000000D+00
"""

NAV_R = """\
     2.10           G: GLONASS NAV DATA                     RINEX VERSION / TYPE
                                                            END OF HEADER
 3 12 10 31  0 15  0.0-1.236097887158D-04 0.000000000000D+00 1.077000000000D+04
   -2.380982128906D+04 2.289457321167D-01-3.725290298462D-09 0.000000000000D+00
   -8.908935546875D+03 2.536134719849D-01 9.313225746155D-10 5.000000000000D+00
    2.209434082031D+03 3.556049346924D+00-1.862645149231D-09 0.000000000000D+00
"""

YUMA = """\
******** Week 149 almanac for PRN-01 ********
ID:                         01
Health:                     000
Eccentricity:               0.1139211655E-001
Time of Applicability(s):  405504.0000
Orbital Inclination(rad):   0.9867355387
Rate of Right Ascen(r/s):  -0.7886042771E-008
SQRT(A)  (m 1/2):           5153.623047
Right Ascen at Week(rad):  -0.1912602899E+001
Argument of Perigee(rad):   0.881498914
Mean Anom(rad):            -0.2769097477E+001
Af0(s):                     0.4291534424E-003
Af1(s/s):                  -0.1091393642E-010
week:                        149
"""


def written(folder, text, name="file"):
    path = folder / name
    path.write_text(text, encoding="latin-1")
    return path


# --- what real files give ----------------------------------------------------------------------------------


@cache
def solved(files, **options):
    without = [*filter(None, [options.pop("without", None)])]
    return bench.solve_rinex(gnss_file(files[0]), gnss_file(files[1]), without=without, **options)


def test_the_middle_of_fixes_on_both_sides_of_the_date_line_is_between_them():
    lon = 180.0 + np.array([-2e-5, -1e-5, 1e-5, 2e-5, 3e-5])
    lla = np.column_stack([np.full(5, -0.3), np.radians((lon + 180.0) % 360.0 - 180.0), np.arange(5.0)])
    assert_allclose(find_middle(lla), [-0.3, np.radians(-180.0 + 1e-5), 2.0], atol=1e-12)
    lla[:, 1] = np.radians(lon - 160.0)
    assert_allclose(find_middle(lla), np.median(lla, axis=0), atol=1e-12)


def test_the_report_of_fixes_shows_the_figures_and_where_they_lie(tmp_path):
    from bench.plugins.receiver import fixes_page

    known = solved(ESBC)
    durable.write(tmp_path / "fixes.html", fixes_page.make_page(known))
    text = (tmp_path / "fixes.html").read_text()
    figures = known.figures()
    assert (
        f'title="horizontal_95_m">horizontal, 95 % below [m]</th><td>{figures["horizontal_95_m"]:.4g}</td>'
        in text
    )
    assert "Errors are relative to the position in the header of the file" in text
    north = known.errors()[known.fixes.valid, 0]
    assert "north position [m]: ±3σ, as computed" in text
    assert f"fix {north.min():.3g} to {north.max():.3g}" in text
    assert "Track from above, north up" in text
    for title in (
        "residuals of GLONASS ranges [m]",
        "C/N0 of GPS satellites [dB-Hz]",
        "Dilution of precision",
    ):
        assert title in text
    worst = max(known.list_satellites(), key=lambda one: one.residual_rms)
    row = f'<th scope="row">{worst.name}</th><td>{worst.epochs}</td><td>{worst.excluded}</td>'
    assert f"{row}<td>{worst.residual_rms:.4g}</td>" in text
    assert known.judge()[1] in text.replace("&#39;", "'")
    assert "Times are hours since 0:00 of 2020-06-25, GPS time." in text
    begin, end = (
        float(x) for x in re.search(r'data-edges="([\d.]+) ([\d.]+) [^"]*" data-unit="h"', text).groups()
    )
    assert (begin, end) == (0.0, pytest.approx(known.observations.t[-1] / 3600.0))
    assert re.search(r"2020-06-25 00:00:00 to \d\d:\d\d:\d\d GPS time", text)
    word = "consistent" if 0.5 <= figures["nees_3"] <= 1.6 else "overconfident"
    assert f'<span class="word">{word}</span>' in text
    assert f"horizontal error {figures['horizontal_median_m']:.1f} m (half of the fixes)" in text
    across = [float(r) for r in re.findall(r'<circle class="bar" [^>]* r="([\d.]+)"', text)]
    wide = float(re.search(r"north up, ([\d.]+) m wide", text)[1])
    errors = [figures["horizontal_median_m"], figures["horizontal_95_m"]]
    assert [one / 420 * wide for one in across] == pytest.approx(errors, rel=1e-3)


def figures_of(files, **options):
    return solved(files, **options).figures()


@cache
def weighted_by_elevation(files, systems, ionosphere="klobuchar", without=()):
    """Return the figures with the weights of the independent computation, and without a test of residuals."""
    alone = ErrorBudget(
        zenith_ionosphere=2.0, ionosphere_share=0.0, ionosphere_decay=0.0, zenith_troposphere=0.2
    )
    processing = Processing(
        systems=systems, ionosphere=ionosphere, budget=alone, false_alarm=0.0, without=frozenset(without)
    )
    paths = [gnss_file(name) for name in files]
    return rinex_fixes.solve_files(paths[:1], paths[1:], processing).figures()


def test_esbc_and_0759_reach_the_medians():
    gps = figures_of(ESBC, systems="gps")
    assert gps["fixes"] == gps["epochs"] == 240
    assert gps["horizontal_median_m"] < 1.5
    assert gps["vertical_median_m"] < 1.2
    both = figures_of(ESBC)
    assert both["horizontal_median_m"] <= gps["horizontal_median_m"]
    assert both["vertical_95_m"] <= gps["vertical_95_m"]
    assert both["vertical_median_m"] < 1.2
    assert both["speed_median_mps"] < 0.020
    assert abs(both["glonass_minus_gps_clock_m"] - 6.2) < 0.1
    japan = figures_of(JAPAN)
    assert japan["horizontal_median_m"] < 0.6
    assert japan["vertical_median_m"] < 0.6


@pytest.mark.parametrize(
    ("options", "horizontal", "vertical"),
    [
        (("gps",), 1.17, 0.75),
        (("gps", "free"), 1.26, 1.14),
        (("glonass",), 2.06, 1.84),
        (("both",), 1.06, 0.84),
    ],
)
def test_esbc_as_an_independent_computation(options, horizontal, vertical):
    """Over the same epochs; its weights differ: 0.2 m."""
    figures = weighted_by_elevation(ESBC, *options)
    assert abs(figures["horizontal_median_m"] - horizontal) < 0.2
    assert abs(figures["vertical_median_m"] - vertical) < 0.2


@pytest.mark.parametrize(
    ("left_out", "figure", "expected", "within"),
    [
        ("sagnac", "horizontal_median_m", 19.9, 0.5),
        ("relativity", "horizontal_median_m", 5.0, 0.6),
        ("relativity", "vertical_median_m", 6.2, 0.9),
        ("group-delay", "horizontal_median_m", 2.3, 0.3),
        ("group-delay", "vertical_median_m", 3.0, 0.7),
        ("troposphere", "vertical_median_m", 7.0, 1.0),
        ("ionosphere", "vertical_median_m", 2.5, 0.5),
    ],
)
def test_each_correction_left_out_costs_what_it_is_worth(left_out, figure, expected, within):
    """Figures of the independent computation; its weights differ."""
    worse = weighted_by_elevation(ESBC, "gps", without=(left_out,))[figure]
    assert abs(worse - expected) < within
    assert worse > 1.5 * weighted_by_elevation(ESBC, "gps")[figure]


def test_one_clock_for_both_systems_costs_a_third():
    """1.4 m and 1.75 m against 1.06 and 0.84 of the independent computation."""
    right = weighted_by_elevation(ESBC, "both")
    wrong = weighted_by_elevation(ESBC, "both", without=("clocks",))
    assert wrong["horizontal_median_m"] > 1.2 * right["horizontal_median_m"]
    assert wrong["vertical_median_m"] > 1.2 * right["vertical_median_m"]


def test_claimed_covariance_covers_the_real_errors():
    """95 % containment of the horizontal error by the reported ellipse: the budget is no optimist."""
    found = solved(ESBC)
    error, cov = found.errors()[:, :2], found.fixes.cov_pos_n[:, :2, :2]
    d2 = np.einsum("mi,mij,mj->m", error, np.linalg.inv(cov), error)
    assert np.mean(d2 < 5.991) > 0.93


def test_the_real_files_are_read_whole():
    raw = observations.read_observations(gnss_file(ESBC[0]))
    assert len(raw.t) == 240
    assert raw.t[1] - raw.t[0] == 360.0
    assert raw.marker == "ESBC00DNK"
    assert_allclose(raw.antenna_hen, [0.216, 0.0, 0.0])
    japan = observations.read_observations(gnss_file(JAPAN[0]))
    assert len(japan.t) == 120
    assert japan.t[-1] == 3570.005  # the receiver's clock is 5 ms ahead by then
    assert np.isnan(japan.doppler).all()
    day = ephemerides.read_navigation(gnss_file("brdc3050.12n"))
    assert len(np.unique(day.gps.sat)) == 32
    assert len(np.unique(ephemerides.read_navigation(gnss_file("brdc3050.12g")).glonass.sat)) == 24


def test_memory_grows_with_what_is_kept():
    """At most 300 bytes per satellite and epoch while a file is read."""
    observations.read_observations(
        gnss_file(ESBC[0])
    )  # what is imported and cached on the way does not count
    tracemalloc.start()
    raw = observations.read_observations(gnss_file(ESBC[0]))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 300 * len(raw.sat)


def test_bench_fixes(tmp_path, capsys):
    out = tmp_path / "fixes.csv"
    asked = ["fixes", str(gnss_file(JAPAN[0]))]
    assert main([*asked, str(gnss_file(JAPAN[1])), "-o", str(out), "--datum", "SK-42", "--json"]) == 0
    assert '"fixes": 120' in capsys.readouterr().out
    rows = out.read_text().splitlines()
    assert len(rows) == 121
    assert rows[1].startswith("2005-04-02T00:00:00,1,")
    fixes = solved(JAPAN).fixes
    lat = float(rows[1].split(",")[2])
    assert_allclose(lat, np.rad2deg(earth.to_datum(fixes.lla[0], "SK-42")[0]), atol=1e-8)
    assert abs(lat - np.rad2deg(fixes.lla[0, 0])) > 5e-5
    assert main([*asked, str(gnss_file("brdc3050.12n"))]) == 2
    said = capsys.readouterr().err
    assert "its ephemerides, 2012-10-31 00:00 to 23:59, fit no satellite of" in said
    assert said.strip().count("\n") == 0


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (
            {"systems": "galilei"},
            "systems = 'galilei' must be one of gps, glonass, galileo, beidou, both, all",
        ),
        ({"without": ["sagnak"]}, "without = 'sagnak' must be one of sagnac, "),
    ],
)
def test_an_option_that_does_not_exist_is_refused_from_python_too(option, words):
    with pytest.raises(ConfigError, match=words):
        bench.solve_rinex("a.obs", "a.nav", **option)


# --- small files -------------------------------------------------------------------------------------------


def test_rinex_3_observations(tmp_path):
    raw = observations.read_observations(written(tmp_path, OBS_3))
    assert raw.t.tolist() == [0.0, 60.001]
    assert raw.sat.tolist() == [5, 24, 5]
    assert raw.others == {"QZSS": 1}
    assert raw.system.tolist() == [0, 1, 0]
    assert raw.epoch_start.tolist() == [0, 2, 3]
    assert_allclose(
        raw.pseudorange, [[20947300.931, 20947300.413], [21947300.931, np.nan], [20947301.931, np.nan]]
    )
    assert_allclose(raw.doppler[:, 0], [-1037.205, np.nan, -1037.205])
    assert_allclose(raw.cn0[:, 0], [50.5, 41.0, np.nan])


def test_a_byte_order_mark_before_a_file_is_passed_over(tmp_path):
    """Some editors write one."""
    plain = observations.read_observations(written(tmp_path, OBS_3))
    marked = tmp_path / "marked.obs"
    marked.write_bytes(codecs.BOM_UTF8 + written(tmp_path, OBS_3).read_bytes())
    assert observations.read_observations(marked).pseudorange.tobytes() == plain.pseudorange.tobytes()


def test_rinex_2_observations_with_more_than_twelve_satellites(tmp_path):
    raw = observations.read_observations(written(tmp_path, OBS_2))
    assert raw.sat.tolist() == [3, 7, 8, 11, 19, 20, 24, 28, 1, 2, 4, 5, 6]
    assert raw.system.tolist() == [0] * 12 + [1]
    assert_allclose(raw.pseudorange, np.tile([24767686.375, 24767684.822], (13, 1)))
    assert_allclose(raw.doppler[:, 0], -1037.205)
    assert_allclose(raw.cn0[:, 0], 45.0)


def test_an_observation_of_zero_is_none(tmp_path):
    raw = observations.read_observations(written(tmp_path, broken(OBS_3, 9, "20947300.413", "       0.000")))
    assert np.isnan(raw.pseudorange[0, 1])
    assert raw.band[0].tolist() == [1, 0]


@pytest.mark.parametrize(("system", "late"), [("GLO", 18.0), ("BDT", 14.0), ("GAL", 0.0)])
def test_the_time_of_the_header_counts(tmp_path, system, late):
    """GPS is ahead of UTC, that of GLONASS, by the leap seconds, of BeiDou by 14 s: those since 2006."""
    shifted = OBS_3.replace("GPS         TIME OF", f"{system}         TIME OF")
    assert observations.read_observations(written(tmp_path, shifted)).t[0] == late


def test_numbers_without_an_exponent_letter_and_weeks(tmp_path):
    nav = ephemerides.read_navigation(written(tmp_path, NAV_2))
    assert nav.gps.t[0] == lines.gps_seconds(2012, 10, 31)
    assert lines.parse_fortran("0.499063314480-269") == 0.499063314480e-269
    assert lines.parse_fortran("-1.5+02") == -150.0
    assert lines.parse_fortran("1_000.0") is None
    assert lines.parse_fortran("nan") is None


def test_glonass_times_are_utc_with_or_without_leap_seconds_in_the_header(tmp_path):
    """16 s on that day by IERS Bulletin C; the header's own number wins."""
    noon = lines.gps_seconds(2012, 10, 31, 900.0)
    assert ephemerides.read_navigation(written(tmp_path, NAV_R)).glonass.t[0] == noon + 16
    said = NAV_R.replace(
        "                                                            END",
        "    17                                                      LEAP SECONDS\n" + 60 * " " + "END",
    )
    assert ephemerides.read_navigation(written(tmp_path, said)).glonass.t[0] == noon + 17
    found = ephemerides.read_navigation(written(tmp_path, NAV_R)).glonass
    assert_allclose(found.state[0, 1:4], [-23809821.28906, -8908935.546875, 2209434.082031], rtol=1e-12)
    assert found.channel.tolist() == [5]


def test_yuma_week_follows_the_date(tmp_path):
    path = written(tmp_path, YUMA)
    for year, week in ((2003, 1173), (2022, 2197)):
        assert almanac.read_yuma(path, lines.gps_seconds(year, 2, 17)).t[0] // 604800 == week


def test_each_entry_of_a_yuma_almanac_has_its_column(tmp_path):
    t_oe = 2197 * 604800.0 + 405504.0
    given = {
        "t_oe": t_oe, "t_oe_week": 405504.0, "t_oc": t_oe, "e": 0.01139211655, "i_0": 0.9867355387,
        "node_rate": -0.7886042771e-8, "sqrt_a": 5153.623047, "node_0": -1.912602899, "perigee": 0.881498914,
        "mean_anomaly": -2.769097477, "af_0": 0.4291534424e-3, "af_1": -0.1091393642e-10,
    }  # fmt: skip
    sets = almanac.read_yuma(written(tmp_path, YUMA), lines.gps_seconds(2022, 2, 17))
    found = dict(zip(KEPLER, sets.elements[0].tolist(), strict=True))
    assert found == pytest.approx(dict.fromkeys(KEPLER, 0.0) | given, rel=1e-14, abs=0.0)


def broken(text, line, old, new):
    lines = text.splitlines(keepends=True)
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new)
    return "".join(lines)


def first_lines(text, count):
    return "".join(text.splitlines(keepends=True)[:count])


OBSERVATIONS = {
    "empty": ("", "file: is empty"),
    "no rinex": ("lat,lon\n1,2\n", "line 1: 'RINEX VERSION / TYPE' is not in columns 61-80"),
    "compact": (
        OBS_3.replace("     3.05 ", "2.0       ").replace("RINEX VERSION / TYPE", "CRINEX VERS   / TYPE"),
        "line 1: Compact RINEX 2.0 must be version 1 or 3",
    ),
    "version": (broken(OBS_3, 1, "3.05", "5.00"), "line 1: version 5 must be 2, 3 or 4"),
    "kind": (NAV_2, "line 1: is a navigation file, not an observation file"),
    "binary": (OBS_3[:200] + "\0" + OBS_3[200:], "has a zero byte"),
    "header": (first_lines(OBS_3, 5), "line 5: the file ends before END OF HEADER"),
    "types": (broken(OBS_3, 4, "G    4", "G    5"), "lists 4 of 5 observables"),
    "too many types": (
        broken(OBS_3, 4, "G    4", "G    3"),
        "line 4: lists 4 observables where 3 are announced",
    ),
    "no epoch": (first_lines(OBS_3, 7), "file: has no epoch"),
    "scale": (
        OBS_3.replace(f"{'HERE':60}MARKER NAME", f"{'G   30  1 C1C':60}SYS / SCALE FACTOR"),
        "line 2: the scale factor 30 must be 1, 10, 100 or 1000",
    ),
    "only epoch": (first_lines(OBS_3, 10), "has no epoch that can be read; line 10: the file ends before"),
}

EPOCHS = {
    "long": (OBS_3 + "G" * 5000 + "\n", "line 16: is longer than 4096 characters"),
    "value": (
        broken(OBS_3, 9, "20947300.931", "2O947300.931"),
        "line 9: an observation must be a number; got '2O947300.931'",
    ),
    "satellite": (broken(OBS_3, 9, "G05", "Gxx"), "line 9: the number of a satellite must be a whole number"),
    "cut": (first_lines(OBS_3, 14), "line 14: the file ends before satellite 1 of 1 of the epoch"),
    "count": (broken(OBS_3, 8, "0  3", "0999"), "line 8: 999 satellites in one epoch are outside 0 to 200"),
    "date": (broken(OBS_3, 8, "2020 06 25", "2020 06 35"), "line 8: 2020-6-35 is not a date"),
    "hour": (broken(OBS_3, 8, "25 00 00", "25 25 00"), "line 8: 25:0:0 is not a time of day"),
    "no marker": (broken(OBS_3, 8, ">", "!"), "line 8: an epoch must begin here; got"),
    "zero byte": (broken(OBS_3, 9, "G05", "G\0005"), "line 9: has a zero byte"),
    "superscript": (broken(OBS_3, 9, "G05", "G0\xb2"), "line 9: the number of a satellite must be"),
}


@pytest.mark.parametrize("case", OBSERVATIONS)
def test_a_broken_observation_file_gets_one_line(tmp_path, case):
    text, said = OBSERVATIONS[case]
    with pytest.raises(ConfigError) as caught:
        observations.read_observations(written(tmp_path, text))
    assert len(caught.value.messages) == 1
    assert said in caught.value.messages[0]
    assert caught.value.messages[0].startswith("file: ")
    assert "\n" not in caught.value.messages[0]


@pytest.mark.parametrize("case", EPOCHS)
def test_a_broken_epoch_is_left_out_and_reported_with_its_line(tmp_path, case):
    text, said = EPOCHS[case]
    raw = observations.read_observations(written(tmp_path, text))
    assert raw.lost == len(raw.reasons) == 1
    assert raw.reasons[0].startswith(f"file: {said}")
    assert len(raw.t) == 1
    assert raw.epoch_start.tolist() == [0, len(raw.sat)]
    first = case in ("cut", "long")  # else the second one is left
    assert (raw.t.tolist(), len(raw.sat)) == (([0.0], 2) if first else ([60.001], 1))


def minutes(*epochs):
    """Return a file with an epoch at each minute."""
    head, body = (
        OBS_3[: OBS_3.index("> 2020")],
        "> 2020 06 25 00 {:02d} 00.0000000  0  1\nG{:02d}  20947301.931\n",
    )
    return head + "".join(body.format(m, k + 1) for k, m in enumerate(epochs))


@pytest.mark.parametrize(
    ("epochs", "kept"),
    [
        ((0, 1, 1, 2), (0, 1, 3)),  # twice: the first
        ((0, 1, 2, 0, 3), (0, 1, 2, 4)),
        ((0, 50, 1, 2, 3), (0, 2, 3, 4)),  # one far ahead: not all that follow
        ((50, 0, 1, 2), (1, 2, 3)),
    ],
)
def test_only_the_epochs_whose_time_does_not_fit_are_lost(tmp_path, epochs, kept):
    raw = observations.read_observations(written(tmp_path, minutes(*epochs)))
    assert raw.t.tolist() == [60.0 * (epochs[k] - epochs[kept[0]]) for k in kept]
    assert raw.sat.tolist() == [k + 1 for k in kept]
    (lost,) = set(range(len(epochs))) - set(kept)
    assert raw.reasons == (
        f"file: line {8 + 2 * lost}: the time of the epoch does not fit between those around it",
    )


def cut_japan(edit):
    """Return the first ten epochs of a real file, edited by a function of (line number from 0, line)."""
    lines = gnss_file(JAPAN[0]).read_text(encoding="latin-1").splitlines()[: 17 + 10 * 9]
    return "".join(f"{edit(k, line)}\n" for k, line in enumerate(lines))


def test_a_real_file_with_broken_epochs_keeps_the_others(tmp_path):
    """RINEX 2 has no mark at an epoch: the next one is found by its form."""
    whole = observations.read_observations(written(tmp_path, cut_japan(lambda k, line: line)))
    text = cut_japan(lambda k, line: "gone" if k == 30 else line).replace("gone\n", "")
    text = broken(broken(text, 20, "24361933", "24361x33"), 35, "8G 3", "9G 3")
    raw = observations.read_observations(written(tmp_path, text))
    assert (raw.lost, raw.recounted) == (2, 1)  # nine satellites are announced, eight are there
    assert [int(reason.split("line ")[1].split(":")[0]) for reason in raw.reasons] == [20, 35]
    assert raw.t.tolist() == whole.t[2:].tolist()
    assert_allclose(raw.pseudorange, whole.pseudorange[16:])


@pytest.mark.parametrize("count", ["0  2", "0  4"])
def test_an_epoch_with_a_wrong_count_and_sound_lines_is_kept(tmp_path, count):
    raw = observations.read_observations(written(tmp_path, broken(OBS_3, 8, "0  3", count)))
    assert (raw.lost, raw.recounted) == (0, 1)
    assert raw.sat.tolist() == [5, 24, 5]


def test_the_code_is_chosen_for_each_satellite_and_epoch(tmp_path):
    """P2 is in the header, but only satellites 3 and 7 have it; the others have C2."""

    def edit(k, line):
        if k == 11:
            return line.replace("L2    P2", "P2    C2")
        if k < 17 or line.startswith(" 05"):
            return line
        has = (k - 17) % 9 in (1, 2)
        return line[:32] + line[48:64].ljust(16) if has else line[:32] + 16 * " " + line[48:]

    path = written(tmp_path, cut_japan(edit))
    expected = observations.read_observations(written(tmp_path, cut_japan(lambda k, line: line), "whole"))
    assert_allclose(observations.read_observations(path).pseudorange, expected.pseudorange)
    assert bench.solve_rinex(path, gnss_file(JAPAN[1]), ionosphere="free").figures()["fixes"] == 10


def test_what_a_signal_lacks_is_taken_from_its_carrier():
    """Its own Doppler and C/N0 first, then those of the same band; never those of the other one."""
    types = ["D1W", "S1W", "C1C", "L1C", "C2W", "D2W", "S2W", "C1W", "D1C", "L2W"]
    first, second = codes.find_signals("G", types, 3.04)
    assert [(one.code, one.doppler, one.cn0, one.phase, one.band) for one in first] == [
        (2, [8, 0], [1], 3, 1),
        (7, [0, 8], [1], -1, 1),
    ]
    assert [(one.code, one.doppler, one.cn0, one.phase, one.band) for one in second] == [(4, [5], [6], 9, 2)]
    e5, e7 = codes.find_signals("E", ["C5Q", "C7Q", "D7Q", "S5Q", "S1C"], 3.04)[1]
    assert (e5.doppler, e5.cn0, e5.band, e7.doppler, e7.cn0, e7.band) == ([], [3], 5, [2], [], 7)
    b1 = codes.find_signals("C", ["C1I", "D1I"], 3.02)[0][0]
    assert (b1.code, b1.doppler, b1.band) == (0, [1], 2)  # B1 has the digit 1 in RINEX 3.02
    assert codes.find_signals("G", ["C1", "D2", "P2", "D1", "S2", "P1"], 2.11)[0][0][:4] == (0, [3], [], -1)


@pytest.mark.parametrize(
    ("edit", "options", "why"),
    [
        (lambda k, line: line[:48], {"ionosphere": "free"}, "on two carriers"),
        (lambda k, line: line, {"mask_deg": 60.0}, "satellites with an elevation above the mask, 60 deg"),
        (lambda k, line: line, {"systems": "glonass"}, "satellites with a pseudorange of --systems glonass"),
        (lambda k, line: line if k < 4 else "", {}, "no fix: too few satellites with a pseudorange"),
        (lambda k, line: line.replace("2", "9"), {}, "the ranges do not agree with one position"),
    ],
)
def test_no_fix_has_a_reason(tmp_path, edit, options, why):
    """``edit`` gets the number of the satellite in its epoch and its line."""

    def change(k, line):
        return line if k < 17 or line.startswith(" 05") else edit((k - 17) % 9, line)

    solved = bench.solve_rinex(written(tmp_path, cut_japan(change)), gnss_file(JAPAN[1]), **options)
    assert solved.figures()["fixes"] == 0
    assert why in solved.notes[-1]


def test_a_receiver_that_moves_is_not_compared_with_the_header(tmp_path):
    """By the event "antenna starts to move"; by fixes 15 m apart every 30 s; by their speed."""
    rest = cut_japan(lambda k, line: line)
    solved = bench.solve_rinex(written(tmp_path, rest), gnss_file(JAPAN[1]))
    assert (solved.moving, solved.notes) == (False, ())
    assert "horizontal_median_m" in solved.figures()
    fixes = solved.fixes
    event = f"{28 * ' '}2  1\n{'A CAR':60}COMMENT\n"
    told = rest.replace(" 05  4  2  0  0 30", event + " 05  4  2  0  0 30")
    lla = fixes.lla + np.outer(np.arange(10), [15.0 / 6.4e6, 0.0, 0.0])
    still = solved.solution
    for found in (
        bench.solve_rinex(written(tmp_path, told), gnss_file(JAPAN[1])),
        replace(solved, solution=still._replace(fixes=replace(fixes, lla=lla))),
        replace(solved, solution=still._replace(fixes=replace(fixes, vel_n=np.ones((10, 3))))),
    ):
        assert found.moving
        assert found.figures()["fixes"] == 10
        assert "horizontal_median_m" not in found.figures()
    found = bench.solve_rinex(written(tmp_path, told), gnss_file(JAPAN[1]))
    assert found.notes == ("the receiver moves: its fixes are not compared with the position in the header",)


def test_a_place_that_cannot_be_written_is_found_before_the_work(tmp_path, capsys):
    there = tmp_path / "none" / "fixes.csv"
    assert main(["fixes", "no.obs", "no.nav", "-o", str(there)]) == 2
    assert capsys.readouterr().err == f"error: {there}: there is no folder {there.parent}\n"
    assert main(["fixes", "no.obs", "no.nav", "-o", str(tmp_path)]) == 2
    assert "is a folder" in capsys.readouterr().err
    assert main(["allan", "stim300", "-o", str(tmp_path / "none" / "a.png")]) == 2
    assert "there is no folder" in capsys.readouterr().err


NAVIGATION = {
    "empty": ("", "file: is empty"),
    "nothing": (first_lines(NAV_2, 2), "file: has no ephemeris of GPS, GLONASS, Galileo or BeiDou"),
    "cut": (first_lines(NAV_2, 7), "line 7: the record of G1 from line 3 ends after 5 of 8 lines"),
    "number": (
        broken(NAV_2, 5, "0.135910103563D-02", "0.13591O103563D-02"),
        "line 5: a value must be a number; got '0.13591O103563D-02'",
    ),
    "missing": (broken(NAV_2, 5, "0.135910103563D-02", "                  "), "line 5: e is missing"),
    "orbit": (
        broken(NAV_2, 5, "0.515370994186D+04", "0.715370994186D+04"),
        "line 5: sqrt_a = 7153.71 is outside 4900 to 5400: not a GPS orbit",
    ),
    "date": (broken(NAV_2, 3, "12 10 31", "12 13 31"), "line 3: 2012-13-31 is not a date"),
    "satellite": (broken(NAV_2, 3, " 1 12", "99 12"), "line 3: satellite 99 is outside 1 to 63"),
    "glonass radius": (
        broken(NAV_R, 4, "-2.380982128906D+04", "-2.380982128906D+03"),
        "line 4: a radius of 9483 km is outside 24000 to 27000 km",
    ),
    "glonass cut": (first_lines(NAV_R, 5), "line 5: the record of R3 from line 3 ends after 3 of 4 lines"),
    "kind": (OBS_3, "line 1: is an observation file, not a navigation file"),
}


def test_the_state_of_glonass_in_si_units_and_a_channel_without_its_sign(tmp_path):
    text = broken(NAV_R, 5, " 5.000000000000D+00", " 2.490000000000D+02")
    found = ephemerides.read_navigation(written(tmp_path, text)).glonass
    assert found.channel.tolist() == [-7]
    expected = {
        "x": -2.380982128906e7, "vx": 228.9457321167, "ax": -3.725290298462e-6,
        "y": -8.908935546875e6, "vy": 253.6134719849, "ay": 9.313225746155e-7,
        "z": 2.209434082031e6, "vz": 3556.049346924, "az": -1.862645149231e-6,
    }  # fmt: skip
    state = dict(zip(STATE, found.state[0], strict=True))
    assert_allclose([state[name] for name in expected], [*expected.values()], rtol=1e-12)


def test_the_issue_of_a_clock_is_no_group_delay(tmp_path):
    gps = ephemerides.read_navigation(written(tmp_path, NAV_2)).gps
    assert gps.get("group_delay").tolist() == [0.838190317154e-8]
    assert gps.get("group_delay_2").tolist() == [0.0]


@pytest.mark.parametrize("case", NAVIGATION)
def test_a_broken_navigation_file_gets_one_line(tmp_path, case):
    text, said = NAVIGATION[case]
    with pytest.raises(ConfigError) as caught:
        ephemerides.read_navigation(written(tmp_path, text))
    assert len(caught.value.messages) == 1
    assert said in caught.value.messages[0]


ALMANACS = {
    "empty": ("", "file: has no almanac"),
    "cut": (first_lines(YUMA, 9), "line 9: the almanac from line 2 has 8 of 13 entries"),
    "next": (first_lines(YUMA, 9) + YUMA, "line 10: the almanac from line 2 has 8 of 13 entries"),
    "number": (broken(YUMA, 4, "0.1139", "O.1139"), "line 4: Eccentricity must be a number"),
    "value": (broken(YUMA, 4, "E-001", "E+001"), "line 4: Eccentricity = 1.13921"),
    "twice": (YUMA.replace("Health", "Eccentricity"), "line 4: gives 'Eccentricity' twice"),
    "other": ("lat,lon\n", "line 1: 'lat,lon' is not an entry of a YUMA almanac"),
}


@pytest.mark.parametrize("case", ALMANACS)
def test_a_broken_almanac_gets_one_line(tmp_path, case):
    text, said = ALMANACS[case]
    with pytest.raises(ConfigError) as caught:
        almanac.read_yuma(written(tmp_path, text), 0.0)
    assert len(caught.value.messages) == 1
    assert said in caught.value.messages[0]


def test_a_broken_record_of_a_navigation_file_is_left_out(tmp_path):
    bad = broken(NAV_2, 5, "0.135910103563D-02", "0.13591O103563D-02")
    nav = ephemerides.read_navigation(
        written(tmp_path, bad + first_lines(NAV_2, 10).split("HEADER\n")[1].replace(" 1 12", " 2 12"))
    )
    assert nav.gps.sat.tolist() == [2]
    assert (nav.lost, nav.reasons) == (
        1,
        ("file: line 5: a value must be a number; got '0.13591O103563D-02' in columns 23-41",),
    )


def test_what_is_no_file_gets_one_line(tmp_path):
    for path, said in ((tmp_path / "none", "none: no such file"), (tmp_path, ": is a folder, not a file")):
        with pytest.raises(ConfigError, match=said):
            observations.read_observations(path)
