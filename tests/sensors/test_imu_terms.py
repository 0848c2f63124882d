"""Error terms of the IMU beyond noise, bias and matrix: each recovered from a run that calibrates it.

Tumbles and rate tables are built from rates and forces written down here. A term alone, on noise-free
increments, is deterministic but for its drawn coefficients; those are recovered and compared with the drawn
ones within 1 %, and doubling a figure doubles what it does. Statistical bounds are two-sided 99.9 % bands.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics.random_streams import stream
from bench.core.records.data import AirData, no_air
from bench.core.records.fields import triad_figures_of
from bench.core.records.sensor_specs import AxisFigures, ImuSpec, ThermalSpec, TriadSpec, VibrationSpec
from bench.simulation.sensors import imu, imu_terms, processes, vibration
from bench.simulation.sensors.draws import SensorDraws
from tests.builders import band
from tests.sensors.given_numbers import respond
from tests.synthetic import still, turning

G = 9.80665
OFF = TriadSpec()
UNIT = ImuSpec("unit", OFF, OFF)
RATE = 100.0
EXTRA = {
    "rate_random_walk": 1e-6,
    "scale_asymmetry_sd": 1e-3,
    "nonlinearity_sd": 1e-3,
    "quadratic_sd": 1e-3,
    "nonorthogonality_sd": 1e-3,
    "alignment_sd": 1e-3,
    "temperature_sd": 1e-5,
}
GYRO_ONLY = {"g_sensitivity_sd": 1e-5, "g2_sensitivity_sd": 1e-6}


def run(truth, unit=UNIT, seed=1, number=0, **parts):
    return imu.measure(truth, replace(unit, **parts), SensorDraws(seed, number))


def made(w_b, f_b, rate=RATE, air=None):
    """A truth with given mean rates (K, 3) [rad/s] and forces (K, 3) [m/s^2]; nothing else of it is used."""
    truth = still(len(w_b) / rate, rate)
    changes = {"dtheta_b": np.asarray(w_b, float) / rate, "dvel_b": np.asarray(f_b, float) / rate}
    return replace(truth, **changes, **({"air": air} if air else {}))


def tumble():
    """12 positions of 1 s: every axis up and down, and between; no rotation."""
    ups = [*np.eye(3), *-np.eye(3), [1, 1, 0], [0, 1, 1], [1, 0, 1], [1, -1, 0], [0, 1, -1], [-1, 0, 1]]
    f = np.repeat([G * np.array(u) / np.linalg.norm(u) for u in ups], 100, axis=0)
    return made(np.zeros_like(f), f)


def rate_table(top=1.5):
    """Each axis from -top to top rad/s in 31 steps of 0.2 s, one axis after another."""
    w = np.vstack([np.repeat(np.outer(np.linspace(-top, top, 31), axis), 20, axis=0) for axis in np.eye(3)])
    return made(w, np.tile([0.0, 0.0, -G], (len(w), 1)))


# --- calibration runs ---------------------------------------------------------------------------------


def test_a_tumble_gives_the_g_sensitivity_back():
    """A-5.1.8, #14: between +1 g and -1 g along an axis the drift changes by twice the coefficient."""
    truth = tumble()
    spec = replace(OFF, g_sensitivity_sd=1e-5, turn_on_bias_sd=1e-4)
    record, _ = run(truth, gyro=spec)
    rate = record.dtheta_b * RATE
    drawn = 1e-5 * stream(1, 0, "imu.gyro.g_sensitivity").standard_normal((3, 3))
    for axis in range(3):
        up, down = rate[100 * axis : 100 * (axis + 1)], rate[300 + 100 * axis : 400 + 100 * axis]
        assert_allclose((up - down).mean(axis=0) / (2 * G), drawn[:, axis], rtol=0.01)
    f = truth.dvel_b * RATE
    found = np.linalg.lstsq(np.column_stack([f, np.ones(len(f))]), rate)[0]
    assert_allclose(found[:3].T, drawn, rtol=0.01)


def test_a_tumble_gives_the_square_of_the_force_back():
    truth = tumble()
    rate = run(truth, gyro=replace(OFF, g2_sensitivity_sd=1e-6))[0].dtheta_b * RATE
    f2 = (truth.dvel_b * RATE) ** 2
    drawn = 1e-6 * stream(1, 0, "imu.gyro.g2_sensitivity").standard_normal((3, 3))
    assert_allclose(np.linalg.lstsq(f2, rate)[0].T, drawn, rtol=0.01)
    felt = run(truth, accel=replace(OFF, quadratic_sd=1e-4))[0].dvel_b * RATE - truth.dvel_b * RATE
    drawn = 1e-4 * stream(1, 0, "imu.accel.quadratic").standard_normal(3)
    assert_allclose(np.linalg.lstsq(f2, felt)[0], np.diag(drawn), rtol=0.01, atol=1e-12)


