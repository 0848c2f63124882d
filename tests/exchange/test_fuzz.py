"""Damaged files of every format are read, or rejected by one line; `tests.fuzz` makes them."""

import json
import re
import time
import warnings

import pytest

import bench
from bench.cli.command_line import main
from bench.core.words.exceptions import BenchError, ConfigError
from bench.io.config.datasheets import SENSORS
from bench.io.config.log import load_log
from bench.io.foreign.solutions import read_solution
from bench.io.logs import formats
from bench.io.logs.resting_log import read_resting_log
from bench.io.parameters import read_parameters
from bench.io.trajectories.track_files import read_track
from bench.plugins.receiver import almanac
from bench.plugins.receiver.receiver_streams.rtcm import read_rtcm
from bench.plugins.receiver.receiver_streams.ubx import read_ubx
from bench.plugins.receiver.rinex.ephemerides import read_navigation
from bench.plugins.receiver.rinex.observations import read_observations
from bench.plugins.receiver.rinex.precise_orbits import read_precise_orbits
from tests import fuzz
from tests.exchange import test_log_formats

SLOW_TO_OPEN = {"log-ros1": 25, "log-ros2": 25, "log-mcap": 25, "results": 40}
SLOW_TO_OPEN |= {"terrain-hgt": 25, "views": 12, "campaign": 12, "journal": 12, "baseline": 30, "answer": 15}
SLOW_TO_OPEN |= {"part": 12}
"""Inputs of formats that take 30 ms or more to be opened and shown; 100 of the others."""


@pytest.mark.parametrize("name", fuzz.FORMATS)
def test_a_damaged_file_is_read_or_refused_by_one_line(tmp_path, name):
    _, failures = fuzz.run(name, 1, range(SLOW_TO_OPEN.get(name, 100)), tmp_path, quick=True)
    assert not failures


@pytest.mark.long
@pytest.mark.parametrize("name", fuzz.FORMATS)
def test_ten_thousand_damaged_files_are_read_or_refused_by_one_line(tmp_path, name):
    """Logs are also navigated, receivers' files solved, and solutions evaluated on damaged results.

    Of a filter 2,000 wrong answers are each a row of the result.
    """
    _, failures = fuzz.run(name, 2, range(2_000 if name == "answer" else 10_000), tmp_path)
    assert not failures


@pytest.mark.parametrize(
    ("name", "seed", "number"),
    [
        ("sp3", 1, 209),  # a power that is a digit and no number
        ("log-navego", 2, 7260),  # an IMU gap before the first fix
        ("views", 1, 26),  # a solution without the epochs of its errors
        ("views", 1, 65),  # an instrument without rows
        ("views", 1, 73),  # numbers in the place of words
        ("views", 1, 133),  # a table in the place of a number
        ("views", 1, 203),  # a sensor without epochs
        ("study", 1, 43),  # a drawing without its scale
        ("study", 1, 69),  # 1e400 runs
        ("card", 1, 63),  # a card without its first line
        ("campaign", 1, 10),  # a profile without its evaluation
        ("campaign", 1, 17),  # words in the place of numbers
        ("campaign", 1, 51),  # a metric that is not finite
        ("campaign", 1, 63),  # a column that is not there
        ("campaign", 5, 161),  # epochs that are no numbers
        ("campaign", 5, 195),  # words that are no text
        ("journal", 1, 56),  # a list in the place of seconds
        ("journal", 1, 78),  # runs of another filter
        ("journal", 1, 89),  # half a row of epochs
        ("journal", 1, 185),  # an interval of 1e30 s
    ],
)
def test_an_input_that_has_failed(tmp_path, name, seed, number):
    _, failures = fuzz.run(name, seed, range(number, number + 1), tmp_path)
    assert not failures


def test_the_fuzz_sees_what_is_no_bench_error(tmp_path):
    def fail(path):
        raise KeyError("a bug")

    assert fuzz.judge(fail, tmp_path)[0] == "failed"


# --- files that have ended in a traceback ----------------------------------------------------------------


def refused(capsys, *arguments):
    """Run a verb that must reject its files; return the message."""
    status = main([str(argument) for argument in arguments])
    said = capsys.readouterr().err
    assert status == 2, said
    assert "Traceback" not in said
    return said.splitlines()[-1]


@pytest.fixture
def drive(tmp_path, request):
    """A log whose files have a format; its folder."""
    fuzz.FORMATS[f"log-{request.param}"](tmp_path)
    return tmp_path


@pytest.mark.parametrize("drive", ["csv"], indirect=True)
def test_a_ulog_without_time_stamps(drive, capsys, monkeypatch):
    for name, fields in test_log_formats.ULOG_SENSORS.items():
        changed = fields.replace("uint64_t timestamp;", "uint64_t other;")
        monkeypatch.setitem(test_log_formats.ULOG_SENSORS, name, changed)
    fuzz.FORMATS["log-ulog"](drive)
    assert "no rows of sensor_combined or vehicle_imu" in refused(capsys, "navigate", drive / "drive.toml")


