"""Simulation of all sensors on board: their reports of the true motion."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Events, InitialState, SensorData, Trajectory
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.run_records import Sensed, SensorTruth, SkyView
from bench.core.records.sensor_specs import SensorsSpec
from bench.core.words.exceptions import ConfigError
from bench.simulation.sensors import faults, gnss, imu, initial
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.measurement_level import sky
from bench.simulation.sensors.timing import check_duration, select_output_times


def sense(truth: Trajectory, spec: SensorsSpec, seed: int, run: int) -> Sensed:
    """Simulate all sensors and draw the initial state of the estimators.

    Parameters
    ----------
    truth : Trajectory
        The motion.
    spec : SensorsSpec
        The sensors on board, outages and faults.
    seed, run : int
        Select the noise; the same pair gives the same bits.

    Returns
    -------
    sensed : Sensed
        GNSS outages are ignored without a receiver.

    Raises
    ------
    ValueError
        If a sensor is faster than the truth, a figure of the IMU is missing, there is no magnetic model for
        the date, or a sensor needs the air and the truth has no air data.
    ConfigError
        If the flight is too short for a row of each sensor, and a solution.
    """
    units = {"gnss": spec.gnss, **{name: getattr(spec, name) for name in INSTRUMENTS}}
    rates = {name: unit.rate for name, unit in units.items() if unit is not None}
    try:
        for name, rate in {**rates, "output": spec.output_rate}.items():
            check_duration(name, truth.t, rate)
    except ValueError as error:
        raise ConfigError(f"{error}; it needs a longer flight or a higher rate") from None
    measured = sense_piece(truth, spec, SensorDraws(seed, run))
    instants = select_output_times(truth.t, spec.output_rate, measured.outages)
    events = [(start, end, "gnss_outage", "GNSS outage", "gnss") for start, end in measured.outages]
    events += [(fault.start, fault.end, "fault", fault.text, fault.sensor) for fault in spec.faults]
    return Sensed(
        data=replace(measured.data, output_t=instants),
        initial=measured.initial,
        truth=measured.truth,
        events=Events.from_rows(events),
        sky=measured.above,
    )


class SensedPiece(NamedTuple):
    """Sensor data of a piece of a flight."""

    data: SensorData  # rows by their time of validity; no epochs of answers
    initial: InitialState  # at the start of the flight
    truth: SensorTruth
    above: SkyView | None
    outages: tuple[tuple[float, float], ...]


def sense_piece(truth: Trajectory, spec: SensorsSpec, draws: SensorDraws) -> SensedPiece:
    """Simulate all sensors over the next piece of a flight; the division does not change the result.

    ``truth`` begins with the last epoch of the piece before, and so do its air data. All but the last piece
    end on the 20 Hz of the guidance. ``draws`` keeps what the sensors carry on. Errors as for :func:`sense`.
    """
    outages = spec.gnss_outages if spec.gnss is not None else ()
    scripted = spec.faults

    def evaluate_faults(sensor: str, width: int) -> FloatArray:
        return faults.evaluate_steps(bias.t, faults.select_faults(scripted, sensor, f"{sensor}-step"), width)

    start = draws.keep("start", lambda: initial.draw_initial_state(truth, spec, draws))
    imu_data, bias = imu.measure(truth, spec.imu, draws)
    imu_data = faults.apply_to_imu(imu_data, spec.imu, scripted, draws)
    fixes, observations, above = None, None, None
    if spec.gnss is not None and spec.gnss.sky is not None:
        seen = sky.measure(truth, spec.gnss, spec.antenna_b, outages, draws, scripted)
        fixes, observations, above = seen.fixes, seen.observations, seen.above
    elif spec.gnss is not None:
        fixes = gnss.measure(truth, spec.gnss, spec.antenna_b, outages, draws, scripted)
    records: dict[str, Any] = dict.fromkeys(INSTRUMENTS)
    drawn: dict[str, FloatArray] = {}
    for name, row in INSTRUMENTS.items():
        unit = getattr(spec, name)
        if unit is not None:
            disk_arrays.release()
            model = draws.keep(name, partial(import_module, f"bench.simulation.sensors.{row.model}"), "model")
            record, error = model.report(truth, spec, draws)
            if len(record):
                drawn[name] = _interpolate_error(bias.t, record.t, error) + evaluate_faults(name, row.width)
            resolution = unit.quantization if row.rounds else 0.0
            record = faults.apply_to_instrument(record, name, row.value, resolution, scripted, draws)
            records[name] = model.limit_output(record, unit) if hasattr(model, "limit_output") else record
    data = SensorData(
        imu=imu_data,
        fixes=fixes,
        antenna_b=np.array(spec.antenna_b),
        specs=spec.assumed,
        output_t=np.empty(0),
        observations=observations,
        ground_alt=spec.ground_alt,
        **records,
        date=spec.date,
    )
    true = SensorTruth(
        bias.t, bias.gyro_b + evaluate_faults("gyro", 3), bias.accel_b + evaluate_faults("accel", 3), drawn
    )
    return SensedPiece(data, start, true, above, outages)


def _interpolate_error(t: FloatArray, sampled: FloatArray, error: FloatArray) -> FloatArray:
    """Interpolate the error (M, k) or (M,) of an instrument to times t (B,); return (B, k)."""
    columns = error.reshape(len(sampled), -1).T
    return np.column_stack([np.interp(t, sampled, column) for column in columns])
