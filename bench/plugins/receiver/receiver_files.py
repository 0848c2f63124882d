"""The verb of the files of a GNSS receiver: fixes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bench.cli.group import (
    FILE,
    FiniteRange,
    force_option,
    json_option,
    new_console,
    out_option,
)
from bench.core.words.exceptions import DONE, NEGATIVE

PUBLIC = "bench.plugins.receiver.receiver_settings"
"""What holds its function in ``bench``."""


@click.command()
@click.argument("files", nargs=-1, required=True, type=FILE, metavar="OBSERVATIONS... NAVIGATION...")
@click.option(
    "--truth",
    metavar="LAT,LON,H|FILE.csv",
    help="true position of the antenna in deg and m (WGS 84), or its track as --out writes it  "
    "[default: the header]",
)
@click.option(
    "--truth-sd",
    "truth_sd_m",
    type=FiniteRange(0, 1000),
    default=0.0,
    metavar="METERS",
    help="how far the truth or the header may be off, sd along each axis, the same at all epochs",
)
@click.option(
    "--systems",
    default="all",
    show_default=True,
    metavar="NAME,...",
    help="gps, glonass, galileo, beidou; both: GPS and GLONASS; auto: at each epoch one or all, those with "
    "the least PDOP times sd",
)
@click.option(
    "--ionosphere",
    type=click.Choice(["klobuchar", "ntcm-g", "free", "none"]),
    default="klobuchar",
    help="broadcast model of GPS or of Galileo on the first carrier, the combination of two, or no delay",
)
@click.option(
    "--troposphere",
    type=click.Choice(["saastamoinen", "unb3m", "b-10"]),
    default="saastamoinen",
    help="vertical delay",
)
@click.option(
    "--mapping",
    type=click.Choice(["do-229", "cosecant"]),
    default="do-229",
    help="slant over vertical delay of the troposphere",
)
@click.option(
    "--pressure-hpa",
    type=FiniteRange(800, 1100),
    default=1013.25,
    help="pressure at sea level, for saastamoinen",
)
@click.option("--temperature-c", type=FiniteRange(-60, 60), default=15.0, help="temperature at sea level")
@click.option("--humidity-pct", type=FiniteRange(0, 100), default=50.0, help="relative humidity at sea level")
@click.option("--mask-deg", type=FiniteRange(0, 60), default=10.0, help="lowest elevation used")
@click.option("--robust", is_flag=True, help="less weight for ranges with large residuals: for cities")
@click.option(
    "--smooth-s",
    type=FiniteRange(0, 600),
    default=0.0,
    metavar="S",
    help="smooth ranges with their carrier phase over S seconds, for data every few seconds; 0: off",
)
@click.option(
    "--without",
    multiple=True,
    type=click.Choice(["sagnac", "relativity", "group-delay", "troposphere", "ionosphere", "clocks"]),
    help="leave a correction out; clocks: one clock for all systems; repeat for more",
)
@click.option(
    "--datum",
    type=click.Choice(["WGS-84", "PZ-90.11", "SK-42"]),
    default="WGS-84",
    help="datum of the positions in --out",
)
@out_option("file for the fixes", "FILE.csv")
@click.option("--report", type=FILE, metavar="FILE.html", help="write a page with the fixes and their errors")
@click.option(
    "--recording",
    type=FILE,
    metavar="FILE.rrd",
    help="write a recording, for bench view FILE.rrd",
)
@force_option("file")
@json_option("the figures")
def fixes(files: tuple[Path, ...], as_json: bool, **options: Any) -> int:
    """Compute GNSS fixes from RINEX files.

    FILES are observations of one receiver and navigation files of the day, in any order: RINEX 2, 3 or 4,
    also packed (.gz, .Z, Compact RINEX), u-blox UBX, SBF, RTCM 3, Android GnssLogger, and SP3 for precise
    orbits. UBX with RXM-SFRBX, SBF and RTCM 3 with ephemerides need no navigation file. The position is
    computed from the code, the velocity from the Doppler if the file contains it. Errors are relative to
    --truth, else to the position in the header.

    \b
    Example:
      bench fixes site.crx.gz brdc.rnx.gz -o fixes.csv
    """
    from bench.plugins.receiver.fixes_verb import solve_fixes

    figures = solve_fixes(files, console=new_console(stderr=as_json), **options)
    if as_json:
        from bench.io.results import to_json

        click.echo(to_json(figures), nl=False)
    return DONE if figures["fixes"] else NEGATIVE
