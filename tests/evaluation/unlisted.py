"""Sound solutions, and the same with faults that are no convention: what must not be given a name.

Faults are errors (K, 9) of position, velocity and attitude that are added to the answers of a sound filter.
Their sizes are 3 to 100 sigmas of what the filter reports.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.records.data import NavSolution, Trajectory
from bench.evaluation.conventions.known_conventions import Answers, TrueMotion, move
from bench.evaluation.errors.error_series import BLOCKS, interpolate_truth, select_epochs
from bench.navigation import built_in, estimator
from bench.simulation import sensors
from tests.evaluation import mistaken
from tests.weaving import units, weaving

POS, VEL, PHI = BLOCKS.values()
MOTIONS = ("s-turns", "weaving")
BEGIN = 60.0  # [s]
EVERY = 5  # of the answers at 10 Hz
SMALLEST, LARGEST = 3.0, 100.0  # sizes of faults [sigma]


@dataclass(frozen=True)
class Base:
    """A sound solution of a run of a motion."""

    truth: Trajectory
    solution: NavSolution
    antenna_b: np.ndarray
    begin: float

    @property
    def sd(self) -> np.ndarray:
        """Reported sigmas (K, 9)."""
        return np.sqrt(np.einsum("kii->ki", self.solution.cov))


@cache
def weave() -> Trajectory:
    return weaving(240.0, 100.0)


@cache
def navigate(motion: str, run: int) -> Base:
    """Return the answers of a filter whose sensors have the errors that it models, on a run of a motion."""
    if motion == "s-turns":
        truth, begin = mistaken.fly(motion)[1], mistaken.fly(motion)[0].evaluation.begin
        sensed = mistaken.sense(motion, run)
    else:
        truth, begin = weave(), BEGIN
        sensed = sensors.sense(truth, units(), 1, run)
    use = "loose-15"
    solution = estimator.answer(built_in.load(use, {}), use, sensed.data, sensed.initial)
    return Base(truth, select_epochs(solution, slice(None, None, EVERY)), sensed.data.antenna_b, begin)


def draw(number: int) -> Base:
    """Return the sound solution of a number: motions take turns."""
    return navigate(MOTIONS[number % len(MOTIONS)], number // len(MOTIONS))


def add(solution: NavSolution, error: np.ndarray) -> NavSolution:
    """Return a solution with errors (K, 9) on top of its own."""
    turned = rotation.multiply(rotation.from_rotvec(error[:, PHI]), solution.q_nb)
    lla = earth.displace(solution.lla, error[:, POS])
    return replace(solution, lla=lla, vel_n=solution.vel_n + error[:, VEL], q_nb=turned)


# --- covariances that are wrong by a factor, errors that wander -------------------------------------------


def misjudge(base: Base, r: np.random.Generator) -> NavSolution:
    """Return a solution with the sigmas of each block wrong by up to ten times, or with random walks."""
    solution = base.solution
    if r.random() < 0.5:
        factors = np.repeat(10.0 ** r.uniform(-1.0, 1.0, 3), 3)
        return replace(solution, cov=solution.cov * factors[:, None] * factors)
    steps = r.normal(size=(len(solution), 9)) * np.sqrt(np.gradient(solution.t))[:, None]
    walks = np.cumsum(steps, axis=0) / np.sqrt(solution.t[-1] - solution.t[0])  # 1 at the end
    some = np.repeat(r.random(3) < 0.6, 3) * draw_size(r)
    return add(solution, walks * some * base.sd)


# --- faults that are on no list ---------------------------------------------------------------------------

Fault = Callable[[Base, TrueMotion, np.random.Generator, float], np.ndarray]


def draw_size(r: np.random.Generator) -> float:
    return float(np.exp(r.uniform(np.log(SMALLEST), np.log(LARGEST))))


def _direct(r: np.random.Generator, flat: bool = True) -> np.ndarray:
    """Return a unit vector (3,), of the horizontal plane if flat."""
    v = r.normal(size=3) * ([1.0, 1.0, 0.0] if flat else 1.0)
    return np.asarray(v / np.linalg.norm(v))


def _put(base: Base, block: slice, values: np.ndarray) -> np.ndarray:
    """Return errors (K, 9) with values (K, 3) or (3,) in sigmas in one block."""
    error = np.zeros((len(base.solution), 9))
    error[:, block] = values * base.sd[:, block]
    return error


def _interval(base: Base, r: np.random.Generator, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the time (K,) since an interval began, and where it lasts."""
    t = base.solution.t
    since = t - r.uniform(base.begin, t[-1] - seconds)
    return since, (since >= 0.0) & (since < seconds)


