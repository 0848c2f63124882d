"""Read a finished campaign back."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench import store
from bench.campaigns.campaign_tables import EPOCHS, RUNS
from bench.campaigns.outcome import Outcome
from bench.campaigns.running import SUMMARY, Campaign
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
    path = folder / SUMMARY
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{folder}: no campaign, there is no {SUMMARY} in it") from None
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    with store.report_damage(folder):
        runs, epochs = (store.read_table(folder / name) for name in (RUNS, EPOCHS))
    try:
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
    except (KeyError, TypeError, ValueError, AttributeError):
        raise ConfigError(f"{path}: not written by this version of bench, or damaged") from None


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
