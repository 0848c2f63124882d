"""Mistakes, single and in pairs, in recordings of random motions: whether the checks of a log name them.

``python -m tests.evaluation.diagnosis [--draws N] [--seed S] [--sound N] [--pairs]`` prints the shares named.
A mistake is named if the advice of the checks, followed, leaves a recording without it, and no line
remains that is not its own. It is not shown if what is left of it is unknown in the sound recording, too.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from bench.evaluation.motion.recorded_motion import Check
from tests.evaluation import random_motions
from tests.evaluation.random_motions import MOTIONS
from tests.evaluation.seeded import Recorded

Rng = np.random.Generator


def _signed(r: Rng) -> np.ndarray:
    """Return a signed permutation other than the identity and its negative."""
    while True:
        one = np.eye(3)[r.permutation(3)] * r.choice([1.0, -1.0], 3)
        if not np.array_equal(np.abs(one), np.eye(3)) or 0 < (one < 0).sum() < 3:
            return one


def _imu(one: Recorded, gyro: Any = None, accel: Any = None, t: float = 0.0) -> Recorded:
    """Return the recording with matrices on the columns of the IMU and an offset of its clock."""
    eye = np.eye(3)
    gyro, accel = (eye if m is None else np.asarray(m) * eye if np.ndim(m) < 2 else m for m in (gyro, accel))
    imu = one.imu
    imu = replace(imu, t=imu.t + t, dtheta_b=imu.dtheta_b @ gyro.T, dvel_b=imu.dvel_b @ accel.T)
    return replace(one, imu=imu)


def _clock(one: Recorded, r: Rng) -> Recorded:
    return _imu(one, t=float(r.choice([-1, 1]) * r.uniform(0.08, 0.9)))


def _far_clock(one: Recorded, r: Rng) -> Recorded:
    far = 18.0 if r.integers(2) else r.uniform(1.5, 29.0)
    return _imu(one, t=float(r.choice([-1, 1]) * far))


def _velocity_axes(one: Recorded, r: Rng) -> Recorded:
    f = one.fixes
    which = [np.diag([1.0, 1.0, -1.0]), np.eye(3)[[1, 0, 2]], 3.6 * np.eye(3), 1.943844 * np.eye(3)]
    return replace(one, fixes=replace(f, vel_n=f.vel_n @ which[r.integers(4)].T))


def _sign(one: Recorded, r: Rng) -> Recorded:
    return _imu(one, accel=-1.0)


def _gyro_axes(one: Recorded, r: Rng) -> Recorded:
    return _imu(one, gyro=_signed(r))


def _accel_axes(one: Recorded, r: Rng) -> Recorded:
    return _imu(one, accel=_signed(r))


def _handedness(one: Recorded, r: Rng) -> Recorded:
    mirror = [np.diag([1.0, -1.0, 1.0]), np.eye(3)[[1, 0, 2]], np.diag([1.0, 1.0, -1.0])][r.integers(3)]
    return _imu(one, gyro=mirror, accel=mirror)


def _gyro_unit(one: Recorded, r: Rng) -> Recorded:
    return _imu(one, gyro=float(np.rad2deg(1.0) if r.integers(2) else np.deg2rad(1.0)))


def _accel_unit(one: Recorded, r: Rng) -> Recorded:
    return _imu(one, accel=float(9.80665 if r.integers(2) else 1.0 / 9.80665))


def _arm(one: Recorded, r: Rng) -> Recorded:
    way = r.normal(size=3)
    return replace(one, antenna_b=one.antenna_b + r.uniform(1.5, 4.0) * way / np.linalg.norm(way))


def _mounting(one: Recorded, r: Rng) -> Recorded:
    while True:
        turn = _signed(r)
        if np.linalg.det(turn) > 0:
            return _imu(one, gyro=turn, accel=turn)


LATE = "late velocity"
MISTAKES: Mapping[str, Callable[[Recorded, Rng], Recorded]] = {
    "clock": _clock,
    "far clock": _far_clock,
    LATE: lambda one, r: one,  # the motion is drawn with it
    "velocity axes or unit": _velocity_axes,
    "sign of accelerometers": _sign,
    "axes of gyros": _gyro_axes,
    "axes of accelerometers": _accel_axes,
    "handedness": _handedness,
    "unit of gyros": _gyro_unit,
    "unit of accelerometers": _accel_unit,
    "lever arm": _arm,
    "mounting": _mounting,
}
_EXCHANGE = ("sign of accelerometers", "axes of gyros", "axes of accelerometers", "handedness", "mounting")
OWN: Mapping[str, Sequence[str]] = {
    "clock": ["imu_shift_s"],
    "far clock": ["imu_shift_s"],
    LATE: ["velocity_shift_s"],
    "velocity axes or unit": [
        "velocity_axes",
        *(f"velocity_ratio_{axis}" for axis in ("north", "east", "down")),
    ],
    "unit of gyros": ["turn_gain", "gyro_max_deg_s"],
    "unit of accelerometers": ["gravity_ratio", "force_gain"],
    "lever arm": ["arm_off_m"],
    **{name: ["imu_axes", "forward_yaw_deg", "level_tilt_deg", "rest_tilt_deg"] for name in _EXCHANGE},
}
"""Mistake -> the checks that may fail because of it."""


def follow(one: Recorded, checks: Mapping[str, Check]) -> Recorded:
    """Return the recording with all advice followed, as the keys of a log would."""
    for check in checks.values():
        for key, value in check.advice.items():
            if key == "imu.time_offset_s":
                one = _imu(one, t=value)
            elif key == "imu.axes":
                one = _imu(one, *value)
            elif key == "imu.gyro_gain":
                one = _imu(one, gyro=1.0 / value)
            elif key == "imu.accel_gain":
                one = _imu(one, accel=1.0 / value)
            elif key == "gnss.velocity":
                one = replace(one, fixes=replace(one.fixes, vel_n=one.fixes.vel_n @ np.asarray(value).T))
            elif key == "gnss.position_m":
                one = replace(one, antenna_b=one.antenna_b + value)
    return one


def judge(vehicle: str, seed: int, names: Sequence[str]) -> tuple[str, list[str]]:
    """Return what becomes of mistakes in one drawn recording, and the wrong lines."""
    r = np.random.default_rng([seed, 7])
    late = float(r.uniform(0.1, 0.5))
    sound = random_motions.draw(vehicle, seed)
    spoiled = random_motions.draw(vehicle, seed, late) if LATE in names else sound
    for name in names:
        spoiled = MISTAKES[name](spoiled, r)
    return describe(sound, spoiled, names, late if LATE in names else 0.0)


def describe(sound: Recorded, spoiled: Recorded, names: Sequence[str], late: float) -> tuple[str, list[str]]:
    """Return what the checks say of mistakes: named, not shown, partly, missed or false, and the lines."""
    checks, before = spoiled.check(), sound.check()

    def say(name: str) -> Check:
        return checks.get(name, Check(name, None, "", True))  # a velocity of another unit ends the comparison

    one_way = before["forward_yaw_deg"].value is not None
    own = {check for name in names for check in OWN[name]}
    wrong = [c for c in checks.values() if not c.good]
    open_clock = late > 0 and _EITHER in say("imu_shift_s").text
    false = [c.text for c in wrong if c.name not in own and not (open_clock and c.name == "imu_shift_s")]
    if false:
        return "false", false
    mended = follow(spoiled, checks)
    hidden = [name for name, check in _UNKNOWN.items() if name in names and before[check].value is None]
    left = _differ(sound, mended, one_way, say("arm_off_m").text, late)
    for name, check in _UNKNOWN.items():
        if name in names and name not in hidden and not open_clock and say(check).value is None:
            left.append(f"{name}: {say(check).text}")
    unknown = say("imu_shift_s").value is None
    shift = sum(c.advice.get("imu.time_offset_s", 0.0) for c in wrong)
    clock = float(np.median(mended.imu.t - sound.imu.t)) if not open_clock else 0.0
    heard = sum(c.advice.get("gnss.velocity_offset_s", 0.0) for c in wrong)
    if abs(clock) > _CLOCK and not unknown:
        left.append(f"clock {clock:+.3f} after {shift:+.3f}")
    if abs(late + heard) > _CLOCK and not open_clock and say("velocity_shift_s").value is not None:
        left.append(f"velocity late by {late:.3f}, advice {heard:+.3f}")
    if not left:
        return ("not shown" if hidden else "named"), []
    return ("missed" if not wrong else "partly"), [*left, *(c.text for c in wrong)]


_EITHER = "only the receiver's velocity is late"
_CLOCK = 0.06  # [s]
_UNKNOWN = {"clock": "imu_shift_s", LATE: "velocity_shift_s", "lever arm": "arm_off_m"}
"""Mistakes that a motion need not show, and the checks that say so."""


def _gain(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) with which rows of a become those of b."""
    return np.asarray(np.linalg.lstsq(a, b, rcond=None)[0].T)


