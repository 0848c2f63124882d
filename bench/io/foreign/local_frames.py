"""Positions in a local frame: where the frame is, which way its axes point, and its alignment with a track.

An alignment is a rigid motion that fits positions to the positions of a track in least squares, without a
scale: three angles by the singular value decomposition of Kabsch, or the heading alone. It takes its degrees
of freedom away from the errors, so that an aligned error is smaller than the true error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import NavSolution
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_count

SE3, YAW, NONE = "se3", "yaw", "none"
FREEDOM = {SE3: 6, YAW: 4, NONE: 0}
"""Kind of an alignment -> degrees of freedom that it takes away from the errors."""
_WORLD = {"n": (1, 0, 0), "e": (0, 1, 0), "d": (0, 0, 1)}  # north, east, down
_BODY = {"f": (1, 0, 0), "r": (0, 1, 0), "d": (0, 0, 1)}  # forward, right, down
_OPPOSITE = {"s": "n", "w": "e", "u": "d", "b": "f", "l": "r"}
_FEWEST = 3  # epochs
_THIN = 1e-3  # extent across a straight line, relative to the extent along it, that three angles need [1]


def is_origin(values: Sequence[float]) -> bool:
    """Return whether values are latitude, longitude [deg], height [m], and a heading [deg] if given."""
    return len(values) in (3, 4) and bool((np.abs(values) <= [90.0, 360.0, 1e5, 360.0][: len(values)]).all())


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Place and axes of a local frame."""

    name: str  # axes of the frame and of the body, such as "enu-flu"
    origin: FloatArray  # (3,) latitude, longitude [rad], height [m]
    heading: float = 0.0  # of its north axis, clockwise from north [rad]

    def place(
        self, pos_l: FloatArray, q_lb: FloatArray, vel_l: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return lla (N, 3), q_nb (N, 4), vel_n (N, 3) of positions, attitudes, velocities in the frame."""
        world, body = read_frame(self.name)
        C_ol = rotation.matrix(rotation.from_euler(0.0, 0.0, self.heading)) @ world
        q_ol, q_wb = rotation.from_matrix(C_ol), rotation.from_matrix(body.T)
        q_ob = rotation.multiply(q_ol, rotation.multiply(q_lb, q_wb))
        return from_tangent(self.origin, pos_l @ C_ol.T, q_ob, vel_l @ C_ol.T)


def read_frame(name: str) -> tuple[FloatArray, FloatArray]:
    """Return C_nl and C_bw (3, 3) of axes by name: to north, east, down, and to forward, right, down.

    Examples
    --------
    >>> read_frame("enu-flu")[1].diagonal()
    array([ 1., -1., -1.])
    """
    world, dash, body = name.lower().partition("-")
    if dash and len(world) == len(body) == 3:
        for known in (_WORLD, _BODY):  # a camera names the axes of its world as its own
            try:
                found = _find_axes(world, known), _find_axes(body, _BODY)
            except KeyError:
                continue
            if all(round(float(np.linalg.det(C))) == 1 for C in found):
                return found
    raise ConfigError(
        f"frame {name!r}: expected the axes x, y, z of the frame and of the body, right-handed: enu-flu, "
        "ned-frd, nwu-flu or another three of n e d s w u, then three of f r d b l u"
    )


def _find_axes(letters: str, known: dict[str, tuple[int, int, int]]) -> FloatArray:
    columns = [
        np.array(known[one], float) if one in known else -np.array(known[_OPPOSITE[one]], float)
        for one in letters
    ]
    return np.stack(columns, axis=-1)


def from_tangent(
    origin: FloatArray, pos_o: FloatArray, q_ob: FloatArray, vel_o: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return lla, q_nb, vel_n of positions, attitudes, velocities along north, east, down at an origin."""
    C_eo = earth.matrix_en(origin[0], origin[1])
    lla = earth.to_geodetic(earth.to_ecef(origin) + pos_o @ C_eo.T)
    q_ne = rotation.conjugate(rotation.from_matrix(earth.matrix_en(lla[:, 0], lla[:, 1])))
    q_no = rotation.multiply(q_ne, rotation.from_matrix(C_eo))
    return lla, rotation.multiply(q_no, q_ob), rotation.rotate(q_no, vel_o)


# --- alignment ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Alignment:
    """A rigid motion in the north-east-down frame at an origin: ``C @ position + shift``."""

    kind: str
    origin: FloatArray  # (3,) [rad, rad, m]
    C: FloatArray  # (3, 3)
    shift: FloatArray  # (3,) [m]
    residual: float  # root mean square of what is left [m]
    epochs: int

    def __str__(self) -> str:
        angles = rotation.to_rotvec(rotation.from_matrix(self.C))
        turn = math.degrees(float(np.linalg.norm(angles)))
        if self.kind == YAW:
            turn = math.degrees(float(angles[2]))
        moved = ", ".join(f"{value:.3f}" for value in self.shift)
        return (
            f"aligned ({self.kind}) by {self.epochs} epochs: turned by {turn:.4g} deg, moved by {moved} m "
            f"north, east, down; {FREEDOM[self.kind]} degrees of freedom are taken away, so that errors are "
            f"smaller than without an alignment; {self.residual:.3g} m rms are left"
        )

    def apply(self, solution: NavSolution) -> NavSolution:
        """Return a solution moved and turned, without the accuracy that it reports."""
        q_on = rotation.multiply(
            rotation.conjugate(rotation.from_matrix(earth.matrix_en(*self.origin[:2]))),
            rotation.from_matrix(earth.matrix_en(solution.lla[:, 0], solution.lla[:, 1])),
        )
        q_turn = rotation.from_matrix(self.C)
        lla, q_nb, vel_n = from_tangent(
            self.origin,
            earth.local_ned(solution.lla, self.origin) @ self.C.T + self.shift,
            rotation.multiply(q_turn, rotation.multiply(q_on, solution.q_nb)),
            rotation.rotate(rotation.multiply(q_turn, q_on), solution.vel_n),
        )
        return replace(solution, lla=lla, q_nb=q_nb, vel_n=vel_n, cov=np.full_like(solution.cov, np.nan))


def align(kind: str, lla: FloatArray, target: FloatArray, shown: str) -> Alignment:
    """Return the alignment of positions with the positions of a track at the same epochs.

    Parameters
    ----------
    kind : str
        ``"se3"``: three angles and position; ``"yaw"``: heading and position.
    lla, target : (N, 3) array
        Positions and where they belong [rad, rad, m]; rows with a NaN do not count.
    shown : str
        Name of the file in messages.

    Raises
    ------
    ConfigError
        If the positions do not determine it: one line.
    """
    known = np.isfinite(lla).all(axis=1) & np.isfinite(target).all(axis=1)
    if known.sum() < _FEWEST:
        many = format_count(int(known.sum()), "epoch")
        raise ConfigError(f"{shown}: {many} in common with the run; an alignment needs {_FEWEST}")
    origin = target[known][0]
    here, there = earth.local_ned(lla[known], origin), earth.local_ned(target[known], origin)
    C, thin = fit_rotation(kind, here - here.mean(axis=0), there - there.mean(axis=0))
    if thin < _THIN:
        what = "its positions, or the run, do not move horizontally, which leaves the heading open; "
        what += "align by none, with an origin"
        if kind == SE3:
            what = "its positions are a straight line, which leaves the angle about it open; align by yaw"
        raise ConfigError(f"{shown}: {what}")
    shift = there.mean(axis=0) - C @ here.mean(axis=0)
    residual = float(np.sqrt(np.mean(np.sum((here @ C.T + shift - there) ** 2, axis=1))))
    return Alignment(kind, origin, C, shift, residual, int(known.sum()))


def fit_rotation(kind: str, here: FloatArray, there: FloatArray) -> tuple[FloatArray, float]:
    """Return C (3, 3) that turns vectors ``here`` (N, 3) to ``there``, and how well they determine it [1].

    That number is the extent across a straight line over the extent along it; for the heading, the smaller
    one of both horizontal extents over the larger one, 0 for a point.
    """
    if kind == YAW:
        B = there.T @ here
        angle = math.atan2(B[1, 0] - B[0, 1], B[0, 0] + B[1, 1])
        few, most = sorted(float(np.hypot(*one[:, :2].T).max(initial=0.0)) for one in (here, there))
        return rotation.matrix(rotation.from_euler(0.0, 0.0, angle)), few / most if most > 0 else 0.0
    C, s = rotation.fit_vectors(here, there)
    return C, math.sqrt(float(s[1]) / float(s[0])) if s[0] > 0 else 0.0
