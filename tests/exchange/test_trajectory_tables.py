"""A table somebody else made becomes truth: it passes through the table, and its increments replay it.

The tables are made by pymap3d and scipy alone; the replay is `tests/flight/inertial.py`, which shares normal
gravity and the rate and figure of the Earth with the bench.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pymap3d
import pytest
from pyarrow import parquet
from scipy.spatial.transform import Rotation

from bench import pipeline
from bench.cli.command_line import main
from bench.core.mathematics.earth import to_ecef
from bench.core.mathematics.rotation import multiply, to_rotvec
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import TableSpec
from bench.core.words.exceptions import ConfigError
from bench.io.config import read_profile
from bench.io.results import parquet as parquet_file
from bench.io.results.truth_cache import join_pieces, truth_key
from bench.io.trajectories import trajectory
from tests.flight.inertial import inertial, largest_difference, navigate, replay

MM, UM = 1e-3, 1e-6  # [m], and [rad] for microradians


def turns(rate: float, duration: float) -> dict[str, np.ndarray]:
    """A winding flight of up to 0.5 g: positions by pymap3d, attitude by scipy."""
    t = np.arange(round(duration * rate) + 1) / rate
    w = 2 * np.pi / 120
    north, east, down = 500 * np.sin(w * t) + 45 * t, 300 * np.sin(2 * w * t), -60 * np.sin(0.5 * w * t)
    lat, lon, alt = pymap3d.ned2geodetic(north, east, down, 47.3, 11.4, 1500.0)
    v_n, v_e, v_d = 500 * w * np.cos(w * t) + 45, 600 * w * np.cos(2 * w * t), -30 * w * np.cos(0.5 * w * t)
    heading, pitch = np.arctan2(v_e, v_n), 0.03 - np.arctan2(v_d, np.hypot(v_n, v_e))
    roll = 0.5 * np.sin(2 * w * t + 0.3)
    x, y, z = pymap3d.geodetic2ecef(lat, lon, alt)
    # velocity in the local level frame of the position, by differences of pymap3d's own positions
    step = 1e-2
    ahead = (500 * np.sin(w * (t + step)) + 45 * (t + step), 300 * np.sin(2 * w * (t + step)))
    lla = pymap3d.ned2geodetic(*ahead, -60 * np.sin(0.5 * w * (t + step)), 47.3, 11.4, 1500.0)
    behind = (500 * np.sin(w * (t - step)) + 45 * (t - step), 300 * np.sin(2 * w * (t - step)))
    lla_b = pymap3d.ned2geodetic(*behind, -60 * np.sin(0.5 * w * (t - step)), 47.3, 11.4, 1500.0)
    vel = np.array(pymap3d.geodetic2ned(*lla, lat, lon, alt)) - np.array(
        pymap3d.geodetic2ned(*lla_b, lat, lon, alt)
    )
    vel /= 2 * step
    q = np.roll(Rotation.from_euler("ZYX", np.stack([heading, pitch, roll], axis=-1)).as_quat(), 1, axis=1)
    return {
        "t_s": t,
        "lat_deg": lat,
        "lon_deg": lon,
        "alt_m": alt,
        "q_nb_w": q[:, 0],
        "q_nb_x": q[:, 1],
        "q_nb_y": q[:, 2],
        "q_nb_z": q[:, 3],
        "vel_n_mps": vel[0],
        "vel_e_mps": vel[1],
        "vel_d_mps": vel[2],
        "roll_deg": np.rad2deg(roll),
        "pitch_deg": np.rad2deg(pitch),
        "heading_deg": np.rad2deg(heading) % 360.0,
        "ecef_x_m": x,
        "ecef_y_m": y,
        "ecef_z_m": z,
    }


GEODETIC = ("t_s", "lat_deg", "lon_deg", "alt_m")
QUATERNION = ("q_nb_w", "q_nb_x", "q_nb_y", "q_nb_z")
EULER = ("roll_deg", "pitch_deg", "heading_deg")
VELOCITY = ("vel_n_mps", "vel_e_mps", "vel_d_mps")


def write(path: Path, table: dict[str, np.ndarray], names: tuple[str, ...]) -> Path:
    if path.suffix == ".parquet":
        parquet.write_table(pa.table({name: table[name] for name in names}), path)
    else:
        rows = np.column_stack([table[name] for name in names])
        np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="", fmt="%.12f")
    return path


def fly(path: Path, rate: float = 200.0, duration: float | None = None) -> Trajectory:
    return join_pieces(trajectory.read_trajectory(TableSpec(path.stem, path, rate, duration)))


def sanity(truth: Trajectory) -> str:
    return "\n".join(text for _, _, text in truth.events.select("sanity"))


def off_rows(truth: Trajectory, table: dict[str, np.ndarray], rate: float) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] of the truth from rows, compared by pymap3d's and scipy's own."""
    k = np.round(table["t_s"] * rate).astype(int)
    k, there = k[k < len(truth)], k < len(truth)
    position = np.stack([table[f"ecef_{axis}_m"][there] for axis in "xyz"], axis=-1)
    distance = np.linalg.norm(to_ecef(truth.lla[k]) - position, axis=1).max()
    q = np.stack([table[name][there] for name in QUATERNION], axis=-1)
    angle = np.linalg.norm(to_rotvec(multiply(truth.q_nb[k] * [1, -1, -1, -1], q)), axis=1).max()
    return float(distance), float(angle)


