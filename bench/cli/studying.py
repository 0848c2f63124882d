"""The verb study: a command for each study, with the flags that its options make."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args, get_origin

import click

from bench.cli.group import (
    commands,
    force_option,
    jobs_option,
    json_option,
    new_console,
    out_option,
    report_option,
    seed_option,
    set_option,
)
from bench.core.words.exceptions import DONE, NEGATIVE, UNDECIDED, ConfigError

_SHARED = {"overrides": set_option, "seed": seed_option}
"""Options of studies that other verbs have, too."""

_OF_FLIGHTS = {"profiles": "--profiles", "units": "--units", "overrides": "--set", "seed": "--seed"}
"""Options of studies that fly profiles -> their flags."""


class _Studies(click.Group):
    """Group of the studies; makes the command of a study when it is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all studies."""
        from bench.experiments.studies import find_studies

        return list(find_studies())

    def get_command(self, ctx: click.Context, name: str) -> click.Command:
        """Return the command of a study; an unknown name ends with those that are known."""
        from bench.experiments.studies.conducting import find_study

        entry, module = find_study(name)
        return _make_command(name, entry.question, module)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the studies with their questions in full."""
        from bench.experiments.studies import find_studies

        with formatter.section("Studies"):
            formatter.write_dl([(name, entry.question) for name, entry in find_studies().items()])


@commands.command(cls=_Studies, subcommand_metavar="NAME [OPTIONS]")
def study() -> None:
    """Choose sensors: requirement, drift, error budget.

    bench study NAME --help lists the options of a study. Results state what is drawn, intervals, and the
    command that makes them again.

    \b
    Examples:
      bench study requirements
      bench study requirements --error-m 10 -o requirements
    """


def _make_command(name: str, question: str, module: Any) -> click.Command:
    """Return the command of a study, with its own arguments and flags and the flags common to all studies."""

    def run(as_json: bool, **given: Any) -> int:
        from bench.cli.verbs.study_verb import run_study
        from bench.io.results import to_json
        from bench.io.results.study_folder import describe_study

        chosen = {key: value for key, value in given.items() if value not in (None, {})}
        if chosen.get("report") is False and "out" not in chosen:
            raise ConfigError(f"study {name}: --no-report is for -o DIR, which writes one")
        console = new_console(stderr=as_json)
        result = run_study(name, console=console, **{"out": None, "jobs": None} | chosen)
        if as_json:
            click.echo(to_json(describe_study(result)), nl=False)
        findings = result.findings
        return NEGATIVE if not findings.good else UNDECIDED if findings.undecided else DONE

    command: Callable[..., Any] = run
    for decorate in (
        force_option("study"),
        report_option,
        json_option("answer and tables"),
        click.option("--table", is_flag=True, help="print all tables and sentences"),
        out_option("folder for tables, figures, study.json and report.html"),
        jobs_option,
    ):
        command = decorate(command)
    fields = module.Options.model_fields
    shared = [key for key in fields if key in _SHARED]
    for key in [*reversed(shared), *(key for key in reversed(fields) if key not in shared)]:
        command = _make_parameter(key, fields[key])(command)
    for key in _OF_FLIGHTS.keys() - fields.keys():
        command = _refuse_option(name, _OF_FLIGHTS[key])(command)
    text = f"{question}\n\n{module.__doc__.partition(chr(10))[2].strip()}"
    return click.command(name, help=text)(command)


def _refuse_option(study: str, flag: str) -> Callable[[Any], Any]:
    """Return a hidden option that ends with why a study has none of this name."""

    def refuse(ctx: click.Context, parameter: click.Parameter, value: Any) -> None:
        if value is not None:
            raise ConfigError(f"study {study}: {flag} is for studies that fly profiles; this one flies none")

    return click.option(flag, expose_value=False, hidden=True, callback=refuse)


def _make_parameter(key: str, field: Any) -> Callable[[Any], Any]:
    """Return the argument or the option for a field of the options of a study."""
    if key in _SHARED:
        return _SHARED[key]
    if field.is_required():
        return click.argument(key, metavar=key.upper())
    flag, words = key.replace("_", "-"), " ".join((field.description or "").split())
    if field.annotation is bool:
        return click.option(f"--{flag}/--no-{flag}", key, default=None, help=words)
    chosen = get_origin(field.annotation) is Literal
    default = field.default
    if default is not None:
        shown = ",".join(map(str, default)) if isinstance(default, tuple) else f"{default}"
        words = f"{words}  [default: {shown.removesuffix('.0')}]"
    kind = click.Choice(get_args(field.annotation)) if chosen else None
    metavar = None if chosen else "LIST" if "tuple" in str(field.annotation) else "X"
    return click.option(f"--{flag}", key, type=kind, metavar=metavar, help=words)
