"""Tight coupling: H is the Jacobian of what satellites measure, the filter is consistent, three are enough.

The register's B-12 and B-14b in the filter. What is left of a single fault on one satellite is told.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.core.mathematics import earth, rotation
from bench.core.records.data import GnssObservations
from bench.core.records.orbit_sets import GLONASS, GPS
from bench.core.records.sensor_specs import Fault
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.consistency.chi_square import chi2_quantile
from bench.evaluation.metrics import run_metrics
from bench.io import config
from bench.navigation.built_in import load
from bench.navigation.error_state_filter import error_state
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.propagation import FilterState, Measurements, Pending, Site, work_for
from bench.navigation.error_state_filter.ranges import ranging, satellite_states
from bench.navigation.error_state_filter.ranges.ionosphere_anchors import ANCHORS
from bench.navigation.error_state_filter.ranges.range_states import CLOCK, RANGES
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.state_blocks import index_of
from bench.navigation.models.loose_tight import Loose, Tight
from bench.simulation import sensors
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.measurement_level.clock import simulate_receiver_clock
from bench.simulation.signals.delays import zenith_troposphere
from tests.builders import ensemble
from tests.navigation.test_error_state import plain
from tests.synthetic import still
from tests.weaving import units, weaving

SKY = config.read_profile("figure-eight", {"sensors.gnss": "sky-l1"}).sensors.gnss
MEMS = config.read_profile("figure-eight").sensors.imu
ERROR_FREE = dict.fromkeys(
    (
        "gps_space_sd", "glonass_space_sd", "ionosphere_sd", "ionosphere_share", "troposphere_sd",
        "multipath_zenith_sd", "multipath_horizon_sd", "clock_g",
    ),
    0.0,
)  # fmt: skip
MATCHED = replace(SKY, sky=replace(SKY.sky, **ERROR_FREE))  # only noise and the clock are left
FLIGHT, UNITS = (60.0,), units(gnss=MATCHED)
GPS_ONLY = replace(SKY, sky=replace(SKY.sky, systems="gps"))


def taken(o, rows):
    """Rows of observations, in whole epochs or not."""
    rows = np.flatnonzero(rows) if np.asarray(rows).dtype == bool else np.asarray(rows)
    epochs = o.epoch[rows]
    columns = {f.name: getattr(o, f.name) for f in fields(o)}
    whole = ("epoch_start", "klobuchar", "gps_t0")
    columns = {name: column if name in whole else column[rows] for name, column in columns.items()}
    columns["epoch_start"] = np.searchsorted(epochs, np.arange(len(o.epoch_start)))
    return GnssObservations(**columns)


def shifted(o, rows, meters):
    """Pseudoranges of some rows moved."""
    pseudorange = o.pseudorange.copy()
    pseudorange[rows] += np.reshape(meters, (-1, 1))
    return GnssObservations(**{f.name: getattr(o, f.name) for f in fields(o)} | {"pseudorange": pseudorange})


def horizontal(solution, truth, t):
    k, j = np.searchsorted(solution.t, t - 1e-6), np.searchsorted(truth.t, t - 1e-6)
    return float(np.linalg.norm(earth.difference_n(solution.lla[k], truth.lla[j])[:2]))


# --- the model ------------------------------------------------------------------------------------------


class Epoch:
    """The fourth epoch of a record, measured from any state with clock, lever arm, ranges and atmosphere."""

    def __init__(self, sensed, gnss=SKY):
        data, initial = sensed.data, sensed.initial
        schedule = Schedule(initial.t, data.specs.imu, compensate=True)
        schedule.take(data, last=True)
        schedule.add_satellites(data.observations, gnss, initial.lla[0], satellite_states.Channels())
        self.sky = schedule.sky
        self.aid = Measurements(
            np.zeros((0, 6)), np.zeros((0, 6)), data.antenna_b, np.zeros((4, 3)), initial.lla
        )
        blocks = [("baro_bias", "m", 1), ("clock_offset", "m", 2), ("glonass_offset", "m", 1)]
        blocks += [("antenna_b", "m", 3), ("gps_range_1", "1", RANGES[GPS])]
        blocks += [("glonass_range_1", "1", RANGES[GLONASS]), ("ionosphere_1", "1", len(ANCHORS))]
        layout = StateLayout(*blocks, ("troposphere", "1", 1))
        self.index, self.n = index_of(layout), layout.size
        attitude = rotation.from_euler(0.3, 0.1, 0.8)
        self.start = np.concatenate([initial.lla, [20.0, 15.0, -2.0], attitude, np.zeros(self.n - 9)])
        self.start[17:20], self.start[20:23] = (5e3, 30.0, 8.0), data.antenna_b

    def measure(self, state, rate, sky):
        """z, H and variance of the rows."""
        n, width = self.n, 2 * int(np.diff(sky.epoch_start).max()) + 6
        work = work_for(n, np.empty((0, 3), np.int64)).measure
        work.last[0] = rate
        pending = Pending(
            np.zeros((width, n)), np.zeros(width), np.zeros(width), np.zeros((width, 4), np.int64),
            np.zeros(1, np.int64), width,
        )  # fmt: skip
        now = FilterState(state, np.zeros((n, n)), np.zeros(n))
        site = Site(now, self.aid, self.index, pending, work)
        rows = plain(ranging.satellites_kernel)(3, 0, site, sky)
        return pending.z[:rows], pending.H[:rows], pending.r[:rows]


def test_h_is_the_jacobian_of_ranges_and_rates(sensed):
    """Central differences of z in every state, lever arm and clocks too.

    Left out of H: how the delays change with the place (3e-3 per meter at 5 deg), the Earth rate on the arm.
    """
    epoch = Epoch(sensed)
    n = epoch.n

    def measured(error):
        state = epoch.start.copy()
        plain(error_state.feedback_kernel)(state, -error)
        # the error of a gyro bias is one of the rate
        return epoch.measure(state, np.array([0.2, -0.1, 0.3]) - error[9:12], epoch.sky)

    size = np.repeat([30.0, 1.0, 1e-3, 1e-3, 1.0], 3)
    size = np.concatenate([size, [1.0], [10.0, 1.0, 1.0], np.full(3, 0.1), np.full(n - 22, 0.1)])
    z, H, _ = measured(np.zeros(n))
    assert len(z) > 24
    assert (H[:, 18] == 1).any()  # GLONASS is among them
    for k in range(n):
        step = np.zeros(n)
        step[k] = size[k]
        slope = (measured(step)[0] - measured(-step)[0]) / (2 * size[k])
        for half, atol in ((0, 4e-3), (1, 2e-4)):
            assert_allclose(H[half::2, k], slope[half::2], rtol=1e-5, atol=atol if k < 3 or k > 8 else 1e-4)


@pytest.mark.parametrize("alt", [-40.0, 25.0, 825.0, 11_975.0, 13_000.0])
def test_the_troposphere_is_that_of_the_height_from_the_ground_to_12_km(sensed, alt):
    """From a table to 2e-5 m; what is left of a variance by the states is white for a thousandth at least."""
    epoch = Epoch(sensed)
    epoch.start[2] = alt
    found = []
    for table in (epoch.sky.zenith, 0.0 * epoch.sky.zenith, 0.0 * epoch.sky.zenith + 1.0):
        small = epoch.sky._replace(zenith=table, variance=np.full_like(epoch.sky.variance, [1e-6, 4e-6]))
        z, _, r = epoch.measure(epoch.start.copy(), np.zeros(3), small)
        found.append(z[::2])
        assert_allclose(r[::2], 1e-9)
        assert_allclose(r[1::2], 4e-6)
    vertical = (found[0] - found[1]) / (found[2] - found[1])
    assert_allclose(vertical, zenith_troposphere(epoch.start[0], np.clip(alt, 0.0, 12_000.0)), atol=2e-5)


@pytest.mark.parametrize("receiver", ["sky-l1", "sky-l1l2"])
def test_rows_are_those_of_one_carrier_or_of_the_combination_of_two(receiver):
    """B-11: without ionosphere, and the errors of two carriers in it by their squares."""
    gnss = config.read_profile("figure-eight", {"sensors.gnss": receiver}).sensors.gnss
    sensed = sensors.sense(weaving(2.0, rate=50.0), units(gnss=gnss), 1, 0)
    o, epoch = sensed.data.observations, Epoch(sensed, gnss)
    squares, sky = o.frequency**2, epoch.sky
    assert len(sky.t) == len(o.t)
    assert_allclose(sky.t, o.t + o.gps_t0)
    assert_allclose(sky.variance, np.column_stack([o.sd_pseudorange, o.sd_range_rate]) ** 2)
    if receiver == "sky-l1":
        assert_allclose(sky.ionosphere, 1575.42e6**2 / squares[:, 0])
        assert_allclose(sky.combined, 1.0)
    else:
        assert not sky.ionosphere.any()
        parts = squares / (squares[:, :1] - squares[:, 1:])
        assert_allclose(sky.combined, np.hypot(*parts.T))
        assert abs(sky.combined[o.system == GPS] - 2.98).max() < 0.01
        free = (o.pseudorange * parts) @ [1.0, -1.0]
        assert np.abs(sky.values[:, 0] - free - o.sat_clock).max() < 1e-6


def test_with_the_true_state_the_ranges_leave_nothing_but_their_noise(truth, sensed):
    """First innovations after the clock is known: NIS of ranges and rates is that of their reported noise."""
    solution = Tight().run(sensed.data, sensed.initial)
    table = solution.innovations
    for sensor in ("pseudorange", "range_rate"):
        rows = (table.code == table.sensor.index(sensor)) & (table.t > 5.0)
        count = rows.sum()
        assert count > 500
        assert abs(table.nis[rows].mean() - 1.0) < 3.3 * np.sqrt(2 / count)
    assert table.accepted.all()


def test_corrections_are_needed(sensed):
    """Without the broadcast ionosphere or the satellite clocks the innovations show it."""
    o = sensed.data.observations
    columns = {f.name: getattr(o, f.name) for f in fields(o)}
    for name in ("klobuchar", "group_delay"):
        wrong = GnssObservations(
            **columns | {name: np.zeros(8) if name == "klobuchar" else 5.0 + o.group_delay}
        )
        changed = Tight().run(replace(sensed.data, observations=wrong), sensed.initial)
        sound = Tight().run(sensed.data, sensed.initial)
        moved = np.abs(changed.extra - sound.extra)[-1].max()
        assert moved > 1.0, name


def test_it_keeps_the_contract_with_satellites(sensed):
    for options in ({}, {"adaptive_noise": 20, "lever_arm_sd": 0.3, "standstill": True}):
        bench.check_estimator(load("tight", options), sensed.data, sensed.initial)


# --- consistency --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_tight_knows_its_errors():
    """40 matched runs of 300 s: all three tests pass; a covariance a third too small keeps none of NEES."""
    truth = weaving(300.0)
    estimator = load("tight", {})
    found = ensemble(estimator, truth, lambda run: sensors.sense(truth, UNITS, 5, run), 40, 60.0)
    result = found.claims()
    assert not result.rejected, result.reasons
    assert set(result.nis) == {"pseudorange", "range_rate", "baro"}
    assert found.claims(nees_factor=1.5).rejected


# --- few satellites -------------------------------------------------------------------------------------


def highest(o, count, after):
    """GPS only: all rows up to a time, and of each later epoch those of the highest satellites."""
    o = taken(o, o.system == GPS)
    keep = o.t <= after
    for k in range(len(o.epoch_start) - 1):
        rows = np.arange(o.epoch_start[k], o.epoch_start[k + 1])
        if len(rows) and o.t[rows[0]] > after:
            # the highest are the nearest
            near = rows[np.argsort(o.pseudorange[rows, 0])[:count]]
            keep[near] = True
    return taken(o, keep)


def test_it_goes_on_with_one_to_three_satellites():
    """They are used, and each one more makes the place surer, though none can give a fix.

    A TCXO is worth little to one satellite: in a minute its offset walks by 50 m.
    """
    truth = weaving(120.0, straight_from=60.0)
    drawn = sensors.sense(truth, units(imu=MEMS, gnss=GPS_ONLY, baro=None), 2, 0)
    o = drawn.data.observations
    sd = []
    for count in range(4):
        data = replace(drawn.data, observations=highest(o, count, 60.0))
        solution = Tight().run(data, drawn.initial)
        sd.append(np.sqrt(np.trace(solution.cov[-1, :3, :3])))
        assert horizontal(solution, truth, 120.0) < 3.0 * sd[-1]
        used = solution.innovations.t > 60.5
        assert used.sum() == 2 * 60 * count
    print("sd", sd)
    assert sd[3] < sd[2] < sd[1] < sd[0]
    assert sd[3] < 0.5 * sd[0]


@pytest.mark.slow
def test_three_satellites_hold_the_position_three_times_better_than_none():
    """GPS only, TCXO, MEMS unit, two minutes to settle, then 60 s straight on the three highest satellites.

    loose-22 has no fixes from three satellites and coasts. 50 seeds; the bound on the ratio of the medians
    is the upper end of its 95 % bootstrap interval.
    """
    truth = weaving(180.0, straight_from=120.0)
    tight, loose = load("tight", {}), load("loose-22", {})
    final = np.empty((50, 2))
    for seed in range(50):
        drawn = sensors.sense(truth, units(imu=MEMS, gnss=GPS_ONLY), 100 + seed, 0)
        fixes = drawn.data.fixes
        early = fixes.t <= 120.0
        coasting = type(fixes)(*(getattr(fixes, f.name)[early] for f in fields(fixes)))
        data = replace(drawn.data, fixes=coasting, observations=highest(drawn.data.observations, 3, 120.0))
        for k, estimator in enumerate((tight, loose)):
            final[seed, k] = horizontal(estimator.run(data, drawn.initial), truth, 180.0)
    draws = np.random.default_rng(1).integers(0, 50, (2000, 50))
    medians = np.median(final[draws], axis=1)
    low, high = np.percentile(medians[:, 0] / medians[:, 1], [2.5, 97.5])
    ratio = np.median(final[:, 0]) / np.median(final[:, 1])
    print(f"median {np.median(final, axis=0)} m, ratio {ratio:.3f}, 95 % interval {low:.3f} to {high:.3f}")
    assert ratio <= 1 / 3
    assert high <= 1 / 3


# --- faults ---------------------------------------------------------------------------------------------


def refused(solution, name):
    return [(t, text) for t, _, text in solution.events.select("refused") if text.startswith(name)]


def test_a_step_of_100_m_is_refused_at_its_first_epoch(sensed):
    o = sensed.data.observations
    names, which = satellite_states.name_satellites(o)
    sat = int(np.bincount(which).argmax())
    rows = np.flatnonzero((which == sat) & (o.t >= 30.0))
    data = replace(sensed.data, observations=shifted(o, rows, 100.0))
    solution = Tight().run(data, sensed.initial)
    assert refused(solution, names[sat]) == [(30.0, f"{names[sat]} range: 31 in a row rejected")]
    assert len(solution.events.select("refused")) == 1  # and no other with it
    sound = Tight().run(sensed.data, sensed.initial)
    assert np.abs(earth.difference_n(solution.lla[-1], sound.lla[-1])).max() < 2.0


def test_a_step_of_all_ranges_is_believed_after_ten_seconds_and_the_clock_takes_it(sensed):
    """3 km, as of the receiver's clock: no satellite speaks for the filter, so P grows for all of them."""
    o = sensed.data.observations
    data = replace(sensed.data, observations=shifted(o, np.flatnonzero(o.t >= 30.0), 3000.0))
    solution, sound = (Tight().run(one, sensed.initial) for one in (data, sensed.data))
    table = solution.innovations
    ranges = table.code == table.sensor.index("pseudorange")
    after = ranges & (table.t > 30.0 - 1e-6)
    assert not table.accepted[after & (table.t < 40.0 - 1e-6)].any()
    assert table.accepted[after & (table.t > 40.0 - 1e-6)].all()
    assert np.abs(earth.difference_n(solution.lla[-1], sound.lla[-1])).max() < 2.0
    clock = solution.extra_names.index("clock_offset_m")
    assert solution.extra[-1, clock] - sound.extra[-1, clock] == pytest.approx(3000.0, abs=5.0)


