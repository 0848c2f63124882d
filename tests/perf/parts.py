"""Where the time of an IMU sample goes in ``loose-22`` with a covariance step at 20 Hz, and that of a step.

    python -m tests.perf.parts

Differences of runs that leave a part out, in microseconds of CPU a sample, the least of eleven interleaved
slices; the parts of a step of the covariance by themselves, done again and again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from bench import pipeline
from bench.core.compilation.compiled import kernel
from bench.core.records.run_records import Sensed
from bench.io import config
from bench.navigation import built_in
from bench.navigation.error_state_filter import filter_run
from bench.navigation.error_state_filter.error_state import (
    covariance_kernel,
    dynamics_kernel,
    transition_kernel,
)
from bench.navigation.error_state_filter.propagation import noise_kernel
from bench.navigation.mechanization import propagate
from bench.navigation.models.loose_tight import Passage
from tests.measured import stamp, write_measured
from tests.perf.dense import epoch_costs

STEPS = 20_000  # of the covariance, in one slice


@kernel
def _noise_kernel(count, T, process, unknown, decay, noise):
    fading = 0
    for k in range(count):  # the interval differs, or the compiler would do it once
        fading += noise_kernel(T + 1e-9 * k, process, -1, 25.0, unknown, decay, noise)
    return fading


@kernel
def _dynamics_kernel(count, nav, C, dv, F):
    for k in range(count):
        nav[2] += 1e-9 * k
        dynamics_kernel(nav, C, dv, F)


@kernel
def _transition_kernel(count, T, F, G):
    for k in range(count):
        transition_kernel(F, T + 1e-9 * k, G)


@kernel
def _covariance_kernel(count, P, G, decay, noise, fading, drives, factor, memory):
    for _ in range(count):
        covariance_kernel(P, G, decay, noise, fading, drives, factor, memory)


def step_parts(sensed: Sensed) -> dict[str, tuple[Callable[[], object], int]]:
    """Return the parts of a step of the covariance of ``loose-22``, each done `STEPS` times."""
    run = Passage(built_in.load("loose-22", {}), sensed.data, sensed.initial, []).run
    process, work, T = run.model.process, run.work, 0.05
    step, lost = work.step, work.carried.lost
    nav, C, dv = run.now.state[:10].copy(), work.carried.C_mean, work.measure.vectors[5]
    C[:], dv[2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], -9.8
    fading = _noise_kernel(1, T, process, lost, step.decay, step.noise)
    P, drives, factor = run.now.P, process.drives, step.factor
    return {
        "decay and noise of the states": (
            lambda: _noise_kernel(STEPS, T, process, lost, step.decay, step.noise),
            STEPS,
        ),
        "dynamics F": (lambda: _dynamics_kernel(STEPS, nav, C, dv, step.F), STEPS),
        "transition Phi": (lambda: _transition_kernel(STEPS, T, step.F, step.G), STEPS),
        "Phi P Phi' + Q": (
            lambda: _covariance_kernel(
                STEPS, P, step.G, step.decay, step.noise, fading, drives, factor, work.covariance
            ),
            STEPS,
        ),
    }


def main() -> None:
    """Print the parts."""
    profile = config.read_profile("figure-eight-matched")
    sensed = pipeline.sense(profile, pipeline.fly(profile))
    data, start, imu = sensed.data, sensed.initial, sensed.data.imu
    last = replace(data, output_t=data.output_t[-1:])

    def run(record, **options):
        filter_ = built_in.load("loose-22", {"covariance_hz": 20.0, **options})
        return lambda: filter_.run(record, start), len(imu.t)

    def strapdown():
        propagate(start.lla, start.vel_n, start.q_nb, imu.dt, imu.dtheta_b, imu.dvel_b)

    works = {
        "whole": run(data),
        "without baro": run(data, baro=False),
        "nor answers": run(last, baro=False),
        "nor covariance steps": run(last, baro=False, covariance_hz=1.0),
        "strapdown": (strapdown, len(imu.t)),
        "every sample": run(data, covariance_hz=None),
    }
    compiled, filter_run.fusion_kernel = filter_run.fusion_kernel, lambda *_: None
    prepared = epoch_costs({"prepared": run(last, baro=False, covariance_hz=1.0)}, 11)["prepared"]
    filter_run.fusion_kernel = compiled
    cost = epoch_costs(works, 11)
    whole, heights, answers, steps, rest, _ = (cost[name] for name in works)
    for what, share in {
        "strapdown": rest,
        "record checked, put in order": prepared,
        "increments corrected and summed, fixes": steps - rest - prepared,
        "covariance steps": answers - steps,
        f"{len(data.baro.t)} heights of the barometer": whole - heights,
        f"{len(data.output_t)} answers with their covariance": heights - answers,
        "together": whole,
    }.items():
        print(f"{what:45} {1e6 * share:.3f} us")
    print(f"{'the same, a step at every sample':45} {1e6 * cost['every sample']:.3f} us")
    print("Of a step of the covariance, and an epoch of dense:")
    for what, share in epoch_costs(step_parts(sensed), 11).items():
        print(f"{what:45} {1e6 * share:.3f} us")


if __name__ == "__main__":
    main()
    print(write_measured([stamp()]))
