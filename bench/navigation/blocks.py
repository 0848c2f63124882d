"""The states of a filter in blocks; each block says once how its states are called, begin and move.

A state beyond position, velocity, attitude and IMU biases is a :class:`Block` here and its column of H
(`bench.navigation.aiding`, `bench.navigation.ranging`), found by :class:`Index`. A state that adds to the
errors of the IMU needs no column: ``drives`` says how it acts. All figures come from the datasheets that the
estimator assumes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.data import InitialState
from bench.navigation.error_state import CORE, CORE_BLOCKS, GYRO, StateLayout
from bench.navigation.options import FusionOptions
from bench.signals.allan import fit_flat_deviation
from bench.signals.orbits import C
from bench.specs import AssumedSpecs, TriadSpec

WIND_SD = 10.0  # of each horizontal component of the wind at the start, a fresh breeze [m/s]
WIND_WALK = 0.1  # change of the wind as the aircraft moves through it: 2.4 m/s in 10 minutes [m/s/sqrt(s)]

TEMPERATURE_SD = 20.0  # of an IMU about its reference temperature, in flight or on a cold day [K]
TEMPERATURE_CORRELATION = 1000.0  # time in which it changes by as much: a climb of 3 km [s]

STEADY = 6  # the "rate" of a state that adds to an error as it is
FLICKER_STAGES = (0.05, 0.55, 6.0)
"""Correlation times of Gauss-Markov processes whose sum is flicker noise, over that of the triad [1]."""

_Figure = float | FloatArray  # the same for every state of a block, or one for each


@dataclass(frozen=True, slots=True)
class States:
    """One to three states of one name and the process they follow.

    A drive ``(state, error, rate)`` adds a state (0 to 2) times a measured rate (0 to 2), specific force
    (3 to 5) or 1 (`STEADY`) to an error of the gyros (0 to 2) or accelerometers (3 to 5).
    """

    name: str
    unit: str
    size: int
    variance: _Figure = 0.0  # at the start [unit^2]
    density: _Figure = 0.0  # of the white noise that drives it [unit^2/s]
    decay_time: _Figure = 0.0  # rate at which a Gauss-Markov state decays by time [1/s]
    decay_distance: _Figure = 0.0  # and by distance over ground [1/m]
    stationary: _Figure = 0.0  # variance that a Gauss-Markov state tends to, in place of the density [unit^2]
    drives: tuple[tuple[int, int, int], ...] = ()


@dataclass(frozen=True, slots=True)
class Block:
    """States that are estimated together or not at all."""

    option: str  # of the compiled filters, that asks for it
    states: Callable[[AssumedSpecs], Sequence[States]]
    takes: tuple[str, ...] = ()  # errors that it models, as `bench.navigation.measurements` names them
    records: tuple[str, ...] = ()  # of `SensorData`, one of which has to be in use; none: always there


class Index(NamedTuple):
    """The first state of each block that a kernel asks for by name; -1 where it is absent."""

    baro_bias: int
    gnss_pos: int  # gnss_vel follows
    g_sensitivity_x: int  # the first of 9, row by row
    clock_offset: int  # clock_drift and glonass_offset follow
    antenna_b: int
    wind_north: int  # wind_east follows
    radar_bias: int
    odometer_scale: int


class Process(NamedTuple):
    """How n states move between measurements; columns as in :class:`States`."""

    q: FloatArray  # (n,) density
    decay_time: FloatArray  # (n,)
    decay_distance: FloatArray  # (n,)
    stationary: FloatArray  # (n,)
    drives: IntArray  # (D, 3) a state, the bias it acts like, and the rate (0-2) or force (3-5) it multiplies


@dataclass(frozen=True, slots=True)
class StateModel:
    """A layout of n states, their covariance at the start and the processes they follow."""

    layout: StateLayout
    P: FloatArray  # (n, n) at the start
    process: Process
    index: Index


def state_model(initial: InitialState, specs: AssumedSpecs, blocks: Iterable[Block]) -> StateModel:
    """Return the model of position, velocity, attitude, IMU biases and the given blocks.

    Parameters
    ----------
    initial : InitialState
        Covariance of position, velocity and attitude at the start, and theirs with the biases.
    specs : AssumedSpecs
        The datasheets that the estimator assumes.
    blocks : iterable of Block
        The further states, in the order of the layout.

    Raises
    ------
    ValueError
        If a block needs the datasheet of a sensor that has none.
    """
    blocks = list(blocks)
    extra = [states for block in blocks for states in block.states(specs)]
    layout = StateLayout(*((states.name, states.unit, states.size) for states in extra))
    n = layout.size
    P = np.zeros((n, n))
    q, decay_time, decay_distance, stationary = np.zeros((4, n))
    drives: list[tuple[int, int, int]] = []
    for states in (*_core(specs, changing=EVERY_ERROR in blocks), *extra):
        at = layout.slice(states.name)
        np.fill_diagonal(P[at, at], states.variance)
        q[at], stationary[at] = states.density, states.stationary
        decay_time[at], decay_distance[at] = states.decay_time, states.decay_distance
        drives += [(at.start + own, GYRO + error, rate) for own, error, rate in states.drives]
    P[:9, :9] = initial.cov
    P[:9, GYRO:CORE], P[GYRO:CORE, :9] = initial.bias_cov, initial.bias_cov.T
    table = np.array(drives, np.int64).reshape(-1, 3)
    process = Process(q, decay_time, decay_distance, stationary, table)
    return StateModel(layout, P, process, index_of(layout))


def index_of(layout: StateLayout) -> Index:
    """Return where the kernels find the blocks of a layout."""
    return Index(*(layout.slice(name).start if layout.has(name) else -1 for name in Index._fields))


def assumed(specs: AssumedSpecs, name: str) -> Any:
    """Return the datasheet of a sensor in use.

    Raises
    ------
    ValueError
        If the estimator was given none.
    """
    spec = getattr(specs, name)
    if spec is None:
        raise ValueError(f"the record holds {name} data, but sensors.assumed names no {name} unit")
    return spec


def _core(specs: AssumedSpecs, *, changing: bool) -> list[States]:
    """Return the states of every layout; P of the first three comes from the initial state.

    ``changing`` biases hold temperature and rate random walk, too.
    """
    gyro, accel = specs.imu.gyro, specs.imu.accel
    pos, vel, phi, gyro_bias, accel_bias = CORE_BLOCKS
    return [
        States(*pos),
        States(*vel, density=accel.random_walk**2),
        States(*phi, density=gyro.random_walk**2),
        *(
            _changing_bias(bias, triad) if changing else bias
            for bias, triad in ((_bias(*gyro_bias, gyro), gyro), (_bias(*accel_bias, accel), accel))
        ),
    ]


def _changing_bias(bias: States, triad: TriadSpec) -> States:
    """Return bias states with the slow stage of flicker, temperature and a rate random walk."""
    if stages := _flicker_stages(triad):
        time, slow2 = stages[-1]
        decay = 0.0 if triad.turn_on_bias_sd > 0 else 1.0 / time
        bias = replace(
            bias, variance=triad.turn_on_bias_sd**2 + slow2, density=2.0 * slow2 / time, decay_time=decay
        )
    heat2 = (triad.temperature_sd * TEMPERATURE_SD) ** 2
    more = 2.0 * heat2 / TEMPERATURE_CORRELATION + triad.rate_random_walk**2
    if more == 0.0:
        return bias
    return replace(bias, variance=bias.variance + heat2, density=bias.density + more, decay_time=0.0)


def _bias(name: str, unit: str, size: int, triad: TriadSpec) -> States:
    """Return bias states: random walks, or without a turn-on bias Gauss-Markov processes."""
    instability2 = triad.instability_sd**2
    variance = triad.turn_on_bias_sd**2 + instability2
    if instability2 == 0:
        return States(name, unit, size, variance)
    decay = 0.0 if triad.turn_on_bias_sd > 0 else 1 / triad.bias_correlation
    return States(name, unit, size, variance, 2 * instability2 / triad.bias_correlation, decay)


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


def _mems(specs: AssumedSpecs) -> list[States]:
    gyro, accel = specs.imu.gyro, specs.imu.accel
    same = [(i, i, i) for i in range(3)]
    return [
        States("gyro_scale", "1", 3, gyro.scale_factor_sd**2, drives=tuple(same)),
        States(
            "accel_scale", "1", 3, accel.scale_factor_sd**2, drives=tuple((i, 3 + i, 3 + i) for i in range(3))
        ),
        *_g_sensitivity(specs),
    ]


def _g_sensitivity(specs: AssumedSpecs) -> list[States]:
    variance = specs.imu.gyro.g_sensitivity_sd**2
    return [
        States(
            f"g_sensitivity_{axis}",
            "rad_s_per_m_s2",
            3,
            variance,
            drives=tuple((j, i, 3 + j) for j in range(3)),
        )
        for i, axis in enumerate("xyz")
    ]


MEMS = Block("mems", _mems, takes=("gyro scale factor", "accelerometer scale factor", "gyro g-sensitivity"))
"""Scale factors, and the g-sensitivity of the gyros: 3 x 3, as the sensor has it (A-5.1.8)."""


def _every_error(specs: AssumedSpecs) -> list[States]:
    found: list[States] = []
    for name, triad, at in (("gyro", specs.imu.gyro, 0), ("accel", specs.imu.accel, 3)):
        scale = _scale_variance(triad)
        across = triad.misalignment_sd**2 + 0.25 * triad.nonorthogonality_sd**2 + triad.alignment_sd**2
        if across > 0:  # row by row of M in (I + M) w
            for i, axis in enumerate("xyz"):
                variance = np.full(3, across)
                variance[i] = scale
                drives = tuple((j, at + i, at + j) for j in range(3))
                found.append(States(f"{name}_matrix_{axis}", "1", 3, variance, drives=drives))
        elif scale > 0:
            drives = tuple((i, at + i, at + i) for i in range(3))
            found.append(States(f"{name}_scale", "1", 3, scale, drives=drives))
    found += _flicker("gyro", "rad_s", specs.imu.gyro, 0) + _flicker("accel", "m_s2", specs.imu.accel, 3)
    return found + (_g_sensitivity(specs) if specs.imu.gyro.g_sensitivity_sd > 0 else [])


def _flicker_stages(triad: TriadSpec) -> list[tuple[float, float]]:
    """Return correlation time [s] and variance of the stages of a flicker bias, the slowest last."""
    if triad.bias_model != "flicker" or triad.bias_instability == 0:
        return []
    sd = triad.bias_instability * fit_flat_deviation(FLICKER_STAGES, 0.1, 10.0, 81)
    times = triad.bias_correlation * np.array(FLICKER_STAGES)
    return list(zip(times.tolist(), np.square(sd).tolist(), strict=True))


def _flicker(name: str, unit: str, triad: TriadSpec, at: int) -> list[States]:
    """Return the fast stages of a flicker bias; the slowest one is part of the bias."""
    drives = tuple((i, at + i, STEADY) for i in range(3))
    return [
        States(f"{name}_flicker_{k}", unit, 3, variance, 0.0, 1.0 / time, stationary=variance, drives=drives)
        for k, (time, variance) in enumerate(_flicker_stages(triad)[:-1], 1)
    ]


def _scale_variance(triad: TriadSpec) -> float:
    """Return the variance of the scale factor as it acts on rates that are small against the range.

    A nonlinearity of ``n (4 u^3 - 3 u)`` is a scale factor of -3 n there; an asymmetry adds its half to one
    sign of the rate and takes it from the other.
    """
    return triad.scale_factor_sd**2 + 9.0 * triad.nonlinearity_sd**2 + triad.scale_asymmetry_sd**2


EVERY_ERROR = Block(
    "every_error",
    _every_error,
    takes=tuple(
        f"{triad} {error}"
        for triad in ("gyro", "accelerometer")
        for error in (
            "scale factor",
            "misalignment",
            "non-orthogonality",
            "alignment",
            "nonlinearity",
            "scale factor asymmetry",
            "g-sensitivity",
            "temperature bias",
            "rate random walk",
            "bias instability as flicker noise",
        )
    ),
)
"""Scale factors and misalignments as the 3 x 3 matrix of each triad, g-sensitivity; what is 0 has no state.

