"""The line of a card about the look-ahead of a filter.

The hashes of all solutions are stored first. Then a random run of each flight is repeated in a process of its
own, and its bits must equal the stored ones. A filter that runs in pieces gets the data that have arrived
until each epoch. For other filters, the data that arrive later are changed.
"""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np

from bench import pipeline
from bench.core.records.data import NavSolution, SensorData
from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import EstimatorError, EstimatorFailedError
from bench.core.words.wording import format_count, one_line
from bench.experiments.campaigns.plan import Plan
from bench.experiments.campaigns.worker import hash_answers
from bench.experiments.card.card_lines import UNPROVEN, Line, Rows
from bench.experiments.card.card_suite import LATE, Suite
from bench.navigation.built_in import BUILT_IN
from bench.navigation.causality import find_late, measure_look_ahead, reverse_values
from bench.navigation.engine.record_cuts import longest_wait
from bench.navigation.estimator import Estimator, answer
from bench.navigation.open_filters import PieceFilter

_MOST = 8  # times of a flight after which the data change
_BEGIN = 0.2  # of a record: its first part
_BEFORE, _WELL_IN, _AFTER = 2.0, 0.3, 5.0  # an outage or a fault [s], part of it, and after it [s]
_SHARE = 0.1  # of the epochs end a piece
_AT_LATE = 3  # times at which answers in pieces differ
_OTHER = 1 << 30  # no card has the noise of a run from this number on


def hash_all_answers(own: Rows) -> str:
    """Return a hash of all bits of the solutions of a filter."""
    return hashlib.sha256(" ".join(str(row.get("answers")) for row in own).encode()).hexdigest()[:16]


def judge_causality(
    plan: Plan, suite: Suite, label: str, own: Sequence[Rows], cpu_s: float, number: int | None = None
) -> Line:
    """Return the look-ahead of a filter in a random run of each flight, until the first that shows one.

    ``own`` are its rows of each flight, ``cpu_s`` is the CPU time of the card [s]. ``number`` selects
    the runs; None: a random number, which the line contains.
    """
    names = [flight.name for flight in suite.members]
    home = names.index(LATE) if LATE in names else 0
    (choice,) = (one for one in suite.profile_of(plan, home, 0).estimators if one.label == label)
    if choice.use.startswith("file:"):
        return _make_line(names[home], "not proven, its solution is a file")
    number = secrets.randbits(48) if number is None else number
    seed = int(hash_all_answers([row for rows in own for row in rows]), 16)
    audit, begun = _Audit(choice, np.random.default_rng([number, seed])), sum(os.times()[:4])
    for k in sorted(range(len(names)), key=lambda k: k != home):
        place = f"{f', on {names[k]}' if k != home else ''}; audit {number}"
        try:
            seconds, text = audit.examine(plan, suite, k, own[k])
        except (ValueError, EstimatorError, EstimatorFailedError) as error:
            return _make_line(names[home], f"not proven, {one_line(str(error))[:200]}{place}", None, UNPROVEN)
        if seconds:
            return _make_line(names[home], f"{text}{place}", seconds)
    share = (sum(os.times()[:4]) - begun) / cpu_s if cpu_s else np.inf
    return _make_line(names[home], f"no; {audit.describe()}; audit {number}, {share:.2g} times the CPU", 0.0)


def _make_line(flight: str, text: str, value: float | None = None, word: str = "") -> Line:
    return Line(
        topic="causality", flight=flight, figure="look-ahead [s]", value=value, low=value, high=value,
        sentence=f"{flight}: uses the future: {text}.", word=word,
    )  # fmt: skip


