"""The card of an estimator: what a fixed suite of flights says of it, beside a built-in filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from bench import pipeline, store
from bench.campaigns.card_suite import FULL, QUICK, VERSION, SuiteFlight, hash_suite
from bench.campaigns.plan import plan_campaign
from bench.campaigns.running import Progress, run_campaign
from bench.config.tables import ROWS, Table, check_table
from bench.errors import ConfigError
from bench.evaluation import ensemble, regression
from bench.evaluation.ensemble import Estimate
from bench.evaluation.ensemble_consistency import TOLERATED
from bench.exchange.solution_folder import write_sensors
from bench.files import read_json
from bench.specs import DEFAULT_GUARD, Guard

AGAINST = "loose-full"
"""The filter that others are compared with."""

YARDSTICK = "free-inertial"
"""The estimator whose CPU time is the unit of speed: the bare integration of the same IMU samples."""

_LEAST = 2  # draws that have an interval
_RMS = {
    "accuracy": ("horizontal error", "pos_rmse_h_m", ""),
    "heading": ("heading error", "heading_rmse_deg", ""),
    "outages": ("growth of the error in outages", "outage_", "_growth_h_m"),
    "faults": ("largest error during faults", "fault_", "_max_h_m"),
}
"""Topic -> its figure in words, and how the names of its metrics begin and end."""
_CONVERGENCE = "heading_convergence_s_all"

COUNT = "count"
"""Word of a line that counts."""

Rows = Sequence[Mapping[str, Any]]
"""Metrics of an estimator by draw."""


class Line(Table):
    """One figure of a card."""

    topic: str  # "convergence", "accuracy", "heading", "honesty", "outages", "faults", "robustness", "speed"
    flight: str
    figure: str  # what it is of
    value: float | None  # None: never
    low: float | None  # 95 % interval; None: open to this side
    high: float | None
    sentence: str
    word: str = ""  # of honesty the verdict; COUNT: ``by_draw`` holds 1 where it happened, else 0
    by_draw: Annotated[tuple[float | None, ...], ROWS] = ()  # what the estimator achieved itself


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
    jobs, progress
        As for `bench.campaigns.running.run_campaign`.

    Raises
    ------
    bench.errors.ConfigError, bench.errors.EstimatorError
        If an estimator cannot be built.
    """
    suite = QUICK if quick else FULL
    uses = tuple(dict.fromkeys((estimator, against, YARDSTICK)))
    plan = plan_campaign(replace(suite, estimators=uses), guard=guard)
    result = run_campaign(plan, jobs=jobs, progress=progress)
    labels = [choice.label for choice in plan.cells[0].profile.estimators]
    own, other, yardstick = (labels[uses.index(use)] for use in (estimator, against, YARDSTICK))
    rows = result.runs.to_pylist()

    def select(number: int, label: str) -> Rows:
        return [row for row in rows if (row["condition"], row["estimator"]) == (number, label)]

    names = [flight.name for flight in suite.members]
    lines: list[Line] = []
    for number, flight in enumerate(suite.members):
        mine = select(number, own)
        lines.append(_judge_convergence(flight, mine))
        if other != own:
            lines += _compare_errors(flight, mine, select(number, other), other)
        lines += _judge_honesty(flight, mine)
        lines += _judge_alarms(flight, mine)
        if flight.without:
            lines += _judge_robustness(flight, mine, select(names.index(flight.without), own))
        lines += _judge_heading(flight, mine)
    return Card(
        estimator=own,
        against=other,
        suite=f"{VERSION}, {'quick' if quick else 'full'}",
        suite_hash=hash_suite(plan),
        draws=suite.runs,
        versions=dict(store.list_versions()),
        lines=tuple(lines),
        speed=_measure_speed(result.estimator_cpu_s[own], result.estimator_cpu_s[yardstick], yardstick),
    )


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


# --- lines ----------------------------------------------------------------------------------------------


def _judge_convergence(flight: SuiteFlight, own: Rows) -> Line:
    by_draw = tuple(float(row["converged"]) for row in own)
    rate = ensemble.estimate_rate(int(sum(by_draw)), len(own))
    text = f"converged in {sum(by_draw):.0f} of {len(own)} draws"
    return _make_line("convergence", flight, "draws that converged", rate, text, by_draw, COUNT)


def _compare_errors(flight: SuiteFlight, own: Rows, other: Rows, label: str) -> list[Line]:
    """Return the ratios of errors to those of another estimator on the same draws."""
    lines = []
    for topic, (figure, start, end) in _RMS.items():
        if topic == "faults" and flight.without:
            continue
        names = _find_names(own, start, end)
        values = [_pool_names(rows, names) for rows in (own, other)]
        ratio = compare_rms(*values)
        if ratio is not None:
            text = f"{figure} {_format(ratio)} times that of {label}"
            lines.append(_make_line(topic, flight, figure, ratio, text, values[0]))
    return lines


def _judge_honesty(flight: SuiteFlight, own: Rows) -> list[Line]:
    """Return the ratio of NEES to its expectation; none without a covariance."""
    by_draw = tuple(
        row["nees_mean"] / row["nees_states"]
        if row["converged"] and row.get("nees_mean") is not None
        else None
        for row in own
    )
    known = np.array([value for value in by_draw if value is not None], float)
    if len(known) < _LEAST:
        return []
    root = ensemble.pool_rmse(known)
    ratio = Estimate(root.value**2, root.low**2, root.high**2)
    least, most = TOLERATED
    if ratio.low > most:
        word = "overconfident"
    elif ratio.high < least:
        word = "underconfident"
    else:
        word = "consistent" if least <= ratio.low and ratio.high <= most else "undecided"
    text = f"NEES is {_format(ratio)} times its expectation: {word}"
    return [_make_line("honesty", flight, "NEES over its expectation", ratio, text, by_draw, word)]


