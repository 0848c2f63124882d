"""Packages of others, one of each kind: found, used, listed; they take no name of bench, and stop nothing."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import bench
from bench.cli.command_line import main
from bench.cli.group import commands
from bench.cli.verbs.other_packages import list_plugin_problems
from bench.core.files.installed import find_class
from bench.core.files.places import PACKAGE
from bench.core.records.orbit_sets import GPS, KEPLER, KeplerSets
from bench.core.records.sky_spec import SkySpec
from bench.experiments.studies.conducting import find_study
from bench.io import exports
from bench.io.config.datasheets import read_gnss
from bench.io.fix_readers import ask_reader
from bench.io.log_formats import find_format
from bench.navigation.built_in import BUILT_IN
from bench.simulation.signals.gps_time import EPOCH
from tests.data import gnss_file
from tests.exchange import drives
from tests.test_installed import SET, install

EXAMPLES = Path(__file__).with_name("examples")
LONG = 60.0  # of the drive [s]
ADDED = {
    "trail": ("logs", "trail_log of trail-log 0.3"),
    "kepler-table": ("fixes", "kepler_table of kepler-table 0.3"),
    "lever": ("studies", "lever_study of lever-study 0.3"),
    "sheet": ("verbs", "sheet_verb:sheet of sheet-verb 0.3"),
}


@pytest.fixture
def site(tmp_path, monkeypatch):
    """The site folder with all examples, as pip would install them."""
    site = tmp_path / "site"
    for folder in EXAMPLES.iterdir():
        project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
        entries = "".join(
            f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in rows.items())
            for group, rows in project["entry-points"].items()
        )
        install(site, project["name"], entries, project["version"])
        shutil.copytree(
            folder, site, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.toml", "__pycache__")
        )
    monkeypatch.syspath_prepend(site)
    monkeypatch.chdir(tmp_path)
    yield site
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", "")).startswith(str(site)):
            del sys.modules[name]


def fails(capsys, *arguments: str) -> str:
    """What a command line that ends with status 2 prints: one line."""
    capsys.readouterr()
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def write_trail(path: Path) -> np.ndarray:
    """Write the first minute of the drive; return time, position and velocity of its fixes."""
    columns, lines = {"I": ("imu", "gyro", "accel"), "G": ("gnss", "lla", "vel_n")}, ["TRAIL"]
    for letter, (kind, first, second) in columns.items():
        found = drives.sensed()[kind]
        rows = np.column_stack([found["t"], found[first], found[second]])[found["t"] <= LONG]
        lines += [f"{letter} {' '.join(map(str, row))}" for row in rows]
    path.write_text("\n".join(lines))
    return rows


@pytest.mark.usefixtures("site")
def test_all_are_listed_with_their_packages_and_none_is_imported(capsys):
    assert main(["list", "packages", "--json"]) == 0
    (rows,) = json.loads(capsys.readouterr().out).values()
    assert {row["name"]: (row["kind"], row["title"]) for row in rows} == ADDED
    assert main(["list"]) == 0
    assert ["packages", str(len(ADDED))] in [
        line.split()[:2] for line in capsys.readouterr().out.splitlines()
    ]
    assert main(["list", "packages"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert all(f"{kind} {name} {title}" in out for name, (kind, title) in ADDED.items())
    assert main(["--help"]) == 0
    assert "sheet package sheet-verb 0.3" in " ".join(capsys.readouterr().out.split())
    assert main(["study", "--help"]) == 0
    assert "lever of lever-study 0.3" in " ".join(capsys.readouterr().out.split())
    assert not {"trail_log", "kepler_table", "lever_study", "sheet_verb"} & set(sys.modules)
    assert list_plugin_problems() == []


@pytest.mark.usefixtures("site")
def test_a_file_that_only_a_package_knows_gets_a_log_and_runs(tmp_path, capsys):
    gnss = write_trail(tmp_path / "drive.rec")
    drive = ["navigate", "drive.rec", "-e", "loose-15", "-o", "out", "--outages", "none"]
    assert main([*drive, "--no-rrd", "--no-report"]) in (0, 1)
    assert "drive.rec: imu, gnss" in capsys.readouterr().out
    result = bench.read_result("out")
    assert result.metrics["loose-15"]["converged"]
    used = np.column_stack([result.sensors.fixes.lla, result.sensors.fixes.vel_n])
    assert len(used) > 200  # some are withheld
    assert set(map(tuple, used)) <= set(map(tuple, gnss[:, 1:]))


@pytest.mark.usefixtures("site")
def test_the_satellites_of_a_datasheet_are_those_of_a_file_that_only_a_package_knows(tmp_path):
    yuma = "yuma_2022-02-17.txt"
    shutil.copy(gnss_file(yuma), tmp_path)
    text = (PACKAGE / "catalog" / "gnss" / "sky-l1.toml").read_text(encoding="utf-8")

    def read(almanac: str) -> SkySpec:
        Path("own.toml").write_text(text.replace("[sky]\n", f"[sky]\nalmanac = {almanac!r}\n", 1))
        return read_gnss(Path("own.toml"), "own.toml").sky

    known = read(yuma)
    sets = known.orbits[GPS].shift_origin(-86400.0 * (known.day - EPOCH).days)
    table, names = np.column_stack([sets.sat, sets.elements]), ",".join(("sat", *KEPLER))
    np.savetxt("own.txt", table, "%.17g", ",", header=names, comments="")
    assert "kepler_table" not in sys.modules
    found = read("own.txt")
    assert_array_equal(found.orbits[GPS].sat, sets.sat)
    assert_allclose(found.orbits[GPS].elements, known.orbits[GPS].elements, rtol=1e-15, atol=1e-6)


@pytest.mark.usefixtures("site")
def test_a_study_and_a_verb_run_by_their_names(capsys):
    assert main(["study", "lever", "figure-eight", "--arm-m", "2", "--json", *SET[:-2]]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["study"] == "lever"
    assert main(["sheet", "stim300"]) == 0
    assert "STIM300" in capsys.readouterr().out
    assert "not in the catalog" in fails(capsys, "sheet", "stim")


TAKEN = {
    "estimators": ("error-ekf", "thief:Thief"),
    "exports": ("ulog", "thief"),
    "logs": ("ulog", "thief"),
    "fixes": ("rinex", "thief"),
    "studies": ("register", "thief"),
    "verbs": ("serve", "thief:thief"),
}


def test_a_name_of_bench_is_taken_by_no_package(site, tmp_path, capsys):
    install(
        site, "thief", "".join(f"[bench.{group}]\n{n} = {place}\n" for group, (n, place) in TAKEN.items())
    )
    (site / "thief.py").write_text(f"open({str(tmp_path / 'stolen')!r}, 'w')\n")
    lines = [
        f"thief 1.2: {group} {n!r} is a name of bench itself; it keeps its own"
        for group, (n, _) in TAKEN.items()
    ]
    assert sorted(list_plugin_problems()) == sorted(lines)
    assert main(["list"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert all(line in out for line in lines)
    assert find_class("error-ekf", BUILT_IN) == "error-ekf"
    assert BUILT_IN["error-ekf"].import_class().__module__ == "bench.plugins.papers.error_ekf"
    assert exports.find_format("ulog").write.__module__ == "bench.plugins.autopilots.ulog_replay"
    assert find_format("ulog").module == "bench.plugins.autopilots.ulog"
    assert find_study("register")[1].__name__ == "bench.plugins.papers.register_study"
    assert commands.get_command(None, "serve").callback.__module__ == "bench.plugins.hil.serving_flights"
    shutil.copy(gnss_file("yuma_2022-02-17.txt"), tmp_path / "own.txt")
    assert len(ask_reader(Path("own.txt"), "read_almanac", KeplerSets, Path("own.txt"), 1.33e9, "own.txt"))
    assert not (tmp_path / "stolen").exists()


BROKEN = {
    "trail_log": ("log format 'trail' of trail-log 0.3", ("navigate", "drive.rec", "-o", "out")),
    "lever_study": ("study 'lever' of lever-study 0.3", ("study", "lever")),
    "sheet_verb": ("verb 'sheet' of sheet-verb 0.3", ("sheet",)),
    "kepler_table": (
        "reader of fixes 'kepler-table' of kepler-table 0.3",
        ("run", "figure-eight", "-o", "out", "--set", "sensors.gnss=own.toml", *SET),
    ),
}
"""Module of a package -> what messages call it, and a command that asks it."""
LOOKS = "from bench.io.logs.log_contents import Contents\nlook = lambda path: Contents(('imu', 'gnss'))\n"


@pytest.mark.parametrize(
    ("name", "source", "wrong"),
    [
        *((name, "import not_there", "No module named 'not_there'") for name in BROKEN),
        ("trail_log", "1 / 0", "ZeroDivisionError: division by zero"),
        ("trail_log", "", "trail_log has no function read"),
        ("trail_log", "ENDINGS = 1\nread = print", "ENDINGS must be a tuple of texts; got 1"),
        ("trail_log", "ENDINGS = ('.rec',)\nread = look = print", "look gives no Contents, but NoneType"),
        ("trail_log", f"{LOOKS}ENDINGS = ('.rec',)\nread = print", "read gives no LogRows, but NoneType"),
        ("lever_study", "run = print", "its module has no Options, a StudyOptions"),
        (
            "lever_study",
            '"A question."\nfrom bench.experiments.studies.study import StudyOptions as Options\nrun = print',
            "run gives no Findings, but NoneType",
        ),
        ("sheet_verb", "sheet = print", "sheet_verb:sheet is not a click.Command"),
        ("kepler_table", "recognizes = bool", "kepler_table has no function read_almanac"),
        (
            "kepler_table",
            "recognizes = bool\nread_almanac = lambda *given: 3",
            "read_almanac gives no KeplerSets, but int",
        ),
    ],
)
def test_a_broken_package_is_one_line_where_it_is_asked(name, source, wrong, site, tmp_path, capsys):
    (site / f"{name}.py").write_text(f"{source}\n")
    Path("drive.rec").write_text("TRAIL")
    sheet = (PACKAGE / "catalog" / "gnss" / "sky-l1.toml").read_text(encoding="utf-8")
    Path("own.toml").write_text(sheet.replace("[sky]\n", '[sky]\nalmanac = "own.txt"\n'), encoding="utf-8")
    Path("own.txt").write_text("sat,t_oe,e\n1,2,3\n")
    shown, command = BROKEN[name]
    assert fails(capsys, *command).endswith(f"{shown}: {wrong}")
    assert not Path("out").exists()
    assert main(["list"]) == 0  # and nothing else minds
    drives.write_log(tmp_path)
    assert bench.read_log("drive.toml")


def test_a_checkout_whose_metadata_names_no_plugin_says_what_to_do(tmp_path):
    code = (
        "import sys, importlib.metadata as known\n"
        "known.distribution = lambda name: known.Distribution.at('nowhere')\n"
        "from bench.__main__ import main\nsys.argv = ['bench', 'list']\nsys.exit(main())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(PACKAGE.parent)},
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert line.endswith(
        "the installed metadata does not name its plug-ins; in the checkout: pip install -e ."
    )
