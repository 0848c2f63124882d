"""A study by its name: options, folder, report, figures, and the words of the command line."""

from __future__ import annotations

import dataclasses
import io
import json
import re
import subprocess
import sys
import time
from importlib import import_module

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

import bench
from bench.cli.command_line import commands
from bench.cli.verbs.printing import print_table
from bench.core.records.findings import Findings, FindingTable, join_findings
from bench.core.records.findings.series import Plot, draw_dots, draw_line
from bench.core.words.exceptions import ConfigError
from bench.evaluation.ensembles.ensemble import Estimate
from bench.experiments.studies import STUDIES, rnp, sensor_requirements
from bench.experiments.studies.conducting import find_study
from bench.experiments.studies.outage_study import outage_drift
from bench.experiments.studies.study import UnitOptions, ask_each, format_estimate, make_command, read_options
from bench.io import results
from bench.io.results.study_folder import write_study
from bench.plugins.papers import alignment_errors, mechanization_costs
from bench.views.report import study_page, svg
from bench.views.report.study_page import format_cell
from bench.views.report.writing import write_figures

SHORT = {"outages_s": (60, 300)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("study") / "asked"
    bench.study("requirements", out=out, error_m=10.0, **SHORT)
    return out


def test_a_folder_is_read_back(folder):
    begun = time.perf_counter()
    made, read = bench.study("requirements", error_m=10.0, **SHORT), bench.read_study(folder)
    assert 0.0 < made.wall_s < time.perf_counter() - begun
    assert read.command == "bench study requirements --error-m 10 --outages-s 60,300"
    assert read.verdicts == made.verdicts
    assert read.tables.keys() == made.tables.keys()
    for name, table in made.tables.items():
        assert dict(read.tables[name].columns) == dict(table.columns)
        assert read.tables[name].units == table.units
    for name, plot in made.figures.items():
        again = read.figures[name]
        assert (again.title, again.across, again.over, again.log) == (
            plot.title, plot.across, plot.over, plot.log,
        )  # fmt: skip
        for one, other in zip(again.series, plot.series, strict=True):
            np.testing.assert_array_equal(one.t, other.t)
            np.testing.assert_array_equal(one.values, other.values)
    assert json.loads((folder / results.STUDY_RESULT).read_text())["provenance"]["versions"]["bench"]


def test_a_folder_is_not_replaced_unless_asked(folder):
    with pytest.raises(ConfigError, match="--force replaces it"):
        bench.study("requirements", out=folder, **SHORT)
    with pytest.raises(ConfigError, match="no study"):
        bench.read_study(folder.parent)


def test_the_report_and_the_figures_of_a_folder(folder, tmp_path):
    page = bench.write_report(folder).read_text(encoding="utf-8")
    read = bench.read_study(folder)
    for text in (read.question, read.command, *read.verdicts):
        assert text in page
    assert re.search(r"<span>written \d{4}-\d\d-\d\d \d\d:\d\d</span>", page)
    assert page.count('<svg class="plot"') == len(read.figures)
    written = write_figures(folder, tmp_path / "figures", "svg")
    assert [path.stem for path in written] == list(read.figures)


def test_options_left_out_are_not_listed(folder):
    read = bench.read_study(folder)
    chosen = {"alert_limit_m": None, "runs": 20, "outages_s": [60.0, 300.0]}
    page = study_page.make_page(dataclasses.replace(read, options=chosen))
    options = dict(re.findall("<dt>(.*?)</dt><dd>(.*?)</dd>", page))
    assert (options["runs"], options["outages_s"]) == ("20", "60, 300")
    assert "alert_limit_m" not in options


def test_text_stands_on_the_left_of_its_column_and_numbers_on_the_right(folder):
    columns = {"grade": ["one"], "gyro_deg_h": [0.5], "unit": ["deg/h"], "remark": ["word " * 12]}
    read = bench.read_study(folder)
    found = dataclasses.replace(read.findings, tables=(FindingTable("t", "Title", columns),))
    page = study_page.make_page(dataclasses.replace(read, findings=found))
    heads = dict(re.findall(r'<th scope="col" class="(\w+)" title="(\w+)">', page))
    assert heads == {"text": "unit", "number": "gyro_deg_h", "words": "remark"}
    assert re.findall(r'<(?:td|th scope="row") class="(\w+)">', page) == ["text", "number", "text", "words"]


def test_an_estimate_in_a_sentence_has_three_digits_and_no_power_of_ten():
    assert format_estimate(Estimate(2031.4, 1091.2, 3793.0)) == "2030 (1090 to 3790)"
    assert format_estimate(Estimate(0.03014, 0.01625, 12.0)) == "0.0301 (0.0163 to 12)"


@pytest.mark.parametrize("width", [80, 200])
def test_a_wide_table_is_divided_and_nothing_is_cut(width):
    """Twelve columns; the first three name a row, and the second of them is not needed for it."""
    names = ["stim300", "adis16475", "a-unit-with-a-long-name"]
    columns = {
        "unit": [name for name in names for _ in range(2)],
        "class": [f"grade {name}" for name in names for _ in range(2)],
        "estimator": ["loose-15", "loose-full"] * 3,
        **{f"horizontal_rms_{k}_m": [1000.0 + 10 * k + row for row in range(6)] for k in range(8)},
        "remark": ["word " * 12] * 6,
    }
    file = io.StringIO()
    print_table(Console(file=file, width=width), FindingTable("t", "The title", columns))
    lines = file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    assert "…" not in file.getvalue()
    words = file.getvalue().split()
    values = [text for name in columns if name.startswith("h") for text in map(format_cell, columns[name])]
    assert sorted(word for word in words if word[:2] in ("10", "11")) == sorted(values)
    assert words.count("word") == 6 * 12
    parts = sum("─" in line for line in lines)
    assert (parts > 1) == (width == 80)
    assert words.count("a-unit-with-a-long-name") == 2 * (parts + 1)  # in "class", too
    assert words.count("loose-full") == 3 * parts


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"error_m": -1.0}, "error_m = -1 m must be above 0"),
        ({"outages_s": "10,x"}, "outages_s.1 = 'x' must be a number"),
        ({"outages": "10"}, "outages is unknown. Did you mean 'outages_s'?"),
        ({"lat_deg": 95.0}, "lat_deg = 95 deg must be at most 80"),
    ],
)
def test_a_wrong_option_is_one_clear_line(given, message):
    with pytest.raises(ConfigError) as raised:
        bench.study("requirements", **given)
    assert len(raised.value.lines) == 1 or "known" in raised.value.lines[-1]
    assert message in str(raised.value)


