"""Speed as ratios measured side by side in one run: ``make perf``.

Filters are measured in units of `tests.perf.dense`, the least of nine interleaved slices each. Every other
ratio is the median over interleaved rounds of two CPU times of the same process. A slow or busy machine moves
both sides. Whole commands are measured by the CPU time of their own process, with pandas installed and as if
it were not: other packages import it where it is. Exit status 1 where a figure is beyond its limit.
"""

from __future__ import annotations

import importlib.util
import math
import os
import pickle
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import bench
from bench import pipeline
from bench.core.mathematics import earth, rotation
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_records import Sensed
from bench.core.records.sensor_specs import ImuSpec, ThermalSpec, TriadSpec, VibrationSpec
from bench.core.records.specs import Profile
from bench.experiments.campaigns.heap import keep_freed_memory
from bench.io import config
from bench.navigation import built_in
from bench.navigation.mechanization import propagate
from bench.navigation.models.loose_tight import Loose
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.rotors import Goto, Hover, Orbit
from bench.simulation.flight.legs.turns import Turn
from bench.views.report import page
from tests.perf import closed, hil
from tests.perf.dense import EPOCHS, dense, epoch_costs

ROUNDS = 7


@dataclass(frozen=True)
class Figure:
    what: str
    value: float
    limit: float
    unit: str
    higher_is_better: bool = False

    @property
    def over(self) -> float:
        """How far it is beyond its limit, as a part of it; 0 or less where it is kept."""
        if math.isinf(self.limit):
            return 0.0
        return (self.limit - self.value if self.higher_is_better else self.value - self.limit) / self.limit

    @property
    def word(self) -> str:
        return "kept" if self.over <= 0 else f"[red]{100 * self.over:.2g} % beyond it"


