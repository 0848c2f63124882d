"""Definitions of IMU noise in other programs: key, unit and discretization of each parameter.

Each definition was read in the source that `Program.source` names. A parameter is a power of a figure of the
datasheet in SI times a scale, a power of the sample rate and a power of the correlation time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from bench.core.mathematics.units import DEG, HOUR, STANDARD_GRAVITY

_ROOT2 = math.sqrt(2.0)
_PER_ROOT_HOUR, _DEG_PER_ROOT_HOUR = math.sqrt(HOUR), math.sqrt(HOUR) / DEG


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of another program: ``(scale * figure * rate^r * correlation^c)^power``."""

    key: str
    triad: str  # "gyro" or "accel"
    figure: str  # field of `TriadSpec`, or "instability_sd": the sd of a Gauss-Markov bias
    unit: str  # in the file
    scale: float = 1.0  # number in the file for a figure of 1 in SI
    rate: float = 0.0  # exponent of the sample rate [Hz]
    correlation: float = 0.0  # exponent of the correlation time of the bias instability [s]
    power: int = 1  # 2: a variance
    layout: str = ""  # if it differs from `Program.layout`


@dataclass(frozen=True, slots=True)
class Program:
    """A program and the file of its IMU parameters."""

    title: str
    source: str  # where its definitions were read
    parameters: tuple[Parameter, ...]
    line: str  # of a parameter, with {key} and {values}
    layout: str = "one"  # numbers of a parameter: "one", "three" axes, or a "matrix" by rows
    head: tuple[str, ...] = ()  # lines above, with {rate}
    tail: tuple[str, ...] = ()
    comment: str = "#"
    note: str = ""  # what a user must know, one sentence

    @property
    def needs_rate(self) -> bool:
        """Return whether a parameter depends on the sample rate."""
        return any(one.rate for one in self.parameters)


def _pair(figure: str, gyro: tuple[str, str], accel: tuple[str, str], **how: float) -> tuple[Parameter, ...]:
    """Return a figure of gyros and accelerometers, each with key and unit."""
    return (
        Parameter(gyro[0], "gyro", figure, gyro[1], **how),  # type: ignore[arg-type]
        Parameter(accel[0], "accel", figure, accel[1], **how),  # type: ignore[arg-type]
    )


_KALIBR = _pair(
    "random_walk",
    ("gyroscope_noise_density", "rad/s/sqrt(Hz)"),
    ("accelerometer_noise_density", "m/s^2/sqrt(Hz)"),
) + _pair(
    "rate_random_walk",
    ("gyroscope_random_walk", "rad/s^2/sqrt(Hz)"),
    ("accelerometer_random_walk", "m/s^3/sqrt(Hz)"),
)