def test_a_ramp_is_told_with_its_delay_or_not_at_all(sensed):
    """1 m/s on one satellite: its own range rate does not move, and the gate of one epoch sees it late.

    A ramp ten times as steep is seen sooner; none of another satellite is rejected.
    """
    o = sensed.data.observations
    names, which = satellite_states.name_satellites(o)
    sat = int(np.bincount(which).argmax())
    rows = np.flatnonzero((which == sat) & (o.t >= 20.0))
    delay = {}
    for rate in (0.0, 1.0, 10.0):
        data = replace(sensed.data, observations=shifted(o, rows, rate * (o.t[rows] - 20.0)))
        found = refused(Tight(readmit_after_s=100.0).run(data, sensed.initial), names[sat])
        delay[rate] = found[0][0] - 20.0 if found else np.inf
    assert delay[0.0] == np.inf
    assert 0 < delay[10.0] <= 3.0
    assert delay[10.0] < delay[1.0]
    print("delays", delay)


def scripted(truth, sensed, step, ramp, start, end, **options):
    """Fault of the pseudorange of the satellite seen most, its metrics, and the solution."""
    o = sensed.data.observations
    names, which = satellite_states.name_satellites(o)
    row = np.flatnonzero(which == np.bincount(which).argmax())[0]
    name = names[which[row]]
    satellite = (int(o.system[row]), int(o.sat[row]))
    fault = Fault(
        "pseudorange", "gnss", start, end, "scripted", satellites=(satellite,), step=(step,), ramp=(ramp,)
    )
    drawn = sensors.sense(truth, replace(units(gnss=MATCHED), faults=(fault,)), 1, 0)
    solution = Tight(**options).run(drawn.data, drawn.initial)
    _, found = run_metrics.measure(
        truth, solution, evaluation=EvaluationWindow(10.0), outages=(), faults=(fault,)
    )
    return found, solution, name