def test_a_rate_table_gives_scale_factor_and_misalignment_back_under_noise():
    """1 % of each of nine elements of M, under noise, bias and bits of a tactical unit, 15 min per axis."""
    steps = np.repeat(np.linspace(-3.0, 3.0, 31), 3000)
    w = np.vstack([np.outer(steps, axis) for axis in np.eye(3)])
    truth = made(w, np.tile([0.0, 0.0, -G], (len(w), 1)))
    spec = TriadSpec(
        random_walk=1e-5,
        turn_on_bias_sd=1e-4,
        quantization=1e-9,
        scale_factor_sd=1e-3,
        misalignment_sd=1e-3,
    )
    rate = run(truth, gyro=spec)[0].dtheta_b * RATE
    found = np.linalg.lstsq(np.column_stack([w, np.ones(len(w))]), rate)[0][:3].T - np.eye(3)
    M = np.diag(1e-3 * stream(1, 0, "imu.gyro.scale_factor").standard_normal(3))
    M[~np.eye(3, dtype=bool)] = 1e-3 * stream(1, 0, "imu.gyro.misalignment").standard_normal(6)
    assert_allclose(found, M, rtol=0.01)


def test_asymmetry_bends_the_scale_factor_at_zero():
    """Slopes above and below zero differ by twice the drawn figure."""
    truth = rate_table()
    error = run(truth, gyro=replace(OFF, scale_asymmetry_sd=1e-3))[0].dtheta_b - truth.dtheta_b
    drawn = 1e-3 * stream(1, 0, "imu.gyro.asymmetry").standard_normal(3)
    for axis in range(3):
        w, e = truth.dtheta_b[:, axis], error[:, axis]
        above, below = (np.sum(w[m] * e[m]) / np.sum(w[m] ** 2) for m in (w > 0, w < 0))
        assert_allclose(above - below, 2 * drawn[axis], rtol=0.01)


def test_nonlinearity_departs_from_the_best_line_by_its_figure():
    """Minimax line of the drawn curve is 0; the largest departure over the range is the drawn share of it."""
    truth = rate_table(top=2.0)
    spec = replace(OFF, nonlinearity_sd=1e-3, range=2.0)
    error = (run(truth, gyro=spec)[0].dtheta_b - truth.dtheta_b) * RATE
    drawn = 1e-3 * stream(1, 0, "imu.gyro.nonlinearity").standard_normal(3)
    for axis in range(3):
        rows = slice(620 * axis, 620 * (axis + 1))
        inside = np.abs(truth.dtheta_b[rows, axis] * RATE) < 2.0 - 1e-9  # the ends may be clipped
        e = error[rows, axis][inside]
        assert_allclose(np.abs(e).max() / 2.0, abs(drawn[axis]), rtol=0.01)
        u = truth.dtheta_b[rows, axis][inside] * RATE / 2.0
        assert_allclose(e, 2.0 * drawn[axis] * np.polynomial.chebyshev.chebval(u, [0, 0, 0, 1]), atol=1e-12)


def test_nonorthogonality_moves_angles_between_axes_and_alignment_does_not():
    """Sensing axes are the rows of I + M: their mutual cosines are the drawn angles, or stay 0."""
    w = np.random.default_rng(3).normal(size=(50, 3))
    truth = made(w, w)

    def cosines(spec):
        rows = np.linalg.lstsq(w, run(truth, gyro=spec)[0].dtheta_b * RATE)[0].T
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        return np.array([rows[1] @ rows[2], rows[2] @ rows[0], rows[0] @ rows[1]]), rows

    bent, _ = cosines(replace(OFF, nonorthogonality_sd=1e-3))
    assert_allclose(
        bent, 1e-3 * stream(1, 0, "imu.gyro.nonorthogonality").standard_normal(3), rtol=0.01, atol=3e-6
    )
    stiff, rows = cosines(replace(OFF, alignment_sd=1e-3))
    assert np.abs(stiff).max() < 1e-5  # second order
    phi = 1e-3 * stream(1, 0, "imu.gyro.alignment").standard_normal(3)
    assert_allclose(rows - np.eye(3), -np.cross(np.eye(3), phi), atol=1e-5)


@pytest.mark.parametrize("figure", [*EXTRA, *GYRO_ONLY])
def test_doubling_a_figure_doubles_what_it_does_and_nothing_else(figure):
    """On a turn, on top of all others; they meet only in second order."""
    turn = turning(20.0, 200.0)
    figures = {**EXTRA, **GYRO_ONLY, "range": 10.0}
    full = TriadSpec(random_walk=1e-5, turn_on_bias_sd=1e-4, **figures)
    value = figures[figure]
    alone = TriadSpec(**{"range": 10.0, figure: value})
    effect = run(turn, gyro=alone)[0].dtheta_b - turn.dtheta_b
    twice = run(turn, gyro=replace(alone, **{figure: 2 * value}))[0].dtheta_b - turn.dtheta_b
    assert np.abs(effect).max() > 1e-10
    assert_allclose(twice, 2 * effect, rtol=0, atol=1e-6 * np.abs(effect).max())
    before = run(turn, gyro=full)[0].dtheta_b
    after = run(turn, gyro=replace(full, **{figure: 2 * value}))[0].dtheta_b
    assert_allclose(after - before, effect, rtol=0, atol=5e-3 * np.abs(effect).max())


BY_AXIS = [name for name, one in triad_figures_of(TriadSpec).items() if one.by_axis]