With it the biases also hold what the temperature and a rate random walk do to them, and flicker noise is a
sum of processes: its fast stages are states, the slowest is part of the bias.
"""


def _clock(specs: AssumedSpecs) -> list[States]:
    sky = assumed(specs, "gnss").sky
    return [
        States("clock_offset", "m", 1, sky.clock_offset_sd**2, 0.5 * C**2 * sky.clock_h_0),
        States("clock_drift", "m_s", 1, sky.clock_drift_sd**2, 2.0 * np.pi**2 * C**2 * sky.clock_h_m2),
        States("glonass_offset", "m", 1, sky.glonass_offset_sd**2),
    ]


CLOCK = Block("tight", _clock, records=("observations",))
"""Offset and drift of the receiver's clock, and its offset for GLONASS.

``c^2 h_0 / 2`` drives the offset and ``2 pi^2 c^2 h_-2`` the drift (Brown and Hwang); flicker, h_-1, has no
state of finite size. The offset grows by the drift: `bench.navigation.cycle`.
"""


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


def _odometer_scale(specs: AssumedSpecs) -> list[States]:
    sd = assumed(specs, "odometer").scale_factor_sd
    return [States("odometer_scale", "1", 1, sd**2)] if sd > 0 else []


ODOMETER_SCALE = Block("odometer", _odometer_scale, takes=("odometer scale factor",), records=("odometer",))
"""Error of the odometer's scale factor, constant."""


def chosen_blocks(options: FusionOptions) -> list[Block]:
    """Return the blocks that the options of a compiled filter ask for, in the order of the layout."""
    arm = antenna(options.lever_arm_sd)
    every = (BARO_BIAS, GNSS_MARKOV, MEMS, EVERY_ERROR, CLOCK, arm, WIND, RADAR_BIAS, ODOMETER_SCALE)
    return [block for block in every if getattr(options, block.option)]