def test_a_scripted_step_is_scored_as_detected_at_once(truth, sensed):
    """One rejection for each of its ten epochs, none before, after, or of another satellite."""
    found, solution, name = scripted(truth, sensed, 100.0, 0.0, 30.0, 40.0)
    assert found["fault_1_detected"] == 1.0
    assert found["fault_1_delay_s"] == pytest.approx(0.0, abs=1e-6)
    assert found["false_alarms_pseudorange"] == found["false_alarms_range_rate"] == 0.0
    told = solution.events.select("refused")
    assert [(t, end, text) for t, end, text in told] == [(30.0, 39.0, f"{name} range: 10 in a row rejected")]
    started_between = scripted(truth, sensed, 100.0, 0.0, 30.25, 40.0)[0]
    assert started_between["fault_1_delay_s"] == pytest.approx(0.75, abs=1e-6)


def test_a_scripted_ramp_is_scored_with_its_delay_or_as_undetected(truth, sensed):
    """The gate alone decides when: the first epoch of the interval at which the NIS of a filter that gates
    nothing passes the bound. 1 m/s is there before 5 s, 5 m being seven sigma of the range; what creeps by
    0.4 m in all stays undetected."""
    probability = 1e-5
    for ramp in (1.0, 0.02):
        found, solution, name = scripted(truth, sensed, 0.0, ramp, 30.0, 50.0, gate_probability=probability)
        table = scripted(truth, sensed, 0.0, ramp, 30.0, 50.0, integrity=())[1].innovations
        assert table.accepted.all()
        rows = np.isin(table.code, [table.sensor.index(what) for what in ("pseudorange", "range_rate")])
        beyond = table.t[rows & (table.nis > chi2_quantile(1.0 - probability, 1)) & (table.t < 50.0 - 1e-6)]
        assert not (beyond < 30.0 - 1e-6).any()
        if ramp == 1.0:
            assert found["fault_1_detected"] == 1.0
            assert found["fault_1_delay_s"] == pytest.approx(beyond.min() - 30.0, abs=1e-6)
            assert 0.0 < found["fault_1_delay_s"] <= 5.0
            assert solution.events.select("refused")[0][2].startswith(f"{name} range")
        else:
            assert len(beyond) == 0
            assert found["fault_1_detected"] == 0.0
            assert found["fault_1_delay_s"] is None


