"""The verbs new and upgrade: a working example, and files of an earlier format rewritten."""

from __future__ import annotations

from pathlib import Path

import click

from bench.cli.group import FILE, commands, new_console, rates_option
from bench.core.words.exceptions import DONE

_KINDS = "estimator", "check", "log", "aircraft", "schemas"


@commands.command()
@click.argument("kind", type=click.Choice(_KINDS), metavar="KIND")
@click.argument("name", required=False)
@rates_option
def new(kind: str, name: str | None, rates: str | None) -> int:
    """Create a filter, a log file, an aircraft or a CI check.

    \b
    estimator NAME writes, in the current folder:
      NAME.py        an INS/GNSS filter in plain NumPy, its class NAME in CamelCase
      test_NAME.py   its test: the requirements of bench, and its accuracy

    \b
    check [ESTIMATOR] flies a filter, loose-15 or one of your own, and writes:
      tests/baselines/short.toml       a flight of two minutes
      tests/baselines/short.json       its accuracy, which bench check compares with
      .github/workflows/accuracy.yml   a CI job that runs bench check

    \b
    log FILE reads a recording and writes FILE.toml beside it for bench navigate, with questions

    \b
    aircraft NAME finds autopilot gains for an aircraft of JSBSim and writes aircraft/jsbsim/NAME.toml;
    aircraft ./FOLDER does it for your own model FOLDER/FOLDER.xml and writes FOLDER/aircraft.toml

    \b
    schemas writes JSON schemas, with which an editor completes keys and marks mistakes:
      schemas/profile.json ...         name one in the first line: #:schema ./schemas/profile.json

    \b
    Examples:
      bench new estimator mine && bench run figure-eight -e mine:Mine
      bench new log drive.csv && bench navigate drive.toml
      bench new aircraft T37
    """
    from bench.cli.new_files.new_example import new_check, new_estimator, new_schemas

    if rates is not None and kind != "log":
        raise click.UsageError(f"--rates is for bench new log, not for bench new {kind}")
    if kind == "schemas":
        if name is not None:
            raise click.UsageError("bench new schemas takes no NAME")
        new_schemas(console=new_console())
    elif kind == "check":
        new_check(name or "loose-15", console=new_console())
    elif name is None:
        raise click.UsageError(f"bench new {kind} needs a {'FILE' if kind == 'log' else 'NAME'}")
    elif kind == "log":
        from bench.cli.new_files.new_log import new_log

        new_log(name, console=new_console(), rates=rates)
    elif kind == "aircraft":
        from bench.cli.new_files.new_aircraft import new_aircraft

        new_aircraft(name, console=new_console())
    else:
        new_estimator(name, console=new_console())
    return DONE


@commands.command()
@click.argument("paths", nargs=-1, required=True, type=FILE, metavar="FILE...")
def upgrade(paths: tuple[Path, ...]) -> int:
    """Rewrite files of an earlier format.

    FILE is a baseline, a card, a results folder or a .toml file. Names that have
    changed are replaced; no value changes.

    \b
    Example:
      bench upgrade tests/baselines/*.json
    """
    from bench.cli.upgrading import upgrade as upgrade_files

    upgrade_files(paths, console=new_console())
    return DONE
