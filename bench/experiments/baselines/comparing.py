"""Compare finished results: folders of runs, of logs, and of campaigns, run by run."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_number
from bench.evaluation.metrics.run_metrics import find_metric
from bench.experiments.baselines.baseline_draws import (
    STRETCHES,
    EstimatorDraw,
    collect_draw,
    collect_stretch,
    is_watched,
    join_draws,
)
from bench.experiments.baselines.baseline_file import Baseline, EstimatorValues, get_name
from bench.experiments.baselines.digests import digest_record
from bench.experiments.baselines.verdict_rows import (
    ERROR,
    SAME,
    UncorrectedVerdict,
    Verdict,
    Word,
    compare,
    decide,
)
from bench.experiments.campaigns.stored import read_campaign
from bench.io import results

ONE_DRAW = "one run: no interval"
"""Note of a verdict on single runs."""

_MOST_DIFFERENCES = 8  # that are named
_MANY = 1_000_000  # epochs: the share of a campaign's run is compared as it is


@dataclass(frozen=True)
class Side:
    """Contents of a folder in a comparison."""

    name: str
    draws: Mapping[str, Baseline]  # by profile
    documents: Mapping[str, Mapping[str, Any]]  # the profiles as flown
    digests: Mapping[str, str]  # of the truth, by profile; a campaign holds none


@dataclass(frozen=True)
class Compared:
    """Comparison of the first folder with another: differences, and a verdict on each metric."""

    first: str
    other: str
    differences: tuple[str, ...]  # of what was run, in words; empty if only the code or the noise may differ
    verdicts: tuple[Verdict, ...]  # "old" is the first, "new" the other
    sentences: tuple[str, ...]  # on the horizontal position of each filter, and on what did not converge


def compare_results(folders: Sequence[str | os.PathLike[str]]) -> list[Compared]:
    """Compare the first results folder with each other one, by the rules of `bench.check`.

    Runs with the same seed and number on the same flight are paired; so are the segments of a log. Filters
    are compared by label. If no label is in both folders and each folder has one filter, these two are
    compared.

    Parameters
    ----------
    folders : sequence of str or Path
        Two or more results folders, folders that contain results folders, or folders of campaigns.

    Returns
    -------
    list of Compared
        ``first``, ``other``, ``differences`` of the setup, ``verdicts`` and sentences.

    Raises
    ------
    bench.ConfigError
        If there are fewer than two folders, one contains no results, or two have nothing in common.

    Examples
    --------
    >>> import bench, tempfile
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = bench.write_result(result, place + "/a", recording=False, report=False)
    ...     [found] = bench.compare_results([folder, folder])
    >>> {one.word for one in found.verdicts}
    {'same'}
    """
    if len(folders) < 2:
        raise ConfigError("a comparison needs at least two folders")
    first, *others = (_read_side(Path(folder)) for folder in folders)
    return [compare_sides(first, other) for other in others]


# --- reading ------------------------------------------------------------------------------------------


def _read_side(folder: Path) -> Side:
    if (folder / results.CAMPAIGN_RESULT).is_file():
        return _read_campaign(folder)
    if folder.is_file():
        raise ConfigError(f"{folder}: is a file; name its folder, {folder.parent}")
    paths = [folder] if (folder / results.RESULT).is_file() else sorted(folder.glob(f"*/{results.RESULT}"))
    if not paths:
        raise ConfigError(f"{folder}: contains no results. Run 'bench run' or 'bench campaign' first")
    loaded = [results.read_result(path if path == folder else path.parent) for path in paths]
    by_profile: dict[str, list[RunResult]] = {}
    for result in loaded:
        by_profile.setdefault(result.name or str(result.profile["title"]), []).append(result)
    draws = {name: _collect_runs(found) for name, found in by_profile.items()}
    return Side(
        str(folder),
        draws,
        {name: found[0].profile for name, found in by_profile.items()},
        {
            name: digest_record(found[0].truth)
            for name, found in by_profile.items()
            if found[0].truth is not None
        },
    )


def _collect_runs(runs: Sequence[RunResult]) -> Baseline:
    """Return the runs of one profile; a single log gives a run for each of its segments."""
    first = runs[0]
    if "log" in first.more:
        assert first.sensors is not None  # a results folder has them
        start, end = first.evaluation.begin, float(first.sensors.imu.t.max())
        keys = [f"segment {k}" for k in range(STRETCHES)]
        rows = [
            {label: collect_stretch(first, label, k, start, end) for label in first.errors}
            for k in range(STRETCHES)
        ]
        truth = digest_record([first.sensors])
    else:
        ordered = sorted(runs, key=lambda one: (one.seed, one.run))
        keys = [f"seed {one.seed}, run {one.run}" for one in ordered]
        rows = [{label: collect_draw(one, label) for label in one.metrics} for one in ordered]
        truth = _describe_flight(first.profile)
    labels = [label for label in rows[0] if all(label in row for row in rows)]
    return _make_draws(
        first.provenance.get("versions", {}),
        truth,
        keys,
        {label: join_draws([row[label] for row in rows]) for label in labels},
    )


def _read_campaign(folder: Path) -> Side:
    found = read_campaign(folder)
    rows = found.runs.to_pylist()
    draws, documents = {}, {}
    for number, condition in enumerate(found.conditions):
        here = [row for row in rows if row["condition"] == number]
        if not here:
            continue
        source = get_name(condition["profile"])
        varied = ", ".join(f"{key} = {value}" for key, value in condition["values"].items())
        name = f"{source}, {varied}" if varied and len(found.conditions) > 1 else source
        labels = list(dict.fromkeys(row["estimator"] for row in here))
        keys = list(dict.fromkeys(f"seed {row['seed']}, run {row['run']}" for row in here))
        draws[name] = _make_draws(
            found.provenance["versions"],
            _describe_flight(condition["as_flown"]),
            keys,
            {
                label: join_draws([_collect_row(row) for row in here if row["estimator"] == label])
                for label in labels
            },
        )
        documents[name] = condition["as_flown"]
    return Side(str(folder), draws, documents, {})


_NOT_FLOWN = ("title", "sensors", "assumed", "estimator", "evaluation", "faults", "fault", "gnss_outage")
"""Parts of a profile that the truth does not depend on."""


_SENSED = ("sensors", "faults", "fault", "gnss_outage")
"""Parts of a profile that its sensor data depend on, besides the truth and the seed."""


def _take_sensed(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of a profile on which its sensor data depend, without the assumed datasheets."""
    units = {key: value for key, value in (document.get("sensors") or {}).items() if key != "assumed"}
    return {key: document.get(key) or None for key in _SENSED} | {"sensors": units}


