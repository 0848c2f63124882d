"""Which errors of its units an estimator has no room for, in words.

The errors of an instrument are pairs of words and a size, which is zero or false where the unit has no such
error; those of the aiding instruments are in `bench.navigation.measurements`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from bench.specs import ImuSpec

Errors = Iterator[tuple[str, object]]


def remaining(errors: Iterable[tuple[str, object]], taken: Collection[str]) -> tuple[str, ...]:
    """Return the words of the errors that a unit has and nothing takes.

    Examples
    --------
    >>> remaining([("lag", 0.2), ("bias", 1.0), ("drift", 0.0)], taken={"bias"})
    ('lag',)
    """
    return tuple(words for words, size in errors if size and words not in taken)


def imu_errors(imu: ImuSpec) -> Errors:
    """Yield the errors of an IMU beyond white noise and biases."""
    for name, triad in (("gyro", imu.gyro), ("accelerometer", imu.accel)):
        yield f"{name} scale factor", triad.scale_factor_sd
        yield f"{name} misalignment", triad.misalignment_sd
        yield f"{name} quantization", triad.quantization
        yield f"{name} rate random walk", triad.rate_random_walk
        yield f"{name} scale factor asymmetry", triad.scale_asymmetry_sd
        yield f"{name} nonlinearity", max(triad.nonlinearity_sd, triad.quadratic_sd)
        yield f"{name} non-orthogonality", triad.nonorthogonality_sd
        yield f"{name} alignment", triad.alignment_sd
        yield f"{name} g-sensitivity", triad.g_sensitivity_sd
        yield f"{name} sensitivity to g squared", triad.g2_sensitivity_sd
        yield f"{name} temperature bias", triad.temperature_sd
        yield f"{name} dead zone", triad.dead_zone
        yield f"{name} bandwidth and delay", max(triad.bandwidth, triad.delay)
        flicker = triad.bias_model == "flicker"
        yield f"{name} bias instability as flicker noise", triad.bias_instability if flicker else 0.0
    yield "distance between the accelerometers", imu.accel_arms
    shaking = imu.vibration
    yield (
        "vibration",
        max(shaking.engine_gyro, shaking.engine_accel, shaking.gust_gyro, shaking.gust_accel),
    )
