"""IMUs flown on the same flights with the same filters: which class is enough, and what limits it.

Few makers print prices; the class of an IMU stands for its price: consumer, industrial, tactical,
navigation. Of the IMUs that meet a requirement, the study names the smallest and the lightest, where
datasheets have `[product]`. All IMUs use the same runs and are compared run by run. If a pair or a
requirement is undecided, runs are added up to --max-runs. An IMU with a diverged run is not usable on the
flight. A parameter that a datasheet leaves out is flown with the typical value of the class, and again as
zero; the study prints if this changes the answer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.core.records.findings import Findings
from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear.drift_laws import drift_sd
from bench.evaluation.requirements.required_metrics import (
    Looks,
    is_metric,
    judge_runs,
    list_requirements,
    take_value,
)
from bench.evaluation.requirements.share_test import ShareTest
from bench.experiments.campaigns.campaign_file import CampaignSpec
from bench.experiments.campaigns.plan import plan_campaign
from bench.experiments.studies.drawn_errors import UnitFlight
from bench.experiments.studies.study import (
    Count,
    FlightOptions,
    Positive,
    StudyWorkers,
    Words,
    write_settings,
)
from bench.experiments.studies.unit_study.catalog_units import CatalogImu, find_units
from bench.experiments.studies.unit_study.unit_answer import Answer, draw_units, fill_tables, tell_answer
from bench.experiments.studies.unit_study.unit_limits import VarianceShares, find_limit
from bench.experiments.studies.unit_study.unit_ranking import Ranking, UnitFlown, rank_units
from bench.io.config.datasheets import read_imu
from bench.io.config.library import find_datasheet

STUDY = 4, "sensors"
QUESTION = "Which IMU of the catalog is good enough, and of which class?"

LAW_S = 60.0
"""Time of the drift that the datasheet alone expects [s]."""

_DRIFT, _RMSE = "outage_*_drift_h_m", "pos_rmse_h_m"
_ERROR = 0.05  # probability of a wrong word about a pair, over all looks
_USUAL_MOST = 24  # runs, where nothing is required
_FAR = 4  # a pair that needs more than so many times the most runs is left undecided


class Options(FlightOptions):
    """Options of the study."""

    units: Words = (
        *("hg9900", "ln-100", "hg1700", "hg4930-ca51", "ln-200", "stim300"),
        *("adis16475", "adis16495", "mti-300", "vn-100"),
        *("bmi088", "icm-20948", "icm-42688-p", "icm-45686", "lsm6dsl", "mpu-6050", "mpu-9250"),
    )
    """IMUs of the catalog, or .toml files of your own"""
    profiles: Words = ("gnss-denied-leg",)
    """flights: built-in names, or .toml files; their [[requirement]] rows are the requirements"""
    estimators: Words = ("loose-full",)
    """filters"""
    metric: str | None = None
    """metric to compare; default: the metric of the first [[requirement]], else the outage drift"""
    most: Positive | None = None
    """largest allowed value of the metric in 95 % of the runs, in addition to each [[requirement]]"""
    runs: Count = 6
    """initial number of runs of each unit on each flight"""
    max_runs: Count | None = None
    """largest number of runs, for undecided results; left out: 24, or as many as can show the requirement (59
    for 95 %)"""


class UnitCase(NamedTuple):
    """An IMU with its gaps filled by typical values of its class, or by zero."""

    unit: str
    filled: bool


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return the sufficient class and the limiting factor for each flight and filter."""
    if options.metric is not None and not is_metric(options.metric):
        raise ConfigError(f"study sensors: metric: {options.metric!r} is unknown; bench list metrics")
    units = find_units("sensors", options.units)
    plan_campaign(_plan(options, options.profiles, units, _list_cases(units), options.runs))
    answers = [one for profile in options.profiles for one in answer(options, units, profile, work)]
    asked = [one for one in answers if one.required]
    return Findings(
        verdicts=tuple(text for one in answers for text in tell_answer(one, units)),
        tables=fill_tables(answers, units, {name: find_law(name) for name in units}, LAW_S),
        figures=tuple(plot for one in answers for plot in draw_units(one, units)),
        runs=options.runs,
        good=not any(one.missed for one in asked),
        undecided=any(one.undecided for one in asked),
    )


def find_law(name: str) -> float:
    """Return the root mean square of the horizontal drift in `LAW_S` that the datasheet expects [m]."""
    return float(np.sqrt(2.0) * drift_sd(LAW_S, read_imu(*find_datasheet("imu", name, Path()))))


def _list_cases(units: Mapping[str, CatalogImu]) -> list[UnitCase]:
    return [UnitCase(name, filled) for name, unit in units.items() for filled in {True, not unit.typical}]


def _plan(
    options: Options,
    profiles: Sequence[str],
    units: Mapping[str, CatalogImu],
    cases: Sequence[UnitCase],
    runs: int,
) -> CampaignSpec:
    return CampaignSpec(
        name="sensors",
        profiles=tuple(profiles),
        runs=runs,
        seed=options.seed,
        estimators=options.estimators,
        fixed=options.settings,
        varied=tuple(
            {"sensors.imu": case.unit} | (units[case.unit].filled if case.filled else {}) for case in cases
        ),
    )


