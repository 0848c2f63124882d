"""The public Python functions behind the verbs of the command line.

``run`` does four steps in a row. Each step can be called on its own, with any of its inputs replaced:

    profile = bench.read_profile("figure-eight", seed=7)
    truth = bench.fly(profile)
    sensed = bench.sense(profile, truth)
    solution = bench.run_filter("loose-15", sensed.data, sensed.initial)
    errors, metrics = bench.evaluate(profile, truth, solution)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import pipeline
from bench.core.records.data import InitialState, NavSolution, SensorData, Trajectory
from bench.core.records.run_records import ErrorSeries, Sensed
from bench.core.records.run_result import RunResult
from bench.core.records.specs import DEFAULT_GUARD, EstimatorChoice, Guard, Profile
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress
from bench.io.config import read_profile

if TYPE_CHECKING:
    from bench.navigation.open_filters import PieceFilter


def run(
    profile: str | Path | Profile,
    *,
    seed: int | None = None,
    run: int = 0,
    estimators: Sequence[str] | None = None,
    sensors: Mapping[str, str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    bound: bool = False,
    causes: bool | None = None,
    guard: Guard = DEFAULT_GUARD,
    progress: Progress | None = None,
) -> RunResult:
    """Fly a profile, simulate the sensors, run each filter, and evaluate all solutions.

    A filter that raises, or cannot start if another can, has failed: its metrics hold the ``reason`` and the
    ``traceback``, and the others go on.

    Parameters
    ----------
    profile : str, Path or Profile
        Name of a built-in profile, path of a ``.toml`` file, or a loaded profile. A loaded profile cannot be
        combined with arguments that change it.
    seed : int, optional
        Seed of noise and turbulence. Default: the seed of the profile.
    run : int, optional
        Number of the run with this seed. Default: 0.
    estimators : sequence of str, optional
        Filters: built-in names, ``module:Class``, ``file:solution.csv`` or
        ``command:./program {sensors} {solution}``. Default: the built-in filters of the profile;
        `read_profile` with ``allow_code`` permits others.
    sensors : mapping, optional
        Sensors to replace, for example ``{"imu": "icm-42688-p"}``: short for ``{"sensors.imu": ...}``.
    overrides : mapping, optional
        Profile keys to replace, for example ``{"sensors.imu": "stim300"}``.
    bound : bool, optional
        Compare the errors with the best linear filter: ``bound`` in the metrics. Default: no.
    causes : bool, optional
        Find the causes of an inconsistent covariance: ``causes`` and ``why_text`` in the metrics. The filter
        runs a dozen times without one error at a time. Default: built-in filters only. True: all filters,
        which are also tested for wrong conventions (``looks_like``). False: none.
    guard : Guard, optional
        Limits for programs and classes. ``Guard(in_process=True)`` runs a class in this process.
    progress : callable, optional
        Called with the current stage (`bench.core.words.stages.Stage`; its ``str`` is readable).

    Returns
    -------
    RunResult
        ``metrics``, ``errors`` and ``solutions`` by filter, the truth, the sensor data and the events.

    Raises
    ------
    bench.ConfigError, bench.EstimatorError, bench.FlightError
        If the profile or an argument is wrong, a filter cannot be built, or the aircraft cannot be flown.

    Examples
    --------
    >>> import bench
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> result.metrics["loose-15"]["verdict"]
    'overconfident'
    """
    if sensors is not None and not isinstance(sensors, Mapping):
        raise ConfigError(f'bench.run: sensors = {sensors!r} must be a mapping: {{"imu": "stim300"}}')
    if isinstance(profile, Profile):
        given = {"seed": seed, "estimators": estimators, "sensors": sensors, "overrides": overrides}
        if any(value is not None for value in given.values()) or guard != DEFAULT_GUARD:
            raise ConfigError(
                f"bench.run: {', '.join(given)} and guard cannot be combined with a loaded profile; "
                "pass them to bench.read_profile"
            )
    else:
        changes = {**(overrides or {}), **{f"sensors.{kind}": name for kind, name in (sensors or {}).items()}}
        profile = read_profile(profile, changes, seed, estimators, guard=guard)
    if not isinstance(run, int | np.integer) or run < 0:
        raise ConfigError(f"bench.run: run = {run!r} must be a whole number, at least 0")
    return pipeline.run(profile, int(run), bound=bound, causes=causes, progress=progress)


def fly(
    profile: str | Path | Profile, *, seed: int | None = None, overrides: Mapping[str, Any] | None = None
) -> Trajectory:
    """Fly a profile and return the true trajectory. Reuses the cache if the flight is unchanged.

    Parameters
    ----------
    profile : str, Path or Profile
        Name of a built-in profile, path of a ``.toml`` file, or a loaded profile.
    seed : int, optional
        Seed of the turbulence. Default: the seed of the profile.
    overrides : mapping, optional
        Profile keys to replace.

    Returns
    -------
    Trajectory
        Motion of the IMU at the N times ``t`` [s]: ``lla`` (N, 3) [rad, rad, m], ``vel_n`` (N, 3) [m/s],
        ``q_nb`` (N, 4), and the increments that an error-free IMU measures.

    Raises
    ------
    bench.ConfigError, bench.FlightError
        If the profile is wrong, or the aircraft cannot be loaded, trimmed or flown.

    Examples
    --------
    >>> import bench
    >>> bench.fly("approach").lla.shape[1]
    3
    """
    return pipeline.fly(_read_profile(profile, seed, overrides))


def sense(
    profile: str | Path | Profile,
    truth: Trajectory,
    run: int = 0,
    *,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Sensed:
    """Simulate the sensors of a profile along a true trajectory, with the noise of one run.

    Parameters
    ----------
    profile : str, Path or Profile
        Name of a built-in profile, path of a ``.toml`` file, or a loaded profile.
    truth : Trajectory
        True trajectory, from `fly`.
    run : int, optional
        Number of the run. Default: 0.
    seed : int, optional
        Seed of the noise. Default: the seed of the profile.
    overrides : mapping, optional
        Profile keys to replace.

    Returns
    -------
    Sensed
        ``data`` and ``initial`` for the filters, and the true sensor errors, which no filter gets.

    Raises
    ------
    bench.ConfigError
        If the profile is wrong.

    Examples
    --------
    >>> import bench
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> sensed.data.imu.dvel_b.shape[1]
    3
    """
    return pipeline.sense(_read_profile(profile, seed, overrides), truth, run)


def run_filter(
    use: str,
    data: SensorData,
    initial: InitialState,
    options: Mapping[str, Any] | None = None,
    guard: Guard = DEFAULT_GUARD,
) -> NavSolution:
    """Run one filter on sensor data and return its navigation solution.

    Parameters
    ----------
    use : str
        Name of a built-in filter, such as ``"loose-15"`` (see `list_estimators`), or ``"module:Class"``.
    data : SensorData
        Measurements, assumed datasheets and output times, such as ``bench.sense(...).data``.
    initial : InitialState
        Initial position, velocity and attitude with their covariance.
    options : mapping, optional
        Options of the filter, for example ``{"covariance_hz": 50.0}``. Default: none.
    guard : Guard, optional
        Limits for ``"module:Class"``. Built-in filters ignore it.

    Returns
    -------
    NavSolution
        Solution at the M times ``data.output_t``: ``lla`` (M, 3) [rad, rad, m], ``vel_n`` (M, 3) [m/s],
        ``q_nb`` (M, 4), ``cov`` (M, 9, 9), and others.

    Raises
    ------
    bench.ConfigError, bench.EstimatorError
        If the name or an option is unknown, or the data lack a sensor the filter needs.
    bench.core.words.exceptions.EstimatorFailedError
        If the filter raises an exception or its process ends.

    See Also
    --------
    run : Fly, simulate, navigate and evaluate in one call.
    open_filter : Update a filter step by step.

    Examples
    --------
    >>> import bench
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> solution = bench.run_filter("loose-15", sensed.data, sensed.initial)
    >>> solution.cov.shape == (len(sensed.data.output_t), 9, 9)
    True
    """
    return pipeline.navigate(EstimatorChoice(use, use, dict(options or {}), guard=guard), data, initial)


def open_filter(
    use: str,
    initial: InitialState,
    options: Mapping[str, Any] | None = None,
    look_back: float = 1.0,
    guard: Guard = DEFAULT_GUARD,
) -> PieceFilter:
    """Return a filter that is updated step by step, for real-time use.

    ``update(piece)`` takes the next piece of sensor data, ``current()`` returns state and covariance at its
    last IMU sample, ``finish()`` returns the rest. The solution equals `run_filter` on the whole record, bit
    for bit, wherever it is cut. Memory does not grow with the length.

    Parameters
    ----------
    use : str
        Name of a built-in filter that runs forward, or ``"module:Class"`` with the method ``in_pieces``.
    initial : InitialState
        Initial state.
    options : mapping, optional
        Options of the filter. Default: none.
    look_back : float, optional
        Longest time from the validity of a measurement to its arrival [s]. Default: 1.
    guard : Guard, optional
        Limits for ``"module:Class"``; the time limit holds for each piece.

    Returns
    -------
    PieceFilter
        The filter, which has taken nothing yet.

    Raises
    ------
    bench.EstimatorError
        If there is no such filter, an option is wrong, or it cannot run in pieces.

    Examples
    --------
    >>> import bench
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> live = bench.open_filter("loose-15", sensed.initial)
    >>> rows = live.update(bench.slice_sensors(sensed.data, float("-inf"), 10.0))
    >>> live.current().lla.shape
    (1, 3)
    """
    from bench.navigation.open_filters import PieceFilter

    given = dict(options or {})
    built = pipeline.build_estimator(EstimatorChoice(use, use, given, guard=guard))
    return PieceFilter(use, given, built, initial, look_back)


def evaluate(
    profile: str | Path | Profile,
    truth: Trajectory,
    solution: NavSolution,
    sensed: Sensed | None = None,
    *,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Compare a solution with the truth and return its errors and metrics.

    Parameters
    ----------
    profile : str, Path or Profile
        Name of a built-in profile, path of a ``.toml`` file, or a loaded profile.
    truth : Trajectory
        True trajectory, from `fly`.
    solution : NavSolution
        Solution to evaluate, from `run_filter` or your own code.
    sensed : Sensed, optional
        Sensor data of the same run. If given, bias errors are evaluated too, and gaps in the IMU data are not
        counted as missing output.
    seed : int, optional
        Seed of noise and turbulence. Default: the seed of the profile.
    overrides : mapping, optional
        Profile keys to replace, for example ``{"sensors.imu": "stim300"}``.

    Returns
    -------
    errors : ErrorSeries
        Estimate minus truth at the M times of the solution: ``pos_n`` (M, 3) [m], ``vel_n`` (M, 3) [m/s],
        ``phi_n`` (M, 3) [rad], ``heading`` (M,) [rad] and ``nees`` (M,).
    metrics : dict of str to float
        Metrics by name; the name ends in the unit. ``bench list metrics`` has all.

    Raises
    ------
    bench.ConfigError
        If the profile is wrong.

    Examples
    --------
    >>> import bench
    >>> truth = bench.fly("approach")
    >>> sensed = bench.sense("approach", truth)
    >>> solution = bench.run_filter("loose-full", sensed.data, sensed.initial)
    >>> errors, metrics = bench.evaluate("approach", truth, solution)
    >>> errors.pos_n.shape == solution.lla.shape
    True
    """
    drawn, data = (None, None) if sensed is None else (sensed.truth, sensed.data)
    return pipeline.measure(_read_profile(profile, seed, overrides), truth, solution, drawn, data)


def _read_profile(
    profile: str | Path | Profile, seed: int | None, overrides: Mapping[str, Any] | None
) -> Profile:
    """Read a profile without checks of its filters, which are not run."""
    if not isinstance(profile, Profile):
        return read_profile(profile, overrides, seed, allow_code=True)
    if seed is not None or overrides is not None:
        raise ConfigError(
            "seed and overrides cannot be combined with a loaded profile; pass them to bench.read_profile"
        )
    return profile
