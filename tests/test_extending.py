"""The table of the guide's page "extending": each addition touches no more files than it says, and works.

A copy of the package gets a toy of every kind, which is then flown once with all the others. A toy adds new
files and inserts lines at an anchor that stands once in a file.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from bench.core.files.places import PACKAGE

GUIDE = PACKAGE / "guide" / "extending.md"


@dataclass(frozen=True)
class Toy:
    """An addition: new files by path, and insertions ``(anchor, lines before it)`` by path."""

    new: dict[str, str] = field(default_factory=dict)
    inserted: dict[str, list[tuple[str, str]]] = field(default_factory=dict)

    @property
    def files(self) -> set[str]:
        return {*self.new, *self.inserted}


METRIC = Toy(
    inserted={
        "bench/evaluation/metrics/run_metrics.py": [
            (
                "METRICS: tuple[Metric, ...] = (\n",
                '''def pos_mean_h(case: Case) -> float:
    """Mean horizontal error [m]."""
    return float(np.hypot(case.pos_n[:, 0], case.pos_n[:, 1]).mean())


''',
            ),
            (
                '    Metric("cep50_m",',
                '    Metric("pos_mean_h_m", pos_mean_h, "pos", "lower"),\n',
            ),
        ]
    }
)

TAB = Toy(
    new={
        "bench/views/plots/tabs/laser_heights.py": """
from bench.views.plots.content import Content, Tab
from bench.core.records.findings.series import FIX, Plot, draw_line


def _plots(content: Content):
    laser = content.sensed.data.laser
    height = draw_line("height", laser.t, laser.height, "height", FIX, 50.0)
    return {"": [[Plot(("laser", "height"), "Height [m]", (height,))]]}


LASER = Tab("Laser", 100, _plots)
"""
    }
)

EXPORT = Toy(
    new={
        "bench/io/exports/row_counts.py": """
from bench.io.results import write_json

FORMATS = {"counts": "rows of each table"}


def write(folder, outgoing, name):
    write_json(folder / "counts.json", {name: len(table[0]) for name, table in outgoing.tables().items()})
    return "`counts.json`: how many rows each table has."
"""
    }
)

FAULT = Toy(
    inserted={
        "bench/io/config/fault_tables.py": [
            (
                '    _make_table("dropped"',
                '    _make_table("zeroed", "The output is 0.", sensor=Noisy),\n',
            ),
        ],
        "bench/simulation/sensors/faults.py": [
            (
                "    values = getattr(record, column)\n",
                """    for fault in faults:
        if fault.kind == "zeroed" and fault.sensor == sensor:
            zero = getattr(record, column).copy()
            zero[(record.t >= fault.start) & (record.t < fault.end)] = 0.0
            record = replace(record, **{column: zero})
""",
            )
        ],
    }
)

LEG = Toy(
    new={
        "bench/simulation/flight/legs/weave.py": '''
from dataclasses import dataclass
from typing import Annotated

from bench.simulation.flight.legs.keys import AtSpeed, Bank, Key
from bench.simulation.flight.legs.turns import turn_by


@dataclass(frozen=True)
class Weave(AtSpeed):
    """Turn right, then left."""

    kind = "weave"
    by: Annotated[float, Key("by_deg", "of each turn", 1, 90)]
    bank: Bank

    def fly(self, cockpit):
        yield from turn_by(cockpit, self.by, self.bank)
        yield from turn_by(cockpit, -self.by, self.bank)
'''
    }
)

IMU_TERM = Toy(
    inserted={
        "bench/core/records/sensor_specs.py": [
            (
                "    @property\n    def instability_sd(self)",
                '    shear_sd: float = triad_figure(_ANGLES, _ANGLES, error="shear", default=0.0)\n\n',
            )
        ],
        "bench/simulation/sensors/imu_terms.py": [
            (
                "    return M\n",
                """    if spec.shear_sd > 0:
        M[0, 1] += spec.shear_sd * draws.constant("shear")
""",
            )
        ],
    }
)

STATE = Toy(
    inserted={
        "bench/navigation/error_state_filter/state_blocks.py": [
            (
                "def chosen_blocks(",
                """SHEAR = Block(
    "shear",
    lambda specs: [States("gyro_shear", "rad", 1, specs.imu.gyro.shear_sd**2, drives=((0, 0, 1),))],
    takes=("gyro shear",),
)


