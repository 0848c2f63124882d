"""A recording says what the run said: columns come back equal, the attitude survives the change of
quaternion order, the file is sound for rerun itself, and a failed write leaves nothing behind."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.files import durable
from bench.core.mathematics import earth, rotation
from bench.core.records.data import (
    AirData,
    Controls,
    Events,
    GnssFixes,
    ImuData,
    InitialState,
    Innovations,
    NavSolution,
    SensorData,
    Trajectory,
    no_events,
    no_innovations,
)
from bench.core.records.findings import series
from bench.core.records.instruments import AirspeedData, BaroData, BaroSpec, MagData
from bench.core.records.run_records import ErrorSeries, OffPath, Sensed, SensorTruth
from bench.core.records.run_result import RunResult
from bench.core.records.sensor_specs import AssumedSpecs, GnssSpec, ImuSpec, TriadSpec
from bench.core.records.specs import IN_FLIGHT
from bench.evaluation.consistency.verdict import add_verdict
from bench.evaluation.errors.error_series import error_series
from bench.io import results
from bench.views import recording
from bench.views.plots.tabs import comparison
from bench.views.recording import drawing, layout, recording_text

ORIGIN = np.array([np.deg2rad(47.26), np.deg2rad(11.34), 1200.0])
SCALARS = "Scalars:scalars"
NAMES = tuple(f"gyro_bias_{axis}_rad_s" for axis in "xyz")
NAMES += (*(f"accel_bias_{axis}_m_s2" for axis in "xyz"), "baro_bias_m")
MAIN = "loose 15/a"  # rerun reserves the blank and the slash in entity paths


def figure_eight(duration: float, rate: float) -> Trajectory:
    """Circles to the right and to the left in turn, 28 m/s, slowly climbing."""
    t = np.arange(round(duration * rate) + 1) / rate
    turn = 0.12 * np.tanh(3.0 * np.sin(2 * np.pi * t / 104.7))
    heading = 0.6 + np.concatenate([[0.0], np.cumsum(turn[1:])]) / rate
    vel_n = np.column_stack([28 * np.cos(heading), 28 * np.sin(heading), -0.3 + 0 * t])
    pos_n = np.vstack([np.zeros(3), np.cumsum(vel_n[1:], axis=0)]) / rate
    coarse = t[:: max(1, round(rate / 20))]
    one = np.ones(len(coarse))
    air = AirData(
        t=coarse,
        pressure=87700.0 * one,
        temperature=280.0 * one,
        airspeed_true=28.0 + 0.5 * np.sin(coarse / 7),
        airspeed_calibrated=26.0 + 0.5 * np.sin(coarse / 7),
        alpha=0.05 + 0.01 * np.sin(coarse / 5),
        beta=0.01 * np.sin(coarse / 3),
        wind_n=np.column_stack([3.0 * one, 1.0 * one, 0.0 * one]),
        engine_speed=500.0 + 10 * np.sin(coarse / 9),
    )
    controls = Controls(
        coarse, 0.1 * np.sin(coarse / 20), 0.05 * one, 0.01 * np.sin(coarse / 8), 0.6 + 0.05 * np.sin(coarse)
    )
    legs = [
        (0.0, min(30.0, duration), "leg", "straight 30 s"),
        (30.0, duration, "leg", "figure-eight, 25 deg"),
    ]
    return Trajectory(
        t=t,
        lla=earth.displace(ORIGIN, pos_n),
        vel_n=vel_n,
        q_nb=rotation.continuous(rotation.from_euler(np.arctan(28 * turn / 9.8), 0.05 + 0 * t, heading)),
        dtheta_b=np.zeros((len(t) - 1, 3)),
        dvel_b=np.zeros((len(t) - 1, 3)),
        air=air,
        controls=controls,
        events=Events.from_rows(legs[: 1 if duration <= 30 else 2]),
    )


def sense(truth: Trajectory, outage: tuple[float, float], specs: AssumedSpecs) -> Sensed:
    rng = np.random.default_rng(1)
    end = truth.t[-1]
    second = np.arange(1.0, end + 1e-9)
    second = second[(second < outage[0]) | (second >= outage[1])]
    rows = np.searchsorted(truth.t, second - 1e-9)
    n = len(second)
    fixes = GnssFixes(
        t=second,
        t_arrival=second,
        valid=np.ones(n, bool),
        lla=earth.displace(truth.lla[rows], rng.normal(size=(n, 3)) * [1.5, 1.5, 3.0]),
        vel_n=truth.vel_n[rows] + 0.05 * rng.normal(size=(n, 3)),
        cov_pos_n=np.tile(np.diag([2.25, 2.25, 9.0]), (n, 1, 1)),
        cov_vel_n=np.tile(0.0025 * np.eye(3), (n, 1, 1)),
        satellites=np.full(n, 9),
    )
    tenth = np.arange(0.1, end + 1e-9, 0.1)
    m = len(tenth)
    alt = np.interp(tenth, truth.t, truth.lla[:, 2])
    slow = np.arange(0.0, end + 1e-9, 0.05)
    return Sensed(
        data=SensorData(
            imu=ImuData(
                truth.t[1:], np.diff(truth.t), np.ones(len(truth) - 1, bool), truth.dtheta_b, truth.dvel_b
            ),
            fixes=fixes,
            baro=BaroData(tenth, tenth, np.ones(m, bool), alt + 2 + rng.normal(size=m), np.ones(m)),
            antenna_b=np.zeros(3),
            specs=specs,
            output_t=tenth,
        ),
        initial=InitialState(0.0, truth.lla[0], truth.vel_n[0], truth.q_nb[0], np.eye(9), "given"),
        truth=SensorTruth(
            slow,
            gyro_bias_b=1e-4 * np.array([1.0, -0.7, 0.4])
            + 2e-6 * rng.normal(size=(len(slow), 3)).cumsum(axis=0),
            accel_bias_b=1e-2 * np.array([1.0, 0.5, -1.2])
            + 1e-4 * rng.normal(size=(len(slow), 3)).cumsum(axis=0),
            bias={"baro": 2.0 + 0.01 * rng.normal(size=(len(slow), 1)).cumsum(axis=0)},
        ),
        events=Events.from_rows([(*outage, "gnss_outage", "GNSS outage")]),
    )


def smooth(rng: np.random.Generator, n: int, columns: int, over: int = 100) -> np.ndarray:
    """Noise of unit size that changes slowly."""
    noise = rng.normal(size=(n + 5 * over, columns))
    kernel = np.exp(-np.arange(5 * over) / over)
    return np.stack([np.convolve(c, kernel, "valid")[:n] for c in noise.T], axis=1) / np.sqrt(over / 2)


def estimate(truth: Trajectory, sensed: Sensed, outage: tuple[float, float]) -> NavSolution:
    """A filter's answer: wrong by about one sigma, which grows while GNSS is lost."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, truth.t[-1] + 1e-9, 0.1)
    rows = np.searchsorted(truth.t, t - 1e-9)
    n = len(t)
    lost = np.clip(t - outage[0], 0.0, None) * (t < outage[1])
    grow = (
        1
        + 3 * np.exp(-t / 15)[:, None]
        + np.column_stack([lost**2 / 100] * 3 + [lost / 5] * 3 + [lost / 60] * 3)
    )
    sd = grow * [0.8, 0.8, 0.9, 0.06, 0.06, 0.04, 2e-3, 2e-3, 8e-3]
    error = sd * smooth(rng, n, 9)
    k = np.searchsorted(sensed.truth.t, t + 1e-9) - 1
    settle = np.exp(-t / 60)[:, None]
    gyro_sd, accel_sd = 2e-5 + 1e-4 * settle + np.zeros(3), 2e-3 + 1e-2 * settle + np.zeros(3)
    fixes, baro = sensed.data.fixes, sensed.data.baro
    parts = []
    for code, (times, width, variance) in enumerate(
        [(fixes.t, 3, [2.9, 2.9, 9.8]), (fixes.t, 3, [0.006, 0.006, 0.004]), (baro.t, 1, [1.8])]
    ):
        z = rng.normal(size=(len(times), width)) * np.sqrt(variance)
        z[len(z) // 3] *= 6  # one that the gate rejects
        nis = np.sum(z**2 / variance, axis=1)
        ones = np.ones((1, width))
        parts.append(
            [
                times[:, None] * ones,
                np.full(z.shape, code),
                np.arange(width) + np.zeros(z.shape),
                z,
                variance + np.zeros(z.shape),
                nis[:, None] * ones,
                (nis < 20)[:, None] & (ones > 0),
            ]
        )
    columns = [np.concatenate([part[i].ravel() for part in parts]) for i in range(7)]
    order = np.lexsort([columns[2], columns[1], columns[0]])
    t_z, code, component, z, S, nis, accepted = (c[order] for c in columns)
    return NavSolution(
        t=t,
        lla=earth.displace(truth.lla[rows], error[:, :3]),
        vel_n=truth.vel_n[rows] + error[:, 3:6],
        q_nb=rotation.multiply(rotation.from_rotvec(error[:, 6:]), truth.q_nb[rows]),
        gyro_bias_b=sensed.truth.gyro_bias_b[k] + gyro_sd * smooth(rng, n, 3),
        accel_bias_b=sensed.truth.accel_bias_b[k] + accel_sd * smooth(rng, n, 3),
        cov=np.einsum("ki,ij->kij", sd**2, np.eye(9)),
        extra_names=NAMES,
        extra=np.zeros((n, 7)) + 2.1,
        extra_sd=np.hstack([gyro_sd, accel_sd, 0.4 + 0 * t[:, None]]),
        innovations=Innovations(
            t_z, ("gnss_position", "gnss_velocity", "baro"), code, component, z, S, nis, accepted
        ),
        events=Events.from_rows(
            [(float(t[n // 2]), float(t[n // 2]), "timeline", "1 row of GNSS arrived late")]
        ),
    )


def drift(truth: Trajectory) -> NavSolution:
    """A free-inertial answer: kilometers off in the end, no updates, no biases."""
    t = np.arange(0.0, truth.t[-1] + 1e-9, 0.1)
    rows = np.searchsorted(truth.t, t - 1e-9)
    n = len(t)
    error = t[:, None] ** 2 * [0.02, -0.012, 0.004]
    sd = np.column_stack([1 + 0.01 * t**2] * 3 + [0.1 + 0.02 * t] * 3 + [0.01 + 1e-4 * t] * 3)
    nan = np.full((n, 3), np.nan)
    return NavSolution(
        t=t,
        lla=earth.displace(truth.lla[rows], error),
        vel_n=truth.vel_n[rows] + t[:, None] * [0.04, -0.024, 0.008],
        q_nb=rotation.multiply(rotation.from_rotvec(t[:, None] * [5e-5, 3e-5, -9e-5]), truth.q_nb[rows]),
        gyro_bias_b=nan,
        accel_bias_b=nan,
        cov=np.einsum("ki,ij->kij", sd**2, np.eye(9)),
        extra_names=(),
        extra=np.empty((n, 0)),
        extra_sd=np.empty((n, 0)),
        innovations=no_innovations(),
        events=no_events(),
    )


def make_run(duration: float, rate: float, outage: tuple[float, float]) -> dict:
    """The parts of a result."""
    imu = ImuSpec("demo-imu", TriadSpec(), TriadSpec())
    gnss, baro = GnssSpec("demo-gnss", 1.0, 1.5, 3.0, 0.05), BaroSpec("demo-baro", 10.0, 1.0, 5.0, 0.01)
    specs = AssumedSpecs(imu, gnss, baro=baro)
    profile = {
        "title": "Figure-eight with a GNSS outage",
        "aircraft": "aerosonde",
        "sensors": {"imu": "demo-imu", "gnss": "demo-gnss", "baro": "demo-baro"},
        "evaluation": {"from_s": min(60.0, duration / 2), "output_hz": 10.0},
    }
    truth = figure_eight(duration, rate)
    sensed = sense(truth, outage, specs)
    solutions = {MAIN: estimate(truth, sensed, outage), "free-inertial": drift(truth)}
    errors: dict[str, ErrorSeries] = {label: error_series(truth, s) for label, s in solutions.items()}
    metrics = {
        MAIN: {"converged": True, "reason": None, "pos_rmse_h_m": 1.234567, "pos_rmse_h_m_all": 9.0}
        | {
            "heading_rmse_deg": 0.41,
            "nees_mean": 9.3,
            "unmodeled_errors": ["gyro scale factor", "GNSS Markov errors"],
        },
        "free-inertial": {
            "converged": True,
            "reason": None,
            "pos_rmse_h_m": 1900.0,
            "heading_rmse_deg": None,
        },
    }
    return {
        "profile": profile,
        "truth": truth,
        "sensed": sensed,
        "solutions": solutions,
        "errors": errors,
        "metrics": metrics,
    }


def write(path: Path, **run) -> None:
    recording.write(path, "demo", make_result(run))


def make_result(run: dict) -> RunResult:
    return RunResult(
        profile=run["profile"],
        seed=7,
        run=0,
        metrics=run["metrics"],
        errors=run["errors"],
        solutions=run["solutions"],
        provenance={"profile": "demo"},
        more={"scene": {"mesh": "uav", "antenna_mask_deg": None}},
        records={"truth": run["truth"], "sensed": run["sensed"]},
    )


@pytest.fixture(scope="module")
def run() -> dict:
    return make_run(40.0, 200.0, (20.0, 26.0))


@pytest.fixture(scope="module")
def flight(run, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "flight.rrd"
    write(path, **run)
    return path


def rerun(*arguments: object) -> subprocess.CompletedProcess:
    """Run the tool of the wheel itself, without its Python launcher."""
    import rerun_cli

    tool = Path(rerun_cli.__file__).parent / "rerun"
    return subprocess.run([tool, "rrd", *map(str, arguments)], capture_output=True, text=True, timeout=60)


def static_batches(path: Path):
    from rerun.chunk import RrdReader

    return {c.entity_path: c.to_record_batch() for c in RrdReader(path).stream() if c.is_static}


def entity_of(label: str, *parts: str) -> str:
    return "/".join(["", "estimators", label.replace(" ", "\\ ").replace("/", "\\/"), *parts])


# --- the file is sound ----------------------------------------------------------------------------------


def test_rerun_verifies_the_file_and_refuses_a_cut_one(flight, tmp_path):
    assert rerun("verify", flight).returncode == 0
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(flight.read_bytes()[:-2000])
    assert rerun("verify", cut).returncode != 0


def test_the_same_run_compares_equal_and_another_does_not(run, flight, tmp_path):
    again, other = tmp_path / "again.rrd", tmp_path / "other.rrd"
    write(again, **run)
    assert rerun("compare", flight, again).returncode == 0
    error = run["errors"][MAIN]
    moved = ErrorSeries(
        error.t, error.pos_n + 1e-9, error.vel_n, error.phi_n, error.heading, error.nees, error.states
    )
    write(other, **{**run, "errors": {**run["errors"], MAIN: moved}})
    assert rerun("compare", flight, other).returncode != 0


def test_ten_minutes_stay_below_fifteen_megabytes(tmp_path):
    write(tmp_path / "long.rrd", **make_run(600.0, 200.0, (330.0, 390.0)))
    assert (tmp_path / "long.rrd").stat().st_size < 15e6


def test_ten_hours_stay_below_thirty_megabytes_and_keep_a_spike(tmp_path):
    run = make_run(36_000.0, 4.0, (330.0, 390.0))
    error = run["errors"][MAIN]
    pos_n = error.pos_n.copy()
    pos_n[77_777, 0] = 1234.5
    run["errors"] = {**run["errors"], MAIN: replace(error, pos_n=pos_n)}
    write(tmp_path / "long.rrd", **run)
    assert (tmp_path / "long.rrd").stat().st_size < 30e6
    path = entity_of(MAIN, "position", "north", "error")
    t, shown = recording.column(tmp_path / "long.rrd", path, SCALARS)
    assert len(t) <= series.LONG_POINTS + 2
    assert t[[0, -1]] == pytest.approx(error.t[[0, -1]])
    assert shown[:, 0].max() == 1234.5
    assert t[shown[:, 0].argmax()] == pytest.approx(error.t[77_777])


def test_a_gap_stays_in_a_long_series():
    t = np.arange(200_000.0)
    values = np.sin(1e-3 * t)[:, None]
    values[60_000:60_010] = np.nan
    shown = series.draw_line("x", t, values[:, 0], "x", (0, 0, 0), most=np.inf)
    assert len(shown.t) <= series.LONG_POINTS + 3
    assert np.isnan(shown.values).any()


def test_a_gap_stays_in_a_series_that_is_thinned():
    """Ten answers a second, none for 40 s; two a second are drawn."""
    t = np.append(np.arange(0.0, 20.0, 0.1), np.arange(60.3, 90.0, 0.1))
    line = series.draw_three_sigma("x", t, t, 0.0 * t + 1.0, "x", (0, 0, 0), most=series.DRIFTING)
    rows = series.select_rows(line)
    assert len(rows) < 0.4 * len(t)
    (lost,) = rows[np.isnan(line.values[rows]).all(axis=1)]
    assert 20.0 < line.t[lost] < 60.0


def test_several_values_of_one_instant_are_no_gap():
    """Ranges to six satellites each second, and none from 20 to 40 s."""
    t = np.repeat(np.append(np.arange(20.0), np.arange(40.0, 60.0)), 6)
    assert series.find_gaps(t).tolist() == [6 * 20]
    assert not len(series.find_gaps(np.repeat([1.0, 9.0], 6)))


def test_a_stretch_of_slower_rows_is_no_row_of_gaps():
    """100 Hz, then 2 Hz for half a minute, where 12 s are missing, then 100 Hz; a gap at each end, too."""
    slow = np.append(np.arange(21.0, 35.0, 0.5), np.arange(46.5, 50.0, 0.5))
    t = np.concatenate([[0.0], np.arange(5.0, 20.0, 0.01), slow, np.arange(50.0, 60.0, 0.01), [65.0]])
    gaps = series.find_gaps(t)
    assert t[gaps - 1].tolist() == [0.0, 34.5, pytest.approx(59.99)]


def test_verdicts_stand_beside_the_comparison(run):
    table = recording_text.make_verdict_table(make_result(run)).splitlines()
    assert table[2] == f"| {MAIN} |  | 1.235 | - | 9.3 |"
    assert len(table) == 4


def test_a_failed_write_leaves_the_folder_as_it_was(run, tmp_path, monkeypatch):
    import rerun as rr

    path = tmp_path / "flight.rrd"
    path.write_bytes(b"the one before")

    def full(action, path):
        if action == "sync":
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(durable, "before", full)
        with pytest.raises(OSError, match="No space left"):
            write(path, **run)
    with monkeypatch.context() as patch:
        patch.setattr(recording.drawing, "send", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write(path, **run)
    assert [p.name for p in tmp_path.iterdir()] == ["flight.rrd"]
    assert path.read_bytes() == b"the one before"
    assert not rr.strict_mode()  # the setting is global to the process: it is put back


def test_rerun_may_not_drop_data_silently(run, tmp_path, monkeypatch):
    send = recording.drawing.send_scalars
    monkeypatch.setattr(
        recording.drawing, "send_scalars", lambda stream, entity, t, v: send(stream, entity, t[:-1], v)
    )
    with pytest.raises(ValueError, match="length"):
        write(tmp_path / "flight.rrd", **run)


# --- what it says is what the run said -------------------------------------------------------------------


@pytest.mark.parametrize("label", [MAIN, "free-inertial"])
def test_errors_and_their_three_sigma_come_back_equal(run, flight, label):
    error, cov = run["errors"][label], run["solutions"][label].cov
    sd = np.sqrt(np.einsum("kii->ki", cov))
    for what, values, first in (
        ("position", error.pos_n, 0),
        ("velocity", error.vel_n, 3),
        ("attitude", np.rad2deg(error.phi_n), 6),
    ):
        for k, axis in enumerate(("north", "east", "down")):
            t, rows = recording.column(flight, entity_of(label, what, axis, "error"), SCALARS)
            three = 3.0 * (np.rad2deg(sd[:, 6 + k]) if what == "attitude" else sd[:, first + k])
            assert_allclose(t, error.t, rtol=0, atol=1e-9)  # rerun counts nanoseconds
            assert_array_equal(rows, np.column_stack([values[:, k], three, -three]))


def test_biases_come_back_in_the_units_of_a_datasheet(run, flight):
    solution, drawn = run["solutions"][MAIN], run["sensed"].truth
    for k, axis in enumerate("xyz"):
        t, gyro = recording.column(flight, entity_of(MAIN, "bias", f"gyro_bias_{axis}", "estimated"), SCALARS)
        at = np.searchsorted(solution.t, t - 1e-6)
        assert len(at) > 80
        assert_allclose(gyro[:, 0], solution.gyro_bias_b[at, k] * 180 / np.pi * 3600, rtol=1e-12)
        assert_allclose(gyro[:, 1] - gyro[:, 0], 3 * solution.extra_sd[at, k] * 180 / np.pi * 3600, rtol=1e-9)
        t, accel = recording.column(flight, entity_of(MAIN, "bias", f"accel_bias_{axis}", "true"), SCALARS)
        there = np.searchsorted(drawn.t, t - 1e-6)
        assert_allclose(accel[:, 0], drawn.accel_bias_b[there, k] / 9.80665 * 1000, rtol=1e-12)
    _, baro = recording.column(flight, entity_of(MAIN, "bias", "baro_bias", "estimated"), SCALARS)
    assert_allclose(baro, [[2.1, 3.3, 0.9]] * len(at), rtol=1e-12)


def test_every_innovation_is_there_used_or_rejected(run, flight):
    table = run["solutions"][MAIN].innovations
    for code, (sensor, axis, component) in enumerate(
        [("gnss_position", "east", 1), ("gnss_velocity", "down", 2), ("baro", "value", 0)]
    ):
        here = (table.code == code) & (table.component == component)
        for name, rows in (("used", here & table.accepted), ("rejected", here & ~table.accepted)):
            assert rows.any()
            t, z = recording.column(flight, entity_of(MAIN, "innovation", sensor, axis, name), SCALARS)
            assert_allclose(t, table.t[rows], rtol=0, atol=1e-9)
            assert_array_equal(z[:, 0], table.z[rows])
        t, bounds = recording.column(flight, entity_of(MAIN, "innovation", sensor, axis, "bounds"), SCALARS)
        steps = np.diff(table.t[here])
        after = np.flatnonzero(steps > 5 * np.median(steps)) + 1
        assert_array_equal(bounds[:, 0], np.insert(3 * np.sqrt(table.S[here]), after, np.nan))
        assert (len(after) > 0) == (sensor != "baro")  # the gates end where GNSS is lost
        lost, instants = np.isnan(bounds[:, 0]), table.t[here]
        assert_allclose(t[lost], 0.5 * (instants[after - 1] + instants[after]), rtol=0, atol=1e-9)
        _, nis = recording.column(flight, entity_of(MAIN, "nis", sensor, "value"), SCALARS)
        assert_array_equal(nis[:, 0], table.nis[here])


def test_nees_stands_in_the_central_95_percent_of_chi_square(flight, run):
    _, band = recording.column(flight, entity_of(MAIN, "nees", "band"), SCALARS)
    assert_allclose(band[0], [2.70, 19.02], atol=0.005)  # 9 degrees of freedom, tables of chi-square
    _, nees = recording.column(flight, entity_of(MAIN, "nees", "value"), SCALARS)
    assert_array_equal(nees[:, 0], run["errors"][MAIN].nees)


def test_two_estimators_and_more_are_compared_in_one_plot(run, flight, tmp_path):
    """A line each, of the size of the error; a filter alone is compared with nobody."""
    for label, error in run["errors"].items():
        t, found = recording.column(flight, drawing.entity("comparison", "horizontal", label), SCALARS)
        wanted = np.interp(t, error.t, np.hypot(error.pos_n[:, 0], error.pos_n[:, 1]))
        good = np.isfinite(wanted) & np.isfinite(found[:, 0])
        assert good.any()
        np.testing.assert_allclose(found[good, 0], wanted[good], rtol=1e-6, atol=1e-6)
    alone = tmp_path / "alone.rrd"
    write(alone, **only(run, [MAIN]))
    with pytest.raises(KeyError):
        recording.column(alone, drawing.entity("comparison", "horizontal", MAIN), SCALARS)


@pytest.mark.parametrize(
    ("sizes", "top"),
    [((1.0, 2.0, 3.0), 3.0), ((1.0, 2.0, 100.0), 2.0), ((1.0, 100.0), 100.0), ((0.0, 0.0, 5.0), 1.0)],
    ids=["together", "one runs away", "two are both shown", "nothing to see"],
)
def test_a_filter_that_runs_away_does_not_flatten_a_comparison(sizes, top):
    t = np.arange(3.0)
    lines = tuple(
        series.Series(str(k), t, np.full((3, 1), x), ("",), ((0, 0, 0),), (1.0,)) for k, x in enumerate(sizes)
    )
    _, shown = series.Plot(("p",), "p", lines, far=comparison.FAR).limits()
    assert top <= shown <= 1.3 * top
    _, whole = series.Plot(("p",), "p", lines).limits()
    assert whole >= max(sizes)


def test_a_block_that_is_not_estimated_has_no_plot(flight):
    with pytest.raises(KeyError, match="no column"):
        recording.column(flight, entity_of("free-inertial", "bias", "gyro_bias_x", "estimated"), SCALARS)


def test_the_pose_is_the_truth_in_the_level_frame_of_the_start(tmp_path, run):
    """Rows 40 km apart: the level frames differ by 0.4 deg, the quaternion is scalar last in the file."""
    truth = run["truth"]
    far = Trajectory(
        truth.t,
        earth.displace(truth.lla, truth.t[:, None] * [1000.0, 0.0, 0.0]),
        truth.vel_n,
        truth.q_nb,
        truth.dtheta_b,
        truth.dvel_b,
        truth.air,
        truth.controls,
        truth.events,
    )
    path = tmp_path / "far.rrd"
    write(path, **{**run, "truth": far})
    t, pos = recording.column(path, "/world/truth/aircraft", "Transform3D:translation")
    _, xyzw = recording.column(path, "/world/truth/aircraft", "Transform3D:quaternion")
    rows = np.searchsorted(far.t, t - 1e-6)
    assert len(t) <= 50 * 40 + 1
    C_se = earth.matrix_en(far.lla[0, 0], far.lla[0, 1]).T
    expected = (earth.to_ecef(far.lla[rows]) - earth.to_ecef(far.lla[0])) @ C_se.T
    assert_allclose(pos, expected, rtol=0, atol=0.005)  # float32 at 40 km
    x, y, z, w = xyzw[-1]
    C_sb = np.array(  # the definition, scalar last: not by bench.core.mathematics.rotation
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    C_en = earth.matrix_en(far.lla[rows[-1], 0], far.lla[rows[-1], 1])
    C_nb = rotation.matrix(far.q_nb[rows[-1]])
    assert_allclose(C_sb, C_se @ C_en @ C_nb, atol=1e-6)
    assert np.abs(C_sb - C_nb).max() > 1e-3  # it would be seen if the frames were mixed up


@pytest.mark.parametrize("beside", [0.0, 60.0])
def test_a_runway_lies_where_the_flight_is_low_over_it_or_beside_it(beside, run, tmp_path):
    result = make_result(run)
    assert "/world/runway" not in static_batches_of(result, tmp_path)
    to_right = [-np.sin(0.6), np.cos(0.6), 0.0]
    lat, lon, _ = earth.displace(ORIGIN, beside * np.array(to_right))
    place = {
        "lat_deg": np.rad2deg(lat),
        "lon_deg": np.rad2deg(lon),
        "alt_m": 1199.0,
        "heading_deg": np.rad2deg(0.6),
        "width_m": 30.0,
    }
    result.more["scene"]["runway"] = place
    found = static_batches_of(result, tmp_path)
    (outline, middle), *_ = found["/world/runway"].column("LineStrips3D:strips").to_pylist()
    threshold, end = np.array(middle)
    assert_allclose(threshold[:2], beside * np.array(to_right[:2]), atol=1e-3)
    assert threshold[2] == pytest.approx(1.0, abs=1e-3)  # one meter below the start
    length = np.hypot(*(end - threshold)[:2])
    assert_allclose((end - threshold)[:2], length * np.array([np.cos(0.6), np.sin(0.6)]), rtol=1e-4)
    pos = earth.local_ned(run["truth"].lla, ORIGIN)
    ahead, aside = pos[:, :2] @ [np.cos(0.6), np.sin(0.6)], pos[:, :2] @ [-np.sin(0.6), np.cos(0.6)]
    over = (np.abs(aside - beside) < 200.0) & (pos[:, 2] > -14.0)
    assert ahead[over].max() < length + 0.1 < ahead[over].max() + 100.2
    assert np.linalg.norm(np.array(outline[0]) - outline[3]) == pytest.approx(30.0, abs=0.01)
    place["alt_m"] = 600.0  # all of the flight is high above it
    assert "/world/runway" not in static_batches_of(result, tmp_path)


def test_the_desired_path_is_drawn_and_the_errors_along_it_add_up(run, tmp_path):
    """On a path 5 m to the left of the truth for half of the time; it comes back from a folder, too."""
    labels = [IN_FLIGHT, *list(run["solutions"])[1:]]
    what = ("solutions", "errors", "metrics")
    named = {name: dict(zip(labels, run[name].values(), strict=True)) for name in what}
    result = make_result(run | named)
    t, course = result.solutions[IN_FLIGHT].t, 0.7
    right = np.where(t < t.mean(), 5.0, np.nan)
    path = OffPath(t, right, np.full(len(t), np.nan), np.full(len(t), course))
    (tmp_path / "out").mkdir()
    results.save(tmp_path / "out", replace(result, records={**result.records, "path": path}))
    loaded = results.read_result(tmp_path / "out")
    assert_array_equal(loaded.records["path"].right, right)
    found = static_batches_of(loaded, tmp_path)
    (drawn,) = found["/world/desired/0/path"].column("LineStrips3D:strips").to_pylist()[0]
    truth = run["truth"]
    rows = np.searchsorted(truth.t, t[t < t.mean()] - 1e-6)
    to_right = np.array([-np.sin(course), np.cos(course), 0.0])
    ends = earth.local_ned(truth.lla[rows[[0, -1]]], ORIGIN) - 5.0 * to_right
    assert_allclose(np.array(drawn)[[0, -1]], ends, atol=0.01)
    parts = {
        one: recording.column(tmp_path / "flight.rrd", f"/path/across/{one}", "Scalars:scalars")
        for one in ("tse", "fte", "nse")
    }
    values = {one: column[1][:, 0] for one, column in parts.items()}
    on = np.isfinite(values["tse"])
    assert_allclose(values["tse"][on], 5.0)
    assert_allclose((values["fte"] - values["nse"])[on], 5.0)
    errors = result.errors[IN_FLIGHT]
    at = np.searchsorted(errors.t, parts["nse"][0][on] - 1e-6)
    assert_allclose(values["nse"][on], errors.pos_n[at] @ to_right, atol=1e-9)


def static_batches_of(result: RunResult, folder: Path):
    recording.write(folder / "flight.rrd", "demo", result)
    return static_batches(folder / "flight.rrd")


def test_fixes_and_map_hold_what_the_receiver_said(run, flight):
    fixes = run["sensed"].data.fixes
    t, lat_lon = recording.column(flight, "/map/gnss/fixes", "GeoPoints:positions")
    assert_allclose(t, fixes.t, rtol=0, atol=1e-9)
    assert_array_equal(lat_lon, np.rad2deg(fixes.lla[:, :2]))
    _, pos = recording.column(flight, "/world/gnss/fixes", "Points3D:positions")
    assert_allclose(pos, earth.local_ned(fixes.lla, run["truth"].lla[0]), rtol=0, atol=1e-3)


def test_outages_are_hatched_in_every_plot_between_their_ends(run, flight):
    for path in (
        entity_of(MAIN, "position", "north"),
        entity_of("free-inertial", "attitude", "down"),
        entity_of(MAIN, "innovation", "baro", "value"),
        "/flight/altitude",
    ):
        t, y = recording.column(flight, f"{path}/behind/outage", SCALARS)
        drawn = np.isfinite(y[:, 0])
        assert (t[drawn][0], t[drawn][-1]) == (20.0, 26.0)
        assert np.isnan(y[-1, 0])  # the line ends there
    low, high = y[drawn, 0].min(), y[drawn, 0].max()
    alt = run["truth"].lla[:, 2]
    assert low < alt.min()
    assert high > alt.max()


def test_each_estimator_has_one_color_everywhere(flight):
    styles = static_batches(flight)

    def color(entity, component):
        return styles[entity].column(component).to_pylist()[0][0]

    main, other = (
        {
            color(entity_of(label, "position", "north", "error"), "SeriesLines:colors"),
            color(entity_of(label, "velocity", "down", "error"), "SeriesLines:colors"),
            color("/world" + entity_of(label, "path"), "LineStrips3D:colors"),
            color("/map" + entity_of(label, "path"), "GeoLineStrings:colors"),
        }
        for label in (MAIN, "free-inertial")
    )
    assert len(main) == len(other) == 1
    assert main != other


def blueprint_of(path: Path) -> dict[str, dict]:
    """First value of every field of the blueprint, by its entity path."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    (entry,) = reader.blueprints()
    found: dict[str, dict] = {}
    for chunk in reader.stream(store=entry):
        batch = chunk.to_record_batch()
        fields = {n: batch.column(n).to_pylist()[0] for n in batch.schema.names if ":" in n}
        found.setdefault(chunk.entity_path, {}).update({n: v[0] for n, v in fields.items() if v})
    return found


def test_it_opens_paused_on_the_whole_flight(flight):
    nodes = blueprint_of(flight)
    assert nodes["/time_panel"]["TimePanelBlueprint:timeline"] == "flight_time"
    (shared,) = (n["TimeAxis:view_range"] for n in nodes.values() if "TimeAxis:view_range" in n)
    assert nodes[f"/{layout.SHARED_TIME_AXIS}"]["TimeAxis:view_range"] == shared
    assert shared["start"] == 0
    assert 40e9 <= shared["end"] < 42e9
    kinds = [n.get("ViewBlueprint:class_identifier") for n in nodes.values()]
    linked = [n["TimeAxis:link"] for n in nodes.values() if "TimeAxis:link" in n]
    assert linked == [2] * (kinds.count("TimeSeries") + kinds.count("StateTimeline"))  # zoomed together
    assert nodes["/time_panel"]["TimePanelBlueprint:play_state"] == 1  # paused
    past = [n["VisibleTimeRanges:ranges"] for n in nodes.values() if "VisibleTimeRanges:ranges" in n]
    assert past == 2 * [{"timeline": "flight_time", "range": {"start": None, "end": 0}}]


def only(run: dict, labels: list[str], **changes) -> dict:
    """The run with the main filter under each of the labels, and without some sensors."""
    columns = {name: dict.fromkeys(labels, run[name][MAIN]) for name in ("solutions", "errors", "metrics")}
    data = replace(run["sensed"].data, **changes)
    return {**run, **columns, "sensed": replace(run["sensed"], data=data)}


@pytest.mark.parametrize("labels", [[], ["one"], ["a", "b", "c", "d", "e", "f", "g"]])
def test_every_view_has_something_to_show(run, tmp_path, labels):
    from rerun.chunk import RrdReader

    path = tmp_path / "flight.rrd"
    write(path, **only(run, labels))
    logged = {chunk.entity_path for chunk in RrdReader(path).stream()}
    views = [n for n in blueprint_of(path).values() if "ViewBlueprint:space_origin" in n]
    kinds = {n["ViewBlueprint:class_identifier"] for n in views}
    assert kinds == {"3D", "Map", "TimeSeries", "TextDocument", "TextLog", "StateTimeline"}
    for view in views:
        origin = view["ViewBlueprint:space_origin"]
        assert any(path == origin or path.startswith(f"{origin}/") for path in logged), origin
    titles = [n["ViewBlueprint:display_name"] for n in views]
    for label in labels:
        assert ("" if len(labels) > 3 else f"{label}: ") + "north position error [m]" in titles
    assert max(map(len, titles)) < 60


def test_a_magnetometer_and_an_airspeed_unit_are_drawn_when_they_are_on_board(run, flight, tmp_path):
    t = np.arange(0.1, 30.0, 0.1)
    field_b = 1e-6 * np.column_stack([20 + t, 3 - t, 43 + 0 * t])
    mag = MagData(t, t, np.ones(len(t), bool), field_b, np.full(len(t), 1e-7))
    pitot = AirspeedData(t, t, np.ones(len(t), bool), 25 + np.sin(t), np.full(len(t), 0.1))
    path = tmp_path / "both.rrd"
    write(path, **only(run, ["one"], mag=mag, airspeed=pitot))
    for k, axis in enumerate(("forward", "right", "down")):
        shown, drawn = recording.column(path, f"/flight/magnetic_field/{axis}", SCALARS)
        assert_allclose(drawn[:, 0], np.interp(shown, t, 1e6 * field_b[:, k]), rtol=1e-9)
    shown, drawn = recording.column(path, "/flight/speed/airspeed", SCALARS)
    assert_allclose(drawn[:, 0], np.interp(shown, t, pitot.airspeed_true), rtol=1e-9)
    assert len(shown) > 100
    with pytest.raises(KeyError):
        recording.column(flight, "/flight/magnetic_field/down", SCALARS)
    on_board = run["profile"]["sensors"] | {"mag": "demo-mag", "airspeed": "demo-pitot"}
    said = recording_text.make_summary(make_result(run | {"profile": run["profile"] | {"sensors": on_board}}))
    assert "- magnetometer `demo-mag`\n- airspeed unit `demo-pitot`" in said


def test_a_flight_without_gnss_and_barometer_is_recorded_too(run, tmp_path):
    path = tmp_path / "flight.rrd"
    write(path, **only(run, ["one"], fixes=None, baro=None))
    assert rerun("verify", path).returncode == 0
    with pytest.raises(KeyError):
        recording.column(path, "/world/gnss/fixes", "Points3D:positions")


def test_summary_gives_the_numbers_and_what_the_filter_leaves_out(run):
    text = recording_text.make_summary(make_result(run))
    assert "| pos_rmse_h_m | 1.235 | 1900 |" in text
    assert "| heading_rmse_deg | 0.41 | - |" in text
    assert "pos_rmse_h_m_all" not in text
    assert f"not modeled by **{MAIN}**: gyro scale factor, GNSS Markov errors." in text
    assert "GNSS outage 20 to 26 s" in text
    lost = {"converged": False, "reason": "covariance is not finite at t = 3 s", "nees_mean": None}
    found = make_result(run | {"metrics": {"drift": add_verdict("drift", lost)}})
    summary = recording_text.make_summary(found)
    assert "drift diverged: covariance is not finite" in summary


def test_a_hostile_title_is_text(run):
    title = "# [x](http://a) ![i](http://b/c.png) <b>`|*_\u202e\x1b[2J"
    result = make_result({**run, "profile": {**run["profile"], "title": title}})
    first, *_ = recording_text.make_summary(result).splitlines()
    assert first == "# \\# \\[x\\](http://a) \\!\\[i\\](http://b/c.png) \\<b\\>\\`\\|\\*\\_??\\[2J"


def test_events_are_told_in_order_of_time(run, flight):
    from rerun.chunk import RrdReader

    (batch,) = [c.to_record_batch() for c in RrdReader(flight).stream() if c.entity_path == "/events"]
    said = [row[0] for row in batch.column("TextLog:text").to_pylist()]
    assert sorted(said[1:3]) == [
        "GNSS outage (6 s)",
        f"{MAIN}: timeline 1 row of GNSS arrived late",
    ]  # both at 20 s
    assert said[::3] == ["leg straight 30 s (30 s)", "leg figure-eight, 25 deg (10 s)"]


@pytest.mark.parametrize(
    ("low", "high"), [(-8.0, 8.3), (-0.3, 24.0), (1200.0, 1310.0), (5.0, 5.0), (0.0, 0.0), (-3e-7, 1e-7)]
)
def test_limits_hold_all_values_and_waste_little(low, high):
    from bench.core.records.findings.series import Plot, Series

    values = np.array([[99.0 * high + 7.0], [low], [high]])  # the first row lies in the alignment window
    series = Series("value", np.array([0.0, 1.0, 2.0]), values, ("v",), ((0, 0, 0),), (1.0,))
    bottom, top = Plot(("p",), "p", (series,), scale_from=0.5).limits()
    assert bottom < low <= high < top
    assert top - bottom <= max(3.0 * (high - low), 3.0 * abs(high), 3.0)


def check_skin(vertices, triangles, colors):
    """Each edge belongs to two triangles in opposite directions; a span of 1; left is as right; return it."""
    edges = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forward, backward = {tuple(e) for e in edges}, {tuple(e[::-1]) for e in edges}
    assert len(forward) == len(edges)
    assert forward == backward
    assert np.ptp(vertices[:, 1]) == pytest.approx(1.0)
    assert_allclose(np.sort(vertices[:, 1]), np.sort(-vertices[:, 1]), atol=1e-12)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    six_volumes = np.sum(a * np.cross(b, c), axis=1)
    for part in np.unique(colors, axis=0):
        of_part = (colors == part).all(axis=1)
        assert six_volumes[of_part].sum() > 0  # the normals point outward
    return vertices, triangles, colors


def test_a_multirotor_has_four_disks_and_orange_ones_ahead():
    from bench.views.recording.meshes import MESHES

    vertices, triangles, colors = check_skin(*MESHES["multirotor"]())
    orange = (colors[:, 2] < 100) & (colors[:, 0] > 200)
    ahead = vertices[triangles[orange].ravel()]
    assert ahead[:, 0].min() > 0.0
    assert ahead[:, 2].max() < 0.0  # above the arms
    assert vertices[:, 2].max() > 0.1  # legs below


@pytest.mark.parametrize(("mesh", "nose_x"), [("uav", 0.36), ("light-single", 0.308), ("jet", 0.52)])
def test_the_aircraft_is_a_closed_skin_with_red_on_the_left(mesh, nose_x):
    """Each edge belongs to two triangles in opposite directions; frame b: y to the right, z down."""
    from bench.views.recording.meshes import MESHES

    vertices, triangles, colors = check_skin(*MESHES[mesh]())
    red = (colors[:, 0] > 200) & (colors[:, 1] < 100)
    assert vertices[triangles[red].ravel(), 1].max() < 0
    nose = vertices[vertices[:, 0].argmax()]
    assert nose[0] == pytest.approx(nose_x)
    aft = vertices[vertices[:, 0] < -0.3]
    assert -aft[:, 2].min() > 2 * aft[:, 2].max()  # the fin points up
