"""Paths of fixed-wing aircraft in wind, of aerobatic figures and of aircraft in a queue."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from tests.motions.held import G, after, draw_log, smooth, waves
from tests.motions.truths import RATE, clock

SLOWEST = 6.0
"""Over the ground, for a start along the course [m/s]."""


def point(course: FloatArray, climb: FloatArray) -> FloatArray:
    """Return unit vectors (N, 3) of a course and an angle of climb [rad]."""
    flat = np.cos(climb)
    return np.asarray(np.column_stack([flat * np.cos(course), flat * np.sin(course), -np.sin(climb)]))


def draw_course(r: np.random.Generator) -> float:
    """Return a course with a uniform distribution [rad]."""
    return float(r.uniform(0.0, 2.0 * np.pi))


def draw_wind(r: np.random.Generator, low: float, high: float) -> tuple[FloatArray, float]:
    """Return a level wind (3,) [m/s] from anywhere, and its speed."""
    speed, course = draw_log(r, low, high), draw_course(r)
    return speed * np.array([np.cos(course), np.sin(course), 0.0]), speed


def gusts(r: np.random.Generator, t: FloatArray, sd: float) -> FloatArray:
    """Return the velocity (N, 3) of gusts [m/s], 0.6 of the sd vertically."""
    return np.asarray(sd * np.column_stack([share * waves(r, t, 20.0, 3.5, 5) for share in (1.0, 1.0, 0.6)]))


def stroke(t: FloatArray, begin: float, seconds: float) -> FloatArray:
    """Return values (N,) that rise from 0 to 1: the rate is constant but for a quarter at each end."""
    end = seconds / 4.0
    fine = np.linspace(0.0, seconds, 400)
    push = after(fine, 0.0, end) * (1.0 - after(fine, seconds - end, end))
    total = np.cumsum(push) - push[0]
    return np.asarray(np.interp(t - begin, fine, total / total[-1]))


def box(t: FloatArray, begin: float, end: float) -> FloatArray:
    """Return 1.0 between two times and 0.0 elsewhere."""
    return np.asarray((t >= begin) & (t < end), float)


def turns(r: np.random.Generator, t: FloatArray, begin: float, low_deg: float, high_deg: float) -> FloatArray:
    """Return a bank (N,) [rad]: turns of 4 to 30 s from a time on, 3 in 10 of them straight."""
    bank, now = np.zeros(len(t)), begin
    while now < t[-1]:
        end = now + draw_log(r, 4.0, 30.0)
        side = 0.0 if r.uniform() < 0.3 else r.choice([-1.0, 1.0])
        bank += side * np.deg2rad(r.uniform(low_deg, high_deg)) * box(t, now, end)
        now = end
    return smooth(bank, 3.0)


def turn_by(start: float, bank: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the course (N,) [rad] of coordinated turns from a start."""
    return np.asarray(start + np.cumsum(G * np.tan(bank) / np.maximum(speed, 5.0)) / RATE)


def incidence(load: FloatArray, speed: FloatArray, cruise: float, trim_deg: float) -> FloatArray:
    """Return the angle (N,) [rad] to the air that gives a load [g]: `trim_deg` at 1 g and cruise."""
    angle = trim_deg * load * 1.1 * cruise**2 / (speed**2 + 0.1 * cruise**2)
    return np.deg2rad(14.0 * np.tanh(angle / 14.0))


def coordinate(
    course: FloatArray,
    climb: FloatArray,
    speed: FloatArray,
    drift: FloatArray,
    cruise: float,
    trim_deg: float,
) -> FloatArray:
    """Return the attitude (N, 3) of wings on a path through air that drifts (N, 3)."""
    ahead = point(course, climb)
    force = np.gradient(speed[:, None] * ahead + drift, 1.0 / RATE, axis=0, edge_order=2) - [0.0, 0.0, G]
    lift = force - np.sum(force * ahead, axis=1)[:, None] * ahead
    size = np.sqrt(np.sum(lift**2, axis=1))
    down = -lift / size[:, None]
    path = rotation.from_matrix(np.stack([ahead, np.cross(down, ahead), down], axis=2))
    zero = np.zeros(len(speed))
    angle = incidence(size / G, speed, cruise, trim_deg) - np.deg2rad(0.4 * trim_deg)
    nose = rotation.multiply(path, rotation.from_rotvec(np.column_stack([zero, angle, zero])))
    roll, pitch, heading = rotation.to_euler(nose)
    off = np.mod(heading - course + np.pi, 2.0 * np.pi) - np.pi
    return np.column_stack([roll, pitch, course + off])