@pytest.mark.parametrize("figure", BY_AXIS)
def test_a_figure_of_one_axis_acts_on_that_axis_alone(figure):
    """The other axes keep their bits; three equal figures are one figure."""
    turn = turning(5.0, 200.0)
    figures = {**dict.fromkeys(BY_AXIS, 1e-4), "range": 1e3, "bias_correlation": 20.0, "quantization": 1e-7}
    figures["transient_time"] = 10.0
    same, large = TriadSpec(**figures), TriadSpec(**{**figures, figure: 5e-4})
    alike = replace(same, axes=(AxisFigures(figure, 1e-4, 1e-4, 1e-4),))
    third = replace(large, axes=(AxisFigures(figure, 1e-4, 1e-4, 5e-4),))
    warming = {"thermal": ThermalSpec(self_heating=5.0, time_constant=2.0)}
    usual, whole, one = (run(turn, gyro=spec, accel=spec, **warming)[0] for spec in (same, large, third))
    assert_array_equal(run(turn, gyro=alike)[0].dtheta_b, run(turn, gyro=same)[0].dtheta_b)
    for column in ("dtheta_b", "dvel_b"):
        ours, before, after = (getattr(record, column) for record in (one, usual, whole))
        assert_array_equal(ours[:, :2], before[:, :2])
        assert_array_equal(ours[:, 2], after[:, 2])
        assert not np.array_equal(ours[:, 2], before[:, 2])


def test_adding_terms_leaves_the_noise_of_the_others_bit_identical(streams_drawn):
    """Streams are named by term: with all of them on, each draws what it draws alone."""
    turn = turning(5.0, 200.0)
    figures = {**EXTRA, **GYRO_ONLY}
    seen = {}

    names = streams_drawn()

    def draw_of(spec):
        names.clear()
        run(turn, gyro=spec)
        return list(names)

    for figure, value in figures.items():
        seen[figure] = draw_of(TriadSpec(**{figure: value, "range": 10.0}))
        assert len(seen[figure]) == 1, figure
    together = draw_of(TriadSpec(**figures, range=10.0))
    assert sorted(together) == sorted(names[0] for names in seen.values())
    assert len(set(together)) == len(figures)


def test_walk_and_temperature_do_not_depend_on_a_fast_instability():
    """A bias stepped at every sample changes where the walk is interpolated, not what it is."""
    turn = turning(20.0, 200.0)
    slow = TriadSpec(rate_random_walk=1e-4)
    fast = replace(slow, bias_instability=1e-12, bias_correlation=0.1, bias_model="gauss-markov")
    assert_allclose(run(turn, gyro=slow)[1].gyro_b, run(turn, gyro=fast)[1].gyro_b, rtol=0, atol=1e-10)
    assert_allclose(run(turn, gyro=slow)[0].dtheta_b, run(turn, gyro=fast)[0].dtheta_b, rtol=0, atol=1e-12)


def test_rate_random_walk_grows_with_the_square_root_of_time():
    truth = still(50.0, 20.0)
    ends = [
        run(truth, gyro=TriadSpec(rate_random_walk=1e-5), number=k)[1].gyro_b[[500, -1]] for k in range(300)
    ]
    for row, time in ((0, 25.0), (1, 50.0)):
        values = np.array(ends)[:, row].ravel()
        low, high = band(values.size)
        assert low < np.mean(values**2) / (1e-10 * time) < high
        assert not low < np.mean(values**2) / (1e-10 * 1.3 * time) < high


# --- the input side -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["subtractive", "hard"])
def test_the_dead_zone_is_that_of_its_kind(kind):
    """A-2.4.S; on a ramp through zero, doubling the width doubles where the output is 0."""
    w = np.tile(np.linspace(-1.0, 1.0, 2001)[:, None], (1, 3))
    truth = made(w, w)
    zeros = []
    for width in (0.1, 0.2):
        spec = replace(OFF, dead_zone=width, dead_zone_kind=kind)
        out = run(truth, gyro=spec, accel=spec)[0]
        for got in (out.dtheta_b * RATE, out.dvel_b * RATE):
            beyond = w - width * np.sign(w) if kind == "subtractive" else w
            assert_allclose(got, np.where(np.abs(w) < width, 0, beyond), rtol=0, atol=1e-12)
        zeros.append(np.sum(out.dtheta_b == 0))
    assert_allclose(zeros[1] / zeros[0], 2.0, rtol=0.01)


def test_the_dead_zone_takes_the_earth_rate_but_not_the_bias():
    spec = TriadSpec(dead_zone=1e-4, turn_on_bias_sd=1e-3)
    truth = still(1.0, 100.0)
    record, bias = run(truth, gyro=spec)
    assert_allclose(record.dtheta_b * 100.0, np.tile(bias.gyro_b[0], (100, 1)), atol=1e-12)


