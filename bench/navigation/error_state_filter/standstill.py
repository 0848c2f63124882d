"""Standstill, detected from the IMU alone.

Over windows of a second the gyros and accelerometers show only their noise, and their means are the rate of
the Earth and gravity. Steady flight in calm air looks the same: the gate of the filter, which knows the
velocity, decides.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.earth import EARTH_RATE, GAMMA_E
from bench.core.records.data import ImuData
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.navigation.engine.imu_sampler import ImuSampler, sum_segments

WINDOW = 1.0  # [s]
VELOCITY_SD = 0.02  # of an aircraft that stands and rocks in the wind [m/s]
RATE_SD = 2e-5  # the same [rad/s]
_NOISY = 1.5  # sd of the samples over that of their noise: 200 samples stay below 1.2
_FEWEST = 4  # samples that tell their noise
_SWINGS = 0.3  # change of the mean between halves of a window over the sd of what shakes on the ground
_SIGMAS = 4.0  # of the biases, granted to the means
STILL_SD = float(np.deg2rad(0.1))  # of the change of an angle at rest, with the Earth's rotation [rad]
_TURNS = 5.0  # sigmas of an angle beyond which the unit has turned
_GRAVITY_SPREAD = 0.06  # normal gravity between equator, poles and 12 km [m/s^2]


class StandstillDetector(ImuSampler):
    """Detector of standstills of an IMU over windows of `WINDOW`; values are zero velocity and mean rate.

    Values are the measured mean rate [rad/s] and force [m/s^2] over each window, b; variances those of the
    velocity, which is zero, and of the rate. With ``gyro_sd``, the sd of the whole error of a gyro [rad/s],
    it may be shaken: the noise of the accelerometers is not asked, and rates that swing have the same mean in
    both halves of a window. What hovers swings slower.
    """

    def __init__(self, start: float, spec: ImuSpec, *, gyro_sd: float | None = None) -> None:
        super().__init__(start, WINDOW)
        self.spec, self.gyro_sd = spec, gyro_sd

    def measure(self, imu: ImuData, last: IntArray) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Return the windows of standstill, the mean rates and forces (W, 6) and the variances (6,)."""
        spec, end = self.spec, last + 1
        first = np.append(0, end)[: len(last)]
        variance = np.repeat([VELOCITY_SD**2, rate_variance(spec)], 3)
        if not len(last):
            return np.zeros(0, np.bool_), np.empty((0, 6)), variance
        count = end - first
        total = sum_segments(imu.dt[:, None], first, end)
        spans = imu.t[last] - (imu.t[first] - imu.dt[first])
        still = (np.abs(spans - total[:, 0]) < 0.5 * imu.dt[first]) & (count >= _FEWEST)  # no gap in it
        inside, means = slice(0, end[-1]), []
        for increment, triad, extra in (
            (imu.dtheta_b, spec.gyro, spec.vibration.engine_gyro),
            (imu.dvel_b, spec.accel, spec.vibration.engine_accel),
        ):
            rate = increment[inside] / imu.dt[inside, None]
            mean = sum_segments(rate, first, end) / count[:, None]
            square = np.square(rate - np.repeat(mean, count, axis=0))
            sd = np.sqrt(sum_segments(square, first, end) / count[:, None])
            quiet = sd < _NOISY * _sample_sd(triad, total / count[:, None], extra)
            if self.gyro_sd is not None:
                middle = first + count // 2
                halves = [sum_segments(rate, *ends) for ends in ((first, middle), (middle, end))]
                change = np.abs(2.0 * (halves[1] - halves[0]) / count[:, None])
                quiet |= (triad is spec.accel) | (change < _SWINGS * sd)
            still &= quiet.all(axis=1)
            means.append(mean)
        turn, force = means
        errs = self.gyro_sd
        if errs is None:
            errs = _bias_sd(spec.gyro) + spec.gyro.g_sensitivity_sd * GAMMA_E
        still &= (np.abs(turn) < EARTH_RATE + _SIGMAS * (errs + RATE_SD)).all(axis=1)
        size = np.linalg.norm(force, axis=1)
        allowed = _GRAVITY_SPREAD + _SIGMAS * (_bias_sd(spec.accel) + GAMMA_E * spec.accel.scale_factor_sd)
        still &= np.abs(size - GAMMA_E) < allowed
        return still, np.hstack(means), variance

    def first_needed(self, imu: ImuData, last: IntArray) -> int:
        """Return the first sample of the window that has not ended."""
        return int(last[-1]) + 1 if len(last) else 0


def rate_variance(spec: ImuSpec) -> float:
    """Return the variance of the mean rate in a window about the Earth rate plus the bias [rad^2/s^2]."""
    return spec.gyro.random_walk**2 / WINDOW + RATE_SD**2


def count_steady(
    rate_b: FloatArray, usual_b: FloatArray | None, gyro: TriadSpec, warming: float = 0.0
) -> int:
    """Return the number of windows from the first on before the unit turns.

    It has turned if its rates, less the usual rate, integrate to an angle beyond their noise on some axis.

    Parameters
    ----------
    rate_b : (W, 3) array
        Mean rates of consecutive windows of a standstill, each `WINDOW` long [rad/s].
    usual_b : (3,) array or None
        Mean rate at rest before them [rad/s]. None: for each window, the mean of the windows before it.
    gyro : TriadSpec
        Random walk and bias instability of the rates.
    warming : float
        Sd of the change of the rates by temperature between these windows and those before [rad/s].

    Returns
    -------
    count : int
        0 to W; with ``usual_b`` of None, the first window counts always.
    """
    begun = int(usual_b is None and len(rate_b) > 0)  # its rate is that of the first
    k = np.arange(1.0, len(rate_b) + 1.0)[:, None]
    before = usual_b if usual_b is not None else (np.cumsum(rate_b, axis=0) / k)[:-1]
    rate_b, k = rate_b[begun:] - before, k[: len(rate_b) - begun]
    angle = np.abs(np.cumsum(rate_b, axis=0)) * WINDOW
    T = k * WINDOW
    sd = np.sqrt(STILL_SD**2 + 2.0 * T * gyro.random_walk**2 + T**2 * (gyro.instability_sd**2 + warming**2))
    turns: BoolArray = np.asarray((angle > _TURNS * sd).any(axis=1))
    return begun + (int(np.argmax(turns)) if turns.any() else len(turns))


def _sample_sd(triad: TriadSpec, dt: FloatArray, vibration: float) -> FloatArray:
    """Return the standard deviation of a sample at rest; 1e-9 of the unit without any noise."""
    lsb = triad.quantization / dt
    return np.asarray(np.sqrt(triad.random_walk**2 / dt + lsb**2 / 6.0 + vibration**2) + 1e-9)


def _bias_sd(triad: TriadSpec) -> float:
    return float(np.hypot(triad.turn_on_bias_sd, triad.instability_sd))
