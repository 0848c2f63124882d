"""The verbs run, fly, list, guide, view, report, record, compare, check, cache and warm."""

from __future__ import annotations

import difflib
import functools
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from bench.cli import completion
from bench.cli.group import (
    FILE,
    FiniteRange,
    code_option,
    commands,
    end_flight,
    estimator_option,
    force_option,
    guard_options,
    jobs_option,
    json_option,
    junit_option,
    make_guard,
    new_console,
    out_option,
    results_options,
    seed_option,
    set_option,
    strict_option,
    table_option,
)
from bench.core.words.exceptions import DONE, NEGATIVE


@commands.command()
@click.argument("profile", shell_complete=completion.profile)
@out_option("folder for the results  [default: runs/<profile>-<seed>]")
@estimator_option("run only this filter: one of the profile")
@set_option
@seed_option
@click.option(
    "--run",
    "draw",
    type=click.IntRange(min=0),
    default=0,
    metavar="K",
    help="number of the run with this seed",
)
@click.option("--bound", is_flag=True, help="compare the errors with the best linear filter")
@click.option(
    "--causes/--no-causes",
    "causes",
    default=None,
    help="find the causes of an inconsistent covariance  [default: of built-in filters]",
)
@click.option("--view", "then_view", is_flag=True, help="open the 3D recording when done")
@click.option("--live", is_flag=True, help="open the viewer during the flight")
@json_option("the metrics")
@table_option
@results_options("profile")
@junit_option
@strict_option
def run(profile: str, then_view: bool, live: bool, as_json: bool, strict: bool, **options: Any) -> int:
    """Fly a profile, run the filters, evaluate them.

    PROFILE is a .toml file, or the name of a shipped profile (bench list).

    \b
    Examples:
      bench run figure-eight                   a profile that ships with bench
      bench run figure-eight -e my_lab:Filter  a filter of your own, my_lab.py here
      bench run figure-eight -e loose-15 -e 'command:./myfilter {sensors} {solution}'
      bench run my_flight.toml -o out/trial-3  a profile of your own
      bench run figure-eight --seed 7 --set sensors.imu=stim300

    \b
    Writes to DIR: result.json (metrics, seeds, versions, the profile as flown),
    truth.parquet, sensors-*.parquet, solution-<filter>.parquet,
    errors-<filter>.parquet, flight.rrd (bench view DIR) and report.html.
    """
    if then_view and not options["recording"]:
        raise click.UsageError("--view needs the recording that --no-rrd leaves out")
    from bench.cli.verbs.flight_verbs import run as run_profile
    from bench.cli.verbs.viewer import show_live
    from bench.cli.verbs.viewer import view as view_folder
    from bench.io.results import to_json

    console = new_console(stderr=as_json)
    options["live"] = functools.partial(show_live, console=console) if live else None
    result, folder = run_profile(profile, console=console, **options)
    if as_json:
        click.echo(to_json(result.metrics), nl=False)
    if then_view:
        view_folder(folder, web=False, console=console)
    return end_flight(result, strict=strict)


@commands.command()
@click.argument("profile", shell_complete=completion.profile)
@set_option
@seed_option
def fly(profile: str, **options: Any) -> int:
    """Fly a profile without filters and describe the flight.

    PROFILE is a .toml file, or the name of a shipped profile (bench list). The
    truth is stored in the cache for bench run. The last line is its integration error:
    an error-free strapdown against the truth.
    """
    from bench.cli.verbs.flight_verbs import fly as fly_profile

    fly_profile(profile, console=new_console(), **options)
    return DONE


