"""Numbers of the register that need simulated flights: results of filters over a few runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from bench import pipeline
from bench.core.mathematics.units import HOUR, STANDARD_GRAVITY
from bench.core.records.data import NavSolution, Trajectory
from bench.core.records.specs import Profile
from bench.evaluation.consistency.chi_square import MeanNis, mean_nis, nis_by_sensor
from bench.experiments.studies import rnp
from bench.experiments.studies.study import StudyWorkers
from bench.experiments.studies.watched_flights import WatchedFlight
from bench.io.config import read_profile
from bench.navigation.engine.record_cuts import slice_sensors
from bench.navigation.open_filters import PieceFilter
from bench.plugins.papers.register_measures import Bounded, RowFinding, below
from bench.simulation import sensors

_STEP: Mapping[str, Any] = {  # a turn that pulls 2 g within a second, fixes at 10 Hz
    "leg": [
        {"kind": "straight", "duration_s": 30.0},
        {"kind": "wind-up-turn", "bank_deg": 60.0, "load_factor": 2.0, "rise_s": 1.0, "hold_s": 5.0},
        {"kind": "straight", "duration_s": 5.0},
    ],
    "sensors.imu": "matched-mems",
    "sensors.gnss": "matched-white",
    "sensors.gnss.rate_hz": 10.0,
    "estimator": [{"use": "loose-15", "options": {"compensate_latency": False}}],
}
_FIXES = ("gnss_position", "gnss_velocity")
_NOSE, _TAIL = (2.0, 0.3, -0.4), (-9.0, 0.0, -1.5)  # antennas [m], b
_DRAWS = 4
FLIGHTS = 12  # that #33 rests on: without a bad one they show 78 %
_ALERT_LIMIT, _OPERATION = 0.3 * 1852.0, 15  # of RNP 0.3 [m], [s]
_STEP_S = 12.0  # from the rise of the force on [s]


def load_step(**values: object) -> Profile:
    """Return the flight with a step of 2 g; errors as for `read_profile`."""
    return read_profile("high-dynamics", {**_STEP, **values}, None, None)


@cache
def fly_step() -> tuple[Trajectory, float]:
    """Return the flight with a step of 2 g, and the time at which the force begins to rise [s]."""
    truth = pipeline.fly(load_step())
    force = np.linalg.norm(truth.dvel_b, axis=1) / np.diff(truth.t) / STANDARD_GRAVITY
    return truth, float(truth.t[np.argmax(force > 1.2)])


def measure_step(**values: object) -> dict[str, MeanNis]:
    """Return the mean NIS of loose-15 by sensor through the step, with its 99.9 % band, over runs."""
    profile = load_step(**values)
    truth, begin = fly_step()
    sensed = [pipeline.sense(profile, truth, draw) for draw in range(_DRAWS)]
    solutions = [pipeline.navigate(profile.estimators[0], one.data, one.initial) for one in sensed]
    return average_nis(solutions, begin, begin + _STEP_S)


def average_nis(solutions: Iterable[NavSolution], begin: float, end: float) -> dict[str, MeanNis]:
    """Return the mean NIS by sensor of the measurements in [begin, end) [s], with its 99.9 % band."""
    found: dict[str, list[Any]] = {}
    for solution in solutions:
        for name, one in nis_by_sensor(solution.innovations, begin).items():
            found.setdefault(name, []).append(one.take(one.t < end))
    return {
        name: mean_nis(np.concatenate([one.nis for one in rows]), np.concatenate([one.dof for one in rows]))
        for name, rows in found.items()
    }


def step_of_2_g() -> RowFinding:
    """#31: NIS in a step of 2 g, also with a receiver that lags because of loops of 1 Hz."""
    whole, behind = measure_step(), measure_step(**{"sensors.gnss.tracking_bandwidth_hz": 1.0})
    text = f"{_tell_nis(whole)}; loops of 1 Hz {behind['gnss_position'].mean:.0f}"
    return RowFinding(text, _check_nis(whole, behind))


def _check_nis(right: Mapping[str, MeanNis], wrong: Mapping[str, MeanNis]) -> tuple[Bounded, ...]:
    """Return bounds: NIS of fixes inside its band for ``right``, above its band for ``wrong``."""
    inside = (Bounded(right[name].mean, right[name].low, right[name].high) for name in _FIXES)
    return (*inside, *(Bounded(wrong[name].mean, wrong[name].high, math.inf) for name in _FIXES))


def _tell_nis(found: Mapping[str, MeanNis]) -> str:
    rows = {name.removeprefix("gnss_"): found[name] for name in _FIXES}
    return ", ".join(f"{name} {one.mean:.2f} ({one.low:.2f} to {one.high:.2f})" for name, one in rows.items())


