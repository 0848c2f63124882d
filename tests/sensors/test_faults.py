"""Each scripted fault does what its script says, in its interval, and leaves every other bit as it was.

What a fault did is the record with it less the record without it: every noise stream is the same in both.
"""

from __future__ import annotations

import pickle
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import ndtri

import bench
from bench.core.mathematics import earth, rotation
from bench.core.records.instruments import AirspeedSpec, BaroSpec, MagSpec
from bench.core.records.sensor_specs import AssumedSpecs, GnssSpec, ImuSpec, SensorsSpec, TriadSpec
from bench.core.words.exceptions import ConfigError
from bench.io import config
from bench.io.config.datasheets import read_gnss
from bench.io.config.fault_tables import make_fault
from bench.io.config.profile_tables import ExperimentTable
from bench.io.config.tables import check_table
from bench.simulation.sensors import faults, sense
from bench.simulation.sensors.draws import SensorDraws
from tests.builders import band
from tests.synthetic import still, turning

CATALOG = Path(bench.__file__).parent / "catalog" / "gnss"
SKY = read_gnss(CATALOG / "sky-l1.toml", "sky-l1.toml")
POSITION = GnssSpec("gnss", 2.0, 1.5, 2.5, 0.05, pos_h_markov_sd=3.0, pos_decay_time=0.01, latency=0.1)
TRIAD = TriadSpec(random_walk=4e-5, turn_on_bias_sd=1e-4, quantization=1e-7)
IMU = ImuSpec("imu", TRIAD, replace(TRIAD, random_walk=1e-3))
BARO = BaroSpec("baro", 5.0, 0.5, 3.0, 0.05, quantization=0.01)
MAG = MagSpec("mag", 10.0, 2e-7, hard_iron_sd=5e-7, quantization=1e-8)
PITOT = AirspeedSpec("pitot", 10.0, white_sd=0.3, bias_sd=0.3)
START, END = 20.0, 30.0


def script(kind, **keys):
    """A fault from what a profile says."""
    document = {
        "sensors": {"imu": "x"},
        "estimator": [{"use": "loose-15"}],
        "fault": [{"kind": kind, "start_s": START, "duration_s": END - START, **keys}],
    }
    return make_fault(check_table(ExperimentTable, document, "own.toml").fault[0])


def sensed(truth, gnss, *scripted, outages=(), seed=1):
    spec = SensorsSpec(
        imu=IMU,
        gnss=gnss,
        baro=BARO,
        mag=MAG,
        airspeed=PITOT,
        assumed=AssumedSpecs(IMU, gnss, baro=BARO, mag=MAG, airspeed=PITOT),
        antenna_b=(0.5, 0.1, -0.3),
        gnss_outages=outages,
        initial_pos_sd=(3.0, 4.0, 5.0),
        initial_vel_sd=(0.1, 0.2, 0.3),
        initial_tilt_sd=0.01,
        initial_heading_sd=0.05,
        output_rate=10.0,
        faults=scripted,
    )
    return sense(truth, spec, seed, 0)


@pytest.fixture(scope="module")
def turn():
    return turning(60.0, 100.0)


@pytest.fixture(scope="module")
def plain(turn):
    return {"position": sensed(turn, POSITION), "sky": sensed(turn, SKY)}


RECEIVERS = {"position": POSITION, "sky": SKY}
STILL = replace(SKY, sky=replace(SKY.sky, ionosphere_sd=0.0, ionosphere_share=0.0))
"""Without errors of the ionosphere: 10 km away they are others, by a tenth of their size."""
EVERY = {
    "satellites-lost": {"satellites": ["G06", "R03"]},
    "jamming": {"cn0_loss_db": 8.0},
    "spoofing": {"step_m": [30.0, 0.0, 0.0], "ramp_mps": [0.0, 2.0, 0.0]},
    "pseudorange": {"satellites": ["G06"], "step_m": 40.0},
    "satellite-clock": {"satellites": ["G06"], "ramp_mps": 3.0},
    "receiver-clock": {"step_m": 3e4},
    "baro-step": {"step_m": 12.0},
    "gyro-step": {"step_deg_h": [100.0, 0.0, -50.0]},
    "accel-step": {"step_mg": [0.0, 5.0, 0.0]},
    "mag-step": {"step_ut": [0.0, 20.0, 0.0]},
    "magnet-passed": {"peak_ut": [0.0, 20.0, 0.0]},
    "frozen": {"sensor": "gnss"},
    "noise-burst": {"sensor": "gnss", "times": 5.0},
    "latency": {"sensor": "gnss", "added_s": 0.4},
    "dropped": {"sensor": "gnss", "share": 0.5},
    "repeated": {"sensor": "gnss", "share": 0.5},
}
NEEDS_SKY = {"satellites-lost", "jamming", "pseudorange", "satellite-clock", "receiver-clock"}
CASES = [
    *[(level, kind, keys) for kind, keys in EVERY.items() for level in RECEIVERS
      if level == "sky" or kind not in NEEDS_SKY],
    *[("position", kind, {**EVERY[kind], "sensor": sensor})
      for kind, sensors in {
          "frozen": ("baro", "mag", "airspeed", "gyro", "accel"),
          "noise-burst": ("baro", "mag", "airspeed", "gyro", "accel"), "latency": ("baro", "mag", "airspeed"),
          "dropped": ("baro", "mag", "airspeed", "imu"), "repeated": ("baro", "mag", "airspeed", "imu"),
      }.items() for sensor in sensors],
]  # fmt: skip