@pytest.mark.parametrize(
    ("rate", "ending", "names"),
    [
        (20.0, ".csv", (*GEODETIC, *EULER)),
        (100.0, ".parquet", (*GEODETIC, *QUATERNION, *VELOCITY)),
        (5.0, ".parquet", ("t_s", "ecef_x_m", "ecef_y_m", "ecef_z_m", *QUATERNION)),
    ],
)
def test_ten_minutes_of_a_table_come_back_within_a_millimeter_and_a_microradian(
    tmp_path, rate, ending, names
):
    table = turns(rate, 600.0)
    truth = fly(write(tmp_path / f"made{ending}", table, names))
    assert len(truth) == 120_001
    distance, angle = replay(truth, 200.0)
    assert distance < 1 * MM
    assert angle < 1 * UM
    assert sanity(truth) == ""
    distance, angle = off_rows(truth, table, 200.0)
    assert distance < 1e-2 * MM
    assert angle < 1e-2 * UM


def test_between_its_rows_the_truth_is_the_motion_the_table_was_made_from(tmp_path):
    truth = fly(write(tmp_path / "made.parquet", turns(5.0, 120.0), (*GEODETIC, *QUATERNION)))
    distance, angle = off_rows(truth, turns(200.0, 120.0), 200.0)
    assert distance < 1 * MM
    assert angle < 100 * UM  # rows 0.2 s apart, rates of 4 deg/s


def test_what_is_left_of_a_millimeter_is_the_navigator_it_falls_with_the_step(tmp_path):
    path = write(tmp_path / "made.parquet", turns(20.0, 300.0), (*GEODETIC, *QUATERNION))
    slow, fast = (replay(fly(path, rate), rate)[0] for rate in (100.0, 200.0))
    assert slow / fast > 3


def test_the_replay_sees_increments_that_are_not_integrals(tmp_path):
    truth = fly(write(tmp_path / "made.parquet", turns(20.0, 300.0), (*GEODETIC, *QUATERNION)))
    reference = inertial(truth)
    start = tuple(column[0] for column in reference)
    found = navigate(1 / 200, truth.dtheta_b, truth.dvel_b, start, two_sample=False)
    assert largest_difference(found, reference)[0] > 1 * MM