def test_names_of_dots_and_places_and_what_is_undecided_are_read_back(tmp_path):
    """And stand in the picture: beside their dots, no two on each other, and below the axis."""
    at, values = np.array([1.0, 1.0, 2.0]), np.array([10.0, 10.1, 100.0])
    dots = draw_dots("units", at, values, "usable", (1, 2, 3), labels=("one", "two & a half", "three"))
    plot = Plot(
        ("s", "p"), "p", (dots,), across="", over="class", log="y", ticks=((1.0, "low"), (2.0, "high"))
    )
    made = bench.study("requirements", **SHORT)
    findings = dataclasses.replace(made.findings, figures=(plot,), undecided=True)
    write_study(tmp_path / "asked", dataclasses.replace(made, findings=findings))
    read = bench.read_study(tmp_path / "asked")
    assert read.findings.undecided
    (again,) = read.figures.values()
    assert again.ticks == plot.ticks
    assert again.series[0].labels == dots.labels
    drawn = study_page.make_page(read)
    assert ">high</text>" in drawn
    assert "p over class" in drawn
    assert "over class [" not in drawn
    rows = re.findall(r'<text class="name" x="(\d+)" y="(\d+)">([^<]*)</text>', drawn)
    assert sorted(text for *_, text in rows) == ["one", "three", "two &amp; a half"]
    assert abs(int(rows[0][1]) - int(rows[1][1])) >= 100
    written = write_figures(tmp_path / "asked", tmp_path / "figures", "svg")
    assert len(written) == 1
    broken = json.loads((tmp_path / "asked" / "figures.json").read_text())
    broken["figures"][0]["series"][0]["labels"].pop()
    (tmp_path / "asked" / "figures.json").write_text(json.dumps(broken))
    with pytest.raises(ConfigError):
        bench.read_study(tmp_path / "asked")