def outside(record, late=0.0):
    """The columns of a record at rows outside the interval."""
    rows = (record.t < START - 1e-6) | (record.t >= END - 1e-6 + late)
    names = [f.name for f in fields(record) if f.name not in ("epoch_start", "klobuchar", "gps_t0")]
    return {name: getattr(record, name)[rows] for name in names}


@pytest.mark.parametrize(("level", "kind", "keys"), CASES)
def test_outside_its_interval_and_its_sensor_no_bit_changes(turn, plain, level, kind, keys):
    """After a loss of signal a receiver has to find its satellites again: a second, its reacquisition."""
    fault = script(kind, **keys)
    clean, faulty = plain[level], sensed(turn, RECEIVERS[level], fault)
    late = SKY.sky.reacquisition if kind in ("satellites-lost", "jamming") else 0.0
    touched = {"gyro": "imu", "accel": "imu"}.get(fault.sensor, fault.sensor)
    changed = False
    for name, of in (
        ("imu", "imu"),
        ("fixes", "gnss"),
        ("observations", "gnss"),
        *((s, s) for s in INSTRUMENTS),
    ):
        before, after = getattr(clean.data, name), getattr(faulty.data, name)
        if before is None:
            continue
        if of != touched:
            assert pickle.dumps(after) == pickle.dumps(before), name
        else:
            for column, values in outside(before, late).items():
                assert_array_equal(outside(after, late)[column], values, err_msg=f"{name}.{column}")
            changed |= pickle.dumps(after) != pickle.dumps(before)
    assert changed
    assert pickle.dumps(faulty.initial) == pickle.dumps(clean.initial)
    assert faulty.events.select("fault") == [(START, END, fault.text)]


INSTRUMENTS = ("baro", "mag", "airspeed")


def test_a_fault_is_said_as_it_stands_in_the_profile():
    assert script("jamming", cn0_loss_db=8.0).text == "jamming of gnss: cn0_loss_db = 8 dB"
    assert script("spoofing", ramp_mps=[0.0, 2.0, 0.0]).text == "spoofing of gnss: ramp_mps = [0, 2, 0]"
    assert script("frozen", sensor="gyro", axes=["z"]).text == "frozen of gyro: axes = ['z']"


def inside(record, late=0.0):
    return (record.t > START - 1e-6) & (record.t < END - 1e-6 + late)


def test_a_spoofed_fix_is_step_and_ramp_away_and_moves_with_the_ramp(turn, plain):
    fault = script("spoofing", step_m=[30.0, 0.0, -5.0], ramp_mps=[0.0, 2.0, 0.0])
    for level, tolerance in (("position", (1e-4, 1e-12)), ("sky", (1e-3, 1e-4))):
        receiver = {"position": POSITION, "sky": STILL}[level]
        clean, faulty = sensed(turn, receiver).data.fixes, sensed(turn, receiver, fault).data.fixes
        rows = inside(clean)
        expected = np.array([30.0, 0.0, -5.0]) + np.outer(clean.t[rows] - START, [0.0, 2.0, 0.0])
        moved = earth.difference_n(faulty.lla[rows], clean.lla[rows])
        assert_allclose(moved, expected, rtol=0, atol=tolerance[0])
        assert_allclose(
            (faulty.vel_n - clean.vel_n)[rows], np.tile([0, 2.0, 0], (rows.sum(), 1)), atol=tolerance[1]
        )