def answer(
    options: Options, units: Mapping[str, CatalogImu], profile: str, work: StudyWorkers
) -> Iterator[Answer]:
    """Fly a profile until more runs would decide nothing; yield an answer for each filter."""
    cases = _list_cases(units)
    flights = _Flights(options, units, profile, work)
    again = set(units)
    while flights.fly([case for case in cases if case.unit in again]):
        ranked = {label: flights.rank(label) for label in flights.labels}
        again = {name for one in ranked.values() for name in list_open(one[0], flights.looks.most)}
    for label, (ranking, bare) in ranked.items():
        limits = tuple(_find_limits(options, units, profile, label, ranking, work))
        yield Answer(profile, label, flights.metric(label), flights.required(label), ranking, bare, limits)


def list_open(ranking: Ranking, most: int) -> Iterator[str]:
    """Yield the IMUs for which more runs may decide: in a pair the IMU with fewer runs, or both."""
    for pair in ranking.list_open():
        if pair.deciding is not None and pair.deciding <= _FAR * most:
            for name in (pair.first, pair.second):
                if len(ranking.flown[name].values) == pair.draws:
                    yield name
    yield from (one.unit for one in ranking.list_undecided())


def _find_limits(
    options: Options,
    units: Mapping[str, CatalogImu],
    profile: str,
    label: str,
    ranking: Ranking,
    work: StudyWorkers,
) -> Iterator[tuple[str, VarianceShares]]:
    """Yield the limiting factor with the cheapest sufficient IMU, and with the best IMU."""
    front = ranking.front
    if not front:
        return
    chosen = [(ranking.recommended or front[0]).best.unit, front[-1].best.unit]
    names = list(dict.fromkeys(chosen))
    flights = [
        UnitFlight(
            profile, name, (label,), (*options.overrides, *write_settings(units[name].filled)), options.seed
        )
        for name in names
    ]
    for name, found in zip(names, work.map("what limits", find_limit, flights), strict=True):
        if found is not None:
            yield name, found


class _Flights:
    """The runs of one profile that are flown, by filter and unit."""

    def __init__(
        self, options: Options, units: Mapping[str, CatalogImu], profile: str, work: StudyWorkers
    ) -> None:
        self._options, self._units, self._profile, self._work = options, units, profile, work
        self._rows: dict[tuple[str, UnitCase], list[Mapping[str, Any]]] = {}
        self._document: Mapping[str, Any] = {}

    @property
    def labels(self) -> list[str]:
        """The filters."""
        return list(dict.fromkeys(label for label, _ in self._rows))

    def fly(self, cases: Sequence[UnitCase]) -> bool:
        """Fly the first runs of IMUs, or double their runs up to the limit; return whether any flew."""
        flown, begun = False, dict[int, list[UnitCase]]()
        for case in cases:
            known = next((len(rows) for (_, one), rows in self._rows.items() if one == case), 0)
            begun.setdefault(known, []).append(case)
        for first, here in begun.items():
            runs = min(2 * first, self.looks.most) if first else self._options.runs
            if first >= runs:
                continue
            flown = True
            spec = _plan(self._options, (self._profile,), self._units, here, runs)
            found = self._work.campaign(f"units on {self._profile}", spec, first)
            self._document = found.conditions[0]["as_flown"]
            for row in sorted(found.runs.to_pylist(), key=lambda row: row["run"]):
                self._rows.setdefault((row["estimator"], here[row["condition"]]), []).append(row)
        return flown

    @property
    def looks(self) -> Looks:
        """Return the number of runs at each look, up to the largest."""
        most = self._options.max_runs
        if most is None:
            rows = (row for label in self.labels for row in self.required(label))
            most = max([_USUAL_MOST, *(ShareTest.from_row(row, True).count_least() for row in rows)])
        return Looks(self._options.runs, most)

    def required(self, label: str) -> list[Mapping[str, Any]]:
        """Return the requirements of the profile and the command on a filter."""
        rows = list_requirements(self._document, label)
        if self._options.most is not None:
            rows.append({"metric": self.metric(label), "most": self._options.most, "share": 0.95})
        return rows

    def metric(self, label: str) -> str:
        """Return the name of the metric that is compared."""
        required = list_requirements(self._document, label)
        usual = _DRIFT if self._document.get("gnss_outage") else _RMSE
        return self._options.metric or (required[0]["metric"] if required else usual)

    def rank(self, label: str) -> tuple[Ranking, Ranking]:
        """Return the ranking with gaps as typical of the class, and with gaps as zero, at this look."""
        return self._rank(label, filled=True), self._rank(label, filled=False)

    def _rank(self, label: str, *, filled: bool) -> Ranking:
        flown = []
        for name, unit in self._units.items():
            rows = self._rows[label, UnitCase(name, filled or not unit.typical)]
            asked = {"metric": self.metric(label), "most": math.inf}
            values = [take_value(asked, row) if row["converged"] else None for row in rows]
            findings = judge_runs(label, rows, self.required(label), sequential=True)
            flown.append(UnitFlown(name, unit.grade, np.array(values, float), tuple(findings)))
        return rank_units(flown, _ERROR / len(self.looks.numbers))
