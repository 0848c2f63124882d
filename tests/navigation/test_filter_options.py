"""Each option of the compiled filters does what it says, and has an effect.

Late fixes, noise other than the datasheet's, standstill, an antenna that is elsewhere, the source's integrity
tests, airspeed and magnetometer.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from bench import pipeline
from bench.core.mathematics import earth, rotation
from bench.core.records.data import GnssFixes, ImuData, Trajectory
from bench.core.records.instruments import AirspeedData, AirspeedSpec, MagData, MagSpec
from bench.core.records.sensor_specs import ThermalSpec
from bench.evaluation.errors import error_series as judge
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.navigation.engine import integrity
from bench.navigation.error_state_filter import standstill
from bench.navigation.error_state_filter.aiding_sensors import airspeed_variance, fix_variance, weigh_fixes
from bench.navigation.models.loose_tight import Loose, Passage, Tight
from bench.simulation import sensors
from bench.simulation.signals.magnetic import field_n
from tests.builders import first_rows, take
from tests.weaving import BARO, DEG, GNSS, IMU, units, weaving

RUNS = 8
FLIGHT = (120.0,)


def with_columns(record, **values):
    return type(record)(**{f.name: getattr(record, f.name) for f in fields(record)} | values)


def rms(truth, solution, block="pos_n", from_s=60.0):
    series = judge.error_series(truth, solution)
    rows = series.t > from_s
    return float(np.sqrt(np.mean(np.sum(getattr(series, block)[rows] ** 2, axis=1))))


def nees(truth, solution, from_s=60.0):
    series = judge.error_series(truth, solution)
    return float(series.nees[series.t > from_s].mean())


def of(solution, sensor):
    table = solution.innovations
    return (table.code == table.sensor.index(sensor)) & (table.component == 0)


# --- latency --------------------------------------------------------------------------------------------


def late(data, seconds):
    """The same fixes, arriving later."""
    return replace(data, fixes=with_columns(data.fixes, t_arrival=data.fixes.t + seconds))


@pytest.mark.parametrize("seconds", [0.2, 0.83, 1.7])
def test_a_late_fix_is_compared_with_where_the_aircraft_was(truth, seconds):
    """25 m/s for 0.83 s are 21 m; allowed for, it is what a fix without delay leaves. Some wait together."""
    on_time, allowed, ignored, consistency = np.zeros((4, RUNS))
    for run in range(RUNS):
        drawn = sensors.sense(truth, units(), 7, run)
        data = late(drawn.data, seconds)
        solution = Loose().run(data, drawn.initial)
        on_time[run] = rms(truth, Loose().run(drawn.data, drawn.initial))
        allowed[run], consistency[run] = rms(truth, solution), nees(truth, solution)
        off = Loose(compensate_latency=False, gate_probability=1e-300)
        ignored[run] = rms(truth, off.run(data, drawn.initial))
        assert_allclose(np.unique(solution.innovations.t[of(solution, "gnss_position")])[0], 1.0 + seconds)
    assert allowed.mean() < 1.1 * on_time.mean() + 0.05
    assert ignored.mean() > 0.6 * 25.0 * seconds
    assert consistency.mean() < 9 + 3.3 * consistency.std(ddof=1) / np.sqrt(RUNS)


def test_without_delay_the_option_changes_no_bit(truth):
    drawn = sensors.sense(truth, units(), 7, 0)
    one, other = (Loose(compensate_latency=c).run(drawn.data, drawn.initial) for c in (True, False))
    assert_array_equal(one.lla, other.lla)
    assert_array_equal(one.cov, other.cov)
    assert "GNSS latency" in Loose(compensate_latency=False).unmodeled_errors(
        replace(drawn.data.specs, gnss=replace(GNSS, latency=0.2))
    )
    assert Loose().unmodeled_errors(replace(drawn.data.specs, gnss=replace(GNSS, latency=0.2))) == ()


def test_an_epoch_between_two_samples_is_used_at_its_own_instant(truth):
    """Exact fixes of 2.5 ms before the next sample: the innovation is nowhere the 0.06 m of 25 m/s."""
    exact = replace(GNSS, pos_h_white_sd=1e-3, pos_v_white_sd=1e-3)
    drawn = sensors.sense(truth, units(gnss=exact, baro=None), 7, 0)
    fixes = drawn.data.fixes
    t = fixes.t - 0.0025
    lla, _, q = judge.interpolate_truth(truth, t)
    arm = rotation.rotate(q, np.array(drawn.data.antenna_b))
    lla = earth.displace(lla, arm)
    moved = with_columns(fixes, t=t, t_arrival=t, lla=lla)
    solution = Loose().run(replace(drawn.data, fixes=moved), drawn.initial)
    z = solution.innovations.z[solution.innovations.code == 0]
    assert np.abs(z[len(z) // 2 :]).max() < 0.03


@pytest.mark.parametrize("part", [0.25, 0.8])
def test_an_answer_between_two_samples_is_that_of_a_record_cut_there(part):
    """A sample and the parts of it before and after, at the same rates; a filter goes on as if not asked."""
    drawn = sensors.sense(weaving(4.0, rate=50.0), units(), 8, 0)
    imu, k = drawn.data.imu, 130
    at = float(imu.t[k] - imu.dt[k] * (1.0 - part))
    cut = {name: np.insert(getattr(imu, name), k, getattr(imu, name)[k], axis=0) for name in imu.__slots__}
    cut["t"][k] = at
    for name in ("dt", "dtheta_b", "dvel_b"):
        cut[name][k], cut[name][k + 1] = part * cut[name][k], (1.0 - part) * cut[name][k + 1]
    asked = replace(drawn.data, output_t=np.array([2.0, at, 4.0]))
    one = Loose(covariance_hz=None, gnss_markov=True)
    whole, parts, unasked = (
        one.run(data, drawn.initial)
        for data in (asked, replace(asked, imu=ImuData(**cut)), replace(asked, output_t=np.array([2.0, 4.0])))
    )
    for name in ("lla", "vel_n", "q_nb", "cov", "extra", "extra_sd"):
        assert_allclose(getattr(whole, name)[1], getattr(parts, name)[1], rtol=1e-9, atol=1e-15)
        assert_array_equal(getattr(whole, name)[[0, 2]], getattr(unasked, name))


# --- noise ----------------------------------------------------------------------------------------------


def test_noise_is_taken_from_the_innovations(truth):
    """A receiver four times as noisy as assumed: NIS falls to 3, errors shrink, the covariance follows.

    Without it NIS lies between 3 and 3 * 16, by how much of S is R.
    """
    noisy = replace(GNSS, pos_h_white_sd=6.0, pos_v_white_sd=10.0, vel_white_sd=0.2)
    found = np.zeros((RUNS, 2, 3))
    for run in range(RUNS):
        drawn = sensors.sense(truth, replace(units(gnss=noisy), assumed=units().assumed), 8, run)
        for k, window in enumerate((None, 20)):
            solution = Loose(adaptive_noise=window).run(drawn.data, drawn.initial)
            rows = of(solution, "gnss_position") & (solution.innovations.t > 60.0)
            found[run, k] = (
                solution.innovations.nis[rows].mean(), rms(truth, solution), nees(truth, solution)
            )  # fmt: skip
    plain, adapted = found.mean(axis=0)
    assert plain[0] > 12
    assert 2.0 < adapted[0] < 5.0
    assert (stats.ttest_rel(found[:, 0], found[:, 1], alternative="greater").pvalue < 0.001).all()


def test_noise_of_the_datasheet_stays_when_it_is_right(truth):
    drawn = sensors.sense(truth, units(), 8, 0)
    plain, adapted = (Loose(adaptive_noise=n).run(drawn.data, drawn.initial) for n in (None, 60))
    ratio = adapted.cov[-1, [0, 1, 2], [0, 1, 2]] / plain.cov[-1, [0, 1, 2], [0, 1, 2]]
    assert ((ratio > 0.5) & (ratio < 2.0)).all()
    assert not np.array_equal(plain.lla, adapted.lla)


def test_the_level_of_noise_is_the_running_mean_of_what_innovations_have_beyond_p():
    """Of 20 measurements, by the datasheet's variance; one beyond the gate counts as at the gate."""
    drawn = sensors.sense(weaving(15.0, rate=50.0), units(), 8, 0)
    baro, fixes = drawn.data.baro, drawn.data.fixes
    alt, lla = baro.alt_baro.copy(), fixes.lla.copy()
    alt[30], lla[6, 0] = alt[30] + 40.0, lla[6, 0] + 1e-5
    data = replace(drawn.data, baro=replace(baro, alt_baro=alt), fixes=replace(fixes, lla=lla))
    passage = Passage(Loose(adaptive_noise=20, gate_probability=1e-3), data, drawn.initial, [])
    solution = passage.update(data, 0.0, last=True)
    most, table = stats.chi2.isf(1e-3, 1), solution.innovations
    position, height = fix_variance(GNSS, gnss_markov=False)[:3], np.array([BARO.white_sd**2])
    for sensor, r in (("gnss_position", position), ("baro", height)):
        rows, level = table.code == table.sensor.index(sensor), 1.0
        z, S = (one[rows].reshape(-1, len(r)) for one in (table.z, table.S))
        for square, variance in zip(z**2, S, strict=True):
            beyond = np.minimum(square, most * variance) - (variance - level * r)
            level = max(level + (np.mean(beyond / r) - level) / 20.0, 0.01)
        assert (z**2 > most * S).any()
        assert_allclose(passage.run.gate.level[table.sensor.index(sensor)], level, rtol=1e-9)