def test_a_truth_of_the_bench_is_a_table_too(tmp_path, short_truth):
    parquet_file.write(tmp_path / "truth.parquet", short_truth)
    truth = fly(tmp_path / "truth.parquet", 100.0)
    assert [t for *_, t in truth.events.select("table")] == [
        "columns not used: dtheta_x_rad, dtheta_y_rad, dtheta_z_rad, dvel_x_mps, dvel_y_mps, dvel_z_mps"
    ]
    distance = np.linalg.norm(to_ecef(truth.lla) - to_ecef(short_truth.lla[: len(truth)]), axis=1)
    assert distance.max() < 1 * MM
    assert sanity(truth) == ""


def edited(tmp_path: Path, change, names=(*GEODETIC, *QUATERNION, *VELOCITY), rate: float = 20.0) -> Path:
    table = turns(rate, 30.0)
    change(table)
    return write(tmp_path / "bad.parquet", table, names)


def set_row(name: str, row: int, value: float):
    def change(table: dict[str, np.ndarray]) -> None:
        table[name][row - 1] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_row("t_s", 101, 4.0), r"bad.parquet: row 101: t_s = 4 is not after 4.95"),
        (set_row("lat_deg", 7, np.nan), r"bad.parquet: row 7: lat_deg is not a finite number"),
        (set_row("lat_deg", 7, 95.0), r"bad.parquet: row 7: lat_deg = 95 is outside -90 to 90"),
        (set_row("q_nb_w", 9, 3.0), r"bad.parquet: row 9: the quaternion has the norm 3\.\d*, not 1"),
    ],
)
def test_what_cannot_be_is_refused_with_its_row(tmp_path, change, message):
    with pytest.raises(ConfigError, match=f"^{message}$"):
        fly(edited(tmp_path, change))


def scale_rows(names: tuple[str, ...], row: int, factor: float):
    def change(table: dict[str, np.ndarray]) -> None:
        for name in names:
            table[name][row - 1] *= factor

    return change


def roll_over(table: dict[str, np.ndarray]) -> None:
    q = np.stack([table[name] for name in QUATERNION], axis=-1)
    q[300:] = multiply(q[300:], [0.0, 1.0, 0.0, 0.0])
    table.update(zip(QUATERNION, q.T, strict=True))


def without_rows(table: dict[str, np.ndarray]) -> None:
    for name in table:
        table[name] = np.delete(table[name], slice(200, 240))


def kilometers_per_hour(table: dict[str, np.ndarray]) -> None:
    table["vel_n_mps"] *= 3.6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            scale_rows(QUATERNION, 9, 1.001),
            r"1 quaternions from row 9 on have a norm other than 1, row 9 the worst: 1.001",
        ),
        (without_rows, r"row 201: 2.05 s after the row before; the median is 0.05 s: filled by the spline"),
        (roll_over, r"row 301: the attitude jumps by 1[78]\d(.\d)? deg in 0.05 s"),
        (
            kilometers_per_hour,
            r"row \d+: the velocity is \d+ m/s off the derivative of the position.*601 rows from row 1",
        ),
        (set_row("alt_m", 300, 1700.0), r"row (299|30\d): a specific force of \d\S* g, beyond 10 g"),
    ],
)
def test_what_is_inconsistent_is_reported_with_its_row_and_flown(tmp_path, change, message):
    assert sanity(fly(edited(tmp_path, lambda table: None))) == ""
    assert re.search(message, sanity(fly(edited(tmp_path, change))))


def test_headings_of_a_flight_to_the_north_are_degrees(tmp_path):
    """A few tenths of a degree are along the path as radians, too."""
    n = np.arange(201)
    table = {"t_s": n / 20, "lat_deg": 47.0 + 1e-5 * n, **dict.fromkeys(("lon_deg", "alt_m"), 0 * n + 11.0)}
    table |= {"roll_deg": 0.0 * n, "pitch_deg": 0.0 * n, "heading_deg": 0.0 * n + 0.3}
    assert sanity(fly(write(tmp_path / "t.csv", table, (*GEODETIC, *EULER)))) == ""


