"""What the instruments on board would have reported of the true motion."""

from __future__ import annotations

import numpy as np

from bench.arrays import FloatArray
from bench.data import Events, Sensed, SensorData, SensorTruth, Trajectory
from bench.sensors import airspeed, baro, faults, gnss, imu, initial, magnetometer, sky, static_pressure
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
        Biases in ``truth`` are NaN where the sensor is not there. GNSS outages count only with a receiver.

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
    baro_data, baro_bias = None, np.full(len(bias.t), np.nan)
    if spec.baro is not None:
        if spec.baro.physical is None:
            baro_data, drawn = baro.measure(truth, spec.baro, seed, run)
        else:
            baro_data, drawn = static_pressure.measure(
                truth, spec.baro, spec.qnh, spec.static_port_b, seed, run
            )
        baro_bias = np.interp(bias.t, baro_data.t, drawn) + stepped("baro", 1)[:, 0]
        lsb = spec.baro.quantization
        baro_data = faults.instrument(baro_data, "baro", "alt_baro", lsb, scripted, seed, run)
    mag_data, mag_bias_b = None, np.full((len(bias.t), 3), np.nan)
    if spec.mag is not None:
        mag_data, mag_bias_b[:] = magnetometer.measure(truth, spec.mag, spec.date, seed, run)
        lsb = spec.mag.quantization
        mag_data = faults.instrument(mag_data, "mag", "field_b", lsb, scripted, seed, run)
    airspeed_data, airspeed_bias = None, np.full(len(bias.t), np.nan)
    if spec.airspeed is not None:
        airspeed_data, drawn = airspeed.measure(truth, spec.airspeed, seed, run)
        airspeed_bias = np.interp(bias.t, airspeed_data.t, drawn)
        airspeed_data = faults.instrument(
            airspeed_data, "airspeed", "airspeed_true", 0.0, scripted, seed, run
        )
        airspeed_data = airspeed.read_out(airspeed_data, spec.airspeed)  # of a burst too
    data = SensorData(
        imu=imu_data,
        fixes=fixes,
        baro=baro_data,
        antenna_b=np.array(spec.antenna_b),
        specs=spec.assumed,
        output_t=output_times(truth.t, spec.output_rate, outages),
        observations=observations,
        mag=mag_data,
        airspeed=airspeed_data,
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
            baro_bias,
            mag_bias_b,
            airspeed_bias,
        ),
        events=Events.from_rows(happened),
        sky=above,
    )