def _describe_flight(document: Mapping[str, Any]) -> str:
    """Return the part of a profile on which the truth depends, as text."""
    return results.to_json({key: value for key, value in document.items() if key not in _NOT_FLOWN})


def _collect_row(row: Mapping[str, Any]) -> EstimatorDraw:
    """Return the metrics of a filter in a run of a campaign, without NIS: rows lack its expected value."""
    watched = {
        name: value
        for name, value in row.items()
        if is_watched(name) and not name.startswith("nis_") and not row["failed"]
    }
    expected = {"nees_mean": float(row["nees_states"])} if row.get("nees_states") else {}
    return EstimatorDraw(bool(row["converged"]), row["reason"] or "", watched, expected, _MANY)


def _make_draws(
    versions: Mapping[str, str], truth: str, keys: Sequence[str], estimators: Mapping[str, EstimatorValues]
) -> Baseline:
    return Baseline(
        profile="",
        requested=None,
        seed=0,
        versions=dict(versions),
        truth=truth,
        sensors=tuple(keys),
        estimators=dict(estimators),
    )


# --- comparing ----------------------------------------------------------------------------------------


def compare_sides(first: Side, other: Side) -> Compared:
    """Compare the runs of two sides, in pairs if truth and noise are the same."""
    pairs = [(name, name) for name in first.draws if name in other.draws]
    if not pairs and len(first.draws) == len(other.draws) == 1:
        pairs = [(next(iter(first.draws)), next(iter(other.draws)))]
    if not pairs:
        raise ConfigError(
            f"no common profile: {first.name} has {', '.join(first.draws)}; "
            f"{other.name} has {', '.join(other.draws)}"
        )
    candidates: list[UncorrectedVerdict] = []
    differences: list[str] = []
    shown: dict[tuple[str, str], str] = {}  # profile and filter of a row -> as a sentence names them
    lost: list[str] = []
    for one, two in pairs:
        old, new, labels = _match(first, other, one, two)
        differences += _list_differences(first, other, one, two)
        if min(old.draws, new.draws) > 1:
            changed = _take_sensed(first.documents[one]) != _take_sensed(other.documents[two])
            found = compare(old, new, one, changed=changed)
        else:
            found = list(_compare_single(old, new, one))
        candidates += [
            replace(row, row=replace(row.row, estimator=labels[row.row.estimator])) for row in found
        ]
        place = f" on {one}" if len(pairs) > 1 else ""
        shown |= {(one, label): f"{label}{place}" for label in labels.values()}
        for label, name in labels.items():
            lost += [
                f"{name}{place}: in {side.name} {text}"
                for side, draws in ((first, old), (other, new))
                if (text := _describe_lost(draws.estimators[label]))
            ]
    verdicts = tuple(decide(candidates, ERROR))
    rows = {(row.profile, row.estimator): row for row in verdicts if row.metric == "pos_rmse_h_m"}
    return Compared(
        first.name,
        other.name,
        tuple(dict.fromkeys(differences)),
        verdicts,
        (*(_describe(name, rows.get(key), first.name, other.name) for key, name in shown.items()), *lost),
    )