def test_an_imu_warms_on_the_way_with_the_air_of_its_height():
    """From 15.2 K below its reference at 800 m towards 5.2 K below, in 30 s: 6.1 K are to come after 15 s."""
    gyro, thermal = replace(IMU.gyro, temperature_sd=1e-5), ThermalSpec(298.15, 10.0, 30.0)
    drawn = sensors.sense(weaving(15.0, rate=50.0), units(replace(IMU, gyro=gyro, thermal=thermal)), 8, 0)
    passage = Passage(Loose(every_error=True), drawn.data, drawn.initial, [])
    assert passage.run.warmth == pytest.approx(-15.2, abs=0.1)
    passage.update(drawn.data, 0.0, last=True)
    imu, (rate, force) = drawn.data.imu, passage.run.work.measure.last  # what measurements see: the newest
    assert_allclose(rate, imu.dtheta_b[-1] * 50.0, atol=1e-3)
    assert_allclose(force, imu.dvel_b[-1] * 50.0, atol=0.1)
    assert_allclose(passage.run.work.carried.known[3], IMU.gyro.random_walk**2 * 50.0)
    assert passage.run.warmth == pytest.approx(-5.2 - 10.0 * np.exp(-0.5), abs=0.1)


# --- standstill -----------------------------------------------------------------------------------------