""",
            ),
            ("ODOMETER_SCALE)\n", "SHEAR, "),
        ],
        "bench/navigation/options.py": [
            (
                "    radar: bool = False\n",
                '    shear: bool = False\n    """Estimate the shear of the gyros."""\n',
            )
        ],
    }
)

INSTRUMENT = Toy(
    new={
        "bench/simulation/sensors/laser.py": '''
import numpy as np

from bench.core.records.instruments import LaserData


def report(truth, on_board, draws):
    """Return ellipsoidal height with white noise, and an error of 0 without it."""
    spec = on_board.laser
    rows, _ = draws.epochs("laser", truth.t, spec.rate)
    t, noise = truth.t[rows], draws.stream("laser.white").standard_normal(len(rows))
    height = truth.lla[rows, 2] + spec.white_sd * noise
    sd = np.full(len(t), spec.white_sd)
    return LaserData(t=t, t_arrival=t, valid=np.ones(len(t), bool), height=height, sd=sd), np.zeros(len(t))
'''
    },
    inserted={
        "bench/core/records/instruments.py": [
            (
                "@declared\nclass RadarData(",
                '''@declared
class LaserData(InstrumentData):
    """Height above the ellipsoid."""

    height: FloatArray = column("height_m")
    sd: FloatArray = column("sd_m")


@declared
class LaserSpec:
    """A laser that knows the height of the ground."""

    name: str
    rate: float = figure("hz", 0.01, 400)
    white_sd: float = figure("m", reported=True)
    quantization: float = figure("m", default=0.0)


''',
            ),
            ("    baro: BaroSpec | None = None\n", "    laser: LaserSpec | None = None\n"),
            ("    baro: BaroData | None = None\n", "    laser: LaserData | None = None\n"),
            (
                '    )\n}\n"""Name -> the instrument."""',
                """        Instrument(
            name="laser",
            title="laser altimeter",
            record=LaserData,
            spec=LaserSpec,
            contents="height above the ellipsoid",
            model="laser",
            innovation="laser",
            quantity="laser height",
            frame=99,
            bias=Column(("laser_bias_m",), ("m",)),
            trace=Trace("altitude", "laser", "m"),
        ),
""",
            ),
        ],
        "bench/navigation/options.py": [
            (
                "    odometer: bool = False\n",
                '    laser: bool = False\n    """Use the height of a laser."""\n',
            )
        ],
        "bench/navigation/error_state_filter/measurement_rows.py": [
            (")\nPOSITION, VELOCITY, BARO", '    "laser",\n'),
            ("_SLOWEST_AIR = ", 'LASER, LASER_ROWS = SENSORS.index("laser"), 99\n'),
            (
                "ROWS: dict[int, Callable[..., int]] = {\n",
                """
@inner
def _laser_kernel(row, first, site):
    return _height_kernel(LASER, -1, row, first, site)


""",
            ),
            ("    FIX_ROWS: _fix_kernel,\n", "    LASER_ROWS: _laser_kernel,\n"),
        ],
        "bench/navigation/error_state_filter/aiding_sensors.py": [
            (
                "AIDING = (",
                """from bench.navigation.error_state_filter.measurement_rows import LASER_ROWS

LASER = AidingSensor(
    "laser",
    "laser",
    "laser",
    LASER_ROWS,
    lambda record, laser, *_: (record.height[:, None], np.array([laser.white_sd**2])),
    lambda laser: iter(()),
)
""",
            ),
            ("FIXES, SATELLITES, ", "LASER, "),
        ],
    },
)

STUDY = Toy(
    new={
        "bench/experiments/studies/coin.py": """
from bench.core.records.findings import Findings, FindingTable
from bench.experiments.studies.study import Count, StudyOptions, StudyWorkers


class Options(StudyOptions):
    tosses: Count = 3
    \"\"\"how often\"\"\"


def run(options: Options, work: StudyWorkers) -> Findings:
    table = FindingTable("coin", "Heads", {"toss": list(range(options.tosses))})
    return Findings(("It is a coin.",), (table,), ())