def test_beyond_the_range_samples_are_clipped_and_flagged():
    w = np.zeros((2001, 3))
    w[:, 1] = np.linspace(-1.9999, 2.0001, 2001)  # no sample at a limit
    truth = made(w, np.zeros_like(w))
    flagged = []
    for limit in (0.5, 1.0):
        record, _ = run(truth, gyro=replace(OFF, range=limit))
        assert_allclose(record.dtheta_b[:, 1] * RATE, np.clip(w[:, 1], -limit, limit), atol=1e-12)
        assert_array_equal(record.valid, np.abs(w[:, 1]) <= limit)
        flagged.append(np.sum(~record.valid))
    assert flagged[0] > flagged[1] > 0
    by_accel = run(made(np.zeros_like(w), w), accel=replace(OFF, range=0.5))[0]
    assert np.sum(~by_accel.valid) == flagged[0]


@pytest.mark.parametrize("cutoff", [5.0, 10.0, 20.0])
def test_the_filter_has_half_the_power_at_its_bandwidth_and_the_delay_of_a_butterworth(cutoff):
    """Gain 1/sqrt(2) at the cutoff; a ramp lags by sqrt(2) / w; the area under a pulse stays."""
    rate = 2000.0
    t = np.arange(8000) / rate
    w = np.tile(np.sin(2 * np.pi * cutoff * (t + 0.5 / rate))[:, None], (1, 3))
    out = run(made(w, w, rate), gyro=replace(OFF, bandwidth=cutoff))[0].dtheta_b[:, 0] * rate
    whole = out[-int(rate / cutoff) * 5 :]  # five periods
    assert_allclose(np.sqrt(2 * np.mean(whole**2)), np.sqrt(0.5), rtol=2e-3)
    ramp = np.tile(t[:, None], (1, 3))
    late = ramp - run(made(ramp, ramp, rate), gyro=replace(OFF, bandwidth=cutoff))[0].dtheta_b * rate
    assert_allclose(late[-1], np.sqrt(2) / (2 * np.pi * cutoff), rtol=0.01)
    pulse = np.zeros((8000, 3))
    pulse[100:110] = 1.0
    area = run(made(pulse, pulse, rate), gyro=replace(OFF, bandwidth=cutoff))[0].dtheta_b.sum(axis=0) * rate
    assert_allclose(area, 10.0, rtol=1e-9)


def test_a_bandwidth_above_half_the_sample_rate_leaves_only_its_delay():
    """375 Hz at 200 Hz: no sample can show the cutoff, a ramp still lags by sqrt(2) / w = 0.6 ms."""
    t = np.arange(400) / 200.0
    ramp = np.tile(t[:, None], (1, 3))
    out = run(made(ramp, ramp, 200.0), gyro=replace(OFF, bandwidth=375.0))[0].dtheta_b * 200.0
    assert_allclose((ramp - out)[-1], np.sqrt(2) / (2 * np.pi * 375.0), rtol=0.01)


@pytest.mark.parametrize("delay", [0.004, 0.0125, 0.1])
def test_the_delay_shifts_the_motion(delay):
    t = np.arange(1000) / RATE
    ramp = np.tile(t[:, None], (1, 3))
    record = run(made(ramp, ramp), gyro=replace(OFF, delay=delay), accel=replace(OFF, delay=2 * delay))[0]
    assert_allclose((ramp - record.dtheta_b * RATE)[-1], delay, rtol=1e-9)
    assert_allclose((ramp - record.dvel_b * RATE)[-1], 2 * delay, rtol=1e-9)


def test_a_filter_refuses_samples_of_unequal_length():
    truth = still(1.0, 100.0)
    for off in (0.003, 1e-7):
        t = truth.t.copy()
        t[50] += off
        with pytest.raises(ValueError, match="samples of equal length"):
            run(replace(truth, t=t), gyro=replace(OFF, delay=0.01))
    t[50] = truth.t[50] + 1e-12  # by rounding
    run(replace(truth, t=t), gyro=replace(OFF, delay=0.01))


# --- where the accelerometers are ---------------------------------------------------------------------


def test_a_skewed_triad_gives_the_force_back_and_the_noise_gains_of_the_register():
    """B-0: N^-1 undoes N; noise gains 0.754 and 1.270 at 40 deg, within 2 % of 200 000 samples."""
    quiet = still(10.0, 100.0)
    for degrees, gains in {
        30: (0.667, 1.633),
        40: (0.754, 1.270),
        54.7356: (1, 1),
        70: (1.688, 0.869),
    }.items():
        cone = np.deg2rad(degrees)
        record = run(quiet, accel_cone=cone)[0]
        assert_allclose(record.dvel_b, quiet.dvel_b, rtol=0, atol=1e-14)
        noisy = made(np.zeros((200_000, 3)), np.zeros((200_000, 3)))
        noise = run(noisy, accel=replace(OFF, random_walk=1.0), accel_cone=cone)[0].dvel_b * np.sqrt(RATE)
        assert_allclose(noise.std(axis=0), [gains[0], gains[1], gains[1]], rtol=0.02)
        assert_allclose(
            np.linalg.inv(imu_terms.cone_axes(cone)) @ imu_terms.cone_axes(cone), np.eye(3), atol=1e-12
        )
    assert_allclose(np.linalg.cond(imu_terms.cone_axes(np.deg2rad(40.0))), 1.685, atol=1e-3)
    assert_allclose(np.linalg.cond(imu_terms.cone_axes(np.deg2rad(70.0))), 1.943, atol=1e-3)


