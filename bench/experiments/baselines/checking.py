"""Record baselines, and check the code against the baselines."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.core.files import durable
from bench.core.records.specs import DEFAULT_GUARD, Guard
from bench.core.words.exceptions import ConfigError
from bench.core.words.stages import Progress, Stage, ignore
from bench.core.words.wording import suggest
from bench.experiments.baselines.baseline_draws import (
    Draw,
    Experiment,
    lose_draw,
    make_baseline,
    open_experiment,
)
from bench.experiments.baselines.baseline_file import (
    CPU,
    LEAST_DRAWS,
    Baseline,
    get_name,
    is_same_source,
    read_baseline,
    write_baseline,
)
from bench.experiments.baselines.verdict_rows import LOOKS, UncorrectedVerdict, Verdict, compare, decide
from bench.experiments.campaigns.batches import Lost, Pool, compute
from bench.experiments.campaigns.pools import open_pool
from bench.io.config.checks import is_code

DIRECTORY = Path("tests/baselines")
"""Default folder of the baselines of ``bench check``."""

DRAWS = LOOKS[-1]
"""Number of runs of a new baseline; a check flies the first of them, and more only to decide."""

CHANGES = "CHANGES.md"
"""File in the folder of the baselines that says why each number moved."""

_HEADING = """# Changes of the accuracy baselines

One line per record: *date filters, profile: metric old -> new; cause.*

"""

_NOT_EVALUATED = "nothing to compare with, as of an autopilot that has used every fix"


@dataclass
class MeasuredRuns:
    """An experiment with the runs measured so far."""

    experiment: Experiment
    requested: Sequence[str] | None
    progress: Progress | None
    overrides: Mapping[str, Any]
    draws: list[Draw] = field(default_factory=list)

    def measure(self, count: int, pool: Pool) -> Baseline:
        """Measure up to a number of runs and return their values."""
        known, found = len(self.draws), dict[int, Draw]()
        self._show(known, count)
        self.experiment.prepare()
        if self.experiment.draws is not None:
            pool = open_pool(1)
        first = () if known else (0,)  # compiles what the others load
        for k, draw in compute(self.experiment.measure, range(known, count), pool, first):
            found[k] = lose_draw(self.experiment, draw.reason) if isinstance(draw, Lost) else draw
            self._show(known + len(found), count)
        self.draws += [found[k] for k in range(len(found))]
        return make_baseline(self.experiment, self.draws[:count], self.requested, self.overrides)

    def _show(self, done: int, count: int) -> None:
        if self.progress:
            self.progress(Stage(self.experiment.name, done, count, "runs"))

    def find_unjudged(self) -> list[str]:
        """Return the filters that did not fail and have no value in any run.

        Raises
        ------
        ConfigError
            If one failed in every run, or no other is left.
        """
        name, found = self.experiment.name, list[str]()
        for label, first in self.draws[0].estimators.items():
            rows = [draw.estimators[label] for draw in self.draws]
            if any(value is not None for row in rows for value in row.metrics.values()):
                continue
            if not first.converged:
                raise ConfigError(
                    f"{name}: {label} has no value in {len(rows)} runs, nothing to compare "
                    f"with; run 0: {first.reason}"
                )
            found.append(label)
        if len(found) == len(self.draws[0].estimators):
            raise ConfigError(f"{name}: {', '.join(found)}: {_NOT_EVALUATED}; -e names a filter to record")
        return found


def record_baselines(
    profiles: Sequence[str] = (),
    *,
    directory: str | Path = DIRECTORY,
    estimators: Sequence[str] | None = None,
    runs: int | None = None,
    reason: str = "",
    overrides: Mapping[str, Any] | None = None,
    cpu: bool = False,
    allow_code: bool = False,
    guard: Guard = DEFAULT_GUARD,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Path]:
    """Run profiles, write their baselines and a line each for ``CHANGES.md``, and return the files.

    Parameters
    ----------
    profiles : sequence of str, optional
        Names or paths of profiles and logs. Default: all that have a baseline.
    directory : str or Path, optional
        Folder of the baselines, one ``PROFILE.json`` each.
    estimators : sequence of str, optional
        Filters to record. Default: as in the old baseline, or of the profile.
    runs : int, optional
        Number of runs, at least `LEAST_DRAWS`. Default: `DRAWS`.
    reason : str, optional
        Why the values changed, for ``CHANGES.md``.
    overrides : mapping, optional
        Profile keys to replace; stored in the baseline. Default: as in the old baseline.
    cpu : bool, optional
        Record CPU time, too (`baseline_file.CPU`). A baseline that has it keeps it.
    allow_code, guard, jobs, progress
        See `check`. ``progress`` also gets a remark for each filter that is left out, such as the solution
        of an autopilot that has used every fix.

    Returns
    -------
    list of Path
        The baselines.

    Raises
    ------
    ConfigError
        If a profile is missing or wrong, two have one name, or there are too few runs: checked before
        anything is flown. If a filter failed in every run.
    """
    if runs is not None and runs < LEAST_DRAWS:
        raise ConfigError(f"runs = {runs} must be at least {LEAST_DRAWS}: the interval comes from the spread")
    directory = Path(directory)
    before = {path.stem: read_baseline(path) for path in sorted(directory.glob("*.json"))}
    asked = _name_sources(profiles or list(before), before)
    if not asked:
        raise ConfigError(f"{directory}: no baseline to record again; name a profile")
    measured = []
    for name, source in asked.items():
        old = before.get(name)
        requested = old.requested if old and estimators is None else estimators
        given = (old.overrides if old else {}) if overrides is None else overrides
        timed = cpu or (old is not None and has_cpu(old))
        measured.append(_open(source, requested, estimators, allow_code, guard, progress, given, cpu=timed))
    paths = []
    with open_pool(jobs) as pool:
        for one in measured:
            count = one.experiment.draws or runs or DRAWS
            baseline = one.measure(count, pool)
            unjudged = one.find_unjudged()
            for label in unjudged:
                (progress or ignore)(Stage(f"{one.experiment.name}: {label} is left out: {_NOT_EVALUATED}"))
            kept = {label: row for label, row in baseline.estimators.items() if label not in unjudged}
            baseline = baseline.model_copy(update={"estimators": kept})
            paths.append(write_baseline(directory, baseline))
            write_change(directory, before.get(one.experiment.name), baseline, reason)
    return paths


def _name_sources(given: Sequence[str], baselines: Mapping[str, Baseline]) -> dict[str, str]:
    """Return profiles and logs by name, with the source of the baseline for a bare name; reject clashes."""
    named: dict[str, str] = {}
    for source in given:
        name = get_name(source)
        whole = baselines[name].profile if source == name and name in baselines else source
        first = named.setdefault(name, whole)
        if not is_same_source(first, whole):
            raise ConfigError(
                f"{first} and {whole} have one name, {name!r}, and so one baseline; rename one of them"
            )
    return named


def _open(
    source: str,
    requested: Sequence[str] | None,
    named: Sequence[str] | None,
    allow_code: bool,
    guard: Guard,
    progress: Progress | None,
    overrides: Mapping[str, Any],
    *,
    cpu: bool,
) -> MeasuredRuns:
    """Open a profile with the filters of its baseline; code needs permission or the user's own -e."""
    code = [use for use in requested or () if is_code(use) and use not in (named or ())]
    if code and not allow_code:
        raise ConfigError(
            f"{source}: its baseline names {code[0][:60]!r}, which runs code on this machine; "
            "--allow-code permits it"
        )
    experiment = open_experiment(source, requested, allow_code, guard, overrides, cpu)
    return MeasuredRuns(experiment, requested, progress, overrides)


