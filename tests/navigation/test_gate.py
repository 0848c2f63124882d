"""The gate: hand cases of what becomes of a measurement, and of how rejected fixes move."""

from __future__ import annotations

import numpy as np
import pytest

from bench.core.words.exceptions import EstimatorError
from bench.navigation.built_in import load
from bench.navigation.engine.gate import (
    LOST,
    REFUSED,
    SOUND,
    STEPPED,
    InnovationGate,
    decide_kernel,
    drift_kernel,
    fix_kernel,
    jumps_kernel,
    moves_kernel,
    new_log,
    new_trust,
    note_kernel,
    refusals,
    returns_kernel,
)

SENSORS = ("gnss_position", "gnss_velocity", "baro", "radar")
RADAR = 3


def outcomes(times, channel=RADAR, opens=True, used=(), after=10.0):
    """What becomes of unsound measurements of a channel, while others are ``used``."""
    trust, found = new_trust(len(SENSORS), 0.0), []
    for t in times:
        found.append(decide_kernel(float(t), channel, False, False, opens, after, len(SENSORS), trust))
        for other in used:
            assert decide_kernel(float(t), other, True, False, True, after, len(SENSORS), trust) == SOUND
    return found


def test_a_sensor_is_believed_again_after_ten_seconds_of_refusals():
    assert outcomes(np.arange(1, 13)) == [REFUSED] * 10 + [LOST, REFUSED]
    at_10_hz = outcomes(1.0 + np.arange(102) / 10)
    assert at_10_hz == [REFUSED] * 100 + [LOST, REFUSED]


def test_a_slow_sensor_is_refused_three_times_at_least():
    assert outcomes([1.0, 31.0, 61.0, 91.0, 121.0]) == [REFUSED] * 3 + [LOST, REFUSED]


def test_a_sensor_without_a_state_that_may_step_stays_out():
    assert set(outcomes(np.arange(1, 100), opens=False)) == {REFUSED}


def test_a_sound_measurement_ends_a_row_of_refusals():
    trust = new_trust(len(SENSORS), 0.0)
    found = [
        decide_kernel(float(t), RADAR, t == 9, False, True, 10.0, len(SENSORS), trust) for t in range(1, 21)
    ]
    assert found == [REFUSED] * 8 + [SOUND] + [REFUSED] * 10 + [LOST]


@pytest.mark.parametrize(
    ("channel", "used", "verdict"),
    [
        (RADAR, [0], STEPPED),  # fixes hold the filter: the altimeter made a step
        (RADAR, [2], LOST),  # a barometer holds nothing but the height
        (0, [1], LOST),  # positions are rejected: the filter may have been led away from them
        (0, [2], LOST),
        (1, [0], LOST),
    ],
)
def test_where_gnss_is_used_meanwhile_the_filter_is_not_lost(channel, used, verdict):
    assert outcomes(np.arange(1, 12), channel, used=used)[-1] == verdict


def moving(place, speed, seconds=30):
    """Whether fixes of 1 Hz are to be accepted, by innovations of their position and velocity along east."""
    trust, found = new_trust(2, 0.0), []
    for t in range(1, seconds + 1):
        y = np.array([0.0, place(t), 0.0, 0.0, speed(t), 0.0])
        found.append(moves_kernel(float(t), y, np.array([4.0] * 3 + [0.01] * 3), 25.9, 10.0, trust))
        decide_kernel(float(t), 0, False, False, False, 10.0, 2, trust)
    return found


def test_fixes_that_move_as_they_say_are_believed_after_ten_seconds():
    late = [False] * 10 + [True] * 20
    assert moving(lambda t: 80.0, lambda t: 0.0) == late  # a step of the place
    assert moving(lambda t: 50.0 + 9.0 * t, lambda t: 9.0) == late  # the filter drifts away
    assert moving(lambda t: 0.4 * t * t, lambda t: 0.8 * t) == late  # and faster and faster


def test_fixes_that_do_not_are_not():
    assert not any(moving(lambda t: -25.0 * t, lambda t: 0.0))  # frozen, in straight flight
    assert not any(moving(lambda t: -300.0 * np.sin(t / 12), lambda t: 25.0 - 25.0 * np.cos(t / 12)))
    assert not any(moving(lambda t: 8.0 * t, lambda t: 0.0))  # the place alone is pulled away