def test_a_spoofer_that_is_not_coherent_leaves_the_velocity(turn, plain):
    fault = script("spoofing", ramp_mps=[0.0, 2.0, 0.0], coherent=False)
    for level in RECEIVERS:
        clean, faulty = plain[level].data.fixes, sensed(turn, RECEIVERS[level], fault).data.fixes
        assert_allclose(faulty.vel_n, clean.vel_n, rtol=0, atol=1e-4)
        last = np.flatnonzero(inside(clean))[-1]
        moved = earth.difference_n(faulty.lla[last], clean.lla[last])
        assert_allclose(moved, [0.0, 2.0 * (clean.t[last] - START), 0.0], rtol=0, atol=1e-3)


def test_spoofed_ranges_are_those_from_the_false_place(turn, plain):
    """In the Earth-fixed frame; the linear term alone would be 2 m short at 10 km. The rest, less than 0.3 m:
    air above the false place, and what the satellite flies while its signal is on the way for longer."""
    away = np.array([10000.0, -4000.0, 0.0])
    fault = script("spoofing", step_m=list(away))
    clean, faulty = sensed(turn, STILL).data.observations, sensed(turn, STILL, fault).data.observations
    keys = [1e3 * np.rint(o.t) + 100 * o.system + o.sat for o in (clean, faulty)]
    rows, others = inside(clean) & np.isin(*keys), inside(faulty) & np.isin(*keys[::-1])
    at = np.searchsorted(turn.t, clean.t[rows] - 1e-6)
    here = earth.to_ecef(turn.lla[at])
    there = earth.to_ecef(earth.displace(turn.lla[at], away))
    sat = clean.sat_pos_e[rows]
    angle = earth.EARTH_RATE * 0.075  # of the Earth in the travel time, within 1e-6 rad
    turned = sat @ np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    expected = np.linalg.norm(turned - there, axis=1) - np.linalg.norm(turned - here, axis=1)
    added = (faulty.pseudorange[others] - clean.pseudorange[rows])[:, 0]
    assert_allclose(added, expected, rtol=0, atol=0.3)
    toward = (turned - here) / np.linalg.norm(turned - here, axis=1)[:, None]
    assert np.abs(added + np.einsum("ki,ki->k", toward, there - here)).max() > 2


def test_ranges_of_named_satellites_alone(turn, plain):
    """A step on the code leaves the Doppler; a clock that runs away takes both along."""
    clean = plain["sky"].data.observations
    for kind, keys, step, ramp, doppler in (
        ("pseudorange", {"step_m": 40.0, "ramp_mps": 1.5}, 40.0, 1.5, 0.0),
        ("satellite-clock", {"ramp_mps": 3.0}, 0.0, 3.0, 3.0),
    ):
        faulty = sensed(turn, SKY, script(kind, satellites=["G06", "R03"], **keys)).data.observations
        named = ((clean.system == 0) & (clean.sat == 6)) | ((clean.system == 1) & (clean.sat == 3))
        struck = inside(clean) & named
        assert struck.sum() == 20
        expected = np.where(struck, step + ramp * (clean.t - START), 0.0)
        assert_allclose((faulty.pseudorange - clean.pseudorange)[:, 0], expected, rtol=0, atol=1e-7)
        assert_allclose((faulty.range_rate - clean.range_rate)[:, 0], doppler * struck, rtol=0, atol=1e-9)


def test_the_receiver_excludes_a_satellite_far_off_and_its_fix_stays(turn, plain):
    """The fault acts before the receiver solves: its residual test throws 300 m out, and 5 m not always."""
    seen = plain["sky"].data.observations
    name = f"G{seen.sat[(seen.system == 0) & inside(seen)][0]:02d}"
    fault = script("pseudorange", satellites=[name], step_m=300.0)
    clean, faulty = plain["sky"], sensed(turn, SKY, fault)
    rows = inside(clean.data.fixes)
    moved = earth.difference_n(faulty.data.fixes.lla[rows], clean.data.fixes.lla[rows])
    assert np.abs(moved).max() < 5.0
    assert (faulty.data.fixes.satellites[rows] == clean.data.fixes.satellites[rows] - 1).all()


def test_a_step_of_the_receiver_clock_is_in_every_range_and_in_no_fix(turn, plain):
    clean, faulty = plain["sky"].data, sensed(turn, SKY, script("receiver-clock", step_m=3e4)).data
    added = (faulty.observations.pseudorange - clean.observations.pseudorange)[:, 0]
    assert_allclose(added, 3e4 * inside(clean.observations), rtol=0, atol=1e-7)
    assert np.abs(earth.difference_n(faulty.fixes.lla, clean.fixes.lla)).max() < 1e-3
    assert_allclose(faulty.fixes.vel_n, clean.fixes.vel_n, rtol=0, atol=1e-6)


