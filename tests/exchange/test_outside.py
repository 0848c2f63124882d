"""A filter outside Python runs on the sensors alone, is evaluated like the others, cannot end bench."""

from __future__ import annotations

import dataclasses
import json
import pickle
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench import pipeline
from bench.cli.command_line import main
from bench.core.records.specs import EstimatorChoice, EvaluationWindow, Guard
from bench.core.words.exceptions import ConfigError, EstimatorError, EstimatorFailedError
from bench.evaluation.metrics import run_metrics
from bench.io import config, results
from bench.io.foreign import outside
from bench.io.foreign.outside import CommandEstimator
from bench.navigation import estimator
from tests.builders import is_running
from tests.cli.test_cli import PROFILE

HERE = Path(__file__).parent
COMPILER = shutil.which("cc")
AWK = shutil.which("awk")

HOLD = """
# Holds the newest valid fix that has arrived: latitude, longitude, height, velocity.
BEGIN { FS = ","; OFS = ","; OFMT = CONVFMT = "%.17g"
  print "t_s,lat_rad,lon_rad,alt_m,vel_n_mps,vel_e_mps,vel_d_mps" > solution }
FNR == 1 { next }
NR == FNR { n++; at[n] = $2 + 0; ok[n] = $3; rest[n] = $4 OFS $5 OFS $6 OFS $7 OFS $8 OFS $9; next }
{ while (k < n && at[k + 1] <= $1 + 1e-9) { k++; if (ok[k]) held = rest[k] }
  if (held != "") print $1, held > solution }
END { print n " fixes" > "/dev/stderr" }
"""


def python(path: Path, code: str) -> str:
    """Write a program in Python and return the command that runs it."""
    path.write_text(code)
    return f"{sys.executable} {{here}}/{path.name} {{sensors}} {{solution}}"


def held(truth, sensed):
    """What a filter that holds the newest valid fix would say, worked out from the record."""
    fixes = sensed.data.fixes
    good = np.flatnonzero(fixes.valid)
    k = np.searchsorted(fixes.t_arrival[good], sensed.data.output_t + 1e-9, "right") - 1
    return k >= 0, fixes.lla[good][np.maximum(k, 0)], fixes.vel_n[good][np.maximum(k, 0)]


@pytest.fixture(scope="module")
def holds(tmp_path_factory) -> list[tuple[str, Path]]:
    """Commands of the fix-holding filter outside Python, and the folders they stand in."""
    folder = tmp_path_factory.mktemp("filter")
    found = []
    if COMPILER:
        subprocess.check_call([COMPILER, "-O1", "-o", str(folder / "hold"), str(HERE / "hold.c")])
        found.append(("./hold {sensors} {solution}", folder))
    if AWK:
        (folder / "hold.awk").write_text(HOLD)
        command = "awk -v solution={solution} -f {here}/hold.awk {sensors}/gnss.csv {sensors}/output.csv"
        found.append((command, folder))
    if not found:
        pytest.skip("no C compiler and no awk here")
    return found


# --- end to end ---------------------------------------------------------------------------------------


def test_a_filter_in_c_or_awk_says_what_its_algorithm_says(run, holds):
    _, truth, sensed = run
    for command, folder in holds:
        solution = CommandEstimator(command, folder).run(sensed.data, sensed.initial)
        begun, lla, vel_n = held(truth, sensed)
        assert_array_equal(np.isfinite(solution.lla).all(axis=1), begun)
        assert_allclose(solution.lla[begun], lla[begun], rtol=0, atol=1e-15 * 2000)
        assert_allclose(solution.vel_n[begun], vel_n[begun], rtol=1e-12)
        assert np.isnan(solution.q_nb).all()
        assert solution.events.select(outside.PROGRAM) == [(0.0, 0.0, "exit status 0")]
        ((_, _, said),) = solution.events.select(outside.STDERR)
        assert said.startswith(("192 rows", "18 fixes"))
        _, measured = run_metrics.measure(
            truth, solution, evaluation=EvaluationWindow(5.0), outages=[(12.0, 14.0)]
        )
        off = np.hypot(
            *(run_metrics.error_series(truth, solution).pos_n[sensed.data.output_t >= 5.0 - 1e-6, :2].T)
        )
        assert measured["pos_rmse_h_m"] == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-9)
        assert 5 < measured["pos_rmse_h_m"] < 60  # 25 m/s held for up to a second, three in the outage


