"""Drift without GNSS: measured against the covariance, the closed form and the tables of the register."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import bench
from bench.errors import ConfigError
from bench.studies.linear_flight import GRADES, LOST, LinearFlight

ALONE = {  # section 4, outage s: accelerometer m, gyro m, of the bias of each grade alone
    ("grade-1", 60): (0.18, 0.01),
    ("grade-1", 300): (4.4, 1.06),
    ("grade-1", 600): (16.9, 8.3),
    ("grade-2", 300): (21.8, 2.1),
    ("grade-2", 600): (84, 16.6),
    ("grade-3", 300): (43.6, 21.2),
    ("grade-3", 600): (169, 166),
}
DRAWS = 12


@pytest.fixture(scope="module")
def matched():
    """A unit and a receiver whose every error the filter models."""
    return bench.study(
        "outages", units="matched-mems", phases="straight", outages_s="60,300,600", gnss="matched-white",
        estimator="loose-15", draws=DRAWS, jobs=1,
    )  # fmt: skip


@pytest.mark.slow
def test_47_monte_carlo_lies_in_the_band_of_the_covariance(matched):
    """The squares of a matched filter over its variance: chi-square, of one to two axes for each draw.

    A claim of half the size leaves the 99.9 % band.
    """
    columns = {name: np.array(values) for name, values in matched.tables["claims"].columns.items()}
    ratio = np.square(columns["error_m"] / columns["claimed_m"])
    low, high = stats.chi2.ppf([0.0005, 0.9995], DRAWS) / DRAWS
    assert ((low < ratio) & (ratio < high)).all(), ratio
    assert (4.0 * ratio > high).all()
    assert (columns["low_m"] < columns["error_m"]).all()
    assert (columns["error_m"] < columns["high_m"]).all()


@pytest.mark.slow
def test_47_the_biases_of_the_grades_alone(matched):
    """A-2.4.4 and A-2.4.7, and the growth of the covariances that stand in section 7.1."""
    table = matched.tables["grades"].columns
    rows = list(zip(*table.values(), strict=True))
    for (grade, outage), printed in ALONE.items():
        found = next(row for row in rows if row[:3] == (grade, "straight", outage))
        for value, one in zip(found[4:], printed, strict=True):
            digits = len(f"{one}".replace(".", "").strip("0"))
            assert float(f"{value:.{digits}g}") == pytest.approx(one, rel=0.5 * 10.0 ** -(digits - 1))
    grown = {row[:3]: row[3] for row in rows}
    assert grown["MEMS", "s-turns", 300.0] == pytest.approx(227.0, rel=0.02)
    assert grown["grade-3", "s-turns", 300.0] == pytest.approx(27.5, rel=0.02)


def test_a_climb_drifts_as_straight_flight_and_a_steady_turn_less():
    """A bias that turns with the aircraft cancels over the circle of 240 s."""
    straight, turn, climb = (
        LinearFlight(phase).predict_sd(GRADES["MEMS"], LOST + 300)[-1, 0]
        for phase in ("straight", "turn", "climb")
    )
    assert climb == pytest.approx(straight, rel=0.02)
    assert turn < 0.5 * straight


@pytest.mark.parametrize(
    ("given", "message"),
    [({"units": "stim"}, "'stim' is no IMU of the catalog"), ({"phases": "loop"}, "must be one of straight")],
)
def test_a_wrong_name_is_one_line(given, message):
    with pytest.raises(ConfigError, match=message):
        bench.study("outages", **given)
