"""Read a finished campaign back."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench import store
from bench.campaigns.campaign_tables import EPOCHS, RUNS
from bench.campaigns.outcome import Outcome
from bench.campaigns.running import Campaign
from bench.errors import ConfigError
from bench.evaluation.consistency import MeanNis
from bench.evaluation.ensemble import Comparison, Estimate
from bench.evaluation.ensemble_consistency import Consistency


def load_campaign(folder: str | os.PathLike[str]) -> Campaign:
    """Read the folder of a campaign back.

    Raises
    ------
    bench.errors.ConfigError
        If the folder is not that of a campaign, or is damaged.
    """
    folder = Path(folder)
    with store.open_summary(folder, store.CAMPAIGN_RESULT, "campaign") as summary:
        with store.report_damage(folder):
            runs, epochs = (store.read_table(folder / name) for name in (RUNS, EPOCHS))
        return Campaign(
            outcomes=tuple(_read_outcome(row) for row in summary["outcomes"]),
            comparisons=tuple(
                Comparison(**{**row, "difference": Estimate(**row["difference"])})
                for row in summary["comparisons"]
            ),
            runs=runs,
            epochs=epochs,
            planned=int(summary["planned"]),
            finished=int(summary["finished"]),
            failed={str(command): str(reason) for command, reason in summary["failed"].items()},
            conditions=tuple(
                {
                    "profile": str(row["profile"]),
                    "values": dict(row["values"]),
                    "as_flown": dict(row["as_flown"]),
                }
                for row in summary["conditions"]
            ),
            estimator_cpu_s={label: list(values) for label, values in summary["estimator_cpu_s"].items()},
            provenance={name: summary[name] for name in store.provenance()},
            timing={name: float(value) for name, value in summary["timing"].items()},
            interrupted=int(summary["finished"]) < int(summary["planned"]),
            folder=folder,
        )


def _read_outcome(row: Mapping[str, Any]) -> Outcome:
    found = row["consistency"]
    if found is not None:
        nis = {name: MeanNis(**values) for name, values in found["nis"].items()}
        found = Consistency(**{**found, "nis": nis, "reasons": tuple(found["reasons"])})
    return Outcome(
        condition=str(row["condition"]),
        label=str(row["label"]),
        runs=int(row["runs"]),
        converged=Estimate(**row["converged"]),
        errors={name: Estimate(**values) for name, values in row["errors"].items()},
        consistency=found,
    )


def choose_runs(campaign: Campaign, which: Sequence[str]) -> dict[str, str]:
    """Return the commands of runs of a campaign of one condition by name.

    Parameters
    ----------
    which : sequence of str
        "best", "median" or "worst" by the horizontal error of the first estimator, or the number of a run.

    Raises
    ------
    bench.errors.ConfigError
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
