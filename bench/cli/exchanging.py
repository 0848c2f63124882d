"""The public Python functions that exchange data with other tools: exports, scores, noise parameters..."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.core.files import durable
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress, Stage, ignore
from bench.io import results

if TYPE_CHECKING:
    from bench.core.records.sensor_specs import ImuSpec
    from bench.evaluation.motion.noise_curves import AllanResult
    from bench.evaluation.motion.pose_fit import PoseFit
    from bench.io.foreign.scoring import Score
    from bench.io.parameters import Converted
    from bench.io.streams.streaming import Streamed


_WARMED = 2.0  # change of the temperature between poses that is reported [K]


def measure_allan(
    unit: str | None = None,
    *,
    log: str | Path | None = None,
    seed: int = 1,
    picture: str | Path | None = None,
    sheet: str | Path | None = None,
    gravity: float | None = None,
    force: bool = False,
) -> AllanResult:
    """Compute the Allan deviation of an IMU and compare it with its datasheet.

    Parameters
    ----------
    unit : str, optional
        Catalog name of an IMU, or path of a datasheet. Its model is measured or, with ``log``, compared.
    log : str or Path, optional
        Table of an IMU at rest, or the ``.toml`` of a log (`bench.io.logs.resting_log`). If it rests in six
        poses or more, its scale factors, misalignments and biases are fitted, too, and the noise to the
        longest rest.
    seed : int, optional
        Seed of the noise of the model. Default: 1.
    picture : str or Path, optional
        File to draw the curves into: .png, .svg or .pdf.
    sheet : str or Path, optional
        File, .toml, to write the datasheet into that is fitted to the log.
    gravity : float, optional
        Gravity where the log was recorded [m/s^2]. Default: 9.80665.
    force : bool, optional
        Replace the picture and the datasheet.

    Returns
    -------
    AllanResult
        ``curves``: averaging times [s], Allan deviations [rad/s; m/s^2] with 99.9 % bands, and the curve of
        each term of the datasheet, or of the fit. ``fits``: the parameters fitted to the log. ``poses``:
        errors fitted to its poses.

    Raises
    ------
    bench.ConfigError
        If neither ``unit`` nor ``log`` is given, a file is wrong, there is no random error to measure, or the
        log is too short for a datasheet.

    Examples
    --------
    >>> import bench
    >>> [curve.triad for curve in bench.measure_allan("stim300").curves]
    ['gyro', 'accel']
    """
    from bench.evaluation.motion import noise_curves
    from bench.io.config.datasheets import read_imu
    from bench.io.config.library import find_datasheet
    from bench.views.report import allan_picture

    if picture is not None:
        allan_picture.check_picture(Path(picture), force=force)
    if sheet is not None:
        check_sheet(Path(sheet), force=force)
        if log is None:
            raise ConfigError(f"{sheet}: a datasheet is fitted to a log; name it with --log")
    if gravity is not None and log is None:
        raise ConfigError("--gravity is for a log with several poses: add --log FILE, or leave it out")
    spec = None if unit is None else read_imu(*find_datasheet("imu", unit, Path()))
    if log is not None:
        measured = _measure_log(Path(log), spec, gravity)
    elif spec is not None:
        curves = noise_curves.measure_model(spec, seed)
        measured = noise_curves.AllanResult(spec.name, tuple(curves), spec, simulated=True)
    else:
        raise ConfigError("measure_allan needs an IMU of the catalog or a log")
    if not measured.curves:
        raise ConfigError(f"{measured.name}: has no random error to measure")
    if sheet is not None:
        write_sheet(Path(sheet), measured)
    if picture is not None:
        allan_picture.draw_allan(Path(picture), measured)
    return measured


def check_sheet(path: Path, *, force: bool) -> None:
    """Raise ConfigError if a datasheet cannot be written under a path. With ``force`` it may be replaced."""
    if path.suffix != ".toml":
        raise ConfigError(f"{path}: must end in .toml")
    results.check_file(path, force=force)


def write_sheet(path: Path, measured: AllanResult) -> None:
    """Write the datasheet that is fitted to a log; ConfigError if there is no fit."""
    from bench.evaluation.motion.noise_fit import FEWEST
    from bench.io import parameters

    if not measured.fits:
        raise ConfigError(f"{path}: a datasheet needs {FEWEST} samples or more at rest in one pose")
    durable.write(path, parameters.format_measured_sheet(path.stem, measured))


def _measure_log(log: Path, spec: ImuSpec | None, gravity: float | None) -> AllanResult:
    """Measure and fit a log of an IMU at rest, and compare it with a datasheet or the fit."""
    import numpy as np

    from bench.core.mathematics.units import STANDARD_GRAVITY
    from bench.evaluation.motion import noise_curves, noise_fit, pose_fit
    from bench.io import parameters
    from bench.io.logs.resting_log import read_resting_log

    desk = read_resting_log(log)
    rest, fits = max(desk.rests, key=lambda rows: rows.stop - rows.start), []
    t = desk.t[rest]
    interval = float(t[-1] - t[0]) / (len(t) - 1)
    poses: list[PoseFit] = []
    if desk.posed:
        poses = pose_fit.fit_poses(desk.triads, desk.rests, interval, gravity, desk.gaps)
    elif gravity is not None:
        raise ConfigError(f"{log}: rests in one pose, so --gravity has no effect; leave it out")
    triads = {name: rates[rest] for name, rates in desk.triads.items()}
    temperature = None if desk.temperature is None else desk.temperature[rest]
    if len(t) >= noise_fit.FEWEST:
        fits = [noise_fit.fit_triad(name, rates, interval, temperature) for name, rates in triads.items()]
        triads = {
            fit.triad: noise_fit.remove_effects(fit, triads[fit.triad], interval, temperature) for fit in fits
        }
    fitted = spec is None and bool(fits)
    name = log.stem + (f" and {spec.name}" if spec else "")
    spec = parameters.make_measured_spec(log.stem, fits, poses) if fitted else spec
    curves = tuple(noise_curves.measure_record(t, triads, spec))
    length = interval * len(t)
    span = f"{length / 3600.0:.3g} h" if length > 1000.0 else f"{length:.3g} s"
    record = f"{log.name}, {span} at {1.0 / interval:.4g} Hz"
    if len(t) < len(desk.t):
        record += f" (rows {rest.start + 1} to {rest.stop})"
    warmth = 0.0 if desk.temperature is None else float(np.ptp(desk.temperature))
    if poses and warmth > _WARMED:
        also = f"the temperature changed by {warmth:.2g} K, so the biases may have changed; "
        also += "record at one temperature"
        poses[-1] = replace(poses[-1], missing="; ".join(filter(None, [poses[-1].missing, also])))
    if poses:
        record += f", and {poses[-1].count} poses in a gravity of {gravity or STANDARD_GRAVITY:g} m/s^2"
    return noise_curves.AllanResult(name, curves, spec, False, tuple(fits), fitted, record, tuple(poses))


def convert_unit(
    unit: str | Path,
    *,
    to: str | None = None,
    source: str | None = None,
    rate: float | None = None,
    bias_as_walk: bool = False,
    out: str | Path | None = None,
    force: bool = False,
) -> Converted:
    """Convert the figures of an IMU into the parameters of another program, or back.

    Parameters
    ----------
    unit : str or Path
        Catalog name of an IMU or path of a datasheet; with ``source``, a file of that program.
    to : str, optional
        Program: "kalibr", "vins", "gtsam" and others (`bench.io.parameters.PROGRAMS`).
    source : str, optional
        Program that the file is of; the text is then a datasheet. Give one of ``to`` and ``source``.
    rate : float, optional
        Rate of the samples [Hz], which the parameters of some programs depend on.
    bias_as_walk : bool, optional
        Add to the random walk of the bias what the bias instability is at short times. Default: no.
    out : str or Path, optional
        File to write.
    force : bool, optional
        Replace the file.

    Returns
    -------
    Converted
        ``text`` of the file, and the errors that are ``lost``.

    Raises
    ------
    bench.ConfigError
        If the program is unknown or has no conversion, a rate is missing, or a file is wrong.

    Examples
    --------
    >>> import bench
    >>> print(bench.convert_unit("stim300", to="kf-gins").text.splitlines()[2])
      arw: [0.15, 0.15, 0.15]  # deg/sqrt(h)
    """
    from bench.io import parameters
    from bench.io.config.datasheets import read_imu
    from bench.io.config.library import find_datasheet

    if (to is None) == (source is None):
        raise ConfigError("convert_unit needs one of to and source")
    if rate is not None and not 0 < rate < 1e6:
        raise ConfigError(f"rate = {rate:g} Hz must be above 0 and below 1e6 Hz")
    if out is not None:
        results.check_file(Path(out), force=force)
    if source is not None:
        path = Path(unit)
        spec = parameters.read_parameters(path, source, rate)
        text = parameters.format_sheet(spec, path.stem, f"{path.name}, parameters of {source}")
        converted = parameters.Converted(source, text, parameters.list_missing(spec, source))
    else:
        spec = read_imu(*find_datasheet("imu", str(unit), Path()))
        converted = parameters.write_parameters(spec, str(to), rate, bias_as_walk=bias_as_walk)
    if out is not None:
        durable.write(Path(out), converted.text)
    return converted


def export_run(
    folder: str | Path,
    kind: str,
    *,
    out: str | Path | None = None,
    include: Sequence[str] = (),
    like: str | Path | None = None,
    force: bool = False,
) -> Path:
    """Export the sensor data of a run in the format of another tool.

    Parameters
    ----------
    folder : str or Path
        Results folder.
    kind : str
        Format: "csv", "kf-gins", "tum" and others; ``bench list exports`` prints all.
    out : str or Path, optional
        Folder to write. Default: the name of the results folder with the format behind it.
    include : sequence of str, optional
        Additional tracks: "truth", "solution:NAME".
    like : str or Path, optional
        File of the other tool whose definitions are used; "ulog" requires a log of your own firmware.
    force : bool, optional
        Replace an existing export.

    Returns
    -------
    Path
        Folder with the files.

    Raises
    ------
    bench.ConfigError
        If the format is unknown, ``like`` is missing or not used, or ``out`` cannot be replaced.

    Examples
    --------
    >>> import bench, tempfile
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = bench.write_result(result, place + "/a", recording=False, report=False)
    ...     written = bench.export_run(folder, "csv")
    ...     (written / "imu.csv").is_file()
    True
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
    progress: Progress | None = None,
) -> Streamed:
    """Send the sensor data of a run to a socket, each measurement at the time of its arrival.

    Parameters
    ----------
    folder : str or Path
        Results folder.
    udp : str, optional
        Address ``IP:PORT``; each message is one datagram.
    tcp : str, optional
        Address ``IP:PORT`` at which one connection is awaited; port 0 takes any free port. Give one of
        ``udp`` and ``tcp``.
    rate : float, optional
        Seconds of the run per second; infinity sends as fast as possible. Default: 1.
    allow_remote : bool, optional
        Permit addresses of other machines. Default: no.
    progress : callable, optional
        Called with a `Stage`, whose text is the address.

    Returns
    -------
    Streamed
        ``messages``, ``seconds``, and the largest delay ``latest`` [s].

    Raises
    ------
    bench.ConfigError
        If an argument is wrong.
    OSError
        If the address cannot be used.

    Examples
    --------
    >>> import bench, tempfile
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = bench.write_result(result, place + "/a", recording=False, report=False)
    ...     sent = bench.stream_run(folder, udp="127.0.0.1:9", rate=float("inf"))
    >>> sent.messages > 1000
    True
    """
    from bench.io import exports
    from bench.io.streams import streaming

    if (udp is None) == (tcp is None):
        raise ConfigError("stream_run needs one of udp and tcp")
    kind, address = ("udp", udp) if udp is not None else ("tcp", str(tcp))
    run = exports.gather(Path(folder))
    show = progress or ignore
    return streaming.stream(
        run, kind, address, rate=rate, remote=allow_remote, say=lambda text: show(Stage(text))
    )