def test_a_receiver_that_recovers_is_believed_ten_seconds_later():
    found = moving(lambda t: -25.0 * min(t, 12), lambda t: 0.0, 40)
    assert not any(found[:20])
    assert all(found[22:])


def test_a_burst_that_jumps_moves_the_place_alone():
    """A fix was used before; where one drifts off the attitude may be wrong. Both are believed after 10 s."""
    for place, speed, verdict in (
        (80.0, 0.0, STEPPED),
        (12.0, 0.0, LOST),  # 11.3 m is beyond the gate, twice that is a jump
        (28.0, 0.4, STEPPED),
        (28.0, 15.0, LOST),  # twice a free fall of 1 s is 19.6 m/s
        (0.0, 40.0, STEPPED),
    ):
        trust, outcomes = new_trust(2, 0.0), []
        decide_kernel(1.0, 0, True, False, True, 10.0, 2, trust)
        decide_kernel(1.0, 1, True, False, True, 10.0, 2, trust)
        for t in range(2, 20):
            y = np.array([0.0, place + speed * (t - 2.0), 0.0, 0.0, speed, 0.0])
            var = np.array([4.0] * 3 + [0.01] * 3)
            opens = moves_kernel(t + 0.0, y, var, 25.9, 10.0, trust)
            outcomes.append(decide_kernel(t + 0.0, 0, False, False, opens, 10.0, 2, trust))
        assert outcomes[:11] == [*[REFUSED] * 10, verdict]


@pytest.mark.parametrize(
    ("dt", "position", "velocity", "off", "speed", "jumps"),
    [
        (1.0, 101.0, 0.0, 10.0, 0.1, True),
        (1.0, 99.0, 0.0, 10.0, 0.1, False),  # four times the limit of 25
        (1.0, 101.0, 0.0, 9.8, 0.1, False),  # a fall of half a g, and the speed
        (9.9, 101.0, 0.0, 400.0, 0.1, False),
        (10.0, 30.0, 0.0, 400.0, 0.1, True),  # after an outage
        (1.0, 0.0, 101.0, 0.0, 19.7, True),
        (1.0, 1e4, 101.0, 1e4, 19.6, False),
        (0.1, 0.0, 99.0, 0.0, 19.7, False),
    ],
)
def test_a_fix_jumps_if_no_filter_drifts_as_far(dt, position, velocity, off, speed, jumps):
    assert jumps_kernel(dt, position, velocity, off, speed, 25.0) is jumps


def test_a_gate_in_python_logs_what_it_decides_and_tells_of_refusals():
    gate = InnovationGate(SENSORS, 0.0, 1e-5, 10.0)
    for t in range(1, 6):
        gate.decide(float(t), RADAR, [40.0], [4.0], 400.0, sound=t == 5)
    table, events = gate.take(last=True)
    assert table.accepted.tolist() == [False] * 4 + [True]
    assert table.z.tolist() == [40.0] * 5
    assert [(a, b, text) for a, b, _, text, _ in events] == [(1.0, 4.0, "radar: 4 in a row rejected")]
    assert len(gate.take(last=True)[0]) == 0


def test_the_number_of_refusals_is_an_option_no_more():
    with pytest.raises(EstimatorError) as caught:
        load("loose-15", {"readmit_after": 10})
    told = "unknown option 'readmit_after'; use 'readmit_after_s', the time of rejections in seconds"
    assert str(caught.value) == f"filter 'loose-15': {told}"


@pytest.mark.parametrize(
    ("position", "velocity", "drifted"),
    [
        (12.0, 0.0, False),
        (12.0, 9.0, True),
        (30.0, 12.0, True),
        (11.1, 30.0, False),  # the limit is that of three components
    ],
)
def test_a_drift_while_there_were_no_fixes_moves_the_velocity_too(position, velocity, drifted):
    S = np.eye(6) + 4.0 * np.kron([[1.0, 0.95], [0.95, 1.0]], np.eye(3))
    y = np.array([position, 0.0, 0.0, velocity, 0.0, 0.0])
    gate = InnovationGate(SENSORS, 0.0, 1e-5, 10.0)
    gate.see_fix(9.9, y, S, np.full(3, 2.0))
    assert not gate.drifted
    gate.see_fix(10.0, y, S, np.full(3, 2.0))
    assert gate.drifted is drifted
    gate.see_fix(10.0, y, S, np.full(3, 10.0))  # the filter reports a smaller sigma than the fix
    assert gate.drifted is (velocity == 12.0)
    gate.decide(10.0, 0, y[:3], [1.0] * 3, 0.0, sound=True)
    gate.see_fix(10.5, y, S, np.ones(3))
    assert not gate.drifted


