"""Motions of what hovers, walks and drives: random parameters, ranges from what such vehicles do.

Multirotors tilt by the horizontal force that they need, most by up to 20 to 40 deg; walkers take 1.6 to 2.1
steps a second; cars brake with 1 to 5 m/s^2 and dip by 0.15 to 0.4 deg for each m/s^2.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from tests.motions.truths import RATE, Kind, Motion, clock

G = 9.81


def draw_log(r: np.random.Generator, low: float, high: float) -> float:
    """Return a log-uniform number between two limits."""
    return float(np.exp(r.uniform(np.log(low), np.log(high))))


def waves(
    r: np.random.Generator, t: FloatArray, slowest: float, fastest: float, count: int = 4
) -> FloatArray:
    """Return a sum of sines (N,) of random periods [s] with an rms of 1."""
    periods = np.exp(r.uniform(np.log(fastest), np.log(slowest), count))
    sines = [np.sin(2.0 * np.pi * t / one + r.uniform(0.0, 2.0 * np.pi)) for one in periods]
    return np.asarray(np.sum(sines, axis=0) * np.sqrt(2.0 / count))


def smooth(values: FloatArray, seconds: float) -> FloatArray:
    """Return values (N,) averaged over a Hann window of a length [s]; the ends are held beyond the record."""
    width = max(3, round(seconds * RATE))
    kernel = np.hanning(width + 2)[1:-1]
    return np.convolve(np.pad(values, width, "edge"), kernel / kernel.sum(), "same")[width:-width]


def after(t: FloatArray, begin: float, seconds: float) -> FloatArray:
    """Return values (N,) that rise smoothly from 0 to 1 from a time on, in so many seconds."""
    share = np.clip((t - begin) / seconds, 0.0, 1.0)
    return np.asarray(share**3 * (10.0 - 15.0 * share + 6.0 * share**2))


def lean(vel_n: FloatArray, heading: FloatArray, drag: float = 0.02) -> FloatArray:
    """Return the attitude (N, 3) of rotors that push along their axis, at a heading (N,) [rad]."""
    force = np.gradient(vel_n, 1.0 / RATE, axis=0) + drag * vel_n * [1.0, 1.0, 0.0] - [0.0, 0.0, G]
    ahead = np.cos(heading) * force[:, 0] + np.sin(heading) * force[:, 1]
    right = np.cos(heading) * force[:, 1] - np.sin(heading) * force[:, 0]
    pitch = np.arctan2(-ahead, -force[:, 2])
    return np.column_stack([np.arctan2(right, np.hypot(ahead, force[:, 2])), pitch, heading])


def jitter(r: np.random.Generator, t: FloatArray, sd_deg: float) -> FloatArray:
    """Return the angles (N, 3) [rad] by which a controller misses its attitude."""
    return np.deg2rad(sd_deg) * np.column_stack([waves(r, t, 4.0, 0.5) for _ in range(3)])


def fly_off(r: np.random.Generator, t: FloatArray, begin: float) -> FloatArray:
    """Return a velocity (N, 3) that is 0 and then that of a multirotor on its way: 3 to 15 m/s."""
    course = r.uniform(0.0, 2.0 * np.pi) + r.uniform(0.3, 1.2) * waves(r, t, 60.0, 15.0)
    speed = (
        draw_log(r, 3.0, 15.0) * after(t, begin, r.uniform(3.0, 8.0)) * (1.0 + 0.2 * waves(r, t, 40.0, 8.0))
    )
    climb = r.uniform(0.2, 1.0) * waves(r, t, 40.0, 10.0) * after(t, begin, 5.0)
    return np.column_stack([speed * np.cos(course), speed * np.sin(course), climb])


def hover(r: np.random.Generator) -> Motion:
    """Hold a place for 15 to 90 s with the nose turning 0.1 to 5 deg/s or not at all, then fly off."""
    still = r.uniform(15.0, 90.0)
    t = clock(still + r.uniform(60.0, 110.0))
    rate = r.choice([-1.0, 1.0]) * draw_log(r, 0.1, 5.0) * (r.uniform() < 0.75)
    drift = draw_log(r, 0.01, 0.3)  # of the place it holds [m/s]
    vel_n = fly_off(r, t, still) + drift * np.column_stack([waves(r, t, 30.0, 4.0) for _ in range(3)])
    course = np.unwrap(np.arctan2(vel_n[:, 1], vel_n[:, 0]))
    nose = r.uniform(0.0, 2.0 * np.pi) + np.deg2rad(rate) * np.minimum(t, still)
    follow = after(t, still, 8.0) * (r.uniform() < 0.5)  # or a nose that stays where it was
    k = int(still * RATE)
    nose = nose + follow * (smooth(course, 2.0) - course[k])
    noise = draw_log(r, 0.05, 1.5)
    figures = {"still_s": still, "yaw_deg_s": rate, "jitter_deg": noise, "drift_mps": drift}
    return Motion(vel_n, lean(vel_n, nose) + jitter(r, t, noise), figures=figures)


def pirouette(r: np.random.Generator) -> Motion:
    """Turn the nose by 20 to 180 deg/s, hovering and on the way."""
    still = r.uniform(10.0, 40.0)
    t = clock(still + r.uniform(70.0, 110.0))
    rate = r.choice([-1.0, 1.0]) * draw_log(r, 20.0, 180.0)
    turning = after(t, r.uniform(3.0, still), 2.0) - after(t, r.uniform(still + 5.0, t[-1] - 20.0), 2.0)
    nose = r.uniform(0.0, 2.0 * np.pi) + np.cumsum(np.deg2rad(rate) * turning) / RATE
    vel_n = fly_off(r, t, still)
    attitude = lean(vel_n, nose) + jitter(r, t, draw_log(r, 0.05, 1.5))
    return Motion(vel_n, attitude, figures={"still_s": still, "yaw_deg_s": rate})


def panning(r: np.random.Generator) -> Motion:
    """Film: hover, pan by 0.5 to 10 deg/s there and back, slide sideways, circle around a subject."""
    still = r.uniform(20.0, 80.0)
    t = clock(still + r.uniform(70.0, 110.0))
    rate, cycle = draw_log(r, 0.5, 10.0), r.uniform(15.0, 60.0)
    pan = np.cumsum(np.deg2rad(rate) * smooth(np.sign(np.sin(2 * np.pi * t / cycle)), 3.0)) / RATE
    slow = draw_log(r, 0.5, 5.0)  # of the slide [m/s]
    around = 2 * np.pi * np.maximum(t - still, 0.0) / r.uniform(30.0, 60.0) * r.choice([-1.0, 1.0])
    course = r.uniform(0.0, 2.0 * np.pi) + around
    speed = slow * after(t, still, 4.0)
    vel_n = np.column_stack([speed * np.cos(course), speed * np.sin(course), 0.0 * t])
    nose = course + r.choice([-0.5, 0.5]) * np.pi + pan
    attitude = lean(vel_n, nose) + jitter(r, t, draw_log(r, 0.05, 1.5))
    return Motion(vel_n, attitude, figures={"still_s": still, "pan_deg_s": rate, "speed_mps": slow})


def walk(r: np.random.Generator) -> Motion:
    """Walk with stops: 0.8 to 1.8 m/s, bobbing, the unit in a hand, at any angle to the course."""
    t = clock(r.uniform(110.0, 200.0))
    go = np.ones(len(t))
    begin = r.uniform(2.0, 12.0)
    go[t < begin] = 0.0
    for at in np.arange(begin + r.uniform(15.0, 50.0), t[-1] - 25.0, r.uniform(25.0, 60.0)):
        go[(t > at) & (t < at + r.uniform(2.0, 12.0))] = 0.0
    speed = r.uniform(0.8, 1.8) * smooth(go, 1.5)
    course = (
        r.uniform(0.0, 2 * np.pi)
        + np.cumsum(r.uniform(0.1, 0.5) * waves(r, t, 40.0, 5.0) * smooth(go, 1.5)) / RATE
    )
    step = 2 * np.pi * np.cumsum(r.uniform(1.6, 2.1) * np.ones(len(t))) / RATE
    pace, bob = (
        speed * (1.0 + 0.12 * np.sin(step)),
        r.uniform(0.1, 0.35) * np.sin(step + 0.7) * smooth(go, 1.0),
    )
    sway = 0.08 * np.sin(0.5 * step) * smooth(go, 1.0)
    c, s = np.cos(course), np.sin(course)
    vel_n = np.column_stack([pace * c - sway * s, pace * s + sway * c, bob])
    held = r.uniform(-0.6, 0.6, 3) * [1.0, 1.0, 0.0] + [0.0, 0.0, r.uniform(-np.pi, np.pi)]
    swing = np.deg2rad(r.uniform(1.0, 6.0)) * np.column_stack([waves(r, t, 20.0, 0.5) for _ in range(3)])
    attitude = held + swing + np.column_stack([0.0 * t, 0.0 * t, course])
    return Motion(vel_n, attitude, figures={"speed_mps": float(speed.max())})


def _drive(
    r: np.random.Generator, speed: FloatArray, turn: FloatArray, bounce_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Return velocity and attitude of a car: its nose along the road, squat and roll by the forces."""
    t = np.arange(len(speed)) / RATE
    moving = np.minimum(np.abs(speed) / 2.0, 1.0)
    course = r.uniform(0.0, 2 * np.pi) + np.cumsum(turn * moving) / RATE
    way = np.cumsum(np.abs(speed)) / RATE
    slope = np.deg2rad(r.uniform(0.0, 4.0)) * np.sin(
        2 * np.pi * way / r.uniform(80.0, 600.0) + r.uniform(0.0, 6.0)
    )
    vel_n = np.column_stack([speed * np.cos(course), speed * np.sin(course), -speed * slope])
    forward = smooth(np.gradient(speed, 1.0 / RATE), 0.5)
    squat, bounce = np.deg2rad(r.uniform(0.15, 0.4)), np.deg2rad(bounce_deg)
    roll = 0.02 * speed * turn * moving / 3.0 + bounce * moving * waves(r, t, 3.0, 0.5)
    pitch = slope + squat * forward + bounce * moving * waves(r, t, 3.0, 0.5)
    return vel_n, np.column_stack([roll, pitch, course])


