"""The states of a filter in blocks; each block declares the names, initial values and processes once.

A state beyond position, velocity, attitude and IMU biases is a :class:`Block` here and its column of H
(`measurement_rows`, `ranging`), found by :class:`Index`. A state that adds to the
errors of the IMU needs no column: ``drives`` says how it acts. All figures come from the datasheets that the
filter assumes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import InitialState, SensorData
from bench.core.records.sensor_specs import AssumedSpecs, ImuSpec
from bench.navigation.error_state_filter.error_state import CORE, CORE_BLOCKS, GYRO, StateLayout
from bench.navigation.error_state_filter.imu_states import (
    EVERY_ERROR,
    MEMS,
    core_states,
    correlate_axes,
    thermal_figures,
)
from bench.navigation.error_state_filter.ranges.range_states import CLOCK, RANGE_ERRORS
from bench.navigation.error_state_filter.state_processes import (
    ABSOLUTE,
    SQUARE,
    STEADY,
    WARMTH,
    Block,
    States,
    assumed,
)
from bench.navigation.error_state_filter.vehicle_states import vehicle
from bench.navigation.options import FusionOptions

CHANGES = 100 / 86400  # of the satellites in use, those of the nominal GPS constellation (A-2.1.2) [1/s]

CLOCK_WALK = 1e-3  # of two clocks that nothing holds together: 100 ppm in 100 s [s/sqrt(s)]
TURNING = 2.0  # acceleration that a vehicle may have as a filter starts [m/s^2]
WIND_SD = 10.0  # of each horizontal component of the wind at the start, a fresh breeze [m/s]
WIND_WALK = 0.1  # change of the wind as the aircraft moves through it: 2.4 m/s in 10 minutes [m/s/sqrt(s)]


class Index(NamedTuple):
    """Index of the first state of each block that kernels use; -1 if the block is absent."""

    baro_bias: int
    gnss_pos: int  # gnss_vel follows
    clock_offset: int  # clock_drift follows
    antenna_b: int
    wind_north: int  # wind_east follows
    radar_bias: int
    mag_iron_b: int
    mag_scale: int
    mag_soft_iron: int
    mag_turn: int
    odometer_scale: int
    heading_bias: int
    heading_wander: int
    time_offset: int
    axis_yaw: int  # axis_pitch, slip_yaw, slip_pitch and pitch_by_force follow
    axle_b: int
    gust_n: int
    ionosphere_1: int  # one for each of `ANCHORS`
    troposphere: int
    course_offset: int
    gps_range_1: int  # RANGES of them, of each system
    glonass_range_1: int
    galileo_range_1: int
    beidou_range_1: int
    gps_offset: int  # none: that of the others is against GPS time
    glonass_offset: int
    galileo_offset: int
    beidou_offset: int

    def take(self, used: IntArray) -> Index:
        """Return the index of a layout of the ``used`` states alone."""
        place = {one: k for k, one in enumerate(used.tolist())}
        return Index(*(place.get(one, -1) for one in self))


class Process(NamedTuple):
    """Propagation of n states between measurements; columns as in :class:`States`."""

    q: FloatArray  # (n,) density
    decay_time: FloatArray  # (n,)
    decay_distance: FloatArray  # (n,)
    stationary: FloatArray  # (n,)
    drives: IntArray  # (D, 3) a state, the bias it acts like, and what it multiplies, in order of correction
    # (4,) of the IMU above reference at the start [K], in the end at height 0 [K], per m [K/m]; [s]
    thermal: FloatArray
    range: FloatArray  # (2,) of the gyros [rad/s] and accelerometers [m/s^2]

    def take(self, used: IntArray) -> Process:
        """Return the processes of the ``used`` states, all that drive among them."""
        drives = self.drives.copy()
        drives[:, 0] = np.searchsorted(used, drives[:, 0])
        q, decay_time, decay_distance, stationary = (one[used] for one in self[:4])
        return Process(q, decay_time, decay_distance, stationary, drives, self.thermal, self.range)


FIRST_RANGE, FIRST_OFFSET = Index._fields.index("gps_range_1"), Index._fields.index("gps_offset")
"""Places in an index; what they stand for in the other systems follows."""


def first_of_satellites(index: Index, n: int) -> int:
    """Return the first of n states that single satellites have; they are the last ones."""
    return min([one for one in index[FIRST_RANGE:FIRST_OFFSET] if one >= 0], default=n)


@dataclass(frozen=True, slots=True)
class StateModel:
    """A layout of n states, their covariance at the start and the processes they follow."""

    layout: StateLayout
    P: FloatArray  # (n, n) at the start
    values: FloatArray  # (n,) at the start, from the gyro bias on
    process: Process
    index: Index


def state_model(
    initial: InitialState, specs: AssumedSpecs, blocks: Iterable[Block], gyro_sd: float | None = None
) -> StateModel:
    """Return the model of position, velocity, attitude, IMU biases and the given blocks.

    Parameters
    ----------
    initial : InitialState
        Covariance of position, velocity and attitude at the start, and theirs with the biases.
    specs : AssumedSpecs
        The datasheets that the filter assumes.
    blocks : iterable of Block
        The further states, in the order of the layout.
    gyro_sd : float or None
        How well the error of the gyros at the start is known as a whole [rad/s]; None: by the datasheet.

    Raises
    ------
    ValueError
        If a block needs the datasheet of a sensor that has none.
    """
    every = _list_states(specs, list(blocks))
    layout = StateLayout(*((states.name, states.unit, states.size) for states in every[len(CORE_BLOCKS) :]))
    n = layout.size
    P, values = np.zeros((n, n)), np.zeros(n)
    q, decay_time, decay_distance, stationary = np.zeros((4, n))
    drives: list[tuple[int, int, int]] = []
    for states in every:
        at = layout.slice(states.name)
        np.fill_diagonal(P[at, at], states.variance)
        values[at] = states.value
        q[at], stationary[at] = states.density, states.stationary
        decay_time[at], decay_distance[at] = states.decay_time, states.decay_distance
        drives += [(at.start + own, GYRO + error, rate) for own, error, rate in states.drives]
    P[:9, :9] = initial.cov
    P[:9, GYRO:CORE], P[GYRO:CORE, :9] = initial.bias_cov, initial.bias_cov.T
    if layout.has("gnss_pos"):  # estimate, zero, less truth
        own = layout.slice("gnss_pos")
        P[:3, own], P[own, :3] = -np.diag(initial.fix_cov), -np.diag(initial.fix_cov)
    if layout.has("time_offset"):  # a start by fixes is that of another time
        at = layout.slice("time_offset").start
        variance = P[at, at]
        if initial.bias_cov.any():  # by an alignment on fixes, whose positions stay known
            P[:3, at] = P[at, :3] = -variance * initial.vel_n
        P[:3, :3] += variance * np.outer(initial.vel_n, initial.vel_n)
        P[3:6, 3:6] += variance * TURNING**2 * np.eye(3)
    table = np.array(sorted(drives, key=_correction_order), np.int64).reshape(-1, 3)
    thermal = thermal_figures(initial.t, float(initial.lla[2]), specs.imu)
    correlate_axes(P, layout, specs.imu)
    if initial.bias_cov.any():
        _relate_attitude(P, table, specs.imu, float(thermal[0]), initial)
    if gyro_sd is not None:
        _know_gyro_biases(P, table, gyro_sd, float(thermal[0]), initial)
    full = np.array([specs.imu.gyro.range, specs.imu.accel.range])
    process = Process(q, decay_time, decay_distance, stationary, table, thermal, full)
    return StateModel(layout, P, values, process, index_of(layout))


def _correction_order(drive: tuple[int, int, int]) -> tuple[int, ...]:
    """Return the sort key of drives: each factor then uses a motion without larger errors.

    Forces come before rates, for rates are corrected by forces; of each, what does not depend on the motion
    comes first, then what goes by the force on a gyro, by the axis itself, and by the axes across.
    """
    _, error, by = drive
    own, axis = error - GYRO, by if by < STEADY else (by - ABSOLUTE) % 6
    kind = 0 if by in (STEADY, WARMTH) else 1 if own < 3 <= axis else 2 if axis == own else 3
    return int(own < 3), kind, *drive


def _feel_gravity(initial: InitialState) -> FloatArray:
    """Return the specific force (3,) of steady level flight at the start [m/s^2], b."""
    g_n = earth.gravity_n(initial.lla[0], initial.lla[2])
    return rotation.rotate(rotation.conjugate(initial.q_nb), -g_n)


def _relate_attitude(
    P: FloatArray, drives: IntArray, imu: ImuSpec, warmth: float, initial: InitialState
) -> None:
    """Add to P (n, n) what an aligned attitude has in common with states that act like an accelerometer bias.

    A tilt compensates whatever the accelerometers err by at rest. Left out are flicker, most of which an
    alignment averages, and errors by the force along an axis itself, which its covariance does not hold.
    """
    size = imu.accel.by_axis("turn_on_bias_sd") ** 2 + imu.accel.instability_by_axis**2
    by_error = np.divide(initial.bias_cov[:, 3:], size, out=np.zeros((9, 3)), where=size > 0.0)
    across = [row for row in drives if row[2] != STEADY and _correction_order(row)[1] != 2]
    L = steady_rows(np.array(across).reshape(-1, 3), _feel_gravity(initial), warmth, len(P))[3:, CORE:]
    more = by_error @ L @ P[CORE:, CORE:]
    P[:9, CORE:] += more
    P[CORE:, :9] += more.T


def _know_gyro_biases(
    P: FloatArray, drives: IntArray, sd: float, warmth: float, initial: InitialState
) -> None:
    """Reduce P (n, n): biases and all that adds to them in steady motion are known to sd [rad/s]."""
    L = steady_rows(drives, _feel_gravity(initial), warmth, len(P))[:3]
    own = slice(GYRO, GYRO + 3)
    P[own], P[:, own] = 0.0, 0.0
    P[own], P[:, own] = -L @ P, -(L @ P).T
    P[own, own] = sd**2 * np.eye(3) - P[own] @ L.T


def steady_rows(drives: IntArray, f_b: FloatArray, warmth: float, n: int) -> FloatArray:
    """Return how the n states beyond the biases add to the errors (6,) of gyros and accelerometers.

    In motion without rates, under a specific force f_b (3,) [m/s^2].
    """
    steady = {3: f_b[0], 4: f_b[1], 5: f_b[2], STEADY: 1.0, WARMTH: warmth}
    steady |= {SQUARE + 3 + axis: f_b[axis] ** 2 for axis in range(3)}
    L = np.zeros((6, n))
    for state, bias, by in drives:
        L[bias - GYRO, state] = steady.get(int(by), 0.0)
    return L


def moving_states(specs: AssumedSpecs, blocks: Iterable[Block]) -> tuple[tuple[object, ...], ...]:
    """Return name, figures and drives of the states that :func:`state_model` lets differ from 0."""
    return tuple(
        (states.name, *figures, states.decay_time, states.decay_distance, states.drives)
        for states in _list_states(specs, list(blocks))
        if np.any(figures := _figures(states))
    )


def _figures(states: States) -> tuple[tuple[float, ...], ...]:
    """Return value and variance at the start, density and stationary variance of each of the states."""
    figures = (states.value, states.variance, states.density, states.stationary)
    return tuple(tuple(np.broadcast_to(figure, states.size).tolist()) for figure in figures)


def _list_states(specs: AssumedSpecs, blocks: list[Block]) -> list[States]:
    """Return the core and the states of blocks; beside `EVERY_ERROR`, an error of size 0 has none."""
    full = EVERY_ERROR in blocks
    found = core_states(specs, changing=full)
    for block in blocks:
        states = block.states(specs)
        if not (full and block.takes) or any(np.any(_figures(one)) for one in states):
            found += states
    return found


def index_of(layout: StateLayout) -> Index:
    """Return the indices of the blocks of a layout, for the kernels."""
    return Index(*(layout.slice(name).start if layout.has(name) else -1 for name in Index._fields))


def _baro_bias(specs: AssumedSpecs) -> list[States]:
    baro = assumed(specs, "baro")
    return [States("baro_bias", "m", 1, baro.bias_sd**2, baro.bias_walk**2)]


BARO_BIAS = Block("baro", _baro_bias, records=("baro",))
"""Bias of the barometric height, a random walk (A-5.3.2)."""


def _gnss_markov(specs: AssumedSpecs) -> list[States]:
    gnss = assumed(specs, "gnss")
    pos = np.square([gnss.pos_h_markov_sd, gnss.pos_h_markov_sd, gnss.pos_v_markov_sd])
    vel = gnss.vel_markov_sd**2
    return [
        States("gnss_pos", "m", 3, pos, 0.0, gnss.pos_decay_time, gnss.pos_decay_distance, pos),
        States("gnss_vel", "m_s", 3, vel, 0.0, gnss.vel_decay_time, stationary=vel),
    ]


GNSS_MARKOV = Block(
    "gnss_markov",
    _gnss_markov,
    takes=("time-correlated GNSS position error", "time-correlated GNSS velocity error"),
    records=("fixes",),
)
"""Gauss-Markov part of the position and velocity errors of a fix (A-5.2.2, A-5.4.2)."""


def _gnss_jumps(specs: AssumedSpecs) -> list[States]:
    """Return the Markov states with the jumps that last, shot noise: variance ``rate jump^2 / (2 decay)``."""
    gnss = assumed(specs, "gnss")
    jumps = np.square([gnss.pos_h_jump_markov_sd, gnss.pos_h_jump_markov_sd, gnss.pos_v_jump_markov_sd])
    pos, vel = _gnss_markov(specs)
    longest = 1.0 / 86400.0
    pos_more = jumps * CHANGES / (2.0 * max(gnss.pos_decay_time, longest))
    vel_more = gnss.vel_jump_markov_sd**2 * CHANGES / (2.0 * max(gnss.vel_decay_time, longest))
    return [
        replace(states, variance=states.variance + more, stationary=states.stationary + more)
        for states, more in ((pos, pos_more), (vel, vel_more))
    ]


GNSS_JUMPS = replace(
    GNSS_MARKOV,
    states=_gnss_jumps,
    takes=(*GNSS_MARKOV.takes, "jumps of the GNSS error where the satellites change"),
)
"""The same with the jumps that last, for `EVERY_ERROR`; R has those of one epoch: `aiding_sensors.jumps`."""


def antenna(sd: float) -> Block:
    """Return the place of the GNSS antenna, known to ``sd`` [m] along each axis of b."""
    states = (States("antenna_b", "m", 3, sd**2),)
    return Block("lever_arm_sd", lambda _: states, records=("fixes", "observations"))


WIND = Block(
    "airspeed",
    lambda _: [States(name, "m_s", 1, WIND_SD**2, WIND_WALK**2) for name in ("wind_north", "wind_east")],
    records=("airspeed",),
)
"""Horizontal wind, random walks."""


def _radar_bias(specs: AssumedSpecs) -> list[States]:
    radar = assumed(specs, "radar")
    return [States("radar_bias", "m", 1, radar.bias_sd**2)] if radar.bias_sd > 0 else []


RADAR_BIAS = Block("radar", _radar_bias, takes=("radar altimeter bias",), records=("radar",))
"""Bias of the radar altimeter, constant."""


def _magnetometer(specs: AssumedSpecs) -> list[States]:
    """Return offset and matrix of errors: its diagonal, and beside it the even and the odd parts.

    An odd part is a turn. Each axis leans towards each other one by itself: half of that variance is odd.
    """
    mag = assumed(specs, "mag")
    scale, lean = mag.soft_iron_sd**2 + mag.scale_factor_sd**2, 0.5 * mag.misalignment_sd**2
    found = [
        States("mag_iron_b", "T", 3, mag.hard_iron_sd**2),
        States("mag_scale", "1", 3, scale),
        States("mag_soft_iron", "1", 3, mag.soft_iron_sd**2 + lean),
        States("mag_turn", "1", 3, lean),
    ]
    return [states for states in found if np.any(states.variance)]


MAGNETOMETER = Block("magnetometer", _magnetometer, takes=("magnetometer calibration",), records=("mag",))
"""What calibration left in a magnetometer, constant: hard iron, soft iron, scale factors, misalignment."""


def _odometer_scale(specs: AssumedSpecs) -> list[States]:
    sd = assumed(specs, "odometer").scale_factor_sd
    return [States("odometer_scale", "1", 1, sd**2)] if sd > 0 else []


ODOMETER_SCALE = Block("odometer", _odometer_scale, takes=("odometer scale factor",), records=("odometer",))
"""Error of the odometer's scale factor, constant."""


