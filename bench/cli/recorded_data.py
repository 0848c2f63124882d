"""The verbs of recorded data, results and other tools: navigate, show, fixes, allan, export, score..."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bench.cli import completion
from bench.cli.group import (
    FILE,
    commands,
    end_run,
    estimator_option,
    force_option,
    json_option,
    new_console,
    out_option,
    parse_durations,
    rates_option,
    results_options,
    set_option,
    strict_option,
    table_option,
)
from bench.core.words.exceptions import DONE, NEGATIVE, ConfigError


class _LogCommand(click.Command):
    """Names the verb for RINEX files if their options are given."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if any(arg.partition("=")[0] in ("--observations", "--navigation") for arg in args):
            raise ConfigError(
                "bench navigate takes a LOG.toml; for RINEX files use: bench fixes OBSERVATIONS NAVIGATION..."
            )
        return super().parse_args(ctx, args)


@commands.command(cls=_LogCommand)
@click.argument("log", metavar="LOG.toml|FILE")
@estimator_option("run only this filter: one of the file, built in")
@click.option(
    "--outages",
    callback=lambda ctx, param, given: (
        None if given is None else parse_durations(ctx, param, "" if given == "none" else given)
    ),
    metavar="S,S,...|none",
    help="simulate GNSS outages of these lengths and measure the drift  [default: 10,30,60 "
    "if the recording is long enough; none if there is a reference]",
)
@click.option(
    "--places",
    type=click.IntRange(2, 1000),
    default=10,
    metavar="N",
    help="number of simulated outages of each length",
)
@click.option(
    "--tune-noise",
    is_flag=True,
    help="assume the IMU noise measured at rest, if larger than in the datasheet",
)
@click.option(
    "--motion-noise",
    is_flag=True,
    help="assume the IMU noise measured in motion, if larger than in the datasheet",
)
@click.option(
    "--apply",
    is_flag=True,
    help="change LOG.toml as the checks advise: clocks, axes, signs, units, lever arm",
)
@rates_option
@results_options("log")
@set_option
@out_option("folder for the results  [default: runs/<log>]")
@json_option("the figures")
@table_option
@strict_option
def navigate(log: str, as_json: bool, strict: bool, **options: Any) -> int:
    """Run filters on a recorded flight.

    FILE is a recording: its LOG.toml is written beside it first, as bench new log does.
    LOG.toml names the files of an IMU, a GNSS receiver and a barometer, how they were
    mounted, and the datasheets the filters assume (bench guide own-log). Suspicious
    data is reported first. Every fifth fix is withheld from the filters to evaluate them;
    --outages cuts out GNSS at several places and evaluates the drift by the fixes there,
    or by the [reference] of the log. The log of an autopilot has its own estimate, too:
    -e autopilot, or -e autopilot:1 for its second instance.
    Writes a results folder as bench run does, without truth.

    \b
    Example:
      bench navigate drive.toml -e loose-15 --outages 10,30,60
      bench navigate flight.bin -e autopilot -e loose-full
    """
    from bench.cli.verbs.record_verbs import navigate_log
    from bench.io.results import to_json

    summary = navigate_log(log, console=new_console(stderr=as_json), **options)
    if as_json:
        click.echo(to_json(summary), nl=False)
    return end_run(summary["metrics"], strict=strict)


@commands.command()
@click.argument("folder", required=False, type=FILE, metavar="[DIR]")
def show(folder: Path | None) -> int:
    """Print all metrics of a result.

    DIR is the folder of a run, a log, a campaign or a study; default the newest run
    below ./runs.
    """
    from bench.cli.verbs.show_verb import show_results

    show_results(folder, console=new_console())
    return DONE


@commands.command()
@click.argument("unit", required=False, metavar="[UNIT]", shell_complete=completion.imu)
@click.option("--log", type=FILE, metavar="FILE", help="measure a log of an IMU at rest")
@out_option("the picture, .png, .svg or .pdf  [default: allan-<unit>.png]", "FILE")
@click.option(
    "--sheet",
    type=FILE,
    metavar="FILE",
    help="write the datasheet fitted to the log  [default without UNIT: unit-<log>.toml]",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, metavar="N", help="seed of the noise")