def go_over(told: tuple[float, float, float]) -> dict[str, MeanNis]:
    """Return the mean NIS of loose-15 after its receiver switches from the nose to the tail antenna.

    ``told`` is where the filter takes the second antenna to be [m], b.
    """
    profile, (truth, begin) = load_step(), fly_step()
    solutions = []
    for draw in range(_DRAWS):
        nose, tail = (
            sensors.sense(truth, replace(profile.sensors, antenna_b=at), profile.seed, draw)
            for at in (_NOSE, _TAIL)
        )
        built = pipeline.build_estimator(profile.estimators[0])
        one = PieceFilter("loose-15", {}, built, nose.initial, 1.0)
        later = replace(tail.data, antenna_b=np.array(told))
        solutions += [one.update(slice_sensors(nose.data, -np.inf, begin))]
        solutions += [one.update(slice_sensors(later, begin, np.inf)), one.finish()]
    return average_nis(solutions, begin + 0.05, begin + _STEP_S)


def switch_antenna() -> RowFinding:
    """#30: NIS of the fixes after a change of the antenna, also of a filter with the old lever arm."""
    right, wrong = go_over(_TAIL), go_over(_NOSE)
    text = f"NIS {_tell_nis(right)}; with the first arm {wrong['gnss_position'].mean:.0f}"
    return RowFinding(text, _check_nis(right, wrong))


class _KeepingWorkers(StudyWorkers):
    """Workers that store their last result."""

    kept: Sequence[Any] = ()

    def map(
        self, what: str, function: Callable[[Any], Any], items: Sequence[Any], first: Sequence[int] = ()
    ) -> list[Any]:
        """Return what a function returns for each item."""
        self.kept = found = super().map(what, function, items, first)
        return found


def count_seconds(flights: Sequence[WatchedFlight]) -> dict[str, tuple[float, float, float, str]]:
    """Return value, bounds and word of the horizontal lines, counted second by second.

    The bounds are those of a count without an event, ``0.05^(1/n)`` at least after n flights that were good
    all the time, and ``ln 20`` over what was tried at most: a study that saw an event differs from them.
    """
    sure, begun, lost, misled = list[bool](), 0, 0, 0
    for one in flights:
        error, level = one.error[:, 0].tolist(), one.level[:, 0].tolist()
        relied = [not a and x <= _ALERT_LIMIT for a, x in zip(one.alarm, level, strict=True)]
        sure += relied
        for k in range(0, len(relied) - _OPERATION + 1, _OPERATION):
            begun += relied[k]
            lost += relied[k] and not all(relied[k : k + _OPERATION])
        wrong = [e > max(x, _ALERT_LIMIT) for e, x in zip(error, level, strict=True)]
        misled += any(r and w for r, w in zip(relied, wrong, strict=True))
    hours, least = len(sure) / HOUR, 0.05 ** (1.0 / len(flights))
    risk, hazards = (math.log(20.0) / tried for tried in (begun, hours))
    return {
        "availability": (sum(sure) / len(sure), least, 1.0, "met" if least >= 0.95 else "undecided"),
        "risk of an alert in 15 s": (lost / begun, 0.0, risk, "met" if risk <= 1e-4 else "undecided"),
        "hazardously misleading, per hour": (
            misled / hours, 0.0, hazards, "met" if hazards <= 1e-5 else "undecided",
        ),
    }  # fmt: skip


def require_performance() -> RowFinding:
    """#33: the lines of a procedure by flights of tight, compared with a count of their seconds."""
    work = _KeepingWorkers(1)
    with work:
        found = rnp.run(rnp.Options(profiles=("waypoints",), gnss="sky-l1", runs=FLIGHTS), work)
    table = found.tables[0].columns
    columns = (table[name] for name in ("value", "low", "high", "word"))
    rows = dict(zip(table["figure"], zip(*columns, strict=True), strict=True))
    told, off = list[str](), list[float]()
    for figure, (*counted, word) in count_seconds(work.kept).items():
        *ours, said = rows[f"{figure}, horizontal"]
        told.append("{} {:.2g} ({:.2g} to {:.2g}, {})".format(figure, *ours, said))
        off.append(0.0 if word == said else math.inf)
        off += [abs(a - b) / max(abs(b), 1e-12) for a, b in zip(ours, counted, strict=True)]
    hours = sum(len(one.t) for one in work.kept) / HOUR
    text = f"{FLIGHTS} flights, {hours:.2g} h: {', '.join(told)}"
    return RowFinding(text, tuple(below(one, 1e-9) for one in off))


def come_back() -> RowFinding:
    """#60: the increments of ten minutes, integrated, against the truth."""
    found = pipeline.fly_over(read_profile("figure-eight", {}, None, None))
    return RowFinding(f"{1e3 * found['replay_position_m']:.1g} mm", (below(found["replay_position_m"], 1.0),))