def test_named_satellites_are_lost_and_no_other(turn, plain):
    clean, faulty = plain["sky"], sensed(turn, SKY, script("satellites-lost", satellites=["G06", "R03"]))
    before, after = clean.data.observations, faulty.data.observations

    def keys(o, rows):
        return set(zip(np.round(o.t[rows], 6), o.system[rows], o.sat[rows], strict=True))

    lost = keys(before, slice(None)) - keys(after, slice(None))
    assert not keys(after, slice(None)) - keys(before, slice(None))
    named = {
        key for key in keys(before, inside(before, SKY.sky.reacquisition)) if key[1:] in ((0, 6), (1, 3))
    }
    assert {key for key in named if key[0] < END - 1e-6} <= lost <= named
    assert {key[1:] for key in lost} == {(0, 6), (1, 3)}


def test_jamming_lowers_every_signal_and_what_is_below_the_threshold_is_lost(turn, plain):
    """The noise is the same run, as much larger as the formulas of the loops say for the lower C/N0."""
    from bench.simulation.sensors.measurement_level.loops import code_sd, doppler_sd

    loss, prompt = 12.0, replace(SKY, sky=replace(SKY.sky, reacquisition=0.0))
    clean, faulty = (
        sensed(turn, prompt).data.observations,
        sensed(turn, prompt, script("jamming", cn0_loss_db=loss)).data.observations,
    )
    rows = inside(clean) & (clean.t > START + 1e-6)
    strong = rows & (clean.cn0[:, 0] - loss >= SKY.sky.cn0_threshold)
    left = inside(faulty) & (faulty.t > START + 1e-6)
    assert 0 < left.sum() == strong.sum() < rows.sum()
    assert_allclose(faulty.cn0[left, 0], clean.cn0[strong, 0] - loss, rtol=0, atol=1e-9)
    quiet = replace(SKY, sky=replace(prompt.sky, dll_bandwidth=0.0, fll_bandwidth=0.0))
    base = sensed(turn, quiet).data.observations
    chip = np.array([299792458.0 / 1.023e6, 299792458.0 / 0.511e6])[clean.system[strong]]
    grown = code_sd(clean.cn0[strong, 0] - loss, chip, SKY.sky) / code_sd(clean.cn0[strong, 0], chip, SKY.sky)
    noise = [
        (o.pseudorange[r] - base.pseudorange[strong])[:, 0] for o, r in ((clean, strong), (faulty, left))
    ]
    assert_allclose(noise[1], noise[0] * grown, rtol=0, atol=1e-6)
    assert grown.min() > 3
    f = clean.frequency[strong, 0]
    grown = doppler_sd(clean.cn0[strong, 0] - loss, f, SKY.sky) / doppler_sd(clean.cn0[strong, 0], f, SKY.sky)
    noise = [(o.range_rate[r] - base.range_rate[strong])[:, 0] for o, r in ((clean, strong), (faulty, left))]
    assert_allclose(noise[1], noise[0] * grown, rtol=0, atol=1e-6)
    assert (faulty.sd_pseudorange[left] > clean.sd_pseudorange[strong]).all()  # the receiver knows
    silent = sensed(turn, SKY, script("jamming", cn0_loss_db=40.0)).data
    assert not inside(silent.fixes).any()
    assert not inside(silent.observations).any()


def test_a_bias_step_is_in_every_sample_to_the_least_bit(turn, plain):
    for kind, column, keys, unit in (
        ("gyro-step", "dtheta_b", {"step_deg_h": [100.0, 0.0, -50.0]}, np.pi / 180 / 3600),
        ("accel-step", "dvel_b", {"step_mg": [0.0, 5.0, 0.5]}, 9.80665e-3),
    ):
        step = np.array(next(iter(keys.values()))) * unit
        faulty = sensed(turn, POSITION, script(kind, **keys))
        added = getattr(faulty.data.imu, column) - getattr(plain["position"].data.imu, column)
        rows = inside(faulty.data.imu)
        lsb = TRIAD.quantization
        assert_allclose(added / lsb, np.rint(added / lsb), rtol=0, atol=1e-3)
        ideal = np.cumsum(np.where(rows[:, None], step * faulty.data.imu.dt[:, None], 0.0), axis=0)
        assert np.abs(np.cumsum(added, axis=0) - ideal)[rows].max() <= 0.51 * lsb
        assert np.abs(added).sum() > 5 * lsb
        truth = {"dtheta_b": "gyro_bias_b", "dvel_b": "accel_bias_b"}[column]
        drawn = getattr(faulty.truth, truth) - getattr(plain["position"].truth, truth)
        struck = (faulty.truth.t > START - 1e-6) & (faulty.truth.t < END - 1e-6)
        assert_allclose(drawn, np.where(struck[:, None], step, 0.0), rtol=0, atol=1e-12)


