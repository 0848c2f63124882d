"""The public functions of Python: what ``bench run`` does.

``run`` is its four steps in a row; each can be called by itself, with any of its inputs exchanged:

    profile = bench.load_profile("figure-eight", seed=7)
    truth = bench.fly(profile)
    sensed = bench.sense(profile, truth)
    solution = bench.navigate("loose-15", sensed.data, sensed.initial)
    errors, metrics = bench.judge(profile, truth, solution)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from bench import pipeline, store
from bench.config import load_profile
from bench.data import ErrorSeries, InitialState, NavSolution, RunResult, Sensed, SensorData, Trajectory
from bench.errors import ConfigError
from bench.specs import EstimatorChoice, Profile

if TYPE_CHECKING:
    from bench.evaluation.noise_curves import AllanResult
    from bench.exchange.rinex_fixes import RinexFixes
    from bench.signals.delays import Troposphere
    from bench.signals.receiver import Ionosphere, Systems

load = store.load

__all__ = ["fly", "judge", "load", "load_profile", "measure_allan", "navigate", "run", "sense", "solve_rinex"]


def run(
    profile: str | Path | Profile,
    *,
    seed: int | None = None,
    run: int = 0,
    estimators: Sequence[str] | None = None,
    sensors: Mapping[str, str] | None = None,
) -> RunResult:
    """Fly one profile, sense, navigate with every estimator, and judge.

    Parameters
    ----------
    profile : str, Path or Profile
        Shipped name, path of a TOML file, or a profile already read, which takes ``run`` alone.
    seed : int or None
        Seed of the noise and of the turbulence; the profile's own when None.
    run : int
        The noise draw of the seed.
    estimators : sequence of str or None
        Built-in names, ``module:Class``, ``file:solution.csv`` or ``command:./program {sensors} {solution}``.
        The profile's own when None, but no programs: `load_profile` with ``allow_commands`` lets it.
    sensors : mapping or None
        Units to exchange, for example ``{"imu": "icm-42688-p"}``.

    Returns
    -------
    result : RunResult
        Metrics, errors and solutions by estimator, and what it takes to repeat them.

    Raises
    ------
    bench.errors.ConfigError
        When the profile or an argument is wrong.
    bench.errors.EstimatorError
        When an estimator cannot be built.
    bench.errors.FlightError
        When the aircraft cannot be loaded, trimmed or flown.
    """
    if isinstance(profile, Profile):
        if (seed, estimators, sensors) != (None, None, None):
            raise ConfigError("bench.run: a profile already read takes no seed, estimators or sensors")
    else:
        overrides = {f"sensors.{kind}": name for kind, name in (sensors or {}).items()}
        profile = load_profile(str(profile), overrides, seed, estimators)
    if run != int(run) or run < 0:
        raise ConfigError(f"bench.run: run = {run} must be a whole number, at least 0")
    return pipeline.run(profile, int(run)).result


def fly(profile: str | Path | Profile) -> Trajectory:
    """Return the truth of a profile; it is flown once and cached."""
    return pipeline.fly(_read(profile))


def sense(profile: str | Path | Profile, truth: Trajectory, run: int = 0) -> Sensed:
    """Return what the sensors of a profile report on a truth, in one noise draw."""
    return pipeline.sense(_read(profile), truth, run)


def navigate(
    use: str, data: SensorData, initial: InitialState, options: Mapping[str, Any] | None = None
) -> NavSolution:
    """Return the solution of an estimator, a built-in name or ``module:Class``."""
    return pipeline.navigate(EstimatorChoice(use, use, dict(options or {})), data, initial)


def judge(
    profile: str | Path | Profile, truth: Trajectory, solution: NavSolution
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors of a solution and its metrics."""
    return pipeline.judge(_read(profile), truth, solution)