def test_an_unknown_study_names_the_known():
    with pytest.raises(ConfigError, match="Did you mean 'requirements'"):
        bench.study("requirement")


DEFAULTS = {
    "requirements": "error_m 5 outages_s 10,30,60,100,120,180,300,600,900,1800,2532,3600 lat_deg 45",
    "outages": "outages_s 10,30,60,120,300,600 error_m 5",
    "alignment": "heading_deg .1 lengths_km 50,100,300,1000,3000 cross_track_m 1000 lat_deg 45 course_deg 50 "
    "speed_mps 200 duration_s 5000 gyro_deg_h .01 angles_deg 0,1,10,57.6,90 position_m 11.2 "
    "velocity_mps .0707 range_km 316",
    "mechanizations": "coning_deg .1 coning_hz 20 bases_m .2,.5,1 accel_bias_ug 10",
    "rnp": "rnp_nm .3 vertical_limit_m 50 time_to_alert_s 10 continuity_s 15 availability .95 "
    "false_alarm 3.33e-7 missed 1e-3",
}
"""What a study takes where nothing is asked."""


@pytest.mark.parametrize("name", DEFAULTS)
def test_what_is_taken_where_nothing_is_asked(name):
    words = DEFAULTS[name].split()
    fields = import_module(STUDIES[name].module).Options.model_fields
    for key, text in zip(words[::2], words[1::2], strict=True):
        assert np.ravel(fields[key].default).tolist() == [float(one) for one in text.split(",")], key


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_has_a_command_with_its_options(name):
    """Each option has its words; the command of the defaults is the bare one."""
    _, module = find_study(name)
    for key, field in module.Options.model_fields.items():
        assert field.is_required() or field.description, key
        assert key not in {"jobs", "out", "force", "progress", "name", "report", "as_json"}
    shown = CliRunner().invoke(commands, ["study", name, "--help"], catch_exceptions=False).output
    for key, field in module.Options.model_fields.items():
        flag = {"overrides": "--set"}.get(key, f"--{key.replace('_', '-')}")
        assert (key.upper() if field.is_required() else flag) in shown
    required = {key: "x" for key, field in module.Options.model_fields.items() if field.is_required()}
    if not required:
        assert list(make_command(name, read_options(name, module.Options, {}))) == ["bench", "study", name]