def cpu(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def ratio(work: Callable[[], object], unit: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Return the median over interleaved rounds of the CPU time of ``work`` over that of ``unit``."""
    work(), unit()  # compiled and warm
    return float(np.median([cpu(work) / cpu(unit) for _ in range(rounds)]))


COMMAND = "from bench.__main__ import main; main()"
WITHOUT_PANDAS = f"""
import sys
class NoPandas:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] == "pandas":
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, NoPandas)
{COMMAND}
"""


def command_cpu(*arguments: str, cwd: Path, cache: Path | None = None, start: str = COMMAND) -> float:
    """Return the CPU time of one ``bench`` command, its children included."""
    environment = dict(os.environ) | ({"BENCH_CACHE": str(cache)} if cache else {})
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # as it is where bench is installed
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", start, *arguments],
        cwd=cwd,
        env=environment,
        capture_output=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        sys.exit(f"bench {' '.join(arguments)}: exit {done.returncode}\n{done.stderr.decode()}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


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
        cost = ratio(lambda: record(spec), lambda: step(spec), 5)
        return Figure(f"recording a flight of the {spec.aircraft.name} / stepping it", cost, 1.4, "x")

    whole = ratio(lambda: list(recorder.fly_pieces(profile.flight)), lambda: step(profile.flight), 3)
    rotors = turning("hover-and-sprint")
    cost = float(np.median([cpu(lambda: record(rotors)) for _ in range(5)]))
    flown = rotors.duration or 0.0
    return [
        *(recording(name) for name in ("figure-eight", "circuit-navion", "long-cruise", "hover-and-sprint")),
        Figure("flight time / recording a flight of the hummingbird", flown / cost, 50.0, "x", True),
        Figure("first flight / stepping it", whole, 4.0, "x"),
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

    n = len(truth) - 1
    draw = np.random.default_rng(1)

    def unit() -> None:
        draw.standard_normal((n, 6))

    cost = ratio(lambda: imu.measure(truth, profile.sensors.imu, SensorDraws(1, 0)), unit, 31)
    whole = ratio(lambda: imu.measure(truth, every_imu_term(), SensorDraws(1, 0)), unit, 31)
    return [
        Figure("IMU record / drawing 6 normals per sample", cost, 3.0, "units"),
        Figure("IMU record with every error term / the same", whole, 6.0, "units"),
        Figure("GPS + GLONASS ranges and fixes / the same", sky_cost(profile, truth, unit), 7.0, "units"),
    ]


def sky_cost(profile: Profile, truth: Trajectory, unit: Callable[[], object]) -> float:
    """Return the cost of the measurement level, both systems, 1 Hz over the whole flight.

    40 % are fixes, whose ranges are weighed by the inverse of their covariance in each epoch; 17 % the waves
    of the ionosphere, 64 for each range; 8 % the satellites' orbits, twice.
    """
    from bench.simulation.sensors.draws import SensorDraws
    from bench.simulation.sensors.measurement_level import sky

    spec = config.read_profile(profile.name, {"sensors.gnss": "sky-l1"}).sensors
    return ratio(lambda: sky.measure(truth, spec.gnss, spec.antenna_b, (), SensorDraws(1, 0)), unit, 31)


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
    length = float(truth.t[-1] - truth.t[0])
    return [
        Figure(f"dense / {name}", dense / cost[name], limit, "x", higher_is_better=True)
        for name, limit in (
            ("loose-22, every sample", 7.0),
            ("loose-22, 20 Hz", 20.0),
            ("loose-mems, every sample", 4.0),
            ("tight, 20 Hz", 10.0),
            ("tight without IMU errors, 20 Hz", 14.0),
        )
    ] + [
        Figure("gnss-only / loose-22, 20 Hz", cost["gnss-only"] / cost["loose-22, 20 Hz"], 0.3, "x"),
        Figure("smoother / its forward filter", cost["smoother"] / cost["its forward filter"], 2.5, "x"),
        Figure("sense, loose-22 at 20 Hz, judge / dense", cost["Monte Carlo"] / dense, 0.10, "x"),
        Figure(
            "the same: flight time over CPU time",
            length / (epochs * cost["Monte Carlo"]),
            6000.0,
            "x",
            higher_is_better=True,
        ),
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
    our_time = float(np.median([cpu(lambda: ours.run(short, initial)) for _ in range(ROUNDS)]))
    end = result.trajectory.iloc[-1]
    there = np.array([np.deg2rad(end["lat"]), np.deg2rad(end["lon"]), end["alt"]])
    apart = earth.difference_n(ours.run(short, initial).lla[-1], there)
    print(f"python-ins and loose-15 end {np.linalg.norm(apart):.2f} m apart after {seconds:.0f} s")
    return [Figure("python-ins / loose-15, 10 Hz covariance, 60 s", their_time / our_time, 300.0, "x", True)]


def reporting(profile: Profile) -> list[Figure]:
    """The report of a run with the filters of its profile, in units of a slice of `tests.perf.dense`."""
    result = bench.run(profile)
    cost = ratio(lambda: page.make_page(profile.name, result), dense)
    return [Figure(f"report of {profile.name} / {EPOCHS} epochs of dense", cost, 1.5, "x")]


def commands() -> list[Figure]:
    """Whole commands, with pandas and without."""
    verbs = {
        "run figure-eight --no-causes --force -o again": (
            "bench run figure-eight --no-causes, cached and warm",
            2.5,
        ),
        "fly figure-eight": ("bench fly figure-eight, cached and warm", 0.8),
        "list": ("bench list", 0.4),
        "--help": ("bench --help", 0.5),
    }
    starts = {"without pandas": WITHOUT_PANDAS}
    if importlib.util.find_spec("pandas"):
        starts["with pandas"] = COMMAND
    else:
        print("pandas is not installed: commands beside it are left out (make perf installs it)")
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        there, cache = Path(folder), Path(folder) / "cache"
        first = command_cpu("run", "figure-eight", "-o", "first", cwd=there, cache=cache)
        figures.append(Figure("bench run figure-eight, first ever, compiling", first, 25.0, "s CPU"))
        size = (there / "first" / "flight.rrd").stat().st_size / 1e6
        figures.append(Figure("recording of figure-eight", size, 15.0, "MB"))
        for verb, (what, limit) in verbs.items():
            for where, start in starts.items():
                costs = [command_cpu(*verb.split(), cwd=there, cache=cache, start=start) for _ in range(4)]
                figures.append(Figure(f"{what}, {where}", float(np.median(costs)), limit, "s CPU"))
    return figures


FIXED_COMPILE = """
import time
import numpy as np
from numba import njit
from tests.perf.dense import _multiply
matrix, compile = np.ones((3, 3)), njit(_multiply.py_func)
begun = time.process_time()
compile(matrix, matrix, matrix, 0)
print(time.process_time() - begun)
"""


def compiling() -> list[Figure]:
    """The first run of a filter where no kernel is compiled, in first compiles of `tests.perf.dense`."""
    with tempfile.TemporaryDirectory() as folder:
        there, cache = Path(folder), Path(folder) / "cache"
        command_cpu("fly", "figure-eight", cwd=there, cache=cache)
        shutil.rmtree(cache / "kernels", ignore_errors=True)
        first = command_cpu("run", "figure-eight", "-e", "loose-22", cwd=there, cache=cache)
    units = [
        float(subprocess.run([sys.executable, "-c", FIXED_COMPILE], capture_output=True, check=True).stdout)
        for _ in range(3)
    ]
    ratio = first / float(np.median(units))
    return [Figure("first run of loose-22, truth cached / a fixed numba compile", ratio, 25.0, "units")]


FIRST_ANSWER = """
import pickle, sys
from bench.navigation.built_in import BUILT_IN, load
with open(sys.argv[1], "rb") as file:
    data, initial = pickle.load(file)
