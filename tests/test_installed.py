"""What installed packages add by entry points: listed without an import, used by name, never in the way."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest

import bench
from bench.cli.command_line import main
from bench.cli.verbs.other_packages import list_plugin_problems
from bench.core.files.places import PACKAGE
from bench.core.words.exceptions import ConfigError

FILTER = """
import pathlib
pathlib.Path({mark!r}).write_text("imported")
import bench
from bench.navigation.built_in import load


class Held:
    def __init__(self, *, gate: float = 1.0) -> None:
        self.gate = gate

    def run(self, sensors, initial):
        return load("free-inertial", {{}}).run(sensors, initial)
"""
EXPORT = """
FORMATS = {"counts": "rows of the IMU"}


def write(folder, outgoing, name):
    (folder / "rows.txt").write_text(str(len(outgoing.imu)))
    return "Rows."
"""
SHORT = {
    "duration_s": 20.0,
    "evaluation.from_s": 5.0,
    "gnss_outage": [],
    "leg": [{"kind": "straight", "duration_s": 5.0}],
}
SET = [part for key, value in SHORT.items() if key != "leg" for part in ("--set", f"{key}={value}")]
SET += ["--set", 'leg=[{kind = "straight", duration_s = 5.0}]', "--no-rrd", "--no-report"]


def install(place: Path, name: str, entries: str, version: str = "1.2") -> None:
    """Write what pip would write of a package of one module."""
    info = place / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(entries)


@pytest.fixture
def lab(tmp_path, monkeypatch) -> Path:
    """Return the site folder with a package that adds one of each group."""
    site = tmp_path / "site"
    install(site, "lab-nav", """
[bench.estimators]
held = lab_nav.filters:Held
[bench.catalog]
lab = lab_nav.sheets
[bench.aircraft]
lab = lab_nav.planes
[bench.exports]
counts = lab_nav.counts
""")  # fmt: skip
    package = site / "lab_nav"
    (package / "sheets" / "imu").mkdir(parents=True)
    (package / "__init__.py").write_text(f"open({str(tmp_path / 'package')!r}, 'w').close()\n")
    (package / "filters.py").write_text(FILTER.format(mark=str(tmp_path / "filter")))
    (package / "counts.py").write_text(EXPORT)
    shutil.copy(PACKAGE / "catalog" / "imu" / "stim300.toml", package / "sheets" / "imu" / "lab-imu.toml")
    shutil.copytree(PACKAGE.parent / "aircraft" / "aerosonde", package / "planes" / "lab-plane")
    plane = package / "planes" / "lab-plane"
    (plane / "aerosonde.xml").rename(plane / "lab-plane.xml")
    shutil.copytree(PACKAGE.parent / "aircraft" / "systems", package / "planes" / "systems")
    monkeypatch.syspath_prepend(site)
    monkeypatch.chdir(tmp_path)
    yield site
    for module in [name for name in sys.modules if name.startswith("lab_nav")]:
        del sys.modules[module]


def test_all_of_it_is_listed_and_nothing_imported(lab, tmp_path, capsys):
    assert main(["list", "--json"]) == 0
    shelves = json.loads(capsys.readouterr().out)
    titles = {(shelf, row["name"]): row["title"] for shelf, rows in shelves.items() for row in rows}
    assert titles["estimators", "held"] == "lab_nav.filters:Held of lab-nav 1.2"
    assert titles["exports", "counts"] == "lab_nav.counts of lab-nav 1.2"
    assert ("sensors", "lab-imu") in titles
    assert ("aircraft", "lab-plane") in titles
    assert not (tmp_path / "package").exists()
    assert not (tmp_path / "filter").exists()


def test_a_file_names_them_without_permission_and_the_filter_has_a_process_of_its_own(lab, tmp_path, capsys):
    profile = (PACKAGE / "profiles" / "figure-eight.toml").read_text()
    head, _, _ = profile.partition("[[estimator]]")
    own = head.replace('"aerosonde"', '"lab-plane"').replace('"adis16475"', '"lab-imu"')
    assert own != head
    Path("own.toml").write_text(own + '[[estimator]]\nuse = "held"\noptions = { gate = 2.0 }\n')
    assert main(["run", "own.toml", "-o", "out", *SET]) in (0, 1)
    result = bench.read_result("out")
    assert "nees_mean" in result.metrics["held"], result.metrics["held"]
    assert result.sensors.specs.imu.name == "lab-imu"
    assert (tmp_path / "filter").exists()
    assert "lab_nav.filters" not in sys.modules  # it ran elsewhere
    assert main(["export", "out", "--to", "counts", "-o", "rows"]) == 0
    assert Path("rows/rows.txt").read_text() == str(len(result.sensors.imu))
    again = bench.run("figure-eight", overrides=SHORT, estimators=["held"])
    assert "nees_mean" in again.metrics["held"]


def test_a_name_that_is_near_is_offered_and_a_class_of_a_file_still_needs_permission(lab):
    with pytest.raises(ConfigError, match="Did you mean 'held'"):
        bench.read_profile("figure-eight", estimators=["hled"])
    text = (PACKAGE / "profiles" / "figure-eight.toml").read_text()
    Path("own.toml").write_text(text + '[[estimator]]\nuse = "lab_nav.filters:Held"\n')
    with pytest.raises(ConfigError, match="is code that would run on this machine"):
        bench.read_profile("own.toml")
    with pytest.raises(ConfigError, match="Did you mean 'lab-imu'"):
        bench.read_profile("figure-eight", {"sensors.imu": "lab-imus"})


def test_a_clash_and_a_broken_entry_are_a_line_and_stop_nothing(lab, tmp_path, capsys):
    install(lab, "other", """
[bench.estimators]
held = other:Held
loose-15 = other:Mine
lame = other
../up = other:Up
[bench.catalog]
gone = other.nowhere
""")  # fmt: skip
    shutil.copy(
        PACKAGE / "catalog" / "imu" / "stim300.toml", lab / "lab_nav" / "sheets" / "imu" / "stim300.toml"
    )
    problems = list_plugin_problems()
    assert problems == [
        "other 1.2: estimators '../up' is no name of letters, digits, '-', '_' and '.', 100 at most",
        "other 1.2: estimators 'held' is a name of lab-nav 1.2, too, which comes first",
        "other 1.2: estimators 'lame' = 'other' does not have the form 'module:Class'",
        "other 1.2: estimators 'loose-15' is a name of bench itself; it keeps its own",
        "other 1.2: catalog 'gone' = 'other.nowhere': there is no such folder",
        "lab-nav 1.2: imu 'stim300' is a name of bench itself; it keeps its own",
    ]
    assert main(["list", "estimators"]) == 0
    assert "is a name of lab-nav 1.2" in " ".join(capsys.readouterr().out.split())
    profile = bench.read_profile("figure-eight", {"sensors.imu": "stim300"}, estimators=["loose-15", "held"])
    assert [choice.use for choice in profile.estimators] == ["loose-15", "held"]
    assert profile.sensors.imu.name == "stim300"


def test_an_export_that_cannot_be_imported_is_one_line(lab, tmp_path):
    (lab / "lab_nav" / "counts.py").write_text("import a_module_that_is_not_there\n")
    with pytest.raises(ConfigError, match=r"'counts' of lab-nav 1\.2: No module named"):
        bench.export_run(tmp_path, "counts")
