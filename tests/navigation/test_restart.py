"""After a gap in the IMU record a filter with fixes is as consistent as without the gap, and soon as good.

On a weaving flight with matched sensors: short gaps are bridged, after long ones the filter coasts on its
fixes and starts again by the alignment on the move or at rest, with the biases it has learnt.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numba
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import bench
from bench import pipeline
from bench.core.mathematics import earth, rotation
from bench.evaluation.errors.error_series import error_series
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.navigation.engine import timeline
from bench.navigation.error_state_filter import filter_run
from bench.navigation.models.loose_tight import Loose
from bench.navigation.start.learnt_biases import LearntBiases
from bench.navigation.start.whole_records import run_between_gaps
from bench.simulation import sensors
from tests.builders import band, first_rows, put, take
from tests.flight.plans import truth_of
from tests.weaving import DEG, IMU, units, weaving

RUNS = 8
FILTER = Loose()


@pytest.fixture(scope="module")
def truth():
    return weaving(215.0, rate=50.0, wind_n=[5.0, -4.0, 0.0])


@pytest.fixture(scope="module")
def draws(truth):
    return [sensors.sense(truth, units(), 31, run) for run in range(RUNS)]


@pytest.fixture(scope="module")
def whole(truth, draws):
    """The errors of the filter on the whole records."""
    return [error_series(truth, FILTER.run(d.data, d.initial)) for d in draws]


def with_gap(data, start, length):
    """IMU rows in (start, start + length] lost."""
    t = data.imu.t
    kept = (t <= start + 1e-6) | (t > start + length + 1e-6)
    return replace(data, imu=take(data.imu, kept))


def window(errors, first, last):
    return (errors.t > first) & (errors.t <= last)


@pytest.mark.parametrize(("start", "length"), [(75.0, 0.1), (52.0, 0.5), (60.0, 5.0), (30.0, 60.0)])
def test_consistent_and_back_30_s_after_a_gap(truth, draws, whole, start, length):
    """Eight runs, straight and turning: NEES at most twice that of the same runs without the gap.

    The mean of 8 draws over 90 s, correlated over 20 s, scatters by 10 %. Without a restart it is thousands.
    """
    nees, plain, tilt, ratios = [], [], [], []
    end = start + length
    for drawn, sound in zip(draws, whole, strict=True):
        solution = FILTER.run(with_gap(drawn.data, start, length), drawn.initial)
        errors = error_series(truth, solution)
        rows = window(errors, end + 30.0, end + 120.0)
        nees.append(errors.nees[rows].mean())
        plain.append(sound.nees[rows].mean())
        tilt.append(errors.phi_n[rows, :2])
        ratios.append(errors.pos_n[rows].std() / sound.pos_n[rows].std())
        assert np.isfinite(solution.cov).all()
        restarts = solution.events.select("restart")
        assert len(restarts) == (length > timeline.LONGEST_BRIDGE)
    assert np.mean(nees) <= 2.0 * np.mean(plain)
    assert np.sqrt(np.mean(np.square(tilt))) < 0.3 * DEG
    assert np.mean(ratios) < 1.5


def test_an_event_says_what_was_done(draws):
    solution = FILTER.run(with_gap(draws[0].data, 60.0, 5.0), draws[0].initial)
    assert "imu: gap of 5 s" in [text for *_, text in solution.events.select("timeline")]
    ((t, t_end, text),) = solution.events.select("restart")
    assert t == 60.0
    assert 67.0 < t_end < 69.0
    assert (
        "IMU silent for 5 s: position and velocity by the fixes alone until 68.02 s; leveled by the" in text
    )


def test_from_the_instant_it_starts_again_on_the_filter_answers(draws):
    """Before, with an attitude that may be anything usual; no answer lies between both."""
    data = with_gap(draws[0].data, 60.0, 5.0)
    wanted = 68.02 + np.array([-1.0, -3e-6, 0.0, 0.1])
    solution = FILTER.run(replace(data, output_t=np.concatenate([[1.0], wanted])), draws[0].initial)
    held = (solution.q_nb[1:] == solution.q_nb[1]).all(axis=1)
    assert held.tolist() == [True, True, False, False]


def test_a_gap_at_the_end_of_a_range_names_it(draws):
    """A unit that clips flags its samples; one step of quantization off the end they still count.

    In pieces, too, that end in the gap."""
    imu, specs = draws[0].data.imu, draws[0].data.specs
    gyro = replace(specs.imu.gyro, range=60.0 * DEG, quantization=1e-6)
    lost = (imu.t > 60.0) & (imu.t <= 65.0)
    dtheta_b = np.where(lost[:, None], 0.0, imu.dtheta_b)
    dtheta_b[lost, 2] = 60.0 * DEG * imu.dt[lost] - 9e-7
    clipped = replace(imu, dtheta_b=dtheta_b, valid=imu.valid & ~lost)
    data = replace(draws[0].data, imu=clipped, specs=replace(specs, imu=replace(specs.imu, gyro=gyro)))
    ((_, _, text),) = FILTER.run(data, draws[0].initial).events.select("restart")
    count = int(lost.sum())
    assert f"({count} of {count} samples have the gyro at or beyond its range of 60 deg/s): position" in text
    opened = bench.open_filter("loose-15", draws[0].initial, {}, look_back=0.5)
    edges = [-1.0, 61.0, 63.3, 100.0]
    found = [opened.update(bench.slice_sensors(data, *edge)) for edge in pairwise(edges)]
    assert [text for one in found for *_, text in one.events.select("restart")] == [text]


def test_what_is_known_in_the_gap_is_claimed(truth, draws):
    """Coasting over 15 s: position and velocity inside their covariances, every fix in use, attitude held."""
    ratio = []
    for drawn in draws[:6]:
        solution = FILTER.run(with_gap(drawn.data, 47.0, 15.0), drawn.initial)
        errors = error_series(truth, solution)
        rows = window(errors, 48.0, 70.0)
        sd = np.sqrt(np.einsum("kii->ki", solution.cov))[rows]
        ratio.append(np.abs(np.hstack([errors.pos_n, errors.vel_n])[rows]) / sd[:, :6])
        table = solution.innovations
        used = table.t[(table.code == table.sensor.index("gnss_position")) & table.accepted]
        assert set(np.arange(48.0, 63.0)) <= set(np.round(used - 0.05).tolist()) | set(
            np.round(used).tolist()
        )
        assert (np.diff(sd[: (10 * 13), 8]) >= 0).all()
    assert np.mean(np.concatenate(ratio) < 3.0) > 0.99


def test_biases_are_kept(truth, draws):
    """The gyro bias after the restart is as good as before the gap, not as unknown as at the start.

    Each accelerometer begins with its own sd; that of z is known twice as well as the others.
    """
    for drawn in draws[:3]:
        solution = FILTER.run(with_gap(drawn.data, 100.0, 20.0), drawn.initial)
        before, after = (int(np.searchsorted(solution.t, t)) for t in (99.9, 135.0))
        start_sd = solution.extra_sd[0, :3]
        assert (
            solution.extra_sd[after, :3]
            < np.maximum(1.6 * solution.extra_sd[before, :3].max(), 0.7 * start_sd)
        ).all()
        ((_, begun, _),) = solution.events.select("restart")
        kept = solution.extra_sd[int(np.searchsorted(solution.t, begun + 0.05)), 3:6]
        floor = drawn.data.specs.imu.accel.instability_sd
        assert_allclose(kept, np.maximum(solution.extra_sd[before, 3:6], floor), rtol=0.02)
        moved = solution.gyro_bias_b[after] - solution.gyro_bias_b[before]
        assert (np.abs(moved) < 4.0 * solution.extra_sd[after, :3]).all()


def test_nothing_after_a_gap_is_known_inside_it(draws):
    data = with_gap(draws[0].data, 40.0, 5.0)
    dvel = data.imu.dvel_b.copy()
    dvel[data.imu.t > 45.0] += 0.001
    changed = replace(data, imu=replace(data.imu, dvel_b=dvel))
    one, other = (FILTER.run(d, draws[0].initial) for d in (data, changed))
    inside = one.t <= 45.0 + 1e-6
    assert_array_equal(one.lla[inside], other.lla[inside])
    assert_array_equal(one.cov[inside], other.cov[inside])
    assert not np.array_equal(one.lla[~inside], other.lla[~inside])


def test_two_gaps_one_of_them_in_the_alignment_after_the_other(truth, draws):
    """Where a second gap cuts the alignment short, the filter coasts on to the next segment."""
    data = with_gap(with_gap(draws[0].data, 60.0, 5.0), 66.0, 9.0)
    solution = FILTER.run(data, draws[0].initial)
    first, second = solution.events.select("restart")
    assert "not started again" in first[2]
    assert second[1] < 90.0
    errors = error_series(truth, solution)
    assert np.linalg.norm(errors.pos_n[errors.t > 105.0], axis=1).max() < 10.0
    assert np.isfinite(errors.nees).all()


def test_without_fixes_after_the_gap_it_does_not_start_again(truth, draws):
    data = with_gap(draws[0].data, 60.0, 5.0)
    data = replace(data, fixes=take(data.fixes, data.fixes.t < 62.0))
    solution = FILTER.run(data, draws[0].initial)
    ((*_, text),) = solution.events.select("restart")
    assert "not started again" in text
    sd = np.sqrt(np.einsum("kii->ki", solution.cov))
    assert np.isfinite(sd).all()
    late = error_series(truth, solution)
    assert (np.abs(late.pos_n) < 5.0 * sd[:, :3]).all()


@pytest.mark.parametrize("name", ["loose-22", "loose-mems", "classic-22", "ukf", "smoother", "invariant-ekf"])
def test_every_filter_with_fixes_starts_again(truth, draws, name):
    """One run, five seconds without IMU in a turn, then 39 s."""
    drawn = draws[0]
    data = with_gap(drawn.data, 22.0, 5.0)
    data = replace(data, imu=take(data.imu, data.imu.t < 66.0), output_t=data.output_t[data.output_t < 65.5])
    solution = load(name, {}).run(data, drawn.initial)
    assert len(solution.events.select("restart")) == 1
    assert np.isfinite(solution.cov).all()
    errors = error_series(truth, solution)
    rows = window(errors, 57.0, 65.0)
    assert np.sqrt(np.mean(errors.phi_n[rows, :2] ** 2)) < 0.4 * DEG
    assert np.linalg.norm(errors.pos_n[rows], axis=1).max() < 10.0
    assert errors.nees[rows].mean() < 45.0  # 9 expected, the mean of one run over 8 s


@pytest.mark.parametrize("use", ["baro-inertial", "free-inertial"])
def test_a_filter_without_fixes_ends_at_a_gap_that_it_cannot_bridge(draws, use):
    """Until the gap its answers are those of the whole record, then there are none, and an event says why."""
    drawn = draws[0]
    whole = load(use, {}).run(drawn.data, drawn.initial)
    solution = load(use, {}).run(with_gap(drawn.data, 40.0, 5.0), drawn.initial)
    before = solution.t <= 40.0
    assert_array_equal(solution.lla[before], whole.lla[before])
    assert_array_equal(solution.cov[before], whole.cov[before])
    assert np.isnan(solution.lla[~before]).all()
    assert np.isnan(solution.cov[~before]).all()
    assert solution.extra_names == whole.extra_names
    ((t, t_end, text),) = solution.events.select("ended")
    assert t == 40.0
    assert t_end == pytest.approx(45.0, abs=0.03)
    assert text == "IMU silent for 5 s: it ends; without fixes its position is unknown"
    twice = load(use, {}).run(with_gap(with_gap(drawn.data, 40.0, 5.0), 60.0, 5.0), drawn.initial)
    assert len(twice.events.select("ended")) == 1


def test_a_short_gap_of_a_filter_without_fixes_is_bridged(draws):
    """Half a second; its covariance grows by what it does not know of it."""
    drawn = draws[0]
    solution = load("baro-inertial", {}).run(with_gap(drawn.data, 40.0, 0.5), drawn.initial)
    assert not solution.events.select("ended")
    sd = np.sqrt(np.einsum("kii->ki", solution.cov))
    before, after = (int(np.searchsorted(solution.t, t)) for t in (39.9, 40.7))
    assert (sd[after, 6:] > 2.0 * sd[before, 6:]).any()
    assert np.isfinite(sd).all()


def standing(truth):
    """A unit that stands level with the nose at 40 deg for as long as a flight."""
    lat, q = 47.0 * DEG, rotation.from_euler(0.0, 0.0, 40.0 * DEG)
    to_b, dt, n = rotation.conjugate(q), np.diff(truth.t)[:, None], len(truth.t)
    rate_n = earth.EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    return replace(
        truth,
        lla=np.tile([lat, 11.0 * DEG, 600.0], (n, 1)),
        vel_n=np.zeros((n, 3)),
        q_nb=np.tile(q, (n, 1)),
        dtheta_b=rotation.rotate(to_b, rate_n) * dt,
        dvel_b=rotation.rotate(to_b, -earth.gravity_n(lat, 600.0)) * dt,
    )


def test_at_rest_it_levels_and_keeps_the_heading():
    truth = standing(weaving(100.0, rate=50.0))
    for run in range(3):
        drawn = sensors.sense(truth, units(), 33, run)
        solution = FILTER.run(with_gap(drawn.data, 30.0, 20.0), drawn.initial)
        ((*_, text),) = solution.events.select("restart")
        assert "leveled at rest" in text
        assert "heading given" in text
        errors = error_series(truth, solution)
        late = errors.t > 65.0
        sd = np.sqrt(np.einsum("kii->ki", solution.cov))
        assert (np.abs(errors.phi_n[late]) < 4.5 * sd[late, 6:]).all()
        assert sd[late, 8].max() < 1.2 * sd[0, 8]
        assert errors.nees[late].mean() < 30.0


WILD = {
    "a velocity of 1e6 m/s": ("dvel_b", [0.0, 1e6, 0.0], 1),
    "not a number": ("dtheta_b", np.nan, 1),
    "stuck at its range": ("dtheta_b", [0.0, 0.0, 5.0 * 0.02], 20),
    "time of another day": ("t", 86_400.0, 1),
}


@pytest.mark.parametrize("case", WILD)
def test_a_wild_sample_is_bridged_and_named(truth, draws, whole, case):
    name, value, count = WILD[case]
    spec = draws[0].data.specs.imu
    specs = replace(draws[0].data.specs, imu=replace(spec, gyro=replace(spec.gyro, range=5.0)))
    nees = []
    for drawn, sound in zip(draws[:5], whole, strict=False):
        imu = put(drawn.data.imu, slice(3000, 3000 + count), **{name: value})
        solution = FILTER.run(replace(drawn.data, imu=imu, specs=specs), drawn.initial)
        said = [text for *_, text in solution.events.select("timeline")]
        assert any(text.startswith(f"imu: {count} rows left out: ") for text in said)
        assert any(text.startswith("imu: gap of ") for text in said)
        errors = error_series(truth, solution)
        rows = window(errors, 65.0, 155.0)
        assert_allclose(errors.pos_n[rows].std(), sound.pos_n[rows].std(), rtol=0.3)
        nees.append(errors.nees[rows].mean() / sound.nees[rows].mean())
    assert np.mean(nees) < 2.0


def test_without_a_long_gap_the_filter_gets_the_record_as_it_is(draws):
    drawn, seen = draws[0], []

    def run(data, initial, gyro_sd):
        seen.append((data, initial))
        return FILTER.forward(data, initial)[0]

    data = with_gap(drawn.data, 40.0, 0.5)
    run_between_gaps(run, data, drawn.initial, "datasheet")
    assert len(seen) == 1
    assert seen[0][0] is data
    assert seen[0][1] is drawn.initial


def test_a_record_with_a_gap_needs_no_second_compilation(draws, monkeypatch):
    """What the kernel is given has the same types with the rows that bridge a gap and without them."""
    kernel, types = filter_run.fusion_kernel, []

    def watched(*arguments):
        types.append([numba.typeof(argument) for argument in arguments])
        kernel(*arguments)

    monkeypatch.setattr(filter_run, "fusion_kernel", watched)
    for data in (draws[0].data, with_gap(draws[0].data, 52.0, 0.3)):
        FILTER.run(data, draws[0].initial)
    assert types[0] == types[1]


# --- consumer units ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["mpu-9250", "bmi088"])
def test_a_gap_of_a_consumer_unit_is_honest_in_it_and_after_it(recorded, unit):
    """Ten runs. In the gap the wandering error of all fixes stays; behind it the gyros are known as a whole.

    Bias and temperature of an mpu-9250 are 1.7 and 1.6 deg/s; the sum of both is what turns the attitude.
    """
    gap = {"kind": "dropped", "sensor": "imu", "start_s": 200.0, "duration_s": 15.0}
    profile = read_profile("figure-eight", {"sensors.imu": unit, "fault": [gap], "evaluation.output_hz": 1.0})
    truth = first_rows(truth_of(recorded(profile.flight), 100.0), 30_001)
    inside, after = [], []
    for draw in range(10):
        drawn = pipeline.sense(profile, truth, draw)
        solution = load("loose-full", {}).run(drawn.data, drawn.initial)
        ((_, end, text),) = solution.events.select("restart")
        assert "leveled by the velocity gained in 2 s" in text
        errors = error_series(truth, solution)
        inside.append(errors.nees[[201, 205, 214]])
        after.append(errors.nees[[int(end) + k for k in (2, 10, 30, 60)]])
    high = 9 * band(90)[1]
    assert (np.mean(inside, axis=0) < high).all(), np.mean(inside, axis=0)
    assert (np.mean(after, axis=0) < high).all(), np.mean(after, axis=0)


def test_a_smoother_of_a_consumer_unit_starts_again_with_its_gyros_known_as_a_whole(recorded):
    """Two runs, the 12 s after the restart. With bias and temperature known one by one it is 1e12."""
    gap = {"kind": "dropped", "sensor": "imu", "start_s": 200.0, "duration_s": 15.0}
    changes = {"sensors.imu": "mpu-9250", "fault": [gap], "evaluation.output_hz": 1.0}
    profile = read_profile("figure-eight", changes)
    truth, found = first_rows(truth_of(recorded(profile.flight), 100.0), 30_001), []
    for draw in range(2):
        drawn = pipeline.sense(profile, truth, draw)
        solution = load("smoother", {}).run(drawn.data, drawn.initial)
        ((_, end, _),) = solution.events.select("restart")
        errors = error_series(truth, solution)
        found.append(errors.nees[window(errors, end, end + 12.0)].mean())
    assert np.mean(found) < 9 * band(18)[1]


# --- motion beyond the range of the IMU ---------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["adis16475", "bmi088"])
def test_rolls_and_turns_beyond_a_range_are_claimed_as_unknown(recorded, unit):
    """Aileron rolls beyond 125 deg/s, turns beyond 3 g: eight runs, at every tenth of a second.

    Nothing is known of such a motion but the fixes. The NEES, averaged over the runs, has no time above
    30, where a model of usual manoeuvres has 1,500.
    """
    profile = read_profile("high-dynamics", {"sensors.imu": unit})
    truth, found = truth_of(recorded(profile.flight), 100.0), []
    for draw in range(8):
        drawn = pipeline.sense(profile, truth, draw)
        solution = load("loose-full", {}).run(drawn.data, drawn.initial)
        assert any("at or beyond its range" in text for *_, text in solution.events.select("restart"))
        found.append(error_series(truth, solution).nees)
    nees = np.mean(found, axis=0)
    assert nees.max() < 30.0
    assert nees.mean() < 9 * band(9 * 8)[1]


def test_less_its_biases_a_sample_inside_the_range_stays_inside():
    """A bias of 0.1 m/s^2 is learnt: a sample that much below the end of the range is no clipped one."""
    imu = replace(IMU, accel=replace(IMU.accel, range=29.4), gyro=replace(IMU.gyro, range=5.0))
    data = sensors.sense(weaving(1.0, rate=50.0), units(imu), 1, 0).data
    dvel_b = data.imu.dvel_b.copy()
    dvel_b[10, 2], dvel_b[20, 2] = -29.39 * 0.02, -29.4 * 0.02
    data = replace(data, imu=put(data.imu, slice(None), dvel_b=dvel_b))
    known = LearntBiases(np.zeros(3), np.full(3, 0.1), np.full(3, 1e-4), np.full(3, 1e-2))
    less = known.taken_off(data)
    assert np.flatnonzero(~less.imu.valid).tolist() == [20]
    rows, _, _ = timeline.imu_rows(less.imu, 0.0, less.specs.imu)
    assert sorted(set(range(len(less.imu))) - set(rows.tolist())) == [20]