def test_the_bias_of_a_skewed_triad_is_reported_in_the_body():
    quiet = still(10.0, 100.0)
    record, bias = run(quiet, accel=replace(OFF, turn_on_bias_sd=1e-2), accel_cone=0.7)
    assert_allclose((record.dvel_b - quiet.dvel_b) * 100.0, np.tile(bias.accel_b[0], (1000, 1)), atol=1e-12)


def test_an_accelerometer_off_the_center_feels_the_rotation():
    """B-0: arm 0.5 m, 10 deg/s and 20 deg/s^2: 0.015 and 0.175 m/s^2; twice the arm, twice the force."""
    spin, gain = np.deg2rad(10.0), np.deg2rad(20.0)
    t = (np.arange(200) + 0.5) / RATE
    w = np.column_stack([0 * t, 0 * t, spin + gain * (t - t[100])])
    truth = made(w, np.zeros_like(w))
    for scale in (1.0, 2.0):
        arms = ((0.5 * scale, 0.0, 0.0), (0.5 * scale, 0.0, 0.0), (0.0, 0.0, 0.0))
        felt = run(truth, accel_arms=arms)[0].dvel_b[100] * RATE
        assert_allclose(felt, scale * np.array([-0.5 * spin**2, 0.5 * gain, 0.0]), rtol=1e-6)
    assert_allclose([0.5 * spin**2, 0.5 * gain], [0.015, 0.175], atol=5e-4)


def test_the_size_effect_is_the_derivative_of_the_motion_of_the_point():
    """Against the places of three points on a body that turns to and fro, differenced twice."""
    rate, n = 500.0, 1000
    t = np.arange(n + 1) / rate
    angle = 0.4 * np.sin(2 * t)
    axis = np.array([1.0, 2.0, -2.0]) / 3

    def turn(a):
        K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K

    arms = ((0.03, 0.01, -0.02), (-0.01, 0.04, 0.02), (0.02, -0.03, 0.05))
    truth = made(np.outer(np.diff(angle) * rate, axis), np.zeros((n, 3)), rate)
    felt = run(truth, accel_arms=arms)[0].dvel_b * rate
    for k in (100, 400, 777):
        at = (k + 0.5) / rate
        h = 1e-4
        a = [0.4 * np.sin(2 * (at + d)) for d in (-h, 0.0, h)]
        for i in range(3):
            moved = (turn(a[0]) - 2 * turn(a[1]) + turn(a[2])) @ arms[i] / h**2
            assert_allclose(felt[k, i], (turn(a[1]).T @ moved)[i], atol=1e-4)


def test_the_size_effect_knows_the_length_of_each_sample():
    """Rates on a parabola through the middles of unequal samples: its derivative, exactly; on a line the
    first two samples have it, too. The samples before a piece are those of the whole."""
    dt = np.array([0.004, 0.007, 0.005, 0.012, 0.003, 0.009])
    middle = np.cumsum(dt) - dt / 2
    arms, none = np.eye(3) * 0.5, np.zeros((len(dt), 3))
    for slope, bend in ((2.0, 0.0), (2.0, 300.0)):
        w = 0.3 + slope * middle + bend * middle**2
        turned = np.outer(w * dt, [0.0, 0.0, 1.0])
        whole = imu_terms.resolve_along_axes(turned, none, dt, arms[[1, 0, 2]], np.eye(3), SensorDraws(1, 0))
        rate = slope + 2 * bend * middle
        known = slice(2 if bend else 0, None)
        expected = np.column_stack([-0.5 * rate, 0.5 * rate, 0 * rate])  # of arms y, x and z
        assert_allclose((whole / dt[:, None])[known], expected[known], rtol=0, atol=1e-9)
        draws = SensorDraws(1, 0)
        parts = [
            imu_terms.resolve_along_axes(turned[k], none[k], dt[k], arms[[1, 0, 2]], np.eye(3), draws)
            for k in (slice(0, 3), slice(3, 4), slice(4, 6))
        ]
        assert_array_equal(np.concatenate(parts), whole)


# --- temperature and vibration ------------------------------------------------------------------------


def weather(duration, temperature=None, engine=None, wind=None):
    t = np.arange(round(20 * duration) + 1) / 20
    one = np.ones_like(t)
    return AirData(
        t=t,
        pressure=9e4 * one,
        temperature=temperature(t) if temperature else 280.0 * one,
        airspeed_true=25.0 * one,
        airspeed_calibrated=25.0 * one,
        alpha=0.0 * one,
        beta=0.0 * one,
        wind_n=wind if wind is not None else np.zeros((len(t), 3)),
        engine_speed=engine(t) if engine else 0.0 * one,
    )


