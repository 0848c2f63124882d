"""Tracks of positions become truth: files of five formats, real ones, and flights known exactly."""

import re
from datetime import UTC, datetime, timedelta
from functools import reduce
from math import cos, degrees, pi, radians
from operator import xor
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.mathematics import earth, rotation
from bench.core.records.flight_specs import TableSpec, TrackSpec
from bench.core.words.exceptions import ConfigError
from bench.io.results.truth_cache import join_pieces
from bench.io.trajectories import track_files
from bench.io.trajectories.track_files import FixSeries, order_fixes, read_track
from bench.io.trajectories.track_fit import find_least, fit_track
from bench.io.trajectories.track_motion import (
    choose_piece,
    coordinate,
    fill_slow,
    find_bank,
    find_jump,
    find_lone,
    find_standing,
    make_motion,
)
from bench.io.trajectories.trajectory import read_trajectory
from bench.simulation.flight import fly
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import STurns
from tests.exchange.resolution_table import FLIGHTS, RATES, find_off
from tests.flight.inertial import replay
from tests.flight.plans import plan

REAL = Path(__file__).parent / "tracks"
BEGIN = datetime(2026, 3, 1, 23, 58, 0, tzinfo=UTC)  # the clock passes midnight


def write_gpx(rows):
    points = "".join(
        f'<trkpt lat="{lat:.8f}" lon="{lon:.8f}"><ele>{alt:.3f}</ele>'
        f"<time>{(BEGIN + timedelta(seconds=t)).isoformat().replace('+00:00', 'Z')}</time></trkpt>"
        for t, lat, lon, alt in rows
    )
    return f'<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'


def write_kml(rows):
    when = "".join(f"<when>{(BEGIN + timedelta(seconds=t)).isoformat()}</when>" for t, *_ in rows)
    coord = "".join(f"<gx:coord>{lon:.8f} {lat:.8f} {alt:.3f}</gx:coord>" for _, lat, lon, alt in rows)
    spaces = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
    return f"<kml {spaces}><Placemark><gx:Track>{when}{coord}</gx:Track></Placemark></kml>"


def checked(body):
    return f"${body}*{reduce(xor, body.encode(), 0):02X}"


def write_nmea(rows):
    lines = ["program startup"]
    for t, lat, lon, alt in rows:
        at = BEGIN + timedelta(seconds=t)
        y, x = abs(lat), abs(lon)
        north, east = "NS"[int(lat < 0)], "EW"[int(lon < 0)]
        place = f"{int(y):02d}{y % 1 * 60:09.6f},{north},{int(x):03d}{x % 1 * 60:09.6f},{east}"
        body = f"GPGGA,{at:%H%M%S}.{at.microsecond // 10000:02d},{place},1,08,0.9,{alt - 47.0:.3f},M,47.0,M,,"
        lines.append(checked(body))
    return "\n".join(lines)


def write_igc(rows):
    lines = ["AXXX001", "HFDTE010326"]
    for t, lat, lon, alt in rows:
        at, y, x = BEGIN + timedelta(seconds=t), abs(lat), abs(lon)
        north, east = "NS"[int(lat < 0)], "EW"[int(lon < 0)]
        place = f"{int(y):02d}{round(y % 1 * 60000):05d}{north}{int(x):03d}{round(x % 1 * 60000):05d}"
        lines.append(f"B{at:%H%M%S}{place}{east}A{round(alt) - 100:05d}{round(alt):05d}")
    return "\n".join(lines)


def write_csv(rows):
    return "t_s,lat_deg,lon_deg,alt_m\n" + "\n".join(",".join(f"{v:.9f}" for v in row) for row in rows)


WRITERS = {".gpx": write_gpx, ".kml": write_kml, ".nmea": write_nmea, ".igc": write_igc, ".csv": write_csv}


def circle(seconds=120.0, step=1.0, speed=25.0, radius=300.0, lat=-33.0, lon=-70.5, noise=0.0):
    """Rows of a level circle by pymap3d; southern and western, so that signs matter."""
    t = np.arange(0.0, seconds, step)
    angle = speed / radius * t
    rng = np.random.default_rng(3)
    n, e, d = radius * np.sin(angle), radius * (1 - np.cos(angle)), 0 * t
    n, e, d = (part + noise * rng.standard_normal(len(t)) for part in (n, e, d))
    return np.column_stack([t, *pymap3d.ned2geodetic(n, e, d, lat, lon, 800.0)])