def blend(share: FloatArray, before: FloatArray, later: FloatArray) -> FloatArray:
    """Return attitudes (N, 3) blended from one to another by a share (N,) of 0 to 1."""
    return (1.0 - share)[:, None] * before + share[:, None] * later


def drift_of(wind: float, airspeed: float, gust: float, others_deg: float) -> float:
    """Return the rms angle [deg] of course and nose over winds from anywhere that leave 6 m/s."""
    to = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    ahead, across = airspeed + wind * np.cos(to), wind * np.sin(to)
    angle = np.rad2deg(np.arctan2(across, ahead))[np.hypot(ahead, across) > SLOWEST]
    return float(np.sqrt(np.mean(angle**2) + np.rad2deg(gust / airspeed) ** 2 + others_deg**2))


class Figures:
    """A path of figures one after the other: turns of the path's axes, and the speed that gravity leaves."""

    def __init__(self, course: float, cruise: float, load: float, roll_rate: float, engine: float) -> None:
        self.cruise, self.pull_rate, self.roll_rate = cruise, (load - 1.0) * G / cruise, roll_rate
        self.engine, self.power = (
            engine,
            1.0,
        )  # the share of its weight that the engine holds, and its throttle
        self.q = [rotation.from_euler([0.0], [0.0], [course])]
        self.speed = [cruise]

    def _go(self, q: FloatArray, power: float) -> None:
        self.q.append(q)
        for up in 2.0 * (q[:, 0] * q[:, 2] - q[:, 1] * q[:, 3]):
            self.power += (power - self.power) / (0.7 * RATE)
            push = self.power * (self.engine * G * up + (self.cruise - self.speed[-1]) / 4.0)
            self.speed.append(self.speed[-1] + (push - G * up) / RATE)

    def turn(self, axis: int, degrees: float, power: float = 1.0) -> None:
        """Roll (0), pull (1) or yaw (2) by an angle."""
        rate, soft = ((self.roll_rate, 0.3), (self.pull_rate, 0.5), (2.5, 0.5))[axis]
        seconds = abs(np.deg2rad(degrees)) / rate + soft
        share = smooth(box(clock(seconds), 0.5 * soft, seconds - 0.5 * soft), soft)
        angle = np.deg2rad(degrees) * np.cumsum(share) / share.sum()
        self._go(
            rotation.multiply(self.q[-1][-1:], rotation.from_rotvec(np.outer(angle, np.eye(3)[axis]))), power
        )

    def line(self, seconds: float, power: float = 1.0) -> None:
        """Fly straight on."""
        self._go(np.repeat(self.q[-1][-1:], max(1, round(seconds * RATE)), axis=0), power)

    def bank(self, degrees: float, bank_deg: float) -> None:
        """Turn level by an angle."""
        rate = G * np.tan(np.deg2rad(bank_deg)) / self.cruise
        seconds = abs(np.deg2rad(degrees)) / rate + 1.5
        share = smooth(box(clock(seconds), 0.75, seconds - 0.75), 1.5)
        course = np.deg2rad(degrees) * np.cumsum(share) / share.sum()
        roll = np.arctan(self.cruise * np.gradient(course, edge_order=2) * RATE / G)
        level = rotation.multiply(self.q[-1][-1:], rotation.from_rotvec(np.outer(roll, [1.0, 0.0, 0.0])))
        self._go(rotation.multiply(rotation.from_rotvec(np.outer(course, [0.0, 0.0, 1.0])), level), 1.0)

    def stall_turn(self, side: float, quarter: float) -> None:
        """Climb until it hardly flies, pivot about a wing, and dive, rolling by an angle [deg] or not."""
        self.turn(1, 90.0, 0.0)
        self.line((self.speed[-1] - 9.0) / G, 0.0)
        self.turn(2, side * 180.0, 0.0)
        self.line(0.3, 0.0)
        if quarter:
            self.turn(0, quarter, 0.0)
        self.line(max(0.1, (0.7 * self.cruise - self.speed[-1]) / G), 0.0)
        self.turn(1, 90.0, 0.0)

    def fly(self, name: str, side: float, quarter: float) -> None:
        """Fly one figure; it ends level and upright."""
        parts = {
            "loop": [(1, 360.0)],
            "roll": [(0, side * 360.0)],
            "half cuban": [(1, 225.0), (0, side * 180.0), (1, 45.0)],
            "half loop": [(1, 180.0), (0, side * 180.0)],
        }
        if name == "stall turn":
            self.stall_turn(side, quarter)
        elif name == "level turn":
            self.bank(side * (135.0 + 0.5 * quarter), 55.0)
        for axis, degrees in parts.get(name, []):
            self.turn(axis, degrees)
            self.line(0.4)