def drift(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    t = base.solution.t
    return _put(base, POS, size * np.outer((t - t[0]) / (t[-1] - t[0]), _direct(r)))


def wave(block: slice) -> Fault:
    def fault(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
        phase = 2.0 * np.pi * (0.05 * base.solution.t + r.random())
        return _put(base, block, size * np.outer(np.sin(phase), _direct(r)))

    return fault


def gravity(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    """Gravity wrong by 1e-3 in a vertical channel that fixes pull back within 3 to 10 s."""
    lag = r.uniform(3.0, 10.0)
    error = np.zeros((len(base.solution), 9))
    error[:, [2, 5]] = 9.8e-3 * np.array([lag**2, lag]) * r.choice([-1.0, 1.0])
    return error


def lost(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    """20 s without corrections: a constant acceleration is integrated."""
    since, now = _interval(base, r, 20.0)
    along = _direct(r) * size * base.sd[:, :3].mean() / 200.0
    since = np.where(now, since, 0.0)[:, None]
    return np.hstack([0.5 * since**2 * along, since * along, np.zeros((len(since), 3))])


def frozen(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    _, now = _interval(base, r, 10.0)
    s, rows = base.solution, np.arange(len(now))
    held = np.where(now, int(np.argmax(now)), rows)
    turned = rotation.to_rotvec(rotation.multiply(s.q_nb[held], rotation.conjugate(s.q_nb)))
    return np.hstack([earth.difference_n(s.lla[held], s.lla), s.vel_n[held] - s.vel_n, turned])


def across_in_turns(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    ahead = motion.vel_n / np.linalg.norm(motion.vel_n, axis=1, keepdims=True)
    right = np.column_stack([-ahead[:, 1], ahead[:, 0], 0.0 * ahead[:, 0]])
    turning = motion.turn_n[:, 2:] / np.abs(motion.turn_n[:, 2]).max()
    return _put(base, POS, size * r.choice([-1.0, 1.0]) * turning * right)


def white(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    return np.asarray(r.normal(size=(len(base.solution), 9)) * base.sd * r.uniform(1.0, 3.0))


def quantized(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    step = size * base.sd.mean(axis=0)[:6]
    start = base.solution.lla[0]
    values = np.hstack([earth.difference_n(base.solution.lla, start), base.solution.vel_n])
    off = np.round(values / step) * step - values
    return np.hstack([off, np.zeros((len(off), 3))])


def radius(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    error = np.zeros((len(base.solution), 9))
    away = earth.difference_n(motion.lla, base.truth.lla[0])
    error[:, :2] = 0.003 * r.choice([-1.0, 1.0]) * away[:, :2]
    return error


def height_by_speed(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    speed = np.square(np.linalg.norm(motion.vel_n, axis=1))
    span = np.ptp(speed)
    return _put(base, POS, size * np.outer((speed - speed.mean()) / span, [0.0, 0.0, 1.0]))


def step(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    _, now = _interval(base, r, r.uniform(20.0, 80.0))
    return _put(base, POS, size * np.outer(now, _direct(r, flat=False)))


def fast_speed(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    error = np.zeros((len(base.solution), 9))
    error[:, VEL] = r.uniform(0.005, 0.05) * r.choice([-1.0, 1.0]) * motion.vel_n
    return error


def smoothed_velocity(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    lag = r.uniform(0.5, 3.0)
    late, speed = base.solution.vel_n.copy(), base.solution.vel_n
    for k, gain in enumerate(1.0 - np.exp(-np.diff(base.solution.t) / lag), start=1):
        late[k] = late[k - 1] + gain * (speed[k] - late[k - 1])
    error = np.zeros((len(speed), 9))
    error[:, VEL] = late - speed
    return error


def outliers(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    rare = r.random(len(base.solution)) < 0.05
    return _put(base, POS, rare[:, None] * r.normal(size=(len(rare), 3)) * max(size, 10.0))


def rocking(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    phase = 2.0 * np.pi * (base.solution.t / r.uniform(80.0, 300.0) + r.random())
    return _put(base, PHI, size * np.outer(np.sin(phase), _direct(r)))


def heading_by_force(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    force = motion.accel_n[:, :1] / np.abs(motion.accel_n[:, 0]).max()
    return _put(base, PHI, size * force * [0.0, 0.0, 1.0])


def wind(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    return _put(base, VEL, size * _direct(r))


def roll_in_turns(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    ahead = motion.vel_n / np.linalg.norm(motion.vel_n, axis=1, keepdims=True)
    turning = np.abs(motion.turn_n[:, 2:]) / np.abs(motion.turn_n[:, 2]).max()
    return _put(base, PHI, size * turning * ahead)


def clock_jump(base: Base, motion: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    _, now = _interval(base, r, 50.0)
    late = -np.hstack([motion.vel_n, motion.accel_n, motion.turn_n]) * r.uniform(0.05, 0.3)
    return np.asarray(now[:, None] * late)


def heading_walk(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    walk = np.cumsum(r.normal(size=len(base.solution))) / np.sqrt(len(base.solution))
    return _put(base, PHI, size * np.outer(walk, [0.0, 0.0, 1.0]))


def climbing(base: Base, _: TrueMotion, r: np.random.Generator, size: float) -> np.ndarray:
    """A vertical velocity that is off for a while, and the height that it makes."""
    since, now = _interval(base, r, 40.0)
    rate = 0.02 * size * r.choice([-1.0, 1.0])
    error = np.zeros((len(now), 9))
    error[:, 5] = rate * now
    error[:, 2] = rate * np.clip(since, 0.0, 40.0) * np.exp(-np.clip(since - 40.0, 0.0, None) / 20.0)
    return error


FAULTS: Mapping[str, Fault] = {
    "a bias of positions that drifts": drift,
    "a wave of 0.05 Hz in positions": wave(POS),
    "a wave of 0.05 Hz in velocities": wave(VEL),
    "gravity wrong by 1e-3": gravity,
    "20 s without corrections": lost,
    "frozen for 10 s": frozen,
    "positions across the track in turns": across_in_turns,
    "white noise on all": white,
    "rounded answers": quantized,
    "radius of the Earth wrong by 0.3 %": radius,
    "a height that grows with speed": height_by_speed,
    "a step of positions and back": step,
    "speeds wrong by some percent": fast_speed,
    "velocities that are smoothed": smoothed_velocity,
    "outliers of positions": outliers,
    "a tilt that rocks": rocking,
    "a heading that follows the acceleration": heading_by_force,
    "a constant velocity of the wind": wind,
    "a roll in turns": roll_in_turns,
    "a clock that jumps for 50 s": clock_jump,
    "a heading that wanders": heading_walk,
    "a climb that is off for 40 s": climbing,
}


def spoil(base: Base, name: str, r: np.random.Generator) -> NavSolution:
    """Return a solution with one of the faults, of a size that is drawn."""
    solution, size = base.solution, draw_size(r)
    t, rows = solution.t, slice(1, -1)  # the motion is of times within the truth
    inner = replace(base, solution=select_epochs(solution, rows))
    lla, vel_n, q_nb = interpolate_truth(base.truth, t[rows])
    first = np.zeros(len(inner.solution), np.int64)
    motion = move([base.truth], Answers(t[rows], lla, vel_n, q_nb, inner.solution.cov, first))
    return add(inner.solution, FAULTS[name](inner, motion, r, size))
