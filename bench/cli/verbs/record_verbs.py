"""The verbs navigate, record, report, allan, export, score and stream."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
from rich.console import Console

from bench.cli import api, exchanging
from bench.cli.new_files.log_advice import apply_advice
from bench.cli.new_files.new_log import name_log, new_log
from bench.cli.verbs import result_table
from bench.cli.verbs.flight_verbs import (
    RUNS,
    find_own_estimators,
    print_end,
    print_result,
    show_stages,
    write_first,
)
from bench.cli.verbs.printing import print_findings, print_wrapped
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.findings import FindingTable
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError
from bench.core.words.notebook import ShownFigure
from bench.core.words.wording import one_line
from bench.evaluation.metrics.outages import DRIFT_MEANING, describe_drift, tabulate_drifts
from bench.evaluation.motion.noise_curves import SHOWN_UNITS, AllanCurve
from bench.evaluation.motion.noise_fit import FEWEST
from bench.io import config, parameters, results
from bench.io.config.checks import is_code
from bench.io.config.datasheets import read_imu
from bench.io.config.library import find_datasheet
from bench.io.logs.resting_log import has_own_columns
from bench.pipeline import log_pipeline


def navigate_log(
    name: str,
    *,
    console: Console,
    outages: Sequence[float] | None,
    places: int,
    out: Path | None,
    recording: bool,
    report: bool,
    force: bool,
    table: bool = False,
    rates: str | None = None,
    apply: bool = False,
    **log_options: Any,
) -> dict[str, Any]:
    """Check a recording, run filters on it, print a screen of it, and write the results folder.

    ``name`` is a log, or a recording, for which one is written beside it unless it is there. If ``out`` is
    None the folder is ``runs/<log>``. ``table`` prints every check and every main metric, too. ``apply``
    changes the log as its checks advise.
    ``log_options`` are those of `bench.read_log`.
    Returns ``metrics`` by filter, ``validity`` and ``outages``, as in ``result.json``.
    """
    find_own_estimators()
    name = _find_log(name, console, rates)
    folder = out or RUNS / Path(name).stem
    results.check_folder(folder, force=force)
    begun = time.perf_counter()
    log = apply_advice(name, console, **log_options) if apply else log_pipeline.read_log(name, **log_options)
    title = one_line(log.spec.title)
    ends = ", seconds of a week that ends in them" if log.records.week_ends else ""
    zero = f"{log.records.origin:.9g} s on the clock of the files{ends}"
    console.print(f"{title}, as {name} describes it: t = 0 is {zero}", soft_wrap=True)
    for note in log.records.notes if table else ():
        console.print(f"  {note}")
    with show_stages() as watch:
        result = log_pipeline.navigate(log, outages=outages, places=places, progress=watch)
    with write_first(console, result, folder, recording=recording, report=report, force=force):
        print_log(console, result, table=table, cuts=outages is None)
    print_end(console, folder, begun, table=table)
    return {"metrics": result.metrics, **result.more}


def print_log(console: Console, result: RunResult, *, table: bool, cuts: bool = False) -> None:
    """Print the results of the filters on a recording, then the checks of the recording.

    ``cuts``: outages were simulated if there was room. Without ``table`` only the failed checks are printed,
    and a sentence for each length of the outages.
    """
    checks, document = result.more["validity"], result.profile
    judge = "evaluated by withheld GNSS fixes"
    if "reference" in document:
        judge = f"evaluated by the reference, {document['reference']['file']}"
    elif "gnss" not in document:
        rests = any("rests" in one for one in result.metrics.values())
        judge = f"no fixes and no reference: only innovations {'and rests ' if rests else ''}are evaluated"
    console.print(f"{judge}; {result.evaluation}", soft_wrap=True)
    print_result(console, result, table=table)
    outages = result.more["outages"]
    if outages and table:
        print_findings(console, [DRIFT_MEANING], [tabulate_drifts(outages)])
    elif outages:
        console.print()
        for row in outages:
            print_wrapped(console, describe_drift(row))
    elif cuts and "reference" not in document and "gnss" in document:
        console.print(
            "The log is too short to simulate outages: its fixes evaluate the receiver, not the IMU."
        )
    failed = [check for check in checks if not check["good"]]
    for check in checks if table else failed[:MOST_CHECKS]:
        mark, style = ("  ", "") if check["good"] else ("! ", "yellow")
        text = mark + check["text"]
        if table:
            console.print(text, style=style, soft_wrap=True)
        else:
            print_wrapped(console, text, style)
    if not table:
        more = len(failed) - MOST_CHECKS
        rest = f"{more} more; all: bench show" if more > 0 else "all: bench show"
        console.print(f"{len(checks) - len(failed)} of {len(checks)} checks of the log passed ({rest})")


MOST_CHECKS = 3
"""Failed checks on the screen of a log."""


def _find_log(name: str, console: Console, rates: str | None) -> str:
    """Return the log of a recording, written if missing; a log file returns itself."""
    path, log = Path(name), name_log(Path(name))
    if path.suffix == ".toml" or not path.exists():
        return name
    if not log.exists():
        new_log(name, console=console, rates=rates)
    return str(log)


def write_recording(folder: Path, out: Path | None, *, force: bool, console: Console) -> None:
    """Make the recording of a results folder, and print the next command."""
    from bench.views import recording

    path = recording.write_recording(folder, out, force=force)
    console.print(f"Wrote {path}.", soft_wrap=True)
    if out is None:
        console.print(f"Next: bench view {folder}", soft_wrap=True)


def find_runs(folder: Path, which: Sequence[str]) -> dict[str, str] | None:
    """Return the commands of runs of a campaign by name; None if the folder contains no campaign."""
    if not (folder / results.CAMPAIGN_RESULT).is_file():
        return None
    from bench.experiments.campaigns.stored import choose_runs, read_campaign

    return choose_runs(read_campaign(folder), [name.strip() for name in which])


def record_runs(
    folder: Path,
    out: Path | None,
    runs: Mapping[str, Mapping[str, Any]],
    *,
    force: bool,
    allow_code: bool,
    console: Console,
) -> None:
    """Fly runs of a campaign again, and record them side by side.

    Each run has ``profile``, ``draw``, and the ``seed``, ``estimators``, ``overrides`` and ``guard`` of
    `config.read_profile`. What a campaign names may be the code of a stranger: it needs ``allow_code``.
    """
    from bench.views import recording
    from bench.views.plots.overlay import merge_results

    path = folder / results.RECORDING if out is None else out
    recording.check_recording(path, force=force or out is None)
    find_own_estimators()
    flown = {}
    for name, options in runs.items():
        code = [use for use in options["estimators"] or () if is_code(use)]
        if code and not allow_code:
            raise ConfigError(
                f"{folder}: its runs name {code[0][:60]!r}, which runs code on this machine; "
                "--allow-code permits it"
            )
        given = {key: options[key] for key in ("overrides", "seed", "estimators", "guard")}
        profile = config.read_profile(options["profile"], **given, allow_code=allow_code)
        flown[name] = api.run(profile, run=options["draw"])
    recording.write(path, folder.resolve().name, merge_results(flown))
    console.print(f"Wrote {path}: {'; '.join(flown)}.", soft_wrap=True)


def write_report(folder: Path, out: Path | None, *, force: bool, console: Console) -> None:
    """Write the report of a results folder, or the index of a folder of results, and print where it is."""
    from bench.views.report import writing

    path = writing.write_report(folder, out, force=force, progress=lambda now: console.print(str(now)))
    console.print(f"Wrote {path}.", soft_wrap=True)


def write_figures(folder: Path, out: Path | None, form: str, *, console: Console, **look: Any) -> None:
    """Draw the figures of a results folder for a paper, and print where they are."""
    from bench.views.report import writing

    out = out or folder.with_name(f"{folder.resolve().name}-figures")
    written = writing.write_figures(folder, out, form, **look)
    console.print(f"Wrote {len(written)} figures into {out}.", soft_wrap=True)


def measure_allan(
    unit: str | None,
    log: Path | None,
    *,
    out: Path | None,
    sheet: Path | None,
    force: bool,
    seed: int,
    gravity: float | None,
    rates: str | None,
    console: Console,
) -> bool:
    """Print and draw the Allan deviation of an IMU or a log; return whether the model is within its bands.

    Without ``unit`` the datasheet that is fitted to the log is written, too, unless the log is short.
    """
    source = log.stem if log else Path(unit).stem if unit and unit.endswith(".toml") else unit
    picture = out or Path(f"allan-{source}.png")
    beside = Path(f"unit-{source}.toml") if sheet is None and unit is None else None
    if beside is not None:
        exchanging.check_sheet(beside, force=force)
    if log is not None and log.suffix != ".toml" and not has_own_columns(log):
        log = Path(_find_log(str(log), console, rates))
    elif rates is not None:
        raise ConfigError("--rates is for a log with other column names; leave it out")
    measured = exchanging.measure_allan(
        unit, log=log, seed=seed, picture=picture, sheet=sheet, gravity=gravity, force=force
    )
    if beside is not None and measured.fits:
        exchanging.write_sheet(beside, measured)
        sheet = beside
    fits = [parameters.summarize_fit(fit) for fit in measured.fits]
    fits += [parameters.summarize_poses(one) for one in measured.poses]
    mark = " (!)" if measured.outside else ""
    outside = f"{measured.outside} of {measured.points} values lie outside their 99.9 % band{mark}."
    sentences = [*fits, f"picture: {picture}", *([outside] if measured.simulated else [])]
    if beside is not None and not measured.fits:
        needs = f"a fit needs {FEWEST} samples at rest in one pose; record for longer"
        sentences.append(f"no datasheet from {measured.record}: {needs}")
    white = {fit.triad: fit.estimates["random_walk"].low for fit in measured.fits}
    sentences += [_doubt_unit(triad) for triad, least in white.items() if least > _MOST[triad]]
    if measured.poses and gravity is None:
        sentences.append(
            f"gravity of {STANDARD_GRAVITY:g} m/s^2 assumed; if it is wrong by 0.1 %, so are scale factors: "
            "give --gravity"
        )
    if sheet is not None:
        if not measured.poses:
            sentences.append(
                "not in the datasheet: turn-on bias, scale factor, misalignment; add them from the "
                "maker's datasheet, or record six poses or more"
            )
        sentences.append(
            f"datasheet: {sheet}; next: bench run figure-eight --set sensors.imu={quote(str(sheet))}"
        )
    name = "fit" if measured.fitted else "datasheet"
    print_findings(console, sentences, [tabulate_allan(curve, name) for curve in measured.curves])
    return measured.held


_MOST = {"gyro": np.deg2rad(5.0) / 60.0, "accel": 0.02}
"""Five times the white noise of any IMU of the catalog [unit/sqrt(s)]."""


def _doubt_unit(triad: str) -> str:
    used = {"gyro": "rad/s, or deg/s", "accel": "m/s^2, or g"}[triad]
    return (
        f"{triad}: more than 5 times the white noise of any IMU of the catalog (!): check that "
        f"the unit in the column names is right ({used}), and record without vibration"
    )


def convert_unit(unit: str, *, to: str | None, console: Console, **options: Any) -> None:
    """Print the figures of an IMU in the parameters of another program, and what is lost on the way.

    For ``options`` see `bench.cli.exchanging.convert_unit`.
    """
    if to is not None and to in parameters.TUNINGS:
        if given := [key for key, value in options.items() if value and key != "force"]:
            raise ConfigError(
                f"convert to {to}: no conversion exists, {given[0]} has no effect; leave it out"
            )
        spec = read_imu(*find_datasheet("imu", unit, Path()))
        tuning = parameters.TUNINGS[to]
        text = (
            f"no conversion exists: the process noise of {tuning.title} is tuned for a whole vehicle, with "
            "its vibration and timing."
        )
        note = tuning.note or "The noise of the IMU, at the step of the filter, is a lower bound."
        sentences = [text, note, f"definitions: {tuning.source}"]
        print_findings(console, sentences, [FindingTable(to, "", parameters.bound_tuning(spec, to))])
        return
    converted = exchanging.convert_unit(unit, to=to, **options)
    console.print(converted.text, markup=False, highlight=False, soft_wrap=True, end="")
    head = "lost: " if to is not None else ""
    for line in converted.lost:
        console.print(f"{head}{line}", markup=False, highlight=False, soft_wrap=True)
    program = parameters.PROGRAMS[converted.program]
    for line in (program.note, f"definitions: {program.source}"):
        if line:
            console.print(line, markup=False, highlight=False, soft_wrap=True)
    if options["out"] is not None:
        console.print(f"Wrote {options['out']}", soft_wrap=True)


def export_run(folder: Path, *, console: Console, **options: Any) -> None:
    """Export a run and print the names of the files; options as for `bench.cli.exchanging.export_run`."""
    out = exchanging.export_run(folder, **options)
    names = sorted(path.name for path in out.glob("[!.]*"))
    console.print(f"{out}: {', '.join(names)}", soft_wrap=True)


def score_solution(solution: Path, folder: Path, *, console: Console, **options: Any) -> dict[str, Any]:
    """Evaluate a solution on a run, print its metrics beside the metrics of the run, and return them.

    For ``options`` see `bench.cli.exchanging.score_solution`.
    """
    score = exchanging.score_solution(solution, folder, **options)
    run, label = score.run, score.label
    console.print(f"{one_line(run.profile['title'])}: seed {run.seed}, run {run.run}, {run.evaluation}")
    result_table.print_screen(
        console, {**run.metrics, label: score.metrics}, {**run.solutions, label: score.solution}
    )
    instants = f"{len(score.solution)} epochs, {score.rows} rows"
    console.print(f"{label} covers {100 * score.coverage:.4g} % of the {instants}")
    for kind in ("table", "interpolated"):
        for _, _, text in score.solution.events.select(kind):
            console.print(f"{label}: {text}")
    if options["out"] is not None:
        console.print(f"Wrote {options['out']}")
    return dict(score.metrics)


def stream_run(folder: Path, *, console: Console, **options: Any) -> None:
    """Send the sensor data of a run, and print address and timing; options as for `exchanging.stream_run`."""
    sent = exchanging.stream_run(folder, progress=lambda now: console.print(str(now)), **options)
    pace = "" if sent.latest is None else f", none more than {1e3 * sent.latest:.3g} ms late"
    console.print(f"{sent.messages} messages in {sent.seconds:.3g} s{pace}")


def tabulate_allan(curve: AllanCurve, name: str = "datasheet") -> FindingTable:
    """Return a measured Allan deviation as a table, beside the datasheet or the fit, as ``name`` calls it."""
    unit, factor = SHOWN_UNITS[curve.triad]
    columns: dict[str, list[Any]] = {"tau [s]": curve.tau.tolist()}
    columns["measured"] = (factor * curve.measured).tolist()
    if curve.terms:
        low, ratio, high = (x / curve.expected for x in (curve.low, curve.measured, curve.high))
        columns[name] = (factor * curve.expected).tolist()
        columns["ratio (99.9 % band)"] = [
            ShownFigure(f"{one:.3f}", f"{least:.3f} to {most:.3f}", outside=not least <= one <= most)
            for least, one, most in zip(low, ratio, high, strict=True)
        ]
    columns["degrees of freedom"] = [round(value) for value in curve.edf.tolist()]
    return FindingTable(curve.triad, f"{curve.triad}, Allan deviation in {unit}", columns)
