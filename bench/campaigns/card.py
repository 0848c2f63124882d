"""The card of an estimator: what a fixed suite of flights says of it, beside a built-in filter."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from bench import pipeline, store
from bench.campaigns.card_lines import (
    COUNT,
    Line,
    Rows,
    judge_flight,
    list_values,
    measure_speed,
    write_figure,
)
from bench.campaigns.card_suite import FULL, LATE, QUICK, VERSION, Suite, hash_suite
from bench.campaigns.plan import Plan, hash_estimator, plan_campaign
from bench.campaigns.running import Progress, run_campaign
from bench.config.tables import ROWS, Table, check_table
from bench.errors import ConfigError, EstimatorError, EstimatorFailedError
from bench.exchange.solution_folder import write_sensors
from bench.files import read_json
from bench.navigation.causality import measure_look_ahead
from bench.specs import DEFAULT_GUARD, Guard
from bench.wording import one_line

AGAINST = "loose-full"
"""The filter that others are compared with."""

_INSTANTS = 5  # at which the future is changed
_SAME = 1e-6  # relative difference of a value that is the same, on another processor for example

YARDSTICK = "free-inertial"
"""The estimator whose CPU time is the unit of speed: the bare integration of the same IMU samples."""


class Card(Table):
    """What an estimator achieves in the suite; equal inputs give equal lines."""

    estimator: str
    against: str
    suite: str  # version and extent
    suite_hash: str  # of flights, sensors and draws: only cards with equal hashes compare
    draws: int  # of each flight
    versions: dict[str, str]
    lines: Annotated[tuple[Line, ...], ROWS]
    speed: Line | None  # measured anew each time
    use: str = ""  # what was run, as -e takes it
    seed: int | None = None  # of all draws; None: those of the profiles
    program: str = ""  # hash of the source, or of the program, and of its options
    commands: dict[str, str] = Field(default_factory=dict)  # by flight: what repeats its first draw

    @property
    def sentences(self) -> tuple[str, ...]:
        """The lines in words."""
        return tuple(line.sentence for line in (*self.lines, *([self.speed] if self.speed else [])))

    @property
    def summary(self) -> str:
        """The card in a sentence."""
        by_topic: dict[str, list[Line]] = {}
        for line in self.lines:
            by_topic.setdefault(line.topic, []).append(line)
        counts = [line for line in by_topic["convergence"] if line.word == COUNT]
        good = [value for line in counts for value in line.by_draw if value is not None]
        parts = [f"{self.estimator} converged in {sum(good):.0f} of {len(good)} draws"]
        words = [line.word for line in by_topic.get("honesty", ())]
        found = [f"{word} on {words.count(word)}" for word in dict.fromkeys(words)]
        if found:
            parts.append(f"is {', '.join(found)} of {len(words)} flights")
        ratios = [line.value for line in by_topic.get("accuracy", ()) if line.value is not None]
        if ratios:
            least, most = (write_figure(end(ratios)) for end in (min, max))
            parts.append(f"has {least} to {most} times the horizontal error of {self.against}")
        return f"{', '.join(parts[:-1])} and {parts[-1]}." if len(parts) > 1 else f"{parts[0]}."


def write_suite(folder: str | Path, *, quick: bool = False) -> Path:
    """Write the sensor data of every flight and draw of the suite, for solutions that are made elsewhere.

    Each draw has a folder with the tables as ``bench export --to csv`` writes them, in ``sensors``. With a
    ``solution.csv`` beside them in every one, ``make_card("file:FOLDER")`` judges the solutions.

    Parameters
    ----------
    folder : str or Path
        A new folder.
    quick : bool
        As for :func:`make_card`.

    Raises
    ------
    bench.errors.ConfigError
        If the folder exists.
    OSError
        If a file cannot be written; nothing is left behind.
    """
    folder = Path(folder)
    store.check_folder(folder, force=False, kind=store.EXPORT)
    suite = QUICK if quick else FULL
    plan = plan_campaign(replace(suite, estimators=(YARDSTICK,)))
    draws = []
    with store.make_folder(folder, kind=store.EXPORT) as partial:
        for one in plan.runs:
            cell = plan.cells[one.cell]
            sensed = pipeline.sense(cell.profile, pipeline.fly(cell.profile), one.run)
            place = write_sensors(partial, sensed.data, sensed.initial)
            draws.append(
                {"folder": place.name, "flight": suite.members[cell.condition].name, "draw": one.run}
            )
        suite_hash = hash_suite(plan)
        store.write_json(partial / "suite.json", {"suite": suite.name, "hash": suite_hash, "draws": draws})
    return folder


def make_card(
    estimator: str,
    *,
    against: str = AGAINST,
    quick: bool = False,
    guard: Guard = DEFAULT_GUARD,
    seed: int | None = None,
    runs: Path | None = None,
    jobs: int | None = None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> Card:
    """Judge an estimator over the suite, draw by draw beside another one.

    Parameters
    ----------
    estimator : str
        Built-in name, ``module:Class``, ``command:./program {sensors} {solution}``, or ``file:FOLDER`` with a
        solution for each draw that :func:`write_suite` wrote.
    against : str
        The one to compare with.
    quick : bool
        Seven flights of 8 draws instead of thirteen of 40.
    guard : Guard
        What programs and classes of others may take, and whether a class gets a process of its own.
    seed : int or None
        Of all draws; None: those of the profiles.
    runs : Path or None
        Folder that keeps the runs; those that are there are not made again.
    jobs, progress
        As for `bench.campaigns.running.run_campaign`.

    Raises
    ------
    bench.errors.ConfigError, bench.errors.EstimatorError
        If an estimator cannot be built.
    """
    suite = replace(QUICK if quick else FULL, seed=seed)
    plan, labels = _plan(suite, estimator, against, guard)
    own, other, yardstick = labels
    resume = runs is not None and runs.is_dir()
    result = run_campaign(plan, jobs=jobs, folder=runs, resume=resume, progress=progress)
    rows, cpu = result.runs.to_pylist(), result.estimator_cpu_s

    def select(name: str, label: str) -> Rows:
        number = [flight.name for flight in suite.members].index(name)
        return [row for row in rows if (row["condition"], row["estimator"]) == (number, label)]

    lines: list[Line] = []
    for flight in suite.members:
        beside = select(flight.name, other) if other != own else []
        without = select(flight.without, own) if flight.without else []
        lines += judge_flight(flight, select(flight.name, own), beside, other, without)
    lines.append(_judge_causality(plan, suite, own))
    return Card(
        estimator=own,
        against=other,
        suite=f"{VERSION}, {'quick' if quick else 'full'}",
        suite_hash=hash_suite(plan),
        draws=suite.runs,
        versions=dict(store.list_versions()),
        lines=tuple(lines),
        speed=measure_speed(cpu.get(own, ()), cpu.get(yardstick, ()), yardstick),
        use=estimator,
        seed=seed,
        program=hash_estimator(plan, own),
        commands={flight.name: select(flight.name, own)[0]["command"] for flight in suite.members},
    )


def _judge_causality(plan: Plan, suite: Suite, label: str) -> Line:
    """Return how far an estimator looks ahead, on the flight whose fixes come late or else on the first."""
    names = [flight.name for flight in suite.members]
    number = names.index(LATE) if LATE in names else 0
    profile = next(cell.profile for cell in plan.cells if cell.condition == number)
    (choice,) = (one for one in profile.estimators if one.label == label)
    value = None
    if choice.use.startswith("file:"):
        text = "uses the future: not proven, its answers were made elsewhere"
    else:
        truth = pipeline.fly(profile)
        one, other = (pipeline.sense(profile, truth, run) for run in range(2))
        fixes, rng = one.data.fixes, np.random.default_rng(profile.seed)
        assert fixes is not None  # every flight of the suite has them
        before = fixes.t_arrival - np.median(np.diff(one.data.imu.t))  # where the next fix has not arrived
        instants = np.sort(rng.choice(before[len(before) // 5 :], _INSTANTS, replace=False))
        try:
            found = measure_look_ahead(
                lambda data: pipeline.navigate(choice, data, one.initial), one.data, other.data, instants
            )
            text, value = found.text, found.seconds if found.repeatable else None
        except (ValueError, EstimatorError, EstimatorFailedError) as error:
            text = f"uses the future: not proven, {one_line(str(error))[:200]}"
    return Line(
        topic="causality", flight=names[number], figure="look-ahead [s]", value=value, low=value, high=value,
        sentence=f"{names[number]}: {text}.",
    )  # fmt: skip


def _plan(suite: Suite, estimator: str, against: str, guard: Guard) -> tuple[Plan, tuple[str, str, str]]:
    """Return the plan of a suite, and the labels of the estimator, of the other one and of the yardstick."""
    uses = tuple(dict.fromkeys((estimator, against, YARDSTICK)))
    plan = plan_campaign(replace(suite, estimators=uses), guard=guard)
    labels = [choice.label for choice in plan.cells[0].profile.estimators]
    own, other, yardstick = (labels[uses.index(use)] for use in (estimator, against, YARDSTICK))
    return plan, (own, other, yardstick)


def verify_card(
    card: Card,
    draws: int = 8,
    *,
    guard: Guard = DEFAULT_GUARD,
    jobs: int | None = None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> list[str]:
    """Run drawn runs of a card again; return what differs from it, in a sentence each.

    Parameters
    ----------
    card : Card
        The runs to repeat are drawn anew at each call: nobody can know them before.
    draws : int
        So many of them, each with the errors and the NEES of its lines.
    guard, jobs, progress
        As for :func:`make_card`.

    Raises
    ------
    bench.errors.ConfigError
        If the suite is not that of the card, or the card does not say what it ran.
    """
    if not card.use:
        raise ConfigError("the card does not say which estimator it ran; make it with this version of bench")
    suite = replace(QUICK if card.suite.endswith("quick") else FULL, seed=card.seed)
    plan, (own, *_) = _plan(suite, card.use, card.use, guard)
    if hash_suite(plan) != card.suite_hash:
        raise ConfigError(f"the card is of suite {card.suite_hash}; here it is {hash_suite(plan)}")
    chosen = secrets.SystemRandom().sample(range(len(plan.runs)), min(draws, len(plan.runs)))
    again = replace(plan, runs=tuple(plan.runs[k] for k in sorted(chosen)))
    found = []
    if card.program != hash_estimator(plan, own):
        found.append(f"{card.use} is not the program that the card names: {card.program}")
    by_name = {(line.topic, line.flight): line for line in card.lines if line.word != COUNT}
    for row in run_campaign(again, jobs=jobs, progress=progress).runs.to_pylist():
        flight = suite.members[row["condition"]].name
        for topic, value in list_values(row).items() if row["estimator"] == own else ():
            line = by_name.get((topic, flight))
            said = line.by_draw[row["run"]] if line and row["run"] < len(line.by_draw) else None
            if line and not _same_value(said, value):
                shown = " and ".join(write_figure(one) for one in (said, value))
                found.append(f"{flight}, draw {row['run']}: {line.figure}: card and repetition {shown}")
    return found


def _same_value(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is other
    return bool(np.isclose(one, other, rtol=_SAME, atol=0.0))


def describe_suite(card: Card) -> str:
    """Return what the figures stand on, in words."""
    return f"suite {card.suite}, {card.suite_hash}, {card.draws} draws of each flight; 95 % intervals"


def read_card(path: Path) -> Card:
    """Read a card from a file.

    Raises
    ------
    ConfigError
        If the file is not a card.
    """
    card = check_table(Card, read_json(path), str(path))
    if not any(line.topic == "convergence" for line in card.lines):
        raise ConfigError(f"{path}: no card: none of its lines has the topic 'convergence'")
    return card