def has_cpu(baseline: Baseline) -> bool:
    """Return whether a baseline contains CPU times."""
    return any(CPU in values.metrics for values in baseline.estimators.values())


def write_change(directory: Path, old: Baseline | None, new: Baseline, reason: str) -> None:
    """Add a line to ``CHANGES.md``: the largest changes of each filter, and the cause."""
    today = datetime.date.today().isoformat()
    name = get_name(new.profile)
    if old is None:
        lines = [f"*{today} {', '.join(new.estimators)}, {name}: first record, {new.draws} runs.*"]
    else:
        cause = reason or "say here why"
        rows = [one for one in compare(old, new, name, numbered=True) if one.side or not one.certain]
        rows.sort(key=lambda one: -abs(one.row.change or 0.0))
        moved: dict[str, list[UncorrectedVerdict]] = {label: [] for label in new.estimators}
        for one in rows:
            moved.setdefault(one.row.estimator, []).append(one)
        lines = [
            f"*{today} {label}, {name}: {_describe_rows(found, old.tolerance)}; {cause}.*"
            for label, found in moved.items()
        ]
    path = directory / CHANGES
    text = path.read_text(encoding="utf-8") if path.is_file() else _HEADING
    durable.write(path, text + "".join(f"{line}\n" for line in lines))


def _describe_rows(candidates: Sequence[UncorrectedVerdict], tolerance: float, most: int = 3) -> str:
    """Return the values that changed by more than the tolerance, the largest changes first."""
    if not candidates:
        return "recorded again, no number moved"
    rows = [one.row for one in candidates if one.side]
    if not rows:
        numbers = "1 number" if len(candidates) == 1 else f"{len(candidates)} numbers"
        return f"recorded again, {numbers} moved, none by more than {100 * tolerance:g} %"
    shown = [f"{row.metric} {row.old:.4g} -> {row.new:.4g}" for row in rows[:most] if row.old is not None]
    more = f", and {len(rows) - most} more" if len(rows) > most else ""
    return ", ".join(shown) + more