def test_a_program_stands_in_a_comparison_beside_a_built_in_filter(tmp_path, holds, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(PROFILE)
    for path in holds[0][1].iterdir():
        shutil.copy(path, tmp_path)
    options = [
        f"-e{holds[0][0]!s}".replace("-e", "-ecommand:"),
        "-eloose-15",
        "-ecommand:./none {sensors} {solution}",
    ]
    assert main(["run", "short.toml", "--no-rrd", *options]) == 2
    assert "./none" not in capsys.readouterr().out
    assert not (tmp_path / "runs").exists()
    assert main(["run", "short.toml", "--table", *options[:2]]) in (0, 1)
    said = capsys.readouterr().out
    assert ": exit status 0; stderr ends: " in said
    result = results.read_result(tmp_path / "runs" / "short-5")
    label = next(iter(result.metrics))
    assert label in ("hold", "awk")
    assert list(result.metrics) == [label, "loose-15"]
    assert result.metrics[label]["program"]["program"] == "exit status 0"
    assert (tmp_path / "runs" / "short-5" / "flight.rrd").is_file()
    assert result.profile["estimator"][0]["use"] == f"command:{holds[0][0]}"


# --- what the program sees ----------------------------------------------------------------------------

LOOK = """
import csv, json, os, sys
from pathlib import Path
sensors, solution = map(Path, sys.argv[1:])
seen = {
    "files": sorted(p.name for p in sensors.iterdir()), "cwd": os.getcwd(), "here": sorted(os.listdir(".")),
    "environment": dict(os.environ), "start": json.loads((sensors / "start.json").read_text()),
    "imu": list(csv.DictReader(open(sensors / "imu.csv")))[-1],
    "stdin": sys.stdin.read(), "sensors": str(sensors), "solution": str(solution),
}
print(json.dumps(seen), file=open(Path(__file__).parent / "seen.json", "w"))
solution.write_text("t_s,lat_rad,lon_rad,alt_m\\n0,0.82,0.19,1200\\n")
"""


def test_the_program_sees_the_sensors_and_nothing_else(run, tmp_path, monkeypatch):
    _, _, sensed = run
    monkeypatch.setenv("BENCH_CACHE", "/somewhere/with/truth")
    CommandEstimator(python(tmp_path / "look.py", LOOK), tmp_path).run(sensed.data, sensed.initial)
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert seen["files"] == ["baro.csv", "gnss.csv", "imu.csv", "output.csv", "start.json"]
    assert seen["here"] == ["home", "sensors"]
    assert seen["cwd"] == str(Path(seen["sensors"]).parent) == str(Path(seen["solution"]).parent)
    assert not Path(seen["cwd"]).is_relative_to(tmp_path)
    assert not Path(seen["cwd"]).exists()  # it is gone afterwards
    assert set(seen["environment"]) <= {"PATH", "HOME", "TMPDIR", "LC_ALL", "LC_CTYPE", "LD_LIBRARY_PATH"}
    assert seen["environment"]["HOME"] == f"{seen['cwd']}/home"
    assert seen["stdin"] == ""
    assert float(seen["imu"]["dvel_z_mps"]) == sensed.data.imu.dvel_b[-1, 2]
    assert_array_equal(seen["start"]["initial"]["q_nb"], sensed.initial.q_nb)
    walk = seen["start"]["assumed"]["imu"]["gyro"]["random_walk"]
    assert walk == sensed.data.specs.imu.gyro.random_walk


def test_the_start_holds_what_the_filters_of_the_bench_are_told_and_no_more(run):
    """Neither drawn biases nor truth are in what a program gets: it follows from the two arguments alone."""
    _, _, sensed = run
    document = results.make_start_document(sensed.data, sensed.initial)
    assert set(document) == {"initial", "antenna_b_m", "ground_alt_m", "date", "assumed"}
    other = dataclasses.replace(
        sensed, truth=dataclasses.replace(sensed.truth, gyro_bias_b=sensed.truth.gyro_bias_b + 1)
    )
    assert results.to_json(results.make_start_document(other.data, other.initial)) == results.to_json(
        document
    )


def test_no_shell_is_between(run, tmp_path):
    _, _, sensed = run
    code = "import sys; print(sys.argv[1:], file=sys.stderr); sys.exit(5)"
    command = python(tmp_path / "say.py", code) + " ; touch pwned '$HOME' `id` 'a b' | cat"
    solution = CommandEstimator(command, tmp_path).run(sensed.data, sensed.initial)
    ((_, _, said),) = solution.events.select(outside.STDERR)
    assert "';', 'touch', 'pwned', '$HOME', '`id`', 'a b', '|', 'cat'" in said


# --- what goes wrong ----------------------------------------------------------------------------------


def failure(run, command: str, beside: Path, **options) -> tuple[str, str]:
    """Why there is no solution, and what was said on stderr."""
    _, truth, sensed = run
    solution = CommandEstimator(command, beside, **options).run(sensed.data, sensed.initial)
    _, measured = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(5.0), outages=[])
    assert measured["converged"] is False
    assert not [
        name for name, value in measured.items() if name.startswith(("pos", "vel")) and value is not None
    ]
    said = solution.events.select(outside.STDERR)
    return measured["reason"], said[0][2] if said else ""


