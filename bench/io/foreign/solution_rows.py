"""Solutions in the formats of other programs: receivers, reference systems and data sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, find_later
from bench.core.words.exceptions import ConfigError
from bench.evaluation.errors.resampling import ForeignSolution
from bench.io.foreign.local_frames import LocalFrame, read_frame
from bench.io.log_formats import find_format, guess_format
from bench.io.logs import formats
from bench.io.logs.formats.pose_files import GPS, PoseRows, read_poses, recognizes

_NORM_WRONG = 0.01  # of a quaternion that is left out [1]
_FAR = 1e7  # a local position that is impossible [m]


@dataclass(frozen=True, slots=True)
class Placing:
    """Where the local positions of a file are; what is not given comes from the file."""

    frame: str | None = None  # axes, such as "enu-flu"
    origin: tuple[float, ...] | None = None  # latitude, longitude [deg], height [m], heading [deg] if given
    near: FloatArray | None = None  # (3,) origin if none is known [rad, rad, m]

    def find_frame(self, frame: str, origin: tuple[float, ...], shown: str) -> tuple[LocalFrame, bool]:
        """Return a frame, and whether its origin is known."""
        lat, lon, alt, *heading = self.origin or origin or (np.nan,) * 3
        known = bool(np.isfinite(lat))
        if not known and self.near is None:
            raise ConfigError(
                f"{shown}: its positions are in a local frame without an origin; bench score aligns them"
            )
        place = np.array([np.deg2rad(lat), np.deg2rad(lon), alt]) if known else np.asarray(self.near)
        read_frame(self.frame or frame)
        return LocalFrame(
            self.frame or frame, place, float(np.deg2rad(heading[0] if heading else 0.0))
        ), known


NOWHERE = Placing()
"""Of positions whose place, if they are local, is in the file."""


def reject_placing(shown: str, **given: object) -> None:
    """Raise ConfigError if values that place a local frame are given for positions that have a place."""
    names = [name for name, value in given.items() if value is not None]
    if names:
        use = "only for positions in a local frame; its positions are geodetic or Earth-fixed: leave out"
        raise ConfigError(f"{shown}: {', '.join(names)}: {use} {' and '.join(names)}")


def read_foreign_rows(path: Path) -> PoseRows | None:
    """Return the rows of a trajectory or of the fixes of a receiver; None if the file is a table.

    Raises
    ------
    ConfigError
        If the file is of such a format and cannot be read: one line.
    """
    if recognizes(path):
        return read_poses(path)
    form = None if path.is_dir() else guess_format(path)
    if form is None or (not find_format(form).fixes and form not in ("novatel", "poses")):
        return None
    topic = "INSPVAX" if form == "novatel" and b"INSPVAXA" in _read_head(path) else None
    return PoseRows(formats.read(form, path, "gnss", topic), GPS)


def _read_head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(1 << 20)


def make_solution(found: PoseRows, shown: str, placing: Placing) -> ForeignSolution:
    """Return the solution in rows of a trajectory, without the rows that are damaged.

    Raises
    ------
    ConfigError
        If no row is usable, or the local frame has no place.
    """
    values, remarks, n = found.rows.values, list(found.rows.notes), len(found.rows.t)
    q, vel = values.get("q_nb"), values.get("vel_n")
    if found.frame:
        pos, q, vel, impossible = values["pos_l"], values["q_lb"], values.get("vel_l"), _FAR
    else:
        pos, impossible = values["lla"], 1e5
    with np.errstate(invalid="ignore", over="ignore"):
        good = (
            np.isfinite(pos).all(axis=1) & (np.abs(pos) < impossible).all(axis=1) & np.isfinite(found.rows.t)
        )
        if not found.frame:
            good &= (np.abs(pos[:, :2]) <= [0.5 * np.pi, 2.0 * np.pi]).all(axis=1)
        good &= values.get("valid", np.ones(n)) > 0
        if q is not None:
            good &= np.abs(np.linalg.norm(q, axis=1) - 1.0) < _NORM_WRONG
    moving = np.zeros(n, np.bool_) if vel is None else np.isfinite(vel).all(axis=1)
    if vel is not None and 2 * np.count_nonzero(moving & good) < np.count_nonzero(good):
        remarks.append("its velocities lack a component, such as the vertical one, and are not evaluated")
        vel = None
    elif vel is not None:
        good &= moving
    good[good] = find_later(found.rows.t[good])
    if not good.any():
        raise ConfigError(f"{shown}: none of its {n} rows has a time and a position that are possible")
    if not good.all():
        remarks.append(
            f"{n - np.count_nonzero(good)} of {n} rows left out: a value or the order of times is wrong"
        )
    n = int(good.sum())
    none3, none4 = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
    lla = pos[good]
    q_nb = none4 if q is None else q[good] / np.linalg.norm(q[good], axis=1)[:, None]
    vel_n, known = none3 if vel is None else vel[good], True
    if found.frame:
        frame, known = placing.find_frame(found.frame, found.origin, shown)
        lla, q_nb, vel_n = frame.place(lla, q_nb, vel_n)
        remarks.append(f"local frame {frame.name}" + ("" if known else ", whose place is unknown"))
    return ForeignSolution(
        shown=shown,
        rows=np.flatnonzero(good) + 1,
        t=found.rows.t[good],
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        gyro_bias_b=none3,
        accel_bias_b=none3,
        cov=_make_covariance(values, good, vel is not None),
        remarks=tuple(remarks),
        clock=found.clock,
        placed=known,
    )


def _make_covariance(values: Mapping[str, FloatArray], good: BoolArray, moves: bool) -> FloatArray | None:
    """Return covariances (N, 9, 9) of the standard deviations in a file, NaN without; None without any."""
    cov = np.full((int(good.sum()), 9, 9), np.nan)
    for k, block in enumerate(("sd_pos", "sd_vel")[: 1 + moves]):
        sd = values.get(block)
        if sd is not None and np.isfinite(sd[good]).all() and (sd[good] >= 0).all():
            cov[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = np.square(sd[good])[:, :, None] * np.eye(3)
    return None if np.isnan(cov).all() else cov