def _heading_errors(specs: AssumedSpecs) -> list[States]:
    spec = assumed(specs, "heading")
    offset, wander = spec.bias_sd**2, spec.wander_sd**2
    found = [
        States("heading_bias", "rad", 1, offset),
        States("heading_wander", "rad", 1, wander, decay_time=1.0 / spec.wander_time, stationary=wander),
    ]
    return [states for states in found if states.variance]


HEADING_ERRORS = Block(
    "heading",
    _heading_errors,
    takes=("offset of the antennas' heading", "multipath of the antennas' heading"),
    records=("heading",),
)
"""Offset of the line between two antennas from the forward axis, constant, and Gauss-Markov multipath."""


def clock_of_fixes(sd: float) -> Block:
    """Return the state of the time to add to fixes: a random walk with the initial sigma ``sd`` [s]."""
    states = (States("time_offset", "s", 1, sd**2, CLOCK_WALK**2),)
    return Block("time_offset_sd", lambda _: states, records=("fixes",))


def used_blocks(blocks: Iterable[Block], sensors: SensorData, used: Iterable[str]) -> list[Block]:
    """Return the blocks with a record that is present and ``used``, and the blocks that need no record."""
    records = {name for name in used if getattr(sensors, name) is not None}
    return [block for block in blocks if not block.records or records & set(block.records)]


def chosen_blocks(options: FusionOptions) -> list[Block]:
    """Return the blocks that the options of a compiled filter select, in the order of the layout."""
    arm, ride = antenna(options.lever_arm_sd), vehicle(options)
    wind = WIND if not options.coordinated else replace(WIND, option="coordinated", records=())
    markov = GNSS_JUMPS if options.every_error else GNSS_MARKOV
    imu, satellites = (MEMS, EVERY_ERROR), (CLOCK, RANGE_ERRORS)
    ride.append(HEADING_ERRORS)
    ride.append(clock_of_fixes(options.time_offset_sd))
    every = (BARO_BIAS, markov, *imu, *satellites, arm, wind, RADAR_BIAS, MAGNETOMETER, *ride, ODOMETER_SCALE)
    return [block for block in every if getattr(options, block.option)]