def test_the_command_line_prints_writes_and_ends_as_it_should(tmp_path):
    verb = [sys.executable, "-m", "bench", "study", "requirements", "--outages-s", "60,300"]
    done = subprocess.run([*verb, "-o", "asked"], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "283.4" in done.stdout
    assert sorted(path.name for path in (tmp_path / "asked").iterdir()) == [
        ".bench.json", "figures.json", "report.html", "study.json", "tables",
    ]  # fmt: skip
    again = subprocess.run([*verb, "-o", "asked"], capture_output=True, text=True, cwd=tmp_path)
    assert again.returncode == 2
    assert "--force replaces it" in again.stderr


def test_a_power_law_is_a_straight_line_on_logarithmic_axes():
    """Marks are powers of ten, and a curve of slope -2 keeps only its ends."""
    t = np.geomspace(10.0, 1000.0, 50)
    plot = Plot(("p",), "p", (draw_line("a", t, 1e6 / t**2, "a", (1, 2, 3)),), log="xy")
    drawn = svg.draw(plot, (10.0, 1000.0))
    assert ">10<" in drawn
    assert ">100<" in drawn
    path = drawn.split('class="line" d="')[1].split('"')[0]
    assert path.count(" ") <= 8


def test_findings_of_several_cases_are_one_and_as_bad_as_the_worst(tmp_path):
    one = Findings(("a",), (FindingTable("t", "T", {"x": [1]}),), (), runs=5)
    other = dataclasses.replace(one, runs=7, good=False, undecided=True)
    for both in (join_findings({"p": one, "q": other}), join_findings({"p": other, "q": one})):
        assert both.verdicts == ("p: a", "q: a")
        assert [(table.name, table.title) for table in both.tables] == [("t-p", "p: T"), ("t-q", "q: T")]
        assert (both.runs, both.good, both.undecided) == (7, False, True)
    assert join_findings({"": one}) is one
    options = UnitOptions(
        profiles=("a/f.toml", "b/f.toml"), units="stim300,vn-100", overrides={"rate_hz": 50}
    )

    checked = []

    def ask(asked, work):
        assert len(checked) in (4, 5)  # all before the first
        return Findings((f"{asked.profile} {asked.imu} {asked.settings}",), (), ())

    found = ask_each("made", options, None, checked.append, ask).verdicts
    assert [text.partition(":")[0] for text in found] == [
        "f-stim300",
        "f-vn-100",
        "f-stim300-3",
        "f-vn-100-4",
    ]
    assert found[3].endswith("b/f.toml vn-100 {'rate_hz': 50, 'sensors.imu': 'vn-100'}")
    lone = ask_each("made", UnitOptions(profiles="f.toml"), None, checked.append, ask).verdicts
    assert lone == ("f.toml None {}",)


@pytest.mark.parametrize(
    ("name", "good", "options"),
    [
        ("bound", "s-turns", {}),
        ("budget", "s-turns", {}),
        ("observability", "s-turns", {}),
        ("sensitivity", "s-turns", {"key": "rate_hz", "values": "100,200"}),
        ("sensors", "s-turns", {"units": "stim300"}),
        ("outages", "gnss-denied-leg", {}),
        ("closed-loop", "approach-closed", {}),
        ("rnp", "waypoints", {"estimator": "loose-15"}),
    ],
)
def test_every_profile_is_read_before_the_first_is_flown(name, good, options, monkeypatch):
    def refuse(*args, **options):
        raise AssertionError("flown")

    for module, function in (("pipeline", "fly"), ("pipeline.closed_loop", "fly"), ("pipeline", "run")):
        monkeypatch.setattr(f"bench.{module}.{function}", refuse)
    with pytest.raises(ConfigError, match="nosuch") as raised:
        bench.study(name, profiles=f"{good},nosuch,nosuch-either", jobs=1, **options)
    assert len(raised.value.messages) == (1 if name in ("sensors", "outages") else 2)


@pytest.mark.parametrize(
    ("study", "numbers"),
    [
        (
            alignment_errors,
            "0.1 50 100 300 1000 3000 1000 45 50 200 5000 0.01 0 1 10 57.6 90 11.2 0.0707 316 1000",
        ),
        (mechanization_costs, "300 100 0.1 20 100 200 400 0.2 0.5 1 10"),
        (outage_drift, "10 30 60 120 300 600 5 10"),
        (sensor_requirements, "5 10 30 60 100 120 180 300 600 900 1800 2532 3600 45"),
        (rnp, "0.3 50 10 15 0.95 3.33e-07 0.001 60"),
    ],
)
def test_who_says_nothing_asks_with_the_numbers_of_the_guide(study, numbers):
    fields = study.Options.model_fields.items()
    given = np.hstack([one.default for name, one in fields if name != "seed" and _is_number(one.default)])
    assert [f"{value:g}" for value in given] == numbers.split()


def _is_number(default) -> bool:
    first = default[0] if isinstance(default, tuple) and default else default
    return isinstance(first, int | float) and not isinstance(first, bool)