def standing(duration, rate=200.0):
    """An aircraft that stands, nose to 35 deg, pitched up by 4: what ground and Earth give its IMU."""
    n = round(duration * rate)
    t = np.arange(n + 1) / rate
    lla, q = np.array([47 * DEG, 11 * DEG, 500.0]), rotation.from_euler(0.01, 4 * DEG, 35 * DEG)
    C = rotation.matrix(q)
    g = earth.gravity_n(lla[0], lla[2])
    w = earth.EARTH_RATE * np.array([np.cos(lla[0]), 0.0, -np.sin(lla[0])])
    base = weaving(1.0)
    still = np.ones((n + 1, 1))
    return Trajectory(
        t=t,
        lla=still * lla,
        vel_n=still * np.zeros(3),
        q_nb=still * q,
        dtheta_b=still[1:] * (C.T @ w) / rate,
        dvel_b=still[1:] * (C.T @ -g) / rate,
        air=base.air,
        controls=base.controls,
        events=base.events,
    )


def test_standstill_holds_position_and_finds_gyro_biases():
    """No GNSS, no baro, 60 s at rest: without the updates it drifts by tens of meters."""
    truth = standing(60.0)
    for run in range(3):
        drawn = sensors.sense(truth, units(gnss=None, baro=None), 9, run)
        drift, held = (Loose(standstill=s).run(drawn.data, drawn.initial) for s in (False, True))
        assert of(held, "zero_velocity").sum() == 60
        assert held.innovations.accepted.all()
        assert held.extra_sd[-1, :3].max() < 0.35 * drift.extra_sd[-1, :3].max()
        assert rms(truth, held, "vel_n", 30.0) < 0.05 < rms(truth, drift, "vel_n", 30.0)
        series = judge.error_series(truth, held)
        assert np.mean(series.nees[series.t > 20.0]) < 25.0