class _Shelf(click.Choice[str]):
    """Choice of a kind of `bench list`; the error for the name of a catalog entry names its kind."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "filters":
            return "estimators"
        if value not in self.choices:
            from bench.cli.verbs.show import list_catalog
            from bench.io.config.listing import KINDS

            if value in KINDS:
                return value
            there = list_catalog()
            del there["packages"]  # the other shelves have these, too
            shelves = {one.name.lower(): shelf for shelf, found in there.items() for one in found}
            near = difflib.get_close_matches(str(value).lower(), shelves, n=1)
            if near:
                self.fail(f"{value!r} is not a kind; {near[0]} is in 'bench list {shelves[near[0]]}'")
            kinds = ["filters" if one == "estimators" else one for one in self.choices]
            self.fail(f"{value!r} is not a kind; there are {', '.join([*kinds, *KINDS])}")
        return super().convert(value, param, ctx)


@commands.command(name="list")
@click.argument(
    "kind",
    required=False,
    type=_Shelf(
        ["profiles", "aircraft", "legs", "sensors", "estimators", "exports", "studies", "metrics", "packages"]
    ),
    metavar="[KIND]",
)
@click.option("--json", "as_json", is_flag=True, help="print JSON")
@click.option("--long", "long", is_flag=True, help="for sensors: all datasheet values in one table")
@force_option("picture")
@click.option(
    "--picture",
    type=FILE,
    metavar="FILE",
    help="for sensors: draw the Allan deviation of all IMUs, by class",
)
def list_all(kind: str | None, as_json: bool, long: bool, picture: Path | None, force: bool) -> int:
    """List profiles, sensors, filters and studies.

    KIND is profiles, aircraft, legs, sensors, filters, exports, studies, metrics or packages, or a kind
    of sensor such as imu or gnss. For sensors and aircraft the command also prints sources and assumed
    values, for legs all keys with limits and defaults, and for packages what each of them adds.
    """
    from bench.cli.verbs.show import list_catalog, print_catalog, print_sensors
    from bench.io.config.listing import KINDS

    if long and kind != "sensors" and kind not in KINDS:
        raise click.UsageError("--long is for bench list sensors, or a kind of sensor such as imu")
    if picture is not None and (kind != "sensors" or as_json):
        raise click.UsageError("--picture is for bench list sensors, without --json")
    if force and picture is None:
        raise click.UsageError("--force is for --picture")
    if picture is not None:
        from bench.cli.verbs.show import draw_imus

        draw_imus(picture, new_console(), force=force)
    if long and as_json:
        from bench.io.config.figure_table import tabulate_figures
        from bench.io.results import to_json

        click.echo(
            to_json({one: tabulate_figures(one) for one in KINDS if kind in ("sensors", one)}), nl=False
        )
    elif long:
        print_sensors(new_console(), [one for one in KINDS if kind in ("sensors", one)])
    elif as_json:
        from bench.io.results import to_json

        rows = {name: [entry.as_dict() for entry in entries] for name, entries in list_catalog(kind).items()}
        click.echo(to_json(rows), nl=False)
    else:
        print_catalog(new_console(), kind)
    return DONE


@commands.command()
@click.argument("topic", required=False, metavar="[TOPIC]", shell_complete=completion.topic)
def guide(topic: str | None) -> int:
    """Read the documentation.

    Without TOPIC it lists the topics. A topic is shown in a pager on a terminal, and
    printed as Markdown elsewhere.

    \b
    Examples:
      bench guide                 the topics
      bench guide own-filter      how to write a filter and run it
    """
    from bench.cli.verbs.guide import list_topics, show_topic

    if topic is None:
        list_topics(new_console())
    else:
        show_topic(topic, new_console())
    return DONE


@commands.command()
@click.argument("path", required=False, type=FILE, metavar="[DIR|FILE.rrd]")
@click.option("--web", is_flag=True, help="show the recording in a browser on 127.0.0.1")
def view(path: Path | None, web: bool) -> int:
    """Open the newest result in the 3D viewer.

    DIR is a results folder; default the newest one below ./runs.
    """
    from bench.cli.verbs.viewer import view as view_recording

    view_recording(path, web=web, console=new_console())
    return DONE


@commands.command()
@click.argument("folder", type=FILE, metavar="DIR")
@out_option(
    "file for the page  [default: DIR/report.html or DIR/index.html], or folder for the figures", "PATH"
)
@click.option(
    "--figures", type=click.Choice(["pdf", "svg", "png"]), help="draw figures for a paper instead of the page"
)
@click.option(
    "--width-mm", type=FiniteRange(30, 500), default=88.0, metavar="MM", help="width of the figures"
)
@click.option("--serif", is_flag=True, help="use a serif font in the figures")
@force_option("page, or folder of figures")
def report(folder: Path, out: Path | None, figures: str | None, force: bool, **look: Any) -> int:
    """Write the HTML report.

    The page needs no network and no other file: verdicts, figures with their bounds, plots,
    events, sensors, versions. If DIR holds results folders, the page is their index.
    --figures draws each tab of the recording into a folder, DIR-figures by default.
    """
    from bench.cli.verbs.record_verbs import write_figures, write_report

    if figures is None:
        write_report(folder, out, force=force, console=new_console())
    else:
        write_figures(folder, out, figures, force=force, console=new_console(), **look)
    return DONE


@commands.command()
@click.argument("folder", type=FILE, metavar="DIR")
@out_option("file for the recording  [default: DIR/flight.rrd]", "FILE.rrd")
@click.option(
    "--runs",
    "which",
    default="median,worst",
    metavar="LIST",
    help="for a campaign: best, median, worst, or numbers of runs",
)
@code_option("campaign")
@force_option("recording")
def record(folder: Path, out: Path | None, which: str, **options: Any) -> int:
    """Write the 3D recording of a result.

    Use it for results written with --no-rrd or by bench score -o. Runs of a campaign are
    flown again and shown side by side.
    """
    from bench.cli.verbs import record_verbs

    chosen = record_verbs.find_runs(folder, which.split(","))
    if chosen is None:
        record_verbs.write_recording(folder, out, force=options["force"], console=new_console())
        return DONE
    runs = {}
    for name, command in chosen.items():
        given = run.make_context("run", shlex.split(command)[2:]).params
        kept = {key: given[key] for key in ("profile", "draw", "seed", "estimators", "overrides")}
        runs[name] = kept | {"guard": make_guard(given)}
    record_verbs.record_runs(folder, out, runs, console=new_console(), **options)
    return DONE


@commands.command()
@click.argument("folders", nargs=-1, required=True, type=FILE, metavar="DIR DIR...")
@out_option("draw the results over each other: a folder for a report and, of runs, a recording")
@click.option("--table", "whole", is_flag=True, help="print all main metrics")
@json_option("the comparison")
@force_option()
def compare(folders: tuple[Path, ...], out: Path | None, whole: bool, as_json: bool, force: bool) -> int:
    """Compare results.

    DIR is a results folder, a folder of results folders, or a campaign. Runs with the same
    seed and number on the same flight are compared in pairs, by the rules of bench check.
    Other differences are printed.

    \b
    Examples:
      bench compare runs/before runs/after -o runs/both
      bench compare campaigns/loose-22 campaigns/mine
    """
    from bench.cli.verbs.compare_verb import compare as compare_folders
    from bench.io.results import to_json

    console = new_console(stderr=as_json)
    compared = compare_folders(folders, console=console, out=out, force=force, whole=whole)
    if as_json:
        click.echo(to_json([asdict(one) for one in compared]), nl=False)
    return DONE


@commands.command()
@click.argument("profiles", nargs=-1, metavar="[PROFILE]...", shell_complete=completion.profile)
@estimator_option("check or record only this filter: one of the profile, built in")
@click.option(
    "--baselines",
    type=FILE,
    default=Path("tests/baselines"),
    metavar="DIR",
    help="folder of the baselines, one <profile>.json each",
)
@click.option("--runs", type=click.IntRange(min=2), metavar="N", help="runs  [default: 20, or 80 to record]")
@jobs_option
@click.option("--record", is_flag=True, help="write new baselines")
@click.option(
    "--reason", default="", metavar="TEXT", help="reason for the change, for CHANGES.md; with --record"
)
@click.option("--cpu", is_flag=True, help="record CPU time, too; a check evaluates it if the baseline has it")
@set_option
@click.option("--strict", is_flag=True, help="exit with status 1 also if a metric is undecided")
@click.option("--junit", type=FILE, metavar="FILE", help="write the verdicts as a JUnit file")
@json_option("the verdicts")
@code_option("profile or baseline")
@guard_options
def check(
    profiles: tuple[str, ...],
    estimators: tuple[str, ...] | None,
    baselines: Path,
    runs: int | None,
    jobs: int | None,
    record: bool,
    reason: str,
    cpu: bool,
    overrides: dict[str, Any],
    strict: bool,
    junit: Path | None,
    as_json: bool,
    allow_code: bool,
    guard: Any,
) -> int:
    """Detect accuracy regressions.

    PROFILE is the name or the .toml file of a profile or log, or a folder of logs.
    Default: all that have a baseline. A baseline contains every metric of every run. The
    check repeats the runs with the same noise and compares each metric: same, better,
    worse or undecided. --record writes the baselines and a line in CHANGES.md. With --set
    it measures the effect of another sensor or parameter.

    \b
    Examples:
      bench check figure-eight -e mine:Mine --record   record a filter of your own
      bench check --allow-code                         and check it after a change
      bench check figure-eight --set sensors.imu.gyro.noise_deg_sqrt_h=0.2
    """
    from bench.cli.verbs import check_verb
    from bench.io.results import to_json

    console = new_console(stderr=as_json)
    options: dict[str, Any] = {
        "directory": baselines,
        "estimators": estimators,
        "runs": runs,
        "overrides": overrides or None,
        "allow_code": allow_code,
        "guard": guard,
        "jobs": jobs,
    }
    if cpu and not record:
        raise click.UsageError("--cpu goes with --record: a check evaluates CPU time if the baseline has it")
    if record:
        if strict or junit or as_json:
            raise click.UsageError("--record measures no change: leave --strict, --junit and --json out")
        check_verb.record(profiles, console=console, reason=reason, cpu=cpu, **options)
        return DONE
    verdicts = check_verb.check(profiles, console=console, junit=junit, strict=strict, **options)
    if as_json:
        click.echo(to_json([asdict(row) for row in verdicts]), nl=False)
    failing = ("worse", "undecided") if strict else ("worse",)
    return NEGATIVE if any(row.word in failing for row in verdicts) else DONE


@commands.command()
@click.option("--empty", is_flag=True, help="remove all flights")
@click.option(
    "--limit",
    type=FiniteRange(min=0),
    metavar="GB",
    help="remove the least recently used flights down to this size",
)
def cache(empty: bool, limit: float | None) -> int:
    """Show or reduce the cache of flights.

    bench flies each flight once and keeps its truth. The least recently used flights are
    removed above the limit of 2 GB (environment variable BENCH_CACHE_GB), and after 30
    days. A flight that a process reads stays. The cache is in BENCH_CACHE, else in bench
    below XDG_CACHE_HOME or ~/.cache.
    """
    from bench.cli.verbs.flight_verbs import look_after_cache

    look_after_cache(0.0 if empty else limit, console=new_console())
    return DONE


@commands.command()
@click.argument("profile", required=False, metavar="[PROFILE]", shell_complete=completion.profile)
@estimator_option("compile only this filter: built in")
def warm(profile: str | None, estimators: tuple[str, ...] | None) -> int:
    """Compile the filters before the first run.

    Without PROFILE all sensors and built-in filters are compiled, which takes half a
    minute once for each version of bench. With PROFILE only what it uses is compiled. Use
    it in install scripts and on cluster nodes.

    \b
    Examples:
      bench warm                  everything that is built in
      bench warm figure-eight     what this profile needs
    """
    from bench.cli.verbs.warm_verb import warm as warm_kernels

    warm_kernels(profile, console=new_console(), estimators=estimators)
    return DONE
