"""The errors of sensors that an estimator has no state for, in words.

The errors of an instrument are pairs of words and a size, which is zero or false where the unit has no such
error; those of the aiding instruments are in `bench.navigation.measurements`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import fields

from bench.specs import ImuSpec

Errors = Iterator[tuple[str, object]]


def remaining(errors: Iterable[tuple[str, object]], taken: Collection[str]) -> tuple[str, ...]:
    """Return the words of the errors that a unit has and nothing takes.

    Examples
    --------
    >>> remaining([("lag", 0.2), ("bias", 1.0), ("drift", 0.0)], taken={"bias"})
    ('lag',)
    """
    return tuple(dict.fromkeys(words for words, size in errors if size and words not in taken))


def imu_errors(imu: ImuSpec) -> Errors:
    """Yield the errors of an IMU beyond white noise and biases."""
    for name, triad in (("gyro", imu.gyro), ("accelerometer", imu.accel)):
        for one in fields(triad):
            if "triad" in one.metadata and one.metadata["triad"].error:
                yield f"{name} {one.metadata['triad'].error}", getattr(triad, one.name)
        flicker = triad.bias_model == "flicker"
        yield f"{name} bias instability as flicker noise", triad.bias_instability if flicker else 0.0
    yield "distance between the accelerometers", imu.accel_arms
    shaking = imu.vibration
    yield (
        "vibration",
        max(shaking.engine_gyro, shaking.engine_accel, shaking.gust_gyro, shaking.gust_accel),
    )