def score_solution(
    solution: str | Path,
    folder: str | Path,
    *,
    label: str | None = None,
    t_0: float | None = None,
    longest: float | None = None,
    align: str | None = None,
    frame: str | None = None,
    origin: Sequence[float] | None = None,
    out: str | Path | None = None,
    force: bool = False,
) -> Score:
    """Evaluate the solution of any program on a run.

    Parameters
    ----------
    solution : str or Path
        File with the motion of the IMU at its own times (`bench.io.foreign.solutions`).
    folder : str or Path
        Results folder.
    label : str, optional
        Label of the solution. Default: the name of the file.
    t_0 : float, optional
        Time in the file at the start of the run [s]. Default: by the clocks that the file may have.
    longest : float, optional
        Longest interval between rows that is interpolated [s]. Default: twice the median, at most 2 s.
    align : str, optional
        Alignment with the positions of the run: ``"se3"``, ``"yaw"`` or ``"none"``. Default: yaw
        if the positions are in a local frame without an origin, else none.
    frame : str, optional
        Axes of local positions and of the body, such as ``"ned-frd"``. Default: the axes of the format.
    origin : sequence of float, optional
        Latitude, longitude [deg], height [m] of a local frame, and its heading [deg], 0 by default.
    out : str or Path, optional
        Folder for a copy of the results with the solution added, without the recording.
    force : bool, optional
        Replace an existing results folder.

    Returns
    -------
    Score
        ``metrics`` by name, ``errors`` (`ErrorSeries`), ``solution`` and ``coverage``.

    Raises
    ------
    bench.ConfigError
        If a file or folder is missing or wrong.

    Examples
    --------
    >>> import bench, tempfile
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = bench.write_result(result, place + "/a", recording=False, report=False)
    ...     written = bench.export_run(folder, "csv", include=["solution:loose-15"])
    ...     score = bench.score_solution(written / "solution-loose-15.csv", folder)
    >>> round(score.metrics["pos_rmse_h_m"] / result.metrics["loose-15"]["pos_rmse_h_m"], 4)
    1.0
    """
    from bench.io.foreign import scoring

    folder = Path(folder)
    if out is not None:
        results.check_folder(Path(out), force=force)
    how = scoring.Matching(t_0, longest, align, frame, None if origin is None else tuple(origin))
    score = scoring.score(Path(solution), folder, label, how)
    if out is not None:
        with results.make_folder(Path(out), force=force) as partial:
            results.copy_results(folder, partial)
            results.add_solution(partial, score.label, score.solution, score.errors, score.metrics)
    return score
