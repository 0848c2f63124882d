"""What the filters cost in units of `tests.perf.dense`, of each other, and of another package."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench import pipeline
from bench.core.mathematics import earth, rotation
from bench.core.records.data import Trajectory
from bench.core.records.run_records import Sensed
from bench.core.records.specs import Profile
from bench.experiments.campaigns.heap import keep_freed_memory
from bench.io import config
from bench.navigation import built_in
from bench.navigation.mechanization import propagate
from bench.navigation.models.loose_tight import Loose
from tests.perf.dense import epoch_costs
from tests.perf.units import Figure, cpu


def navigating(profile: Profile, matched: Profile) -> list[Figure]:
    """The filters in units of `tests.perf.dense`, and of the strapdown and of each other."""
    truth = pipeline.fly(matched)
    sensed = pipeline.sense(matched, truth)
    satellites = pipeline.sense(config.read_profile(profile.name, {"sensors.gnss": "sky-l1"}), truth)
    epochs = len(sensed.data.imu.t)

    def run(use: str, sky: bool = False, **options: object) -> tuple[Callable[[], object], int]:
        filter_, record = built_in.load(use, options), satellites if sky else sensed
        return lambda: filter_.run(record.data, record.initial), epochs

    def strapdown() -> None:
        imu, start = sensed.data.imu, sensed.initial
        propagate(start.lla, start.vel_n, start.q_nb, imu.dt, imu.dtheta_b, imu.dvel_b)

    def monte_carlo() -> None:
        keep_freed_memory()  # as a worker of a campaign does
        drawn = pipeline.sense(matched, truth, 1)
        pipeline.measure(matched, truth, built_in.load("loose-22", slow).run(drawn.data, drawn.initial))

    every, slow = {"covariance_hz": None}, {"covariance_hz": 20.0}
    cost = epoch_costs(
        {
            "strapdown": (strapdown, epochs),
            "loose-22, every sample": run("loose-22", **every),
            "loose-22, 20 Hz": run("loose-22", **slow),
            "loose-mems, every sample": run("loose-mems", **every),
            "tight, 20 Hz": run("tight", sky=True, **slow),
            "tight without IMU errors, 20 Hz": run("tight", sky=True, every_error=False, **slow),
            "gnss-only": run("gnss-only"),
            "smoother": run("smoother", over="loose-15"),
            "its forward filter": run("loose-15", **slow),
            "Monte Carlo": (monte_carlo, epochs),
        }
    )
    print(", ".join(f"{name} {1e6 * one:.3f} us" for name, one in cost.items()), "an epoch")
    dense = cost["dense"]
    return [
        Figure(f"dense / {name}", dense / cost[name], limit, "x", higher_is_better=True)
        for name, limit in (
            ("loose-22, every sample", 5.5),
            ("loose-22, 20 Hz", 16.0),
            ("loose-mems, every sample", 3.6),
            ("tight, 20 Hz", 7.0),
            ("tight without IMU errors, 20 Hz", 10.0),
        )
    ] + [
        Figure("gnss-only / loose-22, 20 Hz", cost["gnss-only"] / cost["loose-22, 20 Hz"], 0.3, "x"),
        Figure("smoother / its forward filter", cost["smoother"] / cost["its forward filter"], 2.5, "x"),
        Figure("sense, loose-22 at 20 Hz, judge / dense", cost["Monte Carlo"] / dense, 0.14, "x"),
        Figure("loose-22, 20 Hz / strapdown", cost["loose-22, 20 Hz"] / cost["strapdown"], math.inf, "x"),
    ]


def slower_covariance(profile: Profile, truth: Trajectory, runs: int = 10) -> list[Figure]:
    """Largest relative change of a pooled RMSE when the covariance runs at 20 Hz."""
    names = (
        "pos_rmse_n_m",
        "pos_rmse_e_m",
        "pos_rmse_d_m",
        "vel_rmse_3d_mps",
        "tilt_rmse_deg",
        "heading_rmse_deg",
    )
    squares = np.zeros((2, len(names)))
    for run in range(runs):
        sensed = pipeline.sense(profile, truth, run)
        for k, filter_ in enumerate((Loose(covariance_hz=None), Loose())):
            solution = filter_.run(sensed.data, sensed.initial)
            _, metrics = pipeline.measure(profile, truth, solution)
            squares[k] += [metrics[name] ** 2 for name in names]
    change = np.abs(np.sqrt(squares[1] / squares[0]) - 1).max()
    return [Figure(f"largest change of an RMSE by 20 Hz covariance, {runs} runs", 100 * change, 1.0, "%")]


def against_python_ins(truth: Trajectory, sensed: Sensed, seconds: float = 60.0) -> list[Figure]:
    """The same 15-state work by the python-ins package, both with a 10 Hz covariance; one round."""
    try:
        import pandas as pd
        from pyins import filters, inertial_sensor, measurements, strapdown
    except ImportError:
        print("python-ins is not installed: that ratio is left out (make perf installs it)")
        return []
    data, initial, specs = sensed.data, sensed.initial, sensed.data.specs
    n = int(np.searchsorted(data.imu.t, seconds))
    m = int(np.searchsorted(data.fixes.t, seconds))
    roll, pitch, heading = np.rad2deg(rotation.to_euler(initial.q_nb))
    pva = pd.Series(
        [*np.rad2deg(initial.lla[:2]), initial.lla[2], *initial.vel_n, roll, pitch, heading],
        index=["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"],
        name=initial.t,
    )
    columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    values = np.hstack([data.imu.dtheta_b[:n], data.imu.dvel_b[:n]])
    record = pd.DataFrame(
        np.vstack([values[:1], values]), index=[initial.t, *data.imu.t[:n]], columns=columns
    )
    lla = data.fixes.lla[:m] * [180 / np.pi, 180 / np.pi, 1.0]
    position = pd.DataFrame(lla, index=data.fixes.t[:m], columns=["lat", "lon", "alt"])
    velocity = pd.DataFrame(data.fixes.vel_n[:m], index=data.fixes.t[:m], columns=["VN", "VE", "VD"])

    def model(triad):
        return inertial_sensor.EstimationModel(
            bias_sd=np.hypot(triad.turn_on_bias_sd, triad.instability_sd),
            noise=triad.random_walk,
            bias_walk=triad.instability_sd * np.sqrt(2 / triad.bias_correlation),
        )

    sd = np.sqrt(np.diag(initial.cov))

    def theirs() -> object:
        return filters.run_feedback_filter(
            pva, sd[0], sd[3], np.rad2deg(sd[6]), np.rad2deg(sd[8]),
            strapdown.compute_increments_from_imu(record, "increment"),
            model(specs.imu.gyro), model(specs.imu.accel),
            [
                measurements.Position(position, specs.gnss.pos_h_white_sd, data.antenna_b),
                measurements.NedVelocity(velocity, specs.gnss.vel_white_sd, data.antenna_b),
            ],
            time_step=0.1,
        )  # fmt: skip

    ours = Loose(baro=False, covariance_hz=10.0)
    short = replace(
        data,
        imu=type(data.imu)(*(getattr(data.imu, f)[:n] for f in ("t", "dt", "valid", "dtheta_b", "dvel_b"))),
        output_t=data.output_t[data.output_t <= data.imu.t[n - 1]],
    )
    start = time.process_time()
    result = theirs()
    their_time = time.process_time() - start
    our_time = min(cpu(lambda: ours.run(short, initial))() for _ in range(7))
    end = result.trajectory.iloc[-1]
    there = np.array([np.deg2rad(end["lat"]), np.deg2rad(end["lon"]), end["alt"]])
    apart = earth.difference_n(ours.run(short, initial).lla[-1], there)
    print(f"python-ins and loose-15 end {np.linalg.norm(apart):.2f} m apart after {seconds:.0f} s")
    return [Figure("python-ins / loose-15, 10 Hz covariance, 60 s", their_time / our_time, 300.0, "x", True)]
