"""Possible causes of an inconsistent run, and the sensors without each cause.

Candidates are the faults, the errors of the simulated sensors for which a filter reports no state, and sensor
parameters that it assumes wrongly. Removing a candidate changes the simulated sensors, not the assumed
datasheet; its noise has a generator of its own, so that all other noise stays the same bit by bit.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from bench.core.records.fields import figures_of, triad_figures_of
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import SampleClockSpec, SensorsSpec, TriadSpec, VibrationSpec
from bench.evaluation.linear.terms import list_sources

TRIADS = {"gyro": "gyro", "accel": "accelerometer"}
"""Field of `ImuSpec` -> how its errors begin."""

WANDER = "time-correlated GNSS position error"
"""What a filter of fixes calls all that lasts in the ranges of a receiver at measurement level."""

_JUMPS = tuple(f"{axes}_{kind}_sd" for axes in ("pos_h", "pos_v", "vel") for kind in ("jump", "jump_markov"))
_IRON = ("hard_iron_sd", "soft_iron_sd", "scale_factor_sd", "misalignment_sd")
SENSOR_ERRORS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    WANDER: ("gnss", ("pos_h_markov_sd", "pos_v_markov_sd")),
    "time-correlated GNSS velocity error": ("gnss", ("vel_markov_sd",)),
    "error of carrier-smoothed code": ("gnss", ("pos_h_smooth_sd", "pos_v_smooth_sd")),
    "GNSS latency": ("gnss", ("latency", "latency_jitter")),
    "time tags of the fixes": ("gnss", ("time_tag_error",)),
    "lag of the receiver under acceleration": ("gnss", ("tracking_bandwidth",)),
    "jumps of the GNSS error where the satellites change": ("gnss", _JUMPS),
    "barometer quantization": ("baro", ("quantization",)),
    "barometer errors with height, airspeed and incidence": ("baro", ("physical",)),
    "airspeed bias and scale factor": ("airspeed", ("bias_sd", "pressure_bias_sd", "scale_factor_sd")),
    "airspeed lag": ("airspeed", ("lag",)),
    "magnetometer calibration": ("mag", _IRON),
    "field of motor currents": ("mag", ("motor_field_sd",)),
    "radar altimeter bias": ("radar", ("bias_sd",)),
    "radar altimeter quantization": ("radar", ("quantization",)),
    "odometer scale factor": ("odometer", ("scale_factor_sd",)),
    "odometer quantization": ("odometer", ("quantization",)),
}
"""Error of an aiding sensor, as filters name it -> its field of `SensorsSpec` and the figures of it."""
SKY_ERRORS: Mapping[str, tuple[str, ...]] = {
    "satellite orbit and clock error": (
        "gps_space_sd",
        "glonass_space_sd",
        "galileo_space_sd",
        "beidou_space_sd",
    ),
    "ionosphere beyond the broadcast model": ("ionosphere_sd", "ionosphere_share"),
    "troposphere beyond the model": ("troposphere_sd",),
    "multipath": ("multipath_zenith_sd", "multipath_horizon_sd"),
    "flicker of the receiver's clock": ("clock_h_m1",),
    "g-sensitivity of the receiver's clock": ("clock_g",),
}
"""The same of the ranges of a receiver at measurement level -> figures of `sky_spec.SkySpec`."""
_OF_BOTH = ("GNSS latency", "lag of the receiver under acceleration")  # of fixes and of ranges
_CLOCK = ("flicker of the receiver's clock", "g-sensitivity of the receiver's clock")

Removal = Callable[[SensorsSpec], SensorsSpec]


@dataclass(frozen=True, slots=True)
class Candidate:
    """One possible cause of an inconsistent run."""

    words: str
    group: str  # of those that are tried together first
    remove: Removal  # sensors -> the same without it
    error: str = ""  # what a filter calls it that has no state for it; empty: none would help
    assumed: bool = False  # a figure that is assumed otherwise


def list_candidates(spec: SensorsSpec, unmodeled: Collection[str]) -> list[Candidate]:
    """Return all possible causes of an inconsistent run.

    Parameters
    ----------
    spec : SensorsSpec
        The sensors on board.
    unmodeled : collection of str
        The errors of these sensors that the filter has no state for.
    """
    errors = list(_list_errors(spec, unmodeled))
    return [*_list_faults(spec), *errors, *_list_other_figures(spec, {one.error for one in errors})]


def _list_faults(spec: SensorsSpec) -> Iterator[Candidate]:
    for number, fault in enumerate(spec.faults, 1):
        yield Candidate(f"fault {number} ({fault.kind})", "faults", partial(_drop_fault, fault))


def _drop_fault(fault: object, spec: SensorsSpec) -> SensorsSpec:
    return replace(spec, faults=tuple(one for one in spec.faults if one is not fault))


def _list_errors(spec: SensorsSpec, unmodeled: Collection[str]) -> Iterator[Candidate]:
    """Yield the errors of the sensors that a filter has no state for."""
    for part, title in TRIADS.items():
        for error, names in _name_triad_errors(title).items():
            sized = any(getattr(getattr(spec.imu, part), name) for name in names)
            if error in unmodeled and sized:
                yield Candidate(error, title, partial(_change_triad, part, names, None), error)
    without: Mapping[str, Mapping[str, Any]] = {
        "distance between the accelerometers": {"accel_arms": ()},
        "time tags of the IMU": {"clock": SampleClockSpec()},
        "vibration": {"vibration": VibrationSpec()},
    }
    for error, changed in without.items():
        if error in unmodeled:
            yield Candidate(error, "imu", partial(_change_part, "imu", changed), error)
    for error, (part, names) in SENSOR_ERRORS.items():
        sensor = getattr(spec, part)
        drawn = part != "gnss" or sensor is None or sensor.sky is None or error in _OF_BOTH
        if sensor is not None and error in unmodeled and drawn:
            changed = {name: None if name == "physical" else 0.0 for name in names}
            yield Candidate(error, part, partial(_change_part, part, changed), error)
    if spec.gnss is not None and spec.gnss.sky is not None:
        for error, names in SKY_ERRORS.items():
            lasts = WANDER in unmodeled and error not in _CLOCK
            if (error in unmodeled or lasts) and any(getattr(spec.gnss.sky, name) for name in names):
                changed = dict.fromkeys(names, 0.0)
                yield Candidate(error, "gnss", partial(_change_sky, changed), error)


def _name_triad_errors(title: str) -> dict[str, tuple[str, ...]]:
    """Return the error names of a triad that filters use, each with the datasheet values of this error."""
    found: dict[str, tuple[str, ...]] = {}
    for name, declared in triad_figures_of(TriadSpec).items():
        if declared.error:
            found[f"{title} {declared.error}"] = (*found.get(f"{title} {declared.error}", ()), name)
    found[f"{title} bias instability as flicker noise"] = ("bias_instability",)
    return found | {f"{title} noise through the filter of the bandwidth": ("noise_shape",)}


def _list_other_figures(spec: SensorsSpec, named: Collection[str]) -> Iterator[Candidate]:
    """Yield the datasheet values that filters assume differently from the simulation; skip named errors."""
    taken = {
        (part, name)
        for part, title in TRIADS.items()
        for error, names in _name_triad_errors(title).items()
        if error in named
        for name in names
    } | {
        (part, name)
        for error in named
        for part, names in (SENSOR_ERRORS.get(error, ("", ())),)
        for name in names
    }
    for source in list_sources():
        names = tuple(name for name in source.figures if (source.part, name) not in taken)
        words = f"{source.name} other than assumed"
        if source.part in TRIADS:
            own, other = (getattr(imu, source.part) for imu in (spec.imu, spec.assumed.imu))
            if any(_figure(own, name) != _figure(other, name) for name in names):
                remove = partial(_change_triad, source.part, names, other)
                yield Candidate(words, TRIADS[source.part], remove, assumed=True)
        elif source.part in ("gnss", "baro"):
            drawn = source.part == "baro" or spec.gnss is None or spec.gnss.sky is None
            if drawn:
                yield from _compare(spec, source.part, names, words)
    if spec.gnss is not None and spec.gnss.optimism != 1.0:
        remove = partial(_change_part, "gnss", {"optimism": 1.0})
        yield Candidate("standard deviations of the receiver that are wrong", "gnss", remove, assumed=True)
    for part, row in INSTRUMENTS.items():
        for name in figures_of(row.spec) if part != "baro" else ():
            if (part, name) not in taken:
                words = f"{row.title} {name.removesuffix('_sd').replace('_', ' ')} other than assumed"
                yield from _compare(spec, part, (name,), words)


def _compare(spec: SensorsSpec, part: str, names: Collection[str], words: str) -> Iterator[Candidate]:
    """Yield a candidate if filters assume other values of an aiding sensor than the simulation has."""
    own, other = getattr(spec, part), getattr(spec.assumed, part)
    if own is None or other is None:
        return
    changed = {name: getattr(other, name) for name in names if getattr(own, name) != getattr(other, name)}
    if changed:
        yield Candidate(words, part, partial(_change_part, part, changed), assumed=True)


def _figure(triad: TriadSpec, name: str) -> tuple[Any, tuple[Any, ...]]:
    return getattr(triad, name), tuple(one for one in triad.axes or () if one.name == name)


def _change_triad(
    part: str, names: Collection[str], other: TriadSpec | None, spec: SensorsSpec
) -> SensorsSpec:
    """Return sensors with some values of a triad copied from another triad; None switches the errors off."""
    own: TriadSpec = getattr(spec.imu, part)
    other = TriadSpec() if other is None else other
    axes = [one for one in own.axes or () if one.name not in names]
    axes += [one for one in other.axes or () if one.name in names]
    changed = {name: getattr(other, name) for name in names}
    triad = replace(own, **changed, axes=tuple(axes))
    return _change_part("imu", {part: triad}, spec)


def _change_part(part: str, changed: Mapping[str, Any], spec: SensorsSpec) -> SensorsSpec:
    return replace(spec, **{part: replace(getattr(spec, part), **changed)})


def _change_sky(changed: Mapping[str, Any], spec: SensorsSpec) -> SensorsSpec:
    assert spec.gnss is not None
    assert spec.gnss.sky is not None
    return _change_part("gnss", {"sky": replace(spec.gnss.sky, **changed)}, spec)
