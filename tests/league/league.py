"""Run the filters of the league on their suites, on the same noise, and judge them as the card does."""

from __future__ import annotations

import os
import platform
import secrets
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench import pipeline
from bench.core.records.specs import Guard
from bench.core.words.exceptions import EstimatorError, EstimatorFailedError
from bench.evaluation.conventions.convention_search import find_mistakes
from bench.experiments.campaigns.plan import Plan, plan_campaign
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.campaigns.running import run_campaign
from bench.experiments.card.card_causality import judge_causality
from bench.experiments.card.card_conventions import judge_conventions
from bench.experiments.card.card_lines import compare_rms, judge_flight, measure_speed
from bench.experiments.card.card_making import YARDSTICK
from bench.experiments.card.card_suite import Suite, hash_suite
from bench.io import results
from tests.league.entries import AUDIT, HELD, SUITES, Entry, find_reference
from tests.measured import name_processor, stamp

IN_PROCESS = Guard(in_process=True)
_TOPICS = ("accuracy", "velocity", "tilt", "heading", "outages", "honesty")
_STAND_IN = np.deg2rad([5.0, 5.0, 10.0])  # sigma of an attitude without a covariance [rad]
_AUDIT_NUMBER = 1  # of the audit, so that equal inputs give equal rows


def plan_suite(suite: Suite, uses: Sequence[str]) -> Plan:
    """Return the plan of a suite for these filters."""
    return plan_campaign(replace(suite, estimators=tuple(dict.fromkeys(uses))), guard=IN_PROCESS)


def fly(plan: Plan) -> Any:
    """Return the campaign of a plan, run in this process."""
    return run_campaign(plan, pool=ExecutorPool(SerialExecutor(), 1))


def make_league(
    only: Sequence[str] = (), seed: int | None = None, runs: int | None = None, audit: bool = True
) -> dict[str, Any]:
    """Return the league: a row for each filter that is installed, with the reason if it failed.

    Parameters
    ----------
    only : sequence of str
        Names of filters; all if empty. The references fly along.
    seed : int, optional
        Draws other places, headings, winds, noises and times of outages. Default: the suite's own.
    runs : int, optional
        Runs of each flight.
    audit : bool
        Whether to prove causality.
    """
    begun = sum(os.times()[:4])
    rows: list[dict[str, Any]] = []
    hashes = {}
    for kind, (suite, entries) in SUITES.items():
        wanted = [one for one in entries if not only or one.label in only]
        if not wanted:
            continue
        suite = replace(suite, draw_seed=seed, draws=runs or suite.draws)
        found, hashes[kind] = _judge_suite(kind, suite, wanted, audit)
        rows += found
    return {
        "format": 1, "stamp": stamp(), "seed": seed, "versions": dict(results.list_versions()),
        "suites": hashes, "flights": {kind: [one.name for one in SUITES[kind][0].members] for kind in hashes},
        "references": {kind: find_reference(kind) for kind in hashes},
        "machine": f"{platform.machine()}, {platform.system()}, {name_processor()}",
        "cpu_s": sum(os.times()[:4]) - begun, "rows": rows,
    }  # fmt: skip


def _judge_suite(
    kind: str, suite: Suite, wanted: Sequence[Entry], audit: bool
) -> tuple[list[dict[str, Any]], str]:
    present = [one for one in wanted if one.version]
    reference = find_reference(kind)
    plan = plan_suite(suite, [*(one.use for one in present), reference, YARDSTICK])
    campaign = fly(plan)
    flown, cpu = campaign.runs.to_pylist(), campaign.estimator_cpu_s
    proof = replace(AUDIT, draw_seed=suite.draw_seed)
    proof_plan = plan_suite(proof, [one.use for one in present] or [reference])
    proven = fly(proof_plan).runs.to_pylist() if audit else []
    made = []
    for one in wanted:
        row: dict[str, Any] = {"kind": kind, "filter": one.label, "package": one.package or "bench"}
        row |= {"version": one.version, "told": one.told, "whole": one.whole, "runs": suite.draws}
        row["command"] = _write_command(one.label, suite)
        made.append(row)
        if not one.version:
            row["failed"] = f"{one.package} is not installed"
            continue
        own = [_select(suite, flown, number, one.label) for number in range(len(suite.members))]
        row["failed"] = next(
            (str(each.get("reason")) for rows in own for each in rows if not each["converged"]), ""
        )
        row["converged"] = sum(each["converged"] for rows in own for each in rows)
        row["answers"] = [[each.get("answers") for each in rows] for rows in own]
        row["scores"] = _score(suite, flown, own, one.label, reference)
        row["robustness"] = _compare_faults(suite, row["scores"], HELD[kind])
        speed = measure_speed(cpu.get(one.label, ()), cpu[YARDSTICK], YARDSTICK)
        row["speed"] = [speed.value, speed.low, speed.high] if speed else None
        row["conventions"] = (
            _search_whole(plan, suite, one.label, own)
            if "honesty" in row["scores"].get(suite.members[0].name, {})
            else _search_attitude(plan, suite, one.label)
        )
        if audit:
            mine = [[each for each in proven if each["estimator"] == one.label]]
            line = judge_causality(proof_plan, proof, one.label, mine, 0.0, _AUDIT_NUMBER)
            row["look_ahead_s"] = line.value
            row["causality"] = line.sentence.partition("uses the future: ")[2].partition("; audit")[0]
    return made, hash_suite(plan)


