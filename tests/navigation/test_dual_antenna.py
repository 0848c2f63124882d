"""The heading of two antennas: what it measures, what a filter makes of it, and what a false one does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from bench.core.mathematics import rotation
from bench.core.records.instruments import HeadingSpec
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.metrics.case import bias_errors
from bench.io.config.fault_tables import read_faults
from bench.navigation.built_in import load
from bench.simulation import sensors
from bench.simulation.sensors import dual_antenna
from bench.simulation.sensors.draws import SensorDraws
from tests.builders import ensemble, put
from tests.synthetic import still, turning
from tests.weaving import DEG, units, weaving

EXACT = HeadingSpec("exact", rate=10.0, white_sd=0.0)
ANTENNAS = HeadingSpec(
    "two", 5.0, white_sd=0.2 * DEG, wander_sd=0.1 * DEG, wander_time=20.0, bias_sd=0.5 * DEG
)


@pytest.fixture(scope="module")
def truth():
    return weaving(60.0, rate=50.0)


def on_board(spec=ANTENNAS, assumed=ANTENNAS, **more):
    whole = replace(units(), heading=spec, initial_heading_sd=5 * DEG, **more)
    return replace(whole, assumed=replace(whole.assumed, heading=assumed))


def test_without_errors_it_reads_the_direction_of_the_nose():
    turn = turning(100.0, 100.0)
    record, parts = dual_antenna.measure(turn, EXACT, SensorDraws(1, 0))
    rows = np.searchsorted(turn.t, record.t - 1e-6)
    off = record.heading - rotation.to_euler(turn.q_nb[rows])[2]
    assert_allclose(np.arctan2(np.sin(off), np.cos(off)), 0.0, atol=1e-12)
    assert (np.abs(record.heading) <= np.pi + 1e-12).all()
    assert np.ptp(record.heading) > 6.0
    assert record.valid.all()
    assert not parts.any()


def test_a_steep_line_is_flagged_and_readings_are_late():
    turn = turning(20.0, 100.0)
    pitch = np.linspace(0.0, 1.4, len(turn.t))
    steep = replace(turn, q_nb=rotation.from_euler(np.zeros_like(pitch), pitch, np.ones_like(pitch)))
    record, _ = dual_antenna.measure(steep, replace(EXACT, max_slope=1.0, latency=0.1), SensorDraws(1, 0))
    rows = np.searchsorted(turn.t, record.t - 1e-6)
    assert_array_equal(record.valid, pitch[rows] <= 1.0)
    assert 0.6 < record.valid.mean() < 0.8
    assert_allclose(record.t_arrival - record.t, 0.1, atol=1e-12)


def test_its_errors_have_the_sizes_and_the_correlation_of_the_datasheet():
    """Bands of 99.9 %, 3.29 standard errors: of a mean of squares, and of a correlation e^-1."""
    turn = turning(30.0, 20.0)
    bias_only = replace(EXACT, bias_sd=0.01)
    drawn = np.array(
        [dual_antenna.measure(turn, bias_only, SensorDraws(1, run))[1][:, 0] for run in range(400)]
    )
    assert not np.ptp(drawn, axis=1).any()
    assert abs(np.mean(drawn[:, 0] ** 2) / 1e-4 - 1.0) < 3.29 * np.sqrt(2 / 400)
    wander = replace(EXACT, wander_sd=0.01, wander_time=5.0)
    drawn = np.array([dual_antenna.measure(turn, wander, SensorDraws(1, run))[1][:, 1] for run in range(400)])
    first, later = drawn[:, 0], drawn[:, 50]  # one correlation time apart
    assert abs(np.mean(later**2) / 1e-4 - 1.0) < 3.29 * np.sqrt(2 / 400)
    assert abs(np.mean(first * later) / 1e-4 - np.exp(-1.0)) < 3.29 * np.sqrt((1 + np.exp(-2.0)) / 400)
    record, parts = dual_antenna.measure(turn, replace(EXACT, white_sd=0.02), SensorDraws(1, 0))
    off = record.heading - rotation.to_euler(turn.q_nb[np.searchsorted(turn.t, record.t - 1e-6)])[2]
    white = np.arctan2(np.sin(off), np.cos(off)) - parts.sum(axis=1)
    assert abs(np.mean(white**2) / 4e-4 - 1.0) < 3.29 * np.sqrt(2 / len(white))


@pytest.mark.parametrize("use", ["loose-15", "loose-full"])
def test_nis_is_in_its_band_and_leaves_it_with_more_noise(truth, use):
    """99.9 % band over four runs; noise 1.4 times that of the datasheet leaves it."""
    for noisier, inside in ((1.0, True), (1.4, False)):
        spec = on_board(replace(ANTENNAS, white_sd=noisier * ANTENNAS.white_sd))

        def draw(run, spec=spec):
            drawn = sensors.sense(truth, spec, 3, run)
            told = put(
                drawn.data.heading, slice(None), sd=np.full(len(drawn.data.heading), ANTENNAS.white_sd)
            )
            return replace(drawn, data=replace(drawn.data, heading=told))

        found = ensemble(load(use, {"heading": True}), truth, draw, 4, 10.0)
        band = found.pooled_nis()["heading"]
        assert (band.low <= band.mean <= band.high) == inside, noisier


@pytest.mark.parametrize(
    ("use", "options", "runs"), [("loose-15", {}, 16), ("ukf", {"covariance_hz": 2.0}, 1)]
)
def test_heading_and_offset_are_as_claimed_and_better_than_without(truth, use, options, runs):
    """Squared errors by their covariance stay below chi-squared, 99.9 %."""
    heading, offset, ratio = 0.0, 0.0, []
    for run in range(runs):
        drawn = sensors.sense(truth, on_board(), 5, run)
        solution = load(use, {"heading": True, **options}).run(drawn.data, drawn.initial)
        heading += error_series(truth, solution).phi_n[-1, 2] ** 2 / solution.cov[-1, 8, 8]
        bias = solution.extra_names.index("heading_bias_rad")
        true = drawn.truth.bias["heading"][0, 0]
        offset += ((solution.extra[-1, bias] - true) / solution.extra_sd[-1, bias]) ** 2
        plain = load(use, options).run(drawn.data, drawn.initial)
        ratio.append(solution.cov[-1, 8, 8] / plain.cov[-1, 8, 8])
        assert solution.extra_sd[-1, bias] < solution.extra_sd[0, bias]
    assert heading < stats.chi2.isf(0.001, runs)
    assert offset < stats.chi2.isf(0.001, runs)
    assert np.mean(ratio) < 0.8


def test_told_of_no_offset_a_filter_is_wrong_by_it(truth):
    """The same records; without the states the heading is off by the offset, and says nothing of it."""
    blind = replace(ANTENNAS, wander_sd=0.0, bias_sd=0.0)
    found = 0.0
    for run in range(6):
        drawn = sensors.sense(truth, on_board(assumed=blind), 5, run)
        solution = load("loose-15", {"heading": True}).run(drawn.data, drawn.initial)
        found += error_series(truth, solution).phi_n[-1, 2] ** 2 / solution.cov[-1, 8, 8]
    assert found > 5 * stats.chi2.isf(0.001, 6)


def test_a_heading_is_told_at_rest_where_nothing_else_tells_it():
    """Two antennas tell the heading of an aircraft that stands; the fixes do not."""
    truth = still(20.0, 50.0)
    spec = replace(on_board(), initial_heading_sd=10 * DEG)
    drawn = sensors.sense(truth, spec, 2, 0)
    for use in (True, False):
        solution = load("loose-15", {"heading": use}).run(drawn.data, drawn.initial)
        assert (np.sqrt(solution.cov[-1, 8, 8]) < 1 * DEG) == use
    off = error_series(truth, load("loose-15", {"heading": True}).run(drawn.data, drawn.initial)).phi_n[-1, 2]
    assert abs(off) < 3.29 * np.hypot(ANTENNAS.bias_sd, ANTENNAS.wander_sd)


def test_a_wrong_ambiguity_is_refused_and_told(truth):
    """A step of 10 deg for 8 s: every reading in it is rejected, and the heading stays as good as it was."""
    (fault,) = read_faults([{"kind": "heading-step", "start_s": 30.0, "duration_s": 8.0, "step_deg": 10.0}])
    spec = on_board(faults=(fault,))
    drawn = sensors.sense(truth, spec, 5, 0)
    solution = load("loose-15", {"heading": True}).run(drawn.data, drawn.initial)
    table = solution.innovations
    here = (table.code == table.sensor.index("heading")) & (table.t >= 30.0 - 1e-6) & (table.t < 38.0 - 1e-6)
    assert here.sum() == 40
    assert not table.accepted[here].any()
    assert np.abs(error_series(truth, solution).phi_n[:, 2][solution.t > 25.0]).max() < 1.5 * DEG
    told = solution.events
    assert any(k == "refused" and "heading" in w for k, w in zip(told.kind, told.text, strict=True))


def test_the_state_of_the_offset_is_judged_by_the_offset(truth):
    """Multipath as large as the offset has a state of its own: it is no error of the offset."""
    spec = replace(ANTENNAS, wander_sd=ANTENNAS.bias_sd)
    found = 0.0
    for run in range(6):
        drawn = sensors.sense(truth, on_board(spec, spec), 5, run)
        solution = load("loose-15", {"heading": True}).run(drawn.data, drawn.initial)
        one = bias_errors(solution, drawn.truth)["heading_bias"]
        found += (one.error[-1] / one.sd[-1]) ** 2
    assert found < stats.chi2.isf(0.001, 6)