"""
    },
    inserted={
        "bench/experiments/studies/__init__.py": [
            (
                '    "requirements": StudyEntry(\n',
                '    "coin": StudyEntry("bench.experiments.studies.coin", "Is it a coin?"),\n',
            )
        ]
    },
)

EVALUATION = Toy(
    inserted={
        "bench/io/config/profile_tables.py": [
            (
                "    output_hz: Annotated[float, between(0.1, 400)] = 10.0\n",
                '    until_s: Annotated[float, between(0, 86400)] = 86400.0\n    """Count until then."""\n',
            )
        ],
        "bench/core/records/specs.py": [
            (
                "\n    @property\n    def first(self)",
                '    end: float = field(default=86400.0, metadata={"key": "until_s"})  # [s]\n',
            )
        ],
        "bench/evaluation/metrics/case.py": [
            ("    taken = as_slice(rows)\n", "    rows &= whole.t < evaluation.end\n")
        ],
    }
)

TOYS = {
    "an option of the evaluation": EVALUATION,
    "a study": STUDY,
    "a metric": METRIC,
    "a recording tab": TAB,
    "an export format": EXPORT,
    "a fault kind": FAULT,
    "a leg": LEG,
    "an IMU error term": IMU_TERM,
    "an estimator state": STATE,
    "an aiding sensor": INSTRUMENT,
}
WITHOUT = {"a profile", "a sensor of a known kind", "an aircraft", "an estimator", "an estimator option"}
"""Additions of the table that other tests make: a file beside those that are shipped, or an own module."""


def table() -> dict[str, tuple[int, str]]:
    """Return what the guide says of each addition: how many files, and which."""
    rows = re.findall(r"^\| (an? .+?) \| (\d+)[^|]* \| (.+) \|$", GUIDE.read_text(encoding="utf-8"), re.M)
    return {what: (int(number), which) for what, number, which in rows}


def test_every_row_of_the_table_has_a_toy():
    assert table().keys() == TOYS.keys() | WITHOUT


@pytest.mark.parametrize("what", TOYS)
def test_an_addition_touches_the_files_of_its_row(what):
    number, which = table()[what]
    places = re.findall(r"`(bench/[\w./]+)`", which)
    files = TOYS[what].files
    assert len(files) <= number
    for file in files:
        assert any(file == place or (place.endswith("/") and file.startswith(place)) for place in places)


# --- all toys in one flight -----------------------------------------------------------------------------

SHEETS = {
    "sheared.toml": """
title = "sheared"
class = "synthetic"
confidence = "table"
source = "made up"
assumed = ["gyro.noise_deg_sqrt_h", "gyro.shear_sd_deg", "accel.noise_m_s_sqrt_h"]
[gyro]
noise_deg_sqrt_h = 0.1
shear_sd_deg = 3.0
[accel]
noise_m_s_sqrt_h = 0.02
""",
    "height.toml": """
title = "height"
class = "synthetic"
confidence = "table"
source = "made up"
assumed = ["laser.rate_hz", "laser.white_sd_m"]
[laser]
rate_hz = 10.0
white_sd_m = 0.02
""",
    "toys.toml": """
title = "All toys"
aircraft = "aerosonde"
rate_hz = 100
seed = 3
[start]
lat_deg = 47.26
lon_deg = 11.34
alt_m = 1000.0
heading_deg = 85.0
speed_mps = 28.0
[[leg]]
kind = "straight"
duration_s = 4.0
[[leg]]
kind = "weave"
by_deg = 30.0
bank_deg = 25.0
[[leg]]
kind = "straight"
duration_s = 4.0
[sensors]
imu = "sheared.toml"
gnss = "l1-code"
laser = "height.toml"
[[fault]]
kind = "zeroed"
sensor = "laser"
start_s = 8.0
duration_s = 0.75
[evaluation]
from_s = 2.0
until_s = 11.0
[[estimator]]
use = "loose-15"
options = { laser = true, shear = true }
[[estimator]]
use = "loose-15"
label = "plain"
""",
}

FLOWN = """
import json
import numpy as np
import bench
from bench.views import recording

result = bench.run("toys.toml")
bench.save(result, "run")
counts = bench.export_run("run", "counts", out="counts")
loose, laser = result.solutions["loose-15"], result.sensed.data.laser
state = loose.extra_names.index("gyro_shear_rad")
t, drawn = recording.column("run/flight.rrd", "/laser/height/height", "Scalars:scalars")
table, events = loose.innovations, result.truth.events
counted = (loose.t >= 2.0) & (loose.t < 11.0)
here = table.code == table.sensor.index("laser")
roll_rate, pitch_rate = result.truth.dtheta_b[:, :2].T
wrong = result.sensed.data.imu.dtheta_b[:, 0] - roll_rate
print(json.dumps({
    "package": bench.__file__,
    "metrics": result.metrics,
    "mean": float(np.hypot(*result.errors["loose-15"].pos_n[counted, :2].T).mean()),
    "legs": [text for kind, text in zip(events.kind, events.text) if kind == "leg"],
    "heading": float(np.ptp(np.unwrap(2 * np.arctan2(result.truth.q_nb[:, 3], result.truth.q_nb[:, 0])))),
    "zeroed": laser.t[laser.height == 0.0].tolist(),
    "innovations": [table.t[here].tolist(), table.accepted[here].tolist()],
    "down_sd": [float(np.sqrt(s.cov[-1, 2, 2])) for s in result.solutions.values()],
    "shear": float(wrong @ pitch_rate / (pitch_rate @ pitch_rate)),
    "estimated": [float(loose.extra[-1, state]), loose.extra_sd[[0, -1], state].tolist()],
    "drawn": [t.tolist(), drawn[:, 0].tolist(), laser.t.tolist(), laser.height.tolist()],
    "counts": json.loads((counts / "counts.json").read_text()),
    "rows": len(laser),
    "listed": [entry.name for entry in bench.list_exports()],
    "tosses": list(bench.study("coin", tosses=5, jobs=1).tables["coin"].columns["toss"]),
}))
"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory, made_once) -> dict[str, Any]:
    """What a flight with all toys gives; its kernels take half a minute to compile, so once in a session."""
    return made_once("toys", lambda: fly_toys(tmp_path_factory.mktemp("toys")))