def _describe_lost(values: EstimatorValues) -> str:
    """Return the number of runs that did not converge, and the reason of the first; "" if all converged."""
    lost = [k for k, good in enumerate(values.converged) if not good]
    if not lost:
        return ""
    return (
        f"{len(lost)} of {len(values.converged)} runs diverged or failed, "
        f"the first: {values.reasons[lost[0]]}"
    )


def _match(first: Side, other: Side, one: str, two: str) -> tuple[Baseline, Baseline, dict[str, str]]:
    """Return the runs to compare (the common runs, if any), and the names of the filters."""
    old, new = first.draws[one], other.draws[two]
    if _is_flown_differently(first, other, one, two):
        new = new.model_copy(update={"truth": "flown differently"})
    labels = {label: label for label in old.estimators if label in new.estimators}
    if not labels and len(old.estimators) == len(new.estimators) == 1:
        (label,), (its,) = old.estimators, new.estimators
        labels = {label: f"{label}, {its}"}
        new = new.model_copy(update={"estimators": {label: new.estimators[its]}})
    if not labels:
        raise ConfigError(
            f"{other.name}: has no filter in common with {first.name}: {', '.join(new.estimators)} "
            f"and {', '.join(old.estimators)}"
        )
    common = [key for key in old.sensors if key in new.sensors] if old.truth == new.truth else []
    if common:
        old, new = (_select(side, common) for side in (old, new))
    chosen = {label: old.estimators[label] for label in labels}
    return old.model_copy(update={"estimators": chosen}), new, labels


def _is_flown_differently(first: Side, other: Side, one: str, two: str) -> bool:
    """Return whether two truths of the same profile are known to differ."""
    known = first.digests.get(one), other.digests.get(two)
    same = first.draws[one].truth == other.draws[two].truth
    return same and None not in known and known[0] != known[1]


def _select(side: Baseline, keys: Sequence[str]) -> Baseline:
    """Return a side with only the runs of these keys."""
    rows = [side.sensors.index(key) for key in keys]
    estimators = {
        label: values.model_copy(
            update={
                "converged": tuple(values.converged[k] for k in rows),
                "metrics": {name: tuple(row[k] for k in rows) for name, row in values.metrics.items()},
                "reasons": tuple(values.reasons[k] for k in rows) if values.reasons else (),
            }
        )
        for label, values in side.estimators.items()
    }
    return side.model_copy(update={"sensors": tuple(keys), "estimators": estimators})


