"""Tables as other programs write them: separators, comments, header in a comment, integers, names twice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from bench.core.words.exceptions import ConfigError
from bench.io.logs.finding.text_search import find_texts
from bench.io.logs.sensor_search import (
    FoundSensor,
    guess_angle,
    guess_force,
    guess_length,
    guess_rate,
    guess_time,
    guess_turn,
)
from bench.io.logs.table_files import group, list_columns, read_columns, read_table

ROWS = ["0,47.5,11", "0.5,47.25,12"]
KINDS = {"time": (group("clock", "t"),), "place": (group("angle", "lat", "lon"),)}


def read(path):
    return read_table(path, KINDS, (), 1000)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\n\n"])
@pytest.mark.parametrize(
    "above",
    ["", "\ufeff", "\n", "# of the car, on the roof\n", "% a\n\n% b, c, d\n"],
)
@pytest.mark.parametrize("mark", ["", "# "])
def test_the_header_is_found(tmp_path, separator, end, above, mark):
    """Below comments, or in the last of them."""
    lines = [f"{mark}t_s,lat_deg,lon_deg", *ROWS]
    text = above.replace("\n", end) + "".join(f"{line.replace(',', separator)}{end}" for line in lines)
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode())
    assert list_columns(path) == ["t_s", "lat_deg", "lon_deg"]
    table = read(path)
    np.testing.assert_array_equal(table.columns["time"][:, 0], [0.0, 0.5])
    np.testing.assert_allclose(np.rad2deg(table.columns["place"]), [[47.5, 11.0], [47.25, 12.0]])
    path.write_bytes(text.replace("47.25", "1_0").encode())
    for failing in (read, lambda path: read_columns(path, ["lat_deg"], 1000)):
        with pytest.raises(ConfigError, match=r"^a.csv: row 2: lat_deg = '1_0' is not a number$"):
            failing(path)


def test_the_row_that_is_wrong_is_named_not_one_without_a_value(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t_s,lat_deg,lon_deg\n0,N/A,11\n1,,11\n2,-,11\n")
    with pytest.raises(ConfigError, match="row 3: lat_deg = '-' is not a number"):
        read(path)


def test_a_name_of_two_columns_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t_s,Lat,Lat,Lon\n0,47.5,48.5,11\n")
    with pytest.raises(ConfigError, match=r"^a.csv: more than one column is named 'Lat'"):
        read_table(path, KINDS, (), 1000, {"lat_deg": "Lat", "lon_deg": "Lon"})
    path.write_text("t_s,x,x,lat_deg,lon_deg\n0,1,2,47.5,11\n")
    assert len(read(path).columns["time"]) == 1


def test_a_text_in_another_encoding_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes("t_s,lat [°],lon\n0,47,11\n".encode("latin-1"))
    for failing in (read, list_columns):
        with pytest.raises(ConfigError, match=r"^a.csv: not a text file in UTF-8$"):
            failing(path)


def test_nanoseconds_since_1970_are_read(tmp_path):
    """They are beyond the integers that a float holds exactly."""
    t = np.array([1_700_000_000_000_000_001, 1_700_000_000_010_000_001])
    parquet.write_table(
        pa.table({"t_ns": t, "lat_deg": [47, 48], "lon_deg": [11, 12]}), tmp_path / "a.parquet"
    )
    found = read(tmp_path / "a.parquet").columns["time"][:, 0]
    np.testing.assert_allclose(found - 1.7e9, [0.0, 0.01], atol=1e-6)


@pytest.mark.parametrize(
    ("fixes", "words"),
    [
        ("10.5 47 11 600 1 2 3\n11 47 200 600 1 2 -1\n", ""),
        ("10.5 47 11 600 1 2 3\n11 90.5 11 600 1 2 3\n", "row 2 holds no fix"),
        ("10.5 47 11 600 1 2 3\n11 47 -361 600 1 2 3\n", "row 2 holds no fix"),
        ("10.5 47 11 600 1 2 3\n11 47 11 600 1 -0.5 3\n", "row 2 holds no fix"),
        ("8 47 11 600 1 2 3\n10.1 47 11 600 1 2 3\n", ""),
        ("11.9 47 11 600 1 2 3\n15 47 11 600 1 2 3\n", ""),
        (
            "8 47 11 600 1 2 3\n9.9 47 11 600 1 2 3\n",
            r"its times, 8 to 9\.9 s, do not overlap",
        ),
        ("12.1 47 11 600 1 2 3\n15 47 11 600 1 2 3\n", r"its times, 12\.1 to 15 s, do not overlap"),
    ],
)
def test_fixes_beside_the_increments_of_an_imu_are_told_by_their_values(tmp_path, fixes, words):
    """The times of the IMU are 10 to 11.99 s; a longitude up to 360 deg and an unknown sd, -1, are good."""
    rows = [f"{10 + 0.01 * k:.2f} 0.001 0.002 0.003 0 0 -0.0981\n" for k in range(200)]
    (tmp_path / "imu.txt").write_text("".join(rows))
    (tmp_path / "gnss.txt").write_text(fixes)
    if words:
        with pytest.raises(ConfigError, match=rf"^imu\.txt: no fixes beside it.*gnss\.txt: {words}"):
            find_texts(tmp_path / "imu.txt")
        return
    found = find_texts(tmp_path / "imu.txt")
    assert {kind: (one.path.name, one.form) for kind, one in found.items()} == {
        "imu": ("imu.txt", "kf-gins"),
        "gnss": ("gnss.txt", "kf-gins"),
    }


@pytest.mark.parametrize(
    ("guess", "values", "unit"),
    [
        (guess_time, [[0.0], [0.1], [0.0]], "s"),  # steps of either sign, of 2 s at most
        (guess_time, [[0.0], [1.9], [3.8]], "s"),
        (guess_time, [[0.0], [2.1], [4.2]], "ms"),
        (guess_time, [[0.0], [1900.0], [3800.0]], "ms"),
        (guess_time, [[0.0], [2100.0], [4200.0]], "us"),
        (guess_time, [[0.0], [1.9e6], [3.8e6]], "us"),
        (guess_time, [[0.0], [2.1e6], [4.2e6]], "ns"),
        (guess_time, [[5.0]], "s"),
        (guess_rate, [-3.4, np.nan], "rad_s"),
        (guess_rate, [-3.6, np.nan], "deg_s"),
        (guess_turn, [-0.19, np.nan], "rad"),
        (guess_turn, [-0.21, np.nan], "deg"),
        (guess_angle, [-3.1, np.nan], "rad"),
        (guess_angle, [-3.2, np.nan], "deg"),
        (guess_angle, [-990.0, 1.0], "deg"),
        (guess_angle, [-1010.0, 1.0], "deg_e7"),
        (guess_length, [600000.0, 600002.0], "mm"),
        (guess_length, [600000.0, 600001.0], "m"),
        (guess_length, [600000.5, 600002.0], "m"),
        (guess_force, [[0.0, 0.1, -1.24]] * 3, "g"),
        (guess_force, [[0.0, 0.1, -0.77]] * 3, "g"),
        (guess_force, [[0.0, 0.1, -1.3]] * 3, ""),
        (guess_force, [[9.8, 0.1, 0.3]] * 3, "m_s2"),
        (guess_force, [[0.0, 0.0, 7.2]] * 3, ""),
        (guess_force, [[0.0, 1010.0, 0.0]] * 3, "mg"),
        (guess_force, [[9.8, 0.0, 0.0], [0.0, 9.8, 0.0], [0.0, 0.0, 9.8]], ""),  # along no axis
        (guess_force, [[5.6, 0.0, 8.0], [5.6, 8.0, 0.0], [5.6, -8.0, 0.0]], "m_s2"),
    ],
)
def test_units_are_told_by_values(guess, values, unit):
    assert guess(np.array(values)) == unit


def test_gyros_in_doubt_can_have_the_other_unit():
    """Only what the values told; a column whose name has its unit keeps it."""
    columns = {"t_s": "t", "gyro_x_rad_s": "wx", "gyro_y_deg_s": "wy", "dtheta_z_rad": "dz", "alt_m": "h"}
    found = FoundSensor(Path("a.csv"), columns, ("wx, wy, dz: taken by the values",))
    assert found.doubtful == ("gyro_x_rad_s", "gyro_y_deg_s", "dtheta_z_rad")
    turned = {"t_s": "t", "gyro_x_deg_s": "wx", "gyro_y_rad_s": "wy", "dtheta_z_deg": "dz", "alt_m": "h"}
    assert found.turn_unit().columns == turned
    told = found._replace(guessed=("h: taken as m by the values",))
    assert (told.doubtful, told.turn_unit().columns) == ((), columns)