@pytest.mark.parametrize(
    ("position", "velocity", "both", "apart", "drifted"),
    [
        (9.0, 99.0, 99.0, 1.0, False),  # the position passes
        (11.0, 11.0, 99.0, -1.0, True),  # the velocity does not pass either
        (11.0, 9.0, 21.0, 1.0, True),  # once the position is used the velocity is to be expected
        (11.0, 9.0, 21.5, 1.0, False),
        (11.0, 9.0, 20.0, 0.0, False),  # the filter knows its place better than the fix
    ],
)
def test_what_is_a_drift_and_what_a_step_of_the_receiver(position, velocity, both, apart, drifted):
    assert drift_kernel(position, velocity, both, apart, 10.0) is drifted


@pytest.mark.parametrize(
    ("misses", "used", "returns"),
    [
        ((0, 0), (-3.0, 0.0), True),
        ((0, 0), (0.1, -3.0), False),
        ((0, 0), (-3.0, 0.1), False),
        ((1, 0), (0.0, 0.0), False),
        ((0, 1), (0.0, 0.0), False),
        ((2, 2), (0.0, 0.0), False),
    ],
)
def test_a_fix_comes_back_after_ten_seconds_without_any(misses, used, returns):
    trust = new_trust(2, 0.0)
    trust.misses[:], trust.used[:] = misses, used
    assert returns_kernel(10.0, trust) is returns


@pytest.mark.parametrize("missed", [0, 1])
def test_a_way_is_the_integral_of_the_velocities_between_unequal_intervals(missed):
    """By trapezoids over 2 s and 3 s; off it by 18 variances of position and 25 of velocity at the limit."""
    velocities = np.array([[1.0, 2.0, -1.0], [3.0, 1.0, 0.0], [2.0, -2.0, 4.0]])
    way = np.array([[0.0] * 3, [4.0, 3.0, -1.0], [11.5, 1.5, 5.0]])
    var = np.array([4.0, 9.0, 1.0, 0.01, 0.04, 0.09])
    S = 18.0 * var[:3] + 25.0 * var[3:]
    for part, agrees in ((0.99, True), (1.01, False)):
        trust = new_trust(4, -7.0)
        off = np.sqrt(part * 20.0 * np.array([0.5, 0.3, 0.2]) * S)
        for t, v, passed in zip((1.0, 3.0, 6.0), velocities, way, strict=True):
            place = np.array([10.0, -20.0, 5.0]) + passed + off * (t == 6.0)
            found = moves_kernel(t, np.append(place, v), var, 20.0, 5.0000005, trust)
            trust.misses[missed] += 1
        assert found is agrees
        assert trust.way_t.tolist() == [1.0 if agrees else 6.0, 6.0]
        assert not moves_kernel(6.0, np.append(place, v), var, 20.0, 5.1, trust)


def test_a_gate_of_a_compiled_filter_sees_a_fix_as_one_in_python_does():
    """NIS of position, velocity and both by whole matrices, with states that the fix shows beside it."""
    rng, seen = np.random.default_rng(5), set[tuple[bool, bool]]()
    for k in range(60):
        root = rng.normal(size=(9, 9))
        P, H, r = root @ root.T, rng.normal(size=(6, 9)), 10.0 ** rng.uniform(-1.0, 2.0, 6)
        sizes = 10.0 ** rng.uniform(0.2, 0.8, 2)
        if k % 3 == 1:  # a drift, and the filter knows its place a little worse than the fix does
            r[:3], sizes = np.trace((H @ P @ H.T)[:3, :3]) / 6.0, np.array([6.0, 0.5])
        S = H @ P @ H.T + np.diag(r)
        y = np.linalg.cholesky(S) @ (rng.normal(size=6) * np.repeat(sizes, 3))
        gate, trust = InnovationGate(SENSORS, 0.0, 1e-5, 1.0), new_trust(2, 0.0)
        if k % 3 == 0:  # rejected a second ago, elsewhere
            for one in (gate.trust, trust):
                moves_kernel(9.0, np.append(y[:3] - y[3:], y[3:]), np.ones(6), 25.9, 1.0, one)
                decide_kernel(9.0, 0, False, False, False, 1.0, 2, one)
        gate.see_fix(10.0, y, S, r[:3])
        work = (np.zeros((6, 7)), np.zeros((6, 9)), np.zeros((6, 10), np.int64))
        innovation, var = np.empty(6), np.empty(6)
        found = fix_kernel.py_func(
            10.0, P, np.zeros(9), H, -y, r, gate.limits[3], 1.0, trust, innovation, var, *work
        )
        assert found == (gate.drifted, gate.moves, gate.contradicts)
        np.testing.assert_array_equal(innovation, y)
        np.testing.assert_allclose(trust.way, gate.trust.way, rtol=1e-9)
        np.testing.assert_array_equal(trust.way_t, gate.trust.way_t)
        np.testing.assert_allclose(var[:3], np.diag(S)[:3])
        seen.add(found[:2])
    assert seen == {(True, False), (False, True), (False, False)}


