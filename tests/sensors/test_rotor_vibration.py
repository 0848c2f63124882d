"""Vibration by rotors: lines, aliases and amplitudes, coning and sculling, range and rectification.

Amplitudes are computed here from force, mass, inertia and arms; attitudes and velocities by a strapdown of
quaternion products. Blind to a wrong sense of rotation of all four rotors together.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from bench.core.mathematics.random_streams import stream
from bench.core.records.rotor_speeds import Rotors
from bench.core.records.sensor_specs import ThermalSpec, TriadSpec, VibrationSpec
from bench.core.words.exceptions import ConfigError
from bench.simulation.sensors import imu, vibration
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.rotor_vibration import RotorTones
from tests.sensors.test_imu_terms import OFF, UNIT, made, run

MASS, INERTIA, ARM, UP = 0.5, np.array([3.65e-3, 3.68e-3, 7.03e-3]), 0.1202, 0.03
HUBS = np.array([[ARM, ARM, -UP], [ARM, -ARM, -UP], [-ARM, -ARM, -UP], [-ARM, ARM, -UP]])  # ahead right first
ANTICLOCKWISE = np.array([1, 0, 1, 0], bool)  # seen from above
REFERENCE = 471.0
PLACE_B = np.array([0.02, -0.01, 0.015])  # of the IMU
ROTORS = VibrationSpec(
    rotor_accel_1=0.6, rotor_accel_2=0.9, rotor_accel_4=0.3, rotor_reference=REFERENCE, rotor_forward=ARM,
    rotor_right=ARM, rotor_up=UP, imu_forward=PLACE_B[0], imu_right=PLACE_B[1], imu_down=PLACE_B[2],
    **{f"gyration_{axis}": float(np.sqrt(i / MASS)) for axis, i in zip("xyz", INERTIA, strict=True)},
)  # fmt: skip
G_B = np.array([0.0, 0.0, -9.8])


def hover(seconds, rate, speed, w_b=(0.0, 0.0, 0.0), f_b=G_B):
    """A hover at a steady rate and force with rotor speeds of t (N,), 4 columns or one."""
    n = round(seconds * rate)
    truth = made(np.tile(w_b, (n, 1)), np.tile(f_b, (n, 1)), rate)
    speeds = np.broadcast_to(speed(truth.t) if callable(speed) else speed, (n + 1, 4))
    return replace(truth, rotors=Rotors(truth.t, speeds.copy()))


def phasors(spec=ROTORS, speed=REFERENCE):
    """Complex amplitudes by order: specific force at the IMU and angular rate, both (3, 3), by Newton.

    A quantity is Re(amplitude e^(i n psi)), psi the angle that all rotors have turned.
    """
    phases = stream(1, 0, "imu.vibration.rotors").uniform(0.0, 2 * np.pi, (4, 3))
    force, rate = np.zeros((2, 3, 3), complex)
    for k, order in enumerate((1, 2, 4)):
        rms = getattr(spec, f"rotor_accel_{order}")
        for r, hub in enumerate(HUBS):
            turn = np.exp(1j * phases[r, k]) * np.sqrt(2) * rms * MASS * (speed / REFERENCE) ** 2
            sine = 1j if ANTICLOCKWISE[r] else -1j  # Re(-i e^(i x)) = sin x: y is to the right
            newton = turn * np.array([1.0, sine, 0.0] if order == 1 else [0.0, 0.0, 1.0])
            moment = np.cross(hub, newton) / INERTIA  # angular acceleration
            force[k] += newton / MASS + np.cross(moment, PLACE_B)
            rate[k] += moment / (1j * order * speed)
    return force, rate


def line(values, rate, f):
    """Amplitude and phase (K, 3) of the line at f [Hz] in rows that last whole periods of it."""
    t = (np.arange(len(values)) + 0.5) / rate
    return 2.0 / len(values) * np.exp(-2j * np.pi * f * t) @ values


HZ = 75.0
SLOW = replace(OFF, bandwidth=218.0)


def butterworth(f, corner=218.0):
    return 1.0 / np.sqrt(1.0 + (f / corner) ** 4)


def test_a_hover_has_lines_at_the_orders_with_the_amplitudes_of_a_rigid_body():
    """75 Hz, 150 Hz and 300 Hz at 1 kHz, of gyros and accelerometers, within 1 %; nothing else above 1e-3."""
    speed, rate = 2 * np.pi * HZ, 1000.0
    record, _ = run(hover(4.0, rate, speed), vibration=ROTORS)
    force, turning = phasors(speed=speed)
    for values, expected in ((record.dvel_b * rate, force), (record.dtheta_b * rate, turning)):
        spectrum = np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0)) * 2 / len(values)
        f = np.fft.rfftfreq(len(values), 1 / rate)
        rest = np.ones(len(f), bool)
        for k, order in enumerate((1, 2, 4)):
            at = np.argmin(np.abs(f - order * HZ))
            rest[at] = False
            found = line(values, rate, order * HZ)
            mean = np.sinc(order * HZ / rate)  # of a sine over a sample, over its value
            assert_allclose(found, expected[k] * mean, rtol=0, atol=0.01 * np.abs(expected[k]).max())
        assert spectrum[rest].max() < 2e-3 * spectrum.max()


def test_lines_beyond_the_output_rate_are_where_they_fold_with_the_gain_of_the_filter():
    """77 Hz at 200 Hz, sampled at 8 kHz: orders 2 and 4 at |154 - 200| and |308 - 400| Hz, within 1 %."""
    hz, rate = 77.0, 200.0
    force, turning = phasors(speed=2 * np.pi * hz)
    spec = replace(ROTORS, inner_rate=8000.0)
    record, _ = run(hover(10.0, rate, 2 * np.pi * hz), gyro=SLOW, accel=SLOW, vibration=spec)
    for values, expected in ((record.dvel_b * rate, force), (record.dtheta_b * rate, turning)):
        values = values[200:]  # without the transient of the filter
        f = np.fft.rfftfreq(len(values), 1 / rate)
        spectrum = np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0)) * 2 / len(values)
        gains = [butterworth(order * hz) * np.sinc(order * hz / rate) for order in (1, 2, 4)]
        folded = [abs(order * hz - rate * round(order * hz / rate)) for order in (1, 2, 4)]
        assert folded == [77.0, 46.0, 92.0]
        for k, at in enumerate(folded):
            axis = np.abs(expected[k] * gains[k]).argmax()
            near = np.flatnonzero(np.abs(f - at) < 5.0)
            peak = near[spectrum[near, axis].argmax()]
            assert f[peak] == pytest.approx(at, rel=0.01)
            size = np.abs(line(values, rate, at))
            assert_allclose(size, np.abs(expected[k] * gains[k]), rtol=0, atol=0.01 * size.max())


def swing(t, speed, angle):
    """Angle and velocity of displacement (N, 3) of the body at angles of the rotors, from `phasors`."""
    force, turning = phasors()
    theta, velocity = np.zeros((2, len(t), 3))
    for k, order in enumerate((1, 2, 4)):
        wave = np.exp(1j * order * angle)[:, None]
        theta += (turning[k] / (1j * order * REFERENCE) * wave).real
        velocity += (force[k] / (1j * order * REFERENCE**2) * wave * speed[:, None]).real
    return theta, velocity


def multiply_up(dtheta):
    """Attitudes (K + 1) after rotation vectors (K, 3), by products of twice as many at a time."""
    q = Rotation.from_rotvec(np.vstack([np.zeros(3), dtheta])).as_quat()
    step = 1
    while step < len(q):
        q[step:] = (Rotation.from_quat(q[:-step]) * Rotation.from_quat(q[step:])).as_quat()
        step *= 2
    return Rotation.from_quat(q)


def test_increments_of_the_inner_rate_lead_to_a_bounded_motion_while_the_speed_changes():
    """Attitude C exp(theta) and velocity v + u' after 2 s of 300 to 700 rad/s, turning at 0.5 rad/s.

    Strapdown of 16 kHz in an inertial frame. Amplitudes are 20 times those of a hover: without the products
    of theta the attitude is 0.47 mrad off, the velocity 28 mm/s.
    """
    rate, count, w_b = 400.0, 40, np.array([0.1, -0.2, 0.45])
    strong = replace(
        ROTORS, **{f"rotor_accel_{n}": 20.0 * getattr(ROTORS, f"rotor_accel_{n}") for n in (1, 2, 4)}
    )
    truth = hover(2.0, rate, lambda t: (300.0 + 200.0 * t)[:, None], w_b)
    tones = RotorTones(truth, strong, SensorDraws(1, 0).part("imu.vibration"))
    dtheta, dvel = tones.add(slice(0, len(truth.t) - 1), truth.dtheta_b, truth.dvel_b, count)
    t = np.array([0.0, 2.0])
    speed, angle = 300.0 + 200.0 * t, 300.0 * t + 100.0 * t**2
    theta, velocity = (20.0 * part for part in swing(t, speed, angle))
    smooth = Rotation.from_rotvec(np.outer(t, w_b))
    expected = smooth * Rotation.from_rotvec(theta)
    turned = expected[0] * multiply_up(dtheta)
    gained = (turned[:-1] * Rotation.from_rotvec(0.5 * dtheta)).apply(dvel).sum(axis=0)
    fine = np.linspace(0.0, 2.0, 20_001)
    held = np.trapezoid(Rotation.from_rotvec(np.outer(fine, w_b)).apply(G_B), fine, axis=0)
    displaced = smooth.apply(velocity + np.cross(w_b, displace(angle)))
    assert np.linalg.norm((expected[1].inv() * turned[-1]).as_rotvec()) < 1e-5
    assert np.linalg.norm(gained - held - (displaced[1] - displaced[0])) < 5e-4


def displace(angle):
    """Displacement (N, 3) at angles of the rotors, with 20 times the amplitudes."""
    force, _ = phasors()
    waves = [
        (force[k] / -((order * REFERENCE) ** 2) * np.exp(1j * order * angle)[:, None]).real
        for k, order in enumerate((1, 2, 4))
    ]
    return 20.0 * np.sum(waves, axis=0)


def test_two_phased_tones_drift_by_half_the_rate_times_both_angles_in_the_sum_of_increments():
    """Coning: w theta_x theta_y sin(phase) / 2 about z, which increments of 8 kHz keep and sums lose.

    Angles about z there are none: the blades push along z.
    """
    blades = replace(ROTORS, rotor_accel_1=0.0, rotor_accel_4=0.0, rotor_accel_2=20.0, inner_rate=8000.0)
    truth = hover(4.0, 200.0, REFERENCE, f_b=(0.0, 0.0, 0.0))
    x, y, _ = phasors(blades)[1][1] / (2j * REFERENCE)  # angles
    drift = 0.5 * 2 * REFERENCE * abs(x) * abs(y) * np.sin(np.angle(x) - np.angle(y))
    tones = RotorTones(truth, blades, SensorDraws(1, 0).part("imu.vibration"))
    dtheta, _ = tones.add(slice(0, len(truth.t) - 1), truth.dtheta_b, truth.dvel_b, 40)
    turned = multiply_up(dtheta)[-1].as_rotvec()
    assert abs(drift) > 1e-4
    assert abs(turned[2] / 4.0) < 0.02 * abs(drift)
    record, _ = run(truth, vibration=blades)
    assert record.dtheta_b.sum(axis=0)[2] / 4.0 == pytest.approx(-drift, rel=3e-3)


def test_no_amplitude_gives_the_bits_of_the_truth():
    truth = hover(1.0, 200.0, REFERENCE)
    none = replace(ROTORS, rotor_accel_1=0.0, rotor_accel_2=0.0, rotor_accel_4=0.0)
    shaken = vibration.shake(truth, none, SensorDraws(1, 0))
    assert shaken[0] is truth.dtheta_b
    assert shaken[1] is truth.dvel_b
    noisy = TriadSpec(random_walk=1e-4, quantization=1e-6)
    plain, _ = run(replace(truth, rotors=hover(1.0, 200.0, 0.0).rotors), gyro=noisy, accel=noisy)
    still, _ = run(truth, gyro=noisy, accel=noisy, vibration=VibrationSpec())
    assert_array_equal(still.dtheta_b, plain.dtheta_b)
    assert_array_equal(still.dvel_b, plain.dvel_b)
    stopped, _ = run(
        hover(1.0, 200.0, 0.0), gyro=noisy, accel=noisy, vibration=replace(ROTORS, inner_rate=4e3)
    )
    assert_allclose(stopped.dvel_b, plain.dvel_b, rtol=0, atol=1e-6)  # rotors that stand shake nothing
    assert_allclose(stopped.dtheta_b, plain.dtheta_b, rtol=0, atol=1e-6)


def test_what_the_filter_and_the_range_do_inside_a_sample_reaches_the_output():
    """Peaks beyond the range clip and flag samples whose mean is within it; the force squared drifts."""
    truth, strong = hover(2.0, 200.0, REFERENCE), replace(ROTORS, rotor_accel_2=9.0, rotor_accel_1=0.0)
    force = phasors(strong)[0]
    peak = 9.8 + np.abs(force[1][2]) - np.abs(force[2][2])
    tight = replace(OFF, range=0.9 * peak)
    outside, _ = run(truth, accel=tight, vibration=strong)
    inside, _ = run(truth, accel=tight, vibration=replace(strong, inner_rate=4000.0))
    assert outside.valid.all()
    assert (~inside.valid).mean() > 0.3
    assert inside.dvel_b.mean(axis=0)[2] * 200.0 > -9.8 + 0.05  # clipped where it is most negative
    unit = replace(UNIT, gyro=replace(OFF, g2_sensitivity_sd=1e-6))
    square = G_B**2 + 0.5 * (np.abs(force) ** 2).sum(axis=0)
    H = 1e-6 * stream(1, 0, "imu.gyro.g2_sensitivity").standard_normal((3, 3))
    coning = run(truth, vibration=replace(strong, inner_rate=8000.0))[0].dtheta_b.mean(axis=0) * 200.0
    drift = run(truth, unit, vibration=replace(strong, inner_rate=8000.0))[0].dtheta_b.mean(axis=0) * 200.0
    assert_allclose(drift - coning, H @ square, rtol=0.01)


def pieces(truth, *ends):
    """A truth without air in pieces that end at these rows."""
    for first, last in zip((0, *ends), (*ends, len(truth.t) - 1), strict=True):
        points = {name: getattr(truth, name)[first : last + 1] for name in ("t", "lla", "vel_n", "q_nb")}
        steps = {name: getattr(truth, name)[first:last] for name in ("dtheta_b", "dvel_b")}
        spun = {f.name: getattr(truth.rotors, f.name)[first : last + 1] for f in fields(Rotors)}
        yield replace(truth, **points, **steps, rotors=Rotors(**spun))


@pytest.mark.parametrize("inner", [0.0, 1000.0, 8000.0])
def test_a_flight_in_pieces_has_the_bits_of_the_whole(inner):
    """Response, range, errors that follow the motion, and rotors that change their speed."""
    rng = np.random.default_rng(4)
    wander = 30.0 * rng.normal(size=(801, 4)).cumsum(axis=0) ** 2 / 800
    truth = hover(4.0, 200.0, 400.0 + wander)
    moving = {"bandwidth": 90.0, "delay": 0.0037, "dead_zone": 1e-3, "quantization": 1e-6, "range": 5.6}
    gyro = TriadSpec(random_walk=1e-4, g2_sensitivity_sd=1e-6, nonlinearity_sd=1e-4, **moving)
    unit = replace(
        UNIT, gyro=gyro, accel=TriadSpec(quadratic_sd=1e-4, **moving), thermal=ThermalSpec(), accel_cone=0.6,
        accel_arms=((0.02, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.02)),
        vibration=replace(ROTORS, inner_rate=inner),
    )  # fmt: skip
    whole, _ = imu.measure(truth, unit, SensorDraws(1, 0))
    draws = SensorDraws(1, 0)
    parts = [imu.measure(piece, unit, draws)[0] for piece in pieces(truth, 10, 20, 400, 570)]
    for name in ("dtheta_b", "dvel_b", "valid"):
        assert_array_equal(
            np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name), name
        )
    assert whole.valid.all() != bool(inner)  # the means of samples are within the range


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (
            replace(ROTORS, inner_rate=500.0),
            "inner_rate_hz = 500 Hz must be a multiple of the output rate, 200 Hz",
        ),
        (replace(ROTORS, inner_rate=100.0), "must be a multiple of the output rate"),
        (replace(ROTORS, rotor_right=0.0, gyration_z=0.0), "needs rotor_right_m, gyration_z_m above 0"),
        (replace(ROTORS, rotor_reference=0.0), "needs rotor_reference_rpm above 0"),
        (VibrationSpec(inner_rate=1000.0), "inner_rate_hz has no effect"),
        (VibrationSpec(imu_forward=3.0), "imu_forward_m has no effect"),
    ],
)
def test_what_cannot_be_is_one_line(spec, message):
    with pytest.raises((ValueError, ConfigError), match=message):
        run(hover(0.5, 200.0, REFERENCE), vibration=spec)


def test_what_has_no_rotors_is_not_shaken_by_them():
    with pytest.raises(
        ConfigError, match="rotor_accel needs the speeds of rotors, which this flight does not have"
    ):
        run(made(np.zeros((100, 3)), np.zeros((100, 3)), 200.0), vibration=ROTORS)
