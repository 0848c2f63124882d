"""What looks ahead is caught, what does not is not: at drawn epochs, on fixes that come late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Events
from bench.core.records.sensor_specs import Fault
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.navigation.causality import (
    change_later,
    find_change,
    find_late,
    list_differing,
    measure_look_ahead,
    reverse_values,
)
from bench.navigation.engine.record_cuts import longest_wait, nothing_known
from bench.navigation.open_filters import PieceFilter
from bench.simulation import sensors
from tests.motions.truths import make_truth
from tests.navigation.test_tight import MATCHED
from tests.weaving import GNSS, units, weaving

LATE = replace(GNSS, latency=0.6)
INSTANTS = (20.3, 31.25, 47.9)


def draws(**changes):
    spec = replace(units(gnss=LATE), **changes)
    truth = weaving(60.0, rate=50.0)
    return (sensors.sense(truth, spec, 4, run) for run in range(2))


def look(estimator, one, other, instants=INSTANTS):
    def run(data):
        return estimator().run(data, one.initial)

    return measure_look_ahead(run, run(one.data), one.data, [other.data], instants)


FAULTS = (
    Fault("dropped", "imu", 25.0, 35.0, "gap"),
    Fault("bias-step", "baro", 40.0, 50.0, "step", step=(30.0,)),
)


@pytest.mark.parametrize(
    ("use", "changes"),
    [
        ("loose-full", {}),
        ("loose-22", {"faults": FAULTS}),
        ("loose-15", {"initial_heading_sd": np.pi}),
        ("tight", {"gnss": MATCHED, "assumed": units(gnss=MATCHED).assumed}),
        ("ukf", {}),
        ("classic-22", {}),
        ("gnss-only", {}),
        ("baro-inertial", {}),
    ],
)
def test_filters_do_not_look_ahead(use, changes):
    one, other = draws(**changes)
    assert look(lambda: load(use, {}), one, other) == (0.0, "no")


def straight(duration):
    """A flight at 25 m/s that shows no heading, with a nose that nods."""
    t = np.arange(round(duration * 50.0) + 1) / 50.0
    vel_n = np.broadcast_to([20.0, 15.0, 0.0], (len(t), 3)).copy()
    nods = [np.sin(3.0 * t), np.sin(2.2 * t + 1.0), 0.5 * np.sin(1.3 * t)]
    return make_truth(vel_n, np.column_stack(nods) * 0.01 + [0.0, 0.0, np.arctan2(15.0, 20.0)], 50.0)


@pytest.mark.parametrize(("run", "instants"), [(0, (130.0,)), (4, (60.0,)), (5, (100.0, 130.0))])
def test_a_reset_takes_nothing_from_the_future(run, instants):
    """A gyro that loses its heading in straight flight; later fixes jump, and tell hypotheses apart."""
    truth = straight(150.0)
    catalog = read_profile("figure-eight", {"sensors.imu": "mpu-9250", "sensors.gnss": "l1-code"}).sensors
    spec = units(catalog.imu, catalog.gnss, catalog.baro)
    one, other = (sensors.sense(truth, spec, 7, k) for k in (run, 99))
    found = load("loose-15", {}).run(one.data, one.initial)
    assert len(list(found.events.select("reset"))) > 1
    assert look(lambda: load("loose-15", {}), one, other, instants) == (0.0, "no")


def test_the_smoother_uses_the_whole_record():
    one, other = draws()
    assert look(lambda: load("smoother", {}), one, other)[1] == "the whole record"


class EarlyBird:
    """Takes fixes at the time they are of, before they are there."""

    def run(self, data, initial):
        fixes = replace(data.fixes, t_arrival=data.fixes.t)
        return load("loose-15", {}).run(replace(data, fixes=fixes), initial)


class Polished:
    """Averages each height with the next ten."""

    def run(self, data, initial):
        found = load("loose-15", {}).run(data, initial)
        lla = found.lla.copy()
        for k in range(len(lla)):
            lla[k, 2] = found.lla[k : k + 11, 2].mean()
        return replace(found, lla=lla)


class Silent:
    def run(self, data, initial):
        found = load("loose-15", {}).run(data, initial)
        return replace(found, lla=np.full_like(found.lla, np.nan), q_nb=np.full_like(found.q_nb, np.nan))


def test_one_that_takes_fixes_too_early_looks_ahead_by_their_delay():
    one, other = draws()
    seconds, text = look(EarlyBird, one, other, np.arange(20.0, 22.0, 0.2))
    assert 0.3 <= seconds <= 0.6
    assert text == f"{seconds:.3g} s"


def test_one_that_averages_ahead_looks_ahead_by_so_much():
    one, other = draws()
    seconds, text = look(Polished, one, other)
    assert seconds == pytest.approx(1.0, abs=0.21)
    assert text == f"{seconds:.3g} s"


def test_nothing_is_proven_of_one_without_answers():
    one, other = draws()
    with pytest.raises(ValueError, match="it gives no answer"):
        look(Silent, one, other)


class Ahead:
    """Answers with what the IMU measures some samples later: attitude alone, just after the sample."""

    def __init__(self, samples):
        self.samples = samples

    def run(self, data):
        rows = np.round(data.output_t).astype(int) - 1000 + self.samples
        rates = data.imu.dtheta_b[np.minimum(rows, len(data.imu) - 1)]
        answers = nothing_known(data.output_t)
        return replace(answers, q_nb=np.column_stack([np.ones(len(rows)), rates]))


def at_one_hertz(data, output_t):
    """The first samples of a record at 1001, 1002, ... 1050 s."""
    n = 50
    imu = replace(
        data.imu,
        **{name: getattr(data.imu, name)[:n] for name in ("dtheta_b", "dvel_b", "valid")},
        t=1001.0 + np.arange(n),
        dt=np.ones(n),
    )
    return replace(data, imu=imu, fixes=None, baro=None, output_t=np.array(output_t) + 0.4 * SAME_INSTANT)


@pytest.mark.parametrize(
    ("samples", "output_t", "instant", "found"),
    [
        (-1, [1001.0, 1002.0, 1003.0], 1003.0, (0.0, "no")),
        (0, [1001.0, 1002.0, 1003.0], 1003.0, (1.0, "1 s")),
        (2, [1001.0, 1002.0, 1003.0, 1005.0], 1003.0, (2.0, "the whole record")),
        (2, [1001.0, 1002.0, 1003.0, 1005.0], 1003.5, (2.0, "the whole record")),
        (46, [1001.0, 1002.0, 1003.0, 1005.0], 1003.0, (2.0, "the whole record")),
        (2, [1001.0, 1039.0, 1041.0], 1040.0, (2.99219, "2.99 s")),  # it uses the sample at 1042 s
    ],
)
def test_it_is_measured_to_the_sample(samples, output_t, instant, found):
    """At 1 Hz, from 1001 s on: what needs the next sample looks ahead by one, what needs all by all."""
    one, other = (at_one_hertz(drawn.data, output_t) for drawn in draws())
    run = Ahead(samples).run
    seconds, text = measure_look_ahead(run, run(one), one, [other], [instant])
    assert (round(seconds, 5), text) == found


def test_only_what_arrives_later_is_changed():
    one, other = draws()
    fixes = one.data.fixes
    assert fixes.t_arrival[28] == pytest.approx(29.6)
    arrival = np.where(np.arange(len(fixes)) == 28, 30.3 + 0.5 * SAME_INSTANT, fixes.t_arrival)
    one = replace(one, data=replace(one.data, fixes=replace(fixes, t_arrival=arrival)))
    other = replace(
        other, data=replace(other.data, fixes=replace(other.data.fixes, valid=~other.data.fixes.valid))
    )
    changed = change_later(one.data, [other.data], 30.3)
    fixes, late = changed.fixes, one.data.fixes.t_arrival > 30.3 + SAME_INSTANT
    np.testing.assert_array_equal(fixes.valid, np.where(late, other.data.fixes.valid, one.data.fixes.valid))
    assert (late & (one.data.fixes.t < 30.3)).any()
    np.testing.assert_array_equal(fixes.lla[late], other.data.fixes.lla[late])
    np.testing.assert_array_equal(fixes.lla[~late], one.data.fixes.lla[~late])
    np.testing.assert_array_equal(changed.imu.t, one.data.imu.t)
    shorter = replace(other.data, baro=None)
    with pytest.raises(ValueError, match="baro: the two runs have different epochs"):
        change_later(one.data, [shorter], 30.0)


def test_an_outage_to_come_is_another_one():
    """Its fixes are those of a record without it, as many as there are."""
    without = next(draws())
    out, other = draws(gnss_outages=((30.0, 40.0),))
    changed = change_later(out.data, [without.data, other.data], 32.0)
    assert len(changed.fixes) == len(out.data.fixes) == len(without.data.fixes) - 10
    later = out.data.fixes.t_arrival > 32.0
    calm = without.data.fixes
    np.testing.assert_array_equal(changed.fixes.lla[~later], out.data.fixes.lla[~later])
    np.testing.assert_array_equal(
        changed.fixes.lla[later], calm.lla[calm.t_arrival > 32.0][: int(later.sum())]
    )
    np.testing.assert_array_equal(changed.baro.t, out.data.baro.t)
    few = replace(without.data, fixes=calm.take(calm.t < 20.0))  # too few: those of the last
    np.testing.assert_array_equal(
        change_later(out.data, [few, other.data], 32.0).fixes.lla[later], other.data.fixes.lla[later]
    )


def test_another_motion_has_the_same_times():
    one = next(draws()).data
    other = reverse_values(one)
    for name in ("imu", "fixes", "baro"):
        np.testing.assert_array_equal(getattr(other, name).t, getattr(one, name).t)
    np.testing.assert_array_equal(other.imu.dtheta_b[0], one.imu.dtheta_b[-1])
    np.testing.assert_array_equal(other.fixes.lla, one.fixes.lla[::-1])
    np.testing.assert_array_equal(other.fixes.t_arrival, one.fixes.t_arrival)
    np.testing.assert_array_equal(other.output_t, one.output_t)


# --- in pieces --------------------------------------------------------------------------------------------


def feed(use, sensed, ends, whole=None, **initial):
    start = replace(sensed.initial, **initial)
    whole = load(use, {}).run(sensed.data, start) if whole is None else whole
    filter_ = PieceFilter(use, {}, load(use, {}), start, longest_wait(sensed.data))
    return whole, find_late(filter_, sensed.data, whole, ends)


def test_answers_in_pieces_are_those_of_the_record():
    """With late fixes and a gap of the IMU; a bit or an event that is another is found."""
    gaps, _ = draws(faults=FAULTS)
    one, _ = draws()
    for each in (gaps, one):
        ends = np.random.default_rng(3).random(len(each.data.output_t)) < 0.05
        whole, late = feed("loose-15", each, ends)
        assert late == []
    k = int(np.flatnonzero(ends)[20])
    for name in ("lla", "cov", "gyro_bias_b", "extra_sd"):
        column = getattr(whole, name).copy()
        column[k].flat[0] = np.nextafter(column[k].flat[0], np.inf)
        assert feed("loose-15", one, ends, replace(whole, **{name: column}))[1] == [whole.t[k]]
    t = float(whole.t[k])
    for row in ((t, t, "integrity", "more", "gnss"), (t - 3.0, t, "odd", "more", "gnss")):
        events = Events.from_rows([*whole.events.rows(), row])
        assert feed("loose-15", one, ends, replace(whole, events=events))[1] == [t]


def test_what_smooths_in_pieces_is_late():
    one, _ = draws()
    ends = np.ones(len(one.data.output_t), bool)
    smoothed = load("smoother", {}).run(one.data, one.initial)
    _, late = feed("loose-full", one, ends, smoothed)
    assert len(late) > 0.9 * len(ends)


def test_states_and_events_are_compared():
    one, _ = draws()
    found = load("loose-15", {}).run(one.data, one.initial)
    rows = np.arange(len(found))
    blank = replace(found, extra_names=(), extra=np.empty((len(rows), 0)), extra_sd=np.empty((len(rows), 0)))
    assert list_differing(found, rows, blank, rows).all()
    none = replace(found, extra=np.full_like(found.extra, np.nan), extra_sd=np.full_like(found.extra, np.nan))
    assert not list_differing(none, rows, blank, rows).any()
    started = replace(found, events=Events.from_rows([(10.0, 14.0, "integrity", "", "gnss")]))
    ended = replace(found, events=Events.from_rows([(10.0, 14.0, "odd", "", "gnss")]))
    longer = replace(found, events=Events.from_rows([(10.0, 30.0, "odd", "", "gnss")]))
    assert [find_change(found, started, t) for t in (9.0, 12.0)] == [None, 10.0]
    assert [find_change(found, ended, t) for t in (12.0, 15.0)] == [None, 14.0]
    assert find_change(longer, ended, 20.0) is None
