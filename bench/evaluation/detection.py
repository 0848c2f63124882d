"""Did an estimator notice a scripted fault, how soon, and how often did it cry for nothing?

An alarm is an update that the estimator refused, or an event of kind "integrity" that it reported. It belongs
to a fault when it comes in the fault's interval and concerns the sensor that is struck; a fault of the IMU
shows in any update.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bench.arrays import BoolArray, FloatArray
from bench.data import Events
from bench.evaluation.consistency import SensorNis
from bench.instruments import INSTRUMENTS
from bench.specs import Fault
from bench.units import SAME_INSTANT

if TYPE_CHECKING:
    from bench.evaluation.metrics import Case

ALARM = "integrity"
"""Kind of the events by which an estimator raises an alarm; the text names the sensor."""

_SHOWS_IN: Mapping[str, tuple[str, ...]] = {
    "gnss": ("gnss", "pseudorange", "range_rate"),
    **{name: (name, row.innovation) for name, row in INSTRUMENTS.items()},
}
"""Sensor that is struck -> what its alarms name; sensors not listed show in all."""


@dataclass(frozen=True, slots=True)
class Alarms:
    """Alarms that say the same."""

    name: str  # of the innovation, or "integrity"
    said: str  # names the sensor: the name of the innovation, or the words of the event
    t: FloatArray  # (K,) [s]


def alarms(nis: Mapping[str, SensorNis], events: Events) -> tuple[Alarms, ...]:
    """Return the alarms of an estimator: refused updates by sensor, then events of kind "integrity"."""
    refused = [Alarms(name, name, s.t[~s.accepted]) for name, s in nis.items()]
    reported = [Alarms(ALARM, text.lower(), np.array([start])) for start, _, text in events.of(ALARM)]
    return (*refused, *reported)


def delay(fault: Fault, raised: Sequence[Alarms]) -> float | None:
    """Return the time from the start of a fault to its first alarm [s], None when there is none."""
    first = [
        float(one.t[inside].min())
        for one in raised
        if _concerns(fault, one.said) and (inside := _inside(fault, one.t)).any()
    ]
    return max(min(first) - fault.start, 0.0) if first else None


def _unexplained(faults: Sequence[Fault], raised: Sequence[Alarms], name: str, from_s: float) -> int:
    """Return how many alarms of a name from an instant [s] on belong to no fault."""
    count = 0
    for one in raised:
        if one.name == name:
            explained = one.t < from_s
            for fault in faults:
                if _concerns(fault, one.said):
                    explained |= _inside(fault, one.t)
            count += int((~explained).sum())
    return count


def _inside(fault: Fault, t: FloatArray) -> BoolArray:
    inside: BoolArray = (t >= fault.start - SAME_INSTANT) & (t < fault.end - SAME_INSTANT)
    return inside


def _concerns(fault: Fault, said: str) -> bool:
    named = _SHOWS_IN.get(fault.sensor)
    return named is None or any(name in said for name in named)


def fault_detected(case: Case) -> dict[str, float | None]:
    """1 when an alarm came while the fault was there, else 0."""
    return {k: float(delay(f, case.alarms) is not None) for k, f in case.faults.items()}


def fault_delay(case: Case) -> dict[str, float | None]:
    """Time from the start of the fault to its first alarm [s]; None when undetected."""
    return {k: delay(f, case.alarms) for k, f in case.faults.items()}


def fault_max_h(case: Case) -> dict[str, float | None]:
    """Largest horizontal position error while the fault was there [m]."""
    found: dict[str, float | None] = {}
    for key, fault in case.faults.items():
        first, stop = np.searchsorted(case.t, [fault.start - SAME_INSTANT, fault.end - SAME_INSTANT])
        if first < stop:
            found[key] = float(np.hypot(*case.pos_n[first:stop, :2].T).max())
    return found


def false_alarms(case: Case) -> dict[str, float | None]:
    """Number of alarms of each sensor that no fault explains; none are counted in a run without faults."""
    if not case.scripted:
        return {}
    names = dict.fromkeys(one.name for one in case.alarms)
    return {
        name: float(_unexplained(case.scripted, case.alarms, name, case.from_s - SAME_INSTANT))
        for name in names
    }