def car_queue(r: np.random.Generator) -> Motion:
    """Stand, creep from stop to stop, 3 to 10 of them, then drive on: 8 to 30 m/s."""
    rest = r.uniform(12.0, 40.0)
    pieces, stops = [np.zeros(round(rest * RATE))], int(r.integers(3, 11))
    for _ in range(stops):
        top, go = draw_log(r, 0.5, 6.0), r.uniform(3.0, 8.0)
        s = np.linspace(0.0, 1.0, round(go * RATE))
        pieces += [top * np.sin(np.pi * s) ** 2, np.zeros(round(draw_log(r, 2.0, 30.0) * RATE))]
    t = clock(70.0)
    top = draw_log(r, 8.0, 30.0)
    pieces.append(top * after(t, 0.0, top / r.uniform(0.8, 2.0)) * (1.0 + 0.15 * waves(r, t, 40.0, 10.0)))
    speed = np.concatenate(pieces)
    t = np.arange(len(speed)) / RATE
    turn = np.clip(r.uniform(0.02, 0.15) * waves(r, t, 40.0, 6.0), -0.4, 0.4)
    turn = np.clip(turn, -3.0 / np.maximum(speed, 1.0), 3.0 / np.maximum(speed, 1.0))
    vel_n, attitude = _drive(r, speed, smooth(turn, 1.0), r.uniform(0.05, 0.3))
    return Motion(vel_n, attitude, ("level",), rest - 1.0, figures={"stops": stops, "speed_mps": top})