def test_satellites_that_are_not_finite_are_counted_and_left_out(sensed):
    o = sensed.data.observations
    bad = shifted(o, np.array([7, 60]), np.nan)
    solution = Tight().run(replace(sensed.data, observations=bad), sensed.initial)
    assert [text for *_, text in solution.events.select("timeline")] == [
        "satellites: 2 rows left out: not finite"
    ]
    assert np.isfinite(solution.cov).all()


def test_the_offset_of_glonass_is_found(sensed):
    """Without GLONASS its state keeps its variance; with it the offset drawn is found to a meter."""
    solution = Tight().run(sensed.data, sensed.initial)
    at = solution.extra_names.index("glonass_offset_m")
    assert solution.extra_sd[-1, at] < 1.0
    gps = taken(sensed.data.observations, sensed.data.observations.system != GLONASS)
    without = Tight().run(replace(sensed.data, observations=gps), sensed.initial)
    assert_allclose(without.extra_sd[-1, at], MATCHED.sky.glonass_offset_sd, rtol=1e-9)


def test_what_tight_does_not_model_is_named():
    named = Tight().unmodeled_errors(units(gnss=SKY).assumed)
    for text in ("g-sensitivity of the receiver's clock",):
        assert text in named
    for text in (
        "multipath",
        "flicker of the receiver's clock",
        "ionosphere beyond the broadcast model",
        "satellite orbit and clock error",
    ):
        assert text not in named
    steady = replace(SKY, sky=replace(SKY.sky, clock_h_m1=0.0))
    assert "flicker of the receiver's clock" not in Tight().unmodeled_errors(units(gnss=steady).assumed)
    assert not [text for text in named if "GNSS" in text]