def _compare_single(old: Baseline, new: Baseline, name: str) -> Iterator[UncorrectedVerdict]:
    """Yield both values of each metric of single runs: the same, or undecided."""
    for label, before in old.estimators.items():
        after = new.estimators[label]
        for metric in before.metrics:
            a, b = before.metrics[metric][0], after.metrics.get(metric, (None,))[0]
            if a is None or b is None:
                continue
            known = find_metric(metric)
            same = abs(b - a) <= SAME * max(abs(a), abs(b))
            word: Word = "same" if same else "undecided"
            unit = known.unit if known else "1"
            paired = old.truth == new.truth and old.sensors == new.sensors
            row = Verdict(name, label, metric, unit, word, a, b, None, None, None, False, 1, paired, ONE_DRAW)
            yield UncorrectedVerdict(row, certain=True)


def _describe(estimator: str, row: Verdict | None, first: str, other: str) -> str:
    """Describe the verdict on the horizontal error, without adding to the table."""
    if row is None:
        return f"{estimator}: no horizontal error to compare"
    old, new = (f"{format_number(value)} m in {name}" for value, name in ((row.old, first), (row.new, other)))
    values = f"{estimator}: horizontal error {old}, {new}"
    if row.note == ONE_DRAW:
        return f"{values}; one run each, which do not separate chance from a difference"
    word = f"{other} is {row.word}" if row.word in ("better", "worse") else row.told
    change = f"{row.format_change()} by {row.draws} {'pairs' if row.paired else 'draws each'}{row.rare}"
    return ", ".join(filter(None, [f"{values}: {word}", change if row.change is not None else "", row.note]))


def _list_differences(first: Side, other: Side, one: str, two: str) -> list[str]:
    """Return the differences between the inputs of both sides, in words."""
    old, new = first.draws[one], other.draws[two]
    found = [] if one == two else [f"profile: {one} and {two}"]
    if _is_flown_differently(first, other, one, two):
        found.append("truth: the same profile was flown differently")
    elif old.truth != new.truth:
        found.insert(0, "the flight: figures of different flights do not compare the filters")
    before, after = (dict(_flatten(side.documents[name])) for side, name in ((first, one), (other, two)))
    found += [
        f"{key}: {_show(before.get(key))} and {_show(after.get(key))}"
        for key in dict.fromkeys([*before, *after])
        if (before.get(key) or None) != (after.get(key) or None)
        and not key.startswith(("title", "estimator"))
    ]
    if old.sensors != new.sensors:
        shared = len(set(old.sensors) & set(new.sensors))
        found.append(f"runs: {old.draws} and {new.draws}, {shared or 'none'} in both")
    if old.estimators.keys() & new.estimators.keys():
        for side, its, others in ((first, old, new), (other, new, old)):
            if alone := [label for label in its.estimators if label not in others.estimators]:
                found.append(f"only in {side.name}: {', '.join(alone)}")
    found += [
        f"{name}: {old.versions.get(name)} and {new.versions.get(name)}"
        for name in dict.fromkeys([*old.versions, *new.versions])
        if old.versions.get(name) != new.versions.get(name)
    ]
    if len(found) > _MOST_DIFFERENCES:
        found = [*found[:_MOST_DIFFERENCES], f"and {len(found) - _MOST_DIFFERENCES} more"]
    return found


def _flatten(document: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted key and value of every leaf of a document."""
    if isinstance(document, Mapping):
        for name, inner in document.items():
            yield from _flatten(inner, f"{key}.{name}" if key else str(name))
    elif (
        isinstance(document, list | tuple)
        and document
        and any(isinstance(item, Mapping) for item in document)
    ):
        for k, item in enumerate(document, 1):
            yield from _flatten(item, f"{key}.{k}")
    else:
        yield key, list(document) if isinstance(document, tuple) else document


def _show(value: Any) -> str:
    return "none" if value in (None, [], {}) else str(value)[:60]