def order(rows):
    """Fixes of rows with degrees."""
    return FixSeries(rows[:, 0], np.column_stack([np.radians(rows[:, 1:3]), rows[:, 3]]), ())


@pytest.mark.parametrize(("ending", "off"), [(".gpx", 0.01), (".kml", 0.01), (".nmea", 0.01), (".igc", 1.5)])
def test_every_format_gives_the_fixes_back(tmp_path, ending, off):
    """IGC has thousandths of minutes, whole meters and whole seconds."""
    rows = circle()
    path = tmp_path / f"track{ending}"
    path.write_text(WRITERS[ending](rows))
    track = read_track(path)
    assert_allclose(track.t, rows[:, 0], atol=1e-6)
    true = np.column_stack([np.radians(rows[:, 1:3]), rows[:, 3]])
    assert np.abs(earth.to_ecef(track.lla) - earth.to_ecef(true)).max() < off


@pytest.mark.parametrize("ending", list(WRITERS))
def test_a_profile_flies_any_of_them(tmp_path, ending):
    """By the command's own way in: the circle is flown at the bank of a coordinated turn."""
    (tmp_path / f"track{ending}").write_text(WRITERS[ending](circle(60.0)))
    spec = TableSpec("track", tmp_path / f"track{ending}", 100.0, 40.0)
    truth = join_pieces(list(read_trajectory(spec)))
    roll, pitch, _ = rotation.to_euler(truth.q_nb)
    middle = slice(1000, 3000)
    bank = np.arctan(25.0**2 / 300.0 / 9.80665)
    assert_allclose(np.degrees(roll[middle]), degrees(bank), atol=3.0 if ending == ".igc" else 0.2)
    # the nose is up by the incidence, in the plane of the wings
    assert_allclose(np.degrees(pitch[middle]), 3.0 * cos(bank), atol=1.0 if ending == ".igc" else 0.1)


def thinned(truth, step, noise, seed):
    rng = np.random.default_rng(seed)
    at = np.arange(0.0, truth.t[-1], step)
    rows = np.round(at / truth.t[1]).astype(int)
    lla = truth.lla[rows].copy()
    pos_n = noise * rng.standard_normal((len(rows), 3))
    lla = np.array([earth.displace(place, off) for place, off in zip(lla, pos_n, strict=True)])
    return np.column_stack([at, np.degrees(lla[:, :2]), lla[:, 2]])


@pytest.fixture(scope="module")
def swinging():
    """A flight of s-turns of 60 deg to either side at 30 deg of bank."""
    return fly(plan(Straight(10.0), STurns(radians(60.0), radians(30.0), 2), Straight(10.0)))


@pytest.mark.parametrize("told", [1.0, None])
def test_a_flight_at_1_hz_with_a_meter_of_noise_comes_back(swinging, told):
    """Six runs: at most 0.8 m an axis and 3 deg of roll (rms) off the flight it was."""
    offs, turned = [], []
    for seed in range(6):
        rows = thinned(swinging, 1.0, 1.0, seed)
        track = order(rows)
        motion = make_motion(track, TrackSpec(noise=told, vertical_noise=told), "t")
        k = np.round(motion.t / swinging.t[1]).astype(int)
        offs.append(earth.difference_n(earth.to_geodetic(motion.pos_e), swinging.lla[k]))
        q_en = rotation.from_matrix(earth.matrix_en(*swinging.lla[k, :2].T))
        roll = rotation.to_euler(rotation.multiply(rotation.conjugate(q_en), motion.q_eb))[0]
        turned.append(np.degrees(roll - rotation.to_euler(swinging.q_nb[k])[0]))
    assert (np.sqrt(np.mean(np.concatenate(offs) ** 2, axis=0)) < 0.8).all()
    assert np.sqrt(np.mean(np.concatenate(turned) ** 2)) < 3.0


def test_a_track_that_does_not_resolve_its_turns_is_refused(tmp_path, swinging):
    """Fixes 5 s apart, with or without noise that is told: the turns reverse within 12 s."""
    (tmp_path / "t.csv").write_text(write_csv(thinned(swinging, 5.0, 1.0, 8)))
    with pytest.raises(
        ConfigError, match=r"t\.csv: .*(do not resolve its turns|no aircraft moves like that)"
    ):
        list(read_trajectory(TableSpec("t", tmp_path / "t.csv", 100.0, None)))


