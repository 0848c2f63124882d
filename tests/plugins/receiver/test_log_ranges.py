"""Tight coupling on recorded ranges: those of a simulated run go out as RINEX and come back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.core.mathematics import earth
from bench.core.records.orbit_sets import BEIDOU, GLONASS, SYSTEM_NAMES
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.io import config, exports
from bench.io.config.log import RANGES, SourceSpec, load_log
from bench.io.exports.outgoing import ExportData
from bench.io.logs.log_ranges import read_ranges
from bench.io.logs.log_records import read_records
from bench.io.results import make_start_document
from bench.navigation.built_in import load
from bench.pipeline.log_pipeline import Session, read_log
from bench.simulation import sensors
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.gnss import compute_antenna_motion
from tests.navigation.test_tight import taken
from tests.weaving import units, weaving

GNSS = config.read_profile("figure-eight", {"sensors.gnss": "sky-multi"}).sensors.gnss
BEGIN = 1451304000.0  # of the run, in GPS time since 1980-01-06 [s]
LOG = f"""
[imu]
file = "imu.csv"
[gnss]
observations = ["run.obs"]
navigation = ["run.nav"]
time_offset_s = {-BEGIN}
position_m = [0.8, 0.3, -0.4]
[sensors.assumed]
imu = "icm-42688-p"
gnss = "sky-multi"
[alignment]
duration_s = 20
[[estimator]]
use = "tight"
[[estimator]]
use = "loose-full"
"""


def export(folder, data, initial, tracks=None):
    start = make_start_document(data, initial)
    out = ExportData(data.imu, data.fixes, data.observations, {}, start, data.output_t, tracks or {})
    for kind in ("csv", "rinex"):
        exports.write(folder, kind, out, "weaving")


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """130 s with four constellations: sensors, truth, and a folder with RINEX, tables and a log of them."""
    folder = tmp_path_factory.mktemp("ranges")
    truth = weaving(130.0)
    sensed = sensors.sense(truth, units(gnss=GNSS, baro=None), 3, 0)
    export(folder, sensed.data, sensed.initial)
    (folder / "log.toml").write_text(LOG)
    return folder, sensed, truth


def read_back(folder, gnss=GNSS):
    files = {"observations": (folder / "run.obs",), "navigation": (folder / "run.nav",)}
    return read_ranges(SourceSpec(folder / "run.obs", RANGES, time_offset=-BEGIN, **files), gnss)


def test_the_ranges_of_a_run_come_back_with_their_satellites_and_noise(flown):
    """To the rounding of RINEX, 1 mm, 1 mHz, 1e-7 s and 12 digits; the messages fit to a millimeter."""
    folder, sensed, _ = flown
    o = sensed.data.observations
    back = read_back(folder).observations
    assert {GLONASS, BEIDOU} < set(o.system.tolist())
    for name, most in {
        "sat": 0, "system": 0, "frequency": 0, "epoch_start": 0, "t": 5e-7, "pseudorange": 5.1e-4,
        "range_rate": 1.3e-4, "cn0": 5.1e-4, "sat_pos_e": 2e-3, "sat_vel_e": 3e-4, "sat_clock": 1e-6,
        "sat_clock_rate": 1e-9, "group_delay": 0, "sd_pseudorange": 2e-3, "sd_range_rate": 1e-5,
    }.items():  # fmt: skip
        assert np.abs(getattr(back, name) - getattr(o, name)).max() <= most, name
    assert np.abs(back.klobuchar / o.klobuchar - 1).max() < 1e-4
    worse = read_back(folder, replace(GNSS, sky=replace(GNSS.sky, gps_space_sd=3.0))).observations
    gps, more = o.system == 0, 3.0**2 - GNSS.sky.gps_space_sd**2
    np.testing.assert_allclose(
        worse.sd_pseudorange[gps] ** 2, back.sd_pseudorange[gps] ** 2 + more, rtol=1e-9
    )
    assert np.array_equal(worse.sd_pseudorange[~gps], back.sd_pseudorange[~gps])


def test_what_no_reader_of_ours_takes_from_a_message_is_that_of_its_system(flown):
    """Tables A6, A8 and A14: source of data, week, flag, accuracy, health, group delay and fit interval.

    Weeks of GPS since 1980-01-06; Galileo counts as GPS in RINEX, BeiDou since 2006-01-01."""
    lines = (flown[0] / "run.nav").read_text().splitlines()
    fields = ((5, 1), (5, 2), (5, 3), (6, 0), (6, 1), (6, 2), (7, 1))
    found: dict[str, set[tuple[float, ...]]] = {}
    for k in (k for k, line in enumerate(lines) if line[0] in "GEC" and line[1:3].isdecimal()):

        def read(row, column, k=k):
            return float(lines[k + row][4 + 19 * column : 23 + 19 * column].replace("D", "E"))

        found.setdefault(lines[k][0], set()).add(tuple(read(*one) for one in fields))
        assert read(7, 0) == read(3, 0)  # sent at its reference time
        assert read(6, 3) == (read(1, 0) if lines[k][0] == "G" else 0.0)  # its issue
        assert read(1, 0) == read(3, 0) // 300 % 256
    week = BEGIN // 604800
    assert found == {
        "G": {(1.0, week, 0.0, 2.0, 0.0, 0.0, 4.0)},
        "E": {(517.0, week, 0.0, 3.12, 0.0, 0.0, 0.0)},
        "C": {(0.0, week - 1356, 0.0, 2.0, 0.0, 0.0, 0.0)},
    }


def test_tight_finds_from_rinex_what_it_finds_from_the_run(flown):
    """3 mm and 0.2 mm/s; with times that are late by the clock of the receiver it would be a decimeter."""
    folder, sensed, _ = flown
    back = read_back(folder).observations
    data = replace(sensed.data, observations=replace(back, gps_t0=sensed.data.observations.gps_t0))
    own, other = (load("tight", {}).run(one, sensed.initial) for one in (sensed.data, data))
    assert np.abs(earth.difference_n(other.lla, own.lla)).max() < 3e-3
    assert np.abs(other.vel_n - own.vel_n).max() < 2e-4
    np.testing.assert_allclose(other.cov, own.cov, rtol=1e-3, atol=1e-6)


def test_fixes_of_ranges_without_errors_are_the_truth_to_the_rounding(tmp_path):
    """With Klobuchar and Saastamoinen, by the defaults of `bench fixes`; with half of the humidity not."""
    off = ("space_sd", "_sd", "clock_g", "bandwidth", "share")
    figures = {name for name in GNSS.sky.__slots__ if name.endswith(off) and not name.startswith("clock_")}
    sky = replace(GNSS.sky, bands=1, clock_g=0.0, **dict.fromkeys(figures, 0.0))
    truth = weaving(20.0)
    sensed = sensors.sense(truth, units(gnss=replace(GNSS, sky=sky), baro=None), 3, 0)
    export(tmp_path, sensed.data, sensed.initial)
    files = tmp_path / "run.obs", tmp_path / "run.nav"
    rows = np.searchsorted(truth.t, sensed.data.fixes.t - 1e-6)
    lla, _ = compute_antenna_motion(truth, rows, (0.8, 0.3, -0.4), SensorDraws(1, 0))
    solved, dry = (bench.solve_rinex(*files, mask_deg=5, humidity_pct=one) for one in (50.0, 25.0))
    assert np.abs(earth.difference_n(solved.fixes.lla, lla)).max() < 3e-3
    assert np.abs(earth.difference_n(dry.fixes.lla, lla)).max() > 0.05


def test_a_log_navigates_ranges_beside_the_fixes_of_the_same_receiver(flown):
    folder, _, truth = flown
    result = bench.navigate(folder / "log.toml")
    seen = result.records["sensed"].data.observations
    withheld, begin = result.records["withheld"], result.more["log"]["origin_s"]
    assert abs(seen.gps_t0 - flown[1].data.observations.gps_t0 - begin) < 1e-6
    sky = result.records["sensed"].sky
    assert set(seen.t) <= set(sky.t)
    assert sky.used.sum() > 3000
    assert len(withheld) > 20
    assert np.abs(np.unique(seen.t)[:, None] - withheld.t).min() > 0.5  # what evaluates is kept from tight
    assert result.metrics["tight"]["verdict"] == "consistent"
    for label, solution in result.solutions.items():
        rows = np.searchsorted(truth.t, solution.t + result.more["log"]["origin_s"] - 1e-6)
        error = earth.difference_n(solution.lla, truth.lla[rows])
        late = solution.t > 60.0
        sd = np.sqrt(np.einsum("kii->ki", solution.cov)[late, :3])
        assert np.mean((error[late] / sd) ** 2) < 4.0, label


def test_until_s_ends_the_sky_as_it_ends_the_imu_and_the_fixes(flown):
    folder, _, _ = flown
    (folder / "short.toml").write_text(f"{LOG}[evaluation]\nuntil_s = 60.2\n")
    whole, cut = (read_log(folder / name).records for name in ("log.toml", "short.toml"))
    rows = whole.sky.t <= 60.2
    assert 1000 < rows.sum() < len(rows) - 1000
    for name in ("t", "system", "sat", "azimuth", "elevation", "cn0", "used"):
        assert np.array_equal(getattr(cut.sky, name), getattr(whole.sky, name)[rows], equal_nan=True), name
    assert cut.imu.t.max() <= 60.2 < whole.imu.t.max()
    assert cut.fixes.t.max() <= 60.2 < whole.fixes.t.max()


def test_an_outage_takes_the_ranges_away_too(flown):
    folder, _, _ = flown
    log = read_log(folder / "log.toml")
    spec = load_log(str(folder / "log.toml"))
    t = log.records.fixes.t
    session = Session(spec, log.records, replace(flown[1].initial, t=float(t[20])))
    keep = (session.fixes.t <= t[40]) | (session.fixes.t > t[50])
    data = session.make_data(keep, np.array([t[-1]]))
    assert np.array_equal(np.unique(data.observations.t), session.fixes.t[keep])
    assert set(t[41:51]) <= set(log.records.observations.t.tolist())


class Listener:
    """Keeps what a filter gets, and answers as `tight`."""

    def run(self, sensors, initial):
        self.sensors = sensors
        return load("tight", {}).run(sensors, initial)


def test_an_outage_ends_when_it_ends_not_with_the_last_fix_in_it(flown):
    """Without fixes from 4 s before its end to 5 s after it: its ranges are gone, those behind are there."""
    folder, _, _ = flown
    log = read_log(folder / "log.toml")
    t = log.records.fixes.t
    begin, end = float(t[40]), float(t[60])
    fixes = log.records.fixes.take((t <= begin + 16.5) | (t > end + 5.5))
    session = Session(log.spec, replace(log.records, fixes=fixes), replace(flown[1].initial, t=float(t[20])))
    session.first, one = begin, Listener()
    session.run_outages(one, "tight", end - begin, 1)
    seen = one.sensors.observations.t
    assert not ((seen > begin + 0.5) & (seen < end + 0.5)).any()
    assert set(t[[*range(36, 41), *range(61, 66)]]) <= set(seen)


def test_epochs_with_too_few_satellites_for_a_fix_reach_tight(flown, tmp_path):
    """Three GPS satellites from 60 s on: no fix, and tight has their ranges, by the place of a track."""
    _, sensed, truth = flown
    o = sensed.data.observations
    few = (o.t < 60.0) | ((o.system == 0) & np.isin(o.sat, np.unique(o.sat[o.system == 0])[:3]))
    fixes = sensed.data.fixes.take(sensed.data.fixes.t < 60.0)
    data = replace(sensed.data, observations=taken(o, few), fixes=fixes)
    export(tmp_path, data, sensed.initial, {"truth": truth})
    rows, back, *_ = read_back(tmp_path)
    assert rows.t.max() < 60.0
    assert "no fix at" in " ".join(rows.notes)
    assert "left out" not in " ".join(rows.notes)
    assert np.array_equal(back.sat, o.sat[few])
    assert np.abs(back.sat_pos_e - o.sat_pos_e[few]).max() < 2e-3


def test_epochs_whose_place_nothing_tells_are_left_out_with_a_word(flown, tmp_path):
    """A single fix that is missing is bridged."""
    _, sensed, _ = flown
    t = sensed.data.fixes.t
    fixes = sensed.data.fixes.take((t < 59.5) & (np.abs(t - 30.0) > 0.5))
    export(tmp_path, replace(sensed.data, fixes=fixes), sensed.initial)
    seen = np.unique(sensed.data.observations.t)
    words = " ".join((tmp_path / "README.md").read_text().split())
    assert f"{(seen > 60.5).sum()} epochs more than 1 s from a fix are left out" in words
    rows, back, *_ = read_back(tmp_path)
    assert "left out" not in " ".join(rows.notes)
    assert len(np.unique(back.t)) == (seen < 60.5).sum()
    none = replace(fixes, t=fixes.t + 1000.0)
    with pytest.raises(bench.core.words.exceptions.ExportError, match="so no position is known"):
        export(tmp_path, replace(sensed.data, fixes=none), sensed.initial)


def test_messages_of_glonass_are_at_quarters_of_an_hour_in_utc(flown, tmp_path):
    """RTKLIB (`decode_geph`) rounds their times to these: others would put satellites kilometers away."""
    folder, sensed, _ = flown
    o = sensed.data.observations
    export(tmp_path, replace(sensed.data, observations=replace(o, gps_t0=o.gps_t0 + 405.0)), sensed.initial)
    for where, count in ((folder, 1), (tmp_path, 2)):
        found = {
            line[4:23] for line in (where / "run.nav").read_text().splitlines() if line[:1] == "R"
            and line[1:3].isdecimal()
        }  # fmt: skip
        assert len(found) == count
        assert {one[-5:] for one in found} <= {"00 00", "15 00", "30 00", "45 00"}
    words = " ".join((folder / "README.md").read_text().split())
    assert "mm with GLONASS" in words


def test_the_sky_ends_with_the_imu(flown, tmp_path):
    """And begins with it; the receiver looks on for half a minute at both ends."""
    folder, _, _ = flown
    for name in ("run.obs", "run.nav"):
        (tmp_path / name).symlink_to(folder / name)
    head, *rows = (folder / "imu.csv").read_text().splitlines()
    (tmp_path / "imu.csv").write_text("\n".join([head, *rows[6000:20000]]) + "\n")
    (tmp_path / "log.toml").write_text(LOG)
    records = read_records(load_log(str(tmp_path / "log.toml")))
    assert 0.0 <= records.sky.t.min() < 1.0
    assert 69.0 < records.sky.t.max() <= records.imu.t[-1] < 71.0


def test_without_doppler_the_reason_is_told(flown, tmp_path):
    folder, _, _ = flown
    for name in ("run.nav", "imu.csv"):
        (tmp_path / name).symlink_to(folder / name)
    text = (folder / "run.obs").read_text()
    (tmp_path / "run.obs").write_text(text.replace(" D1C", " L1C").replace(" D2I", " L2I"))
    (tmp_path / "log.toml").write_text(LOG)
    with pytest.raises(EstimatorError, match="there is none in log: no satellite has both a range and a Dop"):
        bench.navigate(tmp_path / "log.toml")


def test_a_datasheet_without_sky_gives_fixes_alone(flown, tmp_path):
    folder, _, _ = flown
    for name in ("run.obs", "run.nav", "imu.csv"):
        (tmp_path / name).symlink_to(folder / name)
    (tmp_path / "log.toml").write_text(LOG.replace("sky-multi", "zed-f9p"))
    with pytest.raises(EstimatorError, match=r"in log: \[sensors.assumed\] gnss has no \[sky\]"):
        bench.navigate(tmp_path / "log.toml")
    records = read_records(load_log(str(tmp_path / "log.toml")))
    assert records.observations is None
    assert any("gnss has no [sky]: filters get its fixes" in note for note in records.notes)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("navigation", "#"), "[gnss] give either file, or both observations and navigation"),
        (("[gnss]", '[gnss]\nfile = "gnss.csv"'), "[gnss] give either file, or both observations and"),
        (("[gnss]", "[gnss]\nquality = [1]"), "[gnss] quality is for fixes in a file, not for observations"),
        (('"run.nav"', '"no.nav"'), "[gnss] 'no.nav': no such file beside the log"),
        (('"run.obs"', '"run.nav"'), "run.nav: line 1: is a navigation file, not an observation file"),
    ],
)
def test_a_log_that_names_its_ranges_wrongly_is_refused(flown, change, said):
    folder, _, _ = flown
    path = folder / "wrong.toml"
    path.write_text(LOG.replace(*change))
    with pytest.raises(ConfigError) as error:
        read_log(path)
    assert said in "\n".join(error.value.messages)


def test_what_a_frozen_receiver_repeats_is_left_out(flown, tmp_path):
    _, sensed, _ = flown
    o = sensed.data.observations
    first, last = o.epoch_start[10], o.epoch_start[11]
    again = taken(o, np.r_[:last, first:last, last : len(o)])
    t = again.t + 0.5 * (np.r_[np.zeros(last), np.ones(last - first), np.zeros(len(o) - last)])
    again = replace(
        again, t=t, epoch_start=np.r_[o.epoch_start[:11], last, o.epoch_start[11:] + last - first]
    )
    export(tmp_path, replace(sensed.data, observations=again), sensed.initial)
    words = " ".join((tmp_path / "README.md").read_text().split())
    assert "1 epochs that a frozen receiver repeats are left out" in words


def test_a_run_without_ranges_has_no_rinex(flown, tmp_path):
    _, sensed, _ = flown
    with pytest.raises(bench.core.words.exceptions.ExportError, match="its receiver must be one with"):
        export(tmp_path, replace(sensed.data, observations=None), sensed.initial)


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_georinex_reads_the_files_as_they_were_meant(flown):
    """An independent reader: ranges and Doppler of every row, elements of the first message."""
    georinex = pytest.importorskip("georinex")
    folder, sensed, _ = flown
    o = sensed.data.observations
    found = georinex.load(folder / "run.obs")
    for system, letter, code in ((0, "G", "C1C"), (1, "R", "C1C"), (2, "E", "C1C"), (3, "C", "C2I")):
        rows = np.flatnonzero(o.system == system)
        for row in rows[:: len(rows) // 20]:
            values = found[code].sel(sv=f"{letter}{o.sat[row]:02d}").values
            assert abs(values[o.epoch[row]] - o.pseudorange[row, 0]) < 6e-4, SYSTEM_NAMES[system]
    messages = georinex.load(folder / "run.nav")
    elements = messages.sel(sv=f"G{o.sat[0]:02d}").dropna("time", how="all")
    a = float(elements["sqrtA"].values[0]) ** 2
    radius = np.linalg.norm(o.sat_pos_e[o.system == 0], axis=1)
    assert abs(a / np.median(radius) - 1) < 1e-5
    assert (
        "GPSA" in messages.attrs["ionospheric_corr_GPS"] or len(messages.attrs["ionospheric_corr_GPS"]) == 8
    )