@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_the_drift_walks_as_far_between_epochs_as_flicker_moves_it(rate):
    """Of the simulated clock, 20000 epochs: 0.85 to 1.05 of what is assumed; its floor is 3 times less."""
    alone = replace(SKY.sky, clock_h_0=0.0, clock_h_m2=0.0, clock_g=0.0, clock_drift_sd=0.0)
    truth, rows = still(20000.0 / rate, rate, attitude=(0.0, 0.0, 0.0)), np.arange(1, 20001)
    steps, draws = np.diff(truth.t), SensorDraws(1, 0).part("gnss.sky.clock")
    _, drift = simulate_receiver_clock(truth, rows, steps, alone, draws)
    drift_state = CLOCK.states(units(gnss=replace(SKY, sky=alone, rate=rate)).assumed)[1]
    assert 0.85 < np.mean(np.diff(drift) ** 2) * rate / drift_state.density < 1.05


@pytest.mark.parametrize("rate", [2.0, None])
def test_a_clock_that_nothing_measures_walks_in_closed_form(rate):
    """Whatever the step: P_oo + P_dd t^2 + q_o t + q_d t^3 / 3 of the offset, P_dd + q_d t of the drift."""
    sensed = sensors.sense(weaving(8.0, rate=50.0), UNITS, 1, 0)
    lost = np.full_like(sensed.data.observations.pseudorange, np.nan)
    columns = {f.name: getattr(sensed.data.observations, f.name) for f in fields(GnssObservations)}
    data = replace(sensed.data, observations=GnssObservations(**columns | {"pseudorange": lost}))
    solution = Tight(covariance_hz=rate).run(data, sensed.initial)
    offset, drift, *_ = CLOCK.states(sensed.data.specs)
    offset_sd, drift_sd = (
        solution.extra_sd[:, solution.extra_names.index(name)]
        for name in ("clock_offset_m", "clock_drift_m_s")
    )
    t = solution.t
    assert_allclose(drift_sd**2, drift.variance + drift.density * t, rtol=1e-9)
    walked = drift.variance * t**2 + offset.density * t + drift.density * t**3 / 3.0
    assert_allclose(offset_sd**2, offset.variance + walked, rtol=1e-9)