def test_a_magnet_aboard_turns_with_the_body_and_one_outside_does_not(turn, plain):
    """Of a sensor with noise alone; the passed one by its shape, highest in the middle, 1.4 % at its ends."""
    clean = plain["position"].data.mag
    rows, lsb = inside(clean), max(MAG.quantization, 1e-12)
    aboard = sensed(turn, POSITION, script("mag-step", step_ut=[0.0, 20.0, -5.0]))
    assert_allclose(
        (aboard.data.mag.field_b - clean.field_b)[rows], [[0.0, 2e-5, -5e-6]] * rows.sum(), atol=lsb
    )
    bias = (aboard.truth.bias["mag"] - plain["position"].truth.bias["mag"])[:, 1]
    struck = (aboard.truth.t > START - 1e-6) & (aboard.truth.t < END - 1e-6)
    assert_allclose(bias, np.where(struck, 2e-5, 0.0), rtol=0, atol=1e-12)
    outside = sensed(turn, POSITION, script("magnet-passed", peak_ut=[0.0, 20.0, -5.0]))
    added = (outside.data.mag.field_b - clean.field_b)[rows]
    q = turn.q_nb[np.searchsorted(turn.t, clean.t[rows] - 1e-6)]
    u = 8.0 * (clean.t[rows] - START) / (END - START) - 4.0
    expected = rotation.rotate(rotation.conjugate(q), np.outer((1.0 + u**2) ** -1.5, [0.0, 2e-5, -5e-6]))
    distortion = 4.0 * (MAG.soft_iron_sd + MAG.scale_factor_sd + MAG.misalignment_sd)
    assert_allclose(added, expected, rtol=0, atol=lsb + 2e-5 * distortion)
    size = np.linalg.norm(added, axis=1)
    assert abs(clean.t[rows][size.argmax()] - 0.5 * (START + END)) < 0.1
    assert size[0] < 0.03 * size.max()


def test_beyond_its_range_a_sample_is_clipped_and_flagged(turn):
    imu = replace(IMU, gyro=replace(TRIAD, range=1.0))
    record = sensed(turn, POSITION).data.imu
    faulty = faults.apply_to_imu(
        record, imu, [script("gyro-step", step_deg_h=[5e5, 0.0, 0.0])], SensorDraws(1, 0)
    )
    rows = inside(record)
    assert not faulty.valid[rows].any()
    assert faulty.valid[~rows].all()
    assert_allclose(faulty.dtheta_b[rows, 0], 0.01, rtol=1e-9)
    assert_array_equal(faulty.dtheta_b[:, 1:], record.dtheta_b[:, 1:])
    small = [script("gyro-step", step_deg_h=[5e3, 0.0, 0.0])]
    assert faults.apply_to_imu(record, imu, small, SensorDraws(1, 0)).valid.all()


def test_a_baro_step(turn, plain):
    faulty = sensed(turn, POSITION, script("baro-step", step_m=12.0))
    before, after = plain["position"].data.baro, faulty.data.baro
    assert_allclose(after.alt_baro - before.alt_baro, 12.0 * inside(before), rtol=0, atol=1e-9)
    assert np.nanmax(faulty.truth.bias["baro"] - plain["position"].truth.bias["baro"]) == pytest.approx(12.0)
    noisy = sensed(turn, POSITION, script("noise-burst", sensor="baro", times=5.0)).data.baro.alt_baro
    assert_allclose(noisy / 0.01, np.rint(noisy / 0.01), rtol=0, atol=1e-6)


