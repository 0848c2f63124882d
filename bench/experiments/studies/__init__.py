"""Questions that a designer asks before buying sensors, each answered by a table, figures and sentences.

A study is a module with ``Options``, a `StudyOptions`, and ``run(options, work) -> Findings``. Adding one is
such a module and a row of `STUDIES`, or an entry point ``bench.studies`` of any package.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from bench.core.files.installed import find_installed, find_own, import_plugin


class StudyEntry(NamedTuple):
    """Where a study is, and what it asks."""

    module: str
    question: str


_CORE = {
    "requirements": StudyEntry(
        "bench.experiments.studies.sensor_requirements",
        "What gyro and accelerometer error is allowed for a position error after an outage?",
    ),
    "outages": StudyEntry(
        "bench.experiments.studies.outage_study.outage_drift",
        "How far does the position drift without GNSS, by unit and by phase of flight?",
    ),
    "sensitivity": StudyEntry(
        "bench.experiments.studies.sensitivity", "How much does one value of a profile matter?"
    ),
    "sensors": StudyEntry(
        "bench.experiments.studies.unit_study.unit_table",
        "Which IMU of the catalog is good enough, and of which class?",
    ),
    "budget": StudyEntry(
        "bench.experiments.studies.budget",
        "Which error of the sensors contributes what to the errors of a filter, at every instant?",
    ),
    "bound": StudyEntry(
        "bench.experiments.studies.bound",
        "How far is each estimator from the best linear one, on a flight?",
    ),
    "observability": StudyEntry(
        "bench.experiments.studies.observability",
        "What do turns tell of heading and biases, and what stays unknown?",
    ),
    "logs": StudyEntry(
        "bench.experiments.studies.recorded_logs",
        "Which filter does better on many recordings?",
    ),
    "closed-loop": StudyEntry(
        "bench.experiments.studies.flown_by_filters",
        "Where does the aircraft end that a filter flies, and how far off its path, by filter and unit?",
    ),
    "rnp": StudyEntry(
        "bench.experiments.studies.rnp",
        "Are accuracy, integrity, continuity and availability those that a procedure requires?",
    ),
}


def _add_plugins() -> Iterator[tuple[str, StudyEntry]]:
    for name, place in find_own("studies").items():
        yield name, StudyEntry(place, import_plugin("studies", name).STUDIES[name])


STUDIES: Mapping[str, StudyEntry] = {**_CORE, **dict(_add_plugins())}
"""Name of a study of bench, of a plug-in last -> its module and its question, in a line."""


def find_studies() -> dict[str, StudyEntry]:
    """Return the studies by name, those of other packages last; these are not imported."""
    added = find_installed("studies", STUDIES)
    return {**STUDIES, **{name: StudyEntry(one.place, f"of {one.package}") for name, one in added.items()}}
