"""The records: read-only, checked at birth, equal after a copy; strict on the truth side only."""

import pickle

import numpy as np
import pytest

from bench.core.mathematics.arrays import as_float, as_kind, read_only
from bench.core.mathematics.random_streams import stream
from bench.core.records.data import Events, ImuData, NavSolution, SensorData, Trajectory, no_events
from bench.core.records.instruments import BaroData
from bench.core.records.sensor_specs import AssumedSpecs, ImuSpec, TriadSpec
from tests.synthetic import still


def trajectory(**change):
    truth = still(1.0, 100.0)
    fields = {name: getattr(truth, name) for name in Trajectory.__slots__} | change
    return Trajectory(**fields)


def test_the_instants_of_the_answers_grow():
    specs = AssumedSpecs(ImuSpec("none", TriadSpec(), TriadSpec()), None)
    none = np.empty(0)
    imu = ImuData(none, none, none.astype(bool), np.empty((0, 3)), np.empty((0, 3)))
    with pytest.raises(ValueError, match=r"SensorData.output_t must increase; row 2 has 1 s after 1 s"):
        SensorData(imu, None, np.zeros(3), specs, np.array([0.0, 1.0, 1.0]))


def test_columns_are_read_only_and_do_not_freeze_the_callers_array():
    mine = np.linspace(0, 1, 101)
    truth = trajectory(t=mine)
    with pytest.raises(ValueError, match="read-only"):
        truth.t[0] = 1.0
    mine[0] = 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t": np.zeros(101)}, r"Trajectory.t must increase; row 1 has 0 s after 0 s"),
        (
            {"vel_n": np.full((101, 3), np.nan)},
            "Trajectory.vel_n must be finite; the first bad value is in row 0",
        ),
        ({"vel_n": np.zeros((101, 2))}, r"Trajectory.vel_n must have shape \(N, 3\)"),
        ({"lla": np.zeros((100, 3))}, "Trajectory: columns differ in length"),
        ({"dtheta_b": np.zeros((101, 3))}, r"Trajectory.dtheta_b must have shape \(100, 3\); got \(101, 3\)"),
    ],
)
def test_truth_is_strict_at_birth(change, message):
    with pytest.raises(ValueError, match=message):
        trajectory(**change)


def test_sensor_records_take_what_a_receiver_sends():
    """NaN, repeated times and time going back are data; shape and type are not negotiable."""
    t = np.array([1.0, 1.0, 0.5, np.nan])
    flags = np.array([True, False, True, True])
    baro = BaroData(t, t, flags, np.full(4, np.nan), t)
    assert len(baro.t) == 4
    with pytest.raises(ValueError, match=r"BaroData.valid must contain values of type bool"):
        BaroData(t, t, np.array([0, 1, 2, 1]), t, t)
    with pytest.raises(ValueError, match="columns differ in length"):
        BaroData(t, t, flags[:2], t, t)


def test_a_pickled_record_is_equal_and_still_read_only():
    truth = trajectory()
    copy = pickle.loads(pickle.dumps(truth))
    for name in ("t", "lla", "vel_n", "q_nb", "dtheta_b", "dvel_b"):
        np.testing.assert_array_equal(getattr(copy, name), getattr(truth, name))
        assert not getattr(copy, name).flags.writeable
    assert copy.events.kind == truth.events.kind


def test_solution_counts_its_names():
    n = 3
    with pytest.raises(ValueError, match=r"NavSolution.extra must have shape \(N, 1\); got \(3, 2\)"):
        NavSolution(
            t=np.arange(n), lla=np.zeros((n, 3)), vel_n=np.zeros((n, 3)), q_nb=np.zeros((n, 4)),
            gyro_bias_b=np.zeros((n, 3)), accel_bias_b=np.zeros((n, 3)), cov=np.zeros((n, 9, 9)),
            extra_names=("one",), extra=np.zeros((n, 2)), extra_sd=np.zeros((n, 1)),
        )  # fmt: skip


def test_events_are_sorted_and_asked_by_kind():
    events = Events.from_rows([(5.0, 6.0, "leg", "b"), (1.0, 2.0, "leg", "a"), (3.0, 3.0, "fault", "c")])
    assert events.select("leg") == [(1.0, 2.0, "a"), (5.0, 6.0, "b")]
    assert len(no_events()) == 0


def test_arrays_say_what_would_be_right():
    with pytest.raises(ValueError, match=r"q must have shape \(4\); got \(3,\)"):
        as_float("q", [1, 2, 3], (4,))
    with pytest.raises(ValueError, match="row 1"):
        as_float("t", [0.0, np.inf], (None,))
    assert as_float("alt", 3, ()).shape == ()
    with pytest.raises(ValueError, match="n must contain values of type int64"):
        as_kind("n", [1.5], np.int64, (None,))


def test_streams_differ_by_seed_run_and_name_and_by_nothing_else():
    draws = {
        (seed, run, name): stream(seed, run, name).normal()
        for seed in (1, 2)
        for run in (0, 1)
        for name in ("imu.gyro.white", "imu.accel.white")
    }
    assert len(set(draws.values())) == 8
    assert all(stream(*key).normal() == value for key, value in draws.items())


def test_a_column_that_is_frozen_already_is_taken_as_it_is_and_checked_all_the_same():
    frozen = read_only(np.arange(6.0))
    record = BaroData(t=frozen, t_arrival=frozen, valid=np.ones(6, bool), alt_baro=frozen, sd=frozen)
    assert record.alt_baro is frozen
    turned = read_only(np.zeros((6, 2)).T[0])  # every other number: not in one piece
    assert BaroData(
        t=frozen, t_arrival=frozen, valid=np.ones(6, bool), alt_baro=turned, sd=frozen
    ).alt_baro.flags.c_contiguous
    for wrong in (read_only(np.zeros((6, 2))), read_only(np.zeros(5)), read_only(np.array(1.0))):
        with pytest.raises(ValueError, match=r"alt_baro must have shape|differ in length"):
            BaroData(t=frozen, t_arrival=frozen, valid=np.ones(6, bool), alt_baro=wrong, sd=frozen)
