"""The public Python functions behind the verbs of the command line.

``run`` does four steps in a row. Each step can be called on its own, with any of its inputs replaced:

    profile = bench.load_profile("figure-eight", seed=7)
    truth = bench.fly(profile)
    sensed = bench.sense(profile, truth)
    solution = bench.navigate("loose-15", sensed.data, sensed.initial)
    errors, metrics = bench.judge(profile, truth, solution)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import pipeline
from bench.core.records.data import ErrorSeries, InitialState, NavSolution, Sensed, SensorData, Trajectory
from bench.core.records.run_result import RunResult
from bench.core.records.specs import DEFAULT_GUARD, EstimatorChoice, Guard, Profile
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Watcher
from bench.io import results
from bench.io.config import load_profile
from bench.io.config.listing import CatalogEntry

if TYPE_CHECKING:
    from bench.evaluation.motion.noise_curves import AllanResult
    from bench.io.foreign.scoring import Score
    from bench.io.streams.streaming import Streamed
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
    progress: Watcher | None = None,
) -> RunResult:
    """Fly one profile, sense, navigate with every estimator, and judge.

    An estimator that raises, or cannot start where another can, has failed: its metrics hold the ``reason``
    and the ``traceback``, and the others go on.

    Parameters
    ----------
    profile : str, Path or Profile
        Shipped name, path of a TOML file, or a profile already read; with the last, nothing that changes it
        may be given.
    seed : int or None
        Seed of noise and turbulence; None takes that of the profile.
    run : int
        Number of the noise draw of this seed.
    estimators : sequence of str or None
        Built-in names, ``module:Class``, ``file:solution.csv`` or ``command:./program {sensors} {solution}``.
        None takes those of the profile, but no code; `load_profile` with ``allow_code`` permits that.
    sensors : mapping or None
        Sensors to replace, for example ``{"imu": "icm-42688-p"}``: short for ``{"sensors.imu": ...}``.
    overrides : mapping or None
        Dotted keys and values that replace those of the file, as for `load_profile`.
    bound : bool
        Hold the errors against those of the best linear estimator: ``bound`` in the metrics of each.
    causes : bool or None
        Run a filter whose claim is broken again without each fault and each error that it does not model, a
        dozen times, and say which made it so: ``causes`` and ``why_text`` in its metrics. None: only built-in
        ones, True: those of others too. Before, solutions of others are tested for conventions that are
        mistaken (``looks_like``). False: neither.
    guard : Guard
        What a program or a class may take. ``Guard(in_process=True)`` runs a class here, for a debugger.
    progress : callable or None
        Called with what is going on (`bench.core.words.stages.Stage`, whose ``str`` says it), whenever that
        changes.

    Raises
    ------
    bench.ConfigError, bench.EstimatorError, bench.FlightError
        If the profile or an argument is wrong, if an estimator cannot be built, and if the aircraft cannot be
        loaded, trimmed or flown.
    """
    if sensors is not None and not isinstance(sensors, Mapping):
        raise ConfigError(f'bench.run: sensors = {sensors!r} must be a mapping: {{"imu": "stim300"}}')
    if isinstance(profile, Profile):
        given = {"seed": seed, "estimators": estimators, "sensors": sensors, "overrides": overrides}
        if any(value is not None for value in given.values()) or guard != DEFAULT_GUARD:
            raise ConfigError(
                f"bench.run: with a profile already read, {', '.join(given)} and guard change nothing"
            )
    else:
        changes = {**(overrides or {}), **{f"sensors.{kind}": name for kind, name in (sensors or {}).items()}}
        profile = load_profile(profile, changes, seed, estimators, guard=guard)
    if not isinstance(run, int | np.integer) or run < 0:
        raise ConfigError(f"bench.run: run = {run!r} must be a whole number, at least 0")
    return pipeline.run(profile, int(run), bound=bound, causes=causes, progress=progress)


def fly(
    profile: str | Path | Profile, *, seed: int | None = None, overrides: Mapping[str, Any] | None = None
) -> Trajectory:
    """Return the truth of a profile, from the cache if it was flown before.

    Arguments and errors are those of :func:`run`.
    """
    return pipeline.fly(_read_profile(profile, seed, overrides))


def describe_flight(
    profile: str | Path | Profile,
    progress: Callable[[float], None] | None = None,
    *,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Mapping[str, Any]:
    """Fly the truth of a profile into the cache and return its figures.

    These are the legs, the extremes of altitude, speed and attitude, motions that are implausible for the
    aircraft class, and the error of an error-free strapdown against the truth. Names end in their unit, SI
    and radians. Memory does not grow with the length of the flight. Arguments and errors as for :func:`run`.
    """
    return pipeline.fly_over(_read_profile(profile, seed, overrides), progress)


def sense(
    profile: str | Path | Profile,
    truth: Trajectory,
    run: int = 0,
    *,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Sensed:
    """Return the sensor data of a profile for a truth, with one noise draw. Arguments as for :func:`run`."""
    return pipeline.sense(_read_profile(profile, seed, overrides), truth, run)


def navigate(
    use: str,
    data: SensorData,
    initial: InitialState,
    options: Mapping[str, Any] | None = None,
    guard: Guard = DEFAULT_GUARD,
) -> NavSolution:
    """Run an estimator, a built-in name or ``module:Class``, and return its solution.

    Errors as for :func:`run`, and `bench.core.words.exceptions.EstimatorFailedError` if it raises or its
    process ends.
    """
    return pipeline.navigate(EstimatorChoice(use, use, dict(options or {}), guard=guard), data, initial)


def open_filter(
    use: str,
    initial: InitialState,
    options: Mapping[str, Any] | None = None,
    look_back: float = 1.0,
    guard: Guard = DEFAULT_GUARD,
) -> PieceFilter:
    """Return a filter that takes a record in pieces and answers after each.

    ``feed(piece)`` takes the next piece, ``answer()`` gives state and covariance at its last IMU sample,
    ``finish()`` ends. All answers are those of :func:`navigate` on the whole record, bit for bit, wherever it
    is cut. Memory does not grow with the length.

    Parameters
    ----------
    use : str
        A built-in filter that runs forward, or an estimator with `piecewise.RunsInPieces`.
    initial : InitialState
        Start.
    options : mapping or None
        Options of the filter.
    look_back : float
        Longest time from the validity of a measurement to its arrival [s]; final answers wait so long.
    guard : Guard
        As for :func:`run`; its time limit is for each piece.

    Raises
    ------
    bench.EstimatorError
        If there is no such filter, an option is wrong, or it cannot run in pieces.
    """
    from bench.navigation.open_filters import PieceFilter

    given = dict(options or {})
    built = pipeline.build_estimator(EstimatorChoice(use, use, given, guard=guard))
    return PieceFilter(use, given, built, initial, look_back)


def judge(
    profile: str | Path | Profile,
    truth: Trajectory,
    solution: NavSolution,
    sensed: Sensed | None = None,
    *,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors of a solution relative to a truth, and its metrics.

    Those of biases need ``sensed``, the draw of the sensors that `bench.sense` returned; a silence of its IMU
    excuses one of the solution. Other arguments as for :func:`run`.
    """
    drawn, data = (None, None) if sensed is None else (sensed.truth, sensed.data)
    return pipeline.measure(_read_profile(profile, seed, overrides), truth, solution, drawn, data)


