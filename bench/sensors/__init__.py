"""What the instruments on board would have reported of the true motion."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.data import Events, Sensed, SensorData, SensorTruth, Trajectory
from bench.instruments import INSTRUMENTS
from bench.sensors import faults, gnss, imu, initial, sky
from bench.sensors.timing import output_times
from bench.specs import SensorsSpec


def sense(truth: Trajectory, spec: SensorsSpec, seed: int, run: int) -> Sensed:
    """Return one draw of all sensors and of the initial state.

    Parameters
    ----------
    truth : Trajectory
        The motion.
    spec : SensorsSpec
        The units on board and what is scripted to happen to them.
    seed, run : int
        Which draw; the same pair gives the same bits.

    Returns
    -------
    sensed : Sensed
        GNSS outages count only with a receiver.

    Raises
    ------
    ValueError
        When a sensor is faster than the truth, an IMU figure is missing, there is no magnetic model for the
        date, or a sensor feels the air and the truth says nothing of it.
    """
    outages = spec.gnss_outages if spec.gnss is not None else ()
    scripted = spec.faults

    def stepped(sensor: str, width: int) -> FloatArray:
        return faults.steps(bias.t, faults.of(scripted, sensor, f"{sensor}-step"), width)

    imu_data, bias = imu.measure(truth, spec.imu, seed, run)
    imu_data = faults.imu(imu_data, spec.imu, scripted, seed, run)
    fixes, observations, above = None, None, None
    if spec.gnss is not None and spec.gnss.sky is not None:
        seen = sky.measure(truth, spec.gnss, spec.antenna_b, outages, seed, run, scripted)
        fixes, observations, above = seen.fixes, seen.observations, seen.above
    elif spec.gnss is not None:
        fixes = gnss.measure(truth, spec.gnss, spec.antenna_b, outages, seed, run, scripted)
    records: dict[str, Any] = dict.fromkeys(INSTRUMENTS)
    drawn: dict[str, FloatArray] = {}
    for name, row in INSTRUMENTS.items():
        unit = getattr(spec, name)
        if unit is not None:
            model = import_module(f"bench.sensors.{row.model}")
            record, error = model.report(truth, spec, seed, run)
            drawn[name] = _drawn_at(bias.t, record.t, error) + stepped(name, row.width)
            least_bit = unit.quantization if row.rounds else 0.0
            record = faults.instrument(record, name, row.value, least_bit, scripted, seed, run)
            records[name] = model.read_out(record, unit) if hasattr(model, "read_out") else record
    data = SensorData(
        imu=imu_data,
        fixes=fixes,
        antenna_b=np.array(spec.antenna_b),
        specs=spec.assumed,
        output_t=output_times(truth.t, spec.output_rate, outages),
        observations=observations,
        ground_alt=spec.ground_alt,
        **records,
        date=spec.date,
    )
    happened = [(start, end, "gnss_outage", "GNSS outage") for start, end in outages]
    happened += [(fault.start, fault.end, "fault", fault.text) for fault in scripted]
    return Sensed(
        data=data,
        initial=initial.draw(truth, spec, seed, run),
        truth=SensorTruth(
            bias.t,
            bias.gyro_b + stepped("gyro", 3),
            bias.accel_b + stepped("accel", 3),
            drawn,
        ),
        events=Events.from_rows(happened),
        sky=above,
    )


def _drawn_at(t: FloatArray, sampled: FloatArray, error: FloatArray) -> FloatArray:
    """Return the error (M, k) or (M,) of an instrument at times t (B,), as (B, k)."""
    columns = error.reshape(len(sampled), -1).T
    return np.column_stack([np.interp(t, sampled, column) for column in columns])