def test_a_program_that_fails_is_a_result_that_says_why(run, tmp_path):
    def reason(code: str, **options) -> str:
        return failure(run, python(tmp_path / "x.py", code), tmp_path, **options)[0]

    assert reason("import sys; print('oh\\nno', file=sys.stderr); sys.exit(3)") == "failed: exit status 3: no"
    assert reason("import os; os.abort()").startswith("failed: ended by signal SIGABRT")
    assert reason("pass") == "failed: exit status 0: solution.csv: No such file or directory"
    write = "import sys; open(sys.argv[2], 'w').write({!r})"
    assert reason(write.format("")).startswith("failed: exit status 0: solution.csv: no columns for time")
    bad = "t_s,lat_deg,lon_deg,alt_m\n0,47,x,3\n"
    assert (
        reason(write.format(bad))
        == "failed: exit status 0: solution.csv: row 1: lon_deg = 'x' is not a number"
    )
    radians = "t_s,lat_deg,lon_deg,alt_m\n0,0.82,0.19,1200\n"
    assert "row 1: 5078 km from the start of the run" in reason(write.format(radians))
    link = "import os, sys; os.symlink('/dev/zero', sys.argv[2])"
    assert reason(link) == "failed: exit status 0: solution.csv: not a regular file"


def test_a_program_that_does_not_end_is_stopped_with_all_it_started(run, tmp_path):
    code = (
        "import subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
        f"open({str(tmp_path / 'pid')!r}, 'w').write(str(child.pid))\n"
        "time.sleep(600)"
    )
    begun = time.monotonic()
    why, _ = failure(run, python(tmp_path / "x.py", code), tmp_path, guard=Guard(timeout=3.0))
    assert why == "failed: stopped after 3 s (--timeout)"
    assert time.monotonic() - begun < 120  # seconds, on a busy machine too
    pid = int((tmp_path / "pid").read_text())
    for _ in range(100):
        if not is_running(pid):
            break
        time.sleep(0.05)
    assert not is_running(pid)


def test_what_it_says_is_bounded_and_cannot_steer_a_terminal(run, tmp_path):
    code = (
        "import sys\nfor k in range(400000): print('\\x1b[2J', k, file=sys.stderr)\n"
        "print('x' * 10**7); sys.exit(1)"
    )
    why, said = failure(run, python(tmp_path / "x.py", code), tmp_path)
    assert why == "failed: exit status 1: [2J 399999"
    assert len(said) <= 4000
    assert "\x1b" not in said


def test_a_solution_without_end_is_stopped(run, tmp_path):
    code = (
        "import sys\nwith open(sys.argv[2], 'w') as f:\n"
        "    while True: f.write('1,2,3\\n' * 10000); f.flush()"
    )
    why, _ = failure(run, python(tmp_path / "x.py", code), tmp_path, guard=Guard(output=10e6))
    assert why == "failed: stopped: its solution is larger than 10 MB (--output)"


