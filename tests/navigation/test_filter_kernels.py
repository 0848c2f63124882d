"""Cases of the filter's kernels that no flight of the tests meets, by hand and in plain Python."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics import earth, rotation
from bench.navigation.error_state_filter import (
    error_state,
    measurement_rows,
    measurement_update,
    propagation,
)
from bench.navigation.error_state_filter.aiding_sensors import magnetic_map
from bench.navigation.error_state_filter.antenna_rows import antenna_kernel
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import PSEUDORANGE, RANGE_RATE
from bench.navigation.error_state_filter.propagation import FilterState, Measurements, Pending, Site
from bench.navigation.error_state_filter.ranges import ranging
from bench.navigation.error_state_filter.ranges.satellite_states import Channels
from bench.navigation.error_state_filter.state_blocks import index_of
from bench.simulation.signals.magnetic import field_n
from tests.navigation.test_error_state import plain

PLACE = np.array([0.8, 0.2, 500.0])


# --- from one measurement to the next ---------------------------------------------------------------------


def test_an_imu_takes_the_temperature_of_its_end_with_its_time_constant():
    """-6.5 K at 1000 m in the end, 3 K at the start: after 300 s 1/e of the difference is left."""
    thermal, known = np.array([9.0, 0.0, -0.0065, 300.0]), np.array([3.0])
    for T in (100.0, 200.0):
        plain(propagation.warmth_kernel)(T, thermal, 1000.0, known)
    assert known[0] == pytest.approx(-6.5 + 9.5 / np.e)
    thermal[3] = 0.0
    plain(propagation.warmth_kernel)(1e-3, thermal, 1000.0, known)
    assert known[0] == pytest.approx(-6.5)


def test_the_mean_force_begins_with_the_first_and_follows_within_a_tenth_of_a_second():
    mean, first, then = np.zeros(3), np.array([1.0, 2.0, -9.8]), np.array([-4.0, 0.0, -7.0])
    follow = plain(propagation.mean_force_kernel)
    follow(0.05, first, mean)
    assert_allclose(mean, first)
    for T in (0.03, 0.07):
        follow(T, then, mean)
    assert_allclose(mean, then + (first - then) / np.e)
    for axis in range(3):  # a force along one axis is one, too
        mean = 5.0 * np.eye(3)[axis]
        follow(0.1, then, mean)
        assert_allclose(mean, then + (5.0 * np.eye(3)[axis] - then) / np.e)


def test_memory_for_what_waits_grows_and_keeps_it():
    pending = propagation.pending_for(4, 2, 3)
    for one in pending[:4]:
        one[...] = np.arange(one.size).reshape(one.shape) + 1
    pending.live[:] = 3, 2
    for slots, width in ((2, 3), (1, 3), (2, 1)):
        assert propagation.grown(pending, slots, width) is pending
    for slots, width in ((3, 3), (2, 5), (4, 4)):
        more = propagation.grown(pending, slots, width)
        assert (len(more.live), more.width) == (slots, width)
        assert_array_equal(more.live, [3, 2, 0, 0][:slots])
        for old, new in zip(pending[:4], more[:4], strict=True):
            kept = new.reshape(slots, width, *new.shape[1:])
            assert_array_equal(kept[:2, :3], old.reshape(2, 3, *old.shape[1:]))
            assert not kept[2:].any()
            assert not kept[:, 3:].any()


def test_a_row_that_waits_sees_the_clock_as_it_was():
    """h Phi^-1 with the offset that the drift has added since; those of empty slots stay."""
    n, clock, T = 17, 15, 0.5
    pending = propagation.pending_for(n, 2, 2)
    pending.H[:] = np.random.default_rng(2).normal(size=pending.H.shape)
    pending.live[:] = 0, 1
    before, none = pending.H.copy(), np.empty((0, 3), np.int64)
    work = propagation.work_for(n, none).step
    plain(propagation.wait_kernel)(T, pending, none, clock, work, np.empty(n))
    Phi = np.eye(n)
    Phi[clock, clock + 1] = T
    assert_allclose(pending.H[2] @ Phi, before[2])
    assert_array_equal(pending.H[[0, 1, 3]], before[[0, 1, 3]])
    plain(propagation.wait_kernel)(T, pending, none, -1, work, np.empty(n))
    assert_allclose(pending.H[2] @ Phi, before[2])


def test_a_clock_walks_as_the_integral_of_its_drift():
    """White frequency noise by time; the walk of the drift that it follows by a third of its cube."""
    n, clock = 17, 15
    process = SimpleNamespace(
        q=np.r_[np.zeros(15), 4.0, 6.0],
        stationary=np.zeros(n),
        decay_time=np.zeros(n),
        decay_distance=np.zeros(n),
    )
    decay, noise = np.zeros(n), np.zeros(n)
    lost = np.array([0.3, 0.2])
    assert plain(propagation.noise_kernel)(0.5, process, clock, 0.0, lost, decay, noise) == n
    assert_allclose(
        noise, [0, 0, 0, 0.3, 0.3, 0.3, 0.2, 0.2, 0.2, *np.zeros(6), 2.0 + 6.0 * 0.125 / 3.0, 3.0]
    )
    P = np.random.default_rng(4).normal(size=(n, n))
    P = P @ P.T
    Phi = np.eye(n)
    Phi[clock, clock + 1] = 0.5
    wanted = Phi @ P @ Phi.T
    plain(propagation.clock_kernel)(P, clock, 0.5)
    assert_allclose(P, wanted)


# --- rows -------------------------------------------------------------------------------------------------


def fill(kind, state, values, index, drives=(), force_n=(0.0, 0.0, 0.0), **data):
    """Rows made, their z and H, of a measurement."""
    n = len(state) - 1
    pending = Pending(
        np.full((6, n), np.nan),
        np.zeros(6),
        np.zeros(6),
        np.zeros((6, 4), np.int64),
        np.zeros(1, np.int64),
        6,
    )
    given = {"antenna_b": np.zeros(3), "field": np.zeros((4, 3)), "field_lla": PLACE, **data}
    measured = np.zeros((1, 9))
    measured[0, : len(values)] = values
    aid = Measurements(values=measured, variance=np.arange(2.0, 8.0)[None], **given)
    work = propagation.work_for(n, np.reshape(drives, (-1, 3)).astype(np.int64)).measure
    work.force_n[:] = force_n
    now = FilterState(state, np.zeros((n, n)), np.zeros(n))
    made = plain(measurement_rows.ROWS[kind])(0, 0, Site(now, aid, index, pending, work))
    assert_array_equal(pending.r[:made], aid.variance[0, :made])
    sensors, length = SENSORS[kind]
    # sensor, its channel, component of how many
    rows = [[code, code, part, length] for code in sensors for part in range(length)]
    assert pending.tags[:made].tolist() == rows[:made]
    return made, pending.z[:made], pending.H[:made]


SENSORS = {
    measurement_rows.FIX_ROWS: ((measurement_rows.POSITION, measurement_rows.VELOCITY), 3),
    measurement_rows.MAGNETIC_ROWS: ((measurement_rows.MAGNETIC,), 3),
    measurement_rows.AIRSPEED_ROWS: ((measurement_rows.AIRSPEED,), 1),
    measurement_rows.HEADING_ROWS: ((measurement_rows.HEADING,), 1),
    measurement_rows.COURSE_ROWS: ((measurement_rows.COURSE,), 1),
    measurement_rows.STANDSTILL_ROWS: ((measurement_rows.ZERO_VELOCITY, measurement_rows.ZERO_RATE), 3),
    measurement_rows.BARO_ROWS: ((measurement_rows.BARO,), 1),
    measurement_rows.RADAR_ROWS: ((measurement_rows.RADAR,), 1),
    measurement_rows.VEHICLE_ROWS: ((measurement_rows.NONHOLONOMIC,), 2),
    measurement_rows.ODOMETER_ROWS: ((measurement_rows.ODOMETER,), 1),
}


@pytest.mark.parametrize("kind", SENSORS)
def test_each_record_fills_the_rows_of_its_sensors_with_their_variances(kind):
    names = ("wind_north", "wind_east", "course_offset")
    layout = StateLayout(*((name, "1", 1) for name in names))
    state = state_of(layout, (0.1, 0.2, 0.3), vel_n=(10.0, -20.0, 3.0))
    made, *_ = fill(kind, state, np.arange(1.0, 10.0), index_of(layout))
    assert made == len(SENSORS[kind][0]) * SENSORS[kind][1]


def state_of(layout, euler=(0.0, 0.0, 0.0), vel_n=(0.0, 0.0, 0.0), lla=PLACE):
    return np.concatenate([lla, vel_n, rotation.from_euler(*euler), np.zeros(layout.size - 9)])


HEADED = StateLayout(("heading_bias", "rad", 1), ("course_offset", "rad", 1))


@pytest.mark.parametrize("kind", [measurement_rows.HEADING_ROWS, measurement_rows.COURSE_ROWS])
@pytest.mark.parametrize(("yaw", "read", "apart"), [
    (3.1, -3.1, 6.2 - 2 * np.pi), (-3.1, 3.1, 2 * np.pi - 6.2), (0.5, 0.2, 0.3), (0.5, 0.2 + 4 * np.pi, 0.3),
])  # fmt: skip
def test_a_heading_is_compared_the_short_way_round(kind, yaw, read, apart):
    """Of two antennas with their offset added, of a course with its own taken off."""
    state = state_of(HEADED, (0.1, -0.2, yaw))
    state[16:] = 0.02, 0.05
    made, z, H = fill(kind, state, [read], index_of(HEADED))
    heading = kind == measurement_rows.HEADING_ROWS
    assert made == 1
    assert_allclose(z, [apart + (0.02 if heading else -0.05)])
    assert_allclose(H[0, [8, 15, 16]], [1.0, 1.0, 0.0] if heading else [1.0, 0.0, -1.0])


@pytest.mark.parametrize(("pitch", "rows"), [(1.46, 1), (1.48, 0), (-1.48, 0)])
def test_a_line_within_six_degrees_of_the_vertical_has_no_heading(pitch, rows):
    assert (
        fill(measurement_rows.HEADING_ROWS, state_of(HEADED, (0, pitch, 1)), [1.0], index_of(HEADED))[0]
        == rows
    )


@pytest.mark.parametrize(("east", "rows"), [(-10.1, 1), (-9.9, 0), (-0.1, 0)])
def test_below_5_m_s_a_pitot_tube_tells_nothing(east, rows):
    """The air moves at 3 - 2 m/s north, 2 - 7 m/s east, 2 m/s down: the aircraft so north and down, too."""
    layout = StateLayout(("wind_north", "m_s", 1), ("wind_east", "m_s", 1), ("gust_n", "m_s", 3))
    state = state_of(layout, vel_n=(1.0, east, 2.0))
    state[16:] = 3.0, -7.0, -2.0, 2.0, 2.0
    made, z, _ = fill(measurement_rows.AIRSPEED_ROWS, state, [4.0], index_of(layout))
    assert made == rows
    assert_allclose(z, [1.1][:made], rtol=1e-9)


def test_the_rows_of_a_standstill_are_differences_of_its_rates_and_velocities():
    """What the gyros measure beyond their biases is the rotation of the Earth, seen from any attitude."""
    layout = StateLayout()
    state = state_of(layout, (0.4, -0.3, 1.1), vel_n=(0.1, -0.2, 0.3))
    state[10:13] = 1e-4, -2e-4, 3e-4
    rate = np.array([2e-4, -1e-4, 5e-5])

    def rows(error):
        moved = state.copy()
        plain(error_state.feedback_kernel)(moved, -error)
        made, z, H = fill(measurement_rows.STANDSTILL_ROWS, moved, [*rate, 0.0, 0.0, -9.8], index_of(layout))
        assert made == 6
        return z.copy(), H

    z, H = rows(np.zeros(15))
    earth_n = 7.292115e-5 * np.array([np.cos(0.8), 0.0, -np.sin(0.8)])
    wanted = rate - state[10:13] - rotation.matrix(state[6:10]).T @ earth_n
    assert_allclose(z, [0.1, -0.2, 0.3, *wanted], rtol=1e-9, atol=1e-13)
    for k in range(3, 15):  # a place a meter off turns the rates by 1e-11 rad/s
        step = 1e-3 * np.eye(15)[k]
        assert_allclose(H[:, k], (rows(step)[0] - rows(-step)[0]) / 2e-3, rtol=1e-6, atol=1e-11)


def test_the_rows_of_a_magnetometer_are_differences_of_what_it_shows():
    """With a calibration a fifth off, so that its products with an attitude error count."""
    names = ("mag_iron_b", "T"), ("mag_scale", "1"), ("mag_soft_iron", "1"), ("mag_turn", "1")
    layout = StateLayout(*((name, unit, 3) for name, unit in names))
    state = state_of(layout, (0.4, -0.3, 1.1))
    state[16:] = 1e-6, -2e-6, 3e-6, 0.1, -0.2, 0.15, 0.05, -0.1, 0.2, 0.12, 0.07, -0.15
    field = magnetic_map(PLACE, 2026.0)

    def rows(error):
        moved = state.copy()
        plain(error_state.feedback_kernel)(moved, -error)
        _, z, H = fill(measurement_rows.MAGNETIC_ROWS, moved, np.zeros(3), index_of(layout), field=field)
        return z.copy(), H

    z, H = rows(np.zeros(27))
    scale, soft, turn = state[19:22], state[22:25], state[25:28]
    M = np.diag(scale) + np.array(
        [
            [0.0, soft[2] + turn[2], soft[1] - turn[1]],
            [soft[2] - turn[2], 0.0, soft[0] + turn[0]],
            [soft[1] + turn[1], soft[0] - turn[0], 0.0],
        ]
    )
    shown = (np.eye(3) + M) @ rotation.matrix(state[6:10]).T @ field[0] + state[16:19]
    assert_allclose(z, shown, rtol=1e-12)
    for k in range(6, 27):
        step = 1e-4 * np.eye(27)[k]
        difference = (rows(step)[0] - rows(-step)[0]) / 2e-4
        assert_allclose(H[:, k], difference, rtol=1e-6, atol=1e-6 * np.abs(field[0]).max())


def test_the_field_is_that_of_the_place_of_the_filter():
    """5 km from where its map was made: within 2 nT of the field there, of the slopes all but a tenth."""
    layout = StateLayout()
    for away in 5e3 * np.eye(3):
        lla = earth.displace(PLACE, away[None])[0]
        C = rotation.matrix(rotation.from_euler(0.3, -0.2, 1.1))
        there = C.T @ field_n(lla[None], 2026.0)[0]
        state, field = state_of(layout, (0.3, -0.2, 1.1), lla=lla), magnetic_map(PLACE, 2026.0)
        _, z, _ = fill(measurement_rows.MAGNETIC_ROWS, state, there, index_of(layout), field=field)
        moved = field_n(lla[None], 2026.0)[0] - field_n(PLACE[None], 2026.0)[0]
        assert np.abs(z).max() < min(2e-9, 0.1 * np.linalg.norm(moved))


def test_a_fix_shows_what_wanders_in_it_and_one_without_velocity_its_position():
    layout = StateLayout(("gnss_pos", "m", 3), ("gnss_vel", "m_s", 3))
    state = state_of(layout, (0.3, -0.2, 1.1), vel_n=(10.0, -20.0, 3.0))
    state[16:] = 0.1, 0.2, 0.3, 0.4, 0.5, 0.6
    for rows, vel_n in ((6, state[3:6]), (3, np.full(3, np.nan))):
        fix = [*PLACE, *vel_n, 0.0, 0.0, 0.0]
        made, z, H = fill(measurement_rows.FIX_ROWS, state, fix, index_of(layout))
        assert made == rows
        assert_allclose(z, state[16:][:rows], atol=1e-9)
        assert_allclose(H[:, 15:], np.eye(6)[:rows])


def test_a_fix_of_another_instant_moves_by_the_force_and_all_that_errs_in_it():
    """0.2 s off: differences in velocity, attitude, bias, scale factor and the offset itself."""
    layout = StateLayout(("accel_scale", "1", 3), ("time_offset", "s", 1))
    state = state_of(layout, (0.4, -0.3, 1.1), vel_n=(30.0, -20.0, 3.0))
    state[19], f_b = 0.2, np.array([1.0, -2.0, -11.0])
    drives = [(15 + i, 12 + i, 3 + i) for i in range(3)]

    def rows(error):
        moved = state.copy()
        plain(error_state.feedback_kernel)(moved, -error)
        force_n = rotation.matrix(moved[6:10]) @ (f_b * (1.0 - moved[16:19]) - moved[13:16])
        fix = [*PLACE, 25.0, -15.0, 2.0, 0.0, 0.0, 0.0]
        _, z, H = fill(measurement_rows.FIX_ROWS, moved, fix, index_of(layout), drives, force_n)
        return z.copy(), H

    z, H = rows(np.zeros(19))
    a = rotation.matrix(state[6:10]) @ f_b + earth.gravity_n(PLACE[0], PLACE[2])
    assert_allclose(
        z, [*(0.2 * state[3:6] + 0.02 * a), *(state[3:6] + 0.2 * a - [25.0, -15.0, 2.0])], atol=1e-9
    )
    for k in (*range(3, 9), *range(12, 19)):
        step = 1e-4 * np.eye(19)[k]
        assert_allclose(H[:, k], (rows(step)[0] - rows(-step)[0]) / 2e-4, rtol=1e-6, atol=1e-6)


def test_a_fix_beyond_the_date_line_is_near():
    nav = np.array([0.5, np.pi - 1e-6, 100.0, 1.0, 2.0, 3.0])
    z, H = np.zeros(6), np.zeros((6, 15))
    fix = np.array([0.5, -np.pi + 1e-6, 100.0])
    plain(antenna_kernel)(nav, np.eye(3), np.zeros(3), np.zeros(3), fix, np.array([1.0, 2.0, 3.0]), H, z)
    _, prime = earth.radii(0.5)
    assert_allclose(z, [0, -2e-6 * (prime + 100.0) * np.cos(0.5), 0, 0, 0, 0], atol=1e-6)


# --- what is assumed -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("misses", "code", "outvoted"),
    [
        ((0, 0, 1, 1), PSEUDORANGE, True),
        ((0, 1, 1, 1), PSEUDORANGE, False),
        ((0, 2, 3), PSEUDORANGE, False),
        ((1, 1, 1, 1), RANGE_RATE, True),
        ((0, 0, 0), PSEUDORANGE, True),
    ],
)
def test_half_of_the_satellites_outvote_the_others(misses, code, outvoted):
    """Ranges and rates in turn, from row 2 on; all rates agree."""
    tags = np.zeros((2 + 2 * len(misses), 4), np.int64)
    tags[2::2, 0], tags[3::2, 0] = PSEUDORANGE, RANGE_RATE
    tags[2:, 1] = np.arange(2 * len(misses))
    trust = SimpleNamespace(misses=np.zeros(2 * len(misses), np.int64))
    trust.misses[::2] = misses
    rows = 2 * len(misses)
    assert (
        plain(measurement_update.outvoted_kernel)(code, 2, rows, SimpleNamespace(tags=tags), trust)
        == outvoted
    )


def test_a_sensor_opens_states_if_it_has_any():
    opens = np.array([[False, False, False], [False, False, True], [True, False, False]])
    assert [plain(measurement_update.opens_kernel)(code, opens) for code in range(3)] == [False, True, True]


# --- the states of satellites -----------------------------------------------------------------------------


def observed(t, sats):
    return SimpleNamespace(t=np.full(len(sats), t), sat=np.array(sats), system=np.zeros(len(sats), np.int64))


def test_a_state_is_free_a_minute_after_its_satellite_was_seen():
    """Sixteen states of GPS. The seventeenth satellite waits for that of the one that set first."""
    channels = Channels()

    def give(t, *sats):
        own, fresh = channels.give_states(observed(t, sats), np.arange(len(sats)))
        return [(place, bool(new)) for place, new in zip(own.tolist(), fresh.tolist(), strict=True)]

    assert give(100.0, *range(1, 17)) == [(place, True) for place in range(16)]
    assert give(110.0, *range(1, 17)) == [(place, False) for place in range(16)]
    assert give(120.0, *(sat for sat in range(1, 17) if sat != 4)) == [
        (k, False) for k in range(16) if k != 3
    ]
    assert give(169.9, 30) == [(-1, False)]
    assert give(170.0, 30, 4) == [(3, True), (-1, False)]
    assert give(171.0, 30) == [(3, False)]


def test_a_state_that_goes_on_forgets_the_satellite_before():
    """Rows that wait take its error as white; the next begins at zero with a variance of 1."""
    layout = StateLayout(("gps_range_1", "1", 3), ("glonass_range_1", "1", 2))
    n, own = layout.size, 16
    root = np.random.default_rng(5).normal(size=(n, n))
    P, Phi, state = root @ root.T, root.copy(), np.arange(n + 1.0)
    pending = SimpleNamespace(H=np.arange(2.0 * n).reshape(2, n), r=np.array([1.0, 2.0]))
    # rows of three epochs: that which begins lies in the second
    sky = SimpleNamespace(
        epoch_start=np.array([0, 1, 4, 5]),
        which=np.array(
            [[0, 0, 0, 0, 1], [0, 0, 0, 2, 0], [0, 0, 0, 1, 1], [0, 0, 0, -1, 1], [0, 0, 0, 2, 1]]
        ),
    )
    wanted_P, wanted_Phi, wanted_state = P.copy(), Phi.copy(), state.copy()
    wanted_P[own], wanted_P[:, own], wanted_Phi[own], wanted_state[own + 1] = 0.0, 0.0, 0.0, 0.0
    wanted_P[own, own] = 1.0
    more, wanted_H = pending.H[:, own] ** 2 * P[own, own], pending.H.copy()
    wanted_H[:, own] = 0.0
    now = FilterState(state, P, np.zeros(n))
    plain(ranging.renew_kernel)(1, now, Phi, index_of(layout), pending, sky)
    for found, wanted in ((P, wanted_P), (Phi, wanted_Phi), (state, wanted_state), (pending.H, wanted_H)):
        assert_allclose(found, wanted)
    assert_allclose(pending.r, [1.0 + more[0], 2.0 + more[1]])