def test_steady_flight_is_no_standstill():
    """In calm air the IMU alone cannot tell; the gate rejects, and what the filter says stays as it was."""
    truth = weaving(120.0, straight_from=60.0)
    drawn = sensors.sense(truth, units(), 9, 0)
    ends, *_ = standstill.StandstillDetector(drawn.initial.t, IMU).take(drawn.data.imu)
    assert ends.min() > 59.9  # not while it weaves
    assert len(ends) > 50
    plain, guarded = (
        Loose(standstill=s, readmit_after_s=0.5).run(drawn.data, drawn.initial) for s in (False, True)
    )
    zero = of(guarded, "zero_velocity") | of(guarded, "zero_rate")
    assert zero.sum() == 2 * len(ends)
    assert not guarded.innovations.accepted[of(guarded, "zero_velocity")].any()
    assert not guarded.innovations.accepted[of(guarded, "zero_rate")].any()
    assert_allclose(guarded.vel_n, plain.vel_n, rtol=0, atol=1e-9)


# --- the antenna ----------------------------------------------------------------------------------------


def test_an_antenna_that_is_elsewhere_is_found():
    """Told 0.8, 0.3, -0.4 m, it sits 0.6 m ahead of that; turns show it. Code noise of 0.1 m."""
    truth = weaving(180.0)
    precise = replace(GNSS, pos_h_white_sd=0.1, pos_v_white_sd=0.1, vel_white_sd=0.02)
    found = []
    for run in range(4):
        drawn = sensors.sense(truth, units(gnss=precise), 10, run)
        told = np.array(drawn.data.antenna_b)
        data = replace(drawn.data, antenna_b=told - [0.6, 0.0, 0.0])
        known, estimated = (Loose(lever_arm_sd=sd).run(data, drawn.initial) for sd in (0.0, 0.5))
        at = estimated.extra_names.index("antenna_b_x_m")
        assert_allclose(estimated.extra[0, at : at + 3], data.antenna_b, atol=1e-12)
        error = (estimated.extra[-1, at : at + 3] - told) / estimated.extra_sd[-1, at : at + 3]
        found.append(np.sum(error**2))
        assert np.abs(estimated.extra[-1, at] - told[0]) < 0.2
        assert rms(truth, estimated) < 0.6 * rms(truth, known)
    assert np.mean(found) < 3 * 3.6  # chi-square of 12, 99.9 %: 32.9
    with pytest.raises(ValueError, match="needs gnss = true"):
        Loose(gnss=False, lever_arm_sd=0.5)


def test_tight_finds_the_antenna_too():
    from tests.navigation.test_tight import MATCHED

    drawn = sensors.sense(weaving(60.0), units(gnss=MATCHED), 10, 0)
    solution = Tight(lever_arm_sd=0.5).run(drawn.data, drawn.initial)
    at = solution.extra_names.index("antenna_b_x_m")
    assert (solution.extra_sd[-1, at : at + 2] < 0.45).all()


# --- integrity ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("test", ["nis", "trace", "tolerance"])
def test_each_integrity_test_refuses_a_jump_by_itself(truth, test):
    """A-5.4.7 and A-5.4.T: 300 m north for one fix."""
    drawn = sensors.sense(truth, units(), 11, 0)
    lla = drawn.data.fixes.lla.copy()
    lla[49, 0] += 300 / 6.37e6
    data = replace(drawn.data, fixes=with_columns(drawn.data.fixes, lla=lla))
    refused = {}
    for tests in ((), (test,)):
        solution = Loose(integrity=tests).run(data, drawn.initial)
        rows = of(solution, "gnss_position")
        refused[tests] = solution.innovations.t[rows & ~solution.innovations.accepted]
    assert len(refused[()]) == 0
    assert_allclose(refused[(test,)], [50.0])


