"""The shell completes names and keys, and a near name is offered for a wrong one."""

import json
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete

from bench.cli.command_line import commands, main
from bench.core.words.wording import suggest


def complete(*words: str) -> list[str]:
    *before, last = words
    found = ShellComplete(commands, {}, "bench", "_BENCH_COMPLETE").get_completions(list(before), last)
    return [one.value for one in found]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("run", "figure"), ["figure-eight", "figure-eight-matched"]),
        (("fly", "circ"), ["circuit", "circuit-navion"]),
        (("run", "static", "-e", "loose-1"), ["loose-15"]),
        (("run", "static", "--set", "start.lat"), ["start.lat_deg="]),
        (("run", "static", "--set", "sensors.imu=stim"), ["sensors.imu=stim300"]),
        (("campaign", "stat"), ["static"]),
        (("allan", "stim"), ["stim300"]),
        (("guide", "own-f"), ["own-filter"]),
        (("new", "sch"), ["schemas"]),
    ],
)
def test_the_shell_completes(words, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert complete(*words) == expected


def test_a_profile_of_the_present_folder_is_completed(tmp_path, monkeypatch):
    (tmp_path / "mine.toml").touch()
    monkeypatch.chdir(tmp_path)
    assert complete("run", "mi") == ["mine.toml"]


def test_nothing_is_imported_for_it_before_it_is_asked_for():
    code = "import sys, bench.cli; print('bench.io.config' in sys.modules, 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


@pytest.mark.parametrize(
    ("wrong", "known", "near"),
    [
        ("STIM300", ["stim300", "adis16475"], "stim300"),
        ("arw", ["noise_deg_sqrt_h", "noise_deg_s_sqrt_hz", "range_deg_s"], "noise_deg_s"),
        ("ARW_deg_sqrt_h", ["noise_deg_sqrt_h", "range_deg_s"], "noise_deg_sqrt_h"),
        (
            "bias_stability_deg_h",
            ["bias_instability_deg_h", "turn_on_bias_sd_deg_h"],
            "bias_instability_deg_h",
        ),
        ("latitude", ["lat_deg", "lon_deg"], "lat_deg"),
    ],
)
def test_a_name_in_capitals_or_of_the_datasheet_is_understood(wrong, known, near):
    assert f"Did you mean '{near}" in suggest(wrong, known, "keys")


def test_a_word_that_is_no_topic_names_the_pages_that_have_it(capsys):
    assert main(["guide", "octave"]) == 2
    said = capsys.readouterr().err
    assert "no topic 'octave'. Mentioned in: " in said, said


def test_the_name_of_a_unit_is_told_where_it_is_listed(capsys):
    assert main(["list", "STIM300"]) == 2
    assert "stim300 is in 'bench list sensors'" in capsys.readouterr().err


def test_filters_and_the_kinds_of_sensors_are_listed(capsys):
    assert main(["list", "imu", "--json"]) == 0
    (imus,) = json.loads(capsys.readouterr().out).values()
    assert {entry["kind"] for entry in imus} == {"imu"}
    assert "stim300" in [entry["name"] for entry in imus]
    assert main(["list", "filters", "--json"]) == 0
    (filters,) = json.loads(capsys.readouterr().out).values()
    assert "loose-full" in [entry["name"] for entry in filters]


def test_a_figure_without_its_sensor_is_told_what_begins_it(capsys):
    assert main(["run", "figure-eight", "--set", "gyro.arw=1"]) == 2
    assert "name its sensor: sensors.imu.gyro.arw=" in capsys.readouterr().err
