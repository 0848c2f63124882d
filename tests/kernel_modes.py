"""A few kernels, and filters, run as a program that prints what they give:

    python -m tests.kernel_modes '' loose-22 tight       kernels and these filters
    BENCH_PLAIN_KERNELS=1 python -m tests.kernel_modes   plain kernels

The first argument is Python that changes numba before.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

if __name__ == "__main__":
    exec(" ".join(sys.argv[1:2]))

from bench.core.compilation import compiled
from bench.core.compilation.wide_rows import add_row, row_sums, scale_row, set_row, wide
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import gravity_kernel

PATTERN = [[0, 3], [1], [], [0, 1, 2, 3]]
UPPER = 3
add_rows = row_sums(PATTERN, UPPER)


@compiled.inner
def fill_kernel(number, factors, rows):
    add_row(rows, 0, number, rows, 1, 0, 8)
    set_row(rows, 2, number, rows, 0, 8, 16)
    scale_row(rows, 1, number, rows[3], rows, 0, 0, 16)
    return 1


@compiled.inner
def sum_kernel(number, factors, rows):
    add_rows(rows, factors, rows, rows[2:], rows, 0, 16)
    rows[0, 0] = gravity_kernel(0.5, 0.8, number)[1]
    return 2


call = compiled.make_caller([fill_kernel, sum_kernel])


@compiled.kernel
def both_kernel(at, number, factors, rows):
    return call(at[0], number, factors, rows) + 10 * call(at[1], number, factors, rows)


def main(filters: Sequence[str] = ()) -> None:
    """Print how kernels are made, and what they give; then hashes of sensors and filters on ten seconds."""
    factors, rows = wide((4, 8)), wide((4, 16))
    for array in (factors, rows):
        array[:] = np.random.default_rng(1).normal(size=array.shape)
    kinds = compiled.types_of(0.1, factors, rows)
    at = np.array([compiled.find_address(one, kinds) for one in (fill_kernel, sum_kernel)])
    made = both_kernel(at, 0.1, factors, rows)
    print(compiled.is_plain(), compiled.takes_shortcuts(), made, rows.tobytes().hex())
    if filters:
        from bench import pipeline
        from bench.io.config import read_profile
        from bench.navigation import built_in
        from bench.simulation.flight.legs.level import Straight

        profile = read_profile("all-sensors")
        profile = replace(profile, flight=replace(profile.flight, legs=(Straight(10.0),), duration=None))
        sensed = pipeline.sense(profile, pipeline.fly(profile, cache=False))
        print("sensors", _hash(sensed.data.imu.dtheta_b, sensed.data.imu.dvel_b, sensed.data.fixes.lla))
    for name in filters:
        found = built_in.load(name, {}).run(sensed.data, sensed.initial)
        print(name, _hash(found.lla, found.vel_n, found.q_nb, found.cov))


def _hash(*arrays: FloatArray) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in arrays)).hexdigest()


if __name__ == "__main__":
    main(sys.argv[2:])
