"""Allan deviation of an IMU model, or of a recording at rest, compared with a datasheet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import gammaincinv

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import AirData, Trajectory, no_controls, no_events
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.evaluation.motion.noise_fit import NoiseFit
from bench.evaluation.motion.pose_fit import PoseFit
from bench.simulation.sensors import imu
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.processes import make_noise_terms
from bench.simulation.signals import allan

FAST, SLOW = (200.0, 300.0), (1.0, 65536.0)
"""Rate [Hz] and length [s] of the two simulated records: for white noise and quantization, for slow terms."""
INDEPENDENT = 16
"""Smallest number of independent averages in a record at the longest averaging time."""
_CHANGE = 8.0  # the slow record serves averaging times from here on [s]
_TAIL = 0.0005  # probability beyond each side of a 99.9 % band
SHOWN_UNITS = {"gyro": ("deg/h", math.degrees(3600.0)), "accel": ("ug", 1e6 / STANDARD_GRAVITY)}
"""Triad -> unit of the plots, and the factor from SI to it."""


@dataclass(frozen=True, slots=True)
class AllanCurve:
    """The Allan deviation of one triad, its three axes pooled."""

    triad: str  # "gyro" or "accel"
    tau: FloatArray  # (T,) averaging time [s]
    measured: FloatArray  # (T,) root of the mean Allan variance of the axes [unit/s]
    edf: FloatArray  # (T,) effective degrees of freedom of the measured variance
    low: FloatArray  # (T,) 99.9 % band of the measured value around what is expected [unit/s]
    high: FloatArray  # (T,)
    expected: FloatArray  # (T,) from all terms of the datasheet; NaN without one [unit/s]
    terms: Mapping[str, FloatArray] = field(default_factory=dict)  # of each term

    @property
    def outside(self) -> int:
        """Number of measured values outside their band."""
        return int(np.sum((self.measured < self.low) | (self.measured > self.high)))


@dataclass(frozen=True, slots=True)
class AllanResult:
    """The Allan deviation of the triads of an IMU."""

    name: str  # of the IMU, of the log, or of both
    curves: tuple[AllanCurve, ...]
    spec: ImuSpec | None  # datasheet to compare with, or the figures fitted to a log
    simulated: bool  # True: measured on the model of the datasheet; False: on a log
    fits: tuple[NoiseFit, ...] = ()  # of a log of at least `noise_fit.FEWEST` samples
    fitted: bool = False  # spec has the figures fitted to the log
    record: str = ""  # the log in words, or its longest rest
    poses: tuple[PoseFit, ...] = ()  # of a log with several poses

    @property
    def points(self) -> int:
        """Number of measured values."""
        return sum(len(curve.tau) for curve in self.curves)

    @property
    def outside(self) -> int:
        """Number of measured values outside their 99.9 % band."""
        return sum(curve.outside for curve in self.curves)

    @property
    def held(self) -> bool:
        """Return whether at most one value in a hundred lies outside its band; always True for a log."""
        return not self.simulated or self.outside <= max(1, self.points // 100)


def measure_model(spec: ImuSpec, seed: int = 1) -> list[AllanCurve]:
    """Simulate an IMU at rest and constant temperature, and compare its Allan deviation with its datasheet.

    Averaging times below 8 s come from a record at 200 Hz, the others from 18 h at 1 Hz. A skewed triad is
    measured along its own axes. White noise is not filtered, and neither rates nor time tags are rounded or
    late: datasheets do not specify these by an Allan deviation. The simulated biases are linear between
    epochs 0.05 s (1 s) apart; the expected curve includes the effect, which is visible if there is little
    white noise.
    """
    gyro, accel = (
        replace(triad, noise_shape="white", resolution=0.0, transient_sd=0.0)
        for triad in (spec.gyro, spec.accel)
    )
    resting = ImuSpec(spec.name, gyro, accel)
    triads = {"gyro": spec.gyro, "accel": spec.accel}
    found: dict[str, list[AllanCurve]] = {
        name: [] for name, triad in triads.items() if make_noise_terms(triad)
    }
    for (rate, length), first, last in ((FAST, 0.0, _CHANGE), (SLOW, _CHANGE, np.inf)):
        record, _ = imu.measure(make_resting_truth(rate, length), resting, SensorDraws(seed, 0))
        spans = allan.make_octaves(len(record), INDEPENDENT)
        spans = spans[(spans / rate >= first) & (spans / rate < last)]
        for name, increments in (("gyro", record.dtheta_b), ("accel", record.dvel_b)):
            if name in found:
                step = imu.choose_bias_step(triads[name], 1 / rate)
                found[name].append(_measure_curve(name, increments, 1 / rate, spans, triads[name], step))
    return [_join_curves(parts) for parts in found.values()]


def make_resting_truth(rate: float, length: float) -> Trajectory:
    """Return a truth at rest in a frame that does not rotate, with 1 g, at 25 degC in calm air."""
    n = round(rate * length)
    t = np.arange(n + 1) / rate
    ends, one, zero = t[[0, -1]], np.ones(2), np.zeros(2)
    air = AirData(ends, 101325.0 * one, 298.15 * one, zero, zero, zero, zero, np.zeros((2, 3)), zero)
    fixed, turn = np.zeros((n + 1, 3)), np.zeros((n + 1, 4))
    turn[:, 0] = 1.0
    force = np.zeros((n, 3))
    force[:, 2] = -STANDARD_GRAVITY / rate
    return Trajectory(t, fixed, fixed, turn, np.zeros((n, 3)), force, air, no_controls(), no_events())


def _measure_curve(
    name: str,
    increments: FloatArray,
    interval: float,
    spans: IntArray,
    triad: TriadSpec | None,
    step: float = 0.0,
) -> AllanCurve:
    """Return the Allan deviation of one record, axes pooled, with its band around the datasheet.

    ``step`` is the interval between the epochs of the simulated biases [s].
    """
    by_axis = allan.measure_deviation(increments, interval, spans)
    measured: FloatArray = np.sqrt(np.mean(by_axis**2, axis=1))
    tau = np.multiply(spans, interval, dtype=float)
    terms = make_noise_terms(triad, step) if triad is not None else {}
    process = allan.add_processes(*terms.values()) if terms else allan.white(1.0)
    axes = 1 if triad is not None and triad.axes else increments.shape[1]  # the largest alone, if they differ
    one_axis = [allan.degrees_of_freedom(process, len(increments), interval, int(m)) for m in spans]
    edf: FloatArray = axes * np.array(one_axis)
    expected = allan.expected_deviation(process, tau) if terms else np.full(len(tau), np.nan)
    center = expected if terms else measured
    low, high = center * _ratio_quantile(edf, _TAIL), center * _ratio_quantile(edf, 1 - _TAIL)
    by_term = {key: allan.expected_deviation(term, tau) for key, term in terms.items()}
    return AllanCurve(name, tau, measured, edf, low, high, expected, by_term)


def _ratio_quantile(edf: FloatArray, probability: float) -> FloatArray:
    """Return the quantile (T,) of the ratio of measured to expected Allan deviation."""
    ratio: FloatArray = np.sqrt(2 * gammaincinv(edf / 2, probability) / edf)
    return ratio


def _join_curves(parts: list[AllanCurve]) -> AllanCurve:
    """Join the curves of one triad for consecutive averaging times."""
    columns = ("tau", "measured", "edf", "low", "high", "expected")
    return AllanCurve(
        parts[0].triad,
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in columns},
        terms={name: np.concatenate([part.terms[name] for part in parts]) for name in parts[0].terms},
    )


def measure_record(t: FloatArray, triads: Mapping[str, FloatArray], spec: ImuSpec | None) -> list[AllanCurve]:
    """Return the Allan deviations of a recording at rest, compared with a datasheet if there is one.

    Parameters
    ----------
    t : (N,) array
        Times, evenly spaced [s].
    triads : mapping of (N, 3) arrays
        "gyro" [rad/s], "accel" [m/s^2].
    spec : ImuSpec or None
        The datasheet.
    """
    interval = (t[-1] - t[0]) / (len(t) - 1)
    spans = allan.make_octaves(len(t), INDEPENDENT)
    return [
        _measure_curve(name, rates * interval, interval, spans, getattr(spec, name) if spec else None)
        for name, rates in triads.items()
    ]


def format_noise_figures(name: str, triad: TriadSpec) -> dict[str, str]:
    """Return the random errors of a triad as text in the units of datasheets, by name of the error."""
    unit, factor = SHOWN_UNITS[name]
    root = "deg/sqrt(h)" if name == "gyro" else "m/s/sqrt(h)"
    per_root = math.degrees(60.0) if name == "gyro" else 60.0
    bit = f"{triad.quantization:.3g} {'rad' if name == 'gyro' else 'm/s'}"
    return {
        "quantization": bit,
        "white noise": f"{per_root * triad.random_walk:.3g} {root}",
        "bias instability": f"{factor * triad.bias_instability:.3g} {unit}",
        "rate random walk": f"{60 * factor * triad.rate_random_walk:.3g} {unit}/sqrt(h)",
    }
