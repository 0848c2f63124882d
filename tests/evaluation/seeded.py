"""Mistakes seeded into the recordings of shipped profiles, and whether the checks of a log find them.

``python -m tests.evaluation.seeded [PROFILE ...]`` prints the table of the guide; without a name, for all.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import bench
from bench.core.records.data import GnssFixes, ImuData
from bench.core.records.flight_specs import AircraftSpec
from bench.core.records.instruments import BaroData
from bench.evaluation.motion.recorded_motion import Check
from bench.evaluation.motion.validity import check_recording
from bench.io.config.listing import list_profiles


@dataclass(frozen=True)
class Recorded:
    """What the checks get."""

    imu: ImuData
    fixes: GnssFixes
    baro: BaroData | None
    antenna_b: np.ndarray
    sideways: bool = False  # it may fly so: its forward axis does not show

    def check(self) -> dict[str, Check]:
        """Return the checks by name."""
        return {
            c.name: c
            for c in check_recording(
                self.imu, self.fixes, {} if self.baro is None else {"baro": self.baro}, self.antenna_b
            )
            if not (self.sideways and c.name == "forward_yaw_deg")
        }


def record(name: str, run: int = 0) -> Recorded:
    """Return the recording of a shipped profile."""
    data = bench.sense(name, bench.fly(name), run=run).data
    aircraft = getattr(bench.read_profile(name).flight, "aircraft", None)
    sideways = isinstance(aircraft, AircraftSpec) and aircraft.hovers
    return Recorded(data.imu, data.fixes, data.baro, data.antenna_b, sideways)


def _turn(which: str, *rows: tuple[float, float, float]) -> Callable[[Recorded], Recorded]:
    """Return a mistake that multiplies the gyros, the accelerometers or both by a matrix."""
    matrix = np.array(rows).T

    def spoil(one: Recorded) -> Recorded:
        gyro = one.imu.dtheta_b @ matrix if which in ("gyro", "both") else one.imu.dtheta_b
        accel = one.imu.dvel_b @ matrix if which in ("accel", "both") else one.imu.dvel_b
        return replace(one, imu=replace(one.imu, dtheta_b=gyro, dvel_b=accel))

    return spoil


def _scale(which: str, factor: float) -> Callable[[Recorded], Recorded]:
    return _turn(which, *(factor * np.eye(3)))


def _move(arm: tuple[float, float, float]) -> Callable[[Recorded], Recorded]:
    return lambda one: replace(one, antenna_b=one.antenna_b + arm)


def _delay(seconds: float) -> Callable[[Recorded], Recorded]:
    return lambda one: replace(one, imu=replace(one.imu, t=one.imu.t + seconds))


def _of_fixes(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Recorded], Recorded]:
    return lambda one: replace(one, fixes=replace(one.fixes, vel_n=change(one.fixes.vel_n)))


X, Y, Z = np.eye(3)
MISTAKES: dict[str, tuple[Callable[[Recorded], Recorded], tuple[str, ...]]] = {
    "gyro x, y exchanged": (_turn("gyro", Y, X, Z), ("imu_axes",)),
    "gyro x reversed": (_turn("gyro", -X, Y, Z), ("imu_axes",)),
    "gyro y reversed": (_turn("gyro", X, -Y, Z), ("imu_axes",)),
    "gyro z reversed": (_turn("gyro", X, Y, -Z), ("imu_axes",)),
    "accelerometer x, y exchanged": (_turn("accel", Y, X, Z), ("imu_axes",)),
    "accelerometer x reversed": (_turn("accel", -X, Y, Z), ("imu_axes",)),
    "accelerometer z reversed": (_turn("accel", X, Y, -Z), ("imu_axes", "rest_tilt_deg", "level_tilt_deg")),
    "x, y of both exchanged": (_turn("both", Y, X, Z), ("imu_axes",)),
    "IMU turned by 180 deg about x": (_turn("both", X, -Y, -Z), ("rest_tilt_deg", "level_tilt_deg")),
    "IMU turned by 90 deg about z": (_turn("both", Y, -X, Z), ("forward_yaw_deg",)),
    "accelerometers turned by 10 deg about z": (
        _turn("accel", (0.9848, 0.1736, 0.0), (-0.1736, 0.9848, 0.0), Z),
        ("triads_deg",),
    ),
    "deg/s read as rad/s": (_scale("gyro", 180 / np.pi), ("turn_gain", "gyro_max_deg_s")),
    "rad/s read as deg/s": (_scale("gyro", np.pi / 180), ("turn_gain",)),
    "g read as m/s^2": (_scale("accel", 1 / 9.80665), ("gravity_ratio", "force_gain")),
    "gyros 10 % too large": (_scale("gyro", 1.1), ("turn_gain",)),
    "accelerometers 5 % too large": (_scale("accel", 1.05), ("gravity_ratio", "force_gain")),
    "IMU 0.1 s late": (_delay(0.1), ("imu_shift_s",)),
    "IMU 0.5 s early": (_delay(-0.5), ("imu_shift_s",)),
    "antenna 2 m forward": (_move((2.0, 0.0, 0.0)), ("arm_off_m",)),
    "antenna 2 m right": (_move((0.0, 2.0, 0.0)), ("arm_off_m",)),
    "antenna 2 m down": (_move((0.0, 0.0, 2.0)), ("arm_off_m",)),
    "velocity in knots": (_of_fixes(lambda v: v / 0.5144), ("velocity_axes",)),
    "velocity east, north": (
        _of_fixes(lambda v: v[:, [1, 0, 2]]),
        ("velocity_axes",),
    ),
    "velocity up": (_of_fixes(lambda v: v * [1, 1, -1]), ("velocity_axes", "velocity_ratio_down")),
}
"""Mistake -> how it is made, and the checks of which one has to fail."""

_FORWARD, _YAWED = "antenna 2 m forward", "accelerometers turned by 10 deg about z"

_TURNED = ("IMU turned by 180 deg about x", "IMU turned by 90 deg about z")
# what flies sideways hides it; with 40 deg of pitch imu_axes reports it
_UP = "velocity up"  # level flights do not show it
NOT_SHOWN: dict[str, set[str]] = {
    "static": set(MISTAKES),  # nothing moves: only gravity tells
    "climb-cruise-descend": {"gyro z reversed", _FORWARD},
    "gnss-faults": {_YAWED, "IMU 0.1 s late", _FORWARD},
    "holding": {_YAWED, _FORWARD, _UP},
    **{name: {_FORWARD, _UP} for name in ("date-line", "gnss-denied-leg", "polar")},
    **{name: {_FORWARD} for name in ("gnss-jammed", "waypoints", "figure-eight-matched")},
    **{name: {_UP} for name in ("holding-jammed", "mapping", "s-turns", "survey")},
    **{
        name: set(_TURNED)
        for name in ("delivery", "hover-and-sprint", "inspection", "survey-multirotor", "winch-launch")
    },
    "long-cruise": {
        "gyro z reversed",
        _YAWED,
        *(f"antenna 2 m {way}" for way in ("forward", "right", "down")),
        _UP,
    },
}
"""Mistakes that the motion of a profile does not show."""

TRUE_REMARKS = ("imu_gaps", "gnss_gaps", "gnss_invalid_rows", "baro_invalid_rows", "gnss_unordered_rows")
"""Remarks that are right on a sound recording: the receiver was without satellites."""


def describe(found: Mapping[str, Check], names: Sequence[str]) -> str:
    """Return what became of a mistake: found, reported as something else, or missed."""
    wrong = [name for name, check in found.items() if not check.good and name not in TRUE_REMARKS]
    if set(wrong) & set(names):
        return "found"
    return f"reported as {', '.join(wrong)}" if wrong else "missed"


def main(names: Sequence[str]) -> None:
    """Print false lines of sound recordings, and in how many profiles each mistake is found."""
    recorded = {name: record(name) for name in names}
    for name, one in recorded.items():
        false = [c.text for c in one.check().values() if not c.good and c.name not in TRUE_REMARKS]
        print(f"{name}: {'; '.join(false) or 'no false line'}", flush=True)
    print("\n| mistake | found in | not found in |\n|---|---|---|")
    for mistake, (spoil, wanted) in MISTAKES.items():
        became = {name: describe(spoil(one).check(), wanted) for name, one in recorded.items()}
        missed = [f"{name} ({what})" for name, what in became.items() if what != "found"]
        found = len(became) - len(missed)
        print(f"| {mistake} | {found} of {len(became)} | {', '.join(missed)} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or [entry.name for entry in list_profiles()])