@pytest.mark.parametrize("turned", [0.0, -90.0])
def test_angles_in_radians_below_a_name_in_degrees_are_told(tmp_path, turned):
    """The flight winds about north; turned, its headings are on both sides of 0."""
    table = turns(20.0, 60.0)
    east, north = table["lon_deg"] - 11.4, table["lat_deg"] - 47.3
    if turned:  # to the west, about
        table["lat_deg"] = 47.3 + east * np.cos(np.radians(47.3))
        table["lon_deg"] = 11.4 - north / np.cos(np.radians(47.3))
    table["heading_deg"] = (table["heading_deg"] + turned + 180.0) % 360.0 - 180.0
    names = (*GEODETIC, *EULER)
    assert "radians" not in sanity(fly(write(tmp_path / "t.csv", table, names)))
    table["heading_deg"] = np.radians(table["heading_deg"])
    said = sanity(fly(write(tmp_path / "t.csv", table, names)))
    assert "is along the path as radians only: it would be heading_rad" in said
    table["lat_deg"], table["lon_deg"] = np.radians(table["lat_deg"]), np.radians(table["lon_deg"])
    assert "are latitude and longitude in radians?" in sanity(fly(write(tmp_path / "t.csv", table, names)))


def test_rows_off_the_truth_between_its_knots_are_reported(tmp_path):
    clean = edited(tmp_path, lambda table: None, rate=100.0)
    assert sanity(fly(clean)) == ""
    noisy = edited(tmp_path, set_row("alt_m", 1002, 1560.0), rate=100.0)
    assert "row 1002" in sanity(fly(noisy))


def test_a_table_that_starts_later_is_shifted_and_says_so(tmp_path):
    def later(table: dict[str, np.ndarray]) -> None:
        table["t_s"] += 12.5

    truth = fly(edited(tmp_path, later))
    assert truth.t[0] == 0.0
    assert "t = 0 is t_s = 12.5 of the table" in [text for *_, text in truth.events.select("table")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no columns for time: t_s or time_s; there are none"),
        (
            "t_s,lat,lon,alt\n0,1,2,3\n",
            "column 'lat' must end in its unit: lat_deg or lat_rad or lat_mrad",
        ),
        (
            "t_s,lat_deg,lon_deg,alt_m\n0,1,2,3\n",
            "1 fixes with time, position and height; at least 10 are needed",
        ),
        ("t_s,lat_deg,lat_rad,lon_deg,alt_m\n", "'lat_deg' and 'lat_rad' are the same quantity"),
        ("t_s,lat_m,lon_deg,alt_m\n", "column 'lat_m' must end in its unit"),
        (f"{','.join((*GEODETIC, *EULER))}\n0,1,2,x,4,5,6\n", "row 1: alt_m = 'x' is not a number"),
        (f"{','.join((*GEODETIC, *EULER))}\n0,1,2\n", "row 1: 3 columns, the header has 7"),
        (f"{','.join((*GEODETIC, *EULER))}\n" + "0,1,2,3,4,5,6\n" * 3, "3 rows; at least 8 are needed"),
        ("\x00\x01\n", "no columns for time"),
        ("a," * 3_000_000, "no columns for time"),
    ],
)
def test_a_csv_that_is_none_is_one_line(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"^bad.csv: {message}") as caught:
        fly(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


def test_a_parquet_that_is_none_is_one_line(tmp_path):
    path = tmp_path / "bad.parquet"
    path.write_bytes(b"PAR1" + b"\xff" * 40 + b"PAR1")
    with pytest.raises(ConfigError, match=r"^bad.parquet: cannot be read: "):
        fly(path)
    parquet.write_table(pa.table({name: ["x"] * 9 for name in (*GEODETIC, *EULER)}), path)
    with pytest.raises(ConfigError, match=r"^bad.parquet: column 't_s' holds string, not numbers$"):
        fly(path)


def test_a_table_longer_than_any_flight_is_refused_before_it_fills_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(trajectory, "MOST_ROWS", 500)
    with pytest.raises(ConfigError, match="more than 500 rows"):
        fly(edited(tmp_path, lambda table: None))
    path = write(tmp_path / "made.csv", turns(20.0, 30.0), (*GEODETIC, *EULER))
    with pytest.raises(ConfigError, match="more than 500 rows"):
        fly(path)
    monkeypatch.setattr(trajectory, "MOST_ROWS", 1000)
    with pytest.raises(ConfigError, match=r"30 s at rate_hz = 200 Hz are 6000 samples, more than 1000"):
        fly(path)


def test_a_profile_of_one_line_flies_a_table_and_judges_the_usual_filter_on_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "made.csv", turns(20.0, 90.0), (*GEODETIC, *EULER))
    (tmp_path / "mine.toml").write_text('trajectory = "made.csv"\n')
    assert main(["run", "mine.toml", "--seed", "3"]) == 0
    assert "horizontal" in capsys.readouterr().out
    assert (tmp_path / "runs/mine-3/flight.rrd").is_file()
    assert main(["fly", "mine.toml", "--set", "duration_s=100"]) == 2
    assert capsys.readouterr().err == "error: made.csv: it lasts 90 s; duration_s = 100 s is longer\n"
    for setting, said in (
        ("trajectory=none.csv", "trajectory = 'none.csv': no such file beside the profile"),
        ("trajectory=made.txt", "trajectory = 'made.txt' must end in .csv or .parquet"),
        ("turbulence_seed=1", "unknown key 'turbulence_seed'"),
        ("aircraft=aerosonde", "aircraft and trajectory: a profile has only one of them"),
    ):
        assert main(["fly", "mine.toml", "--set", setting]) == 2
        assert said in capsys.readouterr().err


