"""Faults beside another condition: ``python -m tests.navigation.fault_pairs [RUNS]``.

A rule of the gate is made for one thing that goes wrong. Here every fault of a receiver or barometer comes
during or after an outage, a gap of the IMU, late fixes, a step of the receiver clock, or a restart after a
long gap. In the end the filter has to be as good as one whose faulty measurements were flagged invalid, or to
report its error.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from bench.core.records.data import NavSolution, SensorData, Trajectory
from bench.core.records.sensor_specs import Fault, SensorsSpec
from bench.evaluation.errors.error_series import error_series
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.simulation import sensors
from tests.weaving import units, weaving

BEGIN = 25.0
"""Of each fault [s]."""
LAST = 60.0
"""The errors of so many seconds at the end count [s]."""
WORSE = 1.3
"""Largest ratio of pooled horizontal RMS."""
SEED = 41
FLIGHT = 121.0
FILTERS = ("loose-full", "smoother", "tight")
CONDITIONS = ("none", "outage", "imu gap", "late fixes", "clock step", "restart")
PHASES = {"before": (BEGIN - 12.0, BEGIN), "during": (BEGIN - 5.0, BEGIN + 7.0)}
_STEP, _SIDE = (750.0, 0.0, 0.0), (0.0, 300.0, 0.0)
_FIVE = ((0, 2), (0, 5), (0, 12), (0, 15), (0, 25))
_NONE3 = (0.0, 0.0, 0.0)


def _fault(kind: str, sensor: str, lasts: float, **keys: Any) -> Fault:
    return Fault(kind, sensor, BEGIN, BEGIN + lasts, kind, **keys)


def _spoofed(lasts: float, **keys: Any) -> Fault:
    return _fault("spoofing", "gnss", lasts, **{"step": _NONE3, "ramp": _NONE3, **keys})


KINDS: dict[str, tuple[Fault, dict[str, Any]]] = {
    "step of 3 s": (_spoofed(3.0, step=_STEP), {}),
    "step of 3 s, 10 Hz": (_spoofed(3.0, step=_STEP), {"rate": 10.0}),
    "side step of 8 s": (_spoofed(8.0, step=_SIDE), {}),
    "step of 25 s": (_spoofed(25.0, step=_STEP), {}),
    "step of 25 s, 5 Hz": (_spoofed(25.0, step=_STEP), {"rate": 5.0}),
    "step of 25 s, 10 Hz": (_spoofed(25.0, step=_STEP), {"rate": 10.0}),
    "ramp of the position": (_spoofed(25.0, ramp=(0.0, 3.0, 0.0), coherent=False), {}),
    "ramp with its velocity": (_spoofed(25.0, ramp=(0.0, 3.0, 0.0)), {}),
    "frozen": (_fault("frozen", "gnss", 25.0), {}),
    "noise burst": (_fault("noise-burst", "gnss", 25.0, times=20.0), {}),
    "latency": (_fault("latency", "gnss", 25.0, delay=2.0), {}),
    "dropped": (_fault("dropped", "gnss", 25.0, share=0.7), {}),
    "repeated": (_fault("repeated", "gnss", 25.0, share=0.7), {}),
    "pseudoranges": (_fault("pseudorange", "gnss", 25.0, satellites=_FIVE, step=(80.0,), ramp=(0.0,)), {}),
    "satellite clocks": (
        _fault("satellite-clock", "gnss", 25.0, satellites=_FIVE[:2], step=(0.0,), ramp=(3.0,)),
        {},
    ),
    "receiver clock": (_fault("receiver-clock", "gnss", 25.0, step=(3e3,), ramp=(0.0,)), {}),
    "jamming": (_fault("jamming", "gnss", 25.0, loss=12.0), {}),
    "satellites lost": (_fault("satellites-lost", "gnss", 25.0, satellites=_FIVE), {}),
    "barometer step": (_fault("baro-step", "baro", 25.0, step=(60.0,), ramp=(0.0,)), {}),
    "barometer frozen": (_fault("frozen", "baro", 25.0), {}),
}
"""Fault -> what it is, and what is other of the receiver. Each strikes a receiver that has it."""
SKY_ONLY = ("pseudorange", "satellite-clock", "receiver-clock", "jamming", "satellites-lost")


EXCEPTED = {
    "spoofed ranges": "all ranges and rates move alike, as if the aircraft did",
    "spoofed with its velocity": "the same of a fix, once the gate re-admits it after ten seconds",
    "frozen": "after an outage or a gap, and in all ranges, the frozen output is all that comes",
    "ranges after a gap of seconds": "the covariance has grown so far that every range passes",
}
"""What cannot be seen -> why."""


@dataclass(frozen=True)
class Case:
    """A fault beside a condition, for one filter."""

    use: str
    kind: str
    condition: str
    phase: str


def excepted(case: Case) -> str | None:
    """Return which of `EXCEPTED` a case is."""
    fault, _ = KINDS[case.kind]
    if fault.kind == "spoofing" and case.use == "tight":
        return "spoofed ranges"
    if fault.kind == "spoofing" and any(fault.ramp) and fault.coherent:
        return "spoofed with its velocity"
    if fault.kind == "frozen" and fault.sensor == "gnss":
        return "frozen"
    return "ranges after a gap of seconds" if (case.use, case.condition) == ("tight", "restart") else None


def list_cases() -> Iterator[Case]:
    """Yield all cases; those without a condition are in one phase."""
    for use in FILTERS:
        for kind, (fault, _) in KINDS.items():
            if use != "tight" and fault.kind in SKY_ONLY:
                continue
            for condition in CONDITIONS:
                for phase in PHASES if condition != "none" else ["before"]:
                    yield Case(use, kind, condition, phase)


@cache
def flight() -> Trajectory:
    """The truth, in a wind."""
    return weaving(FLIGHT, 50.0, wind_n=[5.0, -4.0, 0.0])


@cache
def _sensors(imu: str, gnss: str) -> SensorsSpec:
    return read_profile("figure-eight", {"sensors.imu": imu, "sensors.gnss": gnss}).sensors


def sense(case: Case, run: int) -> SensorData:
    """Return the record of a run and its start; the odd runs have a consumer IMU."""
    fault, changes = KINDS[case.kind]
    begin, end = PHASES[case.phase]
    catalog = _sensors(("adis16475", "icm-42688-p")[run % 2], "sky-l1" if case.use == "tight" else "l1-code")
    assert catalog.gnss is not None
    faults, outages = (fault,), ()
    if case.condition == "outage":
        outages = ((begin, end),)
    elif case.condition in ("imu gap", "restart"):
        lasts = 0.3 if case.condition == "imu gap" else 4.0
        faults += (Fault("dropped", "imu", end - lasts, end, "gap"),)
    elif case.condition == "late fixes":
        faults += (Fault("latency", "gnss", begin, end, "late", delay=1.5),)
    elif case.condition == "clock step" and case.use == "tight":
        faults += (Fault("receiver-clock", "gnss", begin, end, "clock", step=(600.0,), ramp=(0.0,)),)
    if len({(one.kind, one.sensor) for one in faults}) < len(faults):  # the condition is the fault
        faults = faults[:1]
    spec = units(catalog.imu, replace(catalog.gnss, **changes), catalog.baro)
    spec = replace(spec, faults=faults, gnss_outages=outages, output_rate=2.0)
    drawn = sensors.sense(flight(), spec, SEED, run)
    if case.condition == "clock step" and drawn.data.fixes is not None and case.use != "tight":
        fixes = drawn.data.fixes
        off = 0.3 * ((fixes.t >= begin) & (fixes.t < end))
        drawn = replace(drawn, data=replace(drawn.data, fixes=replace(fixes, t=fixes.t - off)))
    return drawn


def flagged(data: SensorData, fault: Fault, use: str) -> SensorData:
    """Return a record whose faulty measurements are flagged invalid."""

    def struck(t: Any) -> Any:
        return (t >= fault.start - 1e-6) & (t < fault.end - 1e-6)

    if fault.sensor == "baro":
        assert data.baro is not None
        return replace(data, baro=replace(data.baro, valid=data.baro.valid & ~struck(data.baro.t)))
    if use != "tight":
        assert data.fixes is not None
        return replace(data, fixes=replace(data.fixes, valid=data.fixes.valid & ~struck(data.fixes.t)))
    seen = data.observations
    assert seen is not None
    rows = struck(seen.t[seen.epoch] if len(seen.t) < len(seen.sat) else seen.t)
    if fault.satellites:
        rows &= np.array([(s, n) in fault.satellites for s, n in zip(seen.system, seen.sat, strict=True)])
    columns = {
        name: np.where(rows[:, None], np.nan, getattr(seen, name)) for name in ("pseudorange", "range_rate")
    }
    return replace(data, observations=replace(seen, **columns))


def errors_at_end(solution: NavSolution) -> tuple[float, bool]:
    """Return the mean square of the horizontal errors at the end [m^2], and whether 3 sigma hold them."""
    errors = error_series(flight(), solution)
    late = errors.t > FLIGHT - LAST
    sigma = np.sqrt(np.einsum("kii->ki", solution.cov[late, :2, :2]).sum(axis=1))
    square = np.sum(errors.pos_n[late, :2] ** 2, axis=1)
    if not np.isfinite(square).all():
        return np.inf, False
    return float(square.mean()), bool(square.mean() <= 9.0 * np.mean(sigma**2))


def measure(case: Case, runs: int = 4) -> tuple[float, float, bool]:
    """Return the pooled horizontal RMS with the fault and with it flagged [m], and whether it is reported."""
    found, held = [], []
    for run in range(runs):
        drawn = sense(case, run)
        filter_ = load(case.use, {})
        square, inside = errors_at_end(filter_.run(drawn.data, drawn.initial))
        good, _ = errors_at_end(
            filter_.run(flagged(drawn.data, KINDS[case.kind][0], case.use), drawn.initial)
        )
        found.append((square, good))
        held.append(inside)
    bad, good = np.sqrt(np.mean(found, axis=0))
    return float(bad), float(good), all(held)


def main() -> None:
    """Print a row for each case, with ``!`` where it misses and ``x`` where that is excepted."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    for case in list_cases():
        bad, good, held = measure(case, runs)
        mark = " " if bad <= WORSE * good or held else "x" if excepted(case) else "!"
        print(f"{mark} {bad / good:7.2f} {bad:8.2f} {good:8.2f} {held!s:5} {case.use:10} {case.kind:24} "
              f"{case.condition:11} {case.phase}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