def measure_allan(
    unit: str | None = None,
    *,
    log: str | Path | None = None,
    seed: int = 1,
    picture: str | Path | None = None,
    force: bool = False,
) -> AllanResult:
    """Measure the Allan deviation of an IMU and compare it with its datasheet.

    Parameters
    ----------
    unit : str or None
        Catalog name or path of a datasheet. Its model is measured or, with a log, compared with the log.
    log : str, Path or None
        Table of an IMU at rest, as `bench.io.logs.resting_log.read_resting_log` reads it.
    seed : int
        Seed of the noise of the model.
    picture : str, Path or None
        File to draw the curves into, .png, .svg or .pdf.
    force : bool
        Replace the picture if it is there.

    Returns
    -------
    measured : AllanResult
        ``curves``: averaging times [s], Allan deviations [rad/s; m/s^2] with 99.9 % bands, and the curve of
        each term of the datasheet.
    """
    from bench.evaluation.motion import noise_curves
    from bench.io.config.datasheets import read_imu
    from bench.io.config.library import find_datasheet
    from bench.io.logs.resting_log import read_resting_log
    from bench.views.report import allan_picture

    if picture is not None:
        allan_picture.check_picture(Path(picture), force=force)
    spec = None if unit is None else read_imu(*find_datasheet("imu", unit, Path()))
    if log is not None:
        curves = noise_curves.measure_record(*read_resting_log(Path(log)), spec)
        name = Path(log).stem + (f" and {spec.name}" if spec else "")
    elif spec is not None:
        curves = noise_curves.measure_model(spec, seed)
        name = spec.name
    else:
        raise ConfigError("measure_allan needs an IMU of the catalog or a log")
    if not curves:
        raise ConfigError(f"{name}: has no random error to measure")
    measured = noise_curves.AllanResult(name, tuple(curves), spec, simulated=log is None)
    if picture is not None:
        allan_picture.draw_allan(Path(picture), measured)
    return measured


