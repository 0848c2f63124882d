"""Metrics of fault detection: was a scripted fault detected, how soon, and how many alarms were false?

An alarm is an update that the filter rejected, or an event of kind "integrity" that it reported. It
belongs to a fault if it is raised in the interval of the fault and names the faulty sensor. A fault of the
IMU can raise an alarm in any update. A gate rejects a sound measurement now and then, so a fault is detected
at the first event, or at the first of two rejections in a row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import HOUR, SAME_INSTANT
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import Fault
from bench.evaluation.metrics.case import Alarms, Case

_SHOWS_IN: Mapping[str, tuple[str, ...]] = {
    "gnss": ("gnss", "pseudorange", "range_rate"),
    **{name: (name, row.innovation) for name, row in INSTRUMENTS.items()},
}
"""Faulty sensor -> how the names in its alarms begin; a sensor that is not listed can raise any alarm."""


POSITION_UPDATES = ("gnss_position", "pseudorange")
"""Updates that a filter cannot reject for long and still count as converged."""

LONGEST_REFUSAL = 60.0
"""Longest time over which a converged filter rejects all position fixes without a pause [s]."""


def measure_delay(fault: Fault, raised: Sequence[Alarms]) -> float | None:
    """Return the time from the start of a fault until its detection [s]; None if undetected.

    It is at an event, or when two updates of one name in a row are rejected; at one if the fault has no more.
    """
    first = [_find_lasting(fault, one) for one in raised if _concerns(fault, one)]
    known = [t for t in first if t is not None]
    return max(min(known) - fault.start, 0.0) if known else None


def _find_lasting(fault: Fault, one: Alarms) -> float | None:
    """Return the first epoch in a fault of an alarm that is not refuted by the next update [s]."""
    asked = one.asked[_is_active(fault, one.asked)]
    refused = np.isin(asked, one.t)
    if len(asked) > 1:
        refused &= np.append(refused[1:], False)
    return float(asked[refused][0]) if refused.any() else None


def count_false_alarms(faults: Sequence[Fault], raised: Sequence[Alarms], name: str, begin: float) -> int:
    """Count the alarms of one name, from a time on [s], that belong to no fault."""
    count = 0
    for one in raised:
        if one.name == name:
            explained = one.t < begin
            for fault in faults:
                if _concerns(fault, one):
                    explained |= _is_active(fault, one.t)
            count += int((~explained).sum())
    return count


def _is_active(fault: Fault, t: FloatArray) -> BoolArray:
    inside: BoolArray = (t >= fault.start - SAME_INSTANT) & (t < fault.end - SAME_INSTANT)
    return inside


def _concerns(fault: Fault, raised: Alarms) -> bool:
    """Return whether alarms come from the sensor that has the fault."""
    names = _SHOWS_IN.get(fault.sensor)
    return names is None or any(sensor.startswith(names) for sensor in raised.sensors)


def fault_detected(case: Case) -> dict[str, float | None]:
    """1 if the fault was detected: two successive rejections of its sensor, or an event; else 0."""
    return {k: float(measure_delay(f, case.alarms) is not None) for k, f in case.faults.items()}


def fault_delay(case: Case) -> dict[str, float | None]:
    """Time from the start of the fault until its detection [s]; None if undetected."""
    return {k: measure_delay(f, case.alarms) for k, f in case.faults.items()}


def fault_alarm_share(case: Case) -> dict[str, float | None]:
    """Fraction of the whole seconds of the fault with a rejection of its sensor or an active event.

    Of a second in which some updates were used it is the share of the others. Of fixes and ranges those of
    the position count: who rejects only their velocities follows them. Absent of a filter that does not
    use the sensor.
    """
    found: dict[str, float | None] = {}
    for key, fault in case.faults.items():
        stop = min(fault.end, float(case.t[-1]))
        first, last = np.ceil(fault.start - SAME_INSTANT), np.floor(stop + SAME_INSTANT)
        seconds = np.arange(first, last, dtype=np.float64)
        own = [one for one in case.alarms if _concerns(fault, one)]
        updates = [one for one in own if one.end is None]
        updates = [one for one in updates if one.name in POSITION_UPDATES] or updates
        asked, refused = (
            np.unique(np.concatenate([np.empty(0), *(getattr(one, which) for one in updates)]))
            for which in ("asked", "t")
        )
        count, lost = (_count_in(seconds, t) for t in (asked, refused))
        alarmed = lost / np.maximum(count, 1.0)
        for one in own:
            if one.end is not None:
                alarmed[(seconds > one.t[0] - 1.0) & (seconds <= one.end + SAME_INSTANT)] = 1.0
        if own and len(seconds):
            found[key] = float(alarmed.mean())
    return found


def _count_in(seconds: FloatArray, t: FloatArray) -> FloatArray:
    """Return how many epochs (M,) are in each whole second (K,)."""
    first, last = (np.searchsorted(t, edge - SAME_INSTANT) for edge in (seconds, seconds + 1.0))
    return np.asarray(last - first, np.float64)


def fault_max_h(case: Case) -> dict[str, float | None]:
    """Largest horizontal position error during the fault [m]."""
    found: dict[str, float | None] = {}
    for key, fault in case.faults.items():
        first, stop = np.searchsorted(case.t, [fault.start - SAME_INSTANT, fault.end - SAME_INSTANT])
        if first < stop:
            found[key] = float(np.hypot(*case.pos_n[first:stop, :2].T).max())
    return found


def false_alarms(case: Case) -> dict[str, float | None]:
    """Number of alarms of each sensor that no fault explains; absent in a run without faults."""
    if not case.scripted:
        return {}
    count = partial(count_false_alarms, case.scripted, case.alarms, begin=case.begin - SAME_INSTANT)
    return {name: float(count(name)) for name in dict.fromkeys(one.name for one in case.alarms)}


def false_alarm_rate(case: Case) -> float | None:
    """Alarms of all sensors outside all faults, per hour."""
    seconds, alarms = _outside_faults(case)
    return HOUR * len(alarms) / len(seconds) if len(seconds) else None


def false_alarm_share(case: Case) -> float | None:
    """Fraction of the whole seconds outside all faults with an alarm."""
    seconds, alarms = _outside_faults(case)
    return float(np.isin(seconds, np.floor(alarms)).mean()) if len(seconds) else None


def _outside_faults(case: Case) -> tuple[FloatArray, FloatArray]:
    """Return the evaluated whole seconds without a fault, and the alarms in these seconds [s]."""
    first = max(case.begin, float(case.t[0]))
    seconds = np.arange(np.ceil(first - SAME_INSTANT), np.floor(case.t[-1]))
    for fault in case.scripted:
        seconds = seconds[(seconds + 1.0 <= fault.start) | (seconds >= fault.end)]
    raised = np.concatenate([np.empty(0), *(one.t for one in case.alarms)])
    return seconds, raised[np.isin(np.floor(raised), seconds)]


# --- fixes rejected for long -------------------------------------------------------------------------------


def find_refusals(case: Case) -> dict[str, tuple[float, float]]:
    """Return the longest time over which each sensor was rejected without a pause: first and last update [s].

    Updates during a scripted fault of the sensor do not count.
    """
    found = {}
    for name, updates in case.nis.items():
        one = Alarms(name, (name,), updates.t, updates.t)
        struck = np.zeros(len(updates.t), np.bool_)
        for fault in case.scripted:
            if _concerns(fault, one):
                struck |= _is_active(fault, updates.t)
        refused = np.concatenate([[False], ~updates.accepted & ~struck, [False]])
        edges = np.flatnonzero(refused[1:] != refused[:-1]).reshape(-1, 2)
        if len(edges):
            lasting = updates.t[edges[:, 1] - 1] - updates.t[edges[:, 0]]
            k = int(np.argmax(lasting))
            found[name] = float(updates.t[edges[k, 0]]), float(updates.t[edges[k, 1] - 1])
    return found


def find_lost_aiding(case: Case) -> str | None:
    """Return the reason why a filter that rejects its position fixes for long did not converge, or None."""
    for name, (start, end) in find_refusals(case).items():
        if name in POSITION_UPDATES and end - start > LONGEST_REFUSAL:
            return f"{name} was rejected from t = {start:g} to {end:g} s, {end - start:.0f} s without a pause"
    return None
