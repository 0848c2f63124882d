"""The table of the guide's page "extending": each addition touches the files it says, and works.

Of six kinds a patch takes the last real one out of a copy of the package, and puts it back. Of others the
copy gets a toy: new files, and lines inserted at an anchor that stands once in a file. What is left flies
once with all toys.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
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


TAB = Toy(
    new={
        "bench/views/plots/tabs/baro_heights.py": """
from bench.views.plots.content import Content, Tab
from bench.core.records.findings.series import FIX, Plot, draw_line


def _plots(content: Content):
    baro = content.sensed.data.baro
    height = draw_line("height", baro.t, baro.alt_baro, "height", FIX, 50.0)
    return {"": [[Plot(("toy", "height"), "Height [m]", (height,))]]}


TOY = Tab("Toy", 100, _plots)
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


@dataclass(frozen=True)
class Real:
    """The last addition of a kind: its own files, and ``tests/extending/PATCH.patch`` for the others."""

    listed: str
    """Its name in a list of its kind."""
    own: tuple[str, ...] = ()
    patch: str = ""

    def hunks(self) -> dict[str, list[list[str]]]:
        """Return the hunks of the patch by file, each line with its sign."""
        found: dict[str, list[list[str]]] = {}
        if not self.patch:
            return found
        for line in (PATCHES / f"{self.patch}.patch").read_text(encoding="utf-8").splitlines(keepends=True):
            if line.startswith("+++ "):
                file = found.setdefault(line[4:].strip(), [])
            elif line.startswith("@@"):
                file.append([])
            elif found and line[0] in " +-" and not line.startswith("--- "):
                file[-1].append(line)
        return found

    @property
    def files(self) -> set[str]:
        return {*self.own, *self.hunks()}

    def change(self, file: str, source: str, away: str = "+") -> str:
        """Return a file without the lines of the patch that have this sign, and with the others."""
        kept = "-" if away == "+" else "+"
        for hunk in self.hunks()[file]:
            marks = [k for k, line in enumerate(hunk) if line[0] != " "]
            for lines in (hunk, hunk[marks[0] : marks[-1] + 1]):  # of two patches one may change the context
                old, new = (
                    "".join(one[1:] for one in lines if one[0] in (" ", sign)) for sign in (away, kept)
                )
                if old and source.count(old) == 1:
                    source = source.replace(old, new)
                    break
            else:
                patch = f"tests/extending/{self.patch}.patch"
                pytest.fail(
                    f"{file} is not as {patch} says. Take {self.listed!r} out of a clean checkout, then "
                    f"git diff -R -U2 --diff-filter=M --no-prefix > {patch} "
                    "&& git checkout bench pyproject.toml"
                )
        return source

    def take_out(self, folder: Path) -> None:
        """Take it out of a copy of the tree."""
        for file in self.own:
            (folder / file).unlink()
        for file in self.hunks():
            (folder / file).write_text(self.change(file, (folder / file).read_text()))


PATCHES = Path(__file__).parent / "extending"
_AUTOPILOTS = "bench/plugins/autopilots"
REAL = {
    "a log format": Real(
        "dataflash",
        tuple(f"{_AUTOPILOTS}/{name}.py" for name in ("dataflash", "dataflash_reader", "flash_rows")),
        "log_format",
    ),
    "a verb": Real(
        "serve", ("bench/plugins/hil/serving_flights.py", "bench/plugins/hil/__init__.py"), "verb"
    ),
    "a study": Real("closed-loop", ("bench/experiments/studies/flown_by_filters.py",)),
    "a metric": Real("fault_{}_alarm_share", patch="metric"),
    "an aiding sensor": Real("heading", ("bench/simulation/sensors/dual_antenna.py",), "sensor"),
    "a filter state": Real("time_offset_sd", patch="state"),
}

TOYS = {
    "an option of the evaluation": EVALUATION,
    "a recording tab": TAB,
    "an export format": EXPORT,
    "a fault kind": FAULT,
    "a leg": LEG,
    "an IMU error term": IMU_TERM,
}
WITHOUT = {"a profile", "a sensor of a known kind", "an aircraft", "a filter", "a filter option"}
"""Additions of the table that other tests make: a file beside those that are shipped, or an own module."""


def table() -> dict[str, tuple[int, str, str]]:
    """Return what the guide says of each addition: how many files of code, what else, and which."""
    text = re.sub(r"\n  +(?=\S)", " ", GUIDE.read_text("utf-8"))
    rows = re.findall(r"^- \*\*(an? .+?)\*\*, (\d+) files?([^:]*): (.+)$", text, re.M)
    return {what: (int(number), more, which) for what, number, more, which in rows}


def test_every_row_of_the_table_has_an_example():
    assert table().keys() == TOYS.keys() | REAL.keys() | WITHOUT


@pytest.mark.parametrize("what", TOYS)
def test_an_addition_touches_the_files_of_its_row(what):
    number, _, which = table()[what]
    places = re.findall(r"`(bench/[\w./]+)`", which)
    files = TOYS[what].files
    assert len(files) <= number
    for file in files:
        assert any(file == place or (place.endswith("/") and file.startswith(place)) for place in places)


def has_code(file: str) -> bool:
    """Return whether a file is a module of more than a docstring."""
    return (
        file.endswith(".py") and len(ast.parse((PACKAGE.parent / file).read_text(encoding="utf-8")).body) > 1
    )


@pytest.mark.parametrize("what", REAL)
def test_a_real_addition_touches_the_files_of_its_row(what):
    number, more, which = table()[what]
    files = REAL[what].files
    code = {file for file in files if has_code(file)}
    assert set(re.findall(r"`(bench/[\w/]+\.py)`", which)) == code
    assert len(code) == number
    assert ("entry point" in more) == ("pyproject.toml" in files)


