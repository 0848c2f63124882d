"""Initial alignment: closed forms, errors that are what the covariance says, and data it cannot use.

Register section 10, initial alignment: sd of azimuth = eps_E / (u cos lat).
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench import pipeline
from bench.core.mathematics import earth, rotation
from bench.core.records.data import Trajectory, no_air, no_controls, no_events
from bench.core.records.sensor_specs import AxisFigures, ImuSpec, TriadSpec
from bench.core.records.specs import EvaluationWindow
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.metrics import run_metrics
from bench.io.config import read_profile
from bench.navigation.built_in import BUILT_IN, load
from bench.navigation.error_state_filter.state_blocks import state_model
from bench.navigation.models.loose_tight import Loose
from bench.navigation.start import alignment
from bench.simulation import sensors
from tests.builders import at_rest, band, put
from tests.weaving import DEG, IMU, units, weaving

FINE = ImuSpec(
    "ring-laser",
    TriadSpec(random_walk=0.002 * DEG / 60, turn_on_bias_sd=0.1 * DEG / 3600),
    TriadSpec(random_walk=0.009 / 60, turn_on_bias_sd=50e-6 * 9.81),
)
LAT, ROLL, PITCH, HEADING = 50 * DEG, 2 * DEG, -5 * DEG, 140 * DEG


def standing(duration, rate=50.0, roll=ROLL, pitch=PITCH, heading=HEADING, lat=LAT):
    return at_rest(duration, rate, (lat, 0.3, 250.0), roll, pitch, heading)


def then(first, second):
    """One motion after the other: only the columns a navigator sees need to fit."""
    columns = {
        name: np.vstack([getattr(first, name), getattr(second, name)[1:]])
        for name in ("lla", "vel_n", "q_nb")
    }
    columns |= {
        name: np.vstack([getattr(first, name), getattr(second, name)]) for name in ("dtheta_b", "dvel_b")
    }
    t = np.concatenate([first.t, first.t[-1] + second.t[1:]])
    return replace(first, t=t, **columns)


def level(imu=FINE, **changes):
    return replace(units(imu, baro=None), alignment="level", **changes)


def course(imu=IMU, drift=0.0, **changes):
    changes = {"align_for": 10.0, **changes}
    return replace(units(imu, baro=None), alignment="course", drift_sd=drift, **changes)


def found(truth, spec, seed=1, run=0):
    """The start that is found, and its error (9,): estimate less truth."""
    sensed = sensors.sense(truth, spec, seed, run)
    start, _ = alignment.complete(sensed.data, sensed.initial)
    k = int(np.argmin(np.abs(truth.t - start.t)))
    assert abs(truth.t[k] - start.t) < 1e-6
    turn = rotation.multiply(start.q_nb, rotation.conjugate(truth.q_nb[k]))
    error = [
        earth.difference_n(start.lla, truth.lla[k]), start.vel_n - truth.vel_n[k], rotation.to_rotvec(turn)
    ]  # fmt: skip
    return start, np.concatenate(error)


# --- what is told ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "told"), [("given", 9), ("level", 3), ("course", 0)])
def test_what_is_not_told_is_nan_with_infinite_variance(kind, told):
    truth = standing(20.0)
    spec = replace(units(), alignment=kind)
    start = sensors.sense(truth, spec, 1, 0).initial
    values = np.concatenate([start.lla, start.vel_n, start.q_nb])
    assert np.isfinite(values[:told]).all()
    assert np.isnan(values[told:]).all() or told == 9
    assert np.isinf(np.diag(start.cov)[told:]).all()
    assert np.isfinite(np.diag(start.cov)[:told]).all()
    given = sensors.sense(truth, units(), 1, 0).initial
    if told:
        np.testing.assert_array_equal(start.lla, given.lla)  # the run of what is told is that of all


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({}, ("given", 60.0, 10.0)),
        ({"kind": "level"}, ("level", 60.0, 10.0)),
        ({"kind": "level", "duration_s": 45.0}, ("level", 45.0, 10.0)),
        ({"kind": "course"}, ("course", 10.0, 10.0)),
        ({"kind": "course", "duration_s": 20.0, "drift_deg": 3.0}, ("course", 20.0, 3.0)),
    ],
)
def test_a_profile_says_which(asked, told):
    spec = read_profile("circuit", {f"alignment.{key}": value for key, value in asked.items()}).sensors
    assert (spec.alignment, spec.align_for, pytest.approx(spec.drift_sd / DEG)) == told


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            {"duration_s": 20.0},
            "duration_s is for 'level', 'hover' or 'course'; kind = 'given' takes no time",
        ),
        ({"kind": "level", "drift_deg": 3.0}, "drift_deg is for kind = 'course', not for kind = 'level'"),
        (
            {"kind": "level", "duration_s": 80.0},
            "duration_s = 80 s must not go beyond [evaluation] from_s = 60",
        ),
        ({"kind": "lev"}, "kind = 'lev' must be 'given', 'level', 'hover' or 'course'"),
    ],
)
def test_a_profile_that_asks_for_the_impossible_is_refused(asked, message):
    with pytest.raises(ConfigError) as caught:
        read_profile("circuit", {f"alignment.{key}": value for key, value in asked.items()})
    assert str(caught.value).startswith(f"circuit.toml: [alignment] {message}")


# --- at rest --------------------------------------------------------------------------------------------


def test_without_errors_level_returns_the_attitude():
    """Closed form: any attitude, to the rounding of its means."""
    perfect = ImuSpec("perfect", TriadSpec(), TriadSpec())
    for roll, pitch, heading in ((0.0, 0.0, 0.0), (ROLL, PITCH, HEADING), (-0.4, 0.3, 4.0)):
        truth = standing(30.0, roll=roll, pitch=pitch, heading=heading)
        start, error = found(truth, level(perfect, initial_pos_sd=(0.0,) * 3))
        assert np.abs(error[6:]).max() < 1e-9
        assert np.abs(error[:6]).max() < 1e-6
        assert start.t == pytest.approx(29.0, abs=1.01)


def test_a_bias_tilts_and_turns_as_the_closed_form_says():
    """db / g about the other axis; dw_E / (w_ie cos lat) and tan lat times the tilt about the vertical."""
    truth = standing(30.0, roll=0.0, pitch=0.0, heading=0.0)
    perfect = ImuSpec("perfect", TriadSpec(), TriadSpec())
    sensed = sensors.sense(truth, level(perfect, initial_pos_sd=(0.0,) * 3), 1, 0)
    g = earth.gravity_n(LAT, 250.0)[2]
    db, dw = np.array([2e-3, -3e-3, 0.0]), np.array([0.0, 4e-8, 0.0])
    imu = sensed.data.imu
    dt = imu.dt[:, None]
    off = replace(sensed.data, imu=replace(imu, dvel_b=imu.dvel_b + db * dt, dtheta_b=imu.dtheta_b + dw * dt))
    start, _ = alignment.complete(off, sensed.initial)
    phi = rotation.to_rotvec(start.q_nb)
    down = -dw[1] / (earth.EARTH_RATE * np.cos(LAT)) - np.tan(LAT) * phi[0]
    assert_allclose(phi, [-db[1] / g, db[0] / g, down], rtol=2e-3)


def test_the_heading_sd_is_that_of_the_register():
    """Section 10: 0.1 deg/h at 50 deg north, 0.59 deg."""
    start, _ = found(standing(60.0), level())
    assert np.rad2deg(np.sqrt(start.cov[8, 8])) == pytest.approx(0.59, abs=0.02)
    better = replace(FINE, gyro=replace(FINE.gyro, turn_on_bias_sd=0.01 * DEG / 3600))
    assert found(standing(60.0), level(better))[0].cov[8, 8] < 0.3 * start.cov[8, 8]


def test_level_errors_are_what_the_covariance_says():
    """200 runs: position, velocity and attitude together, 99.9 % band; with half the gyro drift it fails."""
    truth, runs = standing(20.0), 200
    nees, tight = [], []
    half = replace(FINE, gyro=replace(FINE.gyro, turn_on_bias_sd=0.05 * DEG / 3600))
    for run in range(runs):
        start, error = found(truth, level(), run=run)
        use = [0, 1, 2, 6, 7, 8]  # the velocity is zero, and so is its error
        nees.append(error[use] @ np.linalg.solve(start.cov[np.ix_(use, use)], error[use]))
        claimed = replace(level(), assumed=replace(level().assumed, imu=half))
        start, error = found(truth, claimed, run=run)
        tight.append(error[use] @ np.linalg.solve(start.cov[np.ix_(use, use)], error[use]))
    low, high = band(runs, states=6)
    assert low < np.mean(nees) < high
    assert np.mean(tight) > high


CLEAN = TriadSpec(random_walk=0.02 / 60, turn_on_bias_sd=5e-3 * 9.81)
STEADY = ImuSpec("steady", TriadSpec(random_walk=0.1 * DEG / 60, turn_on_bias_sd=50 * DEG / 3600), CLEAN)
MOTIONS = {
    "level": (lambda: standing(60.0), level(FINE, align_for=20.0)),
    "course": (lambda: weaving(60.0, straight_from=0.0), course(STEADY, drift=2 * DEG)),
}


def tilts(motion, believed):
    """NEES of the tilt at the end of the minute, 100 runs; a filter is told ``believed`` of it."""
    make, spec = MOTIONS[motion]
    truth, nees = make(), []
    for run in range(100):
        sensed = sensors.sense(truth, spec, 3, run)
        start, _ = alignment.complete(sensed.data, sensed.initial)
        assert np.abs(start.bias_cov).max() > 0
        solution = Loose().run(sensed.data, believed(start))
        phi = error_series(truth, solution).phi_n[-1, :2]
        nees.append(phi @ np.linalg.solve(solution.cov[-1, 6:8, 6:8], phi))
    return np.array(nees)


@pytest.mark.parametrize("motion", MOTIONS)
def test_what_tilt_and_biases_have_in_common_is_told(motion):
    """The tilt an accelerometer bias made stays when the filter sees no motion: NEES 2, not 3 or more."""
    low, high = band(100, states=2)
    assert low < tilts(motion, lambda start: start).mean() < high
    strangers = tilts(motion, lambda start: replace(start, bias_cov=np.zeros((9, 6))))
    assert strangers.mean() > high


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_bias_that_one_axis_hardly_has_leaves_the_covariance_positive_definite(motion):
    make, spec = MOTIONS[motion]
    accel, gyro = (
        replace(triad, axes=(AxisFigures("turn_on_bias_sd", sd, 0.05 * sd, 0.05 * sd),))
        for triad in (spec.imu.accel, spec.imu.gyro)
        for sd in [triad.turn_on_bias_sd]
    )
    imu = replace(spec.imu, accel=accel, gyro=gyro)
    spec = replace(spec, imu=imu, assumed=replace(spec.assumed, imu=imu))
    start, _ = found(make(), spec, seed=3, run=0)
    P = state_model(start, spec.assumed, ()).P[6:, 6:]
    sd = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(sd, sd))[0] > 0


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_joint_covariance_with_biases_that_wander_is_that_of_the_errors(motion):
    """Along its two narrowest directions, which are those that tie each tilt to the bias that made it.

    A flicker is reported to move a little more than it does: its mean has the variance of its value.
    """
    make, spec = MOTIONS[motion]
    accel = replace(
        spec.imu.accel, bias_instability=100e-6 * 9.81, bias_correlation=100.0, bias_model="flicker"
    )
    imu = replace(spec.imu, accel=accel)
    spec = replace(spec, imu=imu, assumed=replace(spec.assumed, imu=imu))
    truth, narrow = make(), []
    for run in range(100):
        start, error = found(truth, spec, seed=3, run=run)
        sensed = sensors.sense(truth, spec, 3, run)
        P = state_model(start, sensed.data.specs, ()).P[6:, 6:]
        k = np.searchsorted(sensed.truth.t, start.t - 1e-6)
        bias = np.concatenate([sensed.truth.gyro_bias_b[k], sensed.truth.accel_bias_b[k]])
        sd = np.sqrt(np.diag(P))
        w, V = np.linalg.eigh(P / np.outer(sd, sd))
        assert w[0] > 0
        narrow.append(np.sum((V[:, :2].T @ (np.concatenate([error[6:], -bias]) / sd)) ** 2 / w[:2]))
    assert np.mean(narrow) < band(100, states=2)[1]


def test_a_gyro_that_feels_gravity_has_it_in_its_heading_sd():
    """100 runs, 99.9 % band; assumed to feel none, it fails."""
    truth, runs = standing(20.0), 100
    felt = replace(FINE, gyro=replace(FINE.gyro, g_sensitivity_sd=0.02 * DEG / 3600))
    square, deaf = [], []
    for run in range(runs):
        start, error = found(truth, level(felt), run=run)
        square.append(error[8] ** 2 / start.cov[8, 8])
        start, error = found(truth, replace(level(felt), assumed=level().assumed), run=run)
        deaf.append(error[8] ** 2 / start.cov[8, 8])
    low, high = band(runs, states=1)
    assert low < np.mean(square) < high
    assert np.mean(deaf) > high


def test_a_mems_unit_levels_and_says_that_its_heading_is_unknown():
    truth = standing(60.0)
    sensed = sensors.sense(truth, level(IMU), 1, 0)
    start, events = alignment.complete(sensed.data, sensed.initial)
    assert np.sqrt(start.cov[8, 8]) == pytest.approx(np.pi / np.sqrt(3))
    ((_, _, kind, text),) = events
    assert kind == "alignment"
    assert "heading is unknown: gyros of " in text
    assert "deg/h of Earth rate" in text
    errors = np.array([found(truth, level(IMU), run=run)[1][6:8] for run in range(100)])
    squares = np.mean(errors**2, axis=0) / np.diag(start.cov)[6:8]
    low, high = band(100)
    assert ((low < squares) & (squares < high)).all()


def test_it_ends_when_the_aircraft_moves_and_not_after_its_time():
    away = weaving(20.0, rate=50.0)
    truth = then(standing(25.0, roll=0.0, pitch=0.0, heading=0.6), away)
    for imu in (FINE, IMU):
        start, _ = found(truth, replace(level(imu), gnss=None))
        assert 23.9 < start.t < 25.01
    assert found(truth, level(FINE, align_for=12.0))[0].t == pytest.approx(12.0)
    sensed = sensors.sense(truth, level(), 1, 0)
    fixes = sensed.data.fixes
    speed = np.where((fixes.t > 17.5)[:, None], [3.0, 0.0, 0.0], fixes.vel_n)
    early = replace(sensed.data, fixes=replace(fixes, vel_n=speed))
    assert alignment.complete(early, sensed.initial)[0].t == pytest.approx(17.0)


# --- moving ---------------------------------------------------------------------------------------------


def test_without_errors_course_returns_the_attitude_of_a_turn():
    """Nose along the course in `straight`; closed form to what two fixes 10 s apart leave: 1e-6 rad."""
    perfect = ImuSpec("perfect", TriadSpec(), TriadSpec())
    quiet = replace(units().gnss, pos_h_white_sd=0.0, pos_v_white_sd=0.0, vel_white_sd=0.0)
    spec = replace(course(perfect), gnss=quiet, assumed=replace(course(perfect).assumed, gnss=quiet))
    truth = straight()
    sensed = sensors.sense(truth, spec, 1, 0)
    start, _ = alignment.complete(sensed.data, sensed.initial)
    k = int(np.argmin(np.abs(truth.t - start.t)))
    turn = rotation.multiply(start.q_nb, rotation.conjugate(truth.q_nb[k]))
    assert np.abs(rotation.to_rotvec(turn)).max() < 2e-5
    assert np.abs(earth.difference_n(start.lla, truth.lla[k])).max() < 1e-3
    assert np.abs(start.vel_n - truth.vel_n[k]).max() < 1e-3


@functools.cache
def straight(duration=30.0, rate=100.0):
    """25 m/s along the nose with a slow weave of pitch and thrust, no bank: course is heading."""
    from bench.navigation import mechanization

    n = round(duration * rate)
    t = np.arange(n + 1) / rate
    q = rotation.from_euler(0.0, 3 * DEG, 0.6)
    lla, v = np.array([47 * DEG, 11 * DEG, 800.0]), 25.0 * np.array([np.cos(0.6), np.sin(0.6), 0.0])
    rows = [np.concatenate([lla, v, q])]
    push, before = 0.5 * np.sin(0.4 * t[1:]), np.zeros(7)
    turns, pushes = [], []
    for a in push:  # level at constant heading: what turns n turns b, what pulls down is held
        lat = rows[-1][0]
        w_n = earth.EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
        r_m, r_p = earth.radii(lat)
        w_n += np.array([rows[-1][4] / r_p, -rows[-1][3] / r_m, -rows[-1][4] / r_p * np.tan(lat)])
        f_n = -earth.gravity_n(lat, 800.0) + a * np.array([np.cos(0.6), np.sin(0.6), 0.0])
        f_n += np.cross(w_n + earth.EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)]), rows[-1][3:6])
        back = rotation.conjugate(rows[-1][6:])
        turns.append(rotation.rotate(back, w_n) / rate)
        pushes.append(rotation.rotate(back, f_n) / rate)
        state = rows[-1]
        rows.append(
            mechanization.propagate(
                state[:3], state[3:6], state[6:], [1 / rate], turns[-1:], pushes[-1:], before
            )[-1]
        )
    nav = np.array(rows)
    return Trajectory(
        t, nav[:, :3], nav[:, 3:6], nav[:, 6:], np.array(turns), np.array(pushes), no_air(), no_controls(),
        no_events(),
    )  # fmt: skip


def test_course_errors_are_what_the_covariance_says():
    """200 runs, crab angles drawn as reported; with an accelerometer assumed twice as good it fails."""
    truth, runs = straight(15.0), 200
    nees, tight = [], []
    drift = 4 * DEG
    turned = np.random.default_rng(3).normal(scale=drift, size=runs)
    good = replace(IMU, accel=replace(IMU.accel, turn_on_bias_sd=IMU.accel.turn_on_bias_sd / 2))
    for run in range(runs):
        crab = crabbing(truth, turned[run])
        for spec, into in (
            (course(drift=drift), nees),
            (replace(course(drift=drift), assumed=replace(course().assumed, imu=good)), tight),
        ):
            start, error = found(crab, spec, run=run)
            into.append(error @ np.linalg.solve(start.cov, error))
    low, high = band(runs, states=9)
    assert low < np.mean(nees) < high
    assert np.mean(tight) > high


def crabbing(truth, angle):
    """The same path with the nose turned off the course."""
    down = rotation.from_rotvec([0.0, 0.0, angle])
    q = rotation.multiply(down, truth.q_nb)
    turn = rotation.multiply(rotation.conjugate(q), truth.q_nb)[:-1]  # old b to new b
    return replace(
        truth,
        q_nb=q,
        dtheta_b=rotation.rotate(turn, truth.dtheta_b),
        dvel_b=rotation.rotate(turn, truth.dvel_b),
    )


def test_the_drift_angle_is_in_the_heading_sd():
    truth = straight(15.0)
    none, some = (found(truth, course(drift=d))[0] for d in (0.0, 0.1))
    assert np.sqrt(some.cov[8, 8] - none.cov[8, 8]) == pytest.approx(0.1)
    speed = np.hypot(*none.vel_n[:2])
    assert np.sqrt(none.cov[8, 8]) == pytest.approx(0.05 / speed, rel=0.01)


def test_course_waits_for_a_stretch_that_moves():
    truth = then(standing(25.0, rate=100.0, roll=0.0, pitch=0.0, heading=0.6), straight(30.0))
    start, _ = found(truth, course())
    assert 35.0 < start.t < 36.1
    assert found(truth, course(align_for=5.0))[0].t < start.t


# --- flown by JSBSim ------------------------------------------------------------------------------------


def test_an_aircraft_on_its_wheels_is_leveled_and_gyrocompassed():
    """`static` for 40 s: each of tilt and heading within 4 sigma in 20 runs, mean square in its band."""
    profile = read_profile("static", {"leg.1.duration_s": 40.0, "evaluation.from_s": 35.0})
    truth = pipeline.fly(profile, cache=False)
    errors, claimed = [], []
    for run in range(20):
        start, error = found(truth, level(FINE, align_for=30.0), run=run)
        assert start.t == pytest.approx(30.0)
        errors.append(error[6:])
        claimed.append(np.sqrt(np.diag(start.cov)[6:]))
    ratio = np.array(errors) / np.array(claimed)
    assert np.abs(ratio).max() < 4.0
    low, high = band(60)
    assert low < np.mean(ratio**2) < high


def test_an_aircraft_in_the_wind_finds_its_nose_within_the_drift_it_allows(short_truth):
    """25 m/s in 5 m/s of wind: the crab angle is inside 10 deg (1 sigma); tilt within 4 sigma in 20 runs."""
    ratio = []
    for run in range(20):
        start, error = found(short_truth, course(drift=10 * DEG), run=run)
        assert start.t < 20.0
        ratio.append(error[6:] / np.sqrt(np.diag(start.cov)[6:]))
    assert np.abs(ratio).max() < 4.0
    assert np.abs(np.array(ratio)[:, 2]).max() < 2.0


# --- what cannot be used --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "motion", "message"),
    [
        (level(), "flying", "alignment level needs a standstill of 10 s at the start; at 0 s "),
        (
            replace(level(), gnss=None),
            "flying",
            "alignment level needs a standstill of 10 s at the start; at ",
        ),
        (
            level(align_for=60.0),
            "short",
            "alignment level needs a standstill of 10 s at the start; at 6 s the",
        ),
        (replace(course(), gnss=None), "flying", "alignment course needs GNSS fixes; the record has none"),
        (
            course(),
            "standing",
            "alignment course needs 10 s of fixes above 5 m/s over ground; the fastest of",
        ),
        (
            course(align_for=40.0),
            "flying",
            "alignment course needs 40 s of fixes above 5 m/s over ground; the",
        ),
    ],
)
def test_a_record_that_does_not_allow_it_is_refused_in_one_line(spec, motion, message):
    truth = {
        "flying": weaving(20.0, rate=50.0),
        "short": standing(6.5),
        "standing": standing(20.0),
    }[motion]
    sensed = sensors.sense(truth, spec, 1, 0)
    with pytest.raises(EstimatorError) as caught:
        load("loose-15", {}).run(sensed.data, sensed.initial)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_imu_without_a_sound_sample_is_named():
    """The fixes are sound."""
    sensed = sensors.sense(straight(15.0), course(), 1, 0)
    broken = replace(sensed.data, imu=put(sensed.data.imu, slice(None), valid=False))
    with pytest.raises(EstimatorError, match="needs IMU samples; the record has no sound one after 0 s"):
        alignment.complete(broken, sensed.initial)


def test_fixes_that_do_not_belong_to_the_record_are_refused():
    sensed = sensors.sense(straight(15.0), course(), 1, 0)
    fixes = sensed.data.fixes
    wild = replace(fixes, vel_n=fixes.vel_n * np.where(fixes.t > 5.0, 40.0, 1.0)[:, None])
    try:
        start, _ = alignment.complete(replace(sensed.data, fixes=wild), sensed.initial)
    except EstimatorError as error:
        assert "do they belong together" in str(error)  # noqa: PT017
    else:  # or a tilt that no aircraft flies
        assert abs(rotation.to_euler(start.q_nb)[1]) > 1.0


# --- in the filters and the judgment ----------------------------------------------------------------


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("kind", ["level", "course"])
def test_estimators_align_say_so_and_are_silent_before(name, kind):
    """The contract holds; what is before the end is NaN, and the metrics count from there."""
    spec = level(FINE) if kind == "level" else course(FINE)
    truth = standing(16.0) if kind == "level" else straight(15.0)
    sensed = sensors.sense(truth, replace(spec, align_for=10.0), 1, 0)
    slow = BUILT_IN[name].import_class().__module__.startswith("bench.navigation.models.classic")
    estimator = load(name, {"covariance_hz": 2.0} if slow else {})
    bench.check_estimator(estimator, sensed.data, sensed.initial)
    solution = estimator.run(sensed.data, sensed.initial)
    silent = np.isnan(solution.q_nb if name == "ahrs" else solution.lla).all(axis=1)
    if name != "gnss-only":
        ((_, end, text),) = solution.events.select("alignment")
        assert end >= 9.9
        assert ("leveled" if kind == "level" else "course") in text
        np.testing.assert_array_equal(silent, solution.t < end - 1e-6)
    errors, judged = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(14.0), outages=())
    assert judged["converged"], judged["reason"]
    assert (judged.get("pos_rmse_h_m_all") is None) == (name == "ahrs")
    assert len(errors) == len(solution)


def test_an_estimator_that_is_silent_beyond_the_window_did_not_converge():
    truth = standing(30.0)
    sensed = sensors.sense(truth, level(align_for=20.0), 1, 0)
    solution = load("loose-15", {}).run(sensed.data, sensed.initial)
    _, judged = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(15.0), outages=())
    assert not judged["converged"]
    assert judged["reason"] == "no solution before t = 20 s; metrics begin at 15 s"
    nees = error_series(truth, solution).nees
    assert np.isnan(nees[solution.t < 19.9]).all()
    assert np.isfinite(nees[solution.t > 20.1]).all()