def test_circles_are_not_taken_for_a_standstill():
    """A fix in 5 s on circles of 19 s: the smoothest curve stays in their middle."""
    rows = circle(seconds=300.0, step=5.0, radius=76.0)
    fixes = order(rows)
    with pytest.raises(ConfigError, match=r"5 s apart, do not resolve its turns: .* missed by \d\d"):
        make_motion(fixes, TrackSpec(), "circles")


def places(ned):
    """Latitude, longitude [rad] and height of places by pymap3d."""
    lat, lon, alt = pymap3d.ned2geodetic(*ned.T, 47.0, 11.0, 500.0)
    return np.column_stack([np.radians(lat), np.radians(lon), alt])


def test_noise_that_may_be_turns_is_told():
    """Turns of 25 deg of bank at 45 m/s, a fix in 5 s with 1 m of noise: the estimate is 3 to 5 m."""
    t = np.arange(0.0, 240.0, 0.05)
    rate = 0.1 * (np.clip((t - 30) / 4, 0, 1) - np.clip((t - 60) / 4, 0, 1) - np.clip((t - 80) / 4, 0, 1))
    course = np.cumsum(rate + 0.1 * np.clip((t - 130) / 4, 0, 1)) * 0.05
    way = np.cumsum(45.0 * np.column_stack([np.cos(course), np.sin(course), 0 * t]), axis=0) * 0.05
    at = slice(None, None, 100)
    lla = places(way[at] + np.random.default_rng(7).standard_normal(way[at].shape))
    for told, most in ((None, 4.0), (1.0, 1.2)):
        motion = make_motion(FixSeries(t[at], lla, ()), TrackSpec(noise=told, vertical_noise=1.0), "t")
        off = earth.difference_n(earth.to_geodetic(motion.pos_e), places(way[: len(motion.t)]))
        assert (np.sqrt(np.mean(off**2, axis=0)) < most).all()
        said = any("may be turns" in text for *_, text in motion.notes)
        assert said == (told is None)


@pytest.mark.parametrize("name", list(FLIGHTS))
def test_what_is_accepted_is_near_the_flight(name):
    """A meter of noise: off by less than 2 m at 0.2 Hz, and less than 1 m above; only 0.2 Hz is rejected."""
    for rate in RATES:
        for noise in (None, 1.0):
            try:
                off = find_off(name, rate, noise, seed=5)
            except ConfigError:
                off = 0.0 if rate < 0.5 and name.startswith(("s-turns", "circles")) else np.inf
            assert off < (2.0 if rate < 0.5 else 1.0), (rate, noise)


def test_turns_that_are_taken_for_noise_are_refused():
    """With noise that is told the same fixes are a meter off."""
    with pytest.raises(ConfigError, match=r"5 s apart, do not resolve its turns: .* m of noise are turns"):
        find_off("s-turns, 20 deg, 45 m/s", 0.2, None)
    assert find_off("s-turns, 20 deg, 45 m/s", 0.2, 1.0) < 1.2
    assert find_off("s-turns, 20 deg, 45 m/s", 0.2, 6.0) < 6.0  # told is told


def test_noise_alone_is_not_taken_for_turns():
    """Ten straight tracks with 6 m of noise, a fix in 5 s: each is accepted, and none is said to turn."""
    for seed in range(10):
        t = np.arange(0.0, 240.0, 5.0)
        way = np.column_stack([45.0 * t, 0 * t, 0 * t]) + 6.0 * np.random.default_rng(seed).standard_normal(
            (48, 3)
        )
        motion = make_motion(FixSeries(t, places(way), ()), TrackSpec(vertical_noise=6.0), "t")
        assert not any("may be turns" in text for *_, text in motion.notes)


def test_degrees_that_may_be_radians_are_told():
    rows = circle()
    for scale, told in ((1.0, False), (pi / 180, True)):
        lla = np.column_stack([np.radians(scale * rows[:, 1:3]), rows[:, 3]])
        motion = make_motion(FixSeries(rows[:, 0], lla, ()), TrackSpec(noise=1.0), "t")
        assert any("are latitude and longitude in radians?" in text for *_, text in motion.notes) == told