def test_the_tolerance_is_that_of_the_register(truth):
    """A-5.4.T by `bench.navigation.engine.integrity`: 1 s after the last fix, 1/2 20 + 5 sigma.

    It is a test of fixes: a height 60 m off is none.
    """
    drawn = sensors.sense(truth, units(), 11, 0)
    alt = drawn.data.baro.alt_baro.copy()
    alt[drawn.data.baro.t > 119.0] += 60.0
    drawn = replace(drawn, data=replace(drawn.data, baro=with_columns(drawn.data.baro, alt_baro=alt)))
    limit = integrity.tolerance(
        1.0, np.array([GNSS.pos_h_white_sd]), order=2, max_acceleration=20.0, sigmas=5.0
    )
    for meters, kept in ((limit[0] - 4.0, True), (limit[0] + 4.0, False)):
        lla = drawn.data.fixes.lla.copy()
        sound = Loose(integrity=()).run(drawn.data, drawn.initial).innovations
        at = 60.0
        z = sound.z[(sound.code == 0) & (sound.component == 0) & np.isclose(sound.t, at)][0]
        R_M, _ = earth.radii(lla[59, 0])
        lla[59, 0] += (meters - z) / (R_M + lla[59, 2])
        data = replace(drawn.data, fixes=with_columns(drawn.data.fixes, lla=lla))
        table = Loose(integrity=("tolerance",)).run(data, drawn.initial).innovations
        row = (table.code == 0) & (table.component == 0) & np.isclose(table.t, at)
        assert table.accepted[row][0] == kept
        assert table.accepted[table.code == table.sensor.index("baro")].all()


# --- airspeed and magnetometer ----------------------------------------------------------------------------


def test_airspeed_slows_the_drift_without_gnss():
    """Wind of 6 m/s, a minute of fixes, three without: airspeed and the wind found bound the velocity."""
    truth = weaving(240.0)
    wind = np.array([5.0, -3.0, 0.0])
    spec = AirspeedSpec("pitot", 10.0, white_sd=0.3)
    error = np.zeros((2 * RUNS, 2))
    for run in range(2 * RUNS):
        drawn = sensors.sense(truth, units(baro=None), 12, run)
        keep = drawn.data.fixes.t <= 60.0
        fixes = GnssFixes(*(getattr(drawn.data.fixes, f.name)[keep] for f in fields(GnssFixes)))
        k = np.arange(20, len(truth), 20)
        speed = np.linalg.norm(truth.vel_n[k] - wind, axis=1)
        speed += 0.3 * np.random.default_rng(run).normal(size=len(k))
        t = truth.t[k]
        air = AirspeedData(t, t, np.ones(len(k), bool), speed, np.full(len(k), 0.3))
        data = replace(drawn.data, fixes=fixes, airspeed=air, specs=replace(drawn.data.specs, airspeed=spec))
        for j, use in enumerate((False, True)):
            solution = Loose(airspeed=use).run(data, drawn.initial)
            error[run, j] = rms(truth, solution, "vel_n", 180.0)
        at = solution.extra_names.index("wind_north_m_s")
        off = (solution.extra[-1, at : at + 2] - wind[:2]) / solution.extra_sd[-1, at : at + 2]
        assert np.abs(off).max() < 4.5
    assert stats.ttest_rel(*error.T, alternative="greater").pvalue < 0.001


def test_the_zero_of_a_pitot_tube_counts_as_a_speed(truth):
    """5 Pa at 25 m/s and at 50 m/s: dV = dp / (rho V), with the density of the height of the start."""
    spec = AirspeedSpec("pitot", 10.0, pressure_bias_sd=5.0, white_sd=0.3)
    t, speed = np.array([0.0, 1.0]), np.array([25.0, 50.0])
    record = AirspeedData(t, t, np.ones(2, bool), speed, np.array([0.3, 0.3]))
    rho = 1.225 * (1 - 2.25577e-5 * 2000.0) ** 4.2559  # ISA troposphere
    expected = 0.3**2 + (5.0 / (rho * speed)) ** 2
    assert_allclose(airspeed_variance(record, spec, 2000.0)[:, 0], expected, rtol=0.02)