def test_a_frozen_output_repeats_the_row_before_and_its_time_goes_on(turn, plain):
    for level in RECEIVERS:
        before = plain[level].data.fixes
        after = sensed(turn, RECEIVERS[level], script("frozen", sensor="gnss")).data
        first = int(np.flatnonzero(inside(before))[0])
        rows = inside(before)
        assert_array_equal(after.fixes.t, before.t)
        assert_array_equal(after.fixes.lla[rows], np.tile(before.lla[first - 1], (rows.sum(), 1)))
        assert_array_equal(after.fixes.vel_n[rows], np.tile(before.vel_n[first - 1], (rows.sum(), 1)))
        if after.observations is not None:
            o = after.observations
            last = slice(*o.epoch_start[[first - 1, first]])
            for m in np.flatnonzero(rows):
                this = slice(*o.epoch_start[[m, m + 1]])
                assert_array_equal(o.pseudorange[this], o.pseudorange[last])
                assert_allclose(o.t[this], before.t[m])
    baro = sensed(turn, POSITION, script("frozen", sensor="baro")).data.baro
    assert len(set(baro.alt_baro[inside(baro)])) == 1
    field = sensed(turn, POSITION, script("frozen", sensor="mag")).data.mag.field_b
    assert len(np.unique(field[inside(plain["sky"].data.mag)], axis=0)) == 1
    for sensor, column in (("gyro", "dtheta_b"), ("accel", "dvel_b")):
        stuck = sensed(turn, POSITION, script("frozen", sensor=sensor, axes=["z"])).data.imu
        rows, clean = inside(stuck), plain["position"].data.imu
        values = getattr(stuck, column)
        assert (values[rows, 2] == values[np.flatnonzero(rows)[0] - 1, 2]).all()
        assert_array_equal(values[:, :2], getattr(clean, column)[:, :2])


@pytest.mark.parametrize(
    "sensor", ["gyro", "accel", "baro", "mag", "airspeed", "fix position", "fix velocity", "code", "doppler"]
)
def test_a_noise_burst_is_as_large_as_it_says(sensor):
    """The added part over its sd, mean square in its 99.9 % band; 1.25 times would be seen."""
    from bench.simulation.sensors.measurement_level.loops import code_sd, doppler_sd

    truth = still(40.0, 50.0)
    struck = sensor if sensor in ("gyro", "accel", *INSTRUMENTS) else "gnss"
    gnss = SKY if sensor in ("code", "doppler") else POSITION
    fault = replace(script("noise-burst", sensor=struck, times=6.0), start=5.0, end=35.0)
    clean, faulty = (
        sensed(truth, replace(gnss, rate=10.0)).data,
        sensed(truth, replace(gnss, rate=10.0), fault).data,
    )
    if sensor in ("gyro", "accel"):
        column = {"gyro": "dtheta_b", "accel": "dvel_b"}[sensor]
        added = getattr(faulty.imu, column) - getattr(clean.imu, column)
        sd, t = getattr(IMU, sensor).random_walk * np.sqrt(0.02), clean.imu.t
    elif sensor == "baro":
        added, sd, t = faulty.baro.alt_baro - clean.baro.alt_baro, BARO.white_sd, clean.baro.t
    elif sensor == "mag":
        added, sd, t = faulty.mag.field_b - clean.mag.field_b, MAG.white_sd, clean.mag.t
    elif sensor == "airspeed":
        added = faulty.airspeed.airspeed_true - clean.airspeed.airspeed_true
        sd, t = clean.airspeed.sd, clean.airspeed.t
        added, sd = added / sd, 1.0
    elif sensor == "fix position":
        added = earth.difference_n(faulty.fixes.lla, clean.fixes.lla)
        sd, t = np.array([1.5, 1.5, 2.5]), clean.fixes.t
    elif sensor == "fix velocity":
        added, sd, t = faulty.fixes.vel_n - clean.fixes.vel_n, 0.05, clean.fixes.t
    else:
        a, b = clean.observations, faulty.observations
        t = a.t
        if sensor == "code":
            chip = np.array([299792458.0 / 1.023e6, 299792458.0 / 0.511e6])[a.system]
            added, sd = (b.pseudorange - a.pseudorange)[:, 0], code_sd(a.cn0[:, 0], chip, SKY.sky)
        else:
            added, sd = (
                (b.range_rate - a.range_rate)[:, 0],
                doppler_sd(a.cn0[:, 0], a.frequency[:, 0], SKY.sky),
            )
    rows = (t > 5.0 - 1e-6) & (t < 35.0 - 1e-6)
    unit = (added / (6.0 * sd))[rows].ravel()
    low, high = band(len(unit))
    assert low < np.mean(unit**2) < high
    assert not low < np.mean(unit**2) * 1.25**2 < high


def test_an_airspeed_in_a_burst_is_never_negative_and_not_valid_where_the_unit_is_blind(turn, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "PITOT", replace(PITOT, white_sd=3.0, min_speed=4.0))
    read = sensed(turn, POSITION, script("noise-burst", sensor="airspeed", times=10.0)).data.airspeed
    burst = inside(read)
    assert (read.airspeed_true[burst] == 0.0).sum() > 5  # 25 m/s is less than one sigma of 30 m/s
    assert (read.airspeed_true >= 0.0).all()
    assert_array_equal(read.valid[burst], read.airspeed_true[burst] >= 4.0)