def test_a_table_is_shown_once_whether_it_is_read_or_comes_from_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "cache"))
    write(tmp_path / "made.csv", turns(20.0, 90.0), (*GEODETIC, *EULER))
    (tmp_path / "mine.toml").write_text('trajectory = "made.csv"\n')
    profile = read_profile(tmp_path / "mine.toml")
    shown = []
    for _ in range(2):
        shown.clear()
        truth = pipeline.run(profile, show=lambda piece, _: shown.append(piece)).truth
        np.testing.assert_array_equal(np.concatenate([piece.t for piece in shown]), truth.t)


def test_the_cache_knows_a_table_by_its_content_and_the_antenna_counts(tmp_path):
    path = write(tmp_path / "made.csv", turns(20.0, 30.0), (*GEODETIC, *EULER))
    (tmp_path / "mine.toml").write_text('trajectory = "made.csv"\n[antenna]\nforward_m = 1.5\n')
    profile = read_profile(str(tmp_path / "mine.toml"))
    before = truth_key(profile.flight)
    assert truth_key(profile.flight) == before
    path.write_text(path.read_text().replace("1500.0", "1500.1", 1))
    assert truth_key(profile.flight) != before
    assert profile.sensors.antenna_b == (1.5, 0.0, 0.0)


SPEEDS = tuple(
    f"rotor_speed_{place}" for place in ("ahead_right", "ahead_left", "behind_left", "behind_right")
)


def spun(unit: str, *, rotors: tuple[str, ...] = SPEEDS, lowest: float = 300.0):
    """What adds rotor speeds to a table: waves between ``lowest`` and 100 rad/s above it."""

    def change(table: dict[str, np.ndarray]) -> None:
        for k, name in enumerate(rotors):
            wave = lowest + 50.0 * (1.0 + np.sin(0.3 * table["t_s"] + k))
            table[f"{name}_{unit}"] = wave * (30.0 / np.pi if unit == "rpm" else 1.0)

    return change