def test_the_bias_follows_the_air_and_the_own_heat():
    """Closed form: air cools by 0.01 K/s behind a lag of 100 s, the unit warms by up to 15 K."""
    air = weather(400.0, temperature=lambda t: 290.0 - 0.01 * t)
    truth = made(np.zeros((8000, 3)), np.zeros((8000, 3)), 20.0, air)
    thermal = ThermalSpec(reference=298.15, self_heating=15.0, time_constant=100.0)
    spec = replace(OFF, temperature_sd=1e-4)
    bias = run(truth, gyro=spec, thermal=thermal)[1]
    slope = 1e-4 * stream(1, 0, "imu.gyro.temperature").standard_normal(3)
    fade = np.exp(-bias.t / 100.0)
    warm = 290.0 - 0.01 * (bias.t - 100.0 * (1 - fade)) + 15.0 * (1 - fade) - 298.15
    assert_allclose(bias.gyro_b, np.outer(warm, slope), rtol=0, atol=1e-9)
    hotter = run(truth, gyro=spec, thermal=replace(thermal, self_heating=30.0))[1].gyro_b - bias.gyro_b
    assert_allclose(hotter, np.outer(15.0 * (1 - fade), slope), rtol=0, atol=1e-9)
    at_once = run(truth, gyro=spec, thermal=replace(thermal, time_constant=0.0))[1].gyro_b
    assert_allclose(at_once, np.outer(290.0 - 0.01 * bias.t + 15.0 - 298.15, slope), rtol=0, atol=1e-9)


def test_without_air_data_the_air_is_that_of_the_standard_atmosphere():
    """By ISO 2533: 15 degC at sea level, 6.5 K less each kilometer, and -56.5 degC from 11 to 20 km."""
    truth = replace(made(np.zeros((160, 3)), np.zeros((160, 3)), 20.0), air=no_air())
    climb = np.interp(truth.t, [0.0, 4.0, 8.0], [0.0, 4002.52, 12_000.0])  # 4002.5 m are 4000 geopotential
    truth = replace(truth, lla=np.column_stack([truth.lla[:, :2], climb]))
    spec = replace(OFF, temperature_sd=1e-4)
    bias = run(truth, gyro=spec, thermal=ThermalSpec(reference=288.15))[1]
    slope = 1e-4 * stream(1, 0, "imu.gyro.temperature").standard_normal(3)
    assert_allclose(bias.gyro_b[[0, 80, 160]], np.outer([0.0, -26.0, -71.5], slope), rtol=0, atol=1e-7)
    space = replace(
        truth, lla=np.add(truth.lla, [0.0, 0.0, 60_000.0])
    )  # above 32 km: as at 32 km, -44.5 degC
    bias = run(space, gyro=spec, thermal=ThermalSpec(reference=288.15))[1]
    assert_allclose(bias.gyro_b, np.tile(-59.5 * slope, (161, 1)), rtol=0, atol=1e-7)


def test_speed_and_strength_of_the_shaking_are_lines_between_instants_of_the_air():
    """Held at both ends; the angle of the engine is their sum by trapezoids, from what it had turned."""
    rng = np.random.default_rng(6)
    t, at, values = (
        np.cumsum(rng.uniform(0.5, 1.5, 60)),
        np.array([9.0, 12.5, 30.0, 41.0]),
        rng.normal(size=4),
    )
    found, angle, turned = np.empty(60), np.empty(60), np.array([3.0])
    vibration.interpolate_kernel(t, at, values, found)
    line = np.interp(t, at, values)
    assert_allclose(found, line, rtol=0, atol=1e-12)
    vibration.engine_angle_kernel(t, at, values, turned, angle)
    expected = 3.0 + np.append(0.0, np.cumsum(0.5 * (line[1:] + line[:-1]) * np.diff(t)))
    assert_allclose(angle, expected, rtol=0, atol=1e-12)
    assert turned[0] == angle[-1]


def test_the_engine_shakes_at_its_speed_with_the_rms_of_its_figure():
    """40 Hz at the reference: rms as given; at half the speed a quarter, at 20 Hz; velocity stays bounded."""
    spec = VibrationSpec(engine_gyro=0.02, engine_accel=3.0, engine_reference=2 * np.pi * 40.0)
    rate, n = 1000.0, 20_000
    for share in (1.0, 0.5):
        air = weather(20.0, engine=lambda t, share=share: 2 * np.pi * 40.0 * share + 0 * t)
        record = run(made(np.zeros((n, 3)), np.zeros((n, 3)), rate, air), vibration=spec)[0]
        mean = np.sinc(40.0 * share / rate)  # of a sine over a sample, over its value
        for values, rms in ((record.dtheta_b * rate, 0.02), (record.dvel_b * rate, 3.0)):
            assert_allclose(values.std(axis=0), rms * share**2 * mean, rtol=1e-3)
            spectrum = np.abs(np.fft.rfft(values[:, 0]))
            assert_allclose(np.fft.rfftfreq(n, 1 / rate)[spectrum.argmax()], 40.0 * share, atol=0.06)
        assert np.abs(np.cumsum(record.dvel_b, axis=0)).max() < 3.0 * np.sqrt(2) * 2 / (
            2 * np.pi * 40 * share
        )
    still_engine = made(np.zeros((n, 3)), np.zeros((n, 3)), rate, weather(20.0))
    assert not run(still_engine, vibration=spec)[0].dvel_b.any()


