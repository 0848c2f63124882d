"""The verbs of many runs: campaign, tune and card."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from bench.cli import completion
from bench.cli.group import (
    FILE,
    code_option,
    commands,
    estimator_option,
    force_option,
    guard_options,
    jobs_option,
    json_option,
    junit_option,
    list_given,
    new_console,
    out_option,
    parse_assignments,
    report_option,
    seed_option,
    set_option,
    strict_option,
)
from bench.core.words.exceptions import DONE, INTERRUPTED, NEGATIVE


@commands.command()
@click.argument(
    "sources",
    nargs=-1,
    required=True,
    metavar="PROFILE|CAMPAIGN.toml|LOG...",
    shell_complete=completion.profile,
)
@click.option("--runs", type=click.IntRange(min=1), metavar="N", help="runs of each flight  [default: 200]")
@click.option(
    "--flights",
    type=click.IntRange(min=1),
    metavar="N",
    help="number of flights, each with its own turbulence",
)
@jobs_option
@click.option("--scheduler", metavar="ADDRESS", help="use the workers of this Dask scheduler")
@out_option("folder for journal and tables  [default: campaigns/<profile>-<seed>]")
@estimator_option("evaluate only this filter: one of the profile")
@set_option
@seed_option
@click.option("--resume", is_flag=True, help="continue the campaign in the folder")
@json_option("the statistics")
@report_option
@force_option("campaign")
@code_option("profile")
@guard_options
@junit_option
@strict_option
def campaign(sources: tuple[str, ...], as_json: bool, strict: bool, **options: Any) -> int:
    """Run a profile many times (Monte Carlo), or filters on many logs.

    PROFILE is a .toml file, or the name of a shipped profile (bench list). CAMPAIGN.toml
    names profiles and the values to vary: every combination is a condition with its
    own statistics. Finished runs are in the journal at once: after Ctrl-C, kill -9 or
    a full disk, --resume continues.

    LOG is a LOG.toml, a recording, or a folder of them: filters run side by side on all, as
    bench study logs does it; a recording without its log gets one first.

    \b
    Examples:
      bench campaign figure-eight --runs 200 -e loose-15 -e loose-22
      bench campaign figure-eight --runs 200 -e loose-15 -e loose-22 --resume
      bench campaign my_flight.toml --runs 1 --flights 100 --set sensors.imu=stim300
      bench campaign which_unit.toml -o units
      bench campaign flights/*.ulg -e autopilot -e loose-full -o fleet

    \b
    Writes to DIR: runs.parquet (a row for each run and filter, with the command
    that repeats it), epochs.parquet (mean and percentiles over the runs at up to 600
    epochs, NEES with its band), campaign.json (figures and sentences), report.html and
    the journal.
    """
    if options["jobs"] and options["scheduler"]:
        raise click.UsageError("--jobs is for processes on this machine; leave it out with --scheduler")
    from bench.cli.verbs.campaign_verb import run_campaign
    from bench.cli.verbs.log_campaign import are_logs, run_logs
    from bench.evaluation.consistency.verdict import BROKEN
    from bench.experiments.campaigns.running import describe
    from bench.io.results import to_json

    if are_logs(sources):
        found = run_logs(sources, list_given(), console=new_console(stderr=as_json), **options)
        if as_json:
            from bench.io.results.study_folder import describe_study

            click.echo(to_json(describe_study(found)), nl=False)
        return DONE if found.findings.good else NEGATIVE
    [profile] = sources
    result = run_campaign(profile, console=new_console(stderr=as_json), **options)
    if as_json:
        click.echo(to_json(describe(result)), nl=False)
    if result.interrupted:
        return INTERRUPTED
    good = not result.failed and all(one.converged.value == 1.0 for one in result.outcomes)
    good &= all(one.word == "met" for one in result.requirements)
    if strict:
        good &= all(one.consistency is None or one.consistency.word not in BROKEN for one in result.outcomes)
    return DONE if good else NEGATIVE


@commands.command()
@click.argument("source", metavar="PROFILE|LOG.toml", shell_complete=completion.profile)
@click.option("-e", "--estimator", required=True, metavar="NAME", help="filter to tune")
@click.option(
    "--log", is_flag=True, help="tune on the first half of a log; check with withheld fixes of the second"
)
@click.option(
    "--goal",
    type=click.Choice(["consistency", "rmse"]),
    default="consistency",
    help="optimize the consistency of the covariance, or the horizontal RMSE",
)
@click.option(
    "--factor",
    "factors",
    multiple=True,
    callback=lambda ctx, param, given: given or None,
    metavar="START",
    help="one factor for all parameters that begin with START, such as imu.gyro.noise; repeat for more",
)
@click.option("--runs", type=click.IntRange(min=2), default=20, metavar="N", help="runs used for tuning")
@click.option(
    "--evaluations",
    type=click.IntRange(min=2),
    default=400,
    metavar="N",
    help="largest number of sets to try; status 1 if the search has not converged by then",
)
@jobs_option
@click.option("-o", "--out", type=FILE, default="tuned", metavar="DIR", help="folder for the datasheets")
@set_option
@seed_option
@json_option("factors and figures")
@force_option("tuned datasheet")
@code_option("profile or log")
@guard_options
def tune(source: str, as_json: bool, **options: Any) -> int:
    """Tune the noise that a filter assumes.

    The first runs of PROFILE tune; as many others evaluate the result, before and after. With --log the
    innovations of the first half of a recording tune, and the withheld fixes of its second half evaluate.
    Each factor is printed with its interval, or as not determined by the data. Writes the datasheets that
    the filter should assume.

    \b
    Examples:
      bench tune figure-eight -e loose-22
      bench tune drive.toml --log -e loose-15 --set sensors.assumed.imu=icm-45686
      bench run figure-eight -e loose-22 --set sensors.assumed.imu=tuned/imu-tuned.toml
    """
    if options["log"] and options["seed"] is not None:
        raise click.UsageError("a log has no seed")
    from bench.cli.verbs.tune_verb import run_tuning
    from bench.io.results import to_json

    found = run_tuning(source, console=new_console(stderr=as_json), **options)
    if as_json:
        click.echo(to_json(asdict(found)), nl=False)
    return DONE if found.converged else NEGATIVE


@commands.command()
@click.option("-e", "--estimator", metavar="NAME", help="the filter to evaluate")
@click.option("--against", default="loose-full", metavar="NAME", help="filter to compare with")
@click.option("--label", metavar="NAME", help="label on the card  [default: class or program]")
@click.option(
    "--option",
    "given",
    multiple=True,
    callback=parse_assignments,
    metavar="KEY=VALUE",
    help="option of the filter; repeat for more",
)
@click.option("--quick", is_flag=True, help="twelve flights of 8 runs instead of eighteen of 40")
@jobs_option
@click.option("-o", "--out", type=FILE, metavar="FILE", help="write the card as JSON")
@click.option("--html", type=FILE, metavar="FILE", help="write the card as a page")
@click.option("--compare", "compared", type=FILE, nargs=2, metavar="A B", help="compare two cards")
@click.option("--verify", "verified", type=FILE, metavar="FILE", help="repeat random runs of a card")
@click.option("--sensors", type=FILE, metavar="DIR", help="write the sensor data of the suite instead")
@click.option("--require", "required", type=FILE, metavar="FILE", help="requirements to check")
@click.option("--runs", type=FILE, metavar="DIR", help="folder for the runs  [default: cards/<label>-quick]")
@click.option("--resume", is_flag=True, help="reuse finished runs")
@seed_option
@json_option("the card")
@click.option("--table", is_flag=True, help="print a sentence for each metric of each flight, too")
@force_option("card")
@guard_options
@junit_option
def card(
    as_json: bool,
    estimator: str | None,
    compared: tuple[Path, Path] | None,
    verified: Path | None,
    sensors: Path | None,
    given: dict[str, Any],
    required: Path | None,
    **options: Any,
) -> int:
    """Score a filter on a fixed suite of flights.

    Accuracy is a ratio to the other filter on the same noise, with its interval. The card
    contains version and hash of the suite; cards with equal hashes can be compared.
    --seed draws noise that no filter was tuned on; --verify repeats some runs of a card.
    The status is 1 if a run did not converge, the filter looks ahead, or a requirement of
    --require is not met.
    To evaluate solutions made elsewhere, use --sensors, which writes a folder for each run,
    and -e file:DIR, which reads solution.csv in each of them.

    \b
    Examples:
      bench card -e mine:Filter --quick
      bench card -e mine:Filter --option gain=2.0 --label gain-2 --require need.toml
      bench card --sensors runs --quick && bench card -e file:runs --quick
      bench card -e 'command:./myfilter {sensors} {solution}' -o mine.json
      bench card --compare mine.json theirs.json
      bench card --verify mine.json
    """
    from bench.cli.verbs.campaign_verb import check_card, print_comparison, run_card, write_sensors
    from bench.io.results import to_json

    if [estimator, compared, sensors, verified].count(None) != 3:
        raise click.UsageError(
            "give one of -e NAME to evaluate, --compare A B, --verify FILE and --sensors DIR"
        )
    if sensors is not None:
        write_sensors(sensors, quick=options["quick"], console=new_console(stderr=as_json))
        return DONE
    console = new_console(stderr=as_json)
    found: Any
    status = DONE
    if verified is not None:
        found = check_card(verified, options["guard"], options["jobs"], console=console)
        if as_json:
            click.echo(to_json(found), nl=False)
        return NEGATIVE if found else DONE
    if compared is not None:
        found = [asdict(line) for line in print_comparison(compared, console=console)]
    else:
        made = run_card(str(estimator), console=console, options=given, requirements=required, **options)
        status, found = DONE if made.good else NEGATIVE, made.model_dump()
    if as_json:
        click.echo(to_json(found), nl=False)
    return status