def test_a_program_that_takes_the_memory_of_others_is_stopped(run, tmp_path):
    code = "kept = []\nwhile True: kept.append(b'x' * 2_000_000)"
    why, _ = failure(run, python(tmp_path / "x.py", code), tmp_path, guard=Guard(memory=1e8))
    assert re.fullmatch(r"failed: stopped: 0\.\d+ GB of memory, more than 0\.1 GB \(--memory\)", why)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("./none {sensors} {solution}", "no such file"),
        ("./data {sensors} {solution}", "not a program that can be run"),
        ("nosuchprogram {sensors} {solution}", "no program 'nosuchprogram' on the PATH; one in this folder"),
        ("awk {sensors}", "{solution} is missing"),
        ("awk {sensors} {solution} {truth}", "{truth} is not one of {sensors}, {solution}, {here}"),
        ("awk {sensors.__class__} {solution}", "{sensors.__class__} is not one of"),
        ("awk 'a {sensors} {solution}", "No closing quotation"),
        ("{sensors}/x {sensors} {solution}", "it must not come from a field"),
    ],
)  # fmt: skip
def test_a_wrong_command_is_refused_before_the_flight(tmp_path, command, said):
    (tmp_path / "data").write_text("no program")
    with pytest.raises(EstimatorError) as caught:
        pipeline.build_estimator(EstimatorChoice(f"command:{command}", "x", {}, tmp_path))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options", [{"timeout_s": 3}, {"max_gap_s": 0}, {"max_gap_s": "long"}, {"seconds": 3}]
)
def test_wrong_options_are_refused(tmp_path, options):
    choice = EstimatorChoice(f"command:{sys.executable} {{sensors}} {{solution}}", "x", options, tmp_path)
    with pytest.raises(EstimatorError, match=next(iter(options))):
        pipeline.build_estimator(choice)


def test_it_pickles(tmp_path):
    """A campaign sends it to other processes."""
    built = CommandEstimator(f"{sys.executable} {{sensors}} {{solution}}", tmp_path)
    assert vars(pickle.loads(pickle.dumps(built))) == vars(built)


# --- profiles -----------------------------------------------------------------------------------------


def test_a_profile_runs_no_class_unless_told(tmp_path, monkeypatch, capsys):
    """Wherever the module is from; the one that the user names with -e is his own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "his.toml").write_text(PROFILE + "[[estimator]]\nuse = 'his:Filter'\nlabel = 'loose-22'\n")
    (tmp_path / "his.py").write_text("open('ran', 'w')\n")
    for options in ([], ["-e", "loose-22"]):  # the label does not make it built in
        assert main(["run", "his.toml", *options]) == 2
        assert re.fullmatch(
            r"error: his.toml: \[\[estimator\]\] 2: 'his:Filter' is code that would run on this machine; "
            r"--allow-code .*\n",
            capsys.readouterr().err,
        )
    assert not (tmp_path / "ran").exists()
    assert config.read_profile("his.toml", allow_code=True).estimators[1].use == "his:Filter"
    assert config.read_profile("his.toml", estimators=["his:Filter"]).estimators[0].use == "his:Filter"


def test_a_class_that_ends_the_interpreter_is_a_failed_estimator(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "leaves_at_import.py").write_text("raise SystemExit(0)\n")
    assert main(["run", "static", "-e", "leaves_at_import:Filter"]) == 70
    said = "filter 'leaves_at_import:Filter': its module raised SystemExit: 0"
    assert said in capsys.readouterr().err

    class Leaves:
        def run(self, sensors, initial):
            sys.exit()

    with pytest.raises(EstimatorFailedError, match=r"^filter 'x': run\(\) raised SystemExit$"):
        estimator.answer(Leaves(), "x", None, None)


def test_a_profile_starts_no_program_unless_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    profile = PROFILE + "[[estimator]]\nuse = 'command:sh -c touch {sensors} {solution}'\n"
    (tmp_path / "his.toml").write_text(profile)
    assert main(["run", "his.toml"]) == 2
    assert capsys.readouterr().err == (
        "error: his.toml: [[estimator]] 2: 'command:sh -c touch {sensors} {solution}' is code that would run "
        "on this machine; --allow-code lets a file do so; code that you name with -e runs without it\n"
    )
    assert main(["run", "his.toml", "-e", "sh"]) == 2  # its label does not make it yours
    assert "--allow-code" in capsys.readouterr().err
    assert [c.label for c in config.read_profile("his.toml", estimators=["loose-15"]).estimators] == [
        "loose-15"
    ]
    assert config.read_profile("his.toml", allow_code=True).estimators[1].label == "sh"


def test_relative_paths_begin_at_the_profile_or_for_e_where_one_stands(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    text = PROFILE + "[[estimator]]\nuse = 'file:sub/his.csv'\n"
    (tmp_path / "there" / "p.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    profile = config.read_profile("there/p.toml")
    assert (profile.estimators[1].label, profile.estimators[1].beside) == ("his", Path("there"))
    mine = config.read_profile("there/p.toml", estimators=["file:his.csv", "file:other/his.csv"])
    assert [(c.label, c.beside) for c in mine.estimators] == [("his", Path()), ("his-2", Path())]
    with pytest.raises(ConfigError, match=r"his\.csv: No such file"):
        pipeline.build_estimator(mine.estimators[0])
