"""The public Python functions that exchange data with other tools: exports, streams, scores, Allan curves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.core.words.exceptions import ConfigError
from bench.io import results
from bench.io.config.listing import CatalogEntry

if TYPE_CHECKING:
    from bench.evaluation.motion.noise_curves import AllanResult
    from bench.io.foreign.scoring import Score
    from bench.io.streams.streaming import Streamed


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
    """Evaluate the solution of any program on a run, like that of a filter of the bench.

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
