"""Where the time of an IMU sample goes in ``loose-22`` with a covariance step at 20 Hz.

    python -m tests.perf.parts

Differences of runs that leave a part out, in microseconds of CPU a sample, the least of eleven interleaved
slices.
"""

from __future__ import annotations

from dataclasses import replace

from bench import config, pipeline
from bench.navigation import estimator, forward
from bench.navigation.mechanization import propagate
from tests.perf.dense import epoch_costs


def main() -> None:
    """Print the parts."""
    profile = config.load_profile("figure-eight-matched")
    sensed = pipeline.sense(profile, pipeline.fly(profile))
    data, start, imu = sensed.data, sensed.initial, sensed.data.imu
    last = replace(data, output_t=data.output_t[-1:])

    def run(record, **options):
        filter_ = estimator.load("loose-22", {"covariance_hz": 20.0, **options})
        return lambda: filter_.run(record, start), len(imu.t)

    def strapdown():
        propagate(start.lla, start.vel_n, start.q_nb, imu.dt, imu.dtheta_b, imu.dvel_b)

    works = {
        "whole": run(data),
        "without baro": run(data, baro=False),
        "nor answers": run(last, baro=False),
        "nor covariance steps": run(last, baro=False, covariance_hz=1.0),
        "strapdown": (strapdown, len(imu.t)),
    }
    compiled, forward._fusion_kernel = forward._fusion_kernel, lambda *_: None
    prepared = epoch_costs({"prepared": run(last, baro=False, covariance_hz=1.0)}, 11)["prepared"]
    forward._fusion_kernel = compiled
    cost = epoch_costs(works, 11)
    whole, heights, answers, steps, rest = (cost[name] for name in works)
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


if __name__ == "__main__":
    main()
