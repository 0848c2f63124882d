"""What flying and sensing cost beyond JSBSim and beyond drawing random numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.sensor_specs import ImuSpec, ThermalSpec, TriadSpec, VibrationSpec
from bench.core.records.specs import Profile
from bench.io import config
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.rotors import Goto, Hover, Orbit
from bench.simulation.flight.legs.turns import Turn
from tests.perf.units import Figure, Ratio, compare, cpu


def flying(profile: Profile) -> list[Figure]:
    """Recording against stepping the same aircraft with its guidance, and the first flight as a whole."""
    from bench.simulation.flight import recorder

    def record(spec: FlightSpec) -> None:
        for _ in recorder.record_plan(spec):
            pass

    def step(spec: FlightSpec) -> None:
        _, dt = recorder.simulation_step(spec.rate)
        fdm, _ = recorder.prepare(spec, dt)
        for _ in range(round((spec.duration or 600.0) / dt)):
            fdm.run()

    def recording(name: str) -> Figure:
        spec = turning(name)
        cost = compare(cpu(lambda: record(spec)), cpu(lambda: step(spec)))
        return cost.hold(f"recording a flight of the {spec.aircraft.name} / stepping it", 1.6)

    whole = compare(
        cpu(lambda: list(recorder.fly_pieces(profile.flight))), cpu(lambda: step(profile.flight)), 3
    )
    return [
        *(recording(name) for name in ("figure-eight", "circuit-navion", "long-cruise", "hover-and-sprint")),
        whole.hold("first flight / stepping it", 2.0),
    ]


def turning(name: str) -> FlightSpec:
    """Return three minutes with the aircraft of a profile: straights and turns at its first trim, hovers."""
    spec = config.read_profile(name).flight
    assert isinstance(spec, FlightSpec)
    if spec.aircraft.hovers:
        there, back = Goto(60.0, 0.0, 6.0), Goto(0.0, 0.0, 6.0)
        legs = (Hover(20.0), there, Orbit(15.0, 5.0), back, Hover(20.0))
        return replace(spec, alt=spec.alt + 20.0, legs=legs, duration=180.0, on_ground=False, severity=0)
    alt, speed = spec.aircraft.trims[0]
    turns = (Turn(side * np.pi / 4, np.radians(20.0)) for side in (1, -1))
    return replace(
        spec, alt=alt, speed=speed, legs=(Straight(20.0), *turns, Straight(20.0)), duration=180.0,
        on_ground=False, runway=None, flat_alt=0.0,
    )  # fmt: skip


def sensing(profile: Profile, truth: Trajectory) -> list[Figure]:
    from bench.simulation.sensors import imu
    from bench.simulation.sensors.draws import SensorDraws
    from bench.simulation.sensors.measurement_level import sky

    n = len(truth) - 1
    draw = np.random.default_rng(1)

    def unit() -> None:
        draw.standard_normal((n, 6))

    def against(work: Callable[[], object]) -> Ratio:
        return compare(cpu(work), cpu(unit), 31)

    sky_spec = config.read_profile(profile.name, {"sensors.gnss": "sky-l1"}).sensors
    given = sky_spec.gnss, sky_spec.antenna_b, ()
    return [
        against(lambda: imu.measure(truth, profile.sensors.imu, SensorDraws(1, 0))).hold(
            "IMU record / drawing 6 normals per sample", 3.0
        ),
        against(lambda: imu.measure(truth, every_imu_term(), SensorDraws(1, 0))).hold(
            "IMU record with every error term / the same", 8.5
        ),
        # 40 % are fixes, whose ranges are weighed by the inverse of their covariance in each epoch; 17 % the
        # waves of the ionosphere, 64 for each range; 8 % the satellites' orbits, twice
        against(lambda: sky.measure(truth, *given, SensorDraws(1, 0))).hold(
            "GPS + GLONASS ranges and fixes / the same", 9.0
        ),
    ]


def every_imu_term() -> ImuSpec:
    """Return a unit that has every error term there is, all of a plausible size."""
    triad = TriadSpec(
        random_walk=4e-5, bias_instability=1e-5, bias_correlation=300.0, turn_on_bias_sd=1e-4,
        scale_factor_sd=1e-3, misalignment_sd=1e-3, quantization=1e-9, rate_random_walk=1e-7,
        scale_asymmetry_sd=1e-4, nonlinearity_sd=1e-4, quadratic_sd=1e-5, nonorthogonality_sd=1e-3,
        alignment_sd=1e-3, temperature_sd=1e-6, dead_zone=1e-6, range=100.0, bandwidth=60.0, delay=0.003,
    )  # fmt: skip
    return ImuSpec(
        "every term",
        gyro=replace(triad, g_sensitivity_sd=1e-6, g2_sensitivity_sd=1e-8),
        accel=triad,
        thermal=ThermalSpec(self_heating=10.0, time_constant=300.0),
        vibration=VibrationSpec(0.01, 1.0, 500.0, 2.0, 0.01, 0.1, 40.0, 0.05),
        accel_cone=0.9,
        accel_arms=((0.02, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.02)),
    )