def measure_allan(
    unit: str | None = None,
    *,
    log: str | Path | None = None,
    seed: int = 1,
    picture: str | Path | None = None,
) -> AllanResult:
    """Measure the Allan deviation of an IMU and compare it with its datasheet.

    Parameters
    ----------
    unit : str or None
        Name in the catalog or path of a datasheet: its model is measured, or a log is compared with it.
    log : str, Path or None
        CSV of a unit at rest, as `bench.exchange.resting_log.read_resting_log` takes it.
    seed : int
        Of the noise of the model.
    picture : str, Path or None
        Drawn there, a .png, .svg or .pdf.

    Returns
    -------
    measured : AllanResult
        ``curves``: averaging times [s], Allan deviations [rad/s; m/s^2] with their 99.9 % bands, and those of
        each term of the datasheet.

    Raises
    ------
    bench.errors.ConfigError
        If the unit or the log is missing or wrong.
    """
    from bench import report
    from bench.config.datasheets import read_imu
    from bench.config.library import sensor_file
    from bench.evaluation import noise_curves
    from bench.exchange.resting_log import read_resting_log

    if picture is not None:
        report.check_picture(Path(picture))
    spec = None if unit is None else read_imu(*sensor_file("imu", unit, Path()))
    if log is not None:
        curves = noise_curves.record_curves(*read_resting_log(Path(log)), spec)
        name = Path(log).stem + (f" and {spec.name}" if spec else "")
    elif spec is not None:
        curves = noise_curves.model_curves(spec, seed)
        name = spec.name
    else:
        raise ConfigError("measure_allan needs a unit of the catalog or a log")
    if not curves:
        raise ConfigError(f"{name}: it has no random error to measure")
    measured = noise_curves.AllanResult(name, tuple(curves), spec, simulated=log is None)
    if picture is not None:
        report.draw_allan(Path(picture), measured)
    return measured


def solve_rinex(
    observations: str | Path,
    navigation: str | Path | Sequence[str | Path],
    *,
    systems: Systems = "both",
    ionosphere: Ionosphere = "klobuchar",
    troposphere: Troposphere = "saastamoinen",
    mask_deg: float = 10.0,
    without: Sequence[str] = (),
) -> RinexFixes:
    """Solve the observations of a GNSS receiver for its fixes, epoch by epoch.

    Parameters
    ----------
    observations : str or Path
        RINEX 2 or 3 observation file.
    navigation : str, Path or a sequence of them
        RINEX 2 or 3 navigation files.
    systems : str
        "gps", "glonass", "both", or "auto": the least PDOP times standard deviation at every epoch.
    ionosphere : str
        "klobuchar": the broadcast model on the first carrier; "free": the combination of two carriers.
    troposphere : str
        Model of the vertical delay: "saastamoinen" or "b-10".
    mask_deg : float
        Lowest elevation used [deg].
    without : sequence of str
        Corrections to leave out, of `bench.signals.receiver.CORRECTIONS`.

    Returns
    -------
    solved : RinexFixes
        ``fixes`` of the antenna [rad, rad, m; m/s, n], ``figures()`` of their errors, ``write_csv(path)``.

    Raises
    ------
    bench.errors.ConfigError
        If a file is wrong, or the ephemerides do not serve the observations.
    """
    from bench.exchange import rinex_fixes
    from bench.signals import delays, receiver

    _one_of("systems", [systems], get_args(receiver.Systems))
    _one_of("ionosphere", [ionosphere], get_args(receiver.Ionosphere))
    _one_of("troposphere", [troposphere], get_args(delays.Troposphere))
    _one_of("without", without, receiver.CORRECTIONS)
    files = [navigation] if isinstance(navigation, str | Path) else navigation
    processing = receiver.Processing(
        systems=systems,
        ionosphere=ionosphere,
        troposphere=troposphere,
        mask=radians(mask_deg),
        without=frozenset(without),
    )
    return rinex_fixes.solve_rinex(Path(observations), [Path(file) for file in files], processing)


def _one_of(name: str, values: Sequence[str], known: Sequence[str]) -> None:
    """Raise ConfigError if a value is none of those there are."""
    for value in values:
        if value not in known:
            raise ConfigError(f"{name} = {value!r} must be one of {', '.join(known)}")


def _read(profile: str | Path | Profile) -> Profile:
    return profile if isinstance(profile, Profile) else load_profile(str(profile))
