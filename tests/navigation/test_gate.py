"""The gate: hand cases of what becomes of a measurement, and of how refused fixes move."""

from __future__ import annotations

import numpy as np
import pytest

from bench.errors import EstimatorError
from bench.navigation.built_in import load
from bench.navigation.engine.gate import (
    LOST,
    REFUSED,
    SOUND,
    STEPPED,
    InnovationGate,
    decide_kernel,
    moves_kernel,
    new_trust,
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
        (0, [1], LOST),  # positions are refused: the filter may have been led away from them
        (0, [2], LOST),
        (1, [0], LOST),
    ],
)
def test_where_gnss_is_used_meanwhile_the_filter_is_not_lost(channel, used, verdict):
    assert outcomes(np.arange(1, 12), channel, used=used)[-1] == verdict


def moving(place, speed, seconds=30):
    """Whether fixes of 1 Hz are to be believed, by innovations of their position and velocity along east."""
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


def test_a_gate_in_python_logs_what_it_decides_and_tells_of_refusals():
    gate = InnovationGate(SENSORS, 0.0, 1e-5, 10.0)
    for t in range(1, 6):
        gate.decide(float(t), RADAR, [40.0], [4.0], 400.0, sound=t == 5)
    table, events = gate.take(last=True)
    assert table.accepted.tolist() == [False] * 4 + [True]
    assert table.z.tolist() == [40.0] * 5
    assert [(a, b, text) for a, b, _, text, _ in events] == [(1.0, 4.0, "radar: 4 in a row refused")]
    assert len(gate.take(last=True)[0]) == 0


def test_the_number_of_refusals_is_an_option_no_more():
    with pytest.raises(EstimatorError) as caught:
        load("loose-15", {"readmit_after": 10})
    told = "unknown option 'readmit_after'; use 'readmit_after_s', the time of refusals in seconds"
    assert str(caught.value) == f"estimator 'loose-15': {told}"


@pytest.mark.parametrize(
    ("position", "velocity", "drifted"),
    [
        (12.0, 0.0, False),
        (12.0, 9.0, True),
        (30.0, 12.0, True),
    ],
)
def test_a_drift_while_there_were_no_fixes_moves_the_velocity_too(position, velocity, drifted):
    S = np.eye(6) + 4.0 * np.kron([[1.0, 0.95], [0.95, 1.0]], np.eye(3))
    y = np.array([position, 0.0, 0.0, velocity, 0.0, 0.0])
    gate = InnovationGate(SENSORS, 0.0, 1e-5, 10.0)
    gate.see_fix(9.0, y, S, np.ones(3))
    assert not gate.drifted
    gate.see_fix(20.0, y, S, np.ones(3))
    assert gate.drifted is drifted
    gate.see_fix(20.0, y, S, np.full(3, 10.0))  # the filter claims to know its place better than the fix
    assert gate.drifted is (velocity == 12.0)
    gate.decide(20.0, 0, y[:3], [1.0] * 3, 0.0, sound=True)
    gate.see_fix(20.5, y, S, np.ones(3))
    assert not gate.drifted