def test_a_magnetometer_gives_the_heading():
    """Straight flight, heading known to 10 deg at the start: fixes alone leave it, the field finds it."""
    truth = weaving(30.0, straight_from=0.0)
    spec = MagSpec("compass", 10.0, white_sd=2e-7)
    k = np.arange(20, len(truth), 20)
    true_field = field_n(truth.lla[k], 2026.0)
    field_b = np.stack([rotation.matrix(q).T @ m for q, m in zip(truth.q_nb[k], true_field, strict=True)])
    wrong = replace(units(), initial_heading_sd=10 * DEG)
    squares = []
    for run in range(RUNS):
        drawn = sensors.sense(truth, wrong, 13, run)
        noise = 2e-7 * np.random.default_rng(run).normal(size=field_b.shape)
        t, sd_claimed = truth.t[k], np.full(len(k), 2e-7)
        mag = MagData(t, t, np.ones(len(k), bool), field_b + noise, sd_claimed)
        data = replace(drawn.data, mag=mag, date=2026.0, specs=replace(drawn.data.specs, mag=spec))
        without, solution = (Loose(magnetometer=use).run(data, drawn.initial) for use in (False, True))
        series = judge.error_series(truth, solution)
        sd = np.sqrt(solution.cov[-1, 8, 8])
        assert sd < 0.3 * DEG < np.sqrt(without.cov[-1, 8, 8])
        squares.append((series.phi_n[-1, 2] / sd) ** 2)
    assert np.mean(squares) < 26.1 / 8  # chi-square of 8, 99.9 %
    with pytest.raises(ValueError, match="names no mag unit"):
        Loose(magnetometer=True).run(replace(data, specs=drawn.data.specs), drawn.initial)


def test_each_aiding_names_the_record_it_needs():
    assert Loose().needs == ("fixes",)
    assert Tight().needs == ("observations",)
    assert Loose(airspeed=True, magnetometer=True).needs == ("fixes", "airspeed", "mag")
    assert Loose(gnss=False).needs == ("baro",)
    assert Loose(gnss=False, baro=False).needs == ()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"adaptive_noise": 0}, "adaptive_noise = 0 must be at least 1"),
        ({"lever_arm_sd": -1.0}, "lever_arm_sd = -1 must be 0 or more"),
        (
            {"integrity": ["raim"]},
            r"integrity\[0\] = 'raim' must be 'nis', 'trace', 'tolerance' or 'velocity'",
        ),
        ({"integrity": "nis"}, "integrity = 'nis' must be a list"),
        ({"max_acceleration": 0.0}, "max_acceleration = 0 must be positive"),
        ({"standstill": 1}, "standstill = 1 must be true or false"),
    ],
)
def test_a_wrong_option_is_said_in_one_line(options, message):
    with pytest.raises(ValueError, match=message):
        Loose(**options)


def test_all_wrong_options_are_told_at_once():
    with pytest.raises(ValueError, match="spread") as caught:
        Loose(mems=1, spread=0.5, readmit_after_s=-1.0)
    assert str(caught.value).splitlines()[:2] == [
        "readmit_after_s = -1 s must be 0 or more",
        "mems = 1 must be true or false",
    ]