@click.option(
    "--gravity",
    type=click.FloatRange(9.7, 9.9),
    metavar="M_S2",
    help="gravity where a log with several poses was recorded  [default: 9.80665]",
)
@rates_option
@force_option("picture and datasheet")
def allan(unit: str | None, log: Path | None, **options: Any) -> int:
    """Measure the Allan deviation of an IMU.

    UNIT is an IMU of the catalog (bench list sensors) or a datasheet of your own, .toml. Its
    model is simulated at rest: averaging times below 8 s at 200 Hz, longer ones for
    18 h at 1 Hz. Each value is compared with the analytic curve of all terms.
    With --log a log is measured and, if UNIT is given, compared with the datasheet. Without UNIT
    white noise N, bias instability B and random walk K are fitted with 95 % intervals and
    written as a datasheet for bench run --set sensors.imu=FILE.

    FILE is a table (.csv, .parquet, .mat) of an IMU at rest, one row per sample. The columns are
    t_s, gyro_x_rad_s (or deg_s, deg_h), gyro_y_..., gyro_z_..., accel_x_m_s2 (or g, mg) and so on.
    One of the two triads may be missing. The effect of temperature_degc on the noise is removed.
    FILE may also be a recording, or the .toml of a log, in any format that bench navigate reads.

    If the IMU rests for 5 s in each of six poses, 20 deg apart, bench also fits biases and scale factors
    of the accelerometers; with nine poses, some tilted, also misalignments and the gyros. The noise is
    fitted to the longest part of a rest without missing samples; 1024 samples are needed.

    \b
    Examples:
      bench allan stim300
      bench allan --log desk.csv
      bench allan icm-42688-p --log desk.csv -o desk.png
    """
    if unit is None and log is None:
        raise click.UsageError("give a UNIT of the catalog or --log FILE")
    if unit is not None and log is None and Path(unit).suffix in (".csv", ".parquet", ".mat"):
        raise click.UsageError(f"{unit} is a log: bench allan --log {unit}")
    from bench.cli.verbs.record_verbs import measure_allan

    return DONE if measure_allan(unit, log, console=new_console(), **options) else NEGATIVE


@commands.command()
@click.argument("unit", metavar="UNIT", shell_complete=completion.imu)
@click.option("--to", metavar="NAME", help="program to write parameters for")
@click.option("--from", "source", metavar="NAME", help="program whose file UNIT is; writes a datasheet")
@click.option("--rate", type=float, metavar="HZ", help="rate of the samples, if the parameters depend on it")
@click.option(
    "--bias-as-walk", is_flag=True, help="add the short-term walk of the bias instability B to K; leave out B"
)
@out_option("write the parameters into a file", "FILE")
@force_option("file")
def convert(unit: str, **options: Any) -> int:
    """Convert IMU noise for another program.

    UNIT is an IMU of the catalog or a datasheet, .toml; NAME is kalibr, openvins, vins, gtsam,
    matlab, ros, kf-gins, navego or gnss-ins-sim. The errors of the datasheet that the program
    does not have are listed. For px4, ardupilot and robot_localization no conversion exists:
    their defaults are printed beside the noise of the IMU, which is a lower bound.

    \b
    Examples:
      bench convert stim300 --to kalibr --rate 200
      bench convert unit-desk.toml --to kf-gins
      bench convert imu.yaml --from kalibr -o mine.toml
    """
    if (options["to"] is None) == (options["source"] is None):
        raise click.UsageError("give one of --to NAME and --from NAME")
    from bench.cli.verbs.record_verbs import convert_unit

    convert_unit(unit, console=new_console(), **options)
    return DONE


@commands.command()
@click.argument("folder", type=FILE, metavar="RUN")
@click.option("--to", "kind", required=True, metavar="FORMAT", help="csv, kf-gins ...; bench list exports")
@out_option("folder for the files  [default: RUN-FORMAT beside RUN]")
@click.option(
    "--with",
    "include",
    multiple=True,
    metavar="NAME",
    help="truth or solution:NAME, besides the sensors; repeat for more",
)
@click.option(
    "--like", type=FILE, metavar="FILE", help="ulog: a log of your own firmware, for the message definitions"
)
@force_option("export")
def export(folder: Path, **options: Any) -> int:
    """Write sensor data in the format of another tool.

    RUN is a results folder, FORMAT one of bench list exports. Truth and
    solutions are exported only if named.

    \b
    Examples:
      bench export runs/figure-eight-20260101 --to kf-gins
      bench export runs/figure-eight-20260101 --to tum --with truth --with solution:loose-15
      bench export runs/figure-eight-20260101 --to ulog --like own.ulg

    \b
    Writes to DIR the files of the format and a README.md that describes their
    columns, units, frames and row counts.
    """
    from bench.cli.verbs.record_verbs import export_run

    export_run(folder, console=new_console(), **options)
    return DONE