PROGRAMS: Mapping[str, Program] = {
    "kalibr": Program(
        "kalibr, imu.yaml",
        "https://github.com/ethz-asl/kalibr/wiki/IMU-Noise-Model and ethz-asl/kalibr, issue 354: white noise "
        "of a sample density / sqrt(dt), step of the bias walk * sqrt(dt)",
        _KALIBR,
        "{key}: {values}",
        head=("rostopic: /imu0", "update_rate: {rate}"),
    ),
    "openvins": Program(
        "OpenVINS, kalibr_imu_chain.yaml",
        "rpng/open_vins: config/euroc_mav/kalibr_imu_chain.yaml; ov_msckf/src/state/Propagator.cpp: "
        "continuous, Qc = sigma^2 / dt and G = dt",
        _KALIBR,
        "  {key}: {values}",
        head=("%YAML:1.0", "imu0:", "  rostopic: /imu0", "  update_rate: {rate}"),
    ),
    "vins": Program(
        "VINS-Mono and VINS-Fusion, the IMU lines of the configuration",
        "HKUST-Aerial-Robotics/VINS-Mono: config/euroc/euroc_config.yaml; "
        "vins_estimator/src/factor/integration_base.h, the same in VINS-Fusion: discrete, per sample",
        _pair("random_walk", ("gyr_n", "rad/s"), ("acc_n", "m/s^2"), scale=_ROOT2, rate=0.5)
        + _pair("rate_random_walk", ("gyr_w", "rad/s^2"), ("acc_w", "m/s^3"), rate=0.5),
        "{key}: {values}",
        note="Midpoint integration takes the two samples of a step as independent: its covariance grows "
        "by n^2 dt^2 / 2 a step: n is sqrt(2) times the noise of a sample.",
    ),
    "gtsam": Program(
        "gtsam, PreintegrationCombinedParams in Python",
        "borglab/gtsam: gtsam/navigation/PreintegrationParams.h, PreintegratedRotation.h and "
        "CombinedImuFactor.cpp: covariances of densities, cov / dt and dt * cov",
        _pair(
            "random_walk",
            ("setGyroscopeCovariance", "(rad/s)^2/Hz"),
            ("setAccelerometerCovariance", "(m/s^2)^2/Hz"),
            power=2,
        )
        + _pair(
            "rate_random_walk",
            ("setBiasOmegaCovariance", "(rad/s^2)^2/Hz"),
            ("setBiasAccCovariance", "(m/s^3)^2/Hz"),
            power=2,
        ),
        "params.{key}(np.array({values}).reshape(3, 3))",
        "matrix",
        head=(
            "import gtsam",
            "import numpy as np",
            "",
            "params = gtsam.PreintegrationCombinedParams.MakeSharedD(9.81)",
        ),
        note="integrationCovariance is an error of the integration, not of the IMU.",
    ),
    "matlab": Program(
        "MATLAB: imuSensor, and factorIMUParameters for the filters",
        "MathWorks fusion.internal.IMUSensorSimulator (setupBandwidth, setStdDevWhiteNoise, "
        "setStdDevRandWalk), NoiseType double-sided: sd = NoiseDensity sqrt(fs / 2), "
        "step = RandomWalk / sqrt(fs / 2); "
        "https://mathworks.com/help/nav/ref/factorimuparameters.html: variances of a sample",
        _pair(
            "random_walk",
            ("imu.Gyroscope.NoiseDensity", "(rad/s)/sqrt(Hz)"),
            ("imu.Accelerometer.NoiseDensity", "(m/s^2)/sqrt(Hz)"),
            scale=_ROOT2,
        )
        + _pair(
            "rate_random_walk",
            ("imu.Gyroscope.RandomWalk", "(rad/s)*sqrt(Hz)"),
            ("imu.Accelerometer.RandomWalk", "(m/s^2)*sqrt(Hz)"),
            scale=1.0 / _ROOT2,
        )
        + _pair(
            "random_walk",
            ("params.GyroscopeNoise", "(rad/s)^2"),
            ("params.AccelerometerNoise", "(m/s^2)^2"),
            rate=0.5,
            power=2,
        )
        + _pair(
            "rate_random_walk",
            ("params.GyroscopeBiasNoise", "(rad/s)^2"),
            ("params.AccelerometerBiasNoise", "(m/s^2)^2"),
            rate=-0.5,
            power=2,
        ),
        "{key} = {values};",
        "three",
        head=(
            "imu = imuSensor('accel-gyro', 'SampleRate', {rate});",
            "imu.Gyroscope = gyroparams; imu.Accelerometer = accelparams;",
            "params = factorIMUParameters(SampleRate={rate});",
        ),
        comment="%",
        note="BiasInstability of imuSensor is filtered noise without a time scale: left at 0.",
    ),
    "ros": Program(
        "ROS, covariances of sensor_msgs/Imu",
        "sensor_msgs/msg/Imu of ros2/common_interfaces: the variance of each measurement on the diagonal",
        _pair(
            "random_walk",
            ("angular_velocity_covariance", "(rad/s)^2"),
            ("linear_acceleration_covariance", "(m/s^2)^2"),
            rate=0.5,
            power=2,
        ),
        "{key}: {values}",
        "matrix",
        head=("# of messages at {rate} Hz",),
    ),
    "kf-gins": Program(
        "KF-GINS, the table imunoise of kf-gins.yaml",
        "i2Nav-WHU/KF-GINS: dataset/kf-gins.yaml; src/kf_gins.cpp (units); src/kf-gins/gi_engine.cpp: "
        "Qc = arw^2 and 2 / corrtime * gbstd^2",
        (
            Parameter("arw", "gyro", "random_walk", "deg/sqrt(h)", _DEG_PER_ROOT_HOUR),
            Parameter("vrw", "accel", "random_walk", "m/s/sqrt(h)", _PER_ROOT_HOUR),
            Parameter("gbstd", "gyro", "instability_sd", "deg/h", HOUR / DEG),
            Parameter("abstd", "accel", "instability_sd", "mGal", 1e5),
            Parameter("gsstd", "gyro", "scale_factor_sd", "ppm", 1e6),
            Parameter("asstd", "accel", "scale_factor_sd", "ppm", 1e6),
            Parameter("corrtime", "gyro", "bias_correlation", "h", 1.0 / HOUR, layout="one"),
        ),
        "  {key}: {values}",
        "three",
        head=("imunoise:",),
    ),
    "navego": Program(
        "NaveGo, the structure imu in units of manufacturers",
        "rodralez/NaveGo: conversions/imu_si_errors.m (units); simulation/gyro_gen.m, noise_b_dyn.m (sd of a "
        "Gauss-Markov process), noise_rrw.m (a step of rrw * dt per sample)",
        (
            Parameter("imu.arw", "gyro", "random_walk", "deg/sqrt(h)", _DEG_PER_ROOT_HOUR),
            Parameter("imu.vrw", "accel", "random_walk", "m/s/sqrt(h)", _PER_ROOT_HOUR),
            Parameter("imu.arrw", "gyro", "rate_random_walk", "deg/sqrt(h)/s", _DEG_PER_ROOT_HOUR, rate=0.5),
            Parameter("imu.vrrw", "accel", "rate_random_walk", "m/s/sqrt(h)/s", _PER_ROOT_HOUR, rate=0.5),
            Parameter("imu.gb_dyn", "gyro", "instability_sd", "deg/s", 1.0 / DEG),
            Parameter("imu.ab_dyn", "accel", "instability_sd", "mg", 1e3 / STANDARD_GRAVITY),
            Parameter("imu.gb_corr", "gyro", "bias_correlation", "s"),
            Parameter("imu.ab_corr", "accel", "bias_correlation", "s"),
        ),
        "{key} = {values};",
        "three",
        comment="%",
        note="noise_rrw.m steps by arrw * dt a sample, so arrw is K times the square root of the rate.",
    ),
    "gnss-ins-sim": Program(
        "gnss-ins-sim, the dictionary of an IMU model",
        "Aceinna/gnss-ins-sim: gnss_ins_sim/sim/imu_model.py (keys, units); gnss_ins_sim/pathgen/pathgen.py, "
        "bias_drift at commit 0d8bc78e: a step of drift * sqrt(1 - exp(-2 dt / b_corr)) (issue 19)",
        (
            Parameter("gyro_arw", "gyro", "random_walk", "deg/sqrt(h)", _DEG_PER_ROOT_HOUR),
            Parameter("accel_vrw", "accel", "random_walk", "m/s/sqrt(h)", _PER_ROOT_HOUR),
            Parameter("gyro_b_stability", "gyro", "instability_sd", "deg/h", HOUR / DEG),
            Parameter("accel_b_stability", "accel", "instability_sd", "m/s^2"),
            Parameter("gyro_b_corr", "gyro", "bias_correlation", "s"),
            Parameter("accel_b_corr", "accel", "bias_correlation", "s"),
        ),
        "    '{key}': np.array({values}),",
        "three",
        head=("import numpy as np", "", "imu_err = {{", "    'gyro_b': np.zeros(3), 'accel_b': np.zeros(3),"),
        tail=("}",),
        note="b_stability is the sd; older versions use it otherwise: steps of b_stability * dt.",
    ),
}
"""Name of a program -> its parameters."""