@pytest.mark.parametrize("drive", ["csv"], indirect=True)
@pytest.mark.parametrize("factor", [1e9, 1e300])
def test_a_log_whose_gyro_is_far_too_large_is_a_result(drive, factor):
    text = (drive / "imu.csv").read_text().splitlines()
    rows = [[float(cell) for cell in line.split(",")] for line in text[1:]]
    larger = [",".join(f"{x * factor if 1 <= k <= 3 else x:.9g}" for k, x in enumerate(row)) for row in rows]
    (drive / "imu.csv").write_text("\n".join([text[0], *larger]) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert main(["navigate", str(drive / "drive.toml"), "-o", str(drive / "out"), "--no-rrd"]) in (
            0,
            1,
            2,
        )


@pytest.mark.parametrize("drive", ["csv"], indirect=True)
def test_a_time_far_off_is_named_before_the_memory_is_full(drive, capsys):
    lines = (drive / "imu.csv").read_text().splitlines()
    lines[20] = "1e15" + lines[20][lines[20].index(",") :]
    (drive / "imu.csv").write_text("\n".join(lines) + "\n")
    said = refused(capsys, "navigate", drive / "drive.toml")
    assert "more than 400000 epochs; the longest interval, 1e+15 s, ends at row 20" in said


def test_a_yuma_almanac_with_control_characters_or_a_week_that_cannot_be(tmp_path):
    path = tmp_path / "yuma.txt"
    text = fuzz.gnss_file("yuma_2022-02-17.txt").read_text()
    path.write_text(text.replace("week:", "week:\x1c\x85"), encoding="latin-1")  # white space of Unicode
    assert len(almanac.read_yuma(path, 1.3e9)) > 20
    for changed in (
        re.sub(r"(week: *)\d+", rf"\g<1>1{400 * '0'}", text),
        text.replace("Health:", "\x07Health:"),
    ):
        path.write_text(changed, encoding="latin-1")
        with pytest.raises(ConfigError, match=r"^yuma\.txt: line \d+: "):
            almanac.read_yuma(path, 1.3e9)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    fuzz.FORMATS["results"](folder)
    return folder


@pytest.mark.parametrize(
    ("entry", "value", "words"),
    [
        (("metrics", "made", "pos_rmse_h_m"), "much", "metrics.made.pos_rmse_h_m must be a number"),
        (("metrics", "made", "converged"), "yes", "metrics.made.converged must be true or false"),
        (("metrics", "other"), {"converged": True}, "metrics of 'other', but no solution-other.parquet"),
        (("metrics",), [], "metrics must be a table for each filter"),
        (("profile", "title"), 5, "profile.title must be a text"),
        (("profile", "evaluation"), {"from_s": "5", "output_hz": 10.0}, "from_s must be a number"),
        (("profile", "gnss_outage"), [{"start_s": 5.0}], "'duration_s' is missing"),
        (("seed",), "one", "seed must be a whole number"),
    ],
)
def test_an_entry_of_a_result_that_is_of_another_kind(results, capsys, entry, value, words):
    path = results / "run" / "result.json"
    whole = path.read_text()
    document = inner = json.loads(whole)
    for key in entry[:-1]:
        inner = inner[key]
    inner[entry[-1]] = value
    path.write_text(json.dumps(document))
    try:
        assert words in refused(capsys, "score", results / "his.csv", results / "run")
    finally:
        path.write_text(whole)


def read_all(folder):
    run = bench.read_result(folder)
    return run.truth, run.sensed


def test_a_damaged_or_missing_table_of_a_result_is_one_line_from_python_too(results):
    for name in ("solution-made", "errors-made", "truth", "sensors-imu", "sensors-gnss"):
        path = results / "run" / f"{name}.parquet"
        whole = path.read_bytes()
        path.write_bytes(whole[:100])
        try:
            with pytest.raises(BenchError, match="cannot be read: ") as caught:
                read_all(results / "run")
        finally:
            path.write_bytes(whole)
        assert str(caught.value).count("\n") == 0


LARGE = {
    "imu.csv": read_resting_log,
    "table.csv": read_solution,
    "table.parquet": read_solution,
    "table.mat": read_solution,
    "log.ulg": lambda path: formats.read("ulog", path, "imu", None),
    "log.bag": lambda path: formats.read("rosbag", path, "imu", None),
    "log.mcap": lambda path: formats.read("mcap", path, "imu", None),
    "imu.txt": lambda path: formats.read("kf-gins", path, "imu", None),
    "log.pos": lambda path: formats.read("rtklib", path, "gnss", None),
    "log.mat": lambda path: formats.read("navego", path, "imu", None),
    "site.rnx": read_observations,
    "brdc.rnx": read_navigation,
    "orbits.sp3": read_precise_orbits,
    "log.ubx": read_ubx,
    "log.rtcm3": read_rtcm,
    "log.bin": lambda path: formats.read("dataflash", path, "imu", None),
    "track.igc": read_track,
    "track.gpx": read_track,
    "yuma.txt": lambda path: almanac.read_yuma(path, 1.3e9),
    "drive.toml": lambda path: load_log(str(path)),
    "imu.toml": lambda path: SENSORS["imu"](path, "imu.toml"),
    "kalibr.yaml": lambda path: read_parameters(path, "kalibr"),
}


@pytest.mark.parametrize("name", LARGE)
def test_a_file_that_is_too_large_is_refused_at_once(tmp_path, name):
    with (tmp_path / name).open("wb") as file:
        file.truncate(3_000_000_000)  # a hole: it takes no room
    begun = time.process_time()
    with pytest.raises(ConfigError, match=r"larger than \d+ MB$"):
        LARGE[name](tmp_path / name)
    assert time.process_time() - begun < 1.0


@pytest.mark.parametrize("drive", ["csv"], indirect=True)
def test_a_name_that_is_too_long_for_a_file(drive, capsys):
    text = (drive / "drive.toml").read_text()
    for name in ("imu.csv", "imu.toml"):
        (drive / "long.toml").write_text(text.replace(name, 300 * "9" + name))
        assert "no such file" in refused(capsys, "navigate", drive / "long.toml")
    for key in ("aircraft", "trajectory", "script"):
        profile = drive / "profile.toml"
        profile.write_text(f'{key} = "{300 * "9"}.{"csv" if key == "trajectory" else "xml"}"\n')
        refused(capsys, "fly", profile)