def _judge_alarms(flight: SuiteFlight, own: Rows) -> list[Line]:
    """Return how many of the faults were noticed, of those that can be."""
    if flight.without:
        return []
    names = _find_names(own, "fault_", "_detected")
    by_draw = tuple(row[name] for row in own for name in names if row.get(name) is not None)
    if not by_draw:
        return []
    rate = ensemble.estimate_rate(int(sum(by_draw)), len(by_draw))
    text = f"noticed {sum(by_draw):.0f} of {len(by_draw)} faults"
    return [_make_line("faults", flight, "faults noticed", rate, text, by_draw, COUNT)]


def _judge_robustness(flight: SuiteFlight, own: Rows, without: Rows) -> list[Line]:
    """Return the ratio of the error to that on the same draws of the same flight where nothing happens."""
    _, start, end = _RMS["accuracy"]
    values = [_pool_names(rows, _find_names(own, start, end)) for rows in (own, without)]
    ratio = compare_rms(*values)
    if ratio is None:
        return []
    text = f"horizontal error {_format(ratio)} times its own on the same flight without them"
    return [_make_line("robustness", flight, "horizontal error", ratio, text, values[0])]


def _judge_heading(flight: SuiteFlight, own: Rows) -> list[Line]:
    """Return the median time after which the heading stays right, of a flight that begins with it wrong."""
    estimated = any(row.get("heading_rmse_deg") is not None for row in own)
    if "initial_error_sd.heading_deg" not in flight.values or not estimated:
        return []
    by_draw = tuple(row.get(_CONVERGENCE) if row["converged"] else None for row in own)
    times = np.array([np.inf if value is None else value for value in by_draw])
    found = ensemble.estimate_quantile(times, 0.5)
    low, high = (end if end is not None and np.isfinite(end) else None for end in (found.low, found.high))
    if not np.isfinite(found.value):
        text = "most draws never find the heading"
    else:
        text = f"half of the draws have the heading within 1 deg or 3 sigma after {found.value:.3g} s"
        last = "never" if high is None else f"{high:.3g} s"
        text += f" ({'the start' if low is None else f'{low:.3g} s'} to {last})"
    value = found.value if np.isfinite(found.value) else None
    return [
        Line(
            topic="convergence",
            flight=flight.name,
            figure="median time to the heading [s]",
            value=value,
            low=low,
            high=high,
            sentence=f"{flight.name}: {text}.",
            by_draw=by_draw,
        )
    ]


def _measure_speed(own: Sequence[float], yardstick: Sequence[float], label: str) -> Line | None:
    """Return the CPU time as a multiple of that of the yardstick in the same runs."""
    if not own:
        return None
    found = ensemble.estimate_quantile(np.array(own) / np.array(yardstick), 0.5)
    interval = f"{found.low or found.value:.3g} to {found.high or found.value:.3g}"
    return Line(
        topic="speed",
        flight="all flights",
        figure=f"CPU time over that of {label}",
        value=found.value,
        low=found.low,
        high=found.high,
        sentence=f"speed: {found.value:.3g} ({interval}) times the CPU of {label} on the same samples; "
        "measured anew for each card.",
    )


def _make_line(
    topic: str,
    flight: SuiteFlight,
    figure: str,
    found: Estimate,
    text: str,
    by_draw: Sequence[float | None],
    word: str = "",
) -> Line:
    low, high = (end if np.isfinite(end) else None for end in (found.low, found.high))
    return Line(
        topic=topic,
        flight=flight.name,
        figure=figure,
        value=found.value,
        low=low,
        high=high,
        sentence=f"{flight.name}: {text}.",
        word=word,
        by_draw=tuple(by_draw),
    )


def _find_names(rows: Rows, start: str, end: str) -> list[str]:
    """Return the metrics between these ends that any row has."""
    names = dict.fromkeys(name for row in rows for name, value in row.items() if value is not None)
    return [
        name for name in names if name == start or (end and name.startswith(start) and name.endswith(end))
    ]


def _pool_names(rows: Rows, names: Sequence[str]) -> tuple[float | None, ...]:
    """Return the root mean square of some metrics in each draw; None if it has none or did not converge."""
    return tuple(
        float(np.sqrt(np.mean([row[name] ** 2 for name in names])))
        if names and row["converged"] and all(row.get(name) is not None for name in names)
        else None
        for row in rows
    )


def compare_rms(own: Sequence[float | None], other: Sequence[float | None]) -> Estimate | None:
    """Return the ratio of two pooled root mean squares over the draws that have both; None if too few."""
    pairs = [(a, b) for a, b in zip(own, other, strict=True) if a is not None and b is not None]
    if len(pairs) < _LEAST:
        return None
    mine, theirs = np.square(np.array(pairs, float)).T
    if not (mine.all() and theirs.all()):
        return None
    change = regression.estimate_change(theirs, mine, regression.half_log_of_mean, paired=True)
    low, high = change.interval(1.0 - ensemble.CONFIDENCE)
    return Estimate(*np.exp([change.estimate, low, high]).tolist())


def _format(ratio: Estimate) -> str:
    return f"{write_figure(ratio.value)} ({write_figure(ratio.low)} to {write_figure(ratio.high)})"


def write_figure(value: float | None) -> str:
    """Return a number with three digits; a dash for None."""
    return "-" if value is None else f"{value:#.3g}".rstrip(".")