def test_gusts_shake_the_structure_at_its_mode_in_proportion():
    """Wind of rms 2 m/s: shaking of rms 2 x figure, peak at 30 Hz, none at 0 Hz and in steady wind."""
    rng = np.random.default_rng(5)
    t = np.arange(4001) / 20
    gusty = 5.0 + rng.normal(scale=2.0, size=(len(t), 3))
    spec = VibrationSpec(gust_gyro=0.01, gust_accel=0.5, mode_frequency=30.0, mode_damping=0.05)
    zero = np.zeros((200_000, 3))
    truth = made(zero, zero, 1000.0, weather(200.0, wind=gusty))
    assert_allclose(
        np.sqrt(np.mean(vibration.compute_gust_rms(truth.air, SensorDraws(1, 0)) ** 2)), 2.0, rtol=0.02
    )
    record = run(truth, vibration=spec)[0]
    # 200 s of a 3 Hz wide band hold about 2 pi 0.05 30 200 = 1900 independent values of the square
    low, high = band(1900)
    for values, figure in ((record.dtheta_b * 1000.0, 0.01), (record.dvel_b * 1000.0, 0.5)):
        ratio = np.mean(values**2) / (2.0 * figure) ** 2
        assert 0.94 * low < ratio < 1.06 * high  # the rms of the gusts is itself within 2 %
        assert not 0.94 * low < ratio * 4 < 1.06 * high
        power = np.abs(np.fft.rfft(values.sum(axis=1))) ** 2
        f = np.fft.rfftfreq(len(values), 1e-3)
        smooth = np.convolve(power, np.full(201, 1 / 201), "same")  # 1 Hz
        assert_allclose(f[smooth.argmax()], 30.0, rtol=0.05)
        assert power[f < 1.0].mean() < 1e-3 * power[(f > 29) & (f < 31)].mean()
    double = run(truth, vibration=replace(spec, gust_accel=1.0))[0]
    assert_allclose(double.dvel_b, 2 * record.dvel_b, atol=1e-15)
    assert_array_equal(double.dtheta_b, record.dtheta_b)
    calm = made(zero[:4000], zero[:4000], 1000.0, weather(4.0, wind=np.full((81, 3), 5.0)))
    assert np.abs(run(calm, vibration=spec)[0].dvel_b).max() < 1e-9


def test_the_engine_shakes_from_a_drawn_phase_and_gusts_along_a_drawn_direction():
    """Sample by sample: the integral of a sine, and the change of a displacement times the gusts."""
    rng, n = np.random.default_rng(8), 400
    wind = rng.normal(size=(41, 3)) * np.linspace(0.5, 3.0, 41)[:, None]
    air = weather(2.0, engine=lambda t: 150.0 + 0 * t, wind=wind)
    truth = made(rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), 200.0, air)
    engine = VibrationSpec(engine_gyro=0.02, engine_accel=3.0, engine_reference=200.0, engine_order=1.5)
    gusts = VibrationSpec(gust_gyro=0.01, gust_accel=0.5, mode_frequency=12.0, mode_damping=0.1)
    w, phases = 1.5 * 150.0, stream(1, 0, "engine").uniform(0.0, 2 * np.pi, (2, 3))
    cosine = np.cos(w * truth.t[:, None, None] + phases)
    drawn = stream(1, 0, "shape").standard_normal((2, 3))
    displacement, draws = np.empty(n + 1), SensorDraws(1, 0)
    vibration.simulate_mode(truth.t, gusts, draws, displacement)
    gust = np.interp(truth.t, air.t, vibration.compute_gust_rms(air, draws))
    for spec, figures in ((engine, (0.02, 3.0)), (gusts, (0.01, 0.5))):
        shaken = vibration.shake(truth, spec, SensorDraws(1, 0))
        for k, (found, true) in enumerate(zip(shaken, (truth.dtheta_b, truth.dvel_b), strict=True)):
            amplitude = np.sqrt(2.0) * figures[k] * (150.0 / 200.0) ** 2
            expected = -amplitude / w * np.diff(cosine[:, k], axis=0)
            if spec is gusts:
                along = np.sqrt(3.0) * figures[k] * drawn[k] / np.linalg.norm(drawn[k])
                expected = np.outer(0.5 * (gust[1:] + gust[:-1]) * np.diff(displacement), along)
            assert_allclose(found - true, expected, rtol=0, atol=1e-12)


def test_gusts_are_the_spread_of_the_wind_in_the_last_ten_seconds():
    """About its own mean, at every time; a steady wind is no gust."""
    air = weather(25.0, wind=50.0 + np.random.default_rng(9).normal(size=(501, 3)) * [1.0, 3.0, 0.2])
    found = vibration.compute_gust_rms(replace(air, t=air.t + 100.0), SensorDraws(1, 0))
    for k, rms in enumerate(found):
        spread = air.wind_n[max(0, k - 199) : k + 1].std(axis=0)
        assert rms == pytest.approx(np.sqrt(np.mean(spread**2)), abs=1e-7)