def list_exports() -> list[CatalogEntry]:
    """Return every format that `export_run` writes."""
    from bench.io import exports

    return [CatalogEntry(name, title, "export") for name, title in exports.list_formats().items()]


def export_run(
    folder: str | Path,
    kind: str,
    *,
    out: str | Path | None = None,
    include: Sequence[str] = (),
    like: str | Path | None = None,
    force: bool = False,
) -> Path:
    """Export the sensor data of a run in the format of another tool, and return the folder of the files.

    Parameters
    ----------
    folder : str or Path
        A results folder.
    kind : str
        One of :func:`list_exports`: "csv", "kf-gins", "tum" ...
    out : str, Path or None
        Folder to write; None makes one beside the results folder, with the format in its name.
    include : sequence of str
        Tracks to export besides the sensors: "truth", "solution:NAME".
    like : str, Path or None
        A file of the other tool whose definitions the export takes: for "ulog" a log of one's own firmware.
    force : bool
        Replace an existing export.
    """
    from bench.io import exports

    needs = exports.find_format(kind).needs_like  # all of this is known before the run is read
    if needs is (like is None):
        raise ConfigError(
            f"export to {kind}: name a log of your own firmware, --like OWN.ulg"
            if needs
            else f"export to {kind}: takes no definitions of another file; leave --like out"
        )
    folder = Path(folder)
    # "." and ".." are not usable as a name
    beside = folder.resolve() if folder.name in ("", "..") else folder
    out = Path(out) if out else beside.with_name(f"{folder.resolve().name}-{kind}")
    results.check_folder(out, force=force, kind=results.EXPORT)
    outgoing = exports.gather(folder, tuple(dict.fromkeys(include)))
    outgoing = replace(outgoing, like=None if like is None else Path(like))
    with results.make_folder(out, force=force, kind=results.EXPORT) as partial:
        exports.write(partial, kind, outgoing, folder.resolve().name)
    return out


def stream_run(
    folder: str | Path,
    *,
    udp: str | None = None,
    tcp: str | None = None,
    rate: float = 1.0,
    allow_remote: bool = False,
    say: Callable[[str], object] = lambda text: None,
) -> Streamed:
    """Send the sensor data of a run to a socket at the pace of its arrival, for a filter in the loop.

    Exactly one of ``udp`` and ``tcp`` is an address ``IP:PORT``. UDP sends each message as a datagram to it;
    TCP waits for one connection there, and port 0 takes any free port. The other parameters and the errors
    are those of `bench.io.streams.streaming.stream`.
    """
    from bench.io import exports
    from bench.io.streams import streaming

    if (udp is None) == (tcp is None):
        raise ConfigError("stream_run needs one of udp and tcp")
    kind, address = ("udp", udp) if udp is not None else ("tcp", str(tcp))
    run = exports.gather(Path(folder))
    return streaming.stream(run, kind, address, rate=rate, remote=allow_remote, say=say)


def score_solution(
    solution: str | Path,
    folder: str | Path,
    *,
    label: str | None = None,
    t_0: float = 0.0,
    longest: float | None = None,
    out: str | Path | None = None,
    force: bool = False,
) -> Score:
    """Judge the solution of any program on a run, like that of an estimator of the bench.

    Parameters
    ----------
    solution : str or Path
        Table of the motion of the IMU at its own times, as `bench.io.foreign.solutions` reads it.
    folder : str or Path
        A results folder.
    label : str or None
        Label of the solution; None takes the name of the file.
    t_0 : float
        Time in the file at the start of the run [s].
    longest : float or None
        Longest interval between rows that is interpolated [s]; default twice the median, at most 2 s.
    out : str, Path or None
        Folder for a copy of the results with the solution added, without the recording.
    force : bool
        Replace an existing results folder.
    """
    from bench.io.foreign import scoring

    folder = Path(folder)
    if out is not None:
        results.check_folder(Path(out), force=force)
    score = scoring.score(Path(solution), folder, label, t_0, longest)
    if out is not None:
        with results.make_folder(Path(out), force=force) as partial:
            results.copy_results(folder, partial)
            results.add_solution(partial, score.label, score.solution, score.errors, score.metrics)
    return score


def _read_profile(
    profile: str | Path | Profile, seed: int | None, overrides: Mapping[str, Any] | None
) -> Profile:
    """Read a profile of which no estimator is run."""
    if not isinstance(profile, Profile):
        return load_profile(profile, overrides, seed, allow_code=True)
    if seed is not None or overrides is not None:
        raise ConfigError(
            "with a profile already read, seed and overrides change nothing: give its name or path"
        )
    return profile
