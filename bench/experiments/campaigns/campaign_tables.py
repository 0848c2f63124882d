"""The tables of a campaign: a row for each run and filter, and statistics over runs at each time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics.units import unit_of
from bench.core.words.wording import format_value
from bench.evaluation.consistency.chi_square import mean_band
from bench.evaluation.ensembles.ensemble import CONFIDENCE
from bench.evaluation.metrics.run_metrics import find_metric
from bench.experiments.campaigns.groups import PERCENTILES, Done, Group
from bench.experiments.campaigns.plan import Condition, Plan
from bench.experiments.campaigns.worker import CHANNELS
from bench.io import results
from bench.io.results.row_parts import join_blocks, stack_rows

RUNS, EPOCHS = "runs.parquet", "epochs.parquet"
"""Names of the tables."""

_BLOCK = 10_000  # rows of a table that are not yet columns


def write_runs(path: Path, plan: Plan, done: Done) -> None:
    """Write the table of runs from the rows of the journal.

    A run that failed as a whole has a row for each filter, with the reason and without metrics.
    """
    heads = [describe_condition(number, one) for number, one in enumerate(plan.conditions)]
    blocks, rows = list[dict[str, Any]](), list[dict[str, Any]]()
    for planned, row in done:
        cell = plan.cells[planned.cell]
        for choice in cell.profile.estimators:
            lost = {"converged": False, "reason": row.get("error"), "failed": True}
            head = {
                **heads[cell.condition],
                "seed": cell.profile.seed,
                "run": planned.run,
                "estimator": choice.label,
                "command": cell.repeat(planned.run),
                "failed": False,
            }
            rows.append(head | (row["estimators"][choice.label]["metrics"] if "estimators" in row else lost))
        if len(rows) >= _BLOCK:
            blocks.append(stack_rows(rows))
            rows = []
    blocks.append(stack_rows(rows))
    columns = join_blocks(blocks)
    known = {name: find_metric(name) for name in columns}
    units = {name: metric.unit for name, metric in known.items() if metric is not None}
    results.write_table(path, columns, _find_units(plan) | units)


def write_epochs(path: Path, plan: Plan, parts: Sequence[Mapping[str, Any]]) -> None:
    """Write the statistics of :func:`describe_instants` for each group."""
    names = dict.fromkeys(name for part in parts for name in part)
    columns: dict[str, Any] = {}
    for name in names:
        found = [part.get(name, [None] * len(part["t_s"])) for part in parts]
        exact = all(isinstance(column, np.ndarray) for column in found)
        columns[name] = np.concatenate(found) if exact else [value for column in found for value in column]
    units = {"t_s": "s"}
    for channel, unit in CHANNELS.items():
        units |= {name: unit for name in columns if name.startswith(f"{channel}_")}
    results.write_table(path, columns, _find_units(plan) | units, confidence=CONFIDENCE)


def describe_instants(group: Group) -> dict[str, Any]:
    """Return the statistics over the runs that converged, at each time, in single precision."""
    t, runs = group.t, int(group.converged.sum())
    head = describe_condition(group.number, group.condition) | {"estimator": group.label, "runs": runs}
    columns: dict[str, Any] = {name: [value] * len(t) for name, value in head.items()} | {"t_s": t}
    for k, channel in enumerate(CHANNELS):
        columns[f"{channel}_mean"] = group.mean[:, k]
        for percent, values in zip(PERCENTILES, group.percentiles, strict=True):
            columns[f"{channel}_p{percent:02d}"] = values[:, k]
    band = mean_band(group.states, runs, CONFIDENCE) if runs and group.states else (np.nan, np.nan)
    columns |= {f"nees_{end}": np.full(len(t), edge) for end, edge in zip(("low", "high"), band, strict=True)}
    single = {name: np.asarray(column, np.float32) for name, column in columns.items() if name not in head}
    return columns | single | {"t_s": t}


def describe_condition(number: int, condition: Condition) -> dict[str, Any]:
    """Return the first columns of the rows of a condition."""
    values = {
        key: value if isinstance(value, str | int | float | bool) else format_value(value)
        for key, value in condition.values.items()
    }
    return {"condition": number, "profile": condition.source, **values}


def _find_units(plan: Plan) -> dict[str, str]:
    """Return the units of the values that are varied."""
    keys = dict.fromkeys(key for condition in plan.conditions for key in condition.values)
    return {key: unit for key in keys if (unit := unit_of(key))}