def test_the_mode_has_the_covariance_of_a_stationary_oscillator():
    """Closed form of a damped oscillator on white noise whose rate has an rms of 1."""
    spec, t = VibrationSpec(mode_frequency=3.0, mode_damping=0.1), 7.0 + np.arange(7) * 0.05

    def displace(draws):
        out = np.empty(len(t))
        vibration.simulate_mode(t, spec, draws, out)
        return out

    response, w = respond("gust", 14, displace), 2 * np.pi * 3.0
    lag, swing = np.abs(np.subtract.outer(t, t)), w * np.sqrt(1 - 0.1**2)
    fade = np.exp(-0.1 * w * lag) / w**2
    expected = fade * (np.cos(swing * lag) + 0.1 * w / swing * np.sin(swing * lag))
    assert_allclose(response @ response.T, expected, rtol=0, atol=1e-15)
    assert (response[[0, 1, 1, 2], [0, 1, 2, 3]] > 0).all()


def test_vibration_reaches_the_gyro_through_the_square_of_the_force():
    """Vibration rectification: a drift of H times the mean square of the shaking."""
    air = weather(20.0, engine=lambda t: 2 * np.pi * 40.0 + 0 * t)
    zero = np.zeros((20_000, 3))
    unit = replace(UNIT, gyro=replace(OFF, g2_sensitivity_sd=1e-6))
    shaken = VibrationSpec(engine_accel=3.0, engine_reference=2 * np.pi * 40.0)
    drift = run(made(zero, zero, 1000.0, air), unit, vibration=shaken)[0].dtheta_b.mean(axis=0) * 1000.0
    H = 1e-6 * stream(1, 0, "imu.gyro.g2_sensitivity").standard_normal((3, 3))
    assert_allclose(drift, H.sum(axis=1) * 9.0 * np.sinc(0.04) ** 2, rtol=0.01)


# --- what cannot be -----------------------------------------------------------------------------------


GUSTS = ("gust_gyro", "gust_accel")


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"gyro": TriadSpec(nonlinearity_sd=1e-3)}, "nonlinearity_sd needs range_deg_s"),
        ({"gyro": TriadSpec(dead_zone=1.0, dead_zone_kind="soft")}, "dead_zone_kind = 'soft'"),
        ({"accel": TriadSpec(g_sensitivity_sd=1.0)}, "g_sensitivity_sd and g2_sensitivity_sd are for gyros"),
        ({"accel": TriadSpec(g2_sensitivity_sd=1.0)}, "g_sensitivity_sd and g2_sensitivity_sd are for gyros"),
        ({"accel_arms": ((0.0, 0.0), (0.0, 0.0))}, "three positions"),
        *(({"accel_cone": angle}, "accel_cone must be") for angle in (2.0, -0.1)),
        *(
            ({"vibration": VibrationSpec(**figures)}, "engine_reference_rpm and engine_order above 0")
            for figures in (
                {"engine_accel": 1.0},
                {"engine_gyro": 1.0},
                {"engine_gyro": 1.0, "engine_reference": 100.0, "engine_order": 0.0},
            )
        ),
        *(({"vibration": VibrationSpec(**{f: 1.0})}, "mode_frequency_hz above 0") for f in GUSTS),
        *(
            (
                {"vibration": VibrationSpec(gust_gyro=1.0, mode_frequency=9.0, mode_damping=damping)},
                "mode_damping above 0 and below 1",
            )
            for damping in (0.0, 1.0)
        ),
    ],
)
def test_a_figure_that_lacks_another_is_refused(parts, message):
    with pytest.raises(ValueError, match=message):
        run(still(1.0, 100.0), **parts)


def test_compiled_kernels_agree_with_their_own_python():
    rng = np.random.default_rng(2)
    n = 60
    t, x, v = np.arange(n + 1) / 100.0, rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    three, nine, values = rng.normal(size=3), rng.normal(size=(3, 3)), rng.normal(size=n + 1)
    step = imu_terms.compute_oscillator_step(30.0, 0.7, 0.01)
    coarse = np.linspace(0.0, 0.5, 8)
    for kernel, arguments, out in [
        (imu_terms.along_kernel, (x, v, np.diff(t), nine, nine, 0, np.empty((3, 3))), np.empty((n, 3))),
        (
            imu_terms.response_kernel,
            (x, 2.3, 30.0, step, 0.01, 0.05, False, v[:3].copy(), v[:2].copy()),
            np.empty((n, 3)),
        ),
        (imu_terms.motion_errors_kernel, (t, x, v, three, three, three, nine, nine, 2.0), np.empty((n, 3))),
        (processes.lag_kernel, (t, values, 1.0, 0.2), np.empty(n + 1)),
        (imu_terms.rotate_rows_kernel, (nine, x), np.empty((n, 3))),
        (vibration.interpolate_kernel, (t, coarse, values[:8]), np.empty(n + 1)),
        (vibration.mode_kernel, (step, step, rng.normal(size=(n, 2)), np.array([0.1, 0.2])), np.empty(n)),
        (
            vibration.shake_kernel,
            (t, x, values, values, values, three, three, values, values, three),
            np.empty((n, 3)),
        ),
    ]:
        plain = np.empty_like(out)
        kernel(*deepcopy(arguments), out)
        kernel.py_func(*arguments, plain)
        assert_allclose(out, plain, rtol=0, atol=1e-12)