for name in sys.argv[2:] or [use for use, row in BUILT_IN.items() if row.package is None]:
    load(name, {}).run(data, initial)
"""


def starting(truth: Trajectory) -> list[Figure]:
    """First answers to two seconds of a record, each in a process of its own: compiling, and compiled."""
    sensed = pipeline.sense(config.read_profile("figure-eight", {"sensors.gnss": "sky-l1"}), truth)
    imu = sensed.data.imu
    begun = {f.name: getattr(imu, f.name)[:400] for f in fields(imu)}
    data = replace(sensed.data, imu=replace(imu, **begun), output_t=sensed.data.output_t[:21])

    def process(cache: Path, *names: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-c", FIRST_ANSWER, str(given), *names],
            env=dict(os.environ) | {"BENCH_CACHE": str(cache)},
            check=True,
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    with tempfile.TemporaryDirectory() as folder:
        given, cache = Path(folder) / "given.pickle", Path(folder) / "cache"
        given.write_bytes(pickle.dumps((data, sensed.initial)))
        first = process(cache)
        warm = float(np.median([process(cache, "loose-22") for _ in range(3)]))
    return [
        Figure("all built-in filters, first ever, compiling", first, 40.0, "s CPU"),
        Figure("loose-22, kernels warm: start of Python to first answer", warm, 1.5, "s CPU"),
    ]


def main() -> None:
    profile = config.read_profile("figure-eight")
    matched = config.read_profile("figure-eight-matched")
    truth = pipeline.fly(profile)
    sensed = pipeline.sense(profile, truth)
    figures = [
        *navigating(profile, matched),
        *slower_covariance(matched, truth),
        *against_python_ins(truth, sensed),
        *starting(truth),
        *sensing(profile, truth),
        *flying(profile),
        *(Figure(*row) for row in (*closed.measure(), *hil.measure())),
        *reporting(profile),
        *commands(),
        *compiling(),
    ]
    table = Table(title="Speed, as ratios inside one run")
    for heading in ("", "measured", "limit", ""):
        table.add_column(heading, justify="left" if not heading else "right")
    for f in figures:
        sign = ">=" if f.higher_is_better else "<="
        table.add_row(f.what, f"{f.value:.3g} {f.unit}", f"{sign} {f.limit:g}", f.word)
    console = Console(width=110)
    console.print(table)
    beyond = sum(f.over > 0 for f in figures)
    console.print(f"{beyond} of {len(figures)} figures are beyond their limit.")
    sys.exit(1 if beyond else 0)


if __name__ == "__main__":
    main()
