"""The verb serve: a client flies, or estimates the position of the aircraft."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.cli import completion
from bench.cli.group import (
    end_flight,
    estimator_option,
    json_option,
    new_console,
    out_option,
    results_options,
    seed_option,
    set_option,
    strict_option,
)
from bench.core.words.exceptions import DONE, NEGATIVE

if TYPE_CHECKING:
    from rich.console import Console

    from bench.core.records.run_result import RunResult

PUBLIC = "bench.plugins.hil.serving"
"""What holds its function in ``bench``."""


@click.command()
@click.argument("profile", shell_complete=completion.profile)
@click.option("--port", type=click.IntRange(0, 65535), help="port; 0: any free port  [default: 5700]")
@click.option("--bind", default="127.0.0.1", metavar="IP", help="address to listen at")
@click.option("--allow-remote", "remote", is_flag=True, help="permit clients of other machines")
@click.option(
    "--give",
    "gives",
    type=click.Choice(["estimate", "commands"]),
    help="what the client sends: an estimate, or steering commands  [default: estimate]",
)
@click.option(
    "--rate",
    type=float,
    default=0.0,
    metavar="R",
    help="largest speed, as a multiple of real time; 0: lock-step without a limit",
)
@click.option("--patience", type=float, default=60.0, metavar="S", help="longest silence of the client")
@click.option(
    "--mavlink",
    is_flag=True,
    help="the client is an autopilot such as PX4 that moves the controls, port 4560",
)
@click.option(
    "--ardupilot", is_flag=True, help="the client is ArduPilot's SITL with its JSON interface, UDP port 9002"
)
@click.option(
    "--channels",
    metavar="LIST",
    help="controls that the autopilot moves  [default: aileron=-6,elevator=-8,rudder=-3,throttle=5; "
    "ArduPilot: aileron=1,elevator=-2,rudder=-4,throttle=3]",
)
@click.option(
    "--undulation",
    type=float,
    default=0.0,
    metavar="M",
    help="height of the geoid above the ellipsoid, for an autopilot's heights above mean sea level",
)
@click.option("--truth", is_flag=True, help="also send the truth to the client: HIL_STATE_QUATERNION")
@out_option("folder for the results  [default: runs/<profile>-<seed>-served]")
@estimator_option("evaluate only this filter: one of the profile")
@set_option
@seed_option
@click.option("--run", "draw", type=click.IntRange(min=0), default=0, metavar="K", help="the K-th run")
@json_option("the metrics")
@results_options("profile")
@strict_option
def serve(
    profile: str,
    port: int | None,
    bind: str,
    gives: str | None,
    mavlink: bool,
    ardupilot: bool,
    channels: str | None,
    as_json: bool,
    strict: bool,
    **options: Any,
) -> int:
    """Fly a profile with an external program.

    The client receives the sensor data as they arrive. In each turn it sends an estimate, which then guides
    the aircraft, or steering commands. The result is written as by bench run. bench guide serve has the
    messages, and clients in Python and C.

    \b
    Examples:
      bench serve approach-closed
      bench serve approach-closed --set guidance.period_s=0.05 --rate 1
      bench serve s-turns --give commands --set duration_s=120
      bench serve s-turns --mavlink --set duration_s=120 --set rate_hz=250
      bench serve s-turns --ardupilot --set duration_s=120 --set rate_hz=400
    """
    if (mavlink or ardupilot) and gives == "estimate":
        raise click.UsageError("an autopilot gives commands: leave --give estimate out")
    if not (mavlink or ardupilot) and (channels is not None or options["undulation"]):
        raise click.UsageError("--channels and --undulation go with --mavlink or --ardupilot")
    from bench.plugins.hil import json_session, mavlink_session
    from bench.plugins.hil.actuator_channels import ARDUPILOT, ActuatorChannels

    session = {key: options.pop(key) for key in ("remote", "rate", "patience", "truth", "undulation")}
    session["gives"] = gives or "estimate"
    if mavlink:
        session["mavlink"] = ActuatorChannels.parse(channels or "")
    if ardupilot:
        session["ardupilot"] = ActuatorChannels.parse(channels or "", ARDUPILOT, json_session.CHANNELS)
    if port is None:
        port = mavlink_session.PORT if mavlink else json_session.PORT if ardupilot else 5700
    session["address"] = f"[{bind}]:{port}" if ":" in bind else f"{bind}:{port}"
    result, ended = _fly(profile, console=new_console(stderr=as_json), session=session, **options)
    if as_json:
        from bench.io.results import to_json

        click.echo(to_json(result.metrics), nl=False)
    return max(end_flight(result, strict=strict), NEGATIVE if ended else DONE)


def _fly(
    name: str,
    *,
    console: Console,
    out: Path | None,
    draw: int,
    recording: bool,
    report: bool,
    force: bool,
    session: Mapping[str, Any],
    overrides: Mapping[str, Any],
    **profile_options: Any,
) -> tuple[RunResult, str]:
    """Fly one profile with a client, as bench run does, and return why the client ended early.

    ``session`` is for `bench.plugins.hil.serving.serve`.
    """
    from bench.cli.verbs import flight_verbs
    from bench.io import results
    from bench.plugins.hil import serving
    from bench.plugins.hil.served import load_served

    flight_verbs.find_own_estimators()
    profile = load_served(name, overrides, **profile_options)
    folder = out or flight_verbs.RUNS / f"{profile.name}-{profile.seed}-served"
    results.check_folder(folder, force=force)
    console.print(
        flight_verbs.describe_run(profile.name, profile.document, profile.seed, draw, profile.evaluation)
    )
    begun = time.perf_counter()
    served = serving.serve(profile, draw, progress=lambda now: console.print(str(now)), **session)
    with flight_verbs.write_first(
        console, served.result, folder, recording=recording, report=report, force=force
    ):
        console.print(f"Flew {served.flown:g} s with the client.")
        if served.latest > 0:
            console.print(f"It was up to {1e3 * served.latest:.1f} ms behind the rate.")
        if served.ended:
            console.print(f"{served.ended[:1].upper()}{served.ended[1:].rstrip('.')}.", style="red")
        flight_verbs.print_result(console, served.result, table=False)
    flight_verbs.print_end(console, folder, begun, table=False)
    return served.result, served.ended