@dataclass(frozen=True, slots=True)
class TuningParameter:
    """A process noise of an autopilot; the noise of the IMU is a lower bound."""

    key: str
    triad: str
    figure: str  # of `TriadSpec` whose value at the rate of the filter is the bound; "": no bound
    unit: str
    default: float


@dataclass(frozen=True, slots=True)
class VehicleTuning:
    """A filter with parameters that describe a whole vehicle."""

    title: str
    source: str
    step: float  # of its prediction [s]
    parameters: tuple[TuningParameter, ...]
    note: str = ""


TUNINGS: Mapping[str, VehicleTuning] = {
    "px4": VehicleTuning(
        "PX4 EKF2",
        "PX4/PX4-Autopilot: src/modules/ekf2, EKF2_*_NOISE, EKF2_PREDICT_US; covariance.cpp: (dt * noise)^2",
        0.01,
        (
            TuningParameter("EKF2_GYR_NOISE", "gyro", "random_walk", "rad/s", 1.5e-2),
            TuningParameter("EKF2_ACC_NOISE", "accel", "random_walk", "m/s^2", 3.5e-1),
            TuningParameter("EKF2_GYR_B_NOISE", "gyro", "rate_random_walk", "rad/s^2", 1e-3),
            TuningParameter("EKF2_ACC_B_NOISE", "accel", "rate_random_walk", "m/s^3", 3e-3),
        ),
    ),
    "ardupilot": VehicleTuning(
        "ArduPilot EKF3, Copter",
        "ArduPilot/ardupilot: libraries/AP_NavEKF3/AP_NavEKF3.cpp, *_P_NSE_DEFAULT; AP_NavEKF3_core: "
        "EKF_TARGET_DT, (dt * noise)^2",
        0.012,
        (
            TuningParameter("EK3_GYRO_P_NSE", "gyro", "random_walk", "rad/s", 1.5e-2),
            TuningParameter("EK3_ACC_P_NSE", "accel", "random_walk", "m/s^2", 3.5e-1),
            TuningParameter("EK3_GBIAS_P_NSE", "gyro", "rate_random_walk", "rad/s^2", 1e-3),
            TuningParameter("EK3_ABIAS_P_NSE", "accel", "rate_random_walk", "m/s^3", 2e-2),
        ),
    ),
    "robot_localization": VehicleTuning(
        "robot_localization",
        "cra-ros-pkg/robot_localization: params/ekf.yaml; src/ekf.cpp: covariance * delta",
        1.0,
        (
            TuningParameter("process_noise_covariance of vroll", "gyro", "", "(rad/s)^2/s", 0.01),
            TuningParameter("process_noise_covariance of vyaw", "gyro", "", "(rad/s)^2/s", 0.02),
            TuningParameter("process_noise_covariance of ax", "accel", "", "(m/s^2)^2/s", 0.01),
        ),
        "Its process noise is the motion of the robot. The noise of the IMU enters by the covariance of its "
        "messages: --to ros.",
    ),
}
"""Name of a filter -> the parameters that no datasheet gives."""
