"""Arguments in, exit status out; no numbers. Nothing heavy is imported before a verb runs."""

from __future__ import annotations

import signal
import sys
import tomllib
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from bench import __version__

if TYPE_CHECKING:
    from rich.console import Console

DONE, NEGATIVE, WRONG, NOT_FLOWN, MACHINE, BUG, INTERRUPTED = 0, 1, 2, 3, 4, 70, 130
"""Exit statuses, as the help of every verb lists them."""

_STATUS = """\b
Exit status: 0 done; 1 a verdict is negative (a limit broken, an estimator
diverged); 2 the command line, a file or the results folder is wrong; 3 the
aircraft could not be loaded, trimmed or flown; 4 the machine failed (disk
full, no viewer); 70 a bug, of bench or of your estimator, with its traceback;
130 interrupted.
"""

_HELP = {"max_content_width": 100}


def _overrides(ctx: click.Context, param: click.Parameter, given: tuple[str, ...]) -> dict[str, Any]:
    """Read KEY=VALUE, the value as in a TOML file; what is not TOML is a text."""
    values: dict[str, Any] = {}
    for item in given:
        key, equals, text = item.partition("=")
        if not equals or not all(key.split(".")):
            raise click.BadParameter(
                f"{item!r} must be KEY=VALUE, for example sensors.imu=stim300", ctx, param
            )
        try:
            values[key] = tomllib.loads(f"value = {text}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError):
            values[key] = text
    return values


def _durations(ctx: click.Context, param: click.Parameter, given: str | None) -> tuple[float, ...]:
    """Read durations in seconds, with commas between."""
    try:
        values = tuple(float(text) for text in given.split(",")) if given else ()
    except ValueError:
        values = (0.0,)
    if not all(0.0 < value <= 3600.0 for value in values):
        raise click.BadParameter(f"{given!r} must be seconds up to 3600, such as 10,30,60", ctx, param)
    return tuple(dict.fromkeys(values))


_set = click.option(
    "--set",
    "overrides",
    callback=_overrides,
    multiple=True,
    metavar="KEY=VALUE",
    help="override one value of the profile; wins over the file",
)
_seed = click.option("--seed", type=click.IntRange(min=0), metavar="N", help="seed of sensors and turbulence")


@click.group(context_settings=_HELP, epilog=_STATUS, invoke_without_command=True)
@click.version_option(__version__)
@click.pass_context
def commands(ctx: click.Context) -> None:
    """Judge INS/GNSS navigation filters on realistic flights.

    \b
    Start here:
      bench run figure-eight      fly, sense, navigate, judge, record
      bench view                  look at the newest result
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


@commands.command(epilog=_STATUS)
@click.argument("profile")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="folder for the results  [default: runs/<profile>-<seed>]",
)
@click.option(
    "-e",
    "--estimator",
    "estimators",
    multiple=True,
    metavar="NAME",
    help="evaluate only this one, of the profile, 'module:Class', 'file:solution.csv' or "
    "'command:./program {sensors} {solution}'; repeat for more",
)
@_set
@_seed
@click.option(
    "--run",
    "draw",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="K",
    help="the K-th noise draw of this seed",
)
@click.option("--view", "then_view", is_flag=True, help="open the recording when done")
@click.option(
    "--json", "as_json", is_flag=True, help="print the metrics as JSON on stdout, the rest on stderr"
)
@click.option("--no-rrd", is_flag=True, help="write no recording")
@click.option("--force", is_flag=True, help="replace an existing results folder")
@click.option(
    "--allow-commands", is_flag=True, help="let the profile start the programs it names (use = 'command:...')"
)
def run(
    profile: str,
    out: Path | None,
    estimators: tuple[str, ...],
    overrides: dict[str, Any],
    seed: int | None,
    draw: int,
    then_view: bool,
    as_json: bool,
    no_rrd: bool,
    force: bool,
    allow_commands: bool,
) -> int:
    """Fly one profile and evaluate every estimator it names.

    PROFILE is a .toml file, or the name of a shipped profile (bench list).

    \b
    Examples:
      bench run figure-eight                   a profile that ships with bench
      bench run figure-eight -e my_lab:Filter  an estimator of your own, my_lab.py here
      bench run figure-eight -e loose-15 -e 'command:./myfilter {sensors} {solution}'
      bench run my_flight.toml -o out/trial-3  a profile of your own
      bench run figure-eight --seed 7 --set sensors.imu=stim300

    \b
    Writes to DIR: result.json (metrics, seeds, versions, the profile as flown),
    truth.parquet, sensors-*.parquet, solution-<estimator>.parquet,
    errors-<estimator>.parquet and flight.rrd (bench view DIR).
    """
    if then_view and no_rrd:
        raise click.UsageError("--view needs the recording that --no-rrd leaves out")
    from bench.store import to_json
    from bench.workbench.run import run as run_profile
    from bench.workbench.view import view as view_folder

    result, folder = run_profile(
        profile,
        console=_console(stderr=as_json),
        out=out,
        estimators=estimators or None,
        overrides=overrides,
        seed=seed,
        draw=draw,
        recording=not no_rrd,
        force=force,
        allow_commands=allow_commands,
    )
    if as_json:
        click.echo(to_json(result.metrics), nl=False)
    if then_view:
        view_folder(folder, web=False, console=_console(stderr=as_json))
    return DONE if all(metrics["converged"] for metrics in result.metrics.values()) else NEGATIVE


@commands.command(epilog=_STATUS)
@click.argument("profile")
@_set
@_seed
def fly(profile: str, overrides: dict[str, Any], seed: int | None) -> int:
    """Fly only the truth of a profile and say what was flown.

    PROFILE is a .toml file, or the name of a shipped profile (bench list). The
    truth is kept in the cache, where bench run finds it. The last line says how
    far an error-free strapdown strays from it.
    """
    from bench.workbench.run import fly as fly_profile

    fly_profile(profile, console=_console(), overrides=overrides, seed=seed)
    return DONE


@commands.command(name="list", epilog=_STATUS)
@click.argument(
    "kind",
    required=False,
    type=click.Choice(["profiles", "aircraft", "sensors", "estimators"]),
    metavar="[KIND]",
)
def list_all(kind: str | None) -> int:
    """List the profiles, aircraft, sensors and estimators there are.

    KIND is one of these words and lists only those; bench list sensors and bench list
    aircraft also say what is known of each, where from, and what no source states.
    """
    from bench.workbench.show import choices

    choices(_console(), kind)
    return DONE


@commands.command(epilog=_STATUS)
@click.argument("kind", type=click.Choice(["estimator"]), metavar="estimator")
@click.argument("name")
def new(kind: str, name: str) -> int:
    """Write a starting point that works, to be changed.

    \b
    estimator NAME writes, in the present folder:
      NAME.py        an INS/GNSS filter in plain NumPy, its class NAME in CamelCase
      test_NAME.py   its test: the contract of the bench, and that it finds its way

    \b
    Example:
      bench new estimator mine && bench run figure-eight -e mine:Mine
    """
    from bench.workbench.new import new_estimator

    new_estimator(name, console=_console())
    return DONE


@commands.command(epilog=_STATUS)
@click.argument("folder", required=False, type=click.Path(path_type=Path), metavar="[DIR]")
@click.option("--web", is_flag=True, help="serve it on 127.0.0.1 for a browser instead")
def view(folder: Path | None, web: bool) -> int:
    """Open the viewer on a results folder.

    DIR is what bench run wrote; the newest one below ./runs when not given.
    """
    from bench.workbench.view import view as view_folder

    view_folder(folder, web=web, console=_console())
    return DONE


@commands.command(epilog=_STATUS)
@click.argument("profiles", nargs=-1, metavar="[PROFILE]...")
@click.option(
    "--baselines",
    type=click.Path(path_type=Path),
    default=Path("tests/baselines"),
    show_default=True,
    metavar="DIR",
    help="folder of the limits, <profile>.json each",
)
@click.option("--runs", type=click.IntRange(min=1), metavar="N", help="noise draws of each profile")
@click.option("--record", is_flag=True, help="write what is measured as the new limits")
def check(profiles: tuple[str, ...], baselines: Path, runs: int | None, record: bool) -> int:
    """Compare the accuracy of profiles with their limits.

    PROFILE names those to check, all that have limits when none is given; with
    --record also a profile that has none yet.
    """
    from bench.workbench.check import check as check_limits
    from bench.workbench.check import record as record_limits

    if record:
        record_limits(baselines, profiles, console=_console(), runs=runs)
        return DONE
    return DONE if check_limits(baselines, profiles, console=_console(), runs=runs) else NEGATIVE


@commands.command(epilog=_STATUS)
@click.argument("log", required=False, metavar="[LOG.toml]")
@click.option(
    "-e",
    "--estimator",
    "estimators",
    multiple=True,
    metavar="NAME",
    help="of a log: use only this one, of the file, built in, 'module:Class', 'file:solution.csv' or "
    "'command:./program {sensors} {solution}'; repeat for more",
)
@click.option(
    "--outages",
    callback=_durations,
    metavar="S,S,...",
    help="of a log: cut GNSS for so many seconds and judge by the fixes that were cut out",
)
@click.option(
    "--places",
    type=click.IntRange(2, 1000),
    default=10,
    show_default=True,
    metavar="N",
    help="of a log: places where each outage is cut",
)
@click.option("--no-rrd", is_flag=True, help="of a log: write no recording")
@click.option("--force", is_flag=True, help="of a log: replace an existing results folder")
@click.option("--allow-commands", is_flag=True, help="of a log: let it start the programs it names")
@click.option(
    "--observations",
    type=click.Path(path_type=Path),
    metavar="FILE.obs",
    help="RINEX 2 or 3 observation file",
)
@click.option(
    "--navigation",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE.nav",
    help="RINEX 2 or 3 navigation file; repeat for more",
)
@click.option(
    "--systems",
    type=click.Choice(["gps", "glonass", "both", "auto"]),
    default="both",
    show_default=True,
    help="satellites to use; auto takes the least PDOP times sd at every epoch",
)
@click.option(
    "--ionosphere",
    type=click.Choice(["klobuchar", "free"]),
    default="klobuchar",
    show_default=True,
    help="broadcast model on the first carrier, or the combination of two",
)
@click.option(
    "--troposphere",
    type=click.Choice(["saastamoinen", "b-10"]),
    default="saastamoinen",
    show_default=True,
    help="vertical delay",
)
@click.option(
    "--mask-deg", type=click.FloatRange(0, 60), default=10.0, show_default=True, help="lowest elevation used"
)
@click.option(
    "--without",
    multiple=True,
    type=click.Choice(["sagnac", "relativity", "group-delay", "troposphere", "ionosphere", "clocks"]),
    help="leave a correction out; clocks: one clock for both systems; repeat for more",
)
@click.option(
    "--datum",
    type=click.Choice(["WGS-84", "PZ-90.11", "SK-42"]),
    default="WGS-84",
    show_default=True,
    help="of the positions in --out",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR|FILE.csv",
    help="folder for the results of a log, or file for the fixes",
)
@click.option(
    "--json", "as_json", is_flag=True, help="print the figures as JSON on stdout, the rest on stderr"
)
@click.pass_context
def navigate(
    ctx: click.Context,
    log: str | None,
    estimators: tuple[str, ...],
    outages: tuple[float, ...],
    places: int,
    no_rrd: bool,
    force: bool,
    allow_commands: bool,
    observations: Path | None,
    navigation: tuple[Path, ...],
    systems: Any,
    ionosphere: Any,
    troposphere: Any,
    mask_deg: float,
    without: tuple[str, ...],
    datum: str,
    out: Path | None,
    as_json: bool,
) -> int:
    """Run estimators on a recording, or solve the observations of a GNSS receiver.

    LOG.toml names the files of an IMU, a GNSS receiver and a barometer, how they were
    mounted, and the datasheets the filters believe (README, "Your own log"). What looks
    wrong in the recording is said first. Every fifth fix is kept from the filters and judges
    them; --outages cuts GNSS at several places and judges the drift by what was cut out.
    Writes the folder of bench run, without truth.

    With --observations and --navigation the RINEX files of a receiver are solved: position
    from the code, velocity from the Doppler where there is one, GPS and GLONASS. Errors are
    against the position in the header of the file.

    \b
    Examples:
      bench navigate drive.toml -e loose-15 --outages 10,30,60
      bench navigate --observations site.rnx --navigation brdc.rnx -o fixes.csv
    """
    from bench.store import to_json

    console = _console(stderr=as_json)
    given = {
        name
        for name in ctx.params
        if ctx.get_parameter_source(name) == click.core.ParameterSource.COMMANDLINE
    }
    if log is not None:
        _refuse(given - {"log", "out", "as_json", *_OF_A_LOG}, "does not go with a LOG.toml")
        from bench.workbench.log import navigate as navigate_log

        summary = navigate_log(
            log,
            console=console,
            estimators=estimators or None,
            durations=outages,
            places=places,
            out=out,
            recording=not no_rrd,
            force=force,
            allow_commands=allow_commands,
        )
        if as_json:
            click.echo(to_json(summary), nl=False)
        return DONE if all(m["converged"] for m in summary["metrics"].values()) else NEGATIVE
    if observations is None or not navigation:
        raise click.UsageError("give a LOG.toml, or --observations and --navigation")
    _refuse(given & _OF_A_LOG, "goes with a LOG.toml only")
    from math import radians

    from bench.signals.receiver import Processing
    from bench.workbench.fixes import navigate as navigate_files

    processing = Processing(
        systems=systems,
        ionosphere=ionosphere,
        troposphere=troposphere,
        mask=radians(mask_deg),
        without=frozenset(without),
    )
    figures = navigate_files(console, observations, navigation, processing, datum, out)
    if as_json:
        click.echo(to_json(figures), nl=False)
    return DONE if figures["fixes"] else NEGATIVE


_OF_A_LOG = frozenset({"estimators", "outages", "places", "no_rrd", "force", "allow_commands"})
"""Options of bench navigate that need a LOG.toml."""


def _refuse(given: set[str], why: str) -> None:
    """Raise UsageError when an option was given that would not be read."""
    if given:
        name = min(given).replace("estimators", "estimator").replace("_", "-")
        raise click.UsageError(f"--{name} {why}")


@commands.command(epilog=_STATUS)
@click.argument("unit", required=False, metavar="[UNIT]")
@click.option(
    "--log", type=click.Path(path_type=Path), metavar="FILE", help="measure this log of a unit at rest"
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="the picture, .png, .svg or .pdf  [default: allan-<unit>.png]",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, metavar="N", help="seed of the noise"
)
def allan(unit: str | None, log: Path | None, out: Path | None, seed: int) -> int:
    """Measure the Allan deviation of an IMU and compare it with its datasheet.

    UNIT is an IMU of the catalog (bench list) or a datasheet of your own, .toml: its
    model is measured at rest, below 8 s at 200 Hz, from there on for 18 h at 1 Hz,
    and each value is held against the analytic curve of all its terms. With --log a
    log is measured; UNIT, when given, is what it is compared with.

    FILE is CSV with a header: t_s, gyro_x_rad_s (or deg_s), gyro_y_..., gyro_z_...,
    accel_x_m_s2 (or g), ...: rates of a unit at rest, a row per sample.

    \b
    Examples:
      bench allan stim300
      bench allan --log desk.csv
      bench allan icm-42688-p --log desk.csv -o desk.png
    """
    if unit is None and log is None:
        raise click.UsageError("give a UNIT of the catalog or --log FILE")
    from bench.workbench.allan import allan_of

    return DONE if allan_of(unit, log, out=out, seed=seed, console=_console()) else NEGATIVE


@commands.command(epilog=_STATUS)
@click.argument("folder", type=click.Path(path_type=Path), metavar="RUN")
@click.option(
    "--to",
    "kind",
    required=True,
    type=click.Choice(
        ["csv", "parquet", "mat", "kf-gins", "navego", "python-ins", "nmea", "kml", "tum", "rosbag2"]
    ),
    help="the format",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="folder for the files  [default: RUN-FORMAT beside RUN]",
)
@click.option(
    "--with",
    "wanted",
    multiple=True,
    metavar="NAME",
    help="truth or solution:NAME, beside the sensors; repeat for more",
)
@click.option("--force", is_flag=True, help="replace an export that is there")
def export(folder: Path, kind: str, out: Path | None, wanted: tuple[str, ...], force: bool) -> int:
    """Write the sensors of a run in the format another tool reads.

    RUN is a results folder of bench run. The truth and the solutions go out only
    when asked for by name.

    \b
    Formats:
      csv, parquet, mat  a table per sensor, columns named by unit; MATLAB
      kf-gins, navego, python-ins  for these filters, with their configuration
      nmea, kml          the fixes as sentences, or on a globe
      tum                poses for evo: --with truth or --with solution:NAME
      rosbag2            a ROS 2 bag (pip install 'ins-gnss-bench[logs]')

    \b
    Examples:
      bench export runs/figure-eight-20260101 --to kf-gins
      bench export runs/figure-eight-20260101 --to tum --with truth --with solution:loose-15

    \b
    Writes to DIR the files of the format and a README.md that says what is in
    them: columns, units, frames, row counts.
    """
    from bench.workbench.export import export as export_run

    export_run(folder, kind, console=_console(), out=out, wanted=wanted, force=force)
    return DONE


@commands.command(epilog=_STATUS)
@click.argument("solution", type=click.Path(path_type=Path))
@click.argument("folder", type=click.Path(path_type=Path), metavar="RUN")
@click.option("--label", metavar="NAME", help="what it is called  [default: the name of its file]")
@click.option(
    "--t0",
    type=float,
    default=0.0,
    show_default=True,
    metavar="S",
    help="time of the file at the start of the run",
)
@click.option(
    "--max-gap",
    type=click.FloatRange(min=0),
    metavar="S",
    help="longest interval between rows that is interpolated  [default: twice the usual one, 2 s at most]",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="write the results folder with the solution added, without the recording",
)
@click.option(
    "--json", "as_json", is_flag=True, help="print its metrics as JSON on stdout, the rest on stderr"
)
@click.option("--force", is_flag=True, help="replace an existing results folder")
def score(
    solution: Path,
    folder: Path,
    label: str | None,
    t0: float,
    max_gap: float | None,
    out: Path | None,
    as_json: bool,
    force: bool,
) -> int:
    """Judge anyone's solution on a run, beside the estimators of the bench.

    RUN is a results folder of bench run, SOLUTION a table (.csv, .parquet, .mat) of
    the motion of the IMU on its own times. Columns are named by quantity, frame and
    unit; besides the time one of position, velocity, attitude is enough:

    \b
      t_s                                     since the start of the run
      lat_deg, lon_deg, alt_m                 or ecef_x_m, ecef_y_m, ecef_z_m
      vel_n_mps, vel_e_mps, vel_d_mps         or ecef_vel_x_mps, ...
      roll_deg, pitch_deg, heading_deg        or q_nb_w, _x, _y, _z, or q_eb_w, ...
      sd_pos_n_m, sd_vel_n_mps, sd_phi_n_deg  with _e, _d: claimed, optional
      cov_pos_n_pos_n, cov_pos_n_vel_e, ...   instead of sd_: in SI and radians

    Nothing is extrapolated; the share of instants it covers is reported.

    \b
    Examples:
      bench export runs/figure-eight-20260101 --to kf-gins   and let another filter run
      bench score theirs.csv runs/figure-eight-20260101 --t0 345618   t = 0 as its README says
    """
    from bench.store import to_json
    from bench.workbench.score import score as score_solution

    measured = score_solution(
        solution,
        folder,
        console=_console(stderr=as_json),
        label=label,
        t_0=t0,
        longest=max_gap,
        out=out,
        force=force,
    )
    if as_json:
        click.echo(to_json(measured), nl=False)
    return DONE if measured["converged"] else NEGATIVE


@commands.command(epilog=_STATUS)
@click.argument("folder", type=click.Path(path_type=Path), metavar="RUN")
@click.option("--udp", metavar="IP:PORT", help="send there, a datagram per message")
@click.option("--tcp", metavar="IP:PORT", help="wait there for one connection; port 0 takes a free one")
@click.option(
    "--rate",
    type=float,
    default=1.0,
    show_default=True,
    metavar="R",
    help="seconds of the run per second; 0 or inf: as fast as it goes",
)
@click.option("--allow-remote", is_flag=True, help="let the messages out to another machine")
def stream(folder: Path, udp: str | None, tcp: str | None, rate: float, allow_remote: bool) -> int:
    """Send the sensors of a run as they would arrive, for a filter in the loop.

    RUN is a results folder of bench run. GNSS fixes are NMEA sentences, GGA and RMC;
    IMU, barometer, magnetometer and airspeed are binary frames, little-endian:

    \b
      0xAA 0x55, kind (1 IMU, 2 baro, 3 mag, 4 airspeed), length n, uint32 number,
      n bytes payload: float64 each, then one byte, 1 when valid;
      uint16 CRC-16/CCITT-FALSE of all between 0xAA 0x55 and itself
    \b
      IMU       t, dt [s], dtheta x y z [rad], dvel x y z [m/s]: forward, right, down
      baro      t [s], altitude [m], sd [m]
      mag       t [s], field x y z [T], sd [T]
      airspeed  t [s], true airspeed [m/s], sd [m/s]

    A message leaves when it would reach the filter: at its time and the latency of
    its sensor. Only addresses of this machine are taken without --allow-remote.

    \b
    Examples:
      bench stream runs/figure-eight-20260101 --udp 127.0.0.1:5600
      bench stream runs/figure-eight-20260101 --tcp 127.0.0.1:5600 --rate 10
    """
    if (udp is None) == (tcp is None):
        raise click.UsageError("give one of --udp IP:PORT and --tcp IP:PORT")
    from bench.workbench.stream import stream as stream_run

    kind, address = ("udp", udp) if udp is not None else ("tcp", str(tcp))
    stream_run(folder, kind, address, console=_console(), rate=rate, remote=allow_remote)
    return DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit status; a bug keeps its traceback.

    Parameters
    ----------
    arguments : sequence of str or None
        What follows ``bench``; the arguments of this process when None.
    """
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        return int(commands.main(arguments, "bench", standalone_mode=False) or DONE)
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx else "bench"
        return _fail(WRONG, f"{error.format_message()} ('{path} --help' says more)")
    except (click.Abort, KeyboardInterrupt):
        return _fail(INTERRUPTED, "interrupted")
    except Exception as error:
        failure = _failure(error)
        if failure is None:
            traceback.print_exc()
            return BUG
        return _fail(*failure)
    finally:
        signal.signal(signal.SIGTERM, before)


def _failure(error: Exception) -> tuple[int, str] | None:
    """Return the exit status and message of a failure that is no bug, None of one that is."""
    from bench.config import ConfigError
    from bench.flight.model import FlightError
    from bench.navigation.estimator import EstimatorError
    from bench.workbench.view import ViewerError

    if isinstance(error, ConfigError | EstimatorError):
        return WRONG, "\nerror: ".join(getattr(error, "messages", None) or [str(error)])
    if isinstance(error, FlightError):
        return NOT_FLOWN, str(error)
    if isinstance(error, ViewerError):
        return MACHINE, str(error)
    if isinstance(error, OSError) and not isinstance(error, FileNotFoundError):
        place = f"{error.filename}: " if error.filename else ""
        return MACHINE, f"{place}{error.strerror or error}"
    return None


def _fail(status: int, message: str) -> int:
    told = "".join(c if c == "\n" or c.isprintable() else "?" for c in message)  # a stranger's file is quoted
    click.echo(f"error: {told}", err=True)
    return status


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _console(*, stderr: bool = False) -> Console:
    from rich.console import Console

    return Console(stderr=stderr, markup=False, highlight=False)


if __name__ == "__main__":
    sys.exit(main())
