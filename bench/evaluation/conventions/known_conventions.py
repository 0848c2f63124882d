"""Conventions that are often mistaken, each with a function that undoes the mistake.

A convention without constants is undone as it is: exchanged axes, units, a conjugate. One with constants (a
time offset, a lever arm, a rotation, a height) has the derivative of the errors by them, so that they can be
fitted. What the truth says of the motion is taken at the epochs that the answers are of.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import Trajectory
from bench.evaluation.errors.error_series import BLOCKS, interpolate_truth

POS, VEL, PHI = BLOCKS["pos"], BLOCKS["vel"], BLOCKS["phi"]
_BUT_PHI = np.repeat([1.0, 1.0, 0.0], 3)[:, None]
_STEP = 0.05  # of differences in time [s]
_TURN_STEP = 0.5  # of the sum of turns [s]


@dataclass(frozen=True, slots=True)
class Answers:
    """Solutions of some runs at some epochs, run by run, as given or with a convention undone."""

    t: FloatArray  # (M,) [s]
    lla: FloatArray  # (M, 3)
    vel_n: FloatArray  # (M, 3) [m/s]
    q_nb: FloatArray  # (M, 4)
    cov: FloatArray  # (M, 9, 9)
    run: IntArray  # (M,) position of its truth in the sequence of truths
    late: float = 0.0  # the answers are of t - late [s]

    def take(self, rows: slice) -> Answers:
        """Return some of the epochs."""
        columns = ("t", "lla", "vel_n", "q_nb", "cov", "run")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})


@dataclass(frozen=True, slots=True)
class TrueMotion:
    """The truth at the epochs of solutions."""

    inside: BoolArray  # (M,) epochs that their truth covers; the others have no row below
    lla: FloatArray  # (K, 3)
    vel_n: FloatArray  # (K, 3) [m/s]
    q_nb: FloatArray  # (K, 4)
    accel_n: FloatArray  # (K, 3) rate of vel_n [m/s^2]
    turn_n: FloatArray  # (K, 3) angular rate of b relative to n [rad/s], n
    turned_n: FloatArray  # (K, 3) integral of turn_n since the truth begins [rad]
    dt: FloatArray  # (K,) since the epoch before, or since the truth begins at the first one of a run [s]
    first: BoolArray  # (K,) the first epoch of a run

    @property
    def body_to_level(self) -> FloatArray:
        """Matrices (K, 3, 3) from b to n."""
        return rotation.matrix(self.q_nb)

    @property
    def turn_b(self) -> FloatArray:
        """The angular rate (K, 3) along b [rad/s]."""
        return rotation.rotate(rotation.conjugate(self.q_nb), self.turn_n)


def move(truths: Sequence[Trajectory], answers: Answers) -> TrueMotion:
    """Return the truth of each run at the epochs of its solution."""
    t, inside, parts = answers.t - answers.late, np.zeros(len(answers.t), np.bool_), []
    for number, truth in enumerate(truths):
        own = (answers.run == number) & (t >= truth.t[0] + _STEP) & (t <= truth.t[-1] - _STEP)
        inside |= own
        parts.append(_move_within(truth, t[own]))
    return TrueMotion(inside, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _move_within(truth: Trajectory, t: FloatArray) -> tuple[FloatArray, ...]:
    """Return the columns of `TrueMotion` after the first, at times (K,) of one run."""
    lla, vel_n, q_nb = interpolate_truth(truth, t)
    (_, before_n, q_before), (_, after_n, q_after) = (
        interpolate_truth(truth, t + step) for step in (-_STEP, _STEP)
    )
    grid = np.append(np.arange(truth.t[0], truth.t[-1], _TURN_STEP), truth.t[-1])
    q_grid = interpolate_truth(truth, grid)[2]
    sums_n = np.cumsum(_turn(q_grid[:-1], q_grid[1:]), axis=0)
    turned_n = np.column_stack([np.interp(t, grid, np.append(0.0, column)) for column in sums_n.T])
    rates = (after_n - before_n) / (2.0 * _STEP), _turn(q_before, q_after) / (2.0 * _STEP)
    dt = np.diff(t, prepend=truth.t[0])
    return lla, vel_n, q_nb, *rates, turned_n, dt, np.arange(len(t)) == 0


def _turn(q_from: FloatArray, q_to: FloatArray) -> FloatArray:
    """Return the rotation vectors (K, 3) between attitudes (K, 4) [rad], n."""
    return rotation.to_rotvec(rotation.multiply(q_to, rotation.conjugate(q_from)))


def compare(answers: Answers, motion: TrueMotion) -> FloatArray:
    """Return the errors (K, 9) of position [m], velocity [m/s] and attitude [rad], n."""
    rows = motion.inside
    with np.errstate(all="ignore"):
        pos_n = earth.difference_n(answers.lla[rows], motion.lla)
        return np.hstack([pos_n, answers.vel_n[rows] - motion.vel_n, _turn(motion.q_nb, answers.q_nb[rows])])


Undo = Callable[[Answers, TrueMotion, FloatArray], Answers]
Derivative = Callable[[TrueMotion], FloatArray]


@dataclass(frozen=True, slots=True)
class Convention:
    """One mistaken convention with the function that undoes it."""

    name: str
    words: Callable[[FloatArray], str]  # constants -> what is said
    blocks: tuple[str, ...]  # that it changes
    undo: Undo
    derivative: Derivative | None = None  # (K, 9, p) of the errors by the constants
    constants: int = 0
    least: float = 0.0  # length of the constants below which it is not named
    most: float = np.inf
    shrinks: float = 0.0  # logarithm of the factor by which it enlarges the volume of the errors
    of_claim: bool = False  # it changes what is reported, and not the answers
    alone: bool = True  # it may be named without another
    starts: tuple[float, ...] = field(default=(0.0,))  # of a single constant


def list_conventions(antenna_b: FloatArray) -> list[Convention]:
    """Return all conventions to try; ``antenna_b`` (3,) is the antenna position in body axes [m]."""
    return [*_list_exchanged(), *_list_fitted(antenna_b), *_list_claims()]


# --- with constants ---------------------------------------------------------------------------------------


def _list_fitted(antenna_b: FloatArray) -> Iterator[Convention]:
    yield Convention(
        "time offset", partial(tell_time, "answers"), ("pos", "vel", "phi"), _undo_time, _by_time, 1, 0.002,
        60.0, starts=tuple(np.arange(-20.0, 20.25, 0.5).tolist()),
    )  # fmt: skip
    yield _fitted(
        "time offset of the fixes", partial(tell_time, "stamps of fixes"), ("pos", "vel"),
        lambda motion: _by_time(motion) * _BUT_PHI, 1, 0.002, 1.0,
    )  # fmt: skip
    yield _fitted("lever arm", partial(tell_arm, antenna_b), ("pos", "vel"), _by_arm, 3, 0.1, 100.0)
    yield _fitted("height", tell_height, ("pos",), partial(_by_axes, POS, [2]), 1, 5.0, 200.0)
    offset = _fitted("offset", tell_offset, ("pos",), partial(_by_axes, POS, [0, 1]), 2, 0.1, 1e4)
    yield replace(offset, alone=False)
    yield _fitted(
        "gyro scale", tell_scale, ("phi",), lambda motion: _in_rows(PHI, motion.turned_n[:, :, None]), 1,
        1e-4, 0.2,
    )  # fmt: skip
    angles = (np.deg2rad(0.2), np.deg2rad(90.0))
    yield _fitted(
        "rotation of the body", partial(tell_turn, "forward, right, down"), ("phi",),
        lambda motion: _in_rows(PHI, motion.body_to_level), 3, *angles,
    )  # fmt: skip
    yield _fitted(
        "rotation of the level", partial(tell_turn, "north, east, down"), ("phi",),
        partial(_by_axes, PHI, [0, 1, 2]), 3, *angles,
    )  # fmt: skip


def _fitted(
    name: str,
    words: Callable[[FloatArray], str],
    blocks: tuple[str, ...],
    derivative: Derivative,
    constants: int,
    least: float,
    most: float,
) -> Convention:
    """Return a convention whose errors are its derivative times the constants, turns included."""

    def undo(answers: Answers, motion: TrueMotion, c: FloatArray) -> Answers:
        lla, vel_n, q_nb, rows = answers.lla.copy(), answers.vel_n.copy(), answers.q_nb.copy(), motion.inside
        error = derivative(motion) @ c
        lla[rows] = earth.displace(lla[rows], -error[:, POS])
        vel_n[rows] -= error[:, VEL]
        q_nb[rows] = rotation.multiply(rotation.from_rotvec(-error[:, PHI]), q_nb[rows])
        return replace(answers, lla=lla, vel_n=vel_n, q_nb=q_nb)

    return Convention(name, words, blocks, undo, derivative, constants, least, most)


def _in_rows(rows: slice, columns: FloatArray) -> FloatArray:
    """Return (K, 9, p) with the columns (K, 3, p) in the rows of a block and zeros elsewhere."""
    whole = np.zeros((len(columns), 9, columns.shape[2]))
    whole[:, rows] = columns
    return whole


def _by_axes(rows: slice, axes: list[int], motion: TrueMotion) -> FloatArray:
    return _in_rows(rows, np.tile(np.eye(3)[:, axes], (len(motion.lla), 1, 1)))


def _undo_time(answers: Answers, _: TrueMotion, c: FloatArray) -> Answers:
    return replace(answers, late=answers.late + float(c[0]))


def _by_time(motion: TrueMotion) -> FloatArray:
    return -np.hstack([motion.vel_n, motion.accel_n, motion.turn_n])[:, :, None]


def tell_time(what: str, c: FloatArray) -> str:
    """Return the words for a constant shift of time [s]."""
    leap = next((words for seconds, words in _LEAPS.items() if abs(abs(c[0]) - seconds) < _NEAR_LEAP), "")
    return f"{what} that are {abs(c[0]):.3f} s too {'late' if c[0] > 0 else 'early'}{leap}"


def _by_arm(motion: TrueMotion) -> FloatArray:
    C_nb = motion.body_to_level
    whole = _in_rows(POS, C_nb)
    whole[:, VEL] = C_nb @ rotation.skew(motion.turn_b)
    return whole


def tell_arm(antenna_b: FloatArray, c: FloatArray) -> str:
    """Describe the point (3,) [m], b, with its motion reported in place of the motion of the IMU."""
    far = np.linalg.norm(antenna_b)
    if np.linalg.norm(c + antenna_b) < 0.3 * far:
        return f"a lever arm of {-c[0]:.2f}, {-c[1]:.2f}, {-c[2]:.2f} m that is applied twice"
    whose = "the antenna" if np.linalg.norm(c - antenna_b) < 0.3 * far else "a point"
    return f"the motion of {whose} {c[0]:.2f}, {c[1]:.2f}, {c[2]:.2f} m (forward, right, down) from the IMU"


def tell_height(c: FloatArray) -> str:
    """Return the words for a constant error of height [m]."""
    return f"heights over the geoid or another datum, {abs(c[0]):.1f} m too {'low' if c[0] > 0 else 'high'}"


def tell_offset(c: FloatArray) -> str:
    """Return the words for a constant offset (2,) north and east [m]."""
    return f"an offset of {c[0]:.2f} m north, {c[1]:.2f} m east"


def tell_scale(c: FloatArray) -> str:
    """Return the words for an attitude that is integrated from gyros with a wrong scale [1]."""
    return f"an attitude from gyros with a scale factor wrong by {100.0 * c[0]:.3f} %"


def tell_turn(axes: str, c: FloatArray) -> str:
    """Return the words for a constant turn (3,) [rad] about named axes."""
    by = ", ".join(f"{value:.2f}" for value in np.rad2deg(c))
    return f"an attitude turned by a constant {by} deg about {axes}"


# --- without ----------------------------------------------------------------------------------------------


def _exchange(
    name: str,
    block: str,
    change: Callable[[FloatArray, TrueMotion], FloatArray],
    shrinks: float = 0.0,
) -> Convention:
    """Return a convention that changes the values of one block by a function of the values and the motion."""
    column = {"pos": "lla", "vel": "vel_n", "phi": "q_nb"}[block]

    def undo(answers: Answers, motion: TrueMotion, _: FloatArray) -> Answers:
        values = getattr(answers, column).copy()
        with np.errstate(all="ignore"):
            values[motion.inside] = change(values[motion.inside], motion)
        return replace(answers, **{column: values})

    return Convention(name, lambda _: name, (block,), undo, shrinks=shrinks)


_HALF = np.sqrt(0.5)
_ANGLES = ((np.pi / 180.0, "degrees read as radians"), (180.0 / np.pi, "radians read as degrees"))
"""What undoes a wrong unit of angles, and its words."""
_LOCKED = 0.3  # least over largest singular value of E: below it an angle is not told
_Q_NED_ENU = np.array([0.0, _HALF, _HALF, 0.0])  # exchanges east and north, turns down into up
_Q_FRD_FLU = np.array([0.0, 1.0, 0.0, 0.0])


_UP = np.array([1.0, 1.0, -1.0])
_NEAR_LEAP = 0.02  # [s]
_LEAPS = {1.0: ", a leap second", 18.0: ", the leap seconds between GPS time and UTC"}
"""Shift of time [s] -> what it may be; `bench.simulation.signals.gps_time` counts 18 s since 2017."""


def _list_exchanged() -> Iterator[Convention]:
    yield _exchange("latitude and longitude that are exchanged", "pos", lambda x, _: x[:, [1, 0, 2]])
    for factor, words in _ANGLES:
        scale = partial(_scale, np.array([factor, factor, 1.0]))
        size = -float(np.log(factor))
        yield _exchange(f"latitude and longitude in {words}", "pos", scale, 2.0 * size)
        yield _exchange(f"attitude angles in {words}", "phi", partial(_undo_euler, 1.0 / factor), 3.0 * size)
    yield _exchange("geocentric latitudes", "pos", _undo_geocentric)
    yield _exchange("heights that count downwards", "pos", partial(_scale, _UP))
    yield _exchange("velocities east, north, up", "vel", lambda v, _: v[:, [1, 0, 2]] * _UP)
    yield _exchange("vertical velocities that count upwards", "vel", partial(_scale, _UP))
    yield _exchange("velocities along the body", "vel", lambda v, motion: rotation.rotate(motion.q_nb, v))
    for conjugate, level, body in product((False, True), repeat=3):
        words = " and ".join(
            [
                *(["from level to body, the conjugate quaternion"] if conjugate else []),
                *(["of axes forward, left, up"] if body else []),
                *(["in east, north, up"] if level else []),
            ]
        )
        if words:
            yield _exchange(f"an attitude {words}", "phi", partial(_undo_axes, conjugate, level, body))
    yield _exchange("headings that are negated", "phi", _undo_heading)
    yield _exchange("quaternions with their scalar last", "phi", lambda q, _: rotation.from_scalar_last(q))


def _scale(factors: FloatArray, values: FloatArray, _: TrueMotion) -> FloatArray:
    return values * factors


def _undo_geocentric(lla: FloatArray, motion: TrueMotion) -> FloatArray:
    """Return geodetic positions (K, 3); ``tan`` of a geocentric latitude is smaller by z / p over it."""
    prime = earth.radii(motion.lla[:, 0])[1]
    ratio = (prime * (1.0 - earth.WGS84.e2) + motion.lla[:, 2]) / (prime + motion.lla[:, 2])
    return np.column_stack([np.arctan(np.tan(lla[:, 0]) / ratio), lla[:, 1:]])


def _undo_heading(q: FloatArray, _: TrueMotion) -> FloatArray:
    roll, pitch, heading = rotation.to_euler(q)
    return rotation.from_euler(roll, pitch, -heading)


def _undo_axes(conjugate: bool, level: bool, body: bool, q: FloatArray, _: TrueMotion) -> FloatArray:
    q = rotation.conjugate(q) if conjugate else q
    q = rotation.multiply(_Q_NED_ENU, q) if level else q
    return rotation.multiply(q, _Q_FRD_FLU) if body else q


def _undo_euler(factor: float, q: FloatArray, motion: TrueMotion) -> FloatArray:
    """Return the attitude from Euler angles that were multiplied by a factor and perhaps wrapped.

    The small rotation from the true angles, multiplied, to the answer is ``E(wrong) factor d``; d are the
    errors of the angles, whose rotation at the true angles is ``E(true) d``. Where the wrong pitch is near 90
    deg, the answer tells one angle less, and its error counts as none.
    """
    true = np.column_stack(rotation.to_euler(motion.q_nb))
    wrong = factor * true
    apart = rotation.to_rotvec(rotation.multiply(q, rotation.conjugate(rotation.from_euler(*wrong.T))))
    moved = np.einsum("kij,kj->ki", np.linalg.pinv(_rates(wrong), _LOCKED), apart) / factor
    return rotation.multiply(rotation.from_rotvec(np.einsum("kij,kj->ki", _rates(true), moved)), motion.q_nb)


def _rates(euler: FloatArray) -> FloatArray:
    """Return the matrices (K, 3, 3) from small changes of roll, pitch, heading to a rotation, n."""
    _, pitch, heading = euler.T
    zero, one = np.zeros(len(euler)), np.ones(len(euler))
    forward = np.stack(
        [np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), -np.sin(pitch)], axis=1
    )
    right = np.stack([-np.sin(heading), np.cos(heading), zero], axis=1)
    return np.stack([forward, right, np.stack([zero, zero, one], axis=1)], axis=2)


# --- of the covariance --------------------------------------------------------------------------------------


def _list_claims() -> Iterator[Convention]:
    for unit, angle in (("", 1.0), (", of angles in degrees", 180.0 / np.pi)):
        units = np.repeat([1.0, 1.0, angle], 3)  # sd times this is in the unit of the file
        yield _claim(f"variances given as standard deviations{unit}", partial(_to_power, 0.5, units))
        yield _claim(f"standard deviations given as variances{unit}", partial(_to_power, 2.0, units))
    for factor, words in _ANGLES:
        scale = partial(np.multiply, np.repeat([1.0, 1.0, factor], 3))
        yield _claim(f"standard deviations of the attitude in {words}", scale, ("phi",))


def _to_power(power: float, units: FloatArray, sd: FloatArray) -> FloatArray:
    return np.asarray((sd * units) ** power / units)


def _claim(
    name: str, change: Callable[[FloatArray], FloatArray], blocks: tuple[str, ...] = ("pos", "vel", "phi")
) -> Convention:
    """Return a convention that changes the standard deviations (M, 9) and keeps the correlations."""

    def undo(answers: Answers, _: TrueMotion, __: FloatArray) -> Answers:
        with np.errstate(all="ignore"):
            sd = np.sqrt(np.einsum("kii->ki", answers.cov))
            ratio = change(sd) / sd
        return replace(answers, cov=answers.cov * ratio[:, :, None] * ratio[:, None, :])

    return Convention(name, lambda _: name, blocks, undo, of_claim=True)
