"""Vehicles on wheels and coordinated flight in the compiled filters: H, consistency, use, defects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from bench.core.mathematics import rotation
from bench.core.records.instruments import AirspeedSpec, OdometerSpec
from bench.evaluation.consistency import chi_square
from bench.evaluation.errors.error_series import error_series
from bench.navigation.error_state_filter import measurement_rows, propagation
from bench.navigation.error_state_filter.error_state import feedback_kernel
from bench.navigation.error_state_filter.state_blocks import chosen_blocks, state_model
from bench.navigation.models.loose_tight import Loose
from bench.navigation.options import FusionOptions
from bench.simulation import sensors
from tests.builders import band
from tests.navigation.test_error_state import plain
from tests.rolling import rolling
from tests.weaving import IMU, units, weaving

SHAKEN = replace(
    IMU,
    gyro=replace(IMU.gyro, random_walk=20 * IMU.gyro.random_walk),
    accel=replace(IMU.accel, random_walk=20 * IMU.accel.random_walk),
)
RUNS, LOST, END = 12, 35.0, 60.0


AIRSPEED = AirspeedSpec("pitot", 10.0, white_sd=0.3)
ROWS = {
    "wheels": measurement_rows.VEHICLE_ROWS,
    "odometer": measurement_rows.ODOMETER_ROWS,
    "wings": measurement_rows.VEHICLE_ROWS,
}


def predict(kind, state, index, values):
    """Predicted less measured, with whole vectors and matrices."""
    air = np.zeros(3)
    if index.gust_n >= 0:
        air = state[index.gust_n + 1 : index.gust_n + 4].copy()
        air[:2] += state[index.wind_north + 1 : index.wind_north + 3]
    if kind == "airspeed":
        return [np.linalg.norm(state[3:6] - air) - values[0]]
    axle = state[index.axle_b + 1 : index.axle_b + 4] if index.axle_b >= 0 else np.zeros(3)
    u = rotation.matrix(state[6:10]).T @ (state[3:6] - air) + np.cross(values[:3] - state[10:13], axle)
    push, side = (0.0, 0.0) if kind == "odometer" else values[6:8]
    yaw, pitch, slip_yaw, slip_pitch, by_force = state[index.axis_yaw + 1 : index.axis_yaw + 6]
    axes = rotation.from_euler(0.0, pitch + slip_pitch + by_force * push, yaw + slip_yaw * (1 + abs(side)))
    along = rotation.matrix(axes).T @ u
    if kind == "odometer":
        return [(1.0 + state[index.odometer_scale + 1]) * along[0] - values[0]]
    return along[1:]


@pytest.mark.parametrize("kind", [*ROWS, "airspeed"])
def test_the_rows_of_h_are_the_derivatives_of_the_prediction(kind):
    """Central differences in every error state: turned axes, far axle, slip, wind, a turn."""
    spec = replace(
        units(), odometer=OdometerSpec("wheel", 10.0, 0.05, scale_factor_sd=0.02), airspeed=AIRSPEED
    )
    spec = replace(spec, assumed=replace(spec.assumed, odometer=spec.odometer, airspeed=AIRSPEED))
    options = FusionOptions(nonholonomic=True, odometer=True, axle_b=(-1.2, 0.4, 1.5))
    if flying := kind in ("wings", "airspeed"):
        options = FusionOptions(coordinated=True, airspeed=True, alpha_deg=5.0)
    sensed = sensors.sense(rolling(0, 2.0), units(), 1, 0)
    model = state_model(sensed.initial, spec.assumed, chosen_blocks(options))
    n, index = model.layout.size, model.index
    state = np.concatenate([np.zeros(10), model.values[9:]])
    if flying:
        assert_allclose(state[index.axis_yaw + 2], -np.deg2rad(options.alpha_deg))
        state[index.gust_n + 1 : index.gust_n + 4] = [1.0, -2.0, 0.5]
        state[index.wind_north + 1 : index.wind_north + 3] = [3.0, 4.0]
    else:
        assert_allclose(state[index.axle_b + 1 : index.axle_b + 4], options.axle_b)
    state[:3], state[3:6] = sensed.initial.lla, [11.0, -7.0, 1.0]
    state[6:10] = rotation.from_euler(0.1, -0.2, 1.1)
    state[10:13] = [1e-3, -2e-3, 3e-3]
    state[index.axis_yaw + 1 : index.axis_yaw + 6] = [0.2, -0.3, 0.05, -0.04, 0.006]
    values = np.array([[0.1, -0.2, 0.4, 0.5, 0.3, -9.7, 2.0, -1.5]])
    aid = propagation.Measurements(values, np.ones((1, 6)), np.zeros(3), np.zeros((4, 3)), np.zeros(3))

    def measure(error):
        moved, back = state.copy(), -error
        feedback_kernel(moved, back)  # takes an error out: here it puts one in
        pending = propagation.Pending(
            np.zeros((6, n)), np.zeros(6), np.zeros(6), np.zeros((6, 4), np.int64), np.zeros(1, np.int64), 6
        )
        work = propagation.work_for(n, model.process.drives).measure
        work.last[0] = values[0, :3] - moved[10:13]
        belief = propagation.FilterState(moved, model.P.copy(), np.zeros(n))
        code = ROWS.get(kind, measurement_rows.AIRSPEED_ROWS)
        rows = plain(measurement_rows.ROWS[code])(0, 0, propagation.Site(belief, aid, index, pending, work))
        assert rows == (2 if code == measurement_rows.VEHICLE_ROWS else 1)
        return pending.z[:rows].copy(), pending.H[:rows].copy()

    z, H = measure(np.zeros(n))
    assert_allclose(z, predict(kind, state, index, values[0]), rtol=1e-9)
    step = 1e-5
    differences = [(measure(step * e)[0] - measure(-step * e)[0]) / (2 * step) for e in np.eye(n)]
    assert_allclose(H, np.transpose(differences), rtol=1e-6, atol=1e-6)
    assert (np.count_nonzero(H, axis=1) >= 8).all()


def drive(slip: float, **options):
    """NIS of the constraint; NEES and horizontal error after an outage; a noisy IMU, drives by seed."""
    spec = replace(units(SHAKEN), gnss_outages=((LOST, END + 1.0),))
    nis, dof, nees, drift = [], [], [], []
    for seed in range(RUNS):
        truth = rolling(seed, END, slip=slip)
        sensed = sensors.sense(truth, spec, 5, seed)
        solution = Loose(**options).run(sensed.data, sensed.initial)
        errors = error_series(truth, solution)
        nees.append(errors.nees[-1])
        drift.append(float(np.hypot(*errors.pos_n[-1, :2])))
        if "nonholonomic" in (found := chi_square.nis_by_sensor(solution.innovations, 15.0)):
            nis.append(found["nonholonomic"].nis)
            dof.append(found["nonholonomic"].dof)
    return nis, dof, np.array(nees), np.array(drift)


def test_it_is_consistent_on_roads_of_its_model_and_slows_the_drift():
    """NIS and NEES in their 99.9 % bands; 25 s without GNSS drift less than without the constraint."""
    nis, dof, nees, drift = drive(1.0, nonholonomic=True)
    found = chi_square.mean_nis(np.concatenate(nis), np.concatenate(dof))
    assert found.low <= found.mean <= found.high
    low, high = band(RUNS, 9)
    assert low <= nees.mean() <= high
    *_, free = drive(1.0)
    assert stats.wilcoxon(free, drift, alternative="greater").pvalue < 0.01


def test_slip_beyond_its_claim_shows():
    nis, dof, _, _ = drive(2.0, nonholonomic=True)
    found = chi_square.mean_nis(np.concatenate(nis), np.concatenate(dof))
    assert found.mean > found.high


def test_coordinated_flight_claims_less_drift_and_is_right_and_a_wrong_angle_of_attack_shows():
    """Eight runs in a wind of 6 m/s, 80 s without GNSS: NEES in its 99.9 % band, a smaller covariance."""
    truth = weaving(120.0, rate=50.0, wind_n=[4.0, -4.5, 0.0])
    rough = replace(SHAKEN, gyro=replace(SHAKEN.gyro, random_walk=5 * SHAKEN.gyro.random_walk))
    spec = replace(units(rough), gnss_outages=((40.0, 121.0),))

    def fly(run, **options):
        sensed = sensors.sense(truth, spec, 5, run)
        return Loose(**options).run(sensed.data, sensed.initial)

    free = fly(0)
    flown = [fly(run, coordinated=True, alpha_deg=0.0) for run in range(8)]
    for solution in flown:
        assert np.trace(solution.cov[-1, :2, :2]) < 0.6 * np.trace(free.cov[-1, :2, :2])
    low, high = band(8, 9)
    assert low <= np.mean([error_series(truth, solution).nees[-1] for solution in flown]) <= high

    def nis(alpha):
        solution = fly(0, coordinated=True, alpha_deg=alpha, alpha_sd_deg=0.3, gust_sd=0.5)
        series = chi_square.nis_by_sensor(solution.innovations, 0.0)["coordinated"]
        return chi_square.mean_nis(series.nis, series.dof)

    assert nis(0.0).mean < nis(0.0).high
    assert nis(15.0).mean > nis(15.0).high