def test_later_arrivals(turn, plain):
    for level in RECEIVERS:
        before = plain[level].data.fixes
        after = sensed(turn, RECEIVERS[level], script("latency", sensor="gnss", added_s=0.4)).data
        assert_allclose(after.fixes.t_arrival - before.t_arrival, 0.4 * inside(before), rtol=0, atol=1e-12)
        assert_array_equal(after.fixes.lla, before.lla)
        if after.observations is not None:
            o = plain[level].data.observations
            assert_allclose(after.observations.t_arrival - o.t_arrival, 0.4 * inside(o), rtol=0, atol=1e-12)


@pytest.mark.parametrize("sensor", ["imu", "gnss", *INSTRUMENTS])
def test_samples_dropped_or_repeated_in_their_share(turn, plain, sensor):
    """All of them with share 1; of a share the number struck lies in the 99.9 % band of the binomial."""
    for level in RECEIVERS:
        name = "fixes" if sensor == "gnss" else sensor
        before = getattr(plain[level].data, name)
        n = int(inside(before).sum())
        assert not inside(
            getattr(sensed(turn, RECEIVERS[level], script("dropped", sensor=sensor)).data, name)
        ).any()
        twice = getattr(sensed(turn, RECEIVERS[level], script("repeated", sensor=sensor)).data, name)
        assert_array_equal(twice.t[inside(twice)], np.repeat(before.t[inside(before)], 2))
        some = getattr(sensed(turn, RECEIVERS[level], script("dropped", sensor=sensor, share=0.4)).data, name)
        kept = np.isin(before.t, some.t)
        assert kept[~inside(before)].all()
        spread = -ndtri(0.0005) * np.sqrt(0.4 * 0.6 * n) + 0.5
        assert abs((~kept).sum() - 0.4 * n) < spread
        for f in fields(some):
            assert_array_equal(getattr(some, f.name), getattr(before, f.name)[kept])


def test_one_fault_more_leaves_the_others_their_bits(turn):
    burst = script("noise-burst", sensor="baro", times=5.0)
    other = [script("noise-burst", sensor="gyro", times=5.0), script("jamming", cn0_loss_db=5.0)]
    alone, among = sensed(turn, SKY, burst).data.baro, sensed(turn, SKY, *other, burst).data.baro
    assert pickle.dumps(alone) == pickle.dumps(among)


def test_an_outage_takes_rows_away_and_changes_no_fault(turn):
    """What is dropped, repeated or noisy is the same with and without silence in between."""
    for gnss in RECEIVERS.values():
        for kind in ("dropped", "repeated", "noise-burst", "frozen", "latency"):
            fault = script(kind, **EVERY[kind])
            whole, broken = (sensed(turn, gnss, fault, outages=o).data.fixes for o in ((), ((22.0, 26.0),)))
            kept = (whole.t < 22.0 - 1e-6) | (whole.t >= 26.0 - 1e-6)
            for f in fields(whole):
                assert_array_equal(
                    getattr(broken, f.name), getattr(whole, f.name)[kept], err_msg=f"{kind} {f.name}"
                )


def test_the_script_stays_out_of_what_filters_get(turn):
    """Not a word of it in their record; it is in the events of the run alone."""
    fault = script("spoofing", step_m=[30.0, 0.0, 0.0])
    faulty = sensed(turn, SKY, fault)
    assert b"spoofing" in pickle.dumps(faulty)
    assert b"spoofing" not in pickle.dumps((faulty.data, faulty.initial))


PROFILE = {
    "estimator": [{"use": "loose-15"}],
    "duration_s": 100.0,
    "gnss_outage": [],
}


