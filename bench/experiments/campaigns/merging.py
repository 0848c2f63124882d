"""Merge several campaigns into one, for the report of a comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from bench.core.words.exceptions import ConfigError
from bench.experiments.campaigns.outcome import Campaign
from bench.experiments.campaigns.plan import Condition


def merge_campaigns(campaigns: Mapping[str, Campaign]) -> Campaign:
    """Return one campaign with the filters of several, each filter with the name of its campaign.

    The conditions are those that all have in common. Campaigns of one condition each are merged whatever
    it is; the merged one describes the flight of the first.

    Parameters
    ----------
    campaigns : mapping of str to Campaign
        Campaigns by name.

    Raises
    ------
    bench.ConfigError
        If they have no condition in common.
    """
    (name, first), *_ = campaigns.items()
    by_condition = {name: _number_conditions(one) for name, one in campaigns.items()}
    common = [key for key in by_condition[name] if all(key in keys for keys in by_condition.values())]
    if all(len(one.conditions) == 1 for one in campaigns.values()):
        places = {name: {0: 0} for name in campaigns}
    elif common:
        places = {name: {keys[key]: k for k, key in enumerate(common)} for name, keys in by_condition.items()}
    else:
        raise ConfigError(f"{' and '.join(campaigns)}: not drawn over each other, no condition is in all")
    kept = [first.conditions[number] for number in places[name]]
    heads = [_name_condition(one) for one in kept]
    outcomes, comparisons = [], []
    for name, one in campaigns.items():
        known = {_name_condition(one.conditions[old]): heads[new] for old, new in places[name].items()}
        outcomes += [
            (row.label, replace(row, label=f"{row.label}, {name}", condition=known[row.condition]))
            for row in one.outcomes
            if row.condition in known
        ]
        comparisons += [
            replace(row, first=f"{row.first}, {name}", second=f"{row.second}, {name}")
            for row in one.comparisons
        ]
    order = {head: k for k, head in enumerate(heads)}
    labels = list(dict.fromkeys(row.label for one in campaigns.values() for row in one.outcomes))
    return Campaign(
        outcomes=tuple(
            row
            for _, row in sorted(outcomes, key=lambda pair: (order[pair[1].condition], labels.index(pair[0])))
        ),
        comparisons=tuple(comparisons),
        runs=_join({name: one.runs for name, one in campaigns.items()}, places),
        epochs=_join({name: one.epochs for name, one in campaigns.items()}, places),
        planned=sum(one.planned for one in campaigns.values()),
        finished=sum(one.finished for one in campaigns.values()),
        failed={command: text for one in campaigns.values() for command, text in one.failed.items()},
        conditions=tuple(kept),
        provenance={
            f"{name}: {key}": value
            for name, one in campaigns.items()
            for key, value in one.provenance.items()
        },
        timing={},
        interrupted=any(one.interrupted for one in campaigns.values()),
        folder=None,
    )


def _name_condition(condition: Mapping[str, Any]) -> str:
    return Condition(condition["profile"], condition["values"]).name


def _number_conditions(campaign: Campaign) -> dict[str, int]:
    return {_name_condition(one): number for number, one in enumerate(campaign.conditions)}


def _join(tables: Mapping[str, Any], places: Mapping[str, Mapping[int, int]]) -> Any:
    """Return the rows of all tables for the kept conditions; filters get the name of their table."""
    columns: dict[str, list[Any]] = {}
    for name, table in tables.items():
        rows = table.to_pydict()
        kept = [k for k, number in enumerate(rows["condition"]) if number in places[name]]
        rows["condition"] = [places[name].get(number) for number in rows["condition"]]
        rows["estimator"] = [f"{label}, {name}" for label in rows["estimator"]]
        count = len(next(iter(columns.values()), []))
        for key in dict.fromkeys([*columns, *rows]):
            new: Sequence[Any] = rows.get(key, [None] * len(rows["estimator"]))
            columns.setdefault(key, [None] * count).extend(new[k] for k in kept)
    return type(next(iter(tables.values()))).from_pydict(columns)