def check(
    profiles: Sequence[str] = (),
    *,
    directory: str | Path = DIRECTORY,
    estimators: Sequence[str] | None = None,
    runs: int | None = None,
    overrides: Mapping[str, Any] | None = None,
    allow_code: bool = False,
    guard: Guard = DEFAULT_GUARD,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Verdict]:
    """Run the profiles that have a baseline and compare every metric with it, run by run.

    The first 20 runs of each profile are compared. While a metric is undecided and its baseline has more
    runs, the number of runs doubles.

    Parameters
    ----------
    profiles : sequence of str, optional
        Names or paths of profiles and logs. Default: all that have a baseline.
    directory : str or Path, optional
        Folder of the baselines, one ``PROFILE.json`` each. Default: ``tests/baselines``.
    estimators : sequence of str, optional
        Filters to check. Default: all of the baselines.
    runs : int, optional
        Runs of the first comparison.
    overrides : mapping, optional
        Profile keys to replace, in addition to the keys of the baseline.
    allow_code : bool, optional
        Permit profiles and baselines to run code they name. Default: no.
    guard : Guard, optional
        Limits for programs and classes.
    jobs : int, optional
        Number of processes. Default: 1.
    progress : callable, optional
        Called with a `Stage` at the start and after each run.

    Returns
    -------
    list of Verdict
        ``word`` ("same", "better", "worse", "undecided"), the values ``old`` and ``new``, the ``change`` with
        its interval, and a ``sentence``.

    Raises
    ------
    bench.ConfigError
        If a baseline or profile is missing or wrong, or a file differs from the recorded one. Checked before
        anything is flown.

    Examples
    --------
    >>> import bench
    >>> verdicts = bench.check(["figure-eight"])  # doctest: +SKIP
    >>> {one.word for one in verdicts}  # doctest: +SKIP
    {'same'}
    """
    if runs is not None and runs < 2:
        raise ConfigError(f"runs = {runs} must be at least 2")
    directory = Path(directory)
    known = sorted(path.stem for path in directory.glob("*.json"))
    if not known:
        raise ConfigError(f"{directory}: no baseline (*.json) in it; 'bench check --record' makes one")
    wanted = list(dict.fromkeys(get_name(name) for name in profiles)) or known
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise ConfigError(
            *(f"{directory}: no baseline {name!r}{suggest(name, known, 'baselines')}" for name in unknown)
        )
    baselines = {name: read_baseline(directory / f"{name}.json") for name in wanted}
    for name, source in _name_sources(profiles, baselines).items():
        there = baselines[name].profile
        if Path(source).is_file() and not is_same_source(source, there):
            raise ConfigError(
                f"{directory / name}.json: is the baseline of {there}, not of {source}; "
                f"'bench check {name}' checks {there}, --baselines names another folder"
            )
    measured = {}
    for name, baseline in baselines.items():
        chosen, requested = _choose(baseline, estimators, directory / f"{name}.json")
        baselines[name] = chosen
        given = {**baseline.overrides, **(overrides or {})}
        measured[name] = _open(
            chosen.profile, requested, estimators, allow_code, guard, progress, given, cpu=has_cpu(chosen)
        )
    looks = sorted({runs or LOOKS[0], *LOOKS})
    found: dict[str, list[UncorrectedVerdict]] = {}
    words: dict[tuple[str, str, str], Verdict] = {}
    unsure = set(baselines)
    with open_pool(jobs) as pool:
        for look in looks[looks.index(runs or LOOKS[0]) :][: len(LOOKS)]:
            for name in sorted(unsure):
                count = min(look, baselines[name].draws)
                new = measured[name].measure(count, pool)
                found[name] = compare(baselines[name], new, name, numbered=True)
            everything = [one for name in baselines for one in found[name]]
            for verdict in decide(everything):
                key = (verdict.profile, verdict.estimator, verdict.metric)
                if key not in words or words[key].word == "undecided":
                    words[key] = verdict
            unsure = {
                row.profile
                for row in words.values()
                if row.word == "undecided" and baselines[row.profile].draws > look
            }
            if not unsure:
                break
    return list(words.values())


def _choose(
    baseline: Baseline, estimators: Sequence[str] | None, path: Path
) -> tuple[Baseline, Sequence[str] | None]:
    """Return a baseline with only some of its filters, and the filters to request from the profile."""
    if estimators is None:
        return baseline, baseline.requested
    labels = list(baseline.estimators)
    by_request = dict(zip(baseline.requested or labels, labels, strict=False))
    unknown = [use for use in estimators if use not in labels and use not in by_request]
    if unknown:
        raise ConfigError(
            *(f"{path}: no filter {use!r}{suggest(use, labels, 'filters')}" for use in unknown),
            "--record -e writes a baseline of another filter",
        )
    wanted = [by_request.get(use, use) for use in estimators]
    chosen = {label: row for label, row in baseline.estimators.items() if label in wanted}
    requests = [use for use, label in by_request.items() if label in wanted]
    return baseline.model_copy(update={"estimators": chosen}), requests
