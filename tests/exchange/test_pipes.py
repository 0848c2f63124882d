"""A pipe in the place of a file is rejected by every reader: it would wait for ever."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from bench.core.words.exceptions import ConfigError
from bench.experiments.baselines.baseline_file import read_baseline
from bench.io import results
from bench.io.config.toml_file import read_toml
from bench.io.foreign.solutions import read_solution
from bench.io.logs.formats import bags, text
from bench.io.logs.mat_files.mat_file import read_mat
from bench.io.logs.table_files import read_table
from bench.io.trajectories.track_files import read_track
from bench.plugins.autopilots import ulog
from bench.plugins.receiver.receiver_streams.rtcm import read_rtcm
from bench.plugins.receiver.receiver_streams.ubx import read_ubx
from bench.plugins.receiver.rinex.lines import open_lines
from bench.simulation.signals.terrain import describe_terrain


def open_rinex(path: Path) -> None:
    with open_lines(path, path.name):
        pass


READERS = {
    "x.toml": lambda path: read_toml(path, path.name),
    "x.csv": lambda path: read_table(path, {"time": [("t_s",)]}, (), 10),
    "x.parquet": lambda path: read_table(path, {"time": [("t_s",)]}, (), 10),
    "x.mat": read_mat,
    "x.ulg": lambda path: ulog.read("ulog", path, "imu", None),
    "x.bag": lambda path: bags.read("rosbag", path, "imu", None),
    "x.pos": lambda path: list(text.read_lines(path)),
    "x.obs": open_rinex,
    "x.igc": read_track,
    "x.gpx": read_track,
    "x.ubx": read_ubx,
    "x.rtcm3": read_rtcm,
    "x.hgt": lambda path: describe_terrain(path, path.name, 0.0, None),
    "x.json": read_baseline,
    "solution.csv": read_solution,
    "result.json": lambda path: results.read_result(path.parent),
}


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_no_file(tmp_path, name):
    def end(*_):
        raise TimeoutError("it waits")

    os.mkfifo(tmp_path / name)
    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(10)
    try:
        with pytest.raises(ConfigError, match=f"{name}: not a regular file"):
            READERS[name](tmp_path / name)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_a_bag_folder_with_a_pipe_in_it_is_refused(tmp_path):
    os.mkfifo(tmp_path / "x.db3")
    with pytest.raises(ConfigError, match=r"x\.db3: not a regular file"):
        bags.read("rosbag", tmp_path, "imu", None)
