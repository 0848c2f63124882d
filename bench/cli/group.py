"""The command group, options and console that all verbs share."""

from __future__ import annotations

import functools
import math
import tomllib
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench import __version__
from bench.cli import completion
from bench.core.files.installed import find_installed, find_own, import_installed
from bench.core.words.exceptions import BUG, DONE, NEGATIVE, ConfigError
from bench.core.words.wording import replace_control

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

if TYPE_CHECKING:
    from rich.console import Console

    from bench.core.records.run_result import RunResult

_GROUPS = {
    "Start": ("run", "view", "list", "guide", "new"),
    "Evaluate": ("show", "compare", "report", "campaign", "card", "check", "study", "tune"),
    "Logs": ("navigate", "fixes", "allan"),
    "Exchange": ("score", "export", "convert", "stream", "serve"),
}
"""Heading in the help -> verbs below it."""
_MAINTAIN = ("fly", "record", "cache", "warm", "upgrade")

_HELP = {"max_content_width": 100, "show_default": True}


def parse_assignments(ctx: click.Context, param: click.Parameter, given: tuple[str, ...]) -> dict[str, Any]:
    """Parse KEY=VALUE; the value is read as TOML or, if that fails, as a text."""
    values: dict[str, Any] = {}
    for item in given:
        key, equals, text = item.partition("=")
        if not equals or not all(key.split(".")):
            raise click.BadParameter(
                f"{item!r} must be KEY=VALUE, for example sensors.imu=stim300", ctx, param
            )
        values.pop(key, None)  # what was typed last is the last
        try:
            values[key] = tomllib.loads(f"value = {text}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError):
            values[key] = text
    return values


class FiniteRange(click.FloatRange):
    """A range of finite numbers."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number, or fail with the reason why it is invalid."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


def parse_durations(ctx: click.Context, param: click.Parameter, given: str | None) -> tuple[float, ...]:
    """Parse durations in seconds, separated by commas."""
    try:
        values = tuple(float(text) for text in given.split(",")) if given else ()
    except ValueError:
        values = (0.0,)
    if not all(0.0 < value <= 3600.0 for value in values):
        raise click.BadParameter(f"{given!r} must be seconds up to 3600, such as 10,30,60", ctx, param)
    return tuple(dict.fromkeys(values))


set_option = click.option(
    "--set",
    "overrides",
    callback=parse_assignments,
    multiple=True,
    metavar="KEY=VALUE",
    shell_complete=completion.setting,
    help="replace a value of the file, or a parameter of a datasheet it names",
)
seed_option = click.option(
    "--seed", type=click.IntRange(min=0), metavar="N", help="seed of sensor noise and turbulence"
)
_OFF: Mapping[str, Any] = {"is_flag": True, "flag_value": False, "default": True, "show_default": False}
recording_option = click.option("--no-rrd", "recording", help="do not write the 3D recording", **_OFF)
report_option = click.option("--no-report", "report", help="do not write the report", **_OFF)
rates_option = click.option(
    "--rates",
    type=click.Choice(["deg", "rad"]),
    help="unit of the gyros, if neither a name nor the motion shows it",
)
FILE = click.Path(path_type=Path)


def out_option(what: str, metavar: str = "DIR") -> Decorator:
    """Return the option -o for the file or folder that a verb writes."""
    return click.option("-o", "--out", type=FILE, metavar=metavar, help=what)


def force_option(what: str = "results folder") -> Decorator:
    """Return the option --force."""
    return click.option("--force", is_flag=True, help=f"replace an existing {what}")


jobs_option = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="J",
    help="number of processes  [default: one for each processor]",
)


def json_option(what: str) -> Decorator:
    """Return the option --json: print these figures as JSON."""
    text = f"print {what} as JSON on stdout, everything else on stderr"
    return click.option("--json", "as_json", is_flag=True, help=text)


strict_option = click.option(
    "--strict", is_flag=True, help="exit with status 1 also if a filter is over- or underconfident"
)
table_option = click.option(
    "--table", is_flag=True, help="print all main metrics with their bounds, as bench show"
)


def code_option(file: str) -> Decorator:
    """Return the option --allow-code of a verb that reads this kind of file."""
    text = f"allow the {file} to run the code it names (use = 'module:Class' or 'command:...')"
    return click.option("--allow-code", is_flag=True, help=text)


LIMITS = ("timeout", "memory", "output", "in_process")
"""Parameters of the options that `guard_options` adds."""


def make_guard(given: dict[str, Any]) -> Any:
    """Take the `LIMITS` out of the parameters of a verb and return them as a `specs.Guard`."""
    from bench.core.records.specs import DEFAULT_GUARD, Guard

    timeout, memory, output, in_process = (given.pop(name) for name in LIMITS)
    return Guard(
        timeout,
        None if memory is None else 1e9 * memory,
        DEFAULT_GUARD.output if output is None else 1e6 * output,
        in_process,
    )


def guard_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options for the limits of user filters; the verb gets them as ``guard``."""

    @functools.wraps(function)
    def run(**given: Any) -> Any:
        if given["in_process"]:
            click.echo("Classes of yours run in this process: nothing is guarded.", err=True)
        return function(guard=make_guard(given), **given)

    above, a_filter = FiniteRange(min=0.0, min_open=True), "your own filter"
    texts = {
        "--output": ("MB", f"limit on the solution of {a_filter}  [default: 2000]"),
        "--memory": ("GB", f"limit on the memory of {a_filter}  [default: half of the machine]"),
        "--timeout": ("S", f"limit on the wall time of {a_filter}  [default: flight time, at least 600]"),
    }
    text = "run your class in the process of bench, for a debugger; no limits apply"
    run = click.option("--in-process", is_flag=True, help=text)(run)
    for name, (unit, text) in texts.items():
        run = click.option(name, type=above, metavar=unit, help=text)(run)
    return run


def results_options(file: str) -> Decorator:
    """Return the options of a verb that runs the filters of this kind of file and writes a results folder."""
    options = (recording_option, report_option, force_option(), code_option(file), guard_options)
    return lambda function: functools.reduce(lambda made, one: one(made), reversed(options), function)


def estimator_option(which: str) -> Decorator:
    """Return the option -e, which may be repeated: use only these estimators."""
    return click.option(
        "-e",
        "--estimator",
        "estimators",
        multiple=True,
        callback=lambda ctx, param, given: given or None,
        shell_complete=completion.estimator,
        metavar="NAME",
        help=f"{which}, 'module:Class', 'file:solution.csv' or 'command:./program {{sensors}} {{solution}}'; "
        "repeat for more",
    )


def _print_version(context: click.Context, _: click.Parameter, asked: bool) -> None:
    if not asked or context.resilient_parsing:
        return
    from bench.io.results.provenance import find_commit

    click.echo(replace_control(f"bench, version {__version__}, commit {find_commit() or 'unknown'}"))
    context.exit()


class _Verbs(click.Group):
    """Group of the verbs of bench, plug-ins and other packages; the last two are imported when used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the verbs of bench."""
        return sorted([*super().list_commands(ctx), *find_own("verbs")])

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Return a verb; None if no verb has this name."""
        own = super().get_command(ctx, name)
        if own is not None:
            return own
        if name in (known := find_own("verbs")):
            module, _, attribute = known[name].partition(":")
            plugged: click.Command = getattr(import_module(module), attribute)
            return plugged
        other = find_installed("verbs", self.list_commands(ctx)).get(name)
        if other is None:
            return None
        found = getattr(import_installed("verb", other), other.place.partition(":")[2], None)
        if not isinstance(found, click.Command):
            raise ConfigError(f"verb {name!r} of {other.package}: {other.place} is not a click.Command")
        return found

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write all verbs on one screen in groups, and the verbs of installed packages."""
        formatter.write("Usage: bench COMMAND [OPTIONS]   Test INS/GNSS filters against a known truth\n\n")
        for heading, names in _GROUPS.items():
            for k, name in enumerate(names):
                verb = self.get_command(ctx, name)
                words = verb.get_short_help_str(200).rstrip(".") if verb is not None else "not installed"
                formatter.write(f"{'' if k else heading:<11} {name:<10} {words}\n")
        formatter.write(f"{'Maintain':<11} {', '.join(_MAINTAIN)}\n")
        for name, other in find_installed("verbs", self.list_commands(ctx)).items():
            formatter.write(f"{'Installed':<11} {name:<10} package {other.package}\n")
        formatter.write(
            "\nOptions: bench COMMAND --help, bench --version. Exit statuses: bench guide results\n"
        )


@click.group(cls=_Verbs, context_settings=_HELP, invoke_without_command=True)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Print version and commit.",
)
@click.pass_context
def commands(ctx: click.Context) -> None:
    """Test INS/GNSS navigation filters against a known truth."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


junit_option = click.option(
    "--junit",
    type=FILE,
    metavar="FILE",
    help="write the requirements as a JUnit file for CI",
)


def end_run(metrics: Mapping[str, Mapping[str, Any]], *, strict: bool = False) -> int:
    """Print the tracebacks of filters that raised, and return the exit status of a run.

    ``strict``: a covariance that does not hold is `NEGATIVE`, too.
    """
    from bench.evaluation.consistency.verdict import BROKEN

    tracebacks = [values["traceback"] for values in metrics.values() if "traceback" in values]
    for text in tracebacks:
        click.echo(replace_control(text), err=True, nl=False)
    if tracebacks:
        return BUG
    bad = any(
        not values["converged"]
        or values.get("required") == "missed"
        or (strict and values.get("verdict") in BROKEN)
        for values in metrics.values()
    )
    return NEGATIVE if bad else DONE


def end_flight(result: RunResult, *, strict: bool = False) -> int:
    """Print the end of a flight and return its exit status, at least `NEGATIVE` if the aircraft crashed."""
    return max(end_run(result.metrics, strict=strict), NEGATIVE if result.events.select("crash") else DONE)


def new_console(*, stderr: bool = False) -> Console:
    """Return the console for tables and progress."""
    from bench.cli.verbs.console import PlainConsole

    return PlainConsole(stderr=stderr)


def list_given() -> list[tuple[str, str]]:
    """Return name and flag of the options and arguments that were typed in the command at work."""
    here = click.get_current_context()
    return [
        (one.name, one.opts[0])
        for one in here.command.params
        if one.name and here.get_parameter_source(one.name) is click.core.ParameterSource.COMMANDLINE
    ]