def _differ(a: Recorded, b: Recorded, one_way: bool, arm_text: str, late: float) -> list[str]:
    """Return in what a followed recording differs from a sound one, but for its clocks.

    Where a vehicle does not move ``one_way``, a common rotation about its vertical does not show.
    """
    found = []
    gyro, accel = _gain(a.imu.dtheta_b, b.imu.dtheta_b), _gain(a.imu.dvel_b, b.imu.dvel_b)
    turn = np.eye(3)
    if not one_way:
        angle = np.arctan2(accel[1, 0], accel[0, 0])
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    for name, one in (("gyros", gyro), ("accelerometers", accel)):
        if np.abs(one - turn).max() > 0.12:
            found.append(f"{name}: {one.round(2).tolist()}")
    vel = _gain(a.fixes.vel_n, b.fixes.vel_n)
    if late:
        vel = np.sign(vel) * (np.abs(vel) > 0.5 * np.abs(vel).max()) * min(1.0, 2.0 / np.abs(vel).max())
        vel[2] = vel[:, 2] = np.eye(3)[2]  # an oscillation says nothing
    if np.abs(vel - np.eye(3)).max() > 0.25 and len(a.fixes.t) == len(b.fixes.t):
        found.append(f"velocity {vel.round(2).tolist()}")
    if arm_text and "does not show" not in arm_text:
        shown = arm_text.partition(" at ")[2].partition(" m")[0].split(", ")
        known = np.array([one != "?" for one in shown])
        off = (b.antenna_b - turn @ a.antenna_b)[known]
        if np.linalg.norm(off) > 0.8:
            found.append(f"arm {np.linalg.norm(off):.2f}")
    return found


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sound", type=int, default=100)
    parser.add_argument("--pairs", action="store_true")
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--only", default="")
    parser.add_argument("--motions", default=",".join(MOTIONS))
    asked = parser.parse_args(arguments)
    motions = asked.motions.split(",")
    for vehicle in motions:
        false = []
        for k in range(asked.sound):
            checks = random_motions.draw(vehicle, 1000 * asked.seed + 500 + k).check()
            false += [(k, c.text) for c in checks.values() if not c.good]
        print(
            f"sound {vehicle}: {len({k for k, _ in false})} of {asked.sound} with a line {false}", flush=True
        )
    sets = list(combinations(MISTAKES, 2)) if asked.pairs else [(name,) for name in MISTAKES]
    total = Counter[str]()
    for names in sets:
        if asked.only and asked.only not in " + ".join(names):
            continue
        became, lines = Counter[str](), []
        for vehicle in motions:
            for k in range(asked.draws):
                seed = 1000 * asked.seed + k
                what, why = judge(vehicle, seed, names)
                became[what] += 1
                if what not in ("named", "not shown"):
                    lines.append(f"    {vehicle} {seed}: {what} {why}")
        total += became
        print(f"{' + '.join(names)}: {dict(became)}", flush=True)
        if asked.verbose:
            print("\n".join(lines), flush=True)
    print(dict(total))


if __name__ == "__main__":
    main(sys.argv[1:])