@pytest.mark.parametrize("least", [-8.0, -7.9, 0.3, 4.321, 9.99, 10.0])
def test_the_penalty_with_the_least_risk_is_found(least):
    """To the width of 24 golden sections of three decades; a shallower valley elsewhere does not matter."""
    there = -7.0 if least > 1.0 else 9.0
    found = find_least(lambda x: min(abs(x - least) ** 1.5, 1.0 + abs(x - there)), -8.0, 10.0)
    assert abs(found - least) < 1e-4


def test_noise_is_estimated_where_it_is_not_told():
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 600.0)
    smooth = np.column_stack([25 * t, 60 * np.sin(2 * pi * t / 40)])
    for noise in (0.3, 3.0):
        fit = fit_track(t, smooth + noise * rng.standard_normal((600, 2)), np.ones(600), None)
        assert_allclose(fit.noise, noise, rtol=0.1)
        assert np.sqrt(((fit.spline(t) - smooth) ** 2).mean()) < 0.7 * noise


def test_standing_still_stays_still():
    """A car drives, stands for a minute in a meter of noise, and drives on."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 180.0)
    gone = 10.0 * (np.minimum(t, 60) + np.maximum(t - 120, 0))
    rows = np.column_stack([gone, 0 * t, 0 * t]) + 1.0 * rng.standard_normal((180, 3))
    lla = np.column_stack(pymap3d.ned2geodetic(*rows.T, 47.0, 11.0, 500.0))
    lla[:, :2] = np.radians(lla[:, :2])
    motion = make_motion(FixSeries(t, lla, ()), TrackSpec(vehicle="ground"), "car")
    standing = (motion.t > 75) & (motion.t < 105)
    speed = np.linalg.norm(np.diff(motion.pos_e[standing], axis=0), axis=1) * 20.0
    assert speed.max() < 0.01
    assert any("stands once, " in note[3] for note in motion.notes)
    (said,) = (note[3] for note in motion.notes if "smoothed" in note[3])
    noise, vertical = (
        float(x) for x in re.findall(r"noise ([\d.]+) m each axis.* ([\d.]+) m in height", said)[0]
    )
    assert_allclose([noise, vertical], 1.0, rtol=0.15)
    roll, pitch, _ = rotation.to_euler(
        rotation.multiply(
            rotation.conjugate(rotation.from_matrix(earth.matrix_en(*lla[0, :2]))), motion.q_eb[standing]
        )
    )
    assert np.degrees(np.abs([roll, pitch])).max() < 0.1


def test_wind_turns_the_nose_into_it_and_not_the_track(tmp_path):
    rows = np.column_stack(
        [np.arange(60.0), 47 + 25 * np.arange(60.0) / 111_200, np.full(60, 11.0), np.full(60, 900.0)]
    )
    (tmp_path / "t.csv").write_text(write_csv(rows))
    wind = TrackSpec(wind_from=radians(270.0), wind_speed=7.0)
    truth = join_pieces(list(read_trajectory(TableSpec("t", tmp_path / "t.csv", 100.0, 50.0, track=wind))))
    heading = np.degrees(rotation.to_euler(truth.q_nb)[2])
    assert_allclose(heading[1000:4000] % 360, 360 - degrees(np.arctan2(7.0, 25.0)), atol=0.2)
    assert_allclose(truth.vel_n[1000:4000, 1], 0.0, atol=0.05)


# --- real ones, and damaged ones ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "track", "length", "fastest"),
    [
        ("car.nmea", TrackSpec(vehicle="ground"), 300.0, 30.0),
        ("run.gpx", TrackSpec(vehicle="ground"), 809.0, 5.0),
        ("glider.igc", TrackSpec(end=600.0), 597.0, 60.0),
    ],
)
def test_a_real_track_becomes_a_truth_that_replays(name, track, length, fastest):
    truth = join_pieces(list(read_trajectory(TableSpec("t", REAL / name, 100.0, 200.0, track=track))))
    distance, _ = replay(truth, 100.0)
    assert distance < 5e-3
    assert np.linalg.norm(truth.vel_n, axis=1).max() < fastest
    assert read_track(REAL / name).t[-1] >= length
    said = [text for _, _, text in truth.events.select("table")]
    assert any("smoothed" in text for text in said)


def test_circles_of_a_glider_at_eight_seconds_are_refused():
    with pytest.raises(ConfigError, match=r"glider\.igc: its fixes, \d+ s apart, do not resolve its turns"):
        make_motion(read_track(REAL / "glider.igc"), TrackSpec(begin=1200.0, end=1500.0), "glider.igc")


@pytest.mark.parametrize(
    ("ending", "text", "says"),
    [
        (".gpx", "<gpx><trk><trkpt lat='1' lon='2'/></trk></gpx>", "no <trkpt> with a <time>"),
        (".gpx", "<gpx><trk>", "not well-formed XML"),
        (".kml", "<kml><LineString/></kml>", "a <LineString> has no times"),
        (".nmea", "$GPGGA,nonsense*00\n", "0 fixes with time"),
        (".igc", "B9999\n", "0 fixes with time"),
    ],
)
def test_what_is_no_track_is_named_in_one_line(tmp_path, ending, text, says):
    path = tmp_path / f"bad{ending}"
    path.write_text(text)
    with pytest.raises(ConfigError, match=says) as told:
        read_track(path)
    assert "\n" not in str(told.value)


def test_broken_sentences_and_gaps_are_told(tmp_path):
    lines = write_nmea(circle(100.0)).splitlines()
    lines[20] = lines[20].replace("GPGGA", "GPGGB").replace("GGB", "GGA")[:-1] + "Z"
    del lines[40:50]
    path = tmp_path / "t.nmea"
    path.write_text("\n".join(lines))
    track = read_track(path)
    assert "left out: 1 sentence with a wrong checksum" in track.notes
    motion = make_motion(track, TrackSpec(), "t")
    assert any("1 gap of up to 11 s bridged" in note[3] for note in motion.notes)
    cut = make_motion(track, TrackSpec(bridge=5.0), "t")
    assert cut.t[-1] == pytest.approx(track.t[-1] - 49.0, abs=1.1)
    assert any("cut at 1 gap of" in note[3] for note in cut.notes)


@pytest.mark.parametrize("noise", [None, 1.0])
def test_a_track_that_jumps_is_refused_with_its_place(noise):
    """By 1 km to the north after 60 s; a fix that alone is there, or 40 m up, is an outlier."""
    rows = circle(120.0, noise=1.0)
    moved = rows.copy()
    moved[60:, 1] += 1000.0 / 111_000
    with pytest.raises(ConfigError, match=r"They jump by (9|10)\d\d m at 60 s \(from_s, to_s\)"):
        make_motion(order(moved), TrackSpec(noise=noise), "t")
    moved[61:] = rows[61:]
    motion = make_motion(order(moved), TrackSpec(noise=noise), "t")
    assert any(note[3].startswith("left out: 1 outlier, up to 9") for note in motion.notes)
    rows[30, 3] += 40.0
    motion = make_motion(order(rows), TrackSpec(noise=noise), "t")
    assert any(re.match(r"left out: 1 outlier, up to (3|4)\d", note[3]) for note in motion.notes)


def test_times_in_milliseconds_are_told_by_their_interval():
    rows = circle(60.0)
    rows[:, 0] *= 1000.0
    with pytest.raises(ConfigError, match=r"has 1 fix; .* their median interval is 1000 s"):
        make_motion(order(rows), TrackSpec(), "t")


def test_a_table_with_an_attitude_wants_no_track(tmp_path):
    rows = circle(30.0)
    text = "t_s,lat_deg,lon_deg,alt_m,roll_deg,pitch_deg,heading_deg\n"
    (tmp_path / "t.csv").write_text(
        text + "\n".join(",".join(f"{v:.9f}" for v in (*row, 0, 0, 0)) for row in rows)
    )
    with pytest.raises(ConfigError, match="because the table contains an attitude"):
        list(read_trajectory(TableSpec("t", tmp_path / "t.csv", 100.0, None, track=TrackSpec())))


def test_the_command_says_what_was_changed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walk.gpx").write_text(write_gpx(circle(60.0, noise=0.5)))
    (tmp_path / "walk.toml").write_text(
        'trajectory = "walk.gpx"\nrate_hz = 100\nevaluation = { from_s = 10.0 }\n'
    )
    assert main(["fly", "walk.toml"]) == 0
    out = capsys.readouterr().out
    assert "smoothed" in out
    assert "ground speed" in out
    assert "airspeed" not in out
    assert "incidence of 3 deg" in " ".join(out.split())


# --- parts, by hand -----------------------------------------------------------------------------------


def test_an_igc_without_heights_of_a_receiver_has_those_of_the_pressure(tmp_path):
    """South and west, past midnight, every other fix marked as two-dimensional; a damaged line is none."""
    place, damaged = "3312345S07030500W", "B2359593312345S070x0500WA0070000000"
    clocks = [f"{t // 3600 % 24:02d}{t // 60 % 60:02d}{t % 60:02d}" for t in range(86394, 86406)]
    lines = [f"B{clock}{place}{'AV'[k % 2]}00{704 + k}00000" for k, clock in enumerate(clocks)]
    (tmp_path / "t.igc").write_text("\n".join([*lines[:6], damaged, *lines[6:]]))
    track = read_track(tmp_path / "t.igc")
    assert_allclose(track.t, np.arange(12.0))
    assert_allclose(np.degrees(track.lla[:, :2]), np.tile([-(33 + 12.345 / 60), -(70 + 30.5 / 60)], (12, 1)))
    assert_allclose(track.lla[:, 2], 704.0 + np.arange(12))
    assert track.notes == (
        "6 fixes are marked as two-dimensional",
        "heights are pressure heights above 1013.25 hPa: the file has no GNSS heights",
    )


@pytest.mark.parametrize("height", ["006--", "99-12", "0069\xb9", "-0\xb269", "0-069", "+0069"])
def test_a_b_record_of_igc_is_read_as_it_is_checked(tmp_path, height):
    lines = write_igc(circle(30.0)).splitlines()
    lines[7] = lines[7][:25] + height + lines[7][30:]
    lines[9] = lines[9][:17] + "1\xb2" + lines[9][19:]
    path = tmp_path / "t.igc"
    path.write_text("\n".join(lines), encoding="latin-1")
    assert len(read_track(path).t) == 28


def test_a_track_of_too_many_fixes_is_refused_before_it_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(track_files, "MOST_FIXES", 20)
    for ending in (".gpx", ".kml", ".nmea", ".igc"):
        (tmp_path / f"track{ending}").write_text(WRITERS[ending](circle(60.0)))
        with pytest.raises(ConfigError, match="more than 20 fixes"):
            read_track(tmp_path / f"track{ending}")


def test_sentences_without_a_fix_are_left_out_and_heights_above_the_sea_told(tmp_path):
    """With a separation of 47 m a height of 600 m is 647 m; ddmm.mmmm is 48 deg 7.038 min."""
    place = "4807.038,N,01131.5,W"
    bodies = [f"GPGGA,{t:06d}.5,{place},1,08,0.9,600.0,M,47.0,M,," for t in range(235950, 235960)]
    bodies += [f"GPGGA,{t:06d}.5,{place},2,08,0.9,600.0,M,,M,," for t in range(3)]
    bodies += [
        f"GPGGA,000004.5,{place},0,08,0.9,600.0,M,47.0,M,,",
        f"GPGGA,,{place},1,08,0.9,600.0,M,47.0,M,,",
    ]
    (tmp_path / "t.nmea").write_text("\n".join(map(checked, bodies)))
    track = read_track(tmp_path / "t.nmea")
    assert_allclose(track.t, np.arange(13.0))
    assert_allclose(np.degrees(track.lla[0, :2]), [48 + 7.038 / 60, -(11 + 31.5 / 60)])
    assert_allclose(track.lla[:, 2], [647.0] * 10 + [600.0] * 3)
    assert track.notes == (
        "left out: 1 sentence without a fix (quality 0)",
        "3 heights above the sea: sentences without a geoid separation",
    )


def test_fixes_that_cannot_be_and_those_that_go_back_are_left_out():
    t = np.arange(5.0, 25.0)
    lla = np.tile([0.8, 0.2, 600.0], (20, 1))
    for row, column, value in ((1, 0, 1.58), (2, 0, -1.58), (3, 1, 6.3), (4, 1, -6.3), (5, 2, -1001.0),
                               (6, 2, 1.1e5), (7, 2, np.nan)):  # fmt: skip
        lla[row, column] = value
    lla[8] = 1.57, 6.28, 9.9e4
    lla[9] = -1.57, -6.28, -990.0
    t[12], t[11] = t[11] - 2.0, np.nan
    track = order_fixes(t, lla, ["read"], "x")
    kept = [0, 8, 9, 10, *range(13, 20)]
    assert_allclose(track.t, np.array(kept, float))
    assert_allclose(track.lla, lla[kept])
    assert track.notes == (
        "read",
        "left out: 8 fixes without a time, a position or a height",
        "left out: 1 fix not after the one before",
    )


def test_the_longest_piece_in_time_is_used_and_its_gaps_told():
    """Pieces of 6, 18 and 10 s; in that of 18 s an interval of 8 s, within bridge_s: above three of 2 s."""
    t = 2.0 * np.array([0.0, 1, 2, 3, 23, 24, 25, 29, 30, 31, 32, 52, 52.5, 53, 53.5, 54, 54.5, 55, 56, 57])
    notes: list[str] = []
    found, lla = choose_piece(t, np.arange(60.0).reshape(20, 3), 20.0, notes)
    assert_allclose(found, t[4:11])
    assert_allclose(lla[:, 0], 3.0 * np.arange(4, 11))
    assert notes == [
        "cut at 2 gaps of more than 20 s; the longest piece is used: 46 to 64 s",
        "1 gap of up to 8 s bridged by the curve; the median interval is 2 s",
    ]


def test_ten_seconds_below_0_4_meters_a_second_are_standing():
    speed = np.full(60, 5.0)
    speed[3:13], speed[20:31], speed[40:] = 0.3, 0.39, 0.41  # 9 s, 10 s, and not slow enough
    speed[47:] = 0.1
    assert find_standing(np.arange(60.0), speed) == [slice(20, 31), slice(47, 60)]


def test_a_vehicle_too_slow_for_a_course_turns_steadily_and_levels():
    """From south-east over south to south-west, by the short way; the slope fades with the speed."""
    vel_n = np.array(
        [[-3.0, 3.0, 0.6], [0.3, 0.4, 5.0], [0.0, 0.0, 0.0], [0.0, -0.25, 0.0], [-3.0, -3.0, -1.2]]
    )
    found = fill_slow(vel_n)
    angles = pi * np.array([0.75, 0.875, 1.0, 1.125])[1:]
    slopes = np.array([0.6, 0.0, -1.2]) / np.sqrt(18.0)
    between = np.interp([1.0, 2.0, 3.0], [0.0, 4.0], slopes[[0, 2]]) * [0.5, 0.0, 0.25]
    assert_allclose(found[[0, 4]], vel_n[[0, 4]])
    assert_allclose(found[1:4], np.column_stack([np.cos(angles), np.sin(angles), between]), atol=1e-12)
    assert_allclose(fill_slow(vel_n[1:4]), np.tile([1.0, 0.0, 0.0], (3, 1)))


def test_a_turn_without_side_force_banks_by_the_force_and_lifts_the_nose_by_the_incidence():
    """East at 20 m/s, 2 m/s down, turning right: no force along y, x at the incidence above the path."""
    force_n = np.array([[-6.0, 0.0, -9.8]])
    (C_nb,) = coordinate(np.array([[0.0, 20.0, 2.0]]), force_n, 0.05)
    assert_allclose(C_nb.T @ C_nb, np.eye(3), atol=1e-12)
    assert np.linalg.det(C_nb) == pytest.approx(1.0)
    air_b, force_b = C_nb.T @ [0.0, 20.0, 2.0], C_nb.T @ force_n[0]
    assert air_b[1] == pytest.approx(0.0, abs=1e-12)
    assert np.arctan2(air_b[2], air_b[0]) == pytest.approx(0.05)
    assert force_b[1] == pytest.approx(0.0, abs=1e-12)
    assert force_b[2] < 0.0
    assert_allclose(find_bank(rotation.from_euler(*np.array([[-0.7], [0.3], [1.0]]))), 0.7)


def test_a_lone_fix_and_a_jump_are_told_from_a_fast_vehicle():
    """10 m in 2 s; 500 m aside for one fix, 400 and 300 m ahead in two steps, and 800 m from 120 s on."""
    t = 2.0 * np.arange(80)
    fixes = np.column_stack([5.0 * t, 0 * t, 0 * t])
    assert not find_lone(t, fixes).any()
    assert find_jump(t, fixes) == ""
    fixes[12, 1] = 500.0
    fixes[30:, 0] += 390.0
    fixes[31:, 0] += 290.0
    fixes[50, 1], fixes[51:, 0] = 40.0, fixes[51:, 0] - 10.0  # not five times as fast as others
    assert np.flatnonzero(find_lone(t, fixes)).tolist() == [12]
    fixes[60:, 0] += 790.0
    assert find_jump(t, fixes) == ". They jump by 800 m at 120 s (from_s, to_s)"
    assert np.flatnonzero(find_lone(t, fixes)).tolist() == [12]