FIGURES = ("loop", "roll", "half cuban", "half loop", "stall turn", "level turn")


def steer(
    r: np.random.Generator, t: FloatArray, start: float, airspeed: float, wind: FloatArray
) -> FloatArray:
    """Return the course through the air (N,) [rad] that orbits points and flies circuits over the ground."""
    course, bank, rolling = np.empty(len(t)), 0.0, 0.0
    at, center, radius, side = np.zeros(2), np.zeros(2), 60.0, 1.0
    corners, until, orbits = np.zeros((4, 2)), -1.0, False
    course[0] = start
    for k in range(len(t) - 1):
        if t[k] > until:  # the next task, near where it is
            orbits, until = bool(r.uniform() < 0.5), t[k] + r.uniform(25.0, 60.0)
            radius, side = airspeed**2 / G * r.uniform(1.8, 4.0), r.choice([-1.0, 1.0])
            center = at + radius * np.array([np.cos(course[k] + side), np.sin(course[k] + side)])
            quarter = course[k] + 0.5 * np.pi * side * np.arange(4)
            corners = at + radius * np.cumsum(
                np.column_stack([np.cos(quarter), np.sin(quarter)]) * 2.0, axis=0
            )
        out = at - center if orbits else corners[0] - at
        far = np.hypot(*out)
        aim = np.arctan2(out[1], out[0])
        if orbits:
            aim += side * (0.5 * np.pi + np.arctan(2.0 * (far / radius - 1.0)))
        elif far < 0.6 * radius:
            corners = np.roll(corners, -1, axis=0)
        across = wind[1] * np.cos(aim) - wind[0] * np.sin(aim)
        aim -= np.arcsin(np.clip(across / airspeed, -1.0, 1.0))
        off = np.mod(aim - course[k] + np.pi, 2.0 * np.pi) - np.pi
        want = np.clip(1.2 * off, -0.75, 0.75)
        rolling += (9.0 * (want - bank) - 5.0 * rolling) / RATE
        bank += rolling / RATE
        course[k + 1] = course[k] + G * np.tan(bank) / airspeed / RATE
        at = at + (airspeed * np.array([np.cos(course[k]), np.sin(course[k])]) + wind[:2]) / RATE
    return course


def rock(acceleration: FloatArray, hertz: float, damping: float) -> FloatArray:
    """Return how an undercarriage (N,) follows accelerations: 1 for a lasting 1 m/s^2, with an overshoot."""
    angle, rate, w = np.zeros(len(acceleration)), 0.0, 2.0 * np.pi * hertz
    for k in range(len(acceleration) - 1):
        rate += (w**2 * (acceleration[k] - angle[k]) - 2.0 * damping * w * rate) / RATE
        angle[k + 1] = angle[k] + rate / RATE
    return angle


def draw_queue(r: np.random.Generator, rest: float) -> tuple[list[tuple[float, float, float, float]], float]:
    """Return moves (begin [s], peak [m/s], seconds to it and from it, seconds at it) and the end.

    The last move, of 35 to 60 m at 3 to 4 m/s, leads onto the runway.
    """
    count = int(r.integers(3, 9))
    stops = np.array([draw_log(r, 5.0, 40.0) for _ in range(count)])
    stops = 5.0 + (stops - 5.0) * min(1.0, max(0.0, (130.0 - 9.0 * count) / stops.sum()))
    moves: list[tuple[float, float, float, float]] = []
    now = rest
    for k, stop in enumerate(stops, 1):
        last = k == count or (len(moves) > 1 and now - rest > 80.0)
        length, hard = r.uniform(35.0, 60.0) if last else draw_log(r, 5.0, 60.0), r.uniform(0.4, 1.1)
        peak = r.uniform(3.0, 4.0) if last else min(r.uniform(2.0, 8.0), np.sqrt(hard * length))
        ramp = peak / hard
        moves.append((now, peak, ramp, length / peak - ramp))
        now += length / peak + ramp + (min(stop, 15.0) if last else stop)
        if last:
            break
    return moves, now
