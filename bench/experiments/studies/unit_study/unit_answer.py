"""Answer of the study of IMUs: sentences, tables, and figures with labeled dots."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.records.findings import FindingTable, make_table, series
from bench.core.records.findings.series import Plot, Series
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import estimate_quantile, qualify
from bench.evaluation.metrics.run_metrics import find_metric
from bench.evaluation.requirements.required_metrics import EVERY, describe_limit
from bench.evaluation.requirements.share_test import MET, UNDECIDED
from bench.experiments.studies.study import format_estimate
from bench.experiments.studies.unit_study.catalog_units import CLASSES, CatalogImu
from bench.experiments.studies.unit_study.unit_limits import VarianceShares
from bench.experiments.studies.unit_study.unit_ranking import ClassStep, Ranking, UnitFlown
from bench.io.config.sheet import ProductTable


@dataclass(frozen=True)
class Answer:
    """Result of one filter on one flight for all IMUs."""

    profile: str
    label: str
    metric: str
    required: Sequence[Mapping[str, Any]]
    ranking: Ranking  # with gaps as typical of the class
    bare: Ranking  # with gaps as zero
    limits: Sequence[tuple[str, VarianceShares]]  # by unit

    @property
    def missed(self) -> bool:
        """Return whether every IMU misses the requirements, or is not usable."""
        words = {one.verdict for one in self.ranking.flown.values()}
        return bool(self.required) and not words & {MET, UNDECIDED}

    @property
    def undecided(self) -> bool:
        """Return whether a cheaper class may meet the limits, or no class is shown to meet or miss them."""
        none = self.ranking.recommended is None and not self.missed
        return none or bool(self.ranking.list_undecided())

    @property
    def unit_of_metric(self) -> str:
        """The unit of the metric."""
        known = find_metric(self.metric.replace(EVERY, "1"))
        return known.unit if known else ""

    @property
    def what(self) -> str:
        """The metric in words, with its unit."""
        words = {
            "outage_*_drift_h_m": "horizontal drift in the outage",
            "pos_rmse_h_m": "horizontal RMSE",
        }
        return f"{words.get(self.metric, self.metric)} [{self.unit_of_metric}]"

    @property
    def where(self) -> str:
        """Flight and filter."""
        return f"{self.profile}, {self.label}"


# --- words ------------------------------------------------------------------------------------------------


def tell_answer(answer: Answer, units: Mapping[str, CatalogImu]) -> Iterator[str]:
    """Yield the answer in sentences: recommendation, reasons, limits, and unusable IMUs."""
    ranking = answer.ranking
    yield from _tell_required(answer, units) if answer.required else ()
    yield f"{answer.where}, {answer.what}, cheapest class first: {'; '.join(_tell_steps(ranking))}."
    if ranking.alike:
        most = 100.0 * (ranking.spread - 1.0)
        yield (
            f"{answer.where}: here the IMU does not matter, the errors of all "
            f"{sum(not one.lost for one in ranking.flown.values())} usable units are within {most:.1f} %; "
            "the cheapest does."
        )
    lost = [one.loss for one in ranking.flown.values() if one.lost]
    if lost:
        yield f"{answer.where}: not usable on this flight, runs lost: {', '.join(lost)}."
    yield from _tell_gaps(answer, units)
    yield from (limit.tell(name) for name, limit in answer.limits)
    outside = [name for name in ranking.flown if units[name].grade not in CLASSES]
    if outside:
        yield (
            f"Without a class, so beside the classes: {', '.join(outside)}; class = "
            f'"{CLASSES[0]}" in a file gives it one, of {", ".join(CLASSES)}.'
        )


def _tell_steps(ranking: Ranking) -> Iterator[str]:
    for step in ranking.steps:
        one = step.best
        known = f" {format_estimate(one.rms)}" if one.rms else ""
        text = f"{step.grade} {one.unit}{known}"
        if step.gain is not None:
            text += (
                f", {step.gain.ratio.value:.2g} times {step.gain.second}"
                if step.pays
                else f", {'no better' if step.gain.word != 'undecided' else 'not shown to be better'} "
                f"than {step.gain.second} ({_tell_pair(step)})"
            )
        same = [pair.first for pair in step.beside if pair.word != "undecided"]
        told = [f"the same: {', '.join(same)}"] if same else []
        told += [
            f"{pair.first} not separated from it: about {max(1, pair.deciding - pair.draws)} more runs needed"
            if pair.deciding
            else f"{pair.first} not separated from it; more runs would hardly help"
            for pair in step.beside
            if pair.word == "undecided"
        ]
        yield f"{text} ({'; '.join(told)})" if told else text
    if not ranking.steps:
        yield "no class has a usable unit"


def _tell_pair(step: ClassStep) -> str:
    gain = step.gain
    assert gain is not None
    text = f"{gain.ratio.value:.3g} times, {gain.ratio.interval}{qualify(gain.draws)}"
    more = f"; about {max(1, gain.deciding - gain.draws)} more runs needed" if gain.deciding else ""
    return f"{text}{more}"


def _tell_required(answer: Answer, units: Mapping[str, CatalogImu]) -> Iterator[str]:
    ranking = answer.ranking
    asked = " and ".join(
        f"{row['metric']} {describe_limit(row)} in {100.0 * row['share']:g} % of the runs"
        for row in answer.required
    )
    found = ranking.recommended
    if found is None:
        word = "no unit meets" if answer.missed else "no unit is shown to meet"
        yield f"{answer.where}: {word} the requirement, {asked}."
    else:
        margin = find_margin(found.best, answer.required, answer.metric)
        shown = f", margin {margin:.2g}" if margin else ""
        open_ones = ", ".join(one.unit for one in ranking.list_undecided())
        maybe = f" Cheaper, but undecided: {open_ones}." if open_ones else ""
        yield (
            f"{answer.where}: {found.best.unit} ({found.grade}) meets the requirement, {asked}{shown}.{maybe}"
        )
        yield from tell_products(answer, units)
    for one in ranking.list_undecided():
        yield from (
            each.sentence.replace(f"{answer.label}:", f"{one.unit}, {answer.label}:", 1)
            for each in one.findings
        )


def tell_products(answer: Answer, units: Mapping[str, CatalogImu]) -> Iterator[str]:
    """Yield the smallest, lightest, most frugal and cheapest of several IMUs that meet the requirements.

    Only datasheets with the figure take part; the sentence names the IMUs that meet and lack the size.
    """
    met = [name for name, one in answer.ranking.flown.items() if one.verdict == MET]
    parts = []
    for word, unit, take in _PRODUCT:
        known = {name: size for name in met if (size := take(units[name].product)) is not None}
        if known:
            best = min(known, key=lambda name: known[name])
            parts.append(f"{word} {best} ({format_number(known[best], 3)} {unit}, of {len(known)})")
    if parts and len(met) > 1:
        unknown = [name for name in met if units[name].product.volume is None]
        rest = f"; without a size: {', '.join(unknown)}" if unknown else ""
        yield f"{answer.where}, of the {len(met)} units that meet it: {', '.join(parts)}{rest}."


_PRODUCT: Sequence[tuple[str, str, Callable[[ProductTable], float | None]]] = (
    ("smallest", "cm^3", lambda product: product.volume),
    ("lightest", "kg", lambda product: product.mass_kg),
    ("least power", "mW", lambda product: product.power_mw),
    ("cheapest by its price", "USD", lambda product: product.price_usd),
)


def find_margin(one: UnitFlown, required: Sequence[Mapping[str, Any]], metric: str) -> float | None:
    """Return the margin: the limit over the quantile that must meet it; None without a limit."""
    for row in required:
        if row["metric"] == metric and "most" in row and not one.lost:
            return float(row["most"]) / estimate_quantile(one.values, float(row["share"])).value
    return None


def _tell_gaps(answer: Answer, units: Mapping[str, CatalogImu]) -> Iterator[str]:
    """Yield whether values that no source states decide the answer."""
    first, second = (_name_choice(one) for one in (answer.ranking, answer.bare))
    filled = [name for name in answer.ranking.flown if units[name].typical]
    if not filled:
        return
    if first == second:
        yield (
            f"{answer.where}: parameters that datasheets leave out have typical values of the class (table "
            "gaps); with zero instead the answer is the same."
        )
    else:
        yield (
            f"{answer.where}: the answer depends on parameters that datasheets leave out (table gaps). If "
            f"they are typical of the class, it is {first}; if they are zero, {second}."
        )


def _name_choice(ranking: Ranking) -> str:
    """Return the best units of a ranking: the unit that meets the requirements, and the front."""
    asked = any(one.findings for one in ranking.flown.values())
    if asked:
        return ranking.recommended.best.unit if ranking.recommended else "no unit"
    return ", ".join(step.best.unit for step in ranking.front) or "no unit"


# --- tables -----------------------------------------------------------------------------------------------


def fill_tables(
    answers: Sequence[Answer], units: Mapping[str, CatalogImu], laws: Mapping[str, float], law_s: float
) -> tuple[FindingTable, ...]:
    """Return the errors of all IMUs, and the values of each IMU that no source states."""
    rows = []
    for answer in answers:
        for name, one in answer.ranking.flown.items():
            bare = answer.bare.flown[name]
            rms = (one.rms.value, one.rms.low, one.rms.high) if one.rms else (None,) * 3
            margin = find_margin(one, answer.required, answer.metric)
            rows.append(
                (
                    name, answer.profile, answer.label, units[name].grade, one.verdict, *rms,
                    bare.rms.value if bare.rms else None, margin, one.lost, len(one.values), laws[name],
                )
            )  # fmt: skip
    names = (
        *("unit", "profile", "estimator", "class", "verdict", "rms", "low", "high", "gaps_zero"),
        *("margin", "lost", "runs", f"predicted_{law_s:g}_s_m"),
    )
    metrics = ", ".join(dict.fromkeys(one.what for one in answers))
    title = (
        f"{metrics}: RMS with its 95 % interval, gaps typical of the class; drift that the datasheet expects"
    )
    return (make_table("units", title, names, rows), _fill_gaps(units), *_fill_products(units))


def _fill_products(units: Mapping[str, CatalogImu]) -> Iterator[FindingTable]:
    """Yield the table of size, mass, power and price, if any of the IMUs has one of them."""
    rows = [(name, *(take(unit.product) for _, _, take in _PRODUCT)) for name, unit in units.items()]
    rows = [row for row in rows if any(size is not None for size in row[1:])]
    if rows:
        names = ("unit", "volume_cm3", "mass_kg", "power_mw", "price_usd")
        yield make_table("products", "Size, mass, power and price, by datasheets that have them", names, rows)


def _fill_gaps(units: Mapping[str, CatalogImu]) -> FindingTable:
    rows: list[tuple[Any, ...]] = []
    for name, unit in units.items():
        for gap in unit.absent:
            mine = [one for one in unit.typical if one.gap == gap]
            for one in mine:
                there = "assumed" if one.assumed else "stated"
                rows.append((name, gap, one.key, one.value, ", ".join(one.units), there))
            if not mine:
                unlimited = gap.endswith((" range", " bandwidth"))
                rows.append((name, gap, "", None, "", "no limit" if unlimited else "zero"))
    names = ("unit", "absent", "key", "typical", "median_of", "basis")
    return make_table("gaps", "Figures that no source states, and what is typical of the class", names, rows)


# --- pictures ---------------------------------------------------------------------------------------------


def draw_units(answer: Answer, units: Mapping[str, CatalogImu]) -> Iterator[Plot]:
    """Yield the figure of the errors by class, a labeled dot with interval for each IMU, and the front."""
    ranking = answer.ranking
    shown = [one for one in ranking.flown.values() if one.rms and one.grade in CLASSES]
    if not shown:
        return
    usable = [one for one in shown if not one.lost]
    lost = [one for one in shown if one.lost]
    layers: list[Series] = []
    for key, words, here, color in (
        ("units", "usable", usable, series.ESTIMATORS[0]),
        ("lost", "runs lost: not usable", lost, series.REJECTED),
    ):
        if here:
            at = np.array([1.0 + CLASSES.index(one.grade) for one in here])
            values = np.array([one.rms.value for one in here if one.rms])
            names = tuple(units[one.unit].short for one in here)
            layers.append(series.draw_dots(key, at, values, words, color, 4.0, labels=names))
    front = [step.best for step in ranking.front]
    if len(front) > 1:
        at = np.array([1.0 + CLASSES.index(one.grade) for one in front])
        values = np.array([one.rms.value for one in front if one.rms])
        layers.append(series.draw_line("front", at, values, "shown to be better", series.ESTIMATORS[0]))
    for row in answer.required:
        if row["metric"] == answer.metric and "most" in row:
            ends = np.array([1.0, float(len(CLASSES))])
            layers.append(
                series.draw_line("limit", ends, np.full(2, float(row["most"])), "required", series.OUTAGE)
            )
    yield Plot(
        ("sensors", f"{answer.profile.rpartition('/')[2].removesuffix('.toml')}-{answer.label}"),
        f"{answer.where}: {answer.what}",
        tuple(layers),
        across="",
        over="class",
        log="y",
        ticks=tuple((1.0 + k, name) for k, name in enumerate(CLASSES)),
    )