# --- the accuracy of fixes ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["loose-15", "gnss-only", "ukf"])
def test_a_fix_is_weighed_by_the_accuracy_it_reports(truth, name):
    """Fixes with 10 m of noise that say so: the position reported is right; by the datasheet it is not."""
    squares: dict[str, list[float]] = {"datasheet": [], "reported": [], "larger": []}
    for run in range(1 if name == "ukf" else 2):
        drawn = sensors.sense(truth, units(), 14, run)
        fixes, rng = drawn.data.fixes, np.random.default_rng(5 + run)
        lla = earth.displace(fixes.lla, rng.normal(scale=10.0, size=(len(fixes), 3)))
        cov = np.tile(100.0 * np.eye(3), (len(fixes), 1, 1))
        data = replace(
            drawn.data,
            fixes=replace(fixes, lla=lla, cov_pos_n=cov),
            imu=take(drawn.data.imu, drawn.data.imu.t < 60.0),
            output_t=drawn.data.output_t[drawn.data.output_t < 59.0],
        )
        for accuracy, found in squares.items():
            options = {"fix_accuracy": accuracy, "gate_probability": 1e-12}
            solution = load(name, options).run(data, drawn.initial)
            variance = np.einsum("kii->ki", solution.cov)[:, :2]
            late = solution.t > 10.0
            pos_n = judge.error_series(truth, solution).pos_n[:, :2]
            found.append(float(np.nanmean((pos_n**2 / variance)[late])))
    assert np.mean(squares["reported"]) < 3.0
    assert np.mean(squares["datasheet"]) > 4.0 * np.mean(squares["reported"])
    assert squares["larger"] == pytest.approx(squares["reported"], rel=0.2)


def test_a_report_of_nothing_is_the_datasheet(truth):
    """A variance that is zero or not finite is none."""
    data = sensors.sense(truth, units(), 14, 0).data
    gnss = data.specs.gnss
    white = fix_variance(gnss, gnss_markov=False)
    cov = data.fixes.cov_pos_n.copy()
    cov[:, 0, 0], cov[:, 1, 1], cov[:, 2, 2] = 0.0, np.nan, 49.0
    fixes = replace(data.fixes, cov_pos_n=cov)
    reported = weigh_fixes(fixes, gnss, white, "reported")
    assert_allclose(reported[:, :3], [[white[0], white[1], 49.0]] * len(fixes))
    assert_allclose(weigh_fixes(fixes, gnss, white, "larger")[:, 2], max(49.0, white[2]))
    for accuracy in ("datasheet", "auto"):
        assert_array_equal(weigh_fixes(fixes, gnss, white, accuracy), [white] * len(fixes))


def test_slow_errors_that_have_states_count_once_in_a_report(truth):
    """A report of noise and slow errors together is the datasheet's noise; what it says beyond is added."""
    gnss = replace(GNSS, pos_h_markov_sd=1.5, pos_v_markov_sd=2.0, pos_decay_time=600.0)
    fixes = sensors.sense(truth, units(gnss=gnss), 14, 0).data.fixes
    white, total = (fix_variance(gnss, gnss_markov=modeled) for modeled in (True, False))
    assert_allclose(weigh_fixes(fixes, gnss, white, "larger"), [white] * len(fixes), rtol=1e-12)
    more = replace(fixes, cov_pos_n=fixes.cov_pos_n + 7.0 * np.eye(3), cov_vel_n=0.5 * fixes.cov_vel_n)
    beyond = np.array([7.0, 7.0, 7.0, 0.0, 0.0, 0.0])
    for known in (white, total):
        assert_allclose(weigh_fixes(more, gnss, known, "larger"), [known + beyond] * len(fixes), rtol=1e-12)
    sky = replace(gnss, sky=read_profile("gnss-jammed").sensors.gnss.sky)
    assert_allclose(weigh_fixes(more, sky, white, "auto"), [white + beyond] * len(fixes), rtol=1e-12)