def fly_toys(folder: Path) -> dict[str, Any]:
    """Fly with all toys in a copy of the package that has them."""
    shutil.copytree(PACKAGE, folder / "bench", ignore=shutil.ignore_patterns("__pycache__"))
    aircraft = PACKAGE.parent / "aircraft"
    if aircraft.is_dir():
        shutil.copytree(aircraft, folder / "aircraft")
    for toy in TOYS.values():
        for path, text in toy.new.items():
            assert not (folder / path).exists(), f"{path} is there; take another name for the toy"
            (folder / path).write_text(f'"""A toy."""\n\nfrom __future__ import annotations\n{text}')
        for path, insertions in toy.inserted.items():
            source = (folder / path).read_text()
            for anchor, lines in insertions:
                assert source.count(anchor) == 1, f"{path} has {anchor!r} {source.count(anchor)} times"
                source = source.replace(anchor, lines + anchor)
            (folder / path).write_text(source)
    for name, text in SHEETS.items():
        (folder / name).write_text(text)
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(folder), "BENCH_CACHE": str(folder / "cache")}
    command = [sys.executable, "-c", FLOWN]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    assert Path(found["package"]).is_relative_to(folder)
    return found


def test_the_metric_is_in_the_result(flown):
    assert flown["metrics"]["loose-15"]["pos_mean_h_m"] == pytest.approx(flown["mean"], rel=1e-9)


def test_the_study_is_run(flown):
    assert flown["tosses"] == [0, 1, 2, 3, 4]


def test_the_leg_is_flown(flown):
    assert flown["legs"][1] == "2 weave"
    assert 0.4 < flown["heading"] < 0.8  # 30 deg [rad]


def test_the_fault_strikes_the_instrument_and_its_innovations_are_refused(flown):
    assert flown["zeroed"] == pytest.approx([8.0, 8.1, 8.2, 8.3, 8.4, 8.5, 8.6, 8.7])
    t, accepted = flown["innovations"]
    refused = [at for at, good in zip(t, accepted, strict=True) if not good]
    assert set(flown["zeroed"]) <= set(refused)
    assert flown["metrics"]["loose-15"]["rejected_laser"] >= len(flown["zeroed"])


def test_the_instrument_is_used_by_the_filter_that_asks_for_it(flown):
    aided, plain = flown["down_sd"]
    assert aided < 0.05 < plain  # its white noise is 0.02 m
    assert "updates_laser" not in flown["metrics"]["plain"]


def test_the_error_term_acts_and_is_named_where_nothing_models_it(flown):
    assert 1e-3 < abs(flown["shear"]) < 0.2  # drawn with 3 deg, 0.05 rad
    assert "gyro shear" in flown["metrics"]["plain"]["unmodelled"]


def test_the_state_estimates_it(flown):
    estimate, (before, after) = flown["estimated"]
    assert before == pytest.approx(0.05236, rel=1e-3)
    assert after < 0.5 * before
    assert abs(estimate - flown["shear"]) < 4.0 * after
    assert "gyro shear" not in flown["metrics"]["loose-15"]["unmodelled"]


def test_the_tab_is_in_the_recording(flown):
    t, drawn, measured_t, measured = flown["drawn"]
    assert t == pytest.approx(measured_t, abs=1e-6)
    assert drawn == measured


def test_the_export_is_written(flown):
    assert "counts" in flown["listed"]
    assert flown["counts"]["laser"] == flown["rows"] > 100
    assert {"imu", "gnss"} <= flown["counts"].keys()