def test_a_gate_in_python_believes_a_fix_again_that_moves_as_it_says_and_no_other():
    gate = InnovationGate(SENSORS, 0.0, 1e-5, 10.0)
    for moves, fix in ((False, REFUSED), (True, LOST)):
        gate.moves = moves
        for t in range(12):
            of_radar, of_fix = (
                gate.decide(float(t), code, [9.0], [1.0], 81.0, sound=False) for code in (RADAR, 0)
            )
            if t == 10:
                assert (of_fix, of_radar) == (fix, LOST)
        gate = InnovationGate(SENSORS, 0.0, 1e-5, 10.0)
    gate.moves = False
    gate.see_position()
    assert (gate.moves, gate.drifted) == (True, False)


def test_what_is_noted_of_a_measurement():
    log = new_log(2)
    note_kernel.py_func(1.5, 2, 3, 1, 4.0, 5.0, 6.0, True, log)
    note_kernel.py_func(2.5, 7, 8, 0, -4.0, 9.0, 16.0, False, log)
    assert log.filled.tolist() == [2]
    assert log.numbers.T.tolist() == [[1.5, 4.0, 5.0, 6.0], [2.5, -4.0, 9.0, 16.0]]
    assert log.marks.T.tolist() == [[2, 1, 1, 3], [7, 0, 0, 8]]


def test_more_channels_begin_with_nothing_refused_and_the_others_stay():
    trust = new_trust(2, 1.0)
    for t in (2.0, 3.0):
        decide_kernel(t, 1, False, False, False, 9.0, 2, trust)
    more = trust.with_channels(4, 5.0)
    assert more.misses.tolist() == [0, 2, 0, 0]
    assert more.since.tolist() == [1.0, 2.0, 5.0, 5.0]
    assert more.used.tolist() == [1.0, 1.0, 5.0, 5.0]
    assert trust.with_channels(2, 5.0) is trust
    assert more.with_channels(3, 5.0) is more


def test_refusals_are_told_once_each_however_the_log_is_cut():
    """Of three channels, components of a measurement together; a channel that a cut lacks goes on."""
    names, rng = ["a", "b", "c"], np.random.default_rng(8)
    channel = np.repeat(rng.integers(0, 3, 300), 2)
    accepted = np.repeat(rng.random(300) < 0.3, 2)
    t = np.repeat(np.arange(300.0), 2)
    marks = np.array([channel + 7, np.tile([0, 1], 300), accepted, channel])
    wanted = []
    for one in range(3):
        row: list[float] = []
        for k in [*np.flatnonzero(channel == one)[::2], None]:
            if k is not None and not accepted[k]:
                row.append(t[k])
            elif row:
                said = f"{names[one]}: {len(row)} in a row rejected"
                wanted.append((row[0], row[-1], "refused", said, names[one]))
                row = []
    assert refusals(t, marks, names, {}, last=True) == sorted(wanted)
    for cuts in ([], [0, 0, 7, 201, 600], np.sort(rng.integers(0, 601, 90))):
        so_far, found = {}, []
        for begin, end in zip([0, *cuts], [*cuts, 600], strict=True):
            found += refusals(t[begin:end], marks[:, begin:end], names, so_far, last=end == 600)
        assert sorted(found) == sorted(wanted)
        assert not so_far