def test_satellites_behind_the_wing_make_a_fix_worse_and_the_filter_knows():
    """Circles at 45 deg of bank with a receiver of the level of measurements: by the datasheet mean NIS of
    position is 4, and an IMU of navigation grade turns what the jumps seem to say into attitude."""
    profile = read_profile("gnss-jammed", {"sensors.imu": "hg9900", "evaluation.output_hz": 1.0})
    flown = pipeline.fly(profile)
    circles = first_rows(flown, int(np.searchsorted(flown.t, 90.0)) + 1)
    nis, attitude = {}, {}
    for accuracy in ("datasheet", "auto"):
        one = load("loose-full", {"fix_accuracy": accuracy, "covariance_hz": 20.0})
        found = []
        for run in range(10):
            drawn = sensors.sense(circles, profile.sensors, 4711, run)
            solution = one.run(drawn.data, drawn.initial)
            late = solution.t >= 60.0
            series = judge.error_series(circles, solution)
            squares = np.einsum(
                "mi,mij,mj->m", series.phi_n, np.linalg.inv(solution.cov[:, 6:9, 6:9]), series.phi_n
            )
            rows = of(solution, "gnss_position") & (solution.innovations.t > 45.0)
            found.append((solution.innovations.nis[rows].mean() / 3.0, squares[late].mean()))
        nis[accuracy], attitude[accuracy] = np.transpose(found)
    assert nis["datasheet"].mean() > 2.5
    assert 0.6 < nis["auto"].mean() < 1.5
    gain = np.log(attitude["datasheet"] / attitude["auto"])
    assert stats.ttest_1samp(gain, 0.0, alternative="greater").pvalue < 0.001


@pytest.mark.parametrize("raised", [0.01, 5.0])
def test_fixes_whose_sd_is_raised_pull_less_and_the_claim_is_right(truth, raised):
    """240 RTK fixes of 1 cm in the middle of 480; told as 5 m they change the answer, and with 5 m of noise
    only a filter that reads their report uses them."""
    rtk = replace(units(), gnss=read_profile("figure-eight", {"sensors.gnss": "rtk-fixed"}).sensors.gnss)
    rtk = replace(rtk, assumed=replace(rtk.assumed, gnss=rtk.gnss))
    part = first_rows(truth, int(np.searchsorted(truth.t, 96.0)) + 1)
    drawn = sensors.sense(part, rtk, 14, 0)
    fixes, rng = drawn.data.fixes, np.random.default_rng(8)
    middle = slice(120, 360)
    assert len(fixes) >= 360
    noise = np.zeros((len(fixes), 3))
    noise[middle] = rng.normal(scale=raised, size=(240, 3)) if raised > 1.0 else 0.0
    cov = fixes.cov_pos_n.copy()
    cov[middle] = raised**2 * np.eye(3)
    data = replace(drawn.data, fixes=replace(fixes, lla=earth.displace(fixes.lla, noise), cov_pos_n=cov))
    found, used = {}, {}
    for accuracy in ("datasheet", "reported"):
        options = {"fix_accuracy": accuracy, "gate_probability": 1e-12}
        solution = load("loose-15", options).run(data, drawn.initial)
        errors = judge.error_series(part, solution)
        inside = (errors.t > 40.0) & (errors.t < fixes.t[359])
        table = solution.innovations
        noisy = of(solution, "gnss_position") & (table.t > fixes.t[121]) & (table.t < fixes.t[359])
        used[accuracy] = np.mean(table.accepted[noisy])
        variance = np.einsum("kii->ki", solution.cov)[inside, :2]
        found[accuracy] = errors.pos_n[inside, :2], variance
    (blind, claimed), (told, honest) = found["datasheet"], found["reported"]
    if raised > 1.0:
        assert used["datasheet"] < 0.1  # 500 times as noisy as it says: left out
        assert used["reported"] > 0.99
        assert max(np.mean(told**2 / honest), np.mean(blind**2 / claimed)) < 4.0
    else:  # what is reported is what the datasheet says
        np.testing.assert_allclose(honest, claimed, rtol=0.1)


@pytest.mark.parametrize("there", [False, True])
def test_an_instrument_that_is_asked_for_and_not_there_is_told(there):
    mag = MagSpec("mag", 10.0, 2e-7) if there else None
    spec = replace(units(), mag=mag, assumed=replace(units().assumed, mag=mag))
    drawn = sensors.sense(weaving(5.0, rate=50.0), spec, 1, 0)
    told = Loose(magnetometer=True, radar=True).run(drawn.data, drawn.initial).events.select("aiding")
    absent = ["radar"] if there else ["magnetometer", "radar"]
    assert [text for *_, text in told] == [
        f"{name}: asked for, but the record holds nothing for it" for name in absent
    ]
