"""Specs of an experiment: filters, evaluation, guidance, and a profile of these, flight and sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from bench.core.files.spawned import machine_memory
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.flight_specs import Flight
from bench.core.records.sensor_specs import SensorsSpec
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import quantity

AUTOPILOT = "autopilot"
"""Name of the estimate in the log of an autopilot, as a filter."""


LEAST_TIMEOUT = 600.0
"""Wall time that any flight may take, if no other limit is set [s]."""


@dataclass(frozen=True, slots=True)
class Guard:
    """Limits for a filter that is not built in, and whether it runs in a separate process.

    Attributes
    ----------
    timeout : float or None
        Wall time of a flight [s]. None: the duration of the flight, at least 600 s.
    memory : float or None
        Memory of the process [byte]. None: half of the memory of the machine.
    output : float
        Largest solution [byte].
    in_process : bool
        Run a class in the process of bench, without limits, for a debugger.
    confined : bool
        On Linux, a class in its own process may open no files but its own. A card sets it.

    Raises
    ------
    bench.ConfigError
        If a limit is not a number above 0.

    Examples
    --------
    >>> import bench
    >>> bench.Guard(timeout=60.0).choose_timeout()
    60.0
    """

    timeout: float | None = None
    memory: float | None = None
    output: float = 2e9
    in_process: bool = False
    confined: bool = False

    def __post_init__(self) -> None:
        for name in ("timeout", "memory", "output"):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
            if not number and (value is not None or name == "output"):
                raise ConfigError(f"Guard: {name} = {value!r} must be a number above 0")

    def choose_timeout(self, duration: float = 0.0) -> float:
        """Return the wall time that a flight of a duration may take [s]."""
        return max(LEAST_TIMEOUT, duration) if self.timeout is None else self.timeout

    def choose_memory(self) -> float:
        """Return the memory limit of the process of the filter [byte]."""
        return 0.5 * machine_memory() if self.memory is None else self.memory


DEFAULT_GUARD = Guard()
"""A process for each filter, and limits that follow from the flight and the machine."""


@dataclass(frozen=True, slots=True)
class EstimatorChoice:
    """A filter by name, ``module:Class``, ``file:`` or ``command:``, and its options."""

    use: str
    label: str  # unique in the profile; in names of files and columns of reports
    options: Mapping[str, Any] = field(default_factory=dict)
    beside: Path = Path()  # base of relative paths in "file:" and "command:"
    guard: Guard = DEFAULT_GUARD


@dataclass(frozen=True, slots=True)
class EvaluationWindow:
    """Part of a run that the metrics cover: the options of ``[evaluation]``.

    A further one is a field here, with its key in a file, and a key of `config.profile_tables`; the record
    goes with the profile to wherever something is evaluated.
    """

    begin: float = field(default=0.0, metadata={"key": "from_s"})  # end of the alignment [s]

    @property
    def first(self) -> float:
        """Epochs from this one on count [s]: a time that is the begin counts."""
        return self.begin - SAME_INSTANT

    @classmethod
    def keys(cls) -> dict[str, str]:
        """Return key in a file -> name of the field."""
        return {f.metadata["key"]: f.name for f in fields(cls)}

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> EvaluationWindow:
        """Return the evaluation window of a profile or log as flown."""
        return cls(**{name: float(document["evaluation"][key]) for key, name in cls.keys().items()})

    def describe_outside(self, end: float, of: str) -> str | None:
        """Say that no time until the ``end`` [s] of something counts; None if some do."""
        if self.begin < end:
            return None
        return f"[evaluation] {quantity('from_s', self.begin)} is outside the {of}, 0 to {end:.6g} s"

    def __str__(self) -> str:
        """Return it in words."""
        return f"errors from {self.begin:g} s on"


IN_FLIGHT = "in-flight"
"""Name of the answers that steered, beside the solutions of the estimators."""

CLIENT = "client"
"""Name of the navigation that a client of `bench serve` gives."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """The estimate that guidance and legs use, with its latency."""

    navigation: EstimatorChoice
    period: float  # between two answers [s], a multiple of 0.05
    latency: float  # from the validity of an answer until guidance goes over to it [s], 0.05 or more
    error: Literal["held", "state"]  # as `bench.simulation.flight.guidance.belief` says
    look_back: float = 1.0  # longest time from a measurement to its arrival [s]


@dataclass(frozen=True, slots=True)
class Profile:
    """One experiment: flight, sensors, filters and evaluation, from `bench.read_profile`.

    Attributes
    ----------
    name, title : str
        File name without ending, and title.
    seed : int
        Seed of the sensor noise.
    flight : FlightSpec, ScriptSpec or TableSpec
        What is flown.
    sensors : SensorsSpec
        Sensors on board and datasheets assumed by the filters, in SI.
    estimators : tuple of EstimatorChoice
        Filters with their options.
    evaluation : EvaluationWindow
        Interval that the metrics cover.
    document : mapping
        The profile with its defaults filled in, in the units of its file.
    guidance : Guidance or None
        How a filter steers the flight; None if guidance uses the truth.

    Examples
    --------
    >>> import bench
    >>> bench.read_profile("approach").labels[0]
    'loose-15'
    """

    name: str
    title: str
    seed: int
    flight: Flight
    sensors: SensorsSpec
    estimators: tuple[EstimatorChoice, ...]
    evaluation: EvaluationWindow
    document: Mapping[str, Any]
    guidance: Guidance | None = None

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the solutions of a run: the filters, and the answers that steered if some did."""
        steered = () if self.guidance is None else (IN_FLIGHT,)
        return (*(choice.label for choice in self.estimators), *steered)

    @property
    def answer_rate(self) -> float:
        """At this rate all solutions of a run have an answer [Hz]."""
        rate = self.sensors.output_rate
        return rate if self.guidance is None else min(rate, 1.0 / self.guidance.period)

    def describe_outside(self, end: float) -> list[str]:
        """Return the outages, faults and alignment window that end after a flight [s], in words."""
        outages = enumerate(self.sensors.gnss_outages, 1)
        ends = [(f"[[gnss_outage]] {k}: its end at", stop) for k, (_, stop) in outages]
        faults = enumerate(self.sensors.faults, 1)
        ends += [(f"[[fault]] {k} ({fault.kind}): its end at", fault.end) for k, fault in faults]
        found = [
            f"{self.name}: {what} {t:g} s is outside the flight, 0 to {end:g} s"
            for what, t in ends
            if t > end
        ]
        outside = self.evaluation.describe_outside(end, "flight")
        return [*found, f"{self.name}: {outside}"] if outside else found

    def __repr__(self) -> str:
        """Return name, seed, flight, sensors and estimators."""
        units = (getattr(self.sensors, f.name) for f in fields(self.sensors))
        names = dict.fromkeys(unit.name for unit in units if hasattr(unit, "name"))
        estimators = ", ".join(one.label for one in self.estimators)
        head = f"{self.name!r}, seed {self.seed}: {self.flight.label}"
        return f"<Profile {head}; sensors {', '.join(names)}; filters {estimators}>"