@pytest.mark.parametrize("what", REAL)
def test_taken_out_and_put_back_it_is_the_same(what):
    for file in REAL[what].hunks():
        source = (PACKAGE.parent / file).read_text(encoding="utf-8")
        without = REAL[what].change(file, source)
        assert without != source
        assert REAL[what].change(file, without, away="-") == source


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
baro = "bmp388"
[[fault]]
kind = "zeroed"
sensor = "baro"
start_s = 8.0
duration_s = 0.75
[evaluation]
from_s = 2.0
until_s = 11.0
[[estimator]]
use = "loose-15"
""",
}

FLOWN = """
import json
import numpy as np
import bench
from bench.cli.command_line import commands
from bench.cli.listings import list_exports
from bench.core.records.instruments import INSTRUMENTS
from bench.evaluation.metrics.run_metrics import METRICS
from bench.experiments.studies import STUDIES
from bench.io.log_formats import list_names
from bench.navigation.options import FusionOptions
from bench.views import recording

result = bench.run("toys.toml")
bench.write_result(result, "run")
counts = bench.export_run("run", "counts", out="counts")
loose, baro = result.solutions["loose-15"], result.sensed.data.baro
t, drawn = recording.column("run/flight.rrd", "/toy/height/height", "Scalars:scalars")
table, events = loose.innovations, result.truth.events
counted = (loose.t >= 2.0) & (loose.t < 11.0)
here = table.code == table.sensor.index("baro")
roll_rate, pitch_rate = result.truth.dtheta_b[:, :2].T
wrong = result.sensed.data.imu.dtheta_b[:, 0] - roll_rate
print(json.dumps({
    "package": bench.__file__,
    "there": {
        "a log format": list_names(),
        "a verb": commands.list_commands(None),
        "a study": list(STUDIES),
        "a metric": [row.name for row in METRICS],
        "an aiding sensor": list(INSTRUMENTS),
        "a filter state": list(FusionOptions.model_fields),
    },
    "metrics": result.metrics,
    "rmse": float(np.sqrt((result.errors["loose-15"].pos_n[counted, :2] ** 2).sum(axis=1).mean())),
    "legs": [text for kind, text in zip(events.kind, events.text) if kind == "leg"],
    "heading": float(np.ptp(np.unwrap(2 * np.arctan2(result.truth.q_nb[:, 3], result.truth.q_nb[:, 0])))),
    "zeroed": baro.t[baro.alt_baro == 0.0].tolist(),
    "innovations": [table.t[here].tolist(), table.accepted[here].tolist()],
    "shear": float(wrong @ pitch_rate / (pitch_rate @ pitch_rate)),
    "drawn": [t.tolist(), drawn[:, 0].tolist(), baro.t.tolist(), baro.alt_baro.tolist()],
    "counts": json.loads((counts / "counts.json").read_text()),
    "rows": len(baro),
    "listed": [entry.name for entry in list_exports()],
}))
"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory, made_once) -> dict[str, Any]:
    """What a flight with all toys gives; its kernels take half a minute to compile, so once in a session."""
    return made_once("toys", lambda: fly_toys(tmp_path_factory.mktemp("toys")))


def fly_toys(folder: Path) -> dict[str, Any]:
    """Fly with all toys in a copy of the package that has them, and nothing of `REAL`."""
    shutil.copytree(PACKAGE, folder / "bench", ignore=shutil.ignore_patterns("__pycache__"))
    aircraft = PACKAGE.parent / "aircraft"
    if aircraft.is_dir():
        shutil.copytree(aircraft, folder / "aircraft")
    shutil.copy(PACKAGE.parent / "pyproject.toml", folder)
    for real in REAL.values():
        real.take_out(folder)
    declare_entries(folder)
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


def declare_entries(folder: Path) -> None:
    """Write the metadata that pip would write, with the entry points of ``pyproject.toml``."""
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {place}" for name, place in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines))


@pytest.mark.parametrize("what", REAL)
def test_what_is_taken_out_is_gone_and_the_rest_flies(flown, what):
    names = flown["there"][what]
    assert names
    assert REAL[what].listed not in names


def test_the_option_cuts_what_is_counted(flown):
    assert flown["metrics"]["loose-15"]["pos_rmse_h_m"] == pytest.approx(flown["rmse"], rel=1e-9)


def test_the_leg_is_flown(flown):
    assert flown["legs"][1] == "2 weave"
    assert 0.4 < flown["heading"] < 0.8  # 30 deg [rad]


def test_the_fault_strikes_the_instrument_and_its_innovations_are_refused(flown):
    zeroed = flown["zeroed"]
    assert len(zeroed) > 5
    assert all(8.0 - 1e-6 <= at < 8.75 for at in zeroed)
    t, accepted = flown["innovations"]
    refused = {at for at, good in zip(t, accepted, strict=True) if not good}
    assert set(zeroed) <= refused
    assert flown["metrics"]["loose-15"]["rejected_baro"] >= len(zeroed)


def test_the_error_term_acts_and_is_named_where_nothing_models_it(flown):
    assert 1e-3 < abs(flown["shear"]) < 0.2  # drawn with 3 deg, 0.05 rad
    assert "gyro shear" in flown["metrics"]["loose-15"]["unmodeled_errors"]


def test_the_tab_is_in_the_recording(flown):
    t, drawn, measured_t, measured = flown["drawn"]
    assert t == pytest.approx(measured_t, abs=1e-6)
    assert drawn == measured


def test_the_export_is_written(flown):
    assert "counts" in flown["listed"]
    assert flown["counts"]["baro"] == flown["rows"] > 100
    assert {"imu", "gnss"} <= flown["counts"].keys()