def _search_whole(plan: Plan, suite: Suite, label: str, own: Sequence[Any]) -> str:
    """Return which wrong convention explains a broken covariance, as a card does, or "none found"."""
    found = judge_conventions(plan, suite, label, own)
    return found[0].sentence if found else "none found"


def _search_attitude(plan: Plan, suite: Suite, label: str) -> str:
    """Return which wrong convention explains the first run of the first flight, or "none found".

    The filter reports no covariance, so its attitude is searched as if its sigma were `_STAND_IN`.
    """
    profile = suite.profile_of(plan, 0, 0)
    (choice,) = (one for one in profile.estimators if one.label == label)
    truth = pipeline.fly(profile)
    sensed = pipeline.sense(profile, truth)
    try:
        solution = pipeline.navigate(choice, sensed.data, sensed.initial)
    except (ValueError, EstimatorError, EstimatorFailedError) as error:
        return f"not searched: {error}"
    cov = np.full((len(solution), 9, 9), np.nan)
    cov[:, 6:, 6:] = np.diag(np.square(_STAND_IN))
    found = find_mistakes(
        [truth], [replace(solution, cov=cov)], sensed.data.antenna_b, profile.evaluation.begin
    )
    return str(found["why_text"]) if found else "none found"


def _score(
    suite: Suite, flown: Sequence[Any], own: Sequence[Any], label: str, reference: str
) -> dict[str, dict[str, Any]]:
    """Return value, interval and sentence by flight and topic."""
    scores: dict[str, dict[str, Any]] = {}
    for number, flight in enumerate(suite.members):
        beside = _select(suite, flown, number, reference)
        for line in judge_flight(flight, own[number], beside, reference, []):
            if line.topic in _TOPICS:
                place = scores.setdefault(flight.name, {})
                place[line.topic] = {
                    "value": line.value, "low": line.low, "high": line.high, "word": line.word,
                    "sentence": line.sentence, "parts": line.parts, "by_run": list(line.by_draw),
                }  # fmt: skip
    return scores


def _compare_faults(suite: Suite, scores: dict[str, Any], topic: str) -> list[float] | None:
    """Return the error with faults over the filter's own without them, same runs, and its interval."""
    for flight in suite.members:
        errors = [scores.get(name, {}).get(topic) for name in (flight.name, flight.without)]
        if flight.without and all(errors):
            ratio = compare_rms(*(one["by_run"] for one in errors))
            return None if ratio is None else [ratio.value, ratio.low, ratio.high]
    return None


def _select(suite: Suite, flown: Sequence[Any], number: int, label: str) -> list[Any]:
    return [row for row in flown if row["estimator"] == label and suite.locate(row["condition"])[0] == number]


def _write_command(label: str, suite: Suite) -> str:
    seed = "" if suite.draw_seed is None else f" --seed {suite.draw_seed}"
    return f"python -m tests.league --only {label} --runs {suite.draws}{seed}"


def verify_league(league: dict[str, Any], count: int = 3) -> tuple[list[str], list[str]]:
    """Repeat random runs of a league; return what was repeated, and each difference in a sentence.

    The bits of all that a filter answered are compared by their hash.
    """
    places = [
        (row, flight, run)
        for row in league["rows"]
        for flight, hashes in enumerate(row.get("answers", ()))
        for run, said in enumerate(hashes)
        if said
    ]
    repeated, found = [], []
    for row, flight, run in secrets.SystemRandom().sample(places, min(count, len(places))):
        suite, entries = SUITES[row["kind"]]
        suite = replace(suite, draw_seed=league["seed"], draws=row["runs"])
        (entry,) = (one for one in entries if one.label == row["filter"])
        plan = plan_suite(suite, [entry.use])
        again = replace(plan, runs=(plan.runs[flight * suite.draws + run],))
        (fresh,) = (one for one in fly(again).runs.to_pylist() if one["estimator"] == entry.label)
        place = f"{entry.label}, {suite.members[flight].name}, run {run}"
        repeated.append(place)
        if fresh.get("answers") != row["answers"][flight][run]:
            found.append(f"{place}: {fresh.get('answers')} instead of {row['answers'][flight][run]}")
    return repeated, found
