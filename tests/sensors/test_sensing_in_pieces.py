"""A flight that is sensed in pieces has the bits of the whole: every unit of the catalog, every fault.

The pieces are of 50 ms to 1 s and end on the 20 Hz of the guidance, as those of a closed loop do.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import bench
from bench.core.records.data import AirData, SensorData, Trajectory
from bench.core.records.rotor_speeds import Rotors
from bench.core.records.sensor_specs import (
    AssumedSpecs,
    ImuSpec,
    SampleClockSpec,
    SensorsSpec,
    ThermalSpec,
    TriadSpec,
    VibrationSpec,
)
from bench.io.config.datasheets import SENSORS
from bench.simulation.sensors import sense, sense_piece
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.gnss import compute_antenna_motion, rate_at
from tests.sensors.test_faults import CASES, RECEIVERS, script

CATALOG = Path(bench.__file__).parent / "catalog"
UNITS = sorted(path for path in CATALOG.glob("*/*.toml") if path.parent.name in SENSORS)
TRIAD = TriadSpec(
    random_walk=4e-5, bias_instability=1e-5, bias_correlation=10.0, turn_on_bias_sd=1e-4,
    rate_random_walk=1e-6, scale_factor_sd=5e-4, misalignment_sd=1e-3, nonorthogonality_sd=1e-3,
    quantization=1e-7, range=5.0, temperature_sd=1e-6, nonlinearity_sd=1e-4, quadratic_sd=1e-5,
    bandwidth=20.0, delay=0.0137, dead_zone=1e-5,
)  # fmt: skip
EVERY_TERM = ImuSpec(
    "every-term",
    replace(TRIAD, g_sensitivity_sd=1e-6, g2_sensitivity_sd=1e-7),
    replace(TRIAD, random_walk=1e-3, range=100.0),
    ThermalSpec(self_heating=15.0, time_constant=20.0),
    VibrationSpec(
        engine_gyro=0.01, engine_accel=1.0, engine_reference=500.0, gust_gyro=0.01, gust_accel=0.5,
        mode_frequency=12.0, mode_damping=0.05,
    ),
    accel_cone=0.6,
    accel_arms=((0.02, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.02)),
)  # fmt: skip


AS_IT_IS = replace(
    EVERY_TERM,
    gyro=replace(EVERY_TERM.gyro, noise_shape="averaged", transient_sd=1e-4, transient_time=9.0),
    accel=replace(EVERY_TERM.accel, noise_shape="sampled", quantization=0.0, resolution=1e-3),
    thermal=ThermalSpec(self_heating=15.0, time_constant=20.0, hysteresis=2.0),
    clock=SampleClockSpec(drift=1e-3, jitter=1e-3),
)
for name in ("gyro", "accel"):
    triad = replace(getattr(AS_IT_IS, name), temperature2_sd=1e-7, hysteresis_sd=1e-4)
    AS_IT_IS = replace(AS_IT_IS, **{name: triad})


@pytest.fixture(scope="module")
def gusty(short_truth):
    """The short flight in wind that moves."""
    air = short_truth.air
    wind_n = air.wind_n + np.random.default_rng(3).normal(size=air.wind_n.shape)
    return replace(short_truth, air=replace(air, wind_n=wind_n))


@pytest.fixture(scope="module")
def begin(gusty):
    """Its first 18 s: an outage from 12 to 15 s, and every sensor has measured."""
    end, air = round(18.0 * (len(gusty.t) - 1) / gusty.t[-1]), gusty.air.t <= 18.0
    instants = {name: getattr(gusty, name)[: end + 1] for name in ("t", "lla", "vel_n", "q_nb")}
    steps = {name: getattr(gusty, name)[:end] for name in ("dtheta_b", "dvel_b")}
    cut_air = AirData(**{f.name: getattr(gusty.air, f.name)[air] for f in fields(AirData)})
    return replace(gusty, air=cut_air, **instants, **steps)


def on_board(imu=EVERY_TERM, gnss=None, scripted=(), **others):
    assumed = AssumedSpecs(imu, gnss, **others)
    return SensorsSpec(
        imu=imu, gnss=gnss, assumed=assumed, antenna_b=(0.5, 0.1, -0.3), gnss_outages=((12.0, 15.0),),
        initial_pos_sd=(3.0, 4.0, 5.0), initial_vel_sd=(0.1, 0.2, 0.3), initial_tilt_sd=0.01,
        initial_heading_sd=0.05, output_rate=10.0, faults=tuple(scripted), static_port_b=(0.3, 0.0, 0.1),
        **others,
    )  # fmt: skip


def cut(truth: Trajectory, ticks: list[int]) -> list[Trajectory]:
    """Pieces of so many ticks of 50 ms each; the air of the first epoch of a piece is that before."""
    rate, begin, pieces = round((len(truth.t) - 1) / truth.t[-1]), 0, []
    for end in [*np.cumsum(ticks), round(truth.t[-1] * 20)]:
        first, last = begin * rate // 20, end * rate // 20
        instants = {name: getattr(truth, name)[first : last + 1] for name in ("t", "lla", "vel_n", "q_nb")}
        steps = {name: getattr(truth, name)[first:last] for name in ("dtheta_b", "dvel_b")}
        air = {f.name: getattr(truth.air, f.name)[begin : end + 1] for f in fields(AirData)}
        spun = slice(first, last + 1) if len(truth.rotors) else slice(0)
        rotors = Rotors(truth.rotors.t[spun], truth.rotors.speed[spun])
        pieces.append(replace(truth, air=AirData(**air), **instants, **steps, rotors=rotors))
        begin = end
    return pieces


def join(parts: list[SensorData], name: str) -> dict[str, np.ndarray]:
    """The columns of a record in pieces, put together."""
    records = [getattr(part, name) for part in parts]
    columns = {}
    for f in fields(records[0]):
        found = [getattr(one, f.name) for one in records]
        if f.name == "epoch_start":
            found = [np.diff(column) for column in found]
        columns[f.name] = found[0] if f.name in ("klobuchar", "gps_t0") else np.concatenate(found)
    return columns


def assert_same_bits(truth, spec, ticks):
    whole = sense(truth, spec, 7, 2)
    draws = SensorDraws(7, 2)
    pieces = [sense_piece(piece, spec, draws) for piece in cut(truth, ticks)]
    names = [f.name for f in fields(SensorData) if hasattr(getattr(whole.data, f.name), "t")]
    assert "imu" in names
    for name in names:
        expected = getattr(whole.data, name)
        for column, values in join([piece.data for piece in pieces], name).items():
            wanted = getattr(expected, column)
            wanted = np.diff(wanted) if column == "epoch_start" else wanted
            assert_array_equal(values, wanted, err_msg=f"{name}.{column}", strict=True)
    first, *rest = [piece.truth for piece in pieces]
    for column in ("t", "gyro_b", "accel_b"):
        column = {"gyro_b": "gyro_bias_b", "accel_b": "accel_bias_b"}.get(column, column)
        values = np.concatenate([getattr(first, column), *(getattr(one, column)[1:] for one in rest)])
        assert_array_equal(values, getattr(whole.truth, column), err_msg=column)
    assert_array_equal(pieces[-1].initial.q_nb, whole.initial.q_nb)


TICKS = [1, 1, 1, 3, 20, 1, 7, 2, 2, 11, 1, 4] * 20
TICKS = TICKS[: int(np.searchsorted(np.cumsum(TICKS), 1180))]
FEW = [1, 1, 20, 3, 1, 30, 2, 11, 4, 40] * 20
FEW = FEW[: int(np.searchsorted(np.cumsum(FEW), 1180))]
KINDS = sorted({path.parent.name for path in UNITS})


def test_rotors_that_change_their_speed_shake_the_imu_in_order_of_time(begin):
    """Beside the engine and the gusts, with every error, in 20 parts of each sample."""
    speed = 300.0 + np.random.default_rng(5).normal(size=(len(begin.t), 4)).cumsum(axis=0)
    tones = replace(
        EVERY_TERM.vibration, rotor_accel_1=1.0, rotor_accel_2=2.0, rotor_accel_4=0.5, rotor_reference=300.0,
        rotor_forward=0.12, rotor_right=0.12, gyration_x=0.09, gyration_y=0.09, gyration_z=0.12,
        inner_rate=20.0 * round((len(begin.t) - 1) / begin.t[-1]),
    )  # fmt: skip
    truth = replace(begin, rotors=Rotors(begin.t, np.abs(speed)))
    assert_same_bits(truth, on_board(replace(EVERY_TERM, vibration=tones)), FEW[:32])


def test_an_engine_shakes_the_imu_inside_of_its_samples_in_order_of_time(begin):
    rate = 20.0 * round((len(begin.t) - 1) / begin.t[-1])
    assert_same_bits(
        begin,
        on_board(replace(EVERY_TERM, vibration=replace(EVERY_TERM.vibration, inner_rate=rate))),
        FEW[:32],
    )


def sense_units(truth, kind, ticks):
    for path in UNITS:
        if path.parent.name == kind:
            unit = SENSORS[kind](path, path.name)
            spec = on_board(unit) if kind == "imu" else on_board(**{kind: unit})
            assert_same_bits(truth, spec, ticks)


@pytest.mark.parametrize("kind", KINDS)
def test_every_unit_of_the_catalog_draws_in_order_of_time(begin, kind):
    sense_units(begin, kind, FEW[:32])


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_every_unit_of_the_catalog_draws_in_order_of_time_to_the_end(gusty, kind):
    sense_units(gusty, kind, TICKS)


@pytest.mark.parametrize("ticks", [[1] * 1199, TICKS], ids=["50 ms", "mixed"])
def test_a_unit_with_every_error_term_draws_in_order_of_time(gusty, ticks):
    assert_same_bits(gusty, on_board(), ticks)


def test_a_unit_as_it_is_draws_in_order_of_time(begin):
    """Shaped noise, clock, transient, hysteresis; and a receiver with late, shaken and smoothed fixes."""
    fixes = SENSORS["gnss"](CATALOG / "gnss" / "l1-code.toml", "l1-code")
    fixes = replace(
        fixes, latency=0.1, latency_jitter=0.3, time_tag_error=0.013, pos_h_smooth_sd=1.0, smooth_time=5.0
    )
    compass = SENSORS["mag"](CATALOG / "mag" / "rm3100.toml", "rm3100")
    spec = on_board(AS_IT_IS, gnss=fixes, mag=replace(compass, motor_field_sd=1e-6))
    assert_same_bits(begin, spec, FEW[:32])


@pytest.mark.slow
@pytest.mark.parametrize(("level", "kind", "keys"), CASES)
def test_faults_act_across_the_pieces(gusty, level, kind, keys):
    names = {"baro": "bmp388", "mag": "rm3100", "airspeed": "ms4525do"}
    units = {name: SENSORS[name](CATALOG / name / f"{unit}.toml", unit) for name, unit in names.items()}
    spec = on_board(gnss=RECEIVERS[level], scripted=[script(kind, **keys)], **units)
    assert_same_bits(gusty, spec, FEW)


def test_a_frozen_output_of_two_faults_repeats_the_row_before_each(gusty):
    first, second = script("frozen", sensor="gnss"), script("frozen", sensor="gnss")
    second = replace(second, start=25.0, end=40.0)
    for gnss in RECEIVERS.values():
        assert_same_bits(gusty, on_board(gnss=gnss, scripted=[first, second]), FEW)


def test_a_flight_may_end_between_two_instants_of_the_biases(begin):
    """It has the bits of a longer one until the last of them, and a bias until its end."""
    instants = {name: getattr(begin, name)[:1204] for name in ("t", "lla", "vel_n", "q_nb")}
    steps = {name: getattr(begin, name)[:1203] for name in ("dtheta_b", "dvel_b")}
    short, whole = replace(begin, **instants, **steps), sense(begin, on_board(), 7, 2)
    found = sense(short, on_board(), 7, 2)
    for name in ("dtheta_b", "dvel_b"):
        measured = getattr(found.data.imu, name)
        assert_array_equal(measured[:1200], getattr(whole.data.imu, name)[:1200])
        assert np.isfinite(measured).all()
    assert found.truth.t[-1] == short.t[-1]


def test_the_loops_of_a_receiver_go_on_through_pieces_without_a_fix(begin):
    unit = SENSORS["gnss"](CATALOG / "gnss" / "l1-code.toml", "l1-code")
    assert_same_bits(begin, on_board(gnss=replace(unit, tracking_bandwidth=1.0)), [1] * 359)


def test_an_antenna_moves_as_in_the_whole_flight_in_pieces_of_a_sample(begin):
    """Its velocity takes the turn of the two samples before, of pieces with a fix or without."""
    rows, arm, draws = np.array([1, 2, 7, 20, 21, 40, 60]), (0.5, 0.1, -0.3), SensorDraws(1, 0)
    found = []
    for k in range(60):
        instants = {name: getattr(begin, name)[k : k + 2] for name in ("t", "lla", "vel_n", "q_nb")}
        steps = {name: getattr(begin, name)[k : k + 1] for name in ("dtheta_b", "dvel_b")}
        piece = replace(begin, **instants, **steps)
        found.append(compute_antenna_motion(piece, rows[rows == k + 1] - k, arm, draws)[1])
    assert_array_equal(np.concatenate(found), compute_antenna_motion(begin, rows, arm, SensorDraws(1, 0))[1])


def test_the_turn_at_a_fix_is_that_of_the_whole_flight_in_pieces_of_a_sample():
    """The two samples before a fix are those of pieces before, with a fix or without."""
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.8, 1.2, 61)) * 0.05
    turned, rows = rng.normal(size=(60, 3)), np.array([1, 2, 7, 20, 21, 40, 60])
    whole, draws = rate_at("turn", t, turned, rows, SensorDraws(1, 0)), SensorDraws(1, 0)
    found = [
        rate_at("turn", t[k : k + 2], turned[k : k + 1], rows[rows == k + 1] - k, draws) for k in range(60)
    ]
    assert_array_equal(np.concatenate(found), whole)