def wrong(gnss="sky-l1", **fault):
    row = {"start_s": 10.0, "duration_s": 5.0, **fault}
    with pytest.raises(ConfigError) as caught:
        config.read_profile("figure-eight", {**PROFILE, "sensors.gnss": gnss, "fault": [row]})
    return str(caught.value)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"kind": "jaming", "cn0_loss_db": 5.0}, "kind = 'jaming' is unknown. Did you mean 'jamming'?"),
        ({"kind": "jamming"}, "[[fault]] 1 (jamming): cn0_loss_db is missing"),
        ({"kind": "jamming", "cn0_loss_db": 99.0}, "cn0_loss_db = 99 dB is outside 0.1 to 60 dB"),
        ({"kind": "jamming", "cn0_loss_db": 9.0, "gnss": "l1-code"}, "without C/N0; choose one with [sky]"),
        ({"kind": "receiver-clock", "step_m": 9.0, "gnss": "l1-code"}, "without clock; choose one with"),
        ({"kind": "satellites-lost", "satellites": ["E37"]}, "'E37' is not a satellite; there are G01"),
        ({"kind": "satellites-lost", "satellites": ["G31"]}, "G31 is not among the satellites of gnss"),
        ({"kind": "satellites-lost", "satellites": []}, "satellites = [] must have at least 1 entry"),
        ({"kind": "satellites-lost", "satellites": ["G06", "G06"]}, "names a satellite twice"),
        ({"kind": "spoofing"}, "step_m and ramp_mps: all are 0; give at least one another value"),
        ({"kind": "frozen", "sensor": "rope"}, "sensor = 'rope' must be 'gnss', 'baro', 'mag', "),
        ({"kind": "frozen", "sensor": "baro", "axes": ["x"]}, "axes are for sensor = 'gyro' or 'accel'"),
        ({"kind": "gyro-step", "step_deg_h": [1.0, 2.0, 3.0], "start_s": 98.0}, "its end at 103 s is"),
        ({"kind": "gyro-step", "step_deg_h": [1.0, 2.0]}, "step_deg_h[2] is missing"),
        ({"kind": "baro-step", "step_m": 1.0, "step_ft": 9.0}, "unknown key 'step_ft'. Did you mean"),
    ],
)  # fmt: skip
def test_a_fault_that_cannot_be_gets_one_line(fault, said):
    message = wrong(**fault)
    assert said in message
    assert message.startswith("figure-eight.toml: [[fault]] 1")
    assert len([line for line in message.splitlines() if "known" not in line or said in line]) == 1


@pytest.mark.parametrize(("level", "kind", "keys"), CASES)
def test_every_fault_of_a_sensor_on_board_is_taken(level, kind, keys):
    units = {"sensors.gnss": {"sky": "sky-l1", "position": "matched-white"}[level], "gnss_outage": []}
    row = {"kind": kind, "start_s": 10.0, "duration_s": 5.0, **keys}
    (fault,) = config.read_profile("all-sensors", {**units, "fault": [row]}).sensors.faults
    assert (fault.kind, fault.start, fault.end) == (kind, 10.0, 15.0)
    assert fault.sensor == keys.get("sensor", {"baro-step": "baro"}.get(kind, fault.sensor))


def test_a_fault_of_a_sensor_that_is_not_on_board_or_of_a_noise_it_has_not(tmp_path):
    text = (
        (Path(bench.__file__).parent / "profiles" / "figure-eight.toml")
        .read_text()
        .replace('baro = "bmp388"\n', "")
    )
    (tmp_path / "own.toml").write_text(text)
    row = {"kind": "baro-step", "start_s": 10.0, "duration_s": 5.0, "step_m": 5.0}
    with pytest.raises(ConfigError, match=r"\[\[fault\]\] 1 \(baro-step\): there is no baro in \[sensors\]"):
        config.read_profile(str(tmp_path / "own.toml"), {"fault": [row]})
    ideal = 'source = "none"\n[accel]\nnoise_ug_sqrt_hz = 5.0\n'
    (tmp_path / "ideal.toml").write_text(ideal)
    row = {"kind": "noise-burst", "sensor": "gyro", "start_s": 10.0, "duration_s": 5.0, "times": 5.0}
    overrides = {"sensors.imu": str(tmp_path / "ideal.toml"), "fault": [row]}
    with pytest.raises(ConfigError, match=r"ideal.* has no white noise in its gyro to multiply"):
        config.read_profile(str(tmp_path / "own.toml"), overrides)


def test_the_same_fault_twice_at_a_time_is_refused():
    row = {"kind": "jamming", "start_s": 10.0, "duration_s": 5.0, "cn0_loss_db": 5.0}
    overrides = {**PROFILE, "sensors.gnss": "sky-l1", "fault": [row, {**row, "start_s": 12.0}]}
    with pytest.raises(ConfigError, match=r"start_s = 12 s overlaps \[\[fault\]\] 1, the same fault"):
        config.read_profile("figure-eight", overrides)
    rows = [{**row, "kind": "pseudorange", "satellites": [s]} for s in ("G06", "G07")]
    for r in rows:
        del r["cn0_loss_db"]
        r["step_m"] = 5.0
    taken = config.read_profile("figure-eight", {**overrides, "fault": rows})
    assert [f.satellites for f in taken.sensors.faults] == [((0, 6),), ((0, 7),)]
    assert taken.document["fault"][0]["satellites"] == ["G06"]
