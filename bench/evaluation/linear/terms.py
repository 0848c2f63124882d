"""Every error of the sensors on board as constants and processes of a linear model, by source.

The figures are from the datasheets of the sensors on board (`bench.simulation.sensors`), not from the ones
that a filter assumes. A constant is an error of one figure times a signal of the motion
(`Path.factors`); a process is three independent Gauss-Markov states or random walks, or white noise. What
is not Gaussian counts by an equal autocovariance (Tichavsky, Muravchik, Nehorai, IEEE Trans. Signal
Processing 46 (5), 1998): roundings are white, jumps where the satellites change are, where their epochs
are unknown, shot noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.sensor_specs import ImuSpec, SensorsSpec, ThermalSpec, TriadSpec, VibrationSpec
from bench.core.words.exceptions import ConfigError
from bench.navigation.error_state_filter.measurement_rows import BARO, POSITION, VELOCITY
from bench.navigation.error_state_filter.state_blocks import CHANGES
from bench.navigation.error_state_filter.state_processes import ABSOLUTE, CUBE, SQUARE, STEADY, WARMTH
from bench.simulation.sensors import imu as imu_model
from bench.simulation.sensors import static_pressure, vibration
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.gnss import find_constellation_changes
from bench.simulation.sensors.processes import choose_bias_stages
from bench.simulation.sensors.timing import find_epoch_rows

IMU = -1
"""What a process acts on, beside the sensors of `measurement_rows`: gyros or accelerometers."""
SAMPLES = 8  # runs that stand for an error which has no linear model
_NOTHING = np.zeros(3)


@dataclass(frozen=True, slots=True)
class Source:
    """A source of error, with the datasheet values that belong to it."""

    name: str
    part: str  # "initial", "gyro", "accel", "imu", "gnss" or "baro"
    figures: tuple[str, ...]  # fields of its spec, those that the error needs


@dataclass(frozen=True, slots=True)
class Constant:
    """An error of unit size that a coefficient of standard deviation 1 multiplies."""

    source: str
    start: FloatArray | None = None  # (9,) of position, velocity and attitude at the start
    factors: tuple[tuple[int, int, float], ...] = ()
    """Error (0 to 2 gyro, 3 to 5 accelerometer), factor of `Path.factors`, size [rad/s; m/s^2]."""
    signal: FloatArray | None = None  # (N - 1, 6) errors of the samples as rates [rad/s; m/s^2]
    height: FloatArray | None = None  # (M,) error of each barometric height [m]
    stochastic: bool = True  # False: the same in every run


@dataclass(frozen=True, slots=True)
class ErrorProcess:
    """Three states that act on a sensor, their driving noise, and white noise; each (3,) by axis."""

    source: str
    acts: int  # IMU, POSITION, VELOCITY or BARO
    first: int = 0  # of IMU: 0 gyros, 3 accelerometers
    variance: FloatArray = field(default_factory=lambda: _NOTHING)  # at the start
    density: FloatArray = field(default_factory=lambda: _NOTHING)  # of the noise that drives it [1/s]
    decay_time: float = 0.0  # [1/s]
    decay_distance: float = 0.0  # [1/m]
    white: FloatArray = field(default_factory=lambda: _NOTHING)
    """IMU: density of the rates [1/s]; else variance of each measurement."""
    kick: FloatArray = field(default_factory=lambda: _NOTHING)  # variance that each of ``at`` adds
    at: FloatArray | None = None  # (J,) epochs of kicks and white noise [s]; None: white noise always

    @property
    def states(self) -> bool:
        """Return whether the process has states, not only white noise."""
        return bool(self.variance.any() or self.density.any() or self.kick.any())


@dataclass(frozen=True, slots=True)
class TruthModel:
    """The errors of the sensors on board; ``sources`` in the order of a datasheet."""

    sources: tuple[Source, ...]
    constants: tuple[Constant, ...]
    processes: tuple[ErrorProcess, ...]


_TRIAD = {  # source -> figures it needs
    "white noise": ("random_walk",),
    "turn-on bias": ("turn_on_bias_sd",),
    "bias instability": ("bias_instability", "bias_correlation", "bias_model"),
    "rate random walk": ("rate_random_walk",),
    "scale factor": ("scale_factor_sd",),
    "misalignment": ("misalignment_sd",),
    "non-orthogonality": ("nonorthogonality_sd",),
    "alignment": ("alignment_sd",),
    "scale factor asymmetry": ("scale_asymmetry_sd",),
    "nonlinearity": ("nonlinearity_sd", "range"),
    "quadratic error": ("quadratic_sd",),
    "g-sensitivity": ("g_sensitivity_sd",),
    "sensitivity to g squared": ("g2_sensitivity_sd",),
    "temperature": ("temperature_sd",),
    "quantization": ("quantization",),
    "lag and dead zone": ("bandwidth", "delay", "dead_zone", "dead_zone_kind"),
}
_GNSS = {
    "GNSS position noise": ("pos_h_white_sd", "pos_v_white_sd"),
    "GNSS position wander": ("pos_h_markov_sd", "pos_v_markov_sd"),
    "GNSS velocity noise": ("vel_white_sd", "vel_v_white_sd"),
    "GNSS velocity wander": ("vel_markov_sd",),
    "GNSS jumps": tuple(
        f"{axes}_{kind}_sd" for axes in ("pos_h", "pos_v", "vel") for kind in ("jump", "jump_markov")
    ),
}
_BARO = {
    "barometer bias": ("bias_sd",),
    "barometer walk": ("bias_walk",),
    "barometer noise": ("white_sd", "quantization"),
}
INITIAL = {  # source -> figures of `bench.core.records.sensor_specs.SensorsSpec`
    "initial position": ("initial_pos_sd",),
    "initial velocity": ("initial_vel_sd",),
    "initial tilt": ("initial_tilt_sd",),
    "initial heading": ("initial_heading_sd",),
}
_WORDS = {"gyro": "gyro", "accel": "accelerometer"}
PHYSICAL = "barometer: pressure, port and weather"


def model_errors(truth: Trajectory, spec: SensorsSpec, seed: int, *, known_jumps: bool) -> TruthModel:
    """Return the errors of the sensors on board along a truth.

    Parameters
    ----------
    truth : Trajectory
        The motion.
    spec : SensorsSpec
        The sensors on board.
    seed : int
        Of the runs that stand for errors without a linear model.
    known_jumps : bool
        Let jumps of the GNSS error come where the satellites change on this flight; else at their mean rate.

    Raises
    ------
    ConfigError
        If a sensor has no linear model here.
    """
    check_sensors(spec)
    constants = list(_initial_errors(spec))
    processes: list[ErrorProcess] = []
    for part, first in (("gyro", 0), ("accel", 3)):
        triad = getattr(spec.imu, part)
        constants += list_triad_constants(_WORDS[part], triad, first)
        processes += list_triad_processes(_WORDS[part], triad, first)
    constants += sampled_imu(truth, spec.imu, seed)
    processes += list_gnss_processes(truth, spec, known_jumps)
    if spec.baro is not None and spec.baro.physical is not None:
        constants += sampled_baro(truth, spec, seed)
    elif spec.baro is not None:
        baro, one = spec.baro, np.array([1.0, 0.0, 0.0])
        white = baro.white_sd**2 + baro.quantization**2 / 12.0
        processes += [
            ErrorProcess("barometer bias", BARO, variance=baro.bias_sd**2 * one),
            ErrorProcess("barometer walk", BARO, density=baro.bias_walk**2 * one),
            ErrorProcess("barometer noise", BARO, white=white * one),
        ]
    processes = [one for one in processes if one.states or one.white.any()]
    present = {one.source for one in constants} | {one.source for one in processes}
    sources = tuple(one for one in list_sources() if one.name in present)
    return TruthModel(sources, tuple(constants), tuple(processes))


def check_sensors(spec: SensorsSpec) -> None:
    """Raise ConfigError if the sensors on board, or their faults, have no linear model here."""
    if spec.imu.accel_cone > 0:
        raise ConfigError("the linear model needs accelerometers along the axes, accel_cone_deg = 0")
    if spec.gnss is not None and spec.gnss.sky is not None:
        raise ConfigError(
            f"the linear model needs a GNSS unit of position level such as 'l1-code', not {spec.gnss.name!r}"
        )
    if spec.gnss is not None and spec.gnss.tracking_bandwidth > 0:
        raise ConfigError("the linear model has no lag of the receiver; set tracking_bandwidth_hz = 0")
    late = [one.name for one in (spec.gnss, spec.baro) if one is not None and one.latency > 0]
    if late:
        raise ConfigError(f"the linear model needs sensors without latency, not {', '.join(late)}")
    imu, gnss = spec.imu, spec.gnss
    names = ("resolution", "temperature2_sd", "hysteresis_sd", "transient_sd")
    odd = [name for one in (imu.gyro, imu.accel) for name in names if getattr(one, name) > 0]
    odd += [name for name in ("drift", "jitter") if getattr(imu.clock, name) > 0]
    odd += ["noise_shape" for one in (imu.gyro, imu.accel) if one.noise_shape != "white"]
    if gnss is not None:
        names = ("latency_jitter", "time_tag_error", "pos_h_smooth_sd", "pos_v_smooth_sd")
        odd += [name for name in names if getattr(gnss, name)]
    if odd:
        raise ConfigError(f"the linear model has no {', '.join(dict.fromkeys(odd))}: set them to 0")
    if spec.faults:
        raise ConfigError("the linear model has no scripted faults; give a profile without [[fault]]")


def list_sources() -> Iterator[Source]:
    """Yield every possible error source, in the order of a datasheet."""
    figures: tuple[str, ...]
    for name, figures in INITIAL.items():
        yield Source(name, "initial", figures)
    for part, words in _WORDS.items():
        for name, figures in _TRIAD.items():
            yield Source(f"{words} {name}", part, figures)
    yield Source("distance between the accelerometers", "imu", ("accel_arms",))
    yield Source("vibration", "imu", ("vibration",))
    for name, figures in _GNSS.items():
        yield Source(name, "gnss", figures)
    for name, figures in _BARO.items():
        yield Source(name, "baro", figures)
    yield Source(PHYSICAL, "baro", ("physical",))


def _initial_errors(spec: SensorsSpec) -> Iterator[Constant]:
    tilt = (spec.initial_tilt_sd, spec.initial_tilt_sd)
    sd = np.array([*spec.initial_pos_sd, *spec.initial_vel_sd, *tilt, spec.initial_heading_sd])
    names = np.repeat(list(INITIAL), [3, 3, 2, 1])
    for k in np.flatnonzero(sd):
        yield Constant(str(names[k]), start=sd[k] * np.eye(9)[k])


def list_triad_constants(words: str, triad: TriadSpec, first: int) -> Iterator[Constant]:
    """Yield the constant errors of a triad with its x axis at the input ``first``."""
    for name, figure, factor, step in (
        ("turn-on bias", "turn_on_bias_sd", STEADY, 0),
        ("scale factor", "scale_factor_sd", first, 1),
        ("scale factor asymmetry", "scale_asymmetry_sd", ABSOLUTE + first, 1),
        ("nonlinearity", "nonlinearity_sd", CUBE + first, 1),
        ("quadratic error", "quadratic_sd", SQUARE + first, 1),
        ("temperature", "temperature_sd", WARMTH, 0),
    ):
        for i, sd in enumerate(triad.by_axis(figure)):
            if sd > 0:
                yield Constant(f"{words} {name}", factors=((first + i, factor + step * i, float(sd)),))
    for name, figure, by in (
        ("g-sensitivity", "g_sensitivity_sd", 3),
        ("sensitivity to g squared", "g2_sensitivity_sd", SQUARE + 3),
    ):
        for i, j in np.ndindex(3, 3):
            if (sd := float(triad.by_axis(figure)[i])) > 0:
                yield Constant(f"{words} {name}", factors=((first + i, by + j, sd),))
    pairs = ((1, 2), (2, 0), (0, 1))
    for i, j in np.ndindex(3, 3):
        if i != j and triad.misalignment_sd > 0:
            yield Constant(f"{words} misalignment", factors=((first + i, first + j, triad.misalignment_sd),))
    for i, j in pairs:
        if (half := 0.5 * triad.nonorthogonality_sd) > 0:
            both = ((first + i, first + j, half), (first + j, first + i, half))
            yield Constant(f"{words} non-orthogonality", factors=both)
        if (sd := triad.alignment_sd) > 0:
            both = ((first + i, first + j, sd), (first + j, first + i, -sd))
            yield Constant(f"{words} alignment", factors=both)


def list_triad_processes(words: str, triad: TriadSpec, first: int) -> Iterator[ErrorProcess]:
    """Yield the random processes of a triad with its x axis at the input ``first``."""
    yield ErrorProcess(f"{words} white noise", IMU, first, white=triad.by_axis("random_walk") ** 2)
    if triad.bias_instability > 0:
        share = triad.by_axis("bias_instability") / triad.bias_instability
        for time, sd in zip(*choose_bias_stages(triad), strict=True):
            yield ErrorProcess(
                f"{words} bias instability", IMU, first, variance=(sd * share) ** 2, decay_time=1.0 / time
            )
    yield ErrorProcess(
        f"{words} rate random walk", IMU, first, density=triad.by_axis("rate_random_walk") ** 2
    )


def list_gnss_processes(truth: Trajectory, spec: SensorsSpec, known_jumps: bool) -> Iterator[ErrorProcess]:
    """Yield the random processes of position and velocity fixes."""
    gnss = spec.gnss
    if gnss is None:
        return
    for acts, name, axes in (
        (POSITION, "position", ("pos_h", "pos_h", "pos_v")),
        (VELOCITY, "velocity", ("vel", "vel", "vel")),
    ):
        markov, passing, lasting = (
            np.array([getattr(gnss, f"{axis}_{kind}_sd") for axis in axes]) ** 2
            for kind in ("markov", "jump", "jump_markov")
        )
        white = np.square(gnss.pos_white_sd_n if acts == POSITION else gnss.vel_white_sd_n)
        by_time = gnss.pos_decay_time if acts == POSITION else gnss.vel_decay_time
        by_distance = gnss.pos_decay_distance if acts == POSITION else 0.0
        decaying = partial(ErrorProcess, acts=acts, decay_time=by_time, decay_distance=by_distance)
        yield ErrorProcess(f"GNSS {name} noise", acts, white=white)
        yield decaying(f"GNSS {name} wander", variance=markov)
        if not (passing.any() or lasting.any()):
            continue
        if known_jumps:
            t = truth.t[find_epoch_rows("gnss", truth.t, gnss.rate)]
            lla = truth.lla[find_epoch_rows("gnss", truth.t, gnss.rate)]
            at = t[find_constellation_changes(t, lla)]
            yield decaying("GNSS jumps", kick=lasting, white=passing, at=at)
        else:
            speed = float(np.hypot(truth.vel_n[:, 0], truth.vel_n[:, 1]).mean())
            rate = max(by_time + by_distance * speed, 1.0 / 86400.0)
            shot = lasting * CHANGES / (2.0 * rate)
            passed = passing * min(CHANGES / gnss.rate, 1.0)
            yield decaying("GNSS jumps", variance=shot, white=passed)


def sampled_imu(truth: Trajectory, imu: ImuSpec, seed: int) -> Iterator[Constant]:
    """Yield the simulated errors due to rounding, lag, dead zone, lever arms and vibration, each alone."""
    still = ThermalSpec()
    dt = np.diff(truth.t)[:, None]

    def signal(unit: ImuSpec) -> FloatArray:
        made, _ = imu_model.measure(truth, unit, SensorDraws(seed, 0))
        return np.hstack([made.dtheta_b - truth.dtheta_b, made.dvel_b - truth.dvel_b]) / dt

    nothing = ImuSpec(imu.name, TriadSpec(), TriadSpec(), still)
    for part, words in _WORDS.items():
        triad = getattr(imu, part)
        for name in ("quantization", "lag and dead zone"):
            kept = {figure: getattr(triad, figure) for figure in _TRIAD[name]}
            if any(isinstance(value, float) and value > 0 for value in kept.values()):
                only = TriadSpec(**kept)
                alone = replace(nothing, gyro=only) if part == "gyro" else replace(nothing, accel=only)
                yield Constant(f"{words} {name}", signal=signal(alone), stochastic=False)
    if imu.accel_arms:
        alone = replace(nothing, accel_arms=imu.accel_arms)
        yield Constant("distance between the accelerometers", signal=signal(alone), stochastic=False)
    if imu.vibration != VibrationSpec():
        for run in range(SAMPLES):
            shaken = vibration.shake(truth, imu.vibration, SensorDraws(seed, run).part("imu.vibration"))
            error = np.hstack([shaken[0] - truth.dtheta_b, shaken[1] - truth.dvel_b]) / dt
            yield Constant("vibration", signal=error / np.sqrt(SAMPLES))


def sampled_baro(truth: Trajectory, spec: SensorsSpec, seed: int) -> Iterator[Constant]:
    """Yield the errors of simulated barometer runs due to the static pressure of the flight."""
    assert spec.baro is not None
    rows = find_epoch_rows("baro", truth.t, spec.baro.rate)
    for run in range(SAMPLES):
        record, _ = static_pressure.measure(
            truth, spec.baro, spec.qnh, spec.static_port_b, SensorDraws(seed, run)
        )
        error = record.alt_baro - truth.lla[rows, 2]
        yield Constant(PHYSICAL, height=error / np.sqrt(SAMPLES))
