"""Radar altimeter and odometer in the compiled filters: their H, their consistency, their use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from bench.core.mathematics import rotation
from bench.core.records.instruments import OdometerSpec, RadarSpec
from bench.evaluation.errors.error_series import error_series
from bench.navigation.error_state_filter import measurement_rows, propagation
from bench.navigation.error_state_filter.error_state import feedback_kernel
from bench.navigation.error_state_filter.state_blocks import chosen_blocks, state_model
from bench.navigation.models.loose_tight import Loose, Tight
from bench.navigation.options import FusionOptions
from bench.simulation import sensors
from tests.builders import ensemble
from tests.navigation.test_error_state import plain
from tests.weaving import units, weaving

RADAR = RadarSpec("radar", 10.0, white_sd=0.3, range=2000.0, bias_sd=0.5)
WHEEL = OdometerSpec("wheel", 10.0, white_sd=0.05, scale_factor_sd=0.02)
GROUND = 700.0


@pytest.fixture(scope="module")
def truth():
    return weaving(60.0, rate=100.0)


def on_board(**more):
    spec = replace(units(), ground_alt=GROUND, **more)
    return replace(spec, assumed=replace(spec.assumed, **more))


@pytest.mark.parametrize("kind", ["radar", "odometer"])
def test_the_row_of_h_is_the_derivative_of_the_prediction(truth, kind):
    """Central differences of predicted less measured in every error state, at a banked, pitched attitude."""
    spec = on_board(radar=RADAR, odometer=WHEEL)
    sensed = sensors.sense(truth, spec, 1, 0)
    options = FusionOptions(radar=True, odometer=True)
    model = state_model(sensed.initial, spec.assumed, chosen_blocks(options))
    n = model.layout.size
    state = np.zeros(n + 1)
    state[:3], state[3:6] = truth.lla[0], [21.0, -13.0, 2.0]
    state[6:10] = rotation.from_euler(0.4, -0.2, 1.1)
    state[model.index.radar_bias + 1], state[model.index.odometer_scale + 1] = 0.7, 0.03
    aid = propagation.Measurements(
        np.full((1, 6), 3.0), np.ones((1, 6)), np.zeros(3), np.zeros((4, 3)), np.zeros(3)
    )
    code = measurement_rows.RADAR_ROWS if kind == "radar" else measurement_rows.ODOMETER_ROWS

    def row(error):
        moved, back = state.copy(), -error
        feedback_kernel(moved, back)  # takes an error out: here it puts one in
        pending = propagation.Pending(
            np.zeros((6, n)), np.zeros(6), np.zeros(6), np.zeros((6, 4), np.int64), np.zeros(1, np.int64), 6
        )
        belief = propagation.FilterState(moved, model.P.copy(), np.zeros(n))
        work = propagation.work_for(n, model.process.drives).measure
        made = plain(measurement_rows.ROWS[code])(
            0, 0, propagation.Site(belief, aid, model.index, pending, work)
        )
        assert made == 1
        return pending.z[0], pending.H[0].copy()

    _, H = row(np.zeros(n))
    step = 1e-5
    differences = [(row(step * e)[0] - row(-step * e)[0]) / (2 * step) for e in np.eye(n)]
    assert_allclose(H, differences, rtol=1e-6, atol=1e-6)
    assert np.count_nonzero(H) >= 2


@pytest.mark.parametrize("estimator", [Loose, Tight])
def test_a_matched_filter_is_consistent_and_finds_bias_and_scale_factor(truth, estimator):
    """NIS in its 99.9 % band over four runs; noise 1.4 times that of the datasheet leaves it."""
    spec = on_board(radar=RADAR, odometer=WHEEL)
    spec = replace(spec, gnss=None, assumed=replace(spec.assumed, gnss=None)) if estimator is Tight else spec
    options = {"radar": True, "odometer": True}
    options |= {"gnss": False} if estimator is Tight else {}
    for noisier, inside in ((1.0, True), (1.4, False)):
        flown = replace(
            spec,
            radar=replace(RADAR, white_sd=noisier * RADAR.white_sd),
            odometer=replace(WHEEL, white_sd=noisier * WHEEL.white_sd),
        )
        found = ensemble(
            estimator(**options), truth, lambda run, flown=flown: sensors.sense(truth, flown, 3, run), 4, 10.0
        )
        for sensor in ("radar", "odometer"):
            band = found.pooled_nis()[sensor]
            assert (band.low <= band.mean <= band.high) == inside, sensor
    sensed = sensors.sense(truth, spec, 3, 0)
    solution = estimator(**options).run(sensed.data, sensed.initial)
    forward = rotation.rotate(rotation.conjugate(truth.q_nb), truth.vel_n)[:, 0]
    scale = sensed.truth.bias["odometer"][-1, 0] / forward[-1]
    for name, true in (("radar_bias_m", sensed.truth.bias["radar"][-1, 0]), ("odometer_scale_1", scale)):
        at = solution.extra_names.index(name)
        assert abs(solution.extra[-1, at] - true) < 3.29 * solution.extra_sd[-1, at]
        assert solution.extra_sd[-1, at] < solution.extra_sd[0, at]


def test_an_odometer_slows_the_drift_without_gnss(truth):
    """Eight runs, GNSS lost after 20 s: the horizontal drift at 60 s is smaller with the wheel."""
    spec = replace(on_board(odometer=WHEEL), gnss_outages=((20.0, 60.1),))
    drift = np.zeros((8, 2))
    for run in range(8):
        sensed = sensors.sense(truth, spec, 5, run)
        for k, use in enumerate((False, True)):
            solution = Loose(odometer=use).run(sensed.data, sensed.initial)
            drift[run, k] = np.hypot(*error_series(truth, solution).pos_n[-1, :2])
    assert stats.wilcoxon(*drift.T, alternative="greater").pvalue < 0.01


def test_a_filter_that_asks_for_them_needs_them_and_names_what_it_leaves_out():
    assert Loose(radar=True, odometer=True).needs == ("fixes", "radar", "odometer")
    spec = on_board(
        radar=replace(RADAR, quantization=0.1), odometer=replace(WHEEL, quantization=0.01)
    ).assumed
    assert not any("radar" in text or "odometer" in text for text in Loose().unmodeled_errors(spec))
    left_out = Loose(radar=True, odometer=True).unmodeled_errors(spec)
    assert {"radar altimeter quantization", "odometer quantization"} <= set(left_out)
    assert not {"radar altimeter bias", "odometer scale factor"} & set(left_out)