def garage(r: np.random.Generator) -> Motion:
    """Back out of a place, drive rounds of a garage at 1.5 to 5 m/s, up or down its ramps, then leave it."""
    rest, back = r.uniform(12.0, 30.0), r.uniform(4.0, 8.0)
    t = clock(rest + back + r.uniform(110.0, 150.0))
    slow, fast, leave = r.uniform(1.5, 5.0), r.uniform(6.0, 14.0), r.uniform(70.0, 100.0)
    begin = rest + back + r.uniform(2.0, 6.0)
    s = np.clip((t - rest) / back, 0.0, 1.0)
    speed = slow * after(t, begin, 4.0) + (fast - slow) * after(t, rest + leave, 8.0)
    speed = speed - r.uniform(0.7, 1.6) * np.sin(np.pi * s) ** 2
    rounds = r.choice([-1.0, 1.0]) * slow / r.uniform(8.0, 18.0)  # a ramp bends as its radius [m]
    bends = smooth((np.sin(2 * np.pi * t / r.uniform(12.0, 25.0)) > -0.2).astype(float), 2.0)
    inside = after(t, begin, 4.0) - after(t, rest + leave - 5.0, 5.0)
    turn = (
        rounds * bends * inside + 0.5 * np.sin(np.pi * s) ** 2 + 0.1 * waves(r, t, 30.0, 8.0) * (1.0 - inside)
    )
    vel_n, attitude = _drive(r, speed, turn, r.uniform(0.05, 0.3))
    return Motion(vel_n, attitude, ("level",), rest - 1.0, figures={"slow_mps": slow, "fast_mps": fast})


def turntable(r: np.random.Generator) -> Motion:
    """Stand, be turned on a table by 0.2 to 60 deg/s about the vertical, stand, and be driven."""
    rest, turned = r.uniform(12.0, 40.0), r.uniform(20.0, 60.0)
    t = clock(rest + turned + r.uniform(75.0, 110.0))
    rate = r.choice([-1.0, 1.0]) * draw_log(r, 0.2, 60.0)
    turning = after(t, rest, 1.0) - after(t, rest + turned, 1.0)
    nose = np.cumsum(np.deg2rad(rate) * turning) / RATE
    top, begin = draw_log(r, 3.0, 20.0), rest + turned + r.uniform(5.0, 12.0)
    speed = top * after(t, begin, top / r.uniform(1.0, 2.5))
    vel_n, attitude = _drive(r, speed, 0.15 * waves(r, t, 40.0, 8.0), r.uniform(0.05, 0.3))
    c, s = np.cos(nose), np.sin(nose)
    vel_n = np.column_stack(
        [c * vel_n[:, 0] - s * vel_n[:, 1], s * vel_n[:, 0] + c * vel_n[:, 1], vel_n[:, 2]]
    )
    attitude[:, 2] += nose
    return Motion(vel_n, attitude, ("level",), rest - 1.0, figures={"turn_deg_s": rate, "speed_mps": top})


KINDS: dict[str, Kind] = {
    "hover": hover,
    "pirouette": pirouette,
    "panning": panning,
    "walk": walk,
    "car queue": car_queue,
    "garage": garage,
    "turntable": turntable,
}
