"""Ten hours at 100 Hz, flown and as a log: navigated, evaluated, stored, drawn and reported below 700 MB."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import bench
from bench.io.config.library import find_profile

MOST = 700e6
"""Memory of a process, that of its libraries and of what it has mapped of files included [byte]."""
LARGEST = 30e6
"""Of a recording [byte]."""
LOG = """
[imu]
file = "table/imu.csv"
time_offset_s = 0.003  # so that fixes and answers lie between samples
[gnss]
file = "table/gnss.csv"
[baro]
file = "table/baro.csv"
[sensors.assumed]
imu = "hg4930-ca51"
gnss = "l1-code"
baro = "bmp388"
[alignment]
kind = "given"
roll_deg = 0.0
pitch_deg = 2.0
heading_deg = 280.0
heading_sd_deg = 5.0
[[estimator]]
use = "loose-22"
"""


def run(folder: Path, *command: str) -> float:
    """Run bench in a folder, and return the most memory it had [byte]."""
    env = os.environ | {
        "PYTHONPATH": str(Path(bench.__file__).parents[1]),
        "BENCH_CACHE": str(folder / "cache"),
    }
    with (folder / "said.txt").open("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "bench", *command], cwd=folder, env=env, stdout=said, stderr=said
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        assert process.returncode == 0, said.read()
    return 1024.0 * usage.ru_maxrss


def cruise(seconds: float) -> str:
    """Return ``long-cruise`` at 100 Hz, with its legs of two hours five times, or with the last alone."""
    text = find_profile("long-cruise")[0].read_text(encoding="utf-8")
    begun, ended = text.index("[[leg]]"), text.index("[sensors]")
    legs = text[begun:ended]
    legs = 5 * legs if seconds > 7200.0 else legs[legs.rindex("[[leg]]") :]
    text = text[:begun] + legs + text[ended:]
    for old, new in (
        ("rate_hz  = 200", "rate_hz = 100"),
        ("duration_s = 7200.0", f"duration_s = {seconds}"),
        ("start_s = 5100.0", f"start_s = {min(5100.0, seconds / 4)}"),
        ('"loose-15"', '"loose-22"'),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="arrays lie in memory here")
def test_ten_hours_take_less_than_700_mb():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "log.toml").write_text(LOG)
        for seconds in (1200.0, 36_000.0):  # the first compiles what the second uses
            (folder / "cruise.toml").write_text(cruise(seconds))
            run(folder, "fly", "cruise.toml")
            flown = run(folder, "run", "cruise.toml", "-o", "flown", "--force")
            run(folder, "export", "flown", "--to", "csv", "-o", "table", "--force")
            navigated = run(folder, "navigate", "log.toml", "-o", "log", "--force")
        assert flown < MOST
        assert navigated < MOST
        for recorded in ("flown", "log"):
            assert (folder / recorded / "flight.rrd").stat().st_size < LARGEST
