"""Questions that a designer asks before buying sensors, each answered by a table, figures and sentences.

A study is a module with ``Options``, a `StudyOptions`, and ``run(options, work) -> Findings``. Adding one is
such a module and a row of `STUDIES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class StudyEntry(NamedTuple):
    """Where a study is, and what it asks."""

    module: str
    question: str


STUDIES: Mapping[str, StudyEntry] = {
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
    "alignment": StudyEntry(
        "bench.experiments.studies.alignment_errors",
        "What do errors of an alignment cost on a route, how do they travel, and what tells them?",
    ),
    "mechanizations": StudyEntry(
        "bench.experiments.studies.mechanization_costs",
        "What do frame, task rates, attitude algorithm and series of a strapdown cost in metres and time?",
    ),
    "register": StudyEntry(
        "bench.experiments.studies.register_study",
        "Which rows of the sources' register hold here, and by what number?",
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
"""Name of a study -> its module and its question, in a line."""