class _Audit:
    """Runs of a filter that are repeated, and what was done with each."""

    def __init__(self, choice: EstimatorChoice, rng: np.random.Generator) -> None:
        self.choice, self.rng = choice, rng
        self.fed = self.changed = self.instants = self.processes = self.others = 0
        self.place = ""  # where a filter runs that is not of bench

    def describe(self) -> str:
        """Return what the runs show, in words."""
        fed, changed = format_count(self.fed, "run"), format_count(self.changed, "run")
        told = [f"fed in pieces in {fed}"] if self.fed else []
        told += [f"other data after {self.instants} times in {changed}"] if self.changed else []
        if self.others:
            told.append(f"in pieces its solution differs in {format_count(self.others, 'run')}")
        chance = 100.0 * (1.0 - 0.9 ** (self.fed + self.changed))
        return f"{', '.join(told)}{self.place}; a look-ahead in 1 of 10 runs is found with {chance:.0f} %"

    @contextmanager
    def build(self) -> Iterator[Estimator]:
        """Provide the filter in a process of its own, which cannot know another run."""
        self.processes += 1
        label = f"{self.choice.label} {self.processes}"  # a process is kept by its label
        one = pipeline.build_estimator(replace(self.choice, label=label))
        if self.choice.use not in BUILT_IN:
            self.place = f", {'confined' if getattr(one, 'confined', False) else 'not confined'}"
        try:
            yield one
        finally:
            getattr(one, "close", lambda: None)()

    def examine(self, plan: Plan, suite: Suite, flight: int, own: Rows) -> tuple[float, str]:
        """Return the look-ahead [s] in a random run of a flight, also in words; errors if not proven."""
        good = [k for k, row in enumerate(own) if row["converged"]] or list(range(len(own)))
        draw = int(self.rng.choice(good))
        profile = suite.profile_of(plan, flight, draw)
        truth, sensors = pipeline.fly(profile), profile.sensors
        one = pipeline.sense(profile, truth)

        def run(data: SensorData) -> NavSolution:
            with self.build() as built:
                return answer(built, self.choice.label, data, one.initial)

        first = run(one.data)
        if hash_answers(first) != own[draw].get("answers"):
            same = hash_answers(run(one.data)) == hash_answers(first)
            raise ValueError("its answers depend on other runs" if same else "it is not repeatable")
        late: list[float] | None = None  # it cannot be fed
        with suppress(EstimatorError), self.build() as built:
            use, options, wait = self.choice.use, self.choice.options, longest_wait(one.data)
            filter_ = PieceFilter(use, options, built, one.initial, wait)
            late = find_late(filter_, one.data, first, self.rng.random(len(first)) < _SHARE)
        if late == []:
            self.fed += 1
            return 0.0, "no"
        spans = [*sensors.gnss_outages, *((fault.start, fault.end) for fault in sensors.faults)]
        instants = choose_instants(one.data, spans, self.rng)
        if late:  # it looks ahead there, or differs in pieces
            self.others += 1
            instants = [late[0], *self.rng.choice(late, min(len(late), _AT_LATE)).tolist(), *instants]
        self.changed, self.instants = self.changed + 1, self.instants + len(instants)
        calm = replace(profile, sensors=replace(sensors, faults=(), gnss_outages=()))
        others = [
            pipeline.sense(spec, truth, int(self.rng.integers(_OTHER, 2 * _OTHER))).data
            for spec in ([calm, profile] if spans else [profile])
        ]
        with suppress(EstimatorFailedError):  # the filter fails at the jump to another motion
            return measure_look_ahead(run, first, one.data, [reverse_values(one) for one in others], instants)
        return measure_look_ahead(run, first, one.data, others, instants)


def choose_instants(
    data: SensorData, spans: Iterable[tuple[float, float]], rng: np.random.Generator
) -> list[float]:
    """Return up to `_MOST` random times [s]: in the first part of a record, the rest, and around ``spans``.

    Those are outages and faults. The times are one IMU sample before a fix arrives, if one does.
    """
    begin, middle, end = np.quantile(data.output_t, (0.0, _BEGIN, 1.0)).tolist()
    parts = [(begin, middle), (middle, end)]
    around = [
        (max(low, begin), min(high, end))
        for first, last in spans
        for low, high in (
            (first - _BEFORE, first), (first + _WELL_IN * (last - first), last), (last, last + _AFTER)
        )
        if max(low, begin) < min(high, end)
    ]  # fmt: skip
    parts += [around[k] for k in rng.permutation(len(around))[: _MOST - len(parts)]]
    arrival = np.sort(data.fixes.t_arrival) if data.fixes is not None else np.empty(0)
    before = np.append(arrival - np.median(np.diff(data.imu.t)), np.inf)
    drawn = [(at, high) for low, high in parts for at in [rng.uniform(low, high)]]
    fixes = before[np.searchsorted(before, [at for at, _ in drawn])].tolist()
    return [fix if fix < high else at for fix, (at, high) in zip(fixes, drawn, strict=True)]
