"""Far from the usual: a day at rest, next to the pole, below the sea, at 40 km, over date line and equator.

Matched sensors on truths by formula. No filter of these has a wrong claim, and no covariance breaks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import BUILT_IN, load
from bench.simulation import sensors
from tests.builders import at_rest, band, steered
from tests.navigation.test_alignment import FINE
from tests.navigation.test_tight import MATCHED
from tests.weaving import BARO, DEG, GNSS, IMU, units


def weave(t):
    return 2 * DEG * np.sin(2 * np.pi * t / 60)


def move(lat_deg, lon_deg, alt, heading_deg, speed):
    return lambda: steered(
        300.0, 20.0, (lat_deg * DEG, lon_deg * DEG, alt), heading_deg * DEG, speed, turn=weave
    )


PLACES = {
    "at rest 1.1 km from the pole": lambda: at_rest(300.0, 10.0, (89.99 * DEG, 0.3, 300.0), 0.02, 0.05, 1.2),
    "east 11 km from the pole": move(89.9, 17.0, 300.0, 90.0, 60.0),
    "north 6 km from the south pole": move(-89.95, 17.0, 3000.0, 5.0, 15.0),
    "500 m below the ellipsoid": move(31.0, 35.0, -500.0, 60.0, 60.0),
    "40 km high": move(31.0, 35.0, 40e3, 60.0, 250.0),
    "east over date line and equator": move(-0.1, 179.9, 9e3, 60.0, 250.0),
    "west over date line and equator": move(0.1, -179.9, 9e3, 240.0, 250.0),
}


def honest(estimator, truth, spec, draws, options=None):
    """Assert that the NEES over runs is in its band at four epochs, and P positive definite throughout.

    Return the last solution.
    """
    nees = []
    for draw in range(draws):
        sensed = sensors.sense(truth, spec, 11, draw)
        solution = load(estimator, options or {}).run(sensed.data, sensed.initial)
        assert_positive_definite(solution)
        assert solution.innovations.accepted.mean() > 0.995  # one in 1e5 is rejected by chance
        errors = error_series(truth, solution)
        nees.append(errors.nees)
    low, high = band(draws, errors.states)
    instants = (np.linspace(0.25, 1.0, 4) * (len(nees[0]) - 1)).astype(int)
    late = np.mean(nees, axis=0)[instants]
    assert (low < late).all(), late
    assert (late < high).all(), late
    return solution


def assert_positive_definite(solution):
    cov = solution.cov
    given = ~np.isnan(np.einsum("kii->ki", cov)).all(axis=0)
    cov = cov[:, given][:, :, given]
    assert np.isfinite(cov).all()
    sd = np.sqrt(np.einsum("kii->ki", cov))
    np.linalg.cholesky(cov / sd[:, :, None] / sd[:, None, :])  # raises if it is not


@pytest.mark.parametrize(
    "estimator",
    [
        "loose-15",
        "gnss-only",
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ("loose-22", "loose-mems", "loose-full", "tight", "smoother", "ukf", "classic-22")
        ),
    ],
)
@pytest.mark.parametrize("place", PLACES)
def test_no_wrong_claim_anywhere(place, estimator):
    spec = replace(units(gnss=MATCHED if estimator == "tight" else GNSS), output_rate=0.5)
    honest(estimator, PLACES[place](), spec, draws=6)


@pytest.mark.parametrize("estimator", sorted(BUILT_IN))
def test_every_covariance_stays_positive_definite_next_to_the_pole(estimator):
    truth = steered(20.0, 20.0, (89.99 * DEG, 179.99 * DEG, 40e3), 90 * DEG, 20.0, turn=weave)
    spec = replace(units(gnss=MATCHED if estimator == "tight" else GNSS), output_rate=1.0)
    sensed = sensors.sense(truth, spec, 11, 0)
    assert_positive_definite(load(estimator, {}).run(sensed.data, sensed.initial))


@pytest.mark.parametrize(
    "estimator",
    [
        "loose-15",
        "loose-22",
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ("loose-full", "smoother", "gnss-only", "ukf", "classic-22")
        ),
    ],
)
def test_a_day_at_rest(estimator):
    """Tactical grade, IMU at 1 Hz, a fix every 10 s."""
    truth = at_rest(86400.0, 1.0, (47 * DEG, 0.3, 300.0), 0.02, 0.05, 1.2)
    seldom = units(FINE, replace(GNSS, rate=0.1), replace(BARO, rate=0.1))
    spec = replace(seldom, initial_heading_sd=0.5 * DEG, output_rate=1 / 600)
    honest(estimator, truth, spec, draws=4, options={"covariance_hz": 0.1} if estimator == "ukf" else None)


@pytest.mark.parametrize(
    ("estimator", "hours"),
    [
        ("loose-15", 24.0),
        ("smoother", 8.0),
        *(
            pytest.param(name, 24.0, marks=pytest.mark.long)
            for name in ("loose-22", "loose-mems", "loose-full", "tight", "smoother")
        ),
    ],
)
def test_a_day_at_rest_of_a_mems_unit(estimator, hours):
    """Its heading is lost within two hours, and nothing tells it; a linear filter has an NEES of 900.

    A smoother whose transition keeps the heading that is lost has negative variances, one that leaves out the
    arm of the antenna an NEES of 15 to 20.
    """
    truth = at_rest(hours * 3600.0, 1.0, (47 * DEG, 0.3, 300.0), 0.02, 0.05, 1.2)
    gnss = replace(MATCHED if estimator == "tight" else GNSS, rate=0.1)
    spec = replace(units(IMU, gnss, replace(BARO, rate=0.1)), output_rate=1 / 600)
    solution = honest(estimator, truth, spec, draws=4)
    assert (np.sqrt(solution.cov[solution.t > 7200.0, 8, 8]) > 90 * DEG).all()


def free_drift(part, estimator):
    """Mean NEES after 10 minutes without aiding, all errors ``part`` of those of a MEMS unit."""
    gyro, accel = (
        replace(t, **{name: part * getattr(t, name) for name in ("random_walk", "turn_on_bias_sd")})
        for t in (replace(t, bias_instability=0.0) for t in (IMU.gyro, IMU.accel))
    )
    unit = replace(IMU, gyro=gyro, accel=accel)
    spec = replace(
        units(unit), output_rate=0.1, initial_vel_sd=(0.05 * part,) * 3, initial_tilt_sd=0.5 * DEG * part,
        initial_heading_sd=2 * DEG * part,
    )  # fmt: skip
    truth = at_rest(600.0, 20.0, (47 * DEG, 0.3, 300.0), 0.0, 0.05, 1.4)
    nees = []
    for draw in range(8):
        sensed = sensors.sense(truth, spec, 11, draw)
        built = load(estimator, {})
        nees.append(error_series(truth, built.run(sensed.data, sensed.initial)).nees[-1])
    return np.mean(nees), built.unmodeled_errors(spec.assumed)


@pytest.mark.parametrize("estimator", ["free-inertial", "baro-inertial"])
def test_what_free_drift_leaves_out_is_of_second_order_and_said(estimator):
    """A thirtieth of the errors: consistent. All of them: tilts of degrees bend the drift, with a remark."""
    low, high = band(8, 9)
    small, words = free_drift(1 / 30, estimator)
    assert low < small < high
    assert words == ()
    large, words = free_drift(1.0, estimator)
    assert large > 30 * high
    assert words == ("nonlinear drift from a tilt of degrees",)


@pytest.mark.parametrize(("estimator", "said"), [("free-inertial", 1), ("baro-inertial", 1), ("loose-15", 0)])
def test_a_free_drift_by_gyros_of_two_degrees_an_hour_is_linear(estimator, said):
    for bias, count in ((1.9, 0), (2.1, said)):
        gyro = replace(IMU.gyro, turn_on_bias_sd=bias * DEG / 3600.0)
        specs = replace(units().assumed, imu=replace(IMU, gyro=gyro))
        assert len(load(estimator, {}).unmodeled_errors(specs)) == count
