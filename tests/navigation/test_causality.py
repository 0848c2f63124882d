"""What looks ahead is caught, what does not is not: at drawn epochs, on fixes that come late."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.sensor_specs import Fault
from bench.navigation.built_in import load
from bench.navigation.causality import LookAhead, change_later, measure_look_ahead
from bench.navigation.engine.record_cuts import nothing_known
from bench.simulation import sensors
from tests.navigation.test_tight import MATCHED
from tests.weaving import GNSS, units, weaving

LATE = replace(GNSS, latency=0.6)
INSTANTS = (20.3, 31.25, 47.9)


def draws(**changes):
    spec = replace(units(gnss=LATE), **changes)
    truth = weaving(60.0, rate=50.0)
    return (sensors.sense(truth, spec, 4, run) for run in range(2))


def look(estimator, one, other, instants=INSTANTS):
    return measure_look_ahead(lambda data: estimator().run(data, one.initial), one.data, other.data, instants)


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
    assert look(lambda: load(use, {}), one, other) == LookAhead(0.0, False, True)


def test_the_smoother_uses_the_whole_record():
    one, other = draws()
    found = look(lambda: load("smoother", {}), one, other)
    assert found.whole
    assert found.text == "uses the future: the whole record"


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


MOODS = count(1)


class Moody:
    """Is another one each time."""

    def run(self, data, initial):
        found = load("loose-15", {}).run(data, initial)
        return replace(found, lla=found.lla * (1 + 1e-15 * next(MOODS)))


def test_one_that_takes_fixes_too_early_looks_ahead_by_their_delay():
    one, other = draws()
    found = look(EarlyBird, one, other, np.arange(20.0, 22.0, 0.2))
    assert 0.3 <= found.seconds <= 0.6
    assert not found.whole


def test_one_that_averages_ahead_looks_ahead_by_so_much():
    one, other = draws()
    found = look(Polished, one, other)
    assert found.seconds == pytest.approx(1.0, abs=0.11)
    assert found.text == f"uses the future: {found.seconds:.3g} s"


def test_nothing_is_proven_of_one_without_answers():
    one, other = draws()
    with pytest.raises(ValueError, match="it gives no answer"):
        look(Silent, one, other)


def test_one_that_differs_from_itself_is_not_repeatable():
    one, other = draws()
    assert look(Moody, one, other).text == "not repeatable: two runs of one record differ"


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
        (-1, [1001.0, 1002.0, 1003.0], 1003.0, LookAhead(0.0, False, True)),
        (0, [1001.0, 1002.0, 1003.0], 1003.0, LookAhead(1.0, False, True)),
        (2, [1001.0, 1002.0, 1003.0, 1005.0], 1003.0, LookAhead(2.0, True, True)),
        (2, [1001.0, 1002.0, 1003.0, 1005.0], 1003.5, LookAhead(2.0, True, True)),
        (46, [1001.0, 1002.0, 1003.0, 1005.0], 1003.0, LookAhead(2.0, True, True)),
        (2, [1001.0, 1039.0, 1041.0], 1040.0, LookAhead(1.0, False, True)),
    ],
)
def test_it_is_measured_to_the_sample(samples, output_t, instant, found):
    """At 1 Hz, from 1001 s on: what needs the next sample looks ahead by one, what needs all by all."""
    one, other = (at_one_hertz(drawn.data, output_t) for drawn in draws())
    seen = measure_look_ahead(Ahead(samples).run, one, other, [instant])
    assert (round(seen.seconds, 5), seen.whole, seen.repeatable) == (found.seconds, found.whole, True)


def test_only_what_arrives_later_is_changed():
    one, other = draws()
    fixes = one.data.fixes
    assert fixes.t_arrival[28] == pytest.approx(29.6)
    arrival = np.where(np.arange(len(fixes)) == 28, 30.3 + 0.5 * SAME_INSTANT, fixes.t_arrival)
    one = replace(one, data=replace(one.data, fixes=replace(fixes, t_arrival=arrival)))
    other = replace(
        other, data=replace(other.data, fixes=replace(other.data.fixes, valid=~other.data.fixes.valid))
    )
    changed = change_later(one.data, other.data, 30.3)
    fixes, late = changed.fixes, one.data.fixes.t_arrival > 30.3 + SAME_INSTANT
    np.testing.assert_array_equal(fixes.valid, one.data.fixes.valid)
    assert (late & (one.data.fixes.t < 30.3)).any()
    np.testing.assert_array_equal(fixes.lla[late], other.data.fixes.lla[late])
    np.testing.assert_array_equal(fixes.lla[~late], one.data.fixes.lla[~late])
    np.testing.assert_array_equal(changed.imu.t, one.data.imu.t)
    shorter = replace(other.data, baro=None)
    with pytest.raises(ValueError, match="baro: the two runs have different epochs"):
        change_later(one.data, shorter, 30.0)
