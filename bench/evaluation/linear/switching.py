"""Sensors with a single error source, for filters that still assume all error sources."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from bench.core.records.data import Trajectory
from bench.core.records.run_records import Sensed
from bench.core.records.sensor_specs import ImuSpec, SensorsSpec, TriadSpec, VibrationSpec
from bench.evaluation.linear.terms import INITIAL, Source, list_sources
from bench.simulation import sensors
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.initial import draw_initial_state


def sense_alone(truth: Trajectory, spec: SensorsSpec, source: Source, seed: int, run: int) -> Sensed:
    """Simulate the sensors with one error source; its noise is the same as in a simulation with all sources.

    The filter gets the covariance at the start of all errors.
    """
    sensed = sensors.sense(truth, keep_source(spec, source), seed, run)
    whole = draw_initial_state(truth, spec, SensorDraws(seed, run))
    return replace(sensed, initial=replace(sensed.initial, cov=whole.cov))


def keep_source(spec: SensorsSpec, source: Source) -> SensorsSpec:
    """Return sensors with only one error source; the values that filters assume do not change."""
    none = {name: _nothing(getattr(spec, name)) for names in INITIAL.values() for name in names}
    kept = {name: getattr(spec, name) for name in source.figures if source.part == "initial"}
    imu = spec.imu
    return replace(
        spec,
        **(none | kept),
        imu=ImuSpec(
            imu.name,
            _keep_triad(imu.gyro, source.figures if source.part == "gyro" else ()),
            _keep_triad(imu.accel, source.figures if source.part == "accel" else ()),
            imu.thermal,
            imu.vibration if "vibration" in source.figures else VibrationSpec(),
            accel_arms=imu.accel_arms if "accel_arms" in source.figures else (),
        ),
        gnss=None if spec.gnss is None else _keep(spec.gnss, "gnss", source),
        baro=None if spec.baro is None else _keep(spec.baro, "baro", source),
    )


def _nothing(value: Any) -> Any:
    return tuple(0.0 for _ in value) if isinstance(value, tuple) else 0.0


def _keep_triad(triad: TriadSpec, figures: tuple[str, ...]) -> TriadSpec:
    axes = tuple(one for one in triad.axes if one.name in figures)
    return TriadSpec(**{name: getattr(triad, name) for name in figures}, axes=axes)


def _keep(spec: Any, part: str, source: Source) -> Any:
    """Return the datasheet of an aiding sensor with the errors of one source."""
    errors = {name for one in list_sources() if one.part == part for name in one.figures}
    if source.part == part and "physical" in source.figures:
        return spec
    off = errors - set(source.figures if source.part == part else ())
    names = {field.name for field in fields(spec)} & off
    return replace(spec, **{name: None if name == "physical" else 0.0 for name in names})