def test_epochs_without_satellites_are_counted_and_carried_through(sensed):
    """As of a receiver under a bridge: six epochs of nothing, one after the other, and two at the end."""
    o = sensed.data.observations
    epoch = np.arange(len(o.epoch_start) - 1)
    gone = (epoch >= 20) & (epoch < 26) | (epoch >= len(epoch) - 2)
    data = replace(sensed.data, observations=taken(o, ~gone[o.epoch]))
    solution = Tight().run(data, sensed.initial)
    ((start, end, text),) = solution.events.select("timeline")
    assert text == "satellites: 8 epochs without satellites"
    assert start == o.t[o.epoch_start[19]]
    assert end == sensed.data.imu.t[-1]
    v = solution.innovations
    ranged = v.t[np.char.endswith(np.array(v.sensor)[v.code], "range")]
    assert len(np.unique(ranged)) == len(epoch) - 8
    assert np.isfinite(solution.lla).all()


def test_fixes_without_satellites_are_told_not_used(truth):
    drawn = sensors.sense(truth, units(), 1, 0)
    solution = Tight().run(drawn.data, drawn.initial)
    assert [text for *_, text in solution.events.select("aiding")] == [
        "tight coupling: asked for, but the record holds nothing for it"
    ]
    assert "GNSS at all: tight coupling needs a receiver with [sky]" in Tight().unmodeled_errors(
        drawn.data.specs
    )


def test_tight_needs_a_receiver_with_a_sky(sensed):
    plain_receiver = replace(sensed.data.specs, gnss=replace(MATCHED, sky=None))
    with pytest.raises(ValueError, match=r"has no \[sky\]"):
        Tight().run(replace(sensed.data, specs=plain_receiver), sensed.initial)
    with pytest.raises(ValueError, match="gnss_markov = true needs fixes"):
        Tight(gnss_markov=True)


def test_the_smoother_goes_back_over_tight(sensed, truth):
    smoothed = load("smoother", {"over": "tight"}).run(sensed.data, sensed.initial)
    forward = Tight().run(sensed.data, sensed.initial)
    assert (np.einsum("kii->ki", smoothed.cov) <= np.einsum("kii->ki", forward.cov) * (1 + 1e-9)).all()
    assert_allclose(smoothed.lla[-1], forward.lla[-1], rtol=1e-12)
    assert Loose().options.tight is False
    k = len(smoothed) // 4
    assert horizontal(smoothed, truth, smoothed.t[k]) < 3.0
