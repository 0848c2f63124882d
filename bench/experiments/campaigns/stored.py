"""Read a finished campaign from its folder."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, NonNegativeInt

from bench.core.words.exceptions import ConfigError
from bench.evaluation.consistency.chi_square import MeanNis
from bench.evaluation.ensembles.ensemble import Comparison, Estimate
from bench.evaluation.ensembles.ensemble_consistency import Consistency
from bench.evaluation.metrics.run_metrics import find_metric
from bench.experiments.campaigns.campaign_tables import EPOCHS, RUNS
from bench.experiments.campaigns.groups import PERCENTILES
from bench.experiments.campaigns.outcome import Campaign, Outcome
from bench.experiments.campaigns.worker import CHANNELS
from bench.io import results

_Number = Annotated[float, BeforeValidator(lambda value: np.nan if value is None else value)]
"""A number; null is what JSON has for one that is not finite."""


class _StoredPart(BaseModel):
    model_config = ConfigDict(strict=True)


class _StoredEstimate(_StoredPart):
    value: _Number
    low: _Number
    high: _Number


class _StoredMeanNis(_StoredPart):
    mean: _Number
    low: _Number
    high: _Number
    updates: NonNegativeInt


class _StoredConsistency(_StoredPart):
    states: NonNegativeInt
    runs: NonNegativeInt
    mean: _Number
    ratio: _Number
    low: _Number
    high: _Number
    word: str
    text: str = ""
    parts: dict[str, _StoredEstimate] = {}
    runs_to_decide: NonNegativeInt | None
    instants: list[int]
    anees: list[_Number]
    band: list[_Number]
    nis: dict[str, _StoredMeanNis]
    reasons: list[str]


class StoredOutcome(_StoredPart):
    """The outcome of one filter under one condition, as stored in the summary."""

    condition: str
    label: str
    runs: NonNegativeInt
    converged: _StoredEstimate
    errors: dict[str, _StoredEstimate]
    consistency: _StoredConsistency | None
    lost: str
    scatter: Sequence[str] = ()


class _StoredComparison(_StoredPart):
    first: str
    second: str
    unit: str
    difference: _StoredEstimate
    runs: NonNegativeInt
    size: _Number


class _Outage(_StoredPart):
    start_s: float
    duration_s: float


class _OnBoard(_StoredPart):
    imu: str | None = None


class _StoredFlown(_StoredPart):
    title: str = ""
    seed: int | None = None
    sensors: _OnBoard | None = None
    assumed: _OnBoard | None = None
    evaluation: dict[str, _Number]
    gnss_outage: list[_Outage] = []


class _StoredCondition(_StoredPart):
    profile: str
    values: dict[str, Any]
    as_flown: _StoredFlown


class _StoredSummary(_StoredPart):
    """The part of `campaign.json` that is read."""

    planned: NonNegativeInt
    finished: NonNegativeInt
    failed: dict[str, str]
    outcomes: list[StoredOutcome]
    comparisons: list[_StoredComparison]
    conditions: Annotated[list[_StoredCondition], Field(min_length=1)]
    estimator_cpu_s: dict[str, list[_Number]]
    timing: dict[str, _Number]
    versions: dict[str, str]


_HEAD: dict[str, str] = {"condition": "int64", "estimator": "string"}
_RUN = {**_HEAD, "profile": "string", "seed": "int64", "run": "int64", "command": "string", "failed": "bool"}
_ENDS = ("mean", *(f"p{percent:02d}" for percent in PERCENTILES))
_INSTANT = {"t_s": "double"} | {f"{channel}_{end}": "float" for channel in CHANNELS for end in _ENDS}
_INSTANT |= {"nees_low": "float", "nees_high": "float", **_HEAD}


def read_campaign(folder: str | os.PathLike[str]) -> Campaign:
    """Read the folder of a campaign.

    Parameters
    ----------
    folder : str or Path
        Folder that ``bench campaign`` or `bench.campaign` wrote.

    Returns
    -------
    Campaign
        Statistics and tables.

    Raises
    ------
    bench.ConfigError
        If the folder is not a campaign or is damaged.

    Examples
    --------
    >>> import bench, tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     found = bench.campaign("approach", 2, estimators=["loose-15"], jobs=1, out=place + "/a")
    ...     bench.read_campaign(place + "/a").sentences == found.sentences
    True
    """
    folder = Path(folder)
    with results.open_summary(folder, results.CAMPAIGN_RESULT, "campaign") as summary:
        found = _StoredSummary.model_validate(summary)
        with results.report_damage(folder):
            runs, epochs = (results.read_table(folder / name) for name in (RUNS, EPOCHS))
        check_columns(folder / RUNS, runs, _RUN)
        check_columns(folder / EPOCHS, epochs, _INSTANT)
        return Campaign(
            outcomes=tuple(map(make_outcome, found.outcomes)),
            comparisons=tuple(
                Comparison(
                    one.first, one.second, one.unit, _make_estimate(one.difference), one.runs, one.size
                )
                for one in found.comparisons
            ),
            runs=runs,
            epochs=epochs,
            planned=found.planned,
            finished=found.finished,
            failed=found.failed,
            conditions=tuple(
                {name: row[name] for name in ("profile", "values", "as_flown")}
                for row in summary["conditions"]
            ),
            estimator_cpu_s=found.estimator_cpu_s,
            provenance={name: summary[name] for name in results.provenance()},
            timing=found.timing,
            interrupted=found.finished < found.planned,
            folder=folder,
        )


def check_columns(path: Path, table: Any, wanted: Mapping[str, str]) -> None:
    """Raise ConfigError unless a table has columns of these types, and each metric is a finite number."""
    types = {field.name: str(field.type) for field in table.schema}
    for name, kind in wanted.items():
        if len(table) and types.get(name) != kind:
            found = f"is of type {types[name]}" if name in types else "is missing"
            raise ConfigError(f"{path}: damaged: column {name!r} {found}; it must be {kind}")
    for name in types:
        if name == "t_s" or (path.name == RUNS and find_metric(name) is not None):
            column = table.column(name)
            numbers = types[name] in ("double", "int64", "bool", "null")
            if not numbers or not np.isfinite(column.drop_null().to_numpy().astype(float)).all():
                raise ConfigError(f"{path}: damaged: column {name!r} must hold finite numbers")


def _make_estimate(row: _StoredEstimate) -> Estimate:
    return Estimate(row.value, row.low, row.high)


def make_outcome(row: StoredOutcome) -> Outcome:
    """Return an outcome from its stored row."""
    found = None
    if row.consistency is not None:
        values = dict(row.consistency)
        nis = {name: MeanNis(**dict(one)) for name, one in row.consistency.nis.items()}
        parts = {name: _make_estimate(one) for name, one in row.consistency.parts.items()}
        found = Consistency(
            **{
                **values,
                "nis": nis,
                "text": values["text"] or values["word"],
                "parts": parts,
                "reasons": tuple(values["reasons"]),
            }
        )
    errors = {name: _make_estimate(one) for name, one in row.errors.items()}
    rate, scatter = _make_estimate(row.converged), tuple(row.scatter)
    return Outcome(row.condition, row.label, row.runs, rate, errors, found, row.lost, scatter)


def choose_runs(campaign: Campaign, which: Sequence[str]) -> dict[str, str]:
    """Return the commands of runs of a campaign of one condition by name.

    Parameters
    ----------
    which : sequence of str
        "best", "median" or "worst" by the horizontal error of the first filter, or the number of a run.

    Raises
    ------
    bench.ConfigError
        If the campaign has several conditions or no such run.
    """
    if len(campaign.conditions) > 1:
        raise ConfigError(
            f"{campaign.folder}: has {len(campaign.conditions)} conditions, which have no flight in common; "
            "the command of each run is in runs.parquet"
        )
    rows = campaign.runs.to_pylist()
    first = [row for row in rows if row["estimator"] == rows[0]["estimator"]] if rows else []
    ordered = sorted(
        (row for row in first if row.get("pos_rmse_h_m") is not None), key=lambda row: row["pos_rmse_h_m"]
    )
    by_rank = {"best": 0, "median": len(ordered) // 2, "worst": -1} if ordered else {}
    by_number = {str(row["run"]): row for row in first}
    found = {}
    for name in which:
        row = ordered[by_rank[name]] if name in by_rank else by_number.get(name)
        if row is None:
            raise ConfigError(
                f"{campaign.folder}: has no run {name!r}; best, median, worst, or a number up to "
                f"{max(map(int, by_number), default=0)}"
            )
        found[f"run {row['run']}" if name == str(row["run"]) else f"{name}, run {row['run']}"] = row[
            "command"
        ]
    return found
