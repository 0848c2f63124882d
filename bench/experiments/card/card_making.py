"""The card of a filter: its results on a fixed suite of flights, beside a built-in filter."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from bench import pipeline
from bench.core.files.file_checks import read_json
from bench.core.records.specs import DEFAULT_GUARD, Guard
from bench.core.words.exceptions import ConfigError
from bench.core.words.notebook import draw, make_frame, write_sentences, write_table
from bench.core.words.renames import FORMAT, check_format
from bench.core.words.stages import Progress
from bench.core.words.wording import one_line
from bench.evaluation.ensembles.statement import state_uncertainty
from bench.evaluation.requirements.required_metrics import Finding
from bench.evaluation.requirements.share_test import MET
from bench.experiments.campaigns.plan import Plan, hash_estimator, plan_campaign
from bench.experiments.campaigns.running import run_campaign
from bench.experiments.card.card_bound import pool_bounds
from bench.experiments.card.card_causality import hash_all_answers, judge_causality
from bench.experiments.card.card_conventions import judge_conventions
from bench.experiments.card.card_lines import (
    COUNT,
    IMPOSSIBLE,
    SAME,
    SHARE,
    UNPROVEN,
    Line,
    Rows,
    judge_flight,
    list_values,
    measure_speed,
    write_figure,
)
from bench.experiments.card.card_requirements import judge_requirements, read_requirements
from bench.experiments.card.card_suite import FULL, QUICK, VERSION, Suite, hash_suite
from bench.io import results
from bench.io.config.profile import make_choice
from bench.io.config.tables import ROWS, Table, check_table
from bench.io.foreign.solution_folder import write_sensors

AGAINST = "loose-full"
"""The filter that others are compared with."""

YARDSTICK = "free-inertial"
"""The filter whose CPU time is the unit of speed: the bare integration of the same IMU samples."""


class LostDraw(Table):
    """A run that did not converge."""

    flight: str
    draw: int
    reason: str
    command: str  # that repeats it


class Card(Table):
    """Results of a filter on the suite; equal inputs give equal lines."""

    format: int = FORMAT
    estimator: str
    against: str
    suite: str  # version and extent
    suite_hash: str  # of flights, sensors and runs: only cards with equal hashes compare
    draws: int  # of each flight
    versions: dict[str, str]
    lines: Annotated[tuple[Line, ...], ROWS]
    speed: Line | None  # measured anew each time
    use: str = ""  # what was run, as -e takes it
    seed: int | None = None  # of all runs; None: the suite's own
    options: dict[str, Any] = Field(default_factory=dict)  # of the filter
    program: str = ""  # hash of the source, or of the program, and of its options
    answers: str = ""  # hash of all that it answered, every bit
    uncertainty: dict[str, Any] = Field(default_factory=dict)  # how the intervals follow, and from what
    commands: dict[str, str] = Field(default_factory=dict)  # by flight: what repeats its first run
    lost: Annotated[tuple[LostDraw, ...], ROWS] = ()  # runs that did not converge

    def __repr__(self) -> str:
        return f"<Card: {self.summary}>"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Return the summary, and a table of the lines."""
        names = ("flight", "topic", "value", "low", "high", "sentence")
        columns = {name: [getattr(one, name) for one in self.lines] for name in names}
        columns["in words"] = columns.pop("sentence")
        return write_sentences([self.summary]) + write_table(f"Card of {self.estimator}", columns)

    def frame(self) -> Any:
        """Return the lines as a pandas.DataFrame, a row for each score of a flight, with its interval."""
        names = ("topic", "flight", "figure", "value", "low", "high", "word", "sentence")
        return make_frame({name: [getattr(one, name) for one in self.lines] for name in names})

    def plot(self, topic: str = "accuracy", **look: Any) -> Any:
        """Draw a topic's ratios with their intervals on each flight; `look` as for `plot_result`."""
        return draw(self, topic, **look)

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
        shares = [line.value for line in by_topic.get("coverage", ()) if line.figure == SHARE]
        least = min((value for value in shares if value is not None), default=None)
        parts = []
        if least is not None:
            share = "all" if least == 1.0 else f"{100.0 * least:.4g} % or more of the"
            parts.append(f"has a solution at {share} epochs")
        counts = [line for line in by_topic["convergence"] if line.word == COUNT]
        good = [value for line in counts for value in line.by_draw if value is not None]
        parts.append(f"converged in {sum(good):.0f} of {len(good)} runs")
        words = [line.word for line in by_topic.get("honesty", ())]
        found = [f"{word} on {words.count(word)}" for word in dict.fromkeys(words)]
        if found:
            parts.append(f"is {', '.join(found)} of {len(words)} flights")
        ratios = [line.value for line in by_topic.get("accuracy", ()) if line.value is not None]
        if ratios and self.against != self.estimator:
            ends = " to ".join(write_figure(end(ratios)) for end in (min, max))
            parts.append(f"has {ends} times the horizontal error of {self.against}")
        parts += [
            f"{line.sentence.partition(': ')[2].rstrip('.')}"
            for line in by_topic.get("causality", ())
            if line.value != 0.0
        ]
        below = [line for line in self.lines if line.word == IMPOSSIBLE]
        parts += [f"is below the bound of causal filters in {len(below)} figures"] if below else []
        kept = [line.word == MET for line in by_topic.get("requirements", ())]
        parts += [f"meets {sum(kept)} of {len(kept)} requirements"] if kept else []
        text = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else parts[0]
        return f"{self.estimator} {text}."

    @property
    def good(self) -> bool:
        """Return whether all runs converged, are causal, stay above the bound, and meet the requirements."""
        return (
            not self.lost
            and all(line.value in (0.0, None) for line in self.lines if line.topic == "causality")
            and all(line.word not in (IMPOSSIBLE, UNPROVEN) for line in self.lines)
            and all(line.word == MET for line in self.lines if line.topic == "requirements")
        )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the verdicts on the requirements, by flight."""
        return tuple(
            Finding(f"{one.flight}: {self.estimator}", one.figure, one.word, one.sentence, one.id, one.text)
            for one in self.lines
            if one.topic == "requirements"
        )


def write_suite(folder: str | Path, *, quick: bool = False) -> Path:
    """Write the sensor data of every flight and run of the suite, for solutions computed elsewhere.

    Each run has a folder with the tables as ``bench export --to csv`` writes them, in ``sensors``; long ones
    are compressed, and increments have the digits that their noise leaves. With a ``solution.csv`` beside
    them in every one, ``make_card("file:FOLDER")`` evaluates the solutions.

    Parameters
    ----------
    folder : str or Path
        A new folder.
    quick : bool
        As for :func:`make_card`.

    Raises
    ------
    bench.ConfigError
        If the folder exists.
    OSError
        If a file cannot be written; nothing is left behind.
    """
    folder = Path(folder)
    results.check_folder(folder, force=False, kind=results.EXPORT)
    suite = QUICK if quick else FULL
    plan = plan_campaign(replace(suite, estimators=(YARDSTICK,)))
    draws = []
    with results.make_folder(folder, kind=results.EXPORT) as partial:
        for one in plan.runs:
            cell = plan.cells[one.cell]
            flight, draw = suite.locate(cell.condition)
            sensed = pipeline.sense(cell.profile, pipeline.fly(cell.profile), one.run)
            place = write_sensors(partial, sensed.data, sensed.initial)
            draws.append({"folder": place.name, "flight": suite.members[flight].name, "draw": draw})
        suite_hash = hash_suite(plan)
        results.write_json(partial / "suite.json", {"suite": suite.name, "hash": suite_hash, "draws": draws})
    return folder


def make_card(
    estimator: str,
    *,
    label: str | None = None,
    options: Mapping[str, Any] | None = None,
    against: str = AGAINST,
    quick: bool = False,
    guard: Guard = DEFAULT_GUARD,
    seed: int | None = None,
    requirements: Path | None = None,
    audit: int | None = None,
    runs: Path | None = None,
    resume: bool = True,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Card:
    """Run a filter over the suite of flights and compare it with another filter, run by run.

    Parameters
    ----------
    estimator : str
        Built-in name, ``module:Class``, ``command:./program {sensors} {solution}``, or ``file:FOLDER`` with a
        solution for each run that `write_suite` wrote.
    label : str, optional
        Name on the card. Default: name of the class, program or folder.
    options : mapping, optional
        Options of the filter.
    against : str, optional
        Filter to compare with. Default: "loose-full".
    quick : bool, optional
        Twelve flights of 8 runs instead of eighteen of 40.
    guard : Guard, optional
        Limits for programs and classes.
    seed : int, optional
        Draws other places, headings, winds and noises of all runs. Default: the suite's own.
    requirements : Path, optional
        File of ``[[requirement]]`` rows (`bench.experiments.card.card_requirements`).
    audit : int, optional
        Number of an audit of causality, to repeat it. Default: a random number.
    runs : Path, optional
        Folder that keeps the runs.
    resume : bool, optional
        Reuse the runs in that folder. Default: yes; no replaces them.
    jobs : int, optional
        Number of processes. Default: the number of processors.
    progress : callable, optional
        Called with a `CampaignStage` at the start and after each run.

    Returns
    -------
    Card
        ``lines`` with value, interval and sentence; ``summary``; ``frame()`` is a DataFrame.

    Raises
    ------
    bench.ConfigError, bench.EstimatorError
        If a filter cannot be built, or two have the same name.
    KeyboardInterrupt
        If the call is interrupted; ``runs`` has the finished runs.

    Examples
    --------
    >>> import bench
    >>> bench.make_card("loose-15", quick=True).summary  # doctest: +SKIP
    """
    suite, guard = replace(QUICK if quick else FULL, draw_seed=seed), replace(guard, confined=True)
    names = [flight.name for flight in suite.members]
    required = () if requirements is None else read_requirements(requirements, names)
    plan, (own, other, yardstick) = plan_card(suite, estimator, against, guard, label, options)
    result = run_campaign(plan, jobs=jobs, folder=runs, resume=resume, force=not resume, progress=progress)
    if result.interrupted:
        raise KeyboardInterrupt
    rows, cpu = result.runs.to_pylist(), result.estimator_cpu_s

    def select(name: str, label: str) -> Rows:
        return [
            row
            for row in rows
            if (suite.locate(row["condition"])[0], row["estimator"]) == (names.index(name), label)
        ]

    lines: list[Line] = []
    for number, flight in enumerate(suite.members):
        beside = select(flight.name, other) if other != own else []
        without = select(flight.without, own) if flight.without else []
        profiles = [suite.profile_of(plan, number, draw) for draw in range(suite.draws)]
        mine = select(flight.name, own)
        lines += judge_flight(flight, mine, beside, other, without, pool_bounds(profiles))
        lines += judge_requirements(flight.name, own, mine, required)
    by_flight = [select(name, own) for name in names]
    lines.append(judge_causality(plan, suite, own, by_flight, result.timing["run_cpu_s"], audit))
    lines += judge_conventions(plan, suite, own, by_flight)
    judged = [row for row in rows if row["estimator"] == own]
    return Card(
        estimator=own,
        against=other,
        suite=f"{VERSION}, {'quick' if quick else 'full'}",
        suite_hash=hash_suite(plan),
        draws=suite.draws,
        versions=dict(results.list_versions()),
        lines=tuple(lines),
        speed=measure_speed(cpu.get(own, ()), cpu.get(yardstick, ()), yardstick),
        use=estimator,
        options=dict(options or {}),
        seed=seed,
        program=hash_estimator(plan, own),
        answers=hash_all_answers(judged),
        uncertainty=state_uncertainty(
            f"{suite.draws} of each of {len(names)} flights",
            "of the suite" if seed is None else str(seed),
            result.provenance,
        ),
        commands={name: select(name, own)[0]["command"] for name in names},
        lost=tuple(
            LostDraw(
                flight=names[suite.locate(row["condition"])[0]],
                draw=suite.locate(row["condition"])[1],
                reason=one_line(str(row.get("reason"))),
                command=row["command"],
            )
            for row in judged
            if not row["converged"]
        ),
    )


def plan_card(
    suite: Suite,
    estimator: str,
    against: str,
    guard: Guard,
    label: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> tuple[Plan, tuple[str, str, str]]:
    """Return the plan of a suite, and the labels of the filter, the reference filter and the yardstick."""
    if not label and not options:
        uses = list(dict.fromkeys((estimator, against, YARDSTICK)))
        plan = plan_campaign(replace(suite, estimators=tuple(uses)), guard=guard)
        own = uses.index(estimator)
    else:  # rows as a profile has them; the user names the code, not a file
        name = label or make_choice(estimator).label
        first = {"use": estimator, "label": name, "options": dict(options or {})}
        others = dict.fromkeys((against, YARDSTICK))
        if name in others:
            raise ConfigError(f"the card already has a filter {name!r}; use --label to rename yours")
        given = [first, *({"use": use} for use in others)]
        plan = plan_campaign(replace(suite, fixed={"estimator": given}), allow_code=True, guard=guard)
        own, uses = 0, [name, *others]
    labels = [choice.label for choice in plan.cells[0].profile.estimators]
    return plan, (labels[own], labels[uses.index(against)], labels[uses.index(YARDSTICK)])


def verify_card(
    card: Card,
    draws: int = 8,
    *,
    guard: Guard = DEFAULT_GUARD,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> list[str]:
    """Repeat random runs of a card; return each difference from the card in a sentence.

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
    bench.ConfigError
        If the suite is not that of the card, or the card does not say what it ran.
    """
    if not card.use:
        raise ConfigError("the card does not name its filter. Make it again with this version of bench")
    suite = replace(QUICK if card.suite.endswith("quick") else FULL, draw_seed=card.seed)
    named = None if card.estimator == make_choice(card.use).label else card.estimator
    plan, (own, *_) = plan_card(suite, card.use, YARDSTICK, guard, named, card.options)
    if hash_suite(plan) != card.suite_hash:
        raise ConfigError(f"the card is of suite {card.suite_hash}; here it is {hash_suite(plan)}")
    chosen = secrets.SystemRandom().sample(range(len(plan.runs)), min(draws, len(plan.runs)))
    again = replace(plan, runs=tuple(plan.runs[k] for k in sorted(chosen)))
    found = []
    if card.program != hash_estimator(plan, own):
        found.append(f"{card.use} is not the program that the card names: {card.program}")
    by_name = {(line.topic, line.flight): line for line in card.lines if line.word != COUNT}
    for row in run_campaign(again, jobs=jobs, progress=progress).runs.to_pylist():
        number, draw = suite.locate(row["condition"])
        flight = suite.members[number].name
        for topic, value in list_values(row).items() if row["estimator"] == own else ():
            line = by_name.get((topic, flight))
            said = line.by_draw[draw] if line and draw < len(line.by_draw) else None
            if line and not is_same_value(said, value):
                shown = " and ".join(write_figure(one) for one in (said, value))
                found.append(f"{flight}, run {draw}: {line.figure}: card and repetition {shown}")
    return found


def is_same_value(one: float | None, other: float | None) -> bool:
    """Return whether two values are equal apart from rounding on another processor."""
    if one is None or other is None:
        return one is other
    return bool(np.isclose(one, other, rtol=SAME, atol=0.0))


def describe_suite(card: Card) -> str:
    """Return version, extent and hash of the suite of a card."""
    return f"suite {card.suite}, {card.suite_hash}, {card.draws} runs of each flight; 95 % intervals"


def read_card(path: str | Path) -> Card:
    """Read a card from a file.

    Parameters
    ----------
    path : str or Path
        File that ``bench card -o`` wrote.

    Returns
    -------
    Card
        The card.

    Raises
    ------
    bench.ConfigError
        If the file is not a card.

    Examples
    --------
    >>> import bench
    >>> bench.read_card("loose-15.json").frame()  # doctest: +SKIP
    """
    document = read_json(Path(path))
    check_format(document, str(path))
    card = check_table(Card, document, str(path))
    if not any(line.topic == "convergence" for line in card.lines):
        raise ConfigError(f"{path}: no card: none of its lines has the topic 'convergence'")
    return card
