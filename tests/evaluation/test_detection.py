"""Detection against the script: what was rejected in the interval of a fault, how soon, and what else was.

The filter is loose-15 on a flight whose sensors it models exactly; its gate rejects a sound fix with 1e-5.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Events, Innovations, NavSolution, no_innovations
from bench.core.records.sensor_specs import Fault
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.consistency.chi_square import nis_by_sensor
from bench.evaluation.metrics import run_metrics
from bench.evaluation.metrics.case import Alarms, collect_alarms
from bench.evaluation.metrics.detection import (
    count_false_alarms,
    false_alarm_rate,
    false_alarm_share,
    false_alarms,
    fault_alarm_share,
    fault_delay,
    fault_max_h,
    find_lost_aiding,
    find_refusals,
    measure_delay,
)
from bench.navigation.models.loose_tight import Loose
from bench.simulation.sensors import sense
from tests.weaving import units, weaving

STEP = Fault("spoofing", "gnss", 60.0, 65.0, "step", step=(100.0, 0.0, 0.0), ramp=(0.0, 0.0, 0.0))
RAMP = Fault("spoofing", "gnss", 60.0, 110.0, "ramp", step=(0.0,) * 3, ramp=(0.0, 1.0, 0.0), coherent=False)
CREEP = replace(RAMP, ramp=(0.0, 0.02, 0.0))


@pytest.fixture(scope="module")
def flight():
    return weaving(120.0, 50.0)


def judged(flight, *faults, run=0, estimator=None):
    """Metrics of the filter, and its solution."""
    sensed = sense(flight, replace(units(), faults=faults), 3, run)
    solution = (estimator or Loose()).run(sensed.data, sensed.initial)
    _, found = run_metrics.measure(
        flight, solution, evaluation=EvaluationWindow(30.0), outages=(), faults=faults
    )
    return found, solution


def test_a_step_of_100_m_is_refused_at_the_first_epoch(flight):
    """The first fix of the interval is at its first time; nothing is rejected without cause."""
    found, solution = judged(flight, STEP)
    assert found["fault_1_detected"] == 1.0
    assert found["fault_1_delay_s"] == pytest.approx(0.0, abs=1e-6)
    table = solution.innovations
    rows = (table.code == table.sensor.index("gnss_position")) & (np.abs(table.t - 60.0) < 0.01)
    assert not table.accepted[rows].any()
    assert found["false_alarms_gnss_position"] == found["false_alarms_baro"] == 0.0
    assert found["fault_1_max_h_m"] < 3.0  # the filter is not pulled away


def test_a_step_between_epochs_is_noticed_at_the_next(flight):
    found, _ = judged(flight, replace(STEP, start=60.3))
    assert found["fault_1_delay_s"] == pytest.approx(0.7, abs=1e-6)


def test_a_ramp_of_1_mps_is_reported_with_its_delay(flight):
    """Five runs: after the fix is gone by several sigma (1.5 m and the filter's own), before it is by 30.

    It is detected at the first of two rejections in a row, which once is not the first of all."""
    for run in range(5):
        found, solution = judged(flight, RAMP, run=run)
        assert found["fault_1_detected"] == 1.0
        assert 2.0 <= found["fault_1_delay_s"] <= 20.0
        table = solution.innovations
        refused = table.t[~table.accepted & (table.t >= 60.0 - 1e-6)]
        lasting = refused[np.isin(np.round(refused + 1.0, 6), np.round(refused, 6))]
        assert found["fault_1_delay_s"] == pytest.approx(lasting.min() - 60.0)


def test_a_ramp_that_creeps_is_reported_as_undetected(flight):
    found, _ = judged(flight, CREEP)
    assert found["fault_1_detected"] == 0.0
    assert found["fault_1_delay_s"] is None


def test_a_fault_of_a_sensor_that_is_not_used_is_not_detected(flight):
    found, _ = judged(flight, STEP, estimator=Loose(gnss=False))
    assert found["fault_1_detected"] == 0.0
    assert "false_alarms_gnss_position" not in found


def test_faults_of_the_imu_show_in_any_update(flight):
    """A yaw gyro that is off by 3 deg/s tears the velocity away within seconds."""
    step = Fault("gyro-step", "gyro", 60.0, 75.0, "step", step=(0.0, 0.0, 0.05), ramp=(0.0, 0.0, 0.0))
    found, _ = judged(flight, step)
    assert found["fault_1_detected"] == 1.0
    assert found["fault_1_delay_s"] < 15.0


def test_without_faults_there_is_nothing_to_score(flight):
    found, _ = judged(flight)
    assert not [name for name in found if name.startswith(("fault_", "false_alarms"))]


def by_hand(refused, events=()):
    """A solution that rejected positions and velocities of GNSS and heights at given times."""
    t, names = np.arange(1.0, 101.0), ("gnss_position", "gnss_velocity", "baro")
    code = np.repeat(np.arange(len(names)), len(t))
    accepted = np.concatenate([~np.isin(t, list(refused.get(name, ()))) for name in names])
    one = np.ones(len(code))
    table = Innovations(np.tile(t, len(names)), names, code, 0 * code, one, one, one, accepted)
    told = Events.from_rows(list(events))
    empty = np.empty((0, 3))
    return NavSolution(
        np.empty(0), empty, empty, np.empty((0, 4)), empty, empty, np.empty((0, 9, 9)), (),
        np.empty((0, 0)), np.empty((0, 0)), table, told,
    )  # fmt: skip


def test_alarms_count_for_the_sensor_that_is_struck_and_in_the_interval():
    solution = by_hand({"gnss_position": [10.0, 20.0, 21.0, 30.0], "baro": [22.0, 23.0]})
    raised = collect_alarms(nis_by_sensor(solution.innovations), solution.events)
    gnss, baro = Fault("spoofing", "gnss", 20.0, 30.0, ""), Fault("baro-step", "baro", 21.5, 30.0, "")
    assert measure_delay(gnss, raised) == 0.0
    assert measure_delay(baro, raised) == 0.5
    assert measure_delay(replace(gnss, start=24.0), raised) is None  # the end does not belong to it
    assert measure_delay(replace(baro, start=22.5), raised) is None  # the first of a pair before it does not
    assert measure_delay(Fault("baro-step", "baro", 22.0, 23.0, ""), raised) == 0.0  # it has no second update
    assert measure_delay(Fault("baro-step", "baro", 23.0, 25.0, ""), raised) is None  # its second is used
    assert count_false_alarms([gnss, baro], raised, "gnss_position", 0.0) == 2
    assert count_false_alarms([gnss], raised, "gnss_position", 15.0) == 1
    assert count_false_alarms([gnss], raised, "baro", 0.0) == 2
    assert count_false_alarms([gnss, baro], raised, "baro", 0.0) == 0


def told_of(solution, fault, *, end=100.0):
    """What the metrics say of a fault, by a solution made by hand."""
    nis = nis_by_sensor(solution.innovations)
    alarms, t = collect_alarms(nis, solution.events), np.arange(0.0, end + 0.1, 0.1)
    case: Any = SimpleNamespace(t=t, alarms=alarms, faults={"1": fault}, pos_n=np.zeros((len(t), 3)))
    return fault_delay(case)["1"], fault_alarm_share(case).get("1")


def test_a_filter_that_refuses_one_fix_by_chance_and_follows_has_not_noticed():
    """One rejection now and then is what a gate does; two in a row are an alarm. Three of 40 s are."""
    ramp = Fault("spoofing", "gnss", 20.0, 60.0, "")
    assert told_of(by_hand({"gnss_position": [25.0, 31.0, 50.0]}), ramp) == (None, 3 / 40)
    assert told_of(by_hand({"gnss_position": [25.0, 31.0, 32.0]}), ramp) == (11.0, 3 / 40)
    assert told_of(by_hand({"gnss_position": range(35, 70)}), ramp) == (15.0, 25 / 40)
    assert told_of(by_hand({"gnss_position": range(35, 70)}), ramp, end=44.0) == (15.0, 9 / 24)
    assert told_of(by_hand({"baro": range(35, 70)}), ramp) == (None, 0.0)
    late = by_hand({"gnss_position": range(35, 70)})
    late = replace(late, innovations=replace(late.innovations, t=late.innovations.t + 0.5))
    assert told_of(late, ramp) == (15.5, 25 / 40)


def test_a_fault_whose_positions_are_followed_is_not_refused_for_all_of_its_time():
    """Ten fixes a second: positions rejected for the first 24 of 40 s, velocities all along."""
    ramp = Fault("spoofing", "gnss", 20.0, 60.0, "")
    always, first = range(20, 60), range(20, 44)
    found = by_hand({"gnss_position": first, "gnss_velocity": always})
    assert told_of(found, ramp) == (0.0, 24 / 40)
    assert told_of(by_hand({"gnss_position": [], "gnss_velocity": always}), ramp) == (0.0, 0.0)
    fast = replace(found.innovations, t=found.innovations.t / 10.0)  # within a second some are used
    assert told_of(replace(found, innovations=fast), replace(ramp, start=2.0, end=6.0)) == (0.0, 24 / 40)


def test_an_event_is_an_alarm_as_long_as_it_stands():
    """From 30 to 50 s of a fault of 20 to 60 s: 21 seconds of 40; rejected updates in it add nothing."""
    ramp = Fault("spoofing", "gnss", 20.0, 60.0, "")
    event = (30.0, 50.0, "integrity", "20 fixes rejected", "gnss_position")
    assert told_of(by_hand({}, [event]), ramp) == (10.0, 21 / 40)
    assert told_of(by_hand({"gnss_position": [40.0]}, [event]), ramp) == (10.0, 21 / 40)
    assert told_of(by_hand({}, [(10.0, *event[1:])]), ramp) == (None, 31 / 40)  # it stood before
    unused = replace(by_hand({}), innovations=no_innovations())
    assert told_of(unused, ramp) == (None, None)


def test_false_alarms_per_hour_are_those_of_the_seconds_without_a_fault():
    """Of 100 s ten have a fault; two of three alarms are outside: 2 in 90 s, 80 in an hour."""
    alarms = (Alarms("baro", ("baro",), np.array([10.0, 25.0, 50.5]), np.arange(0.0, 100.0, 0.5)),)
    fault = Fault("baro-step", "baro", 20.0, 30.0, "")
    case: Any = SimpleNamespace(begin=0.0, t=np.arange(0.0, 100.5, 0.5), scripted=(fault,), alarms=alarms)
    assert false_alarm_rate(case) == pytest.approx(80.0)
    assert false_alarm_share(case) == pytest.approx(2.0 / 90.0)


def test_the_longest_refusal_counts_by_its_time_and_a_scripted_fault_does_not():
    """Rejected for 0, 9 and 4 s, and for 30 s of a fault of its own."""
    refused = [5.0, *range(20, 30), *range(40, 45), *range(60, 91)]
    fault = Fault("spoofing", "gnss", 60.0, 91.0, "")
    nis = nis_by_sensor(by_hand({"gnss_position": refused, "baro": [1.0, 3.0]}).innovations)
    case: Any = SimpleNamespace(nis=nis, scripted=(fault,))
    assert find_refusals(case) == {"gnss_position": (20.0, 29.0), "baro": (1.0, 1.0)}
    case.scripted = ()
    assert find_refusals(case)["gnss_position"] == (60.0, 90.0)


def test_position_fixes_refused_for_more_than_a_minute_are_lost_aiding():
    """From 10 to 70 s is a minute; velocities may be rejected for as long as there are."""
    for last, lost in ((70, False), (71, True)):
        nis = nis_by_sensor(
            by_hand({"gnss_position": range(10, last + 1), "baro": range(1, 101)}).innovations
        )
        told = find_lost_aiding(SimpleNamespace(nis=nis, scripted=()))
        assert (told is not None) == lost
        if lost:
            assert told == "gnss_position was rejected from t = 10 to 71 s, 61 s without a pause"


def test_false_alarms_count_from_the_instant_on_whatever_its_last_digits():
    t = 10.0 + SAME_INSTANT * np.array([-2.0, -0.5, 0.5])
    one = Alarms("baro", ("baro",), t, t)
    case: Any = SimpleNamespace(
        begin=10.0, scripted=(Fault("gnss-step", "gnss", 0.0, 99.0, ""),), alarms=(one, one)
    )
    assert false_alarms(case) == {"baro": 4.0}
    case.scripted = ()
    assert false_alarms(case) == {}


def test_the_largest_error_of_a_fault_is_horizontal_and_inside_of_it():
    t = np.arange(0.0, 10.5, 0.5)
    pos_n = np.outer(t, [3.0, 4.0, 100.0])
    case: Any = SimpleNamespace(t=t, pos_n=pos_n, faults={"1": Fault("x", "gnss", 2.0, 5.0, "")})
    assert fault_max_h(case) == {"1": pytest.approx(5.0 * 4.5)}
    case.faults = {"2": Fault("x", "gnss", 20.0, 25.0, "")}
    assert fault_max_h(case) == {}


def test_an_integrity_event_is_an_alarm_of_the_sensor_it_names():
    rows = [
        (25.0, 25.0, "integrity", "barometer and GNSS height differ by 5 sigma", "gnss_position baro"),
        (50.0, 55.0, "integrity", "rejected by nis", "baro"),
        (45.0, 45.0, "integrity", "not a word of the baro"),
        (5.0, 5.0, "timeline", "gnss", "gnss"),
    ]
    solution = by_hand({}, rows)
    raised = collect_alarms({}, solution.events)
    gnss, baro = Fault("spoofing", "gnss", 20.0, 60.0, ""), Fault("baro-step", "baro", 40.0, 60.0, "")
    assert measure_delay(gnss, raised) == 5.0
    assert measure_delay(baro, raised) == 10.0
    assert count_false_alarms([baro], raised, "integrity", 0.0) == 2


EVERY = [
    STEP,
    Fault("baro-step", "baro", 60.0, 65.0, "", step=(50.0,), ramp=(0.0,)),
    Fault("accel-step", "accel", 60.0, 65.0, "", step=(0.1, 0.0, 0.0), ramp=(0.0,) * 3),
    *(Fault("frozen", s, 60.0, 62.0, "") for s in ("gnss", "baro", "gyro", "accel")),
    *(Fault("noise-burst", s, 60.0, 65.0, "", times=20.0) for s in ("gnss", "baro", "gyro", "accel")),
    *(Fault("latency", s, 60.0, 65.0, "", delay=3.0) for s in ("gnss", "baro")),
    *(Fault(k, s, 60.0, 65.0, "") for k in ("dropped", "repeated") for s in ("gnss", "baro", "imu")),
]

NOTICED = {("baro-step", "baro"), ("noise-burst", "gnss"), ("noise-burst", "baro")}
"""By 50 m, and twenty times the noise, no gate can be taken in."""


@pytest.mark.parametrize("fault", EVERY, ids=lambda f: f"{f.kind}-{f.sensor}")
def test_a_filter_lives_with_every_fault_and_the_timeline_counts_its_rows(flight, fault):
    """Five seconds of anything: a solution at every time, and what came twice or late is reported."""
    found, solution = judged(flight, fault)
    assert np.isfinite(solution.lla).all()
    if fault is STEP or (fault.kind, fault.sensor) in NOTICED:
        assert found["fault_1_detected"] == 1.0
    if fault.kind in ("dropped", "repeated"):  # what is left of the record is sound
        assert found["fault_1_detected"] == 0.0
    told = " ".join(solution.events.text)
    if fault.kind == "repeated":
        assert f"{'gnss' if fault.sensor == 'gnss' else fault.sensor}: " in told
        assert "repeated" in told
    if (fault.kind, fault.sensor) == ("dropped", "imu"):
        assert "gap of" in told
    if fault.kind == "latency":
        assert "going back in time" in told  # fixes from before the end arrive after later ones