@pytest.mark.parametrize("unit", ["rad_s", "rpm"])
def test_rotor_speeds_of_a_table_are_those_of_its_truth(tmp_path, unit):
    """Linear between rows of 20 Hz: a wave of 0.3 rad/s within 0.3^2 0.05^2 / 8 of its amplitude."""
    names = (*GEODETIC, *QUATERNION, *(f"{name}_{unit}" for name in SPEEDS))
    truth = fly(edited(tmp_path, spun(unit), names), 100.0)
    waves = [300.0 + 50.0 * (1.0 + np.sin(0.3 * truth.t + k)) for k in range(4)]
    np.testing.assert_allclose(truth.rotors.speed, np.transpose(waves), rtol=0, atol=2e-3)
    np.testing.assert_array_equal(truth.rotors.t, truth.t)
    assert not len(fly(edited(tmp_path, lambda table: None), 100.0).rotors)


@pytest.mark.parametrize(
    ("change", "unit", "base", "message"),
    [
        (spun("rad_s", rotors=SPEEDS[:3]), "rad_s", QUATERNION, "without rotor_speed_behind_right"),
        (spun("rad_s", lowest=-60.0), "rad_s", QUATERNION, r"row 1: rotor_\w+ = -10 is below 0: give"),
        (spun("rad_s", lowest=1e30), "rad_s", QUATERNION, r"row 1: rotor_\w+ = 1e\+30 is above 10000 rad/s"),
        (spun("rad_s", lowest=np.nan), "rad_s", QUATERNION, "row 1: rotor_speed_ahead_right_rad_s is not a"),
        (spun("hz"), "hz", QUATERNION, "_hz' must end in its unit: .*_rad_s or .*_rpm"),
        (spun("rad_s"), "rad_s", (), "right_rad_s needs an attitude in the table: leave it"),
    ],
)  # fmt: skip
def test_rotor_speeds_that_cannot_be_are_one_line(tmp_path, change, unit, base, message):
    table = turns(20.0, 30.0)
    change(table)
    names = (*GEODETIC, *base, *(f"{name}_{unit}" for name in SPEEDS if f"{name}_{unit}" in table))
    with pytest.raises(ConfigError, match=message) as caught:
        fly(write(tmp_path / "bad.parquet", table, names), 100.0)
    assert len(caught.value.messages) == 1


TONES = {"rotor_accel_1_mg": 200.0, "rotor_reference_rpm": 4500.0}
BODY = {"rotor_forward_m": 0.12, "rotor_right_m": 0.12, **{f"gyration_{axis}_m": 0.09 for axis in "xyz"}}


def test_a_table_with_rotor_speeds_shakes_the_imu_and_one_without_is_refused(tmp_path):
    """The lines of the rotors stand 20 dB above the spectrum of the same unit without them."""
    (tmp_path / "own.toml").write_text('trajectory = "bad.parquet"\n[evaluation]\nfrom_s = 5.0\n')

    def read(**figures):
        changed = {f"sensors.imu.vibration.{key}": value for key, value in figures.items()}
        return read_profile(str(tmp_path / "own.toml"), {"sensors.imu": "matched-mems", **changed})

    edited(tmp_path, spun("rpm"), (*GEODETIC, *QUATERNION))
    with pytest.raises(
        ConfigError, match="rotor_accel needs the speeds of four rotors; the table has no columns"
    ):
        read(**TONES, **BODY)
    edited(tmp_path, spun("rpm"), (*GEODETIC, *QUATERNION, *(f"{name}_rpm" for name in SPEEDS)))
    with pytest.raises(
        ConfigError, match="needs rotor_right_m, gyration_x_m, gyration_y_m, gyration_z_m above 0"
    ):
        read(**TONES, rotor_forward_m=0.12)
    calm, shaken = (
        pipeline.sense(profile, pipeline.fly(profile)).data.imu.dvel_b[:, 0] * 200.0
        for profile in (read(), read(**TONES, **BODY))
    )
    assert np.std(np.diff(shaken)) > 10.0 * np.std(np.diff(calm))