@commands.command()
@click.argument("solution", type=FILE)
@click.argument("folder", type=FILE, metavar="RUN")
@click.option("--label", metavar="NAME", help="label of the solution  [default: the name of its file]")
@click.option(
    "--t0", "t_0", type=float, metavar="S", help="time of the file at the start of the run  [default: found]"
)
@click.option(
    "--max-gap",
    "longest",
    type=click.FloatRange(min=0),
    metavar="S",
    help="longest interval between rows that is interpolated  [default: twice the median, at most 2 s]",
)
@click.option(
    "--align",
    type=click.Choice(["se3", "yaw", "none"]),
    help="fit its positions to the positions of the run",
)
@click.option("--frame", metavar="AXES", help="axes of local positions and of the body, such as ned-frd")
@click.option("--origin", metavar="LAT,LON,H", help="place of a local frame [deg, deg, m]; ,HEADING [deg]")
@out_option("write the results folder with the solution added, without the recording")
@json_option("its metrics")
@force_option()
@strict_option
def score(
    solution: Path, folder: Path, as_json: bool, strict: bool, origin: str | None, **options: Any
) -> int:
    """Evaluate the solution of another program.

    RUN is a results folder, SOLUTION a file with the motion of the IMU at its own times:
    RTKLIB .pos, NMEA, SBET, poses of TUM, EuRoC and KITTI, .nav of KF-GINS, or a table
    (.csv, .parquet, .mat). Column names of a table give quantity, frame and unit;
    time and one of position, velocity, attitude are required:

    \b
      t_s                                     since the start of the run
      lat_deg, lon_deg, alt_m                 or ecef_x_m, ecef_y_m, ecef_z_m
      vel_n_mps, vel_e_mps, vel_d_mps         or ecef_vel_x_mps, ...
      roll_deg, pitch_deg, heading_deg        or q_nb_w, _x, _y, _z, or q_eb_w, ...
      sd_pos_n_m, sd_vel_n_mps, sd_phi_n_deg  with _e, _d: optional
      cov_pos_n_pos_n, cov_pos_n_vel_e, ...   instead of sd_: in SI and radians

    Nothing is extrapolated; the fraction of the output times it covers is reported.

    \b
    Examples:
      bench export runs/figure-eight-20260101 --to kf-gins   then run another filter on it
      bench score theirs.tum runs/figure-eight-20260101 --align yaw   without its place
    """
    from bench.cli.verbs.record_verbs import score_solution
    from bench.io.results import to_json

    options["origin"] = None if origin is None else _parse_origin(origin)
    measured = score_solution(solution, folder, console=new_console(stderr=as_json), **options)
    if as_json:
        click.echo(to_json(measured), nl=False)
    return end_run({solution.stem: measured}, strict=strict)


def _parse_origin(text: str) -> tuple[float, ...]:
    """Return the numbers of an option; none if one is not a number."""
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        return ()


@commands.command()
@click.argument("folder", type=FILE, metavar="RUN")
@click.option("--udp", metavar="IP:PORT", help="send each message as a datagram to this address")
@click.option(
    "--tcp", metavar="IP:PORT", help="wait for one connection at this address; port 0: any free port"
)
@click.option(
    "--rate",
    type=float,
    default=1.0,
    metavar="R",
    help="seconds of the run per second; 0 or inf: as fast as possible",
)
@click.option("--allow-remote", is_flag=True, help="permit an address on another machine")
def stream(folder: Path, **options: Any) -> int:
    """Send sensor data in real time.

    RUN is a results folder of bench run. GNSS fixes are NMEA sentences, GGA and RMC;
    IMU and the other instruments are binary frames, little-endian:

    \b
      0xAA 0x55, kind (1 IMU, 2 baro, 3 mag, 4 airspeed, 5 radar, 6 odometer, 7 heading),
      length n, uint32 number,
      n bytes payload: float64 values, then one byte, 1 if valid;
      uint16 CRC-16/CCITT-FALSE of all between 0xAA 0x55 and itself
    \b
      IMU       t, dt [s], dtheta x y z [rad], dvel x y z [m/s]: forward, right, down
      baro      t [s], altitude [m], sd [m]
      mag       t [s], field x y z [T], sd [T]
      others    t [s], value and its sd: airspeed [m/s], radar [m], odometer [m/s], heading [rad]

    A message is sent when it would reach the filter: at its time plus the latency of
    its sensor. Without --allow-remote only addresses of this machine are accepted.

    \b
    Examples:
      bench stream runs/figure-eight-20260101 --udp 127.0.0.1:5600
      bench stream runs/figure-eight-20260101 --tcp 127.0.0.1:5600 --rate 10
    """
    if (options["udp"] is None) == (options["tcp"] is None):
        raise click.UsageError("give one of --udp IP:PORT and --tcp IP:PORT")
    from bench.cli.verbs.record_verbs import stream_run

    stream_run(folder, console=new_console(), **options)
    return DONE
