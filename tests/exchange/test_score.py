"""A solution from anywhere is evaluated as if a filter had said it, on its own times, without
extrapolation; what is wrong with its file is one line with the row."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.cli.command_line import main
from bench.core.mathematics import earth, rotation
from bench.core.records.data import NavSolution
from bench.core.records.specs import EvaluationWindow
from bench.core.words.exceptions import ConfigError
from bench.evaluation.consistency.verdict import add_verdict
from bench.evaluation.errors.resampling import carry_rows, resample
from bench.evaluation.metrics import run_metrics
from bench.io import config, results
from bench.io.config import fault_tables
from bench.io.foreign.solutions import FileEstimator, read_solution
from bench.io.results import columns, parquet
from tests.evaluation.solutions import without, wrong_solution
from tests.exchange.exported import LOST
from tests.synthetic import turning


def written(path, solution: NavSolution):
    parquet.write_csv(path, solution, columns.solution_layout(()))
    return path


def table(path, **named):
    """Write columns by name; the keys are those of the file."""
    rows = np.column_stack(list(named.values()))
    lines = [",".join(named), *(",".join(repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def judged(capsys, *arguments: str) -> tuple[dict, str]:
    status = main(["score", *arguments, "--json"])
    out, err = capsys.readouterr()
    assert status in (0, 1), err
    return json.loads(out), err


# --- evaluated like a filter -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_solution_of_the_bench_scores_what_it_scored(run, tmp_path, capsys, kind):
    folder = run[0]
    assert (
        main(["export", str(folder), "--to", kind, "-o", str(tmp_path / "x"), "--with", "solution:made"]) == 0
    )
    capsys.readouterr()
    measured, said = judged(capsys, str(tmp_path / "x" / f"solution-made.{kind}"), str(folder))
    expected = results.read_result(folder).metrics["made"]
    assert expected["pos_rmse_h_m"] == pytest.approx(np.hypot(3, 2), rel=1e-6)
    assert set(expected) <= set(measured)
    for name, value in expected.items():
        if isinstance(value, float | None):
            edge = 0.05 if "sigma" in name and name.startswith("coverage") else 1e-8  # an epoch at the limit
            close = None if value is None else pytest.approx(value, rel=1e-9, abs=edge)
            assert measured[name] == close, name
    text = add_verdict("made", expected)["verdict_text"]
    assert measured["verdict_text"].replace("solution-made", "made") == text
    assert "solution-made covers 100 % of the 202 epochs, 202 rows" in said
    assert any("made" in line.split() for line in said.splitlines())


def test_blocks_that_are_not_given_have_no_metrics_and_no_consistency(run, tmp_path, capsys):
    folder, truth, _ = run
    lat, lon, alt = earth.displace(truth.lla, [0.0, 4.0, 0.0]).T
    path = table(tmp_path / "place.csv", t_s=truth.t, lat_rad=lat, lon_rad=lon, alt_m=alt)
    measured, _ = judged(capsys, str(path), str(folder))
    assert measured["converged"] is True
    assert measured["pos_rmse_h_m"] == pytest.approx(4.0, rel=1e-6)
    assert not [
        name for name in measured if name.startswith(("vel", "tilt", "heading", "nees", "coverage_3"))
    ]
    path = table(tmp_path / "sd.csv", t_s=truth.t, lat_rad=lat, lon_rad=lon, alt_m=alt,
                 sd_pos_n_m=0 * lat + 4, sd_pos_e_m=0 * lat + 4, sd_pos_d_m=0 * lat + 4)  # fmt: skip
    measured, _ = judged(capsys, str(path), str(folder))
    assert (measured["nees_states"], measured["nees_mean"]) == (3, pytest.approx(1.0, rel=1e-6))
    assert measured["coverage_3sigma_pos_e"] == 1.0


def test_every_way_to_name_the_columns_says_the_same(run, tmp_path, capsys):
    folder, truth, _ = run
    made = wrong_solution(truth, pos_n=[1.0, 2.0, 3.0], vel_n=[0.1, 0.0, 0.2], phi_n=[0.01, 0.0, 0.03])
    lat, lon, alt = made.lla.T
    e = dict(zip(("ecef_x_km", "ecef_y_km", "ecef_z_km"), earth.to_ecef(made.lla).T / 1e3, strict=True))
    q_en = rotation.from_matrix(earth.matrix_en(lat, lon))
    ev = dict(
        zip(
            ("ecef_vel_x_mps", "ecef_vel_y_mps", "ecef_vel_z_m_s"),
            rotation.rotate(q_en, made.vel_n).T,
            strict=True,
        )
    )
    qe = dict(
        zip(("q_eb_w", "q_eb_x", "q_eb_y", "q_eb_z"), rotation.multiply(q_en, made.q_nb).T, strict=True)
    )
    angles = np.rad2deg(np.column_stack(rotation.to_euler(made.q_nb)))
    n = dict(zip(("vel_n_mps", "vel_e_mps", "vel_d_mps"), made.vel_n.T, strict=True))
    one = table(tmp_path / "one.csv", t_s=made.t, **e, **ev, **qe)
    place = {"lat_deg": np.rad2deg(lat), "lon_deg": np.rad2deg(lon), "alt_km": alt / 1e3}
    turn = {"roll_deg": angles[:, 0], "pitch_mrad": np.deg2rad(angles[:, 1]) * 1e3, "yaw_deg": angles[:, 2]}
    two = table(tmp_path / "two.csv", time_s=made.t, **place, **n, **turn)
    a, b = judged(capsys, str(one), str(folder))[0], judged(capsys, str(two), str(folder))[0]
    assert a.keys() == b.keys()
    for name in a:
        if isinstance(a[name], float | None):
            assert a[name] == (None if b[name] is None else pytest.approx(b[name], rel=1e-6, abs=1e-6)), name
    assert a["verdict"] == b["verdict"]
    assert a["vel_rmse_3d_mps"] == pytest.approx(np.hypot(0.1, 0.2), rel=1e-4)  # one time between rows
    assert a["phi_rmse_d_deg"] == pytest.approx(np.rad2deg(0.03), rel=1e-3)


def test_a_clock_of_its_own(run, tmp_path, capsys):
    folder, truth, _ = run
    made = wrong_solution(truth, pos_n=[1.0, 0.0, 0.0])
    path = written(tmp_path / "late.csv", replace(made, t=made.t + 18.0))
    assert judged(capsys, str(path), str(folder), "--t0", "18")[0]["pos_rmse_h_m"] == pytest.approx(
        1.0, rel=1e-6
    )
    assert judged(capsys, str(path), str(folder))[0]["pos_rmse_h_m"] > 20  # it is somewhere else then


# --- on its own times ---------------------------------------------------------------------------------


def test_between_rows_motion_is_that_of_the_bodies_and_nothing_is_extrapolated():
    truth = turning(20.0, 100.0)
    rows = slice(130, 1530, 20)  # 5 Hz from 1.3 s to 15.1 s
    made = NavSolution(
        truth.t[rows], truth.lla[rows], truth.vel_n[rows], truth.q_nb[rows],
        *2 * (np.zeros_like(truth.vel_n[rows]),), np.tile(np.eye(9), (len(truth.t[rows]), 1, 1)),
        (), np.empty((70, 0)), np.empty((70, 0)),
    )  # fmt: skip
    t = truth.t[::10]
    found = resample(as_read(made), t)
    inside = (t >= 1.3 - 1e-9) & (t <= 15.1 + 1e-9)
    assert_array_equal(np.isfinite(found.lla).all(axis=1), inside)
    assert found.events.select("not_covered") == [
        (0.0, pytest.approx(1.2), "no rows, or more than 0.4 s apart"),
        (pytest.approx(15.2), 20.0, "no rows, or more than 0.4 s apart"),
    ]
    off = np.linalg.norm(earth.difference_n(found.lla[inside], truth.lla[::10][inside]), axis=1)
    # a cubic through positions and velocities: f4 h^4 / 384, f4 = v w^3; 25 m/s, 0.3 rad/s, 0.2 s
    assert 0 < off.max() < 2 * 25 * 0.3**3 * 0.2**4 / 384 + 1e-6
    turned = rotation.multiply(found.q_nb[inside], rotation.conjugate(truth.q_nb[::10][inside]))
    assert np.linalg.norm(rotation.to_rotvec(turned), axis=1).max() < 1e-9  # the turn rate is constant
    slow = np.linalg.norm(found.vel_n[inside] - truth.vel_n[::10][inside], axis=1)
    assert slow.max() == pytest.approx(25 * 0.3**2 * 0.2**2 / 8, rel=0.02)  # straight between: f'' h^2 / 8
    straight = resample(as_read(without(made, "vel")), t)
    off = np.linalg.norm(earth.difference_n(straight.lla[inside], truth.lla[::10][inside]), axis=1)
    assert off.max() == pytest.approx(25 * 0.3 * 0.2**2 / 8, rel=0.02)
    assert_allclose(found.cov[inside], np.tile(np.eye(9), (inside.sum(), 1, 1)))


def test_between_rows_on_both_sides_of_the_date_line_the_way_is_the_short_one(tmp_path):
    """Straight without velocities; at rest at both rows the cubic is 3 s^2 - 2 s^3, s = 0.25: 0.15625."""
    level = np.zeros(3)
    place = {"t_s": np.arange(3.0), "lat_deg": level + 50.0, "lon_deg": [179.9997, 179.9999, -179.9998]}
    still = dict.fromkeys(("vel_n_mps", "vel_e_mps", "vel_d_mps"), level)
    for more, share in (({}, 0.25), (still, 0.15625)):
        path = table(tmp_path / "x.csv", **place, alt_m=level + 700.0, **more)
        found = resample(read_solution(path), np.array([0.25, 1.25, 1.75]))
        east = 1e-4 * np.array([2 * share, 2 + 3 * share, 5 - 3 * share])  # [deg]
        off = np.rad2deg(found.lla[:, 1]) - 179.9997 - east
        assert_allclose((off + 180.0) % 360.0 - 180.0, 0.0, atol=1e-11)


def test_rows_of_a_program_are_carried_on_and_owe_nothing_to_the_next():
    """Between two rows the first counts, moved by its velocity; the later one may be anything."""
    truth = turning(20.0, 100.0)
    made = wrong_solution(truth, every=20)  # five a second
    t = truth.t[::5]
    found = carry_rows(as_read(made), t, 0.4)
    age = np.arange(len(t)) % 4 * 0.05
    turned = 0.3 * age  # 25 m/s, 0.3 rad/s: the tangent leaves the circle
    expected = 25 / 0.3 * np.hypot(turned - np.sin(turned), 1 - np.cos(turned))
    off = np.linalg.norm(earth.difference_n(found.lla, truth.lla[::5]), axis=1)
    assert_allclose(off, expected, atol=1e-4)
    assert_array_equal(found.vel_n, made.vel_n[np.arange(len(t)) // 4])
    assert_array_equal(found.cov, made.cov[np.arange(len(t)) // 4])
    for k in (7, 30):
        late = (np.arange(len(made)) >= k)[:, None]
        ahead = replace(made, lla=made.lla + 1e-5 * late, q_nb=np.where(late, -made.q_nb, made.q_nb))
        before = t < made.t[k] - 1e-9
        for name in ("lla", "q_nb"):
            moved = getattr(carry_rows(as_read(ahead), t, 0.4), name)
            assert_array_equal(moved[before], getattr(found, name)[before])
    ((_, _, told),) = found.events.select("carried_on")
    assert told == "300 of 401 epochs lie between rows, up to 0.15 s after the one before"
    ended = carry_rows(as_read(taken(made, made.t < 10.1)), t, 0.4)
    assert_array_equal(np.isfinite(ended.lla).all(axis=1), t < 10.4 + 1e-6)
    own = carry_rows(as_read(replace(made, t=made.t - 0.01)), t)  # each counts once, at the epoch after it
    assert_array_equal(np.isfinite(own.lla).all(axis=1), age == 0.0)


def as_read(made: NavSolution):
    from bench.evaluation.errors.resampling import ForeignSolution

    rows = np.arange(1, len(made) + 1)
    columns_ = (made.t, made.lla, made.vel_n, made.q_nb, made.gyro_bias_b, made.accel_bias_b, made.cov)
    return ForeignSolution("made.csv", rows, *columns_, ())


def test_a_gap_is_not_bridged_unless_told_and_its_drift_is_that_of_the_last_answer_carried_on(
    run, tmp_path, capsys
):
    folder, truth, sensed = run
    made = wrong_solution(truth, pos_n=[1.0, 0.0, 0.0])
    keep = (made.t < 12.45) | (made.t > 15.75)
    path = written(tmp_path / "gap.csv", taken(made, keep))
    measured, said = judged(capsys, str(path), str(folder))
    asked = sensed.data.output_t  # 10 Hz, and 13.99 s, the last epoch of the outage
    lost = int(np.sum((asked > 12.45) & (asked < 15.75)))
    assert (len(asked), lost) == (202, 34)
    assert measured["output_coverage_all"] == pytest.approx(1 - lost / 202)
    assert measured["output_coverage"] == pytest.approx(1 - lost / 152)  # from 5 s on
    assert measured["verdict"] == "incomplete"
    assert "answers 83.1 % of the epochs asked for, with the longest silence" in " ".join(said.split())
    assert LOST == (12.0, 14.0)
    first, last = (int(np.argmin(np.abs(truth.t - at))) for at in (12.4, 13.99))
    passed = truth.t[last] - truth.t[first]  # the last answer goes on straight from 1 m north
    ended = earth.difference_n(truth.lla[first], truth.lla[last]) + truth.vel_n[first] * passed
    assert measured["outage_1_drift_h_m"] == pytest.approx(np.hypot(ended[0] + 1.0, ended[1]), rel=1e-3)
    assert f"covers {100 * (1 - lost / 202):.4g} % of the 202 epochs" in said
    bridged, _ = judged(capsys, str(path), str(folder), "--max-gap", "4")
    assert bridged["output_coverage"] == 1.0
    assert "outage_1_drift_h_m" in bridged


def taken(solution: NavSolution, keep) -> NavSolution:
    names = ("t", "lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov", "extra", "extra_sd")
    return replace(solution, **{name: getattr(solution, name)[keep] for name in names})


def test_rows_that_are_no_numbers_are_not_covered(run, tmp_path, capsys):
    folder, truth, _ = run
    made = wrong_solution(truth)
    lla = made.lla.copy()
    lla[:30, 1] = np.nan
    lla[100] = np.inf
    measured, said = judged(capsys, str(written(tmp_path / "nan.csv", replace(made, lla=lla))), str(folder))
    assert measured["output_coverage_all"] == pytest.approx(
        172 / 202
    )  # the hole of one row is 0.2 s: bridged
    assert "31 of 201 rows left out: a value is not finite" in said


def test_a_solution_of_another_time_has_no_metrics_and_says_why(run, tmp_path, capsys):
    folder, truth, _ = run
    made = wrong_solution(truth)
    path = written(tmp_path / "late.csv", replace(made, t=made.t + 100.0))
    measured, said = judged(capsys, str(path), str(folder))
    assert measured["converged"] is False
    assert measured["reason"] == "failed: late.csv covers 100 to 120 s, nothing of the run, 0 to 20 s"
    assert measured.get("pos_rmse_h_m") is None
    assert "✗ late  late.csv covers 100 to 120 s" in said


def test_the_faults_of_the_run_are_those_of_its_profile(run, tmp_path, capsys):
    profile = config.read_profile("gnss-faults")
    assert (
        fault_tables.read_faults(json.loads(json.dumps(profile.document["fault"]))) == profile.sensors.faults
    )
    folder, truth, _ = run
    faulty = tmp_path / "faulty"
    shutil.copytree(folder, faulty)
    summary = json.loads((faulty / "result.json").read_text())
    summary["profile"]["fault"] = [{"kind": "baro-step", "start_s": 8.0, "duration_s": 4.0, "step_m": 20.0}]
    (faulty / "result.json").write_text(json.dumps(summary))
    measured, _ = judged(
        capsys, str(written(tmp_path / "x.csv", wrong_solution(truth, pos_n=[3.0, 0, 0]))), str(faulty)
    )
    assert measured["fault_1_max_h_m"] == pytest.approx(3.0, rel=1e-6)


# --- the results folder -------------------------------------------------------------------------------


def test_the_solution_is_added_to_a_copy_of_the_run(run, tmp_path, capsys):
    folder, truth, _ = run
    path = written(tmp_path / "mine.csv", wrong_solution(truth, pos_n=[5.0, 0.0, 0.0]))
    out = tmp_path / "both"
    judged(capsys, str(path), str(folder), "-o", str(out), "--label", "his")
    both = results.read_result(out)
    assert list(both.metrics) == ["made", "his"]
    assert both.metrics["his"]["pos_rmse_h_m"] == pytest.approx(5.0, rel=1e-6)
    assert both.errors["his"].pos_n[:, 0].mean() == pytest.approx(5.0, rel=1e-6)
    assert list(results.read_result(folder).metrics) == ["made"]
    assert main(["score", str(path), str(folder), "-o", str(out), "--label", "his"]) == 2
    assert "exists; --force" in capsys.readouterr().err
    assert main(["score", str(path), str(out), "--label", "his"]) == 2
    assert "has a solution 'his' already" in capsys.readouterr().err


# --- what is wrong with a file ------------------------------------------------------------------------

GOOD = "t_s,lat_deg,lon_deg,alt_m\n"
SD = GOOD[:-1] + ",sd_{0}_n_{1},sd_{0}_e_{1},sd_{0}_d_{1}\n"
FAR = "t_s,lat_deg,lon_deg,alt_m\n0,0.82,0.19,1200\n1,0.82,0.19,1200\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no columns for time: t_s or time_s; there are none"),
        (GOOD, "no rows"),
        (GOOD[:-1], "his.csv: no rows"),
        ("t_s,lat_deg\n0,47\n", "lat without lon, alt"),
        ("t_s\n0\n", "it has no values of position, velocity or attitude"),
        ("t_s,lat_m,lon_deg,alt_m\n0,1,2,3\n", "column 'lat_m' must end in its unit: lat_deg"),
        (GOOD + "0,47,11,1200\n1,forty,11,1200\n", "row 2: lat_deg = 'forty' is not a number"),
        (GOOD + "0,47,11,1200\n1,47,11\n", "row 2: 3 columns, the header has 4"),
        (GOOD + "0,47,11,1200\n0,47,11,1200\n", "row 2: t_s = 0 is not after 0"),
        (GOOD + "0,47,11,1200\nnan,47,11,1200\n", "row 2: t_s is not a finite number"),
        (GOOD + "0,47,11,1200\n1,97,11,1200\n", "row 2: lat_deg = 97 is outside -90 to 90"),
        (GOOD + "0,nan,11,1200\n1,47,nan,1200\n", "row has a finite number in every column"),
        (FAR, "row 1: 5078 km from the start of the run: a solution of another flight, or"),
        ("t_s,q_nb_w,q_nb_x,q_nb_y,q_nb_z\n0,1,0,0,0\n1,1,1,0,0\n", "row 2: the quaternion has the norm"),
        ("t_s,q_eb_w,q_eb_x,q_eb_y,q_eb_z\n0,1,0,0,0\n", "q_eb needs a position column to find north"),
        ("t_s,ecef_x_km,ecef_y_km,ecef_z_km\n0,1,2,3\n", "row 1: ecef position is 3.74"),
        (SD.format("pos", "m") + "0,47,11,1200,1,-1,1\n", "row 1: a standard deviation sd_pos_*"),
        (SD.format("vel", "mps") + "0,47,11,1200,1,1,1\n", "standard deviations or covariances of velocity"),
        (GOOD[:-1] + ",cov_pos_n_pos_n\n0,47,11,1200,1\n", "cov_pos_n_pos_n without cov_pos_e_pos_e"),
        ("t_s,lat_deg,lat_rad,lon_deg,alt_m\n0,1,2,3,4\n", "'lat_deg' and 'lat_rad' are the same quantity"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_one_line_with_the_row(run, tmp_path, capsys, text, said):
    path = tmp_path / "his.csv"
    path.write_text(text)
    status = main(["score", str(path), str(run[0])])
    out, err = capsys.readouterr()
    assert (status, out, err.count("\n")) == (2, "", 1), err
    assert err.startswith("error: his.csv: ")
    assert said in err


@pytest.mark.parametrize("option", [("--t0", "nan"), ("--t0", "-inf"), ("--max-gap", "nan")])
def test_a_number_of_seconds_is_finite(run, tmp_path, capsys, option):
    (tmp_path / "his.csv").write_text(GOOD + "0,47,11,1200\n")
    assert main(["score", str(tmp_path / "his.csv"), str(run[0]), *option]) == 2
    assert capsys.readouterr().err == f"error: {' '.join(option)} must be a number of seconds\n"


def test_a_terminal_obeys_nothing_that_a_file_says(run, tmp_path, capsys):
    (tmp_path / "his.csv").write_bytes(b"\x1b]0;mine\x07x,y\n1,2\n")
    assert main(["score", str(tmp_path / "his.csv"), str(run[0])]) == 2
    err = capsys.readouterr().err
    assert "?]0;mine?x, y" in err
    assert "\x1b" not in err


def test_what_is_no_file_or_no_table_is_one_line(run, tmp_path, capsys):
    fifo = tmp_path / "pipe.csv"
    os.mkfifo(fifo)
    (tmp_path / "noise.csv").write_bytes(np.random.default_rng(1).bytes(5000))
    (tmp_path / "noise.parquet").write_bytes(b"PAR1" + bytes(500))
    (tmp_path / "noise.mat").write_bytes(b"MATLAB 5.0" + bytes(500))
    (tmp_path / "long.csv").write_text("t_s,lat_deg,lon_deg,alt_m\n" + "9" * 5_000_000)
    with (tmp_path / "huge.csv").open("wb") as file:
        file.truncate(3_000_000_000)  # a hole: it needs no room
    for name in (
        "pipe.csv",
        "noise.csv",
        "noise.parquet",
        "noise.mat",
        "long.csv",
        "huge.csv",
        "none.csv",
        ".",
    ):
        status = main(["score", str(tmp_path / name), str(run[0]), "--label", "his"])
        out, err = capsys.readouterr()
        assert (status, out, err.count("\n")) == (2, "", 1), (name, err)


def test_a_run_before_the_solution_is_told_the_order(run, tmp_path, capsys):
    (tmp_path / "his.csv").write_text("t_s\n0\n")
    assert main(["score", str(run[0]), str(tmp_path / "his.csv")]) == 2
    assert "his.csv is a file and " in (said := capsys.readouterr().err)
    assert "the solution comes first, then the run" in said


def test_a_huge_table_is_refused_in_bounded_memory(tmp_path):
    path = tmp_path / "huge.csv"
    with path.open("w") as file:
        file.write("t_s,lat_deg,lon_deg,alt_m\n")
        for k in range(0, 3_200_000, 100_000):
            file.write("".join(f"{n},47,11,1\n" for n in range(k, k + 100_000)))
    code = (
        "import resource, sys; from pathlib import Path\n"
        "from bench.io.foreign.solutions import read_solution\n"
        "from bench.core.words.exceptions import ConfigError\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        f"try: read_solution(Path({str(path)!r}))\n"
        "except ConfigError as error: print(error)\n"
        "print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)"
    )
    said, grown = subprocess.check_output([sys.executable, "-c", code], text=True).splitlines()
    assert said == "huge.csv: more than 3000000 rows"
    assert int(grown) < 300  # [MB]; its columns are 96 MB
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss > 0


def test_a_covariance_that_is_not_symmetric_is_refused(run, tmp_path):
    made = wrong_solution(run[1])
    cov = made.cov.copy()
    cov[7, 0, 4] = 0.1
    with pytest.raises(ConfigError, match=r"row 8: cov_pos_n_vel_e and cov_vel_e_pos_n differ"):
        read_solution(written(tmp_path / "x.csv", replace(made, cov=cov)))


def test_a_file_in_the_place_of_an_estimator(run, tmp_path):
    _, truth, sensed = run
    path = written(tmp_path / "mine.csv", wrong_solution(truth, pos_n=[2.0, 0.0, 0.0]))
    solution = FileEstimator(path).run(sensed.data, sensed.initial)
    assert_array_equal(solution.t, sensed.data.output_t)
    _, measured = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(5.0), outages=[LOST])
    assert measured["pos_rmse_h_m"] == pytest.approx(2.0, rel=1e-6)


def test_the_files_of_kf_gins_are_a_solution(tmp_path):
    """Columns and units of src/kf_gins.cpp of KF-GINS, its standard deviations beside it."""
    t = 345_618.0 + 0.5 * np.arange(5)
    nav = np.column_stack(
        [
            0 * t,
            t,
            47.0 + 0 * t,
            11.0 + 0 * t,
            600.0 + t - t[0],
            *np.ones((3, 5)),
            0 * t,
            2.0 + 0 * t,
            350.0 + 0 * t,
        ]
    )
    np.savetxt(tmp_path / "KF_GINS_Navresult.nav", nav)
    std = np.column_stack(
        [t, *np.full((3, 5), 0.2), *np.full((3, 5), 0.03), *np.full((3, 5), 0.5), *np.ones((12, 5))]
    )
    np.savetxt(tmp_path / "KF_GINS_STD.txt", std)
    found = read_solution(tmp_path / "KF_GINS_Navresult.nav", t_0=345_618.0)
    assert_allclose(found.t, t - t[0])
    assert_allclose(found.lla[2], [np.deg2rad(47.0), np.deg2rad(11.0), 601.0])
    assert_allclose(np.rad2deg(np.stack(rotation.to_euler(found.q_nb)))[:, 0], [0.0, 2.0, 350.0], atol=1e-9)
    assert_allclose(np.sqrt(np.diag(found.cov[0])), [0.2] * 3 + [0.03] * 3 + [np.deg2rad(0.5)] * 3)
    np.savetxt(tmp_path / "KF_GINS_STD.txt", std[1:])
    with pytest.raises(ConfigError, match="the times of KF_GINS"):
        read_solution(tmp_path / "KF_GINS_Navresult.nav")
